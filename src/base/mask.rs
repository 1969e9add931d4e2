//! Which pixels of I1 a solve is about.

use crate::base::color::LUMINANCE;
use crate::base::{Decode, Frame, Region};

/// A mask on the pixels of I1: those left out have no data term and no part in the registration, and their results are
/// NaN.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    /// A byte a pixel, 0 where it is left out.
    counts: Vec<u8>,
}

impl Mask {
    /// The pixels of a picture that are at least half as bright as white.
    pub fn of_picture(picture: &Frame) -> Self {
        let channels = picture.format().channels.count() as usize;
        let bright = |pixel: &[f32]| match *pixel {
            [r, g, b] => LUMINANCE[0] * r + LUMINANCE[1] * g + LUMINANCE[2] * b >= 0.5,
            _ => pixel[0] >= 0.5,
        };
        let intensities = picture.intensities(Decode::None);
        let counts = intensities.chunks_exact(channels).map(|pixel| u8::from(bright(pixel))).collect();
        Self { width: picture.width(), height: picture.height(), counts }
    }

    /// A part of it, which must be within it.
    pub(crate) fn cropped(&self, region: Region) -> Self {
        Self { width: region.width, height: region.height, counts: region.of(&self.counts, self.width as usize, 1) }
    }

    /// Every so-manieth pixel of every so-manieth row.
    pub(crate) fn every(&self, step: u32) -> Self {
        let [width, height] = [self.width.div_ceil(step), self.height.div_ceil(step)];
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (step * y, step * x)));
        let counts = places.map(|(y, x)| self.counts[y as usize * self.width as usize + x as usize]).collect();
        Self { width, height, counts }
    }

    /// Width and height.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Whether the pixel nearest to a place counts.
    pub(crate) fn counts(&self, x: f64, y: f64) -> bool {
        let [column, row] = [(x, self.width), (y, self.height)]
            .map(|(at, side)| (at.round().clamp(0.0, f64::from(side) - 1.0)) as usize);
        self.counts.get(row * self.width as usize + column) == Some(&1)
    }

    /// The share of pixels that count.
    pub(crate) fn share(&self) -> f64 {
        let counted = self.counts.iter().filter(|counts| **counts != 0).count();
        counted as f64 / self.counts.len().max(1) as f64
    }

    /// A byte a pixel, 0 where it is left out.
    pub fn bytes(&self) -> &[u8] {
        &self.counts
    }
}
