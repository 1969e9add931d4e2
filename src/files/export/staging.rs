//! Files that appear together: written under temporary names, renamed at the end.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::destination::{Destination, Guard};
use super::folder::{Folder, Writers};
use super::hashes::{Hash, Hashes};
use super::journal::{Journal, look};
use super::kind::FileKind;
use super::listed::Unfinished;
use super::temporary;
use crate::base::Error;

/// A folder and the files that are about to appear in it. Dropped before [`place`](Staging::place) has succeeded, it
/// leaves nothing behind.
pub(crate) struct Staging {
    // Fields drop in this order: the temporary files go before the folder that holds them.
    written: Vec<(NamedTempFile, PathBuf)>,
    folder: Folder,
    guard: Guard,
    hashes: Hashes,
    /// What stands for the whole, where anything does.
    report: Option<String>,
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
        Self::of_report(out, report, Stale::Rest)
    }

    /// Results that join those which the report lists; of these the `stale` go.
    pub(crate) fn beside(out: Destination<'_>, report: &str, stale: Vec<String>) -> Result<Self, Error> {
        Self::of_report(out, report, Stale::Named(stale))
    }

    /// Results that say themselves what wrote them.
    pub(crate) fn of_kind(out: Destination<'_>, kind: FileKind) -> Result<Self, Error> {
        let folder = Folder::make(out.path, Writers::Many)?;
        Ok(Self::new(folder, Guard::by_kind(out, kind), None, Stale::Named(Vec::new())))
    }

    fn of_report(out: Destination<'_>, report: &str, stale: Stale) -> Result<Self, Error> {
        let folder = Folder::make(out.path, Writers::One)?;
        Journal::recover(out.path, report).map_err(|e| {
            let problem = format!("holds results that were not finished, and cannot be brought in order ({e})");
            Error::file(out.path, format!("{problem}; check permissions"))
        })?;
        Ok(Self::new(folder, Guard::by_report(out, report), Some(report.to_string()), stale))
    }

    fn new(folder: Folder, guard: Guard, report: Option<String>, stale: Stale) -> Self {
        Self { written: Vec::new(), folder, guard, hashes: Hashes::new(), report, stale }
    }

    /// Writes one file under a temporary name.
    pub(crate) fn add(
        &mut self,
        name: impl AsRef<OsStr>,
        fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
    ) -> Result<(), Error> {
        let path = self.folder.path.join(name.as_ref());
        let mut file = self.temporary(&path, fill)?;
        if self.report.is_some() {
            let hash = file.rewind().and_then(|()| Hash::of(&mut file)).map_err(|e| {
                Error::file(&path, format!("cannot be read again once it is written ({e}); check the disk"))
            })?;
            self.hashes.insert(name.as_ref().to_string_lossy().into_owned(), hash);
        }
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
        let mut file = temporary::file(&self.folder.path).map_err(|e| wrap(e.to_string()))?;
        let mut writer = BufWriter::new(file.as_file_mut());
        fill(&mut writer).map_err(wrap)?;
        writer.flush().map_err(|e| wrap(e.to_string()))?;
        drop(writer);
        // A name that is on the disk before what it names would outlast a power cut as an empty file.
        file.as_file().sync_all().map_err(|e| wrap(e.to_string()))?;
        Ok(file)
    }

    /// The names of the files so far.
    pub(crate) fn names(&self) -> Vec<String> {
        let names = self.written.iter().filter_map(|(_, path)| path.file_name());
        names.map(|name| name.to_string_lossy().into_owned()).collect()
    }

    /// What they hold, for the report.
    pub(super) fn hashes(&self) -> Hashes {
        self.hashes.clone()
    }

    /// Gives every file its name, and removes what of an earlier run is stale. Where that fails the earlier results stand as
    /// they did: results of two runs side by side would be worse than none.
    pub(crate) fn place(mut self) -> Result<(), Error> {
        self.written.iter().try_for_each(|(_, path)| self.guard.check(path))?;
        let _uninterrupted = temporary::naming();
        match self.report.clone().filter(|report| self.written.iter().any(|(_, path)| path.ends_with(report))) {
            Some(report) => self.exchange(&report)?,
            None => self.rename()?,
        }
        self.folder.keep();
        Ok(())
    }

    /// Each file as it is: none belongs to another.
    fn rename(&mut self) -> Result<(), Error> {
        let mut new = Vec::new();
        for (file, path) in std::mem::take(&mut self.written) {
            let is_new = look(&path).is_ok_and(|found| found.is_none());
            if let Err(e) = file.persist(&path) {
                new.iter().for_each(|path: &PathBuf| drop(fs::remove_file(path)));
                return Err(self.cannot_be_replaced(&path, &e.error));
            }
            if is_new {
                new.push(path);
            }
        }
        // What a power cut would lose is known to be written, or no longer.
        let _ = self.folder.sync();
        Ok(())
    }

    /// All of them, and what goes, for what there was.
    fn exchange(&mut self, report: &str) -> Result<(), Error> {
        let at = self.folder.path.join(report);
        let journal = Journal::begin(&self.folder.path, report).map_err(|e| self.cannot_be_replaced(&at, &e))?;
        let Err((path, error)) = self.exchange_by(&journal, &at) else {
            // What cannot be removed now the next run removes.
            let _ = journal.finish();
            return Ok(());
        };
        let failed = self.cannot_be_replaced(&path, &error);
        let Err(e) = journal.roll_back() else { return Err(failed) };
        let problem = format!("and the earlier results come back with the next run, for they could not now ({e})");
        Err(Error::file(&path, format!("cannot be replaced ({error}); check the disk, {problem}")))
    }

    fn exchange_by(&mut self, journal: &Journal, report: &Path) -> Result<(), (PathBuf, io::Error)> {
        let stale = self.stale_files()?;
        let folder = self.folder.path.clone();
        let of = |path: &Path| {
            let path = path.to_path_buf();
            move |e| (path, e)
        };
        self.announce(journal, report).map_err(of(report))?;
        self.folder.sync().map_err(of(&folder))?;
        let (last, rest): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.written).into_iter().partition(|(_, path)| path == report);
        for path in stale.iter().chain(rest.iter().map(|(_, path)| path)) {
            journal.set_aside(path.file_name().unwrap_or_default()).map_err(of(path))?;
        }
        for (file, path) in rest {
            journal.name(file, &path).map_err(|e| (path, e))?;
        }
        self.folder.sync().map_err(of(&folder))?;
        for (file, path) in last {
            journal.name(file, &path).map_err(|e| (path, e))?;
        }
        // The results stand, and the disk has been asked.
        let _ = self.folder.sync();
        Ok(())
    }

    fn cannot_be_replaced(&self, path: &Path, error: &io::Error) -> Error {
        Error::file(path, format!("cannot be replaced ({error}); check permissions"))
    }

    /// The files that go. What is no longer a file is none that was written here; of what cannot be told, nobody knows.
    fn stale_files(&self) -> Result<Vec<PathBuf>, (PathBuf, io::Error)> {
        let written = self.names();
        let goes = |name: &&str| match &self.stale {
            Stale::Rest => !written.iter().any(|w| w == name),
            Stale::Named(names) => names.iter().any(|n| n == name),
        };
        let paths = self.guard.listed.files().filter(goes).map(|name| self.folder.path.join(name));
        let is_file = |path: PathBuf| match look(&path) {
            Ok(found) => found.filter(Metadata::is_file).map(|_| Ok(path)),
            Err(e) => Some(Err((path, e))),
        };
        paths.filter_map(is_file).collect()
    }

    /// Puts in the place of the report, which stands for the whole, the list of all files, old and new.
    fn announce(&self, journal: &Journal, report: &Path) -> io::Result<()> {
        let names = self.names();
        let mut new = Vec::new();
        for name in &names {
            if look(&self.folder.path.join(name))?.is_none() {
                new.push(name.clone());
            }
        }
        let files = self.guard.listed.files().map(String::from).chain(names).collect();
        let mut file = temporary::file(&self.folder.path)?;
        file.write_all(Unfinished { files, new }.text().as_bytes())?;
        file.as_file().sync_all()?;
        journal.name(file, report)
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

#[cfg(test)]
mod tests {
    use serde_json::json;
    use tempfile::TempDir;

    use super::super::journal::fault;
    use super::*;

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
        let mut staging = Staging::anew(out.into(), report).map_err(|e| e.to_string())?;
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

    /// What is in a folder.
    fn contents(folder: &Path) -> Vec<(String, String)> {
        let names = names_in(folder).into_iter();
        names.map(|name| (name.clone(), fs::read_to_string(folder.join(name)).unwrap())).collect()
    }

    /// A folder with results, one of which the next have no more, and a file of the user's.
    fn with_results() -> (TempDir, Vec<(String, String)>) {
        let base = TempDir::new().unwrap();
        fs::write(base.path().join("notes"), "mine").unwrap();
        written(base.path(), "report.json", &["a", "b"]).unwrap();
        for name in ["a", "b"] {
            fs::write(base.path().join(name), "old").unwrap();
        }
        let earlier = contents(base.path());
        (base, earlier)
    }

    /// How many steps it takes to write others, and what there is then.
    fn steps_to_new() -> (usize, Vec<(String, String)>) {
        let (base, _) = with_results();
        fault::at(0..0);
        written(base.path(), "report.json", &["b", "c"]).unwrap();
        let (steps, new) = (fault::at(0..0), contents(base.path()));
        assert!(steps > 16 && new.len() == 4, "{steps} {new:?}");
        (steps, new)
    }

    #[test]
    fn a_disk_that_fails_anywhere_leaves_the_earlier_results_or_the_new() {
        let (steps, new) = steps_to_new();
        for n in 0..steps {
            // Once: the earlier results come back.
            let (base, earlier) = with_results();
            fault::at(n..n + 1);
            let stands = written(base.path(), "report.json", &["b", "c"]);
            fault::at(0..0);
            drop(anew(base.path()).unwrap());
            assert_eq!(
                contents(base.path()),
                if stands.is_ok() { new.clone() } else { earlier },
                "once at {n}: {stands:?}"
            );

            // For good, as where the program is killed: the next run brings one or the other back.
            let (base, earlier) = with_results();
            fault::at(n..usize::MAX);
            let stands = written(base.path(), "report.json", &["b", "c"]);
            fault::at(0..0);
            drop(anew(base.path()).unwrap());
            let found = contents(base.path());
            assert_eq!(found, if stands.is_ok() { new.clone() } else { earlier }, "for good at {n}: {stands:?}");
        }
    }

    #[test]
    fn a_recovery_that_fails_is_made_up_for_by_the_next() {
        let (steps, new) = steps_to_new();
        for (begun, n) in (0..steps).flat_map(|begun| (0..12).map(move |n| (begun, n))) {
            let (base, earlier) = with_results();
            fault::at(begun..usize::MAX);
            let stands = written(base.path(), "report.json", &["b", "c"]).is_ok();
            fault::at(n..n + 1);
            let recovered = anew(base.path()).is_ok();
            fault::at(0..0);
            drop(anew(base.path()).unwrap());
            assert_eq!(contents(base.path()), if stands { &new } else { &earlier }[..], "{begun} {n} {recovered}");
        }
    }

    #[test]
    fn what_is_half_written_goes_and_nothing_of_the_users() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("made/out");
        let mut staging = anew(&out).unwrap();
        staging.add("depth.png", |_| Ok(())).unwrap();
        fs::write(out.join(".report.json.backup"), "mine").unwrap();
        // As where the program ends at once.
        std::mem::forget(staging);
        drop(anew(base.path()).unwrap());
        assert_eq!(names_in(&out).len(), 2, "of another folder");
        temporary::remove_leftovers(&out);
        assert_eq!(names_in(&out), [".report.json.backup"]);
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
