//! Buffers and images, each with a name and its own allocation.

use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::device::Device;
use super::failure::failure;
use crate::base::Error;

/// What an image holds in a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Texel {
    /// One 32-bit float.
    One,
    /// Four 16-bit floats.
    FourHalf,
}

impl Texel {
    fn format(self) -> vk::Format {
        match self {
            Texel::One => vk::Format::R32_SFLOAT,
            Texel::FourHalf => vk::Format::R16G16B16A16_SFLOAT,
        }
    }

    /// Floats a pixel.
    #[cfg(test)]
    pub(crate) fn floats(self) -> usize {
        match self {
            Texel::One => 1,
            Texel::FourHalf => 4,
        }
    }
}

/// Every image is read and written by shaders and copied.
const IMAGE_USAGE: vk::ImageUsageFlags = vk::ImageUsageFlags::from_raw(
    vk::ImageUsageFlags::STORAGE.as_raw()
        | vk::ImageUsageFlags::TRANSFER_SRC.as_raw()
        | vk::ImageUsageFlags::TRANSFER_DST.as_raw(),
);

/// A storage buffer; one that the host sees is mapped for as long as it lives.
pub(crate) struct Buffer {
    pub(super) handle: vk::Buffer,
    size: u64,
    /// Whether it is lent to the host where it is, which then does not write it.
    is_lent: bool,
    filling: Mutex<()>,
    allocation: ManuallyDrop<Allocation>,
    device: Arc<Device>,
}

/// An array of `layers` fields of `width` x `height` texels.
pub(crate) struct Image {
    pub(super) handle: vk::Image,
    pub(super) view: vk::ImageView,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) layers: u32,
    #[cfg(test)]
    pub(crate) texel: Texel,
    allocation: ManuallyDrop<Allocation>,
    device: Arc<Device>,
}

/// Bytes of the largest image of one float a texel, and the most layers.
pub(crate) fn image_limits(device: &Device) -> Result<(u64, u32), Error> {
    // SAFETY: the physical device belongs to this instance.
    let found = unsafe {
        device.instance.handle.get_physical_device_image_format_properties(
            device.physical.handle,
            Texel::One.format(),
            vk::ImageType::TYPE_2D,
            vk::ImageTiling::OPTIMAL,
            IMAGE_USAGE,
            vk::ImageCreateFlags::empty(),
        )
    };
    let found = device.check("vkGetPhysicalDeviceImageFormatProperties", found)?;
    Ok((found.max_resource_size, found.max_array_layers))
}

/// Of buffers by which a device leaves commands out.
const CONDITION: vk::BufferUsageFlags = vk::BufferUsageFlags::CONDITIONAL_RENDERING_EXT;

impl Buffer {
    /// A buffer on the device alone.
    pub(crate) fn on_device(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        Self::new(device, name, size, MemoryLocation::GpuOnly)
    }

    /// A mapped buffer that the host fills.
    pub(crate) fn for_upload(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        Self::new(device, name, size, MemoryLocation::CpuToGpu)
    }

    /// A mapped buffer that the host reads.
    pub(crate) fn for_readback(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        Self::new(device, name, size, MemoryLocation::GpuToCpu)
    }

    /// A mapped buffer that the host reads where it is.
    pub(crate) fn lent(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        let mut buffer = Self::of(device, name, size, MemoryLocation::GpuToCpu)?;
        buffer.is_lent = true;
        Ok(Arc::new(buffer))
    }

    fn new(device: &Arc<Device>, name: &str, size: u64, location: MemoryLocation) -> Result<Arc<Self>, Error> {
        Self::of(device, name, size, location).map(Arc::new)
    }

    fn of(device: &Arc<Device>, name: &str, size: u64, location: MemoryLocation) -> Result<Self, Error> {
        // Shaders read whole words, so the last one must be there.
        let size = size.next_multiple_of(4).max(4);
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST
            | device.conditional.as_ref().map_or(vk::BufferUsageFlags::empty(), |_| CONDITION);
        let create = vk::BufferCreateInfo::default().size(size).usage(usage);
        // SAFETY: the device is alive; the size is not zero.
        let handle = device.check("vkCreateBuffer", unsafe { device.handle.create_buffer(&create, None) })?;
        device.name(handle, name);
        // SAFETY: the buffer belongs to this device.
        let requirements = unsafe { device.handle.get_buffer_memory_requirements(handle) };
        let allocation = allocate(device, name, requirements, location, true).inspect_err(|_| {
            // SAFETY: the buffer was never used.
            unsafe { device.handle.destroy_buffer(handle, None) };
        })?;
        // SAFETY: memory and offset come from the allocator for these requirements, and nothing is bound yet.
        let bound = unsafe { device.handle.bind_buffer_memory(handle, allocation.memory(), allocation.offset()) };
        let buffer = Self {
            handle,
            size,
            is_lent: false,
            filling: Mutex::new(()),
            allocation: ManuallyDrop::new(allocation),
            device: device.clone(),
        };
        device.check("vkBindBufferMemory", bound)?;
        Ok(buffer)
    }

    /// Bytes.
    pub(crate) fn size(&self) -> u64 {
        self.size
    }

    /// Writes at the start of a mapped buffer.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<(), Error> {
        assert!(bytes.len() as u64 <= self.size, "{} bytes for a buffer of {}", bytes.len(), self.size);
        self.fill(&mut |mapped| mapped[..bytes.len()].copy_from_slice(bytes))
    }

    /// Has a mapped buffer written that the host fills.
    pub(crate) fn fill(&self, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        assert!(!self.is_lent, "what is lent is not written");
        let Some(mapped) = self.allocation.mapped_ptr() else { return Err(self.not_mapped()) };
        let _alone = self.filling.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the mapping is as long as the buffer. What is lent is never filled, and one thread fills at a time;
        // the device reads what a lane of a solver submitted, and that is waited for before the lane is filled again.
        let bytes = unsafe { std::slice::from_raw_parts_mut(mapped.as_ptr().cast::<u8>(), self.size as usize) };
        write(bytes);
        Ok(())
    }

    /// Writes one word of a mapped buffer, at a byte offset, which the device may be reading: it sees this word or the one before.
    pub(crate) fn signal(&self, offset: u64, word: u32) -> Result<(), Error> {
        assert!(!self.is_lent && offset.is_multiple_of(4) && offset + 4 <= self.size, "a word of what the host writes");
        let Some(mapped) = self.allocation.mapped_ptr() else { return Err(self.not_mapped()) };
        let _alone = self.filling.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the word lies within the mapping and is aligned, since mappings are to more than a word; whoever fills it as bytes holds the
        // lock, and the device takes either value.
        let place = unsafe { AtomicU32::from_ptr(mapped.as_ptr().cast::<u8>().add(offset as usize).cast::<u32>()) };
        place.store(word, Ordering::Release);
        Ok(())
    }

    /// Reads one word of a mapped buffer, at a byte offset, which the device may be writing.
    pub(crate) fn load(&self, offset: u64) -> Result<u32, Error> {
        assert!(offset.is_multiple_of(4) && offset + 4 <= self.size, "a word of the buffer");
        let Some(mapped) = self.allocation.mapped_ptr() else { return Err(self.not_mapped()) };
        // SAFETY: the word lies within the mapping and is aligned, since mappings are to more than a word.
        let word = unsafe { AtomicU32::from_ptr(mapped.as_ptr().cast::<u8>().add(offset as usize).cast::<u32>()) };
        Ok(word.load(Ordering::Acquire))
    }

    /// A mapped buffer that the host reads, where it is.
    pub(crate) fn floats(&self) -> Result<&[f32], Error> {
        assert!(self.is_lent, "only what is for that is lent");
        Ok(bytemuck::cast_slice(
            self.allocation
                .mapped_slice()
                .map(|bytes| &bytes[..self.size as usize])
                .ok_or_else(|| self.not_mapped())?,
        ))
    }

    /// Copies `count` values out of a mapped buffer, from a byte offset.
    pub(crate) fn read<T: bytemuck::Pod>(&self, offset: usize, count: usize) -> Result<Vec<T>, Error> {
        let bytes = self.allocation.mapped_slice().ok_or_else(|| self.not_mapped())?;
        Ok(bytemuck::pod_collect_to_vec(&bytes[offset..offset + count * size_of::<T>()]))
    }

    fn not_mapped(&self) -> Error {
        failure("mapping a buffer", &self.device.info().name, vk::Result::ERROR_MEMORY_MAP_FAILED)
    }
}

impl Image {
    /// An image whose contents are undefined; [`super::Recorder::prepare`] must see it before any pass does.
    pub(crate) fn new(
        device: &Arc<Device>,
        name: &str,
        [width, height]: [u32; 2],
        layers: u32,
        texel: Texel,
    ) -> Result<Arc<Self>, Error> {
        let create = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(texel.format())
            .extent(vk::Extent3D { width, height, depth: 1 })
            .mip_levels(1)
            .array_layers(layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(IMAGE_USAGE);
        // SAFETY: the device is alive; sizes were checked against its limits by the plan.
        let handle = device.check("vkCreateImage", unsafe { device.handle.create_image(&create, None) })?;
        device.name(handle, name);
        // SAFETY: the image belongs to this device.
        let requirements = unsafe { device.handle.get_image_memory_requirements(handle) };
        let allocation = allocate(device, name, requirements, MemoryLocation::GpuOnly, false).inspect_err(|_| {
            // SAFETY: the image was never used.
            unsafe { device.handle.destroy_image(handle, None) };
        })?;
        // SAFETY: memory and offset come from the allocator for these requirements, and nothing is bound yet.
        let bound = unsafe { device.handle.bind_image_memory(handle, allocation.memory(), allocation.offset()) };
        let mut image = Self {
            handle,
            view: vk::ImageView::null(),
            width,
            height,
            layers,
            #[cfg(test)]
            texel,
            allocation: ManuallyDrop::new(allocation),
            device: device.clone(),
        };
        device.check("vkBindImageMemory", bound)?;
        let create = vk::ImageViewCreateInfo::default()
            .image(handle)
            .view_type(vk::ImageViewType::TYPE_2D_ARRAY)
            .format(texel.format())
            .subresource_range(image.whole());
        // SAFETY: the image is bound and belongs to this device.
        image.view = device.check("vkCreateImageView", unsafe { device.handle.create_image_view(&create, None) })?;
        Ok(Arc::new(image))
    }

    pub(super) fn whole(&self) -> vk::ImageSubresourceRange {
        vk::ImageSubresourceRange {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            base_mip_level: 0,
            level_count: 1,
            base_array_layer: 0,
            layer_count: self.layers,
        }
    }
}

fn allocate(
    device: &Device,
    name: &str,
    requirements: vk::MemoryRequirements,
    location: MemoryLocation,
    linear: bool,
) -> Result<Allocation, Error> {
    let desc = AllocationCreateDesc {
        name,
        requirements,
        location,
        linear,
        allocation_scheme: AllocationScheme::GpuAllocatorManaged,
    };
    device.allocator().allocate(&desc).map_err(|e| Error::Vulkan {
        call: format!("allocating {:.1} MiB for {name}", requirements.size as f64 / super::MIB as f64),
        device: device.info().name.clone(),
        result: e.to_string(),
        advice: "; use smaller images, or free memory on the device",
    })
}

/// Gives an allocation back.
fn release(device: &Device, allocation: &mut ManuallyDrop<Allocation>) {
    // SAFETY: called once, from the owner's drop, and the allocation is not touched again.
    let allocation = unsafe { ManuallyDrop::take(allocation) };
    // The allocator refuses only an allocation that is not its own.
    let _ = device.allocator().free(allocation);
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: recordings keep what they use alive and are waited for, so the device no longer uses the buffer.
        unsafe { self.device.handle.destroy_buffer(self.handle, None) };
        release(&self.device, &mut self.allocation);
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: as for `Buffer`; destroying a null view does nothing.
        unsafe {
            self.device.handle.destroy_image_view(self.view, None);
            self.device.handle.destroy_image(self.handle, None);
        }
        release(&self.device, &mut self.allocation);
    }
}
