//! The radiance of a scene: cosines in closed form, random dots, or an image file.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::kernel::{Kernel, Rules};
use super::raster::Raster;
use super::view::{Row, View, fill_rows, split};
use crate::base::random::Random;
use crate::base::{Error, Frame, Samples, Similarity};
use crate::files::image_io;

/// The radiance of the surface in focus: a continuous function of the position, in [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Radiance {
    /// 480 random cosines with correlation lengths of 0.7 to 10 px. Blur and interpolation have an exact closed form.
    Texture,
    /// The sum of stated cosines and ½, with the closed form of the texture: stripes, gratings.
    Waves {
        /// The cosines.
        waves: Vec<Wave>,
    },
    /// Random black and white squares of 4 px, softened by a Gaussian of σ 0.6 px. The blur is integrated over the
    /// continuous pattern, with an error of 1e-5.
    Dots,
    /// An image, grey or colour, as the cubic spline through its pixels. The blur is integrated over the spline, with
    /// an error of 1e-4 even for pixel noise.
    File {
        /// The image, with the scene's size.
        path: PathBuf,
    },
}

/// One channel of radiance that is ready to be rendered.
pub(super) enum Pattern {
    Waves(Waves),
    Dots(Dots),
    Raster(Raster),
}

impl Radiance {
    /// The channels of the radiance of a scene of a size and a seed, 1 or 3.
    pub(super) fn channels(&self, size: [u32; 2], seed: u64) -> Result<Vec<Pattern>, Error> {
        Ok(match self {
            Radiance::Texture => vec![Pattern::Waves(Waves::new(seed, size))],
            Radiance::Waves { waves } => vec![Pattern::Waves(Waves(waves.clone()))],
            Radiance::Dots => vec![Pattern::Dots(Dots::new(seed, size))],
            Radiance::File { path } => rasters(&read_sized(path, size)?),
        })
    }
}

impl Pattern {
    /// One row of an image of this pattern.
    pub(super) fn fill(&self, kernel: Kernel, rules: &Rules, row: &Row, values: &mut [f64]) {
        match self {
            Pattern::Waves(waves) => waves.fill(kernel, row, values),
            Pattern::Dots(dots) => gather(|x| dots.at(x), rules, row, values),
            Pattern::Raster(raster) if kernel == Kernel::Gaussian => {
                for (i, (value, v)) in values.iter_mut().zip(row.variances).enumerate() {
                    *value = raster.gaussian(row.place(i), row.view.length(v.sqrt()));
                }
            }
            Pattern::Raster(raster) => gather(|x| raster.at(x), rules, row, values),
        }
    }
}

/// `∫ h(u; v) r(x - M u) du` at each pixel of a row.
fn gather(radiance: impl Fn([f64; 2]) -> f64, rules: &Rules, row: &Row, values: &mut [f64]) {
    for (i, (value, v)) in values.iter_mut().zip(row.variances).enumerate() {
        let (x, sigma) = (row.place(i), v.sqrt());
        *value = if sigma == 0.0 {
            radiance(x)
        } else {
            let at = |u: [f64; 2]| {
                let [dx, dy] = row.view.turn([sigma * u[0], sigma * u[1]]);
                radiance([x[0] - dx, x[1] - dy])
            };
            rules.of(sigma).iter().map(|node| node.weight * at(node.u)).sum()
        };
    }
}

/// Reads an image, which must have the scene's size.
pub(super) fn read_sized(path: &Path, [width, height]: [u32; 2]) -> Result<Frame, Error> {
    let frame = image_io::read(path)?;
    if (frame.width(), frame.height()) == (width, height) {
        return Ok(frame);
    }
    let (w, h) = (frame.width(), frame.height());
    Err(Error::file(path, format!("is {w}x{h} and the scene {width}x{height}; radiance and shape must have one size")))
}

fn rasters(frame: &Frame) -> Vec<Pattern> {
    let values: Vec<f64> = match frame.samples() {
        Samples::U8(s) => s.iter().map(|&v| f64::from(v) / 255.0).collect(),
        Samples::U16(s) => s.iter().map(|&v| f64::from(v) / 65535.0).collect(),
        Samples::F32(s) => s.iter().map(|&v| f64::from(v)).collect(),
    };
    let count = frame.format().channels.count() as usize;
    let channel = |c: usize| values.iter().skip(c).step_by(count).copied().collect();
    let raster = |c| Pattern::Raster(Raster::new(channel(c), frame.width() as usize, frame.height() as usize));
    (0..count).map(raster).collect()
}

/// A cosine of the position x: `amplitude cos(k·x + phase)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wave {
    /// The frequency along x and y, rad/px.
    pub k: [f64; 2],
    /// The phase at the first pixel, rad.
    pub phase: f64,
    /// Half the range.
    pub amplitude: f64,
}

/// The sum of cosines and ½.
pub(super) struct Waves(Vec<Wave>);

/// Number of waves of each correlation length.
const COUNT: usize = 120;

/// Highest frequency, rad/px. It is below Nyquist, π, even in an image that is reduced a little.
const HIGHEST: f64 = 2.6;

impl Waves {
    /// Makes a random texture that fills [0, 1] in a sharp image of this size: four Gaussian random fields with
    /// correlation lengths of 0.7 to 10 px and equal strength.
    pub(super) fn new(seed: u64, size: [u32; 2]) -> Self {
        let mut random = Random::new(seed, 1);
        let mut waves = Vec::new();
        for length in [0.7, 1.5, 4.0, 10.0] {
            for _ in 0..COUNT {
                waves.push(Wave { k: frequency(&mut random, length), phase: TAU * random.uniform(), amplitude: 1.0 });
            }
        }
        let mut waves = Self(waves);
        let (view, sharp) = (View::new(&Similarity::IDENTITY, size), vec![0.0; size[0] as usize]);
        let values = fill_rows(size, |y, row| waves.fill(Kernel::Gaussian, &view.row(y, &sharp), row));
        let peak = values.iter().map(|v| (v - 0.5).abs()).fold(0.0, f64::max);
        waves.0.iter_mut().for_each(|w| w.amplitude = 0.5 / peak);
        waves
    }

    /// The texture blurred by a Gaussian of this variance, px².
    pub(super) fn softened(mut self, variance: f64) -> Self {
        for wave in &mut self.0 {
            wave.amplitude *= Kernel::Gaussian.transfer(wave.k, variance)[0];
        }
        self
    }

    /// One row of an image of this texture.
    pub(super) fn fill(&self, kernel: Kernel, row: &Row, values: &mut [f64]) {
        values.fill(0.5);
        self.0.iter().for_each(|wave| wave.add(kernel, row, values));
    }
}

/// A random frequency for a field with this correlation length, px.
fn frequency(random: &mut Random, length: f64) -> [f64; 2] {
    loop {
        let k = [random.normal(), random.normal()].map(|n| n / (2f64.sqrt() * length));
        if k[0].hypot(k[1]) < HIGHEST {
            return k;
        }
    }
}

impl Wave {
    /// Adds `amplitude Re[exp(i (k·x + phase)) ĥ(ω; v)]` to each pixel. Along a row k·x increases linearly, so one
    /// constant factor per pixel advances the exponential.
    fn add(&self, kernel: Kernel, row: &Row, values: &mut [f64]) {
        let dot = |x: [f64; 2]| self.k[0] * x[0] + self.k[1] * x[1];
        let (mut sin, mut cos) = (dot(row.start) + self.phase).sin_cos();
        let (turn_sin, turn_cos) = dot(row.step).sin_cos();
        let w = row.view.frequency(self.k);
        let (mut known, mut h) = (f64::NAN, [1.0, 0.0]);
        for (value, &v) in values.iter_mut().zip(row.variances) {
            if v != known {
                (known, h) = (v, kernel.transfer(w, v));
            }
            *value += self.amplitude * (cos * h[0] - sin * h[1]);
            (sin, cos) = (sin * turn_cos + cos * turn_sin, cos * turn_cos - sin * turn_sin);
        }
    }
}

impl Waves {
    /// The sharp texture at a position.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        0.5 + self.0.iter().map(|w| w.amplitude * (w.k[0] * x + w.k[1] * y + w.phase).cos()).sum::<f64>()
    }
}

/// Random squares of 4 px, black (0) or white (1), softened by a Gaussian of σ 0.6 px. The pattern repeats outside a
/// margin around the image.
pub(super) struct Dots {
    cells: Vec<f64>,
    columns: usize,
    rows: usize,
    edge: Vec<f64>,
}

/// Side of a dot, px.
const SIDE: f64 = 4.0;

/// σ of the softening, px. Beyond the neighbours of a dot 1e-11 of its weight remain.
const SOFTNESS: f64 = 0.6;

/// Number of dots around the image before the pattern repeats.
const MARGIN: usize = 32;

/// Number of entries of the table of an edge. With linear interpolation its error is below 1e-7.
const ENTRIES: usize = 4096;

impl Dots {
    pub(super) fn new(seed: u64, [width, height]: [u32; 2]) -> Self {
        let mut random = Random::new(seed, 2);
        let count = |length: u32| (f64::from(length) / SIDE).ceil() as usize + 2 * MARGIN;
        let (columns, rows) = (count(width), count(height));
        let cells = (0..columns * rows).map(|_| if random.uniform() < 0.5 { 0.0 } else { 1.0 }).collect();
        // The weight of a neighbour at a distance from the shared edge.
        let tail = |d: f64| libm::erfc(d / (2f64.sqrt() * SOFTNESS)) / 2.0;
        let edge = (0..ENTRIES + 2).map(|i| tail(SIDE * i as f64 / ENTRIES as f64)).collect();
        Self { cells, columns, rows, edge }
    }

    /// The pattern at a position, px, in [0, 1].
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        // Dots are aligned so that edges fall between pixels.
        let (xs, wx) = self.neighbours((x + 0.5) / SIDE, self.columns);
        let (ys, wy) = self.neighbours((y + 0.5) / SIDE, self.rows);
        let row = |j: usize| (0..3).map(|i| wx[i] * self.cells[ys[j] * self.columns + xs[i]]).sum::<f64>();
        (0..3).map(|j| wy[j] * row(j)).sum()
    }

    /// The three dots around a position, in units of dots, and their weights.
    fn neighbours(&self, position: f64, count: usize) -> ([usize; 3], [f64; 3]) {
        let (whole, part) = split(position);
        let (before, after) = (self.tail(part), self.tail(1.0 - part));
        let (i, count) = (whole + MARGIN as i64, count as i64);
        // Divides only where the pattern repeats, since a division takes longer than the rest.
        let wrap = |i: i64| if (0..count).contains(&i) { i as usize } else { i.rem_euclid(count) as usize };
        ([wrap(i - 1), wrap(i), wrap(i + 1)], [before, 1.0 - before - after, after])
    }

    /// Interpolates the table at a distance in [0, 1] dots.
    fn tail(&self, distance: f64) -> f64 {
        let position = distance * ENTRIES as f64;
        let i = position as usize;
        self.edge[i] + (position - i as f64) * (self.edge[i + 1] - self.edge[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KERNELS: [Kernel; 3] = [Kernel::Gaussian, Kernel::Pillbox, Kernel::HalfGaussian];

    #[test]
    fn quadrature_and_closed_form_agree_on_a_texture() {
        let (size, waves) = ([48, 4], Waves::new(3, [48, 4]));
        for kernel in KERNELS {
            let view = View::new(&Similarity::new(1.3, -0.9, 10.0, 1.1), size);
            let variances: Vec<f64> = (0..48).map(|i| 0.2 * f64::from(i)).collect();
            let row = view.row(2, &variances);
            let (mut exact, mut summed) = (vec![0.0; 48], vec![0.0; 48]);
            waves.fill(kernel, &row, &mut exact);
            gather(|x| waves.at(x), &Rules::new(kernel, 3.1), &row, &mut summed);
            let worst = exact.iter().zip(&summed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-6, "{kernel:?}: {worst}");
        }
    }

    #[test]
    fn an_edge_is_an_error_function() {
        let mut dots = Dots::new(1, [16, 16]);
        // A vertical edge at x = 7.5, between the dots at 4 to 8 and at 8 to 12.
        for (i, cell) in dots.cells.iter_mut().enumerate() {
            *cell = if i % dots.columns < MARGIN + 2 { 0.0 } else { 1.0 };
        }
        for i in -60..=60 {
            let d = f64::from(i) / 20.0;
            let expected = libm::erfc(-d / (2f64.sqrt() * SOFTNESS)) / 2.0;
            assert!((dots.at([7.5 + d, 5.3]) - expected).abs() < 2e-7);
        }
    }
}
