//! Pages of a dma-buf as the host has them.

use std::ffi::c_void;
use std::os::fd::OwnedFd;

use rustix::io::Errno;
use rustix::ioctl::{self, Setter, opcode};
use rustix::mm::{self, MapFlags, ProtFlags};

/// Its pages as the host has them, of one that the device cannot read.
pub(super) struct Mapping {
    start: *mut c_void,
    bytes: usize,
    fd: OwnedFd,
}

/// `DMA_BUF_IOCTL_SYNC` of `linux/dma-buf.h`.
const SYNC: ioctl::Opcode = opcode::write::<u64>(b'b', 0);
const READ: u64 = 1;
const END: u64 = 4;

impl Mapping {
    /// Maps so many bytes.
    ///
    /// # Safety
    /// No page of them goes while this is.
    pub(super) unsafe fn new(fd: OwnedFd, bytes: usize) -> Result<Self, Errno> {
        // SAFETY: a new mapping, wherever there is room.
        let start = unsafe { mm::mmap(std::ptr::null_mut(), bytes, ProtFlags::READ, MapFlags::SHARED, &fd, 0) }?;
        Ok(Self { start, bytes, fd })
    }

    pub(super) fn start(&self) -> *const u8 {
        self.start.cast()
    }

    /// The host begins to read, or ends: caches that are not coherent are then seen to. A file in memory has none.
    pub(super) fn reads(&self, ends: bool) {
        // SAFETY: the call takes these flags, and a descriptor that is no dma-buf refuses it.
        let _ = unsafe { ioctl::ioctl(&self.fd, Setter::<SYNC, u64>::new(READ | if ends { END } else { 0 })) };
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: it was mapped so, and nobody reads it any more.
        let _ = unsafe { mm::munmap(self.start, self.bytes) };
    }
}
