//! TIFF pages, grey, colour or a palette, of integers or floats, by the crate `tiff`.

use DecodingSampleType::{F16, F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
use image::metadata::Orientation;
use image::{ImageBuffer, Luma, Pixel, Primitive, Rgb, imageops};
use tiff::decoder::{Decoder, DecodingResult, DecodingSampleType, Limits};
use tiff::tags::{Tag, Type, ValueBuffer};
use tiff::{ColorType, TiffError, TiffUnsupportedError};

use super::header::{DAMAGED, Header, MAX_PIXELS};
use super::tiff_directory::{Joined, redirected, values};
use crate::base::{Channels, Depth, Frame, Samples};

/// Greatest number of pages of a file.
pub(super) const MAX_PAGES: usize = 1 << 16;

/// Bytes that one pixel may take while it is decoded: RGBA in 32-bit floats.
const LARGEST_PIXEL: u64 = 16;
/// Least memory limit, 16 MiB: a tile of a megapixel of such pixels.
const LEAST_LIMIT: usize = 16 << 20;

/// A page whose directory has been parsed.
pub(super) struct TiffPage<'a> {
    pub(super) header: Header,
    /// The decoder of the page, or one for each plane.
    decoders: Vec<Decoder<Joined<'a>>>,
    pub(super) layout: SampleLayout,
    /// The colours of a palette, if the samples are indices.
    palette: Vec<[u8; 3]>,
    /// Whether 0 is white.
    is_inverted: bool,
    /// The ICC profile.
    pub(super) profile: Option<Vec<u8>>,
    /// The description of the first page.
    pub(super) description: Option<String>,
    /// Pixels per unit of length along x, as the first page states.
    pub(super) resolution: Option<f64>,
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
    /// Reads the directory of a page, from 1; the first page if none is named. `is_cut`: of a file with one directory for
    /// all pages, `bytes` hold this page alone.
    pub(super) fn open(bytes: &'a [u8], page: Option<usize>, is_cut: bool) -> Result<Self, String> {
        if first_directory_fits(bytes) == Some(false) {
            return Err(format!("states more values than a file of {} bytes holds; {DAMAGED}", bytes.len()));
        }
        let mut decoder = Decoder::new(Joined::file(bytes)).map_err(problem)?.with_limits(limits(0, bytes.len()));
        let mut pages = pages(&mut decoder);
        decoder.seek_to_image(pages.first().copied().unwrap_or(0)).map_err(problem)?;
        let (description, resolution) = (text(&mut decoder), resolution(&mut decoder));
        let wanted = page.unwrap_or(1);
        let mut changed = Vec::new();
        let run = PageRun::of(&mut decoder, description.as_deref()).filter(|_| pages.len() == 1);
        if let Some(run) = run.filter(|run| is_cut || run.page(run.count as u64) <= bytes.len() as u64) {
            pages = vec![0; run.count];
            if wanted > 1 && wanted <= run.count {
                changed = run.strip(if is_cut { 0 } else { wanted as u64 - 1 });
            }
        }
        match pages.get(wanted - 1) {
            Some(&index) => decoder.seek_to_image(index).map_err(problem)?,
            None if wanted > 1 => return Err(format!("has {} pages and no page {wanted}", pages.len())),
            None => decoder.seek_to_image(0).map_err(problem)?,
        }
        let profile = bytes_of(&mut decoder, Tag::IccProfile, Type::UNDEFINED);
        let mut first = |tag| values(&mut decoder, tag).and_then(|values| values.first().copied());
        let orientation = first(Tag::Orientation).and_then(|turn| Orientation::from_exif(u8::try_from(turn).ok()?));
        let orientation = orientation.unwrap_or(Orientation::NoTransforms);
        let samples = first(Tag::SamplesPerPixel).unwrap_or(1);
        let kind = first(Tag::PhotometricInterpretation).unwrap_or(1);
        let has_planes = samples > 1 && first(Tag::PlanarConfiguration) == Some(2) && kind <= 2;
        let is_alpha = samples > 1 && matches!(first(Tag::ExtraSamples), Some(1 | 2));
        let palette = if kind == PALETTE { palette(&mut decoder)? } else { Vec::new() };
        if kind == PALETTE {
            changed.push((Tag::PhotometricInterpretation, vec![1]));
        }
        let mut decoders = if has_planes {
            planes(&mut decoder, samples, kind).map_err(problem)?
        } else if changed.is_empty() {
            vec![decoder]
        } else {
            vec![redirected(&mut decoder, &changed, limits(0, bytes.len())).map_err(problem)?]
        };
        let color = decoders[0].colortype().map_err(problem)?;
        let (channels, samples) = match color {
            ColorType::Gray(_) if has_planes && kind == 2 && samples >= 3 => (Channels::Rgb, samples as usize),
            ColorType::Gray(_) if palette.iter().any(|[r, g, b]| r != g || g != b) => (Channels::Rgb, 3),
            ColorType::Gray(_) => (Channels::Gray, samples as usize),
            ColorType::Multiband { num_samples, .. } => (Channels::Gray, num_samples.into()),
            ColorType::RGB(_) => (Channels::Rgb, 3),
            ColorType::RGBA(_) => (Channels::Rgb, 4),
            _ => return Err(unsupported(TiffUnsupportedError::UnsupportedColorType(color))),
        };
        let alpha = is_alpha || matches!(color, ColorType::RGBA(_));
        if channels == Channels::Gray && samples > 1 && !alpha {
            return Err(format!(
                "holds {samples} grey channels in one page, and none of them is stated as alpha; save each as a page or a \
                 file of its own"
            ));
        }
        let depth = depth(&mut decoders[0], color).map(|depth| if palette.is_empty() { depth } else { Depth::U8 })?;
        let size = decoders[0].dimensions().map_err(problem)?;
        // Fewer bits, and the colours of a palette, become 8. Bytes with a sign are a measurement, as more bits are.
        let least = if depth == Depth::F32 { 16 } else { 8 };
        let bits = if palette.is_empty() { u32::from(color.bit_depth()).max(least) } else { 8 };
        let header = Header {
            format: "TIFF",
            size: turned(size, orientation),
            depth,
            bits,
            channels,
            alpha,
            pages: pages.len().max(1),
        };
        let layout = SampleLayout { size, samples, has_alpha: alpha, channels, orientation };
        let is_inverted = kind == 0;
        Ok(Self { header, decoders, layout, palette, is_inverted, profile, description, resolution })
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let Self { mut decoders, mut layout, palette, is_inverted, .. } = self;
        if decoders.len() > 1 {
            // Planes of no colour are not read, except alpha.
            layout.samples = layout.channels.count() as usize + usize::from(layout.has_alpha);
            decoders.truncate(layout.samples);
        }
        let count = layout.channels.count() as usize;
        // An index without a colour is black.
        let color = |index: usize| palette.get(index).copied().unwrap_or_default().into_iter().take(count);
        match decoded(decoders, layout.size, !palette.is_empty())? {
            Samples::U8(indices) if !palette.is_empty() => {
                layout.frame(indices.into_iter().flat_map(|index| color(index.into())).collect(), Samples::U8)
            }
            Samples::U16(indices) if !palette.is_empty() => {
                layout.frame(indices.into_iter().flat_map(|index| color(index.into())).collect(), Samples::U8)
            }
            Samples::U8(values) => layout.frame(values, Samples::U8),
            Samples::U16(mut values) => {
                if is_inverted {
                    // The crate inverts from 65535. Fewer bits are inverted from their own white.
                    let most = values.iter().map(|v| u16::MAX - v).max().unwrap_or(u16::MAX);
                    let unused = u16::MAX.checked_shl(16 - most.leading_zeros()).unwrap_or(0);
                    values.iter_mut().for_each(|v| *v -= unused);
                }
                layout.frame(values, Samples::U16)
            }
            Samples::F32(values) => layout.frame(values, Samples::F32),
        }
    }
}

/// The value of PhotometricInterpretation for colours of a palette.
const PALETTE: u64 = 3;

/// The bytes of a tag.
fn bytes_of(decoder: &mut Decoder<Joined<'_>>, tag: Tag, kind: Type) -> Option<Vec<u8>> {
    let most = decoder.inner().file_length() as u64;
    let mut directory = decoder.image_ifd();
    // Checked first, since the crate would allocate for values that the file cannot hold.
    directory.find_entry(tag).filter(|entry| entry.count() <= most)?;
    let mut value = ValueBuffer::empty(kind);
    directory.find_tag_buf(tag, &mut value).ok()??;
    Some(value.as_bytes().to_vec())
}

/// The description of a page.
fn text(decoder: &mut Decoder<Joined<'_>>) -> Option<String> {
    let bytes = bytes_of(decoder, Tag::ImageDescription, Type::ASCII)?;
    Some(String::from_utf8_lossy(&bytes).trim_end_matches('\0').to_string())
}

/// Pixels per unit of length along x.
fn resolution(decoder: &mut Decoder<Joined<'_>>) -> Option<f64> {
    let [above, below] = values(decoder, Tag::XResolution)?.try_into().ok()?;
    Some(above as f64 / below as f64).filter(|ratio: &f64| ratio.is_finite() && *ratio > 0.0)
}

/// Pages that follow one another under one directory, as ImageJ writes more than 4 GiB.
pub(super) struct PageRun {
    pub(super) count: usize,
    /// Position of the first page, bytes.
    pub(super) position: u64,
    /// Size of a page, bytes.
    pub(super) size: u64,
    height: u64,
}

impl PageRun {
    /// The run under the current directory, with its description.
    fn of(decoder: &mut Decoder<Joined<'_>>, description: Option<&str>) -> Option<Self> {
        let mut lines = description.filter(|text| text.starts_with("ImageJ="))?.lines();
        let count = lines.find_map(|line| line.strip_prefix("images="))?.trim().parse().ok()?;
        let mut first = |tag, usual| values(decoder, tag).map_or(Some(usual), |values| values.first().copied());
        let [width, height, bits, samples, compression] = [
            first(Tag::ImageWidth, 0)?,
            first(Tag::ImageLength, 0)?,
            first(Tag::BitsPerSample, 1)?,
            first(Tag::SamplesPerPixel, 1)?,
            first(Tag::Compression, 1)?,
        ];
        let position = first(Tag::StripOffsets, 0)?;
        let size = width.checked_mul(height)?.checked_mul(bits.checked_mul(samples)?)? / 8;
        let is_run = (2..=MAX_PAGES).contains(&count) && compression == 1 && position > 0 && size > 0;
        is_run.then_some(Self { count, position, size, height })
    }

    /// The run of a file, from its first bytes.
    pub(super) fn of_start(start: &[u8]) -> Option<Self> {
        first_directory_fits(start).filter(|fits| *fits)?;
        let mut decoder = Decoder::new(Joined::file(start)).ok()?.with_limits(limits(0, start.len()));
        let description = text(&mut decoder);
        Self::of(&mut decoder, description.as_deref())
    }

    /// The position of a page, from 0.
    pub(super) fn page(&self, n: u64) -> u64 {
        self.position.saturating_add(n.saturating_mul(self.size))
    }

    /// The tags of a page, from 0.
    fn strip(&self, n: u64) -> Vec<(Tag, Vec<u64>)> {
        let position = self.page(n);
        let values =
            [(Tag::StripOffsets, position), (Tag::StripByteCounts, self.size), (Tag::RowsPerStrip, self.height)];
        values.map(|(tag, value)| (tag, vec![value])).to_vec()
    }
}

/// A decoder for each plane of a page, as a grey picture. The crate fails over planes in tiles.
fn planes<'a>(
    decoder: &mut Decoder<Joined<'a>>,
    samples: u64,
    kind: u64,
) -> Result<Vec<Decoder<Joined<'a>>>, TiffError> {
    let length = decoder.inner().file_length();
    let of_plane = |n: usize| {
        let mut changed = vec![(Tag::SamplesPerPixel, vec![1]), (Tag::PhotometricInterpretation, vec![kind.min(1)])];
        for tag in [Tag::BitsPerSample, Tag::SampleFormat] {
            changed.extend(values(decoder, tag).map(|values| (tag, values[..values.len().min(1)].to_vec())));
        }
        for tag in [Tag::StripOffsets, Tag::StripByteCounts, Tag::TileOffsets, Tag::TileByteCounts] {
            let Some(chunks) = values(decoder, tag) else { continue };
            let count = chunks.len() / samples as usize;
            changed.push((tag, chunks[n * count..(n + 1) * count].to_vec()));
        }
        redirected(decoder, &changed, limits(0, length))
    };
    // Three of colour, and alpha.
    (0..samples.min(4) as usize).map(of_plane).collect()
}

/// The samples of planes, interleaved. Integers other than unsigned ones of up to 16 bits become floats of the same
/// value. Fewer bits than 8 are scaled to 8 unless they are indices.
fn decoded(planes: Vec<Decoder<Joined<'_>>>, size: (u32, u32), are_indices: bool) -> Result<Samples, String> {
    let mut bits = 8;
    let mut read = |mut decoder: Decoder<Joined<'_>>| {
        bits = usize::from(decoder.colortype()?.bit_depth());
        let limits = limits(u64::from(size.0) * u64::from(size.1), decoder.inner().file_length());
        let mut found = DecodingResult::U8(Vec::new());
        decoder.with_limits(limits).read_image_to_buffer(&mut found).map(|_| found)
    };
    let planes = planes.into_iter().map(&mut read).collect::<Result<Vec<_>, _>>().map_err(problem)?;
    macro_rules! interleaved {
        ($kind:ident, $of:expr) => {{
            let of_kind = |plane| if let DecodingResult::$kind(values) = plane { Some(values) } else { None };
            let planes: Vec<Vec<_>> = planes.into_iter().filter_map(of_kind).collect();
            match <[Vec<_>; 1]>::try_from(planes) {
                Ok([only]) => only.into_iter().map($of).collect(),
                Err(planes) => {
                    let pixel = |i| planes.iter().filter_map(move |plane| plane.get(i).copied());
                    (0..planes[0].len()).flat_map(pixel).map($of).collect()
                }
            }
        }};
    }
    Ok(match planes.first() {
        Some(DecodingResult::U8(packed)) if bits < 8 => {
            let scale = if are_indices { 1 } else { 255 / ((1 << bits) - 1) };
            Samples::U8(unpacked(packed, size.0 as usize, bits, scale as u8))
        }
        Some(DecodingResult::U8(_)) => Samples::U8(interleaved!(U8, |v| v)),
        Some(DecodingResult::U16(_)) => Samples::U16(interleaved!(U16, |v| v)),
        Some(DecodingResult::F16(_)) => Samples::F32(interleaved!(F16, |v| v.to_f32())),
        Some(DecodingResult::F32(_)) => Samples::F32(interleaved!(F32, |v| v)),
        Some(DecodingResult::F64(_)) => Samples::F32(interleaved!(F64, |v| v as f32)),
        Some(DecodingResult::I8(_)) => Samples::F32(interleaved!(I8, f32::from)),
        Some(DecodingResult::I16(_)) => Samples::F32(interleaved!(I16, f32::from)),
        Some(DecodingResult::I32(_)) => Samples::F32(interleaved!(I32, |v| v as f32)),
        Some(DecodingResult::I64(_)) => Samples::F32(interleaved!(I64, |v| v as f32)),
        Some(DecodingResult::U32(_)) => Samples::F32(interleaved!(U32, |v| v as f32)),
        Some(DecodingResult::U64(_)) => Samples::F32(interleaved!(U64, |v| v as f32)),
        None => return Err(DAMAGED.to_string()),
    })
}

/// The colours of a palette, red, green and blue of 8 bits.
fn palette(decoder: &mut Decoder<Joined<'_>>) -> Result<Vec<[u8; 3]>, String> {
    let map = values(decoder, Tag::ColorMap).filter(|map| map.len() >= 3);
    let map = map.ok_or_else(|| format!("has a palette without colours; {DAMAGED}"))?;
    // Some programs write 8 bits in the place of 16.
    let shift = if map.iter().all(|value| *value < 256) { 0 } else { 8 };
    let count = map.len() / 3;
    let color = |n: usize| [0, 1, 2].map(|c| (map[c * count + n] >> shift).min(255) as u8);
    Ok((0..count).map(color).collect())
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
fn pages(decoder: &mut Decoder<Joined<'_>>) -> Vec<usize> {
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

/// The type of decoded samples; refuses unsupported ones.
fn depth(decoder: &mut Decoder<Joined<'_>>, color: ColorType) -> Result<Depth, String> {
    let kind = decoder.image_buffer_layout().map_err(problem)?.sample_type;
    match (kind, color.bit_depth()) {
        (Some(U8), 1 | 2 | 4) if matches!(color, ColorType::Gray(_)) => Ok(Depth::U8),
        (Some(U8), 8) => Ok(Depth::U8),
        (Some(U16), 16) => Ok(Depth::U16),
        (Some(F16 | F32 | F64 | I8 | I16 | I32 | I64 | U32 | U64), 8 | 16 | 32 | 64) => Ok(Depth::F32),
        (_, bits) => Err(unsupported(TiffUnsupportedError::UnsupportedBitsPerChannel(bits))),
    }
}

/// Unpacks samples of fewer bits than 8 to bytes, times a factor. Each row begins with a new byte.
fn unpacked(packed: &[u8], width: usize, bits: usize, factor: u8) -> Vec<u8> {
    let sample = |row: &[u8], x: usize| (row[x * bits / 8] << (x * bits % 8)) >> (8 - bits);
    let rows = packed.chunks_exact((width * bits).div_ceil(8));
    rows.flat_map(|row| (0..width).map(move |x| factor * sample(row, x))).collect()
}

/// Layout of the samples of a page.
pub(super) struct SampleLayout {
    /// Width and height, as stored.
    size: (u32, u32),
    /// Samples per pixel; the colour samples come first, alpha follows.
    samples: usize,
    has_alpha: bool,
    /// Colour channels.
    channels: Channels,
    /// Rotation of the picture.
    pub(super) orientation: Orientation,
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
        let frame = Frame::with_holes(width, height, self.channels, wrap(values))?;
        Ok(frame.opaque(alpha.map(|alpha| alpha.iter().map(|alpha| *alpha > half).collect())))
    }

    /// The first sample behind those of colour, if it is alpha.
    fn alpha<T: Copy>(&self, values: &[T]) -> Option<Vec<T>> {
        let alpha = || values.iter().skip(self.channels.count() as usize).step_by(self.samples).copied().collect();
        (self.has_alpha && self.samples > self.channels.count() as usize).then(alpha)
    }

    /// The colour samples alone, interleaved.
    fn colors<T: Copy>(&self, values: Vec<T>) -> Vec<T> {
        let colors = self.channels.count() as usize;
        if self.samples <= colors {
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
    use std::io::Cursor;

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
        TiffPage::open(bytes, None, false)?.decode()
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
        assert!(TiffPage::open(&bytes, None, false).unwrap().header.alpha);

        for (kind, values) in
            [(1, [255, 0, 255, 255, 0, 0, 0, 0, 0, 255]), (0, [0, 255, 0, 0, 255, 255, 255, 255, 255, 0])]
        {
            let bytes = file(&[1], &[(Tag::PhotometricInterpretation, kind)], &[&[0b1011_0000, 0b0000_1000]]);
            assert_eq!(decode(&bytes).unwrap(), frame(Channels::Gray, Samples::U8(values.to_vec())), "{kind}");
            assert_eq!(TiffPage::open(&bytes, None, false).unwrap().header.bits, 8);
        }

        // Two bits are scaled to eight.
        let two = decode(&file(&[2], &[gray], &[&[0b0001_1011, 0b1100_0000, 0, 0]])).unwrap();
        assert_eq!(two, frame(Channels::Gray, Samples::U8(vec![0, 85, 170, 255, 255, 0, 0, 0, 0, 0])));
        // Twelve bits whose 0 is white are inverted from 4095.
        let inverted: Vec<u8> = (0..10u16).flat_map(|n| (455 * n).to_le_bytes()).collect();
        let inverted = decode(&file(&[16], &[(Tag::PhotometricInterpretation, 0)], &[&inverted])).unwrap();
        assert_eq!(inverted, frame(Channels::Gray, Samples::U16((0..10).map(|n| 4095 - 455 * n).collect())));
        // Signed integers are floats of their values.
        let signed: Vec<u8> = (-4..6i16).flat_map(|v| (100 * v).to_le_bytes()).collect();
        let signed = decode(&file(&[16], &[gray, (Tag::SampleFormat, 2)], &[&signed])).unwrap();
        assert_eq!(signed, frame(Channels::Gray, Samples::F32((-4..6i16).map(|v| f32::from(100 * v)).collect())));
        let double: Vec<u8> = (0..10).flat_map(|v| f64::from(v).to_le_bytes()).collect();
        let double = decode(&file(&[64], &[gray, (Tag::SampleFormat, 3)], &[&double])).unwrap();
        assert_eq!(double, frame(Channels::Gray, Samples::F32((0..10u8).map(f32::from).collect())));
        // 1.5 as a half.
        let halves = decode(&file(&[16], &[gray, (Tag::SampleFormat, 3)], &[&[0x00, 0x3e].repeat(10)])).unwrap();
        assert_eq!(halves, frame(Channels::Gray, Samples::F32(vec![1.5; 10])));
    }

    #[test]
    fn transparent_pixels_and_holes_are_no_part_of_a_page() {
        let gray = (Tag::PhotometricInterpretation, GRAY);
        let expected = [1, 1, 1, 1, 1, 1, 1, 0, 1, 1];
        let pixels: Vec<u8> = (0..10).flat_map(|n| [7, if n == 7 { 0 } else { 255 }]).collect();
        let found = decode(&file(&[8; 2], &[gray, (Tag::ExtraSamples, 1)], &[&pixels])).unwrap();
        assert_eq!((found.format().channels, found.counted()), (Channels::Gray, Some(&expected[..])));
        let holes: Vec<u8> = (0..10).flat_map(|n| if n == 7 { f32::NAN } else { 0.5 }.to_le_bytes()).collect();
        let found = decode(&file(&[32], &[gray, (Tag::SampleFormat, 3)], &[&holes])).unwrap();
        assert_eq!(found.counted(), Some(&expected[..]));
        assert_eq!(found.samples(), &Samples::F32(expected.map(|counts| 0.5 * f32::from(counts)).to_vec()));
    }

    /// A picture of 5x2 pixels in this byte order, with entries of shorts or longs, and then data.
    fn by_hand(is_little: bool, entries: &[(Tag, &[u32])], data: &[u8]) -> Vec<u8> {
        let word = |n: u32| if is_little { (n as u16).to_le_bytes() } else { (n as u16).to_be_bytes() };
        let long = |n: u32| if is_little { n.to_le_bytes() } else { n.to_be_bytes() };
        let mut bytes = [if is_little { b"II" } else { b"MM" }, &word(42)[..], &long(8)].concat();
        let mut behind = 8 + 2 + 12 * entries.len() as u32 + 4 + data.len() as u32;
        let mut more = Vec::new();
        bytes.extend(word(entries.len() as u32));
        for (tag, values) in entries {
            bytes.extend([word(tag.to_u16().into()), word(4)].concat());
            bytes.extend(long(values.len() as u32));
            if let [value] = values {
                bytes.extend(long(*value));
            } else {
                bytes.extend(long(behind));
                behind += 4 * values.len() as u32;
                more.extend(values.iter().flat_map(|value| long(*value)));
            }
        }
        [bytes, long(0).to_vec(), data.to_vec(), more].concat()
    }

    #[test]
    fn a_palette_and_planes_in_tiles_are_read() {
        let map: Vec<u32> = [1, 2, 3].iter().flat_map(|c| (0..4).map(move |n| 256 * c * n)).collect();
        let gray_map: Vec<u32> = (0..12).map(|n| 257 * (n % 4)).collect();
        let indices = [0, 1, 2, 3, 0, 1, 2, 3, 0, 9];
        for is_little in [true, false] {
            let at = 8 + 2 + 12 * 9 + 4;
            let palette = |map: &[u32]| {
                let entries: [(Tag, &[u32]); 9] = [
                    (Tag::ImageWidth, &[5]),
                    (Tag::ImageLength, &[2]),
                    (Tag::BitsPerSample, &[8]),
                    (Tag::Compression, &[1]),
                    (Tag::PhotometricInterpretation, &[3]),
                    (Tag::StripOffsets, &[at]),
                    (Tag::RowsPerStrip, &[2]),
                    (Tag::StripByteCounts, &[10]),
                    (Tag::ColorMap, map),
                ];
                decode(&by_hand(is_little, &entries, &indices)).unwrap()
            };
            let gray = indices.map(|n| if n < 4 { n } else { 0 });
            assert_eq!(palette(&gray_map), frame(Channels::Gray, Samples::U8(gray.to_vec())));
            let colors = gray.iter().flat_map(|n| [*n, 2 * n, 3 * n]).collect();
            assert_eq!(palette(&map), frame(Channels::Rgb, Samples::U8(colors)));
        }
        // Three planes in two tiles of 4 x 4 pixels, of 16 bits in either order.
        for is_little in [true, false] {
            let bits = |n: u16| if is_little { n.to_le_bytes() } else { n.to_be_bytes() };
            let at = 8 + 2 + 12 * 11 + 4;
            let pixel = |plane: u16, x: u16, y: u16| 1000 * plane + 100 * y + x;
            let tile = |plane, left| (0..16).flat_map(move |i| bits(pixel(plane, left + i % 4, i / 4)));
            let data: Vec<u8> = (0..3).flat_map(|plane| tile(plane, 0).chain(tile(plane, 4))).collect();
            let offsets: Vec<u32> = (0..6).map(|n| at + 32 * n).collect();
            let entries: [(Tag, &[u32]); 11] = [
                (Tag::ImageWidth, &[5]),
                (Tag::ImageLength, &[2]),
                (Tag::BitsPerSample, &[16, 16, 16]),
                (Tag::Compression, &[1]),
                (Tag::PhotometricInterpretation, &[2]),
                (Tag::SamplesPerPixel, &[3]),
                (Tag::PlanarConfiguration, &[2]),
                (Tag::TileWidth, &[4]),
                (Tag::TileLength, &[4]),
                (Tag::TileOffsets, &offsets),
                (Tag::TileByteCounts, &[32; 6]),
            ];
            let found = decode(&by_hand(is_little, &entries, &data)).unwrap();
            let values = (0..30u16).map(|i| pixel(i % 3, i / 3 % 5, i / 15)).collect();
            assert_eq!(found, frame(Channels::Rgb, Samples::U16(values)), "{is_little}");
        }
    }

    #[test]
    fn an_unsupported_kind_is_named_with_advice() {
        let data = [0; 80];
        let refused = |bits: &[u16], more: &[(Tag, u16)]| decode(&file(bits, more, &[&data])).unwrap_err();
        let kind = |photometric| (Tag::PhotometricInterpretation, photometric);
        for (problem, part) in [
            (refused(&[8], &[kind(3)]), "palette without colours"),
            (refused(&[8; 4], &[kind(5)]), "CMYK(8)"),
            (refused(&[8; 3], &[kind(6)]), "YCbCr(8)"),
            (refused(&[8; 3], &[kind(GRAY)]), "3 grey channels in one page"),
            (refused(&[12], &[kind(GRAY)]), "12 bits"),
            (refused(&[8], &[kind(GRAY), (Tag::Compression, 50001)]), "WebP"),
        ] {
            assert!(problem.contains(part) && (problem.contains("save ") || part.contains("palette")), "{problem}");
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
