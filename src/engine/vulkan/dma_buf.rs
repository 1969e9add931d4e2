//! Memory of another device, a capture card or a camera's, that Linux hands over by a descriptor: VK_EXT_external_memory_dma_buf.

use std::os::fd::{AsRawFd, FromRawFd, IntoRawFd, OwnedFd};
use std::sync::Arc;

use ash::{khr, vk};
use rustix::fs::{SeekFrom, seek};
use rustix::io::Errno;

use super::device::Device;
use super::mapping::Mapping;
use super::shared::{Holder, Imported, Refused, SharedMemory, bind};
use crate::base::Error;

/// A dma-buf that may be read where it is: [`Engine::share_dma_buf`](crate::Engine::share_dma_buf).
#[derive(Debug)]
pub struct DmaBuf {
    fd: OwnedFd,
    bytes: usize,
}

impl DmaBuf {
    /// So many bytes, one at least, of a buffer of linear memory.
    ///
    /// # Safety
    /// - It is a dma-buf, or a file in memory that stays as long as it is, so that no page of it goes while it is mapped.
    /// - From when a pair that takes rows of it is submitted until they are taken ([`Pending::wait_fetched`](crate::Pending::wait_fetched)), nobody writes
    ///   from the first of those rows to the end of the last.
    pub unsafe fn new(fd: OwnedFd, bytes: usize) -> Self {
        Self { fd, bytes }
    }
}

/// Imports a dma-buf; where the device cannot, the host copies out of it.
pub(crate) fn share(device: &Arc<Device>, DmaBuf { fd, bytes }: DmaBuf) -> Result<Arc<SharedMemory>, Error> {
    let problem = |what: &str, e: Errno| Error::Mismatch(format!("the dma-buf cannot be {what}: {e}"));
    let size = seek(&fd, SeekFrom::End(0)).map_err(|e| problem("measured", e))?;
    if bytes == 0 || bytes as u64 > size {
        return Err(Error::Mismatch(format!("the dma-buf has {size} bytes, not {bytes}")));
    }
    if let Some(imported) = import(device, &fd, size) {
        return Ok(SharedMemory::holding(device, bytes, Holder::Device, Some(imported)));
    }
    // SAFETY: the pages stay by the contract of `DmaBuf`.
    let mapping = unsafe { Mapping::new(fd, bytes) }.map_err(|e| problem("read", e))?;
    Ok(SharedMemory::holding(device, bytes, Holder::Mapped(mapping), None))
}

/// All of it: drivers ask for whole pages.
fn import(device: &Arc<Device>, fd: &OwnedFd, size: u64) -> Option<Imported> {
    if !device.physical.liked.dma_buf {
        return None;
    }
    let kind = vk::ExternalMemoryHandleTypeFlags::DMA_BUF_EXT;
    let of_fd = khr::external_memory_fd::Device::new(&device.instance.handle, &device.handle);
    let mut told = vk::MemoryFdPropertiesKHR::default();
    // SAFETY: the descriptor is open, and a kind that it is not of is refused.
    unsafe { of_fd.get_memory_fd_properties(kind, fd.as_raw_fd(), &mut told) }.ok()?;
    // Vulkan takes the descriptor over where it imports it.
    let own = fd.try_clone().ok()?.into_raw_fd();
    let mut import = vk::ImportMemoryFdInfoKHR::default().handle_type(kind).fd(own);
    match bind(device, kind, (told.memory_type_bits, size), &mut import, 0) {
        Ok(imported) => Some(imported.of_another_device()),
        Err(Refused { took_over }) => {
            if !took_over {
                // SAFETY: it is still this one's.
                drop(unsafe { OwnedFd::from_raw_fd(own) });
            }
            None
        }
    }
}
