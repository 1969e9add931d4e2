//! Masks: the pixels of an image that a solve or a measurement uses.

use crate::base::color::LUMINANCE;
use crate::base::{Decode, Frame, Region};

/// The pixels of I1 that a solve uses. Other pixels have no data term and do not contribute to the registration, and
/// their results are NaN.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    /// 1 for each pixel of the mask, else 0.
    bytes: Vec<u8>,
}

impl Mask {
    /// Makes a mask of the pixels of an image whose stored luminance is at least half of white.
    pub fn from_image(image: &Frame) -> Self {
        let channels = image.format().channels.count() as usize;
        let is_bright = |pixel: &[f32]| match *pixel {
            [r, g, b] => LUMINANCE[0] * r + LUMINANCE[1] * g + LUMINANCE[2] * b >= 0.5,
            _ => pixel[0] >= 0.5,
        };
        let intensities = image.intensities(Decode::None);
        let bytes = intensities.chunks_exact(channels).map(|pixel| u8::from(is_bright(pixel))).collect();
        Self { width: image.width(), height: image.height(), bytes }
    }

    /// Returns the mask of the pixels that are part of a picture, if some are not, within another of the same size.
    pub(crate) fn of_frame(frame: &Frame, within: Option<&Self>) -> Option<Self> {
        let Some(counted) = frame.counted() else { return within.cloned() };
        let within = within.map_or(counted, Self::bytes);
        let bytes = counted.iter().zip(within).map(|(a, b)| *a.min(b)).collect();
        Some(Self { width: frame.width(), height: frame.height(), bytes })
    }

    /// Returns the mask of a region, which must lie within it.
    pub(crate) fn cropped(&self, region: Region) -> Self {
        Self { width: region.width, height: region.height, bytes: region.crop(&self.bytes, self.width as usize, 1) }
    }

    /// Returns every `step`-th pixel of every `step`-th row.
    pub(crate) fn subsampled(&self, step: u32) -> Self {
        let [width, height] = [self.width.div_ceil(step), self.height.div_ceil(step)];
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (step * y, step * x)));
        let bytes = pixels.map(|(y, x)| self.bytes[y as usize * self.width as usize + x as usize]).collect();
        Self { width, height, bytes }
    }

    /// Returns width and height, px.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Whether the mask has the pixel nearest to a point, px.
    pub(crate) fn contains(&self, x: f64, y: f64) -> bool {
        let [column, row] = [(x, self.width), (y, self.height)]
            .map(|(at, side)| (at.round().clamp(0.0, f64::from(side) - 1.0)) as usize);
        self.bytes.get(row * self.width as usize + column) == Some(&1)
    }

    /// Returns the fraction of the pixels that the mask has.
    pub(crate) fn coverage(&self) -> f64 {
        let count = self.bytes.iter().filter(|byte| **byte != 0).count();
        count as f64 / self.bytes.len().max(1) as f64
    }

    /// Returns one byte per pixel, row-major: 1 for each pixel of the mask, else 0.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}
