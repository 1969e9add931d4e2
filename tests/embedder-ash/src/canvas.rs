//! Draws V into an image.

use parfocal::interop::DeviceSolution;
use parfocal::interop::ash::vk;

use crate::gpu::Gpu;
use crate::pipeline::Pipeline;

const FORMAT: vk::Format = vk::Format::R8G8B8A8_UNORM;

/// An image with a picture of V, and a buffer with a host-visible copy.
pub struct Canvas<'a> {
    gpu: &'a Gpu,
    extent: vk::Extent2D,
    pipeline: Pipeline,
    image: vk::Image,
    view: vk::ImageView,
    buffer: vk::Buffer,
    /// The memory of the image and of the buffer.
    memory: [vk::DeviceMemory; 2],
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
}

impl<'a> Canvas<'a> {
    pub fn new(gpu: &'a Gpu, [width, height]: [u32; 2]) -> Result<Self, vk::Result> {
        let (device, extent) = (&gpu.device, vk::Extent2D { width, height });
        let usage = vk::ImageUsageFlags::COLOR_ATTACHMENT | vk::ImageUsageFlags::TRANSFER_SRC;
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(extent.into())
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(usage);
        let host = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        // SAFETY: all handles belong to this device. Each memory meets the requirements of the resource bound to it.
        unsafe {
            let image = device.create_image(&create, None)?;
            let needs = device.get_image_memory_requirements(image);
            let of_image = allocate(gpu, needs, vk::MemoryPropertyFlags::DEVICE_LOCAL)?;
            device.bind_image_memory(image, of_image, 0)?;
            let create = vk::ImageViewCreateInfo::default()
                .image(image)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(FORMAT)
                .subresource_range(whole());
            let view = device.create_image_view(&create, None)?;
            let size = u64::from(4 * width * height);
            let create = vk::BufferCreateInfo::default().size(size).usage(vk::BufferUsageFlags::TRANSFER_DST);
            let buffer = device.create_buffer(&create, None)?;
            let of_buffer = allocate(gpu, device.get_buffer_memory_requirements(buffer), host)?;
            device.bind_buffer_memory(buffer, of_buffer, 0)?;
            let create = vk::CommandPoolCreateInfo::default()
                .queue_family_index(gpu.family)
                .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
            let pool = device.create_command_pool(&create, None)?;
            let create = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
            let commands = device.allocate_command_buffers(&create)?[0];
            let fence = device.create_fence(&vk::FenceCreateInfo::default(), None)?;
            let (pipeline, memory) = (Pipeline::new(device, FORMAT)?, [of_image, of_buffer]);
            Ok(Self { gpu, extent, pipeline, image, view, buffer, memory, pool, commands, fence })
        }
    }

    /// Submits a draw of V. The device waits for the results; the host does not.
    ///
    /// # Safety
    /// The previous picture was [read](Self::read). This one is read before the pair is dropped.
    pub unsafe fn draw(&mut self, results: &DeviceSolution, range: f32) -> Result<(), vk::Result> {
        let Gpu { device, queue, shared_queue, .. } = self.gpu;
        // SAFETY: the results belong to this device. The caller ensures that no draw is pending.
        unsafe {
            self.pipeline.read_from(device, results.buffer);
            self.record(range)?;
        }
        // The semaphore wait makes the writes of the engine visible to the fragment shader, so V needs no barrier.
        let waits = [vk::SemaphoreSubmitInfo::default()
            .semaphore(results.semaphore)
            .value(results.value)
            .stage_mask(vk::PipelineStageFlags2::FRAGMENT_SHADER)];
        let commands = [vk::CommandBufferSubmitInfo::default().command_buffer(self.commands)];
        let submit = vk::SubmitInfo2::default().wait_semaphore_infos(&waits).command_buffer_infos(&commands);
        let _guard = shared_queue.acquire();
        // SAFETY: the queue is locked. All resources of the commands live until the fence is signalled.
        unsafe { device.queue_submit2(*queue, &[submit], self.fence) }
    }

    /// # Safety
    /// The command buffer is not pending.
    unsafe fn record(&self, range: f32) -> Result<(), vk::Result> {
        let (device, commands) = (&self.gpu.device, self.commands);
        let once = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        let attachment = [vk::RenderingAttachmentInfo::default()
            .image_view(self.view)
            .image_layout(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL)
            .load_op(vk::AttachmentLoadOp::DONT_CARE)
            .store_op(vk::AttachmentStoreOp::STORE)];
        let area = vk::Rect2D { extent: self.extent, ..vk::Rect2D::default() };
        let rendering = vk::RenderingInfo::default().render_area(area).layer_count(1).color_attachments(&attachment);
        let copy = vk::BufferImageCopy::default().image_extent(self.extent.into()).image_subresource(
            vk::ImageSubresourceLayers::default().aspect_mask(vk::ImageAspectFlags::COLOR).layer_count(1),
        );
        // SAFETY: all handles belong to this device and outlive the commands. The caller ensures that none are pending.
        unsafe {
            device.begin_command_buffer(commands, &once)?;
            self.image_to(vk::ImageLayout::UNDEFINED, vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL);
            device.cmd_begin_rendering(commands, &rendering);
            self.cover(range);
            device.cmd_end_rendering(commands);
            let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
            self.image_to(vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL, layout);
            device.cmd_copy_image_to_buffer(commands, self.image, layout, self.buffer, &[copy]);
            self.buffer_to_host();
            device.end_command_buffer(commands)
        }
    }

    /// # Safety
    /// The command buffer is in the recording state, inside a render pass instance.
    unsafe fn cover(&self, range: f32) {
        let (device, commands, Pipeline { handle, layout, set, .. }) =
            (&self.gpu.device, self.commands, &self.pipeline);
        let vk::Extent2D { width, height } = self.extent;
        let viewport =
            vk::Viewport { width: width as f32, height: height as f32, max_depth: 1.0, ..Default::default() };
        let area = vk::Rect2D { extent: self.extent, ..vk::Rect2D::default() };
        let constants = [width.to_ne_bytes(), range.to_ne_bytes()].concat();
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        // SAFETY: guaranteed by the caller. The constants have the size of the push constant range.
        unsafe {
            device.cmd_bind_pipeline(commands, graphics, *handle);
            device.cmd_bind_descriptor_sets(commands, graphics, *layout, 0, &[*set], &[]);
            device.cmd_push_constants(commands, *layout, vk::ShaderStageFlags::FRAGMENT, 0, &constants);
            device.cmd_set_viewport(commands, 0, &[viewport]);
            device.cmd_set_scissor(commands, 0, &[area]);
            device.cmd_draw(commands, 3, 1, 0, 0);
        }
    }

    /// Waits for the picture and returns its RGBA pixels, row by row.
    pub fn read(&mut self) -> Result<Vec<u8>, vk::Result> {
        let device = &self.gpu.device;
        let size = (4 * self.extent.width * self.extent.height) as usize;
        // SAFETY: no command is pending after the fence is signalled. The mapping covers the whole buffer.
        unsafe {
            device.wait_for_fences(&[self.fence], true, u64::MAX)?;
            device.reset_fences(&[self.fence])?;
            let mapped = device.map_memory(self.memory[1], 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty())?;
            let picture = std::slice::from_raw_parts(mapped.cast::<u8>(), size).to_vec();
            device.unmap_memory(self.memory[1]);
            Ok(picture)
        }
    }
}

impl Canvas<'_> {
    /// Records a transition of the image layout.
    ///
    /// # Safety
    /// The command buffer is in the recording state, and the image has the layout `from`.
    unsafe fn image_to(&self, from: vk::ImageLayout, to: vk::ImageLayout) {
        let drawn = (vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT, vk::AccessFlags2::COLOR_ATTACHMENT_WRITE);
        let copied = (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::TRANSFER_READ);
        let is_new = from == vk::ImageLayout::UNDEFINED;
        let (before, after) = if is_new { (copied, drawn) } else { (drawn, copied) };
        let barrier = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(before.0)
            .src_access_mask(if is_new { vk::AccessFlags2::NONE } else { before.1 })
            .dst_stage_mask(after.0)
            .dst_access_mask(after.1)
            .old_layout(from)
            .new_layout(to)
            .image(self.image)
            .subresource_range(whole())];
        let barrier = vk::DependencyInfo::default().image_memory_barriers(&barrier);
        // SAFETY: guaranteed by the caller.
        unsafe { self.gpu.device.cmd_pipeline_barrier2(self.commands, &barrier) };
    }

    /// Records a barrier that makes the copy visible to the host.
    ///
    /// # Safety
    /// The command buffer is in the recording state.
    unsafe fn buffer_to_host(&self) {
        let barrier = [vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::COPY)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ)];
        let barrier = vk::DependencyInfo::default().memory_barriers(&barrier);
        // SAFETY: guaranteed by the caller.
        unsafe { self.gpu.device.cmd_pipeline_barrier2(self.commands, &barrier) };
    }
}

impl Drop for Canvas<'_> {
    fn drop(&mut self) {
        let Gpu { device, queue, shared_queue, .. } = self.gpu;
        // SAFETY: the queue is locked. No command is pending after the wait.
        unsafe {
            let guard = shared_queue.acquire();
            let _ = device.queue_wait_idle(*queue);
            drop(guard);
            self.pipeline.destroy(device);
            device.destroy_fence(self.fence, None);
            device.destroy_command_pool(self.pool, None);
            device.destroy_buffer(self.buffer, None);
            device.destroy_image_view(self.view, None);
            device.destroy_image(self.image, None);
            self.memory.iter().for_each(|&memory| device.free_memory(memory, None));
        }
    }
}

fn whole() -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange::default().aspect_mask(vk::ImageAspectFlags::COLOR).level_count(1).layer_count(1)
}

/// Allocates memory for an image or a buffer.
///
/// # Safety
/// The requirements were queried from this device.
unsafe fn allocate(
    gpu: &Gpu,
    needs: vk::MemoryRequirements,
    properties: vk::MemoryPropertyFlags,
) -> Result<vk::DeviceMemory, vk::Result> {
    // SAFETY: the physical device belongs to the instance.
    let memory = unsafe { gpu.instance.get_physical_device_memory_properties(gpu.physical) };
    let fits = |(n, kind): &(usize, &vk::MemoryType)| {
        needs.memory_type_bits >> n & 1 == 1 && kind.property_flags.contains(properties)
    };
    let kind = memory.memory_types_as_slice().iter().enumerate().find(fits);
    let (kind, _) = kind.ok_or(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY)?;
    let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind as u32);
    // SAFETY: guaranteed by the caller.
    unsafe { gpu.device.allocate_memory(&allocate, None) }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use embedder::{RANGE, SIZE, pair, validate};
    use parfocal::{Engine, EngineOptions, PairSolver, Settings, SolveOptions};

    use super::*;

    /// One queue could execute the draw in order even without the semaphore. Therefore the host signals the semaphore.
    #[test]
    fn nothing_is_drawn_before_the_semaphore_is_signalled() {
        let gpu = Gpu::new(validate()).unwrap();
        // SAFETY: the engine and the solver are dropped before the device.
        let engine = Engine::from_vulkan(unsafe { gpu.external_device() }, &EngineOptions::default()).unwrap();
        let [i1, i2] = pair(|x| x);
        let mut solver = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default()).unwrap();
        let mut pending = solver.submit([&i1, &i2], &[], &SolveOptions::default()).unwrap();
        pending.wait().unwrap();
        let mut canvas = Canvas::new(&gpu, [SIZE; 2]).unwrap();
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let create = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: all handles belong to this device. The semaphore is destroyed after the wait for it has ended.
        unsafe {
            let semaphore = gpu.device.create_semaphore(&create, None).unwrap();
            let held = DeviceSolution { semaphore, value: 1, ..pending.on_device().unwrap() };
            canvas.draw(&held, RANGE).unwrap();
            std::thread::sleep(Duration::from_millis(100));
            let early = gpu.device.get_fence_status(canvas.fence).unwrap();
            gpu.device.signal_semaphore(&vk::SemaphoreSignalInfo::default().semaphore(semaphore).value(1)).unwrap();
            canvas.read().unwrap();
            gpu.device.destroy_semaphore(semaphore, None);
            assert!(!early, "drawn before the semaphore was signalled");
        }
    }
}
