//! The outcome of a pair or a sweep, and what its report says.

use std::io::ErrorKind;
use std::path::Path;

use parfocal::export::REPORT_FILE;
use parfocal::internals::bounded_read;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::cli::output::failure::Failure;

/// Greatest size of a report, 16 MiB.
const MAX_REPORT: u64 = 16 << 20;

/// The fields of a report that the summary states.
#[derive(Debug, Default, Deserialize, Serialize)]
#[serde(default)]
pub(crate) struct ReportExcerpt {
    /// For a pair.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) converged: Option<bool>,
    pub(super) warnings: Vec<String>,
    /// For a pair.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub(super) relative_blur: Value,
    /// For a sweep.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub(super) focus: Value,
    pub(super) valid_fraction: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mean_confidence: Option<f64>,
    #[serde(skip_serializing_if = "Value::is_null")]
    pub(super) transform: Value,
    #[serde(skip_serializing)]
    frames: Vec<Value>,
    #[serde(skip_serializing)]
    pub(super) timings_ms: Value,
}

impl ReportExcerpt {
    /// Reads the excerpt from a report.
    fn of(report: Value) -> serde_json::Result<Self> {
        let mut found: Self = serde_json::from_value(report)?;
        if let [_, second] = found.frames.as_mut_slice() {
            found.transform = second["transform"].take();
        }
        Ok(found)
    }
}

fn not_a_report(out: &Path, error: &serde_json::Error) -> Failure {
    Failure::file(out.join(REPORT_FILE), format!("is not a report of parfocal ({error}); remove it"))
}

/// The outcome of a pair or a sweep.
#[derive(Debug, Serialize)]
#[serde(tag = "status", rename_all = "snake_case")]
pub(crate) enum Outcome {
    /// Solved and written.
    Solved(ReportExcerpt),
    /// Not solved: complete results exist.
    Kept(ReportExcerpt),
    /// Failed, with the message.
    Failed { error: String },
    /// Not started: the batch was interrupted before.
    NotDone,
}

impl Outcome {
    /// The outcome for a report that was just written.
    pub(crate) fn solved(report: &impl Serialize) -> Result<Self, Failure> {
        let found = serde_json::to_value(report).and_then(ReportExcerpt::of);
        found.map(Self::Solved).map_err(|e| Failure::Failed(format!("the report cannot be summarized ({e})")))
    }

    /// The outcome for existing results.
    pub(crate) fn kept(out: &Path) -> Result<Self, Failure> {
        let found = Self::report(out)?.map(ReportExcerpt::of).transpose();
        match found.map_err(|e| not_a_report(out, &e))? {
            Some(found) => Ok(Self::Kept(found)),
            None => Err(Failure::file(out.join(REPORT_FILE), "is gone")),
        }
    }

    /// Reads the report in a folder of results; `None` if there is none.
    pub(crate) fn report(out: &Path) -> Result<Option<Value>, Failure> {
        let file = out.join(REPORT_FILE);
        match bounded_read::read(&file, MAX_REPORT) {
            Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|e| not_a_report(out, &e)),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(e) => Err(Failure::file(file, format!("cannot be read ({e}); check its permissions"))),
        }
    }

    pub(crate) fn status(&self) -> &'static str {
        match self {
            Self::Solved(_) => "solved",
            Self::Kept(_) => "kept",
            Self::Failed { .. } => "failed",
            Self::NotDone => "not done",
        }
    }

    pub(super) fn excerpt(&self) -> Option<&ReportExcerpt> {
        match self {
            Self::Solved(found) | Self::Kept(found) => Some(found),
            Self::Failed { .. } | Self::NotDone => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_an_unreadable_report_names_it() {
        let folder = tempfile::TempDir::new().unwrap();
        assert_eq!(Outcome::report(folder.path()), Ok(None));
        let file = folder.path().join(REPORT_FILE);
        for text in ["{\"warnings\": 7}", "not JSON", ""] {
            std::fs::write(&file, text).unwrap();
            let problem = Outcome::kept(folder.path()).unwrap_err().message();
            assert!(problem.starts_with(&format!("{}: is not a report", file.display())), "{problem}");
        }
        std::fs::remove_file(&file).unwrap();
        std::fs::create_dir(&file).unwrap();
        assert!(Outcome::report(folder.path()).unwrap_err().message().contains("report.json: cannot be read"));
    }
}
