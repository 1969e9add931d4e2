//! Memory of the host that the device reads where it is: VK_EXT_external_memory_host.

use std::fmt;
use std::ptr::NonNull;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::source::Place;
use crate::base::Error;

/// [Memory](HostMemory) of the embedding program, a camera's ring for one, that the device reads where it is, if it can:
/// [`Engine::share`](crate::Engine::share).
pub struct SharedMemory {
    start: NonNull<u8>,
    bytes: usize,
    imported: Option<Imported>,
    device: Arc<Device>,
}

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
    /// - From when a pair that takes rows of them is submitted until they are taken ([`Solver::wait_taken`](crate::Solver::wait_taken)), nobody writes those
    ///   rows.
    pub unsafe fn new(start: NonNull<u8>, bytes: usize) -> Self {
        Self { start, bytes }
    }
}

/// Whole pages around it as the device has them.
struct Imported {
    memory: vk::DeviceMemory,
    buffer: vk::Buffer,
    /// Of the first byte.
    offset: u64,
}

// SAFETY: it is only read, and nobody writes what is being read: that is the contract of `HostMemory`.
unsafe impl Send for SharedMemory {}
// SAFETY: likewise.
unsafe impl Sync for SharedMemory {}

impl SharedMemory {
    /// Imports the pages around so many bytes; where the device cannot, the host copies.
    pub(crate) fn new(device: &Arc<Device>, HostMemory { start, bytes }: HostMemory) -> Arc<Self> {
        let imported = import(device, start, bytes);
        Arc::new(Self { start, bytes, imported, device: device.clone() })
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
        self.imported.as_ref().map(|of| Place::Buffer { buffer: of.buffer, offset: of.offset + offset, pitch })
    }

    /// The bytes, for the host.
    pub(crate) fn host(&self) -> &[u8] {
        // SAFETY: so many bytes are there while this is, and who submits them writes none until they are taken.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.bytes) }
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

fn import(device: &Arc<Device>, start: NonNull<u8>, bytes: usize) -> Option<Imported> {
    let host = device.external_host.as_ref()?;
    let page = device.host_alignment() as usize;
    let (address, pages) = (start.as_ptr() as usize, |from: usize| from & !(page - 1));
    let first = pages(address);
    let size = (address.checked_add(bytes)?.checked_add(page - 1).map(pages)? - first) as u64;
    let offset = (address - first) as u64;
    let kind = vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
    // SAFETY: `offset` bytes before the start lie in the same page, which is mapped since the start is.
    let pointer = unsafe { start.as_ptr().sub(offset as usize) }.cast::<std::ffi::c_void>();
    let mut of_pointer = vk::MemoryHostPointerPropertiesEXT::default();
    // SAFETY: the pointer is to mapped memory of the host, and aligned as the device asks.
    let told = unsafe {
        (host.fp().get_memory_host_pointer_properties_ext)(device.handle.handle(), kind, pointer, &mut of_pointer)
    };
    told.result().ok()?;
    let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(kind);
    let create =
        vk::BufferCreateInfo::default().size(size).usage(vk::BufferUsageFlags::TRANSFER_SRC).push_next(&mut external);
    // SAFETY: the device is alive and has the extension; the size is not zero.
    let buffer = unsafe { device.handle.create_buffer(&create, None) }.ok()?;
    // SAFETY: the buffer is this device's.
    let needs = unsafe { device.handle.get_buffer_memory_requirements(buffer) };
    let memory = bound(device, buffer, (of_pointer.memory_type_bits & needs.memory_type_bits, size), pointer);
    if memory.is_none() || needs.size > size {
        // SAFETY: the buffer was never used; freeing no memory does nothing.
        unsafe {
            device.handle.destroy_buffer(buffer, None);
            device.handle.free_memory(memory.unwrap_or_default(), None);
        }
        return None;
    }
    memory.map(|memory| Imported { memory, buffer, offset })
}

/// Memory of one of these types over the pages, under the buffer.
fn bound(
    device: &Device,
    buffer: vk::Buffer,
    (types, size): (u32, u64),
    pointer: *mut std::ffi::c_void,
) -> Option<vk::DeviceMemory> {
    if types == 0 {
        return None;
    }
    let mut import = vk::ImportMemoryHostPointerInfoEXT::default()
        .handle_type(vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT)
        .host_pointer(pointer);
    let allocate = vk::MemoryAllocateInfo::default()
        .allocation_size(size)
        .memory_type_index(types.trailing_zeros())
        .push_next(&mut import);
    // SAFETY: the pages are mapped for as long as this lives, by the contract of `HostMemory`; the type is one of theirs.
    let memory = unsafe { device.handle.allocate_memory(&allocate, None) }.ok()?;
    // SAFETY: nothing is bound to the buffer yet.
    match unsafe { device.handle.bind_buffer_memory(buffer, memory, 0) } {
        Ok(()) => Some(memory),
        Err(_) => {
            // SAFETY: the memory was never used.
            unsafe { device.handle.free_memory(memory, None) };
            None
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
        let Some(Imported { memory, buffer, .. }) = self.imported.take().filter(|_| !self.device.is_in_use()) else {
            return;
        };
        // SAFETY: recordings keep what they use alive and are waited for, so the device no longer uses it.
        unsafe {
            self.device.handle.destroy_buffer(buffer, None);
            self.device.handle.free_memory(memory, None);
        }
    }
}
