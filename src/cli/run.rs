//! How a subcommand that solves runs, and what is told of it.

use parfocal::{DeviceInfo, Engine};

use super::engine::EngineArguments;
use super::failure::Failure;
use super::headings::OUTPUT;
use super::told::ToldArguments;

/// None of it decides the results.
#[derive(clap::Args, Clone, Debug, Default)]
pub(super) struct RunArguments {
    #[command(flatten)]
    pub(super) told: ToldArguments,
    /// Exit status 1 if it does not converge or has warnings; the results are written all the same
    #[arg(long, help_heading = OUTPUT)]
    pub(super) strict: bool,
    #[command(flatten)]
    engine: EngineArguments,
}

impl RunArguments {
    /// Opens the device.
    pub(super) fn open_engine(&self) -> Result<Engine, Failure> {
        self.engine.open()
    }

    /// Opens the device, to be kept, and describes it.
    pub(super) fn info(&self, kept: &mut Option<Engine>) -> Result<DeviceInfo, Failure> {
        let engine = kept.insert(self.open_engine()?);
        Ok(engine.info().clone())
    }

    /// Opens the device, unless it was kept.
    pub(super) fn engine(&self, kept: Option<Engine>) -> Result<Engine, Failure> {
        kept.map_or_else(|| self.open_engine(), Ok)
    }

    /// Fails, with `--strict`, if there is anything to warn of.
    pub(super) fn check_strict(&self, converged: bool, warnings: &[String]) -> Result<(), Failure> {
        if !self.strict || (converged && warnings.is_empty()) {
            return Ok(());
        }
        let what = if converged { "has warnings" } else { "did not converge" };
        Err(Failure::Failed(format!("--strict: the solve {what}: {}", warnings.join("; "))))
    }
}
