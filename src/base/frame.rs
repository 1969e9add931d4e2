//! Photographs with their stored samples.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::{Channels, Decode, Depth, Format, Region, workers};

/// The samples of a [`Frame`], row-major, channels interleaved.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8-bit samples.
    U8(Vec<u8>),
    /// 16-bit samples.
    U16(Vec<u16>),
    /// Float samples, finite and of magnitude 1e6 at most.
    F32(Vec<f32>),
}

/// A photograph of `height` rows of `width` pixels with one or three interleaved channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    width: u32,
    height: u32,
    channels: Channels,
    samples: Samples,
    /// 1 for each pixel that is part of the picture, else 0; `None`: all are.
    counted: Option<Vec<u8>>,
}

/// The largest magnitude of a float sample. In the least unit of intensities, 2⁻²⁰, it is 1e12: products of three such
/// numbers are finite in single precision.
const MAX_MAGNITUDE: f32 = 1e6;

impl Frame {
    /// Makes a frame of `width * height * channels` samples.
    ///
    /// # Errors
    /// A message if the number of samples is wrong, or a float sample is not finite or has a magnitude above 1e6.
    pub fn new(width: u32, height: u32, channels: Channels, samples: Samples) -> Result<Self, String> {
        let expected = (width as usize)
            .checked_mul(height as usize)
            .and_then(|n| n.checked_mul(channels.count() as usize))
            .ok_or_else(|| format!("{width}x{height} pixels are too many"))?;
        let found = match &samples {
            Samples::U8(s) => s.len(),
            Samples::U16(s) => s.len(),
            Samples::F32(s) => s.len(),
        };
        if found != expected {
            return Err(format!(
                "{width}x{height} with {} channels needs {expected} samples, not {found}",
                channels.count()
            ));
        }
        if let Samples::F32(s) = &samples
            && let Some(i) = s.iter().position(|&v| !Self::is_valid_sample(v))
        {
            let pixel = i / channels.count() as usize;
            let (x, y) = (pixel % width as usize, pixel / width as usize);
            return Err(format!(
                "the sample at pixel ({x}, {y}) is {}, not a number of at most {MAX_MAGNITUDE:e}: white is 1",
                s[i]
            ));
        }
        Ok(Self { width, height, channels, samples, counted: None })
    }

    /// Makes a frame whose pixels with a float that is no number are not part of it, unless all are.
    ///
    /// # Errors
    /// As [`Frame::new`].
    pub(crate) fn with_holes(
        width: u32,
        height: u32,
        channels: Channels,
        mut samples: Samples,
    ) -> Result<Self, String> {
        let mut counted = None;
        if let Samples::F32(s) = &mut samples
            && s.iter().any(|v| v.is_nan())
        {
            let is_whole = |pixel: &[f32]| !pixel.iter().any(|v| v.is_nan());
            let pixels = s.chunks(channels.count() as usize);
            let bytes: Vec<u8> = pixels.map(|pixel| u8::from(is_whole(pixel))).collect();
            if bytes.contains(&1) {
                s.chunks_mut(channels.count() as usize)
                    .filter(|pixel| !is_whole(pixel))
                    .for_each(|pixel| pixel.fill(0.0));
                counted = Some(bytes);
            }
        }
        Ok(Self { counted, ..Self::new(width, height, channels, samples)? })
    }

    /// Returns whether a float sample is finite and of magnitude 1e6 at most.
    pub(crate) fn is_valid_sample(sample: f32) -> bool {
        sample.is_finite() && sample.abs() <= MAX_MAGNITUDE
    }

    /// Makes a grey float frame, with black at 0 and white at 1.
    ///
    /// # Errors
    /// As [`Frame::new`].
    pub fn gray(width: u32, height: u32, values: Vec<f32>) -> Result<Self, String> {
        Self::new(width, height, Channels::Gray, Samples::F32(values))
    }

    /// Returns the width, px.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Returns the height, px.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Returns channels and sample storage.
    pub fn format(&self) -> Format {
        let depth = match self.samples {
            Samples::U8(_) => Depth::U8,
            Samples::U16(_) => Depth::U16,
            Samples::F32(_) => Depth::F32,
        };
        Format { channels: self.channels, depth }
    }

    /// Returns a region of the frame.
    ///
    /// # Errors
    /// A message if the region is not within the frame.
    pub fn cropped(&self, region: Region) -> Result<Self, String> {
        region.check((self.width, self.height)).map_err(|e| e.to_string())?;
        let (row, channels) = (self.width as usize, self.channels.count() as usize);
        let samples = match &self.samples {
            Samples::U8(s) => Samples::U8(region.crop(s, row, channels)),
            Samples::U16(s) => Samples::U16(region.crop(s, row, channels)),
            Samples::F32(s) => Samples::F32(region.crop(s, row, channels)),
        };
        let counted = self.counted.as_ref().map(|counted| region.crop(counted, row, 1));
        Ok(Self { width: region.width, height: region.height, channels: self.channels, samples, counted })
    }

    /// Leaves out the pixels whose byte is 0, such as transparent ones: they are not part of the picture.
    pub(crate) fn without(self, bytes: &[u8]) -> Self {
        let own = self.counted.as_deref().unwrap_or(bytes);
        Self { counted: Some(own.iter().zip(bytes).map(|(own, byte)| *own.min(byte)).collect()), ..self }
    }

    /// Leaves out and blackens the pixels that are not opaque, unless none is.
    pub(crate) fn opaque(self, opaque: Option<Vec<bool>>) -> Self {
        let Some(opaque) = opaque.filter(|opaque| opaque.contains(&true) && opaque.contains(&false)) else {
            return self;
        };
        let (values, channels) = (self.intensities(Decode::None), self.channels.count() as usize);
        let shown = values.iter().enumerate().map(|(n, v)| if opaque[n / channels] { *v } else { 0.0 });
        let bytes: Vec<u8> = opaque.iter().map(|opaque| u8::from(*opaque)).collect();
        self.with_intensities(&shown.collect::<Vec<_>>()).without(&bytes)
    }

    /// Returns 1 for each pixel that is part of the picture, else 0; `None` if all are.
    pub(crate) fn counted(&self) -> Option<&[u8]> {
        self.counted.as_deref()
    }

    /// Returns the intensities, interleaved, with white at 1.
    pub(crate) fn intensities(&self, decode: Decode) -> Vec<f32> {
        let decode = decode.resolved([self.format().depth]);
        match &self.samples {
            Samples::U8(s) => {
                let table = intensities_to(u8::MAX.into(), decode);
                s.iter().map(|&v| table[usize::from(v)]).collect()
            }
            Samples::U16(s) => {
                let table = intensities_to(u16::MAX, decode);
                s.iter().map(|&v| table[usize::from(v)]).collect()
            }
            Samples::F32(s) => s.iter().map(|&v| decode.intensity(v.into()) as f32).collect(),
        }
    }

    /// Returns the mean intensities of square cells of `step` px, interleaved, with white at 1, and the number of cells
    /// along each side. Cells at the right and lower border may be smaller.
    pub(crate) fn mean_intensities(&self, step: usize, decode: Decode) -> (Vec<f32>, [usize; 2]) {
        let decode = decode.resolved([self.format().depth]);
        match &self.samples {
            Samples::U8(s) => {
                let table = intensities_to(u8::MAX.into(), decode);
                self.means(s, step, |v| table[usize::from(v)])
            }
            Samples::U16(s) => {
                let table = intensities_to(u16::MAX, decode);
                self.means(s, step, |v| table[usize::from(v)])
            }
            Samples::F32(s) => self.means(s, step, |v| decode.intensity(v.into()) as f32),
        }
    }

    fn means<T: Copy + Sync>(
        &self,
        samples: &[T],
        step: usize,
        value: impl Fn(T) -> f32 + Sync,
    ) -> (Vec<f32>, [usize; 2]) {
        let (row, channels) = (self.width as usize * self.channels.count() as usize, self.channels.count() as usize);
        let cells = [self.width, self.height].map(|side| (side as usize).div_ceil(step));
        let mut means = vec![0.0; cells[0] * cells[1] * channels];
        let rows = means.chunks_exact_mut(cells[0] * channels).zip(samples.chunks(step * row));
        workers::for_each(rows, |(means, samples)| {
            for line in samples.chunks_exact(row) {
                for (mean, cell) in means.chunks_exact_mut(channels).zip(line.chunks(step * channels)) {
                    for pixel in cell.chunks_exact(channels) {
                        mean.iter_mut().zip(pixel).for_each(|(mean, sample)| *mean += value(*sample));
                    }
                }
            }
            let lines = samples.len() / row;
            for (x, mean) in means.chunks_exact_mut(channels).enumerate() {
                let pixels = lines * step.min(self.width as usize - x * step);
                mean.iter_mut().for_each(|sum| *sum /= pixels as f32);
            }
        });
        (means, cells)
    }

    /// Returns a frame of the same size and format with other intensities, white at 1. Integers are rounded and
    /// clamped.
    pub(crate) fn with_intensities(&self, values: &[f32]) -> Self {
        let scaled = |v: &f32, white: f32| (v * white).round().clamp(0.0, white);
        let samples = match &self.samples {
            Samples::U8(_) => Samples::U8(values.iter().map(|v| scaled(v, 255.0) as u8).collect()),
            Samples::U16(_) => Samples::U16(values.iter().map(|v| scaled(v, 65535.0) as u16).collect()),
            Samples::F32(_) => Samples::F32(values.to_vec()),
        };
        Self { samples, ..self.clone() }
    }

    /// Returns the frame in 16 bits instead of 8.
    pub(crate) fn widened(&self) -> Self {
        match &self.samples {
            Samples::U8(s) => {
                Self { samples: Samples::U16(s.iter().map(|&v| 257 * u16::from(v)).collect()), ..self.clone() }
            }
            _ => self.clone(),
        }
    }

    /// Returns whether any pixel is clipped: one channel at the white level or above, or all at the black level or
    /// below. The levels of integers are on a scale from 0 to 1.
    pub(crate) fn has_clipped_pixels(&self, [black, white]: [f32; 2]) -> bool {
        let channels = self.channels.count() as usize;
        match &self.samples {
            Samples::U8(s) => has_clipped_pixels(s, channels, [black, white].map(|level| 255.0 * level)),
            Samples::U16(s) => has_clipped_pixels(s, channels, [black, white].map(|level| 65535.0 * level)),
            Samples::F32(s) => has_clipped_pixels(s, channels, [black, white]),
        }
    }

    /// Returns the fraction of clipped pixels, of those that a mask of the same size does not exclude.
    pub(crate) fn clipped_fraction(&self, [black, white]: [f32; 2], mask: Option<&[u8]>) -> f64 {
        let channels = self.channels.count() as usize;
        let count = match &self.samples {
            Samples::U8(s) => count_clipped(s, channels, [black, white].map(|level| 255.0 * level), mask),
            Samples::U16(s) => count_clipped(s, channels, [black, white].map(|level| 65535.0 * level), mask),
            Samples::F32(s) => count_clipped(s, channels, [black, white], mask),
        };
        let open = |mask: &[u8]| mask.iter().filter(|&&counts| counts != 0).count();
        count as f64 / mask.map_or(self.width as usize * self.height as usize, open).max(1) as f64
    }

    /// Copies the samples to `to`, in parallel, and returns whether any pixel is clipped, as
    /// [`has_clipped_pixels`](Self::has_clipped_pixels). Each block is checked while it is in the processor's cache.
    pub(crate) fn copy_samples(&self, to: &mut [u8], levels: [f32; 2]) -> bool {
        let channels = self.channels.count() as usize;
        let [black, white] = levels;
        match &self.samples {
            Samples::U8(s) => copy_samples(s, channels, to, [black, white].map(|level| 255.0 * level)),
            Samples::U16(s) => copy_samples(s, channels, to, [black, white].map(|level| 65535.0 * level)),
            Samples::F32(s) => copy_samples(s, channels, to, levels),
        }
    }

    /// Returns the samples.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Returns the bytes of the samples, as they are uploaded.
    pub fn bytes(&self) -> &[u8] {
        match &self.samples {
            Samples::U8(s) => s,
            Samples::U16(s) => bytemuck::cast_slice(s),
            Samples::F32(s) => bytemuck::cast_slice(s),
        }
    }
}

/// Returns the intensities of the integers up to `white`. A table saves the power of the curve, since integers have few
/// values.
fn intensities_to(white: u16, decode: Decode) -> Vec<f32> {
    (0..=white).map(|v| decode.intensity(f64::from(v) / f64::from(white)) as f32).collect()
}

/// Copies samples to bytes, and returns whether any pixel is clipped.
fn copy_samples<T: bytemuck::Pod + Into<f32> + Sync>(
    from: &[T],
    channels: usize,
    to: &mut [u8],
    levels: [f32; 2],
) -> bool {
    // A block of 2^18 pixels takes much longer than the start of a thread.
    let block = channels << 18;
    let is_clipped = AtomicBool::new(false);
    let blocks = to.chunks_mut(block * size_of::<T>()).zip(from.chunks(block));
    workers::for_each(blocks, |(to, from)| {
        to[..size_of_val(from)].copy_from_slice(bytemuck::cast_slice(from));
        if !is_clipped.load(Ordering::Relaxed) && has_clipped_pixels(from, channels, levels) {
            is_clipped.store(true, Ordering::Relaxed);
        }
    });
    is_clipped.into_inner()
}

/// Counts the clipped pixels that a mask does not exclude.
fn count_clipped<T: Copy + Into<f32> + Sync>(
    samples: &[T],
    channels: usize,
    levels: [f32; 2],
    mask: Option<&[u8]>,
) -> usize {
    let blocks: Vec<&[T]> = samples.chunks(channels << 18).collect();
    let count = |n: usize| {
        if !has_clipped_pixels(blocks[n], channels, levels) {
            return 0;
        }
        let is_open = |pixel: usize| mask.is_none_or(|mask| mask[(n << 18) + pixel] != 0);
        let pixels = blocks[n].chunks_exact(channels).enumerate();
        pixels.filter(|(pixel, samples)| is_clipped_pixel(samples, levels) && is_open(*pixel)).count()
    };
    workers::map(blocks.len(), count).into_iter().sum()
}

/// Returns whether any pixel is clipped.
fn has_clipped_pixels<T: Copy + Into<f32>>(samples: &[T], channels: usize, [black, white]: [f32; 2]) -> bool {
    // A vectorized test of whole blocks comes first, since most images have almost no clipped samples.
    samples.chunks(4096 * channels).any(|block| {
        let may = block.iter().fold(false, |may, &s| may | (s.into() >= white) | (s.into() <= black));
        may && block.chunks_exact(channels).any(|pixel| is_clipped_pixel(pixel, [black, white]))
    })
}

/// Returns whether one sample of a pixel is `white` or above, or all are `black` or below.
fn is_clipped_pixel<T: Copy + Into<f32>>(pixel: &[T], [black, white]: [f32; 2]) -> bool {
    pixel.iter().any(|&s| s.into() >= white) || pixel.iter().all(|&s| s.into() <= black)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_samples_are_copied_and_every_block_is_checked() {
        let levels = [0.5 / 255.0, 254.5 / 255.0];
        for (width, height) in [(7, 5), (1000, 700)] {
            let mut values: Vec<u8> = (0..3 * width * height).map(|n| 1 + (n % 251) as u8).collect();
            for clipped in [None, Some(0), Some(values.len() - 1)] {
                clipped.into_iter().for_each(|n: usize| values[n] = 255);
                let frame = Frame::new(width, height, Channels::Rgb, Samples::U8(values.clone())).unwrap();
                // The buffer may be longer.
                let mut bytes = vec![0; values.len() + 3];
                assert_eq!(frame.copy_samples(&mut bytes, levels), clipped.is_some());
                assert_eq!(frame.has_clipped_pixels(levels), clipped.is_some());
                let fraction = frame.clipped_fraction(levels, None);
                assert_eq!(fraction * (width * height) as f64, f64::from(u8::from(clipped.is_some())));
                let mut mask = vec![1; (width * height) as usize];
                clipped.into_iter().for_each(|n| mask[n / 3] = 0);
                assert_eq!(frame.clipped_fraction(levels, Some(&mask)), 0.0);
                assert_eq!(bytes[..values.len()], values);
                clipped.into_iter().for_each(|n| values[n] = 1);
            }
        }
        let frame = Frame::new(2, 1, Channels::Gray, Samples::U16(vec![513, 65535])).unwrap();
        let mut bytes = vec![0; 4];
        assert!(frame.copy_samples(&mut bytes, levels));
        assert_eq!(bytes, bytemuck::cast_slice::<u16, u8>(&[513, 65535]));
    }
}
