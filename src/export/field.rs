//! One float for each pixel, as EXR: a single 32-bit channel `Y`, unless said otherwise.

use std::io::{Seek, Write};

use exr::image::{FlatSamples, Image, Layer};
use exr::meta::attribute::{AttributeValue, Text};
use exr::meta::header::LayerAttributes;
use exr::prelude::{AnyChannel, AnyChannels, Encoding, WritableImage};

/// What a field holds, for the attributes of its file.
pub(super) struct Meaning {
    units: &'static str,
    comments: &'static str,
}

/// V.
pub(super) const RELATIVE_BLUR: Meaning = Meaning {
    units: "px^2",
    comments: "Relative blur V in px^2 of the first image; positive where the second is the more blurred; \
               NaN outside the valid region",
};

/// σ_V.
pub(super) const UNCERTAINTY: Meaning = Meaning {
    units: "px^2",
    comments: "Standard deviation of the relative blur V in px^2; NaN outside the valid region, 1000 where the images \
               say nothing",
};

/// 1/(1 + σ_V²).
pub(super) const CONFIDENCE: Meaning = Meaning {
    units: "1",
    comments: "1/(1 + s^2), s the standard deviation of V in px^2: 0.5 at 1 px^2; 0 outside the valid region",
};

/// u of a sweep.
pub(super) const FOCUS: Meaning = Meaning {
    units: "focus settings",
    comments: "Focus setting at which each pixel of the reference frame is sharp, in the focus_unit of report.json; NaN where no pair of frames tells",
};

/// Its standard deviation.
pub(super) const FOCUS_UNCERTAINTY: Meaning =
    Meaning { units: "focus settings", comments: "Standard deviation of the focus setting; NaN where there is none" };

/// A photograph.
pub(super) const INTENSITY: Meaning = Meaning { units: "1", comments: "Intensity, white at 1" };

/// True depth.
pub(super) const DEPTH: Meaning =
    Meaning { units: "mm", comments: "Depth in mm from the lens, at the pixels of the first image" };

/// Depth by the lens, and its standard deviation.
pub(super) const METRIC_DEPTH: Meaning = Meaning {
    units: "mm",
    comments: "Y: depth in mm from the lens, at the pixels of the first image; standard_deviation: that of Y in mm, from \
               the uncertainty of the relative blur; NaN outside the valid region and the range of the lens model",
};

/// Depth of a sweep, and its standard deviation.
pub(super) const SWEEP_DEPTH: Meaning = Meaning {
    units: "mm",
    comments: "Y: depth in mm, from the lens or along the axis of the stage, at the pixels of the reference frame; \
               standard_deviation: that of Y in mm; NaN where no pair of frames tells",
};

/// Writes a field of `width` x `height` values.
pub(super) fn write(
    writer: impl Write + Seek,
    size: (u32, u32),
    values: &[f32],
    meaning: &Meaning,
) -> Result<(), String> {
    write_channels(writer, size, &[("Y", values)], meaning)
}

/// Writes several fields of one size, each with the name of its channel.
pub(super) fn write_channels(
    writer: impl Write + Seek,
    (width, height): (u32, u32),
    fields: &[(&str, &[f32])],
    meaning: &Meaning,
) -> Result<(), String> {
    let text = |s: &str| Text::new_or_none(s).ok_or_else(|| format!("'{s}' does not fit EXR text"));
    let mut attributes = LayerAttributes {
        software_name: Some(text(concat!("parfocal ", env!("CARGO_PKG_VERSION")))?),
        comments: Some(text(meaning.comments)?),
        ..LayerAttributes::default()
    };
    attributes.other.insert(text("units")?, AttributeValue::Text(text(meaning.units)?));
    let channel = |&(name, values): &(&str, &[f32])| AnyChannel::new(name, FlatSamples::F32(values.to_vec()));
    let channels = AnyChannels::sort(fields.iter().map(channel).collect());
    let layer = Layer::new((width as usize, height as usize), attributes, Encoding::SMALL_FAST_LOSSLESS, channels);
    Image::from_layer(layer).write().to_buffered(writer).map_err(|e| e.to_string())
}
