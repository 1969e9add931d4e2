//! The files of results: their names, and what fills them.

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufWriter, Write};

use image::RgbImage;

use super::Results;
use crate::files::export::fused::FUSED_FILE;
use crate::files::export::image_files::{
    BEYOND, CONFIDENCE, Description, FOCUS, FOCUS_UNCERTAINTY, FRAMES, RELATIVE_BLUR, RESIDUAL, UNCERTAINTY, VALID,
};
use crate::files::export::report::{Kind, ProfileReport, REPORT_FILE};
use crate::files::export::scale::{Palette, Scale};

/// The page of results.
pub const PAGE_FILE: &str = "report.html";

/// Depth in mm, channel `Y`, and its standard deviation, channel `standard_deviation`.
pub const DEPTH_FILE: &str = "depth_mm.exr";

/// `depth.png`: a picture of depth, or of V or focus if depth is not known.
pub const DEPTH_PICTURE_FILE: &str = "depth.png";

/// A field: its name, its file and its description.
type FieldFile = (&'static str, &'static str, &'static Description);

static PAIR_FIELDS: [FieldFile; 5] = [
    ("relative_blur", "relative_blur.exr", &RELATIVE_BLUR),
    ("uncertainty", "uncertainty.exr", &UNCERTAINTY),
    ("confidence", "confidence.exr", &CONFIDENCE),
    ("residual", "residual.exr", &RESIDUAL),
    ("valid", "valid.png", &VALID),
];

static SWEEP_FIELDS: [FieldFile; 5] = [
    ("focus", "focus.exr", &FOCUS),
    ("uncertainty", "uncertainty.exr", &FOCUS_UNCERTAINTY),
    ("valid", "valid.png", &VALID),
    ("frames", "frames.png", &FRAMES),
    ("beyond", "beyond.png", &BEYOND),
];

impl Kind {
    /// Fields of the results of this kind.
    pub(in crate::files::export) fn fields(self) -> &'static [FieldFile] {
        match self {
            Self::Pair => &PAIR_FIELDS,
            Self::Sweep => &SWEEP_FIELDS,
            _ => &[],
        }
    }

    /// The name of the field that results of this kind are about.
    pub(in crate::files::export) fn quantity(self) -> &'static str {
        self.fields().first().map_or("", |(name, ..)| name)
    }

    /// Files that every solve of this kind writes.
    pub fn files(self) -> Vec<&'static str> {
        let fields = self.fields().iter().map(|(_, file, _)| *file);
        fields.chain([DEPTH_PICTURE_FILE, FUSED_FILE, REPORT_FILE]).collect()
    }
}

/// Draws the keys of maps and the curves of profiles. Without one, `depth.png` has no key and a profile has no picture.
#[derive(Clone, Copy, Debug)]
pub struct Plotter {
    /// Draws the key of a scale in the colours of a palette, with a title and the names of the near and the far end, for a
    /// map of this width and height.
    pub key: fn([&str; 3], &Scale, Palette, (u32, u32)) -> RgbImage,
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
    pub(in crate::files::export) name: &'static str,
    pub(in crate::files::export) fill: Fill<'a>,
}

/// Writes the content of a file. An error is a phrase that fits into "cannot be written (...)".
type Fill<'a> = Box<dyn FnOnce(&Results<'_>, &mut dyn Write) -> Result<(), String> + Send + 'a>;

impl<'a> Extra<'a> {
    pub(crate) fn new(
        name: &'static str,
        fill: impl FnOnce(&Results<'_>, &mut dyn Write) -> Result<(), String> + Send + 'a,
    ) -> Self {
        Self { name, fill: Box::new(fill) }
    }

    /// Its name in the folder of results.
    pub fn name(&self) -> &'static str {
        self.name
    }
}

/// A file that [`Results::write`] and the functions that add to results write.
pub(in crate::files::export) struct NewFile<'a> {
    pub(in crate::files::export) name: Cow<'static, str>,
    pub(in crate::files::export) fill: FillFile<'a>,
}

/// Writes the content of a file. Some contents seek.
type FillFile<'a> = Box<dyn FnOnce(&Results<'_>, &mut BufWriter<&mut File>) -> Result<(), String> + Send + 'a>;

impl<'a> NewFile<'a> {
    pub(in crate::files::export) fn new(
        name: impl Into<Cow<'static, str>>,
        fill: impl FnOnce(&Results<'_>, &mut BufWriter<&mut File>) -> Result<(), String> + Send + 'a,
    ) -> Self {
        Self { name: name.into(), fill: Box::new(fill) }
    }
}

impl<'a> From<Extra<'a>> for NewFile<'a> {
    fn from(Extra { name, fill }: Extra<'a>) -> Self {
        Self::new(name, |results, writer| fill(results, writer))
    }
}
