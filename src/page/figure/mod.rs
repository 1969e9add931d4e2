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

mod canvas;
mod color_bar;
mod plot;

use crate::base::Error;
use crate::files::export::{Destination, FileKind, Plotter, write_drawing, write_file};

use image::RgbImage;

pub use plot::{Axis, Plot, Series};

pub(crate) use canvas::{Align, Area, BLACK, Canvas, Color, GRAY, LIGHT, WHITE, resized, text_width, wrap_text};
pub(crate) use color_bar::{bar_width, color_bar};

/// Draws keys and profiles into results.
pub const PLOTTER: Plotter = Plotter { key: color_bar::key, profile: plot::profile };

/// Writes a picture as PNG atomically. Creates its folder if it is missing. Replaces a picture of parfocal; the
/// [`Destination`] must force the replacement of another file.
///
/// # Errors
/// [`Error::File`].
pub fn write_png<'d>(file: impl Into<Destination<'d>>, image: &RgbImage) -> Result<(), Error> {
    write_file(file.into(), FileKind::Png, |writer| write_drawing(writer, image))
}
