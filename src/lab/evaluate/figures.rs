//! The figures: those of the paper, by its numbers, and the curves.

use super::Figure;
use super::cases::{self, RealPair};
use super::descent::{Race, Run};
use super::robustness::{PAPER_PX, Sweep};
use super::system::{NONE, SystemResult};
use super::table::number;
use crate::base::Region;
use crate::base::{Frame, Method, Samples};
use crate::engine::Solution;
use crate::files::export::{Nearer, Scale};
use crate::lab::contact_sheet::{PALETTE, Panel, Row, Sheet};
use crate::page::figure::{Axis, Plot, Series};
use crate::page::view::{Surface, View};

/// A system by its name, and what it found or why not.
pub(super) type Solved = [(&'static str, Result<Solution, String>)];

/// The names of all figures that there may be.
pub(super) fn names() -> impl Iterator<Item = String> {
    let of_pairs = cases::pair_names().map(|name| format!("fig8-{name}"));
    ["fig4-scenes", "fig6-real", "fig7-closeups", "fig9-focus", "robustness", "descent"]
        .into_iter()
        .map(String::from)
        .chain(of_pairs)
}

/// Rows of the sheets, drawn as soon as a pair is solved: all solutions together would not fit into memory.
#[derive(Default)]
pub(super) struct Collector {
    scenes: Vec<Row>,
    real: Vec<Row>,
    close_ups: Vec<Row>,
    focus: Vec<Row>,
    views: Vec<Figure>,
}

const RED: [u8; 3] = [230, 30, 30];
const BLUE: [u8; 3] = [30, 90, 230];

impl Collector {
    /// A row of Figure 4.
    pub(super) fn scene(&mut self, name: &str, i1: &Frame, solved: &Solved, results: &[SystemResult]) {
        // Zero belongs to the scale: where V is the same all over, rounding must not fill the colours.
        let zero = [0.0];
        let trusted = [Method::Unified.name(), super::system::REFERENCE];
        let fields = solved.iter().filter(|(name, _)| trusted.contains(name)).filter_map(|(_, s)| s.as_ref().ok());
        let scale = Scale::common(fields.map(|s| &s.relative_blur[..]).chain([&zero[..]]), Nearer::First);
        let panels = solved.iter().zip(results).map(|((_, solution), result)| {
            let caption = match result.corner_px() {
                Some(corner) => format!("corners {} px off", number(corner)),
                None => String::new(),
            };
            blur(solution, &scale).caption(caption)
        });
        let row =
            Row::new(name).scale(scale).panels([Panel::photograph(&shown(i1))]).panels(panels.collect::<Vec<_>>());
        self.scenes.push(row);
    }

    /// A row of Figures 6, 7 and 9, and a Figure 8.
    pub(super) fn real(&mut self, pair: &RealPair, [i1, i2]: [&Frame; 2], solved: &Solved) {
        let unified =
            solved.iter().find(|(name, _)| *name == Method::Unified.name()).and_then(|(_, s)| s.as_ref().ok());
        let Some(unified) = unified else {
            for rows in [&mut self.real, &mut self.close_ups, &mut self.focus] {
                rows.push(Row::new(pair.name).panels([Panel::missing("the unified method failed")]));
            }
            return;
        };
        let scale = Scale::of(&unified.relative_blur, pair.nearer);
        let [first, second] = sharpest(unified);
        let photograph = Panel::photograph(i1).mark(first, RED);
        let panels: Vec<Panel> = solved.iter().map(|(_, solution)| blur(solution, &scale)).collect();
        let close: Vec<Panel> = panels.iter().map(|panel| panel.clone().crop(first)).collect();
        let row = || Row::new(pair.name).scale(scale);
        self.close_ups.push(row().panels([Panel::photograph(i1).crop(first)]).panels(close));
        self.real.push(row().panels([photograph]).panels(panels));
        let Some(fused) = fused(unified) else { return };
        let images = [i1, i2, &fused].map(Panel::photograph);
        let marked = images.clone().map(|panel| panel.mark(first, RED).mark(second, BLUE));
        let closer = [first, second].into_iter().flat_map(|region| images.clone().map(|panel| panel.crop(region)));
        self.focus.push(Row::new(pair.name).panels(marked).panels(closer.collect::<Vec<_>>()));
        let view = View { palette: PALETTE, ..View::default() };
        let surface = Surface::new(&unified.relative_blur, &fused, pair.nearer);
        if let Ok(picture) = surface.and_then(|surface| surface.picture(&view)) {
            let caption = format!("{}: the surface in three dimensions; heights order near and far.", pair.name);
            self.views.push(Figure { name: format!("fig8-{}", pair.name), caption, picture });
        }
    }

    /// All figures, in the order of the paper; those without a row are left out.
    pub(super) fn finish(self, robustness: &[Sweep], descent: &[Race]) -> Vec<Figure> {
        let systems = ["I1", "without registration", "appearance", "SIFT", "unified"];
        let scenes = ["I1", "without registration", "appearance", "SIFT", "unified", "aligned pair"];
        let focus = [
            "I1",
            "I2",
            "best focus",
            "I1, red",
            "I2, red",
            "best focus, red",
            "I1, blue",
            "I2, blue",
            "best focus, blue",
        ];
        let sheets = [
            (
                "fig4-scenes",
                "V of pairs whose registration is known (the paper's Figure 4).",
                190,
                scenes.to_vec(),
                self.scenes,
            ),
            ("fig6-real", "V of photographs (the paper's Figure 6).", 260, systems.to_vec(), self.real),
            (
                "fig7-closeups",
                "Close-ups of V (the paper's Figure 7), where Figure 6 is marked.",
                260,
                systems.to_vec(),
                self.close_ups,
            ),
            (
                "fig9-focus",
                "Best focus (the paper's Figure 9), with close-ups where V is greatest (red: I1 the \
             sharper, if it is anywhere) and least (blue: I2).",
                190,
                focus.to_vec(),
                self.focus,
            ),
        ];
        let mut figures = Vec::new();
        for (name, caption, width, columns, rows) in sheets {
            if rows.is_empty() {
                continue;
            }
            let footer = if name == "fig9-focus" { "" } else { FOOTER };
            let sheet = Sheet::new(caption).columns(columns).panel_width(width).footer(footer);
            let sheet = rows.into_iter().fold(sheet, Sheet::row);
            figures.push(Figure { name: name.to_string(), caption: caption.to_string(), picture: sheet.draw() });
        }
        let place = figures.len().saturating_sub(1);
        figures.splice(place..place, self.views);
        figures.push(curves(robustness));
        figures.push(race(descent));
        figures
    }
}

const FOOTER: &str = "A row has one scale, from V of the unified method (and of the aligned pair); red is near, blue \
                      far, grey not valid. What lies beyond the scale has its end colours.";

fn blur(solution: &Result<Solution, String>, scale: &Scale) -> Panel {
    match solution {
        Ok(s) => Panel::relative_blur(s.width, s.height, &s.relative_blur, scale),
        Err(reason) => Panel::missing(reason.clone()),
    }
}

/// A frame whose samples may leave 0 to 1.
fn shown(frame: &Frame) -> Frame {
    let Samples::F32(values) = frame.samples() else { return frame.clone() };
    let clipped = values.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Frame::new(frame.width(), frame.height(), frame.format().channels, Samples::F32(clipped))
        .unwrap_or_else(|_| frame.clone())
}

fn fused(solution: &Solution) -> Option<Frame> {
    let values = solution.fused.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Frame::new(solution.width, solution.height, solution.fused_channels, Samples::F32(values)).ok()
}

/// Parts of a picture along each side, among which close-ups are chosen.
const PARTS: u32 = 6;

/// Where I1 and where I2 is the sharper by most: the parts with the greatest and the least mean of V, of those in
/// which the images say most about it.
fn sharpest(solution: &Solution) -> [Region; 2] {
    let (width, height) = ((solution.width / PARTS).max(1), (solution.height / PARTS).max(1));
    let parts = (1..PARTS - 1).flat_map(|j| (1..PARTS - 1).map(move |i| (i * width, j * height)));
    let mut means: Vec<(f64, f64, Region)> = parts
        .map(|(x, y)| {
            let region = Region { x, y, width, height };
            (mean(solution, &solution.confidence, region), mean(solution, &solution.relative_blur, region), region)
        })
        .filter(|(_, v, _)| v.is_finite())
        .collect();
    means.sort_by(|a, b| b.0.total_cmp(&a.0));
    means.truncate(means.len().div_ceil(2));
    let whole = Region { x: 0, y: 0, width: solution.width, height: solution.height };
    let most = means.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(whole, |m| m.2);
    let least = means.iter().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(whole, |m| m.2);
    [most, least]
}

/// Over the valid pixels of a part.
fn mean(solution: &Solution, field: &[f32], region: Region) -> f64 {
    let rows = region.y..region.y + region.height;
    let pixels = rows.flat_map(|y| (region.x..region.x + region.width).map(move |x| (y * solution.width + x) as usize));
    let (mut sum, mut count) = (0.0, 0u32);
    for i in pixels.filter(|i| solution.relative_blur[*i].is_finite()) {
        sum += f64::from(field[i]);
        count += 1;
    }
    sum / f64::from(count)
}

/// Robustness: a plot a sweep.
fn curves(sweeps: &[Sweep]) -> Figure {
    let caption = "Corner error as scenes get harder: median over the seeds, bars from least to greatest.";
    let plots: Vec<Panel> = sweeps.iter().map(|sweep| Panel::image(curve(sweep))).collect();
    Figure { name: "robustness".to_string(), caption: caption.to_string(), picture: grid(caption, &plots, 3) }
}

fn curve(sweep: &Sweep) -> image::RgbImage {
    let x = if sweep.logarithmic { Axis::log(sweep.quantity) } else { Axis::linear(sweep.quantity) };
    let mut plot = Plot::new(sweep.name, x, Axis::log("corner error, px").limits(1e-4, 100.0))
        .target(PAPER_PX, "the paper's bound");
    let finite = |v: f64| if v.is_finite() { v } else { f64::NAN };
    for (i, first) in sweep.points.first().map_or(&[][..], |p| &p.systems).iter().enumerate() {
        let points = sweep.points.iter().filter_map(|point| {
            let s = point.systems.get(i)?.spread;
            Some((point.value, [s.low, s.median, s.high].map(finite)))
        });
        plot = plot.series(Series::with_spread(called(first.system), points));
    }
    plot.draw()
}

/// Gauss-Newton against gradient descent: a row a scene.
fn race(races: &[Race]) -> Figure {
    let caption = "Gauss-Newton against gradient descent: what whole solves reach with more and more iterations.";
    type Axes = (fn() -> Axis, fn(&Race, &Run) -> Option<f64>);
    let iterations: Axes = (|| Axis::log("outer iterations a level"), |_, run| Some(f64::from(run.iterations)));
    let time: Axes = (|| Axis::log("time, s"), |_, run| run.time_ms.map(|ms| ms / 1e3));
    let energy: Axes = (
        || Axis::log("energy above the best, %").limits(1e-3, 1e3),
        |race, run| race.above_best(run).map(|share| 100.0 * share),
    );
    let corner: Axes = (|| Axis::log("corner error, px").limits(1e-3, 10.0), |_, run| run.corner_px);
    let mut plots = Vec::new();
    for race in races {
        for (x, y) in [(iterations, energy), (time, energy), (iterations, corner)] {
            let mut plot = Plot::new(race.scene, x.0(), y.0());
            for scheme in &race.schemes {
                let points =
                    scheme.runs.iter().filter_map(|run| Some((x.1(race, run)?, y.1(race, run).unwrap_or(f64::NAN))));
                plot = plot.series(Series::new(scheme.name(), points));
            }
            plots.push(Panel::image(plot.draw()));
        }
    }
    Figure { name: "descent".to_string(), caption: caption.to_string(), picture: grid(caption, &plots, 3) }
}

fn grid(title: &str, plots: &[Panel], columns: usize) -> image::RgbImage {
    let rows = plots.chunks(columns).map(|row| Row::new("").panels(row.to_vec()));
    rows.fold(Sheet::new(title).panel_width(640), Sheet::row).draw()
}

/// How the report calls a system.
pub(super) fn called(system: &str) -> &str {
    match system {
        NONE => "no registration",
        "sift" => "SIFT",
        other => other,
    }
}
