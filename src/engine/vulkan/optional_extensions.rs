//! Device extensions that an engine makes use of where they are.

use std::ffi::CStr;

use ash::{ext, khr};

/// Device extensions that an engine makes use of where they are enabled, with their features: the device leaves out by itself what
/// has settled, and a solve is one submission (`VkPhysicalDeviceConditionalRenderingFeaturesEXT`); it reads memory of the host
/// ([`Engine::share`](crate::Engine::share)), and, by the last three together, dma-bufs where they are. None is required.
pub const OPTIONAL_EXTENSIONS: [&CStr; 5] = [
    ext::conditional_rendering::NAME,
    ext::external_memory_host::NAME,
    khr::external_memory_fd::NAME,
    ext::external_memory_dma_buf::NAME,
    ext::queue_family_foreign::NAME,
];

/// What a device has of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Liked {
    /// It leaves commands out by itself.
    pub(crate) conditional: bool,
    /// It reads memory of the host.
    pub(crate) host_memory: bool,
    /// It reads dma-bufs.
    pub(crate) dma_buf: bool,
}

impl Liked {
    /// Of a device that has extensions by these names.
    pub(super) fn of(has: impl Fn(&CStr) -> bool) -> Self {
        let [conditional, host_memory, rest @ ..] = OPTIONAL_EXTENSIONS;
        Self {
            conditional: has(conditional),
            host_memory: has(host_memory),
            dma_buf: rest.iter().all(|name| has(name)),
        }
    }

    /// The extensions of what it has.
    pub(super) fn extensions(self) -> impl Iterator<Item = &'static CStr> {
        let Self { conditional, host_memory, dma_buf } = self;
        let has = [conditional, host_memory, dma_buf, dma_buf, dma_buf];
        OPTIONAL_EXTENSIONS.into_iter().zip(has).filter(|(_, has)| *has).map(|(name, _)| name)
    }

    /// What both have.
    pub(super) fn and(self, other: Self) -> Self {
        Self {
            conditional: self.conditional && other.conditional,
            host_memory: self.host_memory && other.host_memory,
            dma_buf: self.dma_buf && other.dma_buf,
        }
    }
}
