//! The program of `--on-done`, which runs for each part until it succeeds.

use std::collections::{BTreeSet, VecDeque};
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
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
    // CREATE_NEW_PROCESS_GROUP: Ctrl-C goes to this process only, as on Unix.
    #[cfg(windows)]
    std::os::windows::process::CommandExt::creation_flags(command, 0x200);
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

/// Ends the running program of `--on-done` with those that it started. No other one is started afterwards: the process
/// must end.
pub(crate) fn end_program() {
    // A program that is just being started keeps the lock, and is not waited for.
    let Ok(running) = PROGRAM.try_lock() else { return };
    running.iter().for_each(|id| kill_with_descendants(*id));
    std::mem::forget(running);
}

/// Kills the leader of a process group and the group. It fails if the program has just ended.
#[cfg(unix)]
fn kill_with_descendants(id: u32) {
    use nix::sys::signal::{Signal, killpg};

    let _ = i32::try_from(id).map(|id| killpg(nix::unistd::Pid::from_raw(id), Signal::SIGKILL));
}

/// Kills a program and those that it started, for which the standard library has no call.
#[cfg(not(unix))]
fn kill_with_descendants(id: u32) {
    let null = Stdio::null;
    let _ = Command::new("taskkill").args(["/F", "/T", "/PID", &id.to_string()]).stdout(null()).stderr(null()).status();
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
        let file = self.marks.join(name);
        let marked = || {
            fs::create_dir_all(&self.marks)?;
            // Does not follow a link, nor empty a file.
            match OpenOptions::new().write(true).create_new(true).open(&file) {
                Err(e) if e.kind() != io::ErrorKind::AlreadyExists => return Err(e),
                _ => (),
            }
            // The entry of the mark, then that of the folder of marks.
            let mut folders = self.marks.ancestors().take(if cfg!(unix) { 2 } else { 0 });
            folders.try_for_each(|folder| File::open(folder)?.sync_all())
        };
        marked().map_err(|e: io::Error| Failure::file(file, format!("cannot be written ({e})")))
    }

    /// Removes the mark of a part. The folder of marks stays, since another part may be about to be marked.
    fn unmark(&self, name: &str) {
        // The name of a part that failed may lead elsewhere.
        if Path::new(name).file_name().is_some_and(|own| own == name) {
            // A mark that stays makes the program run once more.
            let _ = fs::remove_file(self.marks.join(name));
        }
    }

    fn is_marked(&self, name: &str) -> bool {
        self.marks.join(name).symlink_metadata().is_ok()
    }

    fn marked(&self) -> impl Iterator<Item = String> {
        let entries = fs::read_dir(&self.marks).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned())
    }

    /// Whether the program has to run for a part: it was solved or failed, or its results were kept and it is still
    /// marked.
    fn is_due(&self, row: &Row) -> bool {
        match row.outcome {
            Outcome::Solved(_) | Outcome::Failed { .. } => true,
            Outcome::Kept(_) => self.is_marked(&row.name),
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
                self.wait(PAUSES[0]);
            }
            self.names.push_back(row.name.clone());
        }
    }

    /// Whether the pause before the next try has passed.
    pub(crate) fn is_due(&self) -> bool {
        !self.names.is_empty() && Instant::now() >= self.next
    }

    /// Sets a pause before the next try; if that fails too, the next pause is twice as long.
    fn wait(&mut self, pause: Duration) {
        (self.next, self.pause) = (Instant::now() + pause, PAUSES[1].min(2 * pause));
    }

    /// Tries one part again that is not `is_busy`. After a success the others follow without a pause. While a part is
    /// solved again, its row is of earlier results: it is passed on with its new row.
    pub(crate) fn retry(&mut self, rows: &[Row], is_busy: impl Fn(&str) -> bool) {
        let Some(program) = self.program else { return };
        let Some(name) = self.names.iter().position(|name| !is_busy(name)).and_then(|at| self.names.remove(at)) else {
            self.next = Instant::now() + PAUSES[0];
            return;
        };
        let Some(row) = rows.iter().find(|row| row.name == name) else { return };
        if program.run(row).is_ok() {
            (self.pause, self.next) = (PAUSES[0], Instant::now());
        } else {
            self.names.push_back(name);
            self.wait(self.pause);
        }
    }

    /// Removes the folder of marks if it is empty, when no part is solved any more.
    pub(crate) fn end(&self) {
        // It fails if a part is still marked.
        let _ = self.program.map(|program| fs::remove_dir(&program.marks));
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

#[cfg(all(test, windows))]
#[test]
fn a_program_is_killed() {
    let mut program = Command::new("cmd").args(["/C", "ping -n 60 127.0.0.1"]).stdout(Stdio::null()).spawn().unwrap();
    kill_with_descendants(program.id());
    assert!(!program.wait().unwrap().success());
}

#[cfg(all(test, unix))]
mod tests {
    use tempfile::TempDir;

    use super::*;

    fn row(name: &str) -> Row {
        Row::new(name, &[], Path::new(name), Outcome::Failed { error: String::new() })
    }

    /// The names of the marked parts; `None` without a folder of marks.
    fn marks(out: &TempDir) -> Option<Vec<String>> {
        let entries = fs::read_dir(out.path().join(UNDELIVERED)).ok()?;
        Some(entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect())
    }

    #[test]
    fn the_folder_of_marks_stays_while_parts_are_solved() {
        let out = TempDir::new().unwrap();
        let program = OnDone::new("true".into(), out.path());
        let mut undelivered = Undelivered::new(Some(&program));
        program.mark("a").unwrap();
        program.mark("a").unwrap();
        undelivered.pass_on(&row("a"));
        assert_eq!(marks(&out), Some(Vec::new()));
        program.mark("b").unwrap();
        undelivered.end();
        assert_eq!(marks(&out), Some(vec!["b".into()]));
        undelivered.pass_on(&row("b"));
        undelivered.end();
        assert_eq!(marks(&out), None);
    }

    #[test]
    fn a_part_that_is_solved_again_is_not_tried_with_its_earlier_row() {
        let out = TempDir::new().unwrap();
        let [fails, succeeds] = ["false", "true"].map(|program| OnDone::new(program.into(), out.path()));
        let (rows, mut undelivered) = ([row("a"), row("b")], Undelivered::new(Some(&fails)));
        for row in &rows {
            fails.mark(&row.name).unwrap();
            undelivered.pass_on(row);
        }
        undelivered.program = Some(&succeeds);
        undelivered.retry(&rows, |name| name == "a");
        assert_eq!((&undelivered.names, marks(&out)), (&VecDeque::from(["a".to_string()]), Some(vec!["a".into()])));
        undelivered.retry(&rows, |_| true);
        assert!(!undelivered.is_due() && undelivered.names.len() == 1);
        undelivered.retry(&rows, |_| false);
        assert_eq!((undelivered.names.len(), marks(&out)), (0, Some(Vec::new())));
    }

    #[test]
    fn each_pause_is_twice_the_one_before_and_begins_at_the_shortest_for_a_new_failure() {
        let out = TempDir::new().unwrap();
        let program = OnDone::new("false".into(), out.path());
        let (rows, mut undelivered) = ([row("a")], Undelivered::new(Some(&program)));
        let mut pauses = Vec::new();
        undelivered.pass_on(&rows[0]);
        for _ in 0..7 {
            undelivered.retry(&rows, |_| false);
            pauses.push(undelivered.pause.as_secs());
        }
        assert_eq!(pauses, [4, 8, 16, 32, 60, 60, 60]);
        undelivered.pass_on(&rows[0]);
        assert_eq!(undelivered.pause, 2 * PAUSES[0]);
    }
}
