//! The optional device extensions of an engine.

use std::ffi::CStr;

use ash::{ext, khr};

/// Device extensions that an engine uses if they and their features are enabled. None is required.
///
/// - `VK_EXT_conditional_rendering`, with its feature `conditionalRendering`: the device skips levels that have
///   settled, and a solve is one submission.
/// - `VK_EXT_external_memory_host`: the device reads host memory in place ([`Engine::share`](crate::Engine::share)).
/// - The last three together: the device reads dma-bufs in place.
pub const OPTIONAL_EXTENSIONS: [&CStr; 5] = [
    ext::conditional_rendering::NAME,
    ext::external_memory_host::NAME,
    khr::external_memory_fd::NAME,
    ext::external_memory_dma_buf::NAME,
    ext::queue_family_foreign::NAME,
];

/// Which of the [`OPTIONAL_EXTENSIONS`] a device has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct OptionalExtensions {
    pub(crate) conditional_rendering: bool,
    pub(crate) host_memory: bool,
    /// All three extensions for dma-bufs.
    pub(crate) dma_buf: bool,
}

impl OptionalExtensions {
    /// Those of a device that supports the extensions for which `has` is true.
    pub(super) fn supported(has: impl Fn(&CStr) -> bool) -> Self {
        let [conditional_rendering, host_memory, dma_buf @ ..] = OPTIONAL_EXTENSIONS;
        Self {
            conditional_rendering: has(conditional_rendering),
            host_memory: has(host_memory),
            dma_buf: dma_buf.iter().all(|name| has(name)),
        }
    }

    /// Returns the names of the extensions.
    pub(super) fn names(self) -> impl Iterator<Item = &'static CStr> {
        let Self { conditional_rendering, host_memory, dma_buf } = self;
        let has = [conditional_rendering, host_memory, dma_buf, dma_buf, dma_buf];
        OPTIONAL_EXTENSIONS.into_iter().zip(has).filter(|(_, has)| *has).map(|(name, _)| name)
    }

    /// Returns the extensions that both have.
    pub(super) fn intersection(self, other: Self) -> Self {
        Self {
            conditional_rendering: self.conditional_rendering && other.conditional_rendering,
            host_memory: self.host_memory && other.host_memory,
            dma_buf: self.dma_buf && other.dma_buf,
        }
    }
}
