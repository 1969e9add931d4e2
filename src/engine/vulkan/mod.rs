//! The Vulkan device of an engine. All unsafe code of the crate is here; images have no meaning.

mod device;
mod device_source;
pub(crate) mod external_memory;
#[cfg(test)]
pub(crate) mod faults;
mod instance;
mod interop;
mod memory;
mod pipeline;
mod pipeline_cache;
mod recorder;
mod recording;
#[cfg(feature = "program")]
pub(crate) mod statistics;
mod system_memory;
mod timestamps;

pub(crate) use device::{Device, MIB};
pub use device_source::{DeviceSolution, DeviceSource, SolutionBuffer};
pub(crate) use device_source::{SourceCopy, SourceLocation};
pub use external_memory::{HostMemory, SharedMemory};
pub use instance::OPTIONAL_EXTENSIONS;
#[cfg(test)]
pub(crate) use instance::no_conditional_rendering;
pub(crate) use instance::{Instance, LEAST_WORKGROUP};
pub use interop::{
    DeviceRequirements, ExternalCommandBuffer, ExternalDevice, QueueGuard, QueueLock, REQUIRED_VERSION, SemaphoreWait,
    SharedQueue, enable_required_features,
};
pub(crate) use memory::{Buffer, Image, Texel, image_limits};
pub(crate) use pipeline::{Access, Binding, Kind, Pipeline, Resource, Stage, Variant};
pub(crate) use recorder::{Recorder, Workgroups};
pub(crate) use recording::Recording;
pub use system_memory::available_memory;
pub(crate) use timestamps::{Clock, DeviceTimes};
