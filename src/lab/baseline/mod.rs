//! What parfocal is compared with, apart from the passes, on the CPU: registration by key-points, what the method SIFT
//! starts from, and shape from focus.
//!
//! SIFT key-points of both images (crate `lowe-sift`, after Lowe 2004), matched by the ratio test, and a similarity
//! fitted to the matches by robust least squares.

mod matching;
mod shape_from_focus;
mod sift;
mod similarity_fit;

pub use shape_from_focus::shape_from_focus;

use crate::base::color::LUMINANCE;
use crate::base::{Decode, Error, Frame, Mask, Similarity, centre};
use crate::engine::stages::ingest;

/// Key-points, matches and agreeing matches that a registration takes: a similarity needs two, chance can give a third.
const LEAST: usize = 6;

/// T by key-points, those of I1 that a mask does not leave out: for [`EngineOptions::key_points`](crate::EngineOptions).
///
/// # Errors
/// [`Error::TooFewKeyPoints`].
pub fn key_points([i1, i2]: [&Frame; 2], decode: Decode, mask: Option<&Mask>) -> Result<Similarity, Error> {
    let [mut a, b] = [i1, i2].map(|frame| sift::detect(&ingest::cpu_reference(frame, decode, LUMINANCE)));
    if let Some(mask) = mask {
        a.keep(|[x, y]| mask.contains(x, y));
    }
    enough("key-points in I1", a.places.len())?;
    enough("key-points in I2", b.places.len())?;
    let matches = matching::matches(&a, &b);
    enough("matches of key-points", matches.len())?;
    let (transform, agreeing) = similarity_fit::fit(&matches, centre(i1.width(), i1.height()));
    enough("matches that agree on a similarity", agreeing)?;
    Ok(transform)
}

fn enough(what: &'static str, found: usize) -> Result<(), Error> {
    if found < LEAST { Err(Error::TooFewKeyPoints { what, found, least: LEAST }) } else { Ok(()) }
}
