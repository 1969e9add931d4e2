//! The results of a sweep and its registration.

use std::ops::{Deref, DerefMut};

use super::positions::{Positions, SweepDepth};
use crate::base::{Brightness, Channels, Decode, Homography, Mask, Region};

/// The focus of every pixel of a sweep, an all-in-focus image, and the registration.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// Pixels per row of every field below.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The region of the reference that the fields cover.
    pub region: Region,
    /// u, the focus setting at which each pixel of the reference is sharp. NaN where it is not measured, or where no
    /// frame is in focus.
    pub focus: Vec<f32>,
    /// The standard deviation of u, in settings; NaN where no pair contributes.
    pub uncertainty: Vec<f32>,
    /// The side of pixels that no frame has in focus: -1 before the first frame, 1 beyond the last, else 0.
    pub beyond: Vec<i8>,
    /// Depth in mm, if the positions are in mm.
    pub depth: Option<SweepDepth>,
    /// The all-in-focus image. It is grey only if all frames are.
    pub fused_channels: Channels,
    /// The all-in-focus image, interleaved, in the values of the reference with white at 1.
    pub fused: Vec<f32>,
    /// The frame that supplies each pixel of the fused image, from 1; empty if the results were read from a folder.
    pub frames: Vec<u16>,
    /// The unit of the settings.
    pub unit: &'static str,
    /// The registration. Its fields are also fields of the sweep by `Deref`.
    pub registration: RegisteredSweep,
}

impl Deref for Sweep {
    type Target = RegisteredSweep;

    fn deref(&self) -> &RegisteredSweep {
        &self.registration
    }
}

impl DerefMut for Sweep {
    fn deref_mut(&mut self) -> &mut RegisteredSweep {
        &mut self.registration
    }
}

/// The registration of a sweep.
#[derive(Clone, Debug, Default)]
pub struct RegisteredSweep {
    /// Width and height of the photographs. The transforms are stated about their centre.
    pub photograph: [u32; 2],
    /// The index of the reference frame, to which the others are registered. It defines the pixels of the results.
    pub reference: usize,
    /// The focus setting of each frame; blur is linear in it.
    pub positions: Vec<f64>,
    /// The focus positions of the frames, as stated.
    pub stated: Positions,
    /// Maps the reference's pixels to those of each frame.
    pub transforms: Vec<Homography>,
    /// The parallax of each frame, of a camera that moved, px per setting: what is in focus at u is displaced by (u - m) times
    /// this, to the right and downwards, before the transform. m is the middle between the first and the last position.
    pub parallax: Vec<[f64; 2]>,
    /// Its standard deviation.
    pub parallax_deviation: Vec<[f64; 2]>,
    /// Maps the brightness of each frame to the reference's.
    pub brightness: Vec<Brightness>,
    /// c, the blur variance in px² at a distance of one setting from the focus.
    pub blur_rate: f64,
    /// The fraction of the pixels of each frame that are clipped, of those that no mask excludes.
    pub clipped_fractions: Vec<f64>,
    /// The decoding of stored values to intensities.
    pub decode: Decode,
    /// The index of each frame among the frames that were passed. If no positions are stated, frames out of order are
    /// put in order, and repeated frames are left out.
    pub order: Vec<usize>,
    /// Conditions under which the result may be wrong, one sentence each.
    pub warnings: Vec<String>,
}

/// The least change of scale from the first frame to the last that states which is near, in standard deviations.
const CERTAIN_SCALE: f64 = 5.0;

impl RegisteredSweep {
    /// Whether the first frame is focused nearer than the last, by their scale: a lens that is extended to focus near
    /// shows things larger. `None` if the scale is not certain or comes from elsewhere.
    ///
    /// While a lens is extended by a share of its distance to the sensor, the scale changes by that share, and a blurred
    /// point becomes as wide as this share of the aperture. Four standard deviations are the width of a disk, and no
    /// aperture is four times as wide as the sensor. Where blur changes by more, a stage moved, or the lens is telecentric:
    /// of a part of metal on a stage by twice as much, of five sweeps of lenses by 0.05 to 0.6 times as much.
    pub fn first_is_nearest(&self) -> Option<bool> {
        let count = self.positions.len() as f64;
        let scales: Vec<f64> = self.transforms.iter().map(Homography::scale).collect();
        let [position, scale] = [&self.positions, &scales].map(|values| values.iter().sum::<f64>() / count);
        let (mut squares, mut product, mut all) = (0.0, 0.0, 0.0);
        for (p, s) in self.positions.iter().map(|p| p - position).zip(scales.iter().map(|s| s - scale)) {
            (squares, product, all) = (squares + p * p, product + p * s, all + s * s);
        }
        let slope = product / squares;
        let deviation = ((all - slope * product).max(0.0) / (count - 2.0) / squares).sqrt();
        let diagonal = f64::from(self.photograph[0]).hypot(f64::from(self.photograph[1]));
        let is_of_lens = self.blur_rate.sqrt() < slope.abs() * diagonal;
        let ascending = self.positions.first() < self.positions.last();
        (is_of_lens && slope.abs() > CERTAIN_SCALE * deviation).then_some((slope < 0.0) == ascending)
    }
}

impl Sweep {
    /// Crops the fields to a region.
    pub(super) fn crop(&mut self, part: Region) {
        let row = self.width as usize;
        for field in [&mut self.focus, &mut self.uncertainty] {
            *field = part.crop(field, row, 1);
        }
        self.beyond = part.crop(&self.beyond, row, 1);
        self.frames = part.crop(&self.frames, row, 1);
        self.fused = part.crop(&self.fused, row, self.fused_channels.count() as usize);
        self.region = Region { x: self.region.x + part.x, y: self.region.y + part.y, ..part };
        (self.width, self.height) = (part.width, part.height);
    }

    /// Clears the results of the pixels that a mask excludes.
    pub(super) fn exclude(&mut self, mask: &Mask) {
        for (pixel, _) in mask.bytes().iter().enumerate().filter(|(_, counts)| **counts == 0) {
            (self.focus[pixel], self.uncertainty[pixel], self.beyond[pixel]) = (f32::NAN, f32::NAN, 0);
        }
    }

    /// The largest rectangle in which every pixel has a u; `None` if none has.
    pub(super) fn largest_valid(&self) -> Option<Region> {
        let valid: Vec<bool> = self.focus.iter().map(|u| u.is_finite()).collect();
        Region::largest_valid(&valid, self.width as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Similarity;

    #[test]
    fn frames_of_an_extended_lens_show_the_nearest_largest() {
        let nearest = |scales: [f64; 4], blur_rate: f64| {
            let transforms = scales.map(|scale| Similarity::new(2.0, 0.0, 0.0, scale).into()).to_vec();
            let (photograph, positions) = ([300, 400], vec![0.0, 1.0, 2.0, 3.0]);
            let found = RegisteredSweep { photograph, positions, transforms, blur_rate, ..RegisteredSweep::default() };
            found.first_is_nearest()
        };
        let (falling, rising) = ([1.03, 1.0201, 1.0099, 1.0], [1.0, 1.0101, 1.0199, 1.03]);
        assert_eq!([nearest(falling, 1.0), nearest(rising, 1.0)], [Some(true), Some(false)]);
        // A scale that wanders, and one that grows by less than the width of a blurred point: 10 px a setting.
        assert_eq!([nearest([1.0, 1.01, 0.99, 1.01], 1.0), nearest(rising, 100.0)], [None, None]);
    }
}
