//! Temporary files: how they are called, and that none outlives the program.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::{Builder, NamedTempFile};

/// Characters that tell temporary files apart.
const RANDOM: usize = 6;

/// Folders in which files are being written, each with those above it that were made for it, deepest first.
static OPEN: Mutex<BTreeSet<Vec<PathBuf>>> = Mutex::new(BTreeSet::new());

/// Held while files get their names.
static NAMING: Mutex<()> = Mutex::new(());

/// What the names of this program's temporary files begin with.
fn own_prefix() -> String {
    format!(".parfocal-{}-", std::process::id())
}

/// A temporary file that becomes as readable as any other file when it gets its name.
pub(super) fn file(folder: &Path) -> std::io::Result<NamedTempFile> {
    let prefix = own_prefix();
    let mut builder = Builder::new();
    builder.prefix(&prefix).rand_bytes(RANDOM);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

/// Whether a name is one of [`file`]'s, of this or another program.
fn is_temporary(name: &str) -> bool {
    let Some((id, random)) = name.strip_prefix(".parfocal-").and_then(|rest| rest.split_once('-')) else {
        return false;
    };
    let is_id = !id.is_empty() && id.chars().all(|c| c.is_ascii_digit());
    is_id && random.len() == RANDOM && random.chars().all(|c| c.is_ascii_alphanumeric())
}

/// Removes the temporary files in a folder that no other program is at work in.
pub(super) fn remove_leftovers(folder: &Path) {
    remove(folder, is_temporary);
}

fn remove(folder: &Path, goes: impl Fn(&str) -> bool) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| goes(&entry.file_name().to_string_lossy())) {
        // What cannot be removed stays: it harms nobody.
        let _ = fs::remove_file(entry.path());
    }
}

/// Notes that files are written in a folder, made with those given.
pub(super) fn note(folders: Vec<PathBuf>) {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner).insert(folders);
}

/// Notes that this is over.
pub(super) fn forget(folders: &Vec<PathBuf>) {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner).remove(folders);
}

/// For as long as files get their names.
pub(super) fn naming() -> MutexGuard<'static, ()> {
    NAMING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes what is half written, for a program that is about to end at once; files that get their names at this moment get
/// them first, all of them. No result can be written afterwards: the program must end.
pub fn abandon() {
    std::mem::forget(naming());
    for folders in OPEN.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        folders.first().into_iter().for_each(|folder| remove(folder, |name| name.starts_with(&own_prefix())));
        // The first is there in any case; only those that are empty go.
        folders.iter().skip(1).all(|made| fs::remove_dir(made).is_ok());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_user_named_is_none_of_ours() {
        for name in [".parfocal-12-aB3dE6", ".parfocal-1-000000"] {
            assert!(is_temporary(name), "{name}");
        }
        for name in
            [".report.json.backup", ".parfocal-12-", ".parfocal-x-aB3dE6", ".parfocal-12-aB3dE6.bak", ".parfocal"]
        {
            assert!(!is_temporary(name), "{name}");
        }
    }
}
