//! Many pairs and sweeps: which they are, the threads that solve them, the summary.

pub(crate) mod batch_summary;
pub(crate) mod manifest;
pub(crate) mod on_done;
pub(crate) mod pairs;
pub(crate) mod pairs_bar;
pub(crate) mod pipeline;
pub(crate) mod shard;
pub(crate) mod task;
