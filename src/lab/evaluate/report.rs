//! `report.md`: everything as tables and figures, every statement computed from the numbers.

use super::calibration::Calibration;
use super::descent::{EQUAL, Race};
use super::errors::BORDER;
use super::figures::called;
use super::kernels::KernelResult;
use super::real::{Estimate, PairResult};
use super::registration::CaseResult;
use super::robustness::{PAPER_PX, Sweep};
use super::system::{NONE, REFERENCE, SystemResult};
use super::table::{DASH, Table, number, seconds, yes};
use super::targets::{Target, as_good};
use super::{FIGURES, Figure, Results, itself, section, sweeps};

pub(super) fn markdown(results: &Results, figures: &[Figure]) -> String {
    let figure = |start: &str| -> String { figures.iter().filter(|f| f.name.starts_with(start)).map(link).collect() };
    let paper = [
        targets(&results.targets, &results.registration),
        table1(&results.registration),
        figure("fig4"),
        table2(results),
        ["fig6", "fig7", "fig8", "fig9"].map(figure).concat(),
        robustness(&results.robustness),
        figure("robustness"),
        descent(&results.descent),
        figure("descent"),
        kernels(&results.kernels),
        calibration(&results.calibration),
    ];
    // What was not run has no results, and an empty table would say that it had none.
    let paper = if results.registration.is_empty() { Vec::new() } else { paper.to_vec() };
    let judged = [(itself::HEADING, &results.itself), (sweeps::HEADING, &results.sweeps)];
    let judged = judged.map(|(heading, sections)| section::markdown(heading, sections));
    let sections = [vec![head(results)], paper, judged.to_vec()].concat();
    sections.into_iter().filter(|s| !s.is_empty()).collect::<Vec<_>>().join("\n")
}

fn link(figure: &Figure) -> String {
    format!("![{}]({FIGURES}/{}.png)\n\n", figure.caption, figure.name)
}

fn head(results: &Results) -> String {
    let device = &results.device;
    let quick = if results.quick {
        "\nThis was a quick run, on scenes of 128 x 128 px and reduced photographs: it shows that everything runs, \
         and the targets, which are for the full run, need not be met.\n"
    } else {
        ""
    };
    format!(
        "# Evaluation\n\nparfocal {} on {}, driver {}. The experiments are those of Ben-Ari, *A Unified Approach for \
         Registration and Depth in Depth from Defocus*, TPAMI 2014, section 5. Times are wall-clock times of whole \
         solves on this device, beside whatever else it did; on a software device they say little about a \
         GPU.\n{quick}",
        results.version, device.name, device.driver
    )
}

fn targets(targets: &[Target], registration: &[CaseResult]) -> String {
    let mut table = Table::new(["target", "bound", "worst", "pairs", "met", "missed by"]);
    for t in targets {
        let missed: Vec<String> = t.missed.iter().map(|(name, v)| format!("{name} ({})", number(*v))).collect();
        let sign = if t.at_most { "≤" } else { "≥" };
        table.row([
            t.name.clone(),
            format!("{sign} {} {}", t.bound, t.unit),
            number(t.worst),
            t.judged.to_string(),
            if t.judged > 0 { yes(t.met) } else { "not tested".to_string() },
            missed.join("; "),
        ]);
    }
    let met = targets.iter().filter(|t| t.met == Some(true)).count();
    format!(
        "## Targets\n\n{met} of {} targets are met.\n\n{}\nA separate system counts as good as the unified one where \
         its corner error is at most twice as large, or at most 0.01 px: {}.\n",
        targets.len(),
        table.markdown(),
        good(registration)
    )
}

fn good(registration: &[CaseResult]) -> String {
    let list: Vec<String> = as_good(registration)
        .into_iter()
        .map(|(case, system, corner)| format!("{} on {case} ({} px)", called(system), number(corner)))
        .collect();
    if list.is_empty() { "nowhere".to_string() } else { list.join(", ") }
}

fn table1(results: &[CaseResult]) -> String {
    let mut table = Table::new([
        "pair",
        "system",
        "t_x, px",
        "t_y, px",
        "θ, °",
        "s, %",
        "corners, px",
        "V to truth, px²",
        "V to aligned, px²",
        "energy",
        "time, s",
        "converged",
    ]);
    let mut notes = Vec::new();
    for case in results {
        if let Some(problem) = &case.failure {
            notes.push(format!("- {}: {problem}", case.case));
        }
        if let Some(t) = &case.truth {
            let scale = 100.0 * (t.scale - 1.0);
            let truth = [t.tx, t.ty, t.rotation_deg(), scale].map(number);
            table.row([vec![format!("**{}**", case.case), "truth".to_string()], truth.to_vec()].concat());
        }
        for s in &case.systems {
            table.row(table1_row(s));
            notes.extend(why(s.system, &s.failure, &s.warnings).map(|w| format!("- {}, {w}", case.case)));
        }
    }
    format!(
        "## Table 1: registration errors\n\nWhat was found less the truth, and the largest error of a corner. V: rms, \
         {BORDER} px along the border left out, of V less the true V and of V less that of the {REFERENCE} (the same \
         without displacement, T held at identity), each less its own truth where a lens breathes. Energy: E per \
         valid pixel after the last iteration. The truth of a displaced photograph is the displacement after the \
         unified method's own estimate of the pair as taken: that row leans towards it, and is not among the targets \
         of registration.\n\n{}{}",
        table.markdown(),
        listed(&notes)
    )
}

fn table1_row(s: &SystemResult) -> Vec<String> {
    let error = s.error.map(|e| [e.tx_px, e.ty_px, e.rotation_deg, e.scale_percent, e.corner_px].map(number));
    let error = error.unwrap_or([DASH; 5].map(String::from));
    let name = vec![String::new(), called(s.system).to_string()];
    let rest =
        [number(s.v_rms_to_truth), number(s.v_rms_to_aligned), number(s.energy), seconds(s.time_ms), yes(s.converged)];
    [name, error.to_vec(), rest.to_vec()].concat()
}

fn table2(results: &Results) -> String {
    let mut table = Table::new([
        "pair",
        "system",
        "t_x, px",
        "t_y, px",
        "θ, °",
        "s, %",
        "gain",
        "corners from unified, px",
        "energy",
        "at the limit of V, %",
        "time, s",
        "converged",
    ]);
    let mut notes = Vec::new();
    for pair in &results.real {
        let PairResult { width, height, .. } = pair;
        table.row([format!("**{}**", pair.pair), format!("{width}x{height} px")]);
        notes.extend(pair.failure.iter().map(|problem| format!("- {}: {problem}", pair.pair)));
        for s in &pair.systems {
            table.row(table2_row(s));
            notes.extend(why(s.system, &s.failure, &s.warnings).map(|w| format!("- {}, {w}", pair.pair)));
        }
    }
    for absent in &results.absent {
        let files: Vec<String> = absent.looked_for.iter().map(|p| p.display().to_string()).collect();
        notes.push(format!("- {}: absent: looked for {}", absent.name, files.join(" and ")));
    }
    format!(
        "## Table 2: photographs\n\nEstimates: nobody knows the truth. The lower the energy a valid pixel, the better \
         a registration and its V explain the pair; which pixels are valid differs a little between the \
         systems.\n\n{}{}",
        if results.real.is_empty() { "There was no pair.\n".to_string() } else { table.markdown() },
        listed(&notes)
    )
}

fn table2_row(s: &Estimate) -> Vec<String> {
    let t = s.transform.map(|t| [t.tx, t.ty, t.rotation_deg(), 100.0 * (t.scale - 1.0)].map(number));
    let t = t.unwrap_or([DASH; 4].map(String::from));
    let name = vec![String::new(), called(s.system).to_string()];
    let rest = [
        number(s.photometric.map(|p| p.gain)),
        number(s.corner_to_unified_px),
        number(s.energy),
        number(s.saturated_fraction.map(|f| 100.0 * f)),
        seconds(s.time_ms),
        yes(s.converged),
    ];
    [name, t.to_vec(), rest.to_vec()].concat()
}

fn robustness(sweeps: &[Sweep]) -> String {
    let mut edges = Table::new(["sweep", "system", "holds to", "fails at"]);
    let mut text = format!(
        "## Robustness\n\nCorner error of the slanted plane, 256 x 256 px, V ±4 px², median over the seeds (least to \
         greatest), px; registration alone. A dash: no answer. The working range of a system ends where its median \
         first exceeds {PAPER_PX} px, the paper's bound.\n\n"
    );
    for sweep in sweeps {
        for edge in &sweep.edges {
            let end = edge.fails_at.map_or("not within the sweep".to_string(), |v| v.to_string());
            let start = edge.holds_to.map_or(DASH.to_string(), |v| v.to_string());
            edges.row([sweep.quantity.to_string(), called(edge.system).to_string(), start, end]);
        }
    }
    text += &edges.markdown();
    for sweep in sweeps {
        text += &format!("\n### {}\n\n{}\n\n{}", sweep.name, sweep.note, points(sweep));
    }
    text
}

fn points(sweep: &Sweep) -> String {
    let systems = sweep.points.first().map_or(&[][..], |p| &p.systems);
    let names = systems.iter().map(|s| called(s.system));
    let mut table = Table::new([sweep.quantity].into_iter().chain(names));
    for point in &sweep.points {
        let cells = point
            .systems
            .iter()
            .map(|s| format!("{} ({} to {})", number(s.spread.median), number(s.spread.low), number(s.spread.high)));
        table.row([point.value.to_string()].into_iter().chain(cells));
    }
    table.markdown()
}

fn descent(races: &[Race]) -> String {
    let mut table = Table::new([
        "scene",
        "scheme",
        "iterations to within 1 % of the best",
        "time, s",
        "corners after 20, px",
        "energy above its floor after 20",
        "best of any run",
    ]);
    for race in races {
        let above = |energy: f64| energy - race.energy_floor;
        for scheme in &race.schemes {
            let equal = scheme.runs.iter().find(|run| run.iterations == EQUAL);
            table.row([
                race.scene.to_string(),
                scheme.name().to_string(),
                scheme.iterations_to_best.map_or("not reached".to_string(), |n| n.to_string()),
                seconds(scheme.time_to_best_ms),
                number(equal.and_then(|run| run.corner_px)),
                number(equal.and_then(|run| run.energy).map(above)),
                number(race.best_energy.map(above)),
            ]);
        }
    }
    let allowed = || races.iter().flat_map(|r| &r.schemes).flat_map(|s| &s.runs).map(|run| run.iterations);
    let (least, most) = (allowed().min().unwrap_or(0), allowed().max().unwrap_or(0));
    format!(
        "## Gauss-Newton against gradient descent\n\nWhole solves by the unified method, with from {least} to {most} \
         outer iterations allowed on each level. Energy: E a pixel above its floor, η + α η_tv = {}, below which no V \
         and T bring it.\n\n{}",
        number(races.first().map(|race| race.energy_floor)),
        table.markdown()
    )
}

fn kernels(results: &[KernelResult]) -> String {
    let mut table = Table::new(["scene", "its kernel", "solved with", "corners, px", "V to truth, px²"]);
    for k in results {
        table.row([
            k.scene.to_string(),
            k.scene_kernel.clone(),
            k.model_kernel.clone(),
            k.failure.clone().unwrap_or_else(|| number(k.error.map(|e| e.corner_px))),
            number(k.v_rms_to_truth),
        ]);
    }
    format!("## Kernels\n\nThe unified method with the scene's kernel and with another.\n\n{}", table.markdown())
}

fn calibration(results: &[Calibration]) -> String {
    let tenths = (1..=10).map(|n| n.to_string());
    let mut table = Table::new(["scene", "noise σ", ""].map(String::from).into_iter().chain(tenths));
    for c in results {
        let name = [c.scene.to_string(), c.noise.to_string()];
        let row = |what: &str, value: &dyn Fn(&super::calibration::Decile) -> f64| {
            [String::new(), String::new(), what.to_string()]
                .into_iter()
                .chain(c.deciles.iter().map(|d| number(Some(value(d)))))
                .collect::<Vec<_>>()
        };
        table.row(name.into_iter().chain(c.failure.clone()));
        table.row(row("confidence", &|d| d.confidence));
        table.row(row("stated σ_V, px²", &|d| d.stated_px2));
        table.row(row("rms error, px²", &|d| d.rms_error_px2));
    }
    format!(
        "## Calibration\n\nWhether V is off by what its uncertainty says: tenths of the valid pixels, from the most to \
         the least certain; their median confidence, their median stated standard deviation, and the rms of V less the \
         true V.\n\n{}",
        table.markdown()
    )
}

/// Why a system failed or is in doubt. Without registration doubt is what is expected, and says nothing.
fn why<'a>(system: &'a str, failure: &'a Option<String>, doubts: &'a [String]) -> impl Iterator<Item = String> + 'a {
    let doubts = if system == NONE { &[] } else { doubts };
    failure.iter().chain(doubts).map(move |w| format!("{}: {w}", called(system)))
}

fn listed(notes: &[String]) -> String {
    if notes.is_empty() { String::new() } else { format!("\n{}\n", notes.join("\n")) }
}
