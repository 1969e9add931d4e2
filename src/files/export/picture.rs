//! PNG files that say what they hold.

use std::io::Write;

use image::RgbImage;
use png::{BitDepth, ColorType, Compression, Encoder, Filter};

use super::meaning::{Meaning, SOFTWARE};

/// Samples of a picture, row-major, channels interleaved.
pub(crate) enum Stored<'a> {
    Bytes(&'a [u8]),
    Words(&'a [u16]),
}

impl Stored<'_> {
    fn depth(&self) -> BitDepth {
        match self {
            Self::Bytes(_) => BitDepth::Eight,
            Self::Words(_) => BitDepth::Sixteen,
        }
    }
}

/// Writes a picture whose text states the program, the unit and the content.
pub(crate) fn write(
    writer: impl Write,
    size: (u32, u32),
    color: ColorType,
    samples: &Stored<'_>,
    meaning: &Meaning,
) -> Result<(), String> {
    finish(encoder(writer, size, meaning)?, color, samples)
}

/// Writes a drawing, which large areas of one colour make small, and which states the program.
pub(crate) fn write_drawing(writer: impl Write, image: &RgbImage) -> Result<(), String> {
    let mut encoder = Encoder::new(writer, image.width(), image.height());
    add_text(&mut encoder, "Software", SOFTWARE)?;
    encoder.set_color(ColorType::Rgb);
    encoder.set_compression(Compression::Balanced);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(image).and_then(|()| writer.finish()).map_err(|e| e.to_string())
}

/// An encoder to which more text, or a palette, can be added before it is [`finish`]ed.
pub(crate) fn encoder<'a, W: Write>(
    writer: W,
    (width, height): (u32, u32),
    meaning: &Meaning,
) -> Result<Encoder<'a, W>, String> {
    let mut encoder = Encoder::new(writer, width, height);
    for (keyword, text) in [("Software", SOFTWARE), ("Description", &meaning.comments), ("Units", meaning.units)] {
        add_text(&mut encoder, keyword, text)?;
    }
    Ok(encoder)
}

/// Adds a chunk tEXt.
pub(crate) fn add_text<W: Write>(encoder: &mut Encoder<'_, W>, keyword: &str, text: &str) -> Result<(), String> {
    encoder.add_text_chunk(keyword.to_string(), text.to_string()).map_err(|e| e.to_string())
}

/// Writes the pixels.
pub(crate) fn finish<W: Write>(
    mut encoder: Encoder<'_, W>,
    color: ColorType,
    samples: &Stored<'_>,
) -> Result<(), String> {
    encoder.set_color(color);
    encoder.set_depth(samples.depth());
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    match samples {
        Stored::Bytes(bytes) => writer.write_image_data(bytes),
        // The byte order of the format.
        Stored::Words(words) => {
            writer.write_image_data(&words.iter().flat_map(|w| w.to_be_bytes()).collect::<Vec<_>>())
        }
    }
    .and_then(|()| writer.finish())
    .map_err(|e| e.to_string())
}
