//! Two reports beside each other.

use super::table::{aligned, number, title};
use super::{Report, RunReport, Spread};

/// New over old of every run that both reports hold, by size, method and kernel, as a table without a newline at its
/// end: time end to end and on the device, with the least and the greatest ratio that the samples allow, and the
/// medians of every pass. Above 1 is slower. Runs that only one of them holds are named.
pub fn compare(old: &Report, new: &Report) -> String {
    let mut rows = vec![["", "old ms", "new ms", "new/old", "least", "greatest"].map(str::to_string).to_vec()];
    let mut lone: Vec<String> = Vec::new();
    for run in &new.runs {
        match old.runs.iter().find(|earlier| same(earlier, run)) {
            Some(earlier) => rows.extend(pair(earlier, run)),
            None => lone.push(format!("only in the new report: {}", name(run))),
        }
    }
    let gone = old.runs.iter().filter(|run| !new.runs.iter().any(|later| same(run, later)));
    lone.extend(gone.map(|run| format!("only in the old report: {}", name(run))));
    if old.device != new.device {
        let [a, b] = [old, new].map(|r| format!("{} ({})", r.device.device.name, r.device.device.driver));
        lone.push(format!("the devices differ: {a}, then {b}"));
    }
    let told = [old, new].map(|r| (&r.input, r.outer_iterations, r.relaxation_sweeps));
    if told[0] != told[1] {
        lone.push("the reports differ in input, outer iterations or relaxation sweeps".to_string());
    }
    std::iter::once(aligned(&rows)).chain(lone).collect::<Vec<_>>().join("\n")
}

fn same(a: &RunReport, b: &RunReport) -> bool {
    (a.width, a.height, &a.method, &a.kernel) == (b.width, b.height, &b.method, &b.kernel)
}

fn name(run: &RunReport) -> String {
    title(run.width, run.height, &run.method, &run.kernel)
}

/// The rows of one run.
fn pair(old: &RunReport, new: &RunReport) -> Vec<Vec<String>> {
    let mut rows = vec![vec![name(new)], spread("solve", &old.solve_ms, &new.solve_ms)];
    if let (Some(old), Some(new)) = (&old.device_ms, &new.device_ms) {
        rows.push(spread("device", old, new));
    }
    for pass in &new.passes {
        if let Some(earlier) = old.passes.iter().find(|p| p.name == pass.name) {
            let cells = [number(earlier.ms), number(pass.ms), ratio(pass.ms, earlier.ms)];
            rows.push([vec![format!("    {}", pass.name)], cells.to_vec()].concat());
        }
    }
    rows
}

fn spread(name: &str, old: &Spread, new: &Spread) -> Vec<String> {
    let ratios = [(new.median, old.median), (new.min, old.max), (new.max, old.min)].map(|(n, o)| ratio(n, o));
    [vec![format!("  {name}"), number(old.median), number(new.median)], ratios.to_vec()].concat()
}

/// A dash where the ratio is no number.
fn ratio(new: f64, old: f64) -> String {
    let ratio = new / old;
    if ratio.is_finite() { format!("{ratio:.2}") } else { number(None) }
}

#[cfg(test)]
mod tests {
    use super::super::{Cold, DeviceReport, Dispatches, Memory, PassReport};
    use super::*;

    fn run(width: u32, ms: [f64; 3], relax: f64) -> RunReport {
        RunReport {
            width,
            height: 64,
            method: "unified".to_string(),
            kernel: "gaussian".to_string(),
            solve_ms: Spread::of(&ms).unwrap(),
            device_ms: Spread::of(&ms),
            mpx_per_s: 1.0,
            device_mpx_per_s: None,
            cold: Cold { prepare_ms: 1.0, first_ms: 1.0 },
            memory: Memory { device_bytes_per_px: 1.0, host_bytes_per_px: 1.0 },
            dispatches: Dispatches { recorded: 1, executed: 1 },
            levels: Vec::new(),
            relaxation: None,
            passes: vec![PassReport {
                name: "relax".to_string(),
                ms: relax,
                dispatches: 1,
                bytes: 1,
                gb_per_s: 1.0,
                share_of_copy: None,
            }],
        }
    }

    fn report(runs: Vec<RunReport>) -> Report {
        let device = crate::files::export::DeviceReport { name: "d".into(), driver: "v".into(), uuid: String::new() };
        Report {
            version: String::new(),
            device: DeviceReport { device, subgroup_size: 8 },
            input: "synthetic".to_string(),
            warmup: 1,
            repeats: 3,
            outer_iterations: 20,
            relaxation_sweeps: 5,
            copy_gb_per_s: None,
            engine_ms: 1.0,
            runs,
            refused: Vec::new(),
        }
    }

    fn cells(text: &str, first: &str) -> Vec<String> {
        let line = text.lines().find(|line| line.trim_start().starts_with(first)).unwrap();
        line.split_whitespace().skip(1).map(str::to_string).collect()
    }

    #[test]
    fn ratios_are_new_over_old_with_the_spread_of_the_samples() {
        let old = report(vec![run(64, [9.0, 10.0, 12.0], 4.0), run(32, [1.0; 3], 1.0)]);
        let new = report(vec![run(64, [18.0, 20.0, 24.0], 2.0), run(128, [1.0; 3], 0.0)]);
        let text = compare(&old, &new);
        assert_eq!(cells(&text, "solve"), ["10.0", "20.0", "2.00", "1.50", "2.67"]);
        assert_eq!(cells(&text, "relax"), ["4.00", "2.00", "0.50"]);
        assert!(text.contains("only in the new report: 128x64") && text.contains("only in the old report: 32x64"));
        assert!(!text.contains("differ"), "{text}");
    }

    #[test]
    fn a_report_beside_itself_is_one_and_nothing_over_nothing_a_dash() {
        let one = report(vec![run(64, [5.0; 3], 0.0)]);
        let text = compare(&one, &one);
        assert_eq!(cells(&text, "solve")[2..], ["1.00", "1.00", "1.00"]);
        assert_eq!(cells(&text, "relax"), ["0", "0", "-"]);
        let mut other = one.clone();
        (other.device.device.name, other.relaxation_sweeps) = ("e".to_string(), 6);
        let text = compare(&one, &other);
        assert!(text.contains("the devices differ: d (v), then e (v)") && text.contains("sweeps"), "{text}");
    }
}
