//! What every subcommand that goes on from a finished solve is told.

use std::path::PathBuf;

use serde::Serialize;

use super::failure::Failure;
use super::output::ForceArgument;
use super::output_options::ToldArguments;

/// The results of a solve, and where to say what came of them.
#[derive(clap::Args, Debug)]
pub(super) struct SolvedArguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    pub(super) results: PathBuf,
    #[command(flatten)]
    told: ToldArguments,
    #[command(flatten)]
    pub(super) force: ForceArgument,
}

impl SolvedArguments {
    /// Tells a person the summary, and a program the result, where each is wanted.
    pub(super) fn tell(&self, summary: &str, result: &impl Serialize) -> Result<(), Failure> {
        self.told.tell(summary, || serde_json::to_string_pretty(result))
    }
}
