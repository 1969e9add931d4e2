//! Basic types, without dependence on devices, files or passes.

/// Makes an enum of named choices: the name is that in files, on the command line and in reports.
macro_rules! choices {
    ($(#[$attribute:meta])* pub enum $type:ident { $($(#[$doc:meta])* $variant:ident = $name:literal,)+ }) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "program", derive(clap::ValueEnum))]
        pub enum $type { $(
            $(#[$doc])*
            #[cfg_attr(feature = "serde", serde(rename = $name))]
            #[cfg_attr(feature = "program", value(name = $name))]
            $variant,
        )+ }

        impl $type {
            /// All of them.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// The name, as in files and on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }
        }
    };
}

pub(crate) mod brightness;
pub(crate) mod color;
mod control;
mod device_info;
mod error;
mod frame;
mod frame_format;
pub(crate) mod kernel;
mod lens;
mod lens_field;
mod mask;
pub(crate) mod photon_transfer;
mod pixel_format;
pub(crate) mod random;
mod region;
mod settings;
pub(crate) mod smooth_field;
pub(crate) mod statistics;
mod transform;
pub(crate) mod weighted;
pub(crate) mod workers;

pub use brightness::{Brightness, Shading};
pub use color::Decode;
pub(crate) use control::{CancelSignal, Deadline};
pub use control::{CancellationToken, Progress};
pub use device_info::DeviceInfo;
pub(crate) use device_info::{CPU, CPU_DEVICE};
pub use error::Error;
pub use frame::{Frame, Samples};
pub use frame_format::{Channels, Depth, Format};
pub use kernel::{Aperture, Kernel};
pub use lens::{BlurToDepth, Lens};
pub use lens_field::LensField;
pub use mask::Mask;
pub(crate) use pixel_format::{Order, Packing};
pub use pixel_format::{PixelFormat, RowLayout};
pub use region::Region;
pub use settings::{Method, Motion, Parallax, ParallaxSearch, Photometric, RegistrationStep, Setting, Settings};
pub use statistics::Estimate;
pub use transform::{Homography, Similarity, centre};
