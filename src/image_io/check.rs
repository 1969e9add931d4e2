//! What is asked of a file before it is decoded.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek};
use std::path::Path;

use super::MAX_PIXELS;

/// What every damaged file is told.
pub(super) const DAMAGED: &str = "the file is damaged or incomplete; copy or save it again";

/// What every format that is not read is told.
pub(super) const CONVERT: &str = "convert it to PNG, TIFF, JPEG, PNM or EXR";

/// Opens a regular file that is not empty; also gives its first 4 bytes, zeros where there are fewer.
pub(super) fn open(path: &Path) -> Result<(File, [u8; 4]), String> {
    let mut file = File::open(path).map_err(|e| match e.kind() {
        ErrorKind::NotFound => "there is no such file; check the path".to_string(),
        ErrorKind::PermissionDenied => "may not be read; check its permissions".to_string(),
        _ => format!("cannot be opened ({e})"),
    })?;
    let unreadable = |e: std::io::Error| format!("cannot be read ({e})");
    let kind = file.metadata().map_err(unreadable)?;
    if kind.is_dir() {
        return Err("is a folder; give the image file in it".to_string());
    }
    if !kind.is_file() {
        return Err("is not a regular file; copy the image to a file on disk".to_string());
    }
    if kind.len() == 0 {
        return Err("is empty; copy or save it again".to_string());
    }
    let mut magic = [0; 4];
    let mut start = Vec::new();
    (&mut file).take(magic.len() as u64).read_to_end(&mut start).map_err(unreadable)?;
    magic[..start.len()].copy_from_slice(&start);
    file.rewind().map_err(unreadable)?;
    Ok((file, magic))
}

/// Refuses sizes that would take more memory than a photograph can need.
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
    fn the_limit_itself_is_allowed_and_one_row_more_is_not() {
        assert!(size((1 << 14, 1 << 14)).is_ok());
        let problem = size((1 << 14, (1 << 14) + 1)).unwrap_err();
        assert!(problem.contains("16384x16385") && problem.contains("268435456"), "{problem}");
        assert!(size((u32::MAX, u32::MAX)).is_err());
        assert!(size((0, 5)).is_err());
    }
}
