//! `parfocal simulate`: renders a synthetic pair or focus sweep with its ground truth.

mod sweep;

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::ValueEnum;
use parfocal::export::SIMULATED_FILES;
use parfocal::internals::scene::{Kernel, Preset, Scene, Shape};
use parfocal::internals::scene::{PairField, Truth, simulated_files, write_simulated};
use parfocal::transform::Similarity;

use self::sweep::SweepArguments;
use crate::cli::options::lens::{LensArguments, PartOfLens};
use crate::cli::options::output::ReportArguments;
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
    #[arg(value_enum)]
    scene: SceneName,
    /// Folder for the results; earlier results in it are replaced
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArgument,
    /// Width and height of the images, px [default: 512x512; plane and half-gaussian 256x256; image: that of the
    /// radiance]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Seed of texture, dots, relief and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    report: ReportArguments,

    /// Shape of the blur [default: gaussian; pillbox for card, blocks and bars; half-gaussian for the scenes of that
    /// name]
    #[arg(long, value_enum, help_heading = "Blur")]
    kernel: Option<Kernel>,
    /// Largest |V| of plane, steps and relief (px², 0 to 256) [default: 4, 6 and 8]
    #[arg(long, value_name = "PX2", help_heading = "Blur", allow_negative_numbers = true)]
    range: Option<f64>,
    /// σ of the blur of I2 in the half-gaussian scenes, or if negative of I1 (px, -16 to 16) [default: 2.5]
    #[arg(long, value_name = "PX", help_heading = "Blur", allow_negative_numbers = true)]
    sigma: Option<f64>,
    /// Blur of all images even in focus (px², 0 to 16) [default: 0.3; 0 for the half-gaussian scenes]
    #[arg(long, value_name = "PX2", help_heading = "Blur", allow_negative_numbers = true)]
    base_blur: Option<f64>,

    /// σ of Gaussian noise, added to all images last (0 to 1; white is 1)
    #[arg(
        long,
        value_name = "SIGMA",
        default_value_t = 0.0,
        help_heading = "Intensities",
        allow_negative_numbers = true
    )]
    noise: f64,
    /// Gain of I2: I2 <- G I2 + O; `solve --gain` is its inverse
    #[arg(long, value_name = "G", default_value_t = 1.0, help_heading = "Intensities", allow_negative_numbers = true)]
    i2_gain: f64,
    /// Offset of I2, added after the gain
    #[arg(long, value_name = "O", default_value_t = 0.0, help_heading = "Intensities", allow_negative_numbers = true)]
    i2_offset: f64,
    /// Range of intensities around 0.5 (at most 1)
    #[arg(long, value_name = "C", default_value_t = 0.9, help_heading = "Intensities", allow_negative_numbers = true)]
    contrast: f64,

    /// Translation of T to the right and down, px [default: 1.3,-0.9; half-gaussian 1.5,-0.7]
    #[arg(
        long,
        value_name = "TX,TY",
        help_heading = "Misalignment: I2(T x) lies over I1(x)",
        allow_hyphen_values = true
    )]
    translation: Option<Pair>,
    /// Rotation of T, degrees, positive from x (right) to y (down); of a sweep from the first frame to the last
    /// [default: 0.15; half-gaussian 0.1]
    #[arg(
        long,
        value_name = "DEG",
        help_heading = "Misalignment: I2(T x) lies over I1(x)",
        allow_negative_numbers = true
    )]
    rotation: Option<f64>,
    /// Scale of T (0.2 to 5) [default: 1.01; half-gaussian 1.005; with a lens, its breathing]
    #[arg(
        long,
        value_name = "S",
        help_heading = "Misalignment: I2(T x) lies over I1(x)",
        allow_negative_numbers = true
    )]
    scale: Option<f64>,

    /// Picture on the surface, grey or colour: PNG, JPEG, TIFF, PNM or EXR
    #[arg(long, value_name = "FILE", help_heading = "Files, for the scene image")]
    radiance: Option<PathBuf>,
    /// Depth, for a stated lens: one channel, in units of --depth-unit
    #[arg(long, value_name = "FILE", help_heading = "Files, for the scene image", conflicts_with = "relative_blur")]
    depth: Option<PathBuf>,
    /// Unit of --depth, mm
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 1.0,
        help_heading = "Files, for the scene image",
        allow_negative_numbers = true
    )]
    depth_unit: f64,
    /// V instead of depth, px² of I1, positive where I2 is more blurred: one channel, EXR or TIFF in floats
    #[arg(long, value_name = "FILE", help_heading = "Files, for the scene image")]
    relative_blur: Option<PathBuf>,

    #[command(flatten)]
    lens: LensArguments,

    #[command(flatten)]
    sweep: SweepArguments,
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

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SceneName {
    /// Slanted plane: V falls from left to right
    Plane,
    /// I2 under an asymmetric kernel, on a texture: the paper's asymmetric test
    HalfGaussianTexture,
    /// The same on random dots of 4 px, black and white: the most difficult scene
    HalfGaussianDots,
    /// Two cylinders in front of a plane, through a thin lens that breathes: 50 mm, f/5.6, pixels of 0.0075 mm, focused
    /// at 226.5 and 233.5 mm
    Cylinders,
    /// Seven terraces of constant V
    Steps,
    /// Hills and hollows with steep sides
    Relief,
    /// A near card over a far ground, through the lens of the cylinders, with occlusion; the seed places it
    Card,
    /// Plates at eight heights, with the lens and occlusion of card
    Blocks,
    /// Thin bars, 4 to 30 px, with the lens and occlusion of card
    Bars,
    /// A picture and a shape of your own, from files
    Image,
}

impl SceneName {
    fn preset(self) -> Option<Preset> {
        Some(match self {
            Self::Plane => Preset::Plane,
            Self::HalfGaussianTexture => Preset::HalfGaussianTexture,
            Self::HalfGaussianDots => Preset::HalfGaussianDots,
            Self::Cylinders => Preset::Cylinders,
            Self::Steps => Preset::Steps,
            Self::Relief => Preset::Relief,
            Self::Card => Preset::Card,
            Self::Blocks => Preset::Blocks,
            Self::Bars => Preset::Bars,
            Self::Image => return None,
        })
    }
}

/// Width and height.
#[derive(Clone, Copy, Debug)]
struct Size(u32, u32);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('x').and_then(|(w, h)| Some(Self(w.parse().ok()?, h.parse().ok()?)));
        parsed.ok_or_else(|| "give width and height, as in 640x480".to_string())
    }
}

/// Two numbers.
#[derive(Clone, Copy, Debug)]
struct Pair(f64, f64);

impl FromStr for Pair {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once(',').and_then(|(a, b)| Some(Self(a.trim().parse().ok()?, b.trim().parse().ok()?)));
        parsed.ok_or_else(|| "give two numbers, as in 1.5,-0.7".to_string())
    }
}

/// The file of the ground truth, which lists the files.
const TRUTH: &str = SIMULATED_FILES[4];

/// Renders and writes a scene.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let scene = scene(arguments)?;
    let out = arguments.force.to(&arguments.output);
    if let Some(sweep) = arguments.sweep.of(&scene, arguments.rotation) {
        return sweep::run(&sweep, out, &inputs(arguments), &arguments.report);
    }
    scene.check()?;
    destination::check(&arguments.output, TRUTH, &SIMULATED_FILES, &inputs(arguments))?;
    out.check_results(TRUTH, &simulated_files(scene.lens().is_some()))?;
    let simulated = scene.render()?;
    let truth = Truth::<PairField>::new(&scene, &simulated);
    write_simulated(out, &simulated, &truth)?;
    arguments.report.print(&summary(&truth, &arguments.output), || truth.to_json())
}

fn scene(arguments: &Arguments) -> Result<Scene, Failure> {
    check_applicable(arguments)?;
    let mut scene = match arguments.scene.preset() {
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
    if let Some(Size(width, height)) = arguments.size {
        (scene.width, scene.height) = (width, height);
    }
    if let Some(kernel) = arguments.kernel {
        scene.kernel = kernel;
    }
    set(&mut scene.base_blur, arguments.base_blur);
    scene.transform = transform(scene.transform, arguments);
    scene.exposure.gain = arguments.i2_gain;
    scene.exposure.offset = arguments.i2_offset;
    Ok(Scene { seed: arguments.seed, noise: arguments.noise, contrast: arguments.contrast, ..scene })
}

fn set(field: &mut f64, value: Option<f64>) {
    *field = value.unwrap_or(*field);
}

fn transform(mut t: Similarity, arguments: &Arguments) -> Similarity {
    if let Some(Pair(x, y)) = arguments.translation {
        (t.tx, t.ty) = (x, y);
    }
    set(&mut t.scale, arguments.scale);
    set(&mut t.rotation, arguments.rotation.map(f64::to_radians));
    t
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
    use SceneName::*;
    let a = arguments;
    let files = a.radiance.is_some() || a.depth.is_some() || a.relative_blur.is_some();
    let has_lens = matches!(a.scene, Cylinders | Card | Blocks | Bars) || (a.scene == Image && a.depth.is_some());
    let (is_pair, pairs) = (!a.sweep.is_given(), "pairs, not for a sweep");
    for (given, applies, option, scenes) in [
        (a.range.is_some(), matches!(a.scene, Plane | Steps | Relief), "--range", "plane, steps and relief"),
        (
            a.sigma.is_some(),
            matches!(a.scene, HalfGaussianTexture | HalfGaussianDots),
            "--sigma",
            "the half-gaussian scenes",
        ),
        (a.size.is_some(), a.scene != Image, "--size", "scenes other than image, which has the size of its radiance"),
        (files, a.scene == Image, "--radiance, --depth and --relative-blur", "image"),
        (a.lens.is_given(), has_lens, "the lens", "cylinders, card, blocks and bars, and for image with --depth"),
        (a.range.is_some(), is_pair, "--range", pairs),
        (a.lens.is_given(), is_pair || a.scene == Image, "the lens", pairs),
        (a.translation.is_some(), is_pair, "--translation", "pairs; a sweep has --drift"),
        (a.scale.is_some(), is_pair, "--scale", "pairs; a sweep has --breathing"),
        (
            a.i2_gain != 1.0 || a.i2_offset != 0.0,
            is_pair,
            "--i2-gain and --i2-offset",
            "pairs; a sweep has --gain-drift and --vignetting",
        ),
    ] {
        if given && !applies {
            return Err(Failure::Usage(format!("{option} is for {scenes}; leave it out")));
        }
    }
    Ok(())
}

/// The input files.
fn inputs(arguments: &Arguments) -> Vec<&PathBuf> {
    let files = [&arguments.radiance, &arguments.depth, &arguments.relative_blur].into_iter().flatten();
    files.chain(arguments.lens.file()).collect()
}

fn summary(truth: &Truth<PairField>, output: &Path) -> String {
    let (t, v) = (&truth.frames[1].transform, &truth.field.relative_blur);
    let mut lines = vec![
        format!("{}, {}x{} px, seed {}", truth.scene, truth.size.width, truth.size.height, truth.seed),
        format!("T: ({}, {}) px, {:.6}°, scale {:.6}", t.tx, t.ty, t.rotation_deg(), t.scale),
        format!("V: {:.3} to {:.3} px²", v.min.unwrap_or(0.0), v.max.unwrap_or(0.0)),
    ];
    if truth.clipped_samples > 0 {
        lines.push(format!(
            "warning: {} samples are outside 0 to 1 and were clipped: lower --contrast, --i2-gain or --noise",
            truth.clipped_samples
        ));
    }
    lines.push(format!("in {}", output.display()));
    lines.join("\n")
}
