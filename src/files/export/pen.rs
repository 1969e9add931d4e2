//! What draws, for results that hold a drawing.

use image::RgbImage;

use super::{Palette, ProfileReport, Scale};

/// Draws the keys of maps and the curves of profiles, which this room only places: `page::figure::PEN` does. Without a pen
/// `depth.png` is the map alone and a profile has no picture.
#[derive(Clone, Copy, Debug)]
pub struct Pen {
    /// The key of a scale in the colours of a palette under a title, for a map of so many pixels.
    pub key: fn(&str, &Scale, Palette, (u32, u32)) -> RgbImage,
    /// A profile as a curve.
    pub profile: fn(&ProfileReport) -> RgbImage,
}
