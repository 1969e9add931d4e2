//! PNG, JPEG, PNM, BMP and WebP through the `image` crate.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::header::{CONVERT, DAMAGED, Header};
use super::tiff_page::turned;
use crate::base::{Channels, Depth, Frame, Samples};

/// The formats that are read, with their usual names.
const READ: [(ImageFormat, &str); 5] = [
    (ImageFormat::Png, "PNG"),
    (ImageFormat::Jpeg, "JPEG"),
    (ImageFormat::Pnm, "PNM"),
    (ImageFormat::Bmp, "BMP"),
    (ImageFormat::WebP, "WebP"),
];

/// Greatest number of bytes for the header of a PNG and a row of pixels, 8 MiB. A profile that decompresses to more is
/// skipped.
const MAX_HEADER: u64 = 8 << 20;

/// A file with a parsed header.
pub(super) struct Raster<'a> {
    pub(super) header: Header,
    decoder: Box<dyn ImageDecoder + 'a>,
    pub(super) orientation: Orientation,
}

impl<'a> Raster<'a> {
    /// Reads the header.
    pub(super) fn open(bytes: &'a [u8]) -> Result<Self, String> {
        let Ok(found) = image::guess_format(bytes) else {
            return Err(format!("is in no image format that parfocal knows; {CONVERT}"));
        };
        let Some(&(_, format)) = READ.iter().find(|(read, _)| *read == found) else {
            return Err(format!("is in a format that parfocal does not read ({found:?}); {CONVERT}"));
        };
        let mut limits = Limits::no_limits();
        limits.max_alloc = Some(MAX_HEADER);
        let mut reader = ImageReader::with_format(Cursor::new(bytes), found);
        reader.limits(limits);
        let mut decoder = reader.into_decoder().map_err(|e| problem(format, &e))?;
        let orientation = decoder.orientation().map_err(|e| problem(format, &e))?;
        let (size, color) = (turned(decoder.dimensions(), orientation), decoder.color_type());
        let bits = u32::from(color.bits_per_pixel()) / u32::from(color.channel_count()).max(1);
        let depth = if bits == 16 { Depth::U16 } else { Depth::U8 };
        let channels = if color.has_color() { Channels::Rgb } else { Channels::Gray };
        let header = Header { format, size, depth, bits, channels, alpha: color.has_alpha(), pages: 1 };
        Ok(Self { header, decoder: Box::new(decoder), orientation })
    }

    /// The EXIF data, as a TIFF structure, and the ICC profile, if present.
    pub(super) fn metadata(&mut self) -> (Option<Vec<u8>>, Option<Vec<u8>>) {
        (self.decoder.exif_metadata().ok().flatten(), self.decoder.icc_profile().ok().flatten())
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let mut image = DynamicImage::from_decoder(self.decoder).map_err(|e| problem(self.header.format, &e))?;
        image.apply_orientation(self.orientation);
        frame(image)
    }
}

fn problem(format: &str, error: &image::ImageError) -> String {
    match error {
        image::ImageError::Unsupported(e) => format!("this kind of {format} is not read ({e}); {CONVERT}, 8 or 16 bit"),
        image::ImageError::Limits(e) => {
            format!("this {format} takes too much memory to decode ({e}); save it without metadata, or reduce it")
        }
        e => format!("cannot be decoded as {format} ({e}); {DAMAGED}"),
    }
}

fn frame(image: DynamicImage) -> Result<Frame, String> {
    use DynamicImage::*;
    let (width, height) = (image.width(), image.height());
    let alpha = image.color().has_alpha().then(|| image.to_rgba8().pixels().map(|p| p.0[3] >= 128).collect::<Vec<_>>());
    let (channels, samples) = match image {
        ImageLuma8(_) | ImageLumaA8(_) => (Channels::Gray, Samples::U8(image.into_luma8().into_raw())),
        ImageLuma16(_) | ImageLumaA16(_) => (Channels::Gray, Samples::U16(image.into_luma16().into_raw())),
        ImageRgb8(_) | ImageRgba8(_) => (Channels::Rgb, Samples::U8(image.into_rgb8().into_raw())),
        ImageRgb16(_) | ImageRgba16(_) => (Channels::Rgb, Samples::U16(image.into_rgb16().into_raw())),
        ImageRgb32F(_) | ImageRgba32F(_) => (Channels::Rgb, Samples::F32(image.into_rgb32f().into_raw())),
        other => return Err(format!("holds {:?} samples, which are not read; {CONVERT}", other.color())),
    };
    Ok(Frame::new(width, height, channels, samples)?.opaque(alpha))
}

/// Refuses a JPEG without an end.
pub(super) fn check_end(bytes: &[u8]) -> Result<(), String> {
    match image::guess_format(bytes) {
        Ok(ImageFormat::Jpeg) if !jpeg_has_end(bytes) => Err(format!("the JPEG breaks off before its end; {DAMAGED}")),
        _ => Ok(()),
    }
}

/// Whether the scan of a JPEG ends with an end-of-image marker.
///
/// The decoder fills missing data with grey, which would give a wrong depth without a warning. The segments before the
/// scan are skipped because a thumbnail in them has its own end marker. Data that does not look like segments is left
/// for the decoder to refuse.
fn jpeg_has_end(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xda;
    const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = bytes.get(at..at + 4) {
        match marker {
            START_OF_SCAN => return bytes[at..].windows(2).any(|pair| pair == END_OF_IMAGE),
            0xff => at += 1,
            _ => at += 2 + usize::from(u16::from_be_bytes([high, low])),
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_that_decompresses_to_too_much_is_skipped() {
        let mut info = png::Info::with_size(1, 1);
        info.icc_profile = Some(vec![0; 9 << 20].into());
        let mut bytes = Vec::new();
        let mut writer = png::Encoder::with_info(&mut bytes, info).unwrap().write_header().unwrap();
        writer.write_image_data(&[7]).unwrap();
        writer.finish().unwrap();
        assert!(bytes.len() < 1 << 18);
        let mut raster = Raster::open(&bytes).unwrap();
        assert_eq!(raster.metadata(), (None, None));
        assert_eq!(raster.decode().unwrap().samples(), &Samples::U8(vec![7]));
    }
}
