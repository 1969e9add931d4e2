//! A finished recording: submit, and wait with a limit.

use std::any::Any;
use std::sync::{Arc, PoisonError};
use std::time::Instant;

use ash::vk;

use super::device::Device;
use super::failure::failure;
use super::timestamps::{DeviceTimes, Timestamps};
use crate::Error;

/// Command buffers that can be replayed any number of times.
pub(crate) struct Recording {
    device: Arc<Device>,
    pool: vk::CommandPool,
    parts: Vec<vk::CommandBuffer>,
    descriptor_pools: Vec<vk::DescriptorPool>,
    timestamps: Timestamps,
    /// A timeline that counts the parts done, over all replays.
    timeline: vk::Semaphore,
    done: u64,
    /// Parts of the latest run.
    latest: usize,
    _keep: Vec<Arc<dyn Any + Send + Sync>>,
}

impl Recording {
    pub(super) fn new(
        device: &Arc<Device>,
        pool: vk::CommandPool,
        parts: Vec<vk::CommandBuffer>,
        descriptor_pools: Vec<vk::DescriptorPool>,
        keep: Vec<Arc<dyn Any + Send + Sync>>,
        timestamps: Timestamps,
    ) -> Result<Self, Error> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device has timeline semaphores.
        let timeline = unsafe { device.handle.create_semaphore(&create, None) };
        let mut recording = Self {
            device: device.clone(),
            pool,
            parts,
            descriptor_pools,
            timestamps,
            timeline: vk::Semaphore::null(),
            done: 0,
            latest: 0,
            _keep: keep,
        };
        recording.timeline = device.check("vkCreateSemaphore", timeline)?;
        Ok(recording)
    }

    /// Runs all parts, as [`run_first`](Self::run_first) does.
    pub(crate) fn run(&mut self, after: &mut dyn FnMut(usize)) -> Result<(), Error> {
        self.run_first(self.parts.len(), after)
    }

    /// Runs the first parts, one submission; calls `after` with the number of parts done as each ends.
    ///
    /// # Errors
    /// [`Error::Timeout`] poisons the device: it may still be at work in this memory.
    pub(crate) fn run_first(&mut self, parts: usize, after: &mut dyn FnMut(usize)) -> Result<(), Error> {
        if self.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        // Past what a clock can hold, there is no deadline.
        let deadline = Instant::now().checked_add(self.device.timeout);
        let pending = Pending { recording: self };
        pending.recording.submit(parts)?;
        for part in 1..=parts {
            pending.recording.wait(pending.recording.done + part as u64, deadline)?;
            after(part);
        }
        drop(pending);
        self.done += parts as u64;
        self.latest = parts;
        Ok(())
    }

    fn submit(&self, parts: usize) -> Result<(), Error> {
        let commands: Vec<_> = self.parts[..parts]
            .iter()
            .map(|&part| [vk::CommandBufferSubmitInfo::default().command_buffer(part)])
            .collect();
        let signals: Vec<_> = (1..=parts as u64)
            .map(|part| {
                [vk::SemaphoreSubmitInfo::default()
                    .semaphore(self.timeline)
                    .value(self.done + part)
                    .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)]
            })
            .collect();
        let submits: Vec<_> = commands
            .iter()
            .zip(&signals)
            .map(|(command, signal)| {
                vk::SubmitInfo2::default().command_buffer_infos(command).signal_semaphore_infos(signal)
            })
            .collect();
        let queue = self.device.queue.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the queue is locked; the parts are recorded and not pending, since every run waits to the end; what they
        // use is kept alive.
        let submitted = unsafe { self.device.handle.queue_submit2(*queue, &submits, vk::Fence::null()) };
        if submitted == Err(vk::Result::ERROR_DEVICE_LOST) {
            self.device.poison();
        }
        self.device.check("vkQueueSubmit2", submitted)
    }

    fn wait(&self, value: u64, deadline: Option<Instant>) -> Result<(), Error> {
        let (semaphores, values) = ([self.timeline], [value]);
        let wait = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        let left = deadline.map(|d| d.saturating_duration_since(Instant::now()).as_nanos());
        let nanoseconds = left.and_then(|ns| u64::try_from(ns).ok()).unwrap_or(u64::MAX);
        // SAFETY: the semaphore is a timeline of this device.
        match unsafe { self.device.handle.wait_semaphores(&wait, nanoseconds) } {
            Ok(()) => Ok(()),
            Err(result) => {
                self.device.poison();
                let device = self.device.info().name.clone();
                if result == vk::Result::TIMEOUT {
                    return Err(Error::Timeout { device, seconds: self.device.timeout.as_secs() });
                }
                Err(failure("waiting for the device", &device, result))
            }
        }
    }

    /// The latest run on the device.
    pub(crate) fn times(&self) -> Result<DeviceTimes, Error> {
        self.timestamps.read(self.latest)
    }
}

/// A run under way. Should `after` unwind, the parts still pending may go on using the device's memory.
struct Pending<'a> {
    recording: &'a Recording,
}

impl Drop for Pending<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.recording.device.poison();
        }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        if self.device.is_poisoned() {
            return;
        }
        // SAFETY: every run was waited for, so nothing here is pending; destroying null handles does nothing.
        unsafe {
            self.device.handle.destroy_semaphore(self.timeline, None);
            for &pool in &self.descriptor_pools {
                self.device.handle.destroy_descriptor_pool(pool, None);
            }
            self.device.handle.destroy_command_pool(self.pool, None);
        }
    }
}
