//! A profile as a curve.

use image::RgbImage;

use super::{Axis, Plot, Series};
use crate::files::export::ProfileReport;
use crate::metric::measure::Line;

/// Depth where it is known, else V or focus; with one standard deviation to either side.
pub(crate) fn profile(profile: &ProfileReport) -> RgbImage {
    let Line { from: [x1, y1], to: [x2, y2], width } = profile.line;
    let ([values, deviations], label) = match &profile.depth {
        Some(depth) => (depth, "depth, mm".to_string()),
        None => (&profile.values, profile.label()),
    };
    let points = profile.distances().zip(values).zip(deviations).map(|((at, v), d)| (at, [v - d, *v, v + d]));
    let title = format!("From ({x1}, {y1}) to ({x2}, {y2}), {width} px wide");
    let series = Series::with_spread("", points).unmarked();
    Plot::new(title, Axis::linear("along the line, px"), Axis::linear(label)).series(series).size(800, 440).draw()
}
