//! TIFF pages, grey or colour, in 8 or 16 bits or float, or bilevel, by the crate `tiff`.

use std::io::Cursor;

use DecodingSampleType::{F16, F32, U8, U16};
use image::metadata::Orientation;
use image::{ImageBuffer, Luma, Pixel, Primitive, Rgb, imageops};
use tiff::decoder::{Decoder, DecodingResult, DecodingSampleType, Limits};
use tiff::tags::{Tag, Type, ValueBuffer};
use tiff::{ColorType, TiffError, TiffUnsupportedError};

use super::header::{DAMAGED, Header, MAX_PIXELS};
use crate::base::{Channels, Depth, Format, Frame, Samples};

/// Greatest number of pages of a file.
const MAX_PAGES: usize = 1 << 16;

/// Bytes that one pixel may take while it is decoded: RGBA in 32-bit floats.
const LARGEST_PIXEL: u64 = 16;
/// Least memory limit, 16 MiB: a tile of a megapixel of such pixels.
const LEAST_LIMIT: usize = 16 << 20;

/// A page whose directory has been parsed.
pub(super) struct TiffPage<'a> {
    pub(super) header: Header,
    decoder: Decoder<Cursor<&'a [u8]>>,
    /// Width and height as stored, px.
    size: (u32, u32),
    color: ColorType,
    pub(super) orientation: Orientation,
}

/// Whether a file starts as classic or big TIFF, in either byte order.
pub(super) fn is_tiff(start: &[u8]) -> bool {
    [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| start.starts_with(*magic))
}

fn problem(error: TiffError) -> String {
    match error {
        TiffError::UnsupportedError(e) => format!(
            "this kind of TIFF is not read ({e}); save it as grey or RGB of 8 or 16 bits or 32-bit float, compressed by LZW \
             or Deflate or not at all"
        ),
        TiffError::LimitsExceeded => "this TIFF takes too much memory to decode; reduce it".to_string(),
        e => format!("cannot be decoded as TIFF ({e}); {DAMAGED}"),
    }
}

fn unsupported(kind: TiffUnsupportedError) -> String {
    problem(TiffError::UnsupportedError(kind))
}

impl<'a> TiffPage<'a> {
    /// Reads the directory of a page, from 1; the first page if none is named.
    pub(super) fn open(bytes: &'a [u8], page: Option<usize>) -> Result<Self, String> {
        if first_directory_fits(bytes) == Some(false) {
            return Err(format!("states more values than a file of {} bytes holds; {DAMAGED}", bytes.len()));
        }
        let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(problem)?.with_limits(limits(0, bytes.len()));
        let pages = pages(&mut decoder);
        let wanted = page.unwrap_or(1);
        match pages.get(wanted - 1) {
            Some(&index) => decoder.seek_to_image(index).map_err(problem)?,
            None if wanted > 1 => return Err(format!("has {} pages and no page {wanted}", pages.len())),
            None => decoder.seek_to_image(0).map_err(problem)?,
        }
        let color = decoder.colortype().map_err(problem)?;
        let Format { channels, depth } = format(&mut decoder, color)?;
        let turn = decoder.find_tag_unsigned::<u16>(Tag::Orientation).ok().flatten();
        let turn = turn.and_then(|turn| Orientation::from_exif(u8::try_from(turn).ok()?));
        let orientation = turn.unwrap_or(Orientation::NoTransforms);
        let size = decoder.dimensions().map_err(problem)?;
        let header = Header {
            format: "TIFF",
            size: turned(size, orientation),
            depth,
            // Bilevel becomes 8 bits.
            bits: u32::from(color.bit_depth()).max(8),
            channels,
            alpha: matches!(color, ColorType::RGBA(_)),
            pages: pages.len().max(1),
        };
        Ok(Self { header, decoder, size, color, orientation })
    }

    /// The ICC profile.
    pub(super) fn profile(&mut self) -> Option<Vec<u8>> {
        let most = self.decoder.inner().get_ref().len() as u64;
        let mut directory = self.decoder.image_ifd();
        // Checked first, since the crate would allocate for values that the file cannot hold.
        directory.find_entry(Tag::IccProfile).filter(|entry| entry.count() <= most)?;
        let mut profile = ValueBuffer::empty(Type::UNDEFINED);
        directory.find_tag_buf(Tag::IccProfile, &mut profile).ok()??;
        Some(profile.as_bytes().to_vec())
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let Self { header: Header { channels, .. }, decoder, size, color, orientation } = self;
        let mut found = DecodingResult::U8(Vec::new());
        let mut decoder = decoder;
        let limits = limits(u64::from(size.0) * u64::from(size.1), decoder.inner().get_ref().len());
        let layout = decoder.with_limits(limits).read_image_to_buffer(&mut found).map_err(problem)?;
        let (samples, planar) = (color.num_samples().into(), layout.planes > 1);
        let stored = SampleLayout { size, samples, planar, channels, orientation };
        match found {
            DecodingResult::U8(bits) if color.bit_depth() == 1 => stored.frame(bytes_of(&bits, size.0), Samples::U8),
            DecodingResult::U8(values) => stored.frame(values, Samples::U8),
            DecodingResult::U16(values) => stored.frame(values, Samples::U16),
            DecodingResult::F16(values) => stored.frame(values.iter().map(|v| v.to_f32()).collect(), Samples::F32),
            DecodingResult::F32(values) => stored.frame(values, Samples::F32),
            _ => Err(unsupported(TiffUnsupportedError::UnsupportedSampleDepth(color.bit_depth()))),
        }
    }
}

/// Whether each tag of the first directory has at most as many values as the file can hold. The crate reads this
/// directory before limits can be set, and allocates 32 bytes for each value. `None` if there is no such directory; the
/// crate reports this.
fn first_directory_fits(bytes: &[u8]) -> Option<bool> {
    let number = |at: u64, size: usize| {
        let at = usize::try_from(at).ok()?;
        let found = bytes.get(at..at.checked_add(size)?)?.iter();
        let shift = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Some(if bytes[0] == b'I' { found.rev().fold(0, shift) } else { found.fold(0, shift) })
    };
    // In bytes, for classic TIFF and for BigTIFF: the position of the directory's offset, and the sizes of its length,
    // of a tag's count and of a whole tag.
    let is_big = number(2, 2)? == 43;
    let [stated, length, count, entry] = if is_big { [8, 8, 8, 20] } else { [4, 2, 4, 12] };
    let directory = number(stated, count as usize)?;
    let entries = (0..number(directory, length as usize)?).map_while(|n| {
        let start = directory.checked_add(length)?.checked_add(entry * n)?;
        number(start.checked_add(4)?, count as usize)
    });
    Some(entries.into_iter().all(|count| count <= bytes.len() as u64))
}

/// Memory limits of the decoder for a number of pixels and a file size, bytes. They allow the pixels, or a larger tile,
/// and 32 bytes for each value of a tag that the file can hold.
fn limits(pixels: u64, file: usize) -> Limits {
    let pixels = usize::try_from(pixels.min(MAX_PIXELS) * LARGEST_PIXEL).unwrap_or(usize::MAX);
    let mut limits = Limits::default();
    limits.decoding_buffer_size = pixels.max(LEAST_LIMIT).max(file.saturating_mul(32));
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits
}

/// Indices of the pages of the file up to a damaged page. Leaves out the reduced copies that some programs add.
fn pages(decoder: &mut Decoder<Cursor<&[u8]>>) -> Vec<usize> {
    let mut pages = Vec::new();
    for index in 0.. {
        let kind = decoder.find_tag_unsigned::<u32>(Tag::NewSubfileType).ok().flatten().unwrap_or(0);
        if kind & 1 == 0 {
            pages.push(index);
        }
        if pages.len() == MAX_PAGES || !decoder.more_images() || decoder.next_image().is_err() {
            break;
        }
    }
    pages
}

/// Channels and sample type; refuses unsupported ones.
fn format(decoder: &mut Decoder<Cursor<&[u8]>>, color: ColorType) -> Result<Format, String> {
    let channels = match color {
        ColorType::Gray(_) => Channels::Gray,
        ColorType::RGB(_) | ColorType::RGBA(_) => Channels::Rgb,
        _ => return Err(unsupported(TiffUnsupportedError::UnsupportedColorType(color))),
    };
    let kind = decoder.image_buffer_layout().map_err(problem)?.sample_type;
    let depth = match (kind, color.bit_depth()) {
        (Some(U8), 1) if channels == Channels::Gray => Depth::U8,
        (Some(U8), 8) => Depth::U8,
        (Some(U16), 16) => Depth::U16,
        (Some(F16 | F32), _) => Depth::F32,
        (_, bits) => return Err(unsupported(TiffUnsupportedError::UnsupportedBitsPerChannel(bits))),
    };
    Ok(Format { channels, depth })
}

/// Unpacks bits to bytes, 0 or 255. Each row begins with a new byte.
fn bytes_of(bits: &[u8], width: u32) -> Vec<u8> {
    let width = width as usize;
    let byte = |row: &[u8], x: usize| if row[x / 8] << (x % 8) & 0x80 == 0 { 0 } else { 255 };
    bits.chunks_exact(width.div_ceil(8)).flat_map(|row| (0..width).map(move |x| byte(row, x))).collect()
}

/// Layout of the samples of a page.
struct SampleLayout {
    /// Width and height, as stored.
    size: (u32, u32),
    /// Samples per pixel; the colour samples come first.
    samples: usize,
    /// Whether the samples are stored in planes.
    planar: bool,
    /// Colour channels.
    channels: Channels,
    /// Rotation of the picture.
    orientation: Orientation,
}

impl SampleLayout {
    /// Makes the upright frame.
    fn frame<T: Primitive + 'static>(&self, values: Vec<T>, wrap: fn(Vec<T>) -> Samples) -> Result<Frame, String>
    where
        Rgb<T>: Pixel<Subpixel = T>,
    {
        let alpha = self.alpha(&values).and_then(|alpha| self.upright::<Luma<T>>(alpha));
        let half = T::DEFAULT_MAX_VALUE / (T::one() + T::one());
        let colors = self.colors(values);
        let upright = match self.channels {
            Channels::Gray => self.upright::<Luma<T>>(colors),
            Channels::Rgb => self.upright::<Rgb<T>>(colors),
        };
        let values =
            upright.ok_or_else(|| format!("cannot be decoded as TIFF (it holds too few samples); {DAMAGED}"))?;
        let (width, height) = turned(self.size, self.orientation);
        let frame = Frame::new(width, height, self.channels, wrap(values))?;
        Ok(frame.opaque(alpha.map(|alpha| alpha.iter().map(|alpha| *alpha > half).collect())))
    }

    /// The first sample behind those of colour: alpha.
    fn alpha<T: Copy>(&self, values: &[T]) -> Option<Vec<T>> {
        let (pixels, colors) = (self.size.0 as usize * self.size.1 as usize, self.channels.count() as usize);
        let [first, step] = if self.planar { [colors * pixels, 1] } else { [colors, self.samples] };
        (self.samples > colors).then(|| values.iter().skip(first).step_by(step).take(pixels).copied().collect())
    }

    /// The colour samples alone, interleaved.
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

    /// Rotates the samples as the camera recorded; `None` if there are too few.
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

/// Width and height of the upright picture.
pub(super) fn turned((width, height): (u32, u32), orientation: Orientation) -> (u32, u32) {
    match orientation {
        Orientation::Rotate90 | Orientation::Rotate270 | Orientation::Rotate90FlipH | Orientation::Rotate270FlipH => {
            (height, width)
        }
        _ => (width, height),
    }
}

#[cfg(test)]
mod tests {
    use image::ImageEncoder;
    use image::codecs::jpeg::JpegEncoder;
    use tiff::encoder::{Compression, DeflateLevel, TiffEncoder, colortype};

    use super::*;

    const GRAY: u16 = 1;
    const RGB: u16 = 2;

    /// A picture of 5x2 pixels in one strip, or one for each plane.
    fn file(bits: &[u16], more: &[(Tag, u16)], strips: &[&[u8]]) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
        let mut directory = encoder.image_directory().unwrap();
        let offsets: Vec<u32> = strips.iter().map(|strip| directory.write_data(*strip).unwrap() as u32).collect();
        let counts: Vec<u32> = strips.iter().map(|strip| strip.len() as u32).collect();
        directory.write_tag(Tag::BitsPerSample, bits).unwrap();
        directory.write_tag(Tag::StripOffsets, offsets.as_slice()).unwrap();
        directory.write_tag(Tag::StripByteCounts, counts.as_slice()).unwrap();
        let samples = (Tag::SamplesPerPixel, bits.len() as u16);
        let all = [(Tag::ImageWidth, 5), (Tag::ImageLength, 2), (Tag::RowsPerStrip, 2), samples];
        all.iter().chain(more).for_each(|&(tag, value)| directory.write_tag(tag, value).unwrap());
        directory.finish().unwrap();
        bytes.into_inner()
    }

    fn decode(bytes: &[u8]) -> Result<Frame, String> {
        TiffPage::open(bytes, None)?.decode()
    }

    fn frame(channels: Channels, samples: Samples) -> Frame {
        Frame::new(5, 2, channels, samples).unwrap()
    }

    #[test]
    fn every_compression_holds_the_same_pixels() {
        let values: Vec<u16> = (0..30).map(|i| 2000 * i).collect();
        let expected = frame(Channels::Rgb, Samples::U16(values.clone()));
        let deflate = Compression::Deflate(DeflateLevel::Balanced);
        for compression in [Compression::Uncompressed, Compression::Lzw, deflate, Compression::Packbits] {
            let mut bytes = Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut bytes).unwrap().with_compression(compression);
            encoder.write_image::<colortype::RGB16>(5, 2, &values).unwrap();
            assert_eq!(decode(&bytes.into_inner()).unwrap(), expected);
        }
        let mut jpeg = Vec::new();
        JpegEncoder::new(&mut jpeg).write_image(&[77; 10], 5, 2, image::ExtendedColorType::L8).unwrap();
        let kind = [(Tag::PhotometricInterpretation, GRAY), (Tag::Compression, 7)];
        assert_eq!(decode(&file(&[8], &kind, &[&jpeg])).unwrap(), frame(Channels::Gray, Samples::U8(vec![77; 10])));
    }

    #[test]
    fn planes_bits_half_floats_and_alpha_are_converted() {
        let [gray, rgb] = [GRAY, RGB].map(|kind| (Tag::PhotometricInterpretation, kind));
        let planes = [[1; 10], [2; 10], [3; 10]];
        let planes: Vec<&[u8]> = planes.iter().map(<[u8; 10]>::as_slice).collect();
        let planar = decode(&file(&[8; 3], &[rgb, (Tag::PlanarConfiguration, 2)], &planes)).unwrap();
        assert_eq!(planar, frame(Channels::Rgb, Samples::U8([1, 2, 3].repeat(10))));

        let alpha: Vec<u8> = (0..40).collect();
        let bytes = file(&[8; 4], &[rgb, (Tag::ExtraSamples, 2)], &[&alpha]);
        let opaque = alpha.chunks(4).flat_map(|pixel| pixel[..3].to_vec()).collect();
        assert_eq!(decode(&bytes).unwrap(), frame(Channels::Rgb, Samples::U8(opaque)));
        assert!(TiffPage::open(&bytes, None).unwrap().header.alpha);

        for (kind, values) in
            [(1, [255, 0, 255, 255, 0, 0, 0, 0, 0, 255]), (0, [0, 255, 0, 0, 255, 255, 255, 255, 255, 0])]
        {
            let bytes = file(&[1], &[(Tag::PhotometricInterpretation, kind)], &[&[0b1011_0000, 0b0000_1000]]);
            assert_eq!(decode(&bytes).unwrap(), frame(Channels::Gray, Samples::U8(values.to_vec())), "{kind}");
            assert_eq!(TiffPage::open(&bytes, None).unwrap().header.bits, 8);
        }

        // 1.5 as a half.
        let halves = decode(&file(&[16], &[gray, (Tag::SampleFormat, 3)], &[&[0x00, 0x3e].repeat(10)])).unwrap();
        assert_eq!(halves, frame(Channels::Gray, Samples::F32(vec![1.5; 10])));
    }

    #[test]
    fn an_unsupported_kind_is_named_with_advice() {
        let data = [0; 80];
        let refused = |bits: &[u16], more: &[(Tag, u16)]| decode(&file(bits, more, &[&data])).unwrap_err();
        let kind = |photometric| (Tag::PhotometricInterpretation, photometric);
        for (problem, part) in [
            (refused(&[8], &[kind(3)]), "RGBPalette"),
            (refused(&[8; 4], &[kind(5)]), "CMYK(8)"),
            (refused(&[8; 3], &[kind(6)]), "YCbCr(8)"),
            (refused(&[8; 3], &[kind(GRAY)]), "Multiband"),
            (refused(&[4], &[kind(GRAY)]), "4 bits"),
            (refused(&[64], &[kind(GRAY), (Tag::SampleFormat, 3)]), "64 bits"),
            (refused(&[16], &[kind(GRAY), (Tag::SampleFormat, 2)]), "16 bits"),
            (refused(&[8], &[kind(GRAY), (Tag::Compression, 50001)]), "WebP"),
        ] {
            assert!(problem.contains(part) && problem.contains("save it as grey or RGB"), "{problem}");
        }
    }

    #[test]
    fn a_count_beyond_the_file_size_allocates_nothing() {
        // A tag of 8 million values in a file of 308 bytes, for which the crate would take 251 MiB.
        let bytes = include_bytes!("../../../tests/hostile/tiff_count.tif");
        let [least, most] = [limits(0, bytes.len()), limits(u64::MAX, 0)].map(|limits| limits.decoding_buffer_size);
        assert!(least == LEAST_LIMIT && most as u64 == MAX_PIXELS * LARGEST_PIXEL);
        assert!(decode(bytes).unwrap_err().contains("states more values"));
        let whole = file(&[8], &[(Tag::PhotometricInterpretation, GRAY)], &[&[7; 10]]);
        assert_eq!(first_directory_fits(&whole), Some(true));
        assert_eq!(first_directory_fits(&whole[..6]), None);
    }
}
