//! Instance, device, queue, semaphores and command buffers of the embedding program, and what its device must have.

use std::ffi::CStr;
use std::fmt;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use ash::vk::{self, StructureType};

use super::instance::{Instance, OptionalExtensions};
use crate::base::Error;

/// The lowest Vulkan version that the instance and the device must be created for.
pub const REQUIRED_VERSION: u32 = vk::API_VERSION_1_3;

/// Enables the features that an engine requires: timeline semaphores, synchronization2 and maintenance4. Other features
/// keep their values. [`DeviceRequirements`] does the same in any `pNext` chain, with the optional extensions.
pub fn enable_required_features(
    v12: &mut vk::PhysicalDeviceVulkan12Features<'_>,
    v13: &mut vk::PhysicalDeviceVulkan13Features<'_>,
) {
    v12.timeline_semaphore = vk::TRUE;
    v13.synchronization2 = vk::TRUE;
    v13.maintenance4 = vk::TRUE;
}

/// The required features and the available [`OPTIONAL_EXTENSIONS`](super::OPTIONAL_EXTENSIONS) of a physical device,
/// for the creation of a device.
///
/// A `pNext` chain may hold the structure of a feature once, and not beside that of the Vulkan version that promoted
/// it. This type extends a chain that other code has begun. A program that writes the whole chain itself can use
/// [`enable_required_features`].
pub struct DeviceRequirements {
    timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures<'static>,
    synchronization2: vk::PhysicalDeviceSynchronization2Features<'static>,
    maintenance4: vk::PhysicalDeviceMaintenance4Features<'static>,
    conditional_rendering: Option<vk::PhysicalDeviceConditionalRenderingFeaturesEXT<'static>>,
    optional: OptionalExtensions,
}

impl DeviceRequirements {
    /// Returns the requirements for a physical device.
    ///
    /// # Errors
    /// [`Error::Vulkan`] if the extensions of the device cannot be enumerated.
    ///
    /// # Safety
    /// `physical` belongs to `instance`, which was created for [`REQUIRED_VERSION`] or later.
    pub unsafe fn for_device(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Result<Self, Error> {
        Instance::external(instance.clone()).optional_extensions(physical).map(Self::new)
    }

    fn new(optional: OptionalExtensions) -> Self {
        let conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true);
        Self {
            timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures::default().timeline_semaphore(true),
            synchronization2: vk::PhysicalDeviceSynchronization2Features::default().synchronization2(true),
            maintenance4: vk::PhysicalDeviceMaintenance4Features::default().maintenance4(true),
            conditional_rendering: optional.conditional_rendering.then_some(conditional),
            optional,
        }
    }

    /// Returns the names of the extensions to enable.
    pub fn extensions(&self) -> Vec<&'static CStr> {
        self.optional.names().collect()
    }

    pub(super) fn optional(&self) -> OptionalExtensions {
        self.optional
    }

    /// Enables the features in the structures that are chained to `create`, and chains the missing structures. Call it
    /// last: a structure chained later may be a duplicate.
    ///
    /// # Safety
    /// The chain is valid and its structures may be written, as those chained by `push_next` may.
    pub unsafe fn enable_features<'a>(&'a mut self, mut create: vk::DeviceCreateInfo<'a>) -> vk::DeviceCreateInfo<'a> {
        // An earlier call may have chained them.
        self.timeline_semaphore.p_next = std::ptr::null_mut();
        self.synchronization2.p_next = std::ptr::null_mut();
        self.maintenance4.p_next = std::ptr::null_mut();
        self.conditional_rendering.iter_mut().for_each(|conditional| conditional.p_next = std::ptr::null_mut());
        let mut is_enabled = [false; 4];
        let mut next = create.p_next.cast_mut().cast::<vk::BaseOutStructure<'_>>();
        while !next.is_null() {
            // SAFETY: the caller guarantees that the chain is valid and may be written.
            let (enabled, following) = unsafe { (enable_features_in(next), (*next).p_next) };
            (0..4).for_each(|n| is_enabled[n] |= enabled[n]);
            next = following;
        }
        let [timeline_semaphore, synchronization2, maintenance4, conditional_rendering] = is_enabled;
        if !timeline_semaphore {
            create = create.push_next(&mut self.timeline_semaphore);
        }
        if !synchronization2 {
            create = create.push_next(&mut self.synchronization2);
        }
        if !maintenance4 {
            create = create.push_next(&mut self.maintenance4);
        }
        if let Some(features) = self.conditional_rendering.as_mut().filter(|_| !conditional_rendering) {
            create = create.push_next(features);
        }
        create
    }
}

/// Enables the features of a structure, and returns which of timeline semaphores, synchronization2, maintenance4 and
/// conditional rendering it holds. The last is in no valid chain of a device without the extension.
///
/// # Safety
/// The structure belongs to a valid chain and may be written.
unsafe fn enable_features_in(structure: *mut vk::BaseOutStructure<'_>) -> [bool; 4] {
    // SAFETY: a structure in a valid chain has the type that its `s_type` states.
    unsafe {
        match (*structure).s_type {
            StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceVulkan12Features<'_>>()).timeline_semaphore = vk::TRUE;
                [true, false, false, false]
            }
            StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceTimelineSemaphoreFeatures<'_>>()).timeline_semaphore = vk::TRUE;
                [true, false, false, false]
            }
            StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES => {
                let features = structure.cast::<vk::PhysicalDeviceVulkan13Features<'_>>();
                ((*features).synchronization2, (*features).maintenance4) = (vk::TRUE, vk::TRUE);
                [false, true, true, false]
            }
            StructureType::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceSynchronization2Features<'_>>()).synchronization2 = vk::TRUE;
                [false, true, false, false]
            }
            StructureType::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceMaintenance4Features<'_>>()).maintenance4 = vk::TRUE;
                [false, false, true, false]
            }
            StructureType::PHYSICAL_DEVICE_CONDITIONAL_RENDERING_FEATURES_EXT => {
                let features = structure.cast::<vk::PhysicalDeviceConditionalRenderingFeaturesEXT<'_>>();
                (*features).conditional_rendering = vk::TRUE;
                [false, false, false, true]
            }
            _ => [false; 4],
        }
    }
}

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
    /// - No execution is pending while a solution of its [`Encoded`](crate::interop::Encoded) is borrowed or when that
    ///   is dropped. Afterwards it is not executed again.
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

    fn requirements() -> DeviceRequirements {
        DeviceRequirements::new(OptionalExtensions { conditional_rendering: true, ..OptionalExtensions::default() })
    }

    /// Returns the types of the chained structures, sorted.
    fn chained_types(create: &vk::DeviceCreateInfo<'_>) -> Vec<StructureType> {
        let mut types = Vec::new();
        let mut next = create.p_next.cast::<vk::BaseInStructure<'_>>();
        while !next.is_null() {
            // SAFETY: the structures that the tests chain outlive this call.
            unsafe {
                types.push((*next).s_type);
                next = (*next).p_next;
            }
        }
        types.sort_unstable();
        types
    }

    #[test]
    fn each_feature_is_enabled_in_exactly_one_structure() {
        let mut empty = requirements();
        // SAFETY: the chain is empty.
        let create = unsafe { empty.enable_features(vk::DeviceCreateInfo::default()) };
        let each = [
            StructureType::PHYSICAL_DEVICE_CONDITIONAL_RENDERING_FEATURES_EXT,
            StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES,
            StructureType::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES,
            StructureType::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES,
        ];
        assert_eq!(chained_types(&create), each);

        let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
        let create = vk::DeviceCreateInfo::default().push_next(&mut v12).push_next(&mut v13);
        let mut chained = requirements();
        // SAFETY: both chained structures are local and alive.
        let types = chained_types(&unsafe { chained.enable_features(create) });
        let versions =
            [StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES];
        assert_eq!(types, [&versions[..], &each[..1]].concat());
        assert_eq!([v12.timeline_semaphore, v13.synchronization2, v13.maintenance4], [vk::TRUE; 3]);

        let mut maintenance4 = vk::PhysicalDeviceMaintenance4Features::default();
        let create = vk::DeviceCreateInfo::default().push_next(&mut maintenance4);
        let mut chained = requirements();
        // SAFETY: the chained structure is local and alive.
        assert_eq!(chained_types(&unsafe { chained.enable_features(create) }), each);
        assert_eq!(maintenance4.maintenance4, vk::TRUE);
    }
}
