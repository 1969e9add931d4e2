//! How a subcommand that solves runs, and what is told of it.

use parfocal::Engine;

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

    /// Fails, with `--strict`, if there is anything to warn of.
    pub(super) fn check_strict(&self, converged: bool, warnings: &[String]) -> Result<(), Failure> {
        if !self.strict || (converged && warnings.is_empty()) {
            return Ok(());
        }
        let what = if converged { "has warnings" } else { "did not converge" };
        Err(Failure::Failed(format!("--strict: the solve {what}: {}", warnings.join("; "))))
    }
}
