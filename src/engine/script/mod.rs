//! A solve as data: every dispatch in order, with its stage, what it binds, its constants, its grid, and what it waits for.
//!
//! [`compose`] writes the method down once. Two executors run what it wrote: [`record`](super::record) on a device,
//! [`reference`](super::reference) by the stages' twins.

mod compose;
mod filters;
mod hazards;
mod results;

use super::arguments::{Grid, Place};
use super::slot::Slot;
use super::stages::memory::Memory;
use super::vulkan::{Stage, Variant};

pub(crate) use compose::compose;

/// A solve.
pub(crate) struct Script {
    pub(crate) steps: Vec<Step>,
    pub(crate) parts: Vec<Part>,
    /// How many of the parts it takes until the registration is known.
    pub(crate) registered: usize,
    /// The indirect arguments before the solve.
    pub(crate) arguments: Vec<u32>,
}

/// A submission of its own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Part {
    /// The level, 0 the finest, that is done when it ends.
    pub(crate) level_done: Option<usize>,
    /// The level whose iterations it goes on with: not wanted once that has settled.
    pub(crate) goes_on: Option<usize>,
}

/// One thing to do.
#[derive(Debug)]
pub(crate) struct Step {
    pub(crate) action: Action,
    /// The latest step that must be done, and what it wrote visible, before this one begins; `None` for the first that
    /// touches what it touches. By the accesses that stages declare.
    pub(crate) waits_for: Option<usize>,
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
    /// What was copied so far is visible to the host when the part ends.
    ShowHost,
    /// The next [`Part`] begins.
    NextPart,
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
    /// The dispatches in order.
    pub(crate) fn dispatches(&self) -> impl Iterator<Item = &Dispatch> {
        self.steps.iter().filter_map(|step| match &step.action {
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

    #[test]
    fn each_part_begins_where_the_script_says_and_one_registers() {
        for method in [Method::Unified, Method::Aligned, Method::Appearance] {
            let script = script(method, false);
            let parts = script.steps.iter().filter(|step| matches!(step.action, Action::NextPart)).count();
            assert_eq!(script.parts.len(), parts + 1);
            assert!(script.registered > 0 && script.registered < script.parts.len());
        }
    }

    #[test]
    fn passes_that_share_nothing_do_not_wait_for_each_other() {
        let script = script(Method::Unified, false);
        let of = |name: &'static str| -> Vec<Option<usize>> {
            let named = |step: &&Step| matches!(&step.action, Action::Dispatch(d) if d.stage.shader.name == name);
            script.steps.iter().filter(named).map(|step| step.waits_for).collect()
        };
        assert_eq!(of("ingest")[..2], [None, None]);
        let iteration = ["linearise", "step", "relax", "update"].map(of).concat();
        assert!(iteration.iter().all(Option::is_some));
    }

    #[test]
    fn only_masked_scripts_weigh_pixels() {
        let weighs = |masked| script(Method::Unified, masked).dispatches().any(|d| d.variant[2]);
        assert!(weighs(true) && !weighs(false));
    }
}
