//! The folder that results go to: made if it is missing, and with one writer at a time.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use super::temporary;
use crate::base::Error;

/// How long another writer is waited for: results are written in less.
const PATIENCE: Duration = Duration::from_secs(10);

/// Who else may write there meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Writers {
    /// Nobody: several files belong together.
    One,
    /// Those who write a file each, as this one does.
    Many,
}

/// The folder, locked, and which part of its path was made here.
pub(super) struct Folder {
    pub(super) path: PathBuf,
    /// Deepest first.
    made: Vec<PathBuf>,
    /// The folder itself, open: the lock ends with it, also where the program is killed. None where a file system has no locks.
    handle: Option<File>,
}

impl Folder {
    /// Waits for those who write there; what killed programs have left half written is removed.
    pub(super) fn make(path: &Path, writers: Writers) -> Result<Self, Error> {
        let missing = path.ancestors().take_while(|p| !p.as_os_str().is_empty() && p.try_exists().is_ok_and(|is| !is));
        let made = missing.map(Path::to_path_buf).collect();
        let mut folder = Self { path: path.to_path_buf(), made, handle: None };
        temporary::note(folder.noted());
        match fs::create_dir_all(path) {
            Ok(()) => folder.lock(writers)?,
            Err(_) if path.exists() => return Err(Error::file(path, "is a file; give a folder for the results")),
            Err(e) => {
                return Err(Error::file(path, format!("cannot be made ({e}); give another folder for the results")));
            }
        }
        Ok(folder)
    }

    /// Locks the folder; alone in it, cleans up.
    fn lock(&mut self, writers: Writers) -> Result<(), Error> {
        let until = Instant::now() + PATIENCE;
        loop {
            // Windows opens no folders.
            let Ok(handle) = File::open(&self.path) else { return Ok(()) };
            let locked = match handle.try_lock() {
                Ok(()) => {
                    temporary::remove_leftovers(&self.path);
                    if writers == Writers::Many { handle.try_lock_shared() } else { Ok(()) }
                }
                Err(TryLockError::WouldBlock) if writers == Writers::Many => handle.try_lock_shared(),
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

    /// Waits until the names of its files are on the disk.
    pub(super) fn sync(&self) -> std::io::Result<()> {
        self.handle.as_ref().map_or(Ok(()), |handle| match handle.sync_all() {
            // There are file systems that cannot sync a folder.
            Err(e) if e.kind() == std::io::ErrorKind::InvalidInput => Ok(()),
            other => other,
        })
    }

    /// The folder stays.
    pub(super) fn keep(&mut self) {
        temporary::forget(&self.noted());
        self.made.clear();
        temporary::note(self.noted());
    }

    fn noted(&self) -> Vec<PathBuf> {
        [std::slice::from_ref(&self.path), &self.made].concat()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        temporary::forget(&self.noted());
        for folder in &self.made {
            // Only an empty folder goes: what someone else put there in the meantime is not ours to remove.
            if fs::remove_dir(folder).is_err() {
                return;
            }
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn leftovers_go_where_nobody_else_is_at_work() {
        let base = tempfile::TempDir::new().unwrap();
        let left = base.path().join(".parfocal-1-abcdef");
        fs::write(&left, "half").unwrap();
        let writer = Folder::make(base.path(), Writers::Many).unwrap();
        assert!(!left.exists());
        fs::write(&left, "at work").unwrap();
        drop(Folder::make(base.path(), Writers::Many).unwrap());
        assert!(left.exists(), "it may be another writer's");
        drop(writer);
        drop(Folder::make(base.path(), Writers::One).unwrap());
        assert!(!left.exists());
    }

    #[test]
    fn one_writes_at_a_time_what_belongs_together() {
        let base = tempfile::TempDir::new().unwrap();
        let first = Folder::make(base.path(), Writers::One).unwrap();
        let second = {
            let path = base.path().to_path_buf();
            thread::spawn(move || Folder::make(&path, Writers::One).map(drop).map_err(|e| e.to_string()))
        };
        thread::sleep(Duration::from_millis(200));
        drop(first);
        second.join().unwrap().unwrap();
    }
}
