//! A pair of photographs, by the names of its files.

use std::path::{Path, PathBuf};

use parfocal::image_io::{Input, Photograph};
use parfocal::{Engine, PairSolver, Settings, settings::DeviceInfo};

use crate::cli::output::failure::Failure;

/// The pair.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct PairArguments {
    /// The photograph whose pixels the results follow: PNG, JPEG, TIFF, BMP, WebP, PNM, PFM or EXR
    ///
    /// FILE#2 is the second page of a TIFF, FILE#Mono12p:2448x2048 a frame without a header.
    i1: PathBuf,
    /// The other photograph, of the same size
    i2: PathBuf,
}

impl PairArguments {
    /// Both files.
    pub(crate) fn files(&self) -> [PathBuf; 2] {
        [self.i1.clone(), self.i2.clone()]
    }
}

/// Opens two photographs; also what the report says of them.
pub(crate) fn open([i1, i2]: &[PathBuf; 2]) -> Result<([Photograph; 2], Vec<Input>), Failure> {
    let photographs = Photograph::open_pair(i1, i2)?;
    let inputs = photographs.iter().map(Photograph::describe).collect::<Result<_, _>>()?;
    Ok((photographs, inputs))
}

/// More pixels than this, 2^24, are not decoded before it is known that the device takes them: fewer take no time.
const LARGE: u64 = 1 << 24;

/// Refuses photographs that are too large for the device, before they are decoded; those `in_parts` only where they are too large for that.
pub(crate) fn check_size(
    photographs: [&Photograph; 2],
    settings: &Settings,
    in_parts: bool,
    device: impl FnOnce() -> Result<DeviceInfo, Failure>,
) -> Result<(), Failure> {
    let (width, height) = photographs[0].size();
    if u64::from(width) * u64::from(height) <= if in_parts { PairSolver::MOST_PIXELS } else { LARGE } {
        return Ok(());
    }
    let formats = photographs.map(Photograph::format);
    Engine::check_size(&device()?, [width, height], formats, settings)
        .map_err(|e| Failure::of_solve(e, photographs[0].path()))
}

/// What a photograph is called in the report: without its folders.
pub(crate) fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
