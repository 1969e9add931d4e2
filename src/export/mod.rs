//! Results out: fields, pictures and the report of a solve.
//!
//! [`write()`] puts the files of a solve into a folder: all of them, or none.

mod depth;
mod extra;
mod field;
mod fused;
mod ranks;
mod registration;
mod report;
mod results;
mod scale;
mod simulated;
mod staging;
mod sweep;
#[cfg(test)]
mod tests;
mod transform;

use std::path::{Path, PathBuf};
use std::{fs, io};

pub use extra::{EXTRA_FILES, Extra};
pub use fused::fused;
pub(crate) use fused::stored;
pub use registration::{RegistrationReport, write_registration};
pub use report::{DeviceReport, LevelReport, RangeReport, Report, SizeReport, TimingsReport};
pub use results::Results;
pub use scale::{Scale, color};
pub use simulated::{SIMULATED_FILES, Truth, write_simulated};
pub use sweep::{SWEEP_FILES, SweepFrame, SweepReport, write_sweep};
pub use transform::read_transform;

use crate::{Decode, Error, Format, Solution};
pub(crate) use staging::{Staging, write_file};

/// The files that [`write()`] makes.
pub const FILES: [&str; 6] =
    ["relative_blur.exr", "confidence.exr", "depth.png", "fused.png", "report.json", "uncertainty.exr"];

/// Which of the two images is focused nearer to the camera; it decides what V > 0 means in `depth.png`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Nearer {
    /// I1: V > 0 is near.
    #[default]
    First,
    /// I2: V > 0 is far.
    Second,
}

impl Nearer {
    /// 1 or 2.
    pub fn number(self) -> u8 {
        match self {
            Nearer::First => 1,
            Nearer::Second => 2,
        }
    }
}

/// How the pictures of a solve are drawn.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Which image is focused nearer.
    pub nearer: Nearer,
    /// How the inputs were decoded; `fused.png` is encoded back.
    pub decode: Decode,
    /// The formats of I1 and I2; `fused.png` has 8 bits where both have.
    pub formats: [Format; 2],
}

/// Writes the [`FILES`] of a solve into the folder `out`, which is made if it is missing.
///
/// Everything is written under temporary names first and renamed at the end. On failure the files of this solve, and
/// the folder if it was made here, are removed again.
///
/// # Errors
/// [`Error::File`]; [`Error::Mismatch`] where a field of `solution` is not of the size that it states.
pub fn write(out: &Path, solution: &Solution, report: &Report, look: &Look) -> Result<(), Error> {
    write_with(out, solution, report, look, Vec::new())
}

/// As [`write()`], with further files; all of them, or none. Of the [`EXTRA_FILES`], those that are not among `extras`
/// are removed from the folder.
///
/// # Errors
/// As [`write()`].
pub fn write_with(
    out: &Path,
    solution: &Solution,
    report: &Report,
    look: &Look,
    extras: Vec<Extra>,
) -> Result<(), Error> {
    let size = (solution.width, solution.height);
    check_lengths(solution)?;
    let mut staging = Staging::new(out)?;
    let [blur, confidence, depth, fused, json, uncertainty] = FILES;
    staging.add(blur, |w| field::write(w, size, &solution.relative_blur, &field::RELATIVE_BLUR))?;
    staging.add(confidence, |w| field::write(w, size, &solution.confidence, &field::CONFIDENCE))?;
    staging.add(uncertainty, |w| field::write(w, size, &solution.uncertainty, &field::UNCERTAINTY))?;
    staging.add(depth, |w| depth::write(w, size, &solution.relative_blur, look.nearer))?;
    staging.add(fused, |w| fused::write(w, solution, look))?;
    staging.add(json, |w| {
        use std::io::Write;
        report.to_json().map_err(|e| e.to_string()).and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string()))
    })?;
    let stale = EXTRA_FILES.into_iter().filter(|name| extras.iter().all(|extra| extra.name != *name));
    let stale: Vec<PathBuf> = stale.map(|name| out.join(name)).collect();
    for extra in extras {
        staging.add(extra.name, |w| (extra.fill)(w))?;
    }
    staging.place()?;
    stale.iter().try_for_each(|path| remove(path))
}

/// Removes a file of an earlier solve, if there is one.
fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            Err(Error::file(path, format!("is of an earlier solve and cannot be removed ({e}); check permissions")))
        }
        _ => Ok(()),
    }
}

fn check_lengths(solution: &Solution) -> Result<(), Error> {
    let pixels = solution.width as usize * solution.height as usize;
    let colors = solution.fused_channels.count() as usize;
    let found = [&solution.relative_blur, &solution.uncertainty, &solution.confidence, &solution.fused].map(Vec::len);
    if found == [pixels, pixels, pixels, pixels * colors] {
        return Ok(());
    }
    let (width, height) = (solution.width, solution.height);
    Err(Error::Mismatch(format!("a solution of {width}x{height} with fields of {found:?} values cannot be written")))
}
