//! The key to the colours of V.

use super::axis::Axis;
use super::canvas::{Align, Area, BLACK, Canvas, GRAY};
use super::text;
use crate::export::{Scale, color};

/// Px between the bar and its numbers.
const GAP: f32 = 7.0;

/// Draws a colour bar, near on top, with values of V to its right in text of this size. Of the area, the left part is
/// the bar; the right must hold the numbers.
pub(crate) fn color_bar(canvas: &mut Canvas, area: Area, scale: &Scale, size: f32) {
    let bar = Area { width: 0.9 * size, ..area };
    // Whole rows: antialiased edges between them would show as stripes.
    let (top, bottom) = (bar.y.round(), bar.bottom().round());
    for row in 0..(bottom - top).max(0.0) as u32 {
        let nearness = 1.0 - (f64::from(row) + 0.5) / f64::from(bottom - top);
        canvas.fill(Area { y: top + row as f32, height: 1.0, ..bar }, color(nearness));
    }
    canvas.outline(Area { y: top, height: bottom - top, ..bar }, GRAY, 1.0);
    let axis = Axis::linear("").spanning([f64::from(scale.low), f64::from(scale.high)]);
    for tick in axis.ticks((area.height / (2.5 * size)) as usize) {
        let Some(label) = tick.label else { continue };
        let y = bottom - scale.nearness(tick.value as f32) as f32 * (bottom - top);
        canvas.line(&[(bar.right(), y), (bar.right() + 3.0, y)], GRAY, 1.0, None);
        canvas.text(&label, (bar.right() + GAP, y + 0.35 * size), size, Align::Left, BLACK);
    }
}

/// Width that a colour bar with its numbers takes, px.
pub(crate) fn width(size: f32) -> f32 {
    0.9 * size + GAP + text::width("−188.8", size)
}
