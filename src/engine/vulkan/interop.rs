//! Someone else's instance, device and queue: what an engine needs of them, whose turn it is at the queue, what to wait for there.

use std::fmt;
use std::sync::{Arc, Mutex};

use ash::vk;

use super::device_requirements::DeviceRequirements;
use super::optional_extensions::Liked;

/// SharedQueue at a queue that others submit to as well; [`SharedQueue`](super::SharedQueue) where there is no such lock yet. Each [`lock`](Self::lock) is followed
/// by one [`unlock`](Self::unlock), by the same thread, after a single submission.
pub trait QueueLock: Send + Sync {
    /// Waits until nobody else uses the queue, and keeps others from it.
    fn lock(&self);
    /// Lets others have it.
    fn unlock(&self);
}

/// A device that belongs to the embedding program, for [`Engine::from_vulkan`](crate::Engine::from_vulkan).
#[derive(Clone)]
pub struct ExternalDevice {
    pub(super) instance: ash::Instance,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) device: ash::Device,
    pub(super) queue_family: u32,
    /// Shared by all engines that are made of this.
    pub(super) queue: Arc<Mutex<vk::Queue>>,
    pub(super) liked: Liked,
    pub(super) lock: Option<Arc<dyn QueueLock>>,
}

impl ExternalDevice {
    /// A device and a queue of it, of a family that computes.
    ///
    /// # Safety
    /// - `physical` is of `instance`, `device` was made of `physical`, and `queue` is of `queue_family` of `device`.
    /// - Instance and device were made for [`REQUIRED_VERSION`](super::REQUIRED_VERSION) or later, the device with what
    ///   [`require`](super::require) or [`DeviceRequirements`] switches on.
    /// - Until the last engine, solver and view made of this is gone, none of them is destroyed; and where a solve has timed out, not before the
    ///   device is idle.
    /// - Nobody else uses `queue` meanwhile, unless all do by the turns of [`ExternalDevice::locked_by`]. To wait for the device to be idle is to use all
    ///   its queues. A queue that the device synchronises itself needs no turns, nor does one of several of a family that only the engine has.
    pub unsafe fn new(
        instance: ash::Instance,
        physical: vk::PhysicalDevice,
        device: ash::Device,
        queue_family: u32,
        queue: vk::Queue,
    ) -> Self {
        let queue = Arc::new(Mutex::new(queue));
        Self { instance, physical, device, queue_family, queue, liked: Liked::default(), lock: None }
    }

    /// The same of raw handles, from another language or another version of ash; `entry` is the `vkGetInstanceProcAddr` that `instance` came by.
    ///
    /// # Safety
    /// As of [`ExternalDevice::new`].
    pub unsafe fn from_handles(
        entry: vk::PFN_vkGetInstanceProcAddr,
        instance: vk::Instance,
        physical: vk::PhysicalDevice,
        device: vk::Device,
        queue_family: u32,
        queue: vk::Queue,
    ) -> Self {
        // SAFETY: the handles are valid, and `entry` knows them.
        unsafe {
            let instance = ash::Instance::load(&ash::StaticFn { get_instance_proc_addr: entry }, instance);
            let device = ash::Device::load(instance.fp_v1_0(), device);
            Self::new(instance, physical, device, queue_family, queue)
        }
    }

    /// The queue is shared: it is used by turns. Who has the turn solves nothing before giving it back: the engine would wait for it forever.
    ///
    /// # Safety
    /// Between `lock` and `unlock` nobody else uses the queue.
    pub unsafe fn locked_by(self, lock: Arc<dyn QueueLock>) -> Self {
        Self { lock: Some(lock), ..self }
    }

    /// The device has what was wanted, all of which may be used.
    ///
    /// # Safety
    /// The device was made with the [extensions](DeviceRequirements::extensions) and as [`DeviceRequirements::switch_on`] says, on the same physical device.
    pub unsafe fn made_with(self, wanted: &DeviceRequirements) -> Self {
        Self { liked: wanted.liked(), ..self }
    }

    /// Conditional rendering may be used.
    ///
    /// # Safety
    /// The device was made with `VK_EXT_conditional_rendering` and its feature `conditionalRendering`.
    pub unsafe fn with_conditional_rendering(self) -> Self {
        Self { liked: Liked { conditional: true, ..self.liked }, ..self }
    }

    /// dma-bufs may be shared.
    ///
    /// # Safety
    /// The device was made with the last three of [`OPTIONAL_EXTENSIONS`](super::OPTIONAL_EXTENSIONS).
    pub unsafe fn with_dma_bufs(self) -> Self {
        Self { liked: Liked { dma_buf: true, ..self.liked }, ..self }
    }

    /// Memory of the host may be shared.
    ///
    /// # Safety
    /// The device was made with `VK_EXT_external_memory_host`.
    pub unsafe fn with_host_memory(self) -> Self {
        Self { liked: Liked { host_memory: true, ..self.liked }, ..self }
    }
}

impl fmt::Debug for ExternalDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { physical, queue_family, liked, .. } = self;
        write!(f, "ExternalDevice {{ {physical:?}, family {queue_family}, {liked:?} }}")
    }
}

/// What the device waits for before it reads a photograph.
#[derive(Clone, Copy, Debug)]
pub struct Wait {
    pub(super) semaphore: vk::Semaphore,
    pub(super) value: u64,
}

impl Wait {
    /// For a timeline semaphore to reach a value; or for a binary one, of which the value says nothing.
    ///
    /// # Safety
    /// The semaphore is of the engine's device, lives until the pair is solved, and if it is binary, its signal has been submitted.
    pub unsafe fn new(semaphore: vk::Semaphore, value: u64) -> Self {
        Self { semaphore, value }
    }

    pub(super) fn info(&self) -> vk::SemaphoreSubmitInfo<'static> {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(self.semaphore)
            .value(self.value)
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
    }
}

/// A command buffer of the embedding program's, into which a solve is [recorded](crate::PairSolver::encode).
#[derive(Clone, Copy, Debug)]
pub struct Commands(pub(super) vk::CommandBuffer);

impl Commands {
    /// Wraps a primary command buffer that is being recorded, outside of a render pass and of conditional rendering. Afterwards other
    /// pipelines, descriptor sets and push constants are bound for compute. All of a solve is one submission: it must be short on
    /// drivers that end submissions of some seconds.
    ///
    /// # Safety
    /// - It belongs to the engine's device and queue family, and is used by one thread meanwhile.
    /// - It is executed only while nothing else of the solver is, since all pairs of a solver share memory of the device.
    /// - It is not pending while results of its [`Encoded`](crate::interop::Encoded) are borrowed or when that is dropped, and is not
    ///   executed afterwards.
    /// - If recording fails, it is reset.
    pub unsafe fn new(commands: vk::CommandBuffer) -> Self {
        Self(commands)
    }
}

/// A turn at a queue, given back when it is dropped.
pub struct QueueGuard<'a>(Option<&'a dyn QueueLock>);

impl<'a> QueueGuard<'a> {
    pub(super) fn take(lock: Option<&'a dyn QueueLock>) -> Self {
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

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::base::{Error, Frame, Settings};
    use crate::engine::vulkan::{Instance, OPTIONAL_EXTENSIONS, OnDevice, require};
    use crate::engine::{Engine, EngineOptions, testing};
    use crate::solve::{PairSolver, SolveOptions};

    /// Counts turns, and sees that there is one at a time.
    #[derive(Default)]
    struct SharedQueue {
        taken: AtomicUsize,
        given_back: AtomicUsize,
    }

    impl QueueLock for SharedQueue {
        fn lock(&self) {
            assert_eq!(self.taken.fetch_add(1, Ordering::SeqCst), self.given_back.load(Ordering::SeqCst));
        }

        fn unlock(&self) {
            self.given_back.fetch_add(1, Ordering::SeqCst);
        }
    }

    /// A program that has opened a device for itself.
    struct Program {
        instance: Arc<Instance>,
        physical: vk::PhysicalDevice,
        device: ash::Device,
        family: u32,
        queue: vk::Queue,
        is_conditional: bool,
    }

    impl Program {
        /// On the device that other tests take.
        fn new(likes: bool) -> Self {
            let wanted = crate::engine::open(&testing::options()).unwrap().info().uuid.clone();
            let instance = Instance::new(testing::options().validation).unwrap();
            let found = instance.physical_devices().unwrap().into_iter().find(|device| device.info.uuid == wanted);
            let first = found.unwrap();
            let family = first.queue_family;
            let is_conditional = likes && first.liked.conditional;
            let extensions: Vec<_> =
                OPTIONAL_EXTENSIONS[..1].iter().map(|name| name.as_ptr()).filter(|_| is_conditional).collect();
            let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
            let (mut v12, mut v13) = Default::default();
            require(&mut v12, &mut v13);
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
            // SAFETY: the physical device is of this instance, and has what is asked for, or validation says so.
            let device = unsafe { instance.handle.create_device(first.handle, &create, None) }.unwrap();
            // SAFETY: one queue of the family was asked for.
            let queue = unsafe { device.get_device_queue(family, 0) };
            Self { instance, physical: first.handle, device, family, queue, is_conditional }
        }

        fn foreign(&self, turns: &Arc<SharedQueue>) -> ExternalDevice {
            let handle = self.instance.handle.clone();
            // SAFETY: all are of this program, which outlives what is made of them; the queue is used by turns.
            let foreign =
                unsafe { ExternalDevice::new(handle, self.physical, self.device.clone(), self.family, self.queue) };
            // SAFETY: nobody else uses the queue meanwhile.
            let foreign = unsafe { foreign.locked_by(turns.clone()) };
            // SAFETY: the device was made so.
            if self.is_conditional { unsafe { foreign.with_conditional_rendering() } } else { foreign }
        }
    }

    impl Drop for Program {
        fn drop(&mut self) {
            // SAFETY: the engine is gone; the device is still good for something, and then no more.
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
    fn a_device_of_the_callers_solves_alike_and_stays_theirs() {
        let own = bits(&Engine::new(&testing::options()).unwrap());
        for likes in [true, false] {
            let (program, turns) = (Program::new(likes), Arc::new(SharedQueue::default()));
            let engine = Engine::from_vulkan(program.foreign(&turns), &EngineOptions::default()).unwrap();
            assert_eq!(engine.device().conditional.is_some(), program.is_conditional);
            assert_eq!(bits(&engine), own);
            drop(engine);
            assert!(turns.taken.load(Ordering::SeqCst) > 0);
            assert_eq!(turns.taken.load(Ordering::SeqCst), turns.given_back.load(Ordering::SeqCst));
        }
    }

    #[test]
    fn handles_will_do() {
        let program = Program::new(false);
        // SAFETY: as the engine's own instance has loaded it.
        let loader = unsafe { ash::Entry::load() }.unwrap();
        let (entry, instance) = (loader.static_fn().get_instance_proc_addr, program.instance.handle.handle());
        let (physical, device) = (program.physical, program.device.handle());
        // SAFETY: all are of this program, which outlives the engine and does nothing else with the queue.
        let foreign =
            unsafe { ExternalDevice::from_handles(entry, instance, physical, device, program.family, program.queue) };
        let engine = Engine::from_vulkan(foreign, &EngineOptions::default()).unwrap();
        assert_eq!(bits(&engine), bits(&Engine::new(&testing::options()).unwrap()));
    }

    impl Program {
        /// Copies what an engine leaves to memory of its own, when it is there.
        fn copied(&self, found: &OnDevice) -> Vec<u32> {
            let (device, size) = (&self.device, found.bytes);
            let create = vk::BufferCreateInfo::default().size(size).usage(vk::BufferUsageFlags::TRANSFER_DST);
            // SAFETY: all is of this program's device; the copy waits for the results, and is waited for before anything goes.
            unsafe {
                let own = device.create_buffer(&create, None).unwrap();
                let needs = device.get_buffer_memory_requirements(own);
                let memory = self.instance.handle.get_physical_device_memory_properties(self.physical);
                let wanted = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
                let fits = |n: &u32| {
                    needs.memory_type_bits >> n & 1 == 1
                        && memory.memory_types[*n as usize].property_flags.contains(wanted)
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
                device.cmd_copy_buffer(commands, found.buffer, own, &[vk::BufferCopy::default().size(size)]);
                let to_host = [vk::MemoryBarrier2::default()
                    .src_stage_mask(vk::PipelineStageFlags2::COPY)
                    .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
                    .dst_stage_mask(vk::PipelineStageFlags2::HOST)
                    .dst_access_mask(vk::AccessFlags2::HOST_READ)];
                let to_host = vk::DependencyInfo::default().memory_barriers(&to_host);
                device.cmd_pipeline_barrier2(commands, &to_host);
                device.end_command_buffer(commands).unwrap();
                let waits = [vk::SemaphoreSubmitInfo::default()
                    .semaphore(found.semaphore)
                    .value(found.value)
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
    fn results_are_read_where_the_device_leaves_them() {
        let (program, turns) = (Program::new(true), Arc::new(SharedQueue::default()));
        let engine = Engine::from_vulkan(program.foreign(&turns), &EngineOptions::default()).unwrap();
        let [i1, i2] = pair();
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
        let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default()).unwrap();
        let found = program.copied(&pending.on_device());
        let view = pending.wait().unwrap();
        let planes = [view.relative_blur(), view.uncertainty(), view.residual(), view.fused(0).unwrap()].concat();
        assert_eq!(found, planes.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
    }

    #[test]
    fn a_family_that_there_is_not_is_refused() {
        let program = Program::new(false);
        let foreign = ExternalDevice { queue_family: 99, ..program.foreign(&Arc::default()) };
        let refused = Engine::from_vulkan(foreign, &EngineOptions::default()).map(drop);
        assert!(matches!(&refused, Err(Error::NoDevice(why)) if why.contains("family 99")), "{refused:?}");
    }
}
