//! The Vulkan device behind an engine: the only unsafe code of the crate. It knows no image and no mathematics.

mod cache;
mod commands;
mod descriptors;
mod device;
mod failure;
#[cfg(test)]
pub(crate) mod faults;
mod foreign;
mod instance;
mod memory;
mod on_device;
mod pipeline;
mod recording;
mod shared;
mod source;
mod timestamps;

pub(crate) use commands::{Groups, Recorder};
pub(crate) use descriptors::Resource;
pub(crate) use device::{Device, MIB};
pub use foreign::{Commands, ForeignDevice, LIKED_EXTENSIONS, QueueLock, REQUIRED_VERSION, Wait, require};
pub(crate) use instance::Instance;
#[cfg(test)]
pub(crate) use instance::unconditional;
pub(crate) use memory::{Buffer, Image, Texel, image_limits};
pub use on_device::OnDevice;
pub(crate) use pipeline::{Access, Binding, Kind, Pipeline, Stage, Variant};
pub(crate) use recording::Recording;
pub use shared::{HostMemory, SharedMemory};
pub use source::DeviceSource;
pub(crate) use source::{Fetch, Place};
pub(crate) use timestamps::Clock;
