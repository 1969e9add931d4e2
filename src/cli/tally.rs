//! What came of each pair and sweep of a batch: a table for people, `batch.json` for programs.

use std::path::{Path, PathBuf};
use std::time::Duration;

use parfocal::regular;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::failure::{Failure, plain};

/// The file of the summary, beside the folders of the pairs.
pub(super) const SUMMARY: &str = "batch.json";

/// The report of a pair or a sweep, in its folder.
pub(super) const REPORT: &str = "report.json";

/// The most bytes of a report that are read, 16 MiB, as everywhere.
const MAX_REPORT: u64 = 16 << 20;

/// What a report says that belongs into a table.
#[derive(Debug, Default, Deserialize, Serialize)]
#[serde(default)]
pub(super) struct Found {
    /// Of a pair.
    #[serde(skip_serializing_if = "Option::is_none")]
    converged: Option<bool>,
    warnings: Vec<String>,
    /// Of a pair.
    #[serde(skip_serializing_if = "Value::is_null")]
    relative_blur: Value,
    /// Of a sweep.
    #[serde(skip_serializing_if = "Value::is_null")]
    focus: Value,
    valid_fraction: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mean_confidence: Option<f64>,
    #[serde(skip_serializing_if = "Value::is_null")]
    transform: Value,
    #[serde(skip_serializing)]
    timings_ms: Value,
    #[serde(skip_serializing)]
    total_ms: Option<f64>,
}

/// What became of it.
#[derive(Debug, Serialize)]
#[serde(tag = "status", rename_all = "snake_case")]
pub(super) enum Outcome {
    /// Solved and written.
    Solved(Found),
    /// Left out, for its results were there.
    Kept(Found),
    /// Not solved, and why not.
    Failed { error: String },
    /// The batch ended before.
    NotDone,
}

impl Outcome {
    /// Of a report just written.
    pub(super) fn solved(report: &impl Serialize) -> Self {
        let found = serde_json::to_value(report).ok().and_then(|value| serde_json::from_value(value).ok());
        Self::Solved(found.unwrap_or_default())
    }

    /// Of the results in a folder.
    pub(super) fn kept(out: &Path) -> Self {
        let found = Self::report(out).and_then(|value| serde_json::from_value(value).ok());
        Self::Kept(found.unwrap_or_default())
    }

    /// The report in a folder of results, if there is one that can be read.
    pub(super) fn report(out: &Path) -> Option<Value> {
        serde_json::from_slice(&regular::read(&out.join(REPORT), MAX_REPORT).ok()?).ok()
    }

    fn status(&self) -> &'static str {
        match self {
            Self::Solved(_) => "solved",
            Self::Kept(_) => "kept",
            Self::Failed { .. } => "failed",
            Self::NotDone => "not done",
        }
    }

    fn found(&self) -> Option<&Found> {
        match self {
            Self::Solved(found) | Self::Kept(found) => Some(found),
            Self::Failed { .. } | Self::NotDone => None,
        }
    }
}

/// A pair or a sweep of the batch.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    name: String,
    #[serde(flatten)]
    files: Files,
    output: String,
    #[serde(flatten)]
    outcome: Outcome,
}

/// The photographs of a row.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Files {
    Pair { i1: String, i2: String },
    Sweep { frames: Vec<String> },
}

impl Row {
    pub(super) fn new(name: &str, files: &[PathBuf], output: &Path, outcome: Outcome) -> Self {
        let shown = |path: &PathBuf| path.display().to_string();
        let files = match files {
            [i1, i2] => Files::Pair { i1: shown(i1), i2: shown(i2) },
            frames => Files::Sweep { frames: frames.iter().map(shown).collect() },
        };
        Self { name: name.to_string(), files, output: output.display().to_string(), outcome }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn outcome(&self) -> &Outcome {
        &self.outcome
    }

    /// The row as one line.
    pub(super) fn line(&self) -> String {
        match &self.outcome {
            Outcome::Failed { error } => format!("{}: failed: {error}", plain(&self.name)),
            _ => format!("{}: {}", plain(&self.name), self.cells()[1..].join("  ").trim_end()),
        }
    }

    fn cells(&self) -> [String; 6] {
        let found = self.outcome.found();
        let number = |value: Option<f64>, digits: usize, unit: &str| {
            value.map_or_else(String::new, |v| format!("{v:.digits$}{unit}"))
        };
        let converged = found.map_or("", |f| match f.converged {
            None => "sweep",
            Some(true) => "converged",
            Some(false) => "not converged",
        });
        let of_sweep = found.and_then(|f| f.focus["median"].as_f64());
        [
            plain(&self.name),
            self.outcome.status().to_string(),
            converged.to_string(),
            match of_sweep {
                Some(_) => number(of_sweep, 2, " focus"),
                None => number(found.and_then(|f| f.relative_blur["median"].as_f64()), 2, " px²"),
            },
            number(found.and_then(|f| f.valid_fraction).map(|f| 100.0 * f), 1, " %"),
            number(found.and_then(|f| f.timings_ms["total"].as_f64().or(f.total_ms)), 0, " ms"),
        ]
    }
}

/// What came of all pairs.
#[derive(Debug, Serialize)]
pub(super) struct Tally {
    version: &'static str,
    source: String,
    solved: usize,
    kept: usize,
    failed: usize,
    not_done: usize,
    interrupted: bool,
    seconds: f64,
    pairs: Vec<Row>,
}

impl Tally {
    pub(super) fn new(source: &Path, pairs: Vec<Row>, interrupted: bool, took: Duration) -> Self {
        let count = |status: &str| pairs.iter().filter(|row| row.outcome.status() == status).count();
        Self {
            version: env!("CARGO_PKG_VERSION"),
            source: source.display().to_string(),
            solved: count("solved"),
            kept: count("kept"),
            failed: count("failed"),
            not_done: count("not done"),
            // A Ctrl-C after the last pair stopped nothing.
            interrupted: interrupted && count("not done") > 0,
            seconds: took.as_secs_f64(),
            pairs,
        }
    }

    /// The text of batch.json, without a newline at its end.
    pub(super) fn to_json(&self) -> Result<String, Failure> {
        serde_json::to_string_pretty(self).map_err(|e| Failure::Failed(e.to_string()))
    }

    /// The table, the warnings, the failures and a line that sums up, without a newline at the end.
    pub(super) fn table(&self, out: &Path) -> String {
        let head = ["name", "", "", "median", "valid", "time"].map(String::from);
        let rows: Vec<[String; 6]> = std::iter::once(head).chain(self.pairs.iter().map(Row::cells)).collect();
        let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..6).map(width).collect();
        let mut lines: Vec<String> = rows
            .iter()
            .map(|row| {
                let cell = |(i, text): (usize, &String)| {
                    // Text to the left, numbers to the right.
                    if i < 3 { format!("{text:<w$}", w = widths[i]) } else { format!("{text:>w$}", w = widths[i]) }
                };
                row.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ").trim_end().to_string()
            })
            .collect();
        for row in &self.pairs {
            let warnings = row.outcome.found().map_or(&[][..], |found| &found.warnings);
            lines.extend(warnings.iter().map(|warning| format!("warning: {}: {}", plain(&row.name), plain(warning))));
            if let Outcome::Failed { error } = &row.outcome {
                lines.push(format!("failed: {}: {error}", plain(&row.name)));
            }
        }
        let file = out.join(SUMMARY);
        lines.push(format!(
            "{} solved, {} kept, {} failed, {} not done in {:.1} s; {}",
            self.solved,
            self.kept,
            self.failed,
            self.not_done,
            self.seconds,
            plain(&file.display().to_string())
        ));
        lines.join("\n")
    }

    /// Fails if the batch did, in whole or in part.
    pub(super) fn check(&self, strict: bool) -> Result<(), Failure> {
        let all = self.pairs.len();
        let doubtful =
            |row: &&Row| row.outcome.found().is_some_and(|f| f.converged == Some(false) || !f.warnings.is_empty());
        let doubts = self.pairs.iter().filter(doubtful).count();
        if self.interrupted {
            let done = all - self.not_done;
            return Err(Failure::Interrupted(format!("interrupted after {done} of {all} pairs; --resume goes on")));
        }
        if self.failed > 0 {
            let names: Vec<&str> =
                self.pairs.iter().filter(|r| matches!(r.outcome, Outcome::Failed { .. })).map(Row::name).collect();
            return Err(Failure::Failed(format!("{} of {all} pairs failed: {}", self.failed, names.join(", "))));
        }
        if strict && doubts > 0 {
            return Err(Failure::Failed(format!(
                "--strict: {doubts} of {all} pairs did not converge or have warnings"
            )));
        }
        Ok(())
    }
}
