//! `parfocal simulate`: renders a synthetic pair or focus sweep with its ground truth.

use std::path::PathBuf;

use clap::ValueEnum;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use parfocal::export::SIMULATED_FILES;
use parfocal::internals::scene::{
    Kernel, PairField, Preset, Scene, Shape, SweepField, SweepScene, Truth, simulated_files, simulated_sweep_files,
    write_simulated, write_simulated_sweep,
};

use crate::cli::options::lens::{LensArguments, PartOfLens};
use crate::cli::options::part::numbers;
use crate::cli::options::run::ReportArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Render a synthetic pair with known relative blur, depth and registration, or with --frames a focus sweep
///
/// All images are made from one radiance. Each pixel is blurred by the exact, continuous kernel of its variance;
/// nothing is resampled, and no code is shared with the solver. The blur is a gather, which ignores occlusion. Only
/// card, blocks and bars are traced ray by ray, with occlusion.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Scene to render
    #[arg(value_parser = scene_parser())]
    scene: SceneName,
    /// Folder for the results; earlier results in it are replaced
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArgument,
    /// Width and height of the images, px [default: 512x512; plane and half-gaussian 256x256; image: that of the
    /// radiance]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Seed of texture, dots, relief and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Seed of the noise alone, for repeated photographs of one scene [default: --seed]
    #[arg(long, value_name = "N")]
    noise_seed: Option<u64>,
    #[command(flatten)]
    report: ReportArguments,

    /// Shape of the blur [default: gaussian; pillbox for card, blocks and bars; half-gaussian for the scenes of that
    /// name]
    #[arg(long, value_enum, help_heading = BLUR)]
    kernel: Option<Kernel>,
    /// Largest |V| of plane, steps and relief (px², 0 to 256) [default: 4, 6 and 8]
    #[arg(long, value_name = "PX2", help_heading = BLUR)]
    range: Option<f64>,
    /// σ of the blur of I2 in the half-gaussian scenes, or if negative of I1 (px, -16 to 16) [default: 2.5]
    #[arg(long, value_name = "PX", help_heading = BLUR)]
    sigma: Option<f64>,
    /// Blur of all images even in focus (px², 0 to 16) [default: 0.3; 0 for the half-gaussian scenes]
    #[arg(long, value_name = "PX2", help_heading = BLUR)]
    base_blur: Option<f64>,

    /// σ of Gaussian noise, added to all images last (0 to 1; white is 1)
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0, help_heading = INTENSITIES)]
    noise: f64,
    /// Gain of I2: I2 <- G I2 + O; `solve --gain` is its inverse
    #[arg(long, value_name = "G", default_value_t = 1.0, help_heading = INTENSITIES)]
    i2_gain: f64,
    /// Offset of I2, added after the gain
    #[arg(long, value_name = "O", default_value_t = 0.0, help_heading = INTENSITIES)]
    i2_offset: f64,
    /// Range of intensities around 0.5 (at most 1)
    #[arg(long, value_name = "C", default_value_t = 0.9, help_heading = INTENSITIES)]
    contrast: f64,

    /// Translation of T to the right and down, px [default: 1.3,-0.9; half-gaussian 1.5,-0.7]
    #[arg(long, value_name = "TX,TY", help_heading = MISALIGNMENT, allow_hyphen_values = true,
          value_parser = translation)]
    translation: Option<[f64; 2]>,
    /// Rotation of T, degrees, positive from x (right) to y (down); of a sweep from the first frame to the last
    /// [default: 0.15; half-gaussian 0.1]
    #[arg(long, value_name = "DEG", help_heading = MISALIGNMENT)]
    rotation: Option<f64>,
    /// Scale of T (0.2 to 5) [default: 1.01; half-gaussian 1.005; with a lens, its breathing]
    #[arg(long, value_name = "S", help_heading = MISALIGNMENT)]
    scale: Option<f64>,

    /// By how much a camera that moved displaces near against far things in I2, or from the first to the last frame of a
    /// sweep, px to the right and down (-40 to 40), for card, blocks and bars [default: 0,0]
    #[arg(long, value_name = "X,Y", help_heading = MISALIGNMENT, allow_hyphen_values = true, value_parser = translation)]
    camera_moves: Option<[f64; 2]>,

    /// Picture on the surface, grey or colour: PNG, JPEG, TIFF, PNM or EXR
    #[arg(long, value_name = "FILE", help_heading = FILES)]
    radiance: Option<PathBuf>,
    /// Depth, for a stated lens: one channel, in units of --depth-unit
    #[arg(long, value_name = "FILE", help_heading = FILES, conflicts_with = "relative_blur")]
    depth: Option<PathBuf>,
    /// Unit of --depth, mm
    #[arg(long, value_name = "MM", default_value_t = 1.0, help_heading = FILES)]
    depth_unit: f64,
    /// V instead of depth, px² of I1, positive where I2 is more blurred: one channel, EXR or TIFF in floats
    #[arg(long, value_name = "FILE", help_heading = FILES)]
    relative_blur: Option<PathBuf>,

    #[command(flatten)]
    lens: LensArguments,

    #[command(flatten)]
    sweep: SweepArguments,
}

// Headings of the options.
const BLUR: &str = "Blur";
const INTENSITIES: &str = "Intensities";
const MISALIGNMENT: &str = "Misalignment: I2(T x) lies over I1(x)";
const FILES: &str = "Files, for the scene image";
const SWEEP: &str = "Focus sweep";

/// The options of a sweep.
#[derive(clap::Args, Debug)]
struct SweepArguments {
    /// Render a sweep of N frames (3 to 999) instead of a pair
    ///
    /// Frame k, from 0, is focused at setting k. The scene lies between 0.1 and 0.9 of the range of settings.
    #[arg(long, value_name = "N", help_heading = SWEEP)]
    frames: Option<usize>,
    /// c, px² per squared setting: a point in focus at u has the blur c (k - u)² in frame k [default: 36/(N - 1)²]
    #[arg(long, value_name = "PX2", help_heading = SWEEP, requires = "frames")]
    blur_rate: Option<f64>,
    /// Magnification from the first frame, which is focused nearest, to the last (-20 to 20 %) [default: -1]
    #[arg(long, value_name = "PERCENT", help_heading = SWEEP, requires = "frames")]
    breathing: Option<f64>,
    /// Movement from the first frame to the last, on a smooth path (0 to 1000 px) [default: 2]
    #[arg(long, value_name = "PX", help_heading = SWEEP, requires = "frames")]
    drift: Option<f64>,
    /// Linear drift of the gain to either side of the middle frame (-50 to 50 %) [default: 0]
    #[arg(long, value_name = "PERCENT", help_heading = SWEEP, requires = "frames")]
    gain_drift: Option<f64>,
    /// Vignetting of the corners in the last frame, with the opposite sign in the first (-50 to 50 %) [default: 0]
    #[arg(long, value_name = "PERCENT", help_heading = SWEEP, requires = "frames")]
    vignetting: Option<f64>,
}

/// The default rotation, degrees, like that of a pair.
const ROTATION: f64 = 0.15;

impl SweepArguments {
    /// The requested sweep, if any. `rotation` is in degrees.
    fn of(&self, scene: &Scene, rotation: Option<f64>) -> Option<SweepScene> {
        let sweep = SweepScene::new(scene.clone(), self.frames?);
        Some(SweepScene {
            blur_rate: self.blur_rate.unwrap_or(sweep.blur_rate),
            breathing: self.breathing.unwrap_or(-1.0) / 100.0,
            drift: self.drift.unwrap_or(2.0),
            rotation: rotation.unwrap_or(ROTATION).to_radians(),
            gain_drift: self.gain_drift.unwrap_or(0.0) / 100.0,
            vignetting: self.vignetting.unwrap_or(0.0) / 100.0,
            ..sweep
        })
    }
}

const AFTER_HELP: &str = "\
Results of a pair:
  i1.png, i2.png     the pair, 16 bits, grey or as the radiance; samples outside 0 to 1 are clipped and counted
  relative_blur.exr  V at each pixel of I1, px² of I1: V2/s² - V1, positive where I2 is more blurred
  depth.exr          depth at each pixel of I1, mm; only of scenes with a lens
  truth.json         T, gain and offset, which map I2 onto I1, and the options; solve --transform reads it

Results of a sweep:
  frame_01.png ...   the frames in the order of their focus, 16 bits
  focus.exr          the setting, from 0 for the first frame, at which each pixel of the middle frame is in focus
  truth.json         position, T, gain, offset and vignetting of each frame, c, and the options

Intensities lie in 0.05 to 0.95 before exposure and noise, so that --i2-gain 0.9 --i2-offset 0.05 clips nothing.

Examples:
  parfocal simulate plane -o plane --noise 0.003
  parfocal solve plane/i1.png plane/i2.png -o plane/out
  parfocal solve plane/i1.png plane/i2.png -o plane/held --transform plane/truth.json --hold
  parfocal simulate image -o mine --radiance photo.png --relative-blur v.exr --kernel pillbox
  parfocal simulate relief -o sweep --frames 11 --breathing 5 --drift 10 --gain-drift 5 --noise 0.005
  parfocal simulate image -o metric --radiance photo.png --depth depth16.png --depth-unit 0.01 \\
    --focal-length 50 --f-number 2.8 --pixel-pitch 0.006 --focus 400,450

Exit status: 0 done, 1 failed, 2 wrong usage.";

/// A preset; `None` for the scene image, a picture and a shape from files.
#[derive(Clone, Copy, Debug)]
struct SceneName(Option<Preset>);

fn scene_parser() -> impl TypedValueParser<Value = SceneName> {
    let image = PossibleValue::new("image").help("A picture and a shape of your own, from files");
    let presets = Preset::value_variants().iter().filter_map(ValueEnum::to_possible_value);
    PossibleValuesParser::new(presets.chain([image])).map(|name| SceneName(Preset::from_str(&name, false).ok()))
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let size = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    size.ok_or_else(|| "give width and height, as in 640x480".to_string())
}

fn translation(text: &str) -> Result<[f64; 2], String> {
    numbers(text).ok_or_else(|| "give two numbers, as in 1.5,-0.7".to_string())
}

/// The file of the ground truth, which lists the files.
const TRUTH: &str = SIMULATED_FILES[4];

/// Renders and writes a scene.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let scene = scene(arguments)?;
    if let Some(sweep) = arguments.sweep.of(&scene, arguments.rotation) {
        return run_sweep(arguments, &sweep);
    }
    scene.check()?;
    check_output(arguments, &SIMULATED_FILES, &simulated_files(scene.lens().is_some()))?;
    let simulated = scene.render()?;
    let truth = Truth::<PairField>::new(&scene, &simulated);
    write_simulated(arguments.force.to(&arguments.output), &simulated, &truth)?;
    arguments.report.print(&summary(arguments, &truth, pair_lines(&truth)), &truth)
}

fn run_sweep(arguments: &Arguments, sweep: &SweepScene) -> Result<(), Failure> {
    sweep.check()?;
    let files = simulated_sweep_files(sweep.frames);
    let files: Vec<&str> = files.iter().map(String::as_str).collect();
    check_output(arguments, &files, &files)?;
    let simulated = sweep.render()?;
    let truth = Truth::<SweepField>::new(sweep, &simulated);
    write_simulated_sweep(arguments.force.to(&arguments.output), &simulated, &truth)?;
    arguments.report.print(&summary(arguments, &truth, sweep_lines(&truth)), &truth)
}

/// Refuses an output folder where one of the `possible` files would replace an input, or one of the `written` files
/// one of another program.
fn check_output(arguments: &Arguments, possible: &[&str], written: &[&str]) -> Result<(), Failure> {
    let files = [&arguments.radiance, &arguments.depth, &arguments.relative_blur].into_iter().flatten();
    let inputs: Vec<&PathBuf> = files.chain(arguments.lens.file()).collect();
    destination::check(&arguments.output, TRUTH, possible, &inputs)?;
    Ok(arguments.force.to(&arguments.output).check_results(TRUTH, written)?)
}

fn scene(arguments: &Arguments) -> Result<Scene, Failure> {
    check_applicable(arguments)?;
    // Only a file states a field.
    let bowed = arguments.lens.stated()?.and_then(|lens| lens.field).and(arguments.lens.file());
    if let Some(file) = bowed {
        let problem = "the lens has a field, which simulate does not render; give a file without it";
        return Err(Failure::Usage(format!("{}: {problem}", file.display())));
    }
    let mut scene = match arguments.scene.0 {
        Some(preset) => preset.scene(),
        None => image(arguments)?,
    };
    match &mut scene.shape {
        Shape::Plane { limit } | Shape::Steps { limit } | Shape::Relief { limit } => set(limit, arguments.range),
        Shape::Uniform { variance } => set(variance, arguments.sigma.map(|s| s.powi(2).copysign(s))),
        Shape::Cylinders { lens } | Shape::Layers { lens, .. } => {
            *lens = arguments.lens.lens((*lens).into())?.unwrap_or(*lens);
            scene.transform.scale = lens.breathing();
        }
        Shape::RelativeBlurFile { .. } | Shape::DepthFile { .. } => {}
    }
    let t = &mut scene.transform;
    [scene.width, scene.height] = arguments.size.unwrap_or([scene.width, scene.height]);
    [t.tx, t.ty] = arguments.translation.unwrap_or([t.tx, t.ty]);
    set(&mut t.scale, arguments.scale);
    set(&mut t.rotation, arguments.rotation.map(f64::to_radians));
    scene.camera_moves = arguments.camera_moves.unwrap_or_default();
    set(&mut scene.base_blur, arguments.base_blur);
    scene.kernel = arguments.kernel.unwrap_or(scene.kernel);
    scene.exposure.gain = arguments.i2_gain;
    scene.exposure.offset = arguments.i2_offset;
    let Arguments { seed, noise_seed, noise, contrast, .. } = *arguments;
    Ok(Scene { seed, noise_seed, noise, contrast, ..scene })
}

fn set(field: &mut f64, value: Option<f64>) {
    *field = value.unwrap_or(*field);
}

/// The scene from files.
fn image(arguments: &Arguments) -> Result<Scene, Failure> {
    let Some(radiance) = &arguments.radiance else {
        return Err(Failure::Usage("the scene image needs --radiance FILE".to_string()));
    };
    let shape = match (&arguments.depth, &arguments.relative_blur) {
        (_, Some(path)) => Shape::RelativeBlurFile { path: path.clone() },
        (Some(path), None) => {
            let missing =
                || Failure::Usage("--depth needs the lens: --lens FILE, or --focal-length and so on".to_string());
            let lens = arguments.lens.lens(PartOfLens::default())?.ok_or_else(missing)?;
            Shape::DepthFile { path: path.clone(), unit: arguments.depth_unit, lens }
        }
        (None, None) => {
            let problem = "the scene image needs a shape: --depth FILE with a lens, or --relative-blur FILE";
            return Err(Failure::Usage(problem.to_string()));
        }
    };
    Ok(Scene::image(radiance, shape)?)
}

/// Refuses options that do not apply to the scene: they would have no effect.
fn check_applicable(arguments: &Arguments) -> Result<(), Failure> {
    use Preset::*;
    let (a, preset, is_image) = (arguments, arguments.scene.0, arguments.scene.0.is_none());
    let files = a.radiance.is_some() || a.depth.is_some() || a.relative_blur.is_some();
    let has_range = matches!(preset, Some(Plane | Steps | Relief));
    let is_uniform = matches!(preset, Some(HalfGaussianTexture | HalfGaussianDots));
    let has_lens = matches!(preset, Some(Cylinders | Card | Blocks | Bars)) || (is_image && a.depth.is_some());
    let has_layers = matches!(preset, Some(Card | Blocks | Bars));
    let exposure = a.i2_gain != 1.0 || a.i2_offset != 0.0;
    let (is_pair, pairs) = (a.sweep.frames.is_none(), "pairs, not for a sweep");
    for (given, applies, option, scenes) in [
        (a.range.is_some(), has_range, "--range", "plane, steps and relief"),
        (a.sigma.is_some(), is_uniform, "--sigma", "the half-gaussian scenes"),
        (a.size.is_some(), !is_image, "--size", "scenes other than image, which has the size of its radiance"),
        (files, is_image, "--radiance, --depth and --relative-blur", "image"),
        (a.lens.is_given(), has_lens, "the lens", "cylinders, card, blocks and bars, and for image with --depth"),
        (a.camera_moves.is_some(), has_layers, "--camera-moves", "card, blocks and bars"),
        (a.range.is_some(), is_pair, "--range", pairs),
        (a.lens.is_given(), is_pair || is_image, "the lens", pairs),
        (a.translation.is_some(), is_pair, "--translation", "pairs; a sweep has --drift"),
        (a.scale.is_some(), is_pair, "--scale", "pairs; a sweep has --breathing"),
        (exposure, is_pair, "--i2-gain and --i2-offset", "pairs; a sweep has --gain-drift and --vignetting"),
    ] {
        if given && !applies {
            return Err(Failure::Usage(format!("{option} is for {scenes}; leave it out")));
        }
    }
    Ok(())
}

/// The summary: scene, size and seed, some `lines`, a warning about clipped samples, and the folder.
fn summary<F>(arguments: &Arguments, truth: &Truth<F>, lines: Vec<String>) -> String {
    let (is_sweep, size) = (arguments.sweep.frames.is_some(), truth.size);
    let count = if is_sweep { format!("{} frames of ", truth.frames.len()) } else { String::new() };
    let mut all = vec![format!("{}, {count}{}x{} px, seed {}", truth.scene, size.width, size.height, truth.seed)];
    all.extend(lines);
    if truth.clipped_samples > 0 {
        let option = if is_sweep { "--gain-drift" } else { "--i2-gain" };
        all.push(format!(
            "warning: {} samples are outside 0 to 1 and were clipped: lower --contrast, {option} or --noise",
            truth.clipped_samples
        ));
    }
    all.push(format!("in {}", arguments.output.display()));
    all.join("\n")
}

fn pair_lines(truth: &Truth<PairField>) -> Vec<String> {
    let (t, v) = (&truth.frames[1].transform, &truth.field.relative_blur);
    vec![
        format!("T: ({}, {}) px, {:.6}°, scale {:.6}", t.tx, t.ty, t.rotation_deg(), t.scale),
        format!("V: {:.3} to {:.3} px²", v.min.unwrap_or(0.0), v.max.unwrap_or(0.0)),
    ]
}

fn sweep_lines(truth: &Truth<SweepField>) -> Vec<String> {
    let focus = &truth.field.focus;
    let ends = [&truth.frames[0], &truth.frames[truth.frames.len() - 1]].map(|frame| {
        let t = &frame.transform;
        let at = format!("({:.3}, {:.3}) px, {:.4}°, scale {:.5}", t.tx, t.ty, t.rotation_deg(), t.scale);
        format!("{}: T {at}, gain {:.4}", frame.file, frame.exposure.gain)
    });
    let mut lines = vec![
        format!("in focus: settings {:.3} to {:.3}", focus.min.unwrap_or(0.0), focus.max.unwrap_or(0.0)),
        format!("blur: {:.4} px² a squared setting from the focus", truth.field.blur_rate_px2),
    ];
    lines.extend(ends);
    lines
}
