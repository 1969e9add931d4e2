//! `report.html`: results as one page that works without a network.
//!
//! The page contains its style, its scripts, three.js for the surface, and all data: each field with the digits that
//! its read-out shows, the registered photographs and the fused image as JPEG, and the report. Pairs and sweeps share
//! one template, and the page hides the parts that do not apply. Text from outside, such as file names, is embedded as
//! JSON and displayed as text, never as HTML. A content security policy keeps the page from loading anything.

mod encoding;
mod page;
mod readout;

use std::borrow::Cow;
use std::io::Write;
use std::thread;

use image::{Rgb, RgbImage};
use serde_json::{Value, json};

use self::encoding::Grid;
pub(super) use self::encoding::jpeg;
pub use self::page::{ExistingPage, Page};
pub use self::readout::Readout;
use crate::base::{Brightness, Channels, Decode, Frame, Homography, Region, workers};
use crate::files::export::Palette;
use crate::files::image_io::{Tone, preview_in};
use crate::page::view::{Heights, View};
use crate::solve::resample::{Reduction, registered, registered_and_reduced};

/// Nodes of the surface along its longer side.
const NODES: u32 = 512;

/// Radius of the median that removes spikes from the surface, nodes.
const SMOOTHING: u32 = 2;

/// Decimals of the surface's heights, which run from 0 to 1.
const HEIGHT_DIGITS: u32 = 5;

/// JPEG quality of the pictures. At 88 no block is visible, even when pictures alternate, and a page of 2 megapixels
/// stays below 8 MB.
const QUALITY: u8 = 88;

/// JPEG quality of the frames of a sweep.
const FRAME_QUALITY: u8 = 85;

/// Greatest number of pixels of all frames of a sweep together, without the reference.
const MAX_FRAME_PIXELS: usize = 6 << 20;

const TEMPLATE: &str = include_str!("assets/report.html");

/// Style, scripts and licence, by their names in the template.
const ASSETS: [(&str, &str); 11] = [
    ("style", include_str!("assets/report.css")),
    ("three", include_str!("assets/three/three.min.js")),
    ("three-license", include_str!("assets/three/LICENSE")),
    ("data.js", include_str!("assets/data.js")),
    ("chart.js", include_str!("assets/chart.js")),
    ("view.js", include_str!("assets/view.js")),
    ("measure.js", include_str!("assets/measure.js")),
    ("viewer.js", include_str!("assets/viewer.js")),
    ("surface.js", include_str!("assets/surface.js")),
    ("numbers.js", include_str!("assets/numbers.js")),
    ("report.js", include_str!("assets/report.js")),
];

/// A picture of the page, on the pixels of the reference.
struct Picture<'a> {
    name: String,
    pixels: Pixels<'a>,
}

/// Source of the pixels of a picture.
enum Pixels<'a> {
    Photographed(Box<Photographed<'a>>),
    /// A picture of an existing page: JPEG in base64.
    Encoded(&'a str),
}

/// A photograph, to be moved onto the pixels of the reference.
struct Photographed<'a> {
    frame: Cow<'a, Frame>,
    /// Its decoding.
    decode: Decode,
    /// The range of its stored values that is shown.
    tone: Tone,
    /// The part of the photograph that the fields cover.
    part: Region,
    /// Its registration; `None` for the reference.
    registration: Option<(Homography, Brightness)>,
    /// Number of the frames that share [`MAX_FRAME_PIXELS`], if it is one of them.
    sharing: Option<usize>,
}

impl<'a> Photographed<'a> {
    fn named(self, name: String) -> Picture<'a> {
        Picture { name, pixels: Pixels::Photographed(Box::new(self)) }
    }
}

/// The contents of a page.
struct Contents<'a> {
    /// Size of the fields and the fused image.
    size: (u32, u32),
    palette: Palette,
    /// The pictures; the last one is the fused image.
    pictures: Vec<Picture<'a>>,
    /// The fields; the first one determines which pixels are valid.
    fields: Vec<Readout<'a>>,
    /// Key of the field that gives the surface its heights.
    heights: &'static str,
    /// Relief at which the heights are true to scale, if it is known.
    to_scale: Option<f64>,
    /// Additional data for the scripts; an object.
    more: Value,
}

/// A picture of stored values in a range.
fn picture_of(values: &[f32], [width, height]: [u32; 2], channels: Channels, tone: Tone) -> RgbImage {
    let byte = |value: f32| (255.0 * tone.shown(value)).round() as u8;
    let mut pixels = values.chunks_exact(channels.count() as usize);
    RgbImage::from_fn(width, height, |_, _| match pixels.next() {
        Some(&[r, g, b]) => Rgb([r, g, b].map(byte)),
        Some(&[v, ..]) => Rgb([byte(v); 3]),
        _ => Rgb([0; 3]),
    })
}

/// A picture that is being encoded.
enum Image<'a> {
    /// Pixels with their JPEG quality.
    Raw(RgbImage, u8),
    Encoded(&'a str),
}

impl Contents<'_> {
    fn write(self, writer: &mut dyn Write) -> Result<(), String> {
        let parts = self.parts()?;
        for (i, piece) in TEMPLATE.split("{{").enumerate() {
            let (name, text) = if i == 0 { ("", piece) } else { piece.split_once("}}").unwrap_or(("", piece)) };
            let asset = ASSETS.iter().filter(|(asset, _)| *asset == name).map(|(_, text)| *text);
            let part = parts.iter().filter(|(part, _)| *part == name).map(|(_, text)| text.as_str());
            for text in asset.chain(part).chain([text]) {
                writer.write_all(text.as_bytes()).map_err(|e| e.to_string())?;
            }
        }
        Ok(())
    }

    /// The variable parts of the page by their names in the template. Threads compute the expensive parts in parallel.
    fn parts(mut self) -> Result<Vec<(&'static str, String)>, String> {
        let first = self.fields.first().map(Readout::key);
        self.fields.retain(|field| Some(field.key()) == first || field.is_worth_showing());
        // The page computes some fields from V and its standard deviation.
        let whole = self.fields.iter().any(|field| field.key() == "uncertainty");
        self.fields.retain(|field| whole || field.is_encoded());
        let grid = Grid::of(self.size);
        let heights = self.fields.iter().find(|field| field.key() == self.heights).or(self.fields.first());
        let heights = heights.ok_or("the page has no field")?;
        let (nodes, described) = surface_data(heights, self.size.0 as usize, self.to_scale)?;
        let (fields, pictures) = thread::scope(|scope| {
            // Computed on this thread if no other can be started.
            let beside = |field| {
                let (field, grid): (&Readout<'_>, _) = (field, &grid);
                let packed = thread::Builder::new().spawn_scoped(scope, move || field.encoded(grid));
                packed.map_err(|_| field.encoded(grid))
            };
            let fields: Vec<_> = self.fields.iter().map(beside).collect();
            let pictures = self.encoded_pictures(&grid);
            let join = |packed: Result<thread::ScopedJoinHandle<'_, _>, _>| match packed {
                Ok(packed) => packed.join().unwrap_or_else(|_| Err(OUT.to_string())),
                Err(packed) => packed,
            };
            (fields.into_iter().map(join).collect::<Result<Vec<_>, String>>(), pictures)
        });
        let values = self.fields.iter().zip(fields?).filter(|(field, _)| field.is_encoded());
        let values = values.map(|(field, text)| element(&format!("field-{}", field.key()), &text)).collect();
        let data = encoding::json(&self.data(&grid, described))?;
        Ok(vec![("data", data), ("fields", values), ("heights", nodes), ("pictures", pictures?)])
    }

    /// Encodes pictures. They are resampled in sequence, since resampling uses all processors and much memory, and
    /// compressed in parallel.
    fn encoded_pictures(&self, grid: &Grid) -> Result<String, String> {
        let mut texts = vec![Ok(String::new()); self.pictures.len()];
        let images = self.pictures.iter().map(|picture| self.image(&picture.pixels, grid));
        workers::for_each(images.zip(&mut texts), |(image, text)| {
            *text = image.and_then(|image| match image {
                Image::Encoded(text) => Ok(text.to_string()),
                Image::Raw(image, quality) => jpeg(&image, quality),
            });
        });
        let elements = texts.into_iter().enumerate();
        elements.map(|(i, text)| Ok(element(&format!("picture-{i}"), &text?))).collect()
    }

    /// A picture as the page displays it.
    fn image<'b>(&self, pixels: &Pixels<'b>, grid: &Grid) -> Result<Image<'b>, String> {
        let Photographed { frame, decode, tone, part, registration, sharing } = match pixels {
            Pixels::Encoded(text) => return Ok(Image::Encoded(text)),
            Pixels::Photographed(photographed) => photographed.as_ref(),
        };
        let of_frame = sharing.map(|count| {
            let most = (MAX_FRAME_PIXELS / count.max(1)).min(grid.width * grid.height);
            Grid::within(self.size, most)
        });
        let (grid, quality) = of_frame.as_ref().map_or((grid, QUALITY), |grid| (grid, FRAME_QUALITY));
        let is_whole = (frame.width(), frame.height()) == self.size;
        if let Some((t, p)) = registration.filter(|_| grid.step > 1) {
            let part = if is_whole { Region { x: 0, y: 0, width: self.size.0, height: self.size.1 } } else { *part };
            let size = [grid.width, grid.height].map(|side| side as u32);
            let reduction = Reduction { part, size, step: grid.step };
            let values = registered_and_reduced(frame, &t, &p, *decode, reduction);
            return Ok(Image::Raw(picture_of(&values, size, frame.format().channels, *tone), quality));
        }
        let moved = registration.map(|(t, p)| registered(frame, &t, &p, *decode));
        let whole = moved.as_ref().unwrap_or(frame);
        let part = (!is_whole).then(|| whole.cropped(*part)).transpose()?;
        Ok(Image::Raw(grid.picture(preview_in(part.as_ref().unwrap_or(whole), *tone)), quality))
    }

    fn data(&self, grid: &Grid, surface: Value) -> Value {
        let mut data = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "grid": { "step": grid.step, "first": grid.step / 2, "width": grid.width, "height": grid.height },
            "fields": self.fields.iter().map(Readout::description).collect::<Vec<_>>(),
            "pictures": self.pictures.iter().map(|picture| &picture.name).collect::<Vec<_>>(),
            "surface": surface,
            "colormap": COLORMAPS.iter().position(|(_, palette)| *palette == self.palette),
            "colormaps": COLORMAPS.map(|(name, palette)| json!({ "name": name, "colors": hexadecimal(palette) })),
        });
        if let (Some(data), Value::Object(more)) = (data.as_object_mut(), &self.more) {
            data.extend(more.clone());
        }
        data
    }
}

const OUT: &str = "out of memory";

/// A script element with text that browsers do not execute.
fn element(id: &str, text: &str) -> String {
    format!("<script type=\"text/plain\" id=\"{id}\">{text}</script>\n")
}

/// The nearness of the surface's nodes, NaN in holes, and its description for the scripts.
fn surface_data(field: &Readout<'_>, width: usize, to_scale: Option<f64>) -> Result<(String, Value), String> {
    let view = View::default();
    let relief = to_scale.unwrap_or(view.relief);
    let Heights { width, height, data } = Heights::of(field.values(), width, &field.scale(), NODES, SMOOTHING);
    let described = json!({
        "field": field.key(), "width": width, "height": height, "digits": HEIGHT_DIGITS,
        "relief": relief, "to_scale": to_scale.is_some(), "elevation_deg": view.elevation, "azimuth_deg": view.azimuth,
    });
    Ok((encoding::decimals(&data, width, HEIGHT_DIGITS)?, described))
}

/// Colour maps of the page; the last one is for fields in grey.
const COLORMAPS: [(&str, Palette); 3] =
    [("Viridis", Palette::Viridis), ("Red near, blue far", Palette::RedBlue), ("Grey", Palette::Grey)];

/// 256 colours from far to near.
fn hexadecimal(palette: Palette) -> String {
    (0..256).flat_map(|i| palette.color(f64::from(i) / 255.0)).map(|byte| format!("{byte:02x}")).collect()
}
