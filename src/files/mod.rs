//! Files: photographs to [`Frame`](crate::Frame)s, and results to files.

pub mod bounded_read;
pub mod export;
pub mod image_io;
pub mod model;
pub(crate) mod preview;
