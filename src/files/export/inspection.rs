//! The inspection of a part: `inspect.json` and `inspect.png`.

use image::RgbImage;
use serde::Serialize;

use super::destination::{Destination, INSPECT_FILES};
use super::image_files::write_drawing;
use super::report::{Header, Kind};
use super::staging::{ListedFiles, Staging};
use crate::base::{Error, Region, Similarity};
use crate::metric::inspect::{Deviation, Gap, Inspection, Limits, PlacementRange, Plane, Verdict};

/// The report of an inspected part.
#[derive(Clone, Debug, Serialize)]
pub struct InspectReport {
    #[serde(flatten)]
    header: Header,
    /// Version of parfocal that wrote it.
    pub version: &'static str,
    /// `go`, `no-go` or `cannot-judge`.
    pub verdict: Verdict,
    /// Reasons for any verdict but go; one sentence each.
    pub reasons: Vec<String>,
    /// The part.
    #[serde(flatten)]
    pub part: InspectedPart,
    /// The folders of the golden parts. Positions are stated on the pixels of the first.
    pub golden: Vec<String>,
    /// The quantity that is compared: `depth`, `relative blur` or `focus`.
    pub quantity: String,
    /// Unit of the quantity. Heights are in this unit and grow towards the camera.
    pub unit: &'static str,
    /// Tolerances.
    #[serde(flatten)]
    pub limits: Limits,
    /// The regions of the golden part that are judged; absent if all of it is.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub judged_regions: Vec<Region>,
    /// T: the golden part's pixel x lies at T x in the picture of the part.
    pub transform: Similarity,
    /// Where the part may lie, as stated or taught; absent if neither.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<PlacementRange>,
    /// How the photographs of a pair may lie to each other, as taught.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub registration: Option<PlacementRange>,
    /// The plane of the part minus that of the golden part, in heights and heights per pixel; it is subtracted.
    pub plane: Plane,
    /// The tilt of the plane: the difference of the highest and the lowest corner of the picture.
    pub tilt: f64,
    /// Pixels that were judged.
    pub judged_px: usize,
    /// Pixels where only the golden part has a height.
    pub unjudged_px: usize,
    /// `unjudged_px` as a fraction of the golden part's pixels.
    pub unjudged: f64,
    /// Pixels where the part is too uncertain for the tolerance, or without a height since all of it has as little
    /// evidence.
    pub uncertain_px: usize,
    /// The least tolerance that the part's uncertainty allows to judge; null if too many heights are missing.
    pub least_tolerance: Option<f64>,
    /// Regions that are not judged although the golden part is certain there, the largest first.
    pub gaps: Vec<Gap>,
    /// Deviating regions, the largest first.
    pub regions: Vec<DeviationReport>,
    #[serde(flatten)]
    listed: Option<ListedFiles>,
}

/// The part of an inspection.
#[derive(Clone, Debug, Serialize)]
pub struct InspectedPart {
    /// The folder of its results.
    pub part: String,
    /// Its serial number: the name of its pair or sweep.
    pub serial: String,
    /// When its photographs were last changed, or if they are not known when its results were written: UTC, RFC 3339.
    pub time: String,
}

/// A region where a part deviates.
#[derive(Clone, Debug, Serialize)]
pub struct DeviationReport {
    /// The region.
    #[serde(flatten)]
    pub deviation: Deviation,
    /// Centroid in the part's own picture, px.
    pub centroid_in_part_px: [f64; 2],
}

impl InspectReport {
    /// Report of an inspection; golden parts are named by their folders. With `faults` of the part's results, a sentence
    /// each, it cannot be judged. With `doubts` about those of the golden parts it is no go.
    pub fn new(
        (part, golden): (InspectedPart, &[String]),
        (quantity, unit): (&str, &'static str),
        (limits, transform, regions): (Limits, Similarity, &[Region]),
        (inspection, size): (&Inspection, [u32; 2]),
        [faults, doubts]: [Vec<String>; 2],
    ) -> Self {
        let verdict = match inspection.verdict(&limits) {
            _ if !faults.is_empty() => Verdict::CannotJudge,
            Verdict::Go if !doubts.is_empty() => Verdict::CannotJudge,
            verdict => verdict,
        };
        let middle = crate::base::centre(size[0], size[1]);
        let of = |deviation: &Deviation| DeviationReport {
            deviation: *deviation,
            centroid_in_part_px: transform.apply(deviation.centroid_px, middle),
        };
        Self {
            header: Header::new(Kind::Inspection),
            version: env!("CARGO_PKG_VERSION"),
            verdict,
            reasons: faults.into_iter().chain(reasons(inspection, &limits, unit)).chain(doubts).collect(),
            part,
            golden: golden.to_vec(),
            quantity: quantity.to_string(),
            unit,
            limits,
            judged_regions: regions.to_vec(),
            transform,
            placement: None,
            registration: None,
            plane: inspection.plane,
            tilt: inspection.tilt,
            judged_px: inspection.judged,
            unjudged_px: inspection.unjudged,
            unjudged: inspection.unjudged_share(),
            uncertain_px: inspection.uncertain,
            least_tolerance: inspection.least_tolerance,
            gaps: inspection.gaps.clone(),
            regions: inspection.regions.iter().map(of).collect(),
            listed: None,
        }
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
    let uncertain = inspection.uncertain_share();
    let blurred = (share <= limits.max_unjudged && share + uncertain > limits.max_unjudged).then(|| {
        let least = inspection
            .least_tolerance
            .map_or(String::new(), |least| format!("; a tolerance of {least:.2} {unit} could be judged"));
        format!(
            "{:.1} % of the golden part's pixels are too uncertain on the part for a tolerance of {} {unit}{least}",
            100.0 * uncertain,
            limits.tolerance
        )
    });
    let gap = |is: &dyn Fn(&Gap) -> bool| {
        let mut all = inspection.gaps.iter().filter(|gap| is(gap));
        all.next().map(|gap| {
            let ([x, y], more) = (gap.centroid_px, all.count());
            let more = if more > 0 { format!(", and in {more} smaller ones") } else { String::new() };
            let area = gap.area_px;
            format!("in a region of {area} px at {x:.0},{y:.0}{more}; regions from {} px on count", limits.min_area_px)
        })
    };
    let bare =
        gap(&|gap| gap.is_bare).map(|places| format!("the part lacks the texture that the golden part has {places}"));
    // Around a defect, a part is less certain too.
    let unseen = gap(&|gap| !gap.is_bare && gap.is_unseen).filter(|_| deviates.is_none() && bare.is_none()).map(|places| {
        let smallest = limits.smallest_px.unwrap_or_default();
        format!(
            "a defect {smallest} px wide and {} {unit} high would not be seen {places}; take the part in more light, or \
             allow more by --tolerance or --smallest",
            limits.tolerance
        )
    });
    let unclear =
        gap(&|gap| !gap.is_bare && !gap.is_unseen).filter(|_| deviates.is_none() && bare.is_none()).map(|places| {
            format!("the part is far less certain than the golden part {places}; take it in more light, or as a sweep")
        });
    let tilted = (inspection.tilt > limits.max_tilt).then(|| {
        let (tilt, most) = (inspection.tilt, limits.max_tilt);
        format!(
            "the part lies tilted by {tilt:.2} {unit} over the picture, and {most:.2} is allowed; lay it as the golden \
             part lies, or allow more by --max-tilt"
        )
    });
    let negated = inspection.is_negated.then(|| {
        let problem =
            "the heights are those of the golden part with the other sign: the photographs are in the other order";
        problem.to_string()
    });
    negated
        .into_iter()
        .chain(deviates)
        .chain(bare)
        .chain(missing)
        .chain(blurred)
        .chain(unseen)
        .chain(unclear)
        .chain(tilted)
        .collect()
}

/// Writes report and picture into a folder: both or none. Creates the folder if it is missing. Replaces the files of an
/// earlier inspection. Any other file stays; if it has the name of a result, nothing is written unless the
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
    let mut staging = Staging::replacing(out.into(), json)?;
    staging.add(png, |w| write_drawing(w, picture))?;
    staging.place_with_report(json, |listed| InspectReport { listed: Some(listed), ..report.clone() })
}
