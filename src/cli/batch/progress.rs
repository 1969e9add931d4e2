//! Progress of a batch: a bar on a terminal, lines elsewhere, JSON for programs.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicUsize, Ordering};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use crate::cli::batch::summary::{Outcome, Row};
use crate::cli::options::output::RunArguments;
use crate::cli::output::failure::plain;

/// Progress of a batch: a bar on a terminal, elsewhere a line for each pair.
pub(crate) struct BatchProgress {
    bar: ProgressBar,
    lines: bool,
    /// Whether to print a line of JSON for each pair.
    json: bool,
    /// Number of pairs; 0 if unknown.
    pairs: usize,
    done: AtomicUsize,
}

impl BatchProgress {
    /// Makes the progress of an unknown number of pairs: a line for each.
    pub(crate) fn endless(run: &RunArguments) -> Self {
        let (quiet, json) = (run.report.is_quiet(), run.is_json());
        Self { bar: ProgressBar::hidden(), lines: !quiet && !json, json, pairs: 0, done: AtomicUsize::new(0) }
    }

    /// Makes the progress of a number of pairs.
    pub(crate) fn new(pairs: usize, run: &RunArguments) -> Self {
        let (quiet, json) = (run.report.is_quiet() || run.is_json(), run.is_json());
        let terminal = io::stderr().is_terminal();
        let bar = if terminal && !quiet { ProgressBar::new(pairs as u64) } else { ProgressBar::hidden() };
        let template = "{pos}/{len} {bar:24} {elapsed}, {rate}, {eta} left  {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.with_key(
                "rate",
                |state: &indicatif::ProgressState, text: &mut dyn std::fmt::Write| {
                    let _ = match state.per_sec() {
                        rate if rate > 0.0 => write!(text, "{:.1} s a pair", 1.0 / rate),
                        _ => write!(text, "- s a pair"),
                    };
                },
            ));
        }
        bar.tick();
        Self { bar, lines: !terminal && !quiet, json, pairs, done: AtomicUsize::new(0) }
    }

    /// Counts and displays the outcome of a pair.
    pub(crate) fn show(&self, row: &Row) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if matches!(row.outcome(), Outcome::Kept(_)) {
            // Kept results take no time, so they must not change the estimate.
            self.bar.dec_length(1);
        } else {
            self.bar.inc(1);
        }
        self.bar.set_message(plain(row.name()));
        if self.json {
            let mut line = json!({ "name": row.name(), "status": row.outcome().status() });
            if self.pairs > 0 {
                (line["done"], line["of"]) = (done.into(), self.pairs.into());
            }
            let _ = writeln!(io::stderr(), "{line}");
            return;
        }
        let line = match self.pairs {
            0 => row.line(),
            pairs => format!("{done}/{pairs} {}", row.line()),
        };
        if self.lines {
            let _ = writeln!(io::stderr(), "{line}");
        } else if matches!(row.outcome(), Outcome::Failed { .. }) {
            self.bar.println(line);
        }
    }
}

impl Drop for BatchProgress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
