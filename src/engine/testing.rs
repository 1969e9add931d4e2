//! For tests: the options of their device, and notes for `docs/reliability.md`.

use crate::engine::EngineOptions;

/// The device that PARFOCAL_DEVICE names, or the default one, with validation unless PARFOCAL_VALIDATE is 0.
pub(crate) fn options() -> EngineOptions {
    EngineOptions {
        device: std::env::var("PARFOCAL_DEVICE").ok(),
        validation: std::env::var("PARFOCAL_VALIDATE").as_deref() != Ok("0"),
        ..EngineOptions::default()
    }
}

/// The environment variable that names the file in which `tools/trust` collects figures.
const NOTES: &str = "PARFOCAL_TRUST";

fn notes() -> Option<std::ffi::OsString> {
    std::env::var_os(NOTES).filter(|path| !path.is_empty())
}

/// Whether this run tries all cases. Otherwise it tries a share.
pub(crate) fn is_long() -> bool {
    notes().is_some()
}

/// Appends a figure for `docs/reliability.md`.
pub(crate) fn note(name: &str, figure: &str) {
    use std::io::Write;

    println!("{name}: {figure}");
    if let Some(path) = notes() {
        let mut notes = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
        // In one write: tests run in parallel.
        notes.write_all(format!("{name}\t{figure}\n").as_bytes()).unwrap();
    }
}
