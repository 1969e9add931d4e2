//! Depth in mm as a file.

use std::io::{Seek, Write};

use super::field;
use super::meaning::METRIC_DEPTH;
use crate::metric::MetricDepth;

/// The file of metric depth, which is there only where the lens is known.
pub const DEPTH_FILE: &str = "depth_mm.exr";

/// Writes `depth_mm.exr`: channel `Y` and channel `standard_deviation`, both mm.
pub(super) fn write(writer: impl Write + Seek, metric: &MetricDepth) -> Result<(), String> {
    let channels = [("Y", &metric.depth[..]), ("standard_deviation", &metric.deviation)];
    field::write_channels(writer, (metric.width, metric.height), &channels, &METRIC_DEPTH)
}
