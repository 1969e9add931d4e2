//! Buffers and images, each with a debug name and its own allocation.

use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::device::{Device, MIB};
use super::instance::vulkan_error;
use crate::base::Error;

/// The format of an image's texels.
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

    /// Images of one float per texel also have a view of words.
    fn flags(self) -> vk::ImageCreateFlags {
        match self {
            Texel::One => vk::ImageCreateFlags::MUTABLE_FORMAT,
            Texel::FourHalf => vk::ImageCreateFlags::empty(),
        }
    }

    /// Returns the number of floats per texel.
    #[cfg(test)]
    pub(crate) fn floats(self) -> usize {
        match self {
            Texel::One => 1,
            Texel::FourHalf => 4,
        }
    }
}

/// The usage of every image: shaders read and write it, and copies read and write it.
const IMAGE_USAGE: vk::ImageUsageFlags = vk::ImageUsageFlags::from_raw(
    vk::ImageUsageFlags::STORAGE.as_raw()
        | vk::ImageUsageFlags::TRANSFER_SRC.as_raw()
        | vk::ImageUsageFlags::TRANSFER_DST.as_raw(),
);

/// A storage buffer. A host-visible one is mapped while it lives.
pub(crate) struct Buffer {
    pub(super) handle: vk::Buffer,
    size: u64,
    location: MemoryLocation,
    /// Whether the host borrows the contents in place, so that it must not write them.
    is_host_borrowed: bool,
    /// Locked while the host writes.
    host_write: Mutex<()>,
    allocation: ManuallyDrop<Allocation>,
    device: Arc<Device>,
}

/// A 2D array image of `layers` layers of `width` x `height` texels.
pub(crate) struct Image {
    pub(super) handle: vk::Image,
    pub(super) view: vk::ImageView,
    /// The view of texels of one float as words; null for other texels.
    pub(super) words: vk::ImageView,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) layers: u32,
    #[cfg(test)]
    pub(crate) texel: Texel,
    allocation: ManuallyDrop<Allocation>,
    device: Arc<Device>,
}

/// Returns the size in bytes of the largest image of one float per texel, and the largest number of layers.
pub(crate) fn image_limits(device: &Device) -> Result<(u64, u32), Error> {
    // SAFETY: the physical device belongs to this instance.
    let limits = unsafe {
        device.instance.handle.get_physical_device_image_format_properties(
            device.physical.handle,
            Texel::One.format(),
            vk::ImageType::TYPE_2D,
            vk::ImageTiling::OPTIMAL,
            IMAGE_USAGE,
            Texel::One.flags(),
        )
    };
    let limits = device.check("vkGetPhysicalDeviceImageFormatProperties", limits)?;
    Ok((limits.max_resource_size, limits.max_array_layers))
}

impl Buffer {
    /// Creates a device-local buffer.
    pub(crate) fn device_local(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        Self::new(device, name, size, MemoryLocation::GpuOnly)
    }

    /// Creates a mapped buffer that the host writes and never reads: in the device's memory where the host can write
    /// there, which reads a bus, uncached.
    pub(crate) fn for_upload(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        Self::new(device, name, size, MemoryLocation::CpuToGpu)
    }

    /// Creates a mapped buffer that the host copies from, in the host's cached memory. The host may write it too.
    pub(crate) fn for_readback(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        Self::new(device, name, size, MemoryLocation::GpuToCpu)
    }

    /// Creates a mapped buffer whose contents the host borrows in place.
    pub(crate) fn for_borrowed_readback(device: &Arc<Device>, name: &str, size: u64) -> Result<Arc<Self>, Error> {
        let mut buffer = Self::create(device, name, size, MemoryLocation::GpuToCpu)?;
        buffer.is_host_borrowed = true;
        Ok(Arc::new(buffer))
    }

    fn new(device: &Arc<Device>, name: &str, size: u64, location: MemoryLocation) -> Result<Arc<Self>, Error> {
        Self::create(device, name, size, location).map(Arc::new)
    }

    fn create(device: &Arc<Device>, name: &str, size: u64, location: MemoryLocation) -> Result<Self, Error> {
        // Shaders read whole 32-bit words.
        let size = size.next_multiple_of(4).max(4);
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST
            | match device.is_conditional() {
                true => vk::BufferUsageFlags::CONDITIONAL_RENDERING_EXT,
                false => vk::BufferUsageFlags::empty(),
            };
        let create = vk::BufferCreateInfo::default().size(size).usage(usage);
        // SAFETY: the size is not zero, and the usage flags of an extension are set only if the device has it.
        let handle = device.check("vkCreateBuffer", unsafe { device.handle.create_buffer(&create, None) })?;
        device.name(handle, name);
        // SAFETY: the buffer belongs to this device.
        let requirements = unsafe { device.handle.get_buffer_memory_requirements(handle) };
        let allocation = allocate(device, name, requirements, location, true).inspect_err(|_| {
            // SAFETY: the buffer was never used.
            unsafe { device.handle.destroy_buffer(handle, None) };
        })?;
        // SAFETY: the allocator chose memory and offset for these requirements, and no memory is bound yet.
        let bound = unsafe { device.handle.bind_buffer_memory(handle, allocation.memory(), allocation.offset()) };
        let buffer = Self {
            handle,
            size,
            location,
            is_host_borrowed: false,
            host_write: Mutex::new(()),
            allocation: ManuallyDrop::new(allocation),
            device: device.clone(),
        };
        device.check("vkBindBufferMemory", bound)?;
        Ok(buffer)
    }

    /// Returns the size in bytes.
    pub(crate) fn size(&self) -> u64 {
        self.size
    }

    /// Copies `bytes` to the start of a mapped buffer.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<(), Error> {
        assert!(bytes.len() as u64 <= self.size, "{} bytes for a buffer of {}", bytes.len(), self.size);
        self.write_with(&mut |mapped| mapped[..bytes.len()].copy_from_slice(bytes))
    }

    /// Passes the contents of a mapped buffer to `write`.
    pub(crate) fn write_with(&self, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        assert!(!self.is_host_borrowed, "the host writes a buffer that it borrows");
        let Some(mapped) = self.allocation.mapped_ptr() else { return Err(self.not_mapped()) };
        let _guard = self.host_write.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the mapping has the size of the buffer. The lock excludes other host writes, and borrowed buffers are
        // refused above. A solver waits for the submissions that read the buffer before it writes again.
        let bytes = unsafe { std::slice::from_raw_parts_mut(mapped.as_ptr().cast::<u8>(), self.size as usize) };
        write(bytes);
        Ok(())
    }

    /// Stores a 32-bit word at a byte offset of a mapped buffer, atomically. A pending shader that reads the word sees
    /// the old value or the new one.
    pub(crate) fn store_word(&self, offset: u64, word: u32) -> Result<(), Error> {
        assert!(!self.is_host_borrowed, "the host writes a buffer that it borrows");
        let _guard = self.host_write.lock().unwrap_or_else(PoisonError::into_inner);
        self.word(offset).map(|target| target.store(word, Ordering::Release))
    }

    /// Reads a word of a mapped buffer at a byte offset, which the device may be writing.
    pub(crate) fn load_word(&self, offset: u64) -> Result<u32, Error> {
        self.word(offset).map(|word| word.load(Ordering::Acquire))
    }

    fn word(&self, offset: u64) -> Result<&AtomicU32, Error> {
        assert!(offset.is_multiple_of(4) && offset + 4 <= self.size, "no word at {offset}");
        let mapped = self.allocation.mapped_ptr().ok_or_else(|| self.not_mapped())?;
        // SAFETY: the word lies within the mapping and is aligned, since mappings are aligned to more than a word. Host
        // writes of other kinds hold the lock, and shaders accept either value.
        Ok(unsafe { AtomicU32::from_ptr(mapped.as_ptr().cast::<u8>().add(offset as usize).cast::<u32>()) })
    }

    /// Borrows the contents of a mapped buffer.
    pub(crate) fn mapped_floats(&self) -> Result<&[f32], Error> {
        assert!(self.is_host_borrowed, "the buffer is not for borrowed readback");
        Ok(bytemuck::cast_slice(
            self.allocation
                .mapped_slice()
                .map(|bytes| &bytes[..self.size as usize])
                .ok_or_else(|| self.not_mapped())?,
        ))
    }

    /// Copies `count` values from a byte offset of a buffer for readback.
    pub(crate) fn read<T: bytemuck::Pod>(&self, offset: usize, count: usize) -> Result<Vec<T>, Error> {
        assert!(self.location == MemoryLocation::GpuToCpu, "the host reads a buffer for upload, which is not cached");
        let bytes = self.allocation.mapped_slice().ok_or_else(|| self.not_mapped())?;
        Ok(bytemuck::pod_collect_to_vec(&bytes[offset..offset + count * size_of::<T>()]))
    }

    fn not_mapped(&self) -> Error {
        vulkan_error("mapping a buffer", &self.device.info().name, vk::Result::ERROR_MEMORY_MAP_FAILED)
    }
}

impl Image {
    /// Creates an image with undefined contents. [`Recorder::initialize`](super::Recorder::initialize) must precede its
    /// use.
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
            .flags(texel.flags())
            .extent(vk::Extent3D { width, height, depth: 1 })
            .mip_levels(1)
            .array_layers(layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(IMAGE_USAGE);
        // SAFETY: the plan has checked the size against the limits of the device.
        let handle = device.check("vkCreateImage", unsafe { device.handle.create_image(&create, None) })?;
        device.name(handle, name);
        // SAFETY: the image belongs to this device.
        let requirements = unsafe { device.handle.get_image_memory_requirements(handle) };
        let allocation = allocate(device, name, requirements, MemoryLocation::GpuOnly, false).inspect_err(|_| {
            // SAFETY: the image was never used.
            unsafe { device.handle.destroy_image(handle, None) };
        })?;
        // SAFETY: the allocator chose memory and offset for these requirements, and no memory is bound yet.
        let bound = unsafe { device.handle.bind_image_memory(handle, allocation.memory(), allocation.offset()) };
        let mut image = Self {
            handle,
            view: vk::ImageView::null(),
            words: vk::ImageView::null(),
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
            .subresource_range(image.all_layers());
        // SAFETY: the image is bound and belongs to this device.
        image.view = device.check("vkCreateImageView", unsafe { device.handle.create_image_view(&create, None) })?;
        if texel == Texel::One {
            let create = create.format(vk::Format::R32_UINT);
            // SAFETY: as above. The image is mutable, and both formats are of 32 bits.
            let words = unsafe { device.handle.create_image_view(&create, None) };
            image.words = device.check("vkCreateImageView", words)?;
        }
        Ok(Arc::new(image))
    }

    pub(super) fn all_layers(&self) -> vk::ImageSubresourceRange {
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
        call: format!("allocating {:.1} MiB for {name}", requirements.size as f64 / MIB as f64),
        device: device.info().name.clone(),
        result: e.to_string(),
        advice: "; use smaller images, or free memory on the device",
    })
}

/// Frees an allocation.
fn free(device: &Device, allocation: &mut ManuallyDrop<Allocation>) {
    // SAFETY: only the owner's `drop` calls this, once, and does not use the allocation again.
    let allocation = unsafe { ManuallyDrop::take(allocation) };
    // Fails only for an allocation of another allocator.
    let _ = device.allocator().free(allocation);
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: recordings retain the buffers that they use and are complete, so that the device no longer uses this
        // one.
        unsafe { self.device.handle.destroy_buffer(self.handle, None) };
        free(&self.device, &mut self.allocation);
    }
}

impl Drop for Image {
    fn drop(&mut self) {
        if self.device.is_in_use() {
            return;
        }
        // SAFETY: recordings retain the images that they use and are complete; destroying a null view has no effect.
        unsafe {
            self.device.handle.destroy_image_view(self.view, None);
            self.device.handle.destroy_image_view(self.words, None);
            self.device.handle.destroy_image(self.handle, None);
        }
        free(&self.device, &mut self.allocation);
    }
}
