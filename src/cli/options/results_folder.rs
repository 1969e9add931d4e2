//! What every subcommand that goes on from a finished solve is told.

use std::path::PathBuf;

use serde::Serialize;

use crate::cli::options::output_options::ToldArguments;
use crate::cli::output::destination::ForceArgument;
use crate::cli::output::failure::Failure;

/// The results of a solve, and where to say what came of them.
#[derive(clap::Args, Debug)]
pub(crate) struct SolvedArguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    pub(crate) results: PathBuf,
    #[command(flatten)]
    told: ToldArguments,
    #[command(flatten)]
    pub(crate) force: ForceArgument,
}

impl SolvedArguments {
    /// Tells a person the summary, and a program the result, where each is wanted.
    pub(crate) fn tell(&self, summary: &str, result: &impl Serialize) -> Result<(), Failure> {
        self.told.tell(summary, || serde_json::to_string_pretty(result))
    }
}
