//! The figures: those of the paper, with its numbers, and curves of robustness.

use super::Figure;
use super::pairs::PhotographedPair;
use super::robustness::{Curve, PAPER_PX};
use super::runner::METHODS;
use super::section::number;
use crate::base::{Frame, Method, Samples};
use crate::engine::Solution;
use crate::files::export::{Nearer, Scale};
use crate::lab::contact_sheet::{PALETTE, Panel, Row, Sheet};
use crate::page::figure::{Axis, Plot, Series};
use crate::page::view::{Surface, View};

/// The name of the solve without registration, with T held at the identity.
pub(super) const NONE: &str = "no registration";
/// The name of the solve of the pair without displacement, with T held at the identity.
pub(super) const ALIGNED: &str = "aligned pair";

/// The name of a method, and its solution or the reason for its failure.
pub(super) type Solved = (&'static str, Result<Solution, String>);

const SCENES: &str = "fig4-scenes";
const PHOTOGRAPHS: &str = "fig6-photographs";
const ROBUSTNESS: &str = "robustness";

/// The names of all figures that an evaluation may have.
pub(super) fn names() -> Vec<String> {
    let surfaces = PhotographedPair::all().map(|pair| surface_name(&pair));
    [SCENES, PHOTOGRAPHS, ROBUSTNESS].map(String::from).into_iter().chain(surfaces).collect()
}

fn surface_name(pair: &PhotographedPair) -> String {
    format!("fig8-{}", pair.name)
}

/// Rows of the sheets. They are drawn as soon as a pair is solved, since all solutions together would not fit into
/// memory.
#[derive(Default)]
pub(super) struct Collector {
    scenes: Vec<Row>,
    photographs: Vec<Row>,
    surfaces: Vec<Figure>,
}

impl Collector {
    /// Adds a row to Figure 4, with the corner error in px below each panel.
    pub(super) fn scene(&mut self, name: &str, i1: &Frame, solved: &[Solved], corners: &[Option<f64>]) {
        // The scale includes zero. Otherwise rounding would fill the colours where V is constant.
        let zero = [0.0];
        let trusted = [Method::Unified.name(), ALIGNED];
        let fields = solved.iter().filter(|(name, _)| trusted.contains(name)).filter_map(|(_, s)| s.as_ref().ok());
        let scale = Scale::common(fields.map(|s| &s.relative_blur[..]).chain([&zero[..]]), Nearer::First);
        let panels = solved.iter().zip(corners).map(|((_, solution), corner)| {
            let caption = corner.map_or(String::new(), |corner| format!("corners {} px off", number(corner)));
            blur(solution, &scale).caption(caption)
        });
        let photograph = Panel::photograph(&clipped(i1));
        self.scenes.push(Row::new(name).scale(scale).panels([photograph]).panels(panels.collect::<Vec<_>>()));
    }

    /// Adds a row to Figure 6, and a surface for Figure 8.
    pub(super) fn photographs(&mut self, pair: &PhotographedPair, [i1, _]: [&Frame; 2], solved: &[Solved]) {
        let unified = solved.iter().find(|(name, _)| *name == Method::Unified.name());
        let Some(unified) = unified.and_then(|(_, solution)| solution.as_ref().ok()) else {
            self.photographs.push(Row::new(pair.name).panels([Panel::missing("the unified method failed")]));
            return;
        };
        let scale = Scale::of(&unified.relative_blur, pair.nearer);
        let panels: Vec<Panel> = solved.iter().map(|(_, solution)| blur(solution, &scale)).collect();
        self.photographs.push(Row::new(pair.name).scale(scale).panels([Panel::photograph(i1)]).panels(panels));
        let samples = Samples::F32(unified.fused.iter().map(|v| v.clamp(0.0, 1.0)).collect());
        let fused = Frame::new(unified.width, unified.height, unified.fused_channels, samples);
        let surface = fused.ok().map(|fused| Surface::new(&unified.relative_blur, &fused, pair.nearer));
        let view = View { palette: PALETTE, ..View::default() };
        if let Some(Ok(picture)) = surface.map(|surface| surface.and_then(|surface| surface.picture(&view))) {
            let caption = format!("{}: the surface in three dimensions; heights order near and far.", pair.name);
            self.surfaces.push(Figure { name: surface_name(pair), caption, picture });
        }
    }

    /// All figures, in the order of the paper; sheets without a row are left out.
    pub(super) fn finish(self, robustness: &[Curve]) -> Vec<Figure> {
        let methods = || ["I1", NONE].into_iter().chain(METHODS.map(Method::name));
        let known = "V of pairs whose registration is known (the paper's Figure 4).";
        let mut figures = Vec::from_iter(sheet(SCENES, known, 190, methods().chain([ALIGNED]), self.scenes));
        figures.extend(sheet(
            PHOTOGRAPHS,
            "V of photographs (the paper's Figure 6).",
            260,
            methods(),
            self.photographs,
        ));
        figures.extend(self.surfaces);
        figures.push(curves(robustness));
        figures
    }
}

const FOOTER: &str = "A row has one scale, from V of the unified method (and of the aligned pair): red is near, blue far, \
                      grey not valid. Values beyond the scale have its end colours.";

fn sheet(
    name: &str,
    caption: &str,
    width: u32,
    columns: impl Iterator<Item = &'static str>,
    rows: Vec<Row>,
) -> Option<Figure> {
    let sheet = Sheet::new(caption).columns(columns).panel_width(width).footer(FOOTER);
    let (name, caption) = (name.to_string(), caption.to_string());
    (!rows.is_empty()).then(|| Figure { name, caption, picture: rows.into_iter().fold(sheet, Sheet::row).draw() })
}

fn blur(solution: &Result<Solution, String>, scale: &Scale) -> Panel {
    match solution {
        Ok(s) => Panel::relative_blur(s.width, s.height, &s.relative_blur, scale),
        Err(reason) => Panel::missing(reason.clone()),
    }
}

/// A frame with its samples clipped to 0 to 1.
fn clipped(frame: &Frame) -> Frame {
    let Samples::F32(values) = frame.samples() else { return frame.clone() };
    let clipped = values.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Frame::new(frame.width(), frame.height(), frame.format().channels, Samples::F32(clipped))
        .unwrap_or_else(|_| frame.clone())
}

/// Draws robustness: a plot for each property.
fn curves(curves: &[Curve]) -> Figure {
    let caption = "Corner error as scenes get harder: median over the seeds, bars from least to greatest.";
    let plots: Vec<Panel> = curves.iter().map(|curve| Panel::image(plot(curve))).collect();
    let rows = plots.chunks(3).map(|row| Row::new("").panels(row.to_vec()));
    let picture = rows.fold(Sheet::new(caption).panel_width(640), Sheet::row).draw();
    Figure { name: ROBUSTNESS.to_string(), caption: caption.to_string(), picture }
}

fn plot(curve: &Curve) -> image::RgbImage {
    let series = curve.series;
    let x = if series.logarithmic { Axis::log(series.quantity) } else { Axis::linear(series.quantity) };
    let plot = Plot::new(series.name, x, Axis::log("corner error, px").limits(1e-4, 100.0))
        .target(PAPER_PX, "the paper's bound");
    let finite = |v: f64| if v.is_finite() { v } else { f64::NAN };
    let plot = METHODS.iter().enumerate().fold(plot, |plot, (m, method)| {
        let points = curve.points.iter().map(|point| (point.value, point.spreads[m].map(finite)));
        plot.series(Series::with_spread(method.name(), points))
    });
    plot.draw()
}
