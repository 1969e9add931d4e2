//! The samples of a TIFF, as they are stored, to a frame.

use image::metadata::Orientation;
use image::{ImageBuffer, Luma, Pixel, Primitive, Rgb, imageops};

use super::check::DAMAGED;
use super::turn::turned;
use crate::base::{Channels, Frame, Samples};

/// Bits as bytes, 0 or 255; each row begins with a byte.
pub(super) fn bytes_of(bits: &[u8], width: u32) -> Vec<u8> {
    let width = width as usize;
    let byte = |row: &[u8], x: usize| if row[x / 8] << (x % 8) & 0x80 == 0 { 0 } else { 255 };
    bits.chunks_exact(width.div_ceil(8)).flat_map(|row| (0..width).map(move |x| byte(row, x))).collect()
}

/// How the samples of a page lie.
pub(super) struct Stored {
    /// Width and height, as stored.
    pub(super) size: (u32, u32),
    /// Of a pixel, those besides the colours last.
    pub(super) samples: usize,
    /// Whether all samples of one kind lie together.
    pub(super) planar: bool,
    /// The colours.
    pub(super) channels: Channels,
    /// How the picture is to be turned.
    pub(super) orientation: Orientation,
}

impl Stored {
    /// The upright frame.
    pub(super) fn frame<T: Primitive + 'static>(
        &self,
        values: Vec<T>,
        wrap: fn(Vec<T>) -> Samples,
    ) -> Result<Frame, String>
    where
        Rgb<T>: Pixel<Subpixel = T>,
    {
        let colors = self.colors(values);
        let upright = match self.channels {
            Channels::Gray => self.upright::<Luma<T>>(colors),
            Channels::Rgb => self.upright::<Rgb<T>>(colors),
        };
        let values =
            upright.ok_or_else(|| format!("cannot be decoded as TIFF (it holds too few samples); {DAMAGED}"))?;
        let (width, height) = turned(self.size, self.orientation);
        Frame::new(width, height, self.channels, wrap(values))
    }

    /// The colours alone, interleaved.
    fn colors<T: Copy>(&self, values: Vec<T>) -> Vec<T> {
        let (pixels, colors) = (self.size.0 as usize * self.size.1 as usize, self.channels.count() as usize);
        if self.planar {
            let planes: Vec<&[T]> = values.chunks_exact(pixels).take(colors).collect();
            return (0..pixels).flat_map(|i| planes.iter().map(move |plane| plane[i])).collect();
        }
        if self.samples == colors {
            return values;
        }
        values.chunks_exact(self.samples).flat_map(|pixel| &pixel[..colors]).copied().collect()
    }

    /// Turned as the camera says; `None` where there are too few samples.
    fn upright<P: Pixel + 'static>(&self, values: Vec<P::Subpixel>) -> Option<Vec<P::Subpixel>> {
        let stored: ImageBuffer<P, _> = ImageBuffer::from_raw(self.size.0, self.size.1, values)?;
        let upright = match self.orientation {
            Orientation::NoTransforms => stored,
            Orientation::Rotate90 => imageops::rotate90(&stored),
            Orientation::Rotate180 => imageops::rotate180(&stored),
            Orientation::Rotate270 => imageops::rotate270(&stored),
            Orientation::FlipHorizontal => imageops::flip_horizontal(&stored),
            Orientation::FlipVertical => imageops::flip_vertical(&stored),
            Orientation::Rotate90FlipH => imageops::flip_horizontal(&imageops::rotate90(&stored)),
            Orientation::Rotate270FlipH => imageops::flip_horizontal(&imageops::rotate270(&stored)),
        };
        Some(upright.into_raw())
    }
}
