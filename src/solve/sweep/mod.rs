//! Focus sweeps: three or more photographs of one scene, each focused a little further.
//!
//! [`SweepSolver`] computes the focus setting of every pixel, an all-in-focus image, and the registration of all
//! frames. All frames are solved together, on the pixels of one of them, the reference.

mod foreign;
mod fuse;
mod judgement;
mod order;
mod positions;
mod solution;

use std::borrow::Cow;

use self::fuse::FocusedFrames;
use self::order::{MIN_FRAMES, Order, Rules};
pub use self::positions::{Positions, SweepDepth};
pub use self::solution::{RegisteredSweep, Sweep};
use crate::base::{Brightness, Error, Format, Frame, Homography, Mask, Progress, Region, Settings, centre, workers};
use crate::engine::{Engine, JointRegistration, JointSolution, JointSolver, SweepInput};
use crate::solve::SolveOptions;
use crate::solve::fill::{filled, filled_frame};
use crate::solve::pair_solver::{margin, reuse};
use crate::solve::resample::luminance;

/// The largest standard deviation of u at which a pixel has a result, as a share of the range of settings. It does not
/// depend on the number of frames: of 11 frames it is two steps, of 33 six. A bound in steps narrowed with each frame.
const MAX_DEVIATION: f64 = 0.2;
/// The largest standard deviation of u at which a pixel that no frame has in focus has a side, steps, if that is more.
/// Beyond the frames u is less certain, and only its side is stated.
const MAX_SIDE_DEVIATION: f64 = 2.0;
/// The blur at which a pixel counts as out of range, px: that of its focus in the first or the last frame. The solve
/// follows a focus for half a pixel of blur. Near that limit the focus may be anywhere further out. Below it, the frame
/// cannot be distinguished from one in focus.
const OUT_OF_RANGE: f64 = 0.4;

/// The |V| whose blur the margin around a region holds, px².
const REACH: f64 = 144.0;

/// The largest share of clipped pixels of a frame without a warning: of most of the frame nothing is known beyond it.
const MOST_CLIPPED: f64 = 0.5;

/// The settings of a sweep, the focus positions of its frames, and the reference.
#[derive(Clone, Debug, Default)]
pub struct SweepOptions {
    /// The settings of each pair of frames. With the method aligned, no frame is registered: all T are the identity.
    pub settings: Settings,
    /// The focus positions of the frames.
    pub positions: Positions,
    /// The index of the reference frame, which defines the pixels of the results; `None`: the middle frame.
    pub reference: Option<usize>,
}

impl SweepOptions {
    /// Checks the options against a number of frames. It needs no photograph.
    ///
    /// # Errors
    /// [`Error::Mismatch`]; those of [`Settings::check`].
    pub fn check(&self, frames: usize) -> Result<(), Error> {
        let mismatch = |problem: String| Err(Error::Mismatch(problem));
        if frames < MIN_FRAMES {
            return mismatch(format!(
                "a sweep has three frames or more, not {frames}; solve a pair with parfocal solve"
            ));
        }
        if let Some(n) = self.reference.filter(|&reference| reference >= frames) {
            return mismatch(format!("there is no reference frame {}, counted from 1: there are {frames}", n + 1));
        }
        self.settings.check()?;
        self.positions.check(frames)
    }
}

/// Solves focus sweeps by one choice of options.
///
/// The first sweep of a size, format and number of frames prepares memory and recorded passes; later sweeps of the same
/// kind reuse them. There is no `submit` like that of a [`PairSolver`](crate::PairSolver): the host updates the
/// registration of all frames between iterations, so the calling thread takes part until the end. To overlap the host's
/// work with the device's, use a [`Stream`](crate::Stream::of_sweeps).
///
/// ```
/// # use parfocal::{Engine, EngineOptions, Error, Frame, SolveOptions, SweepSolver};
/// # use parfocal::sweep::SweepOptions;
/// # fn frame(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 64, (0..64 * 64).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let frames = [0.2, 0.4, 0.3].map(frame);
/// let engine = Engine::new(&EngineOptions::default())?;
/// let mut solver = SweepSolver::new(&engine, &SweepOptions::default())?;
/// let sweep = solver.solve(&frames, &SolveOptions::default())?;
/// println!("the first pixel is in focus at {} of the frames", sweep.focus[0]);
/// # Ok(())
/// # }
/// ```
pub struct SweepSolver {
    engine: Engine,
    options: SweepOptions,
    prepared: Option<(Layout, JointSolver)>,
}

/// The size, format, number of frames and settings for which a solver is prepared.
#[derive(PartialEq)]
struct Layout {
    size: [u32; 2],
    format: Format,
    frames: usize,
    settings: Settings,
}

impl SweepSolver {
    /// Makes a solver that prepares itself for the first sweep.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn new(engine: &Engine, options: &SweepOptions) -> Result<Self, Error> {
        options.settings.check()?;
        Ok(Self { engine: engine.clone(), options: options.clone(), prepared: None })
    }

    /// Makes a solver and prepares it for sweeps like this one.
    ///
    /// # Errors
    /// [`Error::Mismatch`] for fewer than three frames, different sizes or formats, or options that do not fit the
    /// frames; [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn for_frames(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<Self, Error> {
        let mut solver = Self::new(engine, options)?;
        check(frames, options)?;
        solver.prepare(frames)?;
        Ok(solver)
    }

    /// The options.
    pub fn options(&self) -> &SweepOptions {
        &self.options
    }

    /// Changes the options of later sweeps. The next sweep prepares the solver again if the settings differ.
    ///
    /// # Errors
    /// [`Error::Setting`].
    pub fn set_options(&mut self, options: &SweepOptions) -> Result<(), Error> {
        options.settings.check()?;
        self.options.clone_from(options);
        Ok(())
    }

    /// Solves a sweep, or the region of it that the options name. If no positions are stated, frames that are certainly
    /// out of order are put in order, and repeated frames are left out. [`RegisteredSweep::order`] and a warning report
    /// this.
    ///
    /// # Errors
    /// As for [`SweepSolver::for_frames`] and [`SolveOptions::check`]; [`Error::Mismatch`] for frames that do not
    /// differ in focus, and for a flat reference, which only pairs support; [`Error::Cancelled`], [`Error::Timeout`].
    pub fn solve(&mut self, frames: &[Frame], options: &SolveOptions) -> Result<Sweep, Error> {
        let sweep_options = self.options.clone();
        let task = Task::new(frames, &sweep_options, options)?;
        let solver = self.prepare(&task.frames)?;
        let mut latest = Progress::of_steps(0, 1);
        let solution = solver.solve(&task.frames, &task.input(), &options.cancel, &mut |progress| {
            latest = progress;
            options.report(progress);
        })?;
        let mut sweep = task.sweep(solution)?;
        options.report(Progress { share: 1.0, ..latest });
        if let Some(Region { x, y, width, height }) = options.region {
            sweep.crop(Region { x: x - task.part.x, y: y - task.part.y, width, height });
        }
        if let Some(mask) = Mask::of_frame(&frames[task.order.frames[task.reference]], options.mask.as_ref()) {
            sweep.exclude(&mask.cropped(sweep.region));
        }
        if options.crop_valid {
            match sweep.largest_valid() {
                Some(valid) => sweep.crop(valid),
                None => sweep.warnings.push("no pixel is valid: nothing was cropped".to_string()),
            }
        }
        sweep.depth = sweep.stated.depth(&sweep.focus, &sweep.uncertainty);
        Ok(sweep)
    }

    /// Registers a sweep, with the same registration as [`solve`](Self::solve). It leaves out the finest level, which
    /// does not change the registration.
    ///
    /// # Errors
    /// As for [`SweepSolver::solve`].
    pub fn register(&mut self, frames: &[Frame], options: &SolveOptions) -> Result<RegisteredSweep, Error> {
        let sweep_options = self.options.clone();
        let task = Task::new(frames, &sweep_options, options)?;
        let solver = self.prepare(&task.frames)?;
        let report = &mut |progress| options.report(progress);
        let registration = solver.register(&task.frames, &task.input(), &options.cancel, report)?;
        Ok(task.registered(registration))
    }

    /// The prepared solver for frames like these.
    fn prepare(&mut self, frames: &[Frame]) -> Result<&mut JointSolver, Error> {
        let settings = self.options.settings.clone();
        let (size, format) = ([frames[0].width(), frames[0].height()], frames[0].format());
        let layout = Layout { size, format, frames: frames.len(), settings };
        let engine = &self.engine;
        let prepare = |layout: &Layout| JointSolver::new(engine, size, format, frames.len(), &layout.settings);
        reuse(&mut self.prepared, layout, prepare)
    }
}

/// Checks that the frames have one size and format and fit the options.
fn check(frames: &[Frame], options: &SweepOptions) -> Result<(), Error> {
    options.check(frames.len())?;
    let first = (frames[0].width(), frames[0].height(), frames[0].format());
    if let Some(n) = frames.iter().position(|f| (f.width(), f.height(), f.format()) != first) {
        let other = &frames[n];
        return Err(Error::Mismatch(format!(
            "frame {} is {}x{}, {}, and the first {}x{}, {}: a sweep's frames have one size and format",
            n + 1,
            other.width(),
            other.height(),
            other.format(),
            first.0,
            first.1,
            first.2
        )));
    }
    Ok(())
}

/// The frames of one solve in order, cut to the region with a margin, and their focus settings in steps.
struct Task<'a> {
    options: &'a SweepOptions,
    /// The positions of the frames that are solved.
    positions: Positions,
    frames: Cow<'a, [Frame]>,
    /// The same frames as photographed, if some of their pixels are not part of the picture and were filled.
    photographed: Option<Cow<'a, [Frame]>>,
    order: Order,
    reference: usize,
    photograph: [u32; 2],
    /// The part of the photographs that the frames are cut to.
    part: Region,
    /// The setting of the first frame, and the mean step from setting to setting, which is negative for descending
    /// settings.
    first: f64,
    step: f64,
    /// The settings in steps from the first. The constants of the solve assume settings about one apart.
    steps: Vec<f64>,
}

impl<'a> Task<'a> {
    fn new(frames: &'a [Frame], options: &'a SweepOptions, solve: &'a SolveOptions) -> Result<Self, Error> {
        check(frames, options)?;
        if solve.flat.is_some() {
            return Err(Error::Mismatch("a flat reference is for pairs: leave it out of a sweep".to_string()));
        }
        let photograph = [frames[0].width(), frames[0].height()];
        solve.check(photograph)?;
        let rules =
            Rules { stated: options.positions != Positions::Counted, keep_foreign: options.settings.keep_frames };
        let is_masked = solve.mask.is_some() || frames.iter().any(|frame| frame.counted().is_some());
        let filled = |frame: &Frame| match &solve.mask {
            Some(mask) => filled_frame(frame.clone().without(mask.bytes())),
            None => filled_frame(frame.clone()),
        };
        let filled = is_masked.then(|| workers::map(frames.len(), |n| filled(&frames[n])));
        let order = order::judge(filled.as_deref().unwrap_or(frames), rules)?;
        let positions = options.positions.of(&order.frames);
        let mut reference = options.reference;
        let mut part = Region { x: 0, y: 0, width: photograph[0], height: photograph[1] };
        if !order.frames.iter().copied().eq(0..frames.len()) {
            reference = reference.and_then(|given| {
                let is_same = |n: &usize| *n == given || frames[*n].samples() == frames[given].samples();
                order.frames.iter().position(is_same)
            });
        }
        if let Some(region) = solve.region {
            part = region.expanded(margin(photograph, REACH), photograph);
        }
        let solved = |mut frames: Cow<'a, [Frame]>| {
            if !order.frames.iter().copied().eq(0..frames.len()) {
                frames = order.frames.iter().map(|n| frames[*n].clone()).collect();
            }
            if solve.region.is_some() {
                let cut = frames.iter().map(|frame| frame.cropped(part).map_err(Error::Region));
                frames = cut.collect::<Result<_, Error>>()?;
            }
            Ok::<_, Error>(frames)
        };
        let photographed = is_masked.then(|| solved(Cow::Borrowed(frames))).transpose()?;
        let frames = solved(filled.map_or(Cow::Borrowed(frames), Cow::Owned))?;
        let (settings, last) = (positions.settings(frames.len()), frames.len() - 1);
        let (first, step) = (settings[0], (settings[last] - settings[0]) / last as f64);
        let steps = settings.iter().map(|p| (p - first) / step).collect();
        let reference = reference.unwrap_or(frames.len() / 2);
        Ok(Self { options, positions, frames, photographed, order, reference, photograph, part, first, step, steps })
    }

    fn input(&self) -> SweepInput<'_> {
        SweepInput {
            settings: &self.steps,
            are_settings_known: self.options.positions != Positions::Counted,
            reference: self.reference,
        }
    }

    /// The result of a solve for the cut frames, in order.
    fn sweep(&self, mut solution: JointSolution) -> Result<Sweep, Error> {
        let unlike = unlike_warning(&solution.registration.unlike, &self.order.frames);
        let (registration, deviation) = (&solution.registration, solution.median_deviation);
        judgement::differ_in_focus(registration, deviation, self.order.differ_in_focus, unlike)?;
        let mut registered = self.registered(solution.registration.clone());
        let color = solution.color_shift.as_ref();
        registered
            .warnings
            .extend(color.and_then(|c| judgement::color_warning(c, self.step, registered.stated.unit())));
        let by_color = color.map_or(0.0, |shift| shift.included);
        let settings = &solution.registration.settings;
        let last = settings[settings.len() - 1];
        let certain = |most: f64| {
            let pixels = solution.focus.iter().zip(&solution.deviation);
            pixels.map(move |(&u, &deviation)| if f64::from(deviation) < most { u } else { f32::NAN })
        };
        let most = MAX_DEVIATION * last;
        let on_side: Vec<f32> = certain(most.max(MAX_SIDE_DEVIATION)).collect();
        let beyond = sides(&on_side, last, solution.registration.rate);
        let in_range = certain(most).zip(&beyond).map(|(u, &side)| if side == 0 { u } else { f32::NAN });
        let focus = in_range.map(|u| (self.first + self.step * f64::from(u)) as f32).collect();
        let deviation = |&s: &f32| (self.step.abs() * f64::from(s).hypot(by_color)) as f32;
        let uncertainty = solution.deviation.iter().map(deviation).collect();
        // The frames are chosen by what is measured, and by what is filled in between.
        let known = certain(most).zip(&on_side).zip(&beyond).map(|((u, far), side)| if *side == 0 { u } else { *far });
        let known: Vec<f32> = known.collect();
        let reference = &self.frames[self.reference];
        let seen = luminance(reference.intensities(registered.decode), reference.format().channels);
        let seen = seen.into_iter().map(|v| v.max(0.0).sqrt()).collect();
        solution.focus = filled(&known, &solution.deviation, seen, reference.width() as usize);
        let frames = FocusedFrames {
            frames: self.photographed.as_deref().unwrap_or(&self.frames),
            reference: self.reference,
            solution: &solution,
            decode: registered.decode,
        };
        let (fused, fused_channels) = (frames.fuse(), frames.channels());
        Ok(Sweep {
            width: self.part.width,
            height: self.part.height,
            region: self.part,
            depth: None,
            focus,
            uncertainty,
            beyond,
            fused_channels,
            fused: fused.values,
            frames: fused.frames.iter().map(|n| n + 1).collect(),
            unit: registered.stated.unit(),
            registration: registered,
        })
    }

    /// The registration of the photographs, from that of the cut frames.
    fn registered(&self, registration: JointRegistration) -> RegisteredSweep {
        let coarse = judgement::coarse_warning(&registration, self.options.settings.blur_limit());
        let unlike = unlike_warning(&registration.unlike, &self.order.frames);
        let JointRegistration { mut transforms, mut brightness, rate, settings, .. } = registration;
        let per_setting = |px: Vec<[f64; 2]>, step: f64| px.iter().map(|moves| moves.map(|px| px / step)).collect();
        if [self.part.width, self.part.height] != self.photograph {
            move_into(&mut transforms, &mut brightness, self.part, self.photograph);
        }
        let positions: Vec<f64> = settings.iter().map(|steps| self.first + self.step * steps).collect();
        let stated = &self.positions;
        let uneven = stated.uneven_warning(&positions, &self.order.frames);
        let levels = self.options.settings.clipped(self.frames[0].format().depth);
        let clipped_fractions: Vec<f64> =
            self.frames.iter().map(|frame| frame.clipped_fraction(levels, frame.counted())).collect();
        let clipped = clipped_warning(&clipped_fractions, &self.order.frames);
        let found = [unlike, uneven, coarse, clipped].into_iter().flatten();
        RegisteredSweep {
            photograph: self.photograph,
            reference: self.reference,
            positions,
            stated: stated.clone(),
            transforms,
            parallax: per_setting(registration.parallax, self.step),
            parallax_deviation: per_setting(registration.parallax_deviation, self.step.abs()),
            brightness,
            blur_rate: rate / self.step.powi(2),
            decode: self.options.settings.decode.resolved([self.frames[0].format().depth]),
            clipped_fractions,
            warnings: self.order.warnings.iter().cloned().chain(found).collect(),
            order: self.order.frames.clone(),
        }
    }
}

/// A warning that names the frames that do not lie on their neighbours.
fn unlike_warning(unlike: &[usize], order: &[usize]) -> Option<String> {
    let names: Vec<String> = unlike.iter().map(|n| (order[*n] + 1).to_string()).collect();
    let words = "moved too far to be registered, or do not show what the frames beside them show";
    (!names.is_empty()).then(|| format!("the frames {} {words}", names.join(", ")))
}

/// A warning that names the frames with most of their pixels clipped. `order` has the index of each frame among the
/// frames that were passed.
fn clipped_warning(fractions: &[f64], order: &[usize]) -> Option<String> {
    let clipped: Vec<usize> = (0..fractions.len()).filter(|n| fractions[*n] > MOST_CLIPPED).collect();
    let most = clipped.iter().map(|n| fractions[*n]).fold(0.0, f64::max);
    let names: Vec<String> = clipped.iter().map(|n| (order[*n] + 1).to_string()).collect();
    (!clipped.is_empty()).then(|| {
        format!(
            "up to {:.0} % of the pixels are clipped in the frames {}, and do not count: expose so that neither light nor dark areas are clipped",
            100.0 * most,
            names.join(", ")
        )
    })
}

/// States the registration of cut frames about the centre of the photographs.
fn move_into(transforms: &mut [Homography], brightness: &mut [Brightness], part: Region, photograph: [u32; 2]) {
    let (from, to) = (part.centre(), centre(photograph[0], photograph[1]));
    transforms.iter_mut().for_each(|transform| *transform = transform.about(from, to));
    for brightness in brightness {
        brightness.part.x += part.x;
        brightness.part.y += part.y;
    }
}

/// The side of each pixel: -1 where u is before the first frame, 1 where it is beyond the last, else 0, also where u is
/// NaN. u and `last` are in steps from the first frame, c in px² per squared step.
fn sides(focus: &[f32], last: f64, rate: f64) -> Vec<i8> {
    let margin = (OUT_OF_RANGE / rate.sqrt()) as f32;
    let side = |u: &f32| i8::from(*u > last as f32 + margin) - i8::from(*u < -margin);
    focus.iter().map(side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Decode;
    use crate::base::random::Random;
    use crate::engine::testing;
    use crate::lab::scene::{Preset, Scene, SweepScene};

    fn solve(frames: &[Frame]) -> Result<Sweep, Error> {
        let engine = Engine::new(&testing::on_any())?;
        SweepSolver::new(&engine, &SweepOptions::default())?.solve(frames, &SolveOptions::default())
    }

    /// The share of the pixels that have a focus.
    fn known(sweep: &Sweep) -> f64 {
        sweep.focus.iter().filter(|u| u.is_finite()).count() as f64 / sweep.focus.len() as f64
    }

    /// A relief whose blur grows by `blur` px from the first frame to the last.
    fn relief(frames: usize, blur: f64, noise: f64, seed: u64) -> SweepScene {
        let scene = Scene { width: 160, height: 128, noise, seed, ..Preset::Relief.scene() };
        SweepScene { blur_rate: (blur / (frames - 1) as f64).powi(2), ..SweepScene::new(scene, frames) }
    }

    #[test]
    fn frames_of_one_focus_setting_are_refused() {
        for (seed, noise) in [(1, 0.002), (2, 0.005), (3, 0.02), (6, 0.05)] {
            let photograph = relief(3, 6.0, 0.0, seed).render().unwrap().frames.swap_remove(1);
            let mut random = Random::new(seed, 9);
            let mut frame = |shift: u32| {
                let part = Region { x: 2 * shift, y: 7 - shift, width: 144, height: 120 };
                let shown = photograph.cropped(part).unwrap().intensities(Decode::None);
                let noisy = shown.iter().map(|v| v + (noise * random.normal()) as f32).collect();
                Frame::gray(part.width, part.height, noisy).unwrap()
            };
            for frames in [[0; 7].map(&mut frame), [0, 1, 2, 3, 4, 5, 6].map(&mut frame)] {
                let error = solve(&frames).err().unwrap().to_string();
                assert!(error.contains("do not differ in focus beyond noise"), "{error}");
            }
        }
        for (blur, noise) in [(1.2, 0.003), (2.0, 0.01)] {
            let weak = solve(&relief(7, blur, noise, 4).render().unwrap().frames).unwrap();
            assert!(known(&weak) > 0.9 && weak.warnings.is_empty(), "{} {:?}", known(&weak), weak.warnings);
        }
    }

    #[test]
    fn the_frames_that_would_do_know_more_than_coarse_steps() {
        for seed in 1..=3 {
            let solve = |frames: usize| {
                let scene = SweepScene { span: [0.2, 0.8], ..relief(frames, 24.0, 0.005, seed) };
                solve(&scene.render().unwrap().frames).unwrap()
            };
            let coarse = solve(4);
            let named = coarse.warnings.iter().find(|warning| warning.contains("too coarse for their blur")).unwrap();
            let words: Vec<&str> = named.split(' ').collect();
            let count =
                words.windows(3).find(|w| w[1..] == ["frames", "would"]).and_then(|w| w[0].parse().ok()).unwrap();
            let fine = solve(count);
            println!("4 frames {:.3}, {count} frames {:.3}", known(&coarse), known(&fine));
            assert!((8..=10).contains(&count) && fine.warnings.is_empty(), "{named} {:?}", fine.warnings);
            assert!(known(&coarse) < 0.7 && known(&fine) > 0.85);
        }
    }

    #[test]
    fn twice_the_frames_of_one_range_know_no_less() {
        for seed in 1..=3 {
            let [few, many] = [17, 33].map(|frames| solve(&relief(frames, 6.0, 0.03, seed).render().unwrap().frames));
            let [few, many] = [few, many].map(|sweep| known(&sweep.unwrap()));
            println!("17 frames {few:.3}, 33 frames {many:.3}");
            assert!(many > few - 0.005, "{few} {many}");
        }
    }

    #[test]
    fn focus_half_a_pixel_of_blur_outside_the_frames_has_a_side() {
        // Blur grows by 2 px per step: 0.4 px are a fifth of a step.
        let focus = [f32::NAN, -0.25, -0.15, 0.0, 2.0, 3.15, 3.25];
        assert_eq!(sides(&focus, 3.0, 4.0), [0, -1, 0, 0, 0, 0, 1]);
    }
}
