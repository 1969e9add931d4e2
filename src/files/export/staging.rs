//! Files that appear together: written under temporary names, renamed at the end.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde_json::json;
use tempfile::{Builder, NamedTempFile};

use super::destination::{Destination, Guard};
use super::kind::FileKind;
use super::listed::{Listed, UNFINISHED};
use crate::base::Error;

/// A folder and the files that are about to appear in it. Dropped before [`place`](Staging::place) has succeeded, it
/// leaves nothing behind.
pub(crate) struct Staging {
    // Fields drop in this order: the temporary files go before the folder that holds them.
    written: Vec<(NamedTempFile, PathBuf)>,
    folder: Folder,
    guard: Guard,
    /// Of the files that an earlier report lists, those that go.
    stale: Stale,
}

/// What of an earlier run goes when the new files have their names.
enum Stale {
    /// What the report lists and this run does not write.
    Rest,
    /// These, as far as it lists them.
    Named(Vec<String>),
}

impl Staging {
    /// Results that take the place of those that a report of this name lists. It is itself the last of them to be
    /// [`add`](Self::add)ed, and says under `files` which there are. Makes the folder if it is missing.
    pub(crate) fn anew(out: Destination<'_>, report: &str) -> Result<Self, Error> {
        Self::new(out, Guard::by_report(out, report), Stale::Rest)
    }

    /// Results that join those which the report lists; of these the `stale` go.
    pub(crate) fn beside(out: Destination<'_>, report: &str, stale: Vec<String>) -> Result<Self, Error> {
        Self::new(out, Guard::by_report(out, report), Stale::Named(stale))
    }

    /// Results that may replace what is listed elsewhere.
    pub(crate) fn over(out: Destination<'_>, listed: Listed) -> Result<Self, Error> {
        Self::new(out, Guard::by_list(out, listed), Stale::Named(Vec::new()))
    }

    /// Results that say themselves what wrote them.
    pub(crate) fn of_kind(out: Destination<'_>, kind: FileKind) -> Result<Self, Error> {
        Self::new(out, Guard::by_kind(out, kind), Stale::Named(Vec::new()))
    }

    fn new(out: Destination<'_>, guard: Guard, stale: Stale) -> Result<Self, Error> {
        Ok(Self { written: Vec::new(), folder: Folder::make(out.path)?, guard, stale })
    }

    /// Writes one file under a temporary name.
    pub(crate) fn add(
        &mut self,
        name: impl AsRef<OsStr>,
        fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
    ) -> Result<(), Error> {
        let path = self.folder.path.join(name.as_ref());
        let file = self.temporary(&path, fill)?;
        self.written.push((file, path));
        Ok(())
    }

    fn temporary(
        &self,
        path: &Path,
        fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
    ) -> Result<NamedTempFile, Error> {
        let wrap =
            |problem: String| Error::file(path, format!("cannot be written ({problem}); check space and permissions"));
        let mut file = temporary(&self.folder.path).map_err(|e| wrap(e.to_string()))?;
        let mut writer = BufWriter::new(file.as_file_mut());
        fill(&mut writer).map_err(wrap)?;
        writer.flush().map_err(|e| wrap(e.to_string()))?;
        drop(writer);
        Ok(file)
    }

    /// The names of the files so far.
    pub(crate) fn names(&self) -> Vec<String> {
        let names = self.written.iter().filter_map(|(_, path)| path.file_name());
        names.map(|name| name.to_string_lossy().into_owned()).collect()
    }

    /// Gives every file its name, and removes what of an earlier run is stale. Where one cannot have its name, those that
    /// already have theirs are removed again: results of two runs side by side would be worse than none.
    pub(crate) fn place(mut self) -> Result<(), Error> {
        self.written.iter().try_for_each(|(_, path)| self.guard.check(path))?;
        let stale = self.stale_files();
        let announced = self.announce()?;
        let mut placed = Vec::new();
        for (file, path) in std::mem::take(&mut self.written) {
            let replaces = path.exists();
            if let Err(e) = file.persist(&path) {
                placed.iter().for_each(|path: &PathBuf| drop(fs::remove_file(path)));
                self.withdraw(announced.as_deref());
                return Err(Error::file(&path, format!("cannot be replaced ({}); check permissions", e.error)));
            }
            if matches!(self.stale, Stale::Rest) || !replaces {
                placed.push(path);
            }
        }
        self.folder.made.clear();
        stale.iter().try_for_each(|file| remove_stale(file))
    }

    /// The files that go. What is no longer a file is none that was written here.
    fn stale_files(&self) -> Vec<PathBuf> {
        let written = self.names();
        let goes = |name: &&str| match &self.stale {
            Stale::Rest => !written.iter().any(|w| w == name),
            Stale::Named(names) => names.iter().any(|n| n == name),
        };
        let paths = self.guard.listed.files().filter(goes).map(|name| self.folder.path.join(name));
        paths.filter(|path| fs::symlink_metadata(path).is_ok_and(|found| found.is_file())).collect()
    }

    /// Puts in the place of the report, which stands for the whole, one that only lists all files, old and new: an earlier
    /// report must not stand beside half of the new results, and results must not be taken for strangers' if the program
    /// ends in between.
    fn announce(&self) -> Result<Option<PathBuf>, Error> {
        let (Stale::Rest, Some((_, report))) = (&self.stale, self.written.last()) else { return Ok(None) };
        let mut files: Vec<String> = self.guard.listed.files().map(String::from).collect();
        files.extend(self.names());
        let text = json!({ "version": env!("CARGO_PKG_VERSION"), UNFINISHED: true, "files": files });
        let file = self.temporary(report, |w| writeln!(w, "{text:#}").map_err(|e| e.to_string()))?;
        file.persist(report)
            .map_err(|e| Error::file(report, format!("cannot be replaced ({}); check permissions", e.error)))?;
        Ok(Some(report.clone()))
    }

    /// Removes the list again, unless files that it lists are left.
    fn withdraw(&self, announced: Option<&Path>) {
        let Some(report) = announced else { return };
        let mut listed = self.guard.listed.files().map(|name| self.folder.path.join(name));
        if !listed.any(|file| file != report && file.exists()) {
            // What cannot be removed stays: another failure is being told.
            drop(fs::remove_file(report));
        }
    }
}

/// Removes a result of an earlier run that this one has not replaced.
fn remove_stale(file: &Path) -> Result<(), Error> {
    match fs::remove_file(file) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::file(file, format!("is of an earlier run, and cannot be removed ({e})")))
        }
        _ => Ok(()),
    }
}

/// Writes one result into a folder, whole or not at all; the folder is made if it is missing.
///
/// # Errors
/// [`Error::File`].
pub fn write_named(out: Destination<'_>, name: &str, kind: FileKind, bytes: &[u8]) -> Result<(), Error> {
    let mut staging = Staging::of_kind(out, kind)?;
    staging.add(name, |w| w.write_all(bytes).map_err(|e| e.to_string()))?;
    staging.place()
}

/// Removes the temporary files that this program, about to end at once, leaves in a folder of results, and the folder if
/// nothing else is in it.
pub fn remove_unfinished(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| is_temporary(&entry.file_name().to_string_lossy())) {
        // What cannot be removed stays: there is nobody to tell.
        let _ = fs::remove_file(entry.path());
    }
    let _ = fs::remove_dir(folder);
}

/// Whether a name is one of [`temporary`].
fn is_temporary(name: &str) -> bool {
    name.strip_prefix(&temporary_prefix())
        .is_some_and(|random| random.len() == RANDOM && random.chars().all(|c| c.is_ascii_alphanumeric()))
}

/// Characters that tell temporary files apart.
const RANDOM: usize = 6;

/// What the names of temporary files begin with, of this program while it runs and of no other.
fn temporary_prefix() -> String {
    format!(".parfocal-{}-", std::process::id())
}

/// A temporary file that becomes as readable as any other file when it gets its name.
fn temporary(folder: &Path) -> std::io::Result<NamedTempFile> {
    let prefix = temporary_prefix();
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

    fn anew(out: &Path) -> Result<Staging, Error> {
        Staging::anew(out.into(), "report.json")
    }

    #[test]
    fn nothing_is_left_of_a_failure() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("a/b");
        let mut staging = anew(&out).unwrap();
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
        let mut staging = Staging::anew(Destination::new(base.path(), true), "report.json").unwrap();
        for name in ["one", "two"] {
            staging.add(name, |w| w.write_all(b"new").map_err(|e| e.to_string())).unwrap();
        }
        assert!(staging.place().unwrap_err().to_string().contains("two: is a folder"));
        assert_eq!(fs::read(base.path().join("one")).unwrap(), b"old");
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 2);
    }

    fn written(out: &Path, report: &str, names: &[&str]) -> Result<(), String> {
        let mut staging = Staging::anew(out.into(), report).unwrap();
        for name in names {
            staging.add(name, |w| w.write_all(b"new").map_err(|e| e.to_string())).unwrap();
        }
        let text = json!({ "transform": {}, "nearer": 1, "files": names });
        staging.add(report, |w| write!(w, "{text}").map_err(|e| e.to_string())).unwrap();
        staging.place().map_err(|e| e.to_string())
    }

    fn names_in(folder: &Path) -> Vec<String> {
        let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    #[test]
    fn what_the_earlier_report_lists_goes_and_nothing_else() {
        let base = TempDir::new().unwrap();
        fs::write(base.path().join("notes"), "mine").unwrap();
        written(base.path(), "report.json", &["a", "b"]).unwrap();
        written(base.path(), "report.json", &["b", "c"]).unwrap();
        assert_eq!(names_in(base.path()), ["b", "c", "notes", "report.json"]);
        let refused = written(base.path(), "report.json", &["b", "notes"]).unwrap_err();
        assert!(refused.contains("notes: is there already") && refused.contains("--force"), "{refused}");
        assert_eq!(fs::read(base.path().join("notes")).unwrap(), b"mine");
        assert_eq!(names_in(base.path()), ["b", "c", "notes", "report.json"]);
        assert!(written(base.path(), "truth.json", &["b"]).is_err(), "the results of another report");
    }

    #[test]
    fn a_program_that_ends_while_results_get_their_names_leaves_none_for_a_strangers() {
        let base = TempDir::new().unwrap();
        written(base.path(), "report.json", &["a"]).unwrap();
        let mut staging = anew(base.path()).unwrap();
        for name in ["b", "report.json"] {
            staging.add(name, |_| Ok(())).unwrap();
        }
        staging.announce().unwrap();
        fs::write(base.path().join("b"), "half").unwrap();
        drop(staging);
        written(base.path(), "report.json", &["b"]).unwrap();
        assert_eq!(names_in(base.path()), ["b", "report.json"]);
    }

    #[test]
    fn what_is_half_written_is_known_by_its_name_and_removed() {
        let base = TempDir::new().unwrap();
        let made = base.path().join("made");
        for (folder, names) in [(base.path(), &["old.png", ".report.json.backup"][..]), (&made, &[])] {
            let mut staging = anew(folder).unwrap();
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
        let Err(error) = anew(&out) else { panic!("made a folder over a file") };
        assert!(error.to_string().contains("is a file"), "{error}");
        assert!(anew(&out.join("below")).is_err());
        assert!(out.is_file());
    }

    #[cfg(unix)]
    #[test]
    fn results_are_as_readable_as_other_files() {
        use std::os::unix::fs::PermissionsExt;
        let base = TempDir::new().unwrap();
        let mut staging = anew(base.path()).unwrap();
        staging.add("one", |_| Ok(())).unwrap();
        staging.place().unwrap();
        fs::write(base.path().join("other"), "x").unwrap();
        let mode = |name| fs::metadata(base.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("one"), mode("other"));
    }
}
