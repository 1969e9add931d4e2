//! What came of inspecting a part: `inspect.json` and `inspect.png`, both or none.

use std::io::Write;

use image::RgbImage;
use serde::Serialize;

use super::destination::Destination;
use super::hashes::Hashes;
use super::json;
use super::picture::write_drawing;
use super::staging::Staging;
use crate::base::{Error, Similarity};
use crate::metric::inspect::{Deviation, Inspection, Limits, Plane};

/// Report and picture of an inspected part.
pub const INSPECT_FILES: [&str; 2] = ["inspect.json", "inspect.png"];

/// The report of an inspected part.
#[derive(Clone, Debug, Serialize)]
pub struct InspectReport {
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// `go` or `no-go`.
    pub verdict: &'static str,
    /// Why it is no-go; a sentence each.
    pub reasons: Vec<String>,
    /// The folder of the part.
    pub part: String,
    /// The folders of the golden parts, on whose first's pixels places are stated.
    pub golden: Vec<String>,
    /// What is compared: `depth`, `relative blur` or `focus`.
    pub quantity: &'static str,
    /// Its unit. Heights are in it, and grow towards the camera.
    pub unit: &'static str,
    /// What the part may do.
    #[serde(flatten)]
    pub limits: Limits,
    /// T: the part's picture at T x lies on the golden one's at x.
    pub transform: Similarity,
    /// How the part lies against the golden one, heights and heights a pixel; it is taken out.
    pub plane: Plane,
    /// Pixels of which both have a height.
    pub judged_px: usize,
    /// Pixels of which only the golden part has one.
    pub unjudged_px: usize,
    /// Their share of the golden part's pixels.
    pub unjudged: f64,
    /// Where it deviates, the largest first.
    pub regions: Vec<DeviationReport>,
    #[serde(flatten)]
    listed: Option<ListedFiles>,
}

/// One place where a part deviates.
#[derive(Clone, Debug, Serialize)]
pub struct DeviationReport {
    /// What it is.
    #[serde(flatten)]
    pub deviation: Deviation,
    /// Its mean place in the part's own picture, px.
    pub centroid_in_part_px: [f64; 2],
}

#[derive(Clone, Debug, Serialize)]
struct ListedFiles {
    files: Vec<String>,
    hashes: Hashes,
}

impl InspectReport {
    /// Gathers the report of an inspection of a part in `unit` of `quantity`; both folders by their names.
    pub fn new(
        [part, golden]: [&[String]; 2],
        [quantity, unit]: [&'static str; 2],
        (limits, transform): (Limits, Similarity),
        (inspection, size): (&Inspection, [u32; 2]),
    ) -> Self {
        let middle = crate::base::centre(size[0], size[1]);
        let of = |deviation: &Deviation| DeviationReport {
            deviation: *deviation,
            centroid_in_part_px: transform.apply(deviation.centroid_px, middle),
        };
        Self {
            version: env!("CARGO_PKG_VERSION"),
            verdict: if inspection.is_go(&limits) { "go" } else { "no-go" },
            reasons: reasons(inspection, &limits, unit),
            part: part.concat(),
            golden: golden.to_vec(),
            quantity,
            unit,
            limits,
            transform,
            plane: inspection.plane,
            judged_px: inspection.judged,
            unjudged_px: inspection.unjudged,
            unjudged: inspection.unjudged_share(),
            regions: inspection.regions.iter().map(of).collect(),
            listed: None,
        }
    }

    /// Whether the part is as it should be.
    pub fn is_go(&self) -> bool {
        self.verdict == "go"
    }

    /// As text, without a newline at its end.
    ///
    /// # Errors
    /// None is known; serde_json's signature allows one.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        json::to_string(self)
    }
}

fn reasons(inspection: &Inspection, limits: &Limits, unit: &str) -> Vec<String> {
    let (regions, share) = (&inspection.regions, inspection.unjudged_share());
    let worst = regions.iter().max_by(|a, b| a.extreme.abs().total_cmp(&b.extreme.abs()));
    let deviates = worst.map(|worst| {
        let ([x, y], count) = (worst.centroid_px, regions.len());
        let places =
            if count == 1 { "deviates at one place".to_string() } else { format!("deviates at {count} places") };
        format!("{places}, at {x:.0},{y:.0} by {:+.4} {unit}", worst.extreme)
    });
    let missing = (share > limits.max_unjudged).then(|| {
        let percent = |share: f64| 100.0 * share;
        let (share, most) = (percent(share), percent(limits.max_unjudged));
        format!("{share:.1} % of the golden part's pixels have no height of the part, and {most:.1} % may")
    });
    deviates.into_iter().chain(missing).collect()
}

/// Writes report and picture into a folder, which is made if it is missing: both, or none. Of an earlier inspection, what its report
/// lists is replaced; any other file stays, and where it has the name of one of both, nothing is written unless the
/// [`Destination`] forces it.
///
/// # Errors
/// [`Error::File`].
pub fn write_inspection<'d>(
    out: impl Into<Destination<'d>>,
    report: &InspectReport,
    picture: &RgbImage,
) -> Result<(), Error> {
    let [json, png] = INSPECT_FILES;
    let mut staging = Staging::anew(out.into(), json)?;
    staging.add(png, |w| write_drawing(w, picture))?;
    let files = staging.names().into_iter().chain([json.to_string()]).collect();
    let listed = Some(ListedFiles { files, hashes: staging.hashes() });
    let text = InspectReport { listed, ..report.clone() }.to_json().map_err(|e| e.to_string());
    staging.add(json, |w| text.and_then(|text| writeln!(w, "{text}").map_err(|e| e.to_string())))?;
    staging.place()
}
