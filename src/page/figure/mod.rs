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
//! Nothing here fails on odd data: what cannot be shown is a gap in a curve.

mod axis;
mod bar;
mod canvas;
mod plot;
mod profile;
mod resize;
mod series;
pub(crate) mod text;

use crate::base::Error;
use crate::files::export::{Destination, FileKind, Plotter, write_drawing, write_file};

use image::RgbImage;

pub use axis::Axis;
pub use plot::Plot;
pub use series::Series;

pub(crate) use bar::{color_bar, width as bar_width};
pub(crate) use canvas::{Align, Area, BLACK, Canvas, Color, GRAY, LIGHT, WHITE};
pub(crate) use resize::resized;

/// Draws keys and profiles into results.
pub const PLOTTER: Plotter = Plotter { key: bar::key, profile: profile::profile };

/// Writes a picture as PNG, whole or not at all; its folder is made if it is missing. A picture of parfocal's that lies
/// there is replaced, another file only where the [`Destination`] forces it.
///
/// # Errors
/// [`Error::File`](crate::Error::File).
pub fn write_png<'d>(file: impl Into<Destination<'d>>, image: &RgbImage) -> Result<(), Error> {
    write_file(file.into(), FileKind::Png, |writer| write_drawing(writer, image))
}
