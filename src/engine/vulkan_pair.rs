//! One pair on a Vulkan device: its memory and recordings.

use std::sync::Arc;
use std::time::Duration;

use super::arguments;
use super::pair_memory::{CancelFlag, PairMemory, Shared};
use super::plan::Plan;
use super::progress::{Costs, WorkCounter};
use super::record::{Workspace, record, record_with};
use super::script::{CountedPixels, Script, compose};
use super::slot::Slot;
use super::stages::Pipelines;
use super::stages::state::State;
use super::vulkan::{
    Buffer, Clock, Device, DeviceSolution, DeviceTimes, ExternalCommandBuffer, Recorder, Recording, SemaphoreWait,
    SolutionBuffer, SourceCopy,
};
use super::windows::Bytes;
use crate::base::{Deadline, Error, Mask, Progress};

/// The device of a pair, and what its frames in flight share.
struct On {
    shared: Arc<Shared>,
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
}

struct RecordedScript {
    script: Script,
    recording: Recording,
}

impl RecordedScript {
    fn new(on: &On, workspace: &Workspace, pixels: CountedPixels) -> Result<Self, Error> {
        let script = compose(&on.shared.plan, pixels);
        let recording = record(&on.device, &on.pipelines, workspace, &script, on.shared.reading)?;
        // All but the last word, which may cancel the pair meanwhile.
        let words = &script.arguments[..script.arguments.len() - 1];
        workspace.buffer(Slot::StartArguments).write(bytemuck::cast_slice(words))?;
        Ok(Self { script, recording })
    }
}

/// The memory and recordings of one pair.
pub(super) struct VulkanPair {
    on: On,
    workspace: Workspace,
    /// The script of the latest pair.
    current: RecordedScript,
    /// The pixels that count with `current`.
    pixels: CountedPixels,
    /// The script of the other kind of pair, once recorded.
    other: Option<RecordedScript>,
    /// The recording that fetches photographs of the latest pair.
    fetching: Option<Recording>,
    /// Whether the device fetches a photograph of the latest pair.
    is_fetched: bool,
    /// What was recorded for the latest pair into a command buffer of the embedding program.
    encoded: Option<Recording>,
    /// The completion word, by which the device signals that it has executed `encoded`.
    completion: Arc<Buffer>,
    /// The value that the timeline of the current recording reaches when the submitted pair is solved.
    in_flight: Option<u64>,
}

impl VulkanPair {
    /// Records the script for pairs with masked or clipped pixels, the one for pairs without, or by `None` both.
    pub(super) fn new(
        shared: &Arc<Shared>,
        (device, pipelines): (&Arc<Device>, &Arc<Pipelines>),
        workspace: Workspace,
        pixels: Option<CountedPixels>,
    ) -> Result<Self, Error> {
        let on = On { shared: shared.clone(), device: device.clone(), pipelines: pipelines.clone() };
        workspace.buffer(Slot::Mask).write(&mask_bytes(&shared.plan, None))?;
        let recorded = |pixels| RecordedScript::new(&on, &workspace, pixels);
        let other = if pixels.is_none() { Some(recorded(CountedPixels::Unmasked)?) } else { None };
        let pixels = pixels.unwrap_or(CountedPixels::All);
        Ok(Self {
            current: recorded(pixels)?,
            pixels,
            other,
            fetching: None,
            is_fetched: false,
            encoded: None,
            completion: Buffer::for_readback(device, "completion", 4)?,
            in_flight: None,
            workspace,
            on,
        })
    }

    /// Begins a pair. No pair is in flight.
    pub(super) fn begin(&mut self) -> Result<(), Error> {
        self.is_fetched = false;
        self.on.device.check_usable()
    }

    /// Whether a pair was submitted and may not have ended.
    pub(super) fn is_in_flight(&self) -> bool {
        self.in_flight.is_some()
    }

    /// Waits for the photographs of a pair whose submission failed: it may have submitted its fetches.
    pub(super) fn abandon(&mut self, deadline: Deadline) {
        if !self.on.device.is_poisoned() {
            let _ = self.wait_fetched(Duration::MAX, deadline);
        }
    }

    /// Whether the pair was encoded into a command buffer of the embedding program.
    pub(super) fn is_encoded(&self) -> bool {
        self.encoded.is_some()
    }

    /// The buffer that the device reads a photograph from.
    fn input(&self, image: usize) -> &Arc<Buffer> {
        self.workspace.buffer(self.on.shared.plan.entry(image))
    }

    /// Submits copies of photographs, which begin after `waits`. Called before [`submit`](Self::submit).
    pub(super) fn fetch(&mut self, fetches: &[(usize, SourceCopy)], waits: &[SemaphoreWait]) -> Result<(), Error> {
        let mut recorder = Recorder::new(&self.on.device, Clock::Never)?;
        for (image, fetch) in fetches {
            recorder.copy_source(fetch, self.input(*image));
        }
        let (recording, earlier) = (recorder.finish()?, self.fetching.take());
        // Waits of another queue for the timeline may still be pending: it lives as long as this.
        let recording = if let Some(earlier) = earlier { recording.with_timeline_of(earlier) } else { recording };
        self.fetching.insert(recording).submit(1, waits)?;
        self.is_fetched = true;
        Ok(())
    }

    /// Submits the pair and returns. On devices without conditional rendering it blocks until the solve is done.
    pub(super) fn submit(&mut self, waits: &[SemaphoreWait], deadline: Deadline) -> Result<(), Error> {
        let parts = self.current.script.parts.len();
        if self.current.recording.has_optional_parts() {
            // The waits belong to a submission of their own.
            if !waits.is_empty() {
                self.fetch(&[], waits)?;
            }
            return self.run(|script| script.parts.len(), deadline, &|_| ());
        }
        self.in_flight = Some(self.current.recording.submit(parts, waits)?);
        Ok(())
    }

    /// Records the pair and its fetches into a command buffer of the embedding program.
    pub(super) fn encode(
        &mut self,
        commands: ExternalCommandBuffer,
        fetches: &[(usize, SourceCopy)],
    ) -> Result<(), Error> {
        self.completion.store_word(0, Recorder::PENDING)?;
        let mut recorder = Recorder::into_external(&self.on.device, commands, &self.completion);
        for (image, fetch) in fetches {
            recorder.copy_source(fetch, self.input(*image));
        }
        recorder.barrier();
        self.encoded = Some(record_with(recorder, &self.on.pipelines, &self.workspace, &self.current.script)?);
        Ok(())
    }

    /// Returns whether the device has executed what was encoded to its end.
    pub(super) fn is_executed(&self) -> Result<bool, Error> {
        Ok(self.completion.load_word(0)? == Recorder::COMPLETE)
    }

    /// The results of the latest pair on the device, and the semaphores that signal when they are complete.
    pub(super) fn on_device(&self) -> DeviceSolution {
        let fetching = self.fetching.as_ref().filter(|_| self.is_fetched);
        DeviceSolution::new(self.workspace.buffer(Slot::EndMaps), &self.current.recording, fetching)
    }

    /// The buffer on the device that holds the results.
    pub(super) fn result_buffer(&self) -> SolutionBuffer {
        SolutionBuffer::new(self.workspace.buffer(Slot::EndMaps))
    }

    /// Waits until the device has fetched the photographs of the latest pair, for `limit` at most. Returns whether it
    /// has.
    pub(super) fn wait_fetched(&mut self, limit: Duration, deadline: Deadline) -> Result<bool, Error> {
        let Some(fetching) = &mut self.fetching else { return Ok(true) };
        let is_fetched = fetching.wait(fetching.completion().1, limit, deadline)?;
        if is_fetched {
            fetching.release();
        }
        Ok(is_fetched)
    }

    /// Waits until the pair is solved, for `limit` at most. Returns whether it is.
    pub(super) fn wait(&mut self, limit: Duration, deadline: Deadline) -> Result<bool, Error> {
        let Some(value) = self.in_flight else { return Ok(true) };
        self.on.device.check_usable()?;
        if !self.current.recording.wait(value, limit, deadline)? {
            return Ok(false);
        }
        self.in_flight = None;
        self.wait_fetched(Duration::MAX, deadline)
    }
}

impl PairMemory for VulkanPair {
    fn upload_mask(&mut self, mask: Option<&Mask>) -> Result<(), Error> {
        self.workspace.buffer(Slot::Mask).write(&mask_bytes(&self.on.shared.plan, mask))
    }

    fn fill(&mut self, image: usize, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        self.input(image).write_with(write)
    }

    fn cancel_flag(&mut self) -> Result<Arc<CancelFlag>, Error> {
        let words = self.workspace.buffer(Slot::StartArguments);
        let offset = arguments::bytes(self.on.shared.plan.solved) - 4;
        words.store_word(offset, arguments::NOT_CANCELLED)?;
        Ok(CancelFlag::new(Arc::default(), Some((words.clone(), offset))))
    }

    fn prepare(&mut self, state: &State, pixels: CountedPixels) -> Result<(), Error> {
        self.workspace.buffer(Slot::StartState).write(bytemuck::bytes_of(state))?;
        if self.pixels != pixels {
            let recorded = || RecordedScript::new(&self.on, &self.workspace, pixels);
            let next = self.other.take().map_or_else(recorded, Ok)?;
            self.other = Some(std::mem::replace(&mut self.current, next));
            self.pixels = pixels;
        }
        self.encoded = None;
        Ok(())
    }

    fn run(
        &mut self,
        parts: fn(&Script) -> usize,
        deadline: Deadline,
        progress: &dyn Fn(Progress),
    ) -> Result<(), Error> {
        let state_word = self.workspace.buffer(Slot::Progress).clone();
        let RecordedScript { script, recording } = &mut self.current;
        let parts = parts(script);
        let latest_state = || -> Result<State, Error> { Ok(state_word.read(0, 1)?[0]) };
        let mut wanted = |part: usize| {
            let state = latest_state()?;
            Ok(script.parts[part].continues.is_none_or(|level| state.levels[level].settled == 0))
        };
        let mut counter = WorkCounter::new(script, parts, Costs::Vulkan);
        recording.run_parts(parts, deadline, &mut wanted, &mut |over| {
            let part = over - 1;
            if let Some(latest) = counter.part_done(&script.parts[part], part, latest_state().ok().as_ref()) {
                progress(latest);
            }
        })
    }

    fn state(&self, slot: Slot) -> Result<State, Error> {
        Ok(self.workspace.buffer(slot).read::<State>(0, 1)?[0])
    }

    fn numbers(&self, slot: Slot, count: usize) -> Result<Vec<f32>, Error> {
        self.workspace.buffer(slot).read(0, count)
    }

    fn maps(&self) -> Result<&[f32], Error> {
        self.workspace.buffer(Slot::EndMaps).mapped_floats()
    }

    fn photograph(&self, image: usize) -> Bytes<'_> {
        Bytes::Mapped(self.input(image))
    }

    fn times(&self) -> Result<DeviceTimes, Error> {
        self.current.recording.times()
    }

    fn script(&self) -> &Script {
        &self.current.script
    }
}

/// A byte for each pixel of I1, 0 where the mask excludes it.
fn mask_bytes(plan: &Plan, mask: Option<&Mask>) -> Vec<u8> {
    let mut bytes = mask.map_or_else(Vec::new, |mask| mask.bytes().to_vec());
    bytes.resize(plan.mask_bytes() as usize, 1);
    bytes
}
