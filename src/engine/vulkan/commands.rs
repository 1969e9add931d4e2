//! Recording passes, copies and barriers. What waits for what is the caller's to know.

use std::any::Any;
use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::descriptors::{Descriptors, Resource};
use super::device::Device;
use super::interop::Commands;
use super::memory::{Buffer, Image};
use super::pipeline::Pipeline;
use super::recording::{CommandBuffer, Recording, Timeline};
use super::timestamps::{Clock, Timestamps};
use crate::base::Error;

/// How many workgroups a pass runs.
#[derive(Clone, Copy)]
pub(crate) enum Groups<'a> {
    Direct([u32; 3]),
    /// Three numbers in a buffer, at a byte offset.
    Indirect(&'a Arc<Buffer>, u64),
}

/// Writes passes into command buffers.
pub(crate) struct Recorder {
    device: Arc<Device>,
    pool: vk::CommandPool,
    parts: Vec<CommandBuffer>,
    /// Command buffers of the pool that are free.
    free: Vec<vk::CommandBuffer>,
    /// The timeline of the recording to come, if it is not a new one.
    timeline: Option<Timeline>,
    descriptors: Descriptors,
    keep: Vec<Arc<dyn Any + Send + Sync>>,
    timestamps: Timestamps,
    /// Whether the part under way is left out by the device itself.
    in_condition: bool,
    /// For a command buffer of the embedding program, which begins and ends it: the word that says that it was executed to its end.
    completion: Option<Arc<Buffer>>,
}

impl Recorder {
    /// Starts a recording of one part.
    pub(crate) fn new(device: &Arc<Device>, clock: Clock) -> Result<Self, Error> {
        let mut recorder = Self::onto(device, Timestamps::new(device, clock)?);
        let create = vk::CommandPoolCreateInfo::default().queue_family_index(device.physical.queue_family);
        // SAFETY: the family is the device's own.
        let pool = unsafe { device.handle.create_command_pool(&create, None) };
        recorder.pool = device.check("vkCreateCommandPool", pool)?;
        recorder.begin_part(false)?;
        recorder.timestamps.reset(recorder.part());
        Ok(recorder)
    }

    /// The completion word while commands have not been executed to their end.
    pub(crate) const PENDING: u32 = 0;
    /// The completion word afterwards.
    pub(crate) const DONE: u32 = 1;

    /// Records all parts into a command buffer of the embedding program. Each execution sets the completion word to
    /// [`PENDING`](Self::PENDING) first and to [`DONE`](Self::DONE) last.
    pub(crate) fn into(device: &Arc<Device>, commands: Commands, completion: &Arc<Buffer>) -> Self {
        let mut recorder = Self::onto(device, Timestamps::default());
        recorder.parts.push(CommandBuffer { commands: commands.0, optional: false });
        recorder.keep(completion.clone());
        recorder.completion = Some(completion.clone());
        recorder.barrier();
        recorder.set_completion(completion, Self::PENDING);
        recorder
    }

    fn set_completion(&self, completion: &Buffer, word: u32) {
        // SAFETY: the part is being recorded; the word lies within the buffer, which is kept alive.
        unsafe { self.device.handle.cmd_fill_buffer(self.part(), completion.handle, 0, 4, word) };
    }

    /// Starts a recording of one part with what an earlier one leaves: its pool, which was reset, its command buffers, its
    /// descriptor sets and its timeline.
    pub(super) fn again(
        device: &Arc<Device>,
        pool: vk::CommandPool,
        parts: Vec<CommandBuffer>,
        descriptors: Descriptors,
        timeline: Timeline,
    ) -> Result<Self, Error> {
        let mut recorder = Self::onto(device, Timestamps::default());
        recorder.pool = pool;
        recorder.free = parts.into_iter().map(|part| part.commands).collect();
        recorder.descriptors = descriptors;
        recorder.timeline = Some(timeline);
        recorder.begin_part(false)?;
        Ok(recorder)
    }

    fn onto(device: &Arc<Device>, timestamps: Timestamps) -> Self {
        Self {
            device: device.clone(),
            pool: vk::CommandPool::null(),
            parts: Vec::new(),
            free: Vec::new(),
            timeline: None,
            descriptors: Descriptors::new(device),
            keep: Vec::new(),
            timestamps,
            in_condition: false,
            completion: None,
        }
    }

    /// Goes on in a new command buffer, submitted with the others and waited for by itself: it sees all that came before it,
    /// and the host, once it is done, all that was written.
    pub(crate) fn next_part(&mut self) -> Result<(), Error> {
        self.end_part()?;
        self.begin_part(false)
    }

    /// Goes on in a command buffer that is submitted only if it is [wanted](Recording::run_first) once what comes before is
    /// done; so far the host sees all that was copied for it.
    pub(crate) fn next_part_if_wanted(&mut self) -> Result<(), Error> {
        self.end_part()?;
        self.begin_part(true)
    }

    /// Goes on in a command buffer whose passes the device leaves out where a word of a buffer, at a byte offset, is not zero once what comes
    /// before is done; where it cannot, in one that is submitted only if it is wanted.
    pub(crate) fn next_part_unless(&mut self, (buffer, offset): (&Arc<Buffer>, u64)) -> Result<(), Error> {
        let device = self.device.clone();
        let Some(conditional) = &device.conditional else { return self.next_part_if_wanted() };
        self.next_part()?;
        self.memory_barrier(
            (vk::PipelineStageFlags2::COMPUTE_SHADER, vk::AccessFlags2::SHADER_STORAGE_WRITE),
            (vk::PipelineStageFlags2::CONDITIONAL_RENDERING_EXT, vk::AccessFlags2::CONDITIONAL_RENDERING_READ_EXT),
        );
        let begin = vk::ConditionalRenderingBeginInfoEXT::default()
            .buffer(buffer.handle)
            .offset(offset)
            .flags(vk::ConditionalRenderingFlagsEXT::INVERTED);
        // SAFETY: the part is being recorded; the word lies within the buffer, which is for conditions and kept alive.
        unsafe { (conditional.fp().cmd_begin_conditional_rendering_ext)(self.part(), &begin) };
        self.keep.push(buffer.clone());
        self.in_condition = true;
        Ok(())
    }

    /// Whether the device leaves parts out by itself.
    pub(crate) fn is_conditional(&self) -> bool {
        self.device.conditional.is_some()
    }

    fn begin_part(&mut self, optional: bool) -> Result<(), Error> {
        if self.completion.is_some() {
            self.barrier();
            return Ok(());
        }
        let commands = match self.free.pop() {
            Some(commands) => commands,
            None => self.allocate()?,
        };
        self.parts.push(CommandBuffer { commands, optional });
        // SAFETY: the command buffer is new, or its pool was reset.
        let begun =
            unsafe { self.device.handle.begin_command_buffer(self.part(), &vk::CommandBufferBeginInfo::default()) };
        self.device.check("vkBeginCommandBuffer", begun)?;
        // Which parts came before, if any, is not known here.
        self.barrier();
        Ok(())
    }

    fn allocate(&self) -> Result<vk::CommandBuffer, Error> {
        let create = vk::CommandBufferAllocateInfo::default()
            .command_pool(self.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: the pool belongs to this device and to this recorder alone.
        let buffers = unsafe { self.device.handle.allocate_command_buffers(&create) };
        Ok(self.device.check("vkAllocateCommandBuffers", buffers)?[0])
    }

    fn end_part(&mut self) -> Result<(), Error> {
        if let (true, Some(conditional)) = (std::mem::take(&mut self.in_condition), &self.device.conditional) {
            // SAFETY: the part is being recorded, and a condition was begun in it.
            unsafe { (conditional.fp().cmd_end_conditional_rendering_ext)(self.part()) };
        }
        self.host_barrier();
        if self.completion.is_some() {
            return Ok(());
        }
        self.timestamps.end_part(self.part());
        // SAFETY: the last part is being recorded.
        let ended = unsafe { self.device.handle.end_command_buffer(self.part()) };
        self.device.check("vkEndCommandBuffer", ended)
    }

    pub(super) fn part(&self) -> vk::CommandBuffer {
        self.parts.last().map(|part| part.commands).unwrap_or_default()
    }

    pub(super) fn device(&self) -> &ash::Device {
        &self.device.handle
    }

    pub(super) fn family(&self) -> u32 {
        self.device.physical.queue_family
    }

    /// Keeps what is recorded alive for as long as the recording.
    pub(super) fn keep(&mut self, used: Arc<dyn Any + Send + Sync>) {
        self.keep.push(used);
    }

    /// Makes new images ready for passes; their contents stay undefined.
    pub(crate) fn prepare(&mut self, images: &[&Arc<Image>]) {
        let barriers: Vec<_> = images
            .iter()
            .map(|image| {
                vk::ImageMemoryBarrier2::default()
                    .src_stage_mask(vk::PipelineStageFlags2::NONE)
                    .dst_stage_mask(vk::PipelineStageFlags2::COMPUTE_SHADER | vk::PipelineStageFlags2::TRANSFER)
                    .dst_access_mask(
                        vk::AccessFlags2::SHADER_STORAGE_READ
                            | vk::AccessFlags2::SHADER_STORAGE_WRITE
                            | vk::AccessFlags2::TRANSFER_READ
                            | vk::AccessFlags2::TRANSFER_WRITE,
                    )
                    .old_layout(vk::ImageLayout::UNDEFINED)
                    .new_layout(vk::ImageLayout::GENERAL)
                    .image(image.handle)
                    .subresource_range(image.whole())
            })
            .collect();
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: the part is being recorded, and the images are kept alive below.
        unsafe { self.device.handle.cmd_pipeline_barrier2(self.part(), &dependency) };
        for &image in images {
            self.keep.push(image.clone());
        }
    }

    /// Records one pass.
    pub(crate) fn pass(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
        constants: &[u8],
        groups: Groups<'_>,
    ) -> Result<(), Error> {
        assert_eq!(constants.len(), pipeline.constant_bytes, "push constants of {}", pipeline.name);
        let set = self.descriptors.set(pipeline, resources)?;
        let part = self.part();
        self.timestamps.before(part, pipeline.name);
        let device = &self.device.handle;
        // SAFETY: the part is being recorded; pipeline, set and buffers belong to this device and are kept alive by `descriptors` and `keep`; the
        // constants fill the layout's range exactly.
        unsafe {
            device.cmd_bind_pipeline(part, vk::PipelineBindPoint::COMPUTE, pipeline.handle);
            device.cmd_bind_descriptor_sets(part, vk::PipelineBindPoint::COMPUTE, pipeline.layout, 0, &[set], &[]);
            if !constants.is_empty() {
                device.cmd_push_constants(part, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, constants);
            }
            match groups {
                Groups::Direct([x, y, z]) => device.cmd_dispatch(part, x, y, z),
                Groups::Indirect(buffer, offset) => device.cmd_dispatch_indirect(part, buffer.handle, offset),
            }
        }
        if let Groups::Indirect(buffer, _) = groups {
            self.keep.push(buffer.clone());
        }
        Ok(())
    }

    /// All that passes and copies wrote before is visible to those after it, and to indirect dispatch; what they read may be
    /// written.
    pub(crate) fn barrier(&mut self) {
        let work = vk::PipelineStageFlags2::COMPUTE_SHADER | vk::PipelineStageFlags2::TRANSFER;
        let writes = vk::AccessFlags2::SHADER_STORAGE_WRITE | vk::AccessFlags2::TRANSFER_WRITE;
        let reads = vk::AccessFlags2::SHADER_STORAGE_READ
            | vk::AccessFlags2::TRANSFER_READ
            | vk::AccessFlags2::INDIRECT_COMMAND_READ;
        self.memory_barrier((work, writes), (work | vk::PipelineStageFlags2::DRAW_INDIRECT, reads | writes));
    }

    pub(super) fn memory_barrier(
        &self,
        (from_stage, from_access): (vk::PipelineStageFlags2, vk::AccessFlags2),
        (to_stage, to_access): (vk::PipelineStageFlags2, vk::AccessFlags2),
    ) {
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(from_stage)
            .src_access_mask(from_access)
            .dst_stage_mask(to_stage)
            .dst_access_mask(to_access)];
        let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: the part is being recorded.
        unsafe { self.device.handle.cmd_pipeline_barrier2(self.part(), &dependency) };
    }

    /// Copies a buffer from a byte offset on to the same place of another.
    pub(crate) fn copy(&mut self, from: &Arc<Buffer>, to: &Arc<Buffer>, offset: u64) {
        let size = from.size().min(to.size()) - offset;
        let region = [vk::BufferCopy { src_offset: offset, dst_offset: offset, size }];
        // SAFETY: the part is being recorded; the region lies within both buffers, which are kept alive.
        unsafe { self.device.handle.cmd_copy_buffer(self.part(), from.handle, to.handle, &region) };
        self.keep.push(from.clone());
        self.keep.push(to.clone());
    }

    /// Zero in every pixel of an image.
    pub(crate) fn clear(&mut self, image: &Arc<Image>) {
        let ranges = [image.whole()];
        // SAFETY: the part is being recorded; the image is in the general layout and kept alive.
        unsafe {
            self.device.handle.cmd_clear_color_image(
                self.part(),
                image.handle,
                vk::ImageLayout::GENERAL,
                &vk::ClearColorValue { float32: [0.0; 4] },
                &ranges,
            );
        }
        self.keep.push(image.clone());
    }

    /// Zero in the first bytes of a buffer, a multiple of 4.
    pub(crate) fn zero(&mut self, buffer: &Arc<Buffer>, bytes: u64) {
        assert!(bytes.is_multiple_of(4) && bytes <= buffer.size(), "{bytes} bytes of a buffer of {}", buffer.size());
        // SAFETY: the part is being recorded; the range lies within the buffer, which is kept alive.
        unsafe { self.device.handle.cmd_fill_buffer(self.part(), buffer.handle, 0, bytes, 0) };
        self.keep.push(buffer.clone());
    }

    /// Layers of an image as they stand in a buffer.
    fn image_region(image: &Image, layers: Range<u32>) -> vk::BufferImageCopy {
        debug_assert!(layers.end <= image.layers);
        vk::BufferImageCopy::default()
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: 0,
                base_array_layer: layers.start,
                layer_count: layers.end - layers.start,
            })
            .image_extent(vk::Extent3D { width: image.width, height: image.height, depth: 1 })
    }

    /// Brings layers of an image down into a buffer.
    pub(crate) fn download(&mut self, image: &Arc<Image>, layers: Range<u32>, to: &Arc<Buffer>) {
        let region = [Self::image_region(image, layers)];
        // SAFETY: the part is being recorded; the image is in the general layout, the buffer holds all its layers, and both
        // are kept alive.
        unsafe {
            self.device.handle.cmd_copy_image_to_buffer(
                self.part(),
                image.handle,
                vk::ImageLayout::GENERAL,
                to.handle,
                &region,
            );
        }
        self.keep.push(image.clone());
        self.keep.push(to.clone());
    }

    /// Fills an image from a buffer.
    pub(crate) fn upload(&mut self, from: &Arc<Buffer>, image: &Arc<Image>) {
        let region = [Self::image_region(image, 0..image.layers)];
        // SAFETY: as for `download`.
        unsafe {
            self.device.handle.cmd_copy_buffer_to_image(
                self.part(),
                from.handle,
                image.handle,
                vk::ImageLayout::GENERAL,
                &region,
            );
        }
        self.keep.push(image.clone());
        self.keep.push(from.clone());
    }

    /// What was copied so far is visible to the host once the part is done.
    fn host_barrier(&mut self) {
        self.memory_barrier(
            (
                vk::PipelineStageFlags2::TRANSFER | vk::PipelineStageFlags2::COMPUTE_SHADER,
                vk::AccessFlags2::TRANSFER_WRITE | vk::AccessFlags2::SHADER_STORAGE_WRITE,
            ),
            (vk::PipelineStageFlags2::HOST, vk::AccessFlags2::HOST_READ),
        );
    }

    /// Ends the recording; what was written is visible to the host once it is done.
    pub(crate) fn finish(mut self) -> Result<Recording, Error> {
        self.end_part()?;
        if let Some(completion) = self.completion.take() {
            // After all that the host reads is visible to it.
            self.memory_barrier(
                (
                    vk::PipelineStageFlags2::TRANSFER | vk::PipelineStageFlags2::COMPUTE_SHADER,
                    vk::AccessFlags2::TRANSFER_WRITE | vk::AccessFlags2::SHADER_STORAGE_WRITE,
                ),
                (
                    vk::PipelineStageFlags2::HOST | vk::PipelineStageFlags2::TRANSFER,
                    vk::AccessFlags2::HOST_READ | vk::AccessFlags2::TRANSFER_WRITE,
                ),
            );
            self.set_completion(&completion, Self::DONE);
            self.host_barrier();
        }
        let timestamps = std::mem::take(&mut self.timestamps);
        Recording::new(
            &self.device,
            std::mem::take(&mut self.pool),
            std::mem::take(&mut self.parts),
            std::mem::replace(&mut self.descriptors, Descriptors::new(&self.device)),
            std::mem::take(&mut self.keep),
            timestamps,
            self.timeline.take(),
        )
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Empty after `finish`; otherwise recording failed, and nothing was submitted.
        // SAFETY: nothing recorded here is in use; destroying null handles does nothing.
        unsafe {
            self.device
                .handle
                .destroy_semaphore(self.timeline.take().map_or(vk::Semaphore::null(), |t| t.semaphore), None);
            self.device.handle.destroy_command_pool(self.pool, None);
        }
    }
}
