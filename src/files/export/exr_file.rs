//! OpenEXR files of 32-bit floats.

use std::io::{Seek, Write};

use exr::image::{FlatSamples, Image, Layer};
use exr::meta::attribute::{AttributeValue, Text};
use exr::meta::header::LayerAttributes;
use exr::prelude::{AnyChannel, AnyChannels, Encoding, WritableImage};

use super::description::{Description, SOFTWARE};
use crate::base::Channels;

/// Writes a field of width x height values as the channel `Y`.
pub(crate) fn write(
    writer: impl Write + Seek,
    size: (u32, u32),
    values: &[f32],
    description: &Description,
) -> Result<(), String> {
    write_channels(writer, size, &[("Y", values)], description)
}

/// Writes an image of interleaved intensities: channel `Y`, or `R`, `G` and `B`.
pub(crate) fn write_image(
    writer: impl Write + Seek,
    size: (u32, u32),
    channels: Channels,
    values: &[f32],
    description: &Description,
) -> Result<(), String> {
    if channels == Channels::Gray {
        return write(writer, size, values, description);
    }
    let plane = |k: usize| values.iter().skip(k).step_by(3).copied().collect::<Vec<f32>>();
    let [r, g, b] = [0, 1, 2].map(plane);
    write_channels(writer, size, &[("R", &r), ("G", &g), ("B", &b)], description)
}

/// Writes fields of one size. Each is a channel with the field's name.
pub(crate) fn write_channels(
    writer: impl Write + Seek,
    (width, height): (u32, u32),
    fields: &[(&str, &[f32])],
    description: &Description,
) -> Result<(), String> {
    let text = |s: &str| Text::new_or_none(s).ok_or_else(|| format!("'{s}' does not fit EXR text"));
    let mut attributes = LayerAttributes {
        software_name: Some(text(SOFTWARE)?),
        comments: Some(text(&description.comments)?),
        ..LayerAttributes::default()
    };
    attributes.other.insert(text("units")?, AttributeValue::Text(text(&description.units)?));
    let channel = |&(name, values): &(&str, &[f32])| AnyChannel::new(name, FlatSamples::F32(values.to_vec()));
    let channels = AnyChannels::sort(fields.iter().map(channel).collect());
    let layer = Layer::new((width as usize, height as usize), attributes, Encoding::SMALL_FAST_LOSSLESS, channels);
    Image::from_layer(layer).write().to_buffered(writer).map_err(|e| e.to_string())
}
