//! Depth in mm as a file, and its part of the report.

use std::io::{Seek, Write};

use serde::Serialize;

use super::field;
use super::meaning::METRIC_DEPTH;
use super::report::RangeReport;
use crate::base::Lens;
use crate::metric::MetricDepth;

/// The file of metric depth, which is there only where the lens is known.
pub const DEPTH_FILE: &str = "depth_mm.exr";

/// What `report.json` says about metric depth; `null` where no pixel has one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthReport {
    /// Least, greatest and median depth of the valid pixels, mm.
    #[serde(flatten)]
    pub range: RangeReport,
    /// Valid pixels whose V no depth in the range of the lens model has, or whose V is at the limit of the solve; they are
    /// NaN.
    pub out_of_range: usize,
    /// The lens.
    pub lens: Lens,
}

impl From<&MetricDepth> for DepthReport {
    fn from(metric: &MetricDepth) -> Self {
        Self { range: RangeReport::of(&metric.depth), out_of_range: metric.out_of_range, lens: metric.lens }
    }
}

/// Writes `depth_mm.exr`: channel `Y` and channel `standard_deviation`, both mm.
pub(super) fn write(writer: impl Write + Seek, metric: &MetricDepth) -> Result<(), String> {
    let channels = [("Y", &metric.depth[..]), ("standard_deviation", &metric.deviation)];
    field::write_channels(writer, (metric.width, metric.height), &channels, &METRIC_DEPTH)
}
