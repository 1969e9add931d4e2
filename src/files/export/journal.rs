//! Replaces earlier results by new ones so that a failure at any time leaves one or the other complete.
//!
//! Earlier results are moved into a folder next to them. Then the new files get their names, the report last. Meanwhile
//! a list of all files replaces the report and marks the folder as unfinished. Once the report has its name, the new
//! results are valid. As long as the list is in its place, a failure, or the next program that writes, restores the
//! earlier results. Files of other programs stay in place, and so does the folder, for processes that have it open.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tempfile::NamedTempFile;

use super::folder::persist;
use super::report::{MAX_BYTES, PROGRAM, is_plain, strings};
use crate::files::bounded_read;

/// Key of the list that takes the place of a report.
const UNFINISHED: &str = "unfinished";

/// The list of files that takes the place of a report while results are renamed.
#[derive(Default)]
pub(super) struct Unfinished {
    /// All files of earlier and of new results.
    pub(super) files: Vec<String>,
    /// Files that did not exist before.
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

    /// Reads the list in the place of this report, if there is one. A file that cannot be read is an error, since it
    /// may be the list.
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

/// Earlier results of a folder, moved aside for new ones.
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
            // Windows syncs a file only if it is open for writing.
            Ok(_) => File::options().read(true).write(cfg!(windows)).open(journal.aside.join(report))?.sync_all()?,
            Err(e) if e.kind() == ErrorKind::NotFound => (),
            Err(e) => {
                fs::remove_dir_all(&journal.aside)?;
                return Err(e);
            }
        }
        Ok(journal)
    }

    /// Recovers a folder after a program was ended while it wrote: the report decides which results are valid.
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

    /// Reads the list, if it is in the place of the report.
    fn unfinished(&self) -> io::Result<Option<Unfinished>> {
        step()?;
        Unfinished::read(&self.report())
    }

    /// Moves a file aside, if it exists. The list must be in the place of the report.
    pub(super) fn set_aside(&self, name: &OsStr) -> io::Result<()> {
        step()?;
        unless_missing(fs::rename(self.folder.join(name), self.aside.join(name)))
    }

    /// Renames a file to its final name. Only the report may already exist under that name.
    pub(super) fn name(&self, file: NamedTempFile, path: &Path) -> io::Result<()> {
        step()?;
        persist(file, path)
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

/// Metadata of a file or a link; `None` if it is missing. Other errors are returned: a file that was assumed missing
/// would be lost.
pub(super) fn metadata(path: &Path) -> io::Result<Option<Metadata>> {
    step()?;
    match fs::symlink_metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// Called before each access to a folder. Tests make it fail.
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

    /// Makes these steps of this thread fail, counted from 0 from now on. Returns the number of steps since the last
    /// call.
    pub fn at(steps: Range<usize>) -> usize {
        STEPS.replace((0, (steps.start, steps.end))).0
    }

    pub(super) fn step() -> io::Result<()> {
        let (count, (from, to)) = STEPS.get();
        STEPS.set((count + 1, (from, to)));
        if (from..to).contains(&count) { Err(io::Error::other("a fault of the test")) } else { Ok(()) }
    }
}
