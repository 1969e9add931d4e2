//! PNG files with a description in their text chunks.

use std::io::Write;

use image::RgbImage;
use png::{BitDepth, ColorType, Compression, Encoder, Filter};

use super::description::{Description, SOFTWARE};

/// Samples of a picture, row-major, channels interleaved.
pub(crate) enum Pixels<'a> {
    Bytes(&'a [u8]),
    Words(&'a [u16]),
}

impl Pixels<'_> {
    fn depth(&self) -> BitDepth {
        match self {
            Self::Bytes(_) => BitDepth::Eight,
            Self::Words(_) => BitDepth::Sixteen,
        }
    }
}

/// Writes a picture; its text chunks state the program, the unit and the content.
pub(crate) fn write(
    writer: impl Write,
    size: (u32, u32),
    color: ColorType,
    samples: &Pixels<'_>,
    description: &Description,
) -> Result<(), String> {
    finish(encoder(writer, size, description)?, color, samples)
}

/// Writes a drawing, whose large areas of one colour compress well. Its text chunk states the program.
pub(crate) fn write_drawing(writer: impl Write, image: &RgbImage) -> Result<(), String> {
    let mut encoder = Encoder::new(writer, image.width(), image.height());
    add_text(&mut encoder, "Software", SOFTWARE)?;
    encoder.set_color(ColorType::Rgb);
    encoder.set_compression(Compression::Balanced);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(image).and_then(|()| writer.finish()).map_err(|e| e.to_string())
}

/// Creates an encoder, to which text or a palette can be added before [`finish`].
pub(crate) fn encoder<'a, W: Write>(
    writer: W,
    (width, height): (u32, u32),
    description: &Description,
) -> Result<Encoder<'a, W>, String> {
    let mut encoder = Encoder::new(writer, width, height);
    for (keyword, text) in
        [("Software", SOFTWARE), ("Description", &description.comments), ("Units", &description.units)]
    {
        add_text(&mut encoder, keyword, text)?;
    }
    Ok(encoder)
}

/// Adds a tEXt chunk.
pub(crate) fn add_text<W: Write>(encoder: &mut Encoder<'_, W>, keyword: &str, text: &str) -> Result<(), String> {
    encoder.add_text_chunk(keyword.to_string(), text.to_string()).map_err(|e| e.to_string())
}

/// Writes the pixels and ends the file.
pub(crate) fn finish<W: Write>(
    mut encoder: Encoder<'_, W>,
    color: ColorType,
    samples: &Pixels<'_>,
) -> Result<(), String> {
    encoder.set_color(color);
    encoder.set_depth(samples.depth());
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    match samples {
        Pixels::Bytes(bytes) => writer.write_image_data(bytes),
        // PNG is big-endian.
        Pixels::Words(words) => {
            writer.write_image_data(&words.iter().flat_map(|w| w.to_be_bytes()).collect::<Vec<_>>())
        }
    }
    .and_then(|()| writer.finish())
    .map_err(|e| e.to_string())
}
