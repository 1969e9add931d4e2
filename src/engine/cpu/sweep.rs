//! The memory of a sweep on the CPU device.

use std::ops::Range;
use std::sync::Arc;

use super::run;
use crate::base::{CancellationToken, Deadline, Error, Frame};
use crate::engine::device::CpuDevice;
use crate::engine::plan::Plan;
use crate::engine::script::{Script, sweep};
use crate::engine::slot::Slot;
use crate::engine::stages::Field;
use crate::engine::stages::pass::Memory;

/// Memory for a sweep.
pub(in crate::engine) struct CpuSweep {
    device: Arc<CpuDevice>,
    memory: Memory<f32>,
    /// Part 0 chooses the unit, part n + 1 uploads frame n.
    upload: Script,
}

impl CpuSweep {
    /// Memory for sweeps of a plan.
    pub(in crate::engine) fn new(device: &Arc<CpuDevice>, plan: &Plan, frames: u32) -> Self {
        let mut memory = Memory::with_filters(&plan.weights.banks);
        memory.upload_state(Default::default());
        memory.copy(Slot::StartState, Slot::State, false);
        Self { device: device.clone(), memory, upload: sweep::upload(plan, frames) }
    }

    /// Runs a part of the upload of a frame.
    pub(in crate::engine) fn upload(&mut self, part: usize, frame: &Frame, deadline: Deadline) -> Result<(), Error> {
        self.memory.upload_photograph(0, frame.clone());
        let name = &self.device.info.name;
        run(&self.upload.parts[part].entries, &mut self.memory, &mut |_| deadline.check(name))
    }

    /// Runs a script. `floats` partial sums are set to zero first.
    pub(in crate::engine) fn run(
        &mut self,
        script: &Script,
        floats: usize,
        cancel: &CancellationToken,
        deadline: Deadline,
    ) -> Result<(), Error> {
        self.memory.clear_numbers(Slot::Partials, floats);
        // CPU references run over all tiles.
        #[cfg(test)]
        self.memory.write_words(Slot::Tiles, &script.tiles);
        let name = &self.device.info.name;
        let mut proceed = |_: &_| deadline.check(name).and_then(|()| cancel.check());
        run(script.entries(), &mut self.memory, &mut proceed)
    }

    /// The words of a buffer.
    pub(in crate::engine) fn write_words(&mut self, slot: Slot, words: &[u32]) {
        self.memory.write_words(slot, words);
    }

    /// Partial sums from a place on.
    pub(in crate::engine) fn partials(&self, first: usize, count: usize) -> Vec<f32> {
        let numbers = self.memory.numbers_in(Slot::Partials);
        (first..first + count).map(|n| numbers.get(n).copied().unwrap_or(0.0)).collect()
    }

    /// Layers of an image.
    pub(in crate::engine) fn read(&self, slot: Slot, layers: Range<u32>) -> Vec<Field> {
        layers.map(|n| self.memory.layer_in(slot, n as usize)).collect()
    }

    /// Fills an image.
    pub(in crate::engine) fn fill(&mut self, slot: Slot, field: &Field) {
        self.memory.write_layer(slot, field);
    }
}
