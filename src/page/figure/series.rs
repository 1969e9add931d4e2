//! One curve of a plot.

use super::canvas::{Canvas, Color};

/// Colours that remain apart for most colour-blind readers (Okabe and Ito 2008).
const COLORS: [Color; 6] = [[213, 94, 0], [0, 114, 178], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233]];

/// Radius of a marker, px.
const RADIUS: f32 = 4.5;

/// A named curve. A point whose y is NaN failed: the curve has a gap there and a cross above the plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    pub(super) name: String,
    pub(super) points: Vec<Point>,
    /// Whether points have markers, bars of their spread, and crosses where they failed.
    pub(super) marked: bool,
}

/// A point with the ends of its spread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub x: f64,
    pub low: f64,
    pub y: f64,
    pub high: f64,
}

impl Series {
    /// Points (x, y), joined in this order.
    pub fn new(name: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let points = points.into_iter().map(|(x, y)| Point { x, low: y, y, high: y }).collect();
        Self { name: name.into(), points, marked: true }
    }

    /// Points (x, [low, y, high]) with a bar from low to high, such as quartiles around a median.
    pub fn with_spread(name: impl Into<String>, points: impl IntoIterator<Item = (f64, [f64; 3])>) -> Self {
        let points = points.into_iter().map(|(x, [low, y, high])| Point { x, low, y, high }).collect();
        Self { name: name.into(), points, marked: true }
    }

    /// A plain line for many points, with its spread as a band; where y is NaN there is a gap and no cross.
    pub fn unmarked(self) -> Self {
        Self { marked: false, ..self }
    }
}

/// The colour of the i-th series.
pub(super) fn color(index: usize) -> Color {
    COLORS[index % COLORS.len()]
}

/// The colour of the band of the i-th series.
pub(super) fn pale(index: usize) -> Color {
    color(index).map(|c| 255 - (255 - c) / 4)
}

/// Draws the marker of the i-th series: shapes differ too, for prints without colour.
pub(super) fn marker(canvas: &mut Canvas, (x, y): (f32, f32), index: usize) {
    let (r, color) = (RADIUS, color(index));
    match index % 4 {
        0 => canvas.disc((x, y), r, color),
        1 => {
            canvas.polygon(&[(x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r)].map(shrunk((x, y))), color)
        }
        2 => canvas.polygon(&[(x, y - r), (x + r, y + 0.8 * r), (x - r, y + 0.8 * r)], color),
        _ => canvas.polygon(&[(x, y - r), (x + r, y), (x, y + r), (x - r, y)], color),
    }
}

/// Brings the corners of the square in, so that its area is near that of the disc.
fn shrunk((cx, cy): (f32, f32)) -> impl Fn((f32, f32)) -> (f32, f32) {
    move |(x, y)| (cx + 0.88 * (x - cx), cy + 0.88 * (y - cy))
}

/// Draws the cross of a point that failed.
pub(super) fn cross(canvas: &mut Canvas, (x, y): (f32, f32), index: usize) {
    let r = 0.8 * RADIUS;
    canvas.line(&[(x - r, y - r), (x + r, y + r)], color(index), 1.8, None);
    canvas.line(&[(x - r, y + r), (x + r, y - r)], color(index), 1.8, None);
}
