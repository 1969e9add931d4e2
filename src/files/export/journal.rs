//! Replaces earlier results by new ones so that one or the other exist whole, whatever happens meanwhile.
//!
//! Earlier results are moved into a folder beside them, and the new ones get their names, the report last. In between, a list
//! of all files stands in the place of the report: it marks the folder as unfinished. The report decides. Once it has its name, the
//! new results stand; while the list stands there, a failure, or the next program that writes, restores the earlier ones. Files of
//! other programs stay where they are, and the folder stays the same one for processes that have it open.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tempfile::NamedTempFile;

use super::report::{MAX_BYTES, PROGRAM, is_plain, strings};
use crate::files::bounded_read;

/// Key of the list that stands in the place of a report.
const UNFINISHED: &str = "unfinished";

/// The list of files that stands in the place of a report while results get their names.
#[derive(Default)]
pub(super) struct Unfinished {
    /// All files of earlier and of new results.
    pub(super) files: Vec<String>,
    /// Those that did not exist before.
    pub(super) new: Vec<String>,
}

impl Unfinished {
    pub(super) fn text(&self) -> String {
        let Self { files, new } = self;
        format!("{:#}\n", json!({ "program": PROGRAM, UNFINISHED: true, "files": files, "new": new }))
    }

    /// Whether a JSON file is such a list.
    pub(super) fn is(file: &Value) -> bool {
        file.get(UNFINISHED).is_some()
    }

    /// The list in the place of this report, if there is one. A file that cannot be read is an error, since it may be one.
    fn read(report: &Path) -> io::Result<Option<Self>> {
        let text = match bounded_read::text(report, MAX_BYTES) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
            text => text?,
        };
        let Ok(found) = serde_json::from_str::<Value>(&text) else { return Ok(None) };
        let names = |key: &str| strings(&found[key]).filter(|name| is_plain(name)).map(String::from).collect();
        Ok(Self::is(&found).then(|| Self { files: names("files"), new: names("new") }))
    }
}

/// Earlier results of a folder, moved out of the way of new ones.
pub(super) struct Journal {
    folder: PathBuf,
    /// The folder that they are moved into.
    aside: PathBuf,
    report: String,
}

impl Journal {
    /// Creates the folder and copies the report into it; the report itself stays until the list replaces it.
    pub(super) fn begin(folder: &Path, report: &str) -> io::Result<Self> {
        let journal = Self::of(folder, report);
        step()?;
        fs::create_dir(&journal.aside)?;
        match fs::copy(journal.report(), journal.aside.join(report)) {
            Ok(_) => File::open(journal.aside.join(report))?.sync_all()?,
            Err(e) if e.kind() == ErrorKind::NotFound => (),
            Err(e) => {
                fs::remove_dir_all(&journal.aside)?;
                return Err(e);
            }
        }
        Ok(journal)
    }

    /// Recovers a folder in which a program was ended: the report decides which results stand.
    pub(super) fn recover(folder: &Path, report: &str) -> io::Result<()> {
        let journal = Self::of(folder, report);
        if !metadata(&journal.aside)?.is_some_and(|found| found.is_dir()) {
            return Ok(());
        }
        let stands = metadata(&journal.report())?.is_some() && journal.unfinished()?.is_none();
        if stands { journal.finish() } else { journal.roll_back() }
    }

    fn of(folder: &Path, report: &str) -> Self {
        let aside = folder.join(format!(".parfocal-earlier-{report}"));
        Self { folder: folder.to_path_buf(), aside, report: report.to_string() }
    }

    fn report(&self) -> PathBuf {
        self.folder.join(&self.report)
    }

    /// The list, if it stands in the place of the report.
    fn unfinished(&self) -> io::Result<Option<Unfinished>> {
        step()?;
        Unfinished::read(&self.report())
    }

    /// Moves a file out of the way, if it exists. The list must stand in the place of the report.
    pub(super) fn set_aside(&self, name: &OsStr) -> io::Result<()> {
        step()?;
        unless_missing(fs::rename(self.folder.join(name), self.aside.join(name)))
    }

    /// Gives a file its name; only the report may exist under it.
    pub(super) fn name(&self, file: NamedTempFile, path: &Path) -> io::Result<()> {
        step()?;
        file.persist(path).map(drop).map_err(|e| e.error)
    }

    /// Removes the earlier results.
    pub(super) fn finish(self) -> io::Result<()> {
        step()?;
        fs::remove_dir_all(&self.aside)
    }

    /// Restores the earlier results and removes the new ones.
    pub(super) fn roll_back(self) -> io::Result<()> {
        for name in self.unfinished()?.unwrap_or_default().new {
            step()?;
            unless_missing(fs::remove_file(self.folder.join(name)))?;
        }
        for entry in fs::read_dir(&self.aside)? {
            let name = entry?.file_name();
            if name != self.report.as_str() {
                step()?;
                fs::rename(self.aside.join(&name), self.folder.join(&name))?;
            }
        }
        // The report comes last: until then the folder is marked as unfinished.
        let earlier = self.aside.join(&self.report);
        let is_there = metadata(&earlier)?.is_some();
        step()?;
        if is_there {
            fs::rename(&earlier, self.report())?
        } else {
            unless_missing(fs::remove_file(self.report()))?
        }
        step()?;
        fs::remove_dir(&self.aside)
    }
}

fn unless_missing(done: io::Result<()>) -> io::Result<()> {
    done.or_else(|e| if e.kind() == ErrorKind::NotFound { Ok(()) } else { Err(e) })
}

/// Metadata of a file or a link, `None` if it is missing. Other errors are returned, since a file taken for missing would be lost.
pub(super) fn metadata(path: &Path) -> io::Result<Option<Metadata>> {
    step()?;
    match fs::symlink_metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// Precedes each access to a folder; a test makes it fail.
fn step() -> io::Result<()> {
    #[cfg(test)]
    fault::step()?;
    Ok(())
}

/// Simulates a disk that fails.
#[cfg(test)]
pub(super) mod fault {
    use std::cell::Cell;
    use std::io;
    use std::ops::Range;

    thread_local! {
        static STEPS: Cell<(usize, (usize, usize))> = const { Cell::new((0, (0, 0))) };
    }

    /// Makes these steps of this thread fail, counted from 0 from now on. Returns the number of steps since the last call.
    pub fn at(steps: Range<usize>) -> usize {
        STEPS.replace((0, (steps.start, steps.end))).0
    }

    pub(super) fn step() -> io::Result<()> {
        let (count, (from, to)) = STEPS.get();
        STEPS.set((count + 1, (from, to)));
        if (from..to).contains(&count) { Err(io::Error::other("a fault of the test")) } else { Ok(()) }
    }
}
