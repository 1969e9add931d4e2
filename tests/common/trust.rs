//! Run length and results file of the reliability tests. `tools/trust` runs all cases, other runs a share.

use std::ffi::OsString;
use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::Write;

/// Environment variable with the path of the results file.
const NOTES: &str = "PARFOCAL_TRUST";

fn notes() -> Option<OsString> {
    std::env::var_os(NOTES).filter(|path| !path.is_empty())
}

/// Returns whether all cases run.
pub fn is_long() -> bool {
    notes().is_some()
}

/// Prints a figure, and appends it to the results file for `docs/reliability.md`.
pub fn note(name: &str, figure: impl Display) {
    println!("{name}: {figure}");
    if let Some(path) = notes() {
        let mut notes = OpenOptions::new().create(true).append(true).open(path).unwrap();
        // One write call, because tests run in parallel.
        notes.write_all(format!("{name}\t{figure}\n").as_bytes()).unwrap();
    }
}
