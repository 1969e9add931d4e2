//! What is told of what was done: to a person on stderr, to a program on stdout.

use std::io::{self, Write};

use crate::cli::options::headings::OUTPUT;
use crate::cli::output::failure::{Failure, plain, print};

/// Whom to tell.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub(crate) struct ToldArguments {
    /// Print the result as JSON on stdout too
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
    #[command(flatten)]
    quiet: QuietArgument,
}

/// Whether a person is told anything.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub(crate) struct QuietArgument {
    /// Print nothing on stderr but errors
    #[arg(short, long, help_heading = OUTPUT)]
    quiet: bool,
}

impl ToldArguments {
    /// Tells a person the summary, and a program the result, where each is wanted.
    pub(crate) fn tell(&self, summary: &str, json: impl FnOnce() -> serde_json::Result<String>) -> Result<(), Failure> {
        self.say(summary);
        self.json(json)
    }

    /// Tells a person a line.
    pub(crate) fn say(&self, line: &str) {
        self.quiet.say(line);
    }

    /// Tells a program the result.
    pub(crate) fn json(&self, json: impl FnOnce() -> serde_json::Result<String>) -> Result<(), Failure> {
        if self.json { print(&json().map_err(|e| Failure::Failed(e.to_string()))?) } else { Ok(()) }
    }

    /// Whether a person is told nothing.
    pub(crate) fn is_quiet(&self) -> bool {
        self.quiet.quiet
    }
}

impl QuietArgument {
    /// Tells a person a line, or some.
    pub(crate) fn say(&self, line: &str) {
        if !self.quiet {
            // Nobody is left to be told where stderr is closed.
            let text: Vec<String> = line.lines().map(plain).collect();
            let _ = writeln!(io::stderr(), "{}", text.join("\n"));
        }
    }
}
