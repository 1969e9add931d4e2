//! The folder of results: created if missing, locked for one writer, free of leftover temporary files.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tempfile::{Builder, NamedTempFile};

use crate::base::Error;
use crate::files::bounded_read::Hash;

/// Longest wait for another writer. Writing results takes less.
const LOCK_TIMEOUT: Duration = Duration::from_secs(10);

/// Other writers that may use the folder at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OtherWriters {
    /// No other writer, since several files belong together.
    None,
    /// Other writers of single files.
    SingleFiles,
}

/// The folder, locked.
pub(super) struct Folder {
    pub(super) path: PathBuf,
    /// Folders that were created for it, the deepest first.
    made: Vec<PathBuf>,
    /// What [`open_lock`] opened. The lock also ends if the program is killed. `None` if the file system has no locks.
    handle: Option<File>,
}

impl Folder {
    /// Creates the folder, waits for other writers, and removes temporary files of ended programs.
    pub(super) fn make(path: &Path, others: OtherWriters) -> Result<Self, Error> {
        let missing = path.ancestors().take_while(|p| !p.as_os_str().is_empty() && p.try_exists().is_ok_and(|is| !is));
        let made = missing.map(Path::to_path_buf).collect();
        let mut folder = Self { path: path.to_path_buf(), made, handle: None };
        register(folder.folders());
        match fs::create_dir_all(path) {
            Ok(()) => folder.lock(others)?,
            Err(_) if path.exists() => return Err(Error::file(path, "is a file; give a folder for the results")),
            Err(e) => {
                return Err(Error::file(path, format!("cannot be made ({e}); give another folder for the results")));
            }
        }
        Ok(folder)
    }

    /// Locks the folder. If no other writer uses it, removes leftovers.
    fn lock(&mut self, others: OtherWriters) -> Result<(), Error> {
        let until = Instant::now() + LOCK_TIMEOUT;
        loop {
            let Ok(handle) = open_lock(&self.path) else { return Ok(()) };
            let locked = match handle.try_lock() {
                Ok(()) => {
                    remove_leftovers(&self.path);
                    if others == OtherWriters::SingleFiles { share(&handle) } else { Ok(()) }
                }
                Err(TryLockError::WouldBlock) if others == OtherWriters::SingleFiles => handle.try_lock_shared(),
                other => other,
            };
            match locked {
                Ok(()) => {
                    self.handle = Some(handle);
                    return Ok(());
                }
                Err(TryLockError::Error(_)) => return Ok(()),
                Err(TryLockError::WouldBlock) if Instant::now() < until => thread::sleep(Duration::from_millis(20)),
                Err(TryLockError::WouldBlock) => {
                    let problem = "is being written to by another parfocal; wait for it to end, or give another folder";
                    return Err(Error::file(&self.path, problem));
                }
            }
        }
    }

    /// Flushes the names of its files to the disk.
    pub(super) fn sync(&self) -> io::Result<()> {
        self.handle.as_ref().map_or(Ok(()), |handle| match handle.sync_all() {
            // Some file systems cannot sync a folder.
            Err(e) if e.kind() == io::ErrorKind::InvalidInput => Ok(()),
            other => other,
        })
    }

    /// Keeps the folder.
    pub(super) fn keep(&mut self) {
        unregister(&self.folders());
        self.made.clear();
        register(self.folders());
    }

    fn folders(&self) -> Vec<PathBuf> {
        [std::slice::from_ref(&self.path), &self.made].concat()
    }
}

/// Opens what a writer of a folder locks: the folder itself. Windows locks no folders: there it is an empty file in the
/// user's folder of temporary files, whose name is a hash of the folder's path.
fn open_lock(folder: &Path) -> io::Result<File> {
    if !cfg!(windows) {
        return File::open(folder);
    }
    let path = canonical(folder).to_string_lossy().to_lowercase();
    let name = format!("parfocal-{:.32}.lock", Hash::of(path.as_bytes())?.sha256);
    File::options().write(true).create(true).truncate(false).open(std::env::temp_dir().join(name))
}

/// The canonical path of a folder, or its own on file systems of Windows that have none.
fn canonical(folder: &Path) -> PathBuf {
    fs::canonicalize(folder).unwrap_or_else(|_| folder.to_path_buf())
}

/// Makes an exclusive lock a shared one.
fn share(handle: &File) -> Result<(), TryLockError> {
    handle.try_lock_shared()?;
    // Windows adds the shared lock, and removes the exclusive one first.
    if cfg!(windows) { handle.unlock().map_err(TryLockError::Error) } else { Ok(()) }
}

impl Drop for Folder {
    fn drop(&mut self) {
        unregister(&self.folders());
        for folder in &self.made {
            // Removes only an empty folder: another program may have put files there.
            if fs::remove_dir(folder).is_err() {
                return;
            }
        }
    }
}

/// Number of random characters in the name of a temporary file.
const RANDOM: usize = 6;

/// Folders that are being written to, each with the created folders above it, the deepest first.
static OPEN: Mutex<BTreeSet<Vec<PathBuf>>> = Mutex::new(BTreeSet::new());

/// Locked while files are renamed to their final names.
static NAMING: Mutex<()> = Mutex::new(());

/// Prefix of the names of this process's temporary files.
fn own_prefix() -> String {
    format!(".parfocal-{}-", std::process::id())
}

/// Creates a temporary file with the permissions of an ordinary file.
pub(super) fn temporary_file(folder: &Path) -> io::Result<NamedTempFile> {
    let prefix = own_prefix();
    let mut builder = Builder::new();
    builder.prefix(&prefix).rand_bytes(RANDOM);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    // A canonical path of Windows may be longer than 260 characters.
    if cfg!(windows) { builder.tempfile_in(canonical(folder)) } else { builder.tempfile_in(folder) }
}

/// Renames a temporary file to its final name in the same folder.
pub(super) fn persist(file: NamedTempFile, path: &Path) -> io::Result<()> {
    let path = file.path().with_file_name(path.file_name().unwrap_or_default());
    file.persist(path).map(drop).map_err(|e| e.error)
}

/// Whether a name is one that [`temporary_file`] makes, in this or another process.
fn is_temporary(name: &str) -> bool {
    let Some((id, random)) = name.strip_prefix(".parfocal-").and_then(|rest| rest.split_once('-')) else {
        return false;
    };
    let is_id = !id.is_empty() && id.chars().all(|c| c.is_ascii_digit());
    is_id && random.len() == RANDOM && random.chars().all(|c| c.is_ascii_alphanumeric())
}

/// Removes temporary files that no other process is writing.
pub(super) fn remove_leftovers(folder: &Path) {
    remove(folder, is_temporary);
}

fn remove(folder: &Path, goes: impl Fn(&str) -> bool) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| goes(&entry.file_name().to_string_lossy())) {
        // A leftover that cannot be removed is harmless.
        let _ = fs::remove_file(entry.path());
    }
}

/// Registers a folder that is being written to.
pub(super) fn register(folders: Vec<PathBuf>) {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner).insert(folders);
}

/// Removes a folder from the register.
pub(super) fn unregister(folders: &Vec<PathBuf>) {
    OPEN.lock().unwrap_or_else(PoisonError::into_inner).remove(folders);
}

/// Guard that is held while files are renamed to their final names.
pub(super) fn naming() -> MutexGuard<'static, ()> {
    NAMING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes half-written files before the process ends. Waits for files that are being renamed. No results can be
/// written afterwards: the process must end.
pub fn abandon() {
    std::mem::forget(naming());
    for folders in OPEN.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        folders.first().into_iter().for_each(|folder| remove(folder, |name| name.starts_with(&own_prefix())));
        // The first entry is the folder itself. Only empty folders are removed.
        folders.iter().skip(1).all(|made| fs::remove_dir(made).is_ok());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leftovers_are_removed_if_no_other_writer_uses_the_folder() {
        let base = tempfile::TempDir::new().unwrap();
        let left = base.path().join(".parfocal-1-abcdef");
        fs::write(&left, "half").unwrap();
        let writer = Folder::make(base.path(), OtherWriters::SingleFiles).unwrap();
        assert!(!left.exists());
        fs::write(&left, "at work").unwrap();
        drop(Folder::make(base.path(), OtherWriters::SingleFiles).unwrap());
        assert!(left.exists(), "it may be another writer's");
        drop(writer);
        drop(Folder::make(base.path(), OtherWriters::None).unwrap());
        assert!(!left.exists());
    }

    #[test]
    fn writers_of_several_files_wait_for_one_another() {
        let base = tempfile::TempDir::new().unwrap();
        let first = Folder::make(base.path(), OtherWriters::None).unwrap();
        let second = {
            let path = base.path().to_path_buf();
            thread::spawn(move || Folder::make(&path, OtherWriters::None).map(drop).map_err(|e| e.to_string()))
        };
        thread::sleep(Duration::from_millis(200));
        drop(first);
        second.join().unwrap().unwrap();
    }

    #[test]
    fn names_that_users_choose_are_not_temporary() {
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
