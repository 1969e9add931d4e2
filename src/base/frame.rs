//! A photograph as the sensor or the file gave it.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::color::srgb_to_linear;
use crate::base::{Decode, Region, workers};

/// How one sample of a [`Frame`] is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Depth {
    /// 8 bits, white at 255.
    U8,
    /// 16 bits, white at 65535.
    U16,
    /// 32-bit float, white at 1.
    F32,
}

/// Colour channels of a [`Frame`]; alpha is not carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channels {
    /// One luminance channel.
    Gray,
    /// Red, green, blue, interleaved.
    Rgb,
}

impl Channels {
    /// 1 or 3.
    pub fn count(self) -> u32 {
        match self {
            Channels::Gray => 1,
            Channels::Rgb => 3,
        }
    }
}

impl Depth {
    /// Bytes a sample.
    pub fn bytes(self) -> u32 {
        match self {
            Depth::U8 => 1,
            Depth::U16 => 2,
            Depth::F32 => 4,
        }
    }
}

/// The samples of a [`Frame`], row-major, channels interleaved.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8-bit samples.
    U8(Vec<u8>),
    /// 16-bit samples.
    U16(Vec<u16>),
    /// Float samples; finite, and at most 1e6 in size.
    F32(Vec<f32>),
}

/// One photograph: `height` rows of `width` pixels of one or three interleaved samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    width: u32,
    height: u32,
    channels: Channels,
    samples: Samples,
}

/// What a solver must know of a frame before it sees one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Format {
    /// Colour channels.
    pub channels: Channels,
    /// Storage of a sample.
    pub depth: Depth,
}

/// Largest float sample, in size: squares of sums of such still fit into single precision.
const LARGEST: f32 = 1e6;

impl Frame {
    /// A frame of `width * height * channels` samples.
    ///
    /// # Errors
    /// A sentence that says what is wrong: another number of samples, or a float sample that is not finite or beyond 1e6.
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
            && let Some(i) = s.iter().position(|&v| !Self::may_hold(v))
        {
            let pixel = i / channels.count() as usize;
            let (x, y) = (pixel % width as usize, pixel / width as usize);
            return Err(format!(
                "the sample at pixel ({x}, {y}) is {}, not a number of at most {LARGEST:e}: white is 1",
                s[i]
            ));
        }
        Ok(Self { width, height, channels, samples })
    }

    /// Whether a float sample is finite, and at most 1e6 in size.
    pub(crate) fn may_hold(sample: f32) -> bool {
        sample.is_finite() && sample.abs() <= LARGEST
    }

    /// A grey float frame, values in [0, 1].
    ///
    /// # Errors
    /// As [`Frame::new`].
    pub fn gray(width: u32, height: u32, values: Vec<f32>) -> Result<Self, String> {
        Self::new(width, height, Channels::Gray, Samples::F32(values))
    }

    /// Pixels a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Channels and storage.
    pub fn format(&self) -> Format {
        let depth = match self.samples {
            Samples::U8(_) => Depth::U8,
            Samples::U16(_) => Depth::U16,
            Samples::F32(_) => Depth::F32,
        };
        Format { channels: self.channels, depth }
    }

    /// A part of it.
    ///
    /// # Errors
    /// A sentence that says that the region is not within the frame.
    pub fn cropped(&self, region: Region) -> Result<Self, String> {
        let Region { x, y, width, height } = region;
        let within =
            |from: u32, length: u32, side: u32| length > 0 && u64::from(from) + u64::from(length) <= u64::from(side);
        if !within(x, width, self.width) || !within(y, height, self.height) {
            return Err(format!(
                "the region {x},{y},{width},{height} is not within the image of {}x{} px",
                self.width, self.height
            ));
        }
        let (row, channels) = (self.width as usize, self.channels.count() as usize);
        let samples = match &self.samples {
            Samples::U8(s) => Samples::U8(region.of(s, row, channels)),
            Samples::U16(s) => Samples::U16(region.of(s, row, channels)),
            Samples::F32(s) => Samples::F32(region.of(s, row, channels)),
        };
        Ok(Self { width, height, channels: self.channels, samples })
    }

    /// Intensities, interleaved, white at 1.
    pub(crate) fn intensities(&self, decode: Decode) -> Vec<f32> {
        let decode = decode.resolved([self.format().depth]);
        let value = |stored: f64| if decode == Decode::Srgb { srgb_to_linear(stored) } else { stored } as f32;
        // The curve takes a power, and integers have few values.
        let table = |white: u16| (0..=white).map(|v| value(f64::from(v) / f64::from(white))).collect::<Vec<f32>>();
        match &self.samples {
            Samples::U8(s) => {
                let table = table(u8::MAX.into());
                s.iter().map(|&v| table[usize::from(v)]).collect()
            }
            Samples::U16(s) => {
                let table = table(u16::MAX);
                s.iter().map(|&v| table[usize::from(v)]).collect()
            }
            Samples::F32(s) => s.iter().map(|&v| value(v.into())).collect(),
        }
    }

    /// A frame of the same size and format that holds other intensities, white at 1; integers are rounded, and what does not
    /// fit them is clamped.
    pub(crate) fn with_intensities(&self, values: &[f32]) -> Self {
        let scaled = |v: &f32, white: f32| (v * white).round().clamp(0.0, white);
        let samples = match &self.samples {
            Samples::U8(_) => Samples::U8(values.iter().map(|v| scaled(v, 255.0) as u8).collect()),
            Samples::U16(_) => Samples::U16(values.iter().map(|v| scaled(v, 65535.0) as u16).collect()),
            Samples::F32(_) => Samples::F32(values.to_vec()),
        };
        Self { samples, ..self.clone() }
    }

    /// Whether any pixel is clipped: one channel from the white level on, or all up to the black level; of integers on a
    /// scale from 0 to 1.
    pub(crate) fn clips(&self, [black, white]: [f32; 2]) -> bool {
        let channels = self.channels.count() as usize;
        match &self.samples {
            Samples::U8(s) => clips(s, channels, [black, white].map(|level| 255.0 * level)),
            Samples::U16(s) => clips(s, channels, [black, white].map(|level| 65535.0 * level)),
            Samples::F32(s) => clips(s, channels, [black, white]),
        }
    }

    /// Writes the samples as they go up to the device, and says whether any pixel is clipped as by [`Frame::clips`]: by all threads, and each
    /// piece is looked at while the processor still has it.
    pub(crate) fn bring(&self, to: &mut [u8], levels: [f32; 2]) -> bool {
        let channels = self.channels.count() as usize;
        let [black, white] = levels;
        match &self.samples {
            Samples::U8(s) => bring(s, channels, to, [black, white].map(|level| 255.0 * level)),
            Samples::U16(s) => bring(s, channels, to, [black, white].map(|level| 65535.0 * level)),
            Samples::F32(s) => bring(s, channels, to, levels),
        }
    }

    /// The samples.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// The samples as they go up to the device.
    pub fn bytes(&self) -> &[u8] {
        match &self.samples {
            Samples::U8(s) => s,
            Samples::U16(s) => bytemuck::cast_slice(s),
            Samples::F32(s) => bytemuck::cast_slice(s),
        }
    }
}

/// Writes samples to bytes, and says whether any pixel is clipped.
fn bring<T: bytemuck::Pod + Into<f32> + Sync>(from: &[T], channels: usize, to: &mut [u8], levels: [f32; 2]) -> bool {
    // A piece is a quarter of a MiB, of colour floats three: a thread's start is next to nothing beside it.
    let piece = channels << 18;
    let found = AtomicBool::new(false);
    let pieces = to.chunks_mut(piece * size_of::<T>()).zip(from.chunks(piece));
    workers::each(pieces, |(to, from)| {
        to[..size_of_val(from)].copy_from_slice(bytemuck::cast_slice(from));
        if !found.load(Ordering::Relaxed) && clips(from, channels, levels) {
            found.store(true, Ordering::Relaxed);
        }
    });
    found.into_inner()
}

/// Whether any pixel is clipped.
fn clips<T: Copy + Into<f32>>(samples: &[T], channels: usize, [black, white]: [f32; 2]) -> bool {
    // First a test of many samples at once, which the processor does side by side: most images have next to none.
    samples.chunks(4096 * channels).any(|many| {
        let may = many.iter().fold(false, |may, &s| may | (s.into() >= white) | (s.into() <= black));
        may && many.chunks_exact(channels).any(|pixel| is_clipped(pixel, [black, white]))
    })
}

/// Whether one sample of a pixel is from `white` on, or all are up to `black`.
fn is_clipped<T: Copy + Into<f32>>(pixel: &[T], [black, white]: [f32; 2]) -> bool {
    pixel.iter().any(|&s| s.into() >= white) || pixel.iter().all(|&s| s.into() <= black)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_of_a_frame_is_brought_and_every_piece_looked_at() {
        let levels = [0.5 / 255.0, 254.5 / 255.0];
        for (width, height) in [(7, 5), (1000, 700)] {
            let mut values: Vec<u8> = (0..3 * width * height).map(|n| 1 + (n % 251) as u8).collect();
            for clipped in [None, Some(0), Some(values.len() - 1)] {
                clipped.into_iter().for_each(|n: usize| values[n] = 255);
                let frame = Frame::new(width, height, Channels::Rgb, Samples::U8(values.clone())).unwrap();
                // A buffer may be longer.
                let mut bytes = vec![0; values.len() + 3];
                assert_eq!(frame.bring(&mut bytes, levels), clipped.is_some());
                assert_eq!(frame.clips(levels), clipped.is_some());
                assert_eq!(bytes[..values.len()], values);
                clipped.into_iter().for_each(|n| values[n] = 1);
            }
        }
        let frame = Frame::new(2, 1, Channels::Gray, Samples::U16(vec![513, 65535])).unwrap();
        let mut bytes = vec![0; 4];
        assert!(frame.bring(&mut bytes, levels));
        assert_eq!(bytes, bytemuck::cast_slice::<u16, u8>(&[513, 65535]));
    }
}
