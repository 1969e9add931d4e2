//! The file that a misspelt name may mean.

use std::path::{Path, PathBuf};

/// Similarity of file names, 1 less the share of letters that differ, above which one may be a misspelling of the
/// other.
pub(super) const SIMILAR: f64 = 0.74;

/// Whether a name may be a misspelling of another. Other numbers are other files: `frame_09` is not `frame_01`.
pub(super) fn similarity(name: &str, other: &str) -> Option<f64> {
    let [name, other] = [name, other].map(str::to_lowercase);
    let numbers = |text: &str| -> Vec<String> {
        let words = text.split(|c: char| !c.is_ascii_digit()).filter(|digits| !digits.is_empty());
        words.map(|digits| digits.trim_start_matches('0').to_string()).collect()
    };
    let stem = |text: &str| text.rsplit_once('.').map_or(text.to_string(), |(stem, _)| stem.to_string());
    let score = strsim::normalized_damerau_levenshtein(&name, &other);
    let is_similar = score > SIMILAR || stem(&name) == stem(&other);
    (is_similar && numbers(&name) == numbers(&other)).then_some(score)
}

/// The file with the most similar name in the folder of a missing file, if one is similar.
pub fn similar_file(missing: &Path) -> Option<PathBuf> {
    let wanted = missing.file_name()?.to_str()?;
    let folder = missing.parent().filter(|p| !p.as_os_str().is_empty());
    let beside = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let scored = beside.filter_map(Result::ok).filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        Some((similarity(wanted, &name)?, name))
    });
    // Names of equal score are ordered, since folders list files in no fixed order.
    let (_, name) = scored.max_by(|a, b| a.0.total_cmp(&b.0).then_with(|| b.1.cmp(&a.1)))?;
    Some(folder.map_or_else(|| PathBuf::from(&name), |folder| folder.join(&name)))
}
