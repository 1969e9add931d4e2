//! Sizes and hashes of the files of results, which reveal a damaged or exchanged file.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::files::bounded_read;

/// The key of a report that holds [`Hashes`].
pub(super) const HASHES: &str = "hashes";

/// Size and hash of each file but the report, by name.
pub(super) type Hashes = BTreeMap<String, Hash>;

/// Size and hash of a file.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Hash {
    /// Size, bytes.
    pub bytes: u64,
    /// SHA-256, as `sha256sum` prints it.
    pub sha256: String,
}

impl Hash {
    /// Reads a file to the end.
    pub(super) fn of(mut reader: impl Read) -> io::Result<Self> {
        let (mut digest, mut bytes, mut block) = (Sha256::new(), 0, vec![0; 1 << 16]);
        loop {
            match reader.read(&mut block) {
                Ok(0) => break,
                Ok(read) => {
                    digest.update(&block[..read]);
                    bytes += read as u64;
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => (),
                Err(e) => return Err(e),
            }
        }
        Ok(Self { bytes, sha256: digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect() })
    }

    /// Whether a file has this size and hash; false for a file that cannot be read.
    fn matches(&self, path: &Path) -> bool {
        // Reads at most one byte more than the stated size.
        bounded_read::open(path).is_ok_and(|file| {
            let is_long = file.metadata().is_ok_and(|found| found.len() == self.bytes);
            is_long && Self::of(file.take(self.bytes + 1)).is_ok_and(|found| found == *self)
        })
    }
}

/// Whether all files that the report of a folder lists exist with their stated sizes and hashes.
pub fn is_whole(folder: &Path, name: &str, report: &Value) -> bool {
    let hashes = report.get(HASHES).and_then(|found| Hashes::deserialize(found).ok()).unwrap_or_default();
    let files = report["files"].as_array().map_or(&[][..], Vec::as_slice);
    let is_as_written = |file: &Value| {
        let Some(file) = file.as_str() else { return false };
        file == name || hashes.get(file).is_some_and(|hash| hash.matches(&folder.join(file)))
    };
    !files.is_empty() && files.iter().all(is_as_written)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use serde_json::json;

    use super::*;

    #[test]
    fn a_missing_truncated_or_exchanged_file_is_noticed() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("a");
        let report = json!({ "files": ["a", "report.json"], "hashes": { "a": Hash::of(&b"abc"[..]).unwrap() } });
        let whole = || is_whole(folder.path(), "report.json", &report);
        assert!(!whole(), "it is missing");
        for (text, is) in [("abc", true), ("ab", false), ("abd", false), ("abcd", false)] {
            fs::write(&file, text).unwrap();
            assert_eq!(whole(), is, "{text}");
        }
        fs::write(&file, "abc").unwrap();
        assert!(!is_whole(folder.path(), "report.json", &json!({ "files": ["a"] })), "its hash is unknown");
        assert!(!is_whole(folder.path(), "report.json", &json!({ "files": [] })));
    }

    #[test]
    fn the_hash_is_that_of_sha256sum() {
        let found = Hash::of(&b"abc"[..]).unwrap();
        assert_eq!(found.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(found.bytes, 3);
    }
}
