//! Formats a report as text, and compares two reports.

use super::{Case, Refused, Report, RunReport, Spread};

/// The text for a missing value.
const DASH: &str = "-";

/// Formats rows of cells as lines. The first column is aligned left, the others right, with two spaces between.
fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let wide = |column: usize| rows.iter().filter_map(|row| row.get(column)).map(|c| c.chars().count()).max();
    let widths: Vec<usize> = (0..columns).map(|column| wide(column).unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match column {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_string()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn row<const N: usize>(cells: [&str; N]) -> Vec<String> {
    cells.map(str::to_string).to_vec()
}

/// Formats a number with three digits or more; a dash if it is missing or not finite.
fn number(value: impl Into<Option<f64>>) -> String {
    match value.into().filter(|v| v.is_finite()) {
        None => DASH.to_string(),
        Some(0.0) => "0".to_string(),
        Some(v) => format!("{v:.*}", (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize),
    }
}

fn percent(share: Option<f64>) -> String {
    share.map_or(DASH.to_string(), |share| format!("{:.0} %", 100.0 * share))
}

/// The median, and the range from the least to the greatest value.
fn spread(values: Option<&Spread>) -> String {
    values.map_or(DASH.to_string(), |s| format!("{} ({} to {})", number(s.median), number(s.min), number(s.max)))
}

/// Formats a line for each name and its value.
fn lines(indent: &str, facts: &[(&str, String)]) -> String {
    facts.iter().map(|(name, value)| format!("{indent}{name:<11}{value}")).collect::<Vec<_>>().join("\n")
}

impl Report {
    /// The report as text, without a newline at its end: a row for each run, the device, and the details of each run.
    pub fn table(&self) -> String {
        let device = &self.device.device;
        let mut facts = vec![
            ("device", format!("{} ({}), subgroups of {}", device.name, device.driver, self.device.subgroup_size)),
            ("copy", format!("{} GB/s", spread(self.copy_gb_per_s.as_ref()))),
            ("engine", format!("{} ms, cold", number(self.engine_ms))),
            (
                "solves",
                format!("{}, after the first and {} more: median (least to greatest)", self.repeats, self.warmup),
            ),
        ];
        if !self.absent.is_empty() {
            facts.push(("absent", format!("{}: give their folder with --data", self.absent.join(", "))));
        }
        let mut rows = vec![row([
            "scene",
            "size",
            "method",
            "kernel",
            "solve, ms",
            "Mpx/s",
            "iterations, coarse to fine",
            "converged",
        ])];
        rows.extend(self.runs.iter().map(RunReport::row));
        let mut text = format!("{}\n\n{}", aligned(&rows), lines("", &facts));
        for run in &self.runs {
            text += &format!("\n\n{}", run.details());
        }
        for Refused { case, error } in &self.refused {
            text += &format!("\n\n{case}: {error}");
        }
        text
    }
}

impl RunReport {
    /// The iterations of each level, coarse to fine.
    fn iterations(&self) -> String {
        self.levels.iter().map(|l| l.iterations.to_string()).collect::<Vec<_>>().join(" ")
    }

    fn converged(&self) -> &'static str {
        self.converged.map_or(DASH, |converged| if converged { "yes" } else { "no" })
    }

    fn row(&self) -> Vec<String> {
        let Case { scene, width, height, method, kernel } = &self.case;
        let [solve, rate] = [spread(Some(&self.solve_ms)), number(self.mpx_per_s)];
        let (iterations, converged) = (self.iterations(), self.converged());
        row([scene, &format!("{width}x{height}"), method, kernel, &solve, &rate, &iterations, converged])
    }

    fn details(&self) -> String {
        let facts = [
            ("device", format!("{} ms, {} Mpx/s", spread(self.device_ms.as_ref()), number(self.device_mpx_per_s))),
            (
                "cold",
                format!("prepare {} ms, first solve {} ms", number(self.cold.prepare_ms), number(self.cold.first_ms)),
            ),
            (
                "memory",
                format!(
                    "{} bytes a pixel on the device, {} that the host sees",
                    number(self.memory.device_bytes_per_px),
                    number(self.memory.host_bytes_per_px)
                ),
            ),
            ("dispatches", format!("{} of {} recorded", self.dispatches.executed, self.dispatches.recorded)),
            (
                "relaxation",
                self.relaxation.map_or(DASH.to_string(), |r| {
                    format!("{} Mpx-sweeps/s, {} of the copy", number(r.mpx_sweeps_per_s), percent(r.share_of_copy))
                }),
            ),
        ];
        let facts = lines("  ", &facts);
        let mut rows = vec![row(["  pass", "ms", "dispatches", "MB", "GB/s", "of copy"])];
        rows.extend(self.passes.iter().map(|p| {
            vec![
                format!("  {}", p.name),
                number(p.ms),
                p.dispatches.to_string(),
                number(p.bytes as f64 * 1e-6),
                number(p.gb_per_s),
                percent(p.share_of_copy),
            ]
        }));
        format!("{}\n{facts}\n{}", self.case, aligned(&rows))
    }
}

/// A table of the ratios new/old of all runs that both reports contain, without a newline at its end. A ratio above 1
/// means slower.
///
/// It has the time end to end and on the device, each with the least and the greatest ratio of the samples, the
/// iterations of each level, convergence, and the time of every pass. Runs that only one report contains are named.
pub fn compare(old: &Report, new: &Report) -> String {
    let mut rows = vec![row(["times in ms", "old", "new", "new/old", "least", "greatest"])];
    let mut notes: Vec<String> = Vec::new();
    for run in &new.runs {
        match old.runs.iter().find(|earlier| earlier.case == run.case) {
            Some(earlier) => rows.extend(pair(earlier, run)),
            None => notes.push(format!("only in the new report: {}", run.case)),
        }
    }
    let missing = old.runs.iter().filter(|run| !new.runs.iter().any(|later| later.case == run.case));
    notes.extend(missing.map(|run| format!("only in the old report: {}", run.case)));
    if old.device != new.device {
        let [a, b] = [old, new].map(|r| format!("{} ({})", r.device.device.name, r.device.device.driver));
        notes.push(format!("the devices differ: {a}, then {b}"));
    }
    let options = [old, new].map(|r| (r.outer_iterations, r.relaxation_sweeps));
    if options[0] != options[1] {
        notes.push("the reports differ in outer iterations or relaxation sweeps".to_string());
    }
    std::iter::once(aligned(&rows)).chain(notes).collect::<Vec<_>>().join("\n")
}

/// The rows of one run.
fn pair(old: &RunReport, new: &RunReport) -> Vec<Vec<String>> {
    let mut rows = vec![vec![new.case.to_string()], compare_spreads("solve", &old.solve_ms, &new.solve_ms)];
    if let (Some(old), Some(new)) = (&old.device_ms, &new.device_ms) {
        rows.push(compare_spreads("device", old, new));
    }
    rows.push(row(["  iterations", &old.iterations(), &new.iterations()]));
    rows.push(row(["  converged", old.converged(), new.converged()]));
    for pass in &new.passes {
        if let Some(earlier) = old.passes.iter().find(|p| p.name == pass.name) {
            let cells = [number(earlier.ms), number(pass.ms), ratio(pass.ms, earlier.ms)];
            rows.push([vec![format!("    {}", pass.name)], cells.to_vec()].concat());
        }
    }
    rows
}

fn compare_spreads(name: &str, old: &Spread, new: &Spread) -> Vec<String> {
    let ratios = [(new.median, old.median), (new.min, old.max), (new.max, old.min)].map(|(n, o)| ratio(n, o));
    [vec![format!("  {name}"), number(old.median), number(new.median)], ratios.to_vec()].concat()
}

/// A ratio; a dash if it is not finite.
fn ratio(new: f64, old: f64) -> String {
    let ratio = new / old;
    if ratio.is_finite() { format!("{ratio:.2}") } else { number(None) }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn columns_are_aligned() {
        let rows = [row(["pass", "ms"]), row(["relax", "12.5"]), row(["x", "1"])];
        assert_eq!(aligned(&rows), "pass     ms\nrelax  12.5\nx         1");
    }

    #[test]
    fn numbers_have_three_digits() {
        let cases = [(0.0, "0"), (0.01234, "0.0123"), (1.0, "1.00"), (123.4, "123"), (12345.6, "12346")];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
        assert_eq!((number(None), number(f64::INFINITY)), (DASH.to_string(), DASH.to_string()));
    }

    fn run(width: u32, ms: [f64; 3], relax: f64) -> RunReport {
        let spread = json!(Spread::of(&ms));
        let run = json!({
            "width": width, "height": 64, "method": "unified", "kernel": "gaussian", "solve_ms": spread,
            "device_ms": spread, "mpx_per_s": 1.0, "cold": { "prepare_ms": 1.0, "first_ms": 1.0 },
            "memory": { "device_bytes_per_px": 1.0, "host_bytes_per_px": 1.0 },
            "dispatches": { "recorded": 1, "executed": 1 },
            "levels": ([12, 8].map(|n| json!({ "width": 32, "height": 32, "iterations": n }))),
            "passes": [{ "name": "relax", "ms": relax, "dispatches": 1, "bytes": 1, "gb_per_s": 1.0 }],
        });
        serde_json::from_value(run).unwrap()
    }

    fn report(runs: Vec<RunReport>) -> Report {
        let report = json!({
            "version": "", "device": { "name": "d", "driver": "v", "uuid": "", "subgroup_size": 8 },
            "warmup": 1, "repeats": 3, "outer_iterations": 20, "relaxation_sweeps": 5,
            "engine_ms": 1.0, "runs": runs,
        });
        serde_json::from_value(report).unwrap()
    }

    fn cells(text: &str, first: &str) -> Vec<String> {
        let line = text.lines().find(|line| line.trim_start().starts_with(first)).unwrap();
        line.split_whitespace().skip(1).map(str::to_string).collect()
    }

    #[test]
    fn a_row_has_iterations_and_convergence() {
        let mut part = run(64, [1.0; 3], 1.0);
        (part.case.scene, part.converged) = ("part".to_string(), Some(false));
        let report = Report { absent: vec!["heatsink".to_string()], ..report(vec![part, run(32, [1.0; 3], 1.0)]) };
        let text = report.table();
        let rows: Vec<Vec<&str>> = text.lines().skip(1).take(2).map(|line| line.split_whitespace().collect()).collect();
        for (row, [scene, size, converged]) in rows.iter().zip([["part", "64x64", "no"], ["synthetic", "32x64", "-"]]) {
            assert_eq!(
                (row[..2].to_vec(), row[row.len() - 3..].to_vec()),
                (vec![scene, size], vec!["12", "8", converged])
            );
        }
        assert!(text.contains("absent     heatsink: give"), "{text}");
    }

    #[test]
    fn ratios_are_new_divided_by_old_with_the_spread_of_the_samples() {
        let old = report(vec![run(64, [9.0, 10.0, 12.0], 4.0), run(32, [1.0; 3], 1.0)]);
        let new = report(vec![run(64, [18.0, 20.0, 24.0], 2.0), run(128, [1.0; 3], 0.0)]);
        let text = compare(&old, &new);
        assert_eq!(cells(&text, "solve"), ["10.0", "20.0", "2.00", "1.50", "2.67"]);
        assert_eq!(cells(&text, "relax"), ["4.00", "2.00", "0.50"]);
        assert_eq!(cells(&text, "iterations"), ["12", "8", "12", "8"]);
        let only = |report, width| text.contains(&format!("only in the {report} report: synthetic {width}x64"));
        assert!(only("new", 128) && only("old", 32), "{text}");
        assert!(!text.contains("differ"), "{text}");
    }

    #[test]
    fn equal_reports_have_ratios_of_one_and_zero_by_zero_is_a_dash() {
        let one = report(vec![run(64, [5.0; 3], 0.0)]);
        let text = compare(&one, &one);
        assert_eq!(cells(&text, "solve")[2..], ["1.00", "1.00", "1.00"]);
        assert_eq!(cells(&text, "relax"), ["0", "0", "-"]);
        assert_eq!(cells(&text, "converged"), ["-", "-"]);
        let mut other = one.clone();
        (other.device.device.name, other.relaxation_sweeps) = ("e".to_string(), 6);
        let text = compare(&one, &other);
        assert!(text.contains("the devices differ: d (v), then e (v)") && text.contains("sweeps"), "{text}");
    }
}
