//! A finished recording: submit, and wait with a limit.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ash::vk;

use super::commands::Recorder;
use super::descriptors::Descriptors;
use super::device::Device;
use super::failure::failure;
use super::interop::Wait;
use super::timestamps::{DeviceTimes, Timestamps};
use crate::base::{Deadline, Error};

/// One part of a recording.
#[derive(Clone, Copy)]
pub(super) struct CommandBuffer {
    pub(super) commands: vk::CommandBuffer,
    /// Whether a run asks if it is wanted, once all before it is done.
    pub(super) optional: bool,
}

/// A timeline semaphore, and the value that it has reached.
pub(super) struct Timeline {
    pub(super) semaphore: vk::Semaphore,
    pub(super) value: u64,
}

impl Timeline {
    fn new(device: &Device) -> Result<Self, Error> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device has timeline semaphores.
        let semaphore = unsafe { device.handle.create_semaphore(&create, None) };
        Ok(Self { semaphore: device.check("vkCreateSemaphore", semaphore)?, value: 0 })
    }
}

/// Whether a run wants an optional part.
pub(crate) type DeviceRequirements<'a> = &'a mut dyn FnMut(usize) -> Result<bool, Error>;

/// Command buffers that can be replayed any number of times.
pub(crate) struct Recording {
    device: Arc<Device>,
    pool: vk::CommandPool,
    parts: Vec<CommandBuffer>,
    descriptors: Descriptors,
    timestamps: Timestamps,
    /// A timeline that counts the parts done, over all replays.
    timeline: vk::Semaphore,
    done: AtomicU64,
    /// Whether something was started that has not been waited for.
    is_pending: bool,
    /// Which parts the latest run ran.
    latest: Vec<bool>,
    keep: Vec<Arc<dyn Any + Send + Sync>>,
}

/// How long a run that failed is waited for, so that what it uses can be freed.
const GRACE: Duration = Duration::from_secs(10);

impl Recording {
    /// A recording of finished command buffers; makes a timeline unless one is passed.
    pub(super) fn new(
        device: &Arc<Device>,
        pool: vk::CommandPool,
        parts: Vec<CommandBuffer>,
        descriptors: Descriptors,
        keep: Vec<Arc<dyn Any + Send + Sync>>,
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
            done: AtomicU64::new(0),
            is_pending: false,
            latest: Vec::new(),
            keep,
        };
        let timeline = match timeline {
            Some(timeline) => timeline,
            None => Timeline::new(device)?,
        };
        recording.timeline = timeline.semaphore;
        *recording.done.get_mut() = timeline.value;
        Ok(recording)
    }

    /// Starts another recording with the command pool, the descriptor sets and the timeline of this one, whose runs must
    /// be done.
    ///
    /// # Errors
    /// [`Error::Poisoned`], [`Error::Vulkan`].
    pub(crate) fn record_again(mut self) -> Result<Recorder, Error> {
        if self.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        // SAFETY: every run was waited for, so no command buffer of the pool is pending.
        let reset = unsafe { self.device.handle.reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty()) };
        self.device.check("vkResetCommandPool", reset)?;
        let (pool, parts) = (std::mem::take(&mut self.pool), std::mem::take(&mut self.parts));
        let descriptors = std::mem::replace(&mut self.descriptors, Descriptors::new(&self.device));
        let timeline = Timeline { semaphore: std::mem::take(&mut self.timeline), value: self.done() };
        Recorder::again(&self.device, pool, parts, descriptors, timeline)
    }

    /// Runs all parts, within the engine's time limit.
    ///
    /// # Errors
    /// As [`run_first`](Self::run_first).
    pub(crate) fn run(&mut self) -> Result<(), Error> {
        self.run_within(Deadline::after(self.device.timeout))
    }

    /// Runs all parts, within the time limit of the solve that they belong to.
    ///
    /// # Errors
    /// As [`run_first`](Self::run_first).
    pub(crate) fn run_within(&mut self, deadline: Deadline) -> Result<(), Error> {
        self.run_first(self.parts.len(), deadline, &mut |_| Ok(true), &mut |_| ())
    }

    /// Runs one part by itself, within the time limit of the solve that it belongs to.
    ///
    /// # Errors
    /// As [`run_first`](Self::run_first).
    pub(crate) fn run_part(&mut self, part: usize, deadline: Deadline) -> Result<(), Error> {
        if self.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        let run = Run { recording: self, last: self.done() + 1 };
        run.recording.submit(&run.recording.parts[part..=part], &[])?;
        run.wait(run.last, deadline)?;
        drop(run);
        *self.done.get_mut() += 1;
        Ok(())
    }

    /// Runs the first parts but for the optional ones that are not wanted; calls `after` with the number of parts done as
    /// each ends, left out or not. Parts between two questions are one submission.
    ///
    /// # Errors
    /// Those of `wanted`; [`Error::Timeout`] poisons the device: it is not to be relied on.
    pub(crate) fn run_first(
        &mut self,
        parts: usize,
        deadline: Deadline,
        wanted: DeviceRequirements<'_>,
        after: &mut dyn FnMut(usize),
    ) -> Result<(), Error> {
        if self.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        self.latest.clear();
        while self.latest.len() < parts {
            let next = self.latest.len();
            if self.parts[next].optional && !wanted(next)? {
                self.latest.push(false);
                after(next + 1);
                continue;
            }
            let end = (next + 1..parts).find(|&part| self.parts[part].optional).unwrap_or(parts);
            let run = Run { recording: self, last: self.done() + (end - next) as u64 };
            run.recording.submit(&run.recording.parts[next..end], &[])?;
            for part in next + 1..=end {
                run.wait(run.recording.done() + (part - next) as u64, deadline)?;
                after(part);
            }
            drop(run);
            *self.done.get_mut() += (end - next) as u64;
            self.latest.resize(end, true);
        }
        Ok(())
    }

    /// Goes on with the timeline of an earlier one, which is done.
    pub(crate) fn after(mut self, mut earlier: Self) -> Self {
        std::mem::swap(&mut self.timeline, &mut earlier.timeline);
        *self.done.get_mut() = earlier.done();
        self
    }

    /// Keeps nothing alive any more, and is run no more.
    pub(crate) fn let_go(&mut self) {
        self.keep.clear();
    }

    fn done(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }

    /// The timeline, and what it reaches when the latest run is done.
    pub(crate) fn signal(&self) -> (vk::Semaphore, u64) {
        (self.timeline, self.done())
    }

    /// Whether runs ask in between which parts they want.
    pub(crate) fn is_asked(&self) -> bool {
        self.parts.iter().any(|part| part.optional)
    }

    /// Submits the first parts, of which a run asks for none, and does not wait; what it submitted before must be done. Gives what the
    /// timeline reaches when they are. They begin when what is waited for has happened.
    pub(crate) fn start(&mut self, parts: usize, waits: &[Wait]) -> Result<u64, Error> {
        if self.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        self.submit(&self.parts[..parts], waits)?;
        self.is_pending = true;
        *self.done.get_mut() += parts as u64;
        self.latest.clear();
        self.latest.resize(parts, true);
        Ok(self.done())
    }

    /// Waits for the timeline to reach a value, for `limit` at most. Returns whether it has.
    ///
    /// # Errors
    /// [`Error::Timeout`] past the deadline of the solve, which poisons the device as every failed wait does.
    pub(crate) fn reached(&mut self, value: u64, limit: Duration, deadline: Deadline) -> Result<bool, Error> {
        let left = deadline.left();
        match self.reach(value, limit.min(left)) {
            Ok(()) => {
                self.is_pending = false;
                Ok(true)
            }
            Err(vk::Result::TIMEOUT) if limit < left => Ok(false),
            Err(result) => Err(self.give_up(self.done(), result, deadline)),
        }
    }

    /// Poisons the device after a failed wait, and returns the error. What was submitted cannot be recalled, but a slow
    /// device soon ends it and a lost one has: all can then be freed. What a hung device may use is never freed.
    fn give_up(&self, last: u64, result: vk::Result, deadline: Deadline) -> Error {
        let ended = self.reach(last, GRACE);
        self.device.poison(matches!(ended, Ok(()) | Err(vk::Result::ERROR_DEVICE_LOST)));
        let name = &self.device.info().name;
        if result == vk::Result::TIMEOUT {
            return deadline.error(name);
        }
        failure("waiting for the device", name, result)
    }

    fn submit(&self, parts: &[CommandBuffer], waits: &[Wait]) -> Result<(), Error> {
        let waits: Vec<_> = waits.iter().map(Wait::info).collect();
        let commands: Vec<_> =
            parts.iter().map(|part| [vk::CommandBufferSubmitInfo::default().command_buffer(part.commands)]).collect();
        let signals: Vec<_> = (1..=parts.len() as u64)
            .map(|part| {
                [vk::SemaphoreSubmitInfo::default()
                    .semaphore(self.timeline)
                    .value(self.done() + part)
                    .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)]
            })
            .collect();
        let mut submits: Vec<_> = commands
            .iter()
            .zip(&signals)
            .map(|(command, signal)| {
                vk::SubmitInfo2::default().command_buffer_infos(command).signal_semaphore_infos(signal)
            })
            .collect();
        if let Some(first) = submits.first_mut() {
            *first = first.wait_semaphore_infos(&waits);
        }
        let submitted = self.device.submit(&submits);
        if submitted == Err(vk::Result::ERROR_DEVICE_LOST) {
            // A device that is lost is at work on nothing.
            self.device.poison(true);
        }
        self.device.check("vkQueueSubmit2", submitted)
    }

    /// Waits for the timeline to reach a value, for `limit` at most.
    fn reach(&self, value: u64, limit: Duration) -> Result<(), vk::Result> {
        let nanoseconds = u64::try_from(limit.as_nanos()).unwrap_or(u64::MAX);
        let (semaphores, values) = ([self.timeline], [value]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is a timeline of this device.
        unsafe { self.device.handle.wait_semaphores(&wait, nanoseconds) }
    }

    /// The latest run on the device.
    pub(crate) fn times(&self) -> Result<DeviceTimes, Error> {
        self.timestamps.read(&self.latest)
    }
}

/// A run in flight. If `after` unwinds, the pending parts may still use the device's memory.
struct Run<'a> {
    recording: &'a Recording,
    /// The value of the timeline at the end.
    last: u64,
}

impl Run<'_> {
    fn wait(&self, value: u64, deadline: Deadline) -> Result<(), Error> {
        let reached = self.recording.reach(value, deadline.left());
        reached.map_err(|result| self.recording.give_up(self.last, result, deadline))
    }
}

impl Drop for Run<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // The device is not at fault: it may take the engine's time limit for what is left of the solve.
            let deadline = Deadline::after(self.recording.device.timeout);
            if self.wait(self.last, deadline).is_ok() {
                self.recording.done.store(self.last, Ordering::Relaxed);
            }
        }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        if self.is_pending && !self.device.is_in_use() {
            let deadline = Deadline::after(self.device.timeout);
            // A failed wait poisons the device, which tells later calls of it.
            let _ = self.reached(self.done(), Duration::MAX, deadline);
        }
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: every run was waited for, so nothing here is pending; destroying null handles does nothing.
        unsafe {
            self.device.handle.destroy_semaphore(self.timeline, None);
            self.device.handle.destroy_command_pool(self.pool, None);
        }
    }
}
