//! A focus sweep: more than two photographs of one scene, each focused a little further, to one map of where every
//! pixel is in focus and one image sharp all over.
//!
//! All frames are solved as one (`engine::SweepSolver`), on the pixels of one of them, the reference.

mod beyond;
mod choose;
mod focused;
mod fuse;
mod laplacian;
mod order;
mod part;
mod position;
mod registered;
mod restated;

pub use self::part::solve_sweep;
pub use self::position::{Positions, SweepDepth};
pub use self::registered::{RegisteredSweep, register_sweep};
use crate::base::{Brightness, Channels, Decode, Error, Frame, Homography, Region, Settings};
use crate::engine::{Engine, JointSolution, JointSolver, SweepInput};
use crate::solve::SolveOptions;

/// A pixel whose deviation is larger, steps, is not known.
const UNKNOWN: f32 = 2.0;

/// The fewest frames of a sweep.
const LEAST: usize = 3;

/// How a sweep is solved.
#[derive(Clone, Debug, Default)]
pub struct SweepOptions {
    /// Settings of each pair.
    pub settings: Settings,
    /// What the frames are focused at.
    pub positions: Positions,
    /// The frame on whose pixels the results are; `None` takes the middle one.
    pub reference: Option<usize>,
    /// The part of the reference that results are wanted of, and which of its pixels count; of pairs alone is a flat reference.
    pub scope: SolveOptions,
}

impl SweepOptions {
    /// Checks what can be said before any photograph is read: that a sweep of so many frames has these positions and this
    /// reference.
    ///
    /// # Errors
    /// [`Error::Mismatch`]; those of [`Settings::check`].
    pub fn check(&self, frames: usize) -> Result<(), Error> {
        let mismatch = |problem: String| Err(Error::Mismatch(problem));
        if frames < LEAST {
            return mismatch(format!(
                "a sweep has three frames or more, not {frames}; solve a pair with parfocal solve"
            ));
        }
        if let Some(n) = self.reference.filter(|&reference| reference >= frames) {
            return mismatch(format!("there is no reference frame {}, counted from 1: there are {frames}", n + 1));
        }
        if self.scope.flat.is_some() {
            return mismatch("a flat reference is of a pair, and a sweep has none".to_string());
        }
        self.settings.check()?;
        self.positions.check(frames)
    }
}

/// Where a scene is in focus.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// Pixels a row, of every field below.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The part of the reference that they are of.
    pub region: Region,
    /// Width and height of the frames, about whose centre the transforms are stated.
    pub photograph: [u32; 2],
    /// The focus setting at which each pixel of the reference is sharp; NaN where no pair tells, and where it lies beyond the frames.
    pub focus: Vec<f32>,
    /// Its standard deviation, in settings; NaN where no pair tells.
    pub uncertainty: Vec<f32>,
    /// What no frame has in focus: -1 where the focus lies before the first frame, 1 beyond the last, else 0.
    pub beyond: Vec<i8>,
    /// Depth in mm, where the positions are in mm.
    pub depth: Option<SweepDepth>,
    /// Grey only if all frames are.
    pub fused_channels: Channels,
    /// The all-in-focus image, interleaved, in the values of the reference with white at 1.
    pub fused: Vec<f32>,
    /// The frame that each pixel of it is taken from, counted from 1; empty where results are read from a folder.
    pub frames: Vec<u16>,
    /// The frame on whose pixels the results are, of those below.
    pub reference: usize,
    /// The focus setting of each frame, in which blur is linear.
    pub positions: Vec<f64>,
    /// Their unit.
    pub unit: &'static str,
    /// What the frames are focused at, as stated.
    pub stated: Positions,
    /// Where each pixel of the reference lies in each frame.
    pub transforms: Vec<Homography>,
    /// What brings each frame to the reference's brightness.
    pub brightness: Vec<Brightness>,
    /// c: by how many px² of variance blur grows with the squared distance from the focus, in settings.
    pub blur_rate: f64,
    /// How stored values became intensities.
    pub decode: Decode,
    /// Which of the frames that were given each of them is, from 0: frames that were out of order stand in order, and one that was there
    /// twice is left out, unless positions are stated.
    pub order: Vec<usize>,
    /// What the user should know; a sentence each.
    pub warnings: Vec<String>,
}

/// Solves all of the frames, which fit the options.
fn solve_whole(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<Sweep, Error> {
    let counted = Counted::of(frames.len(), options);
    let (width, height) = (frames[0].width(), frames[0].height());
    let mut solver = solver(engine, frames, options)?;
    let mut report = |progress| options.scope.report(progress);
    let found = solver.solve(frames, &counted.input(options), &options.scope.cancel, &mut report)?;
    let registration = &found.registration;
    let (reference, first, step) = (counted.reference, counted.first, counted.step);
    let decode = options.settings.decode.resolved([frames[0].format().depth]);
    let focused = focused::Focused { frames, reference, positions: &registration.settings, found: &found, decode };
    let (fused, fused_channels) = (fuse::fuse(&focused), focused.channels());
    let counts = known(&found);
    let beyond = beyond::sides(&counts, registration.settings[frames.len() - 1], registration.rate);
    let within = counts.iter().zip(&beyond).map(|(&u, &side)| if side == 0 { u } else { f32::NAN });
    let focus: Vec<f32> = within.map(|u| (first + step * f64::from(u)) as f32).collect();
    let uncertainty: Vec<f32> = found.deviation.iter().map(|&s| (step.abs() * f64::from(s)) as f32).collect();
    Ok(Sweep {
        width,
        height,
        region: Region { x: 0, y: 0, width, height },
        photograph: [width, height],
        depth: options.positions.depth(&focus, &uncertainty),
        focus,
        uncertainty,
        beyond,
        fused_channels,
        fused: fused.values,
        frames: fused.frames.iter().map(|n| n + 1).collect(),
        reference,
        positions: counted.positions(&registration.settings),
        unit: options.positions.unit(),
        stated: options.positions.clone(),
        blur_rate: registration.rate / (step * step),
        transforms: found.registration.transforms,
        brightness: found.registration.brightness,
        decode,
        order: (0..frames.len()).collect(),
        warnings: Vec::new(),
    })
}

/// Prepares for these frames.
fn solver(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<JointSolver, Error> {
    let size = [frames[0].width(), frames[0].height()];
    JointSolver::new(engine, size, frames[0].format(), frames.len(), &options.settings)
}

/// What the frames of a sweep are focused at as it is solved: constants of the solve are for settings a step apart.
struct Counted {
    reference: usize,
    /// The setting of the first frame, and the mean step from setting to setting, negative where they descend.
    first: f64,
    step: f64,
    /// The settings in steps from the first.
    steps: Vec<f64>,
}

impl Counted {
    fn of(frames: usize, options: &SweepOptions) -> Self {
        let settings = options.positions.settings(frames);
        let (first, step) = (settings[0], (settings[frames - 1] - settings[0]) / (frames - 1) as f64);
        let steps = settings.iter().map(|p| (p - first) / step).collect();
        Self { reference: options.reference.unwrap_or(frames / 2), first, step, steps }
    }

    fn input<'a>(&'a self, options: &'a SweepOptions) -> SweepInput<'a> {
        SweepInput {
            settings: &self.steps,
            are_settings_known: options.positions != Positions::Counted,
            reference: self.reference,
            mask: options.scope.mask.as_ref(),
        }
    }

    /// Settings from steps.
    fn positions(&self, steps: &[f64]) -> Vec<f64> {
        steps.iter().map(|steps| self.first + self.step * steps).collect()
    }
}

/// u where it is known, steps; NaN elsewhere.
fn known(found: &JointSolution) -> Vec<f32> {
    let pixels = found.focus.iter().zip(&found.deviation);
    pixels.map(|(&u, &deviation)| if deviation < UNKNOWN { u } else { f32::NAN }).collect()
}

/// Whether frames and options fit each other.
fn check(frames: &[Frame], options: &SweepOptions) -> Result<(), Error> {
    let mismatch = |problem: String| Err(Error::Mismatch(problem));
    options.check(frames.len())?;
    let first = (frames[0].width(), frames[0].height(), frames[0].format());
    if let Some(n) = frames.iter().position(|f| (f.width(), f.height(), f.format()) != first) {
        let found = &frames[n];
        return mismatch(format!(
            "frame {} is {}x{} {:?} and the first {}x{} {:?}: a sweep's frames have one size and format",
            n + 1,
            found.width(),
            found.height(),
            found.format(),
            first.0,
            first.1,
            first.2
        ));
    }
    Ok(())
}
