//! Writes files atomically: under temporary names that are renamed at the end, all of them or none.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;
use tempfile::NamedTempFile;

use super::destination::{Destination, FileKind, Guard};
use super::folder::{Folder, OtherWriters, naming, persist, temporary_file};
use super::journal::{Journal, Unfinished, metadata};
use super::report::write_json_to;
use crate::base::{Error, workers};
use crate::files::bounded_read::{Hash, Hashes};

/// A folder and the files that are being written into it. Dropping it before [`place`](Staging::place) succeeds removes
/// the files.
pub(crate) struct Staging {
    // Fields drop in this order: the temporary files before the folder that holds them.
    written: Vec<(NamedTempFile, PathBuf)>,
    folder: Folder,
    guard: Guard,
    hashes: Hashes,
    /// Name of the report, if there is one.
    report: Option<String>,
    /// Files of earlier results that are removed.
    stale: Stale,
}

/// The files that a report lists, and their hashes.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ListedFiles {
    files: Vec<String>,
    hashes: Hashes,
}

/// Writes the content of a file. An error is a phrase that fits into "cannot be written (...)".
pub(crate) trait Content: FnOnce(&mut BufWriter<&mut File>) -> Result<(), String> {}

impl<F: FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>> Content for F {}

/// A file under a temporary name, its final path, and its size and hash if a report lists them.
type Written = (NamedTempFile, PathBuf, Option<Hash>);

/// Files of earlier results that are removed when the new files get their names.
enum Stale {
    /// Files that the report lists and that are not written again.
    Rest,
    /// These files, if the report lists them.
    Named(Vec<String>),
}

impl Staging {
    /// Begins results that replace those that the report of this name lists. The report is [`add`](Self::add)ed last
    /// and lists its `files`. Creates the folder if it is missing.
    pub(crate) fn replacing(out: Destination<'_>, report: &str) -> Result<Self, Error> {
        Self::of_report(out, report, Stale::Rest)
    }

    /// Begins results that are added to those that the report lists. Removes the `stale` ones of the listed files.
    pub(crate) fn joining(out: Destination<'_>, report: &str, stale: Vec<String>) -> Result<Self, Error> {
        Self::of_report(out, report, Stale::Named(stale))
    }

    /// Begins files of a kind that no report lists. Their content states that parfocal wrote them.
    pub(crate) fn of_kind(out: Destination<'_>, kind: FileKind) -> Result<Self, Error> {
        let folder = Folder::make(out.path, OtherWriters::SingleFiles)?;
        Ok(Self::new(folder, Guard::by_kind(out, kind), None, Stale::Named(Vec::new())))
    }

    fn of_report(out: Destination<'_>, report: &str, stale: Stale) -> Result<Self, Error> {
        let folder = Folder::make(out.path, OtherWriters::None)?;
        Journal::recover(out.path, report).map_err(|e| {
            let problem = format!("holds incomplete results, and the earlier ones cannot be restored ({e})");
            Error::file(out.path, format!("{problem}; check permissions"))
        })?;
        Ok(Self::new(folder, Guard::by_report(out, report), Some(report.to_string()), stale))
    }

    fn new(folder: Folder, guard: Guard, report: Option<String>, stale: Stale) -> Self {
        Self { written: Vec::new(), folder, guard, hashes: Hashes::new(), report, stale }
    }

    /// Writes one file under a temporary name.
    pub(crate) fn add(&mut self, name: impl AsRef<OsStr>, content: impl Content) -> Result<(), Error> {
        let written = self.write(name.as_ref(), content)?;
        self.push(written);
        Ok(())
    }

    /// Writes files under temporary names, in parallel. The last one begins first. After a failure, no other file
    /// begins, and none is added.
    pub(crate) fn add_all<C: Content + Send>(
        &mut self,
        files: Vec<(impl AsRef<OsStr> + Send, C)>,
    ) -> Result<(), Error> {
        let mut written: Vec<Option<Result<Written, Error>>> = files.iter().map(|_| None).collect();
        let (staging, has_failed) = (&*self, AtomicBool::new(false));
        workers::for_each(files.into_iter().zip(&mut written).rev(), |((name, content), written)| {
            if !has_failed.load(Ordering::Relaxed) {
                let result = staging.write(name.as_ref(), content);
                has_failed.fetch_or(result.is_err(), Ordering::Relaxed);
                *written = Some(result);
            }
        });
        let written: Vec<Written> = written.into_iter().flatten().collect::<Result<_, _>>()?;
        written.into_iter().for_each(|written| self.push(written));
        Ok(())
    }

    fn push(&mut self, (file, path, hash): Written) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.hashes.extend(hash.map(|hash| (name, hash)));
        self.written.push((file, path));
    }

    fn write(&self, name: &OsStr, content: impl Content) -> Result<Written, Error> {
        let path = self.folder.path.join(name);
        let mut file = self.temporary(&path, content)?;
        let hash = self.report.is_some().then(|| file.rewind().and_then(|()| Hash::of(&mut file))).transpose();
        let hash = hash.map_err(|e| {
            Error::file(&path, format!("cannot be read again once it is written ({e}); check the disk"))
        })?;
        Ok((file, path, hash))
    }

    fn temporary(&self, path: &Path, content: impl Content) -> Result<NamedTempFile, Error> {
        let wrap =
            |problem: String| Error::file(path, format!("cannot be written ({problem}); check space and permissions"));
        let mut file = temporary_file(&self.folder.path).map_err(|e| wrap(e.to_string()))?;
        let mut writer = BufWriter::new(file.as_file_mut());
        content(&mut writer).map_err(wrap)?;
        writer.flush().map_err(|e| wrap(e.to_string()))?;
        drop(writer);
        // Without this, a power cut could leave an empty file under the name.
        file.as_file().sync_all().map_err(|e| wrap(e.to_string()))?;
        Ok(file)
    }

    /// Names of the files that were added.
    pub(crate) fn names(&self) -> Vec<String> {
        let names = self.written.iter().filter_map(|(_, path)| path.file_name());
        names.map(|name| name.to_string_lossy().into_owned()).collect()
    }

    /// Sizes and hashes of the files that were added.
    pub(super) fn hashes(&self) -> Hashes {
        self.hashes.clone()
    }

    /// Checks that all files may get their names.
    fn check(&self) -> Result<(), Error> {
        self.written.iter().try_for_each(|(_, path)| self.guard.check(path))
    }

    /// Renames all files and removes stale ones. On failure the earlier results stay: a mixture of two runs would be
    /// worse than none.
    pub(crate) fn place(mut self) -> Result<(), Error> {
        self.check()?;
        let _uninterrupted = naming();
        match self.report.clone().filter(|report| self.written.iter().any(|(_, path)| path.ends_with(report))) {
            Some(report) => self.exchange(&report)?,
            None => self.rename()?,
        }
        self.folder.keep();
        Ok(())
    }

    /// Writes the report that `of` makes from the list of all files, and renames all files.
    pub(super) fn place_with_report<R: Serialize>(
        mut self,
        name: &str,
        of: impl FnOnce(ListedFiles) -> R,
    ) -> Result<(), Error> {
        let files = self.names().into_iter().chain([name.to_string()]).collect();
        let report = of(ListedFiles { files, hashes: self.hashes() });
        self.add(name, |w| write_json_to(w, &report))?;
        self.place()
    }

    /// Renames each file separately.
    fn rename(&mut self) -> Result<(), Error> {
        let mut new = Vec::new();
        for (file, path) in std::mem::take(&mut self.written) {
            let is_new = metadata(&path).is_ok_and(|found| found.is_none());
            if let Err(e) = persist(file, &path) {
                new.iter().for_each(|path: &PathBuf| drop(fs::remove_file(path)));
                return Err(self.cannot_be_replaced(&path, &e));
            }
            if is_new {
                new.push(path);
            }
        }
        // The files exist; a failed sync cannot be undone.
        let _ = self.folder.sync();
        Ok(())
    }

    /// Replaces the earlier results by the new ones.
    fn exchange(&mut self, report: &str) -> Result<(), Error> {
        let at = self.folder.path.join(report);
        let journal = Journal::begin(&self.folder.path, report).map_err(|e| self.cannot_be_replaced(&at, &e))?;
        let Err((path, error)) = self.exchange_by(&journal, &at) else {
            // The next run removes what this run cannot remove.
            let _ = journal.finish();
            return Ok(());
        };
        let failed = self.cannot_be_replaced(&path, &error);
        let Err(e) = journal.roll_back() else { return Err(failed) };
        let problem = format!("the next run restores the earlier results, which failed now ({e})");
        Err(Error::file(&path, format!("cannot be replaced ({error}); check the disk; {problem}")))
    }

    fn exchange_by(&mut self, journal: &Journal, report: &Path) -> Result<(), (PathBuf, io::Error)> {
        let stale = self.stale_files()?;
        let folder = self.folder.path.clone();
        let of = |path: &Path| {
            let path = path.to_path_buf();
            move |e| (path, e)
        };
        self.write_list(journal, report).map_err(of(report))?;
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
        // The results are complete; a failed sync cannot be undone.
        let _ = self.folder.sync();
        Ok(())
    }

    fn cannot_be_replaced(&self, path: &Path, error: &io::Error) -> Error {
        // On Windows a file that another program has open cannot be renamed.
        let advice =
            if cfg!(windows) { "close programs that show it, and check permissions" } else { "check permissions" };
        Error::file(path, format!("cannot be replaced ({error}); {advice}"))
    }

    /// Stale files that exist.
    fn stale_files(&self) -> Result<Vec<PathBuf>, (PathBuf, io::Error)> {
        let written = self.names();
        let is_stale = |name: &&str| match &self.stale {
            Stale::Rest => !written.iter().any(|w| w == name),
            Stale::Named(names) => names.iter().any(|n| n == name),
        };
        let paths = self.guard.listed.iter().filter(is_stale).map(|name| self.folder.path.join(name));
        let is_file = |path: PathBuf| match metadata(&path) {
            Ok(found) => found.filter(Metadata::is_file).map(|_| Ok(path)),
            Err(e) => Some(Err((path, e))),
        };
        paths.filter_map(is_file).collect()
    }

    /// Replaces the report by the list of all earlier and new files.
    fn write_list(&self, journal: &Journal, report: &Path) -> io::Result<()> {
        let names = self.names();
        let mut new = Vec::new();
        for name in &names {
            if metadata(&self.folder.path.join(name))?.is_none() {
                new.push(name.clone());
            }
        }
        let files = self.guard.listed.iter().map(String::from).chain(names).collect();
        let mut file = temporary_file(&self.folder.path)?;
        file.write_all(Unfinished { files, new }.text().as_bytes())?;
        file.as_file().sync_all()?;
        journal.name(file, report)
    }
}

/// Writes files into a folder, each atomically; the folder is created if it is missing. All are complete under
/// temporary names before the first one gets its name. They get their names in the given order, one directly after the
/// other.
///
/// # Errors
/// [`Error::File`].
pub fn write_named(out: Destination<'_>, files: &[(&str, FileKind, &[u8])]) -> Result<(), Error> {
    let staged = files.iter().map(|&(name, kind, bytes)| {
        let mut staging = Staging::of_kind(out, kind)?;
        staging.add(name, |w| w.write_all(bytes).map_err(|e| e.to_string()))?;
        staging.check()?;
        Ok(staging)
    });
    let staged: Vec<Staging> = staged.collect::<Result<_, Error>>()?;
    staged.into_iter().try_for_each(Staging::place)
}

#[cfg(test)]
mod tests {
    use serde_json::json;
    use tempfile::TempDir;

    use super::super::journal::fault;
    use super::*;

    fn replacing(out: &Path) -> Result<Staging, Error> {
        Staging::replacing(out.into(), "report.json")
    }

    #[test]
    fn no_named_file_is_replaced_if_one_of_them_is_of_another_program() {
        let base = TempDir::new().unwrap();
        let out = base.path();
        let (first, last) = (br#"{"program": "parfocal", "kind": "batch"}"#, b"serial,time,judged,verdict,seconds");
        let write = |batch: &[u8], table: &[u8]| {
            let files = [("batch.json", FileKind::Batch, batch), ("verdicts.csv", FileKind::VerdictTable, table)];
            write_named(out.into(), &files)
        };
        write(first, last).unwrap();
        fs::write(out.join("verdicts.csv"), "mine").unwrap();
        assert!(write(b"new", last).unwrap_err().to_string().contains("verdicts.csv: is there already"));
        assert_eq!(fs::read(out.join("batch.json")).unwrap(), first);
        assert_eq!(fs::read_dir(out).unwrap().count(), 2);
    }

    #[test]
    fn a_failure_leaves_no_files() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("a/b");
        let mut staging = replacing(&out).unwrap();
        staging.add("one", |w| w.write_all(b"1").map_err(|e| e.to_string())).unwrap();
        assert!(staging.add("two", |_| Err("disk full".to_string())).unwrap_err().to_string().contains("disk full"));
        drop(staging);
        assert!(!base.path().join("a").exists());
    }

    #[test]
    fn files_of_one_call_keep_their_order_and_a_failure_among_them_is_named() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("new");
        let mut staging = replacing(&out).unwrap();
        let names: Vec<String> = (0..20).map(|n| format!("file-{n}")).collect();
        let files = |failing: Option<usize>| {
            let content = move |(n, name): (usize, &String)| {
                let text = format!("content {n}");
                let content = move |w: &mut BufWriter<&mut File>| match failing {
                    Some(k) if k == n => Err("disk full".to_string()),
                    _ => w.write_all(text.as_bytes()).map_err(|e| e.to_string()),
                };
                (name.clone(), content)
            };
            names.iter().enumerate().map(content).collect::<Vec<_>>()
        };
        let refused = staging.add_all(files(Some(7))).unwrap_err().to_string();
        assert!(refused.contains("file-7: cannot be written (disk full)"), "{refused}");
        assert_eq!((staging.names().len(), staging.hashes().len()), (0, 0));
        assert_eq!(names_in(&out).len(), 0, "a failure leaves no temporary file");
        staging.add_all(files(None)).unwrap();
        assert_eq!(staging.names(), names);
        assert_eq!(staging.hashes()["file-7"], Hash::of(&b"content 7"[..]).unwrap());
    }

    #[test]
    fn a_folder_with_the_name_of_a_result_prevents_all_files() {
        let base = TempDir::new().unwrap();
        fs::create_dir(base.path().join("two")).unwrap();
        fs::write(base.path().join("one"), "old").unwrap();
        let mut staging = Staging::replacing(Destination::new(base.path(), true), "report.json").unwrap();
        for name in ["one", "two"] {
            staging.add(name, |w| w.write_all(b"new").map_err(|e| e.to_string())).unwrap();
        }
        assert!(staging.place().unwrap_err().to_string().contains("two: is a folder"));
        assert_eq!(fs::read(base.path().join("one")).unwrap(), b"old");
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 2);
    }

    fn written(out: &Path, report: &str, names: &[&str]) -> Result<(), String> {
        let mut staging = Staging::replacing(out.into(), report).map_err(|e| e.to_string())?;
        for name in names {
            staging.add(name, |w| w.write_all(b"new").map_err(|e| e.to_string())).unwrap();
        }
        let text = json!({ "program": "parfocal", "kind": "pair", "files": names });
        staging.add(report, |w| write!(w, "{text}").map_err(|e| e.to_string())).unwrap();
        staging.place().map_err(|e| e.to_string())
    }

    fn names_in(folder: &Path) -> Vec<String> {
        let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    /// Names and contents of the files in a folder.
    fn contents(folder: &Path) -> Vec<(String, String)> {
        let names = names_in(folder).into_iter();
        names.map(|name| (name.clone(), fs::read_to_string(folder.join(name)).unwrap())).collect()
    }

    /// A folder with results and a file of the user. The next results lack one of the earlier files.
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

    /// Writes other results. Returns the number of steps, and the files afterwards.
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
            // A single failure: the earlier results are restored.
            let (base, earlier) = with_results();
            fault::at(n..n + 1);
            let stands = written(base.path(), "report.json", &["b", "c"]);
            fault::at(0..0);
            drop(replacing(base.path()).unwrap());
            assert_eq!(
                contents(base.path()),
                if stands.is_ok() { new.clone() } else { earlier },
                "once at {n}: {stands:?}"
            );

            // All steps fail from then on, as if the program were killed. The next run restores the earlier or the new
            // results.
            let (base, earlier) = with_results();
            fault::at(n..usize::MAX);
            let stands = written(base.path(), "report.json", &["b", "c"]);
            fault::at(0..0);
            drop(replacing(base.path()).unwrap());
            let found = contents(base.path());
            assert_eq!(found, if stands.is_ok() { new.clone() } else { earlier }, "for good at {n}: {stands:?}");
        }
    }

    #[test]
    fn the_next_recovery_completes_a_failed_one() {
        let (steps, new) = steps_to_new();
        for (begun, n) in (0..steps).flat_map(|begun| (0..12).map(move |n| (begun, n))) {
            let (base, earlier) = with_results();
            fault::at(begun..usize::MAX);
            let stands = written(base.path(), "report.json", &["b", "c"]).is_ok();
            fault::at(n..n + 1);
            let recovered = replacing(base.path()).is_ok();
            fault::at(0..0);
            drop(replacing(base.path()).unwrap());
            assert_eq!(contents(base.path()), if stands { &new } else { &earlier }[..], "{begun} {n} {recovered}");
        }
    }

    #[test]
    fn half_written_files_are_removed_and_files_of_users_stay() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("made/out");
        let mut staging = replacing(&out).unwrap();
        staging.add("depth.png", |_| Ok(())).unwrap();
        fs::write(out.join(".report.json.backup"), "mine").unwrap();
        // The program ends here.
        std::mem::forget(staging);
        drop(replacing(base.path()).unwrap());
        assert_eq!(names_in(&out).len(), 2, "of another folder");
        super::super::folder::remove_leftovers(&out);
        assert_eq!(names_in(&out), [".report.json.backup"]);
    }

    #[test]
    fn a_file_in_place_of_the_folder_is_named_in_the_error() {
        let base = TempDir::new().unwrap();
        let out = base.path().join("file");
        fs::write(&out, "x").unwrap();
        let Err(error) = replacing(&out) else { panic!("made a folder over a file") };
        assert!(error.to_string().contains("is a file"), "{error}");
        assert!(replacing(&out.join("below")).is_err());
        assert!(out.is_file());
    }

    #[cfg(unix)]
    #[test]
    fn results_have_the_permissions_of_other_files() {
        use std::os::unix::fs::PermissionsExt;
        let base = TempDir::new().unwrap();
        let mut staging = replacing(base.path()).unwrap();
        staging.add("one", |_| Ok(())).unwrap();
        staging.place().unwrap();
        fs::write(base.path().join("other"), "x").unwrap();
        let mode = |name| fs::metadata(base.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("one"), mode("other"));
    }
}
