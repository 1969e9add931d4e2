//! The page of a pair.

use std::borrow::Cow;
use std::io::Write;

use serde_json::json;

use super::{Contents, Picture, Readout, best_focus};
use crate::base::{Decode, Frame};
use crate::engine::Solution;
use crate::files::export::{Extra, Nearer, PAGE_FILE, Palette, Report, fused};
use crate::metric::MetricDepth;

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
    /// Depth in mm, where the lens is known.
    pub depth: Option<&'a MetricDepth>,
    /// The colours that the page begins with.
    pub palette: Palette,
    /// Whatever else there is to read at each pixel.
    pub fields: Vec<Readout<'a>>,
}

impl<'a> Page<'a> {
    /// The page as a file of the solve, for [`write`](crate::export::write()).
    ///
    /// The solution's fields must be of its size, as `write` checks.
    pub fn file(self, solution: &'a Solution, report: &'a Report) -> Extra<'a> {
        Extra::new(PAGE_FILE, move |writer| self.write(solution, report, writer))
    }

    fn write(self, solution: &'a Solution, report: &Report, writer: &mut dyn Write) -> Result<(), String> {
        let [i1, i2] = self.photographs;
        let [name1, name2] = &self.names;
        let picture = |name, frame, place| Picture { name, frame: Cow::Borrowed(frame), place, is_leafed: false };
        let pictures = vec![
            picture(format!("I1: {name1}"), i1, None),
            picture(format!("I2 registered: {name2}"), i2, Some((report.transform, solution.brightness()))),
            best_focus(fused(solution, self.decode))?,
        ];
        let told = json!({ "kind": "pair", "names": self.names, "compare": [0, 1], "report": report });
        let heights = if self.depth.is_some() { "depth" } else { "relative_blur" };
        let (size, decode, palette) = ((solution.width, solution.height), self.decode, self.palette);
        let part = solution.region();
        Contents { size, part, decode, palette, pictures, fields: self.all_fields(solution), heights, told }
            .write(writer)
    }

    fn all_fields(self, solution: &'a Solution) -> Vec<Readout<'a>> {
        let blur = Readout::relative_blur(&solution.relative_blur, self.nearer);
        let sigma = Readout::deviation("uncertainty", &blur, ["σ of V", "σ"], &solution.uncertainty).note(
            "σ, the standard deviation of V, px², by what the images say around each pixel; 1000 where they say nothing. On a \
             logarithmic scale.",
        );
        let mut fields = vec![blur, sigma, Readout::confidence(&solution.confidence)];
        if let Some(metric) = self.depth {
            fields.extend(Readout::depth_with_deviation(&metric.depth, &metric.deviation, Nearer::Second));
        }
        fields.extend(self.fields);
        fields
    }
}
