//! Photographs that are on the device already.

use std::any::Any;
use std::sync::Arc;

use ash::vk;

use super::commands::Recorder;
use super::memory::Buffer;

/// A photograph in memory of the engine's device ([`Source::OnDevice`](crate::frame::Source::OnDevice)): the device fetches it, and its owner may overwrite it
/// once [`Pending::wait_fetched`](crate::Pending::wait_fetched) or [`OnDevice::taken`](super::OnDevice::taken) says so.
#[derive(Clone, Copy, Debug)]
pub struct DeviceSource(Place);

#[derive(Clone, Copy, Debug)]
pub(crate) enum Place {
    Buffer { buffer: vk::Buffer, offset: u64, pitch: u64, is_foreign: bool },
    Image { image: vk::Image, layout: vk::ImageLayout, layer: u32 },
}

impl Place {
    /// Bytes from row to row; 0 without gaps.
    pub(crate) fn pitch(&self) -> u64 {
        if let Self::Buffer { pitch, .. } = self { *pitch } else { 0 }
    }
}

impl DeviceSource {
    /// Rows in a buffer, from a byte on, the start of one `pitch` bytes from that of the next; 0 where they follow one another without a gap.
    ///
    /// # Safety
    /// - The buffer is of the engine's device, may be a source of copies, holds such rows of the solver's format and size, and is of the
    ///   engine's queue family or of all.
    /// - It lives until the pair is solved, and nobody writes those rows from when what is waited for has happened until they are taken.
    pub unsafe fn buffer(buffer: vk::Buffer, offset: u64, pitch: u64) -> Self {
        Self(Place::Buffer { buffer, offset, pitch, is_foreign: false })
    }

    /// A layer of a colour image of the solver's size, whose texels are as its format packs pixels (`Mono8`: `R8_UNORM`; `Mono16`: `R16_UNORM`; `Mono32f`:
    /// `R32_SFLOAT`; `RGBa8`: `R8G8B8A8_UNORM`; `BGRa8`: `B8G8R8A8_UNORM`). It is left in the layout that it is in.
    ///
    /// # Safety
    /// As for [`buffer`](Self::buffer); the image is in this layout by then, which is not undefined.
    pub unsafe fn image(image: vk::Image, layout: vk::ImageLayout, layer: u32) -> Self {
        Self(Place::Image { image, layout, layer })
    }

    pub(crate) fn place(self) -> Place {
        self.0
    }
}

/// A photograph that the device fetches.
pub(crate) struct Fetch {
    pub(crate) place: Place,
    /// Pixels a row, and rows.
    pub(crate) size: [u32; 2],
    /// Bytes of a row, and of all.
    pub(crate) row_bytes: u64,
    pub(crate) bytes: u64,
    /// What the place is of, if it is ours.
    pub(crate) keep: Option<Arc<dyn Any + Send + Sync>>,
}

const ANY: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::ALL_COMMANDS;
const COPY: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::COPY;

impl Recorder {
    /// Copies a photograph to where it is brought, and leaves it as it is for who comes after.
    pub(crate) fn fetch(&mut self, fetch: &Fetch, to: &Arc<Buffer>) {
        // Whoever wrote it did so on this queue before, or is waited for; the host too, which may signal after the submission.
        let writes = vk::AccessFlags2::MEMORY_WRITE | vk::AccessFlags2::HOST_WRITE;
        self.memory_barrier((ANY | vk::PipelineStageFlags2::HOST, writes), (COPY, vk::AccessFlags2::TRANSFER_READ));
        match fetch.place {
            Place::Buffer { buffer, offset, pitch, is_foreign } => {
                let foreign = vk::QUEUE_FAMILY_FOREIGN_EXT;
                if is_foreign {
                    self.hand_over(buffer, foreign, self.family());
                }
                self.fetch_rows(fetch, buffer, offset, pitch, to);
                if is_foreign {
                    self.hand_over(buffer, self.family(), foreign);
                }
            }
            Place::Image { image, layout, layer } => self.fetch_layer(fetch, image, layout, layer, to),
        }
        self.keep(to.clone());
        if let Some(shared) = &fetch.keep {
            self.keep(shared.clone());
        }
    }

    /// A buffer goes from one family of queues to another, one of which is that of another device.
    fn hand_over(&self, buffer: vk::Buffer, from: u32, to: u32) {
        let barrier = [vk::BufferMemoryBarrier2::default()
            .src_stage_mask(COPY)
            .dst_stage_mask(COPY)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)
            .src_queue_family_index(from)
            .dst_queue_family_index(to)
            .buffer(buffer)
            .size(vk::WHOLE_SIZE)];
        let dependency = vk::DependencyInfo::default().buffer_memory_barriers(&barrier);
        // SAFETY: the part is being recorded; the buffer is kept alive, and its other owner has let it go by the contract of `DmaBuf`.
        unsafe { self.device().cmd_pipeline_barrier2(self.part(), &dependency) };
    }

    fn fetch_rows(&self, fetch: &Fetch, buffer: vk::Buffer, offset: u64, pitch: u64, to: &Arc<Buffer>) {
        let whole = pitch == 0 || pitch == fetch.row_bytes;
        let (rows, size) = if whole { (1, fetch.bytes) } else { (fetch.size[1].into(), fetch.row_bytes) };
        let region = |row: u64| vk::BufferCopy { src_offset: offset + row * pitch, dst_offset: row * size, size };
        let regions: Vec<_> = (0..rows).map(region).collect();
        // SAFETY: the part is being recorded; the rows lie within the source, as whoever made it said, and within `to`, which is kept alive.
        unsafe { self.device().cmd_copy_buffer(self.part(), buffer, to.handle, &regions) };
    }

    fn fetch_layer(&self, fetch: &Fetch, image: vk::Image, layout: vk::ImageLayout, layer: u32, to: &Arc<Buffer>) {
        let stays = [vk::ImageLayout::GENERAL, vk::ImageLayout::TRANSFER_SRC_OPTIMAL].contains(&layout);
        let during = if stays { layout } else { vk::ImageLayout::TRANSFER_SRC_OPTIMAL };
        let range = vk::ImageSubresourceRange::default()
            .aspect_mask(vk::ImageAspectFlags::COLOR)
            .level_count(1)
            .base_array_layer(layer)
            .layer_count(1);
        let change = |from, (from_stage, from_access), to, (to_stage, to_access)| {
            let barrier = [vk::ImageMemoryBarrier2::default()
                .src_stage_mask(from_stage)
                .src_access_mask(from_access)
                .dst_stage_mask(to_stage)
                .dst_access_mask(to_access)
                .old_layout(from)
                .new_layout(to)
                .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
                .image(image)
                .subresource_range(range)];
            let dependency = vk::DependencyInfo::default().image_memory_barriers(&barrier);
            // SAFETY: the part is being recorded; the image is in that layout, as whoever made the source said.
            unsafe { self.device().cmd_pipeline_barrier2(self.part(), &dependency) };
        };
        let (any, copy) = ((ANY, vk::AccessFlags2::MEMORY_WRITE), (COPY, vk::AccessFlags2::TRANSFER_READ));
        if !stays {
            change(layout, any, during, copy);
        }
        let [width, height] = fetch.size;
        let region = [vk::BufferImageCopy::default()
            .image_subresource(
                vk::ImageSubresourceLayers::default()
                    .aspect_mask(vk::ImageAspectFlags::COLOR)
                    .base_array_layer(layer)
                    .layer_count(1),
            )
            .image_extent(vk::Extent3D { width, height, depth: 1 })];
        // SAFETY: as above; texels are as the format packs pixels, so that the buffer, which is kept alive, holds them.
        unsafe { self.device().cmd_copy_image_to_buffer(self.part(), image, during, to.handle, &region) };
        if !stays {
            change(during, copy, layout, (ANY, vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE));
        }
    }
}
