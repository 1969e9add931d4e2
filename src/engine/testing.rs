//! For tests: the device that they run on, and how long they take.

use crate::engine::EngineOptions;

/// The device named by PARFOCAL_DEVICE, or the default one, under validation unless PARFOCAL_VALIDATE is 0. A missing
/// device or layer fails the test.
pub(crate) fn options() -> EngineOptions {
    EngineOptions {
        device: std::env::var("PARFOCAL_DEVICE").ok(),
        validation: std::env::var("PARFOCAL_VALIDATE").as_deref() != Ok("0"),
        ..EngineOptions::default()
    }
}

/// Names the file in which `tools/trust` collects figures.
const NOTES: &str = "PARFOCAL_TRUST";

fn notes() -> Option<std::ffi::OsString> {
    std::env::var_os(NOTES).filter(|path| !path.is_empty())
}

/// Whether this run has all the time; a share is tried where not.
pub(crate) fn is_long() -> bool {
    notes().is_some()
}

/// Notes a figure for `docs/reliability.md`.
pub(crate) fn note(name: &str, figure: &str) {
    use std::io::Write;

    println!("{name}: {figure}");
    if let Some(path) = notes() {
        let mut notes = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
        // In one write: tests run beside each other.
        notes.write_all(format!("{name}\t{figure}\n").as_bytes()).unwrap();
    }
}
