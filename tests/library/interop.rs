//! A program with its own Vulkan device: photographs on it, and solves in its command buffers.
#![allow(unsafe_code, reason = "the program's own Vulkan")]

use std::ffi::{CStr, c_void};
use std::ptr::NonNull;
use std::sync::Mutex;
use std::time::Duration;

use parfocal::interop::ash::{self, ext, vk};
use parfocal::interop::{DeviceRequirements, DeviceSource, ExternalCommandBuffer, ExternalDevice, SemaphoreWait};
use parfocal::{
    Engine, EngineOptions, Frame, PairSolver, PixelFormat, Settings, SolutionRef, SolveOptions, interop::HostMemory,
    settings::Decode, transform::Similarity,
};

use crate::common::TestEngine;
use crate::common::scene::pair;

/// The validation messages of the programs of this file.
static MESSAGES: Mutex<Vec<String>> = Mutex::new(Vec::new());

extern "system" fn hear(
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

/// A program's device, of the family that tests compute on.
struct Program {
    _entry: ash::Entry,
    instance: ash::Instance,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    physical: vk::PhysicalDevice,
    wanted: DeviceRequirements,
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
        // SAFETY: all that is pointed to outlives the calls; the first device of the machine has what is asked for, or
        // validation says so.
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
                    .pfn_user_callback(Some(hear));
                let messenger = utils.create_debug_utils_messenger(&create, None).unwrap();
                (utils, messenger)
            });
            let physical = instance.enumerate_physical_devices().unwrap()[0];
            let mut wanted = DeviceRequirements::for_device(&instance, physical).unwrap();
            let liked: Vec<_> = wanted.extensions().into_iter().map(CStr::as_ptr).collect();
            let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&liked);
            let create = wanted.enable_features(create);
            let device = instance.create_device(physical, &create, None).unwrap();
            let queue = device.get_device_queue(0, 0);
            let create = vk::CommandPoolCreateInfo::default().queue_family_index(0);
            let pool = device.create_command_pool(&create, None).unwrap();
            Self { _entry: entry, instance, messenger, physical, wanted, device, queue, pool }
        }
    }

    fn engine(&self) -> Engine {
        // SAFETY: all are of this program, which outlives the engine and uses the queue from this thread alone, as it
        // uses the engine; the device was made with what is wanted.
        let foreign = unsafe {
            ExternalDevice::new(self.instance.clone(), self.physical, self.device.clone(), 0, self.queue)
                .with_requirements(&self.wanted)
        };
        Engine::from_vulkan(foreign, &EngineOptions::default()).unwrap()
    }

    fn memory(&self, needs: vk::MemoryRequirements) -> vk::DeviceMemory {
        let wanted = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        // SAFETY: the type is one of those that the resource may have.
        unsafe {
            let types = self.instance.get_physical_device_memory_properties(self.physical).memory_types;
            let fits =
                |n: &u32| needs.memory_type_bits >> n & 1 == 1 && types[*n as usize].property_flags.contains(wanted);
            let kind = (0..types.len() as u32).find(fits).unwrap();
            let create = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
            self.device.allocate_memory(&create, None).unwrap()
        }
    }

    /// A mapped buffer with these bytes.
    fn buffer(&self, bytes: &[u8]) -> (vk::Buffer, vk::DeviceMemory) {
        let usage = vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST;
        let create = vk::BufferCreateInfo::default().size(bytes.len() as u64).usage(usage);
        // SAFETY: the memory is new, mapped, and as long as the buffer.
        unsafe {
            let buffer = self.device.create_buffer(&create, None).unwrap();
            let memory = self.memory(self.device.get_buffer_memory_requirements(buffer));
            self.device.bind_buffer_memory(buffer, memory, 0).unwrap();
            let mapped = self.device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()).unwrap();
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), mapped.cast(), bytes.len());
            (buffer, memory)
        }
    }

    /// Overwrites a mapped buffer.
    fn fill(&self, (_, memory): (vk::Buffer, vk::DeviceMemory), bytes: &[u8]) {
        // SAFETY: the memory is mapped, as long, and nothing of the device reads it now.
        unsafe {
            self.device.unmap_memory(memory);
            let mapped = self.device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()).unwrap();
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), mapped.cast(), bytes.len());
        }
    }

    fn timeline(&self) -> vk::Semaphore {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device has timelines.
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
        // SAFETY: the memory is new, and as the image needs it.
        unsafe {
            let image = self.device.create_image(&create, None).unwrap();
            let memory = self.memory(self.device.get_image_memory_requirements(image));
            self.device.bind_image_memory(image, memory, 0).unwrap();
            (image, memory)
        }
    }

    fn free(&self, (buffer, memory): (vk::Buffer, vk::DeviceMemory)) {
        // SAFETY: nothing uses it any more.
        unsafe {
            self.device.destroy_buffer(buffer, None);
            self.device.free_memory(memory, None);
        }
    }

    fn commands(&self) -> vk::CommandBuffer {
        let create = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
        // SAFETY: the pool is of this thread.
        unsafe {
            let commands = self.device.allocate_command_buffers(&create).unwrap()[0];
            self.device.begin_command_buffer(commands, &vk::CommandBufferBeginInfo::default()).unwrap();
            commands
        }
    }

    /// Ends and submits commands, which wait for a semaphore to reach a value and signal another.
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
        // SAFETY: the queue is used by this thread alone.
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
        // SAFETY: the commands are being recorded.
        unsafe {
            self.device.cmd_pipeline_barrier2(commands, &vk::DependencyInfo::default().image_memory_barriers(&barrier));
        }
    }

    fn idle(&self) {
        // SAFETY: the queue is used by this thread alone.
        unsafe { self.device.queue_wait_idle(self.queue) }.unwrap();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // SAFETY: the engine and all that was made here is gone, or goes.
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

/// The solution on an engine with its own device, by the passes for pairs with clipped pixels.
fn expected([i1, i2]: &[Frame; 2], settings: &Settings) -> Vec<u32> {
    let solved = TestEngine::new().solve([i1, i2], settings);
    solved.relative_blur.iter().map(|v| v.to_bits()).collect()
}

/// Settings by which some pixels of frames with this white level are clipped.
fn settings(white: f64) -> Settings {
    Settings { white_level: Some(0.75 * white), decode: Decode::None, ..Settings::default() }
}

fn bits(view: &SolutionRef<'_>) -> Vec<u32> {
    assert!(view.converged, "{:?}", view.warnings);
    view.relative_blur().iter().map(|v| v.to_bits()).collect()
}

const DRAWN: vk::ImageLayout = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;

impl Program {
    /// Draws into the second layer of an image, as a renderer does.
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
        // SAFETY: the buffer holds the image.
        unsafe { self.device.cmd_copy_buffer_to_image(commands, from, image, to, &region) };
        self.change(commands, image, to, DRAWN);
        commands
    }
}

#[test]
fn photographs_are_fetched_from_buffers_and_images_after_their_semaphores() {
    let (program, pairs) = (Program::new(), [frames(3), frames(5), frames(6)]);
    let engine = program.engine();
    let mut solver = PairSolver::for_frames(&engine, pairs[0].each_ref(), &settings(1.0)).unwrap();
    // I1 in a buffer, in rows with gaps, from an odd word on; I2 in the second layer of an image as a renderer leaves
    // it.
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
        // Drawing waits for the pair before to be taken, on the device, and is perhaps not yet done as the slot takes
        // this one.
        program.fill(upload, pair[1].bytes());
        program.submit(program.draw(upload.0, image), taken, Some((drawn, value)));
        // SAFETY: both are of this device, outlive the pair, and are written again only once they are taken.
        let (sources, waits) = unsafe {
            let sources = [DeviceSource::buffer(near.0, 4, pitch as u64), DeviceSource::image(image, DRAWN, 1)];
            (
                sources.map(parfocal::frame::Source::OnDevice),
                [SemaphoreWait::new(drawn, value), SemaphoreWait::new(written, value)],
            )
        };
        let mut pending = solver.submit(sources, &waits, &SolveOptions::default()).unwrap();
        assert_eq!(pending.is_fetched(), [true; 2]);
        taken = pending.on_device().inputs_read;
        assert!(!pending.wait_fetched(Duration::from_millis(30)).unwrap() && !pending.poll().unwrap());
        // I1 is written by the host only now.
        program.fill(near, &rows(&pair[0]));
        let signal = vk::SemaphoreSignalInfo::default().semaphore(written).value(value);
        // SAFETY: the value is the next of this timeline.
        unsafe { program.device.signal_semaphore(&signal) }.unwrap();
        assert!(pending.wait_fetched(Duration::MAX).unwrap());
        assert!(bits(&pending.wait().unwrap()) == expected(pair, &settings(1.0)), "pair {value}");
    }
    drop((solver, engine));
    program.idle();
    [near, upload].into_iter().for_each(|buffer| program.free(buffer));
    // SAFETY: nothing uses them any more.
    unsafe {
        program.device.destroy_image(image, None);
        program.device.free_memory(memory, None);
        [drawn, written].into_iter().for_each(|timeline| program.device.destroy_semaphore(timeline, None));
    }
}

#[test]
fn host_memory_is_imported_if_the_device_can() {
    let program = Program::new();
    let (engine, bytes) = (program.engine(), vec![0u8; 10_000]);
    let can = program.wanted.extensions().contains(&ext::external_memory_host::NAME);
    // SAFETY: the bytes outlive it, and are not written.
    let memory = engine.share(unsafe { HostMemory::new(NonNull::from(&bytes[3]), bytes.len() - 3) });
    assert_eq!(memory.is_staged(), !can);
}

#[test]
fn an_encoded_solve_may_be_executed_again() {
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
    // SAFETY: the buffers outlive the solver; nothing else of it runs while the commands do, which are waited for.
    let mut encoded = unsafe {
        let sources = sources.map(|(buffer, _)| DeviceSource::buffer(buffer, 0, 0));
        solver.encode(ExternalCommandBuffer::new(commands), sources, &SolveOptions::default()).unwrap()
    };
    // SAFETY: the commands are ended once.
    unsafe { program.device.end_command_buffer(commands) }.unwrap();
    assert!(encoded.results().unwrap().is_none(), "no results before the commands are executed");
    for pair in &pairs {
        sources.iter().zip(pair).for_each(|(&buffer, bytes)| program.fill(buffer, bytes));
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = vk::SubmitInfo2::default().command_buffer_infos(&buffers);
        // SAFETY: the queue is this thread's alone.
        unsafe { program.device.queue_submit2(program.queue, &[submit], vk::Fence::null()) }.unwrap();
        program.idle();
        let frames = pair.each_ref().map(|bytes| format.frame(SIZE, bytes).unwrap());
        assert!(bits(&encoded.results().unwrap().unwrap()) == expected(&frames, &settings(255.0)));
    }
    // Other pairs of the solver are solved as before.
    let frames = pairs[1].each_ref().map(|bytes| parfocal::frame::Source::Rows { bytes, pitch: 0 });
    let mut pending = solver.submit(frames, &[], &SolveOptions::default()).unwrap();
    let frames = pairs[1].each_ref().map(|bytes| format.frame(SIZE, bytes).unwrap());
    assert!(bits(&pending.wait().unwrap()) == expected(&frames, &settings(255.0)));
    drop((pending, encoded, solver, engine));
    sources.into_iter().for_each(|buffer| program.free(buffer));
}
