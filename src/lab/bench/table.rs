//! A report as text: aligned columns for people, CSV for spreadsheets.

use super::{Report, RunReport, Spread};

/// Stands where there is nothing.
const DASH: &str = "-";

/// Rows of cells as lines: the first column to the left, the others to the right, two spaces between.
pub(super) fn aligned(rows: &[Vec<String>]) -> String {
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

/// Three digits or more; a dash for nothing and for what is no number.
pub(super) fn number(value: impl Into<Option<f64>>) -> String {
    match value.into().filter(|v| v.is_finite()) {
        None => DASH.to_string(),
        Some(0.0) => "0".to_string(),
        Some(v) => format!("{v:.*}", (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize),
    }
}

fn percent(share: Option<f64>) -> String {
    share.map_or(DASH.to_string(), |share| format!("{:.0} %", 100.0 * share))
}

/// Median, and least to greatest.
fn spread(values: Option<&Spread>) -> String {
    values.map_or(DASH.to_string(), |s| format!("{} ({} to {})", number(s.median), number(s.min), number(s.max)))
}

/// A line for each name and what it says.
fn lines(indent: &str, facts: &[(&str, String)]) -> String {
    facts.iter().map(|(name, value)| format!("{indent}{name:<11}{value}")).collect::<Vec<_>>().join("\n")
}

impl Report {
    /// For a person, without a newline at its end.
    pub fn table(&self) -> String {
        let device = &self.device.device;
        let facts = [
            ("device", format!("{} ({}), subgroups of {}", device.name, device.driver, self.device.subgroup_size)),
            ("copy", format!("{} GB/s", spread(self.copy_gb_per_s.as_ref()))),
            ("engine", format!("{} ms, cold", number(self.engine_ms))),
            ("input", self.input.clone()),
            (
                "solves",
                format!("{}, after the first and {} more: median (least to greatest)", self.repeats, self.warmup),
            ),
        ];
        let mut text = lines("", &facts);
        for run in &self.runs {
            text += &format!("\n\n{}", run.table());
        }
        for refused in &self.refused {
            let title = title(refused.width, refused.height, &refused.method, &refused.kernel);
            text += &format!("\n\n{title}: {}", refused.error);
        }
        text
    }

    /// A line for each run, under a line of names; without a newline at its end.
    pub fn csv(&self) -> String {
        let mut passes = Vec::new();
        for pass in self.runs.iter().flat_map(|run| &run.passes) {
            if !passes.contains(&pass.name) {
                passes.push(pass.name.clone());
            }
        }
        let head: Vec<String> = FIELDS.iter().map(|(name, _)| name.to_string()).collect();
        let head = head.into_iter().chain(passes.iter().map(|name| format!("{name}_ms"))).collect::<Vec<_>>();
        let line = |run: &RunReport| {
            let ms = |name: &String| run.passes.iter().find(|p| p.name == *name).map(|p| p.ms.to_string());
            let cells = FIELDS.iter().map(|(_, value)| value(run));
            // A pass that a run lacks took no time.
            cells.chain(passes.iter().map(|name| ms(name).unwrap_or("0".into()))).collect::<Vec<_>>().join(",")
        };
        std::iter::once(head.join(",")).chain(self.runs.iter().map(line)).collect::<Vec<_>>().join("\n")
    }
}

/// A column of the CSV and its cell; empty for nothing.
type Column = (&'static str, fn(&RunReport) -> String);

const FIELDS: &[Column] = &[
    ("width", |r| r.width.to_string()),
    ("height", |r| r.height.to_string()),
    ("method", |r| quoted(&r.method)),
    ("kernel", |r| quoted(&r.kernel)),
    ("solve_ms", |r| r.solve_ms.median.to_string()),
    ("solve_ms_min", |r| r.solve_ms.min.to_string()),
    ("solve_ms_max", |r| r.solve_ms.max.to_string()),
    ("device_ms", |r| cell(r.device_ms.as_ref().map(|s| s.median))),
    ("device_ms_min", |r| cell(r.device_ms.as_ref().map(|s| s.min))),
    ("device_ms_max", |r| cell(r.device_ms.as_ref().map(|s| s.max))),
    ("mpx_per_s", |r| r.mpx_per_s.to_string()),
    ("device_mpx_per_s", |r| cell(r.device_mpx_per_s)),
    ("prepare_ms", |r| r.cold.prepare_ms.to_string()),
    ("first_ms", |r| r.cold.first_ms.to_string()),
    ("device_bytes_per_px", |r| r.memory.device_bytes_per_px.to_string()),
    ("host_bytes_per_px", |r| r.memory.host_bytes_per_px.to_string()),
    ("dispatches_recorded", |r| r.dispatches.recorded.to_string()),
    ("dispatches_executed", |r| r.dispatches.executed.to_string()),
    ("outer_iterations", |r| r.levels.iter().map(|l| l.iterations).sum::<usize>().to_string()),
    ("mpx_sweeps_per_s", |r| cell(r.relaxation.map(|x| x.mpx_sweeps_per_s))),
    ("relax_share_of_copy", |r| cell(r.relaxation.and_then(|x| x.share_of_copy))),
];

fn cell(value: Option<f64>) -> String {
    value.map(|v| v.to_string()).unwrap_or_default()
}

/// A name as RFC 4180 wants it: a measured kernel's may hold anything.
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.to_string() }
}

/// What a run is called.
pub(super) fn title(width: u32, height: u32, method: &str, kernel: &str) -> String {
    format!("{width}x{height} {method} {kernel}")
}

impl RunReport {
    fn table(&self) -> String {
        let levels = self.levels.iter().map(|l| l.iterations.to_string()).collect::<Vec<_>>().join(" ");
        let facts = [
            ("solve", format!("{} ms, {} Mpx/s", spread(Some(&self.solve_ms)), number(self.mpx_per_s))),
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
            ("iterations", format!("{levels} (coarse to fine)")),
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
        let title = title(self.width, self.height, &self.method, &self.kernel);
        format!("{title}\n{facts}\n{}", aligned(&rows))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_under_each_other() {
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

    #[test]
    fn names_are_quoted_where_they_must_be() {
        assert_eq!(quoted("gaussian"), "gaussian");
        assert_eq!(quoted("a \"b\", c"), "\"a \"\"b\"\", c\"");
    }
}
