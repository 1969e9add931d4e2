//! Which files say of themselves that parfocal wrote them.

use std::io::Read;
use std::path::Path;

use serde_json::Value;

use crate::files::bounded_read;

/// The most bytes of JSON that are read, 64 MiB: as of the longest bench.
const MAX_JSON: u64 = 64 << 20;
/// Bytes at the beginning of a file, within which it states what wrote it.
const HEAD: u64 = 1 << 12;

/// What a file is that stands for itself, with no report beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// What `parfocal register` found.
    Registration,
    /// A calibrated lens.
    Lens,
    /// The report of a bench.
    Bench,
    /// The trace of a bench.
    Trace,
    /// The summary of a batch.
    Batch,
    /// The index of a batch.
    BatchPage,
    /// A page for man(1).
    Manual,
    /// A picture, PNG.
    Png,
    /// An image in floats, EXR.
    Exr,
    /// An animation.
    Gif,
}

impl FileKind {
    /// Whether the file is one that parfocal wrote. What cannot be read is none.
    pub(super) fn is_of(self, path: &Path) -> bool {
        match self {
            Self::Registration => json(path).is_some_and(|found| is_registration(&found)),
            Self::Lens => has(path, &["lens", "found", "residual_rms_px2"]),
            Self::Bench => has(path, &["version", "copy_gb_per_s", "runs"]),
            Self::Batch => has(path, &["version", "source", "not_done", "pairs"]),
            Self::Trace => json(path).is_some_and(|trace| is_trace(&trace)),
            Self::Manual => says(path, b"", b".TH parfocal"),
            Self::BatchPage => says(path, b"<!doctype html>", b"content=\"parfocal batch\""),
            Self::Png => says(path, b"\x89PNG\r\n\x1a\n", b"Software\0parfocal "),
            Self::Exr => says(path, b"\x76\x2f\x31\x01", b"parfocal "),
            Self::Gif => says(path, b"GIF89a", b"parfocal "),
        }
    }
}

/// The report of a solve has all of it, and more.
fn is_registration(found: &Value) -> bool {
    let has = |keys: &[&str]| keys.iter().all(|key| found.get(key).is_some()) && found.get("nearer").is_none();
    has(&["version", "transform", "photometric", "levels", "timings_ms"])
        || has(&["version", "frames", "reference", "photograph", "total_ms"])
}

/// Other programs write this format too; ours begins with the host of a run.
fn is_trace(trace: &Value) -> bool {
    let first = &trace["traceEvents"][0];
    first["name"] == "process_name" && first["args"]["name"].as_str().is_some_and(|name| name.ends_with(": host"))
}

fn has(path: &Path, keys: &[&str]) -> bool {
    json(path).is_some_and(|value| keys.iter().all(|key| value.get(key).is_some()))
}

fn json(path: &Path) -> Option<Value> {
    serde_json::from_slice(&read(path, MAX_JSON)?).ok()
}

fn says(path: &Path, magic: &[u8], words: &[u8]) -> bool {
    read(path, HEAD).is_some_and(|head| head.starts_with(magic) && head.windows(words.len()).any(|w| w == words))
}

fn read(path: &Path, most: u64) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    bounded_read::open(path).ok()?.take(most).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn only_what_states_it_is_ours() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("file");
        assert!(!FileKind::Lens.is_of(&file), "there is none");
        for (kind, text, ours) in [
            (FileKind::Lens, r#"{"lens": {}, "found": [], "residual_rms_px2": 1}"#, true),
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
