//! Drawing: plots of curves, and the keys of maps, as PNG.
//!
//! ```
//! use parfocal::page::figure::{Axis, Plot, Series};
//!
//! let plot = Plot::new("Translation against noise", Axis::linear("noise σ"), Axis::log("error, px"))
//!     .series(Series::new("ours", [(0.0, 0.002), (0.01, 0.02), (0.02, 0.05)]))
//!     .series(Series::new("SIFT", [(0.0, 0.3), (0.01, 0.8), (0.02, f64::NAN)]))
//!     .target(0.25, "target");
//! # let folder = tempfile::TempDir::new().unwrap();
//! # let plot_png = folder.path().join("plot.png");
//! parfocal::page::figure::write_png(&plot_png, &plot.draw())?;
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! Values that are not finite are gaps in a curve.

#[allow(missing_docs, reason = "public for the laboratory only")]
pub(crate) mod canvas;
mod plot;

use self::canvas::MAX_SIDE;
use self::plot::Tick;
use crate::base::Error;
use crate::files::export::{Destination, FileKind, Palette, Plotter, Scale, write_drawing, write_file};

use image::RgbImage;

pub use plot::{Axis, Plot, Series};

pub(crate) use canvas::{Align, Area, BLACK, Canvas, Color, GRAY, WHITE, resized, text_width};

/// Draws keys and profiles into results.
pub const PLOTTER: Plotter = Plotter { key, profile: plot::profile };

/// Writes a picture as PNG atomically. Creates its folder if it is missing. Replaces a picture of parfocal; the
/// [`Destination`] must force the replacement of another file.
///
/// # Errors
/// [`Error::File`].
pub fn write_png<'d>(file: impl Into<Destination<'d>>, image: &RgbImage) -> Result<(), Error> {
    write_file(file.into(), FileKind::Png, |writer| write_drawing(writer, image))
}

/// Gap between the bar and its numbers, in text sizes.
const GAP: f32 = 0.5;

/// Least size of text, px.
const LEAST_TEXT: f32 = 11.0;
/// Size of text as a fraction of the longer side.
const TEXT: f32 = 0.018;
/// Least height of a map in text sizes, which limits the size of text. Title and names take half of it.
const LINES: f32 = 12.0;

/// Draws a colour bar, near on top, with values to its right in text of this size. The bar is in the left part of the
/// area, the numbers are in the right.
pub(crate) fn color_bar(canvas: &mut Canvas, area: Area, scale: &Scale, palette: Palette, size: f32) {
    let bar = Area { width: 0.9 * size, ..area };
    // Draws whole rows: antialiased edges between them would be visible as stripes.
    let (top, bottom) = (bar.y.round(), bar.bottom().round());
    for row in 0..(bottom - top).max(0.0) as u32 {
        let nearness = 1.0 - (f64::from(row) + 0.5) / f64::from(bottom - top);
        canvas.fill(Area { y: top + row as f32, height: 1.0, ..bar }, palette.color(nearness));
    }
    let line = (size / 12.0).max(1.0);
    canvas.outline(Area { y: top, height: bottom - top, ..bar }, GRAY, line);
    for Tick { value, label } in ticks(scale, area.height, size) {
        let Some(label) = label else { continue };
        let y = bottom - scale.nearness(value as f32) as f32 * (bottom - top);
        canvas.line(&[(bar.right(), y), (bar.right() + 3.0 * line, y)], GRAY, line, None);
        canvas.text(&label, (bar.right() + GAP * size, y + 0.35 * size), size, Align::Left, BLACK);
    }
}

/// Round values for a bar of this height.
fn ticks(scale: &Scale, height: f32, size: f32) -> Vec<Tick> {
    let span = Axis::linear("").spanning([f64::from(scale.low), f64::from(scale.high)]);
    span.ticks((height / (2.5 * size)).max(1.0) as usize)
}

/// Width of a colour bar with numbers of V, px.
pub(crate) fn bar_width(size: f32) -> f32 {
    (0.9 + GAP) * size + text_width("−188.8", size)
}

/// Draws the key of a map of this size: a title with the unit, the bar, names of its near and far end, and round values. The key is
/// as high as the map, and the text scales with the map.
pub(crate) fn key(
    [title, near, far]: [&str; 3],
    scale: &Scale,
    palette: Palette,
    (width, height): (u32, u32),
) -> RgbImage {
    let high = height.min(MAX_SIDE) as f32;
    let size = (TEXT * width.max(height) as f32).min(high / LINES).max(LEAST_TEXT);
    let line = 1.4 * size;
    // A low map has only the colours in its key.
    let around = if high >= 5.0 * line { 2.3 * line } else { 0.0 };
    let bar = Area { x: size, y: around + 0.2 * line, width: 0.0, height: high - 1.6 * around - 0.4 * line };
    let labels = ticks(scale, bar.height, size).into_iter().filter_map(|tick| tick.label);
    let numbers = labels.map(|label| text_width(&label, size)).fold(0.0, f32::max);
    let wide = text_width(title, size).max((0.9 + GAP) * size + numbers);
    let mut canvas = Canvas::new((wide + 2.0 * size).ceil() as u32, height);
    if around > 0.0 {
        for (words, y) in [(title, line), (near, around), (far, bar.bottom() + line)] {
            canvas.text(words, (bar.x, y), size, Align::Left, BLACK);
        }
    }
    color_bar(&mut canvas, Area { width: wide, ..bar }, scale, palette, size);
    canvas.into_image()
}
