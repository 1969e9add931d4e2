//! How many cases the reliability tests run, and the file of their figures: all cases under `tools/trust`, else a
//! share.

use std::ffi::OsString;
use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::Write;

/// The environment variable that names the file.
const NOTES: &str = "PARFOCAL_TRUST";

fn notes() -> Option<OsString> {
    std::env::var_os(NOTES).filter(|path| !path.is_empty())
}

/// Whether all cases run.
pub fn is_long() -> bool {
    notes().is_some()
}

/// Writes a figure for `docs/reliability.md`.
pub fn note(name: &str, figure: impl Display) {
    println!("{name}: {figure}");
    if let Some(path) = notes() {
        let mut notes = OpenOptions::new().create(true).append(true).open(path).unwrap();
        // One write: tests run in parallel.
        notes.write_all(format!("{name}\t{figure}\n").as_bytes()).unwrap();
    }
}
