//! Grey TIFF in 32-bit floats, the form in which laboratories keep measurements and which the `image` crate refuses.

use std::fs::File;
use std::io::BufReader;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{SampleFormat, Tag};
use tiff::{ColorType, TiffError};

use super::MAX_PIXELS;
use super::check::DAMAGED;
use crate::Frame;

/// A grey float TIFF whose header has been read.
pub(super) struct TiffFloat {
    decoder: Decoder<BufReader<File>>,
    size: (u32, u32),
}

/// Whether a file starts as classic or big TIFF, in either byte order.
pub(super) fn is_tiff(magic: [u8; 4]) -> bool {
    matches!(&magic, b"II*\0" | b"MM\0*" | b"II+\0" | b"MM\0+")
}

fn problem(error: TiffError) -> String {
    format!("cannot be decoded as TIFF ({error}); {DAMAGED}")
}

impl TiffFloat {
    /// Reads the header; `None` if this is another kind of TIFF.
    pub(super) fn open(file: BufReader<File>) -> Result<Option<Self>, String> {
        let mut decoder = Decoder::new(file).map_err(problem)?;
        let formats = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).map_err(problem)?;
        let float = formats.is_some_and(|f| f.first() == Some(&SampleFormat::IEEEFP.to_u16()));
        if !float || !matches!(decoder.colortype(), Ok(ColorType::Gray(32))) {
            return Ok(None);
        }
        // Turning pixels is left to the `image` crate, which has no grey float image; no camera writes one either.
        if let Some(turn @ 2..) = decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(problem)? {
            return Err(format!(
                "asks to be turned (orientation {turn}), which is not done for grey floats; save it upright"
            ));
        }
        let size = decoder.dimensions().map_err(problem)?;
        let mut limits = Limits::default();
        limits.decoding_buffer_size = usize::try_from(4 * MAX_PIXELS).unwrap_or(usize::MAX);
        Ok(Some(Self { decoder: decoder.with_limits(limits), size }))
    }

    /// Width and height.
    pub(super) fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Decodes the pixels.
    pub(super) fn decode(mut self) -> Result<Frame, String> {
        match self.decoder.read_image().map_err(problem)? {
            DecodingResult::F32(values) => Frame::gray(self.size.0, self.size.1, values),
            _ => Err(format!("cannot be decoded as TIFF (its samples are not 32-bit floats); {DAMAGED}")),
        }
    }
}
