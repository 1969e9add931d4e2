//! `parfocal open`: the page of results in a browser.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use parfocal::export::PAGE_FILE;

use crate::cli::batch::summary::{INDEX, SUMMARY};
use crate::cli::output::failure::{Failure, print};

/// Open the page of results in a browser: report.html, or the index of a batch.
#[derive(clap::Args, Debug)]
#[command(after_help = "Exit status: 0 done, 1 failed, 2 wrong usage.")]
pub(crate) struct Arguments {
    /// Folder that `parfocal solve -o`, `stack -o` or `batch -o` wrote
    results: PathBuf,
    /// Print the path of the page, and do not open it
    #[arg(long)]
    print: bool,
}

/// The program that opens a file in the user's preferred application.
const OPENER: &str = if cfg!(target_os = "macos") {
    "open"
} else if cfg!(windows) {
    "explorer"
} else {
    "xdg-open"
};

/// Longest wait for an error of this program, in tenths of a second.
const MAX_WAIT: u32 = 50;

/// Finds and opens the page.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let results = &arguments.results;
    let failed = |problem: &str| Failure::Failed(format!("{}: {problem}", results.display()));
    if !results.is_dir() {
        return Err(failed("is no folder; give the one that parfocal solve, stack or batch wrote"));
    }
    let names = if results.join(SUMMARY).is_file() { [INDEX, PAGE_FILE] } else { [PAGE_FILE, INDEX] };
    let page = names.map(|name| results.join(name)).into_iter().find(|page| page.is_file());
    let page = page.ok_or_else(|| {
        failed("has no page: it is of a run with --no-html, or holds no results; run it again without")
    })?;
    if arguments.print {
        return print(&page.display().to_string());
    }
    let failed = |problem: String| Failure::Failed(format!("{OPENER} {problem}; open {} in a browser", page.display()));
    let null = Stdio::null;
    let started = Command::new(OPENER).arg(&page).stdin(null()).stdout(null()).stderr(null()).spawn();
    let mut opener = started.map_err(|e| failed(format!("cannot be run ({e})")))?;
    // If the program is the browser itself, it keeps running, and the page is open.
    for _ in 0..MAX_WAIT {
        match opener.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => return Err(failed(format!("opened nothing ({status})"))),
            Ok(None) => thread::sleep(Duration::from_millis(100)),
            Err(e) => return Err(failed(format!("cannot be waited for ({e})"))),
        }
    }
    Ok(())
}
