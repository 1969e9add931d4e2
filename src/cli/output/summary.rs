//! The summary of a solve on stderr.

use std::fmt::Display;
use std::path::Path;

use parfocal::export::{FrameReport, Palette, ParallaxReport, Report};
use parfocal::image_io::{Basis, Input, Values};
use parfocal::{
    results::{OtherMotion, TransformDeviation},
    settings::{Decode, Photometric},
};

use crate::cli::output::numbers::{depth_range, measurements, signed};

/// A label with its text.
type Row = (&'static str, String);

/// The summary of a solve, without a newline at the end.
pub(crate) fn summary(report: &Report, palette: Palette, out: &Path) -> String {
    let mut rows = found(report);
    rows.extend(report.kernel_shape.map(|shape| ("blur", kernel(shape, report.separation))));
    let scale = |deviation: f64| format!("V as a whole may be off by {:.0} % (σ)", 100.0 * deviation);
    // Below half a per cent it says nothing that V's digits do not.
    rows.extend(
        report.scale_deviation.filter(|deviation| *deviation >= 0.005).map(|deviation| ("scale", scale(deviation))),
    );
    let by = if report.settings.regularization.is_some() { "as stated" } else { "found" };
    rows.extend(report.regularization.map(|alpha| ("smoothness", format!("α {}, {by}", rounded(alpha)))));
    rows.extend([("relative blur", blur(report)), ("depth.png", near_and_far(report, palette))]);
    rows.extend(report.depth.as_ref().map(|metric| ("depth", depth_range(metric))));
    rows.extend(report.measurements.iter().flat_map(measurements));
    rows.extend(judged(report));
    rows.push(("results", format!("{}: {}", out.display(), report.files.join(" "))));
    lines(&rows)
}

/// The summary of a registration, without a newline at the end.
pub(crate) fn registration_summary(report: &Report, out: Option<&Path>) -> String {
    let mut rows = found(report);
    rows.extend(judged(report));
    rows.extend(out.map(|file| ("result", file.display().to_string())));
    lines(&rows)
}

fn lines(rows: &[Row]) -> String {
    rows.iter().map(|(label, value)| format!("{label:<14} {value}")).collect::<Vec<_>>().join("\n")
}

/// Device, method, registration, motion and values.
fn found(report: &Report) -> Vec<Row> {
    let (device, levels) = (&report.device, report.levels.as_ref().map_or(0, Vec::len));
    let mut rows = vec![
        ("device", format!("{} ({})", device.name, device.driver)),
        ("method", format!("{}, levels: {levels}", report.method.name())),
    ];
    rows.extend(report.frames.get(1).into_iter().flat_map(registration));
    let known = |known: TransformDeviation| format!("known to {} px at a corner", rounded(known.corner_px));
    rows.extend(report.transform_deviation.map(|deviation| ("registration", known(deviation))));
    let parallax = |found: &ParallaxReport| ("parallax", camera_moved(rounded(found.near_to_far_px)));
    rows.extend(report.parallax.as_ref().map(parallax));
    let motion = |other: OtherMotion| ("motion", format!("{other} (--motion {})", other.motion.name()));
    rows.extend(report.other_motion.map(motion));
    rows.extend(clipped(&report.frames));
    if !report.inputs.is_empty() {
        rows.push(("values", values_in_words(&report.inputs, report.values)));
    }
    rows.extend(pictures_in_words(report).map(|words| ("pictures", words)));
    rows
}

/// The parallax in words. `px`: of near things against far ones.
pub(crate) fn camera_moved(px: impl Display) -> String {
    format!("the camera moved: near things are displaced against far ones by up to {px} px")
}

/// The shares of clipped pixels of I1 and I2, if there are any.
fn clipped(frames: &[FrameReport]) -> Option<Row> {
    let shares: Vec<f64> = frames.iter().map(|frame| 100.0 * frame.clipped_fraction.unwrap_or(0.0)).collect();
    let [first, second] = <[f64; 2]>::try_from(shares).ok()?;
    (first + second > 0.0).then(|| ("clipped", format!("{first:.1} % of the pixels of I1, {second:.1} % of I2")))
}

/// Transform and exposure of I2.
fn registration(frame: &FrameReport) -> [Row; 2] {
    let (t, Photometric { gain, offset }) = (&frame.transform, frame.photometric);
    let [right, down] = t.translation();
    let transform = format!(
        "{} px right, {} px down, rotation {}°, scale {:.5}",
        signed(right, 3),
        signed(down, 3),
        signed(t.rotation_deg(), 4),
        t.scale()
    );
    let [low, high] = frame.shading.range.map(|factor| 100.0 * (factor - 1.0));
    let shading = match frame.shading.is_significant() {
        true => format!(", shading {} to {} %", signed(low, 0), signed(high, 0)),
        false => String::new(),
    };
    [("transform", transform), ("exposure", format!("gain {gain:.4}, offset {}{shading}", signed(offset, 4)))]
}

/// The kernel and the separation of the focus settings that were found.
fn kernel(shape: f64, separation: Option<f64>) -> String {
    match separation {
        _ if shape == 0.0 => "Gaussian, found".to_string(),
        Some(p) => {
            format!("a disk, found; what is in focus in one photograph is {:.1} px wide in the other", 4.0 * p.sqrt())
        }
        None => "a disk, found, of the photograph that is less sharp".to_string(),
    }
}

/// Rounds to two significant digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

/// The decoding of the files, and its reason.
pub(crate) fn values_in_words(inputs: &[Input], Values { decode, by }: Values) -> String {
    let mut said: Vec<&str> = inputs.iter().filter_map(|input| input.encoding.as_deref()).collect();
    said.sort_unstable();
    said.dedup();
    let files = match said.as_slice() {
        [] => "the files do not say what they are".to_string(),
        several => format!("the files say {}", several.join(" and ")),
    };
    let reading = match said.as_slice() {
        _ if decode != Decode::Srgb => "as stored".to_string(),
        [own] if own.starts_with("gamma ") || own.ends_with(" curve") => format!("{own} undone"),
        _ => "sRGB curve undone".to_string(),
    };
    let why = match (by, decode) {
        (Basis::Files, _) => files,
        (Basis::Stated, _) => format!("as stated; {files}"),
        // Noise is not measured if a file states a curve.
        (Basis::Assumed, Decode::Srgb) if said.is_empty() => {
            "assumed, since neither files nor noise say; --decode none if they are linear".to_string()
        }
        (Basis::Assumed, Decode::Srgb) => {
            "assumed where files do not say; --decode none if they are linear".to_string()
        }
        (Basis::Noise, _) => {
            "linear: the noise grows with brightness as light does; --decode srgb if they are not".to_string()
        }
        (Basis::Assumed, _) => "assumed linear, where files do not say; --decode srgb if they are not".to_string(),
    };
    format!("{reading} ({why})")
}

/// The range of stored values that pictures show, if it is not that from 0 to white.
pub(crate) fn pictures_in_words(report: &Report) -> Option<String> {
    let [black, white] = report.tone.map(|tone| [tone.black, tone.white])?;
    let digits = if white - black > 100.0 { 0 } else { 4 };
    Some(format!(
        "stretched, with fused.png: black is {black:.digits$} and white {white:.digits$} of the stored values"
    ))
}

fn judged(report: &Report) -> Vec<Row> {
    let (time, converged) = (&report.timings_ms, report.converged == Some(true));
    let mut rows = vec![("converged", if converged { "yes" } else { "no" }.to_string())];
    rows.extend(report.warnings.iter().map(|warning| ("warning", warning.clone())));
    rows.push(("time", format!("{:.0} ms, {:.0} ms of it on the device", time.total, time.gpu.unwrap_or(0.0))));
    rows
}

fn near_and_far(report: &Report, palette: Palette) -> String {
    let [near, far] = palette.ends();
    let nearer = report.nearer().number();
    if report.depth.is_some() {
        return format!("mm, {near} near, {far} far; I{nearer} focused nearer by the lens");
    }
    let other = 3 - nearer;
    format!("{near} near, {far} far, I{nearer} taken as focused nearer; --nearer {other} swaps them")
}

fn blur(report: &Report) -> String {
    let range = report.relative_blur.map(|range| (range.min, range.max, range.median));
    let Some((Some(min), Some(max), Some(median))) = range else {
        return "no valid pixel".to_string();
    };
    // Marked pixels are valid ones, and those at the limit are among them.
    let marked = report.texture.map_or(0.0, |texture| texture.marked_fraction);
    let valid = report.valid_fraction.unwrap_or(0.0);
    format!(
        "{} to {} px², median {}; {:.1} % of the pixels measured ({:.1} % valid, {:.1} % at the limit of {} px²)",
        signed(min.into(), 2),
        signed(max.into(), 2),
        signed(median.into(), 2),
        100.0 * (valid - marked),
        100.0 * valid,
        100.0 * valid * report.saturated_fraction.unwrap_or(0.0),
        report.max_relative_blur.unwrap_or(f64::NAN)
    )
}

#[cfg(test)]
mod tests {
    use parfocal::export::{Nearer, Palette, Report};
    use parfocal::{
        Settings, Solution,
        results::Findings,
        settings::{DeviceInfo, Photometric},
        transform::{Shading, Similarity},
    };

    use super::*;

    fn report(blur: [f32; 2]) -> Report {
        let device = DeviceInfo { name: "a device".to_string(), driver: "a driver".to_string(), ..Default::default() };
        let findings = Findings {
            width: 2,
            height: 1,
            photograph: [2, 1],
            transform: Similarity::new(1.25, -0.5, 0.15, 1.01).into(),
            transform_deviation: Some(TransformDeviation { corner_px: 0.0234, direction_deg: 90.0 }),
            photometric: Photometric { gain: 1.02, offset: -0.01 },
            shading: Shading { coefficients: std::array::from_fn(|n| if n == 0 { -0.06 } else { 0.0 }) },
            regularization: 0.00314,
            kernel_shape: Some(1.0),
            separation: Some(9.0),
            scale_deviation: 0.123,
            warnings: vec!["something to know".to_string()],
            valid_fraction: 0.5,
            saturated_fraction: 0.25,
            clipped_fractions: [0.02, 0.0],
            unsettled_fraction: 0.1,
            ..Findings::default()
        };
        let uncertainty = vec![f32::NAN; 2];
        let solution = Solution { relative_blur: blur.to_vec(), uncertainty, findings, ..Solution::default() };
        let mut report = Report::pair(&solution, &Settings::default(), &device, Nearer::First);
        report.files = vec!["depth.png".to_string()];
        report
    }

    #[test]
    fn the_summary_states_the_results_and_their_folder() {
        let text = summary(&report([-1.5, 4.0]), Palette::Viridis, Path::new("out"));
        for part in [
            "a device (a driver)",
            "+1.250 px right",
            "gain 1.0200, offset -0.0100, shading -6 to +6 %",
            "α 0.0031, found",
            "a disk, found; what is in focus in one photograph is 12.0 px wide in the other",
            "-1.50 to +4.00 px²",
            "50.0 %",
            "2.0 % of the pixels of I1, 0.0 % of I2",
            "out: depth.png",
        ] {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
        assert!(text.contains("converged      no\nwarning        something to know"), "{text}");
    }

    #[test]
    fn without_a_valid_pixel_the_summary_states_no_range() {
        let text = summary(&report([f32::NAN; 2]), Palette::Viridis, Path::new("out"));
        assert!(text.contains("no valid pixel") && !text.contains("NaN"), "{text}");
    }
}
