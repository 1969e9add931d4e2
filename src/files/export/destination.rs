//! Where results go, and what may be replaced there.

use std::io::ErrorKind;
use std::path::Path;

use super::journal::look;
use super::kind::FileKind;
use super::listed::Listed;
use crate::base::Error;

/// A folder or a file for results. What lies there already is replaced only where parfocal wrote it, unless that is forced.
///
/// ```
/// use std::path::Path;
///
/// use parfocal::export::Destination;
///
/// let careful: Destination = Path::new("out").into();
/// let forced = Destination::new(Path::new("out"), true);
/// # let _ = (careful, forced);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Destination<'a> {
    pub(crate) path: &'a Path,
    pub(crate) force: bool,
}

impl<'a, P: AsRef<Path> + ?Sized> From<&'a P> for Destination<'a> {
    fn from(path: &'a P) -> Self {
        Self::new(path.as_ref(), false)
    }
}

impl<'a> Destination<'a> {
    /// With `force`, files of other programs that have the names of results are overwritten.
    pub fn new(path: &'a Path, force: bool) -> Self {
        Self { path, force }
    }

    /// The folder or the file.
    pub fn path(&self) -> &'a Path {
        self.path
    }

    /// The same for something within or beside it.
    pub(crate) fn to<'b>(&self, path: &'b Path) -> Destination<'b> {
        Destination { path, force: self.force }
    }

    /// Refuses a folder in which one of the results `names` cannot have its place: what is there is none of the files that
    /// the earlier report of this name lists.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_results<S: AsRef<str>>(&self, report: &str, names: &[S]) -> Result<(), Error> {
        let guard = Guard::by_report(*self, report);
        names.iter().try_for_each(|name| guard.check(&self.path.join(name.as_ref())))
    }

    /// The same for results in a folder without a report, each of which says itself that parfocal wrote it.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_named<S: AsRef<str>>(&self, kind: FileKind, names: &[S]) -> Result<(), Error> {
        let guard = Guard::by_kind(*self, kind);
        names.iter().try_for_each(|name| guard.check(&self.path.join(name.as_ref())))
    }
}

/// Refuses a file or folder that cannot be made.
///
/// # Errors
/// [`Error::File`].
pub fn check_writable(out: &Path) -> Result<(), Error> {
    // The folder, or the nearest above it that there is, must take a file.
    let above = out.ancestors().find(|p| p.is_dir()).filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::tempfile_in(above)
        .map(drop)
        .map_err(|e| Error::file(out, format!("cannot be written ({}); give another folder", e.kind())))
}

/// Which of the files in a folder may be replaced.
pub(crate) struct Guard {
    /// What an earlier report says is its own.
    pub(super) listed: Listed,
    /// What says of itself that it is a result, where no report does.
    kind: Option<FileKind>,
    force: bool,
}

impl Guard {
    /// What the report lists.
    pub(crate) fn by_report(out: Destination<'_>, report: &str) -> Self {
        Self::by_list(out, Listed::of(out.path, report))
    }

    /// What a list holds.
    pub(crate) fn by_list(out: Destination<'_>, listed: Listed) -> Self {
        Self { listed, kind: None, force: out.force }
    }

    /// What states itself to be of this kind, and belongs to no report.
    pub(crate) fn by_kind(out: Destination<'_>, kind: FileKind) -> Self {
        Self { listed: Listed::of_any_report(out.path), kind: Some(kind), force: out.force }
    }

    /// Refuses a place that is taken by what must not be replaced.
    pub(crate) fn check(&self, path: &Path) -> Result<(), Error> {
        let found = match look(path) {
            Ok(Some(found)) => found,
            Ok(None) => return Ok(()),
            // There is no folder: making it tells.
            Err(e) if e.kind() == ErrorKind::NotADirectory => return Ok(()),
            Err(e) => return Err(Error::file(path, format!("cannot be looked at ({e}); check the disk"))),
        };
        let refuse = |problem: &str| Err(Error::file(path, problem));
        if path.is_dir() {
            return refuse("is a folder where a result should go; move it away");
        }
        if found.is_symlink() {
            return refuse("is a symbolic link where a result should go; remove it, or give another folder");
        }
        if !found.is_file() {
            return refuse("is a device or a pipe where a result should go; move it away, or give another folder");
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let of_a_report = self.listed.holds(&name);
        match self.kind {
            _ if self.force => Ok(()),
            Some(_) if of_a_report => refuse(
                "belongs to the results beside it, by their report; give another name, or overwrite it with --force",
            ),
            Some(kind) if kind.is_of(path) => Ok(()),
            None if of_a_report => Ok(()),
            Some(_) => refuse(
                "is there already, and is none that parfocal wrote; give another name, or overwrite it with --force",
            ),
            None => refuse(
                "is there already, and no report of parfocal in its folder lists it; give another folder, or overwrite it \
                 with --force",
            ),
        }
    }
}
