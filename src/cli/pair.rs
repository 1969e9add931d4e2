//! A pair of photographs, by the names of its files.

use std::path::{Path, PathBuf};

use parfocal::image_io::{Input, Photograph};

use super::failure::Failure;

/// The pair.
#[derive(clap::Args, Clone, Debug)]
pub(super) struct PairArguments {
    /// The photograph whose pixels the results follow: PNG, JPEG, TIFF, PNM, PFM or EXR
    ///
    /// FILE#2 is the second page of a TIFF.
    i1: PathBuf,
    /// The other photograph, of the same size
    i2: PathBuf,
}

impl PairArguments {
    /// Both files.
    pub(super) fn files(&self) -> [PathBuf; 2] {
        [self.i1.clone(), self.i2.clone()]
    }
}

/// Opens two photographs; also what the report says of them.
pub(super) fn open([i1, i2]: &[PathBuf; 2]) -> Result<([Photograph; 2], Vec<Input>), Failure> {
    let photographs = Photograph::open_pair(i1, i2)?;
    let inputs = photographs.iter().map(Photograph::describe).collect::<Result<_, _>>()?;
    Ok((photographs, inputs))
}

/// What a photograph is called in the report: without its folders.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
