//! Files that appear together: written under temporary names, renamed at the end.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile};

use crate::base::Error;

/// A folder and the files that are about to appear in it. Dropped before [`place`](Staging::place) has succeeded, it
/// leaves nothing behind.
pub(crate) struct Staging {
    // Fields drop in this order: the temporary files go before the folder that holds them.
    written: Vec<(NamedTempFile, PathBuf)>,
    folder: Folder,
}

impl Staging {
    /// Makes the folder if it is missing.
    pub(crate) fn new(out: &Path) -> Result<Self, Error> {
        Ok(Self { written: Vec::new(), folder: Folder::make(out)? })
    }

    /// Writes one file under a temporary name.
    pub(crate) fn add(
        &mut self,
        name: impl AsRef<OsStr>,
        fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
    ) -> Result<(), Error> {
        let name = name.as_ref();
        let path = self.folder.path.join(name);
        let wrap =
            |problem: String| Error::file(&path, format!("cannot be written ({problem}); check space and permissions"));
        let mut file = temporary(&self.folder.path, name).map_err(|e| wrap(e.to_string()))?;
        let mut writer = BufWriter::new(file.as_file_mut());
        fill(&mut writer).map_err(wrap)?;
        writer.flush().map_err(|e| wrap(e.to_string()))?;
        drop(writer);
        self.written.push((file, path));
        Ok(())
    }

    /// Gives every file its name. Where one cannot have it, those that already have theirs are removed again: results
    /// of two solves side by side would be worse than none.
    pub(crate) fn place(mut self) -> Result<(), Error> {
        if let Some((_, path)) = self.written.iter().find(|(_, path)| path.is_dir()) {
            return Err(Error::file(path, "is a folder where a result should go; move it away"));
        }
        // The last is the report, which stands for the whole: an earlier one must not stand beside half of the new results.
        if self.written.len() > 1
            && let Some((_, last)) = self.written.last()
        {
            drop(fs::remove_file(last));
        }
        let mut placed = Vec::new();
        for (file, path) in self.written.drain(..) {
            if let Err(e) = file.persist(&path) {
                placed.iter().for_each(|p: &PathBuf| drop(fs::remove_file(p)));
                return Err(Error::file(&path, format!("cannot be replaced ({}); check permissions", e.error)));
            }
            placed.push(path);
        }
        self.folder.made.clear();
        Ok(())
    }
}

/// Writes one file, whole or not at all; its folder is made if it is missing.
pub(crate) fn write_file(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
) -> Result<(), Error> {
    let Some(name) = path.file_name() else {
        return Err(Error::file(path, "is no name of a file; give one"));
    };
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut staging = Staging::new(folder)?;
    staging.add(name, fill)?;
    staging.place()
}

/// Removes the temporary files that a program which is about to end at once leaves in a folder of results, and the folder
/// if nothing else is in it. Not for folders that another program writes to at the same time.
pub fn remove_unfinished(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| is_temporary(&entry.file_name().to_string_lossy())) {
        // What cannot be removed stays: there is nobody to tell.
        let _ = fs::remove_file(entry.path());
    }
    let _ = fs::remove_dir(folder);
}

/// Whether a name is one of [`temporary`]: that of a result with an ending, between dots, and six characters.
fn is_temporary(name: &str) -> bool {
    let parts = name.strip_prefix('.').and_then(|rest| rest.rsplit_once('.'));
    parts.is_some_and(|(result, random)| {
        let ours = [".exr", ".png", ".csv", ".json", ".html", ".ply", ".glb", ".tif", ".tiff"];
        ours.iter().any(|ending| result.ends_with(ending))
            && random.len() == RANDOM
            && random.chars().all(|c| c.is_ascii_alphanumeric())
    })
}

/// Characters that tell temporary files apart.
const RANDOM: usize = 6;

/// A temporary file that becomes as readable as any other file when it gets its name.
fn temporary(folder: &Path, name: &OsStr) -> std::io::Result<NamedTempFile> {
    let prefix = format!(".{}.", name.to_string_lossy());
    let mut builder = Builder::new();
    builder.prefix(&prefix).rand_bytes(RANDOM);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

/// The output folder, and which part of its path was made here, deepest first.
struct Folder {
    path: PathBuf,
    made: Vec<PathBuf>,
}

impl Folder {
    fn make(path: &Path) -> Result<Self, Error> {
        let missing = path.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists());
        let folder = Self { path: path.to_path_buf(), made: missing.map(Path::to_path_buf).collect() };
        match fs::create_dir_all(path) {
            Ok(()) => Ok(folder),
            Err(_) if path.exists() => Err(Error::file(path, "is a file; give a folder for the results")),
            Err(e) => Err(Error::file(path, format!("cannot be made ({e}); give another folder for the results"))),
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        for folder in &self.made {
            // Only an empty folder goes: what someone else put there in the meantime is not ours to remove.
            if fs::remove_dir(folder).is_err() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::TempDir;

    #[test]
    fn nothing_is_left_of_a_failure() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("a/b");
        let mut staging = Staging::new(&out).unwrap();
        staging.add("one", |w| w.write_all(b"1").map_err(|e| e.to_string())).unwrap();
        assert!(staging.add("two", |_| Err("disk full".to_string())).unwrap_err().to_string().contains("disk full"));
        drop(staging);
        assert!(!base.path().join("a").exists());
    }

    #[test]
    fn a_folder_in_the_way_stops_all_files_and_keeps_what_was_there() {
        let base = TempDir::new().unwrap();
        fs::create_dir(base.path().join("two")).unwrap();
        fs::write(base.path().join("one"), "old").unwrap();
        let mut staging = Staging::new(base.path()).unwrap();
        for name in ["one", "two"] {
            staging.add(name, |w| w.write_all(b"new").map_err(|e| e.to_string())).unwrap();
        }
        assert!(staging.place().is_err());
        assert_eq!(fs::read(base.path().join("one")).unwrap(), b"old");
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_is_half_written_is_known_by_its_name_and_removed() {
        let base = TempDir::new().unwrap();
        let made = base.path().join("made");
        for (folder, names) in [(base.path(), &["old.png", ".report.json.bak"][..]), (&made, &[])] {
            let mut staging = Staging::new(folder).unwrap();
            staging.add("depth.png", |_| Ok(())).unwrap();
            names.iter().for_each(|name| fs::write(folder.join(name), "x").unwrap());
            // As where the program ends at once.
            std::mem::forget(staging);
            assert_eq!(fs::read_dir(folder).unwrap().count(), names.len() + 1);
        }
        remove_unfinished(&made);
        assert!(!made.exists());
        remove_unfinished(base.path());
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_file_where_the_folder_should_be_is_named() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("file");
        fs::write(&out, "x").unwrap();
        let Err(error) = Staging::new(&out) else { panic!("made a folder over a file") };
        assert!(error.to_string().contains("is a file"), "{error}");
        assert!(Staging::new(&out.join("below")).is_err());
        assert!(out.is_file());
    }

    #[cfg(unix)]
    #[test]
    fn results_are_as_readable_as_other_files() {
        use std::os::unix::fs::PermissionsExt;
        let base = TempDir::new().unwrap();
        let mut staging = Staging::new(base.path()).unwrap();
        staging.add("one", |_| Ok(())).unwrap();
        staging.place().unwrap();
        fs::write(base.path().join("other"), "x").unwrap();
        let mode = |name| fs::metadata(base.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("one"), mode("other"));
    }
}
