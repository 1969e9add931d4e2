//! How a subcommand that solves runs, and what is told of it.

use std::sync::Arc;

use parfocal::{Engine, settings::DeviceInfo};

use crate::cli::options::engine::EngineArguments;
use crate::cli::options::headings::OUTPUT;
use crate::cli::options::output_options::ToldArguments;
use crate::cli::output::failure::Failure;
use crate::cli::output::progress::{Bar, ProgressName};

/// None of it decides the results.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct RunArguments {
    #[command(flatten)]
    pub(crate) told: ToldArguments,
    /// Exit status 1 if it does not converge or has warnings; the results are written all the same
    #[arg(long, help_heading = OUTPUT)]
    pub(crate) strict: bool,
    /// How far it has come, told on stderr
    #[arg(long, value_name = "HOW", help_heading = OUTPUT, value_enum, default_value_t)]
    progress: ProgressName,
    #[command(flatten)]
    pub(crate) engine: EngineArguments,
}

impl RunArguments {
    /// What tells how far it has come.
    pub(crate) fn bar(&self) -> Arc<Bar> {
        Arc::new(Bar::new(self.progress, self.told.is_quiet()))
    }

    /// Whether programs are told.
    pub(crate) fn tells_programs(&self) -> bool {
        self.progress == ProgressName::Json
    }

    /// Opens the device.
    pub(crate) fn open_engine(&self) -> Result<Engine, Failure> {
        self.engine.open()
    }

    /// Opens the device, to be kept, and describes it.
    pub(crate) fn info(&self, kept: &mut Option<Engine>) -> Result<DeviceInfo, Failure> {
        let engine = kept.insert(self.open_engine()?);
        Ok(engine.info().clone())
    }

    /// Opens the device, unless it was kept.
    pub(crate) fn engine(&self, kept: Option<Engine>) -> Result<Engine, Failure> {
        kept.map_or_else(|| self.open_engine(), Ok)
    }

    /// Fails, with `--strict`, if there is anything to warn of.
    pub(crate) fn check_strict(&self, converged: bool, warnings: &[String]) -> Result<(), Failure> {
        if !self.strict || (converged && warnings.is_empty()) {
            return Ok(());
        }
        let what = if converged { "has warnings" } else { "did not converge" };
        Err(Failure::Failed(format!("--strict: the solve {what}: {}", warnings.join("; "))))
    }
}
