//! Shading: `solve` estimates it, and later commands apply it.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use image::{ImageBuffer, Luma};
use parfocal::image_io::read_field;
use parfocal::transform::{Homography, Similarity};
use serde_json::Value;
use tempfile::TempDir;

struct Desk(TempDir);

impl Desk {
    /// Simulates the slanted plane, 256x256. I2 is 15 % darker at its left border and 15 % brighter at its right.
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        desk.run(&["simulate", "plane", "--noise", "0.003", "-o", "pair", "--quiet"]);
        let i2 = image::open(desk.path("pair/i2.png")).unwrap().into_luma16();
        let ramp = |x: u32| 1.0 + 0.15 * (f64::from(x) / 127.5 - 1.0);
        let shaded = ImageBuffer::from_fn(256, 256, |x, y| Luma([(ramp(x) * f64::from(i2[(x, y)][0])) as u16]));
        shaded.save(desk.path("pair/shaded.png")).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        let output = command.current_dir(self.0.path()).args(arguments).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        output
    }

    fn solved(&self, i2: &str, out: &str, extra: &[&str]) -> (Value, String) {
        let output = self.run(&[&["solve", "pair/i1.png", i2, "-o", out, "--no-html"], extra].concat());
        (self.report(out), String::from_utf8(output.stderr).unwrap())
    }

    fn report(&self, out: &str) -> Value {
        serde_json::from_str(&fs::read_to_string(self.path(out).join("report.json")).unwrap()).unwrap()
    }
}

/// The smallest and largest shading factor of a report.
fn range(report: &Value) -> [f64; 2] {
    [0, 1].map(|i| report["frames"][1]["shading"]["range"][i].as_f64().unwrap())
}

#[test]
fn a_shading_ramp_is_estimated_and_reported() {
    let desk = Desk::new();
    let (report, stderr) = desk.solved("pair/shaded.png", "out", &[]);
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
    let desk = Desk::new();
    let (report, stderr) = desk.solved("pair/i2.png", "even", &["--regularization", "0.004"]);
    let [low, high] = range(&report);
    assert!(low > 0.99 && high < 1.01, "{low} to {high}");
    assert!(!stderr.contains("shading") && stderr.contains("smoothness     α 0.004, as stated"), "{stderr}");
    assert_eq!(report["regularization"].as_f64().map(|alpha| alpha as f32), Some(0.004));
}

#[test]
fn apply_and_hold_use_the_shading_of_a_report() {
    let desk = Desk::new();
    let (report, _) = desk.solved("pair/shaded.png", "out", &[]);
    let moved = |out: &str, extra: &[&str]| {
        let apply = ["apply", "pair/shaded.png", "--transform", "out/report.json", "-o", out];
        desk.run(&[&apply[..], extra].concat());
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
    let (held, _) = desk.solved("pair/shaded.png", "held", &["--transform", "out/report.json", "--hold"]);
    let apart = [0, 1].map(|i| (range(&held)[i] - range(&report)[i]).abs());
    assert!(apart.iter().all(|d| *d < 0.01), "{apart:?}");
    assert_eq!(
        held["frames"][1]["transform"]["tx_px"].as_f64().map(|t| t as f32),
        report["frames"][1]["transform"]["tx_px"].as_f64().map(|t| t as f32)
    );
}
