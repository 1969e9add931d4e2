//! Files: photographs are read as [`Frame`](crate::Frame)s, results are written and read.

pub mod bounded_read;
pub mod export;
pub mod image_io;
pub mod model;
