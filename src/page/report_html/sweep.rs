//! The page of a focus sweep.

use std::borrow::Cow;
use std::io::Write;

use serde::Serialize;
use serde_json::json;

use super::{Contents, Photographed, Picture, Readout, best_focus};
use crate::base::{Decode, Frame};
use crate::files::export::{Extra, Nearer, PAGE_FILE, Palette, fused_frame, larger_is};
use crate::solve::sweep::Sweep;

/// What `report.html` shows besides the sweep.
#[derive(Clone, Debug)]
pub struct SweepPage<'a> {
    /// The frames in the order in which they were solved.
    pub frames: Vec<&'a Frame>,
    /// What they are called; any text.
    pub names: Vec<String>,
    /// How they were decoded.
    pub decode: Decode,
    /// Whether the first or the last frame is focused nearest.
    pub nearer: Nearer,
    /// The colours that the page begins with.
    pub palette: Palette,
    /// Whatever else there is to read at each pixel.
    pub fields: Vec<Readout<'a>>,
}

impl<'a> SweepPage<'a> {
    /// The page as a file of the sweep with this report, for [`write_sweep`](crate::export::write_sweep()).
    pub fn file(self, sweep: &'a Sweep, report: &'a impl Serialize) -> Extra<'a> {
        Extra::new(PAGE_FILE, move |writer| self.write(sweep, report, writer))
    }

    fn write(self, sweep: &'a Sweep, report: &impl Serialize, writer: &mut dyn Write) -> Result<(), String> {
        let (reference, decode, part) = (sweep.reference, self.decode, sweep.region);
        let mut pictures: Vec<Picture<'_>> = Vec::new();
        for (n, (&frame, name)) in self.frames.iter().zip(&self.names).enumerate() {
            let is_reference = n == reference;
            let place = (!is_reference).then(|| (sweep.transforms[n], sweep.brightness[n]));
            let leafed = (!is_reference).then(|| self.frames.len() - 1);
            let name = if is_reference { format!("{name} (reference)") } else { name.clone() };
            let frame = Cow::Borrowed(frame);
            pictures.push(Photographed { frame, decode, part, place, leafed }.named(name));
        }
        let compare = [reference, pictures.len()];
        let (size, palette) = ((sweep.width, sweep.height), self.palette);
        pictures.push(best_focus(fused_frame(size, sweep.fused_channels, &sweep.fused, decode))?);
        let ends = [self.names.first(), self.names.last()];
        let told = json!({
            "kind": "sweep", "names": ends, "compare": compare, "frames": self.frames.len(), "report": report,
        });
        let heights = if sweep.depth.is_some() { "depth" } else { "focus" };
        Contents { size, palette, pictures, fields: self.all_fields(sweep), heights, to_scale: None, told }
            .write(writer)
    }

    fn all_fields(self, sweep: &'a Sweep) -> Vec<Readout<'a>> {
        let mut fields = fields_of_sweep(sweep, self.nearer);
        fields.extend(self.fields);
        fields
    }
}

/// Focus and its standard deviation, and depth in mm where that is known.
pub(super) fn fields_of_sweep(sweep: &Sweep, nearer: Nearer) -> Vec<Readout<'_>> {
    let focus = Readout::focus(&sweep.focus, larger_is(&sweep.positions, nearer));
    let focus = focus.unit(sweep.unit).rounded_by(&sweep.uncertainty);
    let sigma = Readout::deviation("uncertainty", &focus, ["σ of focus", "σ"], &sweep.uncertainty)
        .note("σ, the standard deviation of the focus setting, by what the pairs say. On a logarithmic scale.");
    let mut fields = vec![focus, sigma];
    if let Some(found) = &sweep.depth {
        let near = larger_is(sweep.stated.millimetres().unwrap_or_default(), nearer);
        let [depth, sigma] = Readout::depth_with_deviation(&found.depth, &found.deviation, near);
        fields.extend([depth.rounded_by(&found.deviation), sigma]);
    }
    fields
}
