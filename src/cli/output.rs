//! Whether results can be written, found out before any work is done.

use std::path::{Path, PathBuf};

use super::failure::Failure;

/// Refuses an output folder that cannot be one, or where one of `results` would replace one of `inputs`.
pub(super) fn check(out: &Path, results: &[&str], inputs: &[&PathBuf]) -> Result<(), Failure> {
    if out.exists() && !out.is_dir() {
        return Err(Failure::Failed(format!("{}: is a file; give a folder for the results", out.display())));
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
