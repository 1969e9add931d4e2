//! What a solve tells a person: progress while it runs, a few lines when it is done.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use parfocal::Progress;
use parfocal::export::{FILES, Report};

/// A bar over the levels, on stderr.
pub(super) struct Bar(ProgressBar);

impl Bar {
    /// A bar, or nothing at all where nobody would see it.
    pub(super) fn new(visible: bool) -> Self {
        let bar = if visible { ProgressBar::no_length() } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template("level {pos}/{len} {bar:24} {elapsed} {msg}") {
            bar.set_style(style);
        }
        Self(bar)
    }

    /// Shows how far the solve has come.
    pub(super) fn show(&self, progress: Progress) {
        self.0.set_length(u64::from(progress.levels));
        self.0.set_message(format!("{}x{}", progress.width, progress.height));
        self.0.set_position(u64::from(progress.done));
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// The few lines, without a newline at the end.
pub(super) fn summary(report: &Report, out: &Path) -> String {
    let (t, p, time) = (&report.transform, &report.photometric, &report.timings_ms);
    let registration = format!(
        "{:+.3} px right, {:+.3} px down, rotation {:+.4}°, scale {:.5}",
        t.tx_px, t.ty_px, t.rotation_deg, t.scale
    );
    let converged = if report.converged { "yes" } else { "no" };
    let mut rows = vec![
        ("device", format!("{} ({})", report.device.name, report.device.driver)),
        ("method", format!("{}, levels: {}", report.method, report.levels.len())),
        ("transform", registration),
        ("exposure", format!("gain {:.4}, offset {:+.4}", p.gain, p.offset)),
        ("relative blur", blur(report)),
        ("converged", converged.to_string()),
    ];
    rows.extend(report.warnings.iter().map(|warning| ("warning", warning.clone())));
    rows.push(("time", format!("{:.0} ms, {:.0} ms of it on the device", time.total, time.gpu)));
    rows.push(("results", format!("{}: {}", out.display(), FILES.join(" "))));
    rows.iter().map(|(label, value)| format!("{label:<14} {value}")).collect::<Vec<_>>().join("\n")
}

fn blur(report: &Report) -> String {
    let range = &report.relative_blur;
    let (Some(min), Some(max), Some(median)) = (range.min, range.max, range.median) else {
        return "no valid pixel".to_string();
    };
    format!(
        "{min:+.2} to {max:+.2} px², median {median:+.2}; {:.1} % of the pixels valid, {:.1} % of those at the limit",
        100.0 * report.valid_fraction,
        100.0 * report.saturated_fraction
    )
}
