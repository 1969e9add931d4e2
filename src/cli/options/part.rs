//! The part of the photographs that is solved and measured: masks, regions, lines, and the flat reference.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use parfocal::export::{MeasurementRequest, PIXEL_SIZES_UM, Results};
use parfocal::metric::measure::Line;
use parfocal::{Mask, Region, SolveOptions, image_io, settings::FieldCurvature};
use serde::Serialize;

use crate::cli::help::{MEASUREMENTS, REGION};
use crate::cli::output::failure::Failure;

/// The options of the part of the frame.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct PartArguments {
    /// Picture of the size of the photographs, white where pixels count; others become NaN
    #[arg(long, value_name = "FILE", help_heading = REGION)]
    mask: Option<PathBuf>,
    /// Region of the results, px; a margin around it is solved too
    #[arg(long, value_name = "X,Y,W,H", help_heading = REGION, value_parser = region)]
    roi: Option<Region>,
    /// Crop the results to the largest rectangle without invalid pixels
    #[arg(long, help_heading = REGION)]
    crop_valid: bool,
}

/// The options of the part of the frame and the corrections of a pair.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct ScopeArguments {
    #[command(flatten)]
    part: PartArguments,
    /// Folder of the results of a flat target with the same optics; its field curvature is subtracted from V
    #[arg(long, value_name = "DIR", help_heading = REGION)]
    flat: Option<PathBuf>,
    /// Standard deviation of V above which a pixel counts as without texture (px², 1e-6 to 1e6) [default: half the
    /// range of V, at least 1]
    #[arg(long, value_name = "PX2", help_heading = REGION, 
          value_parser = within(1e-6f32..=1e6, "give a number of px² from 1e-6 to 1e6"))]
    max_uncertainty: Option<f32>,
}

impl PartArguments {
    pub(crate) fn part(&self) -> SolvedPart {
        SolvedPart {
            mask: self.mask.clone(),
            region: self.roi,
            crop_valid: self.crop_valid,
            flat: None,
            max_uncertainty: None,
        }
    }
}

impl ScopeArguments {
    pub(crate) fn part(&self) -> SolvedPart {
        SolvedPart { flat: self.flat.clone(), max_uncertainty: self.max_uncertainty, ..self.part.part() }
    }
}

/// The part of the photographs that is solved, and the correction files.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct SolvedPart {
    mask: Option<PathBuf>,
    region: Option<Region>,
    pub(crate) crop_valid: bool,
    /// The folder of the flat reference. No result may replace it.
    pub(crate) flat: Option<PathBuf>,
    /// Standard deviation of V above which a pixel is marked, px².
    pub(crate) max_uncertainty: Option<f32>,
}

impl SolvedPart {
    /// Reads the files.
    fn scope(&self) -> Result<SolveOptions, Failure> {
        let mask = self.mask.as_ref().map(|file| image_io::read(file)).transpose()?;
        let flat = self.flat.as_ref().map(|folder| flat_reference(folder)).transpose()?;
        let mask = mask.as_ref().map(Mask::from_image);
        Ok(SolveOptions { region: self.region, mask, flat, crop_valid: self.crop_valid, ..SolveOptions::default() })
    }

    /// Reads the files. Refuses files that do not match photographs of this size.
    pub(crate) fn fitting(&self, size: [u32; 2]) -> Result<SolveOptions, Failure> {
        let scope = self.scope()?;
        check_size(self.mask.as_deref(), scope.mask.as_ref().map(Mask::size), size, "photographs")?;
        if let (Some(path), Some(mask)) = (&self.mask, &scope.mask)
            && mask.bytes().iter().all(|counts| *counts == 0)
        {
            let problem = "leaves no pixel: it is nowhere at least half as bright as white; white is what counts";
            return Err(Failure::file(path, problem));
        }
        check_size(self.flat.as_deref(), scope.flat.as_ref().map(FieldCurvature::size), size, "photographs")?;
        let outside = |e| Failure::Usage(format!("--roi: {e}"));
        scope.check(size).map_err(outside)?;
        Ok(scope)
    }

    /// The size of the results, if it is known before the solve.
    pub(crate) fn size(&self, photograph: [u32; 2]) -> Option<[u32; 2]> {
        let size = self.region.map_or(photograph, |region| [region.width, region.height]);
        (!self.crop_valid).then_some(size)
    }

    /// Whether the whole frame is solved.
    pub(crate) fn is_whole(&self) -> bool {
        self.region.is_none()
    }

    /// The file of the mask. No result may replace it.
    pub(crate) fn mask(&self) -> Option<&PathBuf> {
        self.mask.as_ref()
    }

    /// The files with contents that change the results.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        let of_flat = ["relative_blur.exr", "uncertainty.exr", "report.json"];
        let flat = self.flat.iter().flat_map(|folder| of_flat.map(|name| folder.join(name)));
        self.mask.iter().map(|file| image_io::split_page(file).0).chain(flat).collect()
    }
}

/// Refuses a file whose size is not that of the named photographs or results. Without a file there is no size.
pub(crate) fn check_size(
    path: Option<&Path>,
    found: Option<[u32; 2]>,
    size: [u32; 2],
    which: &str,
) -> Result<(), Failure> {
    let (Some(path), Some([w, h])) = (path, found) else { return Ok(()) };
    if [w, h] == size {
        return Ok(());
    }
    let [width, height] = size;
    let problem = format!("is of {w}x{h}, and the {which} are {width}x{height}; give one of their size");
    Err(Failure::file(path, problem))
}

fn flat_reference(folder: &Path) -> Result<FieldCurvature, Failure> {
    let flat = Results::read_pair(folder)?;
    if flat.report.size != flat.report.photograph {
        let problem = "is of a part of the photographs; solve the flat target without --roi and --crop-valid";
        return Err(Failure::file(folder, problem));
    }
    FieldCurvature::of_flat_target(flat.report.photograph.into(), flat.values(), &flat.uncertainty_without_scale())
        .map_err(|e| Failure::file(folder, e))
}

/// The option of the size of a pixel.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct PixelSizeArgument {
    /// The size of a pixel on the surface, µm: the pixel pitch over the magnification
    ///
    /// The same everywhere, as under a microscope or a telecentric lens. Lengths along the surface are then known; with
    /// depth in mm so is the shape.
    #[arg(long, value_name = "UM", help_heading = MEASUREMENTS,
          value_parser = within(PIXEL_SIZES_UM, "give a size in µm above 0, from 1e-6 to 1e6"))]
    pub(crate) pixel_size: Option<f64>,
}

/// Regions and lines to measure.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct MeasureArguments {
    /// Step height from the first region to the second; may be repeated
    ///
    /// Rectangles in pixels of the results. The height is the difference of their levels, which are medians after
    /// removing the tilt. It is in px², or settings of a sweep, and also in mm if the lens or the focus positions are
    /// known.
    #[arg(long, value_names = ["X,Y,W,H", "X,Y,W,H"], num_args = 2, help_heading = MEASUREMENTS,
          value_parser = region)]
    step: Vec<Region>,
    /// Profile from one pixel of the results to another; may be repeated
    ///
    /// The mean over WIDTH px across the line, 1 if not given.
    #[arg(long, value_name = "X1,Y1,X2,Y2[,WIDTH]", help_heading = MEASUREMENTS, value_parser = line)]
    profile: Vec<Line>,
}

impl MeasureArguments {
    pub(crate) fn request(&self) -> MeasurementRequest {
        MeasurementRequest {
            // clap passes the values in pairs.
            steps: self.step.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect(),
            lines: self.profile.clone(),
        }
    }
}

/// Parses numbers that are separated by commas; `None` unless there are N.
pub(crate) fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let all: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    all?.try_into().ok()
}

/// A parser of a number in a range. The error is `hint`.
pub(crate) fn within<T: FromStr + PartialOrd + Clone>(
    range: RangeInclusive<T>,
    hint: &str,
) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| text.parse().ok().filter(|value| range.contains(value)).ok_or_else(|| hint.to_string())
}

/// Parses `X,Y,W,H`.
pub(crate) fn region(text: &str) -> Result<Region, String> {
    let region = numbers(text).map(|[x, y, width, height]| Region { x, y, width, height });
    region.ok_or_else(|| "give X,Y,WIDTH,HEIGHT in whole pixels, as in 40,60,32,32".to_string())
}

/// Parses `X,Y,W,H=Z`.
pub(crate) fn region_at_depth(text: &str) -> Result<(Region, f64), String> {
    let parsed = text.split_once('=').and_then(|(part, z)| Some((region(part).ok()?, z.trim().parse().ok()?)));
    parsed.ok_or_else(|| "give X,Y,WIDTH,HEIGHT=DEPTH in pixels and mm, as in 40,60,32,32=529".to_string())
}

/// Parses `X1,Y1,X2,Y2` or `X1,Y1,X2,Y2,WIDTH`.
pub(crate) fn line(text: &str) -> Result<Line, String> {
    let with_width = || numbers(text).map(|[x1, y1, x2, y2]| [x1, y1, x2, y2, 1.0]);
    let line = numbers(text).or_else(with_width);
    line.map(|[x1, y1, x2, y2, width]| Line { from: [x1, y1], to: [x2, y2], width })
        .ok_or_else(|| "give X1,Y1,X2,Y2 in pixels and perhaps the width, as in 10,40,300,40,9".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_region_is_refused_with_an_example() {
        let (at, z) = region_at_depth("1,2, 3,4 = 52.5").unwrap();
        assert_eq!((at.x, at.y, at.width, at.height, z), (1, 2, 3, 4, 52.5));
        let wide = line("0,1.5,20,1.5,7").unwrap();
        assert_eq!((wide.from, wide.to, wide.width), ([0.0, 1.5], [20.0, 1.5], 7.0));
        assert_eq!(line("0,1,20,1").unwrap().width, 1.0);
        for bad in ["1,2,3", "1,2,3,x", "", "1,2,3,-4"] {
            assert!(region(bad).unwrap_err().contains("as in"), "{bad}");
        }
        assert!(region_at_depth("1,2,3,4").is_err() && line("1,2,3").is_err());
    }
}
