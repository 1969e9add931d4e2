//! The Vulkan device behind an engine: the only unsafe code of the crate. It knows no image and no mathematics.

mod cache;
mod commands;
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
mod timestamps;
mod turns;
mod wanted;

pub(crate) use commands::{Groups, Recorder, Resource};
pub(crate) use device::{Device, MIB};
pub use foreign::{ForeignDevice, QueueLock, Turn};
pub(crate) use instance::Instance;
#[cfg(test)]
pub(crate) use instance::unconditional;
pub(crate) use memory::{Buffer, Image, Texel, image_limits};
pub use on_device::OnDevice;
pub(crate) use pipeline::{Access, Binding, Kind, Pipeline, Stage, Variant};
pub(crate) use recording::Recording;
pub(crate) use timestamps::Clock;
pub use turns::Turns;
pub use wanted::{LIKED_EXTENSIONS, REQUIRED_VERSION, Wanted, require};
