//! `parfocal view`: the surface of a solve in three dimensions.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use parfocal::export::{Destination, FileKind, Results, result_files};
use parfocal::page::figure;
use parfocal::page::view::{Surface, View};

use crate::cli::options::output::ColorsArgument;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Show the surface of a solve or a sweep in three dimensions, textured and colour-coded.
#[derive(clap::Args, Debug)]
#[command(after_help = "Exit status: 0 done, 1 failed, 2 wrong usage.")]
pub(crate) struct Arguments {
    /// Folder that `parfocal solve -o` or `stack -o` wrote
    results: PathBuf,
    /// The picture, PNG [default: view.png in RESULTS]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Also write an animation in which the camera swings 40° to either side of --azimuth, GIF
    #[arg(long, value_name = "FILE")]
    turntable: Option<PathBuf>,
    /// Height of the camera over the plane of the image, degrees, 10 to 90; 90 sees it as photographed
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, default_value_t = View::default().elevation)]
    elevation: f64,
    /// How far the camera goes around to the right, degrees, -180 to 180 [default: -20, of the animation 0]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    azimuth: Option<f64>,
    /// Height from far to near over the longer side of the image, 0 to 2 [default: true to scale with a lens, else
    /// 0.15]
    #[arg(long, value_name = "R", allow_negative_numbers = true)]
    relief: Option<f64>,
    /// Radius of the median that takes spikes off the surface, px of a panel, 0 (none) to 16
    #[arg(long, value_name = "PX", default_value_t = View::default().smoothing)]
    smoothing: u32,
    /// Width of each of the two panels, px, 64 to 2048
    #[arg(long, value_name = "PX", default_value_t = View::default().width)]
    width: u32,
    /// Width of each of the two panels of the animation, px, 64 to 2048
    #[arg(long, value_name = "PX", default_value_t = 360)]
    turntable_width: u32,
    #[command(flatten)]
    colors: ColorsArgument,
    #[command(flatten)]
    force: ForceArgument,
}

/// Path of the picture in the folder of the results.
pub(crate) const VIEW: &str = "view.png";

/// Draws and writes the pictures. Inexpensive checks come first.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let [still, turning] = views(arguments, View::default().relief);
    still.check()?;
    turning.check()?;
    let output = output_file(arguments);
    let force = &arguments.force;
    check_output(force.to(&output), "png", FileKind::Png, &arguments.results)?;
    if let Some(turntable) = &arguments.turntable {
        check_output(force.to(turntable), "gif", FileKind::Gif, &arguments.results)?;
    }
    if arguments.output.is_none() {
        // Unlike a file that the user names, a result in its folder must not be a symbolic link.
        force.to(&arguments.results).check_named(FileKind::Png, &[VIEW])?;
    }
    let results = Results::read(&arguments.results)?;
    let (quantity, fused) = (results.best(), results.fused()?);
    let surface = Surface::of(&quantity, results.lens(), &fused)?;
    let [still, turning] = views(arguments, surface.relief());
    figure::write_png(force.to(&output), &surface.picture(&still)?)?;
    if let Some(turntable) = &arguments.turntable {
        surface.write_turntable(force.to(turntable), &turning)?;
    }
    Ok(())
}

/// The path of the picture.
fn output_file(arguments: &Arguments) -> PathBuf {
    arguments.output.clone().unwrap_or_else(|| arguments.results.join(VIEW))
}

/// The views of the picture and of the animation, with the same smoothing.
fn views(arguments: &Arguments, default_relief: f64) -> [View; 2] {
    let still = View {
        elevation: arguments.elevation,
        azimuth: arguments.azimuth.unwrap_or(View::default().azimuth),
        relief: arguments.relief.unwrap_or(default_relief),
        smoothing: arguments.smoothing,
        width: arguments.width,
        palette: arguments.colors.palette(),
    };
    let width = arguments.turntable_width;
    let smoothing = f64::from(still.smoothing) * f64::from(width) / f64::from(still.width.max(1));
    let turning = View {
        width,
        azimuth: arguments.azimuth.unwrap_or(0.0),
        smoothing: smoothing.ceil().min(16.0) as u32,
        ..still
    };
    [still, turning]
}

/// Refuses a name without the extension of the format, a file of the results, and a file that must not be replaced.
fn check_output(file: Destination<'_>, extension: &str, kind: FileKind, results: &Path) -> Result<(), Failure> {
    let path = file.path();
    if !path.extension().and_then(OsStr::to_str).is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        return Err(Failure::Usage(format!("{}: give a name that ends in .{extension}", path.display())));
    }
    if result_files().any(|name| crate::cli::same_file(&results.join(name), path)) {
        return Err(Failure::Usage(format!("{}: is a result of the solve; give another name", path.display())));
    }
    destination::check_file(file, kind, "", &[])
}
