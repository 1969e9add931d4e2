//! `parfocal apply`: photographs, and a registration that is known, to photographs that lie on one another.

use std::path::{Path, PathBuf};

use parfocal::export::{self, SweepPlaces, registered_ending, registered_kind, write_registered};
use parfocal::image_io::Photograph;
use parfocal::{Brightness, Depth, Frame, image_io, resample};

use crate::cli::jobs::frames;
use crate::cli::options::output_options::ToldArguments;
use crate::cli::options::settings::registration_file;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Bring other photographs of I2's camera, or all frames of a sweep, onto the pixels of the reference.
///
/// By a registration that is known: photographs with other lights, or other channels. Of a sweep one for each frame, in
/// order, all or none.
#[derive(clap::Args, Debug)]
#[command(after_help = "Exit status: 0 done, 1 failed, 2 wrong usage.")]
pub(crate) struct Arguments {
    /// The photographs, of the size of those that were registered; of a sweep their folder will do
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// The registration: a report.json of a pair or a sweep, what register wrote, or its transform object
    #[arg(long, value_name = "FILE", value_parser = registration_file)]
    transform: PathBuf,
    /// Folder for the results, each of the name of its image; made if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Apply gain, offset and shading of the registration too, to the values as it was found with (--decode)
    #[arg(long)]
    exposure: bool,
    #[command(flatten)]
    force: ForceArgument,
    #[command(flatten)]
    told: ToldArguments,
}

/// Reads, moves and writes one photograph after the other.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(places) = export::read_sweep_places(&arguments.transform)? {
        return of_sweep(arguments, &places);
    }
    let (transform, photometric) = export::read_transform(&arguments.transform)?;
    let photometric = photometric.filter(|_| arguments.exposure);
    if arguments.exposure && photometric.is_none() {
        let file = arguments.transform.display();
        return Err(Failure::Failed(format!("{file}: states no gain and offset; leave out --exposure")));
    }
    let names = check(arguments, &arguments.images)?;
    let export::PairOf { size, region, shading, decode } = export::read_pair_of(&arguments.transform)?;
    for (path, file) in arguments.images.iter().zip(&names) {
        let frame = image_io::read(path)?;
        check_size(arguments, path, [frame.width(), frame.height()], size.map(|size| [size.width, size.height]))?;
        if *file != place(path, registered_ending(frame.format().depth))? {
            return Err(Failure::Failed(format!("{}: was replaced meanwhile; run it again", path.display())));
        }
        let unchanged = Brightness::identity([frame.width(), frame.height()]);
        let brightness = photometric.map_or(unchanged, |photometric| {
            shading.map_or(Brightness { photometric, ..unchanged }, |shading| shading.with(photometric))
        });
        let mut moved = resample::registered(&frame, &transform, &brightness, decode);
        if let Some(region) = region {
            let problem = |e| Failure::Failed(format!("{}: {e}", arguments.transform.display()));
            moved = moved.cropped(region).map_err(problem)?;
        }
        write_registered(arguments.force.to(&arguments.output), file, &moved)?;
        arguments.told.say(&arguments.output.join(file).display().to_string());
    }
    list(arguments, &names)
}

/// The same of all frames of a sweep.
fn of_sweep(arguments: &Arguments, places: &SweepPlaces) -> Result<(), Failure> {
    let images = frames::of_sweep(&arguments.images, false, None)?;
    if images.len() != places.frames.len() {
        let (file, stated) = (arguments.transform.display(), places.frames.len());
        let problem = format!("registers {stated} frames, and {} images are given; give one for each", images.len());
        return Err(Failure::Usage(format!("{file}: {problem}")));
    }
    let names = check(arguments, &images)?;
    let depth = Photograph::open(&images[0])?.depth();
    let one = |n: usize| moved(arguments, places, &images[n], n, depth).map(|frame| (names[n].clone(), frame));
    let moved = (0..images.len()).map(one);
    export::write_all_registered(arguments.force.to(&arguments.output), depth, moved)?;
    names.iter().for_each(|file| arguments.told.say(&arguments.output.join(file).display().to_string()));
    list(arguments, &names)
}

/// One of them on the pixels of the reference.
fn moved(arguments: &Arguments, places: &SweepPlaces, path: &Path, n: usize, depth: Depth) -> Result<Frame, Failure> {
    let frame = image_io::read(path)?;
    check_size(arguments, path, [frame.width(), frame.height()], Some(places.size))?;
    if registered_kind(frame.format().depth) != registered_kind(depth) {
        return Err(of_file(path, "is in other samples than the first; save all in integers, or all in floats"));
    }
    let (transform, brightness) = places.frames[n];
    let brightness = if arguments.exposure { brightness } else { Brightness::identity(places.size) };
    let moved = match n == places.reference {
        true => frame,
        false => resample::registered(&frame, &transform, &brightness, places.decode),
    };
    match places.region {
        Some(region) => moved.cropped(region).map_err(|problem| of_file(&arguments.transform, problem)),
        None => Ok(moved),
    }
}

/// Refuses a photograph of another size than those that were registered.
fn check_size(arguments: &Arguments, path: &Path, found: [u32; 2], size: Option<[u32; 2]>) -> Result<(), Failure> {
    let Some([width, height]) = size.filter(|size| *size != found) else { return Ok(()) };
    let (file, [w, h]) = (arguments.transform.display(), found);
    Err(of_file(path, format!("is {w}x{h}, and {file} registers images of {width}x{height}; resize it first")))
}

fn of_file(path: &Path, problem: impl std::fmt::Display) -> Failure {
    Failure::Failed(format!("{}: {problem}", path.display()))
}

/// Tells a program which files there are.
fn list(arguments: &Arguments, names: &[String]) -> Result<(), Failure> {
    let files: Vec<String> = names.iter().map(|file| arguments.output.join(file).display().to_string()).collect();
    arguments.told.json(|| serde_json::to_string(&serde_json::json!({ "files": files })))
}

/// The names of the results; refuses, before the first is written, those that would replace one another, an input, or what
/// is not ours. Of the photographs only headers are looked at, and none is kept: there may be many.
fn check(arguments: &Arguments, images: &[PathBuf]) -> Result<Vec<String>, Failure> {
    destination::check_folder(&arguments.output)?;
    let inputs: Vec<&PathBuf> = images.iter().chain([&arguments.transform]).collect();
    let mut names: Vec<String> = Vec::new();
    for path in images {
        let depth = Photograph::open(path)?.depth();
        let name = place(path, registered_ending(depth))?;
        if names.contains(&name) {
            let problem = "two images have this name; bring them up one after the other into two folders";
            return Err(Failure::Failed(format!("{}: {problem}", path.display())));
        }
        destination::check_inputs(&arguments.output, &[&name], &inputs)?;
        arguments.force.to(&arguments.output).check_named(registered_kind(depth), &[&name])?;
        names.push(name);
    }
    Ok(names)
}

/// The name of an image's result.
fn place(path: &Path, ending: &str) -> Result<String, Failure> {
    let stem = path.file_stem().ok_or_else(|| Failure::Usage(format!("{}: names no file", path.display())))?;
    Ok(format!("{}.{ending}", stem.to_string_lossy()))
}
