//! A solve as data: its dispatches and copies in order, and which of them wait for those before.
//!
//! [`compose`] composes the script of a pair. Two executors run it: [`record`](super::record) on a Vulkan device,
//! and [`cpu`](super::cpu) by the CPU references of the stages.

mod compose;
mod filters;
pub(crate) mod outlines;
mod output_passes;
mod passes;
pub(crate) mod sweep;

use std::collections::HashMap;
use std::ops::Range;

use super::arguments::{Grid, Place};
use super::slot::Slot;
use super::stages::Number;
use super::stages::pass::{Memory, Pass};
use super::vulkan::{Access, Stage, Variant};

pub(crate) use compose::compose;
pub(crate) use passes::MOST_MOVING;

/// A solve.
pub(crate) struct Script {
    pub(crate) parts: Vec<Part>,
    /// The number of parts until the registration is known.
    pub(crate) registered: usize,
    /// The indirect arguments before the solve. Scripts with and without masks share one buffer, so both must have the
    /// same arguments.
    pub(crate) arguments: Vec<u32>,
    /// The lists of tiles that passes of a sweep run over.
    pub(crate) tiles: Vec<u32>,
}

/// The kernel of a level's blur stacks.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum StackKernel {
    /// A Gaussian: the stacks have just been computed.
    Gaussian,
    /// The kernel that the level has found so far.
    Found,
}

/// Which pixels of a pair count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CountedPixels {
    All,
    /// Those that are neither masked nor clipped.
    Unmasked,
}

/// A command buffer that the host can skip. It begins when all parts before are complete.
#[derive(Debug, Default)]
pub(crate) struct Part {
    pub(crate) entries: Vec<Entry>,
    /// The level, 0 the finest, that is complete when it ends.
    pub(crate) level_done: Option<usize>,
    /// The level whose iterations it continues. It is skipped once that level has settled.
    pub(crate) continues: Option<usize>,
    /// The level that it begins. Devices that skip parts by themselves skip it once that level has settled: all levels
    /// do in a solve that is cancelled.
    pub(crate) begins: Option<usize>,
    /// Whether it ends a batch: the host sees that it is complete. Parts that end none are complete with a later one.
    pub(crate) ends_batch: bool,
}

impl Part {
    /// The compulsory traffic of its dispatches.
    fn bytes(&self) -> u64 {
        let bytes = |entry: &Entry| if let Action::Dispatch(dispatch) = &entry.action { dispatch.bytes } else { 0 };
        self.entries.iter().map(bytes).sum()
    }

    /// The first outer iteration that it has dispatches of.
    pub(crate) fn iteration(&self) -> Option<u32> {
        self.entries.iter().find_map(|entry| match &entry.action {
            Action::Dispatch(dispatch) => dispatch.place.iteration,
            _ => None,
        })
    }
}

/// An action of a part.
#[derive(Debug)]
pub(crate) struct Entry {
    pub(crate) action: Action,
    /// Whether a barrier precedes it: it reads a slot that was written, or writes a slot that was accessed, since the
    /// last barrier.
    pub(crate) waits: bool,
}

/// What an entry does.
#[derive(Debug)]
pub(crate) enum Action {
    /// Runs a stage.
    Dispatch(Dispatch),
    /// Copies a buffer, or with `levels` only the state of the levels.
    Copy { from: Slot, to: Slot, levels: bool },
    /// Sets all pixels of these layers of an image to zero.
    Clear { image: Slot, size: [u32; 2], layers: Range<u32> },
    /// Copies the first `layers` layers of the stacks, the results, into mapped memory.
    Download { layers: u32 },
}

/// One run of a stage.
#[derive(Clone, Debug)]
pub(crate) struct Dispatch {
    pub(crate) stage: &'static Stage,
    pub(crate) variant: Variant,
    /// The slots that it binds, in the shader's order.
    pub(crate) slots: Vec<Slot>,
    pub(crate) constants: Vec<u8>,
    pub(crate) grid: Grid,
    pub(crate) place: Place,
    /// Compulsory traffic: each input element read once, each output element written once.
    pub(crate) bytes: u64,
    /// The stage's CPU reference, which runs on the same slots.
    pub(crate) cpu_reference: CpuReference,
}

impl Dispatch {
    /// Bindings, push constants and variant, if it is of this pass.
    #[cfg(any(test, feature = "program"))]
    pub(crate) fn of<P: Pass>(&self) -> Option<(P, P::Constants, Variant)> {
        (self.stage.shader.name == P::STAGE.shader.name)
            .then(|| (P::of(&self.slots), bytemuck::pod_read_unaligned(&self.constants), self.variant))
    }
}

/// A stage's CPU reference, for numbers of both types. Only tests run it in double precision, and compiling that takes
/// as long as compiling it in single precision.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CpuReference {
    #[cfg(any(test, debug_assertions, feature = "reference"))]
    double: fn(&Dispatch, &mut Memory<f64>),
    single: fn(&Dispatch, &mut Memory<f32>),
}

impl CpuReference {
    /// The CPU reference of a pass.
    fn of<P: Pass>() -> Self {
        Self {
            #[cfg(any(test, debug_assertions, feature = "reference"))]
            double: run::<P, f64>,
            single: run::<P, f32>,
        }
    }
}

fn run<P: Pass, N: Number>(dispatch: &Dispatch, memory: &mut Memory<N>) {
    let constants = bytemuck::pod_read_unaligned(&dispatch.constants);
    P::of(&dispatch.slots).run(&constants, dispatch.variant, memory);
}

/// A type of numbers that scripts run with on the processor.
pub(crate) trait Executable: Number {
    /// Runs the CPU reference of a dispatch.
    fn run(dispatch: &Dispatch, memory: &mut Memory<Self>);
}

#[cfg(any(test, debug_assertions, feature = "reference"))]
impl Executable for f64 {
    fn run(dispatch: &Dispatch, memory: &mut Memory<Self>) {
        (dispatch.cpu_reference.double)(dispatch, memory);
    }
}

impl Executable for f32 {
    fn run(dispatch: &Dispatch, memory: &mut Memory<Self>) {
        (dispatch.cpu_reference.single)(dispatch, memory);
    }
}

impl Script {
    /// All entries in order.
    pub(crate) fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.parts.iter().flat_map(|part| &part.entries)
    }

    /// The dispatches in order.
    pub(crate) fn dispatches(&self) -> impl Iterator<Item = &Dispatch> {
        self.entries().filter_map(|entry| match &entry.action {
            Action::Dispatch(dispatch) => Some(dispatch),
            _ => None,
        })
    }
}

/// The slots that were accessed since the last barrier, and whether they were written.
#[derive(Default)]
struct Hazards {
    accessed: HashMap<Slot, bool>,
}

impl Hazards {
    /// Begins a part, which waits for all before it.
    fn begin_part(&mut self) {
        self.accessed.clear();
    }

    /// Whether an action needs a barrier: it reads a slot that was written, or writes one that was accessed.
    fn waits(&mut self, action: &Action) -> bool {
        let accesses = accesses(action);
        let collides = |(slot, access): &(Slot, Access)| {
            self.accessed.get(slot).is_some_and(|&written| written || *access != Access::Read)
        };
        let waits = accesses.iter().any(collides);
        if waits {
            self.accessed.clear();
        }
        for (slot, access) in accesses {
            *self.accessed.entry(slot).or_default() |= access != Access::Read;
        }
        waits
    }
}

/// The slots that an action accesses, and how.
pub(crate) fn accesses(action: &Action) -> Vec<(Slot, Access)> {
    match action {
        Action::Dispatch(dispatch) => {
            let declared = dispatch.slots.iter().zip(dispatch.stage.bindings);
            let indirect = dispatch.grid.word().map(|_| (Slot::Arguments, Access::Read));
            declared.map(|(slot, binding)| (*slot, binding.access)).chain(indirect).collect()
        }
        Action::Copy { from, to, .. } => vec![(*from, Access::Read), (*to, Access::Write)],
        Action::Clear { image, .. } => vec![(*image, Access::Write)],
        Action::Download { .. } => vec![(Slot::Stacks, Access::Read), (Slot::EndMaps, Access::Write)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Channels, Depth, Format, Method, PixelFormat, Settings};
    use crate::engine::arguments::{Indirect, Over};
    use crate::engine::plan::Plan;
    use crate::engine::stages::{NO_VARIANT, prolong};

    fn script(method: Method, pixels: CountedPixels) -> Script {
        let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
        let settings = Settings { method, ..Settings::default() };
        compose(&Plan::new(200, 150, [gray; 2], &settings).unwrap(), pixels)
    }

    fn name(entry: &Entry) -> &str {
        match &entry.action {
            Action::Dispatch(dispatch) => dispatch.stage.shader.name,
            _ => "",
        }
    }

    #[test]
    fn the_registration_is_known_before_the_end() {
        for method in [Method::Unified, Method::Aligned, Method::Appearance] {
            let script = script(method, CountedPixels::All);
            assert!(script.registered > 0 && script.registered < script.parts.len());
        }
    }

    #[test]
    fn a_pass_waits_for_the_slots_that_it_reads_and_for_no_others() {
        let packed = "Mono12p".parse::<PixelFormat>().unwrap();
        let script = compose(&Plan::new(200, 150, [packed; 2], &Settings::default()).unwrap(), CountedPixels::All);
        let first = |pass| script.parts[0].entries.iter().find(|entry| name(entry) == pass).unwrap();
        assert!(!first("unpack").waits, "it is the first, and does not read the state, which is copied before");
        assert!(first("ingest").waits);
        let iteration = |entry: &&Entry| ["linearise", "system_tiles", "relax_tiles"].contains(&name(entry));
        for part in &script.parts {
            // The first entry of a part needs no barrier.
            assert!(part.entries.iter().skip(1).filter(iteration).all(|entry| entry.waits));
        }
    }

    #[test]
    fn only_masked_scripts_weight_pixels_and_both_have_the_same_arguments() {
        let [plain, masked] =
            [CountedPixels::All, CountedPixels::Unmasked].map(|pixels| script(Method::Unified, pixels));
        let weights = |script: &Script| script.dispatches().any(|dispatch| dispatch.variant.has(Variant::MASKED));
        assert!(!weights(&plain) && weights(&masked));
        assert_eq!(plain.arguments, masked.arguments);
    }

    #[test]
    fn a_device_is_submitted_few_batches() {
        let batches =
            |plan: &Plan| compose(plan, CountedPixels::All).parts.iter().filter(|part| part.ends_batch).count();
        let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
        let plan = Plan::new(1000, 1000, [gray; 2], &Settings::default()).unwrap();
        assert!(compose(&plan, CountedPixels::All).parts.len() > 300);
        assert!(batches(&plan) <= 10, "{}", batches(&plan));
    }

    #[test]
    fn only_grids_of_many_tiles_have_dispatches_of_their_own() {
        let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
        let plan = Plan::new(2000, 2000, [gray; 2], &Settings::default()).unwrap();
        let script = compose(&plan, CountedPixels::All);
        let variants = |name: &str, level: usize| -> Vec<bool> {
            let of_level = script.dispatches().filter(|d| d.stage.shader.name == name && d.place.level == level);
            of_level.map(|dispatch| dispatch.variant.has(Variant::JOINED)).collect()
        };
        // Grids of 250, 500 and 1000 cells along a side before the finest level, the first two before the next.
        for (level, grids, joins) in [
            (0, &[true, false, false][..], false),
            (1, &[true, false], false),
            (2, &[true], false),
            (3, &[], true),
            (6, &[], true),
        ] {
            let count = plan.settings.outer_iterations as usize - 1;
            assert_eq!(variants("relax_grid_tiles", level), grids.repeat(count), "level {level}");
            assert_eq!(variants("relax_tiles", level), vec![joins; count], "level {level}");
        }
    }

    #[test]
    fn a_read_waits_for_writes_and_a_write_for_both() {
        let mut hazards = Hazards::default();
        let copy = |from, to| Action::Copy { from, to, levels: false };
        let (a, b, c) = (Slot::State, Slot::Progress, Slot::EndState);
        assert!(!hazards.waits(&copy(a, b)));
        assert!(!hazards.waits(&copy(a, c)), "two reads");
        assert!(hazards.waits(&copy(b, Slot::RegisteredState)), "a read after a write");
        assert!(hazards.waits(&copy(Slot::StartState, b)), "a write after a read");
        assert!(!hazards.waits(&copy(Slot::Energies, c)), "no access since the last barrier");
        hazards.begin_part();
        assert!(!hazards.waits(&copy(b, a)), "a part waits for all before it");
    }

    #[test]
    fn an_indirect_dispatch_waits_for_its_arguments() {
        let dispatch = |grid| {
            Action::Dispatch(Dispatch {
                stage: &prolong::STAGE,
                variant: NO_VARIANT,
                slots: vec![Slot::RelativeBlur { level: 1 }, Slot::RelativeBlur { level: 0 }],
                constants: Vec::new(),
                grid,
                place: Place::default(),
                bytes: 0,
                cpu_reference: CpuReference::of::<prolong::Bindings>(),
            })
        };
        let arguments = Action::Copy { from: Slot::StartArguments, to: Slot::Arguments, levels: false };
        let level = Grid::Indirect(Indirect::Level { level: 0, over: Over::Tiles });
        for (grid, waits) in [(level, true), (Grid::Direct([1; 3]), false)] {
            let mut hazards = Hazards::default();
            assert!(!hazards.waits(&arguments));
            assert_eq!(hazards.waits(&dispatch(grid)), waits);
        }
    }
}
