//! One pair or one sweep, from its files to its results.

pub(crate) mod frames;
pub(crate) mod request;
pub(crate) mod sweep_work;
pub(crate) mod work;
