//! The surface with its texture, and how it is viewed.

use image::RgbImage;

use crate::base::{Error, Frame};
use crate::files::export::{Nearer, Palette, Quantity, Scale};
use crate::files::image_io::preview;

/// Title and key of the surface of V.
const OF_BLUR: [&str; 2] = ["Relative blur V", "V, px²"];

/// Greatest value of the relief.
const MOST_RELIEF: f64 = 2.0;

/// A field with its scale, and the picture that textures it.
#[derive(Clone, Debug)]
pub struct Surface<'a> {
    pub(super) values: &'a [f32],
    pub(super) texture: RgbImage,
    pub(super) scale: Scale,
    /// Title, and label of the key.
    pub(super) names: [&'static str; 2],
    /// Relief that is true to scale, if the size of a pixel is known.
    to_scale: Option<f64>,
    /// The names of the near and the far end.
    pub ends: [&'static str; 2],
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
        Self::on(relative_blur, fused, Scale::of(relative_blur, nearer), OF_BLUR)
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
        Ok(Self { to_scale, ..Self::on(&quantity.values, fused, quantity.scale(), names)? })
    }

    /// The [relief](View::relief) that is true to scale at the middle depth, if the size of a pixel is known;
    /// else the default one.
    pub fn relief(&self) -> f64 {
        self.to_scale.unwrap_or(View::default().relief)
    }

    fn on(values: &'a [f32], fused: &Frame, scale: Scale, names: [&'static str; 2]) -> Result<Self, Error> {
        let texture = preview(fused);
        let (width, height) = texture.dimensions();
        if values.len() != width as usize * height as usize {
            let problem = format!("{} values cannot be shown under an image of {width}x{height}", values.len());
            return Err(Error::Mismatch(problem));
        }
        Ok(Self { values, texture, scale, names, to_scale: None, ends: ["near", "far"] })
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
