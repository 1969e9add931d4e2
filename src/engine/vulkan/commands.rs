//! Recording passes, copies and barriers. What waits for what is the caller's to know.

use std::any::Any;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::memory::{Buffer, Image};
use super::pipeline::{Kind, Pipeline};
use super::recording::{CommandBuffer, Recording};
use super::timestamps::{Clock, Timestamps};
use crate::base::Error;

/// What a pass binds, in the order of its stage's bindings.
#[derive(Clone, Copy)]
pub(crate) enum Resource<'a> {
    Image(&'a Arc<Image>),
    Buffer(&'a Arc<Buffer>),
    Uniform(&'a Arc<Buffer>),
}

/// How many workgroups a pass runs.
#[derive(Clone, Copy)]
pub(crate) enum Groups<'a> {
    Direct([u32; 3]),
    /// Three numbers in a buffer, at a byte offset.
    Indirect(&'a Arc<Buffer>, u64),
}

/// Descriptor sets that one pool holds; another is made when it is full.
const SETS_PER_POOL: u32 = 128;

/// Writes passes into command buffers.
pub(crate) struct Recorder {
    device: Arc<Device>,
    pool: vk::CommandPool,
    parts: Vec<CommandBuffer>,
    descriptor_pools: Vec<vk::DescriptorPool>,
    sets_left: u32,
    sets: HashMap<(vk::Pipeline, Vec<u64>), vk::DescriptorSet>,
    keep: Vec<Arc<dyn Any + Send + Sync>>,
    timestamps: Timestamps,
    /// Whether the part under way is left out by the device itself.
    in_condition: bool,
}

impl Recorder {
    /// Starts a recording of one part.
    pub(crate) fn new(device: &Arc<Device>, clock: Clock) -> Result<Self, Error> {
        let timestamps = Timestamps::new(device, clock)?;
        let create = vk::CommandPoolCreateInfo::default().queue_family_index(device.physical.queue_family);
        // SAFETY: the family is the device's own.
        let pool = unsafe { device.handle.create_command_pool(&create, None) };
        let pool = device.check("vkCreateCommandPool", pool)?;
        let mut recorder = Self {
            device: device.clone(),
            pool,
            parts: Vec::new(),
            descriptor_pools: Vec::new(),
            sets_left: 0,
            sets: HashMap::new(),
            keep: Vec::new(),
            timestamps,
            in_condition: false,
        };
        recorder.begin_part(false)?;
        recorder.timestamps.reset(recorder.part());
        Ok(recorder)
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

    fn begin_part(&mut self, optional: bool) -> Result<(), Error> {
        let create = vk::CommandBufferAllocateInfo::default()
            .command_pool(self.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: the pool belongs to this device and to this recorder alone.
        let buffers = unsafe { self.device.handle.allocate_command_buffers(&create) };
        let buffers = self.device.check("vkAllocateCommandBuffers", buffers)?;
        self.parts.extend(buffers.into_iter().map(|commands| CommandBuffer { commands, optional }));
        // SAFETY: the command buffer is new.
        let begun =
            unsafe { self.device.handle.begin_command_buffer(self.part(), &vk::CommandBufferBeginInfo::default()) };
        self.device.check("vkBeginCommandBuffer", begun)?;
        // Which parts came before, if any, is not known here.
        self.barrier();
        Ok(())
    }

    fn end_part(&mut self) -> Result<(), Error> {
        if let (true, Some(conditional)) = (std::mem::take(&mut self.in_condition), &self.device.conditional) {
            // SAFETY: the part is being recorded, and a condition was begun in it.
            unsafe { (conditional.fp().cmd_end_conditional_rendering_ext)(self.part()) };
        }
        self.host_barrier();
        self.timestamps.end_part(self.part());
        // SAFETY: the last part is being recorded.
        let ended = unsafe { self.device.handle.end_command_buffer(self.part()) };
        self.device.check("vkEndCommandBuffer", ended)
    }

    fn part(&self) -> vk::CommandBuffer {
        self.parts.last().map(|part| part.commands).unwrap_or_default()
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
        let set = self.descriptor_set(pipeline, resources)?;
        let part = self.part();
        self.timestamps.before(part, pipeline.name);
        let device = &self.device.handle;
        // SAFETY: the part is being recorded; pipeline, set and buffers belong to this device and are kept alive by `keep`; the
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
        self.keep.push(pipeline.clone());
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

    fn memory_barrier(
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
        let timestamps = std::mem::take(&mut self.timestamps);
        Recording::new(
            &self.device,
            std::mem::take(&mut self.pool),
            std::mem::take(&mut self.parts),
            std::mem::take(&mut self.descriptor_pools),
            std::mem::take(&mut self.keep),
            timestamps,
        )
    }

    fn descriptor_set(
        &mut self,
        pipeline: &Arc<Pipeline>,
        resources: &[Resource<'_>],
    ) -> Result<vk::DescriptorSet, Error> {
        let kinds: Vec<_> = resources.iter().map(|r| r.kind()).collect();
        let expected: Vec<_> = pipeline.bindings.iter().map(|b| b.kind).collect();
        assert_eq!(kinds, expected, "resources of {}", pipeline.name);
        let key = (pipeline.handle, resources.iter().map(|r| r.id()).collect::<Vec<_>>());
        if let Some(&set) = self.sets.get(&key) {
            return Ok(set);
        }
        let set = self.allocate_set(pipeline)?;
        for (index, resource) in (0..).zip(resources) {
            self.write_descriptor(set, index, *resource);
        }
        self.sets.insert(key, set);
        Ok(set)
    }

    fn allocate_set(&mut self, pipeline: &Pipeline) -> Result<vk::DescriptorSet, Error> {
        if self.sets_left == 0 {
            // No stage binds more than twelve resources of a kind.
            let sizes = [Kind::Image, Kind::Buffer, Kind::Uniform].map(|kind| vk::DescriptorPoolSize {
                ty: kind.descriptor_type(),
                descriptor_count: 12 * SETS_PER_POOL,
            });
            let create = vk::DescriptorPoolCreateInfo::default().max_sets(SETS_PER_POOL).pool_sizes(&sizes);
            // SAFETY: the device is alive.
            let pool = unsafe { self.device.handle.create_descriptor_pool(&create, None) };
            self.descriptor_pools.push(self.device.check("vkCreateDescriptorPool", pool)?);
            self.sets_left = SETS_PER_POOL;
        }
        self.sets_left -= 1;
        let layouts = [pipeline.set_layout];
        let pool = self.descriptor_pools.last().copied().unwrap_or_default();
        let create = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
        // SAFETY: the pool has room for the set.
        let sets = unsafe { self.device.handle.allocate_descriptor_sets(&create) };
        Ok(self.device.check("vkAllocateDescriptorSets", sets)?[0])
    }

    fn write_descriptor(&mut self, set: vk::DescriptorSet, index: u32, resource: Resource<'_>) {
        let write = vk::WriteDescriptorSet::default()
            .dst_set(set)
            .dst_binding(index)
            .descriptor_type(resource.kind().descriptor_type());
        match resource {
            Resource::Image(image) => {
                let info =
                    [vk::DescriptorImageInfo::default().image_view(image.view).image_layout(vk::ImageLayout::GENERAL)];
                // SAFETY: the set is new and used by no submission; the view is kept alive.
                unsafe { self.device.handle.update_descriptor_sets(&[write.image_info(&info)], &[]) };
                self.keep.push(image.clone());
            }
            Resource::Buffer(buffer) | Resource::Uniform(buffer) => {
                let info = [vk::DescriptorBufferInfo { buffer: buffer.handle, offset: 0, range: vk::WHOLE_SIZE }];
                // SAFETY: the set is new and used by no submission; the buffer is kept alive.
                unsafe { self.device.handle.update_descriptor_sets(&[write.buffer_info(&info)], &[]) };
                self.keep.push(buffer.clone());
            }
        }
    }
}

impl Resource<'_> {
    fn kind(&self) -> Kind {
        match self {
            Resource::Image(_) => Kind::Image,
            Resource::Buffer(_) => Kind::Buffer,
            Resource::Uniform(_) => Kind::Uniform,
        }
    }

    fn id(&self) -> u64 {
        use ash::vk::Handle;
        match self {
            Resource::Image(image) => image.handle.as_raw(),
            Resource::Buffer(buffer) | Resource::Uniform(buffer) => buffer.handle.as_raw(),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Empty after `finish`; otherwise recording failed, and nothing was submitted.
        // SAFETY: nothing recorded here is in use; destroying a null pool does nothing.
        unsafe {
            for &pool in &self.descriptor_pools {
                self.device.handle.destroy_descriptor_pool(pool, None);
            }
            self.device.handle.destroy_command_pool(self.pool, None);
        }
    }
}
