//! Writes a file that the user names: replaces a regular file atomically, writes to a device or a pipe.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use super::destination::{Destination, FileKind, Guard, check_writable};
use super::staging::Staging;
use crate::base::Error;

/// Greatest number of symbolic links that are followed, as in the kernel.
const MAX_LINKS: usize = 40;

/// The target of a path.
enum Target {
    /// A regular file at the end of all symbolic links. It may be missing. It is replaced.
    File(PathBuf),
    /// A stream. It is written to.
    Stream(Stream),
}

enum Stream {
    Stdout,
    Stderr,
    /// A device, a pipe, or a file that another program has open.
    Other(PathBuf),
}

/// Writes one file atomically. Creates its folder if it is missing. Replaces the file at the end of a symbolic link;
/// writes to devices and pipes.
pub(crate) fn write_file(
    out: Destination<'_>,
    kind: FileKind,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
) -> Result<(), Error> {
    let path = match target(out.path)? {
        Target::File(path) => path,
        Target::Stream(stream) => return write_through(out.path, stream, fill),
    };
    let (folder, name) = split(&path)?;
    let mut staging = Staging::of_kind(out.to(folder), kind)?;
    staging.add(name, fill)?;
    staging.place()
}

impl Destination<'_> {
    /// Checks that a file can be written, and that an existing file was written by parfocal.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn check_file(&self, kind: FileKind) -> Result<(), Error> {
        let Target::File(path) = target(self.path)? else { return Ok(()) };
        let (folder, _) = split(&path)?;
        Guard::by_kind(self.to(folder), kind).check(&path)?;
        check_writable(&path)
    }
}

fn split(path: &Path) -> Result<(&Path, &std::ffi::OsStr), Error> {
    let Some(name) = path.file_name() else {
        return Err(Error::file(path, "is not the name of a file; give one"));
    };
    Ok((path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")), name))
}

fn target(path: &Path) -> Result<Target, Error> {
    if let Some(stream) = open_already(path) {
        return Ok(Target::Stream(stream));
    }
    let is_link = fs::symlink_metadata(path).is_ok_and(|found| found.is_symlink());
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => Err(Error::file(path, "is a folder; give a file")),
        Ok(found) if !found.is_file() => Ok(Target::Stream(Stream::Other(path.to_path_buf()))),
        Ok(_) if is_link => fs::canonicalize(path)
            .map(Target::File)
            .map_err(|e| Error::file(path, format!("is a symbolic link that cannot be followed ({e}); remove it"))),
        Err(_) if is_link => Err(Error::file(path, "is a symbolic link that leads nowhere; remove it")),
        // Creating the file reports any other problem.
        _ => Ok(Target::File(path.to_path_buf())),
    }
}

/// The open file, of this or another program, that a name like /dev/stdout refers to. It may be a regular file that
/// must not be replaced.
fn open_already(path: &Path) -> Option<Stream> {
    let mut at = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        let folder = at.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = fs::canonicalize(folder).ok()?;
        let of_programs = folder.starts_with("/proc") && folder.ends_with("fd");
        if of_programs || folder == Path::new("/dev/fd") {
            let own = [format!("/proc/{}/fd", std::process::id()), "/dev/fd".to_string()];
            let is_own = own.iter().any(|own| folder == Path::new(own));
            return match at.file_name()?.to_str()? {
                "1" if is_own => Some(Stream::Stdout),
                "2" if is_own => Some(Stream::Stderr),
                _ => Some(Stream::Other(path.to_path_buf())),
            };
        }
        at = folder.join(fs::read_link(&at).ok()?);
    }
    None
}

/// Writes to a stream after the content is complete.
fn write_through(
    path: &Path,
    stream: Stream,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), String>,
) -> Result<(), Error> {
    let wrap = |problem: String| Error::file(path, format!("cannot be written ({problem}); check what it leads to"));
    // Some encoders seek, which a pipe cannot.
    let mut whole = tempfile::tempfile().map_err(|e| wrap(e.to_string()))?;
    let mut writer = BufWriter::new(&mut whole);
    fill(&mut writer).map_err(wrap)?;
    writer.flush().map_err(|e| wrap(e.to_string()))?;
    drop(writer);
    let copied = whole.rewind().and_then(|()| match stream {
        Stream::Stdout => io::copy(&mut whole, &mut io::stdout().lock()).and_then(|_| io::stdout().flush()),
        Stream::Stderr => io::copy(&mut whole, &mut io::stderr().lock()).map(drop),
        Stream::Other(path) => {
            // A file that another program has open keeps its content.
            let append = path.is_file();
            let mut open = OpenOptions::new().write(true).append(append).open(path)?;
            io::copy(&mut whole, &mut open).and_then(|_| open.flush())
        }
    });
    match copied {
        // The reader has closed its end.
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(wrap(e.to_string())),
        _ => Ok(()),
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::{FileTypeExt, symlink};

    use super::*;

    #[test]
    fn a_device_behind_a_link_is_written_to() {
        let base = tempfile::TempDir::new().unwrap();
        // The test uses a link, so that an error cannot replace a device.
        let null = base.path().join("null");
        symlink("/dev/null", &null).unwrap();
        let kind = FileKind::Lens;
        let out = Destination::from(&null);
        out.check_file(kind).unwrap();
        write_file(out, kind, |w| w.write_all(b"{}").map_err(|e| e.to_string())).unwrap();
        assert!(fs::metadata(&null).unwrap().file_type().is_char_device());
    }

    #[test]
    fn standard_streams_are_recognized() {
        assert!(matches!(open_already(Path::new("/dev/stdout")), Some(Stream::Stdout)));
        assert!(matches!(open_already(Path::new("/dev/stderr")), Some(Stream::Stderr)));
        assert!(open_already(Path::new("/dev/null")).is_none());
    }
}
