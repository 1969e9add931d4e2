//! The program without a command: its first steps, and photographs that are dropped onto it.

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::cli::commands::view;
use crate::cli::options::photographs::{is_photograph, list_folder, one_series};
use crate::cli::options::series::stem;
use crate::cli::output::failure::Failure;

/// What the program prints without arguments.
const FIRST_STEPS: &str = "\
Depth from photographs of one scene that are focused at different distances. Three things to begin with:

  two photographs            parfocal solve near.png far.png -o out
  three or more of a sweep   parfocal stack FOLDER -o out
  many pairs                 parfocal batch FOLDER -o out

`parfocal open out` shows the results in a browser.

Without a command, photographs or their folder are solved and shown: parfocal near.png far.png
On Windows, drop them onto the program. The results are in a new folder beside them, whose name ends in -depth.

`parfocal --help` lists all commands, `parfocal solve --help` the options of one.
";

/// Prints the first steps, as a wrong usage.
pub(super) fn first_steps() -> ExitCode {
    // If stderr is closed, there is no reader.
    let _ = io::stderr().write_all(FIRST_STEPS.as_bytes());
    // cmd.exe sets PROMPT for its programs: without it, the window closes with the program.
    if std::env::var_os("PROMPT").is_none() {
        wait_for_enter();
    }
    ExitCode::from(2)
}

/// On Windows, keeps the window of the program open until it is read.
fn wait_for_enter() {
    if cfg!(windows) && io::stdin().is_terminal() && io::stderr().is_terminal() {
        let _ = io::stderr().write_all(b"Press Enter to close.\n");
        let _ = io::stdin().read_line(&mut String::new());
    }
}

/// Photographs, or a folder of them, without a command.
pub(super) struct Dropped {
    command: &'static str,
    inputs: Vec<PathBuf>,
    /// The folder for the results.
    out: PathBuf,
}

impl Dropped {
    /// `None` unless the arguments are one folder, or all are photographs.
    pub(super) fn of(arguments: &[OsString]) -> Option<Self> {
        let mut inputs: Vec<PathBuf> = arguments.iter().map(PathBuf::from).collect();
        if cfg!(windows) {
            // Explorer begins with the photograph that was dragged, wherever it is among the others.
            inputs.sort();
        }
        let named = |file: &Path| file.with_file_name(format!("{}-depth", stem(file)));
        let (command, inputs, out) = match &inputs[..] {
            [folder] if folder.is_dir() => {
                let out = named(&std::path::absolute(folder).ok()?);
                match list_folder(folder, None).ok()?.0 {
                    pair if pair.len() == 2 => ("solve", pair, out),
                    sweep if sweep.len() == 1 || one_series(&sweep).is_some() => ("stack", inputs, out),
                    _ => ("batch", inputs, out),
                }
            }
            [first, ..] if inputs.iter().all(|file| is_photograph(file) && file.is_file()) => {
                let out = named(first);
                (if inputs.len() == 2 { "solve" } else { "stack" }, inputs, out)
            }
            _ => return None,
        };
        Some(Self { command, inputs, out })
    }

    /// The command and its arguments.
    pub(super) fn arguments(&self) -> Vec<OsString> {
        let options = ["-o".into(), self.out.clone().into_os_string()];
        [self.command.into()].into_iter().chain(self.inputs.iter().map(Into::into)).chain(options).collect()
    }

    /// Opens the page of the results, and returns the exit status of the program.
    pub(super) fn show(self, done: Result<(), Failure>) -> ExitCode {
        let page = view::PageArguments { results: self.out, print: false };
        match done.and_then(|()| view::open(&page)) {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => {
                let status = failure.report();
                wait_for_enter();
                status
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn photographs_and_folders_choose_their_command() {
        let base = tempfile::TempDir::new().unwrap();
        let at = |name: &str| base.path().join(name);
        for (folder, count) in [("pair", 2), ("sweep", 3), ("parts", 0)] {
            fs::create_dir(at(folder)).unwrap();
            (0..count).for_each(|n| fs::write(at(folder).join(format!("i_{n}.JPG")), "").unwrap());
        }
        fs::write(at("list.csv"), "").unwrap();
        let of = |names: &[&str]| {
            let found = Dropped::of(&names.iter().map(|name| at(name).into()).collect::<Vec<_>>())?;
            let out = found.out.strip_prefix(base.path()).unwrap().to_string_lossy().replace('\\', "/");
            Some((found.command, found.inputs.len(), out))
        };
        let [a, b, c] = ["sweep/i_0.JPG", "sweep/i_1.JPG", "sweep/i_2.JPG"];
        assert_eq!(of(&[a, b]), Some(("solve", 2, "sweep/i_0-depth".to_string())));
        let first = if cfg!(windows) { 0 } else { 2 };
        assert_eq!(of(&[c, a, b]), Some(("stack", 3, format!("sweep/i_{first}-depth"))));
        assert_eq!(of(&["pair"]), Some(("solve", 2, "pair-depth".to_string())));
        assert_eq!(of(&["parts"]), Some(("batch", 1, "parts-depth".to_string())));
        assert_eq!(of(&["sweep"]), Some(("stack", 1, "sweep-depth".to_string())));
        for other in [&[a, "sweep/i_9.JPG"][..], &["pair", "sweep"], &["list.csv"], &["pair", a], &[]] {
            assert_eq!(of(other), None);
        }
    }
}
