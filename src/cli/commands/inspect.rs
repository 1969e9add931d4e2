//! `parfocal inspect`: a part against a golden one, go or no-go.

use std::path::{Path, PathBuf};

use parfocal::export::{INSPECT_FILES, InspectReport};
use parfocal::metric::inspect::Verdict;

use crate::cli::inspection::arguments::{InspectionArguments, files_of, result_folders};
use crate::cli::inspection::judge::label_of;
use crate::cli::options::config_file::ConfigArgument;
use crate::cli::options::run::ReportArguments;
use crate::cli::output::destination::{self, ForceArgument};
use crate::cli::output::failure::Failure;

/// Inspect a part against a golden part: go, no-go if its heights deviate by more than the tolerance, or cannot judge.
#[derive(clap::Args, Debug)]
#[command(after_help = AFTER_HELP)]
pub(crate) struct Arguments {
    /// Folder of the part's results, from `parfocal solve -o` or `stack -o`
    part: PathBuf,
    #[command(flatten)]
    inspection: InspectionArguments,
    #[command(flatten)]
    config: ConfigArgument,
    /// Folder for inspect.json and inspect.png; it may be that of the part
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArguments,
    #[command(flatten)]
    force: ForceArgument,
}

const AFTER_HELP: &str = "\
The part's picture is registered onto the golden one's by key-points (a similarity), its heights are brought along, and
the plane that most of the difference lies in is taken out: how the part lies is no defect, up to the tilt that is
allowed. A pixel deviates where what is left is more than the tolerance, and more than K standard deviations of both; of
several golden parts, what they differ by at that pixel counts too. Pixels that touch are a region. Where the golden
part has a height and the part has none, no texture, or a height too uncertain for the tolerance, nothing is judged. A
region that lacks the golden part's texture is no-go. A part cannot be judged if too much of it or a region is
uncertain, if it lies tilted by more than is allowed, if a solve had not converged, or if the golden parts disagree.

Results, with -o, both or none:
  inspect.json  verdict, reasons, registration, plane, and of each region area, mean, extreme, place
  inspect.png   the part, on the golden one's pixels: red nearer to the camera, blue further away, striped not judged

Examples:
  parfocal inspect part --golden good1 good2 good3 --tolerance 0.05 -o part
  parfocal inspect part --golden golden.exr

Exit status: 0 go, 3 no-go, 4 cannot judge, 1 failed, 2 wrong usage.";

/// Reads, registers, inspects, writes and prints.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(out) = &arguments.output {
        check_output(arguments, out)?;
    }
    let Some(judge) = arguments.inspection.judge()? else {
        let problem = "--golden is missing: give folders of golden parts, or the file of parfocal teach";
        return Err(Failure::Usage(problem.to_string()));
    };
    let judged = judge.judge(&arguments.part, label_of(&arguments.part))?;
    if let Some(out) = &arguments.output {
        judged.write(arguments.force.to(out))?;
    }
    let report = &judged.report;
    arguments.report.print(&summary(report, arguments.output.as_deref()), report)?;
    match report.verdict {
        Verdict::Go => Ok(()),
        Verdict::NoGo => Err(Failure::NoGo),
        Verdict::CannotJudge => Err(Failure::CannotJudge),
    }
}

/// Refuses a folder that cannot be written.
fn check_output(arguments: &Arguments, out: &Path) -> Result<(), Failure> {
    destination::check_folder(out)?;
    let golden = result_folders(&arguments.inspection.golden)?;
    let inputs: Vec<PathBuf> = golden.iter().chain([&arguments.part]).flat_map(|folder| files_of(folder)).collect();
    destination::check(out, INSPECT_FILES[0], &INSPECT_FILES, &inputs.iter().collect::<Vec<_>>())?;
    Ok(arguments.force.to(out).check_results(INSPECT_FILES[0], &INSPECT_FILES)?)
}

fn summary(report: &InspectReport, out: Option<&Path>) -> String {
    let (unit, t) = (report.unit, &report.transform);
    let mut lines = vec![format!("verdict        {}", report.verdict.text())];
    lines.extend(report.reasons.iter().map(|reason| format!("reason         {reason}")));
    let (x, y, turn, scale) = (t.tx, t.ty, t.rotation_deg(), t.scale);
    let allowed = report.placement.map_or(String::new(), |range| {
        format!("; {:.1} px and {:.1}° allowed", range.max_shift_px, range.max_rotation_deg)
    });
    lines.push(format!("part lies      {x:+.2} {y:+.2} px, {turn:+.3}°, scale {scale:.4} off{allowed}"));
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
