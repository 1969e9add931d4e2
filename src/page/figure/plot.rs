//! Plots: curves over linear or logarithmic axes.

use image::RgbImage;

use super::axis::{Axis, Span};
use super::canvas::{Align, Area, BLACK, Canvas, GRAY, LIGHT};
use super::series::{Point, Series, color, cross, marker, pale};
use super::text;

/// Size of the title, and of everything else, px.
const TITLE: f32 = 18.0;
const TEXT: f32 = 14.0;
/// Room around the area of the curves for numbers and names, px.
const TOP: f32 = 40.0;
const BOTTOM: f32 = 52.0;
const RIGHT: f32 = 20.0;
/// Height of a line of the legend, px.
const LINE: f32 = 20.0;
/// Height of a line of crosses, px.
const CROSSES: f32 = 12.0;
/// Part of the axes left free at either end.
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

/// Where values stand on the canvas.
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
        // Within reach of the canvas, whatever the value: NaN stays.
        let fraction = self.y.fraction(value).clamp(-1.0, 2.0);
        self.area.bottom() - fraction as f32 * self.area.height
    }

    fn holds(&self, point: &Point) -> bool {
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

    /// Width and height of the whole picture, px; at least 240 x 180, at most 4096 a side.
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
        let numbers = names.map(|name| text::width(&name, TEXT)).fold(0.0, f32::max);
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
            canvas.line(&[(x, area.y), (x, area.bottom())], LIGHT, grid(tick.label.is_some()), None);
            if let Some(label) = tick.label {
                canvas.text(&label, (x, area.bottom() + 1.4 * TEXT), TEXT, Align::Middle, BLACK);
            }
        }
        for tick in frame.y.ticks((area.height / 50.0) as usize) {
            let y = frame.y(tick.value);
            canvas.line(&[(area.x, y), (area.right(), y)], LIGHT, grid(tick.label.is_some()), None);
            if let Some(label) = tick.label {
                canvas.text(&label, (area.x - 8.0, y + 0.35 * TEXT), TEXT, Align::Right, BLACK);
            }
        }
        canvas.outline(area, GRAY, 1.0);
        canvas.text(&self.title, (area.x, TOP - 14.0), TITLE, Align::Left, BLACK);
        let (x, y) = area.middle();
        if self.series.iter().all(|series| series.points.iter().all(|p| !frame.holds(p))) {
            canvas.text("nothing to show", (x, y), TEXT, Align::Middle, GRAY);
        }
        canvas.text(&self.x.label, (x, area.bottom() + 3.0 * TEXT), TEXT, Align::Middle, BLACK);
        canvas.text_up(&self.y.label, (1.3 * TEXT, y), TEXT, Align::Middle, BLACK);
    }

    /// The series of which a point failed.
    fn failing(&self) -> impl Iterator<Item = usize> {
        let failed = |series: &Series| series.marked && series.points.iter().any(|p| p.y.is_nan());
        (0..self.series.len()).filter(move |&i| failed(&self.series[i]))
    }

    /// A line of crosses above the curves for each series of which a point failed: two in one place would look like one.
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

    /// Lines of the legend, each with the named series in it: as many as fit beside each other.
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
    31.0 + text::width(&series.name, TEXT) + 20.0
}

fn grid(named: bool) -> f32 {
    if named { 1.0 } else { 0.5 }
}

fn draw_target(canvas: &mut Canvas, frame: &Frame, value: f64, name: &str) {
    let (y, area) = (frame.y(value), frame.area);
    if y >= area.y && y <= area.bottom() {
        canvas.line(&[(area.x, y), (area.right(), y)], GRAY, 1.5, Some(10.0));
        canvas.text(name, (area.right() - 6.0, y - 5.0), TEXT, Align::Right, GRAY);
    }
}

fn draw_series(canvas: &mut Canvas, frame: &Frame, series: &Series, index: usize) {
    for run in series.points.split(|p| !frame.holds(p)) {
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

/// From low to high; where these are not finite, no wider than the curve itself.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn plot() -> Plot {
        Plot::new("", Axis::linear("x").limits(0.0, 10.0), Axis::linear("y").limits(0.0, 1.0))
    }

    fn has(image: &RgbImage, wanted: [u8; 3], x: std::ops::Range<u32>) -> bool {
        image.enumerate_pixels().any(|(at, _, p)| x.contains(&at) && p.0 == wanted)
    }

    #[test]
    fn points_land_where_the_axes_say() {
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
    fn what_is_beyond_the_limits_is_not_drawn() {
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
    fn odd_data_is_drawn_all_the_same() {
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
    fn many_names_take_several_lines() {
        let mut plot = plot();
        for i in 0..12 {
            plot = plot.series(Series::new(format!("a rather long name {i}"), []));
        }
        let lines = plot.legend();
        assert!(lines.len() > 1);
        assert_eq!(lines.concat(), (0..12).collect::<Vec<_>>());
    }
}
