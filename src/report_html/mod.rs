//! `report.html`: the results of a solve in one page to look at, which asks nothing of a network.
//!
//! The page holds its style, its scripts, three.js for the surface, and all data: V and confidence bit by bit, the
//! photographs, registered, and the fused image as JPEG, and the report. What comes from outside, names of files say,
//! goes in as JSON and out as text, never as HTML; a content security policy keeps the page from loading anything.

mod packed;
mod registered;

use std::io::Write;
use std::thread;

use image::RgbImage;
use serde_json::{Value, json};

use self::registered::registered;
use crate::export::{Extra, Nearer, Report, Scale, color, fused};
use crate::figure::{photograph, resized};
use crate::view::{Surface, View};
use crate::{Decode, Frame, Solution};

/// The most pixels that a page holds. Of larger images it has every second pixel of every second row, or every third
/// and so on, so that a browser can still open it; each value is still that of its pixel.
const MOST_PIXELS: u64 = 1 << 22;

/// Nodes of the surface along its longer side.
const NODES: u32 = 512;

/// The least confidence that has a colour of its own.
const LEAST_CONFIDENCE: f32 = 1e-6;

const TEMPLATE: &str = include_str!("assets/report.html");

/// Style, scripts and licence, by their names in the template.
const ASSETS: [(&str, &str); 8] = [
    ("style", include_str!("assets/report.css")),
    ("three", include_str!("assets/three/three.min.js")),
    ("three-license", include_str!("assets/three/LICENSE")),
    ("data.js", include_str!("assets/data.js")),
    ("viewer.js", include_str!("assets/viewer.js")),
    ("surface.js", include_str!("assets/surface.js")),
    ("numbers.js", include_str!("assets/numbers.js")),
    ("report.js", include_str!("assets/report.js")),
];

/// What `report.html` shows besides the solution.
#[derive(Clone, Debug)]
pub struct Page<'a> {
    /// I1 and I2.
    pub photographs: [&'a Frame; 2],
    /// What they are called; any text.
    pub names: [String; 2],
    /// How they were decoded.
    pub decode: Decode,
    /// Which image is focused nearer.
    pub nearer: Nearer,
}

impl<'a> Page<'a> {
    /// The page as a file of the solve, for [`write`](crate::export::write()).
    ///
    /// The solution's fields must be of its size, as `write` checks.
    pub fn file(self, solution: &'a Solution, report: &'a Report) -> Extra<'a> {
        Extra::new("report.html", move |writer| self.write(solution, report, writer))
    }

    fn write(&self, solution: &Solution, report: &Report, writer: &mut dyn Write) -> Result<(), String> {
        let parts = self.parts(solution, report)?;
        for (i, piece) in TEMPLATE.split("{{").enumerate() {
            let (name, text) = if i == 0 { ("", piece) } else { piece.split_once("}}").unwrap_or(("", piece)) };
            let asset = ASSETS.iter().find(|(asset, _)| *asset == name).map(|(_, text)| *text);
            let part = parts.iter().find(|(part, _)| *part == name).map(|(_, text)| text.as_str());
            for text in [asset.or(part).unwrap_or_default(), text] {
                writer.write_all(text.as_bytes()).map_err(|e| e.to_string())?;
            }
        }
        Ok(())
    }

    /// What of the page changes from solve to solve, by its name in the template. The dear parts are made side by side.
    fn parts(&self, solution: &Solution, report: &Report) -> Result<Vec<(&'static str, String)>, String> {
        let grid = Grid::of(solution);
        let [i1, i2] = self.photographs;
        let best = fused(solution, self.decode).map_err(|e| e.to_string())?;
        let surface = Surface::new(&solution.relative_blur, &best, self.nearer).map_err(|e| e.to_string())?;
        let (surface_json, heights) = surface_data(&surface);
        let field = |values: &[f32]| packed::floats(&grid.values(values));
        let image = |image: &RgbImage| packed::picture(&grid.picture(image));
        let warped = || registered(&photograph(i2), &report.transform, &report.photometric, self.decode);
        let results = thread::scope(|scope| {
            let parts = [
                ("relative-blur", scope.spawn(|| field(&solution.relative_blur))),
                ("confidence", scope.spawn(|| field(&solution.confidence))),
                ("i1", scope.spawn(|| image(&photograph(i1)))),
                ("i2", scope.spawn(|| image(&warped()))),
                ("fused", scope.spawn(|| image(&photograph(&best)))),
                ("heights", scope.spawn(|| packed::floats(&heights))),
            ];
            parts.map(|(name, part)| (name, part.join().unwrap_or_else(|_| Err("out of memory".to_string()))))
        });
        let mut parts = vec![("data", packed::json(&self.data(solution, report, &grid, surface_json))?)];
        for (name, part) in results {
            parts.push((name, part?));
        }
        Ok(parts)
    }

    fn data(&self, solution: &Solution, report: &Report, grid: &Grid, surface: Value) -> Value {
        let scale = Scale::of(&solution.relative_blur, self.nearer);
        let confidences: Vec<f32> = solution.confidence.iter().copied().filter(|&c| c > 0.0).collect();
        let spread = Scale::of(&confidences, Nearer::First);
        // Above the least, so that the logarithmic scale between them has a length.
        let greatest = confidences.iter().copied().fold(10.0 * LEAST_CONFIDENCE, f32::max);
        json!({
            "names": self.names,
            "grid": { "step": grid.step, "first": grid.step / 2, "width": grid.width, "height": grid.height },
            "relative_blur": { "low": scale.low, "high": scale.high },
            "confidence": { "low": spread.low.max(greatest * 1e-4).min(greatest / 10.0), "high": greatest },
            "surface": surface,
            "colormaps": [
                { "name": "Red near, blue far", "colors": colormap(color) },
                { "name": "Viridis", "colors": colormap(gradient(colorous::VIRIDIS)) },
                { "name": "Grey", "colors": colormap(|t| [(255.0 * t) as u8; 3]) },
            ],
            "report": report,
        })
    }
}

/// Which pixels a page holds: those at `step / 2 + k step` of both axes, k = 0, 1 and so on.
struct Grid {
    full: (usize, usize),
    step: usize,
    width: usize,
    height: usize,
}

impl Grid {
    fn of(solution: &Solution) -> Self {
        let full = (solution.width as usize, solution.height as usize);
        let count = |side: usize, step: usize| (side - step / 2).div_ceil(step);
        let mut step = 1;
        while (count(full.0, step) * count(full.1, step)) as u64 > MOST_PIXELS {
            step += 1;
        }
        Self { full, step, width: count(full.0, step), height: count(full.1, step) }
    }

    fn values(&self, values: &[f32]) -> Vec<f32> {
        let (first, step) = (self.step / 2, self.step);
        let rows = values.chunks_exact(self.full.0).skip(first).step_by(step);
        rows.flat_map(|row| row.iter().skip(first).step_by(step)).copied().collect()
    }

    fn picture(&self, image: &RgbImage) -> RgbImage {
        if self.step == 1 { image.clone() } else { resized(image, (self.width as u32, self.height as u32)) }
    }
}

/// The surface's nodes: what they are, and their nearness, NaN in holes.
fn surface_data(surface: &Surface) -> (Value, Vec<f32>) {
    let view = View { width: NODES, smoothing: 2, ..View::default() };
    let (width, height, heights) = surface.heights(&view);
    let view = json!({
        "width": width, "height": height,
        "relief": view.relief, "elevation_deg": view.elevation, "azimuth_deg": view.azimuth,
    });
    (view, heights)
}

fn gradient(gradient: colorous::Gradient) -> impl Fn(f64) -> [u8; 3] {
    move |t| {
        let c = gradient.eval_continuous(t);
        [c.r, c.g, c.b]
    }
}

/// 256 colours from far to near, as hexadecimal digits.
fn colormap(color: impl Fn(f64) -> [u8; 3]) -> String {
    (0..256).flat_map(|i| color(f64::from(i) / 255.0)).map(|byte| format!("{byte:02x}")).collect()
}
