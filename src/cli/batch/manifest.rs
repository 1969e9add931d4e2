//! Manifests of a batch: lists of pairs and sweeps in CSV or JSON lines.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use parfocal::image_io::RawFormat;
use parfocal::internals::bounded_read;
use serde::Deserialize;

use crate::cli::options::photographs::{self, PageArguments, SweepFiles};
use crate::cli::options::series::{file_name, stem};
use crate::cli::output::failure::Failure;

/// Greatest size of a manifest, 64 MiB.
const MAX_BYTES: u64 = 64 << 20;

/// A line of a manifest.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    #[serde(default)]
    i1: Option<PathBuf>,
    #[serde(default)]
    i2: Option<PathBuf>,
    #[serde(default)]
    sweep: Option<Sweep>,
    #[serde(default)]
    pub(super) name: Option<String>,
}

/// The frames of a sweep in order, or their folder.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Sweep {
    Folder(PathBuf),
    Frames(Vec<PathBuf>),
}

impl Line {
    /// The files, and the default name. `folder` is the folder of the manifest.
    pub(super) fn files(self, folder: &Path, raw: Option<RawFormat>) -> Result<(SweepFiles, String), String> {
        let is_pair = self.sweep.is_none();
        let named = SweepFiles::of;
        let (files, name) = match (self.i1, self.i2, self.sweep) {
            (Some(i1), Some(i2), None) => (named(vec![folder.join(&i1), folder.join(i2)]), stem(&i1)),
            (None, None, Some(Sweep::Frames(frames))) => {
                let name = frames.first().map(|first| stem(first)).unwrap_or_default();
                (named(frames.iter().map(|frame| folder.join(frame)).collect()), name)
            }
            (None, None, Some(Sweep::Folder(path))) => {
                let path = folder.join(path);
                if !path.is_dir() {
                    let folder = path.display();
                    return Err(format!("there is no folder {folder}; give that of the frames, or a list of them"));
                }
                let frames =
                    photographs::sweep_frames(std::slice::from_ref(&path), false, raw, PageArguments::default());
                (frames.map_err(|failure| failure.message())?, file_name(&path))
            }
            _ => return Err(format!("is not {JSON}")),
        };
        if !is_pair && files.frames.len() < 3 {
            return Err(format!("has {} frames, and a sweep has three or more", files.frames.len()));
        }
        Ok((files, name))
    }
}

/// The fields of a line of JSON.
const JSON: &str = "{\"i1\": FILE, \"i2\": FILE, \"name\": NAME} or {\"sweep\": FOLDER, \"name\": NAME}";

/// The lines of a manifest with their numbers, or the number and problem of the first invalid line.
type Lines = Result<Vec<(usize, Line)>, (usize, String)>;

/// Reads the lines of a manifest with their numbers.
pub(super) fn read(file: &Path) -> Result<Vec<(usize, Line)>, Failure> {
    let failed = |problem: String| Failure::file(file, problem);
    let text = bounded_read::text(file, MAX_BYTES).map_err(|e| match e.kind() {
        ErrorKind::FileTooLarge => failed("is too long for a manifest; split it".to_string()),
        _ => failed(format!("cannot be read as a manifest ({e}); give a folder, CSV or JSON lines")),
    })?;
    let folder = file.parent().unwrap_or(Path::new(""));
    lines(&text, folder).map_err(|(number, problem)| failed(format!("line {number}: {problem}")))
}

/// Parses a manifest. Its files are relative to `folder`.
fn lines(text: &str, folder: &Path) -> Lines {
    if text.trim_start().starts_with('{') { json_lines(text) } else { csv_lines(text, folder) }
}

fn json_lines(text: &str) -> Lines {
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(i, line)| match serde_json::from_str(line) {
            Ok(parsed) => Ok((i + 1, parsed)),
            Err(e) => Err((i + 1, format!("is not {JSON} ({e})"))),
        })
        .collect()
}

fn csv_lines(text: &str, folder: &Path) -> Lines {
    let first = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#')).unwrap_or_default();
    // Spreadsheets write semicolons where the comma is the decimal separator.
    let delimiter = [b';', b'\t'].into_iter().find(|mark| !first.contains(',') && first.as_bytes().contains(mark));
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .delimiter(delimiter.unwrap_or(b','))
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    // Words of a header, which are not file names.
    let is_word = |cell: &&str| !cell.contains(['.', '/', '\\']) && !folder.join(cell).exists();
    let mut lines = Vec::new();
    for (place, record) in reader.records().enumerate() {
        let record = record.map_err(|e| {
            let number = e.position().map_or(0, csv::Position::line);
            (number as usize, format!("is not CSV ({e})"))
        })?;
        let number = record.position().map_or(0, csv::Position::line) as usize;
        let cells: Vec<&str> = record.iter().collect();
        let is_header = place == 0 && cells.len() > 1 && cells.iter().take(2).all(is_word);
        match cells.as_slice() {
            _ if is_header => {}
            [i1, i2, rest @ ..] if !i1.is_empty() && !i2.is_empty() && rest.len() <= 1 => {
                let name = rest.first().filter(|name| !name.is_empty()).map(ToString::to_string);
                lines.push((number, Line { i1: Some(i1.into()), i2: Some(i2.into()), sweep: None, name }));
            }
            _ => return Err((number, "is not I1,I2 or I1,I2,NAME".to_string())),
        }
    }
    Ok(lines)
}
