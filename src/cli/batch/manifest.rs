//! The lines of a list of pairs and sweeps: CSV or JSON.

use std::path::{Path, PathBuf};

use parfocal::image_io::RawFormat;
use serde::Deserialize;

use crate::cli::jobs::frames::{self, shown, stem};

/// A line of a manifest.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Line {
    #[serde(default)]
    i1: Option<PathBuf>,
    #[serde(default)]
    i2: Option<PathBuf>,
    #[serde(default)]
    sweep: Option<Sweep>,
    #[serde(default)]
    pub(crate) name: Option<String>,
}

/// The frames of a sweep in order, or the folder that holds them.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Sweep {
    Folder(PathBuf),
    Frames(Vec<PathBuf>),
}

impl Line {
    fn of_pair(i1: &str, i2: &str, name: Option<&str>) -> Self {
        Self { i1: Some(i1.into()), i2: Some(i2.into()), sweep: None, name: name.map(String::from) }
    }

    /// Its files, and the name that it has without one that is stated; `folder` is that of the manifest.
    pub(crate) fn files(self, folder: &Path, raw: Option<RawFormat>) -> Result<(Vec<PathBuf>, String), String> {
        let is_pair = self.sweep.is_none();
        let (files, name): (Vec<PathBuf>, _) = match (self.i1, self.i2, self.sweep) {
            (Some(i1), Some(i2), None) => (vec![folder.join(&i1), folder.join(i2)], stem(&i1)),
            (None, None, Some(Sweep::Frames(frames))) => {
                let name = frames.first().map(|first| stem(first)).unwrap_or_default();
                (frames.iter().map(|frame| folder.join(frame)).collect(), name)
            }
            (None, None, Some(Sweep::Folder(path))) => {
                let path = folder.join(path);
                if !path.is_dir() {
                    return Err(format!(
                        "there is no folder {}; give that of the frames, or a list of them",
                        path.display()
                    ));
                }
                (
                    frames::of_sweep(std::slice::from_ref(&path), true, raw).map_err(|failure| failure.message())?,
                    shown(&path),
                )
            }
            _ => return Err(format!("is not {JSON}")),
        };
        if !is_pair && files.len() < 3 {
            return Err(format!("has {} frames, and a sweep has three or more", files.len()));
        }
        Ok((files, name))
    }
}

/// A line of JSON.
const JSON: &str = "{\"i1\": FILE, \"i2\": FILE, \"name\": NAME} or {\"sweep\": FOLDER, \"name\": NAME}";

/// Lines of a manifest with their numbers, or the first that is wrong.
pub(crate) type Lines = Result<Vec<(usize, Line)>, (usize, String)>;

/// Those of a text, which names files in this folder.
pub(crate) fn lines(text: &str, folder: &Path) -> Lines {
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
    // As spreadsheets write it where the comma is the decimal mark.
    let delimiter = [b';', b'\t'].into_iter().find(|mark| !first.contains(',') && first.as_bytes().contains(mark));
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .delimiter(delimiter.unwrap_or(b','))
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    // Words, which name no file.
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
            [i1, i2] | [i1, i2, ""] if !i1.is_empty() && !i2.is_empty() => {
                lines.push((number, Line::of_pair(i1, i2, None)));
            }
            [i1, i2, name] if !i1.is_empty() && !i2.is_empty() => {
                lines.push((number, Line::of_pair(i1, i2, Some(name))));
            }
            _ => return Err((number, "is not I1,I2 or I1,I2,NAME".to_string())),
        }
    }
    Ok(lines)
}
