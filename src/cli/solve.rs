//! `parfocal solve`: two photographs in, relative blur and registration out.

use std::fs;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use parfocal::export::{
    self, Additions, DEPTH_FILE, Depth16, DepthReport, EXTRA_FILES, FILES, FUSED_FLOAT_FILE, Look, PAGE_FILE, Report,
    Texture, TextureReport,
};
use parfocal::figure::PEN;
use parfocal::image_io::{Input, Photograph};
use parfocal::report_html::{Page, Readout};
use parfocal::{
    Decode, Depth, DeviceInfo, Frame, GainField, Lens, Method, MetricDepth, Scope, Scoped, Settings, Solution,
};
use sha2::{Digest, Sha256};

use super::colors::ColorsArgument;
use super::failure::Failure;
use super::help::{AFTER_HELP, INPUT, OUTPUT, REGISTRATION};
use super::lens::{self, LensArguments, PartOfLens};
use super::measure::MeasureArguments;
use super::models::ModelArguments;
use super::output::{self, ForceArgument};
use super::pair::PairArguments;
use super::scope::ScopeArguments;
use super::summary::{Bar, summary};

/// Recover relative blur and registration of two photographs of one scene, focused at two distances.
#[derive(clap::Args, Clone, Debug)]
#[command(after_long_help = AFTER_HELP)]
pub(super) struct Arguments {
    #[command(flatten)]
    pub(super) pair: PairArguments,
    /// Folder for the results; made if it is missing, earlier results in it replaced
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// How the registration is found
    #[arg(long, value_name = "NAME", help_heading = REGISTRATION, value_enum, default_value_t = MethodName::from(Settings::default().method))]
    method: MethodName,
    /// Keep what --transform states instead of starting from it; the method is then aligned
    #[arg(long, help_heading = REGISTRATION, requires_if("true", "transform"))]
    hold: bool,
    /// Which image is focused nearer [default: 1; with a lens, as its focus distances say]
    ///
    /// It decides which end of V is near in pictures and page.
    #[arg(long, value_name = "1|2", help_heading = INPUT, value_parser = clap::value_parser!(u8).range(1..=2))]
    nearer: Option<u8>,
    #[command(flatten)]
    colors: ColorsArgument,
    /// Do not write report.html
    #[arg(long, help_heading = OUTPUT)]
    no_html: bool,
    #[command(flatten)]
    pub(super) force: ForceArgument,
    #[command(flatten)]
    scope: ScopeArguments,
    #[command(flatten)]
    models: ModelArguments,
    #[command(flatten)]
    lens: LensArguments,
    #[command(flatten)]
    measure: MeasureArguments,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum MethodName {
    /// Together with the blur
    Unified,
    /// Not at all, which is depth only: T is held at identity or at --transform
    Aligned,
    /// Before the blur, by the difference of the images
    Appearance,
    /// Before the blur, by SIFT key-points
    Sift,
}

impl From<Method> for MethodName {
    fn from(method: Method) -> Self {
        match method {
            Method::Unified => Self::Unified,
            Method::Aligned => Self::Aligned,
            Method::Appearance => Self::Appearance,
            Method::Sift => Self::Sift,
        }
    }
}

impl From<MethodName> for Method {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Unified => Self::Unified,
            MethodName::Aligned => Self::Aligned,
            MethodName::Appearance => Self::Appearance,
            MethodName::Sift => Self::Sift,
        }
    }
}

/// Solves a pair and writes the results. Cheap checks come before dear ones: arguments, files, device, solve, write.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let pair = &arguments.pair;
    let settings = settings(arguments)?;
    check(arguments)?;
    let Some(photographs) = read(arguments, |_| false)? else { return Ok(()) };
    let engine = pair.common.open_engine()?;
    let (decided, frames) = (photographs.settings(&settings), photographs.frames.each_ref());
    let bar = Bar::new(pair.common.told.shows_progress());
    let scoped = photographs
        .scope
        .solve(&engine, &mut None, frames, &decided, &mut |progress| bar.show(progress))
        .map_err(|e| Failure::of_solve(e, &pair.i1))?;
    drop(bar);
    super::check_validation(&engine)?;
    let (report, written) = write(arguments, &settings, engine.info(), photographs, &scoped)?;
    tell(&report, &written, arguments)?;
    pair.common.check_strict(report.converged, &report.warnings)
}

/// What a photograph is called in the report: without its folders.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A pair as its files hold it.
pub(super) struct Photographs {
    pub(super) frames: [Frame; 2],
    pub(super) inputs: Vec<Input>,
    pub(super) scope: Scope,
    lens: Option<Lens>,
    decode: Decode,
}

impl Photographs {
    /// The settings, with values decoded as these files ask for under `--decode auto`.
    pub(super) fn settings(&self, settings: &Settings) -> Settings {
        Settings { decode: self.decode, ..settings.clone() }
    }
}

/// What the flags ask for.
pub(super) fn settings(arguments: &Arguments) -> Result<Settings, Failure> {
    arguments.pair.common.settings(arguments.method.into(), arguments.hold)
}

/// Refuses flags that contradict each other, and an output folder that cannot be written, or whose results would replace
/// an input.
pub(super) fn check(arguments: &Arguments) -> Result<(), Failure> {
    lens::nearer(arguments.nearer, arguments.lens.stated()?.as_ref())?;
    if arguments.scope.crops() && !arguments.measure.wanted().is_empty() {
        return Err(Failure::Usage(
            "--crop-valid moves the pixels that --step and --profile name; measure afterwards, with parfocal measure"
                .to_string(),
        ));
    }
    let of_the_pair = arguments.pair.inputs().into_iter().chain(arguments.lens.file());
    let inputs: Vec<_> = of_the_pair.chain(arguments.scope.inputs()).collect();
    if arguments.scope.flat().is_some_and(|flat| super::same_file(flat, &arguments.output)) {
        let problem = "holds the flat reference; give another folder for the results";
        return Err(Failure::Failed(format!("{}: {problem}", arguments.output.display())));
    }
    let profiles = export::profiles_in(&arguments.output);
    let profiles: Vec<&str> = profiles.iter().map(String::as_str).collect();
    let possible = [&FILES[..], &EXTRA_FILES, &[DEPTH_FILE], &profiles].concat();
    output::check(&arguments.output, REPORT, &possible, &inputs)?;
    check_places(arguments, arguments.lens.is_given(), false)
}

/// What says what was solved, and lists the files.
const REPORT: &str = FILES[4];

/// Refuses an output folder in which results would take the places of files that no solve wrote; whether there are results
/// in mm, and in floats.
fn check_places(arguments: &Arguments, in_mm: bool, in_floats: bool) -> Result<(), Failure> {
    let page = (!arguments.no_html).then_some(PAGE_FILE);
    let more = page.into_iter().chain(in_mm.then_some(DEPTH_FILE)).chain(in_floats.then_some(FUSED_FLOAT_FILE));
    let profiles = arguments.measure.wanted().files();
    let mut names: Vec<&str> = FILES.into_iter().chain(arguments.models.names()).chain(more).collect();
    names.extend(profiles.iter().map(String::as_str));
    Ok(arguments.force.to(&arguments.output).check_results(REPORT, &names)?)
}

/// Reads the pair, unless what the files are says that it is `settled` already.
pub(super) fn read(
    arguments: &Arguments,
    settled: impl FnOnce(&[Input]) -> bool,
) -> Result<Option<Photographs>, Failure> {
    let pair = &arguments.pair;
    let (photographs, inputs) = pair.photographs()?;
    if settled(&inputs) {
        return Ok(None);
    }
    let lens = arguments.lens.lens(PartOfLens::of_photographs(&inputs))?;
    lens::nearer(arguments.nearer, lens.as_ref())?;
    let decode = pair.common.decode(&inputs)?;
    let [i1, i2] = Photograph::decode_pair(photographs)?;
    let in_floats = [&i1, &i2].iter().any(|frame| frame.format().depth == Depth::F32);
    check_places(arguments, lens.is_some(), in_floats)?;
    let scope = arguments.scope.fitting([i1.width(), i1.height()])?;
    if let Some(size) = arguments.scope.size((i1.width(), i1.height())) {
        arguments.measure.wanted().check(size)?;
    }
    Ok(Some(Photographs { frames: [i1, i2], inputs, scope, lens, decode }))
}

/// Writes the results; tells the report, and which files.
pub(super) fn write(
    arguments: &Arguments,
    settings: &Settings,
    device: &DeviceInfo,
    photographs: Photographs,
    Scoped { solution, gain_field }: &Scoped,
) -> Result<(Report, Vec<&'static str>), Failure> {
    let nearer = lens::nearer(arguments.nearer, photographs.lens.as_ref())?;
    let request = request(arguments, settings);
    let settings = &photographs.settings(settings);
    let (width, blur, uncertainty) = (solution.width, &solution.relative_blur, &solution.uncertainty);
    let metric = photographs.lens.map(|lens| {
        MetricDepth::new(&lens, solution.transform.scale, settings.max_relative_blur, width, blur, uncertainty)
    });
    let wanted = arguments.measure.wanted();
    let measurements = wanted.measure(width, blur, uncertainty, metric.as_ref())?;
    let frames = photographs.frames;
    let formats = frames.each_ref().map(Frame::format);
    let mut report = Report::new(solution, settings, device, nearer);
    report.of(photographs.inputs, super::validation_asked());
    let texture = Texture::of(solution, arguments.scope.max_uncertainty());
    report.texture = TextureReport::of(&texture);
    report.gain_field = gain_field.as_ref().map(GainField::range);
    report.flattened = photographs.scope.flat.is_some();
    report.request = request;
    report.depth = metric.as_ref().map(DepthReport::from);
    report.measurements = (!wanted.is_empty()).then(|| measurements.clone());
    // What was filled in is no measurement, and is not handed on as one.
    let measured = Solution { relative_blur: texture.without(blur), ..solution.clone() };
    let measured_metric =
        metric.as_ref().map(|metric| MetricDepth { depth: texture.without(&metric.depth), ..metric.clone() });
    let depth16 = arguments.models.depth16(&measured, measured_metric.as_ref());
    report.depth16 = depth16.as_ref().map(Depth16::report);
    let look = Look { nearer, decode: settings.decode, formats, palette: arguments.colors.palette(), pen: Some(PEN) };
    // Which photograph is the sharper V tells before a flat reference is taken off.
    let sharpness = photographs.scope.flat.as_ref().map(|flat| flat.restored(solution));
    let fused = export::fused(solution, settings.decode)?;
    let points = arguments.models.points(&measured, &fused, nearer)?;
    let mut extras = arguments.models.files(points.as_ref(), &fused);
    extras.extend(depth16.iter().flat_map(Depth16::files));
    extras.extend(arguments.models.labels(sharpness.as_ref().unwrap_or(solution)));
    extras.extend(export::fused_float(solution, &look));
    let mut written: Vec<&str> = FILES.into_iter().chain(extras.iter().map(|extra| extra.name())).collect();
    written.extend(metric.as_ref().map(|_| DEPTH_FILE));
    written.extend((!arguments.no_html).then_some(PAGE_FILE));
    report.files = written.iter().map(ToString::to_string).chain(wanted.files()).collect();
    if !arguments.no_html {
        let names = [&arguments.pair.i1, &arguments.pair.i2].map(|path| name(path));
        let depth = metric.as_ref();
        let photographs = frames.each_ref();
        let (decode, palette, fields) = (settings.decode, look.palette, vec![residual(solution)]);
        let page = Page { photographs, names, decode, nearer, depth, palette, fields };
        extras.push(page.file(solution, &report));
    }
    let additions = Additions { depth: metric.as_ref(), measurements, extras };
    export::write(arguments.force.to(&arguments.output), solution, &report, &look, additions)?;
    Ok((report, written))
}

/// What neither blur nor registration explains, for the page.
fn residual(solution: &Solution) -> Readout<'_> {
    Readout::new("residual", "Residual", "residual", &solution.residual)
        .digits(5)
        .logarithmic()
        .ends(["explained", "not"])
        .note(
            "What neither blur nor registration explains around each pixel, in intensities with white at 1: large where \
             something moved between the photographs or shone differently. On a logarithmic scale.",
        )
}

/// SHA-256 of everything but the photographs that decides the results: the version, the settings with what the files
/// that they name hold, and the flags.
pub(super) fn request(arguments: &Arguments, settings: &Settings) -> String {
    let (output, force) = (PathBuf::new(), ForceArgument::default());
    let flags = Arguments { output, force, pair: arguments.pair.deciding(), ..arguments.clone() };
    let lens = arguments.lens.file().and_then(|file| fs::read(file).ok());
    let files = arguments.scope.contents();
    let text = format!("{} {settings:?} {flags:?} {lens:?} {files:?}", env!("CARGO_PKG_VERSION"));
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn tell(report: &Report, written: &[&str], arguments: &Arguments) -> Result<(), Failure> {
    let summary = summary(report, arguments.colors.palette(), &arguments.output, written);
    arguments.pair.common.told.tell(&summary, || report.to_json())
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use parfocal::Photometric;

    use super::*;
    use crate::cli::{Cli, Command};

    const T: &str = r#"{"tx_px": 3, "ty_px": 4, "rotation_deg": 0, "scale": 1}"#;

    fn with_exposure() -> String {
        format!(r#"{{"transform": {T}, "photometric": {{"gain": 1.2, "offset": 0.1}}}}"#)
    }

    fn parse(extra: &[&str]) -> Box<Arguments> {
        let arguments = ["parfocal", "solve", "a.png", "b.png", "-o", "out"].iter().chain(extra);
        match Cli::try_parse_from(arguments).unwrap().command {
            Command::Solve(arguments) => arguments,
            other => panic!("{other:?}"),
        }
    }

    fn with_file(extra: &[&str], json: &str) -> Settings {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("report.json");
        fs::write(&file, json).unwrap();
        let all = ["--transform", file.to_str().unwrap()].into_iter().chain(extra.iter().copied());
        settings(&parse(&all.collect::<Vec<_>>())).unwrap()
    }

    #[test]
    fn without_flags_the_settings_are_those_of_the_library() {
        assert_eq!(settings(&parse(&[])).unwrap(), Settings::default());
    }

    #[test]
    fn a_transform_is_a_start_and_hold_keeps_it() {
        let start = with_file(&[], &with_exposure());
        assert_eq!((start.method, start.photometric, start.start.tx), (Method::Unified, true, 3.0));
        assert_eq!(start.start_photometric.gain, 1.2);
        let held = with_file(&["--hold"], &with_exposure());
        assert_eq!((held.method, held.photometric, held.start.ty), (Method::Aligned, false, 4.0));
        let exposure_not_stated = with_file(&["--hold"], T);
        assert_eq!((exposure_not_stated.method, exposure_not_stated.photometric), (Method::Aligned, true));
        let aligned = with_file(&["--method", "aligned"], &with_exposure());
        assert_eq!((aligned.method, aligned.photometric, aligned.start.tx), (Method::Aligned, true, 3.0));
    }

    #[test]
    fn an_exposure_by_flag_is_held_and_goes_before_a_file() {
        let found = settings(&parse(&["--gain", "1.1"])).unwrap();
        assert_eq!((found.photometric, found.start_photometric), (false, Photometric { gain: 1.1, offset: 0.0 }));
        let found = with_file(&["--offset", "-0.02"], &with_exposure());
        assert_eq!((found.photometric, found.start_photometric), (false, Photometric { gain: 1.0, offset: -0.02 }));
        assert!(settings(&parse(&["--gain", "0"])).is_err());
    }

    #[test]
    fn hash_and_pixels_are_of_one_file_even_if_another_takes_its_name() {
        let folder = tempfile::TempDir::new().unwrap();
        let [file, new] = ["a.pgm", "new.pgm"].map(|name| folder.path().join(name));
        fs::write(&file, b"P5 2 1 255 \x01\x02").unwrap();
        let mut arguments = parse(&[]);
        (arguments.pair.i1, arguments.pair.i2) = (file.clone(), file.clone());
        let whole = read(&arguments, |_| false).unwrap().unwrap();
        let swapped = read(&arguments, |_| {
            fs::write(&new, b"P5 1 2 255 \x03\x04").unwrap();
            fs::rename(&new, &file).unwrap();
            false
        });
        let swapped = swapped.unwrap().unwrap();
        assert_eq!((swapped.frames, swapped.inputs), (whole.frames, whole.inputs));
        assert_eq!(read(&arguments, |_| false).unwrap().unwrap().frames[0].height(), 2);
    }

    #[test]
    fn every_method_has_its_name() {
        for method in [Method::Unified, Method::Aligned, Method::Appearance, Method::Sift] {
            assert_eq!(settings(&parse(&["--method", method.name()])).unwrap().method, method);
        }
    }
}
