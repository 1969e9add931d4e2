//! The passes of the iterations: what each binds, its push constants and what it is dispatched over.

use std::ops::Range;

use super::StackKernel;
use super::compose::Composer;
use super::filters::Layers;
use crate::base::color::LUMINANCE;
use crate::base::{Decode, RegistrationStep};
use crate::engine::arguments::{Grid, Over};
use crate::engine::plan::{Level, Plan, step_share};
use crate::engine::slot::Slot;
use crate::engine::stages::cascade::Start;
use crate::engine::stages::exposure::Adopt;
use crate::engine::stages::stack::{self, Slopes};
use crate::engine::stages::{
    NO_VARIANT, appearance, blur_matched_pair, cascade, exposure, grid, halve_grid, ingest, lens, lens_windows,
    linearise, mask, pair_samples, parallax, parallax_windows, prolong, relax, relax_grid_tiles, relax_tiles, shape,
    system, system_tiles, uncertainty_terms, unit, unpack, update, update_transform,
};
use crate::engine::vulkan::Variant;

/// The finest level settles once no corner moves by more than this in an iteration, pixels of the level. At 0.01, pairs
/// under a half-Gaussian stop 0.004 px off instead of 0.002.
const FINEST_STILL: f32 = 0.001;
/// The largest movement of a corner with which a coarser level settles. It provides a start only: at
/// 0.001 such levels took up to 20 iterations, and no result was better.
const COARSER_STILL: f32 = 0.01;
/// A level settles once a whole step moves no more than this share of the valid pixels below the limit of |V| by a
/// tenth of their standard deviation: V of weak areas, which comes from afar. With 0.1 the heat sink takes 16
/// iterations instead of 8.
pub(crate) const MOST_MOVING: f32 = 0.25;
/// And no more than this share by half of it: pixels at depth edges. Without this bound twice as many pixels of bars
/// end more than five standard deviations off.
const MOST_FAR: f32 = 0.05;
/// T is at rest if its step is less than about half of its standard deviation: ¼ of 1.8² (as of a step of V) times Σ b²
/// / Σ D, for each unknown. About, since the sums of T have a wider η where noise is strong.
const STEADY: f32 = 0.25 * 3.24;
/// Or if it is less than a tenth of the standard deviation that the scatter over tiles shows, squared. Of a generated
/// part that deviation is as the one above. On photographs residuals are alike over a feature: the variance is 15 to
/// 600 times 1.8² Σ b² / Σ D. Without this rule pcb-macro took 20 instead of 10 iterations, for steps of T of a
/// hundredth of its deviation.
const STEADY_BY_TILES: f32 = 0.01;
/// The largest |dV| as a share of |V|, where that is more than [`Settings::largest_step`](crate::Settings).
const RELATIVE_STEP: f32 = 0.25;
/// Without V, by the method appearance, the finest level settles only if the energy changes by no more than this share
/// in an iteration.
const FINEST_FLAT: f32 = 1e-5;
/// The largest change of the energy with which a coarser level settles, and any level
/// where steps are damped: an alternating energy changes by less only by chance.
const COARSER_FLAT: f32 = 1e-4;

pub(super) fn single(numbers: [f64; 2]) -> [f32; 2] {
    numbers.map(|number| number as f32)
}

/// Images.
impl Composer<'_> {
    /// Unpacks a photograph from its camera's format.
    pub(super) fn unpack(&mut self, image: usize) {
        let (packed_words, samples) = (Slot::Packed { image }.read(), Slot::Photograph { image }.write());
        let bindings = unpack::Bindings { packed_words, samples };
        let format = self.plan.packed[image];
        let constants = unpack::Constants::new(self.plan.size, format);
        self.over(constants.invocations(), bindings, &constants, unpack::variant(format));
    }

    /// Chooses the unit of intensities by two photographs, which may be one.
    pub(super) fn unit(&mut self, images: [usize; 2]) {
        let [first, second] = images.map(|image| Slot::Photograph { image }.read());
        let bindings = unit::Bindings { first, second, ..unit::Bindings::on(0) };
        let constants = unit::Constants::new(self.plan.size, images.map(|image| self.plan.formats[image]), LUMINANCE);
        let variant = unit::variant(self.plan.settings.decode);
        self.dispatch(bindings, &constants, variant, Grid::Direct([1; 3]));
    }

    /// Puts the luminance of a photograph, in units, onto the finest level. `measures`: also raises white.
    pub(super) fn luminance(&mut self, image: usize, measures: bool) {
        self.ingest(image, LUMINANCE, [measures, true]);
    }

    /// Puts a channel of a photograph, as stored, onto the finest level.
    pub(super) fn channel(&mut self, image: usize, channel: u32) {
        let mut weights = [0.0; 3];
        weights[channel as usize] = 1.0;
        self.ingest(image, weights, [false; 2]);
    }

    fn ingest(&mut self, image: usize, weights: [f32; 3], [measures, in_units]: [bool; 2]) {
        let (samples, to) = (Slot::Photograph { image }.read(), Slot::Luminance { image, level: 0 }.write());
        let bindings = ingest::Bindings { samples, image: to, ..ingest::Bindings::on(0) };
        let ([width, height], format) = (self.plan.size, self.plan.formats[image]);
        let (channels, bytes) = (format.channels.count(), format.depth.bytes());
        let constants = ingest::Constants { width, height, channels, bytes, weights };
        let variant = ingest::variant([self.plan.settings.decode == Decode::Srgb, measures, in_units]);
        self.over(self.plan.size, bindings, &constants, variant);
    }

    /// Determines which pixels of a photograph count, on the finest level.
    pub(super) fn mask(&mut self, image: usize) {
        let counts = (Slot::Scratch, image as u32);
        let samples = Slot::Photograph { image }.read();
        let bindings = mask::Bindings { samples, counts: counts.0.write(), ..mask::Bindings::on(0) };
        let ([width, height], format) = (self.plan.size, self.plan.formats[image]);
        let constants = mask::Constants {
            width,
            height,
            channels: format.channels.count(),
            bytes: format.depth.bytes(),
            second: image as u32,
            clipped: self.plan.settings.clipped(format.depth),
        };
        self.over(self.plan.size, bindings, &constants, NO_VARIANT);
        self.smooth([counts, (Slot::Masks { level: 0 }, image as u32)], self.plan.size);
    }

    /// Matches gain, offset and shading, or measures the correlation alone. `stacks` are the blur stacks, or the
    /// spline of I2: V is then zero.
    pub(super) fn exposure(&mut self, level: &Level, adopt: Adopt, stacks: Slot) {
        let (plan, size) = (self.plan, uncertainty_terms::size(level.size));
        let has_stacks = stacks == Slot::Stacks;
        let bindings =
            blur_matched_pair::Bindings { stacks: stacks.read(), ..blur_matched_pair::Bindings::on(level.index) };
        let constants = blur_matched_pair::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: if has_stacks { level.nodes as u32 } else { 0 },
            second_stack: if has_stacks { plan.second_stack(level) } else { 0 },
            factor: level.factor as f32,
            centre: single(level.centre),
            mean: single(plan.settings.kernel.mean()),
        };
        let slopes = if has_stacks { plan.slopes() } else { Slopes::Laplacian };
        let variant = linearise::variant(slopes, has_stacks && plan.warps(level), self.masked, false);
        let variant = stack::packed(variant, has_stacks && plan.packs(level));
        self.over(size, bindings, &constants, variant);
        let constants = exposure::Constants::new(level.size, level.factor, level.centre, adopt);
        let (filters, samples) = (Slot::Filters { bank: plan.window.bank }.read(), Slot::Partials.write());
        let bindings = pair_samples::Bindings { filters, samples, ..pair_samples::Bindings::on(level.index) };
        let sampling = pair_samples::Constants::new(size, constants.every, plan.window);
        self.dispatch(bindings, &sampling, NO_VARIANT, Grid::Direct(sampling.groups()));
        self.dispatch(
            exposure::Bindings::on(level.index),
            &constants,
            exposure::variant(adopt),
            Grid::Direct([1, 1, 1]),
        );
    }

    /// Finds the law and the kernel from windows, and turns both blur stacks into those of disks if they are found.
    pub(super) fn find_lens(&mut self, level: &Level, stacks: StackKernel) {
        let grid @ [columns, rows] = lens_windows::grid(level.size);
        let are_gaussian = u32::from(stacks == StackKernel::Gaussian);
        let constants = lens_windows::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            second_stack: self.plan.second_stack(level),
            grid,
            level: level.index as u32,
            factor: level.factor as f32,
            centre: single(level.centre),
            are_gaussian,
            noise: level.noise,
        };
        let variant = Variant::MASKED.when(self.masked) | Variant::PACKED.when(self.plan.packs(level));
        let bindings = lens_windows::Bindings::on(level.index);
        self.dispatch(bindings, &constants, variant, Grid::Direct([columns, rows, 1]));
        let constants = lens::Constants { windows: columns * rows, level: level.index as u32, are_gaussian };
        self.dispatch(lens::Bindings::on(0), &constants, NO_VARIANT, Grid::Direct([1; 3]));
        self.shape(level, 0..2, stacks);
    }

    /// Steps T and the parallax together.
    pub(super) fn step_parallax(&mut self, level: &Level) {
        let (plan, grid @ [columns, rows]) = (self.plan, parallax_windows::grid(level.size));
        let constants = parallax_windows::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            second_stack: plan.second_stack(level),
            grid,
            level: level.index as u32,
            factor: level.factor as f32,
            centre: single(level.centre),
            scale_length: level.length as f32,
            eta: plan.settings.data_eta as f32,
            smoothness_eta: plan.settings.smoothness_eta as f32,
            elimination: linearise::ELIMINATION,
            mean: single(plan.settings.kernel.mean()),
            noise: level.noise,
        };
        let variant = linearise::variant(plan.slopes(), plan.warps(level), self.masked, false);
        let variant = stack::packed(variant, plan.packs(level));
        let bindings = parallax_windows::Bindings::on(level.index);
        self.dispatch(bindings, &constants, variant, Grid::Direct([columns, rows, 1]));
        let constants = parallax::Constants {
            windows: columns * rows,
            level: level.index as u32,
            unknowns: plan.settings.motion.unknowns() as u32,
            factor: level.factor as f32,
            scale_length: level.length as f32,
        };
        self.dispatch(parallax::Bindings::on(0), &constants, NO_VARIANT, Grid::Direct([1; 3]));
    }

    /// Turns the blur stacks of some images into those of disks. Those of Gaussians are turned if the kernel is a disk,
    /// others only if it has just become one.
    pub(super) fn shape(&mut self, level: &Level, images: Range<usize>, stacks: StackKernel) {
        let [width, height] = level.size;
        let (nodes, are_gaussian) = (level.nodes as u32, u32::from(stacks == StackKernel::Gaussian));
        let stacks @ Layers { first, step, count: planes, is_packed, .. } = self.stacks(level, images, 0);
        let grid = self.grid(shape::groups(level.size, stacks.groups()));
        let constants = shape::Constants { width, height, nodes, first, step, planes, are_gaussian };
        self.dispatch(shape::Bindings::on(level.index), &constants, Variant::PACKED.when(is_packed), grid);
    }
}

/// T.
impl Composer<'_> {
    /// The registration integrals without a blur model, equation 36.
    pub(super) fn appearance(&mut self, level: &Level) {
        let constants = appearance::Constants {
            width: level.size[0],
            height: level.size[1],
            rows: level.rows,
            factor: level.factor as f32,
            centre: single(level.centre),
            length: level.length as f32,
            eta: self.plan.settings.data_eta as f32,
        };
        let variant = Variant::MASKED.when(self.masked) | Variant::PROJECTIVE.when(self.plan.projective());
        self.within(level, Over::Tiles, appearance::Bindings::on(level.index), &constants, variant);
    }

    /// Residuals, D, b and the registration integrals, equations 22 to 32. Its last workgroup updates T and determines
    /// whether the level has settled.
    pub(super) fn linearise(&mut self, level: &Level, k: u32) {
        let (plan, s) = (self.plan, &self.plan.settings);
        let step = transform_step(plan, level, k);
        let constants = linearise::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            second_stack: plan.second_stack(level),
            rows: level.rows,
            factor: level.factor as f32,
            centre: single(level.centre),
            scale_length: level.length as f32,
            continuation: plan.continued(level, k) as f32,
            eta: s.data_eta as f32,
            smoothness_eta: s.smoothness_eta as f32,
            // Gradient descent does not eliminate dV: this smoothness keeps V of every pixel in place.
            elimination: if descends(plan) { 1e20 } else { linearise::ELIMINATION },
            mean: single(s.kernel.mean()),
            noise: level.noise,
            t_step: update_transform::Step { flags: step.flags | update_transform::STEPS, ..step },
        };
        let variant = linearise::variant(plan.slopes(), plan.warps(level), self.masked, plan.sums_all(level));
        let variant = stack::packed(variant, plan.packs(level));
        self.within(level, Over::Tiles, linearise::Bindings::on(level.index), &constants, variant);
        self.place = self.place.after_step();
    }

    /// Updates T after `appearance`, in iteration k of a level.
    pub(super) fn update_transform_by_appearance(&mut self, level: &Level, k: u32) {
        use update_transform::{MAY_SETTLE, MAY_WARP};
        let step = transform_step(self.plan, level, k);
        let t_step = update_transform::Step {
            unknowns: self.plan.settings.motion.unknowns() as u32,
            flags: step.flags & !(MAY_SETTLE | MAY_WARP) | if k > 0 { MAY_SETTLE } else { 0 },
            steady: 0.0,
            steady_by_tiles: 0.0,
            flatness: if level.index == 0 && step_share(k) == 1.0 { FINEST_FLAT } else { COARSER_FLAT },
            ..step
        };
        let ([columns, rows, _], [factor, scale_length]) =
            (level.tiles(), [level.factor, level.length].map(|x| x as f32));
        let half_size = single(level.centre);
        let constants = update_transform::Constants { rows: columns * rows, factor, scale_length, half_size, t_step };
        let variant = Variant::PROJECTIVE.when(self.plan.sums_all(level));
        self.within(level, Over::One, update_transform::Bindings::on(level.index), &constants, variant);
        self.place = self.place.after_step();
    }
}

/// The step of T in iteration k of a level that solves for V.
fn transform_step(plan: &Plan, level: &Level, k: u32) -> update_transform::Step {
    use update_transform::{DESCENDS, FINDS_ALPHA, MAY_SETTLE, MAY_WARP};
    let is_finest = level.index == 0;
    let flags = [
        (descends(plan), DESCENDS),
        (plan.may_settle(level, k), MAY_SETTLE),
        (plan.finds_alpha(level, k), FINDS_ALPHA),
        (plan.warps_again(level, k + 1), MAY_WARP),
    ];
    let unknowns = if plan.solves_transform() { plan.settings.motion.unknowns() as u32 } else { 0 };
    update_transform::Step {
        level: level.index as u32,
        energy_place: level.index as u32 * plan.settings.outer_iterations + k,
        unknowns,
        flags: flags.into_iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag).sum(),
        still: if is_finest { FINEST_STILL } else { COARSER_STILL },
        share: step_share(k),
        steady: if unknowns > 0 { STEADY * unknowns as f32 } else { f32::MAX },
        steady_by_tiles: if has_tiles(level) { STEADY_BY_TILES * unknowns as f32 } else { 0.0 },
        // V and T have measures of their own; the energy is none (section 6 of `docs/method.md`).
        flatness: f32::MAX,
        most_moving: MOST_MOVING,
        most_far: MOST_FAR,
        least_spread: (plan.settings.data_eta / linearise::BROAD) as f32,
    }
}

/// Whether a level has enough tiles for the scatter over them. By those of a processor, so that levels settle alike on
/// all devices.
fn has_tiles(level: &Level) -> bool {
    let [columns, rows, _] = linearise::tiles(level.size, linearise::rows_on_processor(level.size));
    f64::from(columns * rows) > update_transform::TOO_FEW
}

fn descends(plan: &Plan) -> bool {
    plan.settings.registration_step == RegistrationStep::GradientDescent
}

/// V.
impl Composer<'_> {
    /// V of a level before its first iteration: zero, or that of the coarser level.
    pub(super) fn start(&mut self, level: &Level) {
        if level.index + 1 == self.plan.solved {
            return self.clear(level);
        }
        let coarse = Slot::RelativeBlur { level: level.index + 1 }.read();
        let bindings = prolong::Bindings { coarse, fine: Slot::RelativeBlur { level: level.index }.write() };
        let [width, height] = level.size;
        let constants = prolong::Constants { width, height, limit: level.limit as f32, gain: 4.0 };
        self.over(level.size, bindings, &constants, NO_VARIANT);
    }

    /// dV and V in iteration k of a level of a pair.
    pub(super) fn step(&mut self, level: &Level, k: u32) {
        let ([width, height], settings) = (level.size, &self.plan.settings);
        let (alpha, smoothness_eta) = (self.plan.continued(level, k) as f32, settings.smoothness_eta as f32);
        let constants = system::Constants { width, height, alpha, rate: 1.0, smoothness_eta };
        self.system(level, &constants, NO_VARIANT);
        // A whole step, then an extrapolated one, and so on.
        let extrapolation = if k.is_multiple_of(2) { update::KEEP } else { update::EXTRAPOLATE };
        let (largest_step, limit, share) = (settings.largest_step as f32, level.limit as f32, step_share(k));
        let relative_step = RELATIVE_STEP;
        let constants = update::Constants { width, height, largest_step, relative_step, limit, share, extrapolation };
        self.relaxation(level, &constants);
    }

    /// The linear system for the step of the unknown: V of a pair, u of a sweep.
    pub(super) fn system(&mut self, level: &Level, constants: &system::Constants, variant: Variant) {
        let window = self.plan.window;
        let filters = Slot::Filters { bank: window.bank }.read();
        let bindings = system_tiles::Bindings { filters, ..system_tiles::Bindings::on(level.index) };
        let constants = system_tiles::Constants::new(constants, window, self.plan.summed_grids(level));
        self.within(level, Over::SystemTiles, bindings, &constants, variant);
    }

    /// dV by the cascade: up to the coarsest grid, and back with relaxation sweeps on each grid and on the level. Then
    /// V.
    ///
    /// The finest grid or level of few tiles computes all coarser grids too. With many sweeps it is the one that follows
    /// the small grids. Where [`Plan::joins_grids`] says no, each grid has dispatches of its own.
    pub(super) fn relaxation(&mut self, level: &Level, update: &update::Constants) {
        let (plan, grids) = (self.plan, grid::grids(level.size));
        let summed = plan.summed_grids(level);
        for n in system_tiles::GRIDS..summed {
            self.halve_grid(level, n - 1, [grids[n - 1], grids[n]]);
        }
        if let Some(small) = plan.small_grid(level) {
            let sizes = [level.size].into_iter().chain(grids.iter().map(|grid| grid.size));
            let alone = sizes.take(small + 1).position(|size| self.joins_tiles(size)).unwrap_or(small);
            let joined = || Start::Joined { grids: &grids[alone..], small: small - alone };
            for n in (0..alone).rev() {
                let start = if n + 1 == alone { joined() } else { Start::Coarser(grids[n + 1].first) };
                self.relax_grid(level, n, start);
            }
            let start = if alone == 0 { joined() } else { Start::Coarser(grids[0].first) };
            return self.relax_tiles(level, start, plan.settings.relaxation_sweeps, update);
        }
        for n in (0..grids.len()).rev() {
            let start = grids.get(n + 1).map_or(Start::Zero, |coarser| Start::Coarser(coarser.first));
            self.relax_grid(level, n, start);
        }
        self.relax_pixels(level, update);
    }

    /// Whether a grid or level of this size also relaxes coarser grids that do not fit shared memory.
    fn joins_tiles(&self, size: [u32; 2]) -> bool {
        let sweeps = self.plan.settings.relaxation_sweeps;
        cascade::covers(sweeps) && relax_tiles::has_few_tiles(size, sweeps)
    }

    /// Sums the system of the n-th grid up to the next one.
    fn halve_grid(&mut self, level: &Level, n: usize, [grid, next]: [grid::Place; 2]) {
        let [width, height] = grid.size;
        let constants = halve_grid::Constants { width, height, first: grid.first, next: next.first };
        self.within(level, Over::Coarse(n), halve_grid::Bindings::on(level.index), &constants, NO_VARIANT);
    }

    /// All relaxation sweeps on the n-th grid: as many dispatches as halos of tiles ask for. Each stores dV in the place
    /// of the grid or in the spare one, in turn, so that none reads what it writes. The last stores it in the grid's.
    fn relax_grid(&mut self, level: &Level, n: usize, start: Start) {
        let (plan, grid) = (self.plan, grid::grids(level.size)[n]);
        let ([width, height], over_relaxation) = (grid.size, plan.settings.over_relaxation as f32);
        let sweeps = plan.sweeps_on_grid(level, n);
        let [halo, count] = relax_tiles::dispatches(sweeps);
        let place = |k: u32| if (count - k) % 2 == 1 { grid.first } else { grid::cells(level.size) as u32 };
        for k in 0..count {
            let start = if k > 0 { Start::Own(place(k - 1)) } else { start };
            let constants = relax_grid_tiles::Constants {
                width,
                height,
                first: grid.first,
                to: place(k),
                sweeps: halo.min(sweeps - k * halo),
                halo,
                over_relaxation,
                coarser: start.constants(),
            };
            let bindings = relax_grid_tiles::Bindings::on(level.index);
            self.within(level, Over::CoarseTiles(n), bindings, &constants, start.variant());
        }
    }

    /// All relaxation sweeps on the level, and the update of V. Those beyond the most that tiles take are half-sweeps of
    /// one color after the other.
    fn relax_pixels(&mut self, level: &Level, update: &update::Constants) {
        let ([width, height], sweeps) = (level.size, self.plan.settings.relaxation_sweeps);
        let on_tiles = sweeps.min(relax_tiles::MOST_SWEEPS);
        let first = grid::cells(level.size) as u32;
        for half in 0..2 * (sweeps - on_tiles) {
            let (color, over_relaxation) = (half % 2, self.plan.settings.over_relaxation as f32);
            let constants = relax::Constants { width, height, color, rows: relax::ROWS, over_relaxation, first };
            let variant = Variant::FIRST.when(half < 2);
            self.within(level, Over::Half, relax::Bindings::on(level.index), &constants, variant);
        }
        let start = if sweeps > on_tiles { Start::Own(first) } else { Start::Coarser(0) };
        self.relax_tiles(level, start, on_tiles, update);
    }

    /// Relaxation sweeps on the level, and the update of V.
    fn relax_tiles(&mut self, level: &Level, start: Start, sweeps: u32, update: &update::Constants) {
        let relaxation = (sweeps, self.plan.settings.over_relaxation as f32);
        let constants = relax_tiles::Constants::new(start.constants(), relaxation, update);
        self.within(level, Over::RelaxTiles, relax_tiles::Bindings::on(level.index), &constants, start.variant());
    }
}
