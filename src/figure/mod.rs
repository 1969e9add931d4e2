//! Figures: contact sheets of pictures and plots of curves, as PNG.
//!
//! ```
//! use parfocal::export::{Nearer, Scale};
//! use parfocal::figure::{Axis, Panel, Plot, Row, Series, Sheet};
//!
//! let (raw, ours) = (vec![0.0; 64 * 48], vec![1.5; 64 * 48]);
//! let scale = Scale::common([&raw[..], &ours], Nearer::First);
//! let field = |v: &[f32]| Panel::relative_blur(64, 48, v, &scale);
//! let sheet = Sheet::new("Relative blur").columns(["without registration", "SIFT", "ours"]).row(
//!     Row::new("Cup").scale(scale).panels([
//!         field(&raw).caption("t off by 2.9 px"),
//!         Panel::missing("too few key-points"),
//!         field(&ours).caption("0.001 px"),
//!     ]),
//! );
//! let plot = Plot::new("Translation against noise", Axis::linear("noise σ"), Axis::log("error, px"))
//!     .series(Series::new("ours", [(0.0, 0.002), (0.01, 0.02), (0.02, 0.05)]))
//!     .series(Series::new("SIFT", [(0.0, 0.3), (0.01, 0.8), (0.02, f64::NAN)]))
//!     .target(0.25, "target");
//! # let folder = tempfile::TempDir::new().unwrap();
//! # let (sheet_png, plot_png) = (folder.path().join("sheet.png"), folder.path().join("plot.png"));
//! parfocal::figure::write_png(&sheet_png, &sheet.draw())?;
//! parfocal::figure::write_png(&plot_png, &plot.draw())?;
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! V is red near and blue far, as in the paper, and grey where not valid. Nothing here fails on odd data: what
//! cannot be shown is a panel that says why, or a gap in a curve.

mod axis;
mod bar;
mod canvas;
mod panel;
mod plot;
mod series;
mod sheet;
mod text;

use image::RgbImage;

pub use axis::Axis;
pub use panel::Panel;

use crate::export::{self, Destination, FileKind};
pub use crate::region::Region;
pub use plot::Plot;
pub use series::Series;
pub use sheet::{Row, Sheet};

pub(crate) use bar::{color_bar, key, width as bar_width};
pub(crate) use canvas::{Align, Area, BLACK, Canvas, GRAY};
pub(crate) use panel::{photograph, resized};

/// Writes a picture as PNG, whole or not at all; its folder is made if it is missing. A picture of parfocal's that lies
/// there is replaced, another file only where the [`Destination`] forces it.
///
/// # Errors
/// [`Error::File`](crate::Error::File).
pub fn write_png<'d>(file: impl Into<Destination<'d>>, image: &RgbImage) -> Result<(), crate::Error> {
    export::write_file(file.into(), FileKind::Png, |writer| export::write_drawing(writer, image))
}
