//! Shading: `solve` estimates it, and later commands apply it.

use image::{ImageBuffer, Luma};
use parfocal::image_io::read_field;
use parfocal::transform::{Homography, Similarity};
use serde_json::Value;

use crate::desk::{Desk, stderr_of};

/// Returns a folder with the slanted plane, 256x256. I2 is 15 % darker at its left border, 15 % brighter at its right.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.done(&["simulate", "plane", "--noise", "0.003", "-o", "pair", "--quiet"]);
    let i2 = image::open(desk.path("pair/i2.png")).unwrap().into_luma16();
    let ramp = |x: u32| 1.0 + 0.15 * (f64::from(x) / 127.5 - 1.0);
    let shaded = ImageBuffer::from_fn(256, 256, |x, y| Luma([(ramp(x) * f64::from(i2[(x, y)][0])) as u16]));
    shaded.save(desk.path("pair/shaded.png")).unwrap();
    desk
}

/// Returns the report and the summary.
#[track_caller]
fn solved(desk: &Desk, i2: &str, out: &str, extra: &[&str]) -> (Value, String) {
    let output = desk.done(&[&["solve", "pair/i1.png", i2, "-o", out, "--no-html"], extra].concat());
    (desk.report(out), stderr_of(&output))
}

/// The smallest and largest shading factor of a report.
fn range(report: &Value) -> [f64; 2] {
    [0, 1].map(|i| report["frames"][1]["shading"]["range"][i].as_f64().unwrap())
}

#[test]
fn a_shading_ramp_is_estimated_and_reported() {
    let desk = desk();
    let (report, stderr) = solved(&desk, "pair/shaded.png", "out", &[]);
    let [low, high] = range(&report);
    // The factors must invert the ramp from 0.85 to 1.15.
    assert!((low - 1.0 / 1.15).abs() < 0.03 && (high - 1.0 / 0.85).abs() < 0.03, "{low} to {high}");
    assert!(stderr.contains(", shading -1") && stderr.contains("smoothness     α 0.0"), "{stderr}");
    assert_eq!(report["warnings"], serde_json::json!([]));
    let t = &report["frames"][1]["transform"];
    let [tx, ty, angle, scale] = ["tx_px", "ty_px", "rotation_deg", "scale"].map(|name| t[name].as_f64().unwrap());
    let truth = Homography::from(Similarity::new(1.3, -0.9, 0.15, 1.01));
    let corner = Homography::from(Similarity::new(tx, ty, angle, scale)).corner_distance(truth, 256, 256);
    let [v, truth] = ["out", "pair"].map(|folder| read_field(&desk.path(folder).join("relative_blur.exr")).unwrap().2);
    let apart = v.iter().zip(&truth).map(|(v, t)| f64::from(v - t)).filter(|d| !d.is_nan());
    let squares: Vec<f64> = apart.map(|d| d * d).collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    println!("corner {corner:.4} px, V rms {rms:.4} px², shading {low:.3} to {high:.3}");
    assert!(corner <= 0.02 && rms <= 0.12 && squares.len() > 50_000, "{corner} {rms} {}", squares.len());
}

#[test]
fn uniform_light_is_not_reported_as_shading() {
    let desk = desk();
    let (report, stderr) = solved(&desk, "pair/i2.png", "even", &["--regularization", "0.004"]);
    let [low, high] = range(&report);
    assert!(low > 0.99 && high < 1.01, "{low} to {high}");
    assert!(!stderr.contains("shading") && stderr.contains("smoothness     α 0.004, as stated"), "{stderr}");
    assert_eq!(report["regularization"].as_f64().map(|alpha| alpha as f32), Some(0.004));
}

#[test]
fn apply_and_hold_use_the_shading_of_a_report() {
    let desk = desk();
    let (report, _) = solved(&desk, "pair/shaded.png", "out", &[]);
    let moved = |out: &str, extra: &[&str]| {
        let apply = ["apply", "pair/shaded.png", "--transform", "out/report.json", "-o", out];
        desk.done(&[&apply[..], extra].concat());
        image::open(desk.path(out).join("shaded.png")).unwrap().into_luma16()
    };
    let (lit, plain) = (moved("lit", &["--exposure"]), moved("plain", &[]));
    // Blur does not change the mean over a stripe.
    let i1 = image::open(desk.path("pair/i1.png")).unwrap().into_luma16();
    let mean = |image: &ImageBuffer<Luma<u16>, Vec<u16>>, from: u32| {
        let stripe = (20..236).flat_map(|y| (from..from + 40).map(move |x| (x, y)));
        stripe.map(|place| f64::from(image[place][0])).sum::<f64>()
    };
    for from in [12, 204] {
        let [lit, plain] = [&lit, &plain].map(|image| mean(image, from) / mean(&i1, from) - 1.0);
        assert!(lit.abs() < 0.01 && plain.abs() > 0.08, "{from}: {lit} {plain}");
    }
    // Only T is held. Gain, offset and shading are estimated again.
    let (held, _) = solved(&desk, "pair/shaded.png", "held", &["--transform", "out/report.json", "--hold"]);
    let apart = [0, 1].map(|i| (range(&held)[i] - range(&report)[i]).abs());
    assert!(apart.iter().all(|d| *d < 0.01), "{apart:?}");
    assert_eq!(
        held["frames"][1]["transform"]["tx_px"].as_f64().map(|t| t as f32),
        report["frames"][1]["transform"]["tx_px"].as_f64().map(|t| t as f32)
    );
}
