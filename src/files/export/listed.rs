//! Which files in a folder of results are ours: those that the report there lists.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Component, Path};

use serde_json::{Value, json};

use super::metric::DEPTH_FILE;
use super::results::{MAX_BYTES, read_report};
use super::{EXTRA_FILES, FILES, FUSED_FLOAT_FILE, INSPECT_FILES, PAGE_FILE, SWEEP_FILES};
use crate::files::bounded_read;

/// The files of a synthetic pair; `depth.exr` only where the scene has a lens.
pub const SIMULATED_FILES: [&str; 5] = ["i1.png", "i2.png", "relative_blur.exr", "depth.exr", "truth.json"];

/// Set in the list that stands in the place of a report while results get their names.
const UNFINISHED: &str = "unfinished";

/// The list that stands in the place of a report while results get their names.
#[derive(Default)]
pub(super) struct Unfinished {
    /// All files, of earlier and of new results.
    pub(super) files: Vec<String>,
    /// Those that were not there before.
    pub(super) new: Vec<String>,
}

impl Unfinished {
    /// Its text, which says of itself what it is.
    pub(super) fn text(&self) -> String {
        let Self { files, new } = self;
        let list = json!({ "version": env!("CARGO_PKG_VERSION"), UNFINISHED: true, "files": files, "new": new });
        format!("{list:#}\n")
    }

    /// The one that stands in the place of this report, if one does. What cannot be read may be one.
    pub(super) fn of(report: &Path) -> io::Result<Option<Self>> {
        let text = match bounded_read::text(report, MAX_BYTES) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
            text => text?,
        };
        let Ok(found) = serde_json::from_str::<Value>(&text) else { return Ok(None) };
        let names = |key: &str| strings(&found[key]).filter(|name| is_plain(name)).map(String::from).collect();
        Ok(found.get(UNFINISHED).map(|_| Self { files: names("files"), new: names("new") }))
    }
}

/// The files of a folder that a report there lists. A report is a file like any other, which anyone may have written: names
/// that lead out of the folder are not taken from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Listed {
    /// What it names.
    files: BTreeSet<String>,
    /// What may belong to a report from before they named their files: replaced, never removed.
    implied: Vec<&'static str>,
}

impl Listed {
    /// By the report of this name; nothing where there is none, or one of another program.
    pub(crate) fn of(folder: &Path, report: &str) -> Self {
        let path = folder.join(report);
        let is_file = fs::symlink_metadata(&path).is_ok_and(|found| found.is_file());
        let Some(found) = is_file.then(|| read_report(&path).ok()).flatten() else { return Self::default() };
        let Some(implied) = implied(&found) else { return Self::default() };
        let mut files: BTreeSet<String> = stated(&found).filter(|name| is_plain(name)).map(String::from).collect();
        let names_none = strings(&found["files"]).next().is_none();
        files.insert(report.to_string());
        Self { files, implied: if names_none { implied } else { Vec::new() } }
    }

    /// By any report that a folder of results may hold.
    pub(crate) fn of_any_report(folder: &Path) -> Self {
        let all = [FILES[4], SIMULATED_FILES[4], INSPECT_FILES[0]].map(|report| Self::of(folder, report));
        Self {
            files: all.iter().flat_map(|listed| listed.files.iter().cloned()).collect(),
            implied: all.iter().flat_map(|listed| listed.implied.iter().copied()).collect(),
        }
    }

    /// Whether a file of this name may be replaced.
    pub(crate) fn holds(&self, name: &str) -> bool {
        self.files.contains(name) || self.implied.contains(&name)
    }

    /// The names that may be removed too.
    pub(crate) fn files(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(String::as_str)
    }
}

/// The names of files that the report in a folder lists, which results that take their place replace or remove.
pub fn listed_in(folder: &Path, report: &str) -> Vec<String> {
    Listed::of(folder, report).files.into_iter().collect()
}

/// What a report of ours may have beside it where it names no files; nothing for a report that is not ours.
fn implied(report: &Value) -> Option<Vec<&'static str>> {
    let has = |keys: &[&str]| keys.iter().all(|key| report.get(key).is_some());
    if has(&[UNFINISHED, "files"]) {
        Some(Vec::new())
    } else if has(&["frames", "blur_rate_px2"]) {
        Some([&SWEEP_FILES[..], &[DEPTH_FILE, PAGE_FILE, FUSED_FLOAT_FILE]].concat())
    } else if has(&["transform", "nearer"]) {
        Some([&FILES[..], &EXTRA_FILES, &[DEPTH_FILE]].concat())
    } else if has(&["scene", "seed", "clipped_samples"]) {
        Some(SIMULATED_FILES.to_vec())
    } else if has(&["verdict", "tolerance", "regions"]) {
        Some(Vec::new())
    } else if has(&["paper", "defaults", "sweeps"]) {
        Some(Vec::new())
    } else {
        None
    }
}

/// Every file that a report names, under `files` or where it says what is in it.
fn stated(report: &Value) -> impl Iterator<Item = &str> {
    let profiles = report["measurements"]["profiles"].as_array().into_iter().flatten();
    let of_profiles = profiles.flat_map(|profile| [&profile["csv"], &profile["png"]]).filter_map(Value::as_str);
    // In a truth the file itself, in a report what is known of it.
    let depth = report["depth"].as_str().or(report["depth"].is_object().then_some(DEPTH_FILE));
    strings(&report["files"]).chain(of_profiles).chain(depth)
}

fn strings(value: &Value) -> impl Iterator<Item = &str> {
    value.as_array().into_iter().flatten().filter_map(Value::as_str)
}

/// Whether a name is that of a file in the folder itself.
fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let only = (parts.next(), parts.next());
    matches!(only, (Some(Component::Normal(part)), None) if part == name) && !name.contains(['/', '\\', '\0'])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(report: &Value) -> Listed {
        let folder = tempfile::TempDir::new().unwrap();
        fs::write(folder.path().join("report.json"), report.to_string()).unwrap();
        Listed::of(folder.path(), "report.json")
    }

    #[test]
    fn names_that_lead_elsewhere_are_not_taken() {
        let names = ["", ".", "..", "../a", "/etc/passwd", "a/b", "a\\b", "./a", "a/", "\0", "depth.png"];
        let found = listed(&json!({ "transform": {}, "nearer": 1, "files": names }));
        assert_eq!(found.files().collect::<Vec<_>>(), ["depth.png", "report.json"]);
        assert!(!found.holds("fused.png"), "it is not listed");
    }

    #[test]
    fn earlier_reports_named_less() {
        let mut report = json!({ "transform": {}, "nearer": 1, "depth": {} });
        report["measurements"] = json!({ "profiles": [{ "csv": "profile_1.csv", "png": "../profile_1.png" }] });
        let found = listed(&report);
        assert_eq!(found.files().collect::<Vec<_>>(), ["depth_mm.exr", "profile_1.csv", "report.json"]);
        assert!(found.holds("fused.png") && !found.holds("focus.exr"));
        assert!(listed(&json!({ "frames": [], "blur_rate_px2": 1 })).holds("focus.exr"));
    }

    #[test]
    fn the_report_of_another_program_lists_nothing() {
        for report in [json!({ "version": "1.0", "files": ["depth.png"] }), json!(["depth.png"]), json!(3)] {
            assert_eq!(listed(&report), Listed::default(), "{report}");
        }
        let folder = tempfile::TempDir::new().unwrap();
        assert_eq!(Listed::of(folder.path(), "report.json"), Listed::default());
    }
}
