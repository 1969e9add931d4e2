//! One pair on the CPU device.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::run;
use crate::base::{Deadline, Error, Frame, Mask, Progress};
use crate::engine::device::CpuDevice;
use crate::engine::pair_memory::{CancelFlag, PairMemory, Shared};
use crate::engine::progress::{Costs, WorkCounter};
use crate::engine::record::Reading;
use crate::engine::script::{Action, CountedPixels, Entry, Script, compose};
use crate::engine::slot::Slot;
use crate::engine::stages::pass::Memory;
use crate::engine::stages::state::State;
use crate::engine::vulkan::DeviceTimes;
use crate::engine::windows::Bytes;

/// The memory and scripts of one pair.
pub(in crate::engine) struct CpuPair {
    device: Arc<CpuDevice>,
    shared: Arc<Shared>,
    memory: Memory<f32>,
    /// The script of the latest pair.
    script: Script,
    /// The pixels that count with `script`.
    pixels: CountedPixels,
    /// The script of the other kind of pair, once composed.
    other: Option<Script>,
    results: Vec<f32>,
    /// When each dispatch of the latest run began, and when the last ended; empty if solves do not read times. Of
    /// dispatches that run together the first takes all of their time.
    moments: Vec<Instant>,
    cancelled: Arc<AtomicBool>,
}

impl CpuPair {
    /// Memory for one pair of a plan.
    pub(in crate::engine) fn new(device: &Arc<CpuDevice>, shared: &Arc<Shared>) -> Self {
        let plan = &shared.plan;
        Self {
            device: device.clone(),
            memory: Memory::with_filters(&plan.weights.banks),
            shared: shared.clone(),
            script: compose(plan, CountedPixels::All),
            pixels: CountedPixels::All,
            other: None,
            results: Vec::new(),
            moments: Vec::new(),
            cancelled: Arc::default(),
        }
    }
}

impl PairMemory for CpuPair {
    fn upload_mask(&mut self, mask: Option<&Mask>) -> Result<(), Error> {
        self.memory.upload_mask(mask.cloned());
        Ok(())
    }

    fn fill(&mut self, image: usize, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        let plan = &self.shared.plan;
        let mut bytes = vec![0; plan.packed_bytes(image) as usize];
        write(&mut bytes);
        let frame = plan.packed[image].frame(plan.size, &bytes);
        let frame = frame.map_err(|problem| Error::Mismatch(format!("photograph {}: {problem}", image + 1)))?;
        self.memory.upload_photograph(image, frame);
        Ok(())
    }

    fn upload(&mut self, image: usize, photograph: &Frame, levels: [f32; 2]) -> Result<bool, Error> {
        self.memory.upload_photograph(image, photograph.clone());
        Ok(photograph.has_clipped_pixels(levels))
    }

    fn cancel_flag(&mut self) -> Result<Arc<CancelFlag>, Error> {
        self.cancelled = Arc::default();
        Ok(CancelFlag::new(self.cancelled.clone(), None))
    }

    fn prepare(&mut self, state: &State, pixels: CountedPixels) -> Result<(), Error> {
        self.memory.upload_state(state.into());
        if self.pixels != pixels {
            let next = self.other.take().unwrap_or_else(|| compose(&self.shared.plan, pixels));
            self.other = Some(std::mem::replace(&mut self.script, next));
            self.pixels = pixels;
        }
        self.memory.upload_arguments(&self.script.arguments);
        Ok(())
    }

    fn run(
        &mut self,
        parts: fn(&Script) -> usize,
        deadline: Deadline,
        progress: &dyn Fn(Progress),
    ) -> Result<(), Error> {
        let script = &self.script;
        let count = parts(script);
        let mut counter = WorkCounter::new(script, count, Costs::Cpu);
        self.moments.clear();
        for (n, part) in script.parts[..count].iter().enumerate() {
            let mut proceed = |entry: &Entry| {
                if self.shared.reading != Reading::Never && matches!(entry.action, Action::Dispatch(_)) {
                    self.moments.push(Instant::now());
                }
                if self.cancelled.load(Ordering::SeqCst) {
                    return Err(Error::Cancelled);
                }
                deadline.check(&self.device.info.name)
            };
            run(&part.entries, &mut self.memory, &mut proceed)?;
            let state = self.memory.state_in(Slot::State).into();
            if let Some(latest) = counter.part_done(&script.parts[n], n, Some(&state)) {
                progress(latest);
            }
        }
        if !self.moments.is_empty() {
            self.moments.push(Instant::now());
        }
        if count == script.parts.len() {
            self.results.clear();
            self.memory.download(Slot::Stacks, self.shared.plan.map_layers(), &mut self.results);
        }
        Ok(())
    }

    fn state(&self, slot: Slot) -> Result<State, Error> {
        Ok(self.memory.state_in(slot).into())
    }

    fn numbers(&self, slot: Slot, count: usize) -> Result<Vec<f32>, Error> {
        let mut numbers = self.memory.numbers_in(slot).to_vec();
        numbers.resize(count, 0.0);
        Ok(numbers)
    }

    fn maps(&self) -> Result<&[f32], Error> {
        Ok(&self.results)
    }

    fn photograph(&self, image: usize) -> Bytes<'_> {
        Bytes::Slice(self.memory.photograph_of(image).bytes())
    }

    fn times(&self) -> Result<DeviceTimes, Error> {
        let Some((first, ends)) = self.moments.split_first() else { return Ok(DeviceTimes::default()) };
        let mut times = DeviceTimes::default();
        for (dispatch, end) in self.script.dispatches().zip(ends) {
            let end_ms = (*end - *first).as_secs_f64() * 1e3;
            times.add(dispatch.stage.shader.name, end_ms - times.total_ms);
            times.ends_ms.push(end_ms);
            times.total_ms = end_ms;
        }
        Ok(times)
    }

    fn script(&self) -> &Script {
        &self.script
    }
}
