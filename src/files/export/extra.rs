//! Files beside those that every solve writes.

use std::io::Write;

/// The page of a solve.
pub const PAGE_FILE: &str = "report.html";

/// Names that an [`Extra`] may have. One that an earlier solve lists and this one does not write is removed: it would
/// contradict the rest.
pub const EXTRA_FILES: [&str; 15] = [
    PAGE_FILE,
    "surface.ply",
    "points.ply",
    "surface.glb",
    "surface.stl",
    "surface.obj",
    "depth.npy",
    "deviation.npy",
    "depth.tiff",
    "deviation.tiff",
    "depth.zarr.zip",
    "depth16.png",
    "depth16.tiff",
    "labels.png",
    "fused.exr",
];

/// Those of them that show depth and are made anew with it.
pub(super) fn showing_depth() -> impl Iterator<Item = &'static str> {
    EXTRA_FILES.into_iter().take(11)
}

/// One more file of a solve, which appears with the others or not at all.
pub struct Extra<'a> {
    pub(super) name: &'static str,
    pub(super) fill: Fill<'a>,
}

/// Writes the content of a file; a problem is a phrase that fits into "cannot be written (...)".
pub(super) type Fill<'a> = Box<dyn FnOnce(&mut dyn Write) -> Result<(), String> + 'a>;

impl<'a> Extra<'a> {
    /// A file of this name, one of the [`EXTRA_FILES`].
    pub(crate) fn new(name: &'static str, fill: impl FnOnce(&mut dyn Write) -> Result<(), String> + 'a) -> Self {
        debug_assert!(EXTRA_FILES.contains(&name));
        Self { name, fill: Box::new(fill) }
    }

    /// Its name in the folder of results.
    pub fn name(&self) -> &'static str {
        self.name
    }
}
