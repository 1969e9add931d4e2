//! The figures: those of the paper, with its numbers, curves of robustness, and pairs on which the program warns.

use image::{Rgb, RgbImage};
use parfocal::{
    Frame, Solution,
    export::{Nearer, Scale},
    page::figure::{Axis, Plot, Series},
    settings::Method,
};

use crate::contact_sheet::{Panel, Row, Sheet};
use crate::pairs::{PhotographedPair, intensities};
use crate::robustness::{Curve, PAPER_PX};
use crate::section::{METHODS, number};

/// A picture and the name of its file.
pub(crate) struct Figure {
    pub name: String,
    /// A sentence that describes the picture.
    pub caption: String,
    pub picture: RgbImage,
}

impl Figure {
    pub(crate) fn file(name: &str) -> String {
        format!("{name}.png")
    }
}

/// The name of the solve without registration, with T held at the identity.
pub(crate) const NONE: &str = "no registration";
/// The name of the solve of the pair without displacement, with T held at the identity.
pub(crate) const ALIGNED: &str = "aligned pair";

/// The name of a method, and its solution or the reason for its failure.
pub(crate) type Solved = (&'static str, Result<Solution, String>);

const SCENES: &str = "fig4-scenes";
const PHOTOGRAPHS: &str = "fig6-photographs";
const ROBUSTNESS: &str = "robustness";
/// Rows of a sheet of pairs that do not fit the model.
const WARNED_ROWS: usize = 6;

/// The names of all figures that an evaluation may have. `kinds` is the number of kinds of pairs that do not fit.
pub(crate) fn names(kinds: usize) -> Vec<String> {
    let warned = (0..kinds.div_ceil(WARNED_ROWS)).map(warned_name);
    [SCENES, PHOTOGRAPHS, ROBUSTNESS].map(String::from).into_iter().chain(warned).collect()
}

/// Rows of the sheets. They are drawn as soon as a pair is solved, since all solutions together would not fit into
/// memory.
#[derive(Default)]
pub(crate) struct Collector {
    scenes: Vec<Row>,
    photographs: Vec<Row>,
}

impl Collector {
    /// Adds a row to Figure 4, with the corner error in px below each panel.
    pub(crate) fn scene(&mut self, name: &str, i1: &Frame, solved: &[Solved], corners: &[Option<f64>]) {
        // The scale includes zero. Otherwise rounding would fill the colours where V is constant.
        let zero = [0.0];
        let trusted = [Method::Unified.name(), ALIGNED];
        let fields = solved.iter().filter(|(name, _)| trusted.contains(name)).filter_map(|(_, s)| s.as_ref().ok());
        let scale = Scale::common(fields.map(|s| &s.relative_blur[..]).chain([&zero[..]]), Nearer::First);
        let panels = solved.iter().zip(corners).map(|((_, solution), corner)| {
            let caption = corner.map_or(String::new(), |corner| format!("corners {} px off", number(corner)));
            Panel { caption, ..blur(solution, &scale) }
        });
        let panels = [Panel::new(preview(i1))].into_iter().chain(panels).collect();
        self.scenes.push(Row { name: name.to_string(), panels, scale: Some(scale) });
    }

    /// Adds a row to Figure 6.
    pub(crate) fn photographs(&mut self, pair: &PhotographedPair, [i1, _]: [&Frame; 2], solved: &[Solved]) {
        let unified = solved.iter().find(|(name, _)| *name == Method::Unified.name());
        let name = pair.name.to_string();
        let Some(unified) = unified.and_then(|(_, solution)| solution.as_ref().ok()) else {
            let panels = vec![Panel::missing("the unified method failed")];
            self.photographs.push(Row { name, panels, scale: None });
            return;
        };
        let scale = Scale::of(&unified.relative_blur, pair.nearer);
        let panels = solved.iter().map(|(_, solution)| blur(solution, &scale));
        let panels = [Panel::new(preview(i1))].into_iter().chain(panels).collect();
        self.photographs.push(Row { name, panels, scale: Some(scale) });
    }

    /// All figures, in the order of the paper; sheets without a row are left out.
    pub(crate) fn finish(self, robustness: &[Curve]) -> Vec<Figure> {
        let methods = || ["I1", NONE].into_iter().chain(METHODS.map(Method::name));
        let known = "V of pairs whose registration is known (the paper's Figure 4).";
        let mut figures = Vec::from_iter(sheet(SCENES, known, 190, methods().chain([ALIGNED]), self.scenes));
        let photographs = "V of photographs (the paper's Figure 6).";
        figures.extend(sheet(PHOTOGRAPHS, photographs, 260, methods(), self.photographs));
        figures.push(curves(robustness));
        figures
    }
}

/// A pair that does not fit the model, V where it is measured, and what the program said.
pub(crate) fn warned_row(name: &str, images: [&Frame; 2], measured: &[f32], said: String) -> Row {
    let scale = Scale::common([measured, &[0.0]], Nearer::First);
    let [i1, i2] = images.map(|image| Panel::new(preview(image)));
    let (width, height) = (images[0].width(), images[0].height());
    let v = if measured.is_empty() {
        Panel::missing("none")
    } else {
        Panel::relative_blur(width, height, measured, &scale)
    };
    Row { name: name.to_string(), panels: vec![i1, i2, Panel { caption: said, ..v }], scale: Some(scale) }
}

/// The sheets of such pairs.
pub(crate) fn warned(rows: Vec<Row>) -> Vec<Figure> {
    let caption = "Pairs that do not fit the model: V where it is measured, and what the program says.";
    let (mut rows, mut sheets) = (rows.into_iter().peekable(), Vec::new());
    while rows.peek().is_some() {
        let sheet = Sheet {
            title: String::new(),
            columns: vec!["I1", "I2", "V, and what is said"],
            rows: rows.by_ref().take(WARNED_ROWS).collect(),
            footer: "Grey: not measured.",
            panel_width: 200,
        };
        sheets.push(Figure { name: warned_name(sheets.len()), caption: caption.to_string(), picture: sheet.draw() });
    }
    sheets
}

fn warned_name(sheet: usize) -> String {
    format!("warnings-{}", sheet + 1)
}

const FOOTER: &str = "A row has one scale, from V of the unified method (and of the aligned pair): red is near, blue far, \
                      grey not valid. Values beyond the scale have its end colours.";

fn sheet(
    name: &str,
    caption: &str,
    panel_width: u32,
    columns: impl Iterator<Item = &'static str>,
    rows: Vec<Row>,
) -> Option<Figure> {
    if rows.is_empty() {
        return None;
    }
    let (name, caption) = (name.to_string(), caption.to_string());
    let sheet = Sheet { title: caption.clone(), columns: columns.collect(), rows, footer: FOOTER, panel_width };
    Some(Figure { name, caption, picture: sheet.draw() })
}

fn blur(solution: &Result<Solution, String>, scale: &Scale) -> Panel {
    match solution {
        Ok(s) => Panel::relative_blur(s.width, s.height, &s.relative_blur, scale),
        Err(reason) => Panel::missing(reason),
    }
}

/// A frame as a picture, clipped to 0 to 1.
fn preview(frame: &Frame) -> RgbImage {
    let values = intensities(frame);
    let channels = values.len() / (frame.width() * frame.height()) as usize;
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    RgbImage::from_fn(frame.width(), frame.height(), |x, y| {
        let first = (y * frame.width() + x) as usize * channels;
        Rgb([0, 1, 2].map(|c| byte(values[first + c % channels])))
    })
}

/// Draws robustness: a plot for each property.
fn curves(curves: &[Curve]) -> Figure {
    let caption = "Corner error as scenes get harder: median over the seeds, bars from least to greatest.";
    let panels = |curves: &[Curve]| curves.iter().map(|curve| Panel::new(plot(curve))).collect();
    let rows = curves.chunks(3).map(|curves| Row { panels: panels(curves), ..Row::default() }).collect();
    let sheet = Sheet { title: caption.to_string(), rows, panel_width: 640, ..Sheet::default() };
    Figure { name: ROBUSTNESS.to_string(), caption: caption.to_string(), picture: sheet.draw() }
}

fn plot(curve: &Curve) -> RgbImage {
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
