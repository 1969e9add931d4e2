//! Additional files of results, and how pictures are drawn.

use std::io::Write;

use image::RgbImage;

use super::{Palette, ProfileReport, Results, Scale};

/// The page of results.
pub const PAGE_FILE: &str = "report.html";

/// Draws the keys of maps and the curves of profiles. Without it `depth.png` has no key and a profile has no picture.
#[derive(Clone, Copy, Debug)]
pub struct Plotter {
    /// Draws the key of a scale in the colours of a palette under a title, for a map of this width and height.
    pub key: fn(&str, &Scale, Palette, (u32, u32)) -> RgbImage,
    /// Draws a profile.
    pub profile: fn(&ProfileReport) -> RgbImage,
}

/// How pictures are drawn.
#[derive(Clone, Copy, Debug, Default)]
pub struct Drawing {
    /// Colours of `depth.png`.
    pub palette: Palette,
    /// Draws keys and profiles.
    pub plotter: Option<Plotter>,
}

/// An additional file of results.
pub struct Extra<'a> {
    pub(super) name: &'static str,
    pub(super) fill: Fill<'a>,
}

/// Writes the content of a file; an error is a phrase that fits into "cannot be written (...)".
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
