//! Whether results can be written, found out before any work is done; and small files, written whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::failure::Failure;

/// Refuses an output folder that cannot be one, or where one of `results` would replace one of `inputs`.
pub(super) fn check(out: &Path, results: &[&str], inputs: &[&PathBuf]) -> Result<(), Failure> {
    if out.exists() && !out.is_dir() {
        let folder = out.with_extension("");
        let hint = if folder.exists() { String::new() } else { format!(", '{}' say", folder.display()) };
        return Err(Failure::Failed(format!("{}: is a file; give a folder for the results{hint}", out.display())));
    }
    check_writable(out)?;
    for input in inputs {
        if let Some(name) = results.iter().find(|name| super::same_file(&out.join(name), input)) {
            let problem = format!("is an input, and the result {name} would replace it; give another folder");
            return Err(Failure::Failed(format!("{}: {problem}", input.display())));
        }
    }
    Ok(())
}

/// Refuses a file or folder that cannot be made.
pub(super) fn check_writable(out: &Path) -> Result<(), Failure> {
    // The folder, or the nearest above it that there is, must take a file.
    let above = out.ancestors().find(|p| p.is_dir()).filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::tempfile_in(above).map(|_| ()).map_err(|e| {
        Failure::Failed(format!("{}: cannot be written ({}); give another folder", out.display(), e.kind()))
    })
}

/// Writes a file under a temporary name and renames it.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let written = builder.tempfile_in(folder).and_then(|mut file| {
        file.write_all(bytes)?;
        file.persist(path).map(drop).map_err(std::io::Error::from)
    });
    written.map_err(|e| {
        Failure::Failed(format!("{}: cannot be written ({e}); check space and permissions", path.display()))
    })
}
