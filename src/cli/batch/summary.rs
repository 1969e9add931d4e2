//! The summary of a batch: a table on stderr, `batch.json`, and the index page.

use std::path::{Path, PathBuf};
use std::time::Duration;

use parfocal::export::{Destination, FileKind, Hash, Hashes, Header, Kind, PAGE_FILE, to_json, write_named};
use parfocal::internals::bounded_read;
use parfocal::metric::inspect::Verdict;
use parfocal::page::batch_html::{Entry, batch_page};
use serde::Serialize;
use serde_json::{Value, json};

use crate::cli::batch::outcome::Outcome;
use crate::cli::inspection::verdict::{self, PartVerdict, VerdictCounts};
use crate::cli::options::photographs::in_short;
use crate::cli::options::run::RunArguments;
use crate::cli::options::solve::Request;
use crate::cli::output::failure::{Failure, plain};

/// Name of the summary file, in the folder of the results.
pub(crate) const SUMMARY: &str = "batch.json";

/// Name of the index page, in the folder of the results.
pub(crate) const INDEX: &str = "index.html";

/// Beginning of the names of the tables of verdicts, in the folder of the results.
const VERDICTS: &str = "verdicts";

/// Names of the tables of verdicts beside a summary file: CSV and JUnit.
pub(crate) fn verdict_files(summary: &str) -> [String; 2] {
    let share = summary.trim_start_matches("batch").trim_end_matches(".json");
    ["csv", "xml"].map(|extension| format!("{VERDICTS}{share}.{extension}"))
}

/// Name of the summary file of one share of `count`.
pub(crate) fn of_share(index: usize, count: usize) -> String {
    format!("batch-{index}-of-{count}.json")
}

/// Whether a batch writes a file of this name beside the folders of results.
pub(crate) fn is_of_batch(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let of_share = |first: &str, last: &str| {
        let share = name.strip_prefix(first).and_then(|rest| rest.strip_suffix(last)?.strip_prefix('-'));
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        share.and_then(|share| share.split_once("-of-")).is_some_and(|(i, n)| is_number(i) && is_number(n))
    };
    let shares = [("batch", ".json"), (VERDICTS, ".csv"), (VERDICTS, ".xml")];
    let [csv, xml] = verdict_files(SUMMARY);
    [SUMMARY, INDEX, &csv, &xml].contains(&name.as_str()) || shares.iter().any(|(first, last)| of_share(first, last))
}

/// Greatest size of a picture of depth, 1 GiB.
const MAX_PICTURE: u64 = 1 << 30;

/// A row of the summary: a pair or a sweep.
#[derive(Debug, Serialize)]
pub(crate) struct Row {
    pub(crate) name: String,
    #[serde(flatten)]
    files: Files,
    /// The folder of results.
    pub(crate) output: String,
    #[serde(flatten)]
    pub(crate) outcome: Outcome,
    /// The verdict, with golden parts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) inspection: Option<PartVerdict>,
}

/// The photographs of a row.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Files {
    Pair { i1: String, i2: String },
    Sweep { frames: Vec<String> },
}

impl Row {
    pub(crate) fn new(name: &str, files: &[PathBuf], output: &Path, outcome: Outcome) -> Self {
        let shown = |path: &PathBuf| path.display().to_string();
        let files = match files {
            [i1, i2] => Files::Pair { i1: shown(i1), i2: shown(i2) },
            frames => Files::Sweep { frames: frames.iter().map(shown).collect() },
        };
        Self { name: name.to_string(), files, output: output.display().to_string(), outcome, inspection: None }
    }

    /// The rank on the index page: first failures, then any verdict but go, then solves that did not converge, then
    /// warnings, then fewer valid pixels.
    fn badness(&self) -> f64 {
        let is_go = self.inspection.as_ref().is_none_or(|part| part.verdict == Verdict::Go);
        self.solve_rank() + if is_go { 0.0 } else { 500.0 }
    }

    fn solve_rank(&self) -> f64 {
        let Some(found) = self.outcome.excerpt() else { return 1000.0 };
        let unsettled = if found.converged == Some(false) { 100.0 } else { 0.0 };
        let doubt = unsettled + found.warnings.len() as f64;
        if doubt > 0.0 { doubt + 1.0 - found.valid_fraction.unwrap_or(0.0) } else { 0.0 }
    }

    fn entry(&self, out: &Path) -> Entry {
        let cells = self.cells();
        let own = Path::new(&self.output);
        let is_there = self.outcome.excerpt().is_some();
        let picture = is_there.then(|| on_white(&own.join("depth.png"))).flatten();
        let page = own.strip_prefix(out).ok().filter(|_| is_there && own.join(PAGE_FILE).is_file());
        let error = if let Outcome::Failed { error } = &self.outcome { Some(error.clone()) } else { None };
        let warnings = self.outcome.excerpt().map(|found| found.warnings.clone()).unwrap_or_default();
        let reasons = self.inspection.iter().filter(|_| is_there).flat_map(|part| part.reasons.clone());
        let warnings: Vec<String> = reasons.chain(warnings).collect();
        Entry {
            name: self.name.clone(),
            status: [&cells[6], &cells[1], &cells[2]]
                .into_iter()
                .filter(|cell| !cell.is_empty())
                .cloned()
                .collect::<Vec<_>>()
                .join(", "),
            facts: ["median", "valid", "time"]
                .iter()
                .zip(&cells[3..6])
                .filter(|(_, cell)| !cell.is_empty())
                .map(|(name, cell)| format!("{name} {cell}"))
                .collect(),
            warnings: warnings.into_iter().chain(error).collect(),
            badness: self.badness(),
            page: page.map(|folder| link(&folder.join(PAGE_FILE))),
            picture,
        }
    }

    /// The row as one line of text.
    pub(crate) fn line(&self) -> String {
        match &self.outcome {
            Outcome::Failed { error } => format!("{}: failed: {error}", plain(&self.name)),
            _ => {
                let reason = self.inspection.iter().map(PartVerdict::reason).filter(|reason| !reason.is_empty());
                let cells = self.cells()[1..].iter().filter(|cell| !cell.is_empty()).cloned().collect::<Vec<_>>();
                let cells = cells.join("  ");
                let parts = [plain(&self.name), cells].into_iter().chain(reason);
                parts.collect::<Vec<_>>().join(": ")
            }
        }
    }

    fn cells(&self) -> [String; 7] {
        let found = self.outcome.excerpt();
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
            number(found.and_then(|f| f.timings_ms["total"].as_f64()), 0, " ms"),
            self.inspection.as_ref().map_or_else(String::new, |part| part.verdict.text().to_string()),
        ]
    }
}

/// The summary of all pairs.
#[derive(Debug, Serialize)]
pub(crate) struct BatchSummary {
    #[serde(flatten)]
    header: Header,
    version: &'static str,
    source: String,
    solved: usize,
    kept: usize,
    failed: usize,
    not_done: usize,
    interrupted: bool,
    seconds: f64,
    /// The number of each verdict, with golden parts.
    #[serde(skip_serializing_if = "Option::is_none")]
    verdicts: Option<VerdictCounts>,
    /// Size and hash of the tables of verdicts that belong to this summary, by name.
    #[serde(skip_serializing_if = "Hashes::is_empty")]
    hashes: Hashes,
    /// Photographs that belong to no pair or sweep, and the reasons, one line each.
    left_over: Vec<String>,
    pairs: Vec<Row>,
}

impl BatchSummary {
    pub(crate) fn new(source: &Path, pairs: Vec<Row>, left_over: Vec<String>, took: Duration) -> Self {
        let count = |status: &str| pairs.iter().filter(|row| row.outcome.status() == status).count();
        Self {
            header: Header::new(Kind::Batch),
            version: env!("CARGO_PKG_VERSION"),
            source: source.display().to_string(),
            solved: count("solved"),
            kept: count("kept"),
            failed: count("failed"),
            not_done: count("not done"),
            interrupted: false,
            seconds: took.as_secs_f64(),
            verdicts: None,
            hashes: Hashes::new(),
            left_over,
            pairs,
        }
    }

    /// Marks the batch as interrupted. Ctrl-C after the last pair has no effect.
    pub(crate) fn interrupt(&mut self) {
        self.interrupted = self.not_done > 0;
    }

    /// Adds the number of each verdict, for a batch with golden parts.
    pub(crate) fn with_verdicts(mut self) -> Self {
        self.verdicts = Some(VerdictCounts::of(self.judged()));
        self
    }

    fn judged(&self) -> impl Iterator<Item = &PartVerdict> + Clone {
        self.pairs.iter().filter_map(|row| row.inspection.as_ref())
    }

    /// The last line of a log.
    pub(crate) fn end(&self) -> Value {
        json!({
            "solved": self.solved, "kept": self.kept, "failed": self.failed, "not_done": self.not_done,
            "verdicts": self.verdicts, "left_over": self.left_over, "seconds": self.seconds,
        })
    }

    pub(crate) fn into_rows(self) -> Vec<Row> {
        self.pairs
    }

    /// Writes the tables of verdicts into the folder `out`, then the summary to a file, with the hashes of the tables,
    /// and the index page if it has a name.
    pub(crate) fn write(
        &mut self,
        request: &Request,
        out: &Path,
        file: &str,
        index: Option<&str>,
    ) -> Result<(), Failure> {
        let [table, cases] = verdict_files(file);
        let (csv, junit);
        let mut files: Vec<(&str, FileKind, &[u8])> = Vec::new();
        if self.verdicts.is_none() {
            // Those of an earlier run with golden parts hold no longer.
            for (name, kind) in [(&table, FileKind::VerdictTable), (&cases, FileKind::Junit)] {
                if Destination::from(out).check_named(kind, &[name]).is_ok() {
                    // A file that stays is no reason to fail.
                    let _ = std::fs::remove_file(out.join(name));
                }
            }
        } else {
            let rows = self.pairs.iter().filter_map(|row| Some((row.inspection.as_ref()?, row.output.as_str())));
            csv = verdict::csv(rows)?;
            junit = verdict::junit(&self.source, self.judged()).into_bytes();
            files.extend([(&*table, FileKind::VerdictTable, &*csv), (&*cases, FileKind::Junit, &*junit)]);
        }
        // Reading memory does not fail.
        let hashes = files.iter().filter_map(|(name, _, bytes)| Some((name.to_string(), Hash::of(*bytes).ok()?)));
        self.hashes = hashes.collect();
        let json = to_json(self).map_err(|e| Failure::Failed(e.to_string()))? + "\n";
        files.push((file, FileKind::Batch, json.as_bytes()));
        write_named(request.force.to(out), &files)?;
        if let Some(index) = index {
            write_named(request.force.to(out), &[(index, FileKind::BatchPage, self.page(out).as_bytes())])?;
        }
        Ok(())
    }

    /// The index page, with links relative to the folder `out`.
    fn page(&self, out: &Path) -> String {
        let entries = self.pairs.iter().map(|row| row.entry(out)).collect();
        let (solved, failed) = (self.solved + self.kept, self.failed + self.not_done);
        let doubtful = self.pairs.iter().filter(|row| row.badness() > 0.0 && row.outcome.excerpt().is_some()).count();
        let in_words = |count: usize| if count == 0 { "none".to_string() } else { count.to_string() };
        let left = if self.left_over.is_empty() {
            String::new()
        } else {
            format!("; left over: {}", in_short(&self.left_over, "; "))
        };
        let sentence = format!(
            "{solved} solved, {} of them with warnings or not converged; {} failed or not done{left}.",
            in_words(doubtful),
            in_words(failed)
        );
        batch_page(&self.source, &sentence, entries)
    }

    /// The table, the warnings, the failures, and a line with the counts and the file, without a newline at the end.
    pub(crate) fn table(&self, file: &Path) -> String {
        let head = ["name", "", "", "median", "valid", "time", if self.verdicts.is_some() { "verdict" } else { "" }];
        let head = head.map(String::from);
        let rows: Vec<[String; 7]> = std::iter::once(head).chain(self.pairs.iter().map(Row::cells)).collect();
        let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..7).map(width).collect();
        let mut lines: Vec<String> = rows
            .iter()
            .map(|row| {
                let cell = |(i, text): (usize, &String)| {
                    // Text is left-aligned, numbers are right-aligned.
                    if !(3..6).contains(&i) {
                        format!("{text:<w$}", w = widths[i])
                    } else {
                        format!("{text:>w$}", w = widths[i])
                    }
                };
                row.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ").trim_end().to_string()
            })
            .collect();
        for row in &self.pairs {
            let warnings = row.outcome.excerpt().map_or(&[][..], |found| &found.warnings);
            lines.extend(warnings.iter().map(|warning| format!("warning: {}: {}", plain(&row.name), plain(warning))));
            if let Some(part) = row.inspection.as_ref().filter(|part| !part.reasons.is_empty()) {
                let (name, verdict) = (plain(&row.name), part.verdict.text());
                lines.push(format!("{verdict}: {name}: {}", part.reason()));
            } else if let Outcome::Failed { error } = &row.outcome {
                lines.push(format!("failed: {}: {error}", plain(&row.name)));
            }
        }
        lines.extend(self.left_over.iter().map(|problem| format!("left over: {}", plain(problem))));
        lines.extend(self.verdicts.as_ref().map(VerdictCounts::line));
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

    /// Fails if a pair failed, or the batch was interrupted. With golden parts, the worst verdict is the status. A
    /// photograph that belongs to no part cannot be judged.
    pub(crate) fn check(&self, run: &RunArguments) -> Result<(), Failure> {
        let all = self.pairs.len();
        let doubtful =
            |row: &&Row| row.outcome.excerpt().is_some_and(|f| f.converged == Some(false) || !f.warnings.is_empty());
        let doubts = self.pairs.iter().filter(doubtful).count();
        if self.interrupted {
            let done = all - self.not_done;
            return Err(Failure::Interrupted(format!("interrupted after {done} of {all} pairs; --resume goes on")));
        }
        if let Some(verdicts) = &self.verdicts {
            verdicts.check()?;
            if !self.left_over.is_empty() {
                return Err(Failure::CannotJudge);
            }
        }
        if self.failed > 0 {
            let failed = self.pairs.iter().filter(|row| matches!(row.outcome, Outcome::Failed { .. }));
            let names: Vec<String> = failed.map(|row| plain(&row.name)).collect();
            return Err(Failure::Failed(format!("{} of {all} pairs failed: {}", self.failed, in_short(&names, ", "))));
        }
        if run.strict && !self.left_over.is_empty() {
            let problem = format!("--strict: photographs are left over: {}", in_short(&self.left_over, "; "));
            return Err(Failure::Failed(problem));
        }
        if run.strict && doubts > 0 {
            return Err(Failure::Failed(format!(
                "--strict: {doubts} of {all} pairs did not converge or have warnings"
            )));
        }
        Ok(())
    }
}

/// Reads a picture and fills its transparent pixels with white.
fn on_white(path: &Path) -> Option<image::RgbImage> {
    let picture = image::load_from_memory(&bounded_read::read(path, MAX_PICTURE).ok()?).ok()?.into_rgba8();
    let over =
        |color: u8, alpha: u8| ((u32::from(color) * u32::from(alpha) + 255 * (255 - u32::from(alpha))) / 255) as u8;
    Some(image::RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b, alpha] = picture.get_pixel(x, y).0;
        image::Rgb([r, g, b].map(|color| over(color, alpha)))
    }))
}

/// Escapes a path for a link.
fn link(path: &Path) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte);
    let escaped = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    path.to_string_lossy().bytes().map(escaped).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_card_of_a_failed_pair_has_no_empty_facts() {
        let failed = Outcome::Failed { error: "no picture".to_string() };
        let entry = Row::new("a", &[], Path::new("out/a"), failed).entry(Path::new("out"));
        assert!(entry.facts.is_empty() && entry.warnings == ["no picture"], "{entry:?}");
    }

    #[test]
    fn the_error_of_many_failed_pairs_names_the_first_ten() {
        let failed = |n| Row::new(&format!("p{n}"), &[], Path::new(""), Outcome::Failed { error: String::new() });
        let summary =
            |count| BatchSummary::new(Path::new(""), (1..=count).map(failed).collect(), Vec::new(), Duration::ZERO);
        let message = |count| summary(count).check(&RunArguments::default()).unwrap_err().message();
        assert_eq!(message(2), "2 of 2 pairs failed: p1, p2");
        assert_eq!(
            message(10_000),
            "10000 of 10000 pairs failed: p1, p2, p3, p4, p5, p6, p7, p8, p9, p10 and 9990 more"
        );
    }

    #[test]
    fn transparent_pixels_become_white_and_links_are_escaped() {
        let file = tempfile::NamedTempFile::with_suffix(".png").unwrap();
        let pixels = [[9, 8, 7, 255], [9, 8, 7, 0], [0, 0, 0, 51]];
        image::RgbaImage::from_fn(3, 1, |x, _| image::Rgba(pixels[x as usize])).save(file.path()).unwrap();
        assert_eq!(on_white(file.path()).unwrap().into_raw(), [9, 8, 7, 255, 255, 255, 204, 204, 204]);
        assert_eq!(on_white(Path::new("/nowhere")), None);
        assert_eq!(link(Path::new("a b/ü#1/report.html")), "a%20b/%C3%BC%231/report.html");
    }
}
