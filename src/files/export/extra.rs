//! Additional files of results, and the style of pictures.

use std::io::Write;

use image::RgbImage;

use super::{Palette, ProfileReport, Results, Scale};

/// The page of results.
pub const PAGE_FILE: &str = "report.html";

/// Draws the keys of maps and the curves of profiles. Without one, `depth.png` has no key and a profile has no picture.
#[derive(Clone, Copy, Debug)]
pub struct Plotter {
    /// Draws the key of a scale in the colours of a palette, under a title, for a map of this width and height.
    pub key: fn(&str, &Scale, Palette, (u32, u32)) -> RgbImage,
    /// Draws a profile.
    pub profile: fn(&ProfileReport) -> RgbImage,
}

/// The style of pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct Drawing {
    /// Colours of `depth.png`.
    pub palette: Palette,
    /// The function object that draws keys and profiles.
    pub plotter: Option<Plotter>,
}

/// An additional file of results.
pub struct Extra<'a> {
    pub(super) name: &'static str,
    pub(super) fill: Fill<'a>,
}

/// Writes the content of a file. An error is a phrase that fits into "cannot be written (...)".
type Fill<'a> = Box<dyn FnOnce(&Results<'_>, &mut dyn Write) -> Result<(), String> + 'a>;

impl<'a> Extra<'a> {
    pub(crate) fn new(
        name: &'static str,
        fill: impl FnOnce(&Results<'_>, &mut dyn Write) -> Result<(), String> + 'a,
    ) -> Self {
        Self { name, fill: Box::new(fill) }
    }

    /// Its name in the folder of results.
    pub fn name(&self) -> &'static str {
        self.name
    }
}
