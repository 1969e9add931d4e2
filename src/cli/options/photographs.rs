//! The photographs of a pair or a sweep: their files, their order, and their focus positions.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use parfocal::export::{Nearer, NearerBy, SIMULATED_FILES, result_files};
use parfocal::image_io::{Input, PageStack, Photograph, RawFormat, foreign_problem};
use parfocal::internals::{available_memory, bounded_read};
use parfocal::sweep::Positions;
use parfocal::{Engine, Settings, settings::DeviceInfo};

use crate::cli::help::INPUT;
use crate::cli::options::series::{self, file_name, stem};
use crate::cli::output::failure::Failure;

/// The two photographs of a pair.
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
    /// The two files.
    pub(crate) fn files(&self) -> [PathBuf; 2] {
        [self.i1.clone(), self.i2.clone()]
    }
}

/// Opens two photographs. Also returns their descriptions for the report.
pub(crate) fn open_pair([i1, i2]: &[PathBuf; 2]) -> Result<([Photograph; 2], Vec<Input>), Failure> {
    let photographs = Photograph::open_pair(i1, i2)?;
    let inputs = photographs.iter().map(Photograph::describe).collect();
    Ok((photographs, inputs))
}

/// Number of pixels, 2^24, above which photographs are only decoded once the device is known to support their size.
/// Decoding smaller ones takes little time.
pub(crate) const LARGE: u64 = 1 << 24;

/// Refuses photographs that are too large for the device, before they are decoded. Up to a number of pixels, the device
/// is not asked.
pub(crate) fn check_size(
    photographs: [&Photograph; 2],
    settings: &Settings,
    unchecked: u64,
    device: impl FnOnce() -> Result<DeviceInfo, Failure>,
) -> Result<(), Failure> {
    let (width, height) = photographs[0].size();
    if u64::from(width) * u64::from(height) <= unchecked {
        return Ok(());
    }
    let formats = photographs.map(Photograph::format);
    Engine::check_size(&device()?, [width, height], formats, settings)
        .map_err(|e| Failure::of_solve(e, photographs[0].path()))
}

/// Bytes of memory that a pixel of a sweep takes at least, solved in parts: for each frame, and besides with its results
/// and their page. 45 frames of 0.75 Mpx fail under a limit of 700 MB and not under 1100 MB.
const LEAST_BYTES: [u64; 2] = [5, 220];

/// Refuses a sweep, before its frames are decoded, for which there is no memory.
pub(crate) fn check_memory(first: &Photograph, count: usize) -> Result<(), Failure> {
    let ((width, height), format) = (first.size(), first.format());
    let pixels = u64::from(width) * u64::from(height);
    let [of_frame, besides] = LEAST_BYTES;
    let stored = u64::from(format.channels.count() * format.depth.bytes());
    let needed = pixels.saturating_mul(count as u64 * (stored + of_frame) + besides);
    let available = available_memory().unwrap_or(u64::MAX);
    if needed <= available {
        return Ok(());
    }
    let gib = |bytes: u64| bytes as f64 / f64::from(1 << 30);
    Err(Failure::Failed(format!(
        "{count} frames of {width}x{height} take {:.1} GiB of memory at least, and {:.1} GiB are available: give fewer \
         frames, or reduce all to half their size",
        gib(needed),
        gib(available)
    )))
}

/// Extensions of photographs.
const EXTENSIONS: [&str; 13] =
    ["png", "jpg", "jpeg", "tif", "tiff", "exr", "bmp", "webp", "pnm", "pgm", "ppm", "pam", "pfm"];

/// Extensions of photographs without a header.
const RAW_EXTENSIONS: [&str; 2] = ["raw", "bin"];

/// Whether a file has the extension of a photograph.
pub(crate) fn is_photograph(file: &Path) -> bool {
    let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    EXTENSIONS.contains(&extension.as_str())
}

/// Adds the format to the name of a photograph without a header.
pub(crate) fn with_format(path: PathBuf, raw: Option<RawFormat>) -> PathBuf {
    match raw {
        Some(format) if path.exists() || !series::file_name(&path).contains('#') => {
            let mut name = path.into_os_string();
            name.push(format!("#{format}"));
            name.into()
        }
        _ => path,
    }
}

/// The frames of a sweep in order, and what their folder holds besides.
#[derive(Clone, Debug, Default)]
pub(crate) struct SweepFiles {
    pub(crate) frames: Vec<PathBuf>,
    /// Names of the photographs of the folder that do not belong to the series.
    pub(crate) left_out: Vec<String>,
    /// Of pages of a file: size of a pixel, µm, and positions along z, mm.
    pub(crate) pixel_um: Option<f64>,
    pub(crate) z_mm: Option<Vec<f64>>,
    /// Which pages of a file are read.
    pub(crate) pages_note: Option<String>,
}

impl SweepFiles {
    /// Frames without any besides.
    pub(crate) fn of(frames: Vec<PathBuf>) -> Self {
        Self { frames, ..Self::default() }
    }

    /// A line that lists the photographs that were left out, or says which pages are read.
    pub(crate) fn note(&self) -> Option<String> {
        let note = || {
            format!("note: left out: {}, not named like {}", in_short(&self.left_out, ", "), series::ends(&self.frames))
        };
        if self.left_out.is_empty() { self.pages_note.clone() } else { Some(note()) }
    }
}

/// The options of a file with several channels or times.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub(crate) struct PageArguments {
    /// Channel of ImageJ or OME-TIFF pages, from 1 [default: 1]
    #[arg(long, value_name = "N", help_heading = INPUT, value_parser = clap::value_parser!(u32).range(1..))]
    channel: Option<u32>,
    /// Time of ImageJ or OME-TIFF pages, from 1 [default: 1]
    #[arg(long, value_name = "N", help_heading = INPUT, value_parser = clap::value_parser!(u32).range(1..))]
    time: Option<u32>,
}

/// The most names in a message.
const MOST_NAMES: usize = 10;

/// Lists names for a message, the first of many, and the number of the others.
pub(crate) fn in_short(names: &[String], separator: &str) -> String {
    let more = names.len().saturating_sub(MOST_NAMES);
    let shown = names[..names.len() - more].join(separator);
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

/// The series of photographs of a folder, the pages of a file, or the named files. Named files in alphabetical order, as
/// from a shell, are put in natural order, `frame_2` before `frame_10`, unless positions are stated for them
/// (`has_positions`).
pub(crate) fn sweep_frames(
    named: &[PathBuf],
    has_positions: bool,
    raw: Option<RawFormat>,
    pages: PageArguments,
) -> Result<SweepFiles, Failure> {
    let mut files = match named {
        [folder] if folder.is_dir() => match &list_folder(folder, raw)?.0[..] {
            [file] if raw.is_none() => of_pages(file, pages)?,
            files => of_folder(folder, files.to_vec())?,
        },
        [file] if raw.is_none() => of_pages(file, pages)?,
        _ => {
            let mut frames = named.to_vec();
            if !has_positions && frames.is_sorted() {
                frames.sort_by_cached_key(|file| natural_key(file));
            }
            SweepFiles::of(frames)
        }
    };
    let is_chosen = pages.channel.is_some() || pages.time.is_some();
    if is_chosen && files.pages_note.is_none() {
        let problem = "--channel and --time choose pages of one file, an ImageJ or OME-TIFF stack; leave them out";
        return Err(Failure::Usage(problem.to_string()));
    }
    for file in &mut files.frames {
        *file = with_format(std::mem::take(file), raw);
    }
    Ok(files)
}

/// The pages of a TIFF as the frames of a sweep.
fn of_pages(file: &Path, PageArguments { channel, time }: PageArguments) -> Result<SweepFiles, Failure> {
    let Some(stack) = PageStack::read(file, [channel, time].map(|n| n.map(|n| n as usize)))? else {
        let problem = "is one photograph, and a sweep has three or more; give their folder, or name them all";
        return Err(Failure::file(file, problem));
    };
    let chosen = |what: &str, n: Option<u32>, count: usize| {
        let n = n.unwrap_or(1);
        (count > 1).then(|| format!(", {what} {n} of {count} (--{what})"))
    };
    let [channels, times] = stack.counts;
    let chosen = [chosen("channel", channel, channels), chosen("time", time, times)];
    let chosen: String = chosen.into_iter().flatten().collect();
    let PageStack { frames, left_out, pixel_um, z_um, .. } = stack;
    let z = z_um.as_ref().and_then(|z| Some(format!("z of {} to {} µm", z.first()?, z.last()?)));
    let sizes: Vec<String> = pixel_um.map(|um| format!("pixels of {um:.4} µm")).into_iter().chain(z).collect();
    let sizes = if sizes.is_empty() { String::new() } else { format!(", with {} as stated", sizes.join(" and ")) };
    let others =
        if left_out > 0 { format!("; {left_out} of another size or kind are left out") } else { String::new() };
    let note = format!("note: {} pages of {} are the frames{chosen}{sizes}{others}", frames.len(), file.display());
    let z_mm = z_um.map(|z| z.iter().map(|um| um / 1000.0).collect());
    Ok(SweepFiles { pixel_um, z_mm, pages_note: Some(note), ..SweepFiles::of(frames) })
}

/// The series of the photographs of a folder; `None` if they have no series, or several.
pub(crate) fn one_series(files: &[PathBuf]) -> Option<SweepFiles> {
    let [frames] = <[_; 1]>::try_from(series::find(files)).ok()?;
    let left_out = files.iter().filter(|file| !frames.contains(file)).map(|file| file_name(file)).collect();
    Some(SweepFiles { left_out, ..SweepFiles::of(frames) })
}

/// The series of the photographs of a folder, or all if their names have no numbers.
fn of_folder(folder: &Path, mut files: Vec<PathBuf>) -> Result<SweepFiles, Failure> {
    let refused = |problem: String| Failure::file(folder, format!("holds {problem}"));
    if files.len() < 3 {
        let besides = foreign_files(folder).map_or(String::new(), |besides| format!("; it holds {besides}"));
        return Err(refused(format!("{} photographs, and a sweep has three or more{besides}", files.len())));
    }
    if let Some(found) = one_series(&files) {
        return Ok(found);
    }
    let several = series::find(&files);
    if several.len() > 1 {
        let listed: Vec<_> = several.iter().map(|one| format!("{} ({})", series::ends(one), one.len())).collect();
        let problem = format!("{} series of photographs: {}", several.len(), in_short(&listed, ", "));
        return Err(refused(format!("{problem}; name the frames of one, or move the others away")));
    }
    let extension = |file: &PathBuf| file.extension().map(|extension| extension.to_ascii_lowercase());
    let is_one_kind = files.iter().all(|file| extension(file) == extension(&files[0]));
    if is_one_kind && files.iter().all(|file| !stem(file).contains(|c: char| c.is_ascii_digit())) {
        files.sort_by_cached_key(|file| natural_key(file));
        return Ok(SweepFiles::of(files));
    }
    let names: Vec<String> = files.iter().map(|file| file_name(file)).collect();
    Err(refused(format!(
        "{} photographs and no series of three or more, whose names differ in a number only ({}); name the frames in \
         the order of their focus",
        files.len(),
        in_short(&names, ", ")
    )))
}

/// Folders that systems make, in small letters: bins, previews, copies and what a repair of the disk found.
const SYSTEM_FOLDERS: [&str; 12] = [
    "#recycle",
    "#snapshot",
    "@eadir",
    "@recycle",
    "@recently-snapshot",
    "$recycle.bin",
    "recycler",
    "lost+found",
    "system volume information",
    "__macosx",
    "network trash folder",
    "temporary items",
];

/// The number of files of a folder that are of another kind than photographs, and what to do about the first; `None` if
/// there are none.
pub(crate) fn foreign_files(folder: &Path) -> Option<String> {
    let entries = fs::read_dir(folder).ok()?.filter_map(Result::ok).map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|file| foreign_problem(file, None).is_some()).collect();
    files.sort();
    let problem = foreign_problem(files.first()?, None)?;
    Some(format!("{} of another kind: {} {problem}", files.len(), file_name(&files[0])))
}

/// The photographs and the folders in a folder, sorted, without hidden files and results.
pub(crate) fn list_folder(folder: &Path, raw: Option<RawFormat>) -> Result<(Vec<PathBuf>, Vec<PathBuf>), Failure> {
    let failed = |e: std::io::Error| {
        let problem = match e.kind() {
            ErrorKind::NotFound => {
                bounded_read::not_a_path(folder).unwrap_or("there is no such folder; check the path").to_string()
            }
            _ => format!("cannot be listed ({e}); check its permissions"),
        };
        Failure::file(folder, problem)
    };
    let (mut files, mut folders) = (Vec::new(), Vec::new());
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let is_input = SIMULATED_FILES[..2].contains(&name.as_str());
        let is_profile = name.starts_with("profile_") && name.ends_with(".png");
        let mut results = result_files().chain(SIMULATED_FILES);
        let is_result = results.any(|result| result == name) && !is_input || is_profile;
        if name.starts_with('.') || is_result {
            continue;
        } else if path.is_dir() {
            folders.extend(Some(path).filter(|_| !SYSTEM_FOLDERS.contains(&name.to_lowercase().as_str())));
        } else if if raw.is_some() { &RAW_EXTENSIONS[..] } else { &EXTENSIONS }.contains(&extension.as_str()) {
            files.push(path);
        }
    }
    files.sort();
    folders.sort();
    Ok((files, folders))
}

/// The parts of a path: pairs of a text and the number after it.
fn natural_key(path: &Path) -> Vec<(String, u64)> {
    let (mut pieces, text) = (Vec::new(), path.to_string_lossy().into_owned());
    let mut rest = text.as_str();
    while !rest.is_empty() {
        let number = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let end = rest[number..].find(|c: char| !c.is_ascii_digit()).map_or(rest.len(), |end| number + end);
        // Uses the first 19 digits of a longer number.
        let digits = &rest[number..end.min(number + 19)];
        pieces.push((rest[..number].to_string(), digits.parse().unwrap_or(0)));
        rest = &rest[end..];
    }
    pieces
}

/// The positions of frames: each, or the first and the step.
#[derive(Clone, Debug)]
pub(crate) enum FramePositions {
    Each(Vec<f64>),
    Even { start: f64, step: f64 },
}

impl FromStr for FramePositions {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            text.trim().parse::<f64>().map_err(|_| format!("'{text}' is no number: give one a frame, or START:STEP"))
        };
        match text.split_once(':') {
            Some((start, step)) => Ok(Self::Even { start: number(start)?, step: number(step)? }),
            None => text.split(',').map(number).collect::<Result<_, _>>().map(Self::Each),
        }
    }
}

impl FramePositions {
    /// The position of each of some frames.
    pub(crate) fn of(&self, frames: usize) -> Vec<f64> {
        match self {
            Self::Each(positions) => positions.clone(),
            Self::Even { start, step } => {
                // Twelve digits of the larger, so that 3 times 0.1 is 0.3.
                let digits = (12.0 - start.abs().max(step.abs()).log10().floor()).clamp(0.0, 30.0) as usize;
                let at = |n: usize| format!("{:.digits$}", start + step * n as f64);
                (0..frames).map(|n| at(n).parse().unwrap_or(f64::NAN)).collect()
            }
        }
    }
}

/// The options of the focus positions of the frames.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct FocusPositionArguments {
    /// Distance from the lens at which each frame is focused, in order, or the first and the step (mm)
    #[arg(long, value_name = "MM,MM,...|START:STEP", help_heading = INPUT, allow_hyphen_values = true)]
    focus_at: Option<FramePositions>,
    /// Take the numbers of --focus-at as positions along the axis, from any origin
    ///
    /// For a stage that moves the camera or the scene, or a lens that is telecentric on the side of the scene: depth is
    /// linear in them, not in their inverse. `up`: greater positions are nearer to the camera; `down`: farther away, as
    /// without either.
    #[arg(long, value_name = "up|down", help_heading = INPUT, num_args = 0..=1, default_missing_value = "true",
          value_parser = ["up", "down", "true"], hide_possible_values = true, requires = "focus_at")]
    stage: Option<String>,
}

impl FocusPositionArguments {
    /// Whether positions are stated.
    pub(crate) fn is_given(&self) -> bool {
        self.focus_at.is_some()
    }

    /// The stated positions of some frames.
    pub(crate) fn positions(&self, frames: usize) -> Option<Positions> {
        let at = self.focus_at.as_ref()?.of(frames);
        Some(if self.stage.is_some() { Positions::Stage(at) } else { Positions::Distances(at) })
    }

    /// The frame that is focused nearest, from `--nearer` or the direction of the stage.
    pub(crate) fn nearer(&self, stated: Option<u8>, positions: &Positions) -> Option<u8> {
        let ascending = positions.first_is_nearest();
        match (self.stage.as_deref(), ascending) {
            (Some("up"), Some(ascending)) => Some(1 + u8::from(ascending)),
            (Some("down"), Some(ascending)) => Some(2 - u8::from(ascending)),
            _ => stated,
        }
    }
}

/// The near end of the sweep, from `--nearer` and the positions, and what states it. For a stage, `--nearer` takes
/// precedence, since the direction of the stage is unknown.
pub(crate) fn nearer_end(stated: Option<u8>, positions: &Positions) -> Result<(Nearer, Option<NearerBy>), Failure> {
    let by_distance = positions.first_is_nearest().map(|first| if first { 1 } else { 2 });
    let contradicted = stated.is_some() && by_distance.is_some() && stated != by_distance;
    if contradicted && matches!(positions, Positions::Distances(_)) {
        return Err(Failure::Usage("--nearer contradicts --focus-at; leave --nearer out".to_string()));
    }
    let by = match (stated, positions) {
        (Some(_), _) => Some(NearerBy::Stated),
        (None, Positions::Distances(_)) => Some(NearerBy::Distances),
        (None, Positions::Stage(_)) => Some(NearerBy::Assumed),
        (None, _) => None,
    };
    Ok((if stated.or(by_distance) == Some(2) { Nearer::Second } else { Nearer::First }, by))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_listed_by_a_shell_are_put_in_natural_order() {
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let listed = paths(&["a/image_1.jpg", "a/image_10.jpg", "a/image_2.jpg"]);
        let counted = paths(&["a/image_1.jpg", "a/image_2.jpg", "a/image_10.jpg"]);
        assert_eq!(sweep_frames(&listed, false, None, PageArguments::default()).unwrap().frames, counted);
        assert_eq!(sweep_frames(&listed, true, None, PageArguments::default()).unwrap().frames, listed);
        let chosen = paths(&["z_3.png", "z_1.png", "z_2.png"]);
        assert_eq!(sweep_frames(&chosen, false, None, PageArguments::default()).unwrap().frames, chosen);
        assert_eq!(natural_key(Path::new("9999999999999999999999.png"))[0].1, 9_999_999_999_999_999_999);
    }

    #[test]
    fn positions_are_listed_or_even() {
        let of = |text: &str| text.parse::<FramePositions>().map(|positions| positions.of(4));
        assert_eq!(of("3,-1.5, 7"), Ok(vec![3.0, -1.5, 7.0]));
        assert_eq!(of("-0.3:0.1"), Ok(vec![-0.3, -0.2, -0.1, 0.0]));
        assert_eq!(of("1000.0004:-1e-3"), Ok(vec![1000.0004, 999.9994, 999.9984, 999.9974]));
        assert!(["", "1,", "1:2:3", "0:x"].into_iter().all(|text| of(text).unwrap_err().contains("START:STEP")));
    }

    #[test]
    fn a_folder_is_the_series_of_its_names() {
        let folder = tempfile::TempDir::new().unwrap();
        let of = |names: &[&str]| {
            for entry in std::fs::read_dir(folder.path()).unwrap() {
                std::fs::remove_file(entry.unwrap().path()).unwrap();
            }
            names.iter().for_each(|name| std::fs::write(folder.path().join(name), name).unwrap());
            let found = sweep_frames(&[folder.path().to_path_buf()], false, None, PageArguments::default());
            found.map(|found| (found.frames.iter().map(|file| file_name(file)).collect::<Vec<_>>(), found.left_out))
        };
        let (frames, left_out) = of(&["f_2.png", "f_10.png", "f_1.png", "notes.txt", "fused.png", "mask.png"]).unwrap();
        assert_eq!(
            (&frames[..], &left_out[..]),
            (&["f_1.png", "f_2.png", "f_10.png"].map(String::from)[..], &["mask.png".to_string()][..])
        );
        let (frames, left_out) = of(&["near.png", "middle.png", "far.png"]).unwrap();
        assert_eq!((frames.len(), left_out.len()), (3, 0));
        for (names, problem) in [
            (&["f_10.png", "f_1.png"][..], "holds 2 photographs"),
            (&["near.png", "middle.png", "far.png", "expected.jpg"], "no series of three or more"),
            (&["a_1.png", "a_2.png", "b_1.png", "b_2.png"], "no series of three or more"),
            (
                &["1.png", "2.png", "3.png", "x1.png", "x2.png", "x3.png"],
                "2 series of photographs: 1.png to 3.png (3), x1.png to x3.png (3)",
            ),
        ] {
            let refused = of(names).unwrap_err();
            assert!(refused.message().contains(problem), "{}", refused.message());
        }
    }
}
