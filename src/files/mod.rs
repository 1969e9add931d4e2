//! Files to [`Frame`](crate::Frame)s, and results to files: all of them or none. Nothing here knows Vulkan or a pass.

pub mod bounded_read;
pub mod export;
pub mod image_io;
pub mod model;
pub(crate) mod preview;
