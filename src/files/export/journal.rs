//! How results take the place of earlier ones so that the one or the other stand whole, whatever happens meanwhile.
//!
//! Earlier results step aside into a folder beside them, and the new ones take their names, the report last. In between, a
//! bare list of all files stands in the place of the report: by it the folder is known as unfinished, and nothing in it is
//! taken for a stranger's. The report is what decides: once it has its name, the new results stand; as long as the list
//! stands there, a failure, or the next program that writes, brings the earlier ones back. Files of others stay where they
//! are throughout, and the folder stays the same one, for whoever has it open.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::listed::Unfinished;

/// Earlier results of a folder, out of the way of new ones.
pub(super) struct Journal {
    folder: PathBuf,
    /// Where they are.
    aside: PathBuf,
    report: String,
}

impl Journal {
    /// Steps aside nothing yet; the report is copied, so that it is there until the list takes its place.
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

    /// Brings a folder in order in which a program was ended: the report says which results stand.
    pub(super) fn recover(folder: &Path, report: &str) -> io::Result<()> {
        let journal = Self::of(folder, report);
        if !look(&journal.aside)?.is_some_and(|found| found.is_dir()) {
            return Ok(());
        }
        let stands = look(&journal.report())?.is_some() && journal.unfinished()?.is_none();
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
        Unfinished::of(&self.report())
    }

    /// Moves a file out of the way, if it is there. The list must stand in the place of the report.
    pub(super) fn set_aside(&self, name: &OsStr) -> io::Result<()> {
        step()?;
        unless_missing(fs::rename(self.folder.join(name), self.aside.join(name)))
    }

    /// Gives a file its name, which nothing has now but for the report.
    pub(super) fn name(&self, file: NamedTempFile, path: &Path) -> io::Result<()> {
        step()?;
        file.persist(path).map(drop).map_err(|e| e.error)
    }

    /// The new results stand: the earlier ones go.
    pub(super) fn finish(self) -> io::Result<()> {
        step()?;
        fs::remove_dir_all(&self.aside)
    }

    /// The earlier results come back, and what is new goes.
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
        // The report is the last: until then the folder is known as unfinished.
        let earlier = self.aside.join(&self.report);
        let is_there = look(&earlier)?.is_some();
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

/// What there is of this name. Where the disk cannot say, neither can we: what is taken for missing is removed, or lost.
pub(super) fn look(path: &Path) -> io::Result<Option<Metadata>> {
    step()?;
    match fs::symlink_metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
        found => found.map(Some),
    }
}

/// Comes before each look at a folder and each change of it; a test makes it fail.
fn step() -> io::Result<()> {
    #[cfg(test)]
    fault::step()?;
    Ok(())
}

/// A disk that fails.
#[cfg(test)]
pub(super) mod fault {
    use std::cell::Cell;
    use std::io;
    use std::ops::Range;

    thread_local! {
        static STEPS: Cell<(usize, (usize, usize))> = const { Cell::new((0, (0, 0))) };
    }

    /// From now on these steps of this thread fail, counted from 0; of how many there have been before.
    pub fn at(steps: Range<usize>) -> usize {
        STEPS.replace((0, (steps.start, steps.end))).0
    }

    pub(super) fn step() -> io::Result<()> {
        let (count, (from, to)) = STEPS.get();
        STEPS.set((count + 1, (from, to)));
        if (from..to).contains(&count) { Err(io::Error::other("a fault of the test")) } else { Ok(()) }
    }
}
