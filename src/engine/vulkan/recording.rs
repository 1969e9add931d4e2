//! Submission of recorded command buffers, and waits with a time limit.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ash::vk;

use super::device::Device;
use super::instance::vulkan_error;
use super::interop::SemaphoreWait;
use super::pipeline::DescriptorSets;
use super::timestamps::{DeviceTimes, Timestamps};
use crate::base::{Deadline, Error};

#[derive(Clone, Copy)]
pub(super) struct RecordedPart {
    pub(super) commands: vk::CommandBuffer,
    /// Whether the host decides to submit it when the earlier parts are complete.
    pub(super) is_optional: bool,
    /// Whether the timeline counts it when it is complete, with those before it.
    pub(super) ends_batch: bool,
}

/// A timeline semaphore and its value.
pub(super) struct Timeline {
    pub(super) semaphore: vk::Semaphore,
    pub(super) value: u64,
}

impl Timeline {
    fn new(device: &Device) -> Result<Self, Error> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device has the feature of timeline semaphores.
        let semaphore = unsafe { device.handle.create_semaphore(&create, None) };
        Ok(Self { semaphore: device.check("vkCreateSemaphore", semaphore)?, value: 0 })
    }
}

/// The objects of a recording, for another one.
pub(super) struct Reusable {
    pub(super) device: Arc<Device>,
    pub(super) pool: vk::CommandPool,
    pub(super) commands: Vec<vk::CommandBuffer>,
    pub(super) descriptors: DescriptorSets,
    pub(super) timeline: Timeline,
}

/// Decides whether an optional part is submitted.
pub(crate) type PartCondition<'a> = &'a mut dyn FnMut(usize) -> Result<bool, Error>;

/// Command buffers that can be submitted any number of times.
pub(crate) struct Recording {
    device: Arc<Device>,
    pool: vk::CommandPool,
    parts: Vec<RecordedPart>,
    descriptors: DescriptorSets,
    timestamps: Timestamps,
    /// A timeline semaphore that counts the submitted parts of all runs, by batches.
    timeline: vk::Semaphore,
    /// The value of the timeline when all submitted parts are complete.
    end_value: AtomicU64,
    /// Whether a submission has not been waited for.
    is_pending: bool,
    /// Which parts the latest run submitted.
    submitted: Vec<bool>,
    /// The objects that the commands use.
    retained: Vec<Arc<dyn Any + Send + Sync>>,
}

/// How long a run that failed is waited for, so that what it uses can be freed.
const GRACE: Duration = Duration::from_secs(10);

impl Recording {
    /// A recording of executable command buffers. `None` creates a timeline.
    pub(super) fn new(
        device: &Arc<Device>,
        pool: vk::CommandPool,
        parts: Vec<RecordedPart>,
        descriptors: DescriptorSets,
        retained: Vec<Arc<dyn Any + Send + Sync>>,
        timestamps: Timestamps,
        timeline: Option<Timeline>,
    ) -> Result<Self, Error> {
        let mut recording = Self {
            device: device.clone(),
            pool,
            parts,
            descriptors,
            timestamps,
            timeline: vk::Semaphore::null(),
            end_value: AtomicU64::new(0),
            is_pending: false,
            submitted: Vec::new(),
            retained,
        };
        let timeline = match timeline {
            Some(timeline) => timeline,
            None => Timeline::new(device)?,
        };
        recording.timeline = timeline.semaphore;
        *recording.end_value.get_mut() = timeline.value;
        Ok(recording)
    }

    /// Sets which parts end a batch. The host is notified of the others when the next one that does is complete.
    pub(crate) fn join_batches(&mut self, ends: impl ExactSizeIterator<Item = bool>) {
        // In a command buffer of the embedding program all parts are one.
        let is_external = self.pool == vk::CommandPool::null();
        debug_assert!(is_external || self.parts.len() == ends.len(), "{} parts", self.parts.len());
        self.parts.iter_mut().zip(ends).for_each(|(part, ends)| part.ends_batch = ends);
    }

    /// Resets the command pool and returns the objects for another recording. All runs must be complete.
    pub(super) fn into_reusable(mut self) -> Result<Reusable, Error> {
        self.device.check_usable()?;
        // SAFETY: every run was waited for, so that no command buffer of the pool is pending.
        let reset = unsafe { self.device.handle.reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty()) };
        self.device.check("vkResetCommandPool", reset)?;
        Ok(Reusable {
            device: self.device.clone(),
            pool: std::mem::take(&mut self.pool),
            commands: std::mem::take(&mut self.parts).into_iter().map(|part| part.commands).collect(),
            descriptors: std::mem::replace(&mut self.descriptors, DescriptorSets::new(&self.device)),
            timeline: Timeline { semaphore: std::mem::take(&mut self.timeline), value: self.end_value() },
        })
    }

    /// Runs all parts, within the engine's time limit.
    pub(crate) fn run(&mut self) -> Result<(), Error> {
        self.run_within(Deadline::after(self.device.timeout))
    }

    /// Runs all parts, within the time limit of the solve that they belong to.
    pub(crate) fn run_within(&mut self, deadline: Deadline) -> Result<(), Error> {
        self.run_parts(self.parts.len(), deadline, &mut |_| Ok(true), &mut |_| ())
    }

    /// Runs one part, within the time limit of the solve that it belongs to.
    pub(crate) fn run_part(&mut self, part: usize, deadline: Deadline) -> Result<(), Error> {
        self.device.check_usable()?;
        let run = Run { recording: self, last: self.end_value() + 1 };
        run.recording.submit_parts(&run.recording.parts[part..=part], &[])?;
        run.wait(run.last, deadline)?;
        drop(run);
        *self.end_value.get_mut() += 1;
        Ok(())
    }

    /// Runs the first `parts` parts, and waits for them. An optional part is skipped if `is_wanted` is false for its
    /// index. `on_part_end` is called with the number of parts that are complete or skipped, for all parts of a batch
    /// when its last one is complete. Parts between two optional ones are one submission.
    ///
    /// # Errors
    /// The errors of `is_wanted`; [`Error::Timeout`], which poisons the device as every failed wait does; [`Error::Vulkan`].
    pub(crate) fn run_parts(
        &mut self,
        parts: usize,
        deadline: Deadline,
        is_wanted: PartCondition<'_>,
        on_part_end: &mut dyn FnMut(usize),
    ) -> Result<(), Error> {
        self.device.check_usable()?;
        self.submitted.clear();
        while self.submitted.len() < parts {
            let next = self.submitted.len();
            if self.parts[next].is_optional && !is_wanted(next)? {
                self.submitted.push(false);
                on_part_end(next + 1);
                continue;
            }
            let end = (next + 1..parts).find(|&part| self.parts[part].is_optional).unwrap_or(parts);
            let run = Run { recording: self, last: self.end_value() + (end - next) as u64 };
            run.recording.submit_parts(&run.recording.parts[next..end], &[])?;
            for part in next + 1..=end {
                // Only for values that are signaled: validation (1.3.239) waits for others for ever.
                let batch = (part..end).find(|&part| run.recording.parts[part - 1].ends_batch).unwrap_or(end);
                run.wait(run.recording.end_value() + (batch - next) as u64, deadline)?;
                on_part_end(part);
            }
            drop(run);
            *self.end_value.get_mut() += (end - next) as u64;
            self.submitted.resize(end, true);
        }
        Ok(())
    }

    /// Continues the timeline of an earlier recording, which is complete.
    pub(crate) fn with_timeline_of(mut self, mut earlier: Self) -> Self {
        std::mem::swap(&mut self.timeline, &mut earlier.timeline);
        *self.end_value.get_mut() = earlier.end_value();
        self
    }

    /// Releases the objects that the commands use. The recording must be complete, and must not run again.
    pub(crate) fn release(&mut self) {
        self.retained.clear();
    }

    fn end_value(&self) -> u64 {
        self.end_value.load(Ordering::Relaxed)
    }

    /// Returns the timeline semaphore and its value when the latest run is complete.
    pub(crate) fn completion(&self) -> (vk::Semaphore, u64) {
        (self.timeline, self.end_value())
    }

    /// Whether the host decides about a part while a run is in flight.
    pub(crate) fn has_optional_parts(&self) -> bool {
        self.parts.iter().any(|part| part.is_optional)
    }

    /// Submits the first `parts` parts, none of them optional, without waiting. The device begins them after the
    /// semaphore waits. Returns the value of the timeline when they are complete. The previous submission must be
    /// complete.
    pub(crate) fn submit(&mut self, parts: usize, waits: &[SemaphoreWait]) -> Result<u64, Error> {
        self.device.check_usable()?;
        self.submit_parts(&self.parts[..parts], waits)?;
        self.is_pending = true;
        *self.end_value.get_mut() += parts as u64;
        self.submitted.clear();
        self.submitted.resize(parts, true);
        Ok(self.end_value())
    }

    /// Waits for the timeline to reach a value, for `limit` at most. Returns whether it has.
    ///
    /// # Errors
    /// [`Error::Timeout`] past the deadline of the solve, which poisons the device as every failed wait does.
    pub(crate) fn wait(&mut self, value: u64, limit: Duration, deadline: Deadline) -> Result<bool, Error> {
        let left = deadline.left();
        match self.wait_timeline(value, limit.min(left)) {
            Ok(()) => {
                self.is_pending = false;
                Ok(true)
            }
            Err(vk::Result::TIMEOUT) if limit < left => Ok(false),
            Err(result) => Err(self.give_up(self.end_value(), result, deadline)),
        }
    }

    /// Poisons the device after a failed wait, and returns the error. A submission cannot be recalled, but a slow
    /// device soon completes it, and a lost device has: everything can then be freed. What a hung device may use is
    /// never freed.
    fn give_up(&self, last: u64, result: vk::Result, deadline: Deadline) -> Error {
        let ended = self.wait_timeline(last, GRACE);
        if !matches!(ended, Ok(()) | Err(vk::Result::ERROR_DEVICE_LOST)) {
            self.device.abandon();
        }
        self.device.poison();
        let name = &self.device.info().name;
        if result == vk::Result::TIMEOUT {
            return deadline.error(name);
        }
        vulkan_error("waiting for the device", name, result)
    }

    fn submit_parts(&self, parts: &[RecordedPart], waits: &[SemaphoreWait]) -> Result<(), Error> {
        let waits: Vec<_> = waits.iter().map(SemaphoreWait::submit_info).collect();
        let commands: Vec<_> =
            parts.iter().map(|part| vk::CommandBufferSubmitInfo::default().command_buffer(part.commands)).collect();
        let batches: Vec<_> = parts.split_inclusive(|part| part.ends_batch).map(<[RecordedPart]>::len).collect();
        let ends = batches.iter().scan(0, |end, batch| {
            *end += batch;
            Some(*end)
        });
        let signals: Vec<_> = ends
            .map(|end| {
                [vk::SemaphoreSubmitInfo::default()
                    .semaphore(self.timeline)
                    .value(self.end_value() + end as u64)
                    .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)]
            })
            .collect();
        let mut rest = commands.as_slice();
        let mut submits: Vec<_> = batches
            .iter()
            .zip(&signals)
            .map(|(&batch, signal)| {
                let commands = rest.split_off(..batch).unwrap_or_default();
                vk::SubmitInfo2::default().command_buffer_infos(commands).signal_semaphore_infos(signal)
            })
            .collect();
        if let Some(first) = submits.first_mut() {
            *first = first.wait_semaphore_infos(&waits);
        }
        let submitted = self.device.submit(&submits);
        if submitted == Err(vk::Result::ERROR_DEVICE_LOST) {
            // A lost device completes all submissions.
            self.device.poison();
        }
        self.device.check("vkQueueSubmit2", submitted)
    }

    /// Waits for the timeline to reach a value, for `limit` at most.
    fn wait_timeline(&self, value: u64, limit: Duration) -> Result<(), vk::Result> {
        let nanoseconds = u64::try_from(limit.as_nanos()).unwrap_or(u64::MAX);
        let (semaphores, values) = ([self.timeline], [value]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is a timeline semaphore of this device.
        unsafe { self.device.handle.wait_semaphores(&wait, nanoseconds) }
    }

    /// Reads the times of the latest run.
    pub(crate) fn times(&self) -> Result<DeviceTimes, Error> {
        self.timestamps.read(&self.submitted)
    }
}

/// A run in flight. If `on_part_end` panics, the pending parts may still use the device's memory.
struct Run<'a> {
    recording: &'a Recording,
    /// The value of the timeline when the run is complete.
    last: u64,
}

impl Run<'_> {
    fn wait(&self, value: u64, deadline: Deadline) -> Result<(), Error> {
        let reached = self.recording.wait_timeline(value, deadline.left());
        reached.map_err(|result| self.recording.give_up(self.last, result, deadline))
    }
}

impl Drop for Run<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // The device is not at fault: it may take the engine's time limit for what is left of the solve.
            let deadline = Deadline::after(self.recording.device.timeout);
            if self.wait(self.last, deadline).is_ok() {
                self.recording.end_value.store(self.last, Ordering::Relaxed);
            }
        }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        if self.is_pending && !self.device.is_in_use() {
            let deadline = Deadline::after(self.device.timeout);
            // A failed wait poisons the device, which tells later calls of it.
            let _ = self.wait(self.end_value(), Duration::MAX, deadline);
        }
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: every submission is complete; destroying null handles has no effect.
        unsafe {
            self.device.handle.destroy_semaphore(self.timeline, None);
            self.device.handle.destroy_command_pool(self.pool, None);
        }
    }
}
