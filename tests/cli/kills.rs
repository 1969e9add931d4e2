//! Results stand whole, or the earlier ones do, or the folder says that it is unfinished: wherever the program is killed, and
//! wherever the disk fails. strace kills it as it enters a call, or has the call fail.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

use crate::common::trust;

/// Calls that take a path or a file: whatever else a program does, it changes no folder.
const CALLS: &str = "%file,%desc";

/// Of these, what no disk fails: memory, and ends of which there is nobody to tell.
const SPARED: [&str; 4] = ["close", "fcntl", "mmap", "poll"];

/// What is in a folder.
type Set = BTreeMap<String, Vec<u8>>;

/// A command, and what is in the folder `out` before it.
struct Scene {
    desk: TempDir,
    name: &'static str,
    command: Vec<&'static str>,
    /// All of the folder before the command, hidden files too.
    before: Set,
    /// The earlier results.
    old: Set,
    new: Set,
}

impl Scene {
    fn new(name: &'static str, runs: &[&[&str]], command: &[&'static str]) -> Self {
        let desk = TempDir::new().unwrap();
        let [before, old, new] = [const { Set::new() }; 3];
        let mut scene = Self { desk, name, command: command.to_vec(), before, old, new };
        runs.iter().for_each(|arguments| scene.must(arguments));
        fs::create_dir_all(scene.out()).unwrap();
        scene.old = contents(&scene.out());
        scene.before = scene.old.clone();
        scene.must(command);
        scene.new = contents(&scene.out());
        assert_ne!(scene.old, scene.new);
        scene
    }

    /// The same where a run before it was killed as files got their names.
    fn unfinished(mut self) -> Self {
        self.restore();
        self.struck("renameat", "signal=KILL:when=3");
        self.before = tree(&self.out());
        assert_eq!(self.judge("killed before"), Held::Unfinished);
        self
    }

    fn out(&self) -> PathBuf {
        self.desk.path().join("out")
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
        command.current_dir(self.desk.path()).env("PARFOCAL_CACHE_DIR", self.desk.path().join("cache"));
        command.args(&self.command).output().unwrap()
    }

    /// The command, by strace, which injects something into calls of this name.
    fn struck(&self, call: &str, injection: &str) -> Output {
        let (trace, inject) = (format!("trace={call}"), format!("inject={call}:{injection}"));
        self.program(&["strace", "-f", "-qq", "-e", "signal=none", "-o", "/dev/null", "-e", &trace, "-e", &inject])
    }

    fn must(&self, arguments: &[&str]) {
        let program = assert_cmd::cargo::cargo_bin("parfocal");
        let done = Command::new(program).current_dir(self.desk.path()).args(arguments).output().unwrap();
        assert!(done.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&done.stderr));
    }

    /// As before the command.
    fn restore(&self) {
        fs::remove_dir_all(self.out()).unwrap();
        fs::create_dir(self.out()).unwrap();
        for (name, bytes) in &self.before {
            let path = self.out().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
    }

    /// The calls of the first thread, which writes: which, its how many-th, and whether the folder has been named by then.
    fn points(&self) -> Vec<(String, usize, bool)> {
        self.restore();
        let log = self.desk.path().join("log");
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
                // strace counts for each thread: those of others would be met by this one long before.
                let first = *main.get_or_insert(thread);
                if thread == first && call != "execve" {
                    points.insert((call.to_string(), *count, begun));
                }
            }
        }
        points.into_iter().collect()
    }

    /// What the folder holds after something went wrong in it.
    #[track_caller]
    fn judge(&self, what: &str) -> Held {
        let found = contents(&self.out());
        match found {
            found if found == self.new => Held::New,
            found if found == self.old => Held::Old,
            found => {
                let report = ["truth.json", "report.json"].iter().find_map(|name| found.get(*name));
                let told: Option<Value> = report.and_then(|bytes| serde_json::from_slice(bytes).ok());
                let says = told.is_some_and(|report| report["unfinished"] == true);
                let names: Vec<_> = found.keys().collect();
                assert!(says, "{}, {what}: neither set, and nothing says so: {names:?}", self.name);
                let all = tree(&self.out());
                let is_kept = |(name, bytes)| all.iter().any(|(at, found)| at.ends_with(name) && found == bytes);
                assert!(self.old.iter().all(is_kept), "{}, {what}: earlier results are lost", self.name);
                Held::Unfinished
            }
        }
    }

    /// The next run makes all good.
    #[track_caller]
    fn recovers(&self, what: &str) {
        let done = self.program(&[]);
        assert!(done.status.success(), "{}, {what}: {}", self.name, String::from_utf8_lossy(&done.stderr));
        assert!(contents(&self.out()) == self.new, "{}, {what}: not recovered", self.name);
        let hidden = fs::read_dir(self.out()).unwrap().filter(|entry| is_hidden(&entry.as_ref().unwrap().path()));
        assert_eq!(hidden.count(), 0, "{}, {what}: something is left", self.name);
    }
}

/// What a folder holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Held {
    Old,
    New,
    Unfinished,
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().unwrap().to_string_lossy().starts_with(".parfocal-")
}

/// All that a folder holds, and folders in it.
fn tree(folder: &Path) -> Set {
    let mut all = Set::new();
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

/// But for what is hidden from whoever looks into it.
fn contents(folder: &Path) -> Set {
    let mut seen = tree(folder);
    seen.retain(|name, _| !is_hidden(Path::new(name.split('/').next().unwrap())));
    seen
}

/// A pair where there was none; over another; over a sweep, whose files go; a sweep over a pair; over a sweep where that was
/// begun before.
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

/// Of so many points, those that this run tries: all where it has the time, else a share of each scene that the next share
/// does not hold.
fn tried(points: impl Iterator<Item = (String, usize, bool)>) -> impl Iterator<Item = (String, usize)> {
    let stride = if trust::is_long() { 1 } else { 24 };
    points.step_by(stride).map(|(call, count, _)| (call, count))
}

#[test]
fn a_program_that_is_killed_anywhere_leaves_one_set_whole_or_says_that_it_does_not() {
    let mut held = BTreeMap::<Held, usize>::new();
    for scene in scenes() {
        for (call, count) in tried(scene.points().into_iter()) {
            scene.restore();
            let what = format!("killed at {call} {count}");
            let ended = scene.struck(&call, &format!("signal=KILL:when={count}"));
            assert!(!ended.status.success() || scene.judge(&what) == Held::New, "{what}");
            *held.entry(scene.judge(&what)).or_default() += 1;
            scene.recovers(&what);
        }
    }
    let kills: usize = held.values().sum();
    trust::note("kills", format!("{kills}: {held:?}"));
    assert!(kills > 20, "{held:?}");
}

#[test]
fn a_disk_that_fails_anywhere_leaves_one_set_whole_or_says_that_it_does_not() {
    let mut held = BTreeMap::<(Held, bool), usize>::new();
    for scene in scenes() {
        // Before the folder is named, what fails is the loading of the program.
        let points = scene.points().into_iter().filter(|(call, _, begun)| *begun && !SPARED.contains(&call.as_str()));
        for (call, count) in tried(points) {
            for (error, when) in [("EIO", ""), ("ENOSPC", "+")] {
                scene.restore();
                let what = format!("{error} at {call} {count}{when}");
                let ended = scene.struck(&call, &format!("error={error}:when={count}{when}"));
                let told = String::from_utf8_lossy(&ended.stderr);
                let left = scene.judge(&what);
                assert!(ended.status.code().is_some_and(|code| code < 2), "{what}: {} {told}", ended.status);
                assert!(!ended.status.success() || left == Held::New, "{what}: {left:?}, and nothing was said: {told}");
                *held.entry((left, ended.status.success())).or_default() += 1;
                scene.recovers(&what);
            }
        }
    }
    trust::note("disk faults", format!("{}: {held:?}", held.values().sum::<usize>()));
}
