//! Tests of a caller's Vulkan device: photographs in its memory, solves in its command buffers.
#![allow(unsafe_code, reason = "the tests call Vulkan themselves")]

use std::ffi::{CStr, c_void};
use std::ptr::NonNull;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use parfocal::interop::ash::{self, ext, vk};
use parfocal::interop::{
    DeviceRequirements, DeviceSource, ExternalCommandBuffer, ExternalDevice, QueueLock, SemaphoreWait,
};
use parfocal::{
    Engine, EngineOptions, Error, Frame, PairSolver, PixelFormat, Settings, SolutionRef, SolveOptions,
    interop::HostMemory, settings::Decode, transform::Similarity,
};

use crate::common::TestEngine;
use crate::common::scene::pair;

/// Validation messages of all `Program`s.
static MESSAGES: Mutex<Vec<String>> = Mutex::new(Vec::new());

extern "system" fn collect_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    _: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data.
    let message = unsafe { (*data).message_as_c_str() }.map(|m| m.to_string_lossy().into_owned());
    MESSAGES.lock().unwrap().push(message.unwrap_or_default());
    vk::FALSE
}

/// A Vulkan device of the caller, with a queue of family 0.
struct Program {
    entry: ash::Entry,
    instance: ash::Instance,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    physical: vk::PhysicalDevice,
    requirements: DeviceRequirements,
    device: ash::Device,
    queue: vk::Queue,
    pool: vk::CommandPool,
}

impl Program {
    fn new() -> Self {
        let validation = crate::common::options().validation;
        let layers = [c"VK_LAYER_KHRONOS_validation".as_ptr()];
        let extensions = [ext::debug_utils::NAME.as_ptr(), ext::validation_features::NAME.as_ptr()];
        let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let mut create = vk::InstanceCreateInfo::default().application_info(&application);
        if validation {
            create = create.enabled_layer_names(&layers).enabled_extension_names(&extensions).push_next(&mut features);
        }
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(0).queue_priorities(&[1.0])];
        // SAFETY: the create infos and the arrays that they point to outlive the calls. If the first physical device
        // lacks a feature, the validation layer reports it.
        unsafe {
            let entry = ash::Entry::load().unwrap();
            let instance = entry.create_instance(&create, None).unwrap();
            let messenger = validation.then(|| {
                let utils = ext::debug_utils::Instance::new(&entry, &instance);
                let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
                    .message_severity(
                        vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
                    )
                    .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
                    .pfn_user_callback(Some(collect_message));
                let messenger = utils.create_debug_utils_messenger(&create, None).unwrap();
                (utils, messenger)
            });
            let physical = instance.enumerate_physical_devices().unwrap()[0];
            let mut requirements = DeviceRequirements::for_device(&instance, physical).unwrap();
            let device_extensions: Vec<_> = requirements.extensions().into_iter().map(CStr::as_ptr).collect();
            let create =
                vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&device_extensions);
            let create = requirements.enable_features(create);
            let device = instance.create_device(physical, &create, None).unwrap();
            let queue = device.get_device_queue(0, 0);
            let create = vk::CommandPoolCreateInfo::default().queue_family_index(0);
            let pool = device.create_command_pool(&create, None).unwrap();
            Self { entry, instance, messenger, physical, requirements, device, queue, pool }
        }
    }

    /// The device with its queue, without optional extensions.
    fn external_device(&self, queue_family: u32) -> ExternalDevice {
        let (instance, device) = (self.instance.clone(), self.device.clone());
        // SAFETY: the handles belong to this program, which outlives the engine. Only this thread uses the queue and
        // the engine. The device was created with the required features. Another family than 0 is refused.
        unsafe { ExternalDevice::new(instance, self.physical, device, queue_family, self.queue) }
    }

    fn engine(&self) -> Engine {
        // SAFETY: the device was created with the required features and extensions.
        let external = unsafe { self.external_device(0).with_requirements(&self.requirements) };
        Engine::from_vulkan(external, &EngineOptions::default()).unwrap()
    }

    fn memory(&self, needs: vk::MemoryRequirements) -> vk::DeviceMemory {
        let properties = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        // SAFETY: `memory_type_bits` contains the memory type.
        unsafe {
            let types = self.instance.get_physical_device_memory_properties(self.physical).memory_types;
            let fits = |n: &u32| {
                needs.memory_type_bits >> n & 1 == 1 && types[*n as usize].property_flags.contains(properties)
            };
            let kind = (0..types.len() as u32).find(fits).unwrap();
            let create = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
            self.device.allocate_memory(&create, None).unwrap()
        }
    }

    /// Creates a mapped buffer that holds the bytes.
    fn buffer(&self, bytes: &[u8]) -> (vk::Buffer, vk::DeviceMemory) {
        let usage = vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST;
        let create = vk::BufferCreateInfo::default().size(bytes.len() as u64).usage(usage);
        // SAFETY: the memory is new, mapped, and large enough for the buffer.
        unsafe {
            let buffer = self.device.create_buffer(&create, None).unwrap();
            let memory = self.memory(self.device.get_buffer_memory_requirements(buffer));
            self.device.bind_buffer_memory(buffer, memory, 0).unwrap();
            let mapped = self.device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()).unwrap();
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), mapped.cast(), bytes.len());
            (buffer, memory)
        }
    }

    /// Copies the first bytes of a mapped buffer, which the device does not access now.
    fn read(&self, (_, memory): (vk::Buffer, vk::DeviceMemory), bytes: usize) -> Vec<u8> {
        // SAFETY: the memory is mapped and at least `bytes` long.
        unsafe {
            self.device.unmap_memory(memory);
            let mapped = self.device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()).unwrap();
            std::slice::from_raw_parts(mapped.cast::<u8>(), bytes).to_vec()
        }
    }

    /// Overwrites a mapped buffer.
    fn fill(&self, (_, memory): (vk::Buffer, vk::DeviceMemory), bytes: &[u8]) {
        // SAFETY: the memory is mapped and at least `bytes.len()` long. The device does not access it now.
        unsafe {
            self.device.unmap_memory(memory);
            let mapped = self.device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()).unwrap();
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), mapped.cast(), bytes.len());
        }
    }

    fn timeline(&self) -> vk::Semaphore {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device supports timeline semaphores.
        unsafe { self.device.create_semaphore(&create, None) }.unwrap()
    }

    fn image(&self, format: vk::Format, [width, height]: [u32; 2]) -> (vk::Image, vk::DeviceMemory) {
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(format)
            .extent(vk::Extent3D { width, height, depth: 1 })
            .mip_levels(1)
            .array_layers(2)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(
                vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::SAMPLED,
            );
        // SAFETY: the memory is new and meets the requirements of the image.
        unsafe {
            let image = self.device.create_image(&create, None).unwrap();
            let memory = self.memory(self.device.get_image_memory_requirements(image));
            self.device.bind_image_memory(image, memory, 0).unwrap();
            (image, memory)
        }
    }

    fn free(&self, (buffer, memory): (vk::Buffer, vk::DeviceMemory)) {
        // SAFETY: no pending command uses the buffer.
        unsafe {
            self.device.destroy_buffer(buffer, None);
            self.device.free_memory(memory, None);
        }
    }

    fn commands(&self) -> vk::CommandBuffer {
        let create = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
        // SAFETY: only this thread uses the command pool.
        unsafe {
            let commands = self.device.allocate_command_buffers(&create).unwrap()[0];
            self.device.begin_command_buffer(commands, &vk::CommandBufferBeginInfo::default()).unwrap();
            commands
        }
    }

    /// Ends and submits a command buffer that waits for one timeline semaphore and signals another.
    fn submit(
        &self,
        commands: vk::CommandBuffer,
        wait: Option<(vk::Semaphore, u64)>,
        signal: Option<(vk::Semaphore, u64)>,
    ) {
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let info = |(semaphore, value)| {
            vk::SemaphoreSubmitInfo::default()
                .semaphore(semaphore)
                .value(value)
                .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
        };
        let [waits, signals] = [wait, signal].map(|of| of.into_iter().map(info).collect::<Vec<_>>());
        let submit = vk::SubmitInfo2::default()
            .wait_semaphore_infos(&waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(&signals);
        // SAFETY: the queue is used only by this thread.
        unsafe {
            self.device.end_command_buffer(commands).unwrap();
            self.device.queue_submit2(self.queue, &[submit], vk::Fence::null()).unwrap();
        }
    }

    fn change(&self, commands: vk::CommandBuffer, image: vk::Image, from: vk::ImageLayout, to: vk::ImageLayout) {
        let all = vk::PipelineStageFlags2::ALL_COMMANDS;
        let range =
            vk::ImageSubresourceRange::default().aspect_mask(vk::ImageAspectFlags::COLOR).level_count(1).layer_count(2);
        let barrier = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(all)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(all)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
            .old_layout(from)
            .new_layout(to)
            .image(image)
            .subresource_range(range)];
        // SAFETY: the command buffer is in the recording state.
        unsafe {
            self.device.cmd_pipeline_barrier2(commands, &vk::DependencyInfo::default().image_memory_barriers(&barrier));
        }
    }

    fn idle(&self) {
        // SAFETY: the queue is used only by this thread.
        unsafe { self.device.queue_wait_idle(self.queue) }.unwrap();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // SAFETY: the engine was dropped before, and no command is pending after the wait.
        unsafe {
            self.device.device_wait_idle().unwrap();
            self.device.destroy_command_pool(self.pool, None);
            self.device.destroy_device(None);
            if let Some((utils, messenger)) = &self.messenger {
                utils.destroy_debug_utils_messenger(*messenger, None);
            }
            self.instance.destroy_instance(None);
        }
        let messages = MESSAGES.lock().unwrap();
        assert!(std::thread::panicking() || messages.is_empty(), "validation: {messages:#?}");
    }
}

const SIZE: [u32; 2] = [96, 80];

fn frames(seed: u64) -> [Frame; 2] {
    pair(SIZE, Similarity::new(0.4, -0.3, 0.05, 1.0), |x| [1.0, 1.5 + 0.02 * x[0]], 0.0, seed)
}

/// V in bits, solved by an engine with its own device. The settings use the passes for clipped pixels.
fn expected([i1, i2]: &[Frame; 2], settings: &Settings) -> Vec<u32> {
    let solved = TestEngine::new().solve([i1, i2], settings);
    solved.relative_blur.iter().map(|v| v.to_bits()).collect()
}

/// Returns settings with which some pixels of frames with this white level are clipped.
fn settings(white: f64) -> Settings {
    Settings { white_level: Some(0.75 * white), decode: Decode::None, ..Settings::default() }
}

fn bits(view: &SolutionRef<'_>) -> Vec<u32> {
    assert!(view.converged, "{:?}", view.warnings);
    view.relative_blur().iter().map(|v| v.to_bits()).collect()
}

const DRAWN: vk::ImageLayout = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;

impl Program {
    /// Records commands that copy a buffer into the second layer of an image.
    fn draw(&self, from: vk::Buffer, image: vk::Image) -> vk::CommandBuffer {
        let (commands, to) = (self.commands(), vk::ImageLayout::TRANSFER_DST_OPTIMAL);
        self.change(commands, image, vk::ImageLayout::UNDEFINED, to);
        let layer = vk::ImageSubresourceLayers::default()
            .aspect_mask(vk::ImageAspectFlags::COLOR)
            .base_array_layer(1)
            .layer_count(1);
        let [width, height] = SIZE;
        let extent = vk::Extent3D { width, height, depth: 1 };
        let region = [vk::BufferImageCopy::default().image_subresource(layer).image_extent(extent)];
        // SAFETY: the buffer is as large as the image layer.
        unsafe { self.device.cmd_copy_buffer_to_image(commands, from, image, to, &region) };
        self.change(commands, image, to, DRAWN);
        commands
    }
}

#[test]
fn buffers_and_images_are_read_after_their_semaphores_are_signalled() {
    let (program, pairs) = (Program::new(), [frames(3), frames(5), frames(6)]);
    let engine = program.engine();
    let mut solver = PairSolver::for_frames(&engine, pairs[0].each_ref(), &settings(1.0)).unwrap();
    // I1 is in a buffer with gaps between the rows, at an offset of 4 bytes. I2 is in the second layer of an image.
    let pitch = 4 * SIZE[0] as usize + 12;
    let row = |row: &[u8]| [row, &[0xa5; 12]].concat();
    let rows = |frame: &Frame| {
        let rows: Vec<u8> = frame.bytes().chunks(4 * SIZE[0] as usize).flat_map(row).collect();
        [[0; 4].as_slice(), &rows].concat()
    };
    let (near, upload) = (program.buffer(&rows(&pairs[0][0])), program.buffer(pairs[0][1].bytes()));
    let (image, memory) = program.image(vk::Format::R32_SFLOAT, SIZE);
    let (drawn, written) = (program.timeline(), program.timeline());
    let mut taken = None;
    for (value, pair) in (1..).zip(&pairs) {
        // On the device, the draw waits until the previous pair was read. The draw may still be pending when this pair
        // is submitted.
        program.fill(upload, pair[1].bytes());
        program.submit(program.draw(upload.0, image), taken, Some((drawn, value)));
        // SAFETY: the buffer and the image belong to this device and outlive the pair. They are written again only
        // after the pair was read.
        let (sources, waits) = unsafe {
            let sources = [DeviceSource::buffer(near.0, 4, pitch as u64), DeviceSource::image(image, DRAWN, 1)];
            (
                sources.map(parfocal::frame::Source::OnDevice),
                [SemaphoreWait::new(drawn, value), SemaphoreWait::new(written, value)],
            )
        };
        let mut pending = solver.submit(sources, &waits, &SolveOptions::default()).unwrap();
        assert_eq!(pending.is_fetched(), [true; 2]);
        taken = pending.on_device().unwrap().inputs_read;
        assert!(!pending.wait_fetched(Duration::from_millis(30)).unwrap() && !pending.poll().unwrap());
        // The host writes I1 only now.
        program.fill(near, &rows(&pair[0]));
        let signal = vk::SemaphoreSignalInfo::default().semaphore(written).value(value);
        // SAFETY: the value is greater than the current value of the semaphore.
        unsafe { program.device.signal_semaphore(&signal) }.unwrap();
        assert!(pending.wait_fetched(Duration::MAX).unwrap());
        assert!(bits(&pending.wait().unwrap()) == expected(pair, &settings(1.0)), "pair {value}");
    }
    drop((solver, engine));
    program.idle();
    [near, upload].into_iter().for_each(|buffer| program.free(buffer));
    // SAFETY: no pending command uses them.
    unsafe {
        program.device.destroy_image(image, None);
        program.device.free_memory(memory, None);
        [drawn, written].into_iter().for_each(|timeline| program.device.destroy_semaphore(timeline, None));
    }
}

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

fn solve(engine: &Engine, [i1, i2]: &[Frame; 2]) -> Vec<u32> {
    let mut solver = PairSolver::for_frames(engine, [i1, i2], &settings(1.0)).unwrap();
    bits(&solver.submit([i1, i2], &[], &SolveOptions::default()).unwrap().wait().unwrap())
}

#[test]
fn a_device_of_the_caller_gives_the_same_bits_under_its_lock_and_is_not_destroyed() {
    let frames = frames(3);
    for has_extensions in [true, false] {
        let (program, lock) = (Program::new(), Arc::new(CountingLock::default()));
        // SAFETY: no other code uses the queue. The device was created with the extensions.
        let external = unsafe {
            let external = program.external_device(0).with_queue_lock(lock.clone());
            if has_extensions { external.with_requirements(&program.requirements) } else { external }
        };
        let engine = Engine::from_vulkan(external, &EngineOptions::default()).unwrap();
        assert!(solve(&engine, &frames) == expected(&frames, &settings(1.0)));
        drop(engine);
        assert!(lock.locked.load(Ordering::SeqCst) > 0);
        assert_eq!(lock.locked.load(Ordering::SeqCst), lock.unlocked.load(Ordering::SeqCst));
        let timeline = program.timeline();
        // SAFETY: nothing uses the semaphore.
        unsafe { program.device.destroy_semaphore(timeline, None) };
    }
}

#[test]
fn an_engine_is_made_from_raw_handles() {
    let (program, frames) = (Program::new(), frames(3));
    let entry = program.entry.static_fn().get_instance_proc_addr;
    let (instance, device) = (program.instance.handle(), program.device.handle());
    // SAFETY: the handles belong to this program, which outlives the engine and does not use the queue meanwhile.
    let external = unsafe { ExternalDevice::from_handles(entry, instance, program.physical, device, 0, program.queue) };
    let engine = Engine::from_vulkan(external, &EngineOptions::default()).unwrap();
    assert!(solve(&engine, &frames) == expected(&frames, &settings(1.0)));
}

#[test]
fn a_missing_queue_family_is_refused() {
    let program = Program::new();
    let refused = Engine::from_vulkan(program.external_device(99), &EngineOptions::default()).map(drop);
    assert!(matches!(&refused, Err(Error::NoDevice(why)) if why.contains("family 99")), "{refused:?}");
}

#[test]
fn results_in_device_memory_are_those_that_the_host_reads() {
    let (program, [i1, i2]) = (Program::new(), frames(3));
    let engine = program.engine();
    let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
    let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default()).unwrap();
    let results = pending.on_device().unwrap();
    let copy = program.buffer(&vec![0; results.bytes as usize]);
    let commands = program.commands();
    let to_host = [vk::MemoryBarrier2::default()
        .src_stage_mask(vk::PipelineStageFlags2::COPY)
        .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
        .dst_stage_mask(vk::PipelineStageFlags2::HOST)
        .dst_access_mask(vk::AccessFlags2::HOST_READ)];
    // SAFETY: the command buffer is recording, and both buffers live until the queue is idle.
    unsafe {
        let all = [vk::BufferCopy::default().size(results.bytes)];
        program.device.cmd_copy_buffer(commands, results.buffer, copy.0, &all);
        program.device.cmd_pipeline_barrier2(commands, &vk::DependencyInfo::default().memory_barriers(&to_host));
    }
    // Submitted before the host knows that the pair is solved.
    program.submit(commands, Some((results.semaphore, results.value)), None);
    program.idle();
    let copied = program.read(copy, results.bytes as usize);
    let solution = pending.wait().unwrap();
    let fused = solution.fused(0).unwrap();
    let planes = [solution.relative_blur(), solution.uncertainty(), solution.residual(), fused].concat();
    assert!(copied == planes.iter().flat_map(|v| v.to_ne_bytes()).collect::<Vec<u8>>());
    drop((pending, solver, engine));
    program.free(copy);
}

#[test]
fn host_memory_is_imported_if_the_device_supports_it() {
    let program = Program::new();
    let (engine, bytes) = (program.engine(), vec![0u8; 10_000]);
    let can_import = program.requirements.extensions().contains(&ext::external_memory_host::NAME);
    // SAFETY: the bytes outlive the shared memory and are not written.
    let memory = engine.share(unsafe { HostMemory::new(NonNull::from(&bytes[3]), bytes.len() - 3) });
    assert_eq!(memory.is_staged(), !can_import);
}

#[test]
fn an_encoded_solve_can_be_executed_more_than_once() {
    let program = Program::new();
    let engine = program.engine();
    let format: PixelFormat = "BGRa8".parse().unwrap();
    let pixels = |frame: &Frame| {
        let parfocal::frame::Samples::F32(values) = frame.samples() else { unreachable!() };
        values.iter().flat_map(|v| [(255.0 * v) as u8; 4]).collect::<Vec<u8>>()
    };
    let pairs = [frames(3), frames(5)].map(|pair| pair.each_ref().map(pixels));
    let mut solver = PairSolver::for_size(&engine, SIZE, [format; 2], 2, &settings(255.0)).unwrap();
    let sources = pairs[0].each_ref().map(|bytes| program.buffer(bytes));
    let commands = program.commands();
    // SAFETY: the buffers outlive the solver. The queue is idle before the solver is used again.
    let mut encoded = unsafe {
        let sources = sources.map(|(buffer, _)| DeviceSource::buffer(buffer, 0, 0));
        solver.encode(ExternalCommandBuffer::new(commands), sources, &SolveOptions::default()).unwrap()
    };
    // SAFETY: the command buffer is in the recording state.
    unsafe { program.device.end_command_buffer(commands) }.unwrap();
    assert!(encoded.results().unwrap().is_none(), "results exist before the commands are executed");
    for pair in &pairs {
        sources.iter().zip(pair).for_each(|(&buffer, bytes)| program.fill(buffer, bytes));
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = vk::SubmitInfo2::default().command_buffer_infos(&buffers);
        // SAFETY: only this thread uses the queue.
        unsafe { program.device.queue_submit2(program.queue, &[submit], vk::Fence::null()) }.unwrap();
        program.idle();
        let frames = pair.each_ref().map(|bytes| format.frame(SIZE, bytes).unwrap());
        assert!(bits(&encoded.results().unwrap().unwrap()) == expected(&frames, &settings(255.0)));
    }
    // The solver still solves other pairs.
    let frames = pairs[1].each_ref().map(|bytes| parfocal::frame::Source::Rows { bytes, pitch: 0 });
    let mut pending = solver.submit(frames, &[], &SolveOptions::default()).unwrap();
    let frames = pairs[1].each_ref().map(|bytes| format.frame(SIZE, bytes).unwrap());
    assert!(bits(&pending.wait().unwrap()) == expected(&frames, &settings(255.0)));
    drop((pending, encoded, solver, engine));
    sources.into_iter().for_each(|buffer| program.free(buffer));
}
