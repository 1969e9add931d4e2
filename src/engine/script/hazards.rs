//! Where a script must wait: by what stages declare to do to the slots that they touch.

use std::collections::HashMap;

use super::Action;
use crate::engine::slot::Slot;
use crate::engine::vulkan::Access;

/// The slots touched since the last wait, and whether they were written.
#[derive(Default)]
pub(super) struct Hazards {
    touched: HashMap<Slot, bool>,
}

impl Hazards {
    /// A part begins, which waits for all before it.
    pub(super) fn begin_part(&mut self) {
        self.touched.clear();
    }

    /// Whether this must wait: it reads what has been written, or writes what has been read or written.
    pub(super) fn waits(&mut self, action: &Action) -> bool {
        let accesses = accesses(action);
        let collides = |(slot, access): &(Slot, Access)| {
            self.touched.get(slot).is_some_and(|&written| written || *access != Access::Read)
        };
        let waits = accesses.iter().any(collides);
        if waits {
            self.touched.clear();
        }
        for (slot, access) in accesses {
            *self.touched.entry(slot).or_default() |= access != Access::Read;
        }
        waits
    }
}

/// The slots that an entry touches, and how.
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
    use crate::engine::arguments::{Grid, Over, Place};
    use crate::engine::script::Dispatch;
    use crate::engine::stages::{NO_VARIANT, update};

    #[test]
    fn reads_wait_for_writes_and_writes_for_both() {
        let mut hazards = Hazards::default();
        let copy = |from, to| Action::Copy { from, to, levels: false };
        let (a, b, c) = (Slot::State, Slot::Progress, Slot::EndState);
        assert!(!hazards.waits(&copy(a, b)));
        assert!(!hazards.waits(&copy(a, c)), "two that only read the same");
        assert!(hazards.waits(&copy(b, Slot::RegisteredState)), "reads what was written");
        assert!(hazards.waits(&copy(Slot::StartState, b)), "writes what is read");
        assert!(!hazards.waits(&copy(Slot::Energies, c)), "nothing since the last wait");
        hazards.begin_part();
        assert!(!hazards.waits(&copy(b, a)), "a part waits for all before it");
    }

    #[test]
    fn an_indirect_dispatch_waits_for_its_arguments() {
        let dispatch = |grid| {
            Action::Dispatch(Dispatch {
                stage: &update::STAGE,
                variant: NO_VARIANT,
                slots: vec![Slot::Change { color: 0 }, Slot::Change { color: 1 }, Slot::RelativeBlur { level: 0 }],
                constants: Vec::new(),
                grid,
                place: Place::default(),
                bytes: 0,
                twin: |_, _| (),
            })
        };
        let arguments = Action::Copy { from: Slot::StartArguments, to: Slot::Arguments, levels: false };
        for (grid, waits) in [(Grid::Level { level: 0, over: Over::Pixels }, true), (Grid::Direct([1; 3]), false)] {
            let mut hazards = Hazards::default();
            assert!(!hazards.waits(&arguments));
            assert_eq!(hazards.waits(&dispatch(grid)), waits);
        }
    }
}
