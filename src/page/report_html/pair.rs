//! The page of a pair.

use std::borrow::Cow;
use std::io::Write;

use serde_json::json;

use super::{Contents, Photographed, Readout, best_focus, through_lens, to_scale};
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
        let (decode, part) = (self.decode, solution.region());
        let picture = |name, frame, place| {
            Photographed { frame: Cow::Borrowed(frame), decode, part, place, leafed: None }.named(name)
        };
        let pictures = vec![
            picture(format!("I1: {name1}"), i1, None),
            picture(format!("I2 registered: {name2}"), i2, Some((report.transform, solution.brightness()))),
            best_focus(fused(solution, decode))?,
        ];
        let lens = through_lens(report.transform.scale(), report.settings.max_relative_blur, self.depth);
        let told = json!({ "kind": "pair", "names": self.names, "compare": [0, 1], "lens": lens, "report": report });
        let to_scale = to_scale(self.depth);
        let heights = if self.depth.is_some() { "depth" } else { "relative_blur" };
        let (size, palette) = ((solution.width, solution.height), self.palette);
        Contents { size, palette, pictures, fields: self.all_fields(solution), heights, to_scale, told }.write(writer)
    }

    fn all_fields(self, solution: &'a Solution) -> Vec<Readout<'a>> {
        let of_solution = [&solution.relative_blur[..], &solution.uncertainty, &solution.confidence];
        let mut fields = fields_of_pair(of_solution, self.nearer, self.depth);
        fields.extend(self.fields);
        fields
    }
}

/// V, its standard deviation and confidence, and depth in mm where that is known.
pub(super) fn fields_of_pair<'a>(
    [blur, uncertainty, confidence]: [&'a [f32]; 3],
    nearer: Nearer,
    depth: Option<&'a MetricDepth>,
) -> Vec<Readout<'a>> {
    let blur = Readout::relative_blur(blur, nearer).rounded_by(uncertainty);
    let sigma = Readout::deviation("uncertainty", &blur, ["σ of V", "σ"], uncertainty).note(
        "σ, the standard deviation of V, px², by what the images say around each pixel; 1000 where they say nothing. On a \
         logarithmic scale.",
    );
    let mut fields = vec![blur, sigma, Readout::confidence(confidence).computed()];
    if let Some(metric) = depth {
        let by_formula =
            Readout::depth_with_deviation(&metric.depth, &metric.deviation, Nearer::Second).map(Readout::computed);
        fields.extend(by_formula);
    }
    fields
}

/// What neither blur nor registration explains, for the page.
pub fn residual(values: &[f32]) -> Readout<'_> {
    Readout::new("residual", "Residual", "residual", values).digits(5).logarithmic().ends(["explained", "not"]).note(
        "What neither blur nor registration explains around each pixel, in intensities with white at 1: large where \
             something moved between the photographs or shone differently. On a logarithmic scale.",
    )
}
