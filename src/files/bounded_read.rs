//! Reads regular files up to a limit, and hashes them.
//!
//! A user may name a pipe or a device. Opening a pipe blocks until a writer exists, and reading a device may never end.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// The reason why a text is no path of this system: it is a network path of Windows or a URL.
pub fn not_a_path(path: &Path) -> Option<&'static str> {
    let text = path.to_string_lossy();
    let scheme = text.split_once("://").map_or(&b""[..], |(scheme, _)| scheme.as_bytes());
    // A single letter is a drive of Windows.
    let is_scheme = scheme.len() > 1 && scheme[0].is_ascii_alphabetic();
    let is_url = text.starts_with("file:")
        || is_scheme && scheme.iter().all(|b| b.is_ascii_alphanumeric() || b"+-.".contains(b));
    if path.exists() {
        None
    } else if !cfg!(windows) && text.starts_with(r"\\") {
        Some("is a network path of Windows; mount it, and give the folder where it is mounted")
    } else if is_url {
        Some("is a URL; give the path of a file or a folder on this computer")
    } else {
        None
    }
}

/// Whether Windows has files and folders of this name. It has none with certain characters or a dot or a space at the
/// end, and names of devices refer to these, with any extension.
pub fn is_name_of_windows(name: &str) -> bool {
    let stem = name.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let is_port = |port: &str| {
        stem.strip_prefix(port).is_some_and(|n| n.len() == 1 && n.chars().all(|digit| digit.is_ascii_digit()))
    };
    let is_device = ["con", "prn", "aux", "nul"].contains(&stem.as_str()) || is_port("com") || is_port("lpt");
    !is_device && !name.contains(['<', '>', ':', '"', '|', '?', '*']) && !name.ends_with(['.', ' '])
}

/// Opens a regular file for reading. Other files are refused at once.
///
/// # Errors
/// As for [`File::open`], and [`ErrorKind::InvalidInput`] for other files.
pub fn open(path: &Path) -> Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, rustix::fs::OFlags::NONBLOCK.bits() as i32);
    // Windows does not open folders.
    let is_folder = || cfg!(windows) && path.is_dir();
    let file = options.open(path).map_err(|e| if is_folder() { irregular() } else { e })?;
    // Uses the metadata of the open file, since its name may refer to another file by now.
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    Err(irregular())
}

fn irregular() -> Error {
    Error::new(ErrorKind::InvalidInput, "not a regular file: give a file on disk")
}

/// Reads the bytes of a regular file.
///
/// # Errors
/// As for [`open`] and [`read_open`].
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    read_open(&open(path)?, most)
}

/// Reads the bytes of an open file. The length of the file is checked first, so that a longer one is not read.
///
/// # Errors
/// [`ErrorKind::FileTooLarge`] for more than `most` bytes, [`ErrorKind::OutOfMemory`] if there is no memory for them,
/// [`ErrorKind::InvalidInput`] for bytes of a file whose length is reported as 0,
/// and [`ErrorKind::ResourceBusy`] if the file grows.
pub fn read_open(file: &File, most: u64) -> Result<Vec<u8>> {
    let length = file.metadata()?.len();
    if length > most {
        return Err(Error::new(ErrorKind::FileTooLarge, format!("{length} bytes, and the most is {most}")));
    }
    let bytes = read_start(file, length + 1)?;
    if length == 0 && !bytes.is_empty() {
        // As in /proc.
        let problem =
            "its length was 0, and it holds bytes: if it is being written, try again; else copy it to a folder on disk";
        return Err(Error::new(ErrorKind::InvalidInput, problem));
    }
    if bytes.len() as u64 > length {
        return Err(Error::new(ErrorKind::ResourceBusy, "it grew while it was read; try again"));
    }
    Ok(bytes)
}

/// Reads the first bytes of an open file, at most `count`.
///
/// # Errors
/// [`ErrorKind::OutOfMemory`] if there is no memory for them.
pub fn read_start(file: &File, count: u64) -> Result<Vec<u8>> {
    read_from(file, 0, count)
}

/// Reads at most `count` bytes of an open file from a position on.
///
/// # Errors
/// As for [`read_start`].
pub fn read_from(mut file: &File, position: u64, count: u64) -> Result<Vec<u8>> {
    file.seek(SeekFrom::Start(position))?;
    let mut bytes = Vec::new();
    let rest = file.metadata()?.len().saturating_sub(position);
    let all = usize::try_from(count.min(rest + 1)).unwrap_or(usize::MAX);
    // All memory is taken here, since growing aborts the program where it fails.
    bytes
        .try_reserve_exact(all)
        .map_err(|_| Error::new(ErrorKind::OutOfMemory, format!("no memory for {all} bytes")))?;
    file.take(all as u64).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads the text of a regular file, without what programs of Windows add to UTF-8: a mark at the start, and carriage
/// returns at the end of lines.
///
/// # Errors
/// As for [`read`], and [`ErrorKind::InvalidData`] for text that is not UTF-8.
pub fn text(path: &Path, most: u64) -> Result<String> {
    let mut bytes = read(path, most)?;
    if bytes.starts_with(b"\xef\xbb\xbf") {
        bytes.drain(..3);
    }
    let text = String::from_utf8(bytes).map_err(|_| Error::new(ErrorKind::InvalidData, "not UTF-8"))?;
    Ok(if text.contains('\r') { text.replace("\r\n", "\n") } else { text })
}

/// The key of a report that holds [`Hashes`].
pub(crate) const HASHES: &str = "hashes";

/// Size and hash of files, by name: of a folder of results all but the report.
pub type Hashes = BTreeMap<String, Hash>;

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
    ///
    /// # Errors
    /// As for the reader.
    pub fn of(mut reader: impl Read) -> Result<Self> {
        let (mut digest, mut bytes, mut block) = (Sha256::new(), 0, vec![0; 1 << 16]);
        loop {
            match reader.read(&mut block) {
                Ok(0) => break,
                Ok(read) => {
                    digest.update(&block[..read]);
                    bytes += read as u64;
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => (),
                Err(e) => return Err(e),
            }
        }
        Ok(Self { bytes, sha256: digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect() })
    }

    /// Whether a file has this size and hash; false for a file that cannot be read.
    pub(crate) fn matches(&self, path: &Path) -> bool {
        // Reads at most one byte more than the stated size.
        open(path).is_ok_and(|file| {
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
    use serde_json::json;

    use super::*;

    #[test]
    fn urls_are_no_paths_and_drives_are() {
        for url in ["https://host/a.png", "svn+ssh://host/a", "x-a.b://c", "file:/a.png"] {
            assert!(not_a_path(Path::new(url)).is_some_and(|problem| problem.starts_with("is a URL")), "{url}");
        }
        for path in ["C://out", "a/b://c", "1a://b", "://a", "a:b"] {
            assert_eq!(not_a_path(Path::new(path)), None, "{path}");
        }
    }

    #[test]
    fn names_that_windows_lacks_are_recognized() {
        for name in ["con", "Aux.png", "NUL.tar.gz", "com1", "LPT9.txt", "nul .png", "a.", "a ", "a:b", "a*", "C:"] {
            assert!(!is_name_of_windows(name), "{name}");
        }
        for name in ["console", "a.con", "com", "com10", "part 1.aux", ".b", "auxiliary_1"] {
            assert!(is_name_of_windows(name), "{name}");
        }
    }

    #[test]
    fn a_file_beyond_the_limit_is_refused() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "abc").unwrap();
        assert_eq!(text(&file, 3).unwrap(), "abc");
        std::fs::write(&file, "\u{feff}a\r\n\rc").unwrap();
        assert_eq!(text(&file, 8).unwrap(), "a\n\rc");
        std::fs::write(&file, "abc").unwrap();
        assert_eq!(read(&file, 2).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_start(&open(&file).unwrap(), 2).unwrap(), b"ab");
        // A file that is longer than any memory takes no space on the disk, and is not read.
        File::create(&file).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(read(&file, 1 << 32).unwrap_err().kind(), ErrorKind::FileTooLarge);
        std::fs::write(&file, b"\xff").unwrap();
        assert_eq!(text(&file, 3).unwrap_err().kind(), ErrorKind::InvalidData);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_of_the_kernel_is_refused_since_it_reports_no_length() {
        let refused = read(Path::new("/proc/self/status"), 1 << 20).unwrap_err();
        assert!(refused.to_string().contains("copy it to a folder on disk"), "{refused}");
    }

    #[cfg(unix)]
    #[test]
    fn a_pipe_and_a_device_are_refused_at_once() {
        let folder = tempfile::TempDir::new().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&pipe, Path::new("/dev/zero"), folder.path()] {
            assert_eq!(open(path).unwrap_err().kind(), ErrorKind::InvalidInput, "{}", path.display());
        }
    }

    #[test]
    fn a_missing_truncated_or_exchanged_file_is_noticed() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("a");
        let report = json!({ "files": ["a", "report.json"], "hashes": { "a": Hash::of(&b"abc"[..]).unwrap() } });
        let whole = || is_whole(folder.path(), "report.json", &report);
        assert!(!whole(), "it is missing");
        for (text, is) in [("abc", true), ("ab", false), ("abd", false), ("abcd", false)] {
            std::fs::write(&file, text).unwrap();
            assert_eq!(whole(), is, "{text}");
        }
        std::fs::write(&file, "abc").unwrap();
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
