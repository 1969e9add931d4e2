//! Instance, device, queue, semaphores and command buffers of the embedding program.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use ash::vk;

use super::device_requirements::DeviceRequirements;
use super::instance::OptionalExtensions;

/// A device that belongs to the embedding program, for [`Engine::from_vulkan`](crate::Engine::from_vulkan).
#[derive(Clone)]
pub struct ExternalDevice {
    pub(super) instance: ash::Instance,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) device: ash::Device,
    pub(super) queue_family: u32,
    /// Shared by all engines that are made from clones of this device.
    pub(super) queue: Arc<Mutex<vk::Queue>>,
    pub(super) optional: OptionalExtensions,
    pub(super) queue_lock: Option<Arc<dyn QueueLock>>,
}

impl ExternalDevice {
    /// Wraps a device and one of its queues, whose family supports compute. No optional extension is used.
    ///
    /// # Safety
    /// - `physical` belongs to `instance`, `device` was created from `physical`, and `queue` is of the family
    ///   `queue_family` of `device`.
    /// - Instance and device were created for [`REQUIRED_VERSION`](super::REQUIRED_VERSION) or later, the device with
    ///   the features of [`enable_required_features`](super::enable_required_features) or [`DeviceRequirements`].
    /// - None of them is destroyed before the last engine, solver and solution made from this device is dropped; after
    ///   a solve has timed out, not before the device is idle.
    /// - No other code uses `queue` meanwhile, unless all code locks it ([`with_queue_lock`](Self::with_queue_lock)).
    ///   `vkDeviceWaitIdle` uses all queues. A queue created with internal synchronization needs no lock, nor does a
    ///   queue that only the engine uses.
    pub unsafe fn new(
        instance: ash::Instance,
        physical: vk::PhysicalDevice,
        device: ash::Device,
        queue_family: u32,
        queue: vk::Queue,
    ) -> Self {
        let queue = Arc::new(Mutex::new(queue));
        let optional = OptionalExtensions::default();
        Self { instance, physical, device, queue_family, queue, optional, queue_lock: None }
    }

    /// Wraps raw handles, from another language or another version of ash. `entry` is the `vkGetInstanceProcAddr` from
    /// which `instance` was created.
    ///
    /// # Safety
    /// As for [`ExternalDevice::new`].
    pub unsafe fn from_handles(
        entry: vk::PFN_vkGetInstanceProcAddr,
        instance: vk::Instance,
        physical: vk::PhysicalDevice,
        device: vk::Device,
        queue_family: u32,
        queue: vk::Queue,
    ) -> Self {
        // SAFETY: the caller guarantees valid handles, and that `entry` belongs to their loader.
        unsafe {
            let instance = ash::Instance::load(&ash::StaticFn { get_instance_proc_addr: entry }, instance);
            let device = ash::Device::load(instance.fp_v1_0(), device);
            Self::new(instance, physical, device, queue_family, queue)
        }
    }

    /// Sets the lock of a queue that the program uses as well. A thread that holds the lock must not start a solve: the
    /// engine would wait for the lock forever.
    ///
    /// # Safety
    /// No other code uses the queue between [`QueueLock::lock`] and [`QueueLock::unlock`].
    pub unsafe fn with_queue_lock(self, lock: Arc<dyn QueueLock>) -> Self {
        Self { queue_lock: Some(lock), ..self }
    }

    /// Enables the use of all optional extensions of `requirements`.
    ///
    /// # Safety
    /// The device was created from the same physical device with [`DeviceRequirements::extensions`] and
    /// [`DeviceRequirements::enable_features`].
    pub unsafe fn with_requirements(self, requirements: &DeviceRequirements) -> Self {
        Self { optional: requirements.optional(), ..self }
    }

    /// Enables the use of conditional rendering.
    ///
    /// # Safety
    /// The device was created with `VK_EXT_conditional_rendering` and its feature `conditionalRendering`.
    pub unsafe fn with_conditional_rendering(self) -> Self {
        Self { optional: OptionalExtensions { conditional_rendering: true, ..self.optional }, ..self }
    }

    /// Enables the import of dma-bufs.
    ///
    /// # Safety
    /// The device was created with the last three of [`OPTIONAL_EXTENSIONS`](super::OPTIONAL_EXTENSIONS).
    pub unsafe fn with_dma_bufs(self) -> Self {
        Self { optional: OptionalExtensions { dma_buf: true, ..self.optional }, ..self }
    }

    /// Enables the import of host memory.
    ///
    /// # Safety
    /// The device was created with `VK_EXT_external_memory_host`.
    pub unsafe fn with_host_memory(self) -> Self {
        Self { optional: OptionalExtensions { host_memory: true, ..self.optional }, ..self }
    }
}

impl fmt::Debug for ExternalDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { physical, queue_family, optional, .. } = self;
        write!(f, "ExternalDevice {{ {physical:?}, family {queue_family}, {optional:?} }}")
    }
}

/// The lock of a queue that the embedding program uses as well. [`SharedQueue`] is one for programs without their own.
///
/// The engine calls [`lock`](Self::lock) before each submission, and [`unlock`](Self::unlock) after it from the same
/// thread.
pub trait QueueLock: Send + Sync {
    /// Blocks until no other thread uses the queue, and locks it.
    fn lock(&self);
    /// Unlocks the queue.
    fn unlock(&self);
}

/// Unlocks a queue when it is dropped.
pub struct QueueGuard<'a>(Option<&'a dyn QueueLock>);

impl<'a> QueueGuard<'a> {
    /// Locks a queue. `None` locks nothing.
    pub(super) fn new(lock: Option<&'a dyn QueueLock>) -> Self {
        if let Some(lock) = lock {
            lock.lock();
        }
        Self(lock)
    }
}

impl Drop for QueueGuard<'_> {
    fn drop(&mut self) {
        if let Some(lock) = self.0 {
            lock.unlock();
        }
    }
}

/// A mutex of a queue, for a program that has none. The program [acquires](Self::acquire) it for each use of the queue.
#[derive(Default)]
pub struct SharedQueue {
    // Not a `Mutex<vk::Queue>`: its guard cannot be released by a separate call of `unlock`.
    is_locked: Mutex<bool>,
    unlocked: Condvar,
}

impl SharedQueue {
    /// Blocks until no other thread uses the queue, and locks it until the guard is dropped.
    #[must_use = "the queue is unlocked when the guard is dropped"]
    pub fn acquire(&self) -> QueueGuard<'_> {
        QueueGuard::new(Some(self))
    }
}

impl QueueLock for SharedQueue {
    fn lock(&self) {
        let is_locked = self.is_locked.lock().unwrap_or_else(PoisonError::into_inner);
        let unlocked = self.unlocked.wait_while(is_locked, |is_locked| *is_locked);
        *unlocked.unwrap_or_else(PoisonError::into_inner) = true;
    }

    fn unlock(&self) {
        *self.is_locked.lock().unwrap_or_else(PoisonError::into_inner) = false;
        self.unlocked.notify_one();
    }
}

/// A semaphore wait operation of the device before it reads a photograph.
#[derive(Clone, Copy, Debug)]
pub struct SemaphoreWait {
    pub(super) semaphore: vk::Semaphore,
    pub(super) value: u64,
}

impl SemaphoreWait {
    /// Waits for a timeline semaphore to reach `value`, or for a binary semaphore, which ignores `value`.
    ///
    /// # Safety
    /// The semaphore belongs to the engine's device and lives until the pair is solved. The signal operation of a
    /// binary semaphore has been submitted.
    pub unsafe fn new(semaphore: vk::Semaphore, value: u64) -> Self {
        Self { semaphore, value }
    }

    pub(super) fn submit_info(&self) -> vk::SemaphoreSubmitInfo<'static> {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(self.semaphore)
            .value(self.value)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
    }
}

/// A command buffer of the embedding program into which a solve is [recorded](crate::PairSolver::encode).
#[derive(Clone, Copy, Debug)]
pub struct ExternalCommandBuffer(pub(super) vk::CommandBuffer);

impl ExternalCommandBuffer {
    /// Wraps a primary command buffer in the recording state, outside of a render pass and of conditional rendering.
    ///
    /// Recording changes the bound compute pipeline, descriptor sets and push constants. The solve is one submission:
    /// it must be shorter than the time limit of the driver's watchdog.
    ///
    /// # Safety
    /// - The command buffer belongs to the engine's device and queue family, and no other thread uses it meanwhile.
    /// - It is executed only while no other solve of the solver is pending, since all pairs of a solver share memory.
    /// - No execution is pending while a solution of its [`Encoded`](crate::interop::Encoded) is borrowed or when that is
    ///   dropped. Afterwards it is not executed again.
    /// - If recording fails, the command buffer is reset.
    pub unsafe fn new(commands: vk::CommandBuffer) -> Self {
        Self(commands)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn one_thread_at_a_time_holds_a_shared_queue() {
        let (queue, holders) = (SharedQueue::default(), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..500 {
                        let _guard = queue.acquire();
                        assert_eq!(holders.fetch_add(1, Ordering::SeqCst), 0);
                        holders.fetch_sub(1, Ordering::SeqCst);
                    }
                });
            }
        });
    }
}
