//! Results folders after a kill or a disk failure at any system call.
//!
//! The folder must hold the new results, the earlier results, or a report that is marked unfinished.
//! strace kills the program as it enters a call, or makes the call fail.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

use crate::common::trust;
use crate::desk::{Desk, stderr_of};

/// System calls that take a path or a file descriptor. No other call can change a folder.
const CALLS: &str = "%file,%desc";

/// Calls of `CALLS` that are not made to fail: no disk failure affects them, or nothing could report it.
const SPARED: [&str; 4] = ["close", "fcntl", "mmap", "poll"];

/// The files of a folder: contents by relative path.
type Files = BTreeMap<String, Vec<u8>>;

/// A command and the state of the folder `out` before and after it.
struct Scene {
    desk: Desk,
    name: &'static str,
    command: Vec<&'static str>,
    /// All files before the command, including hidden files.
    before: Files,
    /// The visible files before the command: the earlier results.
    old: Files,
    /// The visible files after the command.
    new: Files,
}

impl Scene {
    fn new(name: &'static str, runs: &[&[&str]], command: &[&'static str]) -> Self {
        let desk = Desk::new();
        let [before, old, new] = [const { Files::new() }; 3];
        let mut scene = Self { desk, name, command: command.to_vec(), before, old, new };
        runs.iter().for_each(|arguments| _ = scene.desk.done(arguments));
        fs::create_dir_all(scene.out()).unwrap();
        scene.old = contents(&scene.out());
        scene.before = scene.old.clone();
        scene.desk.done(command);
        scene.new = contents(&scene.out());
        assert_ne!(scene.old, scene.new);
        scene
    }

    /// Starts from a folder in which an earlier run was killed while it renamed files.
    fn unfinished(mut self) -> Self {
        self.restore();
        self.run_with_fault("renameat", "signal=KILL:when=3");
        self.before = tree(&self.out());
        assert_eq!(self.state("killed before"), Held::Unfinished);
        self
    }

    fn out(&self) -> PathBuf {
        self.desk.path("out")
    }

    fn program(&self, by: &[&str]) -> Output {
        let program = assert_cmd::cargo::cargo_bin("parfocal");
        let mut command = match by {
            [] => Command::new(&program),
            [first, rest @ ..] => {
                let mut command = Command::new(first);
                command.args(rest).arg(&program);
                command
            }
        };
        command.current_dir(self.desk.folder()).env("PARFOCAL_CACHE_DIR", self.desk.path("cache"));
        command.args(&self.command).output().unwrap()
    }

    /// Runs the command under strace, which injects a signal or an error into calls of this name.
    fn run_with_fault(&self, call: &str, injection: &str) -> Output {
        let (trace, inject) = (format!("trace={call}"), format!("inject={call}:{injection}"));
        self.program(&["strace", "-f", "-qq", "-e", "signal=none", "-o", "/dev/null", "-e", &trace, "-e", &inject])
    }

    /// Restores the folder to its state before the command.
    fn restore(&self) {
        fs::remove_dir_all(self.out()).unwrap();
        fs::create_dir(self.out()).unwrap();
        for (name, bytes) in &self.before {
            let path = self.out().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
    }

    /// Lists the calls of the main thread, which writes the files.
    ///
    /// Returns the call's name, its number (from 1), and whether a call up to it has named the folder.
    fn points(&self) -> Vec<(String, usize, bool)> {
        self.restore();
        let log = self.desk.path("log");
        let by =
            ["strace", "-f", "-qq", "-e", &format!("trace={CALLS}"), "-e", "signal=none", "-o", log.to_str().unwrap()];
        assert!(self.program(&by).status.success());
        let log = fs::read_to_string(log).unwrap();
        let (mut counts, mut points, mut begun) = (BTreeMap::<_, usize>::new(), BTreeSet::new(), false);
        let mut main = None;
        for line in log.lines() {
            let Some((thread, call)) = line.trim_start().split_once(' ') else { continue };
            let Some((call, arguments)) = call.trim_start().split_once('(') else { continue };
            if call.starts_with(|c: char| c.is_ascii_lowercase()) {
                let count = counts.entry((thread, call)).or_default();
                *count += 1;
                begun |= call != "execve" && arguments.contains("\"out");
                // strace counts calls per thread, so a count of another thread would match an earlier call of this one.
                let first = *main.get_or_insert(thread);
                if thread == first && call != "execve" {
                    points.insert((call.to_string(), *count, begun));
                }
            }
        }
        points.into_iter().collect()
    }

    /// Determines what the folder holds after a failure. Panics if the state is invalid.
    #[track_caller]
    fn state(&self, what: &str) -> Held {
        let found = contents(&self.out());
        match found {
            found if found == self.new => Held::New,
            found if found == self.old => Held::Old,
            found => {
                let report = ["truth.json", "report.json"].iter().find_map(|name| found.get(*name));
                let report: Option<Value> = report.and_then(|bytes| serde_json::from_slice(bytes).ok());
                let is_marked = report.is_some_and(|report| report["unfinished"] == true);
                let names: Vec<_> = found.keys().collect();
                assert!(is_marked, "{}, {what}: incomplete results without an unfinished mark: {names:?}", self.name);
                let all = tree(&self.out());
                let is_kept = |(name, bytes)| all.iter().any(|(at, found)| at.ends_with(name) && found == bytes);
                assert!(self.old.iter().all(is_kept), "{}, {what}: earlier results are lost", self.name);
                Held::Unfinished
            }
        }
    }

    /// Asserts that the next run completes and leaves only the new results.
    #[track_caller]
    fn assert_recovers(&self, what: &str) {
        let done = self.program(&[]);
        assert!(done.status.success(), "{}, {what}: {}", self.name, stderr_of(&done));
        assert!(contents(&self.out()) == self.new, "{}, {what}: not recovered", self.name);
        let hidden = fs::read_dir(self.out()).unwrap().filter(|entry| is_hidden(&entry.as_ref().unwrap().path()));
        assert_eq!(hidden.count(), 0, "{}, {what}: hidden files are left", self.name);
    }
}

/// State of a results folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Held {
    Old,
    New,
    Unfinished,
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().unwrap().to_string_lossy().starts_with(".parfocal-")
}

/// All files of a folder and its subfolders, by relative path.
fn tree(folder: &Path) -> Files {
    let mut all = Files::new();
    for path in fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            all.extend(tree(&path).into_iter().map(|(within, bytes)| (format!("{name}/{within}"), bytes)));
        } else {
            all.insert(name, fs::read(&path).unwrap());
        }
    }
    all
}

/// The files of a folder without the program's hidden files.
fn contents(folder: &Path) -> Files {
    let mut seen = tree(folder);
    seen.retain(|name, _| !is_hidden(Path::new(name.split('/').next().unwrap())));
    seen
}

/// The commands under test: a pair into an empty folder, over a pair and over a sweep, and a sweep over a pair.
///
/// The last scene repeats the pair over a sweep after an earlier run of it was killed.
fn scenes() -> [Scene; 5] {
    let pair = ["simulate", "plane", "--size", "40x32", "-o", "out", "--quiet"];
    let other = [&pair[..], &["--seed", "2"]].concat();
    let sweep = [&pair[..], &["--frames", "4"]].concat();
    [
        Scene::new("the first", &[], &pair),
        Scene::new("over another", &[&other], &pair),
        Scene::new("over a sweep", &[&sweep], &pair),
        Scene::new("a sweep over a pair", &[&pair], &sweep),
        Scene::new("begun before", &[&sweep], &pair).unfinished(),
    ]
}

/// Selects the calls that this run tests: all in a long run, otherwise every 24th of each scene.
fn select_calls(points: impl Iterator<Item = (String, usize, bool)>) -> impl Iterator<Item = (String, usize)> {
    let stride = if trust::is_long() { 1 } else { 24 };
    points.step_by(stride).map(|(call, count, _)| (call, count))
}

#[test]
fn a_kill_at_any_call_leaves_complete_results_or_an_unfinished_mark() {
    let mut held = BTreeMap::<Held, usize>::new();
    for scene in scenes() {
        for (call, count) in select_calls(scene.points().into_iter()) {
            scene.restore();
            let what = format!("killed at {call} {count}");
            let ended = scene.run_with_fault(&call, &format!("signal=KILL:when={count}"));
            assert!(!ended.status.success() || scene.state(&what) == Held::New, "{what}");
            *held.entry(scene.state(&what)).or_default() += 1;
            scene.assert_recovers(&what);
        }
    }
    let kills: usize = held.values().sum();
    trust::note("kills", format!("{kills}: {held:?}"));
    assert!(kills > 20, "{held:?}");
}

#[test]
fn a_disk_failure_at_any_call_leaves_complete_results_or_an_unfinished_mark() {
    let mut held = BTreeMap::<(Held, bool), usize>::new();
    for scene in scenes() {
        // Calls before the folder is named belong to loading the program.
        let points = scene.points().into_iter().filter(|(call, _, begun)| *begun && !SPARED.contains(&call.as_str()));
        for (call, count) in select_calls(points) {
            for (error, when) in [("EIO", ""), ("ENOSPC", "+")] {
                scene.restore();
                let what = format!("{error} at {call} {count}{when}");
                let ended = scene.run_with_fault(&call, &format!("error={error}:when={count}{when}"));
                let stderr = stderr_of(&ended);
                let left = scene.state(&what);
                assert!(ended.status.code().is_some_and(|code| code < 2), "{what}: {} {stderr}", ended.status);
                assert!(
                    !ended.status.success() || left == Held::New,
                    "{what}: {left:?}, but the exit status is 0: {stderr}"
                );
                *held.entry((left, ended.status.success())).or_default() += 1;
                scene.assert_recovers(&what);
            }
        }
    }
    trust::note("disk faults", format!("{}: {held:?}", held.values().sum::<usize>()));
}
