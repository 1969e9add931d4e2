//! The Vulkan device behind an engine: the only unsafe code of the crate. It knows no image and no mathematics.

mod cache;
mod commands;
mod descriptors;
mod device;
#[cfg(target_os = "linux")]
pub(crate) mod dma_buf;
mod failure;
#[cfg(test)]
pub(crate) mod faults;
mod foreign;
mod instance;
mod liked;
#[cfg(target_os = "linux")]
mod mapping;
mod memory;
mod on_device;
mod pipeline;
mod recording;
mod shared;
mod source;
mod timestamps;
mod turns;
mod wanted;

pub(crate) use commands::{Groups, Recorder};
pub(crate) use descriptors::Resource;
pub(crate) use device::{Device, MIB};
pub use foreign::{Commands, ForeignDevice, QueueLock, Turn, Wait};
pub(crate) use instance::Instance;
#[cfg(test)]
pub(crate) use instance::unconditional;
pub use liked::LIKED_EXTENSIONS;
pub(crate) use memory::{Buffer, Image, Texel, image_limits};
pub use on_device::OnDevice;
pub(crate) use pipeline::{Access, Binding, Kind, Pipeline, Stage, Variant};
pub(crate) use recording::Recording;
pub use shared::{HostMemory, SharedMemory};
pub use source::DeviceSource;
pub(crate) use source::{Fetch, Place};
pub(crate) use timestamps::Clock;
pub use turns::Turns;
pub use wanted::{REQUIRED_VERSION, Wanted, require};
