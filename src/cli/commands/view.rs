//! `parfocal view`: the surface of a solve in three dimensions. `parfocal open`: the page of results in a browser.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use parfocal::export::{Destination, FileKind, PAGE_FILE, Results, result_files};
use parfocal::page::figure;
use parfocal::page::view::{Surface, View};

use crate::cli::batch::summary::{INDEX, SUMMARY};
use crate::cli::options::run::ColorsArgument;
use crate::cli::output::destination::{self, ForceArgument, same_file};
use crate::cli::output::failure::{Failure, print};

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
    #[arg(long, value_name = "DEG", default_value_t = View::default().elevation)]
    elevation: f64,
    /// How far the camera goes around to the right, degrees, -180 to 180 [default: -20, of the animation 0]
    #[arg(long, value_name = "DEG")]
    azimuth: Option<f64>,
    /// Height from far to near over the longer side of the image, 0 to 2 [default: true to scale with a lens, else
    /// 0.15]
    #[arg(long, value_name = "R")]
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
    let mut surface = Surface::of(&quantity, results.footprint(), &fused)?;
    surface.ends = results.report.end_names();
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
    if result_files().any(|name| same_file(&results.join(name), path)) {
        return Err(Failure::Usage(format!("{}: is a result of the solve; give another name", path.display())));
    }
    destination::check_file(file, kind, "", &[])
}

/// Open the page of results in a browser: report.html, or the index of a batch.
#[derive(clap::Args, Debug)]
#[command(after_help = "Exit status: 0 done, 1 failed, 2 wrong usage.")]
pub(crate) struct PageArguments {
    /// Folder that `parfocal solve -o`, `stack -o` or `batch -o` wrote
    pub(crate) results: PathBuf,
    /// Print the path of the page, and do not open it
    #[arg(long)]
    pub(crate) print: bool,
}

/// The program that opens a file in the user's preferred application.
const OPENER: &str = if cfg!(target_os = "macos") {
    "open"
} else if cfg!(windows) {
    "explorer"
} else {
    "xdg-open"
};

/// Longest wait for an error of this program, in tenths of a second.
const MAX_WAIT: u32 = 50;

/// Finds and opens the page.
pub(crate) fn open(arguments: &PageArguments) -> Result<(), Failure> {
    let results = &arguments.results;
    let failed = |problem: &str| Failure::file(results, problem);
    if !results.is_dir() {
        return Err(failed("is no folder; give the one that parfocal solve, stack or batch wrote"));
    }
    let names = if results.join(SUMMARY).is_file() { [INDEX, PAGE_FILE] } else { [PAGE_FILE, INDEX] };
    let page = names.map(|name| results.join(name)).into_iter().find(|page| page.is_file());
    let page = page.ok_or_else(|| {
        failed("has no page: it is of a run with --no-html, or holds no results; run it again without")
    })?;
    if arguments.print {
        return print(&page.display().to_string());
    }
    let failed = |problem: String| Failure::Failed(format!("{OPENER} {problem}; open {} in a browser", page.display()));
    let null = Stdio::null;
    // Explorer takes only absolute paths with backslashes.
    let address = if cfg!(windows) { std::path::absolute(&page) } else { Ok(page.clone()) };
    let address = address.map_err(|e| failed(format!("cannot be given the page ({e})")))?;
    let started = Command::new(OPENER).arg(address).stdin(null()).stdout(null()).stderr(null()).spawn();
    let mut opener = started.map_err(|e| failed(format!("cannot be run ({e})")))?;
    // If the program is the browser itself, it keeps running, and the page is open.
    for _ in 0..MAX_WAIT {
        match opener.try_wait() {
            // Explorer returns 1 after it has opened a page.
            Ok(Some(status)) if status.success() || cfg!(windows) => return Ok(()),
            Ok(Some(status)) => return Err(failed(format!("opened nothing ({status})"))),
            Ok(None) => thread::sleep(Duration::from_millis(100)),
            Err(e) => return Err(failed(format!("cannot be waited for ({e})"))),
        }
    }
    Ok(())
}
