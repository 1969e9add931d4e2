//! The method, a line a pass, in the order of `docs/method.md`.

use std::collections::BTreeMap;

use super::hazards::Hazards;
use super::{Action, Dispatch, Entry, Part, Script};
use crate::base::Decode;
use crate::base::color::LUMINANCE;
use crate::engine::arguments::{self, Grid, Over, Place};
use crate::engine::plan::{Level, Plan};
use crate::engine::slot::{self, Slot};
use crate::engine::stages::exposure::Adopt;
use crate::engine::stages::pass::Pass;
use crate::engine::stages::{
    NO_VARIANT, appearance, convolve, ingest, linearise, mask, prolong, relax, sums, unpack, update, update_transform,
};
use crate::engine::tiles::NeededCells;
use crate::engine::vulkan::Variant;

/// Which photograph.
pub(super) const BOTH: [usize; 2] = [0, 1];

/// Pixels times outer iterations of one part at most: some 8 s on lavapipe, and by estimate (0.7 kB a
/// pixel and iteration) 1 s on a GPU of 50 GB/s, within the 2 s that Windows allows a submission.
const PART_BUDGET: u64 = 1 << 26;
/// Separable filters that take as long as an outer iteration: on lavapipe 5, of a disk's stacks.
const FILTERS_AN_ITERATION: u64 = 5;

/// Writes a whole solve down: one part for the way up, some for each level, one or two for the results. Where the registration
/// does not wait for V, it comes first, with parts and levels of its own. `masked`: pixels are masked or clipped.
pub(crate) fn compose(plan: &Plan, masked: bool) -> Script {
    let mut s = Composer::new(plan, masked);
    s.reset();
    for image in BOTH {
        s.place = Place::level(0);
        if plan.unpacks(image) {
            s.unpack(image);
        }
        s.ingest(image, LUMINANCE);
        if masked {
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
        s.exposure(&plan.pyramid[0], if known { Adopt::Nothing } else { Adopt::Exposure }, false);
        s.bring_down_registration();
        s.reset_levels();
        registered = s.parts.len();
    }
    for level in plan.coarse_to_fine() {
        s.begin_level(level);
        s.solve_level(level);
    }
    s.next_part();
    s.place = Place::level(0);
    if !plan.matches_exposure() {
        s.exposure(&plan.pyramid[0], Adopt::Nothing, true);
    }
    if plan.solves_transform() {
        s.copy(Slot::Partials, Slot::EndPartials);
        s.bring_down_registration();
        registered = s.parts.len();
        s.next_part();
    }
    s.evidence();
    s.uncertainty();
    for channel in 0..plan.fused_count() {
        s.fuse(channel);
    }
    s.bring_down();
    s.finish(registered)
}

/// Workgroups that cover a level.
fn groups(level: &Level, over: Over) -> [u32; 3] {
    match over {
        Over::Tiles => level.tiles(),
        Over::Half => relax::tiles(level.size),
        Over::Pixels => update::STAGE.groups(level.size),
        Over::AlongX => convolve::groups([level.size[0], level.size[1]], false),
        Over::AlongY => convolve::groups([level.size[1], level.size[0]], true),
        Over::One => [1, 1, 1],
    }
}

/// Whether iteration k of a level goes into a new part.
fn starts_part(level: &Level, k: u32) -> bool {
    let per_part = (PART_BUDGET / level.pixels()).max(1) as u32;
    k > 0 && k.is_multiple_of(per_part)
}

/// Whether bringing I2 onto the pixels anew takes as long as a part should.
fn warping_fills_part(level: &Level) -> bool {
    level.pixels() > PART_BUDGET / FILTERS_AN_ITERATION
}

/// The script so far, and what its next pass is about.
pub(super) struct Composer<'a> {
    pub(super) plan: &'a Plan,
    pub(super) masked: bool,
    /// The level whose I2 is being brought onto I1's pixels anew, by passes that run only if T has moved.
    pub(super) anew: Option<usize>,
    /// The workgroups of those passes, by level.
    pub(super) warps: Vec<Vec<[u32; 3]>>,
    /// The level on which filters run unless it has settled.
    pub(super) unsettled: Option<usize>,
    /// Whether levels settle, so that their passes are dispatched indirectly.
    pub(super) settles: bool,
    /// Where the next pass stands.
    pub(super) place: Place,
    /// What passes are wanted for, where not for everything.
    wanted: Option<NeededCells>,
    /// The lists of its tiles, by their size and margin: where they begin, and how many they are.
    listed: BTreeMap<([u32; 2], u32), [u32; 2]>,
    /// All lists so far.
    lists: Vec<u32>,
    parts: Vec<Part>,
    hazards: Hazards,
}

impl<'a> Composer<'a> {
    pub(super) fn new(plan: &'a Plan, masked: bool) -> Self {
        Self {
            plan,
            masked,
            anew: None,
            unsettled: None,
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

    pub(super) fn finish(self, registered: usize) -> Script {
        let grids =
            self.plan.pyramid[..self.plan.solved].iter().map(|level| Over::GRIDS.map(|over| groups(level, over)));
        let arguments = arguments::at_the_start(&grids.collect::<Vec<_>>(), &self.warps);
        Script { parts: self.parts, registered, arguments, tiles: self.lists }
    }

    fn push(&mut self, action: Action) {
        let waits = self.hazards.waits(&action);
        self.part().entries.push(Entry { action, waits });
    }

    /// The part at hand.
    fn part(&mut self) -> &mut Part {
        let last = self.parts.len() - 1;
        &mut self.parts[last]
    }

    /// A stage runs.
    pub(super) fn dispatch<P: Pass>(&mut self, bindings: P, constants: &P::Constants, variant: Variant, grid: Grid) {
        self.push(Action::Dispatch(Dispatch {
            stage: P::STAGE,
            variant,
            slots: bindings.slots(),
            constants: bytemuck::bytes_of(constants).to_vec(),
            grid,
            place: self.place,
            bytes: P::bytes(constants, variant),
            twin: |dispatch, memory| {
                let constants = bytemuck::pod_read_unaligned(&dispatch.constants);
                P::of(&dispatch.slots).run(&constants, dispatch.variant, memory);
            },
        }));
    }

    /// The tiles of so many pixels that come within `margin` pixels of what is wanted: where their list begins, and a workgroup each; `None`
    /// if everything is.
    pub(super) fn list(&mut self, tile: [u32; 2], margin: u32) -> Option<(u32, Grid)> {
        let wanted = self.wanted.as_ref()?;
        let [first, count] = *self.listed.entry((tile, margin)).or_insert_with(|| {
            let (first, tiles) = (self.lists.len(), wanted.tiles(tile, margin));
            self.lists.extend(&tiles);
            [first, tiles.len()].map(|n| n as u32)
        });
        Some((first, Grid::Direct([count, 1, 1])))
    }

    /// What the passes to come are wanted for.
    pub(super) fn want(&mut self, wanted: NeededCells) {
        self.wanted = Some(wanted);
        self.listed.clear();
    }

    /// A stage runs over so many pixels.
    pub(super) fn over<P: Pass>(&mut self, size: [u32; 2], bindings: P, constants: &P::Constants, variant: Variant) {
        self.dispatch(bindings, constants, variant, Grid::Direct(P::STAGE.groups(size)));
    }

    /// A stage runs in an iteration of a level, unless the level has settled.
    pub(super) fn within<P: Pass>(
        &mut self,
        level: &Level,
        over: Over,
        bindings: P,
        constants: &P::Constants,
        variant: Variant,
    ) {
        let grid =
            if self.settles { Grid::Level { level: level.index, over } } else { Grid::Direct(groups(level, over)) };
        self.dispatch(bindings, constants, variant, grid);
    }

    fn copy(&mut self, from: Slot, to: Slot) {
        self.push(Action::Copy { from, to, levels: false });
    }

    /// V of a level is zero.
    fn clear(&mut self, level: &Level) {
        self.empty(Slot::RelativeBlur { level: level.index }, level.size);
    }

    /// An image is zero.
    pub(super) fn empty(&mut self, image: Slot, size: [u32; 2]) {
        self.push(Action::Clear { image, size });
    }

    /// The rest goes into another part.
    pub(super) fn next_part(&mut self) {
        self.parts.push(Part::default());
        self.hazards.begin_part();
    }

    /// What comes before a level's iterations goes into another part.
    fn begin_level(&mut self, level: &Level) {
        self.next_part();
        self.part().begins = Some(level.index);
    }

    /// Iteration k of a level: into another part, if the host is to be asked whether it is wanted or the part at hand is full.
    fn begin_iteration(&mut self, level: &Level, k: u32, may_settle: impl Fn(u32) -> bool) {
        if Plan::asks_before(k, may_settle) {
            self.copy(Slot::State, Slot::Progress);
            self.next_part();
            self.part().goes_on = Some(level.index);
        } else if starts_part(level, k) || self.plan.warps_anew(level, k) && warping_fills_part(level) {
            self.next_part();
        }
        self.place = self.place.iteration(k);
    }

    /// The part at hand is the last of a level.
    fn end_level(&mut self, level: &Level) {
        self.part().level_done = Some(level.index);
    }

    /// T on one level, by appearance.
    fn register_level(&mut self, level: &Level) {
        let plan = self.plan;
        self.place = Place::registering(level.index);
        self.spline2(level);
        if plan.matches_exposure() {
            // Nothing is known of V yet.
            self.clear(level);
            self.exposure(level, Adopt::Exposure, false);
        }
        for k in 0..plan.settings.outer_iterations {
            self.begin_iteration(level, k, |k| plan.appearance_step(level, k).may_settle == 1);
            self.appearance(level);
            self.step(level, &plan.appearance_step(level, k));
        }
        self.end_level(level);
    }

    /// V on one level, and the registration where it is solved for together with V.
    fn solve_level(&mut self, level: &Level) {
        let plan = self.plan;
        self.place = Place::level(level.index);
        self.start(level);
        let mut passed = 0;
        for (image, layer) in BOTH.iter().flat_map(|&image| (0..plan.layers_of(level)).map(move |n| (image, n))) {
            passed += self.stack_layer(level, image, layer) * level.pixels();
            if passed > FILTERS_AN_ITERATION * PART_BUDGET {
                self.begin_level(level);
                passed = 0;
            }
        }
        if plan.finds_shape(level) {
            self.find_shape(level);
        }
        for k in 0..plan.settings.outer_iterations {
            self.begin_iteration(level, k, |k| plan.may_settle(level, k));
            if plan.warps_anew(level, k) {
                self.warp_anew(level);
            }
            if plan.matches_before(level, k) {
                self.exposure(level, plan.adopts(level), true);
            }
            self.linearise(level, k);
            self.step(level, &plan.step(level, k));
            // The last only says where the others have led.
            if k + 1 < plan.settings.outer_iterations {
                self.system(level, &plan.system(level, k), NO_VARIANT);
                self.relaxation(level);
                self.update(level, &plan.update(level, k));
            }
        }
        self.end_level(level);
    }

    /// State and indirect arguments as they are before a solve.
    fn reset(&mut self) {
        self.copy(Slot::StartState, Slot::State);
        self.copy(Slot::StartArguments, Slot::Arguments);
    }

    /// What levels have done, and their indirect arguments, as they are before a solve; T, gain and offset stay.
    fn reset_levels(&mut self) {
        self.push(Action::Copy { from: Slot::StartState, to: Slot::State, levels: true });
        self.copy(Slot::StartArguments, Slot::Arguments);
    }

    /// A photograph as a camera packs it to its samples.
    fn unpack(&mut self, image: usize) {
        let bindings = unpack::Bindings { packed: slot::packed(image).read(), samples: slot::samples(image).write() };
        let constants = self.plan.unpack(image);
        self.over(constants.invocations(), bindings, &constants, unpack::variant(self.plan.packed[image]));
    }

    /// One channel of a photograph, or its luminance, onto the finest level.
    pub(super) fn ingest(&mut self, image: usize, weights: [f32; 3]) {
        let bindings =
            ingest::Bindings { samples: slot::samples(image).read(), image: slot::luminance(image, 0).write() };
        let variant = if self.plan.settings.decode == Decode::Srgb { ingest::SRGB } else { NO_VARIANT };
        self.over(self.plan.size, bindings, &self.plan.ingest(image, weights), variant);
    }

    /// Which pixels of a photograph count, on the finest level.
    fn mask(&mut self, image: usize) {
        let masks = slot::masks(0);
        let bindings =
            mask::Bindings { samples: slot::samples(image).read(), mask: slot::MASK.read(), masks: masks.write() };
        self.over(self.plan.size, bindings, &self.plan.mask(image), NO_VARIANT);
        self.smooth((masks.plane(), image as u32), self.plan.size);
    }

    /// V of a level before its first iteration: zero, or the coarser level's.
    fn start(&mut self, level: &Level) {
        if level.index + 1 == self.plan.solved {
            return self.clear(level);
        }
        let coarse = slot::relative_blur(level.index + 1).read();
        let bindings = prolong::Bindings { coarse, fine: slot::relative_blur(level.index).write() };
        self.over(level.size, bindings, &self.plan.prolong(level), NO_VARIANT);
    }

    /// The registration integrals without a blur model: equation 36.
    fn appearance(&mut self, level: &Level) {
        let bindings = appearance::Bindings {
            i1: slot::i1(level.index).read(),
            spline2: slot::SPLINE2.read(),
            state: slot::STATE.read(),
            partials: slot::PARTIALS.write(),
            masks: slot::masks(level.index).read(),
        };
        let variant = [false, false, self.masked, self.plan.projective()];
        self.within(level, Over::Tiles, bindings, &self.plan.appearance(level), variant);
    }

    /// S1, S2, D, b and the registration integrals: equations 22 to 32 and 23.
    fn linearise(&mut self, level: &Level, k: u32) {
        let variant =
            linearise::variant(self.plan.slopes(), self.plan.warps(level), self.masked, self.plan.sums_all(level));
        let bindings = linearise::Bindings {
            i1: slot::i1(level.index).read(),
            v: slot::relative_blur(level.index).read(),
            stacks: slot::STACKS.read(),
            equations: slot::NORMAL_EQUATIONS.write(),
            state: slot::STATE.read(),
            partials: slot::PARTIALS.write(),
            masks: slot::masks(level.index).read(),
        };
        self.within(level, Over::Tiles, bindings, &self.plan.linearise(level, k), variant);
    }

    /// T; settled?
    fn step(&mut self, level: &Level, constants: &update_transform::Constants) {
        let bindings = update_transform::Bindings {
            partials: slot::PARTIALS.read(),
            state: slot::STATE.update(),
            energies: slot::ENERGIES.write(),
            arguments: slot::ARGUMENTS.write(),
            start_arguments: slot::START_ARGUMENTS.read(),
        };
        let variant = if self.plan.sums_all(level) { sums::PROJECTIVE } else { NO_VARIANT };
        self.within(level, Over::One, bindings, constants, variant);
        self.place = self.place.after_step();
    }

    /// The registration, into mapped memory, before the results are there.
    fn bring_down_registration(&mut self) {
        self.copy(Slot::State, Slot::RegisteredState);
        self.copy(Slot::Energies, Slot::RegisteredEnergies);
    }

    /// The results, into mapped memory.
    fn bring_down(&mut self) {
        self.push(Action::Download { layers: self.plan.map_layers() });
        self.copy(Slot::State, Slot::EndState);
        self.copy(Slot::Energies, Slot::EndEnergies);
    }
}
