//! Recording of dispatches, copies and barriers into command buffers. The caller decides where barriers are needed.

use std::any::Any;
use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::interop::ExternalCommandBuffer;
use super::memory::{Buffer, Image};
use super::pipeline::{DescriptorSets, Pipeline, Resource};
use super::recording::{RecordedPart, Recording, Reusable, Timeline};
use super::timestamps::{Clock, Timestamps};
use crate::base::Error;

/// The stages of dispatches and copies.
const WORK: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::from_raw(
    vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw() | vk::PipelineStageFlags2::TRANSFER.as_raw(),
);
const WRITES: vk::AccessFlags2 = vk::AccessFlags2::from_raw(
    vk::AccessFlags2::SHADER_STORAGE_WRITE.as_raw() | vk::AccessFlags2::TRANSFER_WRITE.as_raw(),
);
const READS: vk::AccessFlags2 = vk::AccessFlags2::from_raw(
    vk::AccessFlags2::SHADER_STORAGE_READ.as_raw() | vk::AccessFlags2::TRANSFER_READ.as_raw(),
);

/// The number of workgroups of a dispatch, along x, y and z.
#[derive(Clone, Copy)]
pub(crate) enum Workgroups<'a> {
    Direct([u32; 3]),
    /// Read from a buffer, at a byte offset.
    Indirect(&'a Arc<Buffer>, u64),
}

/// Records commands into the command buffers of a [`Recording`], one per part.
pub(crate) struct Recorder {
    device: Arc<Device>,
    pool: vk::CommandPool,
    parts: Vec<RecordedPart>,
    /// Command buffers of the pool in the initial state.
    unused: Vec<vk::CommandBuffer>,
    /// The timeline of the recording, if it is not a new one.
    timeline: Option<Timeline>,
    descriptors: DescriptorSets,
    /// The objects that the commands use.
    retained: Vec<Arc<dyn Any + Send + Sync>>,
    timestamps: Timestamps,
    /// The condition of the current part, if the device skips parts.
    part_condition: Option<Condition>,
    /// Whether conditional rendering is active.
    in_condition: bool,
    /// If the commands go to one command buffer of the embedding program, which begins and ends it: the word that says
    /// that it was executed to its end.
    completion: Option<Arc<Buffer>>,
}

/// A word of a buffer that decides whether the device executes dispatches.
#[derive(Clone)]
struct Condition {
    buffer: Arc<Buffer>,
    /// Of the word, bytes.
    offset: u64,
    /// Whether they are executed if the word is zero, and not if it is any other.
    if_zero: bool,
}

impl Recorder {
    /// Begins a recording with its first part.
    pub(crate) fn new(device: &Arc<Device>, clock: Clock) -> Result<Self, Error> {
        let mut recorder = Self::empty(device, Timestamps::new(device, clock)?);
        let create = vk::CommandPoolCreateInfo::default().queue_family_index(device.physical.queue_family);
        // SAFETY: the device was created with a queue of this family.
        let pool = unsafe { device.handle.create_command_pool(&create, None) };
        recorder.pool = device.check("vkCreateCommandPool", pool)?;
        recorder.begin_part()?;
        recorder.timestamps.reset(recorder.commands());
        Ok(recorder)
    }

    /// The completion word while commands have not been executed to their end.
    pub(crate) const PENDING: u32 = 0;
    /// The completion word afterwards.
    pub(crate) const COMPLETE: u32 = 1;

    /// Begins a recording of all parts into one command buffer of the embedding program. Each execution sets the
    /// completion word to [`PENDING`](Self::PENDING) first and to [`COMPLETE`](Self::COMPLETE) last.
    pub(crate) fn into_external(
        device: &Arc<Device>,
        commands: ExternalCommandBuffer,
        completion: &Arc<Buffer>,
    ) -> Self {
        let mut recorder = Self::empty(device, Timestamps::default());
        recorder.parts.push(RecordedPart { commands: commands.0, is_optional: false, ends_batch: true });
        recorder.retain(completion.clone());
        recorder.completion = Some(completion.clone());
        recorder.barrier();
        recorder.set_completion(completion, Self::PENDING);
        recorder
    }

    fn set_completion(&self, completion: &Buffer, word: u32) {
        // SAFETY: the command buffer is recording; the word is in the buffer, which is retained.
        unsafe { self.device.handle.cmd_fill_buffer(self.commands(), completion.handle, 0, 4, word) };
    }

    /// Begins a recording with the command pool, the descriptor sets and the timeline of an earlier one, whose runs
    /// must be complete.
    pub(crate) fn reusing(recording: Recording) -> Result<Self, Error> {
        let Reusable { device, pool, commands, descriptors, timeline } = recording.into_reusable()?;
        let mut recorder = Self::empty(&device, Timestamps::default());
        (recorder.pool, recorder.unused, recorder.descriptors) = (pool, commands, descriptors);
        recorder.timeline = Some(timeline);
        recorder.begin_part()?;
        Ok(recorder)
    }

    fn empty(device: &Arc<Device>, timestamps: Timestamps) -> Self {
        Self {
            device: device.clone(),
            pool: vk::CommandPool::null(),
            parts: Vec::new(),
            unused: Vec::new(),
            timeline: None,
            descriptors: DescriptorSets::new(device),
            retained: Vec::new(),
            timestamps,
            part_condition: None,
            in_condition: false,
            completion: None,
        }
    }

    /// Begins another part. It sees all earlier writes. Once a part is complete, the host sees all its writes.
    pub(crate) fn next_part(&mut self) -> Result<(), Error> {
        self.end_part()?;
        self.begin_part()
    }

    /// Begins an optional part. The host decides whether to submit it when the earlier parts are complete
    /// ([`Recording::run_parts`]).
    pub(crate) fn next_optional_part(&mut self) -> Result<(), Error> {
        self.end_part()?;
        let parts = self.parts.len();
        self.begin_part()?;
        self.parts[parts..].iter_mut().for_each(|part| part.is_optional = true);
        Ok(())
    }

    /// Begins a part that the device skips if a word of a buffer, at a byte offset, is not zero when the earlier parts
    /// are complete. Without conditional rendering it is an optional part.
    pub(crate) fn next_part_unless_set(&mut self, (buffer, offset): (&Arc<Buffer>, u64)) -> Result<(), Error> {
        if !self.is_conditional() {
            return self.next_optional_part();
        }
        self.next_part()?;
        self.part_condition = Some(Condition { buffer: buffer.clone(), offset, if_zero: true });
        self.begin_condition(self.part_condition.clone());
        Ok(())
    }

    /// The device skips the following dispatches of the part if a word of a buffer, at a byte offset, is zero; with
    /// `None` those that the part's own condition skips. Devices without conditional rendering skip none.
    ///
    /// The part's condition is then read again. If its level has settled since the part began, it skips the rest of the
    /// part, whose passes have no workgroups by then.
    pub(crate) fn only_if_set(&mut self, word: Option<(&Arc<Buffer>, u64)>) {
        self.end_condition();
        let own = word.map(|(buffer, offset)| Condition { buffer: buffer.clone(), offset, if_zero: false });
        self.begin_condition(own.or_else(|| self.part_condition.clone()));
    }

    fn begin_condition(&mut self, condition: Option<Condition>) {
        let device = self.device.clone();
        let (Some(conditional), Some(Condition { buffer, offset, if_zero })) =
            (&device.conditional_rendering, condition)
        else {
            return;
        };
        self.memory_barrier(
            (vk::PipelineStageFlags2::COMPUTE_SHADER, vk::AccessFlags2::SHADER_STORAGE_WRITE),
            (vk::PipelineStageFlags2::CONDITIONAL_RENDERING_EXT, vk::AccessFlags2::CONDITIONAL_RENDERING_READ_EXT),
        );
        let inverted = if if_zero {
            vk::ConditionalRenderingFlagsEXT::INVERTED
        } else {
            vk::ConditionalRenderingFlagsEXT::empty()
        };
        let begin =
            vk::ConditionalRenderingBeginInfoEXT::default().buffer(buffer.handle).offset(offset).flags(inverted);
        // SAFETY: the command buffer is recording and in no condition; the word lies within the buffer, which has the
        // usage for conditional rendering and is retained.
        unsafe { (conditional.fp().cmd_begin_conditional_rendering_ext)(self.commands(), &begin) };
        self.retain(buffer);
        self.in_condition = true;
    }

    fn end_condition(&mut self) {
        if let (true, Some(conditional)) = (std::mem::take(&mut self.in_condition), &self.device.conditional_rendering)
        {
            // SAFETY: the command buffer is recording, and conditional rendering is active in it.
            unsafe { (conditional.fp().cmd_end_conditional_rendering_ext)(self.commands()) };
        }
    }

    /// Whether the device skips parts by conditional rendering.
    pub(crate) fn is_conditional(&self) -> bool {
        self.device.is_conditional()
    }

    fn begin_part(&mut self) -> Result<(), Error> {
        if self.completion.is_some() {
            self.barrier();
            return Ok(());
        }
        let commands = match self.unused.pop() {
            Some(commands) => commands,
            None => self.allocate()?,
        };
        self.parts.push(RecordedPart { commands, is_optional: false, ends_batch: true });
        // SAFETY: the command buffer is in the initial state.
        let begun =
            unsafe { self.device.handle.begin_command_buffer(self.commands(), &vk::CommandBufferBeginInfo::default()) };
        self.device.check("vkBeginCommandBuffer", begun)?;
        // Orders the part after whichever parts precede it.
        self.barrier();
        Ok(())
    }

    fn allocate(&self) -> Result<vk::CommandBuffer, Error> {
        let create = vk::CommandBufferAllocateInfo::default()
            .command_pool(self.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: the pool belongs to this device, and only this recorder uses it.
        let allocated = unsafe { self.device.handle.allocate_command_buffers(&create) };
        Ok(self.device.check("vkAllocateCommandBuffers", allocated)?[0])
    }

    fn end_part(&mut self) -> Result<(), Error> {
        self.end_condition();
        self.part_condition = None;
        self.host_barrier();
        if self.completion.is_some() {
            return Ok(());
        }
        self.timestamps.end_part(self.commands());
        // SAFETY: the command buffer of the last part is recording.
        let ended = unsafe { self.device.handle.end_command_buffer(self.commands()) };
        self.device.check("vkEndCommandBuffer", ended)
    }

    /// Returns the command buffer of the current part.
    pub(super) fn commands(&self) -> vk::CommandBuffer {
        self.parts.last().map(|part| part.commands).unwrap_or_default()
    }

    pub(super) fn device(&self) -> &ash::Device {
        &self.device.handle
    }

    pub(super) fn queue_family(&self) -> u32 {
        self.device.physical.queue_family
    }

    /// Keeps an object alive as long as the recording.
    pub(super) fn retain(&mut self, used: Arc<dyn Any + Send + Sync>) {
        self.retained.push(used);
    }

    /// Transitions new images to the general layout. Their contents stay undefined.
    pub(crate) fn initialize(&mut self, images: &[&Arc<Image>]) {
        let barriers: Vec<_> = images
            .iter()
            .map(|image| {
                vk::ImageMemoryBarrier2::default()
                    .src_stage_mask(vk::PipelineStageFlags2::NONE)
                    .dst_stage_mask(WORK)
                    .dst_access_mask(READS | WRITES)
                    .old_layout(vk::ImageLayout::UNDEFINED)
                    .new_layout(vk::ImageLayout::GENERAL)
                    .image(image.handle)
                    .subresource_range(image.all_layers())
            })
            .collect();
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: the command buffer is recording, and the images are retained below.
        unsafe { self.device.handle.cmd_pipeline_barrier2(self.commands(), &dependency) };
        for &image in images {
            self.retain(image.clone());
        }
    }

    /// Records a dispatch of a pipeline with its descriptor set and push constants.
    pub(crate) fn dispatch(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
        constants: &[u8],
        workgroups: Workgroups<'_>,
    ) -> Result<(), Error> {
        assert_eq!(constants.len(), pipeline.constant_bytes, "push constants of {}", pipeline.name);
        let set = self.descriptors.get(pipeline, resources)?;
        let commands = self.commands();
        self.timestamps.before_dispatch(commands, pipeline.name);
        let device = &self.device.handle;
        // SAFETY: the command buffer is recording; pipeline, set and buffers belong to this device and are retained;
        // the constants have the size of the layout's range.
        unsafe {
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.handle);
            device.cmd_bind_descriptor_sets(commands, vk::PipelineBindPoint::COMPUTE, pipeline.layout, 0, &[set], &[]);
            if !constants.is_empty() {
                device.cmd_push_constants(commands, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, constants);
            }
            match workgroups {
                Workgroups::Direct([x, y, z]) => device.cmd_dispatch(commands, x, y, z),
                Workgroups::Indirect(buffer, offset) => device.cmd_dispatch_indirect(commands, buffer.handle, offset),
            }
        }
        if let Workgroups::Indirect(buffer, _) = workgroups {
            self.retain(buffer.clone());
        }
        Ok(())
    }

    /// Records a global barrier: earlier writes of dispatches and copies are visible to later ones and to indirect
    /// dispatch, and later ones may write what earlier ones, or conditions, read.
    pub(crate) fn barrier(&mut self) {
        let reads = READS | vk::AccessFlags2::INDIRECT_COMMAND_READ;
        let conditions = match self.is_conditional() {
            true => vk::PipelineStageFlags2::CONDITIONAL_RENDERING_EXT,
            false => vk::PipelineStageFlags2::empty(),
        };
        self.memory_barrier(
            (WORK | conditions, WRITES),
            (WORK | vk::PipelineStageFlags2::DRAW_INDIRECT, reads | WRITES),
        );
    }

    pub(super) fn memory_barrier(
        &self,
        (src_stage, src_access): (vk::PipelineStageFlags2, vk::AccessFlags2),
        (dst_stage, dst_access): (vk::PipelineStageFlags2, vk::AccessFlags2),
    ) {
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(src_stage)
            .src_access_mask(src_access)
            .dst_stage_mask(dst_stage)
            .dst_access_mask(dst_access)];
        let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: the command buffer is recording.
        unsafe { self.device.handle.cmd_pipeline_barrier2(self.commands(), &dependency) };
    }

    /// Copies a buffer, from a byte offset on, to the same offset of another.
    pub(crate) fn copy_buffer(&mut self, from: &Arc<Buffer>, to: &Arc<Buffer>, offset: u64) {
        let size = from.size().min(to.size()) - offset;
        let region = [vk::BufferCopy { src_offset: offset, dst_offset: offset, size }];
        // SAFETY: the command buffer is recording; the region lies within both buffers, which are retained.
        unsafe { self.device.handle.cmd_copy_buffer(self.commands(), from.handle, to.handle, &region) };
        self.retain(from.clone());
        self.retain(to.clone());
    }

    /// Sets every texel of some layers of an image to zero.
    pub(crate) fn clear_image(&mut self, image: &Arc<Image>, layers: Range<u32>) {
        debug_assert!(layers.end <= image.layers);
        let (base_array_layer, layer_count) = (layers.start, layers.end - layers.start);
        let ranges = [vk::ImageSubresourceRange { base_array_layer, layer_count, ..image.all_layers() }];
        // SAFETY: the command buffer is recording; the image is in the general layout and retained.
        unsafe {
            self.device.handle.cmd_clear_color_image(
                self.commands(),
                image.handle,
                vk::ImageLayout::GENERAL,
                &vk::ClearColorValue { float32: [0.0; 4] },
                &ranges,
            );
        }
        self.retain(image.clone());
    }

    /// Sets the first `bytes` bytes of a buffer, a multiple of 4, to zero.
    pub(crate) fn clear_buffer(&mut self, buffer: &Arc<Buffer>, bytes: u64) {
        assert!(bytes.is_multiple_of(4) && bytes <= buffer.size(), "{bytes} bytes of a buffer of {}", buffer.size());
        // SAFETY: the command buffer is recording; the range lies within the buffer, which is retained.
        unsafe { self.device.handle.cmd_fill_buffer(self.commands(), buffer.handle, 0, bytes, 0) };
        self.retain(buffer.clone());
    }

    /// Returns the copy region between layers of an image and the start of a buffer.
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

    pub(crate) fn copy_image_to_buffer(&mut self, image: &Arc<Image>, layers: Range<u32>, to: &Arc<Buffer>) {
        let region = [Self::image_region(image, layers)];
        // SAFETY: the command buffer is recording; the image is in the general layout, the layers fit into the buffer,
        // and both are retained.
        unsafe {
            self.device.handle.cmd_copy_image_to_buffer(
                self.commands(),
                image.handle,
                vk::ImageLayout::GENERAL,
                to.handle,
                &region,
            );
        }
        self.retain(image.clone());
        self.retain(to.clone());
    }

    /// Copies a buffer to all layers of an image.
    pub(crate) fn copy_buffer_to_image(&mut self, from: &Arc<Buffer>, image: &Arc<Image>) {
        let region = [Self::image_region(image, 0..image.layers)];
        // SAFETY: the command buffer is recording; the image is in the general layout, the buffer holds all its layers,
        // and both are retained.
        unsafe {
            self.device.handle.cmd_copy_buffer_to_image(
                self.commands(),
                from.handle,
                image.handle,
                vk::ImageLayout::GENERAL,
                &region,
            );
        }
        self.retain(image.clone());
        self.retain(from.clone());
    }

    /// Makes all earlier writes visible to the host once the part is complete.
    fn host_barrier(&mut self) {
        self.memory_barrier((WORK, WRITES), (vk::PipelineStageFlags2::HOST, vk::AccessFlags2::HOST_READ));
    }

    /// Ends the recording. Once it is complete, the host sees its writes.
    pub(crate) fn finish(mut self) -> Result<Recording, Error> {
        self.end_part()?;
        if let Some(completion) = self.completion.take() {
            // The word is written after the results are visible to the host.
            self.memory_barrier(
                (WORK, WRITES),
                (
                    vk::PipelineStageFlags2::HOST | vk::PipelineStageFlags2::TRANSFER,
                    vk::AccessFlags2::HOST_READ | vk::AccessFlags2::TRANSFER_WRITE,
                ),
            );
            self.set_completion(&completion, Self::COMPLETE);
            self.host_barrier();
        }
        let timestamps = std::mem::take(&mut self.timestamps);
        Recording::new(
            &self.device,
            std::mem::take(&mut self.pool),
            std::mem::take(&mut self.parts),
            std::mem::replace(&mut self.descriptors, DescriptorSets::new(&self.device)),
            std::mem::take(&mut self.retained),
            timestamps,
            self.timeline.take(),
        )
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let timeline = self.timeline.take().map_or(vk::Semaphore::null(), |timeline| timeline.semaphore);
        // SAFETY: both handles are null after `finish`, for which the calls have no effect. Otherwise the command
        // buffers were never submitted, and earlier uses of the semaphore are complete.
        unsafe {
            self.device.handle.destroy_semaphore(timeline, None);
            self.device.handle.destroy_command_pool(self.pool, None);
        }
    }
}
