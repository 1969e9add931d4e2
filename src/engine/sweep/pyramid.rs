//! The joint solve on the device, from a coarse level of the frames' pyramid to the finest.

use super::device::{Limits, SweepDevice};
use super::pairs::{self, PairSums, Step};
use super::shared::{ITERATIONS, SharedParameters};
use super::start::{Frames, Motion, Registration};
use super::validity::{self, ExcludedPixels, FinalSystem};
use super::{contrast, outlines, spacing, start};
use crate::base::statistics::median;
use crate::base::{Error, Frame, Homography, Method, ParallaxSearch, Settings, Shading};
use crate::engine::Engine;
use crate::engine::plan::{Level, Plan};
use crate::engine::script::sweep::{self, RegistrationStep};
use crate::engine::slot::Slot;
use crate::engine::stages::sums::{Layout, Sums, UNKNOWNS};
use crate::engine::stages::update_transform::displacing;
use crate::engine::stages::{Field, half_pair, prolong, system, system_tiles};
use crate::engine::tiles::Ranges;

/// The focus settings, the reference and the mask of a sweep.
pub struct SweepInput<'a> {
    /// The focus settings of the frames, ascending, about one step apart.
    pub settings: &'a [f64],
    /// Whether the settings are known. If not, those that the sweep itself shows are used where it shows that they are
    /// uneven.
    pub are_settings_known: bool,
    /// The frame on whose pixels the results are.
    pub reference: usize,
}

/// The longest side of the level where a solve starts, px.
const START_SIDE: u32 = 160;
/// The largest step of ln c downwards and upwards. Where frames do not differ in blur, Gauss-Newton steps are near -1,
/// and the few iterations end before smaller ones bring c near 0: with steps of -0.3, frames of one focus setting
/// seemed to differ by up to 1.4 px of blur, now by up to 0.64 px. Sweeps that fit have no step below -0.3.
const RATE_STEPS: [f64; 2] = [-1.0, 0.3];
/// Relaxation sweeps per step. Iterations are expensive, since each makes a blur stack of every frame; relaxation
/// sweeps are not.
pub(super) const RELAXATION_SWEEPS: u32 = 3;
/// The largest move of a frame's corner in one step of T, px of the level: coarser levels have brought it closer.
const MAX_CORNER_STEP: f64 = 0.5;
/// A frame is resampled again once T has moved a corner by this, px of the level.
const RESAMPLE_AFTER: f64 = 0.02;
/// Time to upload a frame and to compute its pyramid, relative to that of an iteration on the finest level. This and
/// the next two are from four real sweeps on the CPU device.
const UPLOAD: f64 = 0.45;
/// Time to estimate the start, relative to that of an iteration on the first level for one frame. It depends little on
/// the number of frames.
const START: f64 = 1100.0;
/// Time per pixel of all iterations on the finest level, one or two, relative to one iteration on a coarser level.
const FINEST: f64 = 1.5;
/// Time of the search for outlines on a level, per pixel of the finest, relative to the same iteration: 0.2 to 0.8 on three real sweeps. Coarser
/// levels have fewer cells, but more of them have an edge.
const OUTLINES: f64 = 0.4;

/// The least blur of a sweep that differences of frames tell on the level of the start, px: below, contrast on a finer
/// level tells more.
const LEAST_BLUR: f64 = 1.0;
/// How many levels finer that is. Of three sweeps taken by hand, of 700 px, u by contrast and u of a plain sharpness
/// measure at full size have rank correlations of 0.86 to 0.90, one level coarser 0.64 to 0.84, on the level of the start
/// 0.25 to 0.48.
pub(in crate::engine) const CONTRAST_LEVELS: usize = 2;
/// Contrast counts if it finds at least this share of the rate of blur that differences find.
const MISLED: f64 = 0.25;
/// The least longer side of a level that says how certain u is, px: on smaller ones a window is a thirtieth of the frame.
const LEAST_MEASURED: u32 = 320;
/// The standard deviation by a level over that of the next coarser one, if its texture says as much: a window of it has a
/// quarter of the area.
const WIDER: f64 = 2.0;
/// The most of the differences between frames that parallax may leave on the level of the start to be adopted. It leaves
/// 0.69 and 0.92 of two sweeps taken by hand, 0.83 to 0.97 of generated ones with 2 to 8 px between near and far of 320 px,
/// and 0.99 to 1.001 of ten of cameras that stood still or nearly so.
const MOVED: f64 = 0.98;
/// A frame does not lie on the one before it if they differ by this share of their contrast, and by this multiple of what
/// other neighbours do.
const UNLIKE: [f64; 2] = [0.4, 3.0];

/// Called after each finished part of the preparation, each iteration, and each level of the search for outlines, with
/// the work since the last call, in pixels of an iteration, and whether the level or part ends with it.
pub(super) type IterationDone<'a> = dyn FnMut(u64, bool) + 'a;

/// The level where a solve starts.
pub(in crate::engine) fn first_level(plan: &Plan) -> usize {
    let longest = |level: &Level| level.size[0].max(level.size[1]);
    let coarsest = plan.pyramid.len() - 1;
    plan.pyramid.iter().position(|level| longest(level) <= START_SIDE).unwrap_or(coarsest)
}

/// A solver for frames of one size, format and number. u stays on the device between its methods.
pub(super) struct PyramidSolver {
    plan: Plan,
    device: SweepDevice,
    frames: usize,
    /// Words per pixel of the current level that state which frames are excluded there; 0 if none is.
    excluded_words: u32,
    /// Pixels of the current level that count in two frames or more.
    valid_pixels: f64,
    /// The median standard deviation of u on the finest level before outlines move; `None` if no pixel has one.
    pub(super) median_deviation: Option<f64>,
    /// u and its standard deviation by the coarser levels, on the last of them.
    pub(super) measured: Option<[Field; 2]>,
}

impl PyramidSolver {
    /// Prepares for `frames` frames.
    pub(super) fn new(engine: &Engine, plan: Plan, frames: usize) -> Result<Self, Error> {
        let device = SweepDevice::new(engine, &plan, frames as u32)?;
        Ok(Self { plan, device, frames, excluded_words: 0, valid_pixels: 0.0, median_deviation: None, measured: None })
    }

    pub(super) fn set_limits(&mut self, limits: Limits) {
        self.device.limits = limits;
    }

    pub(super) fn settings(&self) -> &Settings {
        &self.plan.settings
    }

    pub(super) fn finest(&self) -> &Level {
        &self.plan.pyramid[0]
    }

    /// The number of levels of a solve.
    pub(super) fn level_count(&self) -> usize {
        first_level(&self.plan) + 1
    }

    /// The work of `upload`, in pixels of an iteration on as many frames.
    pub(super) fn upload_work(&self) -> u64 {
        (UPLOAD * self.plan.pyramid[0].pixels() as f64) as u64
    }

    /// The work on each level down to `last`, coarse to fine, without the final iterations on the finest, in pixels of
    /// an iteration. The first includes the upload and the estimate of the start.
    pub(super) fn work_above(&self, last: usize) -> Vec<u64> {
        let first = first_level(&self.plan);
        let iterations = |index: usize| if index < first { ITERATIONS[1] } else { ITERATIONS[0] };
        let mut work: Vec<u64> = (last.min(first)..=first)
            .rev()
            .map(|index| iterations(index) as u64 * self.plan.pyramid[index].pixels())
            .collect();
        work[0] += self.upload_work() + self.start_work();
        work
    }

    fn start_work(&self) -> u64 {
        (START / self.frames as f64 * self.plan.pyramid[first_level(&self.plan)].pixels() as f64) as u64
    }

    /// The work on the finest level, or on a part of it, with T and c held, and of the search for outlines, in pixels of
    /// an iteration.
    pub(super) fn final_work(&self) -> u64 {
        self.finest_work() + outlines::levels(&self.plan).count() as u64 * self.outlines_work()
    }

    fn finest_work(&self) -> u64 {
        (FINEST * self.plan.pyramid[0].pixels() as f64) as u64
    }

    /// The work of the search for outlines on a level.
    fn outlines_work(&self) -> u64 {
        (OUTLINES * self.plan.pyramid[0].pixels() as f64) as u64
    }

    /// Uploads the frames and computes their pyramids.
    pub(super) fn upload(&mut self, frames: &[Frame], reference: usize) -> Result<(), Error> {
        self.device.upload_frames(frames, reference)
    }

    /// Estimates the start, and solves from there down to level `last`, with steps of T and c. `done` is called after
    /// each iteration with its pixels, and whether its level ends with it.
    pub(super) fn descend(
        &mut self,
        input: &SweepInput<'_>,
        excluded: &ExcludedPixels,
        last: usize,
        done: &mut IterationDone<'_>,
    ) -> Result<SharedParameters, Error> {
        let first = first_level(&self.plan);
        let (mut shared, focus) = self.start(first, input)?;
        done(self.start_work(), false);
        self.device.fill(Slot::RelativeBlur { level: first }, &focus)?;
        self.measured = None;
        for index in (last.min(first)..=first).rev() {
            if index < first {
                self.prolong(index, &shared)?;
            }
            let level = self.plan.pyramid[index].clone();
            self.enter(&level, &mut shared, excluded)?;
            // If there is one level only, `finish` makes its last iteration.
            let count = if index < first { ITERATIONS[1] } else { ITERATIONS[0] - usize::from(index < last) };
            for n in 1..=count {
                self.iterate(&level, &mut shared)?;
                done(level.pixels(), n == count);
            }
            if index < first && level.size[0].max(level.size[1]) >= LEAST_MEASURED {
                self.sum_pairs(&level, &mut shared, RegistrationStep::Held)?;
                let (focus, layers) = (self.focus(&level)?, self.system(&level)?);
                let deviation = self.deviation(&level, &shared, FinalSystem::after_step(layers, &focus, &focus))?;
                let deviation = self.with_coarser(&focus, deviation);
                self.measured = Some([focus, deviation]);
            }
        }
        Ok(shared)
    }

    /// Solves the finest level from the one above, with T and c held. Returns u relative to the middle setting, and its
    /// standard deviation.
    pub(super) fn finish(
        &mut self,
        shared: &mut SharedParameters,
        excluded: &ExcludedPixels,
        done: &mut IterationDone<'_>,
    ) -> Result<[Field; 2], Error> {
        if first_level(&self.plan) == 0 {
            return self.refine(1, shared, excluded, done);
        }
        self.prolong(0, shared)?;
        self.refine(shared.finest_iterations(), shared, excluded, done)
    }

    /// Solves the finest level from `start`, u relative to the middle setting.
    pub(super) fn finish_from(
        &mut self,
        start: &Field,
        shared: &mut SharedParameters,
        excluded: &ExcludedPixels,
        done: &mut IterationDone<'_>,
    ) -> Result<[Field; 2], Error> {
        self.device.fill(Slot::RelativeBlur { level: 0 }, start)?;
        self.refine(shared.finest_iterations(), shared, excluded, done)
    }

    fn refine(
        &mut self,
        iterations: usize,
        shared: &mut SharedParameters,
        excluded: &ExcludedPixels,
        done: &mut IterationDone<'_>,
    ) -> Result<[Field; 2], Error> {
        let level = self.plan.pyramid[0].clone();
        self.enter(&level, shared, excluded)?;
        let mut system = None;
        for n in 1..=iterations {
            let (_, rate) = self.sum_pairs(&level, shared, RegistrationStep::Held)?;
            let layers = self.system(&level)?;
            let before = self.focus(&level)?;
            self.step(&level, shared, rate)?;
            system = FinalSystem::after_step(layers, &before, &self.focus(&level)?).or(system);
            let is_last = n == iterations && !self.plan.settings.edges;
            done(self.finest_work() / iterations as u64, is_last);
        }
        let (focus, deviation) = (self.focus(&level)?, self.deviation(&level, shared, system)?);
        self.median_deviation = median(deviation.data.iter().copied());
        let mut deviation = self.with_coarser(&focus, deviation);
        for (deviation, u) in deviation.data.iter_mut().zip(&focus.data) {
            *deviation = deviation.hypot(shared.parallax_scale * u);
        }
        match self.plan.settings.edges {
            true => {
                let (words, per_pixel) = (excluded.words(&level, &shared.transforms), self.excluded_words as usize);
                let counts = |i: usize| {
                    per_pixel == 0 || validity::is_in_two_frames(&words[per_pixel * i..][..per_pixel], self.frames)
                };
                let work = self.outlines_work();
                outlines::sharpen(&self.plan, &mut self.device, shared, [focus, deviation], counts, &mut |level| {
                    done(work, level.index == 0);
                })
            }
            false => Ok([focus, deviation]),
        }
    }

    /// The layers of the linear system of a level.
    fn system(&mut self, level: &Level) -> Result<Vec<Field>, Error> {
        self.device.read(Slot::NormalEquations, level.size, 0..half_pair::LAYERS)
    }

    /// The standard deviation of u by what a level shows; NaN where it shows nothing.
    fn deviation(
        &mut self,
        level: &Level,
        shared: &SharedParameters,
        system: Option<FinalSystem>,
    ) -> Result<Field, Error> {
        let focus = self.focus(level)?;
        let mut end = |n: usize| {
            let mut layers = self.device.read(Slot::Aligned, level.size, n as u32..n as u32 + 1)?;
            Ok::<_, Error>((layers.swap_remove(0), validity::visible(&shared.transforms[n], level)))
        };
        let ends = [end(0)?, end(self.frames - 1)?];
        let unknown = || Field::from_fn(focus.width, focus.height, |_, _| f64::NAN);
        Ok(system.map_or_else(unknown, |system| system.deviation(&focus, &ends)))
    }

    /// The standard deviation of u on a level, or what coarser levels say where that is less: photographs that are not
    /// sharp to the pixel show their texture there. The distance from their u adds to theirs.
    fn with_coarser(&self, focus: &Field, mut deviation: Field) -> Field {
        let Some(measured) = &self.measured else { return deviation };
        let [width, height] = [focus.width, focus.height].map(|side| side as u32);
        let constants = prolong::Constants { width, height, limit: f32::MAX, gain: 1.0 };
        let [u, of_u] = measured.each_ref().map(|field| prolong::cpu_reference(&constants, field));
        for (i, deviation) in deviation.data.iter_mut().enumerate() {
            // If one of them is NaN, `min` gives the other.
            *deviation = deviation.min((WIDER * of_u.data[i]).hypot(focus.data[i] - u.data[i]));
        }
        deviation
    }

    /// u of a level, relative to the middle setting.
    pub(super) fn focus(&mut self, level: &Level) -> Result<Field, Error> {
        let layers = self.device.read(Slot::RelativeBlur { level: level.index }, level.size, 0..1);
        layers.map(|mut layers| layers.swap_remove(0))
    }

    fn prolong(&mut self, index: usize, shared: &SharedParameters) -> Result<(), Error> {
        let level = &self.plan.pyramid[index];
        self.device.run(&sweep::prolong(&self.plan, level, shared.limit(level) as f32))
    }

    /// Prepares for a level: every frame is to be resampled, and the excluded pixels are uploaded.
    fn enter(&mut self, level: &Level, shared: &mut SharedParameters, excluded: &ExcludedPixels) -> Result<(), Error> {
        shared.resampled = vec![None; self.frames];
        let words = excluded.words(level, &shared.transforms);
        self.excluded_words = (words.len() as u64 / level.pixels()) as u32;
        self.valid_pixels = level.pixels() as f64;
        if self.excluded_words > 0 {
            self.valid_pixels = validity::count_in_two_frames(&words, self.frames) as f64;
            self.device.write_words(Slot::Hidden, &words)?;
        }
        Ok(())
    }

    /// The start on a level: registration, brightness, settings if they are not known, c, and u relative to the middle
    /// setting.
    fn start(&mut self, first: usize, input: &SweepInput<'_>) -> Result<(SharedParameters, Field), Error> {
        let (reference, unknowns) = (input.reference, self.unknowns());
        let frames = self.read_frames(first)?;
        let appearance = start::appearance(&frames);
        let registered = start::register(&appearance, reference, &Registration { start: &[], unknowns, focus: None });
        let mut motions: Vec<Motion> = registered.iter().map(|frame| frame.motion).collect();
        let most = UNLIKE[0].max(UNLIKE[1] * median(registered.iter().map(|frame| frame.unlike)).unwrap_or(0.0));
        let unlike = (0..self.frames).filter(|n| registered[*n].unlike > most).collect();
        let brightness = if self.plan.settings.photometric {
            start::brightness(&frames, &motions, reference)
        } else {
            vec![(1.0, Shading::NONE); self.frames]
        };
        let resampled = start::resample(&frames, &motions, None, &brightness);
        let (mut settings, mut rate) = (input.settings.to_vec(), start::rate(&resampled, input.settings));
        if !input.are_settings_known {
            let finer = || {
                let finer = first.checked_sub(1).map(|level| self.read_frames(level)).transpose()?;
                Ok::<_, Error>(finer.map(|frames| start::resample(&frames, &motions, None, &brightness)))
            };
            if let Some(uneven) = spacing::uneven_settings(&resampled, &settings, rate, finer)? {
                rate = start::rate(&resampled, &uneven);
                settings = uneven;
            }
        }
        let middle = 0.5 * (settings[0] + settings[self.frames - 1]);
        let range = settings[self.frames - 1] - settings[0];
        let mut by_contrast = None;
        if rate.sqrt() * range < LEAST_BLUR {
            let finer = self.read_frames(first.saturating_sub(CONTRAST_LEVELS))?;
            let every = frames.level.factor / finer.level.factor;
            let finer = start::resample(&finer, &motions, None, &brightness);
            let contrast = contrast::by_contrast(&finer, &settings, every as usize);
            let found = contrast.rate / every.powi(2);
            if found > MISLED * rate {
                (rate, by_contrast) = (found, Some(contrast.focus));
            }
        }
        let mut focus = by_contrast.unwrap_or_else(|| start::focus(&resampled, &settings, rate));
        focus.data.iter_mut().for_each(|u| *u -= middle);
        let finds_parallax = match self.plan.settings.parallax {
            ParallaxSearch::Auto => unknowns > 0,
            stated => stated == ParallaxSearch::On,
        };
        if finds_parallax {
            let registration = Registration { start: &motions, unknowns, focus: Some(&focus) };
            let with_parallax = start::register(&appearance, reference, &registration);
            let [then, before] =
                [&with_parallax, &registered].map(|all| all.iter().map(|frame| frame.left).sum::<f64>());
            if then < MOVED * before {
                motions = with_parallax.iter().map(|frame| frame.motion).collect();
            }
        }
        let shared = SharedParameters {
            settings,
            middle,
            reference,
            rate: rate * frames.level.factor * frames.level.factor,
            transforms: motions.iter().map(|motion| motion.transform).collect(),
            resampled: vec![None; self.frames],
            parallax: motions.iter().map(|motion| motion.parallax).collect(),
            parallax_deviation: vec![[0.0; 2]; self.frames],
            parallax_scale: 0.0,
            brightness,
            pairs_per_pixel: 1.0,
            unlike,
        };
        Ok((shared, focus))
    }

    /// Unknowns of T of a frame: none if the frames are aligned.
    fn unknowns(&self) -> usize {
        if self.plan.settings.method == Method::Aligned { 0 } else { self.plan.settings.motion.unknowns() }
    }

    fn read_frames(&mut self, level: usize) -> Result<Frames, Error> {
        let (slot, level) = (Slot::Frames { level }, self.plan.pyramid[level].clone());
        let images = self.device.read(slot, level.size, 0..self.frames as u32)?;
        Ok(Frames { images, level })
    }

    /// One iteration on a level: steps of u, T and c.
    fn iterate(&mut self, level: &Level, shared: &mut SharedParameters) -> Result<(), Error> {
        let (sums, rate) = self.sum_pairs(level, shared, RegistrationStep::Free)?;
        let evidence = if shared.steps_parallax(RegistrationStep::Free) {
            let (d, focus) = (self.system(level)?.swap_remove(0), self.focus(level)?);
            d.data.iter().zip(&focus.data).map(|(d, u)| d * u * u).sum()
        } else {
            0.0
        };
        let eliminated = self.step(level, shared, rate)?;
        let own: [f64; 2] = [0, 1].map(|n| sums.iter().map(|pair| pair.sums.roughness[n]).sum());
        // c steps with u eliminated.
        let step = -(own[1] + eliminated[0]) / (own[0] - eliminated[1]).max(1e-9);
        shared.rate *= step.clamp(RATE_STEPS[0], RATE_STEPS[1]).exp();
        let (steps, tiles) = pairs::registration_steps(&sums, self.frames, shared.reference, self.unknowns());
        // From pixels of the level at half the range.
        let to_full = level.factor / shared.half_range();
        for (n, Step { transform, parallax }) in steps.into_iter().enumerate() {
            shared.transforms[n] = shared.transforms[n].after(&self.limited_displacement(level, transform));
            let share = (MAX_CORNER_STEP / parallax[0].hypot(parallax[1])).min(1.0);
            for (p, moved) in shared.parallax[n].iter_mut().zip(parallax) {
                *p += share * moved * to_full;
            }
            let scatter = |c: usize| tiles.iter().fold(0.0, |sum, moves| sum + moves[n][c].powi(2));
            shared.parallax_deviation[n] = [0, 1].map(|c| to_full * scatter(c).sqrt());
        }
        if evidence > 0.0 {
            let parallax: Vec<[f64; 2]> = shared.parallax.iter().map(|p| p.map(|px| px / to_full)).collect();
            let along = |moves: &Vec<[f64; 2]>| {
                moves.as_flattened().iter().zip(parallax.as_flattened()).map(|(a, b)| a * b).sum::<f64>()
            };
            let size = tiles.iter().map(|moves| along(moves).powi(2)).sum::<f64>().sqrt() / along(&parallax);
            let displaced: f64 = sums.iter().map(|pair| pair.displaced(&parallax)).sum();
            shared.parallax_scale = size * (displaced / evidence).min(1.0);
        }
        Ok(())
    }

    /// Sums the linear systems of all pairs on the device; returns the sums of their registrations, and c of the level.
    fn sum_pairs(
        &mut self,
        level: &Level,
        shared: &mut SharedParameters,
        registration: RegistrationStep,
    ) -> Result<(Vec<PairSums>, f64), Error> {
        self.resample(level, shared)?;
        let rate = shared.rate_on(level);
        let sums = self.half_pairs(level, shared, registration)?;
        shared.pairs_per_pixel = sums.iter().map(|pair| pair.sums.valid).sum::<f64>() / self.valid_pixels.max(1.0);
        Ok((sums, rate))
    }

    /// A step of T, shortened if it moves a corner too far.
    fn limited_displacement(&self, level: &Level, x: [f64; UNKNOWNS]) -> Homography {
        let [width, height] = self.plan.size;
        let step = displacing(level.length, level.factor, x);
        let excess = step.corner_distance(Homography::IDENTITY, width, height) / (MAX_CORNER_STEP * level.factor);
        if excess > 1.0 { displacing(level.length, level.factor, x.map(|x| x / excess)) } else { step }
    }

    /// Resamples the frames whose T has moved onto the reference's pixels.
    fn resample(&mut self, level: &Level, shared: &mut SharedParameters) -> Result<(), Error> {
        let [width, height] = self.plan.size;
        let mut moved = Vec::new();
        for n in 0..self.frames {
            let t = shared.transforms[n];
            let is_near =
                |earlier: &Homography| earlier.corner_distance(t, width, height) < RESAMPLE_AFTER * level.factor;
            // Parallax follows u, which each iteration steps.
            if shared.resampled[n].as_ref().is_some_and(is_near) && shared.parallax[n] == [0.0; 2] {
                continue;
            }
            shared.resampled[n] = Some(t);
            moved.push((n as u32, shared.alignment(level, n)));
        }
        if moved.is_empty() { Ok(()) } else { self.device.run(&sweep::align(&self.plan, level, &moved)) }
    }

    /// The sums of all pairs, of u on the device.
    fn half_pairs(
        &mut self,
        level: &Level,
        shared: &SharedParameters,
        registration: RegistrationStep,
    ) -> Result<Vec<PairSums>, Error> {
        let [columns, rows, _] = half_pair::tiles(level.size);
        let ranges = Ranges::of(&self.focus(level)?);
        let (frames, half_pairs) = shared.half_pairs(level, self.excluded_words, &ranges, registration);
        let layout = Layout::of(self.plan.projective());
        let floats = (columns * rows) as usize * layout.length;
        // Tiles that are not listed write no sums.
        let script = sweep::half_pairs(&self.plan, level, &frames, registration);
        let steps_parallax = shared.steps_parallax(registration);
        let runs = half_pairs.len() * if steps_parallax { 2 } else { 1 };
        self.device.run_after_zeroing(&script, runs * floats)?;
        let read = |n: usize| self.device.partials(n * floats, floats);
        let of_pair = |(n, &frames): (usize, &[usize; 2])| {
            let (own, by_u) = (read(n)?, if steps_parallax { read(half_pairs.len() + n)? } else { Vec::new() });
            let sums = |own: &[f32], by_u: Option<&[f32]>, tiles| {
                let [sums, by_u] = [Some(own), by_u].map(|rows| rows.map(|rows| Sums::from_partials(rows, layout)));
                PairSums { frames, sums: sums.unwrap_or_default(), by_u, tiles }
            };
            let tiles = own.chunks_exact(layout.length).zip(by_u.chunks_exact(layout.length));
            let tiles = tiles.map(|(own, by_u)| sums(own, Some(by_u), Vec::new())).collect();
            Ok(sums(&own, Some(&by_u[..]).filter(|_| steps_parallax), tiles))
        };
        half_pairs.iter().enumerate().map(of_pair).collect()
    }

    /// Steps u; returns the sums by which u is eliminated from the step of c.
    fn step(&mut self, level: &Level, shared: &SharedParameters, rate: f64) -> Result<[f64; 2], Error> {
        let (system, update) = shared.step(level, rate);
        self.device.run(&sweep::step(&self.plan, level, &system, &update))?;
        let [columns, rows, _] = system_tiles::tiles(level.size);
        let floats = (columns * rows) as usize * system::SUMS;
        let rows = self.device.partials(0, floats)?;
        let total = |n: usize| rows.chunks_exact(system::SUMS).map(|row| f64::from(row[n])).sum();
        Ok([total(0), total(1)])
    }
}
