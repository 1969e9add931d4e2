//! Checks of a photograph file before it is decoded: existence, size, and advice about problems.

use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::MAX_PIXELS;
use crate::files::bounded_read;

/// Advice for a damaged file.
pub(super) const DAMAGED: &str = "the file is damaged or incomplete; copy or save it again";

/// Advice for an unsupported format.
pub(super) const CONVERT: &str = "convert it to PNG, TIFF, JPEG, BMP, WebP, PNM, PFM or EXR; of a frame without a header state format and size (--raw)";

/// Similarity of file names (Jaro and Winkler) above which one may be a misspelling of the other.
const SIMILAR: f64 = 0.9;

/// Greatest number of bytes of a file that are read, 4 GiB: the limit of classic TIFF, and the size of the largest
/// picture with four floats per pixel.
const MAX_BYTES: u64 = 1 << 32;

/// Reads the whole of a regular file that is not empty.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, String> {
    let file = bounded_read::open(path).map_err(|e| match e.kind() {
        ErrorKind::NotFound => match similar_file(path) {
            Some(other) => format!("there is no such file; did you mean '{}'?", other.display()),
            None => "there is no such file; check the path".to_string(),
        },
        ErrorKind::PermissionDenied => "may not be read; check its permissions".to_string(),
        ErrorKind::InvalidInput if path.is_dir() => "is a folder; give the image file in it".to_string(),
        ErrorKind::InvalidInput => "is not a regular file; copy the image to a file on disk".to_string(),
        _ => format!("cannot be opened ({e})"),
    })?;
    let unreadable = |e: std::io::Error| format!("cannot be read ({e})");
    let stated = file.metadata().map_err(unreadable)?.len();
    let mut bytes = Vec::new();
    let too_large = |e| format!("is of {} bytes, for which there is no memory ({e}); reduce it", stated);
    bytes.try_reserve_exact(stated.min(MAX_BYTES) as usize).map_err(too_large)?;
    // The file may grow while it is read.
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    match bytes.len() as u64 {
        0 => Err("is empty; copy or save it again".to_string()),
        length if length > MAX_BYTES => {
            Err(format!("is larger than {MAX_BYTES} bytes, the most that is read; save its pages as files"))
        }
        _ => Ok(bytes),
    }
}

/// The file with the most similar name in the folder of a missing file, if one is similar.
pub fn similar_file(missing: &Path) -> Option<PathBuf> {
    let wanted = missing.file_name()?.to_str()?;
    let folder = missing.parent().filter(|p| !p.as_os_str().is_empty());
    let beside = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let scored = beside.filter_map(Result::ok).filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        let score = strsim::jaro_winkler(&wanted.to_lowercase(), &name.to_lowercase());
        (score > SIMILAR).then_some((score, name))
    });
    // Names of equal score are ordered, since folders list files in no fixed order.
    let (_, name) = scored.max_by(|a, b| a.0.total_cmp(&b.0).then_with(|| b.1.cmp(&a.1)))?;
    Some(folder.map_or_else(|| PathBuf::from(&name), |folder| folder.join(&name)))
}

/// Refuses images without pixels and images larger than [`MAX_PIXELS`].
pub(super) fn size((width, height): (u32, u32)) -> Result<(), String> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 {
        return Err(format!("is {width}x{height} and holds no pixels"));
    }
    if pixels > MAX_PIXELS {
        return Err(format!(
            "is {width}x{height}, {pixels} pixels, and the most that is read is {MAX_PIXELS}; crop or reduce it"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_greatest_size_is_allowed_and_one_row_more_is_not() {
        assert!(size((1 << 14, 1 << 14)).is_ok());
        let problem = size((1 << 14, (1 << 14) + 1)).unwrap_err();
        assert!(problem.contains("16384x16385") && problem.contains("268435456"), "{problem}");
        assert!(size((u32::MAX, u32::MAX)).is_err());
        assert!(size((0, 5)).is_err());
    }
}
