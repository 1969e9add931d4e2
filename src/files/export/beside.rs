//! What joins the results in a folder later: its report is written anew, with what came and what went.

use std::io::Write;
use std::path::Path;

use serde_json::{Value, json};

use super::extra::showing_depth;
use super::hashes::HASHES;
use super::measurements::{Measurements, Wanted, is_profile};
use super::staging::Staging;
use super::{Destination, Extra, FILES, PAGE_FILE, Pen, listed_in};
use crate::base::Error;

/// The report of pair and sweep.
const REPORT: &str = FILES[4];

/// Refuses, before they are made, results that may not join those in the folder.
pub(super) fn check(folder: &Path, names: &[&str], force: bool) -> Result<(), Error> {
    Destination::new(folder, force).check_results(REPORT, &[names, &[REPORT]].concat())
}

/// Refuses, before it is made, what [`write_measurements`] would not write.
pub(super) fn check_measurements(folder: &Path, wanted: &Wanted, force: bool) -> Result<(), Error> {
    let names = wanted.files();
    check(folder, &names.iter().map(String::as_str).collect::<Vec<_>>(), force)
}

/// Files that join those of the folder, where the `stale` go.
pub(super) fn staging(folder: &Path, force: bool, stale: &[String]) -> Result<Staging, Error> {
    Staging::beside(Destination::new(folder, force), REPORT, stale.to_vec())
}

/// What shows depth and goes when depth is told anew without it.
pub(super) fn stale(shown: &[Extra<'_>]) -> Vec<String> {
    let is_shown = |name: &&str| shown.iter().any(|extra| extra.name == *name);
    showing_depth().filter(|name| !is_shown(name)).map(String::from).collect()
}

/// Says anew what a report says; one of an earlier version may not.
pub(super) fn restate(report: &mut Value, key: &str, word: &str) {
    if let Some(said) = report.get_mut(key) {
        *said = word.into();
    }
}

/// A report with measurements: steps take the place of earlier steps, profiles of earlier profiles; where this has none, the earlier
/// ones stay.
pub(super) fn with_measurements(mut report: Value, measured: &Measurements) -> Value {
    if !report.get("measurements").is_some_and(Value::is_object) {
        report["measurements"] = json!(Measurements::default());
    }
    let known = &mut report["measurements"];
    if !measured.steps.is_empty() {
        known["steps"] = json!(measured.steps);
    }
    if !measured.profiles.is_empty() {
        known["profiles"] = json!(measured.profiles);
    }
    report
}

/// Adds measurements to a folder, whose report has them already, and what shows them besides.
pub(super) fn write_measurements(
    folder: &Path,
    report: Value,
    measured: &Measurements,
    (pen, shown): (Option<Pen>, Vec<Extra<'_>>),
    force: bool,
) -> Result<(), Error> {
    let earlier = listed_in(folder, REPORT).into_iter().filter(|file| is_profile(file));
    let new: Vec<&str> = measured.profiles.iter().flat_map(|p| [p.csv.as_str(), &p.png]).collect();
    let mut stale: Vec<String> = earlier.filter(|file| !new.is_empty() && !new.contains(&file.as_str())).collect();
    if !shown.iter().any(|extra| extra.name == PAGE_FILE) {
        stale.push(PAGE_FILE.to_string());
    }
    let mut staging = staging(folder, force, &stale)?;
    measured.stage(&mut staging, pen)?;
    for extra in shown {
        staging.add(extra.name, |w| (extra.fill)(w))?;
    }
    finish(staging, report, &stale)
}

/// `report.json` anew, and all gets its name.
pub(super) fn finish(mut staging: Staging, mut report: Value, stale: &[String]) -> Result<(), Error> {
    // A report that names no files is of an earlier version, and of a folder whose files are known otherwise.
    if let Some(files) = report.get_mut("files").and_then(Value::as_array_mut).filter(|files| !files.is_empty()) {
        files.retain(|file| !stale.iter().any(|name| file == name));
        let came: Vec<Value> =
            staging.names().into_iter().map(Value::from).filter(|name| !files.contains(name)).collect();
        files.extend(came);
    }
    // Of files from before there were hashes nothing is vouched for.
    if let Some(hashes) = report.get_mut(HASHES).and_then(Value::as_object_mut) {
        hashes.retain(|file, _| !stale.contains(file));
        hashes.extend(staging.hashes().into_iter().map(|(file, hash)| (file, json!(hash))));
    }
    staging.add(REPORT, |w| writeln!(w, "{report:#}").map_err(|e| e.to_string()))?;
    staging.place()
}
