//! The options of output: reports, progress, strictness, colours; and the results that a command reads.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;

use parfocal::export::Palette;
use parfocal::{Engine, settings::DeviceInfo};
use serde::Serialize;

use crate::cli::help::OUTPUT;
use crate::cli::options::device::EngineArguments;
use crate::cli::output::destination::ForceArgument;
use crate::cli::output::failure::{Failure, plain, print};
use crate::cli::output::progress::{Bar, ProgressMode};

/// The options of printed reports.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub(crate) struct ReportArguments {
    /// Print the report as JSON on stdout
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
    #[command(flatten)]
    quiet: QuietArgument,
}

/// The option `--quiet`.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub(crate) struct QuietArgument {
    /// Print only errors on stderr
    #[arg(short, long, help_heading = OUTPUT)]
    quiet: bool,
}

impl ReportArguments {
    /// Prints the summary on stderr, and with `--json` the report on stdout.
    pub(crate) fn print(
        &self,
        summary: &str,
        json: impl FnOnce() -> serde_json::Result<String>,
    ) -> Result<(), Failure> {
        self.print_line(summary);
        self.print_json(json)
    }

    /// Prints a line on stderr.
    pub(crate) fn print_line(&self, line: &str) {
        self.quiet.print_line(line);
    }

    /// Prints the report on stdout, with `--json`.
    pub(crate) fn print_json(&self, json: impl FnOnce() -> serde_json::Result<String>) -> Result<(), Failure> {
        if self.json { print(&json().map_err(|e| Failure::Failed(e.to_string()))?) } else { Ok(()) }
    }

    /// Whether `--quiet` was given.
    pub(crate) fn is_quiet(&self) -> bool {
        self.quiet.quiet
    }
}

impl QuietArgument {
    /// Prints lines on stderr.
    pub(crate) fn print_line(&self, line: &str) {
        if !self.quiet {
            // If stderr is closed, there is no reader.
            let text: Vec<String> = line.lines().map(plain).collect();
            let _ = writeln!(io::stderr(), "{}", text.join("\n"));
        }
    }
}

/// The options of a run. They do not change the results.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct RunArguments {
    #[command(flatten)]
    pub(crate) report: ReportArguments,
    /// Exit with status 1 if the solve does not converge or has warnings; the results are written
    #[arg(long, help_heading = OUTPUT)]
    pub(crate) strict: bool,
    /// Progress on stderr
    #[arg(long, value_name = "HOW", help_heading = OUTPUT, value_enum, default_value_t)]
    progress: ProgressMode,
    #[command(flatten)]
    pub(crate) engine: EngineArguments,
}

impl RunArguments {
    /// A progress bar.
    pub(crate) fn bar(&self) -> Arc<Bar> {
        Arc::new(Bar::new(self.progress, self.report.is_quiet()))
    }

    /// Whether progress is printed as JSON.
    pub(crate) fn is_json(&self) -> bool {
        self.progress == ProgressMode::Json
    }

    /// Opens the device.
    pub(crate) fn open_engine(&self) -> Result<Engine, Failure> {
        self.engine.open()
    }

    /// Opens the device into `opened`. Returns its description.
    pub(crate) fn info(&self, opened: &mut Option<Engine>) -> Result<DeviceInfo, Failure> {
        let engine = opened.insert(self.open_engine()?);
        Ok(engine.info().clone())
    }

    /// Returns the opened device, or opens it.
    pub(crate) fn engine(&self, opened: Option<Engine>) -> Result<Engine, Failure> {
        opened.map_or_else(|| self.open_engine(), Ok)
    }

    /// Fails with `--strict` if the solve did not converge or has warnings.
    pub(crate) fn check_strict(&self, converged: bool, warnings: &[String]) -> Result<(), Failure> {
        if !self.strict || (converged && warnings.is_empty()) {
            return Ok(());
        }
        let what = if converged { "has warnings" } else { "did not converge" };
        Err(Failure::Failed(format!("--strict: the solve {what}: {}", warnings.join("; "))))
    }
}

/// The options of a command that reads the results of a solve.
#[derive(clap::Args, Debug)]
pub(crate) struct ResultsArguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    pub(crate) results: PathBuf,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    pub(crate) force: ForceArgument,
}

impl ResultsArguments {
    /// Prints the summary on stderr, and with `--json` the report on stdout.
    pub(crate) fn report(&self, summary: &str, result: &impl Serialize) -> Result<(), Failure> {
        self.report.print(summary, || serde_json::to_string_pretty(result))
    }
}

/// The option `--colors`.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct ColorsArgument {
    /// Colours of near and far
    #[arg(long, value_name = "NAME", help_heading = OUTPUT, value_enum, default_value_t)]
    colors: Palette,
}

impl ColorsArgument {
    pub(crate) fn palette(self) -> Palette {
        self.colors
    }
}
