//! What is written and printed: results, progress, summaries and errors.

pub(crate) mod derived_outputs;
pub(crate) mod destination;
pub(crate) mod failure;
pub(crate) mod progress;
pub(crate) mod summary;
