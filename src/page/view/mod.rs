//! The surface in three dimensions, textured and colour-coded, as in the paper's Figure 8; still or animated.
//!
//! ```
//! use parfocal::export::Nearer;
//! use parfocal::page::view::{Surface, View};
//! use parfocal::{Frame, page::figure};
//!
//! let bump = |i: usize| 9.0 * (-((i % 64) as f32 - 32.0).powi(2) / 99.0).exp();
//! let blur: Vec<f32> = (0..64 * 48).map(bump).collect();
//! let fused = Frame::gray(64, 48, vec![0.5; 64 * 48]).unwrap();
//! let surface = Surface::new(&blur, &fused, Nearer::First)?;
//! let picture = surface.picture(&View { width: 200, ..View::default() })?;
//! # let folder = tempfile::TempDir::new().unwrap();
//! # let (png, gif) = (folder.path().join("view.png"), folder.path().join("turntable.gif"));
//! figure::write_png(&png, &picture)?;
//! surface.write_turntable(&gif, &View { width: 120, ..View::default() })?;
//! # Ok::<(), parfocal::Error>(())
//! ```
//!
//! Heights are nearness, from the 1st to the 99th percentile. They are metric only if the size of a pixel is
//! known. The rasteriser runs on the CPU and gives the same picture on every machine.

mod mesh;
mod picture;
mod raster;

use image::RgbImage;

use crate::base::{Error, Frame};
use crate::files::export::{Destination, Nearer, Palette, Quantity, Scale};
use crate::files::image_io::preview;

/// Title and key of the surface of V.
const OF_BLUR: [&str; 2] = ["Relative blur V", "V, px²"];

/// Greatest value of the relief.
const MOST_RELIEF: f64 = 2.0;

/// A field with its scale, and the picture that textures it.
#[derive(Clone, Debug)]
pub struct Surface<'a> {
    width: usize,
    height: usize,
    values: &'a [f32],
    texture: RgbImage,
    scale: Scale,
    /// Title, and label of the key.
    names: [&'static str; 2],
    /// Relief that is true to scale, if the size of a pixel is known.
    to_scale: Option<f64>,
}

/// Camera, size, relief and colours of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Height of the camera over the plane of the image, degrees, 10 to 90; 90 sees it as photographed.
    pub elevation: f64,
    /// Azimuth of the camera to the right, degrees, -180 to 180; at 0 it is below the lower edge.
    pub azimuth: f64,
    /// Height from the far to the near end of the scale, over the longer side of the image, 0 to 2.
    pub relief: f64,
    /// Radius of the median that removes spikes from the surface, 0 (none) to 16. Its unit is about a pixel of a panel.
    /// If V has fewer pixels than a panel, its unit is a pixel of V.
    pub smoothing: u32,
    /// Width of one of the two panels, px, 64 to 2048.
    pub width: u32,
    /// The colours of near and far in the colour-coded panel.
    pub palette: Palette,
}

impl Default for View {
    fn default() -> Self {
        Self { elevation: 55.0, azimuth: -20.0, relief: 0.15, smoothing: 6, width: 900, palette: Palette::default() }
    }
}

impl View {
    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Setting`] with the first value that is out of range.
    pub fn check(&self) -> Result<(), Error> {
        let ranges = [
            ("elevation", self.elevation, 10.0, 90.0),
            ("azimuth", self.azimuth, -180.0, 180.0),
            ("relief", self.relief, 0.0, MOST_RELIEF),
            ("smoothing", f64::from(self.smoothing), 0.0, 16.0),
            ("width", f64::from(self.width), 64.0, 2048.0),
        ];
        match ranges.into_iter().find(|&(_, value, low, high)| !(value >= low && value <= high)) {
            None => Ok(()),
            Some((name, value, low, high)) => Err(Error::Setting { name, value, range: format!("{low} to {high}") }),
        }
    }
}

impl<'a> Surface<'a> {
    /// Makes the surface of V, px², row-major, NaN where not valid, with an image of the same size as texture.
    ///
    /// # Errors
    /// [`Error::Mismatch`] where the sizes differ.
    pub fn new(relative_blur: &'a [f32], fused: &Frame, nearer: Nearer) -> Result<Self, Error> {
        Self::on(relative_blur, fused, Scale::of(relative_blur, nearer))
    }

    /// Makes the surface of a quantity of results, with an image of the same size as texture. `footprint` is the size
    /// of a pixel at the middle of the quantity's scale, in the unit of the quantity, if it is known.
    ///
    /// # Errors
    /// As for [`new`](Self::new).
    pub fn of(quantity: &'a Quantity<'_>, footprint: Option<f64>, fused: &Frame) -> Result<Self, Error> {
        let names = match quantity.name {
            "relative_blur" => OF_BLUR,
            "focus" => ["Focus", "setting"],
            _ => ["Depth", "mm"],
        };
        let size = (fused.width(), fused.height());
        let to_scale = footprint.map(|footprint| relief_to_scale(quantity, size, footprint));
        Ok(Self { names, to_scale, ..Self::on(&quantity.values, fused, quantity.scale())? })
    }

    /// The [relief](View::relief) that is true to scale at the middle depth, if the size of a pixel is known;
    /// else the default one.
    pub fn relief(&self) -> f64 {
        self.to_scale.unwrap_or(View::default().relief)
    }

    /// The surface of a field on this scale.
    pub(crate) fn on(values: &'a [f32], fused: &Frame, scale: Scale) -> Result<Self, Error> {
        let bare = Self::bare(values, (fused.width(), fused.height()), scale)?;
        Ok(Self { texture: preview(fused), ..bare })
    }

    /// Makes the surface without a picture, for its heights alone.
    pub(crate) fn bare(values: &'a [f32], (width, height): (u32, u32), scale: Scale) -> Result<Self, Error> {
        let (width, height) = (width as usize, height as usize);
        if values.len() != width * height || values.is_empty() {
            return Err(Error::Mismatch(format!(
                "{} values cannot be shown under an image of {width}x{height}",
                values.len()
            )));
        }
        Ok(Self { width, height, values, texture: RgbImage::new(0, 0), scale, names: OF_BLUR, to_scale: None })
    }

    /// Nearness, 0 far to 1 near, row-major on a grid of about `view.width` nodes along the longer side, smoothed as
    /// `view` states. NaN where no pixel is valid. Also returns the numbers of columns and rows.
    pub(crate) fn heights(&self, view: &View) -> (usize, usize, Vec<f32>) {
        let heights = mesh::Heights::of(self, view.width as usize, view.smoothing as usize);
        (heights.width, heights.height, heights.data)
    }

    /// Draws both panels side by side, textured and colour-coded, with a key to the colours.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn picture(&self, view: &View) -> Result<RgbImage, Error> {
        view.check()?;
        Ok(picture::draw(self, view))
    }

    /// Writes an animated GIF of both panels. The camera swings 40° to either side of `view`. Creates the folder if it
    /// is missing. Replaces an animation of parfocal; the [`Destination`] must force the replacement of another file.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::File`].
    pub fn write_turntable<'d>(&self, file: impl Into<Destination<'d>>, view: &View) -> Result<(), Error> {
        view.check()?;
        picture::write_turntable(self, view, file.into())
    }
}

/// Height from far to near over the longer side of the image at the middle depth, where a pixel has this size.
pub(crate) fn relief_to_scale(depth: &Quantity<'_>, (width, height): (u32, u32), footprint: f64) -> f64 {
    let scale = depth.scale();
    let longer = f64::from(width.max(height));
    let relief = f64::from(scale.high - scale.low) / (longer * footprint);
    if relief.is_finite() { relief.clamp(0.0, MOST_RELIEF) } else { View::default().relief }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_out_of_range_and_different_sizes_are_refused() {
        let fused = Frame::gray(4, 3, vec![0.5; 12]).unwrap();
        assert!(matches!(Surface::new(&[0.0; 11], &fused, Nearer::First), Err(Error::Mismatch(_))));
        let blur = [0.0; 12];
        let surface = Surface::new(&blur, &fused, Nearer::First).unwrap();
        for view in [
            View { elevation: f64::NAN, ..View::default() },
            View { relief: -0.1, ..View::default() },
            View { width: 5000, ..View::default() },
        ] {
            assert!(matches!(surface.picture(&view), Err(Error::Setting { .. })), "{view:?}");
        }
    }
}
