//! Memory of the embedding program that the device reads in place: host memory and dma-bufs.

use std::fmt;
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::Arc;

use ash::vk;

use super::device::Device;
use super::device_source::SourceLocation;
use crate::base::Error;

/// Host memory of the embedding program, which the device may read in place (`VK_EXT_external_memory_host`).
#[derive(Clone, Copy, Debug)]
pub struct HostMemory {
    start: NonNull<u8>,
    bytes: usize,
}

impl HostMemory {
    /// Describes `bytes` bytes from `start` on, at least 1.
    ///
    /// # Safety
    /// - The memory stays mapped at this address while the [`SharedMemory`] made from it lives.
    /// - From the submission of a pair that reads rows of it until they are read
    ///   ([`Pending::wait_fetched`](crate::Pending::wait_fetched)), no code writes between the start of the first row
    ///   and the end of the last.
    pub unsafe fn new(start: NonNull<u8>, bytes: usize) -> Self {
        Self { start, bytes }
    }
}

/// Memory of the embedding program, such as a camera's ring buffer, that the device reads in place if it can
/// ([`Engine::share`](crate::Engine::share)).
pub struct SharedMemory {
    bytes: usize,
    host_view: HostView,
    imported: Option<ImportedMemory>,
    /// `None` with the CPU device.
    device: Option<Arc<Device>>,
}

/// How the host accesses the memory.
enum HostView {
    Pointer(NonNull<u8>),
    #[cfg(target_os = "linux")]
    Mapped(dma_buf::Mapping),
    #[cfg(target_os = "linux")]
    None,
}

// SAFETY: the memory is only read, and the contracts of `HostMemory` and `DmaBuf` exclude concurrent writes.
unsafe impl Send for SharedMemory {}
// SAFETY: the memory is only read, and the contracts of `HostMemory` and `DmaBuf` exclude concurrent writes.
unsafe impl Sync for SharedMemory {}

impl SharedMemory {
    /// Imports the pages of host memory. If the device cannot, the host copies rows from it.
    pub(crate) fn new(device: Option<&Arc<Device>>, HostMemory { start, bytes }: HostMemory) -> Arc<Self> {
        let imported = device.and_then(|device| import_host_memory(device, start, bytes));
        Arc::new(Self { bytes, host_view: HostView::Pointer(start), imported, device: device.cloned() })
    }

    /// Whether the host copies rows from the memory, because the device could not import it.
    pub fn is_staged(&self) -> bool {
        self.imported.is_none()
    }

    /// Returns the size in bytes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns the location of rows for the device, from the byte `offset` on. `None` if the memory is not imported.
    pub(crate) fn location(&self, offset: u64, pitch: u64) -> Option<SourceLocation> {
        self.imported.as_ref().map(|imported| {
            let (offset, is_foreign) = (imported.offset + offset, imported.is_foreign);
            SourceLocation::Buffer { buffer: imported.buffer, offset, pitch, is_foreign }
        })
    }

    /// Passes a range of bytes to `read`. Other bytes may be written meanwhile. The slice is empty if the host has no
    /// access.
    pub(crate) fn read<T>(&self, bytes: Range<usize>, read: impl FnOnce(&[u8]) -> T) -> T {
        assert!(bytes.start <= bytes.end && bytes.end <= self.bytes, "{bytes:?} of {} bytes", self.bytes);
        let start = match &self.host_view {
            HostView::Pointer(start) => start.as_ptr().cast_const(),
            #[cfg(target_os = "linux")]
            HostView::Mapped(mapping) => {
                mapping.begin_read();
                mapping.start()
            }
            #[cfg(target_os = "linux")]
            HostView::None => return read(&[]),
        };
        // SAFETY: the bytes stay mapped while `self` lives, and the contracts of `HostMemory` and `DmaBuf` exclude
        // writes to them until they are read.
        let result = read(unsafe { std::slice::from_raw_parts(start.add(bytes.start), bytes.len()) });
        #[cfg(target_os = "linux")]
        if let HostView::Mapped(mapping) = &self.host_view {
            mapping.end_read();
        }
        result
    }

    /// Checks that the memory is shared with `device`.
    pub(crate) fn check(&self, device: Option<&Arc<Device>>) -> Result<(), Error> {
        let owner = |device: &Arc<Device>| Arc::as_ptr(device);
        if self.device.as_ref().map(owner) == device.map(owner) {
            return Ok(());
        }
        Err(Error::Mismatch("the memory is shared with another engine: share it with this one too".into()))
    }
}

impl fmt::Debug for SharedMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SharedMemory of {} bytes, staged: {}", self.bytes, self.is_staged())
    }
}

impl Drop for SharedMemory {
    fn drop(&mut self) {
        if let (Some(imported), Some(device)) = (self.imported.take(), &self.device)
            && !device.is_in_use()
        {
            imported.free(device);
        }
    }
}

/// A buffer over imported memory.
struct ImportedMemory {
    memory: vk::DeviceMemory,
    buffer: vk::Buffer,
    /// Offset of the first byte in the buffer.
    offset: u64,
    /// Whether another device writes it, so that its ownership must be acquired from the foreign queue family.
    is_foreign: bool,
}

/// A failed import. It is no error of the engine: the host then copies.
struct ImportFailed {
    /// Whether Vulkan has taken ownership of the handle.
    #[cfg_attr(not(target_os = "linux"), expect(dead_code, reason = "only a dma-buf has a handle"))]
    owns_handle: bool,
}

impl ImportedMemory {
    /// Creates a buffer over external memory of `size` bytes, in one of the memory types of the mask `types`.
    fn new(
        device: &Arc<Device>,
        handle_type: vk::ExternalMemoryHandleTypeFlags,
        (types, size): (u32, u64),
        import: &mut impl vk::ExtendsMemoryAllocateInfo,
        offset: u64,
    ) -> Result<Self, ImportFailed> {
        let failed = ImportFailed { owns_handle: false };
        let usage = vk::BufferUsageFlags::TRANSFER_SRC;
        let Some(is_dedicated) = import_support(device, handle_type, usage) else { return Err(failed) };
        let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(handle_type);
        let create = vk::BufferCreateInfo::default().size(size).usage(usage).push_next(&mut external);
        // SAFETY: the device has the extension of the handle type; the size is not zero.
        let Ok(buffer) = (unsafe { device.handle.create_buffer(&create, None) }) else { return Err(failed) };
        // SAFETY: the buffer belongs to this device.
        let requirements = unsafe { device.handle.get_buffer_memory_requirements(buffer) };
        let memory_type = memory_type(device, types & requirements.memory_type_bits, handle_type);
        let memory = memory_type.filter(|_| requirements.size <= size).and_then(|memory_type| {
            let mut dedicated = vk::MemoryDedicatedAllocateInfo::default().buffer(buffer);
            let mut allocate = vk::MemoryAllocateInfo::default().allocation_size(size).memory_type_index(memory_type);
            if is_dedicated {
                allocate = allocate.push_next(&mut dedicated);
            }
            // SAFETY: the contracts of `HostMemory` and `DmaBuf` keep the memory valid while this import lives; the
            // type is one that the handle supports.
            unsafe { device.handle.allocate_memory(&allocate.push_next(import), None) }.ok()
        });
        let Some(memory) = memory else {
            // SAFETY: the buffer was never used.
            unsafe { device.handle.destroy_buffer(buffer, None) };
            return Err(failed);
        };
        let imported = Self { memory, buffer, offset, is_foreign: false };
        // SAFETY: no memory is bound to the buffer yet, and the memory has its size.
        if unsafe { device.handle.bind_buffer_memory(buffer, memory, 0) }.is_err() {
            imported.free(device);
            return Err(ImportFailed { owns_handle: true });
        }
        Ok(imported)
    }

    fn free(&self, device: &Device) {
        // SAFETY: recordings retain the memory that they use and are complete, so that the device no longer uses it.
        unsafe {
            device.handle.destroy_buffer(self.buffer, None);
            device.handle.free_memory(self.memory, None);
        }
    }
}

/// Imports the pages that hold a range of host memory.
fn import_host_memory(device: &Arc<Device>, start: NonNull<u8>, bytes: usize) -> Option<ImportedMemory> {
    let extension = device.external_memory_host.as_ref()?;
    let alignment = device.imported_host_alignment() as usize;
    let align_down = |address: usize| address & !(alignment - 1);
    let address = start.as_ptr() as usize;
    let first = align_down(address);
    let size = (address.checked_add(bytes)?.checked_add(alignment - 1).map(align_down)? - first) as u64;
    let handle_type = vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT;
    // The bytes before the start lie in the same page, which is mapped because the start is.
    let pointer = start.as_ptr().wrapping_sub(address - first).cast::<std::ffi::c_void>();
    let mut properties = vk::MemoryHostPointerPropertiesEXT::default();
    let query = extension.fp().get_memory_host_pointer_properties_ext;
    // SAFETY: the pointer is to mapped host memory and has the required alignment.
    unsafe { query(device.handle.handle(), handle_type, pointer, &mut properties) }.result().ok()?;
    let mut import = vk::ImportMemoryHostPointerInfoEXT::default().handle_type(handle_type).host_pointer(pointer);
    let memory = (properties.memory_type_bits, size);
    ImportedMemory::new(device, handle_type, memory, &mut import, (address - first) as u64).ok()
}

/// Whether buffers can be imported and, if they can, whether each needs a dedicated allocation.
fn import_support(
    device: &Device,
    handle_type: vk::ExternalMemoryHandleTypeFlags,
    usage: vk::BufferUsageFlags,
) -> Option<bool> {
    let (instance, physical) = (&device.instance.handle, device.physical.handle);
    let buffer = vk::PhysicalDeviceExternalBufferInfo::default().usage(usage).handle_type(handle_type);
    let mut properties = vk::ExternalBufferProperties::default();
    // SAFETY: the physical device belongs to this instance.
    unsafe { instance.get_physical_device_external_buffer_properties(physical, &buffer, &mut properties) };
    let features = properties.external_memory_properties.external_memory_features;
    let is_dedicated = features.contains(vk::ExternalMemoryFeatureFlags::DEDICATED_ONLY);
    features.contains(vk::ExternalMemoryFeatureFlags::IMPORTABLE).then_some(is_dedicated)
}

/// Chooses a memory type from the mask `types`. Host memory must be coherent, since nothing flushes a camera's writes.
fn memory_type(device: &Device, types: u32, handle_type: vk::ExternalMemoryHandleTypeFlags) -> Option<u32> {
    // SAFETY: the physical device belongs to this instance.
    let memory = unsafe { device.instance.handle.get_physical_device_memory_properties(device.physical.handle) };
    let required = match handle_type {
        vk::ExternalMemoryHandleTypeFlags::HOST_ALLOCATION_EXT => vk::MemoryPropertyFlags::HOST_COHERENT,
        _ => vk::MemoryPropertyFlags::empty(),
    };
    // Needs a device feature that is not enabled.
    let excluded = vk::MemoryPropertyFlags::DEVICE_COHERENT_AMD;
    (0..memory.memory_type_count).find(|&n| {
        let flags = memory.memory_types[n as usize].property_flags;
        types >> n & 1 == 1 && flags.contains(required) && !flags.intersects(excluded)
    })
}

/// Memory of another device, such as a capture card, that Linux passes by a file descriptor
/// (`VK_EXT_external_memory_dma_buf`).
#[cfg(target_os = "linux")]
pub(crate) mod dma_buf {
    use std::ffi::c_void;
    use std::os::fd::{AsRawFd, FromRawFd, IntoRawFd, OwnedFd};
    use std::sync::Arc;

    use ash::{khr, vk};
    use rustix::fs::{SeekFrom, seek};
    use rustix::io::Errno;
    use rustix::ioctl::{self, Setter, opcode};
    use rustix::mm::{self, MapFlags, ProtFlags};

    use super::{Device, Error, HostView, ImportFailed, ImportedMemory, SharedMemory};

    /// A dma-buf that the device may read in place ([`Engine::share_dma_buf`](crate::Engine::share_dma_buf)).
    #[derive(Debug)]
    pub struct DmaBuf {
        fd: OwnedFd,
        bytes: usize,
    }

    impl DmaBuf {
        /// Describes the first `bytes` bytes of a buffer of linear memory, at least 1.
        ///
        /// # Safety
        /// - `fd` is a dma-buf, or a memory file that is never truncated, so that its pages stay valid while mapped.
        /// - From the submission of a pair that reads rows of it until they are read
        ///   ([`Pending::wait_fetched`](crate::Pending::wait_fetched)), no code writes between the start of the first
        ///   row and the end of the last.
        pub unsafe fn new(fd: OwnedFd, bytes: usize) -> Self {
            Self { fd, bytes }
        }
    }

    /// Imports a dma-buf. If the device cannot, the host maps it and copies rows from it.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it is shorter than stated, or can be neither imported nor mapped.
    pub(crate) fn share(
        device: Option<&Arc<Device>>,
        DmaBuf { fd, bytes }: DmaBuf,
    ) -> Result<Arc<SharedMemory>, Error> {
        let problem = |action: &str, e: Errno| Error::Mismatch(format!("the dma-buf cannot be {action}: {e}"));
        let size = seek(&fd, SeekFrom::End(0)).map_err(|e| problem("measured", e))?;
        if bytes == 0 || bytes as u64 > size {
            return Err(Error::Mismatch(format!("the dma-buf has {size} bytes, not {bytes}")));
        }
        let (host_view, imported) = match device.and_then(|device| import(device, &fd, size)) {
            Some(imported) => (HostView::None, Some(imported)),
            // SAFETY: the contract of `DmaBuf` keeps the pages valid.
            None => (HostView::Mapped(unsafe { Mapping::new(fd, bytes) }.map_err(|e| problem("mapped", e))?), None),
        };
        Ok(Arc::new(SharedMemory { bytes, host_view, imported, device: device.cloned() }))
    }

    /// Imports the whole dma-buf, since drivers require whole pages.
    fn import(device: &Arc<Device>, fd: &OwnedFd, size: u64) -> Option<ImportedMemory> {
        if !device.physical.optional.dma_buf {
            return None;
        }
        let handle_type = vk::ExternalMemoryHandleTypeFlags::DMA_BUF_EXT;
        let extension = khr::external_memory_fd::Device::new(&device.instance.handle, &device.handle);
        let mut properties = vk::MemoryFdPropertiesKHR::default();
        // SAFETY: the descriptor is open; the call fails if it is of another handle type.
        unsafe { extension.get_memory_fd_properties(handle_type, fd.as_raw_fd(), &mut properties) }.ok()?;
        // A successful import transfers the ownership of the descriptor to Vulkan.
        let duplicate = fd.try_clone().ok()?.into_raw_fd();
        let mut import = vk::ImportMemoryFdInfoKHR::default().handle_type(handle_type).fd(duplicate);
        match ImportedMemory::new(device, handle_type, (properties.memory_type_bits, size), &mut import, 0) {
            Ok(imported) => Some(ImportedMemory { is_foreign: true, ..imported }),
            Err(ImportFailed { owns_handle }) => {
                if !owns_handle {
                    // SAFETY: Vulkan has not taken the descriptor, which nothing else owns.
                    drop(unsafe { OwnedFd::from_raw_fd(duplicate) });
                }
                None
            }
        }
    }

    /// `DMA_BUF_IOCTL_SYNC` and its flags, of `linux/dma-buf.h`.
    const SYNC: ioctl::Opcode = opcode::write::<u64>(b'b', 0);
    const SYNC_READ: u64 = 1;
    const SYNC_END: u64 = 4;

    /// A host mapping of a dma-buf that the device cannot import.
    pub(super) struct Mapping {
        start: *mut c_void,
        bytes: usize,
        fd: OwnedFd,
    }

    impl Mapping {
        /// Maps the first `bytes` bytes for reading.
        ///
        /// # Safety
        /// The pages stay valid while the mapping lives.
        unsafe fn new(fd: OwnedFd, bytes: usize) -> Result<Self, Errno> {
            // SAFETY: the kernel chooses the address of the new mapping.
            let start = unsafe { mm::mmap(std::ptr::null_mut(), bytes, ProtFlags::READ, MapFlags::SHARED, &fd, 0) }?;
            Ok(Self { start, bytes, fd })
        }

        pub(super) fn start(&self) -> *const u8 {
            self.start.cast()
        }

        /// Makes the device's writes visible to the host.
        pub(super) fn begin_read(&self) {
            self.sync(SYNC_READ);
        }

        /// Ends the host's access.
        pub(super) fn end_read(&self) {
            self.sync(SYNC_READ | SYNC_END);
        }

        /// Repeats the call while the kernel asks for that. Other failures are ignored: a memory file has no caches to
        /// synchronize and refuses the call.
        fn sync(&self, flags: u64) {
            // SAFETY: the opcode takes these flags; a descriptor that is no dma-buf refuses the call.
            let sync = || unsafe { ioctl::ioctl(&self.fd, Setter::<SYNC, u64>::new(flags)) };
            while matches!(sync(), Err(Errno::INTR | Errno::AGAIN)) {}
        }
    }

    impl Drop for Mapping {
        fn drop(&mut self) {
            // SAFETY: `new` mapped these bytes, and no slice of them is left. Fails only for invalid arguments.
            let _ = unsafe { mm::munmap(self.start, self.bytes) };
        }
    }
}
