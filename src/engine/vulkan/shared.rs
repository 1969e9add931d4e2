//! Memory of others that the device reads where it is: that of the host, VK_EXT_external_memory_host, and [dma-bufs](super::dma_buf).

use std::fmt;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
#[cfg(target_os = "linux")]
use super::mapping::Mapping;
use super::source::Place;
use crate::base::Error;

/// Memory of the embedding program that may be read where it is.
#[derive(Clone, Copy, Debug)]
pub struct HostMemory {
    start: NonNull<u8>,
    bytes: usize,
}

impl HostMemory {
    /// So many bytes, one at least.
    ///
    /// # Safety
    /// - They stay mapped, where they are, for as long as what [`Engine::share`](crate::Engine::share) makes of them lives.
    /// - From when a pair that takes rows of them is submitted until they are taken ([`Pending::wait_fetched`](crate::Pending::wait_fetched)), nobody writes
    ///   from the first of those rows to the end of the last.
    pub unsafe fn new(start: NonNull<u8>, bytes: usize) -> Self {
        Self { start, bytes }
    }
}

/// [Memory](HostMemory) of the embedding program, a camera's ring for one, that the device reads where it is, if it can:
/// [`Engine::share`](crate::Engine::share).
pub struct SharedMemory {
    bytes: usize,
    holder: Holder,
    imported: Option<Imported>,
    device: Arc<Device>,
}

/// How the host has it.
pub(super) enum Holder {
    Host(NonNull<u8>),
    #[cfg(target_os = "linux")]
    Mapped(Mapping),
    /// Not at all.
    #[cfg(target_os = "linux")]
    Device,
}

/// How the device has it.
pub(super) struct Imported {
    memory: vk::DeviceMemory,
    buffer: vk::Buffer,
    /// Of the first byte.
    offset: u64,
    /// Whether another device writes it.
    is_foreign: bool,
}

/// What was not imported.
pub(super) struct Refused {
    /// Whether the device took the handle over, and has let it go.
    pub(super) took_over: bool,
}

// SAFETY: it is only read, and nobody writes what is being read: that is the contract of `HostMemory` and of `DmaBuf`.
unsafe impl Send for SharedMemory {}
// SAFETY: likewise.
unsafe impl Sync for SharedMemory {}

impl SharedMemory {
    /// Imports the pages around so many bytes; where the device cannot, the host copies.
    pub(crate) fn new(device: &Arc<Device>, HostMemory { start, bytes }: HostMemory) -> Arc<Self> {
        Self::holding(device, bytes, Holder::Host(start), import(device, start, bytes))
    }

    pub(super) fn holding(device: &Arc<Device>, bytes: usize, holder: Holder, imported: Option<Imported>) -> Arc<Self> {
        Arc::new(Self { bytes, holder, imported, device: device.clone() })
    }

    /// Whether the host copies out of it, since the device cannot read it.
    pub fn is_staged(&self) -> bool {
        self.imported.is_none()
    }

    /// Its size, bytes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Rows from a byte on, where the device finds them.
    pub(crate) fn place(&self, offset: u64, pitch: u64) -> Option<Place> {
        self.imported.as_ref().map(|of| {
            let (offset, is_foreign) = (of.offset + offset, of.is_foreign);
            Place::Buffer { buffer: of.buffer, offset, pitch, is_foreign }
        })
    }

    /// Reads bytes by the host, and no others, which may be written meanwhile; of memory that it does not have, none.
    pub(crate) fn read<T>(&self, bytes: Range<usize>, read: impl FnOnce(&[u8]) -> T) -> T {
        assert!(bytes.start <= bytes.end && bytes.end <= self.bytes, "{bytes:?} of {} bytes", self.bytes);
        let start = match &self.holder {
            Holder::Host(start) => start.as_ptr().cast_const(),
            #[cfg(target_os = "linux")]
            Holder::Mapped(mapping) => {
                mapping.reads(false);
                mapping.start()
            }
            #[cfg(target_os = "linux")]
            Holder::Device => return read(&[]),
        };
        // SAFETY: these bytes are there while this is, and who submits them writes none of them until they are taken.
        let done = read(unsafe { std::slice::from_raw_parts(start.add(bytes.start), bytes.len()) });
        #[cfg(target_os = "linux")]
        if let Holder::Mapped(mapping) = &self.holder {
            mapping.reads(true);
        }
        done
    }

    /// Whether it is of a device.
    pub(crate) fn check(&self, device: &Arc<Device>) -> Result<(), Error> {
        if Arc::ptr_eq(&self.device, device) {
            return Ok(());
        }
        Err(Error::Mismatch(
            "shared memory is of the engine that it was shared with: share it with this one too".into(),
        ))
    }
}

/// The pages around so many bytes of the host.
fn import(device: &Arc<Device>, start: NonNull<u8>, bytes: usize) -> Option<Imported> {
    let host = device.external_host.as_ref()?;
    let page = device.host_alignment() as usize;
    let (address, pages) = (start.as_ptr() as usize, |from: usize| from & !(page - 1));
    let first = pages(address);
    let size = (address.checked_add(bytes)?.checked_add(page - 1).map(pages)? - first) as u64;
    let kind = vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
    // The bytes before the start lie in the same page, which is mapped since the start is.
    let pointer = start.as_ptr().wrapping_sub(address - first).cast::<std::ffi::c_void>();
    let mut told = vk::MemoryHostPointerPropertiesEXT::default();
    // SAFETY: the pointer is to mapped memory of the host, and aligned as the device asks.
    let result =
        unsafe { (host.fp().get_memory_host_pointer_properties_ext)(device.handle.handle(), kind, pointer, &mut told) };
    result.result().ok()?;
    let mut import = vk::ImportMemoryHostPointerInfoEXT::default().handle_type(kind).host_pointer(pointer);
    bind(device, kind, (told.memory_type_bits, size), &mut import, (address - first) as u64).ok()
}

/// A buffer over memory that is imported, of one of these types, and so many bytes.
pub(super) fn bind(
    device: &Arc<Device>,
    kind: vk::ExternalMemoryHandleTypeFlags,
    (types, size): (u32, u64),
    import: &mut impl vk::ExtendsMemoryAllocateInfo,
    offset: u64,
) -> Result<Imported, Refused> {
    let usage = vk::BufferUsageFlags::TRANSFER_SRC;
    let Some(is_alone) = importable(device, kind, usage) else { return Err(Refused { took_over: false }) };
    let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(kind);
    let create = vk::BufferCreateInfo::default().size(size).usage(usage).push_next(&mut external);
    // SAFETY: the device is alive and has the extension; the size is not zero.
    let buffer = unsafe { device.handle.create_buffer(&create, None) }.map_err(|_| Refused { took_over: false })?;
    // SAFETY: the buffer is this device's.
    let needs = unsafe { device.handle.get_buffer_memory_requirements(buffer) };
    let fitting = memory_type(device, types & needs.memory_type_bits, kind).filter(|_| needs.size <= size);
    let memory = fitting.and_then(|memory_type| {
        let mut alone = vk::MemoryDedicatedAllocateInfo::default().buffer(buffer);
        let mut allocate = vk::MemoryAllocateInfo::default().allocation_size(size).memory_type_index(memory_type);
        if is_alone {
            allocate = allocate.push_next(&mut alone);
        }
        // SAFETY: what is imported is there for as long as this lives, by the contracts of `HostMemory` and `DmaBuf`; the type is one of its.
        unsafe { device.handle.allocate_memory(&allocate.push_next(import), None) }.ok()
    });
    let Some(memory) = memory else {
        // SAFETY: the buffer was never used.
        unsafe { device.handle.destroy_buffer(buffer, None) };
        return Err(Refused { took_over: false });
    };
    let imported = Imported { memory, buffer, offset, is_foreign: false };
    // SAFETY: nothing is bound to the buffer yet, which the memory is as large as.
    if unsafe { device.handle.bind_buffer_memory(buffer, memory, 0) }.is_err() {
        imported.free(device);
        return Err(Refused { took_over: true });
    }
    Ok(imported)
}

/// Whether such buffers can be imported, and only into memory of their own.
fn importable(device: &Device, kind: vk::ExternalMemoryHandleTypeFlags, usage: vk::BufferUsageFlags) -> Option<bool> {
    let (instance, physical) = (&device.instance.handle, device.physical.handle);
    let asked = vk::PhysicalDeviceExternalBufferInfo::default().usage(usage).handle_type(kind);
    let mut told = vk::ExternalBufferProperties::default();
    // SAFETY: the physical device is of this instance.
    unsafe { instance.get_physical_device_external_buffer_properties(physical, &asked, &mut told) };
    let features = told.external_memory_properties.external_memory_features;
    let is_alone = features.contains(vk::ExternalMemoryFeatureFlags::DEDICATED_ONLY);
    features.contains(vk::ExternalMemoryFeatureFlags::IMPORTABLE).then_some(is_alone)
}

/// One of these types of memory; of the host's one that needs no flushing, since nobody flushes what a camera writes.
fn memory_type(device: &Device, types: u32, kind: vk::ExternalMemoryHandleTypeFlags) -> Option<u32> {
    // SAFETY: the physical device is of this instance.
    let all = unsafe { device.instance.handle.get_physical_device_memory_properties(device.physical.handle) };
    let is_host = kind == vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
    let wanted = if is_host { vk::MemoryPropertyFlags::HOST_COHERENT } else { vk::MemoryPropertyFlags::empty() };
    // Memory that is coherent for debugging takes a feature that is not switched on.
    let beside = vk::MemoryPropertyFlags::DEVICE_COHERENT_AMD;
    (0..all.memory_type_count).find(|&n| {
        let flags = all.memory_types[n as usize].property_flags;
        types >> n & 1 == 1 && flags.contains(wanted) && !flags.intersects(beside)
    })
}

impl Imported {
    #[cfg(target_os = "linux")]
    pub(super) fn of_another_device(self) -> Self {
        Self { is_foreign: true, ..self }
    }

    fn free(&self, device: &Device) {
        // SAFETY: recordings keep what they use alive and are waited for, so the device no longer uses it.
        unsafe {
            device.handle.destroy_buffer(self.buffer, None);
            device.handle.free_memory(self.memory, None);
        }
    }
}

impl fmt::Debug for SharedMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SharedMemory of {} bytes, staged: {}", self.bytes, self.is_staged())
    }
}

impl Drop for SharedMemory {
    fn drop(&mut self) {
        if let Some(imported) = self.imported.take().filter(|_| !self.device.is_in_use()) {
            imported.free(&self.device);
        }
    }
}
