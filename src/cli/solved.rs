//! What every subcommand that goes on from a finished solve is told.

use std::io::{self, Write};
use std::path::PathBuf;

use serde::Serialize;

use super::failure::{Failure, print};
use super::output::ForceArgument;

/// The results of a solve, and where to say what came of them.
#[derive(clap::Args, Debug)]
pub(super) struct SolvedArguments {
    /// Folder that `parfocal solve -o` wrote
    pub(super) results: PathBuf,
    /// Print the result as JSON on stdout
    #[arg(long)]
    json: bool,
    /// Print nothing on stderr but errors
    #[arg(long)]
    quiet: bool,
    #[command(flatten)]
    pub(super) force: ForceArgument,
}

impl SolvedArguments {
    /// Tells a person the summary, and a program the result, where each is wanted.
    pub(super) fn tell(&self, summary: &str, result: &impl Serialize) -> Result<(), Failure> {
        if !self.quiet {
            // Nobody is left to be told where stderr is closed.
            let _ = writeln!(io::stderr(), "{summary}");
        }
        if self.json {
            print(&serde_json::to_string_pretty(result).map_err(|e| Failure::Failed(e.to_string()))?)?;
        }
        Ok(())
    }
}
