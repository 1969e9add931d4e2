//! OpenEXR: red, green and blue, or one channel, in half or float.

use std::io::Cursor;

use exr::block::reader::Reader;
use exr::compression::Compression;
use exr::image::{AnyChannels, FlatSamples};
use exr::meta::attribute::SampleType;
use exr::meta::header::Header as LayerHeader;
use exr::prelude::{ReadChannels, ReadLayers};

use super::header::{DAMAGED, Header};
use crate::base::{Channels, Depth, Frame, Samples};

/// Greatest number of samples of a layer over all channels, 2^30: the largest image with four channels.
const MAX_SAMPLES: u64 = 1 << 30;

/// An EXR file with a parsed header.
pub(super) struct Exr<'a> {
    pub(super) header: Header,
    reader: Reader<Cursor<&'a [u8]>>,
    names: Vec<String>,
}

/// Whether a file begins like EXR.
pub(super) fn is_exr(magic: &[u8]) -> bool {
    magic.starts_with(&[0x76, 0x2f, 0x31, 0x01])
}

fn problem(error: exr::error::Error) -> String {
    match error {
        exr::error::Error::NotSupported(what) => {
            format!("this kind of EXR is not read ({what}); save it as scan lines with ZIP compression")
        }
        e => format!("cannot be decoded as EXR ({e}); {DAMAGED}"),
    }
}

impl<'a> Exr<'a> {
    /// Reads the header and selects the channels. DWAA and DWAB are refused: a wrong byte in them can make the crate
    /// allocate more than the available memory, which aborts the program.
    pub(super) fn open(bytes: &'a [u8]) -> Result<Self, String> {
        let reader = exr::block::read(Cursor::new(bytes), false).map_err(problem)?;
        let Some(header) = reader.headers().first() else {
            return Err(format!("holds no layer; {DAMAGED}"));
        };
        let side = |length: usize| u32::try_from(length).map_err(|_| format!("is {length} pixels long; reduce it"));
        // All layers are checked, since the chunks determine which one is decoded.
        if reader.headers().iter().any(|h| matches!(h.compression, Compression::DWAA(_) | Compression::DWAB(_))) {
            return Err("is compressed by DWAA or DWAB, which is not read; save it with ZIP compression".to_string());
        }
        let size = (side(header.layer_size.x())?, side(header.layer_size.y())?);
        let names = chosen_channels(header)?;
        let list = || header.channels.list.iter().map(|channel| (channel.name.to_string(), channel.sample_type));
        let bytes = list().filter(|(name, _)| names.contains(name)).map(|(_, kind)| kind.bytes_per_sample());
        let bits = 8 * bytes.max().unwrap_or(0) as u32;
        let channels = if names.len() == 1 { Channels::Gray } else { Channels::Rgb };
        let alpha = list().any(|(name, _)| name == "A");
        let header = Header { format: "EXR", size, depth: Depth::F32, bits, channels, alpha, pages: 1 };
        Ok(Self { header, reader, names })
    }

    /// The number of bytes of all layers without compression, each with its smaller copies.
    pub(super) fn length(&self) -> u64 {
        let of_layer = |header: &LayerHeader| {
            let pixels = (header.layer_size.x() as u64).saturating_mul(header.layer_size.y() as u64);
            pixels.saturating_mul(2 * header.channels.bytes_per_pixel as u64)
        };
        self.reader.headers().iter().map(of_layer).fold(0, u64::saturating_add)
    }

    /// Decodes the pixels.
    pub(super) fn decode(self) -> Result<Frame, String> {
        let (width, height) = self.header.size;
        let mut names = self.names.clone();
        names.extend(self.header.alpha.then(|| "A".to_string()));
        let has_alpha = self.header.alpha;
        let mut planes = self.planes(&names)?;
        let alpha = if has_alpha { planes.pop() } else { None };
        let frame = match <[Vec<f32>; 3]>::try_from(planes) {
            Ok([r, g, b]) => {
                let values = r.into_iter().zip(g).zip(b).flat_map(|((r, g), b)| [r, g, b]).collect();
                Frame::with_holes(width, height, Channels::Rgb, Samples::F32(values))
            }
            Err(mut planes) => {
                let values = planes.pop().unwrap_or_default();
                Frame::with_holes(width, height, Channels::Gray, Samples::F32(values))
            }
        }?;
        Ok(frame.opaque(alpha.map(|alpha| alpha.iter().map(|alpha| *alpha > 0.5).collect())))
    }

    /// Decodes a single channel, including NaN and infinity.
    pub(super) fn decode_field(self) -> Result<Vec<f32>, String> {
        let names = self.names.clone();
        match <[Vec<f32>; 1]>::try_from(self.planes(&names)?) {
            Ok([values]) => Ok(values),
            Err(_) => {
                Err("is a colour image, and a field has one channel; give the file that parfocal wrote".to_string())
            }
        }
    }

    /// The comments of the file.
    pub(super) fn comments(&self) -> Option<String> {
        self.reader.headers().first()?.own_attributes.comments.as_ref().map(ToString::to_string)
    }

    /// Decodes the channels of these names, including NaN and infinity.
    pub(super) fn planes<S: AsRef<str>>(self, names: &[S]) -> Result<Vec<Vec<f32>>, String> {
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            // A panic in a thread of the crate would abort the program, and its decompressors can panic.
            .non_parallel()
            .from_chunks(self.reader)
            .map_err(problem)?;
        let channels = &image.layer_data.channel_data;
        let plane = |name| plane(channels, name).map(|samples| samples.values_as_f32().collect());
        let planes: Option<Vec<Vec<f32>>> = names.iter().map(|name| plane(name.as_ref())).collect();
        planes.ok_or_else(|| format!("cannot be decoded as EXR (a channel is missing); {DAMAGED}"))
    }
}

fn plane<'a>(channels: &'a AnyChannels<FlatSamples>, name: &str) -> Option<&'a FlatSamples> {
    channels.list.iter().find(|channel| channel.name.to_string() == name).map(|channel| &channel.sample_data)
}

/// Selects R, G and B, or Y, or the only channel that is not alpha.
fn chosen_channels(header: &LayerHeader) -> Result<Vec<String>, String> {
    let list = &header.channels.list;
    let samples = header.layer_size.area() as u64 * list.len() as u64;
    if header.deep {
        return Err("is a deep EXR; flatten it".to_string());
    }
    if samples > MAX_SAMPLES {
        return Err(format!("holds {} channels, {samples} samples, and the most read is {MAX_SAMPLES}", list.len()));
    }
    if list.iter().any(|c| c.sampling.x() != 1 || c.sampling.y() != 1) {
        return Err("has subsampled channels, which are not read; save it as RGB".to_string());
    }
    let names: Vec<String> = list.iter().map(|c| c.name.to_string()).collect();
    let chosen = choose(&names).ok_or_else(|| {
        format!("has the channels {}; parfocal reads R, G and B, or Y, or a single channel", names.join(", "))
    })?;
    if list.iter().any(|c| c.sample_type == SampleType::U32 && chosen.contains(&c.name.to_string())) {
        return Err("holds 32-bit integers; save it as half or float".to_string());
    }
    Ok(chosen)
}

fn choose(names: &[String]) -> Option<Vec<String>> {
    let has = |wanted: &&str| names.iter().any(|name| name == wanted);
    let color = ["R", "G", "B"];
    if color.iter().all(has) {
        return Some(color.map(String::from).to_vec());
    }
    if has(&"Y") && !has(&"RY") {
        return Some(vec!["Y".to_string()]);
    }
    let mut others = names.iter().filter(|name| *name != "A");
    match (others.next(), others.next()) {
        (Some(only), None) => Some(vec![only.clone()]),
        _ => None,
    }
}
