//! `parfocal apply`: photographs, and a registration that is known, to photographs that lie on one another.

use std::path::{Path, PathBuf};

use parfocal::export::{self, registered_ending, registered_kind, write_registered};
use parfocal::image_io::Photograph;
use parfocal::{Brightness, image_io, resample};

use super::failure::Failure;
use super::output::{self, ForceArgument};
use super::told::ToldArguments;

/// Bring other photographs of I2's camera onto the pixels of I1, by a registration that is known.
///
/// Such as other lights, or other channels.
#[derive(clap::Args, Debug)]
#[command(after_help = "Exit status: 0 done, 1 failed, 2 wrong usage.")]
pub(super) struct Arguments {
    /// The photographs, of the size of the pair that was registered
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// The registration: a report.json, what register wrote, or its transform object
    #[arg(long, value_name = "FILE")]
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
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (transform, photometric) = export::read_transform(&arguments.transform)?;
    let photometric = photometric.filter(|_| arguments.exposure);
    if arguments.exposure && photometric.is_none() {
        let file = arguments.transform.display();
        return Err(Failure::Failed(format!("{file}: states no gain and offset; leave out --exposure")));
    }
    let names = check(arguments)?;
    let export::PairOf { size, region, shading, decode } = export::read_pair_of(&arguments.transform)?;
    for (path, file) in arguments.images.iter().zip(&names) {
        let frame = image_io::read(path)?;
        let found = (frame.width(), frame.height());
        if let Some(size) = size.filter(|size| (size.width, size.height) != found) {
            let (file, path) = (arguments.transform.display(), path.display());
            let (registered, found) = (format!("{}x{}", size.width, size.height), format!("{}x{}", found.0, found.1));
            let problem = format!("is {found}, and {file} registers images of {registered}; resize it first");
            return Err(Failure::Failed(format!("{path}: {problem}")));
        }
        if *file != place(path, registered_ending(frame.format().depth))? {
            return Err(Failure::Failed(format!("{}: was replaced meanwhile; run it again", path.display())));
        }
        let unchanged = Brightness::unchanged([frame.width(), frame.height()]);
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
    let files: Vec<String> = names.iter().map(|file| arguments.output.join(file).display().to_string()).collect();
    arguments.told.json(|| serde_json::to_string(&serde_json::json!({ "files": files })))
}

/// The names of the results; refuses, before the first is written, those that would replace one another, an input, or what
/// is not ours. Of the photographs only headers are looked at, and none is kept: there may be many.
fn check(arguments: &Arguments) -> Result<Vec<String>, Failure> {
    output::check_folder(&arguments.output)?;
    let inputs: Vec<&PathBuf> = arguments.images.iter().chain([&arguments.transform]).collect();
    let mut names: Vec<String> = Vec::new();
    for path in &arguments.images {
        let depth = Photograph::open(path)?.depth();
        let name = place(path, registered_ending(depth))?;
        if names.contains(&name) {
            let problem = "two images have this name; bring them up one after the other into two folders";
            return Err(Failure::Failed(format!("{}: {problem}", path.display())));
        }
        output::check_inputs(&arguments.output, &[&name], &inputs)?;
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
