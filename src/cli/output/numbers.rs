//! Numbers and measurements as text.

use parfocal::export::{DepthReport, Measurements, StepReport};
use parfocal::metric::Estimate;

/// The range of depth and the number of pixels beyond it.
pub(crate) fn depth_range(report: &DepthReport) -> String {
    let (range, out) = (&report.range, report.out_of_range);
    let beyond = match (report.lens.is_some(), out) {
        // A stage reaches no infinity.
        (false, 0) => String::new(),
        (false, _) => format!("; beyond infinity: {out} px"),
        (true, _) => format!("; out of the range of the lens: {out} px"),
    };
    let (Some(min), Some(max), Some(median)) = (range.min, range.max, range.median) else {
        return format!("of no pixel{beyond}");
    };
    let digits = decimals(f64::from(max - min) / 100.0);
    format!("{min:.digits$} to {max:.digits$} mm, median {median:.digits$}{beyond}")
}

/// Number of decimals for a number with this error: two digits of the error.
pub(crate) fn decimals(error: f64) -> usize {
    // The logarithm is not finite for 0 and NaN. Six decimals are enough.
    if error > 0.0 { (1.0 - error.log10().floor()).clamp(0.0, 6.0) as usize } else { 6 }
}

/// A number with its sign. What rounds to zero is positive, since "-0.000" looks like a defect.
pub(crate) fn signed(value: f64, digits: usize) -> String {
    let text = format!("{value:+.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|byte| b"0.".contains(&byte)) => format!("+{zero}"),
        _ => text,
    }
}

/// Labels and texts of measurements.
pub(crate) fn measurements(measured: &Measurements) -> Vec<(&'static str, String)> {
    let steps = measured.steps.iter().map(|step| ("step", step_height(step)));
    let profiles = measured.profiles.iter().map(|profile| ("profile", format!("{} {}", profile.csv, profile.png)));
    steps.chain(profiles).collect()
}

fn step_height(step: &StepReport) -> String {
    let number = |Estimate { value, standard_error }, unit: &str| {
        let digits = decimals(standard_error);
        format!("{} ± {standard_error:.digits$} {unit}", signed(value, digits))
    };
    let unit = step.unit.as_str();
    // The focus of a sweep may be in mm already.
    let depth = step.depth_mm.filter(|_| unit != "mm" || step.difference.is_none());
    let blur = step.difference.map_or("too few valid pixels".to_string(), |estimate| number(estimate, unit));
    depth.map_or(blur.clone(), |estimate| format!("{}, {blur}", number(estimate, "mm")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounds_to_zero_is_positive() {
        assert_eq!([-0.0004, -0.0, -0.0006, 1.0].map(|x| signed(x, 3)), ["+0.000", "+0.000", "-0.001", "+1.000"]);
        assert_eq!(signed(-0.4, 0), "+0");
    }
}
