//! The program of `--on-done`, which runs for each part until it succeeds.

use std::collections::{BTreeSet, VecDeque};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::cli::batch::outcome::Outcome;
use crate::cli::batch::summary::Row;
use crate::cli::options::photographs::in_short;
use crate::cli::output::failure::{Failure, plain};

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

/// Folder, in that of the results, with an empty file for each part that was solved and is not yet passed on. No part
/// has its name, since it begins with a dot.
const UNDELIVERED: &str = ".undelivered";

/// The program of `--on-done`. It gets the folder of results as its argument, without a shell.
#[derive(Debug)]
pub(crate) struct OnDone {
    program: OsString,
    marks: PathBuf,
}

impl OnDone {
    /// Makes the program of a `watch` that writes into the folder `out`.
    pub(crate) fn new(program: OsString, out: &Path) -> Self {
        Self { program, marks: out.join(UNDELIVERED) }
    }

    /// Marks a part as not passed on, before its results are written. If this process ends before the program has
    /// succeeded, the next one runs it.
    pub(crate) fn mark(&self, name: &str) -> Result<(), Failure> {
        let marked = || {
            fs::create_dir_all(&self.marks)?;
            File::create(self.marks.join(name))?;
            if cfg!(unix) { File::open(&self.marks)?.sync_all() } else { Ok(()) }
        };
        let file = self.marks.join(name);
        marked().map_err(|e: io::Error| Failure::Failed(format!("{}: cannot be written ({e})", file.display())))
    }

    /// Removes the mark of a part, and the folder of the last one.
    fn unmark(&self, name: &str) {
        // The name of a part that failed may lead elsewhere.
        if Path::new(name).file_name().is_some_and(|own| own == name) {
            // A mark that stays makes the program run once more.
            let _ = fs::remove_file(self.marks.join(name));
            let _ = fs::remove_dir(&self.marks);
        }
    }

    fn marked(&self) -> impl Iterator<Item = String> {
        let entries = fs::read_dir(&self.marks).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned())
    }

    /// Whether the program has to run for a part: it was solved or failed, or an earlier process solved it only.
    fn is_due(&self, row: &Row) -> bool {
        match row.outcome {
            Outcome::Solved(_) | Outcome::Failed { .. } => true,
            Outcome::Kept(_) => self.marks.join(&row.name).exists(),
            Outcome::NotDone => false,
        }
    }

    /// Runs the program for a part.
    fn run(&self, row: &Row) -> Result<(), String> {
        let mut command = Command::new(&self.program);
        command.arg(&row.output).stdin(Stdio::null());
        command.env("PARFOCAL_NAME", &row.name).env("PARFOCAL_OUTPUT", &row.output);
        let is_failed = matches!(row.outcome, Outcome::Failed { .. });
        command.env("PARFOCAL_STATUS", if is_failed { "failed" } else { "solved" });
        if let Some(part) = &row.inspection {
            command.env("PARFOCAL_VERDICT", part.verdict.name());
            command.env("PARFOCAL_TIME", part.time.as_deref().unwrap_or_default());
            command.env("PARFOCAL_REASONS", part.reason());
        }
        match run_program(&mut command) {
            Ok(status) if status.success() => {
                self.unmark(&row.name);
                Ok(())
            }
            Ok(status) => Err(status.to_string()),
            Err(error) => Err(error.to_string()),
        }
    }
}

/// The shortest and the longest pause before the program is tried again. Each failure doubles it.
const PAUSES: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(60)];

/// The parts of one `watch` that were not passed on, because the program failed.
pub(crate) struct Undelivered<'a> {
    program: Option<&'a OnDone>,
    names: VecDeque<String>,
    pause: Duration,
    /// When the first part is tried again.
    next: Instant,
}

impl<'a> Undelivered<'a> {
    pub(crate) fn new(program: Option<&'a OnDone>) -> Self {
        Self { program, names: VecDeque::new(), pause: PAUSES[0], next: Instant::now() }
    }

    /// Runs the program for a new part. After a failure, prints a warning and keeps the name.
    pub(crate) fn pass_on(&mut self, row: &Row) {
        let Some(program) = self.program.filter(|program| program.is_due(row)) else { return };
        self.names.retain(|name| *name != row.name);
        if let Err(problem) = program.run(row) {
            let (program, name) = (plain(&program.program.to_string_lossy()), plain(&row.name));
            let _ = writeln!(io::stderr(), "warning: --on-done {program} of {name}: {problem}; it is tried again");
            if self.names.is_empty() {
                self.next = Instant::now() + self.pause;
            }
            self.names.push_back(row.name.clone());
        }
    }

    /// Whether the pause before the next try has passed.
    pub(crate) fn is_due(&self) -> bool {
        !self.names.is_empty() && Instant::now() >= self.next
    }

    /// Tries one part again. After a success the others follow without a pause.
    pub(crate) fn retry(&mut self, rows: &[Row]) {
        let Some((program, name)) = self.program.zip(self.names.pop_front()) else { return };
        let Some(row) = rows.iter().find(|row| row.name == name) else { return };
        if program.run(row).is_ok() {
            (self.pause, self.next) = (PAUSES[0], Instant::now());
        } else {
            self.names.push_back(name);
            self.next = Instant::now() + self.pause;
            self.pause = PAUSES[1].min(2 * self.pause);
        }
    }

    /// Fails if a part was not passed on, now or by an earlier process.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        let marked = self.program.into_iter().flat_map(OnDone::marked);
        let names: BTreeSet<String> = self.names.iter().cloned().chain(marked).map(|name| plain(&name)).collect();
        let names: Vec<String> = names.into_iter().collect();
        let Some(marks) = self.program.map(|program| plain(&program.marks.display().to_string())) else {
            return Ok(());
        };
        match names.len() {
            0 => Ok(()),
            count => Err(Failure::Failed(format!(
                "--on-done has not succeeded for {count} part{}: {}; the next start tries again if the photographs are \
                 still there; to give up, remove {marks}",
                if count == 1 { "" } else { "s" },
                in_short(&names, ", ")
            ))),
        }
    }
}
