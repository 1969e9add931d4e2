//! The joint solve of a focus sweep: u of each pixel, and the registration of all frames.
//!
//! u is the focus setting at which a pixel is sharp. Section 11 of `docs/method.md`. The device holds the frames, one
//! blur stack at a time, and the linear system that all pairs of frames add to. Between iterations the host steps the
//! parameters that all pixels share: T of each frame, and c. So nothing can be submitted ahead as it is for pairs, and
//! a sweep has no `submit`.

mod color;
pub(super) mod contrast;
mod device;
#[cfg(feature = "program")]
pub(super) mod model;
mod outlines;
mod pairs;
mod parts;
pub(super) mod pyramid;
mod shared;
mod spacing;
pub(super) mod start;
mod validity;

use std::time::Duration;

use self::device::Limits;
pub use self::pairs::MAX_RELATIVE_BLUR;
use self::parts::PartSolver;
pub use self::pyramid::SweepInput;
use self::pyramid::{IterationDone, PyramidSolver, RELAXATION_SWEEPS};
use self::shared::SharedParameters;
use self::validity::ExcludedPixels;
use crate::base::{
    Brightness, CancellationToken, Channels, Deadline, Decode, Depth, Error, Format, Frame, Homography, Kernel,
    Photometric, Progress, Settings,
};
use crate::engine::Engine;
use crate::engine::channels::ColorShift;
use crate::engine::plan::Plan;

/// The largest distance of a kernel's mean from its origin, px at a variance of 1 px². Measured kernels are off by some
/// of it.
const MAX_KERNEL_MEAN: f64 = 0.1;
/// Bytes of the device beyond which the finest level is solved in parts.
const MEMORY: u64 = 4 << 30;

/// Time to fuse the frames, grey or colour, relative to that of an iteration on the finest level: four real sweeps.
const FUSION: [f64; 2] = [0.7, 1.4];

/// The registration of a sweep's frames.
#[derive(Clone, Debug, PartialEq)]
pub struct JointRegistration {
    /// Maps the reference's pixels to those of each frame.
    pub transforms: Vec<Homography>,
    /// The parallax of each frame, px per setting: what is in focus at u is displaced by (u - m) times this before T, m being
    /// the middle between the first and the last setting.
    pub parallax: Vec<[f64; 2]>,
    /// Its standard deviation.
    pub parallax_deviation: Vec<[f64; 2]>,
    /// Maps the brightness of each frame to the reference's.
    pub brightness: Vec<Brightness>,
    /// c, px² of variance by squared settings.
    pub rate: f64,
    /// The focus settings of the frames, as stated or as found.
    pub settings: Vec<f64>,
    /// The frames that do not lie on their neighbours: their registration failed.
    pub unlike: Vec<usize>,
}

/// The result of a joint solve.
#[derive(Clone, Debug)]
pub struct JointSolution {
    /// u at each pixel of the reference, in settings.
    pub focus: Vec<f32>,
    /// The standard deviation of u, in settings; NaN where no pair contributes.
    pub deviation: Vec<f32>,
    /// The median of the deviation before outlines moved, in settings; `None` if no pixel has one.
    pub median_deviation: Option<f64>,
    /// By how much u differs between the channels, in settings; `None` of grey frames, and if it is not known.
    pub color_shift: Option<ColorShift>,
    /// The registration of the frames.
    pub registration: JointRegistration,
}

/// A solver for sweeps of one size, format and number of frames, prepared once and used for any number of them.
pub struct JointSolver {
    settings: Settings,
    size: [u32; 2],
    timeout: Duration,
    /// Solves the photographs or, if there are parts, the photographs at half their size.
    whole: PyramidSolver,
    parts: Option<PartSolver>,
}

impl JointSolver {
    /// Prepares for sweeps of `frames` frames.
    ///
    /// # Errors
    /// As [`PairSolver::new`](crate::PairSolver::new); [`Error::Mismatch`] for a kernel that is not symmetric.
    pub fn new(
        engine: &Engine,
        size: [u32; 2],
        format: Format,
        frames: usize,
        settings: &Settings,
    ) -> Result<Self, Error> {
        Self::within(MEMORY.min(engine.memory()), engine, size, format, frames, settings)
    }

    /// Makes a solver that uses at most `memory` bytes of the device.
    fn within(
        memory: u64,
        engine: &Engine,
        size: [u32; 2],
        format: Format,
        frames: usize,
        settings: &Settings,
    ) -> Result<Self, Error> {
        let [right, down] = settings.kernel.mean();
        if right.hypot(down) > MAX_KERNEL_MEAN {
            let name = settings.kernel.name();
            return Err(Error::Mismatch(format!(
                "the kernel {name} is not centred: behind the focus of a sweep it would lie mirrored; choose a symmetric kernel"
            )));
        }
        let (timeout, limit) = (engine.timeout(), settings.blur_limit().min(MAX_RELATIVE_BLUR));
        let decode = settings.decode.resolved([format.depth]);
        // Sweeps do not look for a kernel.
        let kernel = if settings.kernel == Kernel::Auto { Kernel::Gaussian } else { settings.kernel.clone() };
        let relaxation_sweeps = RELAXATION_SWEEPS;
        let max_relative_blur = Some(limit);
        let settings = Settings { kernel, max_relative_blur, relaxation_sweeps, decode, ..settings.clone() };
        let plan = Plan::new(size[0], size[1], [format; 2], &settings)?.for_device(engine.info());
        let is_small = plan.sweep_bytes(frames as u32) <= memory;
        if is_small && plan.check_sweep(engine.device(), frames as u32).is_ok() || plan.pyramid.len() == 1 {
            let whole = PyramidSolver::new(engine, plan, frames)?;
            return Ok(Self { settings, size, timeout, whole, parts: None });
        }
        let parts = Some(PartSolver::new(engine, &plan, frames, memory / 2)?);
        let max_relative_blur = Some((limit / 4.0).max(1.0));
        let half = Settings { max_relative_blur, decode: Decode::None, levels: None, ..settings.clone() };
        let format = Format { channels: Channels::Gray, depth: Depth::F32 };
        let plan = Plan::new(size[0].div_ceil(2), size[1].div_ceil(2), [format; 2], &half)?;
        let plan = plan.for_device(engine.info());
        Ok(Self { settings, size, timeout, whole: PyramidSolver::new(engine, plan, frames)?, parts })
    }

    /// Solves a sweep; `report` is called after each iteration and each level of the search for outlines. The share that
    /// is left at the end is for the fusion of the frames.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Timeout`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub fn solve(
        &mut self,
        frames: &[Frame],
        input: &SweepInput<'_>,
        cancel: &CancellationToken,
        report: &mut dyn FnMut(Progress),
    ) -> Result<JointSolution, Error> {
        let is_whole = self.parts.is_none();
        let mut work = self.whole.work_above(usize::from(is_whole));
        match &self.parts {
            Some(parts) => work.extend(parts.work()),
            None => work.push(self.whole.final_work()),
        }
        let pixels = f64::from(self.size[0]) * f64::from(self.size[1]);
        let is_color = frames.first().is_some_and(|frame| frame.format().channels.count() > 1);
        let mut done = counter(&work, FUSION[usize::from(is_color)] * pixels, report);
        self.set_limits(cancel);
        let (mut shared, excluded) = self.descend(frames, input, &mut done)?;
        let ([focus, deviation], median_deviation) = match &mut self.parts {
            None => (self.whole.finish(&mut shared, &excluded, &mut done)?, self.whole.median_deviation),
            Some(parts) => {
                let finest = self.whole.finest().clone();
                let coarse = self.whole.focus(&finest)?;
                parts.solve(frames, (&coarse, self.whole.measured.as_ref()), &shared, &mut done)?
            }
        };
        let focus = focus.data.iter().map(|u| (u + shared.middle) as f32).collect();
        let registration = self.registration(shared);
        let least = median_deviation.unwrap_or(f64::INFINITY);
        let color_shift =
            color::shift(frames, &registration.transforms, &registration.settings, self.settings.decode, least);
        Ok(JointSolution { focus, deviation: deviation.to_f32(), median_deviation, color_shift, registration })
    }

    /// Registers a sweep, with the same result as [`solve`](Self::solve): T and c stay on the finest level, which is
    /// left out.
    ///
    /// # Errors
    /// As [`solve`](Self::solve).
    pub fn register(
        &mut self,
        frames: &[Frame],
        input: &SweepInput<'_>,
        cancel: &CancellationToken,
        report: &mut dyn FnMut(Progress),
    ) -> Result<JointRegistration, Error> {
        let mut done = counter(&self.whole.work_above(usize::from(self.parts.is_none())), 0.0, report);
        self.set_limits(cancel);
        let (shared, _) = self.descend(frames, input, &mut done)?;
        Ok(self.registration(shared))
    }

    /// Begins the time limit of a solve, which all its parts share.
    fn set_limits(&mut self, cancel: &CancellationToken) {
        let limits = Limits { cancel: cancel.clone(), deadline: Deadline::after(self.timeout) };
        self.whole.set_limits(limits.clone());
        if let Some(parts) = &mut self.parts {
            parts.set_limits(limits);
        }
    }

    /// Solves all levels but the finest of the photographs; u stays on the device.
    fn descend(
        &mut self,
        frames: &[Frame],
        input: &SweepInput<'_>,
        done: &mut IterationDone<'_>,
    ) -> Result<(SharedParameters, ExcludedPixels), Error> {
        let levels = self.whole.level_count() + usize::from(self.parts.is_some());
        let excluded = ExcludedPixels::new(frames, input.reference, &self.settings, levels);
        if self.parts.is_none() {
            self.whole.upload(frames, input.reference)?;
            done(self.whole.upload_work(), false);
            let shared = self.whole.descend(input, &excluded, 1, done)?;
            return Ok((shared, excluded));
        }
        let excluded = excluded.halved();
        self.whole.upload(&parts::halved(frames, &self.settings)?, input.reference)?;
        done(self.whole.upload_work(), false);
        let shared = self.whole.descend(input, &excluded, 0, done)?;
        Ok((parts::doubled(&shared, self.size), excluded))
    }

    fn registration(&self, shared: SharedParameters) -> JointRegistration {
        let of = |&(gain, shading): &_| Brightness {
            photometric: Photometric { gain, offset: 0.0 },
            shading,
            ..Brightness::identity(self.size)
        };
        JointRegistration {
            brightness: shared.brightness.iter().map(of).collect(),
            transforms: shared.transforms,
            parallax: shared.parallax,
            parallax_deviation: shared.parallax_deviation,
            rate: shared.rate,
            settings: shared.settings,
            unlike: shared.unlike,
        }
    }
}

/// Returns a function that reports progress when some work is done. `work`: of each level or part, in pixels times
/// iterations; `after`: what the caller does with the results, in the same unit.
fn counter<'a>(work: &[u64], after: f64, report: &'a mut dyn FnMut(Progress)) -> impl FnMut(u64, bool) + use<'a> {
    let add = |sum: &mut u64, work: &u64| {
        *sum += work;
        Some(*sum)
    };
    let ends: Vec<u64> = work.iter().scan(0, add).collect();
    let all = after + ends.last().copied().unwrap_or(1) as f64;
    let (mut done, mut worked) = (0, 0);
    move |pixels, ends_level| {
        worked += pixels;
        if ends_level {
            // Corrects rounding; and if the pyramid has one level, it has one iteration less than was counted.
            worked = ends.get(done).copied().unwrap_or(worked);
            done += 1;
        }
        report(Progress { done: done as u32, total: ends.len() as u32, share: (worked as f64 / all).min(1.0) });
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::base::Samples;
    use crate::engine::{EngineOptions, testing};
    use crate::lab::scene::{Preset, Scene, SimulatedSweep, SweepScene};

    const FRAMES: usize = 5;

    fn sweep(width: u32, height: u32) -> SimulatedSweep {
        let scene = Scene { width, height, noise: 0.003, ..Preset::Relief.scene() };
        let sweep = SweepScene {
            breathing: 0.03,
            drift: 5.0,
            rotation: 0.004,
            gain_drift: 0.03,
            vignetting: 0.04,
            ..SweepScene::new(scene, FRAMES)
        };
        sweep.render().unwrap()
    }

    const SETTINGS: [f64; FRAMES] = [0.0, 1.0, 2.0, 3.0, 4.0];

    fn input(sweep: &SimulatedSweep) -> SweepInput<'static> {
        SweepInput { settings: &SETTINGS, are_settings_known: true, reference: sweep.reference }
    }

    fn solver(engine: &Engine, sweep: &SimulatedSweep, memory: u64, settings: &Settings) -> JointSolver {
        let size = [sweep.frames[0].width(), sweep.frames[0].height()];
        let solver = JointSolver::within(memory, engine, size, sweep.frames[0].format(), FRAMES, settings).unwrap();
        assert_eq!(solver.parts.is_some(), memory < MEMORY);
        solver
    }

    fn run(solver: &mut JointSolver, sweep: &SimulatedSweep) -> Result<JointSolution, Error> {
        solver.solve(&sweep.frames, &input(sweep), &CancellationToken::default(), &mut |_| ())
    }

    fn solve(sweep: &SimulatedSweep, memory: u64, settings: &Settings) -> JointSolution {
        let engine = Engine::new(&testing::options()).unwrap();
        run(&mut solver(&engine, sweep, memory, settings), sweep).unwrap()
    }

    fn bits(solution: &JointSolution) -> (Vec<u32>, Vec<u32>, &JointRegistration) {
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect();
        (bits(&solution.focus), bits(&solution.deviation), &solution.registration)
    }

    /// Median and 99th percentile of |u - truth| in settings, of the pixels that have a result and satisfy `counts`.
    fn errors(solution: &JointSolution, truth: &[f32], counts: impl Fn(usize) -> bool) -> [f32; 2] {
        let measured = (0..truth.len()).filter(|&i| solution.deviation[i] < 2.0 && counts(i));
        let mut errors: Vec<f32> = measured.map(|i| (solution.focus[i] - truth[i]).abs()).collect();
        errors.sort_by(f32::total_cmp);
        [errors[errors.len() / 2], errors[errors.len() * 99 / 100]]
    }

    /// The largest error of a frame's corner, px.
    fn corner_error(sweep: &SimulatedSweep, solution: &JointSolution) -> f64 {
        let [width, height] = [sweep.frames[0].width(), sweep.frames[0].height()];
        let pairs = sweep.shots.iter().zip(&solution.registration.transforms);
        pairs.map(|(shot, t)| t.corner_distance(Homography::from(shot.transform), width, height)).fold(0.0, f64::max)
    }

    /// Vulkan devices give the u of the CPU device but for rounding.
    #[test]
    fn devices_solve_a_sweep_alike() {
        let sweep = sweep(211, 167);
        let cpu = EngineOptions { device: Some("CPU".into()), ..EngineOptions::default() };
        let [vulkan, cpu] = [testing::options(), cpu].map(|options| {
            let engine = Engine::new(&options).unwrap();
            run(&mut solver(&engine, &sweep, MEMORY, &Settings::default()), &sweep).unwrap()
        });
        let mut differences: Vec<f32> = vulkan.focus.iter().zip(&cpu.focus).map(|(a, b)| (a - b).abs()).collect();
        differences.sort_by(f32::total_cmp);
        let [median, largest] = [differences.len() / 2, differences.len() - 1].map(|n| differences[n]);
        println!("difference of u: {median} in the median, {largest} at most");
        assert!(largest < 1e-3 && median < 1e-5, "{median} {largest}");
    }

    /// A near card over a far ground: with the search for outlines at most a quarter as many pixels around the rim are
    /// wrong.
    #[test]
    fn outlines_of_a_card_are_sharp() {
        let scene = Scene { width: 320, height: 256, noise: 0.003, ..Preset::Card.scene() };
        let sweep = SweepScene { blur_rate: 1.5, ..SweepScene::new(scene, FRAMES) }.render().unwrap();
        let [width, height] = [320usize, 256];
        let at = |x: usize, y: usize| sweep.focus[y.min(height - 1) * width + x.min(width - 1)];
        let is_rim = |x: usize, y: usize| (at(x, y) - at(x + 1, y)).abs().max((at(x, y) - at(x, y + 1)).abs()) > 0.5;
        let rims: Vec<[usize; 2]> =
            (0..width * height).map(|i| [i % width, i / width]).filter(|&[x, y]| is_rim(x, y)).collect();
        let near =
            |i: usize| rims.iter().any(|&[x, y]| x.abs_diff(i % width).pow(2) + y.abs_diff(i / width).pow(2) <= 64);
        let around: Vec<usize> = (0..width * height).filter(|&i| near(i)).collect();
        let wrong = |edges: bool| {
            let solution = solve(&sweep, MEMORY, &Settings { edges, ..Settings::default() });
            let is_wrong = |&&i: &&usize| (solution.focus[i] - sweep.focus[i]).abs() > 0.3;
            around.iter().filter(is_wrong).count() as f64 / around.len() as f64
        };
        let [with, without] = [true, false].map(wrong);
        println!("wrong within 8 px of the rim: {with:.3} with the search, {without:.3} without it");
        assert!(without > 0.2 && with < 0.25 * without, "{with} {without}");
    }

    #[test]
    fn without_jumps_outlines_change_no_bit() {
        let sweep = sweep(168, 126);
        let [with, without] =
            [true, false].map(|edges| solve(&sweep, MEMORY, &Settings { edges, ..Settings::default() }));
        assert!(bits(&with) == bits(&without));
    }

    #[test]
    fn a_reused_solver_gives_the_bits_of_a_new_one() {
        let engine = Engine::new(&testing::options()).unwrap();
        for (size, memory) in [([168, 126], MEMORY), ([400, 220], 4 << 20)] {
            let first = sweep(size[0], size[1]);
            let mut second = first.clone();
            // Another scene and a mask, so that other pairs, tiles and excluded pixels are left behind.
            second.frames.reverse();
            let mask = vec![1; (size[0] * size[1]) as usize];
            second.frames = second.frames.into_iter().map(|frame| frame.without(&mask)).collect();
            let settings = Settings::default();
            let fresh = run(&mut solver(&engine, &first, memory, &settings), &first).unwrap();
            let mut solver = solver(&engine, &second, memory, &settings);
            run(&mut solver, &second).unwrap();
            assert!(bits(&run(&mut solver, &first).unwrap()) == bits(&fresh));
        }
    }

    #[test]
    fn parts_give_the_result_of_the_whole() {
        let sweep = sweep(520, 390);
        let settings = Settings::default();
        let [whole, parts] = [MEMORY, 16 << 20].map(|memory| solve(&sweep, memory, &settings));
        let [of_whole, of_parts] = [&whole, &parts].map(|solution| errors(solution, &sweep.focus, |_| true));
        let corners = [&whole, &parts].map(|solution| corner_error(&sweep, solution));
        let mut differences: Vec<f32> = whole.focus.iter().zip(&parts.focus).map(|(a, b)| (a - b).abs()).collect();
        differences.sort_by(f32::total_cmp);
        println!(
            "whole {of_whole:?}, parts {of_parts:?}, corners {corners:?}, differences {} {}",
            differences[differences.len() / 2],
            differences[differences.len() * 99 / 100]
        );
        // In settings. Registration at half the size adds to the error.
        assert!(of_parts[0] < 1.1 * of_whole[0] + 0.002 && of_parts[1] < 1.2 * of_whole[1]);
        assert!(corners[1] < 1.2 * corners[0] + 0.01);
        assert!(differences[differences.len() / 2] < 0.003 && differences[differences.len() * 99 / 100] < 0.03);
    }

    #[test]
    fn a_sweep_obeys_the_memory_of_the_engine() {
        let is_in_parts = |memory| {
            let device = Some("cpu".into());
            let options = EngineOptions { device, validation: false, memory, ..testing::options() };
            let engine = Engine::new(&options).unwrap();
            let format = Format { channels: Channels::Gray, depth: Depth::F32 };
            let solver = JointSolver::new(&engine, [520, 390], format, FRAMES, &Settings::default()).unwrap();
            solver.parts.is_some()
        };
        assert_eq!([None, Some(16 << 20)].map(is_in_parts), [false, true]);
    }

    #[test]
    fn register_gives_the_registration_of_solve() {
        let (sweep, engine) = (sweep(168, 126), Engine::new(&testing::options()).unwrap());
        let mut solver = solver(&engine, &sweep, MEMORY, &Settings::default());
        let mut reports = Vec::new();
        let (input, cancel) = (input(&sweep), CancellationToken::default());
        let alone = solver.register(&sweep.frames, &input, &cancel, &mut |progress| reports.push(progress)).unwrap();
        assert_eq!(alone, run(&mut solver, &sweep).unwrap().registration);
        // Frames uploaded, start estimated, four iterations.
        assert_eq!(
            reports.iter().map(|p| (p.done, p.total)).collect::<Vec<_>>(),
            [[(0, 1); 5].as_slice(), &[(1, 1)]].concat()
        );
        // The frames have four times the pixels of the level.
        for (report, done) in reports.iter().zip([1.8, 221.8, 222.8, 223.8, 224.8, 225.8]) {
            assert!((report.share - done / 225.8).abs() < 1e-4, "{reports:?}");
        }
    }

    #[test]
    fn progress_rises_with_and_without_outlines_and_in_parts() {
        let options = EngineOptions { device: Some("cpu".into()), validation: false, ..testing::options() };
        let engine = Engine::new(&options).unwrap();
        for (edges, memory, size) in
            [(true, MEMORY, [168, 126]), (false, MEMORY, [168, 126]), (true, 16 << 20, [520, 390])]
        {
            let (sweep, mut reports) = (sweep(size[0], size[1]), Vec::new());
            let mut solver = solver(&engine, &sweep, memory, &Settings { edges, ..Settings::default() });
            let (input, cancel) = (input(&sweep), CancellationToken::default());
            solver.solve(&sweep.frames, &input, &cancel, &mut |progress| reports.push(progress)).unwrap();
            let shares: Vec<f64> = reports.iter().map(|p| p.share).collect();
            assert!(shares.is_sorted() && shares[0] > 0.0, "{shares:?}");
            let last = reports[reports.len() - 1];
            assert!(last.done == last.total && (0.8..1.0).contains(&last.share), "{last:?}, edges {edges}, {size:?}");
        }
    }

    #[test]
    fn a_sweep_has_one_time_limit() {
        let sweep = sweep(168, 126);
        let solve = |options: &EngineOptions| {
            let engine = Engine::new(options).unwrap();
            let mut solver = solver(&engine, &sweep, MEMORY, &Settings::default());
            let started = Instant::now();
            (run(&mut solver, &sweep).map(drop), started.elapsed())
        };
        // The first solve may also compile pipelines.
        let [_, (solved, whole)] = [(); 2].map(|()| solve(&testing::options()));
        solved.unwrap();
        // No script of a sweep takes as long as a third of it.
        let (solved, _) = solve(&EngineOptions { timeout: whole / 3, ..testing::options() });
        assert!(matches!(solved, Err(Error::Timeout { .. })), "{solved:?}");
    }

    #[test]
    fn a_missing_frame_leaves_a_gap_unless_settings_are_known() {
        let mut sweep = sweep(168, 126);
        sweep.frames.remove(1);
        let engine = Engine::new(&testing::options()).unwrap();
        let format = sweep.frames[0].format();
        let mut solver = JointSolver::new(&engine, [168, 126], format, FRAMES - 1, &Settings::default()).unwrap();
        for (are_settings_known, settings) in [(false, [0.0, 2.0, 3.0, 4.0]), (true, [0.0, 1.0, 2.0, 3.0])] {
            let input = SweepInput { settings: &[0.0, 1.0, 2.0, 3.0], are_settings_known, reference: 1 };
            let registered =
                solver.register(&sweep.frames, &input, &CancellationToken::default(), &mut |_| ()).unwrap();
            assert_eq!(registered.settings, settings);
        }
    }

    #[test]
    fn clipped_pixels_do_not_count() {
        let mut sweep = sweep(260, 200);
        for frame in &mut sweep.frames {
            let Samples::F32(values) = frame.samples() else { unreachable!() };
            // A fifth of the frame is white.
            let clipped = values.iter().map(|v| (1.8 * v).min(1.0)).collect();
            *frame = Frame::gray(frame.width(), frame.height(), clipped).unwrap();
        }
        let stated = Settings { white_level: Some(1.0), ..Settings::default() };
        let solutions = [Settings::default(), stated].map(|settings| solve(&sweep, MEMORY, &settings));
        let [plain, stated] = solutions.each_ref().map(|solution| errors(solution, &sweep.focus, |_| true));
        let corners = solutions.each_ref().map(|solution| corner_error(&sweep, solution));
        println!("plain {plain:?}, white level stated {stated:?}, corners {corners:?}");
        assert!(stated[0] < 0.95 * plain[0] && corners[1] < 0.7 * corners[0]);
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let clean = sweep(260, 200);
        let mut dirty = clean.clone();
        let masked = |i: usize| (40..140).contains(&(i % 260)) && (50..150).contains(&(i / 260));
        for (n, frame) in dirty.frames.iter_mut().enumerate() {
            let Samples::F32(values) = frame.samples() else { unreachable!() };
            // A pattern that moves by 3 px from frame to frame.
            let at = |i: usize| if masked(i) { 0.5 + 0.4 * ((i % 260 + 3 * n) as f32).sin() } else { values[i] };
            *frame = Frame::gray(260, 200, (0..values.len()).map(at).collect()).unwrap();
        }
        let mask: Vec<u8> = (0..260 * 200).map(|i| u8::from(!masked(i))).collect();
        let settings = Settings::default();
        let without = solve(&dirty, MEMORY, &settings);
        dirty.frames = dirty.frames.into_iter().map(|frame| frame.without(&mask)).collect();
        let with = solve(&dirty, MEMORY, &settings);
        let clean = solve(&clean, MEMORY, &settings);
        let of =
            |solution: &JointSolution| (errors(solution, &dirty.focus, |i| !masked(i)), corner_error(&dirty, solution));
        println!("clean {:?}, masked {:?}, not {:?}", of(&clean), of(&with), of(&without));
        assert!(of(&with).0[0] < 1.3 * of(&clean).0[0] && of(&with).1 < 0.06);
        assert!((60..120).all(|x| (70..130).all(|y| with.deviation[y * 260 + x].is_nan())));
    }
}
