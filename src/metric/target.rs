//! Targets of known depth, as solved for a calibration.

use crate::base::smooth_field::covers;
use crate::base::{Error, Lens, LensField, Region};
use crate::metric::measure::Values;

/// A target of known depth.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A plane that fills the image: its depths, mm, at the centres of the top left, top right and bottom left pixels.
    /// Under perspective, 1/z is linear in the pixel coordinates.
    Plane([f64; 3]),
    /// Surfaces perpendicular to the axis, each with its depth, mm. Where regions overlap, the first applies.
    Steps(Vec<(Region, f64)>),
}

/// V of a photographed target.
#[derive(Clone, Debug)]
pub struct SolvedTarget<'a> {
    /// The target.
    pub target: Target,
    /// V, px².
    pub blur: Values<'a>,
    /// The confidence in V.
    pub confidence: &'a [f32],
    /// s of the registration.
    pub scale: f64,
}

/// The largest number of pixels; more are subsampled, since a fit needs no more.
const MAX_PIXELS: usize = 1 << 18;
/// The smallest number of pixels.
const MIN_PIXELS: usize = 64;

impl Target {
    /// Returns the depth at each pixel, mm. NaN off the target.
    pub(super) fn depths(&self, lens: &Lens, blur: &Values) -> Result<Vec<f64>, Error> {
        let check = |z: f64| {
            let range = format!("more than the focal length, {} mm, and less than 1e9", lens.focal_length);
            if z > lens.focal_length && z < 1e9 {
                Ok(())
            } else {
                Err(Error::Setting { name: "depth of the target", value: z, range })
            }
        };
        let (width, pixels) = (blur.width as usize, blur.values.len());
        match self {
            Self::Plane(corners) => {
                corners.iter().try_for_each(|&z| check(z))?;
                let [q00, q10, q01] = corners.map(|z| 1.0 / z);
                let last = |length: usize| length.saturating_sub(1).max(1) as f64;
                let (right, down) = ((q10 - q00) / last(width), (q01 - q00) / last(pixels / width.max(1)));
                let depth = |i: usize| 1.0 / (q00 + right * (i % width) as f64 + down * (i / width) as f64);
                // The plane has no depth beyond its horizon.
                Ok((0..pixels).map(depth).map(|z| if z > lens.focal_length { z } else { f64::NAN }).collect())
            }
            Self::Steps(steps) => {
                let mut depths = vec![f64::NAN; pixels];
                for &(region, z) in steps.iter().rev() {
                    check(z)?;
                    blur.region(region)?;
                    for y in region.y..region.y + region.height {
                        let start = y as usize * width + region.x as usize;
                        depths[start..start + region.width as usize].fill(z);
                    }
                }
                Ok(depths)
            }
        }
    }
}

/// V and depth at subsampled pixels of one or two targets.
pub(super) struct Samples {
    /// Width and height of the photographs, px.
    pub(super) size: [u32; 2],
    /// Samples per row.
    pub(super) width: usize,
    /// Row-major, those of the second target after those of the first.
    pub(super) pixels: Vec<Sample>,
    /// The number of valid samples on the targets.
    pub(super) valid: usize,
    /// s of the registration of each target.
    pub(super) scales: Vec<f64>,
}

#[derive(Clone, Copy)]
pub(super) struct Sample {
    /// The index of its target.
    pub(super) target: usize,
    /// The place in the photographs, px.
    pub(super) place: [f64; 2],
    /// x of the depth.
    pub(super) x: f64,
    /// Depth, mm.
    pub(super) z: f64,
    /// V, px².
    pub(super) v: f64,
    /// The confidence; 0 if not valid or off the target.
    pub(super) weight: f64,
}

impl Samples {
    pub(super) fn new(lens: &Lens, targets: &[SolvedTarget<'_>]) -> Result<Self, Error> {
        let size = |solved: &SolvedTarget<'_>| [solved.blur.width, solved.blur.height()];
        let Some(whole) = targets.first().map(size) else {
            return Err(Error::Region("no target is given".to_string()));
        };
        if let Some([width, height]) = targets.iter().map(size).find(|size| *size != whole) {
            let [w, h] = whole;
            let problem = format!("the results of a target have {w}x{h} pixels, and those of another {width}x{height}");
            return Err(Error::Mismatch(problem));
        }
        let width = whole[0] as usize;
        let depths: Vec<Vec<f64>> =
            targets.iter().map(|solved| solved.target.depths(lens, &solved.blur)).collect::<Result<_, _>>()?;
        let on_target = depths.iter().flatten().filter(|z| z.is_finite()).count();
        let step = (on_target as f64 / MAX_PIXELS as f64).sqrt().ceil().max(1.0) as usize;
        let (mut pixels, mut valid) = (Vec::new(), 0);
        for (target, (solved, depths)) in targets.iter().zip(&depths).enumerate() {
            let sample = |i: usize| {
                let (z, v, c) = (depths[i], f64::from(solved.blur.values[i]), f64::from(solved.confidence[i]));
                let weight = if z.is_finite() && v.is_finite() && c > 0.0 { c } else { 0.0 };
                let place = [(i % width) as f64, (i / width) as f64];
                Sample { target, place, x: lens.coordinate(z), z, v, weight }
            };
            let rows = (0..depths.len() / width.max(1)).step_by(step);
            let first = pixels.len();
            pixels.extend(rows.flat_map(|y| (0..width).step_by(step).map(move |x| y * width + x)).map(sample));
            let own = pixels[first..].iter().filter(|s: &&Sample| s.weight > 0.0).count();
            if own < MIN_PIXELS {
                return Err(Error::Region(format!(
                    "the target has {own} valid pixels, and {MIN_PIXELS} are needed: give larger regions, or texture on it"
                )));
            }
            valid += own;
        }
        let scales = targets.iter().map(|solved| solved.scale).collect();
        Ok(Self { size: whole, width: width.div_ceil(step), pixels, valid, scales })
    }

    /// Returns whether each target has V all over the frame.
    pub(super) fn cover_the_frame(&self) -> bool {
        (0..self.scales.len()).all(|target| {
            let valid = self.pixels.iter().filter(|s| s.target == target && s.weight > 0.0);
            covers(self.size, valid.map(|s| s.place))
        })
    }

    /// Replaces V by that at the image centre.
    pub(super) fn move_to_centre(&mut self, field: &LensField) {
        for sample in &mut self.pixels {
            let [gain, offset] = field.at(sample.place);
            sample.v = (sample.v - offset) / gain;
        }
    }
}
