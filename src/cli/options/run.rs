//! The options of a run: device, reports, progress, strictness, colours; and the results that a command reads.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use parfocal::export::{Palette, to_json};
use parfocal::{Engine, EngineOptions, Error, internals::key_points, settings::DeviceInfo};
use serde::Serialize;

use crate::cli::help::{DEVICE, OUTPUT};
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
    pub(crate) fn print(&self, summary: &str, report: &impl Serialize) -> Result<(), Failure> {
        self.print_line(summary);
        self.print_json(report)
    }

    /// Prints a line on stderr.
    pub(crate) fn print_line(&self, line: &str) {
        self.quiet.print_line(line);
    }

    /// Prints the report on stdout, with `--json`.
    pub(crate) fn print_json(&self, report: &impl Serialize) -> Result<(), Failure> {
        if self.json { print(&to_json(report).map_err(|e| Failure::Failed(e.to_string()))?) } else { Ok(()) }
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
    /// A progress bar for a solve. Writing its results is expected to take `writing` seconds; 0 if none are written.
    pub(crate) fn bar(&self, writing: f64) -> Arc<Bar> {
        let mode = match self.progress {
            ProgressMode::Auto if self.report.is_quiet() => ProgressMode::None,
            mode => mode,
        };
        Arc::new(Bar::new(mode, writing))
    }

    /// Whether progress is printed as JSON.
    pub(crate) fn is_json(&self) -> bool {
        self.progress == ProgressMode::Json
    }

    /// Opens the device into `opened`. Returns its description.
    pub(crate) fn info(&self, opened: &mut Option<Engine>) -> Result<DeviceInfo, Failure> {
        let engine = opened.insert(self.engine.open()?);
        Ok(engine.info().clone())
    }

    /// Returns the opened device, or opens it.
    pub(crate) fn engine(&self, opened: Option<Engine>) -> Result<Engine, Failure> {
        opened.map_or_else(|| self.engine.open(), Ok)
    }

    /// Fails with `--strict` if the solve did not converge or has warnings. `converged` is `None` for a sweep.
    pub(crate) fn check_strict(&self, converged: Option<bool>, warnings: &[String]) -> Result<(), Failure> {
        let failed = converged == Some(false);
        if !self.strict || (!failed && warnings.is_empty()) {
            return Ok(());
        }
        let what = if failed { "did not converge" } else { "has warnings" };
        Err(Failure::Failed(format!("--strict: the solve {what}: {}", warnings.join("; "))))
    }
}

/// Parses options that a command would have.
#[cfg(test)]
pub(crate) fn parsed<A: clap::Args>(flags: &[&str]) -> A {
    let command = A::augment_args(clap::Command::new("test").no_binary_name(true));
    A::from_arg_matches(&command.try_get_matches_from(flags).unwrap()).unwrap()
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
        self.report.print(summary, result)
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

/// The environment variable with the default of --device.
const DEFAULT: &str = "PARFOCAL_DEVICE";

/// The environment variable that enables the Vulkan validation layer.
const VALIDATE: &str = "PARFOCAL_VALIDATE";

/// The value of --device for all devices.
const ALL: &str = "all";

/// The device and its limits.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct EngineArguments {
    /// Index, part of the name, UUID, cpu or vulkan [default: PARFOCAL_DEVICE, else a GPU, else cpu]
    ///
    /// cpu is the processor, vulkan the most capable Vulkan device, software drivers included. batch and watch also
    /// take all: each pair goes to the next free GPU.
    #[arg(long, value_name = "D", help_heading = DEVICE)]
    device: Option<String>,
    /// Longest time of one solve on the device, s
    #[arg(long, value_name = "SECONDS", help_heading = DEVICE, default_value_t = EngineOptions::default().timeout.as_secs(),
          value_parser = clap::value_parser!(u64).range(1..))]
    timeout: u64,
    /// Device memory for a pair or a sweep, MiB (64 to 16777216); larger ones are solved in parts [default: all; sweeps
    /// 4096]
    #[arg(long, value_name = "MIB", help_heading = DEVICE, value_parser = clap::value_parser!(u64).range(64..=1 << 24))]
    memory: Option<u64>,
    /// Measure each pass, for the times in the report; slows the solve down
    #[arg(long, help_heading = DEVICE)]
    timings: bool,
}

impl EngineArguments {
    /// Opens the device.
    pub(crate) fn open(&self) -> Result<Engine, Failure> {
        let options = self.options();
        if is_all(&options) {
            return Err(Failure::Usage("--device all is for batch and watch: give one device".to_string()));
        }
        Engine::new(&options).map_err(|error| match error {
            Error::NoSuchDevice { .. } if self.device.is_none() => Failure::Failed(format!("{DEFAULT}: {error}")),
            other => other.into(),
        })
    }

    /// The options of each requested device.
    pub(crate) fn each(&self) -> Result<Vec<Self>, Failure> {
        if !is_all(&self.options()) {
            return Ok(vec![self.clone()]);
        }
        let devices = Engine::devices()?;
        let found = DeviceInfo::usable(&devices, is_validation_requested());
        // If there is no device, opening it returns the reason.
        let named = |index: usize| Self { device: Some(index.to_string()), ..self.clone() };
        Ok(if found.is_empty() { vec![named(0)] } else { found.iter().map(|device| named(device.index)).collect() })
    }

    /// The options of the library.
    pub(crate) fn options(&self) -> EngineOptions {
        EngineOptions {
            device: self.device.clone().or_else(|| std::env::var(DEFAULT).ok().filter(|device| !device.is_empty())),
            validation: is_validation_requested(),
            timeout: Duration::from_secs(self.timeout),
            memory: self.memory.map(|mib| mib << 20),
            key_points: Some(key_points),
            timed: self.timings,
        }
    }
}

fn is_all(options: &EngineOptions) -> bool {
    options.device.as_deref() == Some(ALL)
}

/// Whether the environment requests the validation layer.
pub(crate) fn is_validation_requested() -> bool {
    std::env::var_os(VALIDATE).is_some_and(|value| !value.is_empty() && value != "0")
}

/// Fails if the validation layer has reported a message.
pub(crate) fn check_validation(engine: &Engine) -> Result<(), Failure> {
    match engine.validation_messages().as_slice() {
        [] => Ok(()),
        messages => Err(Failure::Failed(format!("validation reported: {}", messages.join("; ")))),
    }
}
