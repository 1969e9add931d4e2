//! `report.html`: the results of a solve or of a focus sweep in one page to look at, which asks nothing of a network.
//!
//! The page holds its style, its scripts, three.js for the surface, and all data: each field to the digits that its
//! read-out shows, the photographs, registered, and the fused image as JPEG, and the report. Pair and sweep share one
//! template, of which parts are left out. What comes from outside, names of files say, goes in as JSON and out as text,
//! never as HTML; a content security policy keeps the page from loading anything.

mod earlier;
mod packed;
mod pair;
mod readout;
mod sweep;
mod thinning;

use std::borrow::Cow;
use std::io::Write;
use std::thread;

use image::RgbImage;
use serde_json::{Value, json};

pub use self::earlier::EarlierPage;
use self::pair::fields_of_pair;
pub use self::pair::{Page, residual};
pub use self::readout::Readout;
pub use self::sweep::SweepPage;
use self::sweep::fields_of_sweep;
use self::thinning::Thinning;
use crate::base::{Brightness, Decode, Error, Frame, Homography, Region, workers};
use crate::files::export::Palette;
use crate::files::preview::photograph;
use crate::metric::MetricDepth;
use crate::page::view::{Surface, View, relief_to_scale};
use crate::solve::resample::registered;

/// Nodes of the surface along its longer side.
const NODES: u32 = 512;

/// Digits after the point of its heights, which run from 0 to 1.
const HEIGHT_DIGITS: u32 = 5;

/// Quality of the pictures, of 100: at 88 no block shows, even flickering, and a page of 2 megapixels stays below 8 MB.
const QUALITY: u8 = 88;

/// Of many frames.
const LESSER_QUALITY: u8 = 85;

/// The most pixels of all the frames that are there only to be leafed through.
const MOST_LEAFED: usize = 6 << 20;

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

/// Where the pixels of a picture come from.
enum Pixels<'a> {
    Photographed(Box<Photographed<'a>>),
    /// An earlier page, as it stands there.
    Packed(&'a str),
}

/// A photograph, to be brought onto the pixels of the reference.
struct Photographed<'a> {
    frame: Cow<'a, Frame>,
    /// How it was decoded.
    decode: Decode,
    /// The part of it that the fields are of.
    part: Region,
    /// Where it lies and how it is exposed, unless it is the reference.
    place: Option<(Homography, Brightness)>,
    /// How many it is one of, and may be reduced for, if it is one of many.
    leafed: Option<usize>,
}

impl<'a> Photographed<'a> {
    fn named(self, name: String) -> Picture<'a> {
        Picture { name, pixels: Pixels::Photographed(Box::new(self)) }
    }
}

/// What a page is made of, be it of a pair or of a sweep.
struct Contents<'a> {
    /// Of the fields and the fused image.
    size: (u32, u32),
    palette: Palette,
    /// The last one is the fused image.
    pictures: Vec<Picture<'a>>,
    /// The first says which pixels are valid.
    fields: Vec<Readout<'a>>,
    /// The key of the field that gives the surface its heights.
    heights: &'static str,
    /// The relief at which these are true to scale, where that is known.
    to_scale: Option<f64>,
    /// What the scripts are told besides; an object.
    told: Value,
}

/// A picture on its way into the page.
enum Image<'a> {
    /// With its quality.
    Fresh(RgbImage, u8),
    Packed(&'a str),
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

    /// What of the page changes from page to page, by its name in the template. The dear parts are made side by side.
    fn parts(mut self) -> Result<Vec<(&'static str, String)>, String> {
        let first = self.fields.first().map(Readout::key);
        self.fields.retain(|field| Some(field.key()) == first || field.is_worth_showing());
        // What a field is made of must be there.
        let whole = self.fields.iter().any(|field| field.key() == "uncertainty");
        self.fields.retain(|field| whole || field.is_packed());
        let thinning = Thinning::of(self.size);
        let heights = self.fields.iter().find(|field| field.key() == self.heights).or(self.fields.first());
        let heights = heights.ok_or("the page has no field")?;
        let surface = Surface::bare(heights.values(), self.size, heights.scale()).map_err(|e| e.to_string())?;
        let (nodes, described) = surface_data(&surface, heights.key(), self.to_scale)?;
        let (fields, pictures) = thread::scope(|scope| {
            // On this thread where there is no other.
            let beside = |field| {
                let (field, thinning): (&Readout<'_>, _) = (field, &thinning);
                let packed = thread::Builder::new().spawn_scoped(scope, move || field.packed(thinning));
                packed.map_err(|_| field.packed(thinning))
            };
            let fields: Vec<_> = self.fields.iter().map(beside).collect();
            let pictures = self.packed_pictures(&thinning);
            let join = |packed: Result<thread::ScopedJoinHandle<'_, _>, _>| match packed {
                Ok(packed) => packed.join().unwrap_or_else(|_| Err(OUT.to_string())),
                Err(packed) => packed,
            };
            (fields.into_iter().map(join).collect::<Result<Vec<_>, String>>(), pictures)
        });
        let values = self.fields.iter().zip(fields?).filter(|(field, _)| field.is_packed());
        let values = values.map(|(field, text)| element(&format!("field-{}", field.key()), &text)).collect();
        let data = packed::json(&self.data(&thinning, described))?;
        Ok(vec![("data", data), ("fields", values), ("heights", nodes), ("pictures", pictures?)])
    }

    /// Brought onto the reference's pixels one after the other, since warping takes all processors, and memory; compressed beside that.
    fn packed_pictures(&self, thinning: &Thinning) -> Result<String, String> {
        let mut texts = vec![Ok(String::new()); self.pictures.len()];
        let images = self.pictures.iter().map(|picture| self.image(&picture.pixels, thinning));
        workers::for_each(images.zip(&mut texts), |(image, text)| {
            *text = image.and_then(|image| match image {
                Image::Packed(text) => Ok(text.to_string()),
                Image::Fresh(image, quality) => packed::picture(&image, quality),
            });
        });
        let elements = texts.into_iter().enumerate();
        elements.map(|(i, text)| Ok(element(&format!("picture-{i}"), &text?))).collect()
    }

    /// A picture as the page shows it.
    fn image<'b>(&self, pixels: &Pixels<'b>, thinning: &Thinning) -> Result<Image<'b>, String> {
        let Photographed { frame, decode, part, place, leafed } = match pixels {
            Pixels::Packed(text) => return Ok(Image::Packed(text)),
            Pixels::Photographed(photographed) => photographed.as_ref(),
        };
        let moved = place.map(|(t, p)| registered(frame, &t, &p, *decode));
        let whole = moved.as_ref().unwrap_or(frame);
        let part = ((whole.width(), whole.height()) != self.size).then(|| whole.cropped(*part)).transpose()?;
        let image = photograph(part.as_ref().unwrap_or(whole));
        let Some(count) = leafed else { return Ok(Image::Fresh(thinning.picture(image), QUALITY)) };
        let most = (MOST_LEAFED / count.max(&1)).min(thinning.width * thinning.height);
        Ok(Image::Fresh(Thinning::within(self.size, most).picture(image), LESSER_QUALITY))
    }

    fn data(&self, thinning: &Thinning, surface: Value) -> Value {
        let mut data = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "grid": { "step": thinning.step, "first": thinning.step / 2, "width": thinning.width, "height": thinning.height },
            "fields": self.fields.iter().map(Readout::description).collect::<Vec<_>>(),
            "pictures": self.pictures.iter().map(|picture| &picture.name).collect::<Vec<_>>(),
            "surface": surface,
            "colormap": COLORMAPS.iter().position(|(_, palette)| *palette == self.palette),
            "colormaps": COLORMAPS.map(|(name, palette)| json!({ "name": name, "colors": hexadecimal(palette) })),
        });
        if let (Some(data), Value::Object(told)) = (data.as_object_mut(), &self.told) {
            data.extend(told.clone());
        }
        data
    }
}

const OUT: &str = "out of memory";

/// What a page needs to see V through a lens as the program does; nothing without one.
fn through_lens(scale: f64, limit: f64, metric: Option<&MetricDepth>) -> Value {
    metric.map_or(Value::Null, |_| json!({ "scale": scale, "limit": limit.is_finite().then_some(limit) }))
}

/// The relief at which depth is true to scale.
fn to_scale(metric: Option<&MetricDepth>) -> Option<f64> {
    metric.map(relief_to_scale)
}

/// An element that holds text which no browser reads by itself.
fn element(id: &str, text: &str) -> String {
    format!("<script type=\"text/plain\" id=\"{id}\">{text}</script>\n")
}

/// The surface's nodes: their nearness, NaN in holes; and what they are.
fn surface_data(surface: &Surface, field: &str, to_scale: Option<f64>) -> Result<(String, Value), String> {
    let relief = to_scale.unwrap_or(View::default().relief);
    let view = View { width: NODES, smoothing: 2, relief, ..View::default() };
    let (width, height, heights) = surface.heights(&view);
    let described = json!({
        "field": field, "width": width, "height": height, "digits": HEIGHT_DIGITS,
        "relief": view.relief, "to_scale": to_scale.is_some(), "elevation_deg": view.elevation, "azimuth_deg": view.azimuth,
    });
    Ok((packed::decimals(&heights, width, HEIGHT_DIGITS)?, described))
}

/// What the page offers; the last one is for fields in grey.
const COLORMAPS: [(&str, Palette); 3] =
    [("Viridis", Palette::Viridis), ("Red near, blue far", Palette::RedBlue), ("Grey", Palette::Grey)];

/// 256 colours from far to near.
fn hexadecimal(palette: Palette) -> String {
    (0..256).flat_map(|i| palette.color(f64::from(i) / 255.0)).map(|byte| format!("{byte:02x}")).collect()
}

/// The fused image as the page's last picture.
fn best_focus<'a>(fused: Result<Frame, Error>) -> Result<Picture<'a>, String> {
    let frame: Cow<'_, Frame> = Cow::Owned(fused.map_err(|e| e.to_string())?);
    let part = Region { x: 0, y: 0, width: frame.width(), height: frame.height() };
    let fused = Photographed { frame, decode: Decode::None, part, place: None, leafed: None };
    Ok(fused.named("Best focus".to_string()))
}
