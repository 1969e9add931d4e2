//! What brings one photograph to the brightness of another.

use crate::base::{Photometric, Region, Shading, centre};

/// Gain, offset and shading of I2: `gain · shading(x) · I2(x) + offset` is as bright as I1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brightness {
    /// Gain and offset.
    pub photometric: Photometric,
    /// How the gain varies.
    pub shading: Shading,
    /// The part of I2 that the shading is stated over, px: all of it unless a part was solved.
    pub part: Region,
}

impl Brightness {
    /// Nothing is changed in a photograph of so many pixels.
    pub fn unchanged(size: [u32; 2]) -> Self {
        Self {
            photometric: Photometric::IDENTITY,
            shading: Shading::NONE,
            part: Region { x: 0, y: 0, width: size[0], height: size[1] },
        }
    }

    /// The shading's factor at a place on I2, px; beyond its part that of the nearest place within.
    pub fn factor(&self, place: [f64; 2]) -> f64 {
        self.shading.at([self.within(0, place[0]), self.within(1, place[1])])
    }

    /// A place along x (0) or y (1) on the part, -1 to 1.
    fn within(&self, axis: usize, place: f64) -> f64 {
        let (first, half) = ([self.part.x, self.part.y], centre(self.part.width, self.part.height));
        // A part one pixel wide has only a middle.
        let from_middle = (place - f64::from(first[axis]) - half[axis]) / half[axis].max(0.5);
        from_middle.clamp(-1.0, 1.0)
    }

    /// An intensity of I2 at a place on it, px, as bright as in I1.
    pub fn of(&self, intensity: f64, place: [f64; 2]) -> f64 {
        self.photometric.gain * self.factor(place) * intensity + self.photometric.offset
    }

    /// The same of a row of I2, interleaved, which is changed in place; several times as fast, and equal but for rounding.
    pub(crate) fn apply_to_row(&self, row: &mut [f32], channels: usize, y: usize) {
        let factor = self.shading.along(self.within(1, y as f64));
        let Photometric { gain, offset } = self.photometric;
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let gain = gain * factor(self.within(0, x as f64));
            pixel.iter_mut().for_each(|value| *value = (gain * f64::from(*value) + offset) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_stated_over_its_part_and_held_beyond() {
        let mut shading = Shading::NONE;
        shading.coefficients[0] = 0.1;
        let part = Region { x: 10, y: 20, width: 5, height: 3 };
        let brightness = Brightness { photometric: Photometric { gain: 2.0, offset: 0.5 }, shading, part };
        for (x, factor) in [(0.0, 0.9), (10.0, 0.9), (12.0, 1.0), (13.0, 1.05), (14.0, 1.1), (99.0, 1.1)] {
            assert!((brightness.factor([x, 7.0]) - factor).abs() < 1e-12, "{x}");
            assert!((brightness.of(0.25, [x, 7.0]) - (0.5 * factor + 0.5)).abs() < 1e-12);
        }
        let mut row = [0.25f32; 40];
        brightness.apply_to_row(&mut row, 2, 7);
        for (i, value) in row.into_iter().enumerate() {
            assert!((f64::from(value) - brightness.of(0.25, [(i / 2) as f64, 7.0])).abs() < 1e-7, "{i}");
        }
        assert_eq!(Brightness::unchanged([1, 1]).of(0.3, [0.0, 0.0]), 0.3);
    }
}
