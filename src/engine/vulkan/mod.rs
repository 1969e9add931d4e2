//! The Vulkan device behind an engine: the only unsafe code of the crate. It knows no image and no mathematics.

mod cache;
mod commands;
mod descriptors;
mod device;
mod device_requirements;
#[cfg(target_os = "linux")]
pub(crate) mod dma_buf;
mod failure;
#[cfg(test)]
pub(crate) mod faults;
mod instance;
mod interop;
#[cfg(target_os = "linux")]
mod mapping;
mod memory;
mod on_device;
mod optional_extensions;
mod pipeline;
mod recording;
mod shared;
mod shared_queue;
mod source;
mod timestamps;

pub(crate) use commands::{Groups, Recorder};
pub(crate) use descriptors::Resource;
pub(crate) use device::{Device, MIB};
pub use device_requirements::{DeviceRequirements, REQUIRED_VERSION, require};
pub(crate) use instance::Instance;
#[cfg(test)]
pub(crate) use instance::unconditional;
pub use interop::{Commands, ExternalDevice, QueueGuard, QueueLock, Wait};
pub(crate) use memory::{Buffer, Image, Texel, image_limits};
pub use on_device::{OnDevice, ResultBuffer};
pub use optional_extensions::OPTIONAL_EXTENSIONS;
pub(crate) use pipeline::{Access, Binding, Kind, Pipeline, Stage, Variant};
pub(crate) use recording::Recording;
pub use shared::{HostMemory, SharedMemory};
pub use shared_queue::SharedQueue;
pub use source::DeviceSource;
pub(crate) use source::{Fetch, Place};
pub(crate) use timestamps::Clock;
