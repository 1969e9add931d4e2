//! Plots: curves over linear or logarithmic axes, and profiles.

use image::RgbImage;

use super::canvas::{Align, Area, BLACK, Canvas, Color, GRAY, LIGHT, text_width};
use crate::files::export::ProfileReport;
use crate::metric::measure::Line;

/// One axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    pub(super) label: String,
    log: bool,
    /// Fixed limits; `None` follows the data.
    limits: Option<[f64; 2]>,
}

/// An axis with its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    log: bool,
    low: f64,
    high: f64,
}

/// A tick of an axis, with or without a label.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tick {
    pub value: f64,
    pub label: Option<String>,
}

impl Axis {
    /// A linear axis. `label` states the quantity and its unit.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: false, limits: None }
    }

    /// A logarithmic axis. Values that are not above 0 are drawn at the lower end.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: true, limits: None }
    }

    /// Sets the ends. Ignores ends that are not finite, not ascending, or not above 0 on a logarithmic axis.
    pub fn limits(mut self, low: f64, high: f64) -> Self {
        self.limits = Some([low, high]);
        self
    }

    /// The ends for these values. Without values: 0 to 1, or 0.1 to 1 on a logarithmic axis.
    pub(crate) fn spanning(&self, values: impl IntoIterator<Item = f64>) -> Span {
        let shown = |v: &f64| v.is_finite() && v.abs() < 1e300 && (!self.log || *v > 1e-300);
        if let Some([low, high]) = self.limits
            && [low, high].iter().all(shown)
            && low < high
        {
            return Span { log: self.log, low, high };
        }
        let least = if self.log { 0.1 } else { 0.0 };
        let ends = values.into_iter().filter(shown).map(|v| (v, v)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (low, high) = ends.unwrap_or((least, 1.0));
        let (low, high) = match (low < high, self.log) {
            (true, _) => (low, high),
            (false, true) => (low / 2.0, high * 2.0),
            (false, false) => (low - 0.5f64.max(1e-3 * low.abs()), high + 0.5f64.max(1e-3 * high.abs())),
        };
        Span { log: self.log, low, high }
    }
}

impl Span {
    /// Extends both ends by a fraction of the length.
    pub(super) fn padded(self, fraction: f64) -> Self {
        let (low, high) = (self.place(self.low), self.place(self.high));
        let room = fraction * (high - low);
        let back = |p: f64| if self.log { 10f64.powf(p) } else { p };
        Self { low: back(low - room), high: back(high + room), ..self }
    }

    /// The position of a value: 0 at the lower end, 1 at the upper end, outside these for values beyond; NaN stays NaN.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        if self.log && value <= 0.0 {
            return 0.0;
        }
        (self.place(value) - self.place(self.low)) / (self.place(self.high) - self.place(self.low))
    }

    /// Ticks between the ends, about `count` of them with labels.
    pub(crate) fn ticks(&self, count: usize) -> Vec<Tick> {
        let ticks = if self.log { self.log_ticks(count) } else { self.linear_ticks(count) };
        let slack = 1e-9 * (self.place(self.high) - self.place(self.low));
        let inside =
            |v: f64| self.place(v) >= self.place(self.low) - slack && self.place(v) <= self.place(self.high) + slack;
        ticks.into_iter().filter(|tick| inside(tick.value)).collect()
    }

    fn place(&self, value: f64) -> f64 {
        if self.log { value.log10() } else { value }
    }

    fn linear_ticks(&self, count: usize) -> Vec<Tick> {
        let step = step((self.high - self.low) / count.max(1) as f64);
        let first = (self.low / step).ceil();
        let decimals = (-step.log10().floor()).max(0.0) as usize;
        // Limits the number of ticks for any values.
        (0..=2 * count + 2)
            .map(|i| (first + i as f64) * step)
            .map(|value| Tick { value, label: Some(number(value, decimals)) })
            .collect()
    }

    /// Ticks at decades, or at every n-th decade if there are many. With few decades there are minor ticks at the
    /// multiples 2 to 9; 2 and 5 have labels.
    fn log_ticks(&self, count: usize) -> Vec<Tick> {
        let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
        let decades = self.high.log10() - self.low.log10();
        let every = (decades / count.max(1) as f64).ceil().max(1.0) as i32;
        let named = |exponent: i32, digit: i32| match digit {
            1 => exponent.rem_euclid(every) == 0,
            2 | 5 => decades < 1.7,
            _ => false,
        };
        let digits = if every == 1 { 1..10 } else { 1..2 };
        (first..=last)
            .flat_map(|exponent| digits.clone().map(move |digit| (exponent, digit)))
            .map(|(exponent, digit)| {
                let value = f64::from(digit) * 10f64.powi(exponent);
                Tick { value, label: named(exponent, digit).then(|| power(value, exponent)) }
            })
            .collect()
    }
}

/// The least of 1, 2, 5 times a power of ten that is at least `least`.
fn step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= least * (1.0 - 1e-9)).unwrap_or(10.0);
    factor * power
}

/// Formats a number with a typographic minus sign, and without one for zero.
fn number(value: f64, decimals: usize) -> String {
    if decimals > 6 || value.abs() >= 1e6 {
        return format!("{value:.1e}").replace('-', "−");
    }
    let text = format!("{value:.decimals$}");
    let zero = text.trim_start_matches(['-', '0', '.']).is_empty();
    if zero { text.trim_start_matches('-').to_string() } else { text.replace('-', "−") }
}

fn power(value: f64, exponent: i32) -> String {
    match exponent {
        -4..=-1 => format!("{value:.*}", exponent.unsigned_abs() as usize),
        0..=5 => format!("{value:.0}"),
        _ => format!("{value:.0e}").replace('-', "−"),
    }
}

/// Colours that most colour-blind readers can distinguish (Okabe and Ito 2008).
const COLORS: [Color; 6] = [[213, 94, 0], [0, 114, 178], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233]];

/// Radius of a marker, px.
const RADIUS: f32 = 4.5;

/// A named curve. A point with the y NaN failed: the curve has a gap, and a cross is drawn above the plot.
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
        Self::with_spread(name, points.into_iter().map(|(x, y)| (x, [y; 3])))
    }

    /// Points (x, [low, y, high]) with a bar from low to high, such as quartiles around a median.
    pub fn with_spread(name: impl Into<String>, points: impl IntoIterator<Item = (f64, [f64; 3])>) -> Self {
        let points = points.into_iter().map(|(x, [low, y, high])| Point { x, low, y, high }).collect();
        Self { name: name.into(), points, marked: true }
    }

    /// A plain line for many points, with its spread as a band. Where y is NaN there is a gap without a cross.
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

/// Draws the marker of the i-th series. Shapes differ too, for prints without colour.
pub(super) fn marker(canvas: &mut Canvas, (x, y): (f32, f32), index: usize) {
    let (r, color) = (RADIUS, color(index));
    match index % 4 {
        0 => canvas.disc((x, y), r, color),
        1 => {
            // The square has about the area of the disc.
            let s = 0.88 * r;
            canvas.polygon(&[(x - s, y - s), (x + s, y - s), (x + s, y + s), (x - s, y + s)], color)
        }
        2 => canvas.polygon(&[(x, y - r), (x + r, y + 0.8 * r), (x - r, y + 0.8 * r)], color),
        _ => canvas.polygon(&[(x, y - r), (x + r, y), (x, y + r), (x - r, y)], color),
    }
}

/// Draws the cross of a point that failed.
pub(super) fn cross(canvas: &mut Canvas, (x, y): (f32, f32), index: usize) {
    let r = 0.8 * RADIUS;
    canvas.line(&[(x - r, y - r), (x + r, y + r)], color(index), 1.8, None);
    canvas.line(&[(x - r, y + r), (x + r, y - r)], color(index), 1.8, None);
}

/// Size of the title, and of all other text, px.
const TITLE: f32 = 18.0;
const TEXT: f32 = 14.0;
/// Margins around the curves for numbers and labels, px.
const TOP: f32 = 40.0;
const BOTTOM: f32 = 52.0;
const RIGHT: f32 = 20.0;
/// Height of a row of the legend, px.
const LINE: f32 = 20.0;
/// Height of a row of crosses, which mark points that failed, px.
const CROSSES: f32 = 12.0;
/// Fraction of each axis that is free at either end.
const PADDING: f64 = 0.05;

/// Curves over two axes; see [the module](super) for an example.
#[derive(Clone, Debug)]
pub struct Plot {
    title: String,
    x: Axis,
    y: Axis,
    series: Vec<Series>,
    targets: Vec<(f64, String)>,
    size: (u32, u32),
}

/// The map from values to the canvas.
struct Frame {
    area: Area,
    x: Span,
    y: Span,
}

impl Frame {
    fn x(&self, value: f64) -> f32 {
        self.area.x + self.x.fraction(value) as f32 * self.area.width
    }

    fn y(&self, value: f64) -> f32 {
        // Clamps values far outside; NaN stays NaN.
        let fraction = self.y.fraction(value).clamp(-1.0, 2.0);
        self.area.bottom() - fraction as f32 * self.area.height
    }

    fn contains(&self, point: &Point) -> bool {
        let inside = |fraction: f64| (-1e-9..=1.0 + 1e-9).contains(&fraction);
        inside(self.x.fraction(point.x)) && inside(self.y.fraction(point.y))
    }
}

impl Plot {
    /// A plot without curves, 640 x 440 px.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, series: Vec::new(), targets: Vec::new(), size: (640, 440) }
    }

    /// Adds a curve.
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a dashed horizontal line with a name.
    pub fn target(mut self, y: f64, name: impl Into<String>) -> Self {
        self.targets.push((y, name.into()));
        self
    }

    /// Sets width and height of the whole picture, px: at least 240 x 180, at most 4096 a side.
    pub fn size(mut self, width: u32, height: u32) -> Self {
        self.size = (width.clamp(240, 4096), height.clamp(180, 4096));
        self
    }

    /// Draws the plot.
    pub fn draw(&self) -> RgbImage {
        let mut canvas = Canvas::new(self.size.0, self.size.1);
        let frame = self.frame();
        self.draw_axes(&mut canvas, &frame);
        for (y, name) in &self.targets {
            draw_target(&mut canvas, &frame, *y, name);
        }
        for (i, series) in self.series.iter().enumerate() {
            draw_series(&mut canvas, &frame, series, i);
        }
        self.draw_failures(&mut canvas, &frame);
        self.draw_legend(&mut canvas, &frame.area);
        canvas.into_image()
    }

    fn frame(&self) -> Frame {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let ys = points().flat_map(|p| [p.low, p.y, p.high]).chain(self.targets.iter().map(|(y, _)| *y));
        let (x, y) = (self.x.spanning(points().map(|p| p.x)), self.y.spanning(ys));
        let (x, y) = (x.padded(PADDING), y.padded(PADDING));
        let names = y.ticks(self.size.1 as usize / 60).into_iter().filter_map(|tick| tick.label);
        let numbers = names.map(|name| text_width(&name, TEXT)).fold(0.0, f32::max);
        let left = 1.6 * TEXT + numbers + 18.0;
        let legend = LINE * self.legend().len() as f32 + if self.legend().is_empty() { 0.0 } else { 6.0 };
        let top = TOP + legend + CROSSES * self.failing().count() as f32;
        let area = Area {
            x: left.round() + 0.5,
            y: top.round() + 0.5,
            width: (self.size.0 as f32 - left - RIGHT).max(1.0).round(),
            height: (self.size.1 as f32 - top - BOTTOM).max(1.0).round(),
        };
        Frame { area, x, y }
    }

    fn draw_axes(&self, canvas: &mut Canvas, frame: &Frame) {
        let area = frame.area;
        for tick in frame.x.ticks((area.width / 80.0) as usize) {
            let x = frame.x(tick.value);
            canvas.line(&[(x, area.y), (x, area.bottom())], LIGHT, grid(&tick), None);
            if let Some(label) = tick.label {
                canvas.text(&label, (x, area.bottom() + 1.4 * TEXT), TEXT, Align::Middle, BLACK);
            }
        }
        for tick in frame.y.ticks((area.height / 50.0) as usize) {
            let y = frame.y(tick.value);
            canvas.line(&[(area.x, y), (area.right(), y)], LIGHT, grid(&tick), None);
            if let Some(label) = tick.label {
                canvas.text(&label, (area.x - 8.0, y + 0.35 * TEXT), TEXT, Align::Right, BLACK);
            }
        }
        canvas.outline(area, GRAY, 1.0);
        canvas.text(&self.title, (area.x, TOP - 14.0), TITLE, Align::Left, BLACK);
        let (x, y) = area.middle();
        if self.series.iter().all(|series| series.points.iter().all(|p| !frame.contains(p))) {
            canvas.text("nothing to show", (x, y), TEXT, Align::Middle, GRAY);
        }
        canvas.text(&self.x.label, (x, area.bottom() + 3.0 * TEXT), TEXT, Align::Middle, BLACK);
        canvas.text_up(&self.y.label, (1.3 * TEXT, y), TEXT, Align::Middle, BLACK);
    }

    /// The series with failed points.
    fn failing(&self) -> impl Iterator<Item = usize> {
        let failed = |series: &Series| series.marked && series.points.iter().any(|p| p.y.is_nan());
        (0..self.series.len()).filter(move |&i| failed(&self.series[i]))
    }

    /// Draws a row of crosses above the curves for each series with failed points. On one row the crosses of two series
    /// could coincide.
    fn draw_failures(&self, canvas: &mut Canvas, frame: &Frame) {
        for (line, i) in self.failing().enumerate() {
            let y = frame.area.y - CROSSES * (line as f32 + 0.5);
            for point in self.series[i].points.iter().filter(|p| p.y.is_nan()) {
                if (0.0..=1.0).contains(&frame.x.fraction(point.x)) {
                    cross(canvas, (frame.x(point.x), y), i);
                }
            }
        }
    }

    /// Lines of the legend, with as many named series as fit on each.
    fn legend(&self) -> Vec<Vec<usize>> {
        let mut lines: Vec<Vec<usize>> = Vec::new();
        let (limit, mut used) = (self.size.0 as f32 - 80.0 - RIGHT, 0.0);
        for (i, series) in self.series.iter().enumerate().filter(|(_, series)| !series.name.is_empty()) {
            let width = entry_width(series);
            match lines.last_mut() {
                Some(line) if used + width <= limit => line.push(i),
                _ => {
                    lines.push(vec![i]);
                    used = 0.0;
                }
            }
            used += width;
        }
        lines
    }

    fn draw_legend(&self, canvas: &mut Canvas, area: &Area) {
        for (row, line) in self.legend().iter().enumerate() {
            let (mut x, y) = (area.x, TOP + LINE * (row as f32 + 0.5));
            for &i in line {
                canvas.line(&[(x, y), (x + 24.0, y)], color(i), 2.0, None);
                marker(canvas, (x + 12.0, y), i);
                canvas.text(&self.series[i].name, (x + 31.0, y + 0.35 * TEXT), TEXT, Align::Left, BLACK);
                x += entry_width(&self.series[i]);
            }
        }
    }
}

fn entry_width(series: &Series) -> f32 {
    31.0 + text_width(&series.name, TEXT) + 20.0
}

/// Width of the line of the grid at a tick.
fn grid(tick: &Tick) -> f32 {
    if tick.label.is_some() { 1.0 } else { 0.5 }
}

fn draw_target(canvas: &mut Canvas, frame: &Frame, value: f64, name: &str) {
    let (y, area) = (frame.y(value), frame.area);
    if y >= area.y && y <= area.bottom() {
        canvas.line(&[(area.x, y), (area.right(), y)], GRAY, 1.5, Some(10.0));
        canvas.text(name, (area.right() - 6.0, y - 5.0), TEXT, Align::Right, GRAY);
    }
}

fn draw_series(canvas: &mut Canvas, frame: &Frame, series: &Series, index: usize) {
    for run in series.points.split(|p| !frame.contains(p)) {
        let line: Vec<(f32, f32)> = run.iter().map(|p| (frame.x(p.x), frame.y(p.y))).collect();
        if !series.marked {
            draw_band(canvas, frame, run, index);
        }
        canvas.line(&line, color(index), 2.0, None);
        for (point, &(x, y)) in run.iter().zip(&line).filter(|_| series.marked) {
            draw_spread(canvas, frame, point, x, index);
            marker(canvas, (x, y), index);
        }
    }
}

/// The spread of a point, or the point itself if the ends are not finite.
fn draw_band(canvas: &mut Canvas, frame: &Frame, run: &[Point], index: usize) {
    let edge = |end: fn(&Point) -> f64| {
        run.iter().map(move |p| {
            let value = if end(p).is_finite() { end(p) } else { p.y };
            (frame.x(p.x), frame.y(value).clamp(frame.area.y, frame.area.bottom()))
        })
    };
    let outline: Vec<(f32, f32)> = edge(|p| p.low).chain(edge(|p| p.high).rev()).collect();
    canvas.polygon(&outline, pale(index));
}

fn draw_spread(canvas: &mut Canvas, frame: &Frame, point: &Point, x: f32, index: usize) {
    let ends = [point.low, point.high].map(|v| frame.y(v).clamp(frame.area.y, frame.area.bottom()));
    if point.low == point.high || ends.iter().any(|y| y.is_nan()) {
        return;
    }
    canvas.line(&[(x, ends[0]), (x, ends[1])], color(index), 1.2, None);
    for y in ends {
        canvas.line(&[(x - 3.0, y), (x + 3.0, y)], color(index), 1.2, None);
    }
}

/// Draws a profile of depth, or of V or focus if depth is not known, with one standard deviation to either side.
pub(crate) fn profile(profile: &ProfileReport) -> RgbImage {
    let Line { from: [x1, y1], to: [x2, y2], width } = profile.line;
    let ([values, deviations], label) = match &profile.depth {
        Some(depth) => (depth, "depth, mm".to_string()),
        None => (&profile.values, profile.label()),
    };
    let (factor, unit) = profile.pixel_mm.map_or((1.0, "px"), |mm| (mm, "mm"));
    let points = profile.distances().zip(values).zip(deviations).map(|((at, v), d)| (factor * at, [v - d, *v, v + d]));
    let title = format!("From ({x1}, {y1}) to ({x2}, {y2}), {width} px wide");
    let series = Series::with_spread("", points).unmarked();
    let along = Axis::linear(format!("along the line, {unit}"));
    Plot::new(title, along, Axis::linear(label)).series(series).size(800, 440).draw()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(span: &Span, count: usize) -> Vec<String> {
        span.ticks(count).into_iter().filter_map(|tick| tick.label).collect()
    }

    #[test]
    fn linear_ticks_are_round_numbers_within_the_ends() {
        let axis = Axis::linear("x");
        assert_eq!(labels(&axis.spanning([-0.3, 1.0]), 5), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(&axis.spanning([-50.0, 6.0]), 6), ["−50", "−40", "−30", "−20", "−10", "0"]);
        assert_eq!(labels(&axis.spanning([0.0, 0.004]), 4), ["0.000", "0.001", "0.002", "0.003", "0.004"]);
    }

    #[test]
    fn log_ticks_have_labels_at_decades_and_marks_between() {
        let span = Axis::log("x").spanning([0.001, 10.0]);
        assert_eq!(labels(&span, 5), ["0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(span.ticks(5).len(), 4 * 9 + 1);
        assert_eq!(labels(&Axis::log("x").spanning([0.9, 12.0]), 5), ["1", "2", "5", "10"]);
        assert_eq!(labels(&Axis::log("x").spanning([1e-12, 1e12]), 4), ["1e−12", "1e−6", "1", "1e6", "1e12"]);
        assert_eq!(span.fraction(0.1), 0.5);
        assert_eq!((span.fraction(0.0), span.fraction(-3.0)), (0.0, 0.0));
    }

    #[test]
    fn any_values_make_an_axis() {
        for axis in
            [Axis::linear("x"), Axis::log("x"), Axis::log("x").limits(-1.0, 1.0), Axis::linear("x").limits(1.0, 1.0)]
        {
            for values in [&[][..], &[f64::NAN, f64::INFINITY], &[3.0], &[0.0], &[-1e299, 1e299], &[1e-320, 1e-320]] {
                let span = axis.spanning(values.iter().copied()).padded(0.05);
                assert!(span.low < span.high, "{axis:?} {values:?} {span:?}");
                assert!(span.ticks(5).len() < 800, "{axis:?} {values:?}");
                assert!(span.ticks(0).iter().all(|tick| tick.value.is_finite()));
            }
        }
    }

    #[test]
    fn limits_take_precedence_over_the_data() {
        let span = Axis::linear("x").limits(0.0, 2.0).spanning([5.0]);
        assert_eq!((span.fraction(1.0), span.fraction(5.0)), (0.5, 2.5));
    }

    fn plot() -> Plot {
        Plot::new("", Axis::linear("x").limits(0.0, 10.0), Axis::linear("y").limits(0.0, 1.0))
    }

    fn has(image: &RgbImage, wanted: [u8; 3], x: std::ops::Range<u32>) -> bool {
        image.enumerate_pixels().any(|(at, _, p)| x.contains(&at) && p.0 == wanted)
    }

    #[test]
    fn points_are_drawn_at_the_positions_of_the_axes() {
        let plot = plot().series(Series::new("a", [(5.0, 0.5)]));
        let (x, y) = plot.frame().area.middle();
        let image = plot.draw();
        assert_eq!(image.get_pixel(x as u32, y as u32).0, color(0));
        assert_eq!(image.dimensions(), (640, 440));
    }

    #[test]
    fn a_failed_point_leaves_a_gap_and_a_cross() {
        let plot = plot().series(Series::new("", [(0.0, 0.5), (4.0, 0.5), (5.0, f64::NAN), (6.0, 0.5), (10.0, 0.5)]));
        let frame = plot.frame();
        let image = plot.draw();
        let (gap, line) = (frame.x(5.0), frame.x(2.0));
        let middle = frame.y(0.5) as u32;
        assert_eq!(image.get_pixel(line as u32, middle).0, color(0));
        assert_ne!(image.get_pixel(gap as u32, middle).0, color(0));
        let above = frame.area.y as u32 - 6;
        assert!((0..5).any(|d| image.get_pixel(gap as u32 + d - 2, above).0 == color(0)), "no cross");
    }

    #[test]
    fn values_beyond_the_limits_are_not_drawn() {
        let image = plot().series(Series::new("", [(5.0, 7.0)])).draw();
        assert!(!has(&image, color(0), 200..640));
    }

    #[test]
    fn spreads_reach_from_low_to_high() {
        let plot = plot().series(Series::with_spread("", [(5.0, [0.2, 0.5, 0.9])]));
        let (frame, image) = (plot.frame(), plot.draw());
        let at = |v: f64| {
            (frame.x(5.0) as u32 - 1..=frame.x(5.0) as u32 + 1)
                .any(|x| image.get_pixel(x, frame.y(v) as u32).0 != [255; 3])
        };
        assert!(at(0.25) && at(0.85) && !at(0.97), "{:?}", frame.area);
    }

    #[test]
    fn an_unmarked_series_has_a_band_and_neither_markers_nor_crosses() {
        let points = [(2.0, [0.3, 0.5, 0.7]), (8.0, [0.3, 0.5, 0.7]), (9.0, [f64::NAN; 3])];
        let plot = plot().series(Series::with_spread("", points).unmarked());
        let (frame, image) = (plot.frame(), plot.draw());
        let at = |x: f64, y: f64| image.get_pixel(frame.x(x) as u32, frame.y(y) as u32).0;
        assert_eq!((at(5.0, 0.5), at(5.0, 0.6)), (color(0), pale(0)));
        assert!(plot.failing().next().is_none() && at(9.0, 0.5) != color(0));
    }

    #[test]
    fn unusual_data_is_drawn() {
        let nan = f64::NAN;
        let wild =
            [(nan, nan), (f64::INFINITY, 1.0), (1.0, f64::NEG_INFINITY), (0.0, 0.0), (-1.0, -1.0), (1e300, 1e-300)];
        for (x, y) in [(Axis::linear("x"), Axis::log("y")), (Axis::log("x"), Axis::linear("y"))] {
            for points in [&wild[..], &wild[..1], &wild[..2], &[]] {
                let series = Series::new("s", points.iter().copied());
                let spread = Series::with_spread("t", points.iter().map(|&(x, y)| (x, [y, nan, y])));
                let plot =
                    Plot::new("t", x.clone(), y.clone()).series(series).series(spread).target(nan, "t").size(1, 1);
                assert_eq!(plot.draw().dimensions(), (240, 180));
            }
        }
    }

    #[test]
    fn many_names_fill_several_lines() {
        let mut plot = plot();
        for i in 0..12 {
            plot = plot.series(Series::new(format!("a rather long name {i}"), []));
        }
        let lines = plot.legend();
        assert!(lines.len() > 1);
        assert_eq!(lines.concat(), (0..12).collect::<Vec<_>>());
    }
}
