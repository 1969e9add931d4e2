//! Instance, device, queue, semaphores and command buffers of the embedding program.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use ash::vk;

use super::device_requirements::DeviceRequirements;
use super::optional_extensions::OptionalExtensions;

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
    use crate::base::{Error, Frame, Settings};
    use crate::engine::vulkan::{DeviceSolution, Instance, OPTIONAL_EXTENSIONS, enable_required_features};
    use crate::engine::{Engine, EngineOptions, testing};
    use crate::solve::{PairSolver, SolveOptions};

    /// A lock that counts its calls and checks that they alternate.
    #[derive(Default)]
    struct CountingLock {
        locked: AtomicUsize,
        unlocked: AtomicUsize,
    }

    impl QueueLock for CountingLock {
        fn lock(&self) {
            assert_eq!(self.locked.fetch_add(1, Ordering::SeqCst), self.unlocked.load(Ordering::SeqCst));
        }

        fn unlock(&self) {
            self.unlocked.fetch_add(1, Ordering::SeqCst);
        }
    }

    /// An embedding program with its own device.
    struct Program {
        instance: Arc<Instance>,
        physical: vk::PhysicalDevice,
        device: ash::Device,
        family: u32,
        queue: vk::Queue,
        is_conditional: bool,
    }

    impl Program {
        /// Opens the device of the other tests, with conditional rendering if asked and available.
        fn new(conditional_rendering: bool) -> Self {
            let uuid = crate::engine::open(&testing::options()).unwrap().info().uuid.clone();
            let instance = Instance::new(testing::options().validation).unwrap();
            let mut devices = instance.physical_devices().unwrap().into_iter();
            let physical = devices.find(|device| device.info.uuid == uuid).unwrap();
            let family = physical.queue_family;
            let is_conditional = conditional_rendering && physical.optional.conditional_rendering;
            let extensions: Vec<_> =
                OPTIONAL_EXTENSIONS[..1].iter().map(|name| name.as_ptr()).filter(|_| is_conditional).collect();
            let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
            let (mut v12, mut v13) = Default::default();
            enable_required_features(&mut v12, &mut v13);
            let mut conditional =
                vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true);
            let mut create = vk::DeviceCreateInfo::default()
                .queue_create_infos(&queues)
                .enabled_extension_names(&extensions)
                .push_next(&mut v12)
                .push_next(&mut v13);
            if is_conditional {
                create = create.push_next(&mut conditional);
            }
            // SAFETY: the physical device belongs to this instance and supports the extensions and features.
            let device = unsafe { instance.handle.create_device(physical.handle, &create, None) }.unwrap();
            // SAFETY: the device was created with one queue of the family.
            let queue = unsafe { device.get_device_queue(family, 0) };
            Self { instance, physical: physical.handle, device, family, queue, is_conditional }
        }

        fn external_device(&self, lock: &Arc<CountingLock>) -> ExternalDevice {
            let handle = self.instance.handle.clone();
            // SAFETY: the handles belong to this program, which outlives the engine; the queue is locked.
            let external =
                unsafe { ExternalDevice::new(handle, self.physical, self.device.clone(), self.family, self.queue) };
            // SAFETY: no other code uses the queue while it is locked.
            let external = unsafe { external.with_queue_lock(lock.clone()) };
            // SAFETY: the device was created with the extension and its feature.
            if self.is_conditional { unsafe { external.with_conditional_rendering() } } else { external }
        }
    }

    impl Drop for Program {
        fn drop(&mut self) {
            // SAFETY: the engine is dropped, so that nothing uses the device, which must still be usable.
            unsafe {
                self.device.queue_wait_idle(self.queue).unwrap();
                let semaphore = self.device.create_semaphore(&vk::SemaphoreCreateInfo::default(), None).unwrap();
                self.device.destroy_semaphore(semaphore, None);
                self.device.destroy_device(None);
            }
            assert_eq!(self.instance.messages(), Vec::<String>::new());
        }
    }

    fn pair() -> [Frame; 2] {
        let value = |soft: f32, i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
        [0.4, 0.3].map(|soft| Frame::gray(64, 48, (0..64 * 48).map(|i| value(soft, i)).collect()).unwrap())
    }

    fn bits(engine: &Engine) -> Vec<u32> {
        let [i1, i2] = pair();
        let solved =
            PairSolver::new(engine, &Settings::default()).unwrap().solve([&i1, &i2], &SolveOptions::default()).unwrap();
        solved.relative_blur.iter().map(|v| v.to_bits()).collect()
    }

    #[test]
    fn an_external_device_gives_the_same_bits_and_is_not_destroyed() {
        let own = bits(&Engine::new(&testing::options()).unwrap());
        for conditional_rendering in [true, false] {
            let (program, lock) = (Program::new(conditional_rendering), Arc::new(CountingLock::default()));
            let engine = Engine::from_vulkan(program.external_device(&lock), &EngineOptions::default()).unwrap();
            assert_eq!(engine.device().is_conditional(), program.is_conditional);
            assert_eq!(bits(&engine), own);
            drop(engine);
            assert!(lock.locked.load(Ordering::SeqCst) > 0);
            assert_eq!(lock.locked.load(Ordering::SeqCst), lock.unlocked.load(Ordering::SeqCst));
        }
    }

    #[test]
    fn an_engine_is_made_from_raw_handles() {
        let program = Program::new(false);
        // SAFETY: the engine's own instance has loaded the same library.
        let loader = unsafe { ash::Entry::load() }.unwrap();
        let (entry, instance) = (loader.static_fn().get_instance_proc_addr, program.instance.handle.handle());
        let (physical, device) = (program.physical, program.device.handle());
        // SAFETY: the handles belong to this program, which outlives the engine and does not use the queue meanwhile.
        let external =
            unsafe { ExternalDevice::from_handles(entry, instance, physical, device, program.family, program.queue) };
        let engine = Engine::from_vulkan(external, &EngineOptions::default()).unwrap();
        assert_eq!(bits(&engine), bits(&Engine::new(&testing::options()).unwrap()));
    }

    impl Program {
        /// Copies a solution to memory of the program, after waiting for its semaphore on the device.
        fn copy_to_host(&self, solution: &DeviceSolution) -> Vec<u32> {
            let (device, size) = (&self.device, solution.bytes);
            let create = vk::BufferCreateInfo::default().size(size).usage(vk::BufferUsageFlags::TRANSFER_DST);
            // SAFETY: all handles belong to this program's device; the copy waits for the results, and completes before
            // anything is destroyed.
            unsafe {
                let own = device.create_buffer(&create, None).unwrap();
                let needs = device.get_buffer_memory_requirements(own);
                let memory = self.instance.handle.get_physical_device_memory_properties(self.physical);
                let properties = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
                let fits = |n: &u32| {
                    needs.memory_type_bits >> n & 1 == 1
                        && memory.memory_types[*n as usize].property_flags.contains(properties)
                };
                let kind = (0..memory.memory_type_count).find(fits).unwrap();
                let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
                let memory = device.allocate_memory(&allocate, None).unwrap();
                device.bind_buffer_memory(own, memory, 0).unwrap();
                let create = vk::CommandPoolCreateInfo::default().queue_family_index(self.family);
                let pool = device.create_command_pool(&create, None).unwrap();
                let create = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
                let commands = device.allocate_command_buffers(&create).unwrap()[0];
                device.begin_command_buffer(commands, &vk::CommandBufferBeginInfo::default()).unwrap();
                device.cmd_copy_buffer(commands, solution.buffer, own, &[vk::BufferCopy::default().size(size)]);
                let to_host = [vk::MemoryBarrier2::default()
                    .src_stage_mask(vk::PipelineStageFlags2::COPY)
                    .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
                    .dst_stage_mask(vk::PipelineStageFlags2::HOST)
                    .dst_access_mask(vk::AccessFlags2::HOST_READ)];
                let to_host = vk::DependencyInfo::default().memory_barriers(&to_host);
                device.cmd_pipeline_barrier2(commands, &to_host);
                device.end_command_buffer(commands).unwrap();
                let waits = [vk::SemaphoreSubmitInfo::default()
                    .semaphore(solution.semaphore)
                    .value(solution.value)
                    .stage_mask(vk::PipelineStageFlags2::COPY)];
                let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
                let submit = vk::SubmitInfo2::default().wait_semaphore_infos(&waits).command_buffer_infos(&buffers);
                device.queue_submit2(self.queue, &[submit], vk::Fence::null()).unwrap();
                device.queue_wait_idle(self.queue).unwrap();
                let mapped = device.map_memory(memory, 0, size, vk::MemoryMapFlags::empty()).unwrap();
                let words = std::slice::from_raw_parts(mapped.cast::<u32>(), size as usize / 4).to_vec();
                device.destroy_command_pool(pool, None);
                device.destroy_buffer(own, None);
                device.free_memory(memory, None);
                words
            }
        }
    }

    #[test]
    fn the_program_reads_results_in_device_memory() {
        let (program, lock) = (Program::new(true), Arc::new(CountingLock::default()));
        let engine = Engine::from_vulkan(program.external_device(&lock), &EngineOptions::default()).unwrap();
        let [i1, i2] = pair();
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
        let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default()).unwrap();
        let copied = program.copy_to_host(&pending.on_device());
        let solution = pending.wait().unwrap();
        let fused = solution.fused(0).unwrap();
        let planes = [solution.relative_blur(), solution.uncertainty(), solution.residual(), fused].concat();
        assert_eq!(copied, planes.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
    }

    #[test]
    fn a_missing_queue_family_is_refused() {
        let program = Program::new(false);
        let external = ExternalDevice { queue_family: 99, ..program.external_device(&Arc::default()) };
        let refused = Engine::from_vulkan(external, &EngineOptions::default()).map(drop);
        assert!(matches!(&refused, Err(Error::NoDevice(why)) if why.contains("family 99")), "{refused:?}");
    }

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
