//! The joint solve on a device: frames of one size, one stack of blurred images at a time, and the system that all pairs add up to.

use std::ops::Range;
use std::sync::Arc;

use super::common::Common;
use super::deviation::Told;
use super::graph::{self, Link};
use super::hidden::{self, Hidden};
use super::start::{Frames, GRAIN, Grid};
use super::{Asked, pairs, shown, spacing, start};
use crate::base::{CancellationToken, Error, Frame, Homography, Photometric, Settings, Shading};
use crate::engine::Engine;
use crate::engine::plan::{Level, Plan};
use crate::engine::profile::Reading;
use crate::engine::record::record;
use crate::engine::script::{Script, sweep};
use crate::engine::slot::Slot;
use crate::engine::stages::state::Registration;
use crate::engine::stages::sums::{Layout, Sums, UNKNOWNS};
use crate::engine::stages::update_transform::displacing;
use crate::engine::stages::{Field, Pipelines, align, half_pair, system, update};
use crate::engine::tiles::Ranges;
use crate::engine::vulkan::{Buffer, Clock, Device, Recorder};
use crate::engine::workspace::Workspace;

/// The longest side on which a sweep starts, px.
const START: u32 = 160;
/// Most V between frames that counts, px² of a level; of wider blur other pairs tell.
pub(super) const LIMIT: f64 = 10.0;
/// Blur of a frame from which on pairs with blurrier ones are left out, px² of a level, unless no sharper frame is there: they tell little,
/// and the frame's stack is made where it is asked for.
const FAR: f64 = 1.0;
/// α of one pair.
const ALPHA: f64 = 0.005;
/// η of the data term: frames are band-passed, and hold less than photographs do.
const ETA: f64 = 0.005;
/// η of the smoothness term, px of blur a pixel.
const SMOOTHNESS_ETA: f64 = 0.1;
/// Largest step of u, px of blur.
const LARGEST_STEP: f64 = 0.3;
/// The largest step of ln c.
const LARGEST_RATE_STEP: f64 = 0.3;
/// Red-black sweeps a step: iterations are dear, each takes a stack of every frame, and sweeps are cheap.
pub(super) const SWEEPS: u32 = 10;
/// Iterations on the level where it starts, on those between, and on the finest, where a second is as dear as all before it: of frames
/// closer than pairs are wide; one of others. With two, 41 frames of three generated stacks err by 0.050, 0.032 and 0.041 of a frame instead
/// of 0.057, 0.032 and 0.044, but 11 by 0.082 instead of 0.076 (`docs/experiments/focus-sweeps.md`). T and c stay on the finest: frames far out of focus
/// show little but noise there, and with steps of T a corner of the last of 11 simulated frames is off by 0.07 px, without by 0.008.
const ITERATIONS: [usize; 3] = [4, 3, 2];
/// Px of the level that a step moves a corner of a frame by at most: the coarser level has put it closer.
const FURTHEST: f64 = 0.5;
/// Px of the level that a corner of a frame moves by before it is brought onto the reference's pixels anew.
const FOLLOWED: f64 = 0.02;

/// Iterations on the finest of several levels.
fn finest_iterations(common: &Common) -> usize {
    if pairs::stride(&common.settings, common.rate) < 2.0 { ITERATIONS[2] - 1 } else { ITERATIONS[2] }
}

/// A size and a number of frames, prepared for joint solves.
pub(super) struct Joint {
    plan: Plan,
    workspace: Workspace,
    frames: usize,
    /// Words of bits a pixel of the level at hand that tell which frames do not count there; 0 where all do.
    hidden: u32,
    /// Pixels of the level at hand that count.
    counting: f64,
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
    pub(super) cancel: CancellationToken,
}

impl Joint {
    /// Prepares for so many frames.
    ///
    /// # Errors
    /// [`Error::TooLarge`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub(super) fn new(engine: &Engine, plan: Plan, frames: usize) -> Result<Self, Error> {
        let device = engine.device().clone();
        if device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        plan.check_sweep(&device, frames as u32)?;
        let workspace = Workspace::for_sweep(&device, &plan, frames as u32)?;
        let mut first = Recorder::new(&device, Clock::Never)?;
        first.prepare(&workspace.images());
        first.finish()?.run()?;
        let (pipelines, cancel) = (engine.pipelines().clone(), CancellationToken::default());
        Ok(Self { plan, workspace, frames, hidden: 0, counting: 0.0, device, pipelines, cancel })
    }

    /// The finest level.
    pub(super) fn finest(&self) -> &Level {
        &self.plan.pyramid[0]
    }

    pub(super) fn settings(&self) -> &Settings {
        &self.plan.settings
    }

    /// Brings frames up, and makes their pyramids.
    pub(super) fn bring_up<'a>(&self, frames: impl Iterator<Item = &'a Frame>) -> Result<(), Error> {
        for (n, frame) in frames.enumerate() {
            self.workspace.buffer(Slot::Photograph { image: 0 }).write(frame.bytes())?;
            self.run(&sweep::bring_up(&self.plan, n as u32))?;
        }
        Ok(())
    }

    /// Levels of a solve, from where it starts.
    pub(super) fn levels(&self) -> usize {
        self.first_level() + 1
    }

    /// Starts, and goes down to a level: T of all frames, and c, which step there too; u stays on the device. `say` is told of each level done.
    pub(super) fn descend(
        &mut self,
        asked: &Asked<'_>,
        hidden: &Hidden,
        last: usize,
        say: &mut dyn FnMut(),
    ) -> Result<Common, Error> {
        let first = self.first_level();
        let (mut common, focus) = self.start(first, asked)?;
        self.upload(Slot::RelativeBlur { level: first }, &focus)?;
        for index in (last.min(first)..=first).rev() {
            if index < first {
                self.prolong(index, &common)?;
            }
            let level = self.plan.pyramid[index].clone();
            self.enter(&level, &mut common, hidden)?;
            // Of an only level the last iteration refines.
            let count = if index < first { ITERATIONS[1] } else { ITERATIONS[0] - usize::from(index < last) };
            for _ in 0..count {
                self.iterate(&level, &mut common)?;
            }
            if index >= last {
                say();
            }
        }
        Ok(common)
    }

    /// From the level above the finest, if there is one, to u of the finest and its standard deviation, where T and c stay.
    pub(super) fn finish(&mut self, common: &mut Common, hidden: &Hidden) -> Result<[Field; 2], Error> {
        if self.first_level() == 0 {
            return self.refine(1, common, hidden);
        }
        self.prolong(0, common)?;
        self.refine(finest_iterations(common), common, hidden)
    }

    /// The same from u where the finest level starts, less the middle setting.
    pub(super) fn finish_from(
        &mut self,
        start: &Field,
        common: &mut Common,
        hidden: &Hidden,
    ) -> Result<[Field; 2], Error> {
        self.upload(Slot::RelativeBlur { level: 0 }, start)?;
        self.refine(finest_iterations(common), common, hidden)
    }

    fn refine(&mut self, iterations: usize, common: &mut Common, hidden: &Hidden) -> Result<[Field; 2], Error> {
        let level = self.plan.pyramid[0].clone();
        self.enter(&level, common, hidden)?;
        let mut told = None;
        for _ in 0..iterations {
            let (_, rate) = self.ask(&level, common, true)?;
            let system = self.fetch(Slot::NormalEquations, level.size, 0..half_pair::LAYERS)?;
            let before = self.focus(&level)?;
            self.step(&level, common, rate)?;
            told = Told::after(system, &before, &self.focus(&level)?).or(told);
        }
        let focus = self.focus(&level)?;
        let end = |n: usize| {
            let mut layers = self.fetch(Slot::Aligned, level.size, n as u32..n as u32 + 1)?;
            Ok::<_, Error>((layers.swap_remove(0), shown::by(&common.transforms[n], &level)))
        };
        let ends = [end(0)?, end(self.frames - 1)?];
        let unknown = || Field::from_fn(focus.width, focus.height, |_, _| f64::NAN);
        let deviation = told.map_or_else(unknown, |told: Told| told.deviation(&focus, &ends));
        Ok([focus, deviation])
    }

    fn prolong(&self, index: usize, common: &Common) -> Result<(), Error> {
        let level = &self.plan.pyramid[index];
        self.run(&sweep::prolong(&self.plan, level, common.limit(level) as f32))
    }

    /// Makes ready for a level: no frame is on the reference's pixels, and what does not count is told.
    fn enter(&mut self, level: &Level, common: &mut Common, hidden: &Hidden) -> Result<(), Error> {
        common.aligned = vec![None; self.frames];
        let words = hidden.words(level, &common.transforms);
        self.hidden = (words.len() as u64 / level.pixels()) as u32;
        self.counting = level.pixels() as f64;
        if self.hidden > 0 {
            self.counting = hidden::counting(&words, self.frames) as f64;
            self.workspace.buffer(Slot::Hidden).write(bytemuck::cast_slice(&words))?;
        }
        Ok(())
    }

    /// The level where a sweep starts.
    fn first_level(&self) -> usize {
        let long = |level: &Level| level.size[0].max(level.size[1]);
        let coarsest = self.plan.pyramid.len() - 1;
        self.plan.pyramid.iter().position(|level| long(level) <= START).unwrap_or(coarsest)
    }

    /// Registration, brightness, settings where they are not known, c, and u less the middle setting.
    fn start(&self, first: usize, asked: &Asked<'_>) -> Result<(Common, Field), Error> {
        let reference = asked.reference;
        let level = &self.plan.pyramid[first];
        let images = self.fetch(Slot::Frames { level: first }, level.size, 0..self.frames as u32)?;
        let frames = Frames { images: &images, grid: Grid { factor: level.factor, centre: level.centre } };
        let transforms = start::register(&frames, reference, self.plan.settings.motion.unknowns());
        let brightness = if self.plan.settings.photometric {
            start::brightness(&frames, &transforms, reference)
        } else {
            vec![(1.0, Shading::NONE); self.frames]
        };
        let moved = start::aligned(&frames, &transforms, &brightness);
        let (mut settings, mut rate) = (asked.settings.to_vec(), start::rate(&moved, asked.settings));
        if !asked.known {
            let finer = || self.aligned_finer(first, &transforms, &brightness);
            if let Some(uneven) = spacing::uneven(&moved, &settings, rate, finer)? {
                rate = start::rate(&moved, &uneven);
                settings = uneven;
            }
        }
        let middle = 0.5 * (settings[0] + settings[self.frames - 1]);
        let mut focus = start::focus(&moved, &settings, rate);
        focus.data.iter_mut().for_each(|u| *u -= middle);
        let common = Common {
            settings,
            middle,
            reference,
            rate: rate * level.factor * level.factor,
            transforms,
            aligned: vec![None; self.frames],
            brightness,
            telling: 1.0,
        };
        Ok((common, focus))
    }

    /// The frames on the reference's pixels of the next finer level; none where there is no such.
    fn aligned_finer(
        &self,
        first: usize,
        transforms: &[Homography],
        brightness: &[(f64, Shading)],
    ) -> Result<Option<Vec<Field>>, Error> {
        let Some(index) = first.checked_sub(1) else { return Ok(None) };
        let level = &self.plan.pyramid[index];
        let images = self.fetch(Slot::Frames { level: index }, level.size, 0..self.frames as u32)?;
        let frames = Frames { images: &images, grid: Grid { factor: level.factor, centre: level.centre } };
        Ok(Some(start::aligned(&frames, transforms, brightness)))
    }

    /// An iteration on a level: u, T and c step.
    fn iterate(&self, level: &Level, common: &mut Common) -> Result<(), Error> {
        let (links, rate) = self.ask(level, common, false)?;
        let answered = self.step(level, common, rate)?;
        let own: [f64; 2] = [0, 1].map(|n| links.iter().map(|link| link.sums.roughness[n]).sum());
        // c steps as if u had answered already.
        let step = -(own[1] + answered[0]) / (own[0] - answered[1]).max(1e-9);
        common.rate *= step.clamp(-LARGEST_RATE_STEP, LARGEST_RATE_STEP).exp();
        let steps = graph::step(&links, self.frames, common.reference, self.plan.settings.motion.unknowns());
        for (t, x) in common.transforms.iter_mut().zip(steps) {
            *t = t.after(&self.displacing(level, x));
        }
        Ok(())
    }

    /// What all pairs say on a level, of u on the device and of their registration; c of the level.
    fn ask(&self, level: &Level, common: &mut Common, stays: bool) -> Result<(Vec<Link>, f64), Error> {
        self.align(level, common)?;
        let rate = common.rate_on(level);
        let links = self.half_pairs(level, common, rate, stays)?;
        common.telling = links.iter().map(|link| link.sums.valid).sum::<f64>() / self.counting.max(1.0);
        Ok((links, rate))
    }

    /// A step of T, shortened where it goes far.
    fn displacing(&self, level: &Level, x: [f64; UNKNOWNS]) -> Homography {
        let [width, height] = self.plan.size;
        let step = displacing(level.length, level.factor, x);
        let far = step.corner_distance(Homography::IDENTITY, width, height) / (FURTHEST * level.factor);
        if far > 1.0 { displacing(level.length, level.factor, x.map(|x| x / far)) } else { step }
    }

    /// u of a level, less the middle setting.
    pub(super) fn focus(&self, level: &Level) -> Result<Field, Error> {
        self.fetch(Slot::RelativeBlur { level: level.index }, level.size, 0..1).map(|mut layers| layers.swap_remove(0))
    }

    /// Brings the frames that have moved onto the reference's pixels.
    fn align(&self, level: &Level, common: &mut Common) -> Result<(), Error> {
        let [width, height] = self.plan.size;
        let mut moved = Vec::new();
        for n in 0..self.frames {
            let t = common.transforms[n];
            let stays = |before: &Homography| before.corner_distance(t, width, height) < FOLLOWED * level.factor;
            if common.aligned[n].as_ref().is_some_and(stays) {
                continue;
            }
            common.aligned[n] = Some(t);
            let (gain, shading) = common.brightness[n];
            let registration = Registration::new(t, &Photometric { gain, offset: 0.0 });
            let constants = align::Constants {
                width: level.size[0],
                height: level.size[1],
                layer: n as u32,
                factor: level.factor as f32,
                centre: level.centre.map(|c| c as f32),
                registration: (&registration).into(),
                shading: shading.coefficients.map(|c| c as f32),
            };
            moved.push((n as u32, constants));
        }
        if moved.is_empty() { Ok(()) } else { self.run(&sweep::align(&self.plan, level, &moved)) }
    }

    /// What all pairs say, of u on the device and of their registration.
    fn half_pairs(&self, level: &Level, common: &Common, rate: f64, stays: bool) -> Result<Vec<Link>, Error> {
        let pairs = pairs::pairs(&common.settings, rate);
        let [columns, rows, _] = half_pair::tiles(level.size);
        let ranges = Ranges::of(&self.focus(level)?);
        let mut frames = Vec::new();
        let mut links = Vec::new();
        for own in 0..self.frames {
            let beside = |[i, j]: &[usize; 2]| if *i == own { Some(*j) } else { (*j == own).then_some(*i) };
            let others: Vec<usize> = pairs.iter().filter_map(beside).collect();
            let far = FAR.max(rate * common.gap(own).powi(2));
            let constants = others.into_iter().map(|other| {
                let row = links.len() as u32 * columns * rows;
                links.push([own, other]);
                self.half_pair(level, common, [rate, far], [own, other], row)
            });
            let others = constants.collect();
            let (setting, reach) = (common.settings[own] - common.middle, (far / rate).sqrt());
            let wanted = ranges.between(setting - reach, setting + reach);
            frames.push(sweep::Beside { frame: own as u32, others, wanted });
        }
        let layout = Layout::of(self.plan.projective());
        let floats = (columns * rows) as usize * layout.length;
        // Tiles that are not wanted write none.
        self.workspace.buffer(Slot::Partials).write(&vec![0; 4 * links.len() * floats])?;
        self.run(&sweep::half_pairs(&self.plan, level, &frames, stays))?;
        let read = |(n, frames): (usize, &[usize; 2])| {
            let rows: Vec<f32> = self.workspace.buffer(Slot::Partials).read(4 * n * floats, floats)?;
            Ok(Link { frames: *frames, sums: Sums::from_partials(&rows, layout) })
        };
        links.iter().enumerate().map(read).collect()
    }

    fn half_pair(
        &self,
        level: &Level,
        common: &Common,
        [rate, far]: [f64; 2],
        [own, other]: [usize; 2],
        row: u32,
    ) -> half_pair::Constants {
        let setting = |n: usize| (common.settings[n] - common.middle) as f32;
        let shown = [own, other].map(|n| shown::by(&common.aligned[n].unwrap_or(common.transforms[n]), level));
        half_pair::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            other: other as u32,
            row,
            listed: 0,
            own: own as u32,
            words: self.hidden,
            own_setting: setting(own),
            other_setting: setting(other),
            rate: rate as f32,
            grain: GRAIN as f32,
            eta: ETA as f32,
            limit: LIMIT.min(level.limit) as f32,
            far: far as f32,
            length: level.length as f32,
            centre: level.centre.map(|c| c as f32),
            shown: shown::by_both(shown).map(|side| side as f32),
        }
    }

    /// Steps u; what it answers to c.
    fn step(&self, level: &Level, common: &Common, rate: f64) -> Result<[f64; 2], Error> {
        let [width, height] = level.size;
        let constants = system::Constants {
            width,
            height,
            alpha: (ALPHA * common.telling) as f32,
            rate: rate as f32,
            smoothness_eta: SMOOTHNESS_ETA as f32,
        };
        let update = update::Constants {
            width,
            height,
            largest_step: (LARGEST_STEP / rate.sqrt()) as f32,
            limit: common.limit(level) as f32,
            share: 1.0,
        };
        self.run(&sweep::step(&self.plan, level, &constants, &update))?;
        let [columns, rows, _] = system::tiles(level.size);
        let floats = (columns * rows) as usize * system::SUMS;
        let rows: Vec<f32> = self.workspace.buffer(Slot::Partials).read(0, floats)?;
        let total = |n: usize| rows.chunks_exact(system::SUMS).map(|row| f64::from(row[n])).sum();
        Ok([total(0), total(1)])
    }

    fn run(&self, script: &Script) -> Result<(), Error> {
        self.cancel.check()?;
        self.workspace.buffer(Slot::Tiles).write(bytemuck::cast_slice(&script.tiles))?;
        record(&self.device, &self.pipelines, &self.workspace, script, Reading::Never)?.run()
    }

    /// The corner of an image that a level takes, of some layers.
    fn fetch(&self, slot: Slot, [width, height]: [u32; 2], layers: Range<u32>) -> Result<Vec<Field>, Error> {
        let image = self.workspace.image(slot);
        let pixels = image.width as usize * image.height as usize;
        let buffer = Buffer::for_readback(&self.device, "sweep", 4 * (pixels * layers.len()) as u64)?;
        let mut recorder = Recorder::new(&self.device, Clock::Never)?;
        recorder.download(image, layers.clone(), &buffer);
        recorder.finish()?.run()?;
        let layer = |n: usize| {
            let values: Vec<f32> = buffer.read(4 * n * pixels, pixels)?;
            Ok(Field::corner(&values, image.width as usize, [width as usize, height as usize]))
        };
        (0..layers.len()).map(layer).collect()
    }

    fn upload(&self, slot: Slot, field: &Field) -> Result<(), Error> {
        let values = field.to_f32();
        let buffer = Buffer::for_upload(&self.device, "sweep", 4 * values.len() as u64)?;
        buffer.write(bytemuck::cast_slice(&values))?;
        let mut recorder = Recorder::new(&self.device, Clock::Never)?;
        recorder.upload(&buffer, self.workspace.image(slot));
        recorder.finish()?.run()
    }
}
