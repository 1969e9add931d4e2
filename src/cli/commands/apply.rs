//! `parfocal apply`: moves photographs onto the pixels of the reference by a known registration.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use parfocal::export::{FrameRegistration, Registration, registered_ending, registered_kind, write_registered};
use parfocal::image_io::{Carried, Photograph};
use parfocal::{Frame, frame::Depth, resample, transform::Brightness};

use crate::cli::options::photographs::{self, PageArguments};
use crate::cli::options::run::ReportArguments;
use crate::cli::options::settings::registration_file;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Move other photographs of I2's camera, or all frames of a sweep, onto the pixels of the reference.
///
/// The registration is known, so the photographs may have other lights or channels. For a sweep, give one photograph
/// per frame, in order.
#[derive(clap::Args, Debug)]
#[command(after_help = "Exit status: 0 done, 1 failed, 2 wrong usage.")]
pub(crate) struct Arguments {
    /// The photographs, of the size of those that were registered; for a sweep their folder will do
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// The registration: a report.json of a pair or a sweep, what register wrote, or its transform object
    #[arg(long, value_name = "FILE", value_parser = registration_file)]
    transform: PathBuf,
    /// Folder for the results, which have the names of their images; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Also apply gain, offset and shading of the registration, to values decoded as in its solve (--decode)
    #[arg(long)]
    exposure: bool,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    report: ReportArguments,
}

/// Reads, moves and writes the photographs one by one.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let registration = Registration::read(&arguments.transform)?;
    if arguments.exposure && registration.frames.iter().all(|frame| frame.photometric().is_none()) {
        return Err(of_file(&arguments.transform, "states no gain and offset; leave out --exposure"));
    }
    // Any number of photographs of I2's camera, each written separately.
    if let Some(second) = registration.second() {
        let names = check(arguments, &arguments.images)?;
        for (path, name) in arguments.images.iter().zip(&names) {
            let depth = Photograph::open(path)?.depth();
            if *name != result_name(path, registered_ending(depth))? {
                return Err(of_file(path, "was replaced meanwhile; run it again"));
            }
            let frame = moved(arguments, &registration, Some(second), path, depth);
            let frame = std::iter::once(frame.map(|(frame, carried)| (name.clone(), frame, carried)));
            write_registered(arguments.force.to(&arguments.output), depth, frame)?;
            arguments.report.print_line(&arguments.output.join(name).display().to_string());
        }
        return list(arguments, &names);
    }
    // One photograph for each frame of a sweep, all written or none.
    let files = photographs::sweep_frames(&arguments.images, false, None, PageArguments::default())?;
    files.note().iter().for_each(|note| arguments.report.print_line(note));
    let images = files.frames;
    let count = registration.frames.len();
    if images.len() != count {
        let problem = format!("registers {count} frames, and {} images are given; give one for each", images.len());
        return Err(Failure::Usage(format!("{}: {problem}", arguments.transform.display())));
    }
    let names = check(arguments, &images)?;
    let depth = Photograph::open(&images[0])?.depth();
    let all = registration.frames.iter().enumerate().map(|(n, frame)| {
        let frame = Some(frame).filter(|_| n != registration.reference);
        let moved = moved(arguments, &registration, frame, &images[n], depth)?;
        Ok::<_, Failure>((names[n].clone(), moved.0, moved.1))
    });
    write_registered(arguments.force.to(&arguments.output), depth, all)?;
    names.iter().for_each(|name| arguments.report.print_line(&arguments.output.join(name).display().to_string()));
    list(arguments, &names)
}

/// A photograph on the pixels of the reference, and its metadata. `frame` is `None` if it is already on them.
fn moved(
    arguments: &Arguments,
    registration: &Registration,
    frame: Option<&FrameRegistration>,
    path: &Path,
    depth: Depth,
) -> Result<(Frame, Arc<Carried>), Failure> {
    let photograph = Photograph::open(path)?;
    let carried = photograph.describe().carried;
    let photograph = photograph.decode()?;
    let size = [photograph.width(), photograph.height()];
    check_size(arguments, path, size, registration.size)?;
    if registered_kind(photograph.format().depth) != registered_kind(depth) {
        return Err(of_file(path, "is in other samples than the first; save all in integers, or all in floats"));
    }
    let moved = match frame {
        None => photograph,
        Some(frame) => {
            let brightness = frame.brightness(size).filter(|_| arguments.exposure);
            let brightness = brightness.unwrap_or_else(|| Brightness::identity(size));
            resample::registered(&photograph, &frame.transform, &brightness, registration.decode)
        }
    };
    let moved = match registration.region {
        Some(region) => moved.cropped(region).map_err(|problem| of_file(&arguments.transform, problem))?,
        None => moved,
    };
    Ok((moved, carried))
}

/// Refuses a photograph if its size differs from the registered ones.
fn check_size(arguments: &Arguments, path: &Path, found: [u32; 2], size: Option<[u32; 2]>) -> Result<(), Failure> {
    let Some([width, height]) = size.filter(|size| *size != found) else { return Ok(()) };
    let (file, [w, h]) = (arguments.transform.display(), found);
    Err(of_file(path, format!("is {w}x{h}, and {file} registers images of {width}x{height}; resize it first")))
}

fn of_file(path: &Path, problem: impl std::fmt::Display) -> Failure {
    Failure::file(path, problem)
}

/// Prints the files as JSON.
fn list(arguments: &Arguments, names: &[String]) -> Result<(), Failure> {
    let files: Vec<String> = names.iter().map(|file| arguments.output.join(file).display().to_string()).collect();
    arguments.report.print_json(&serde_json::json!({ "files": files }))
}

/// The names of the results. Refuses names that would replace one another, an input, or a file of another program. Only
/// one photograph at a time is read.
fn check(arguments: &Arguments, images: &[PathBuf]) -> Result<Vec<String>, Failure> {
    destination::check_folder(&arguments.output)?;
    let inputs: Vec<&PathBuf> = images.iter().chain([&arguments.transform]).collect();
    let mut names: Vec<String> = Vec::new();
    for path in images {
        let depth = Photograph::open(path)?.depth();
        let name = result_name(path, registered_ending(depth))?;
        if names.contains(&name) {
            let problem = "two images have this name; write them into two folders";
            return Err(Failure::file(path, problem));
        }
        destination::check_inputs(&arguments.output, &[&name], &inputs)?;
        arguments.force.to(&arguments.output).check_named(registered_kind(depth), &[&name])?;
        names.push(name);
    }
    Ok(names)
}

/// Name of the result for an image.
fn result_name(path: &Path, ending: &str) -> Result<String, Failure> {
    let stem = path.file_stem().ok_or_else(|| Failure::Usage(format!("{}: names no file", path.display())))?;
    Ok(format!("{}.{ending}", stem.to_string_lossy()))
}
