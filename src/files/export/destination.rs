//! Destinations of results: which existing files may be replaced.

use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use serde_json::Value;

use super::journal::{Unfinished, metadata};
use super::report::{Kind, PROGRAM, REPORT_FILE, is_plain, read_json, strings};
use crate::base::Error;
use crate::files::bounded_read::{self, not_a_path};

/// Names of the files of a synthetic pair. `depth.exr` exists only if the scene has a lens.
pub const SIMULATED_FILES: [&str; 5] = ["i1.png", "i2.png", "relative_blur.exr", "depth.exr", "truth.json"];

/// Names of the report and the picture of an inspected part.
pub const INSPECT_FILES: [&str; 2] = ["inspect.json", "inspect.png"];

/// Names of the report of repeated measurements, its page and its tables.
pub const REPEAT_FILES: [&str; 8] = [
    "repeat.json",
    "repeat.html",
    "repeat_readings.csv",
    "repeat_values.csv",
    "repeat_pairs.csv",
    "repeat_anova.csv",
    "repeat_components.csv",
    "repeat_categories.csv",
];

/// A folder or a file for results. By default, only existing files that parfocal wrote are replaced.
///
/// ```
/// use std::path::Path;
///
/// use parfocal::export::Destination;
///
/// let careful: Destination = Path::new("out").into();
/// let forced = Destination::new(Path::new("out"), true);
/// # let _ = (careful, forced);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Destination<'a> {
    pub(crate) path: &'a Path,
    pub(crate) force: bool,
}

impl<'a, P: AsRef<Path> + ?Sized> From<&'a P> for Destination<'a> {
    fn from(path: &'a P) -> Self {
        Self::new(path.as_ref(), false)
    }
}

impl<'a> Destination<'a> {
    /// Makes a destination. With `force`, files of other programs that have the names of results are overwritten.
    pub fn new(path: &'a Path, force: bool) -> Self {
        Self { path, force }
    }

    /// The folder or the file.
    pub fn path(&self) -> &'a Path {
        self.path
    }

    /// Makes a destination with the same rule and another path.
    pub(crate) fn to<'b>(&self, path: &'b Path) -> Destination<'b> {
        Destination { path, force: self.force }
    }

    /// Checks that results of these names may be written into the folder. No existing file may have one of the names,
    /// unless the earlier report of the name `report` lists it.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_results<S: AsRef<str>>(&self, report: &str, names: &[S]) -> Result<(), Error> {
        Guard::by_report(*self, report).check_all(self.path, names)
    }

    /// Checks the same for files of a kind, which no report lists.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_named<S: AsRef<str>>(&self, kind: FileKind, names: &[S]) -> Result<(), Error> {
        Guard::by_kind(*self, kind).check_all(self.path, names)
    }
}

/// Checks that a file or a folder can be created.
///
/// # Errors
/// [`Error::File`].
pub fn check_writable(out: &Path) -> Result<(), Error> {
    if let Some(problem) = not_a_path(out) {
        return Err(Error::file(out, problem));
    }
    // The folder, or the nearest existing folder above it, must accept a file.
    let above = out.ancestors().find(|p| p.is_dir()).filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::tempfile_in(above)
        .map(drop)
        .map_err(|e| Error::file(out, format!("cannot be written ({}); give another folder", e.kind())))
}

/// Decides which existing files may be replaced.
pub(crate) struct Guard {
    /// The files that an earlier report lists.
    pub(super) listed: ReportFiles,
    /// The kind of files that may be replaced without a report that lists them.
    kind: Option<FileKind>,
    force: bool,
}

impl Guard {
    /// Lets files that the report of this name lists be replaced.
    pub(crate) fn by_report(out: Destination<'_>, report: &str) -> Self {
        Self::by_list(out, ReportFiles::of(out.path, report))
    }

    /// Lets the listed files be replaced.
    pub(crate) fn by_list(out: Destination<'_>, listed: ReportFiles) -> Self {
        Self { listed, kind: None, force: out.force }
    }

    /// Lets files of a kind be replaced, unless a report lists them.
    pub(crate) fn by_kind(out: Destination<'_>, kind: FileKind) -> Self {
        Self { listed: ReportFiles::of_any_report(out.path), kind: Some(kind), force: out.force }
    }

    fn check_all<S: AsRef<str>>(&self, folder: &Path, names: &[S]) -> Result<(), Error> {
        names.iter().try_for_each(|name| self.check(&folder.join(name.as_ref())))
    }

    /// Refuses a path if its existing file must not be replaced.
    pub(crate) fn check(&self, path: &Path) -> Result<(), Error> {
        let found = match metadata(path) {
            Ok(Some(found)) => found,
            Ok(None) => return Ok(()),
            // Creating the folder reports this.
            Err(e) if e.kind() == ErrorKind::NotADirectory => return Ok(()),
            Err(e) => return Err(Error::file(path, format!("cannot be accessed ({e}); check the disk"))),
        };
        let refuse = |problem: &str| Err(Error::file(path, problem));
        if path.is_dir() {
            return refuse("is a folder where a result should go; move it away");
        }
        if found.is_symlink() {
            return refuse("is a symbolic link where a result should go; remove it, or give another folder");
        }
        if !found.is_file() {
            return refuse("is a device or a pipe where a result should go; move it away, or give another folder");
        }
        let is_listed = self.listed.contains(&path.file_name().unwrap_or_default().to_string_lossy());
        match self.kind {
            _ if self.force => Ok(()),
            Some(_) if is_listed => refuse(
                "belongs to the results beside it, by their report; give another name, or overwrite it with --force",
            ),
            Some(kind) if kind.is_of(path) => Ok(()),
            None if is_listed => Ok(()),
            Some(_) => refuse(
                "is there already, and is none that parfocal wrote; give another name, or overwrite it with --force",
            ),
            None => refuse(
                "is there already, and no report of parfocal in its folder lists it; give another folder, or overwrite it \
                 with --force",
            ),
        }
    }
}

/// Names of the files that a report in a folder lists, including the report. Names that lead out of the folder are
/// ignored, since anyone may have written the report.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ReportFiles(BTreeSet<String>);

impl ReportFiles {
    /// The files that the report of this name lists; none if it is missing or from another program.
    pub(crate) fn of(folder: &Path, report: &str) -> Self {
        let path = folder.join(report);
        let is_file = fs::symlink_metadata(&path).is_ok_and(|found| found.is_file());
        let found = is_file.then(|| read_json(&path).ok()).flatten();
        match found.filter(lists_files) {
            Some(found) => Self::named(strings(&found["files"]).chain([report])),
            None => Self::default(),
        }
    }

    /// The files that any report of results in the folder lists.
    pub(crate) fn of_any_report(folder: &Path) -> Self {
        let reports = [REPORT_FILE, SIMULATED_FILES[4], INSPECT_FILES[0], REPEAT_FILES[0]];
        Self(reports.into_iter().flat_map(|report| Self::of(folder, report).0).collect())
    }

    /// These names.
    pub(crate) fn named<'a>(names: impl Iterator<Item = &'a str>) -> Self {
        Self(names.filter(|name| is_plain(name)).map(String::from).collect())
    }

    pub(crate) fn contains(&self, name: &str) -> bool {
        self.0.contains(name)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }
}

/// Names of the files that the report in a folder lists. New results replace or remove these files.
pub fn listed_in(folder: &Path, report: &str) -> Vec<String> {
    ReportFiles::of(folder, report).0.into_iter().collect()
}

/// Whether a JSON file is a report of parfocal that lists the files next to it.
fn lists_files(report: &Value) -> bool {
    use Kind::{Evaluation, Inspection, Pair, Repeatability, Simulation, Sweep};
    let is_unfinished = report["program"] == PROGRAM && Unfinished::is(report);
    is_unfinished
        || matches!(Kind::of(report), Some(Pair | Sweep | Simulation | Inspection | Repeatability | Evaluation))
}

/// Greatest number of bytes of JSON that are read, 64 MiB: more than the longest bench writes.
const MAX_JSON: u64 = 64 << 20;
/// Number of bytes at the beginning of a file within which it states the program that wrote it.
const HEAD: u64 = 1 << 12;

/// Kind of a file that has no report next to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A registration.
    Registration,
    /// A calibrated lens.
    Lens,
    /// The report of a bench.
    Bench,
    /// The trace of a bench.
    Trace,
    /// The summary of a batch.
    Batch,
    /// The index page of a batch.
    BatchPage,
    /// The verdicts of a batch, CSV.
    VerdictTable,
    /// The verdicts of a batch, JUnit.
    Junit,
    /// A golden part, EXR.
    Golden,
    /// A page for man(1).
    Manual,
    /// A picture, PNG.
    Png,
    /// An image in floats, EXR.
    Exr,
    /// An animation, GIF.
    Gif,
}

impl FileKind {
    /// The kind that a JSON file of this kind states; `None` for kinds that are not JSON.
    pub(super) fn report(self) -> Option<Kind> {
        match self {
            Self::Registration => Some(Kind::Registration),
            Self::Lens => Some(Kind::Lens),
            Self::Bench => Some(Kind::Bench),
            Self::Batch => Some(Kind::Batch),
            _ => None,
        }
    }

    /// Whether parfocal wrote the file as one of this kind; false for a file that cannot be read.
    fn is_of(self, path: &Path) -> bool {
        match self {
            Self::Registration | Self::Lens | Self::Bench | Self::Batch => {
                json(path).is_some_and(|file| Kind::of(&file) == self.report())
            }
            Self::Trace => json(path).is_some_and(|trace| is_trace(&trace)),
            Self::VerdictTable => begins(path, b"serial,", b"serial,time,judged,verdict,"),
            Self::Junit => begins(path, b"<?xml ", b"<testsuite name=\"parfocal\""),
            Self::Golden => begins(path, b"\x76\x2f\x31\x01", b"{\"program\":\"parfocal\",\"kind\":\"golden\","),
            Self::Manual => begins(path, b"", b".TH parfocal"),
            Self::BatchPage => begins(path, b"<!doctype html>", b"content=\"parfocal batch\""),
            Self::Png => begins(path, b"\x89PNG\r\n\x1a\n", b"Software\0parfocal "),
            Self::Exr => begins(path, b"\x76\x2f\x31\x01", b"parfocal "),
            Self::Gif => begins(path, b"GIF89a", b"parfocal "),
        }
    }
}

/// Whether a trace is from parfocal: it begins with the host of a run. Other programs write this format too.
fn is_trace(trace: &Value) -> bool {
    let first = &trace["traceEvents"][0];
    first["name"] == "process_name" && first["args"]["name"].as_str().is_some_and(|name| name.ends_with(": host"))
}

fn json(path: &Path) -> Option<Value> {
    serde_json::from_slice(&read(path, MAX_JSON)?).ok()
}

/// Whether a file begins with `magic` and has `words` within its [`HEAD`].
fn begins(path: &Path, magic: &[u8], words: &[u8]) -> bool {
    read(path, HEAD).is_some_and(|head| head.starts_with(magic) && head.windows(words.len()).any(|w| w == words))
}

fn read(path: &Path, most: u64) -> Option<Vec<u8>> {
    bounded_read::read_start(&bounded_read::open(path).ok()?, most).ok()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn listed(report: &Value) -> ReportFiles {
        let folder = tempfile::TempDir::new().unwrap();
        fs::write(folder.path().join("report.json"), report.to_string()).unwrap();
        ReportFiles::of(folder.path(), "report.json")
    }

    #[test]
    fn names_that_lead_out_of_the_folder_are_ignored() {
        let names = ["", ".", "..", "../a", "/etc/passwd", "a/b", "a\\b", "./a", "a/", "\0", "depth.png"];
        let found = listed(&json!({ "program": "parfocal", "kind": "pair", "files": names }));
        assert_eq!(found.iter().collect::<Vec<_>>(), ["depth.png", "report.json"]);
        assert!(!found.contains("fused.png"), "it is not listed");
    }

    #[test]
    fn the_report_of_another_program_lists_nothing() {
        for report in [
            json!({ "version": "1.0", "files": ["depth.png"] }),
            json!({ "program": "parfocal", "kind": "lens", "files": ["depth.png"] }),
            json!({ "program": "other", "kind": "pair", "files": ["depth.png"] }),
            json!(["depth.png"]),
            json!(3),
        ] {
            assert_eq!(listed(&report), ReportFiles::default(), "{report}");
        }
        let folder = tempfile::TempDir::new().unwrap();
        assert_eq!(ReportFiles::of(folder.path(), "report.json"), ReportFiles::default());
    }

    #[test]
    fn only_a_file_that_states_its_kind_is_of_parfocal() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("file");
        assert!(!FileKind::Lens.is_of(&file), "it is missing");
        for (kind, text, ours) in [
            (FileKind::Lens, r#"{"program": "parfocal", "kind": "lens"}"#, true),
            (FileKind::Bench, r#"{"program": "parfocal", "kind": "lens"}"#, false),
            (FileKind::Lens, r#"{"focal_length_mm": 25}"#, false),
            (FileKind::Batch, "no JSON", false),
            (FileKind::Trace, r#"{"traceEvents": [{"name": "process_name", "args": {"name": "1x1: host"}}]}"#, true),
            (FileKind::Trace, r#"{"traceEvents": [{"name": "process_name", "args": {"name": "browser"}}]}"#, false),
            (FileKind::Gif, "GIF89a......!.parfocal 0.1.0", true),
            (FileKind::Gif, "parfocal 0.1.0", false),
        ] {
            fs::write(&file, text).unwrap();
            assert_eq!(kind.is_of(&file), ours, "{kind:?} {text}");
        }
    }
}
