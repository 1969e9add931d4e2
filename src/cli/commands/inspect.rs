//! `parfocal inspect`: a part against a golden one, go or no-go.

use std::path::{Path, PathBuf};

use parfocal::export::{INSPECT_FILES, InspectReport, REPORT_FILE, Report, Results, listed_in, write_inspection};
use parfocal::metric::inspect::{Heights, Limits, Verdict, inspect};
use parfocal::metric::{Disagreement, disagreement, golden};
use parfocal::{
    Frame,
    internals::baseline,
    page::inspection,
    resample,
    settings::Decode,
    transform::{Brightness, Similarity},
};

use serde_json::Value;

use crate::cli::commands::compare::differing;
use crate::cli::options::part::within;
use crate::cli::options::run::ReportArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Inspect a part against a golden part: go, no-go if its heights deviate by more than the tolerance, or cannot judge.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder of the part's results, from `parfocal solve -o` or `stack -o`
    part: PathBuf,
    /// Folders of one or several golden parts of equal size; positions are stated on the pixels of the first
    #[arg(long, required = true, num_args = 1.., value_name = "GOLDEN")]
    golden: Vec<PathBuf>,
    /// The allowed difference of heights: mm where all have depth in mm, else px² of V, or settings of a sweep
    #[arg(long, value_name = "T", value_parser = from_zero)]
    tolerance: f64,
    /// Standard deviations that a difference must also exceed
    #[arg(long, value_name = "K", default_value_t = Limits::new(0.0).sigmas, value_parser = from_zero)]
    sigmas: f64,
    /// Least number of pixels of a region that counts
    #[arg(long, value_name = "COUNT", default_value_t = Limits::new(0.0).min_area_px)]
    min_area: usize,
    /// The allowed share of the golden part's pixels that are not judged, 0 to 1: without a height of the part, or with
    /// one whose K standard deviations exceed the tolerance
    #[arg(long, value_name = "SHARE", default_value_t = Limits::new(0.0).max_unjudged,
          value_parser = within(0.0..=1.0, "give a share from 0 to 1"))]
    max_unjudged: f64,
    /// The allowed tilt of the part over the golden one, from one corner of the picture to the opposite one, in the unit
    /// of the tolerance [default: 10 tolerances]
    #[arg(long, value_name = "TILT", value_parser = from_zero)]
    max_tilt: Option<f64>,
    /// Do not register the pictures: the fixture holds every part in the same position
    #[arg(long)]
    in_place: bool,
    /// Folder for inspect.json and inspect.png; it may be that of the part
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    force: ForceArgument,
}

const AFTER_HELP: &str = "\
The part's picture is registered onto the golden one's by key-points (a similarity), its heights are brought along, and the plane
that most of the difference lies in is taken out: how the part lies is no defect, up to the tilt that is allowed. A pixel deviates where what is left is more than
the tolerance, and more than K standard deviations of both; of several golden parts, what they differ by at that pixel counts
too. Pixels that touch are a region. Where the golden part has a height and the part has none, no texture, or a height too
uncertain for the tolerance, nothing is judged. A region that lacks the golden part's texture is no-go. A part cannot be judged
if too much of it or a region is uncertain, if it lies tilted by more than is allowed, if a solve had not converged, or if
the golden parts disagree.

Results, with -o, both or none:
  inspect.json  verdict, reasons, registration, plane, and of each region area, mean, extreme, place
  inspect.png   the part, on the golden one's pixels: red nearer to the camera, blue further away, striped not judged

Example:
  parfocal inspect part --golden good1 good2 good3 --tolerance 0.05 -o part

Exit status: 0 go, 3 no-go, 4 cannot judge, 1 failed, 2 wrong usage.";

fn from_zero(text: &str) -> Result<f64, String> {
    within(0.0..=1e6, "give a number from 0 to 1e6")(text)
}

/// A part that was read from its folder.
struct Part {
    folder: PathBuf,
    /// Whether its solve converged; `None` for a sweep.
    converged: Option<bool>,
    /// The settings that its heights depend on.
    settings: Value,
    /// The fused image, used to register the part.
    picture: Frame,
    /// Quantities with name, unit, and heights towards the camera; the best one is last.
    fields: Vec<(String, &'static str, Heights)>,
}

/// Reads, registers, inspects, writes and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(out) = &arguments.output {
        check_output(arguments, out)?;
    }
    let part = Part::read(&arguments.part)?;
    let goldens = arguments.golden.iter().map(|folder| Part::read(folder)).collect::<Result<Vec<_>, _>>()?;
    // clap requires at least one.
    let Some(first) = goldens.first() else { return Ok(()) };
    let (quantity, unit) = common(&part, &goldens)?;
    std::iter::once(&part).chain(&goldens[1..]).try_for_each(|other| other.check_settings(first))?;
    let on_first = |other: &Part| other.on(first, quantity, arguments.in_place);
    let limits = arguments.limits();
    let registered = {
        let all = goldens[1..].iter().map(|other| on_first(other).map(|(heights, _)| heights));
        let own = first.field(quantity, first)?.clone();
        std::iter::once(Ok(own)).chain(all).collect::<Result<Vec<_>, Failure>>()?
    };
    let golden = golden(&registered, &limits)?;
    let (heights, transform) = on_first(&part)?;
    let found = inspect(&heights, &golden, &limits).map_err(|e| part.failed(first, e))?;
    let names = |folders: &[PathBuf]| folders.iter().map(|f| f.display().to_string()).collect::<Vec<_>>();
    let (own, of) = (names(std::slice::from_ref(&arguments.part)), names(&arguments.golden));
    let size = [golden.width, golden.height];
    let disagreeing = disagreement(&registered, &limits)?.map(|found| disagrees(&found, &goldens, unit));
    let doubts = std::iter::once(&part).chain(&goldens).filter_map(Part::doubt).chain(disagreeing).collect();
    let report = InspectReport::new([&own, &of], (quantity, unit), (limits, transform), (&found, size), doubts);
    let verdict = format!("{}: tolerance {} {unit}, {} σ", report.verdict.text(), limits.tolerance, limits.sigmas);
    if let Some(out) = &arguments.output {
        let unchanged = Brightness::identity(size);
        let moved = resample::registered(&part.picture, &transform.into(), &unchanged, Decode::None);
        write_inspection(arguments.force.to(out), &report, &inspection::draw(&moved, &found, unit, &verdict))?;
    }
    arguments.report.print(&summary(&report, arguments.output.as_deref()), || report.to_json())?;
    match report.verdict {
        Verdict::Go => Ok(()),
        Verdict::NoGo => Err(Failure::NoGo),
        Verdict::CannotJudge => Err(Failure::CannotJudge),
    }
}

impl Arguments {
    fn limits(&self) -> Limits {
        let default = Limits::new(self.tolerance);
        Limits {
            sigmas: self.sigmas,
            min_area_px: self.min_area,
            max_unjudged: self.max_unjudged,
            max_tilt: self.max_tilt.unwrap_or(default.max_tilt),
            ..default
        }
    }
}

/// Refuses a folder that cannot be written.
fn check_output(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    destination::check_folder(out)?;
    let results = arguments.golden.iter().chain([&arguments.part]);
    let inputs: Vec<PathBuf> =
        results.flat_map(|folder| listed_in(folder, REPORT_FILE).into_iter().map(|name| folder.join(name))).collect();
    destination::check(out, INSPECT_FILES[0], &INSPECT_FILES, &inputs.iter().collect::<Vec<_>>())?;
    Ok(arguments.force.to(out).check_results(INSPECT_FILES[0], &INSPECT_FILES)?)
}

/// The best quantity that all parts have, and its unit.
fn common<'a>(part: &'a Part, goldens: &[Part]) -> Result<(&'a str, &'static str), Failure> {
    let has =
        |other: &Part, name: &str, unit| other.fields.iter().any(|field| (field.0.as_str(), field.1) == (name, unit));
    let best = part.fields.iter().rev().find(|(name, unit, _)| goldens.iter().all(|other| has(other, name, *unit)));
    best.map(|(name, unit, _)| (name.as_str(), *unit)).ok_or_else(|| {
        let problem = "has no quantity in common with the golden parts: pairs and sweeps cannot be compared, nor settings of two units";
        Failure::Failed(format!("{}: {problem}", part.folder.display()))
    })
}

/// Which golden part disagrees with the others.
fn disagrees(found: &Disagreement, goldens: &[Part], unit: &str) -> String {
    let ([x, y], extreme) = (found.deviation.centroid_px, found.deviation.extreme);
    let place = format!("at {x:.0},{y:.0} by {extreme:+.4} {unit}");
    match goldens {
        [first, second] => {
            let [first, second] = [first, second].map(|part| part.folder.display());
            format!("the golden parts {first} and {second} disagree {place}; with a third one, the bad one is known")
        }
        all => {
            let folder = all.get(found.part).map(|part| part.folder.display().to_string()).unwrap_or_default();
            format!("the golden part {folder} disagrees with the others {place}; leave it out, or solve it again")
        }
    }
}

impl Part {
    fn read(folder: &Path) -> Result<Self, Failure> {
        let results = Results::read(folder)?;
        results.check_hashes()?;
        let evidence = results.evidence()?;
        let fields = results.comparable().into_iter().map(|quantity| {
            let heights = quantity.heights(results.report.size.into())?;
            let heights = match &evidence {
                Some(evidence) => heights.with_evidence(evidence.clone())?,
                None => heights,
            };
            Ok((quantity.label(), quantity.unit, heights))
        });
        let fields = fields.collect::<Result<_, Failure>>()?;
        let report = &results.report;
        let (converged, settings) = (report.converged, settings(report)?);
        Ok(Self { folder: folder.to_path_buf(), converged, settings, picture: results.fused()?, fields })
    }

    /// Refuses results of other settings: then heights differ for another reason than the part.
    fn check_settings(&self, first: &Self) -> Result<(), Failure> {
        let differing = differing(&self.settings, &first.settings);
        if differing.is_empty() {
            return Ok(());
        }
        let each = differing.iter().map(|(name, [own, golden])| format!("{name} is {own} and {golden}"));
        let all = each.collect::<Vec<_>>().join(", ");
        Err(self.failed(first, format!("have other settings: {all}; solve both with the same settings")))
    }

    /// The heights of the part on the pixels of a golden part, and the transform T from those pixels to its own.
    fn on(&self, first: &Self, quantity: &str, in_place: bool) -> Result<(Heights, Similarity), Failure> {
        let heights = self.field(quantity, first)?;
        let transform = match in_place || self.folder == first.folder {
            true => Similarity::IDENTITY,
            false => baseline::key_points([&first.picture, &self.picture], Decode::None, None)
                .map_err(|e| self.failed(first, format!("{e}; --in-place takes the pictures as they lie")))?,
        };
        Ok((heights.resample([heights.width, heights.height], &transform), transform))
    }

    /// The heights. Refuses a size that differs from the golden part's.
    fn field(&self, quantity: &str, first: &Self) -> Result<&Heights, Failure> {
        let size = |part: &Self| [part.picture.width(), part.picture.height()];
        let ([w, h], [width, height]) = (size(self), size(first));
        if [w, h] != [width, height] {
            return Err(self.failed(first, format!("are of {w}x{h} and {width}x{height} pixels; solve the same part")));
        }
        let found = self.fields.iter().find(|field| field.0 == quantity).map(|field| &field.2);
        found.ok_or_else(|| self.failed(first, format!("have no {quantity} in common")))
    }

    /// Why its heights should not be believed, if there is a reason.
    fn doubt(&self) -> Option<String> {
        (self.converged == Some(false)).then(|| format!("the solve of {} had not converged", self.folder.display()))
    }

    fn failed(&self, other: &Self, problem: impl std::fmt::Display) -> Failure {
        Failure::Failed(format!("{} and {}: {problem}", self.folder.display(), other.folder.display()))
    }
}

/// Settings that change how a solve arrives at its result, and not the result of one that converged.
const PATH: [&str; 9] = [
    "start",
    "start_photometric",
    "registration_step",
    "levels",
    "outer_iterations",
    "relaxation_sweeps",
    "over_relaxation",
    "continuation",
    "largest_step",
];

/// The settings that the heights of results depend on. For a sweep whose focus is in settings, they include the number
/// of frames, since one setting is the distance between two frames.
fn settings(report: &Report) -> Result<Value, Failure> {
    let failed = |e: serde_json::Error| Failure::Failed(e.to_string());
    let mut settings = serde_json::to_value(&report.settings).map_err(failed)?;
    if let Some(map) = settings.as_object_mut() {
        map.retain(|name, _| !PATH.contains(&name.as_str()));
        // As found, since `auto` may find another curve for each part.
        map.insert("decode".to_string(), serde_json::to_value(report.values.decode).map_err(failed)?);
        map.insert("flattened".to_string(), report.flattened.into());
        if report.focus_unit.as_deref() == Some("settings") {
            map.insert("number of frames".to_string(), report.frames.len().into());
        }
    }
    Ok(settings)
}

/// The summary.
fn summary(report: &InspectReport, out: Option<&Path>) -> String {
    let (unit, t) = (report.unit, &report.transform);
    let mut lines = vec![format!("verdict        {}", report.verdict.text())];
    lines.extend(report.reasons.iter().map(|reason| format!("reason         {reason}")));
    let (x, y, turn, scale) = (t.tx, t.ty, t.rotation_deg(), t.scale);
    lines.push(format!("part lies      {x:+.2} {y:+.2} px, {turn:+.3}°, scale {scale:.4} off"));
    let [right, down] = report.plane.slope;
    lines.push(format!(
        "plane          {:+.4} {unit}, {right:+.6} {down:+.6} {unit}/px right, down; tilt {:.2} of {:.2} {unit} allowed",
        report.plane.offset, report.tilt, report.limits.max_tilt
    ));
    let all = report.judged_px + report.unjudged_px + report.uncertain_px;
    let share = |pixels: usize| 100.0 * pixels as f64 / all.max(1) as f64;
    lines.push(format!(
        "judged         {} of the golden part's {} px; {:.1} % without a height, {:.1} % too uncertain",
        report.judged_px,
        all,
        share(report.unjudged_px),
        share(report.uncertain_px)
    ));
    for (n, region) in (1..=SHOWN).zip(&report.regions) {
        let ([x, y], found) = (region.deviation.centroid_px, &region.deviation);
        let (area, mean, extreme) = (found.area_px, found.mean, found.extreme);
        lines.push(format!(
            "region {n:<7} {area} px at {x:.1},{y:.1}, {mean:+.4} {unit} on average, {extreme:+.4} at most"
        ));
    }
    let more = report.regions.len().saturating_sub(SHOWN);
    lines.extend((more > 0).then(|| format!("regions        {more} more, smaller ones")));
    lines.extend(out.map(|out| format!("results        {}", out.display())));
    lines.join("\n")
}

/// Greatest number of regions in the summary.
const SHOWN: usize = 10;
