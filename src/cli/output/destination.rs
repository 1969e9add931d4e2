//! Checks, before other work, that results can be written.

use std::fs;
use std::path::{Path, PathBuf};

use parfocal::export::{self, Destination, FileKind};
use parfocal::image_io::split_page;

use crate::cli::help::OUTPUT;
use crate::cli::output::failure::Failure;

/// The option of every subcommand that writes files.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub(crate) struct ForceArgument {
    /// Overwrite files that have the names of results even if parfocal did not write them
    #[arg(long, help_heading = OUTPUT)]
    force: bool,
}

impl ForceArgument {
    /// The folder or file for results.
    pub(crate) fn to<'a>(&self, path: &'a Path) -> Destination<'a> {
        Destination::new(path, self.force)
    }
}

/// Refuses an output folder that cannot be written.
pub(crate) fn check_folder(out: &Path) -> Result<(), Failure> {
    if out == Path::new("-") {
        let problem = "-: results are files in a folder; give a folder, and print the report with --json";
        return Err(Failure::Usage(problem.to_string()));
    }
    if out.exists() && !out.is_dir() {
        let folder = out.with_extension("");
        let hint = if folder.exists() { String::new() } else { format!(", '{}' say", folder.display()) };
        return Err(Failure::file(out, format!("is a file; give a folder for the results{hint}")));
    }
    Ok(export::check_writable(out)?)
}

/// Refuses an output folder where one of `results` would replace one of `inputs`.
pub(crate) fn check_inputs(out: &Path, results: &[&str], inputs: &[&PathBuf]) -> Result<(), Failure> {
    for input in inputs {
        if let Some(name) = results.iter().find(|name| same_file(&out.join(name), input)) {
            let problem = format!("is an input, and the result {name} would replace it; give another folder");
            return Err(Failure::file(input, problem));
        }
    }
    Ok(())
}

/// Refuses an output folder that cannot be written, or where a result would replace one of `inputs`. The results are
/// `possible` and the files that an earlier report of this name lists.
pub(crate) fn check(out: &Path, report: &str, possible: &[&str], inputs: &[&PathBuf]) -> Result<(), Failure> {
    check_folder(out)?;
    let listed = export::listed_in(out, report);
    let results: Vec<&str> = possible.iter().copied().chain(listed.iter().map(String::as_str)).collect();
    check_inputs(out, &results, inputs)
}

/// Refuses a file that cannot be written, that is one of `inputs`, or that must not be replaced. `what` describes the
/// file in messages.
pub(crate) fn check_file(
    file: Destination<'_>,
    kind: FileKind,
    what: &str,
    inputs: &[&PathBuf],
) -> Result<(), Failure> {
    let failed = |problem: String| Err(Failure::file(file.path(), problem));
    if file.path() == Path::new("-") {
        let stream = if cfg!(unix) { "; /dev/stdout is one" } else { "" };
        return Err(Failure::Usage(format!("-: give a file{what}{stream}")));
    }
    if file.path().is_dir() {
        return failed(format!("is a folder; give a file{what}"));
    }
    if inputs.iter().any(|input| same_file(file.path(), input)) {
        return failed("is an input; give another file".to_string());
    }
    Ok(file.check_file(kind)?)
}

/// Whether two paths refer to the same existing file.
pub(crate) fn same_file(a: &Path, b: &Path) -> bool {
    let [(a, _), (b, _)] = [a, b].map(split_page);
    matches!((fs::canonicalize(a), fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
}
