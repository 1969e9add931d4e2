//! The order of the passes of a solve, and how a script is composed.

use std::collections::BTreeMap;
use std::ops::Range;

use super::{Action, CountedPixels, CpuReference, Dispatch, Entry, Hazards, Part, Script, StackKernel};
use crate::engine::arguments::{self, Grid, Indirect, Over, Place};
use crate::engine::plan::{Level, Plan};
use crate::engine::slot::Slot;
use crate::engine::stages::exposure::Adopt;
use crate::engine::stages::pass::Pass;
use crate::engine::stages::{grid, halve_grid, relax, relax_tiles, system_tiles};
use crate::engine::tiles::NeededCells;
use crate::engine::vulkan::Variant;

/// Both photographs.
pub(super) const BOTH: [usize; 2] = [0, 1];

/// The most pixels times outer iterations in one part: some 8 s on lavapipe, and an estimated 1 s (0.7 kB per pixel and
/// iteration) on a GPU of 50 GB/s. Windows allows a submission 2 s.
const PART_BUDGET: u64 = 1 << 26;
/// The bytes that the dispatches of a batch move on a GPU: some 80 ms of one of 50 GB/s. Drivers take some microseconds
/// for a batch.
const BATCH_BYTES: u64 = 4 << 30;
/// Separable filters that take as long as an outer iteration, measured on lavapipe with the blur stacks of a disk.
const FILTERS_AN_ITERATION: u64 = 5;

/// Composes the script of a pair: one part for the upload and the pyramid, one or more for each level, one or two for
/// the results.
///
/// A registration that does not need V comes first, with parts and levels of its own.
pub(crate) fn compose(plan: &Plan, pixels: CountedPixels) -> Script {
    let mut s = Composer::new(plan, pixels);
    s.reset();
    s.place = Place::level(0);
    BOTH.into_iter().filter(|&image| plan.unpacks(image)).for_each(|image| s.unpack(image));
    s.unit(BOTH);
    for image in BOTH {
        s.place = Place::level(0);
        s.luminance(image, plan.packs_stacks());
        if s.masked {
            s.mask(image);
        }
        s.pyramid(image);
    }
    for level in plan.appearance_levels() {
        s.begin_level(level);
        s.register_level(level);
    }
    let mut registered = 0;
    if !plan.solves_transform() {
        s.next_part();
        s.place = Place::level(0);
        s.clear(&plan.pyramid[0]);
        s.spline2(&plan.pyramid[0]);
        let known = !plan.matches_exposure() || plan.solves_appearance();
        s.exposure(&plan.pyramid[0], if known { Adopt::Nothing } else { Adopt::Exposure }, Slot::Spline2);
        s.download_registration();
        s.reset_levels();
        registered = s.parts.len();
    }
    for level in plan.coarse_to_fine() {
        s.begin_level(level);
        s.solve_level(level);
    }
    s.next_part();
    s.place = Place::level(0);
    if plan.solves_transform() {
        s.copy(Slot::Partials, Slot::EndPartials);
    }
    if !plan.matches_exposure() {
        s.exposure(&plan.pyramid[0], Adopt::Nothing, Slot::Stacks);
    }
    if plan.solves_transform() {
        s.download_registration();
        registered = s.parts.len();
        s.next_part();
    }
    s.uncertainty_terms();
    s.uncertainty();
    if plan.settings.edges {
        s.edges();
    }
    s.total_deviation();
    for channel in 0..plan.fused_count() {
        s.fuse(channel);
    }
    s.download_results();
    s.finish(registered)
}

/// Workgroups of a dispatch over a level.
fn groups(plan: &Plan, level: &Level, over: Over) -> [u32; 3] {
    let sweeps = plan.settings.relaxation_sweeps;
    let of_grid = |n: usize, groups: &dyn Fn([u32; 2]) -> [u32; 3]| {
        grid::grids(level.size).get(n).map_or([0; 3], |grid| groups(grid.size))
    };
    match over {
        Over::Tiles => level.tiles(),
        Over::Half => relax::tiles(level.size),
        Over::SystemTiles => system_tiles::tiles(level.size),
        Over::One => [1, 1, 1],
        Over::RelaxTiles => relax_tiles::tiles(level.size, sweeps.min(relax_tiles::MOST_SWEEPS)),
        Over::Coarse(n) => of_grid(n, &|size| halve_grid::STAGE.groups(grid::halved(size))),
        Over::CoarseTiles(n) => {
            of_grid(n, &|size| relax_tiles::tiles(size, relax_tiles::dispatches(plan.sweeps_on_grid(level, n))[0]))
        }
    }
}

/// Whether a part begins before iteration k of a level, by the length of parts.
fn starts_part(level: &Level, k: u32) -> bool {
    let per_part = (PART_BUDGET / level.pixels()).max(1) as u32;
    k > 0 && k.is_multiple_of(per_part)
}

/// Whether warping I2 and computing its blur stack takes as long as a part should.
fn warping_fills_part(level: &Level) -> bool {
    level.pixels() > PART_BUDGET / FILTERS_AN_ITERATION
}

/// The script so far, and the context of the next pass.
pub(super) struct Composer<'a> {
    pub(super) plan: &'a Plan,
    pub(super) masked: bool,
    /// The level whose I2 is being warped again, by passes that run only if T has moved.
    pub(super) warping_again: Option<usize>,
    /// The workgroups of those passes, by level.
    pub(super) warps: Vec<Vec<[u32; 3]>>,
    /// Whether levels settle, so that their passes are dispatched indirectly.
    pub(super) settles: bool,
    /// The place of the next pass in the method.
    pub(super) place: Place,
    /// The tiles that passes run over; `None` for all.
    wanted: Option<NeededCells>,
    /// The first tile and the number of tiles of each list, by size of the tiles and margin.
    listed: BTreeMap<([u32; 2], u32), [u32; 2]>,
    /// All lists of tiles so far.
    lists: Vec<u32>,
    parts: Vec<Part>,
    hazards: Hazards,
}

impl<'a> Composer<'a> {
    pub(super) fn new(plan: &'a Plan, pixels: CountedPixels) -> Self {
        Self {
            plan,
            masked: pixels == CountedPixels::Unmasked,
            warping_again: None,
            warps: vec![Vec::new(); plan.solved],
            settles: true,
            place: Place::default(),
            wanted: None,
            listed: BTreeMap::new(),
            lists: Vec::new(),
            parts: vec![Part::default()],
            hazards: Hazards::default(),
        }
    }

    pub(super) fn finish(mut self, registered: usize) -> Script {
        self.end_batches(registered);
        let grids = self.plan.pyramid[..self.plan.solved]
            .iter()
            .map(|level| Over::all().map(|over| groups(self.plan, level, over)));
        let arguments = arguments::initial_words(&grids.collect::<Vec<_>>(), &self.warps);
        Script { parts: self.parts, registered, arguments, tiles: self.lists }
    }

    /// Joins parts to batches.
    fn end_batches(&mut self, registered: usize) {
        let (mut bytes, count) = (0, self.parts.len());
        for (n, part) in self.parts.iter_mut().enumerate() {
            bytes += part.bytes();
            part.ends_batch = bytes >= BATCH_BYTES || [registered, count].contains(&(n + 1));
            if part.ends_batch {
                bytes = 0;
            }
        }
    }

    /// Adds an entry.
    fn push(&mut self, action: Action) {
        let waits = self.hazards.waits(&action);
        self.part().entries.push(Entry { action, waits });
    }

    /// The part that is being composed.
    fn part(&mut self) -> &mut Part {
        let last = self.parts.len() - 1;
        &mut self.parts[last]
    }

    /// Adds a dispatch.
    pub(super) fn dispatch<P: Pass>(&mut self, bindings: P, constants: &P::Constants, variant: Variant, grid: Grid) {
        let (stage, slots) = (P::STAGE, bindings.slots());
        debug_assert!(!slots.contains(&Slot::Unbound), "{}: {slots:?}", stage.shader.name);
        debug_assert!(stage.flags.has(variant), "{} has no such variant: {variant:?}", stage.shader.name);
        self.push(Action::Dispatch(Dispatch {
            stage,
            variant,
            slots,
            constants: bytemuck::bytes_of(constants).to_vec(),
            grid,
            place: self.place,
            bytes: P::bytes(constants, variant),
            cpu_reference: CpuReference::of::<P>(),
        }));
    }

    /// The list of the tiles of a size within `margin` pixels of the wanted ones: its first entry, and a grid of one
    /// workgroup per tile. `None` if passes run over all tiles.
    pub(super) fn list(&mut self, tile: [u32; 2], margin: u32) -> Option<(u32, Grid)> {
        let wanted = self.wanted.as_ref()?;
        let [first, count] = *self.listed.entry((tile, margin)).or_insert_with(|| {
            let (first, tiles) = (self.lists.len(), wanted.tiles(tile, margin));
            self.lists.extend(&tiles);
            [first, tiles.len()].map(|n| n as u32)
        });
        Some((first, Grid::Direct([count, 1, 1])))
    }

    /// Sets the tiles that the following passes run over.
    pub(super) fn want(&mut self, wanted: NeededCells) {
        self.wanted = Some(wanted);
        self.listed.clear();
    }

    /// Adds a dispatch with an invocation for each of `size` pixels.
    pub(super) fn over<P: Pass>(&mut self, size: [u32; 2], bindings: P, constants: &P::Constants, variant: Variant) {
        self.dispatch(bindings, constants, variant, Grid::Direct(P::STAGE.groups(size)));
    }

    /// Adds a dispatch within an iteration of a level. It has no workgroups once the level has settled.
    pub(super) fn within<P: Pass>(
        &mut self,
        level: &Level,
        over: Over,
        bindings: P,
        constants: &P::Constants,
        variant: Variant,
    ) {
        let grid = if self.settles {
            Grid::Indirect(Indirect::Level { level: level.index, over })
        } else {
            Grid::Direct(groups(self.plan, level, over))
        };
        self.dispatch(bindings, constants, variant, grid);
    }

    fn copy(&mut self, from: Slot, to: Slot) {
        self.push(Action::Copy { from, to, levels: false });
    }

    /// Sets V of a level to zero.
    pub(super) fn clear(&mut self, level: &Level) {
        self.empty(Slot::RelativeBlur { level: level.index }, level.size, 0..1);
    }

    /// Sets layers of an image to zero.
    pub(super) fn empty(&mut self, image: Slot, size: [u32; 2], layers: Range<u32>) {
        self.push(Action::Clear { image, size, layers });
    }

    /// Begins a part.
    pub(super) fn next_part(&mut self) {
        self.parts.push(Part::default());
        self.hazards.begin_part();
    }

    /// Begins a part for the passes before a level's iterations.
    fn begin_level(&mut self, level: &Level) {
        self.next_part();
        self.part().begins = Some(level.index);
    }

    /// Begins iteration k of a level. It begins a part if the level may have settled, or if the current part is full.
    fn begin_iteration(&mut self, level: &Level, k: u32, may_settle: impl Fn(u32) -> bool) {
        if Plan::checks_before(k, may_settle) {
            self.copy(Slot::State, Slot::Progress);
            self.next_part();
            self.part().continues = Some(level.index);
        } else if starts_part(level, k) || self.plan.warps_again(level, k) && warping_fills_part(level) {
            self.next_part();
        }
        self.place = self.place.iteration(k);
    }

    /// Ends a level with the current part.
    fn end_level(&mut self, level: &Level) {
        self.part().level_done = Some(level.index);
    }

    /// Solves for T on one level, by appearance.
    fn register_level(&mut self, level: &Level) {
        let plan = self.plan;
        self.place = Place::registering(level.index);
        self.spline2(level);
        if plan.matches_exposure() {
            // V is not known yet.
            self.clear(level);
            self.exposure(level, Adopt::Exposure, Slot::Spline2);
        }
        for k in 0..plan.settings.outer_iterations {
            self.begin_iteration(level, k, |k| k > 0);
            self.appearance(level);
            self.update_transform_by_appearance(level, k);
        }
        self.end_level(level);
    }

    /// Solves for V on one level, and for T if it is solved for together with V.
    fn solve_level(&mut self, level: &Level) {
        let plan = self.plan;
        self.place = Place::level(level.index);
        self.start(level);
        let mut filtered = 0;
        self.stack_starts(level);
        for layer in 1..plan.layers_of(level) {
            filtered += self.stack_layer(level, 0..2, layer) * level.pixels();
            if filtered > FILTERS_AN_ITERATION * PART_BUDGET {
                self.begin_level(level);
                filtered = 0;
            }
        }
        if plan.finds_lens(level) {
            self.find_lens(level, StackKernel::Gaussian);
        }
        for k in 0..plan.settings.outer_iterations {
            self.begin_iteration(level, k, |k| plan.may_settle(level, k));
            if plan.steps_parallax(level, k) {
                self.step_parallax(level);
            }
            if plan.warps_again(level, k) {
                self.warp_again(level);
            }
            if plan.finds_lens_again(level, k) {
                self.find_lens(level, StackKernel::Found);
            }
            if plan.matches_before(level, k) {
                self.exposure(level, plan.adopts(level), Slot::Stacks);
            }
            self.linearise(level, k);
            // The last iteration only evaluates the result of the others.
            if k + 1 < plan.settings.outer_iterations {
                self.step(level, k);
            }
        }
        self.end_level(level);
    }

    /// Sets state and indirect arguments to those before a solve.
    fn reset(&mut self) {
        self.copy(Slot::StartState, Slot::State);
        self.copy(Slot::StartArguments, Slot::Arguments);
    }

    /// Sets the state of the levels and their indirect arguments to those before a solve. T, gain and offset stay.
    fn reset_levels(&mut self) {
        self.push(Action::Copy { from: Slot::StartState, to: Slot::State, levels: true });
        self.copy(Slot::StartArguments, Slot::Arguments);
    }

    /// Copies the registration into mapped memory, before the results.
    fn download_registration(&mut self) {
        self.copy(Slot::State, Slot::RegisteredState);
        self.copy(Slot::Energies, Slot::RegisteredEnergies);
    }

    /// Copies the results into mapped memory.
    fn download_results(&mut self) {
        self.push(Action::Download { layers: self.plan.map_layers() });
        self.copy(Slot::State, Slot::EndState);
        self.copy(Slot::Energies, Slot::EndEnergies);
    }
}
