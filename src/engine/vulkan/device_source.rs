//! Photographs and results in device memory, and the commands that copy photographs.

use std::any::Any;
use std::sync::Arc;

use ash::vk;

use super::memory::Buffer;
use super::recorder::Recorder;
use super::recording::Recording;

/// A photograph in memory of the engine's device ([`Source::OnDevice`](crate::frame::Source::OnDevice)).
///
/// The device copies it. The owner may overwrite it after [`Pending::wait_fetched`](crate::Pending::wait_fetched), or
/// once the semaphore [`DeviceSolution::inputs_read`](super::DeviceSolution::inputs_read) reaches its value.
#[derive(Clone, Copy, Debug)]
pub struct DeviceSource(SourceLocation);

/// Where the device reads a photograph.
#[derive(Clone, Copy, Debug)]
pub(crate) enum SourceLocation {
    /// Rows from the byte `offset` on. `is_foreign`: another device writes the buffer.
    Buffer { buffer: vk::Buffer, offset: u64, pitch: u64, is_foreign: bool },
    /// A layer of an image in the given layout.
    Image { image: vk::Image, layout: vk::ImageLayout, layer: u32 },
}

impl SourceLocation {
    /// Returns the bytes from the start of a row to that of the next, 0 for rows without padding.
    pub(crate) fn pitch(&self) -> u64 {
        if let Self::Buffer { pitch, .. } = self { *pitch } else { 0 }
    }
}

impl DeviceSource {
    /// Rows in a buffer, from the byte `offset` on. `pitch` is the number of bytes from the start of a row to that of
    /// the next, 0 for rows without padding.
    ///
    /// # Safety
    /// - The buffer belongs to the engine's device, has the usage `TRANSFER_SRC`, and holds rows of the solver's format
    ///   and size. The engine's queue family owns it, or its sharing mode is concurrent.
    /// - It lives until the pair is solved. No code writes those rows between the semaphore waits of the pair and the
    ///   end of the copy.
    pub unsafe fn buffer(buffer: vk::Buffer, offset: u64, pitch: u64) -> Self {
        Self(SourceLocation::Buffer { buffer, offset, pitch, is_foreign: false })
    }

    /// A layer of a colour image of the solver's size. It is left in the layout that it is in.
    ///
    /// The image format matches the pixel format: `R8_UNORM` for `Mono8`, `R16_UNORM` for `Mono16`, `R32_SFLOAT` for
    /// `Mono32f`, `R8G8B8A8_UNORM` for `RGBa8`, `B8G8R8A8_UNORM` for `BGRa8`.
    ///
    /// # Safety
    /// As for [`buffer`](Self::buffer). After the semaphore waits the image is in `layout`, which is not `UNDEFINED`.
    pub unsafe fn image(image: vk::Image, layout: vk::ImageLayout, layer: u32) -> Self {
        Self(SourceLocation::Image { image, layout, layer })
    }

    pub(crate) fn location(self) -> SourceLocation {
        self.0
    }
}

/// A copy of a photograph by the device.
pub(crate) struct SourceCopy {
    pub(crate) location: SourceLocation,
    /// Width and height, px.
    pub(crate) size: [u32; 2],
    /// Bytes per row. Rows without padding count as one row.
    pub(crate) row_bytes: u64,
    /// Bytes of the photograph without padding.
    pub(crate) bytes: u64,
    /// The owner of the location, if the engine keeps it alive.
    pub(crate) owner: Option<Arc<dyn Any + Send + Sync>>,
}

const ALL_COMMANDS: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::ALL_COMMANDS;
const COPY: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::COPY;

impl Recorder {
    /// Records the copy of a photograph to a buffer. Its source keeps its queue family and layout.
    pub(crate) fn copy_source(&mut self, copy: &SourceCopy, to: &Arc<Buffer>) {
        // Earlier submissions to this queue, submissions that are waited for, or the host may have written it. The host
        // may also signal the semaphore after this submission.
        let writes = vk::AccessFlags2::MEMORY_WRITE | vk::AccessFlags2::HOST_WRITE;
        let stages = ALL_COMMANDS | vk::PipelineStageFlags2::HOST;
        self.memory_barrier((stages, writes), (COPY, vk::AccessFlags2::TRANSFER_READ));
        match copy.location {
            SourceLocation::Buffer { buffer, offset, pitch, is_foreign } => {
                let foreign = vk::QUEUE_FAMILY_FOREIGN_EXT;
                if is_foreign {
                    self.transfer_ownership(buffer, foreign, self.queue_family());
                }
                self.copy_rows(copy, buffer, offset, pitch, to);
                if is_foreign {
                    self.transfer_ownership(buffer, self.queue_family(), foreign);
                }
            }
            SourceLocation::Image { image, layout, layer } => self.copy_layer(copy, image, layout, layer, to),
        }
        self.retain(to.clone());
        if let Some(owner) = &copy.owner {
            self.retain(owner.clone());
        }
    }

    /// Records a queue family ownership transfer, to or from the foreign queue family of another device.
    fn transfer_ownership(&self, buffer: vk::Buffer, from: u32, to: u32) {
        let barrier = [vk::BufferMemoryBarrier2::default()
            .src_stage_mask(COPY)
            .dst_stage_mask(COPY)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)
            .src_queue_family_index(from)
            .dst_queue_family_index(to)
            .buffer(buffer)
            .size(vk::WHOLE_SIZE)];
        let dependency = vk::DependencyInfo::default().buffer_memory_barriers(&barrier);
        // SAFETY: the command buffer is recording. The buffer is retained, and by the contract of `DmaBuf` the other
        // device does not write it meanwhile.
        unsafe { self.device().cmd_pipeline_barrier2(self.commands(), &dependency) };
    }

    fn copy_rows(&self, copy: &SourceCopy, buffer: vk::Buffer, offset: u64, pitch: u64, to: &Arc<Buffer>) {
        let size = copy.row_bytes;
        let region = |row: u64| vk::BufferCopy { src_offset: offset + row * pitch, dst_offset: row * size, size };
        let regions: Vec<_> = (0..copy.bytes / size).map(region).collect();
        // SAFETY: the command buffer is recording. The rows lie within the source by the contract of its constructor,
        // and within `to`, which is retained.
        unsafe { self.device().cmd_copy_buffer(self.commands(), buffer, to.handle, &regions) };
    }

    fn copy_layer(&self, copy: &SourceCopy, image: vk::Image, layout: vk::ImageLayout, layer: u32, to: &Arc<Buffer>) {
        let is_readable = [vk::ImageLayout::GENERAL, vk::ImageLayout::TRANSFER_SRC_OPTIMAL].contains(&layout);
        let copy_layout = if is_readable { layout } else { vk::ImageLayout::TRANSFER_SRC_OPTIMAL };
        let range = vk::ImageSubresourceRange::default()
            .aspect_mask(vk::ImageAspectFlags::COLOR)
            .level_count(1)
            .base_array_layer(layer)
            .layer_count(1);
        let transition = |old_layout, (src_stage, src_access), new_layout, (dst_stage, dst_access)| {
            let barrier = [vk::ImageMemoryBarrier2::default()
                .src_stage_mask(src_stage)
                .src_access_mask(src_access)
                .dst_stage_mask(dst_stage)
                .dst_access_mask(dst_access)
                .old_layout(old_layout)
                .new_layout(new_layout)
                .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                .image(image)
                .subresource_range(range)];
            let dependency = vk::DependencyInfo::default().image_memory_barriers(&barrier);
            // SAFETY: the command buffer is recording. The image is in the old layout by the contract of
            // `DeviceSource::image`.
            unsafe { self.device().cmd_pipeline_barrier2(self.commands(), &dependency) };
        };
        let read = (COPY, vk::AccessFlags2::TRANSFER_READ);
        if !is_readable {
            transition(layout, (ALL_COMMANDS, vk::AccessFlags2::MEMORY_WRITE), copy_layout, read);
        }
        let [width, height] = copy.size;
        let layers = vk::ImageSubresourceLayers::default()
            .aspect_mask(vk::ImageAspectFlags::COLOR)
            .base_array_layer(layer)
            .layer_count(1);
        let region = [vk::BufferImageCopy::default().image_subresource(layers).image_extent(vk::Extent3D {
            width,
            height,
            depth: 1,
        })];
        // SAFETY: the command buffer is recording. The image format matches the pixel format by the contract of
        // `DeviceSource::image`, so that the layer fits into the buffer, which is retained.
        unsafe { self.device().cmd_copy_image_to_buffer(self.commands(), image, copy_layout, to.handle, &region) };
        if !is_readable {
            let any = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
            transition(copy_layout, read, layout, (ALL_COMMANDS, any));
        }
    }
}

/// The results of a pair in device memory ([`Pending::on_device`](crate::Pending::on_device)).
///
/// The buffer holds planes of f32, row-major and without padding: V, its standard deviation, the residual, and the
/// channels of the fused image, with the units of a [`SolutionRef`](crate::SolutionRef).
///
/// A submission to a queue of the engine's family that waits for `semaphore` to reach `value` may read `buffer`, as a
/// source of copies and as a storage buffer. It must complete before the [`Pending`](crate::Pending) is
/// dropped, and so must a submission that waits for `inputs_read`.
#[derive(Clone, Copy, Debug)]
pub struct DeviceSolution {
    /// A buffer of the engine's device, in host-visible memory that the host also reads.
    pub buffer: vk::Buffer,
    /// The size of the buffer, in bytes.
    pub bytes: u64,
    /// A timeline semaphore.
    pub semaphore: vk::Semaphore,
    /// The value of `semaphore` once the results are written.
    pub value: u64,
    /// The timeline semaphore and its value once the device has read all photographs, which may then be overwritten.
    /// `None` if the host has copied them.
    pub inputs_read: Option<(vk::Semaphore, u64)>,
}

/// The buffer that receives the results of an [encoded](crate::interop::Encoded) pair, in the planes of a
/// [`DeviceSolution`].
#[derive(Clone, Copy, Debug)]
pub struct SolutionBuffer {
    /// A buffer of the engine's device, in host-visible memory that the host also reads.
    pub buffer: vk::Buffer,
    /// The size of the buffer, in bytes.
    pub bytes: u64,
}

impl SolutionBuffer {
    pub(crate) fn new(buffer: &Buffer) -> Self {
        Self { buffer: buffer.handle, bytes: buffer.size() }
    }
}

impl DeviceSolution {
    /// The solution that `solve` writes to a buffer, after `input_copies` has copied the photographs.
    pub(crate) fn new(buffer: &Buffer, solve: &Recording, input_copies: Option<&Recording>) -> Self {
        let (semaphore, value) = solve.completion();
        let inputs_read = input_copies.map(Recording::completion);
        Self { buffer: buffer.handle, bytes: buffer.size(), semaphore, value, inputs_read }
    }
}
