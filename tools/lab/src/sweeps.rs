//! Errors of focus sweeps with default settings, compared with shape from focus.

use std::path::Path;

use parfocal::{
    Error, Frame, Settings, SolveOptions, image_io,
    internals::scene::{Preset, Scene, SimulatedSweep, SweepScene},
    internals::{Random, brightened, luminance, median, onto},
    settings::Decode,
    sweep::{Positions, Sweep, SweepOptions, SweepSolver},
    transform::centre,
};

use crate::beside_sweeps;
use crate::errors::{BORDER, Coverage, inside, spread};
use crate::pairs::intensities;
use crate::section::{Case, Runner, Section};
use crate::shape_from_focus::shape_from_focus;

/// The heading in the report.
pub(crate) const HEADING: &str = "Focus sweeps";

/// Measures everything.
pub(crate) fn run(runner: &mut Runner, data: &Path) -> Vec<Section> {
    let mut sections = vec![generated(runner, data), simulated(runner), flat_patch(runner), fused(runner, data)];
    if !runner.quick {
        sections.push(beside_sweeps::section(runner, data));
    }
    sections
}

const ERROR: &str = "MAD, frames";
const BEYOND: &str = "off by more than a frame, %";

/// Errors of the focus u, in frames. A pixel without a result has an infinite error.
struct Errors {
    /// Median of the absolute error.
    median: f64,
    /// Share of the pixels with an error above one frame.
    beyond: f64,
    /// Share of the pixels without a result.
    unanswered: f64,
}

impl Errors {
    /// Computes the errors of u at the pixels with a known truth.
    fn of(pixels: impl Iterator<Item = (f32, f32)>) -> Self {
        let known = pixels.filter(|(_, truth)| truth.is_finite());
        let errors: Vec<f64> = known.map(|(u, truth)| f64::from(u - truth).abs()).collect();
        let share = |f: &dyn Fn(f64) -> bool| errors.iter().filter(|e| f(**e)).count() as f64 / errors.len() as f64;
        let (within, answered) = (share(&|e| e <= 1.0), share(&f64::is_finite));
        let errors: Vec<Option<f64>> = errors.iter().map(|e| e.is_finite().then_some(*e)).collect();
        Self { median: spread(&errors)[1], beyond: 1.0 - within, unanswered: 1.0 - answered }
    }

    /// Adds the errors, with a bound on the median.
    fn bounded(&self, case: Case, most: f64) -> Case {
        let case = case.at_most(ERROR, self.median, most).at_most(BEYOND, 100.0 * self.beyond, 0.2);
        case.value("no answer, %", 100.0 * self.unanswered)
    }
}

/// Solves a sweep with default settings, with values as stored.
fn solve(runner: &Runner, frames: &[Frame], positions: Vec<f64>) -> Result<Sweep, String> {
    let settings = Settings { decode: Decode::None, ..Settings::default() };
    let options = SweepOptions { settings, positions: Positions::Settings(positions), ..SweepOptions::default() };
    let solved =
        SweepSolver::new(runner.engine, &options).and_then(|mut solver| solver.solve(frames, &SolveOptions::default()));
    solved.map_err(|e| e.to_string())
}

/// Solves a sweep with the frame numbers as positions.
fn solve_counted(runner: &Runner, frames: &[Frame]) -> Result<Sweep, String> {
    solve(runner, frames, (0..frames.len()).map(|n| n as f64).collect())
}

/// Adds errors of u and the coverage by σ, over some pixels of a sweep with frame numbers as positions.
fn judge(case: Case, sweep: &Sweep, truth: &[f32], pixels: &[usize], most: f64) -> Case {
    let errors = Errors::of(pixels.iter().map(|&i| (sweep.focus[i], truth[i])));
    let error = |&i: &usize| (f64::from(sweep.focus[i] - truth[i]), f64::from(sweep.uncertainty[i]));
    Coverage::of(pixels.iter().map(error)).within(errors.bounded(case, most))
}

/// Folder of the generated stacks within the data folder.
const GENERATED: &str = "cou";
const STACKS: [&str; 3] = ["1", "2", "3"];
/// Steps between the frames that are used, and the bound on the median error, frames.
const STEPS: [(usize, f64); 4] = [(1, 0.045), (2, 0.055), (4, 0.09), (8, 0.12)];
/// The steps of a quick run.
const QUICK_STEPS: &[(usize, f64)] = STEPS.split_at(2).1;
const MOST_FRAMES: usize = 999;

/// Measures generated stacks of known focus, with all frames and with fewer.
fn generated(runner: &mut Runner, data: &Path) -> Section {
    let (stacks, steps) = if runner.quick { (&STACKS[..1], QUICK_STEPS) } else { (&STACKS[..], &STEPS[..]) };
    let cases = stacks.iter().flat_map(|name| generated_stack(runner, &data.join(GENERATED), name, steps)).collect();
    let what = "Corentin Cou's generated stacks, 41 frames of JPEG: all of them, and every 2nd, 4th and 8th, by default \
                settings; below each, shape from focus (modified Laplacian, window of σ 4 px). A pixel without an answer \
                counts as off by more than a frame.";
    Section::new("Generated stacks", what, cases)
}

fn generated_stack(runner: &mut Runner, folder: &Path, name: &str, steps: &[(usize, f64)]) -> Vec<Case> {
    let stack = match Stack::read(&folder.join(name)) {
        Ok(stack) => stack,
        Err(e) => return vec![Case::failed(format!("stack {name}"), e)],
    };
    let pixels: Vec<usize> = (0..stack.truth.len()).filter(|&i| stack.truth[i].is_finite()).collect();
    let mut cases = Vec::new();
    for (step, most) in steps {
        let (frames, positions) = stack.every(*step);
        let name = format!("stack {name}, {} frames", frames.len());
        cases.push(runner.case("sweeps", name.clone(), |runner, case| {
            let sweep = solve(runner, &frames, positions.clone())?;
            Ok(judge(case, &sweep, &stack.truth, &pixels, *most))
        }));
        cases.push(runner.case("sweeps", format!("{name}: shape from focus"), |_, case| {
            let focus = shape_from_focus(&frames, &positions, Decode::None).map_err(|e| e.to_string())?;
            let errors = Errors::of(focus.into_iter().zip(stack.truth.iter().copied()));
            Ok(case.value(ERROR, errors.median).value(BEYOND, 100.0 * errors.beyond))
        }));
    }
    cases
}

/// A generated stack.
struct Stack {
    frames: Vec<Frame>,
    /// The index of the frame in focus at each pixel; NaN if it is not known.
    truth: Vec<f32>,
}

impl Stack {
    /// Reads `image_1.jpg` and all images with consecutive numbers, and `truth.exr`.
    fn read(folder: &Path) -> Result<Self, String> {
        let file = |n: usize| folder.join(format!("image_{n}.jpg"));
        let count = (2..=MOST_FRAMES).find(|n| !file(*n).is_file()).unwrap_or(MOST_FRAMES + 1) - 1;
        let read = || {
            let (width, height, truth) = image_io::read_field(&folder.join("truth.exr"))?;
            let frames = (1..=count).map(|n| image_io::read(&file(n))).collect::<Result<Vec<Frame>, Error>>()?;
            Ok::<_, Error>((Self { frames, truth }, [width, height]))
        };
        let (stack, size) = read().map_err(|e| e.to_string())?;
        let other = stack.frames.iter().position(|frame| [frame.width(), frame.height()] != size);
        match other {
            None => Ok(stack),
            Some(n) => Err(format!("truth.exr is {size:?} px and image_{}.jpg is not", n + 1)),
        }
    }

    /// Every `step`-th frame, beginning with the first, and their indices.
    fn every(&self, step: usize) -> (Vec<Frame>, Vec<f64>) {
        let chosen = || (0..self.frames.len()).step_by(step);
        (chosen().map(|k| self.frames[k].clone()).collect(), chosen().map(|k| k as f64).collect())
    }
}

/// Number of frames of the rendered sweeps.
const FRAMES: usize = 11;

/// Measures a rendered sweep with breathing, drift, rotation, brightening and vignetting.
fn simulated(runner: &mut Runner) -> Section {
    const NOISE: f64 = 0.005;
    let mut scene = Scene { noise: NOISE, ..Preset::Relief.scene() };
    if runner.quick {
        [scene.width, scene.height] = [160, 120];
    }
    let scene = SweepScene {
        breathing: 0.05,
        drift: 10.0,
        rotation: 0.3f64.to_radians(),
        gain_drift: 0.05,
        vignetting: 0.06,
        ..SweepScene::new(scene, FRAMES)
    };
    let case = runner.case("sweeps", format!("{}, {FRAMES} frames", scene.scene.name), |runner, case| {
        let SimulatedSweep { frames, shots, focus, .. } = scene.render().map_err(|e| e.to_string())?;
        let sweep = solve(runner, &frames, shots.iter().map(|shot| shot.position).collect())?;
        let pixels: Vec<usize> = inside(sweep.width, sweep.height, BORDER).collect();
        let corners = sweep.transforms.iter().zip(&shots);
        let corners = corners.map(|(t, shot)| t.corner_distance(shot.transform, sweep.width, sweep.height));
        let case = judge(case, &sweep, &focus, &pixels, 0.1);
        let case = case.at_most("worst corner, px", corners.fold(0.0, f64::max), 0.05);
        Ok(case.note(format!("c {:.4} px², true {:.4}", sweep.blur_rate, scene.blur_rate)))
    });
    let what = format!(
        "A rendered sweep that breathes by 5 %, drifts by 10 px, turns by 0.3°, brightens by ±5 % and vignettes by ±6 %, \
         noise {NOISE}, by default settings: the worst corner of a frame, and the focus, {BORDER} px along the border left \
         out."
    );
    Section::new("Simulated sweep", what, vec![case])
}

/// Standard deviations of the noise of the flat patch, white = 1. A quick run uses the middle one.
const PATCH_NOISES: [f64; 3] = [0.001, 0.005, 0.02];
/// Half the side of the patch in the middle of 256 px, px.
const HALF: f64 = 65.0;
/// Distance from the patch's border at which the texture has full contrast, px. The transition is slow, so that blur
/// carries hardly any texture into the patch.
const FADES: f64 = 24.0;
/// Width of the border of the patch that is not judged, px. The window for the standard deviation (σ 4 px) contains
/// texture there.
const LEFT_OUT: f64 = 16.0;

/// Measures a patch without texture: the share of its pixels that get a focus.
fn flat_patch(runner: &mut Runner) -> Section {
    let noises = if runner.quick { &PATCH_NOISES[1..2] } else { &PATCH_NOISES[..] };
    let rendered = SweepScene::new(Preset::Plane.scene(), FRAMES).render().map_err(|e| e.to_string());
    let case = |&noise: &f64| {
        runner.case("sweeps: flat patch", format!("noise {noise}"), |runner, case| {
            let sweep = solve_counted(runner, &patched(&rendered.as_ref()?.frames, noise)?)?;
            Ok(judge_patch(case, &sweep))
        })
    };
    let cases = noises.iter().map(case).collect();
    let what = format!(
        "A slanted plane of 256 x 256 px in {FRAMES} frames, in its middle a patch of {0} x {0} px without texture: the \
         share of the patch, and of what is around it, that has a focus, {LEFT_OUT} px along both borders left out; and \
         the share of the whole patch.",
        2.0 * HALF
    );
    Section::new("Flat patch", what, cases)
}

fn judge_patch(case: Case, sweep: &Sweep) -> Case {
    let size = [sweep.width, sweep.height];
    let valid = |counts: &dyn Fn(f64) -> bool| {
        let all: Vec<bool> =
            (0..sweep.focus.len()).filter(|i| counts(outside(*i, size))).map(|i| sweep.focus[i].is_finite()).collect();
        100.0 * all.iter().filter(|valid| **valid).count() as f64 / all.len() as f64
    };
    let border = 0.5 * f64::from(size[0]) - HALF - LEFT_OUT;
    let case = case.at_most("of the patch, %", valid(&|distance| distance < -LEFT_OUT), 1.0);
    let case = case.value("of all of it, %", valid(&|distance| distance < 0.0));
    case.within("around, %", valid(&|distance| distance > FADES && distance < border), [99.0, 100.0])
}

/// Adds noise to frames, and removes their texture in the patch.
fn patched(frames: &[Frame], noise: f64) -> Result<Vec<Frame>, String> {
    let mut random = Random::new(1, 0);
    let mut patch = |frame: &Frame| {
        let size = [frame.width(), frame.height()];
        let value = |(i, v): (usize, &f32)| {
            let texture = (outside(i, size) / FADES).clamp(0.0, 1.0);
            let smooth = texture * texture * (3.0 - 2.0 * texture);
            (0.5 + smooth * (f64::from(*v) - 0.5) + noise * random.normal()) as f32
        };
        Frame::gray(size[0], size[1], intensities(frame).iter().enumerate().map(value).collect())
    };
    frames.iter().map(&mut patch).collect()
}

/// Distance of a pixel from the border of the patch, px; negative inside.
fn outside(i: usize, [width, height]: [u32; 2]) -> f64 {
    let [x, y] = centre(width, height);
    let (column, row) = ((i % width as usize) as f64, (i / width as usize) as f64);
    (column - x).abs().max((row - y).abs()) - HALF
}

/// Standard deviation of the noise of simulated sweeps, white = 1.
const FUSED_NOISE: f64 = 0.003;
/// Size of a quick run, px.
const SMALL: [u32; 2] = [160, 128];
/// Folder within the data folder, and the numbers of the frames.
const HEAT_SINK: &str = "heatsink";
const NUMBERS: [u32; 7] = [10, 15, 20, 25, 30, 35, 40];
/// Side of a tile, px.
const TILE: usize = 32;
/// Least ratio of the variances of the Laplacian between two frames for a tile to count as textured. In other tiles
/// focus makes no difference.
const TEXTURED: f64 = 4.0;
/// The share of the sharpest frame's variance that a tile must reach, and the share of tiles that must reach it, %.
const SHARP: f64 = 0.95;
const ENOUGH: f64 = 99.0;

/// Measures the heat sink, and simulated sweeps with edges that hide what is behind them.
fn fused(runner: &mut Runner, data: &Path) -> Section {
    let presets = [Preset::Card, Preset::Blocks, Preset::Bars];
    let presets = if runner.quick { &presets[..1] } else { &presets[..] };
    let simulated = |preset: &Preset| {
        let mut scene = Scene { noise: FUSED_NOISE, ..preset.scene() };
        if runner.quick {
            [scene.width, scene.height] = SMALL;
        }
        runner.case("sweeps: fused image", scene.name.clone(), |runner, case| {
            let frames = SweepScene::new(scene, FRAMES).render().map_err(|e| e.to_string())?.frames;
            Ok(judge_fused(case, &solve_counted(runner, &frames)?, &frames))
        })
    };
    let mut cases: Vec<Case> = presets.iter().map(simulated).collect();
    if !runner.quick {
        cases.push(runner.case("sweeps: fused image", "heat sink", |runner, case| {
            let read = NUMBERS.iter().map(|n| image_io::read(&data.join(HEAT_SINK).join(format!("frame_{n}.png"))));
            let frames = read.collect::<Result<Vec<Frame>, Error>>().map_err(|e| e.to_string())?;
            Ok(judge_fused(case, &solve_counted(runner, &frames)?, &frames))
        }));
    }
    let what = format!(
        "Variance of the Laplacian in tiles of {TILE} px against that of the sharpest frame there, registered by a cubic \
         spline. A tile has texture where one frame has {TEXTURED} times the variance of another: the share of these tiles \
         with {SHARP} of the sharpest frame's; of the other tiles, the median share. Simulated sweeps of {FRAMES} frames, \
         noise {FUSED_NOISE}, and the seven frames of the heat sink, by default settings."
    );
    Section::new("Fused image", what, cases)
}

fn judge_fused(case: Case, sweep: &Sweep, frames: &[Frame]) -> Case {
    let size = [sweep.width as usize, sweep.height as usize];
    let registered = |n: usize| {
        let values = luminance(brightened(&frames[n], &sweep.brightness[n], sweep.decode), frames[n].format().channels);
        variances(&onto(values, 1, &sweep.transforms[n], size), size)
    };
    let frames: Vec<Vec<f64>> = (0..frames.len()).map(registered).collect();
    let fused = variances(&luminance(sweep.fused.clone(), sweep.fused_channels), size);
    let (textured, flat) = shares(&frames, &fused);
    let sharp = 100.0 * textured.iter().filter(|share| **share >= SHARP).count() as f64 / textured.len() as f64;
    let case = case.within("as sharp as the sharpest frame, % of tiles", sharp, [ENOUGH, 100.0]);
    let case = case.value("least share of a tile", textured.iter().copied().reduce(f64::min));
    let note = format!("{} tiles with texture, {} without", textured.len(), flat.len());
    case.value("share of the median tile without texture", median(flat)).note(note)
}

/// The variance of each tile in the fused image over that in the sharpest frame, for tiles with and without texture.
fn shares(frames: &[Vec<f64>], fused: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut textured, mut flat) = (Vec::new(), Vec::new());
    for (tile, fused) in fused.iter().enumerate() {
        let variances = || frames.iter().map(|frame| frame[tile]).filter(|variance| variance.is_finite());
        let (most, least) = (variances().fold(0.0, f64::max), variances().fold(f64::INFINITY, f64::min));
        if most > 0.0 {
            (if most >= TEXTURED * least { &mut textured } else { &mut flat }).push(fused / most);
        }
    }
    (textured, flat)
}

/// The variance of the Laplacian in each whole tile; NaN if a pixel is NaN.
fn variances(values: &[f32], [width, height]: [usize; 2]) -> Vec<f64> {
    let at = |x: usize, y: usize| f64::from(values[y.min(height - 1) * width + x.min(width - 1)]);
    let laplacian = |x: usize, y: usize| {
        at(x.saturating_sub(1), y) + at(x + 1, y) + at(x, y.saturating_sub(1)) + at(x, y + 1) - 4.0 * at(x, y)
    };
    let of_tile = |left: usize, top: usize| {
        let pixels = || (0..TILE * TILE).map(|n| laplacian(left + n % TILE, top + n / TILE));
        let mean = pixels().sum::<f64>() / (TILE * TILE) as f64;
        pixels().map(|l| (l - mean).powi(2)).sum::<f64>() / (TILE * TILE) as f64
    };
    let places = (0..height / TILE).flat_map(|row| (0..width / TILE).map(move |column| (column, row)));
    places.map(|(column, row)| of_tile(TILE * column, TILE * row)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_without_result_is_an_error_and_one_without_truth_is_left_out() {
        let nan = f32::NAN;
        let pixels = [(1.0, 1.5), (nan, 1.0), (3.0, nan), (2.0, 2.0), (5.0, 3.0)];
        let errors = Errors::of(pixels.into_iter());
        assert_eq!((errors.median, errors.beyond, errors.unanswered), (2.0, 0.5, 0.25));
        let met: Vec<_> = errors.bounded(Case::new("x"), 2.0).values.iter().map(|f| f.met).collect();
        assert_eq!(met, [Some(true), Some(false), None]);
        assert_eq!(Errors::of([].into_iter()).median, f64::INFINITY);
    }

    #[test]
    fn a_missing_stack_is_named() {
        let folder = tempfile::TempDir::new().unwrap();
        let read = || Stack::read(folder.path()).err().unwrap();
        assert!(read().contains("truth.exr") && read().contains("no such file"), "{}", read());
    }

    #[test]
    fn frames_keep_their_indices_when_others_are_left_out() {
        let frame = Frame::gray(16, 16, vec![0.5; 256]).unwrap();
        let stack = Stack { frames: vec![frame; 41], truth: vec![f32::NAN, 3.0] };
        for (step, count) in [(1, 41), (2, 21), (4, 11), (8, 6)] {
            let (frames, positions) = stack.every(step);
            assert_eq!((frames.len(), positions[count - 1]), (count, 40.0));
        }
    }

    #[test]
    fn tiles_are_compared_with_the_sharpest_frame_that_shows_them() {
        // Checks of ±a have a Laplacian of ±8a, with the variance 64 a².
        let checks =
            |a: f32| (0..64 * 32).map(|i| if (i % 64 + i / 64) % 2 == 0 { a } else { -a }).collect::<Vec<f32>>();
        let found = variances(&checks(0.5), [64, 32]);
        // The Laplacian is smaller at the border.
        assert!(found.len() == 2 && found.iter().all(|v| (14.0..16.1).contains(v)), "{found:?}");
        let mut hidden = checks(0.5);
        hidden[5] = f32::NAN;
        assert!(variances(&hidden, [64, 32])[0].is_nan());
        let frames = [vec![4.0, 1.0, f64::NAN], vec![1.0, 1.1, 2.0]];
        assert_eq!(shares(&frames, &[3.8, 1.1, 1.0]), (vec![0.95], vec![1.0, 0.5]));
        assert_eq!((median(vec![3.0, 1.0, 2.0]), median(Vec::new())), (Some(2.0), None));
    }
}
