//! A command of the user's, run of each pair that was solved.

use std::ffi::OsString;
use std::io::{self, Write};
use std::process::{Command, Stdio};

use crate::cli::batch::batch_summary::{Outcome, Row};
use crate::cli::output::failure::plain;

/// A program, which is given the folder of results; nothing goes through a shell.
#[derive(Debug)]
pub(crate) struct OnDone(pub(crate) OsString);

impl OnDone {
    /// Runs it, unless nothing was done, and says where it fails: the pairs go on.
    pub(crate) fn run(&self, row: &Row) {
        if matches!(row.outcome(), Outcome::Kept(_) | Outcome::NotDone) {
            return;
        }
        let mut command = Command::new(&self.0);
        command.arg(row.output()).stdin(Stdio::null());
        command.env("PARFOCAL_NAME", row.name()).env("PARFOCAL_OUTPUT", row.output());
        command.env("PARFOCAL_STATUS", row.outcome().status());
        let problem = match command.status() {
            Ok(status) if status.success() => return,
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        let (program, name) = (plain(&self.0.to_string_lossy()), plain(row.name()));
        let _ = writeln!(io::stderr(), "warning: --on-done {program} of {name}: {problem}");
    }
}
