//! A temporary folder in which tests run the program, and what they check of its output.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::Duration;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

/// A temporary folder. The program runs in it and keeps its cache in the subfolder `cache`.
///
/// Names of files are relative to the folder.
pub struct Desk {
    folder: TempDir,
    /// Whether the program runs on Vulkan, under validation if the environment asks for it.
    is_vulkan: bool,
}

impl Desk {
    /// Returns an empty folder. The program runs on the CPU device in it, unless the environment or its arguments name
    /// another: on lavapipe, compiling pipelines under validation takes ten times as long as a small pair.
    pub fn new() -> Self {
        Self { folder: TempDir::new().unwrap(), is_vulkan: false }
    }

    /// Has the program run on Vulkan, under validation if the environment asks for it.
    pub fn on_vulkan(self) -> Self {
        Self { is_vulkan: true, ..self }
    }

    /// Returns a folder with the pair `i1.png`, `i2.png` of 80x64 px and its scene in `scene`.
    pub fn with_pair() -> Self {
        let desk = Self::new();
        desk.done(&["simulate", "plane", "--size", "80x64", "-o", "scene", "--quiet"]);
        for name in ["i1.png", "i2.png"] {
            fs::copy(desk.path("scene").join(name), desk.path(name)).unwrap();
        }
        desk
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns the program as a process to be started and controlled.
    pub fn process(&self, arguments: &[&str]) -> std::process::Command {
        let mut process = std::process::Command::new(assert_cmd::cargo::cargo_bin("parfocal"));
        process.current_dir(self.folder()).env("PARFOCAL_CACHE_DIR", self.path("cache")).args(arguments);
        choose_device(&mut process, self.is_vulkan);
        process
    }

    /// Returns the program to be run to its end. A program that hangs fails the test.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::from_std(self.process(arguments));
        command.timeout(Duration::from_secs(1200));
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs the program and asserts its exit status.
    #[track_caller]
    pub fn exits(&self, arguments: &[&str], status: i32) -> Output {
        let output = self.run(arguments);
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {}", stderr_of(&output));
        output
    }

    /// Runs the program and asserts success.
    #[track_caller]
    pub fn done(&self, arguments: &[&str]) -> Output {
        self.exits(arguments, 0)
    }

    /// Runs the program with `--json` and returns what it prints.
    #[track_caller]
    pub fn printed(&self, arguments: &[&str]) -> Value {
        let output = self.done(&[arguments, &["--json"]].concat());
        println!("{}", stderr_of(&output));
        printed(&output)
    }

    /// Runs the program and asserts its exit status and the parts of its message.
    #[track_caller]
    pub fn refuses(&self, arguments: &[&str], status: i32, parts: &[&str]) {
        assert_refused(&self.run(arguments), status, parts);
    }

    /// Runs the program and asserts that it fails with a message of one line that has these parts.
    #[track_caller]
    pub fn refuses_in_one_line(&self, arguments: &[&str], parts: &[&str]) {
        assert_refused_in_one_line(&self.run(arguments), 1, parts);
    }

    pub fn has(&self, name: &str) -> bool {
        self.path(name).exists()
    }

    /// Writes a file, and its folder if there is none.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
        fs::write(self.path(name), content).unwrap();
    }

    /// Writes a shell script that can be run.
    #[cfg(unix)]
    pub fn write_script(&self, name: &str, lines: &str) {
        self.write(name, format!("#!/bin/sh\n{lines}"));
        fs::set_permissions(self.path(name), std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    }

    /// Makes a named pipe.
    #[cfg(unix)]
    pub fn make_pipe(&self, name: &str) {
        assert!(std::process::Command::new("mkfifo").arg(self.path(name)).status().unwrap().success());
    }

    #[track_caller]
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    #[track_caller]
    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.bytes(name)).unwrap()
    }

    #[track_caller]
    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.bytes(name)).unwrap()
    }

    /// Returns the report of a results folder.
    #[track_caller]
    pub fn report(&self, out: &str) -> Value {
        self.json(&format!("{out}/report.json"))
    }
}

/// Has the program run on Vulkan, or on the CPU device without validation, unless `PARFOCAL_DEVICE` names a device.
pub fn choose_device(process: &mut std::process::Command, is_vulkan: bool) {
    if std::env::var_os("PARFOCAL_DEVICE").is_some() {
        return;
    }
    process.env("PARFOCAL_DEVICE", if is_vulkan { "vulkan" } else { "cpu" });
    if !is_vulkan {
        process.env_remove("PARFOCAL_VALIDATE");
    }
}

/// Returns the text that the program has printed to stderr, with slashes in paths.
pub fn stderr_of(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    if cfg!(windows) { text.replace('\\', "/") } else { text }
}

/// Returns the JSON that the program has printed to stdout.
#[track_caller]
pub fn printed(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", stderr_of(output)))
}

/// Asserts that the program has ended with this status and a message that has these parts.
#[track_caller]
pub fn assert_refused(output: &Output, status: i32, parts: &[&str]) {
    let stderr = stderr_of(output);
    assert_eq!(output.status.code(), Some(status), "{stderr}");
    assert!(parts.iter().all(|part| stderr.contains(part)), "{parts:?} in {stderr}");
}

/// Asserts that the program has failed, with any status, and a message that has these parts.
#[track_caller]
pub fn assert_fails(output: &Output, parts: &[&str]) {
    let stderr = stderr_of(output);
    assert!(!output.status.success() && parts.iter().all(|part| stderr.contains(part)), "{parts:?} in {stderr}");
}

#[track_caller]
pub fn assert_refused_in_one_line(output: &Output, status: i32, parts: &[&str]) {
    assert_refused(output, status, parts);
    assert_eq!(stderr_of(output).lines().count(), 1, "{}", stderr_of(output));
}

/// Runs a Python script, which prints JSON.
#[track_caller]
pub fn python(script: &str, arguments: &[&str]) -> Value {
    let python = std::env::var("PARFOCAL_PYTHON").unwrap_or("/usr/bin/python3".to_string());
    let output = std::process::Command::new(&python)
        .args(["-c", script])
        .args(arguments)
        .output()
        .unwrap_or_else(|e| panic!("{python}: {e}: run tools/setup --test, or set PARFOCAL_PYTHON"));
    assert!(output.status.success(), "{}: run tools/setup --test", stderr_of(&output));
    printed(&output)
}
