//! The nouns: plain numbers and their names, which every other room uses. Nothing here knows a device, a file or a pass.

pub(crate) mod aperture;
mod brightness;
pub(crate) mod color;
mod control;
mod device_info;
mod error;
mod frame;
mod homography;
mod kernel;
mod lens;
mod mask;
mod mosaic;
mod pixel_format;
pub(crate) mod random;
mod region;
mod settings;
pub(crate) mod shading;
mod similarity;
pub(crate) mod statistics;
#[cfg(feature = "serde")]
mod stored;
pub(crate) mod weighted;
pub(crate) mod workers;

pub use aperture::Aperture;
pub use brightness::Brightness;
pub use color::Decode;
pub(crate) use control::{CancelSignal, Deadline};
pub use control::{CancellationToken, Progress};
pub use device_info::DeviceInfo;
pub use error::Error;
pub use frame::{Channels, Depth, Format, Frame, Samples};
pub use homography::Homography;
pub use kernel::Kernel;
pub use lens::{Inverse, Lens};
pub use mask::Mask;
pub use pixel_format::PixelFormat;
pub(crate) use pixel_format::{Order, Packing};
pub use region::Region;
pub use settings::{Method, Motion, Photometric, RegistrationStep, Setting, Settings};
pub use shading::Shading;
pub use similarity::{Similarity, centre};
pub use statistics::Estimate;
