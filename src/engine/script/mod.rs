//! A solve as data: every dispatch in order, with its stage, what it binds, its constants, its grid, and what it waits for.
//!
//! [`compose`] writes the method down once. Two executors run what it wrote: [`record`](super::record) on a device,
//! [`reference`](super::reference) by the stages' twins.

mod compose;
mod exposure;
mod filters;
mod hazards;
mod relaxation;
mod results;
mod shape;
pub(crate) mod sweep;

use super::arguments::{Grid, Place};
use super::slot::Slot;
use super::stages::memory::Memory;
use super::vulkan::{Stage, Variant};

pub(crate) use compose::compose;
#[cfg(test)]
pub(crate) use hazards::accesses;

/// A solve.
pub(crate) struct Script {
    pub(crate) parts: Vec<Part>,
    /// How many of them it takes until the registration is known.
    pub(crate) registered: usize,
    /// The indirect arguments before the solve: of one plan the same, whether pixels are masked or not, since the scripts of
    /// both keep them in one buffer.
    pub(crate) arguments: Vec<u32>,
    /// The lists of tiles that passes are wanted for, of sweeps alone.
    pub(crate) tiles: Vec<u32>,
}

/// A command buffer of its own, which the host can wait for or leave out. It begins when all before it is done.
#[derive(Debug, Default)]
pub(crate) struct Part {
    pub(crate) entries: Vec<Entry>,
    /// The level, 0 the finest, that is done when it ends.
    pub(crate) level_done: Option<usize>,
    /// The level whose iterations it goes on with: not wanted once that has settled.
    pub(crate) goes_on: Option<usize>,
    /// The level that it begins: where the device leaves parts out by itself, it leaves that out once it has settled, as all do in a solve that is
    /// called off.
    pub(crate) begins: Option<usize>,
}

/// One thing to do.
#[derive(Debug)]
pub(crate) struct Entry {
    pub(crate) action: Action,
    /// Whether all before it in its part must be done, and what that wrote visible: by the accesses that stages declare, it
    /// touches what has been written, or writes what has been touched, since the last that waited.
    pub(crate) waits: bool,
}

/// What there is to do.
#[derive(Debug)]
pub(crate) enum Action {
    /// A stage runs.
    Dispatch(Dispatch),
    /// A buffer is copied, or of a state only what its levels have done.
    Copy { from: Slot, to: Slot, levels: bool },
    /// Zero in every pixel of an image of this size.
    Clear { image: Slot, size: [u32; 2] },
    /// The results come down: so many of the stacks' first layers.
    Download { layers: u32 },
}

/// A stage runs once.
#[derive(Clone, Debug)]
pub(crate) struct Dispatch {
    pub(crate) stage: &'static Stage,
    pub(crate) variant: Variant,
    /// What it binds, in the shader's order; how, the stage says.
    pub(crate) slots: Vec<Slot>,
    pub(crate) constants: Vec<u8>,
    pub(crate) grid: Grid,
    pub(crate) place: Place,
    /// Compulsory traffic: every input element read once, every output element written once.
    pub(crate) bytes: u64,
    /// The stage's twin at work on the same slots.
    pub(crate) twin: fn(&Dispatch, &mut Memory),
}

impl Script {
    /// Everything to do, in order.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Channels, Depth, Format, Method, Settings};
    use crate::engine::plan::Plan;

    fn script(method: Method, masked: bool) -> Script {
        let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
        let settings = Settings { method, ..Settings::default() };
        compose(&Plan::new(200, 150, [gray; 2], &settings).unwrap(), masked)
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
            let script = script(method, false);
            assert!(script.registered > 0 && script.registered < script.parts.len());
        }
    }

    #[test]
    fn passes_wait_for_what_they_read_and_for_nothing_else() {
        let script = script(Method::Unified, false);
        let first: Vec<&Entry> = script.parts[0].entries.iter().filter(|entry| name(entry) == "ingest").collect();
        assert!(!first[0].waits, "nothing came before it");
        let iteration = |entry: &&Entry| ["linearise", "update_transform", "relax", "update"].contains(&name(entry));
        for part in &script.parts {
            // The first of a part waits by being so.
            assert!(part.entries.iter().skip(1).filter(iteration).all(|entry| entry.waits));
        }
    }

    #[test]
    fn only_masked_scripts_weigh_pixels_and_both_have_the_same_arguments() {
        let [plain, masked] = [false, true].map(|masked| script(Method::Unified, masked));
        let weighs = |script: &Script| script.dispatches().any(|dispatch| dispatch.variant[2]);
        assert!(!weighs(&plain) && weighs(&masked));
        assert_eq!(plain.arguments, masked.arguments);
    }
}
