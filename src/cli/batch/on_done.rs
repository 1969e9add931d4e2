//! The program of `--on-done`, which runs for each part.

use std::ffi::OsString;
use std::io::{self, Write};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};

use crate::cli::batch::outcome::Outcome;
use crate::cli::batch::summary::Row;
use crate::cli::output::failure::plain;

/// The process group of the running program of `--on-done`.
static PROGRAM: Mutex<Option<u32>> = Mutex::new(None);

/// Runs a program in a process group of its own, so that [`end_program`] also ends the programs that it started.
fn run_program(command: &mut Command) -> io::Result<ExitStatus> {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    let running = || PROGRAM.lock().unwrap_or_else(PoisonError::into_inner);
    let mut child = {
        let mut running = running();
        let child = command.spawn()?;
        *running = Some(child.id());
        child
    };
    let status = child.wait();
    *running() = None;
    status
}

/// Ends the running program of `--on-done` on Unix. No other one is started afterwards: the process must end.
pub(crate) fn end_program() {
    // A program that is just being started keeps the lock, and is not waited for.
    let Ok(running) = PROGRAM.try_lock() else { return };
    #[cfg(unix)]
    if let Some(id) = running.and_then(|id| i32::try_from(id).ok()) {
        use nix::sys::signal::{Signal, killpg};

        // It fails if the program has just ended.
        let _ = killpg(nix::unistd::Pid::from_raw(id), Signal::SIGKILL);
    }
    std::mem::forget(running);
}

/// The program of `--on-done`. It gets the folder of results as its argument, without a shell.
#[derive(Debug)]
pub(crate) struct OnDone(pub(crate) OsString);

impl OnDone {
    /// Runs the program for a task that was solved or failed. A failure of the program gives a warning.
    pub(crate) fn run(&self, row: &Row) {
        if matches!(row.outcome, Outcome::Kept(_) | Outcome::NotDone) {
            return;
        }
        let mut command = Command::new(&self.0);
        command.arg(&row.output).stdin(Stdio::null());
        command.env("PARFOCAL_NAME", &row.name).env("PARFOCAL_OUTPUT", &row.output);
        command.env("PARFOCAL_STATUS", row.outcome.status());
        if let Some(part) = &row.inspection {
            command.env("PARFOCAL_VERDICT", part.verdict.name());
            command.env("PARFOCAL_TIME", part.time.as_deref().unwrap_or_default());
            command.env("PARFOCAL_REASONS", part.reason());
        }
        let problem = match run_program(&mut command) {
            Ok(status) if status.success() => return,
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        let (program, name) = (plain(&self.0.to_string_lossy()), plain(&row.name));
        let _ = writeln!(io::stderr(), "warning: --on-done {program} of {name}: {problem}");
    }
}
