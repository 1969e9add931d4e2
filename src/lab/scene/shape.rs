//! The shape of a scene, and the blur of each image that follows from it.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::layers::{self, Arrangement};
use super::radiance::read_sized;
use crate::base::random::Random;
use crate::base::{Channels, Error, Frame, Lens, Samples, centre};

/// The shape of a scene: blur, and depth if there is a lens, at each position of I1.
///
/// Plane, steps and relief state V itself. Their blur is that of a lens that focuses I1 where V is `limit` and I2 where
/// V is `-limit`. The standard deviation of each image's blur grows linearly with the distance from its focus.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Shape {
    /// V decreases linearly from `limit` at the left border to `-limit` at the right border.
    Plane {
        /// Largest |V|, px².
        limit: f64,
    },
    /// Uniform V: one image is sharp and the other is blurred, I2 if V > 0 and I1 if V < 0.
    Uniform {
        /// V, px².
        variance: f64,
    },
    /// Seven terraces side by side, from `limit` at the left to `-limit` at the right.
    Steps {
        /// Largest |V|, px².
        limit: f64,
    },
    /// Twelve hills and hollows, placed by the seed.
    Relief {
        /// Largest |V|, px².
        limit: f64,
    },
    /// Two cylinders, one upright and one inclined, in front of a plane, between the focus distances of a lens.
    Cylinders {
        /// The lens.
        lens: Lens,
    },
    /// Cards in front of a background, between the focus distances of a lens. Only this shape has edges that hide the
    /// background.
    Layers {
        /// The arrangement of the cards.
        arrangement: Arrangement,
        /// The lens.
        lens: Lens,
    },
    /// V from a file, interpolated bilinearly between its pixels.
    RelativeBlurFile {
        /// One channel of 32-bit floats, EXR or TIFF, px².
        path: PathBuf,
    },
    /// Depth from a file, interpolated bilinearly between its pixels.
    DepthFile {
        /// One channel: EXR, PNG, TIFF or PNM, values as stored.
        path: PathBuf,
        /// The depth of a stored value of 1, mm.
        unit: f64,
        /// The lens.
        lens: Lens,
    },
}

/// Blur and depth at one position of I1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    /// Variance of the blur of I1 and of I2 (on I1's grid), px² of I1.
    pub(super) variances: [f64; 2],
    /// The focus position: 0 where I1 is focused, 1 where I2 is, and linear in the standard deviation of blur.
    pub(super) share: f64,
    /// Depth, mm.
    pub(super) depth: Option<f64>,
}

/// A shape that is ready to be rendered: it gives blur and depth at a position, px of I1, inside or outside the frame.
pub(super) type Surface = Box<dyn Fn([f64; 2]) -> Point + Sync>;

/// Number of terraces of the steps.
const TERRACES: f64 = 7.0;

/// Number of hills and hollows of the relief.
const HILLS: usize = 12;

impl Shape {
    /// The lens, if the shape has one.
    pub fn lens(&self) -> Option<&Lens> {
        match self {
            Shape::Cylinders { lens } | Shape::Layers { lens, .. } | Shape::DepthFile { lens, .. } => Some(lens),
            _ => None,
        }
    }

    /// The value of `occlusion` in `truth.json`.
    pub(super) fn occlusion(&self) -> &'static str {
        if matches!(self, Shape::Layers { .. }) { "rendered" } else { "ignored" }
    }

    /// Prepares the shape for a scene of a size and a seed, and for the scale of T.
    pub(super) fn surface(&self, size: [u32; 2], seed: u64, scale: f64) -> Result<Surface, Error> {
        let width = f64::from(size[0]);
        Ok(match self.clone() {
            Shape::Plane { limit } => Box::new(move |[x, _]| focused_at(limit, x / (width - 1.0))),
            Shape::Uniform { variance } => {
                let share = if variance < 0.0 { 1.0 } else { 0.0 };
                Box::new(move |_| Point {
                    variances: [f64::max(-variance, 0.0), variance.max(0.0)],
                    share,
                    depth: None,
                })
            }
            Shape::Steps { limit } => Box::new(move |[x, _]| {
                let terrace = ((x + 0.5) / width * TERRACES).floor().clamp(0.0, TERRACES - 1.0);
                focused_at(limit, terrace / (TERRACES - 1.0))
            }),
            Shape::Relief { limit } => {
                let height = relief(seed, size);
                Box::new(move |x| focused_at(limit, (1.0 - height(x)) / 2.0))
            }
            Shape::Cylinders { lens } => {
                let depth = cylinders(lens.focus, size);
                Box::new(move |x| through(&lens, scale, depth(x)))
            }
            Shape::Layers { arrangement, lens } => {
                let layers = arrangement.layers(seed, size, &lens);
                Box::new(move |x| through(&lens, scale, layers::front(&layers, x).depth))
            }
            Shape::RelativeBlurFile { path } => {
                let map = Map::read(&path, size, 1.0)?;
                let limit = map.largest_blur(&path)?;
                // A map of zeros is a plane in focus, for which any limit is correct.
                let limit = if limit > 0.0 { limit } else { 1.0 };
                Box::new(move |x| focused_at(limit, (1.0 - map.at(x) / limit) / 2.0))
            }
            Shape::DepthFile { path, unit, lens } => {
                let map = Map::read(&path, size, unit)?;
                map.check_depth(&path, &lens)?;
                Box::new(move |x| through(&lens, scale, map.at(x)))
            }
        })
    }
}

/// The blur at a `share` of the way from the focus of I1, V = `limit`, to the focus of I2, V = `-limit`. V is `limit
/// ((1 - share)² - share²) = limit (1 - 2 share)`.
fn focused_at(limit: f64, share: f64) -> Point {
    Point { variances: [limit * share * share, limit * (1.0 - share) * (1.0 - share)], share, depth: None }
}

/// The blur of a point at a depth, mm.
fn through(lens: &Lens, scale: f64, z: f64) -> Point {
    let variances = [lens.variance(0, z), lens.variance(1, z) / (scale * scale)];
    Point { variances, share: share_of(lens, z), depth: Some(z) }
}

/// The position of a depth in mm between the focus distances of a lens: 0 at that of I1, 1 at that of I2.
pub(super) fn share_of(lens: &Lens, z: f64) -> f64 {
    let [first, second] = lens.focus.map(|u| lens.coordinate(u));
    (lens.coordinate(z) - first) / (second - first)
}

/// A sum of hills of both signs, scaled to fill [-1, 1] over the image.
fn relief(seed: u64, [width, height]: [u32; 2]) -> impl Fn([f64; 2]) -> f64 + Sync {
    let mut random = Random::new(seed, 3);
    let short = f64::from(width.min(height));
    let hills: [_; HILLS] = std::array::from_fn(|i| {
        let centre = [random.uniform() * f64::from(width), random.uniform() * f64::from(height)];
        let radius = short * (0.07 + 0.08 * random.uniform());
        (centre, radius, if i % 2 == 0 { 1.0 } else { -1.0 })
    });
    let sum = move |[x, y]: [f64; 2]| {
        let bell = |([cx, cy], r): ([f64; 2], f64)| (-((x - cx).powi(2) + (y - cy).powi(2)) / (2.0 * r * r)).exp();
        hills.iter().map(|&(centre, radius, sign)| sign * bell((centre, radius))).sum::<f64>()
    };
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for y in 0..height {
        for x in 0..width {
            let value = sum([f64::from(x), f64::from(y)]);
            (low, high) = (low.min(value), high.max(value));
        }
    }
    move |x| (2.0 * sum(x) - low - high) / (high - low)
}

/// The depth of the cylinders, mm. Their size across the image is relative to its width, and along the view to the
/// distance between the focus distances.
fn cylinders(focus: [f64; 2], [width, height]: [u32; 2]) -> impl Fn([f64; 2]) -> f64 + Sync {
    let (near, far) = (focus[0].min(focus[1]), focus[0].max(focus[1]));
    let (width, [_, cy]) = (f64::from(width), centre(width, height));
    // The parameters of a cylinder: where its axis crosses the middle row and its radius, both relative to the width;
    // the slope of its axis; the nearness of its axis and its bulge, from 0 at the far focus to 1 at the near one.
    let shapes: [(f64, f64, f64, f64, f64); 2] = [(0.28, 0.16, 0.0, 0.20, 0.40), (0.70, 0.15, 0.21, 0.45, 0.45)];
    move |[x, y]| {
        let nearness = shapes.iter().fold(0.05, |nearest: f64, &(middle, radius, slant, axis, bulge)| {
            let across = (x - middle * width - slant * (y - cy)) / (1.0 + slant * slant).sqrt();
            let inside = 1.0 - (across / (radius * width)).powi(2);
            if inside > 0.0 { nearest.max(axis + bulge * inside.sqrt()) } else { nearest }
        });
        far - (far - near) * nearness
    }
}

/// The values of a file, extended beyond its border.
struct Map {
    values: Vec<f64>,
    /// Whether the file holds floats.
    float: bool,
    width: usize,
    height: usize,
}

impl Map {
    fn read(path: &Path, size: [u32; 2], unit: f64) -> Result<Self, Error> {
        let frame = read_sized(path, size)?;
        if frame.format().channels != Channels::Gray {
            return Err(Error::file(path, "is in colour; depth and relative blur are one channel"));
        }
        let float = matches!(frame.samples(), Samples::F32(_));
        let values = stored(&frame).into_iter().map(|v| unit * v).collect();
        Ok(Self { values, float, width: size[0] as usize, height: size[1] as usize })
    }

    /// The largest |V|, px². Refuses integers.
    fn largest_blur(&self, path: &Path) -> Result<f64, Error> {
        if !self.float {
            let problem = "holds whole numbers, which relative blur is not; give it as EXR or TIFF in 32-bit floats";
            return Err(Error::file(path, problem));
        }
        Ok(self.values.iter().fold(0.0, |most: f64, v| most.max(v.abs())))
    }

    fn check_depth(&self, path: &Path, lens: &Lens) -> Result<(), Error> {
        let Some(i) = self.values.iter().position(|z| z.is_nan() || *z <= lens.focal_length) else { return Ok(()) };
        let (x, y, z, f) = (i % self.width, i / self.width, self.values[i], lens.focal_length);
        let problem = format!(
            "states a depth of {z} mm at pixel ({x}, {y}), not beyond the focal length of {f} mm; check the unit of depth"
        );
        Err(Error::file(path, problem))
    }

    /// Interpolates bilinearly.
    fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let split = |p: f64, length: usize| {
            let p = p.clamp(0.0, (length - 1) as f64);
            let i = (p as usize).min(length.saturating_sub(2));
            (i, p - i as f64)
        };
        let ((i, a), (j, b)) = (split(x, self.width), split(y, self.height));
        let row = |j: usize| {
            let at = j * self.width + i;
            (1.0 - a) * self.values[at] + a * self.values[at + 1]
        };
        (1.0 - b) * row(j) + b * row(j + 1)
    }
}

/// The samples of a file as stored.
fn stored(frame: &Frame) -> Vec<f64> {
    match frame.samples() {
        Samples::U8(s) => s.iter().map(|&v| f64::from(v)).collect(),
        Samples::U16(s) => s.iter().map(|&v| f64::from(v)).collect(),
        Samples::F32(s) => s.iter().map(|&v| f64::from(v)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Preset, Scene};
    use super::*;

    fn values(shape: &Shape) -> Vec<f64> {
        let Scene { seed, transform, .. } = Preset::Plane.scene();
        let surface = shape.surface([96, 64], seed, transform.scale).unwrap();
        let places = (0..64).flat_map(|y| (0..96).map(move |x| [f64::from(x), f64::from(y)]));
        places.map(|x| surface(x).variances).map(|[v1, v2]| v2 - v1).collect()
    }

    #[test]
    fn shapes_span_their_stated_range() {
        for (shape, limit) in [
            (Shape::Plane { limit: 4.0 }, 4.0),
            (Shape::Steps { limit: 6.0 }, 6.0),
            (Shape::Relief { limit: 8.0 }, 8.0),
        ] {
            let v = values(&shape);
            let (low, high) = v.iter().fold((0.0, 0.0), |(a, b): (f64, f64), v| (a.min(*v), b.max(*v)));
            assert!((low + limit).abs() < 1e-9 && (high - limit).abs() < 1e-9, "{shape:?}: {low} to {high}");
        }
    }

    #[test]
    fn the_cylinders_have_v_of_both_signs() {
        let v = values(&Preset::Cylinders.scene().shape);
        let (low, high) = v.iter().fold((0.0, 0.0), |(a, b): (f64, f64), v| (a.min(*v), b.max(*v)));
        assert!(low < -5.0 && low > -7.0 && high > 4.0 && high < 7.0, "{low} to {high}");
    }

    #[test]
    fn a_map_is_interpolated_between_its_pixels() {
        let map = Map { values: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], float: true, width: 3, height: 2 };
        assert_eq!(map.at([1.5, 0.5]), 3.0);
        assert_eq!(map.at([-9.0, 9.0]), 3.0);
        assert_eq!(map.at([2.0, 1.0]), 5.0);
    }
}
