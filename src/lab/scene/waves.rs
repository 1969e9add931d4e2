//! Texture in closed form: a sum of cosines, which any kernel blurs exactly and which can be read at any place.

use std::f64::consts::TAU;

use super::Kernel;
use super::view::{Row, View, fill_rows};
use crate::base::Similarity;
use crate::base::random::Random;

struct Wave {
    k: [f64; 2],
    phase: f64,
    amplitude: f64,
}

/// A random texture in [0, 1]: four Gaussian random fields of correlation lengths 0.7 to 10 px and equal strength.
pub(super) struct Waves(Vec<Wave>);

/// Waves of each correlation length.
const COUNT: usize = 120;

/// Frequencies beyond this would not survive sampling at Nyquist, π rad/px, in an image that is shrunk a little.
const HIGHEST: f64 = 2.6;

impl Waves {
    /// Scaled so that an image of this size just fills [0, 1] where it is sharp.
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

    /// The same under a Gaussian, its variance in px².
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

/// A random frequency of a field of a correlation length, px.
fn frequency(random: &mut Random, length: f64) -> [f64; 2] {
    loop {
        let k = [random.normal(), random.normal()].map(|n| n / (2f64.sqrt() * length));
        if k[0].hypot(k[1]) < HIGHEST {
            return k;
        }
    }
}

impl Wave {
    /// Adds `amplitude Re[exp(i (k·x + phase)) ĥ(ω; v)]` to each pixel. Along a row k·x grows evenly, so the exponential
    /// turns by one factor a pixel.
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
    /// The texture at a place, sharp.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        0.5 + self.0.iter().map(|w| w.amplitude * (w.k[0] * x + w.k[1] * y + w.phase).cos()).sum::<f64>()
    }
}
