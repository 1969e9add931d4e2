//! The folder of a solve, read again.

use std::path::Path;

use serde_json::Value;

use super::{FILES, Nearer};
use crate::base::{Error, Frame};
use crate::files::{bounded_read, image_io};

/// The most bytes of a report that are read, 16 MiB: one with every level and iteration at its limit takes under 1 MiB.
pub(super) const MAX_BYTES: u64 = 16 << 20;

/// What [`write()`](super::write()) put into a folder, as far as pictures need it.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// V, px², row-major; NaN where not valid.
    pub relative_blur: Vec<f32>,
    /// In [0, 1], of the same size.
    pub confidence: Vec<f32>,
    /// The fused image, of the same size.
    pub fused: Frame,
    /// Which image was focused nearer.
    pub nearer: Nearer,
}

impl Results {
    /// Reads the results in a folder.
    ///
    /// # Errors
    /// [`Error::File`]: a file is missing or damaged, or not of the size of `relative_blur.exr`.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        if !folder.is_dir() {
            return Err(Error::file(folder, "is no folder; give the one that parfocal solve -o wrote"));
        }
        let [blur, confidence, _, fused, report, ..] = FILES.map(|name| folder.join(name));
        let nearer = nearer_of(&read_report(&report)?, &report)?;
        let (width, height, relative_blur) = image_io::read_field(&blur)?;
        let of_one_size = |path: &Path, (w, h): (u32, u32)| {
            if (w, h) == (width, height) {
                return Ok(());
            }
            let problem = format!("is {w}x{h} and relative_blur.exr is {width}x{height}; solve the pair again");
            Err(Error::file(path, problem))
        };
        let (w, h, values) = image_io::read_field(&confidence)?;
        of_one_size(&confidence, (w, h))?;
        let image = image_io::read(&fused)?;
        of_one_size(&fused, (image.width(), image.height()))?;
        Ok(Self { width, height, relative_blur, confidence: values, fused: image, nearer })
    }
}

const SOLVE: &str = "solve the pair again, or give the folder of another solve";

/// The whole of `report.json`.
pub(super) fn read_report(path: &Path) -> Result<Value, Error> {
    let text =
        bounded_read::text(path, MAX_BYTES).map_err(|e| Error::file(path, format!("cannot be read ({e}); {SOLVE}")))?;
    serde_json::from_str(&text).map_err(|e| Error::file(path, format!("is not JSON ({e}); {SOLVE}")))
}

/// Whether a folder is one that `parfocal stack` wrote.
///
/// # Errors
/// [`Error::File`]: it is no folder of results.
pub fn holds_sweep(folder: &Path) -> Result<bool, Error> {
    if !folder.is_dir() {
        return Err(Error::file(folder, "is no folder; give the one that parfocal solve or stack wrote"));
    }
    if folder.join("batch.json").is_file() && !folder.join(FILES[4]).exists() {
        return Err(Error::file(folder, "holds the results of a batch; give the folder of one pair or sweep in it"));
    }
    Ok(is_of_sweep(&read_report(&folder.join(FILES[4]))?))
}

/// Whether the report in a folder has depth in mm through a lens.
///
/// # Errors
/// As [`holds_sweep`].
pub fn states_a_lens(folder: &Path) -> Result<bool, Error> {
    Ok(read_report(&folder.join(FILES[4]))?["depth"].get("lens").is_some())
}

/// Whether a report is of a focus sweep.
pub(super) fn is_of_sweep(report: &Value) -> bool {
    report.get("frames").is_some() && report.get("blur_rate_px2").is_some()
}

/// Which image was focused nearer, as the report at `path` says.
pub(super) fn nearer_of(report: &Value, path: &Path) -> Result<Nearer, Error> {
    match report.get("nearer").and_then(Value::as_u64) {
        Some(1) => Ok(Nearer::First),
        Some(2) => Ok(Nearer::Second),
        _ => Err(Error::file(path, format!("does not say which image is nearer (\"nearer\": 1 or 2); {SOLVE}"))),
    }
}
