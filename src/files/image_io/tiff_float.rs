//! Grey TIFF in 32-bit floats, the form in which laboratories keep measurements and which the `image` crate refuses.

use std::io::{Read, Seek};

use image::metadata::Orientation;
use image::{ImageBuffer, Luma, imageops};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{SampleFormat, Tag};
use tiff::{ColorType, TiffError};

use super::MAX_PIXELS;
use super::check::DAMAGED;
use crate::base::Frame;

/// A grey float TIFF whose header has been read.
pub(super) struct TiffFloat<R: Read + Seek> {
    decoder: Decoder<R>,
    size: (u32, u32),
    orientation: Orientation,
}

/// Whether a file starts as classic or big TIFF, in either byte order.
pub(super) fn is_tiff(magic: &[u8]) -> bool {
    [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|start| magic.starts_with(*start))
}

fn problem(error: TiffError) -> String {
    format!("cannot be decoded as TIFF ({error}); {DAMAGED}")
}

impl<R: Read + Seek> TiffFloat<R> {
    /// Reads the header; `None` if this is another kind of TIFF.
    pub(super) fn open(file: R) -> Result<Option<Self>, String> {
        let mut decoder = Decoder::new(file).map_err(problem)?;
        let formats = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).map_err(problem)?;
        let float = formats.is_some_and(|f| f.first() == Some(&SampleFormat::IEEEFP.to_u16()));
        if !float || !matches!(decoder.colortype(), Ok(ColorType::Gray(32))) {
            return Ok(None);
        }
        let turn = decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(problem)?;
        let turn = turn.and_then(|turn| Orientation::from_exif(u8::try_from(turn).ok()?));
        let orientation = turn.unwrap_or(Orientation::NoTransforms);
        let size = decoder.dimensions().map_err(problem)?;
        let mut limits = Limits::default();
        limits.decoding_buffer_size = usize::try_from(4 * MAX_PIXELS).unwrap_or(usize::MAX);
        Ok(Some(Self { decoder: decoder.with_limits(limits), size, orientation }))
    }

    /// Width and height once the camera's rotation is applied.
    pub(super) fn size(&self) -> (u32, u32) {
        super::turned(self.size, self.orientation)
    }

    /// Decodes the pixels.
    pub(super) fn decode(mut self) -> Result<Frame, String> {
        match self.decoder.read_image().map_err(problem)? {
            DecodingResult::F32(values) => turn(values, self.size, self.orientation),
            _ => Err(format!("cannot be decoded as TIFF (its samples are not 32-bit floats); {DAMAGED}")),
        }
    }
}

/// The upright frame. `image` turns its own kinds of images only, of which grey floats are none.
fn turn(values: Vec<f32>, (width, height): (u32, u32), orientation: Orientation) -> Result<Frame, String> {
    let stored: ImageBuffer<Luma<f32>, Vec<f32>> = ImageBuffer::from_raw(width, height, values)
        .ok_or_else(|| format!("cannot be decoded as TIFF (it holds too few samples); {DAMAGED}"))?;
    let upright = match orientation {
        Orientation::NoTransforms => stored,
        Orientation::Rotate90 => imageops::rotate90(&stored),
        Orientation::Rotate180 => imageops::rotate180(&stored),
        Orientation::Rotate270 => imageops::rotate270(&stored),
        Orientation::FlipHorizontal => imageops::flip_horizontal(&stored),
        Orientation::FlipVertical => imageops::flip_vertical(&stored),
        Orientation::Rotate90FlipH => imageops::flip_horizontal(&imageops::rotate90(&stored)),
        Orientation::Rotate270FlipH => imageops::flip_horizontal(&imageops::rotate270(&stored)),
    };
    Frame::gray(upright.width(), upright.height(), upright.into_raw())
}
