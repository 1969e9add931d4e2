//! Results out: fields, pictures and the report of a solve.
//!
//! [`write()`] puts the files of a solve into a folder: all of them, or none.

mod arrays;
mod beside;
mod depth;
mod depth16;
mod destination;
mod extra;
pub(crate) mod field;
mod folder;
mod fused;
mod hashes;
mod inspection;
mod journal;
mod json;
mod kind;
mod labelled;
mod labels;
mod listed;
pub(crate) mod meaning;
mod measurements;
mod metric;
mod palette;
mod pen;
pub(crate) mod picture;
mod ranks;
mod registered;
mod registration;
mod report;
mod results;
mod scale;
mod single;
mod solved;
mod staging;
mod sweep;
mod sweep_registration;
mod sweep_solved;
mod temporary;
#[cfg(test)]
mod tests;
mod texture;
mod transform;
mod valid;

use std::io::Write;

pub use arrays::{ArrayKind, Arrays};
pub(crate) use depth::{focus_scale, larger_is};
pub use depth16::{Depth16, Depth16Report};
pub use destination::{Destination, check_writable};
pub use extra::{EXTRA_FILES, Extra, PAGE_FILE};
pub use fused::{FUSED_FLOAT_FILE, fused, fused_as_stored, fused_float};
pub(crate) use fused::{color_type, fused_frame};
pub use hashes::{Hash, is_whole};
pub use inspection::{DeviationReport, INSPECT_FILES, InspectReport, write_inspection};
pub use kind::FileKind;
pub use labels::{MOST_LABELS, labels, sweep_labels};
pub use listed::{SIMULATED_FILES, listed_in};
pub use measurements::{Measurable, Measurements, ProfileReport, Quantity, StepReport, Wanted, profiles_in};
pub use metric::DEPTH_FILE;
pub use palette::Palette;
pub use pen::Pen;
pub use registered::{registered_ending, registered_kind, write_all_registered, write_registered};
pub use registration::{RegistrationReport, write_json, write_registration};
pub use report::{
    DepthReport, DeviceReport, LevelReport, RangeReport, Report, ShadingReport, SizeReport, SurfaceReport,
    TextureReport, TimingsReport,
};
pub use results::{Results, holds_sweep, states_a_lens};
pub use scale::Scale;
pub use solved::Solved;
pub(crate) use sweep::depth_surface;
pub use sweep::{
    NeverReport, SWEEP_FILES, SweepDepthReport, SweepFrame, SweepReport, sweep_files, sweep_fused, sweep_surface,
    write_sweep,
};
pub use sweep_registration::{SweepPlaces, SweepRegistration, read_sweep_places, write_sweep_registration};
pub use sweep_solved::SolvedSweep;
pub use temporary::abandon;
pub use texture::Texture;
pub use transform::{PairOf, read_pair_of, read_transform};

use crate::base::{Decode, Error, Format, Lens};
use crate::engine::Solution;
use crate::metric::MetricDepth;
use depth::Map;
pub(crate) use json::to_string as to_json;
pub(crate) use meaning::SOFTWARE;
pub(crate) use picture::write_drawing;
pub(crate) use ranks::Ranks;
pub(crate) use single::write_file;
pub(crate) use staging::Staging;
pub use staging::write_named;

/// The files that [`write()`] makes.
pub const FILES: [&str; 8] = [
    "relative_blur.exr",
    "confidence.exr",
    "depth.png",
    "fused.png",
    "report.json",
    "uncertainty.exr",
    "residual.exr",
    "valid.png",
];

/// Which of the two images is focused nearer to the camera; it decides which end of V is near in `depth.png`.
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

    /// As the focus distances of a lens say.
    pub fn of_lens(lens: &Lens) -> Self {
        if lens.focus[0] < lens.focus[1] { Self::First } else { Self::Second }
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
    /// The colours of `depth.png`.
    pub palette: Palette,
    /// What draws keys and curves.
    pub pen: Option<Pen>,
}

/// What is written only where it was asked for.
#[derive(Default)]
pub struct Additions<'a> {
    /// Depth in mm: [`DEPTH_FILE`].
    pub depth: Option<&'a MetricDepth>,
    /// Profiles: `profile_1.csv`, `profile_1.png` and so on.
    pub measurements: Measurements,
    /// Any of the [`EXTRA_FILES`].
    pub extras: Vec<Extra<'a>>,
}

/// Writes the [`FILES`] of a solve into the folder `out`, which is made if it is missing.
///
/// With [`Additions`], their files too. Of an earlier solve, what its report lists is replaced or removed; any other file
/// stays, and where it has the name of a result, nothing is written unless the [`Destination`] forces it. The report that is
/// written, and comes back, lists under `files` what was written, and under `hashes` what that holds, whatever `report` says.
///
/// Everything is written under temporary names first and renamed at the end. On failure the files of this solve, and
/// the folder if it was made here, are removed again, and the earlier results stand as they did; where the program is ended
/// meanwhile, the next that writes there sees to it.
///
/// # Errors
/// [`Error::File`]; [`Error::Mismatch`] where a field of `solution` is not of the size that it states.
pub fn write<'d>(
    out: impl Into<Destination<'d>>,
    solution: &Solution,
    report: &Report,
    look: &Look,
    additions: Additions<'_>,
) -> Result<Report, Error> {
    let size = (solution.width, solution.height);
    check_lengths(solution)?;
    let [blur, confidence, depth, fused, json, uncertainty, residual, valid] = FILES;
    let mut staging = Staging::anew(out.into(), json)?;
    staging.add(blur, |w| field::write(w, size, &solution.relative_blur, &meaning::RELATIVE_BLUR))?;
    staging.add(confidence, |w| field::write(w, size, &solution.confidence, &meaning::CONFIDENCE))?;
    staging.add(uncertainty, |w| field::write(w, size, &solution.uncertainty, &meaning::UNCERTAINTY))?;
    staging.add(residual, |w| field::write(w, size, &solution.residual, &meaning::RESIDUAL))?;
    let texture = Texture::of(solution, Some(report.texture.max_uncertainty_px2));
    staging.add(valid, |w| valid::write(w, size, &texture.without(&solution.relative_blur)))?;
    let map = match additions.depth {
        Some(metric) => Map::of_depth(metric, look.palette),
        None => Map::of_relative_blur(size, &solution.relative_blur, look.nearer, look.palette),
    };
    staging.add(depth, |w| depth::write(w, &map.marking(&texture.marked), look.pen))?;
    staging.add(fused, |w| fused::write(w, solution, look))?;
    for extra in additions.extras {
        staging.add(extra.name, |w| (extra.fill)(w))?;
    }
    if let Some(metric) = additions.depth {
        staging.add(DEPTH_FILE, |w| metric::write(w, metric))?;
    }
    additions.measurements.stage(&mut staging, look.pen)?;
    // The last to get its name: where the report is that was asked for, the rest is too (`batch --resume`).
    let report = report.listing(staging.names().into_iter().chain([json.to_string()]), staging.hashes());
    staging.add(json, |w| {
        report.to_json().map_err(|e| e.to_string()).and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string()))
    })?;
    staging.place().map(|()| report)
}

fn check_lengths(solution: &Solution) -> Result<(), Error> {
    let pixels = solution.width as usize * solution.height as usize;
    let colors = solution.fused_channels.count() as usize;
    let fields = [&solution.relative_blur, &solution.uncertainty, &solution.confidence, &solution.residual];
    let found = [fields.map(Vec::len).as_slice(), &[solution.fused.len()]].concat();
    if found == [pixels, pixels, pixels, pixels, pixels * colors] {
        return Ok(());
    }
    let (width, height) = (solution.width, solution.height);
    if solution.fused.is_empty() {
        return Err(Error::Mismatch(
            "a solution without its fused image cannot be written: solve with `fused` set".to_string(),
        ));
    }
    Err(Error::Mismatch(format!("a solution of {width}x{height} with fields of {found:?} values cannot be written")))
}
