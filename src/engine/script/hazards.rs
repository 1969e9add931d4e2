//! What a step waits for: by what earlier steps did to the slots that it touches.

use std::collections::HashMap;

use super::Action;
use crate::engine::slot::Slot;
use crate::engine::vulkan::Access;

/// The latest steps that read and that wrote a slot.
#[derive(Clone, Copy, Default)]
struct Touched {
    read: Option<usize>,
    written: Option<usize>,
}

/// The slots touched so far.
#[derive(Default)]
pub(super) struct Hazards {
    touched: HashMap<Slot, Touched>,
}

impl Hazards {
    /// Which earlier step the step of this index waits for: reads for the latest write, writes for the latest of either.
    pub(super) fn waits_for(&mut self, index: usize, action: &Action) -> Option<usize> {
        let accesses = accesses(action);
        let before = |(slot, access): &(Slot, Access)| {
            let Touched { read, written } = self.touched.get(slot).copied().unwrap_or_default();
            if *access == Access::Read { written } else { read.max(written) }
        };
        let waits_for = accesses.iter().filter_map(before).max();
        for (slot, access) in accesses {
            let touched = self.touched.entry(slot).or_default();
            if access == Access::Read {
                touched.read = Some(index);
            } else {
                touched.written = Some(index);
            }
        }
        waits_for
    }
}

/// The slots that a step touches, and how.
fn accesses(action: &Action) -> Vec<(Slot, Access)> {
    match action {
        Action::Dispatch(dispatch) => {
            let declared = dispatch.slots.iter().zip(dispatch.stage.bindings);
            let indirect = dispatch.grid.word().map(|_| (Slot::Arguments, Access::Read));
            declared.map(|(slot, binding)| (*slot, binding.access)).chain(indirect).collect()
        }
        Action::Copy { from, to, .. } => vec![(*from, Access::Read), (*to, Access::Write)],
        Action::Clear { image, .. } => vec![(*image, Access::Write)],
        Action::Download { .. } => vec![(Slot::Stacks, Access::Read), (Slot::Results, Access::Write)],
        Action::ShowHost | Action::NextPart => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_waits_for_the_write_and_a_write_for_both() {
        let mut hazards = Hazards::default();
        let copy = |from, to| Action::Copy { from, to, levels: false };
        let (a, b, c) = (Slot::State, Slot::Progress, Slot::EndState);
        assert_eq!(hazards.waits_for(0, &copy(a, b)), None);
        assert_eq!(hazards.waits_for(1, &copy(a, c)), None, "two that only read the same");
        assert_eq!(hazards.waits_for(2, &copy(b, c)), Some(1), "reads what 0 wrote, writes over what 1 wrote");
        assert_eq!(hazards.waits_for(3, &copy(c, a)), Some(2));
        assert_eq!(hazards.waits_for(4, &copy(Slot::Energies, b)), Some(2), "2 still reads it");
    }
}
