//! How long the tests of trust take, and where they note what they found: `tools/trust` names a file, and has all the time;
//! without one a share is run.

use std::ffi::OsString;
use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::Write;

/// Names the file.
const NOTES: &str = "PARFOCAL_TRUST";

fn notes() -> Option<OsString> {
    std::env::var_os(NOTES).filter(|path| !path.is_empty())
}

/// Whether this run has all the time.
pub fn is_long() -> bool {
    notes().is_some()
}

/// Notes a figure for `docs/reliability.md`.
pub fn note(name: &str, figure: impl Display) {
    println!("{name}: {figure}");
    if let Some(path) = notes() {
        let mut notes = OpenOptions::new().create(true).append(true).open(path).unwrap();
        // In one write: tests run beside each other.
        notes.write_all(format!("{name}\t{figure}\n").as_bytes()).unwrap();
    }
}
