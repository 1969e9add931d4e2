//! `parfocal stack`, from outside: a sweep over scenes whose focus is known.

mod common;

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use parfocal::image_io::read_field;
use serde_json::Value;

/// A sweep over two planes, of which the left is in focus at setting 1 and the right at 2.6: variance 2 (p - u)² px².
struct Sweep {
    folder: tempfile::TempDir,
    files: Vec<PathBuf>,
}

const SIZE: [u32; 2] = [192, 128];
const RATE: f64 = 2.0;

fn focus_at(x: u32) -> f64 {
    if x < SIZE[0] / 2 { 1.0 } else { 2.6 }
}

impl Sweep {
    fn new(frames: u32) -> Self {
        let folder = tempfile::TempDir::new().unwrap();
        let files = (0..frames).map(|n| folder.path().join(format!("frame_{n}.png"))).collect::<Vec<_>>();
        for (n, file) in files.iter().enumerate() {
            // Waves of many directions, blurred in closed form: exp(-v k²/2).
            let value = |x: u32, y: u32| {
                let v = RATE * (n as f64 - focus_at(x)).powi(2) + 0.3;
                let waves = (0..40).map(|i| {
                    let (angle, k) = (f64::from(i) * 2.399, 0.25 + 0.035 * f64::from(i));
                    let phase = k * (f64::from(x) * angle.cos() + f64::from(y) * angle.sin()) + f64::from(i * i);
                    (-v * k * k / 2.0).exp() * phase.sin()
                });
                0.5 + 0.05 * waves.sum::<f64>()
            };
            let image = image::ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
                image::Luma([(value(x, y).clamp(0.0, 1.0) * 65535.0).round() as u16])
            });
            image.save(file).unwrap();
        }
        Self { folder, files }
    }

    fn stack(&self, extra: &[&str]) -> Output {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        command.arg("stack").args(&self.files).arg("-o").arg(self.out()).args(extra);
        command.env("PARFOCAL_VALIDATE", "1").output().unwrap()
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }
}

#[test]
fn a_sweep_gives_the_focus_of_both_planes() {
    let sweep = Sweep::new(5);
    let output = sweep.stack(&["--json", "--reference", "3"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rate = report["blur_rate_px2"].as_f64().unwrap();
    assert!((rate / RATE - 1.0).abs() < 0.1, "{rate}");
    assert_eq!((&report["reference"], report["frames"].as_array().unwrap().len()), (&2.into(), 5));
    let (width, height, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    let (_, _, uncertainty) = read_field(&sweep.out().join("uncertainty.exr")).unwrap();
    for (from, to) in [(20, 76), (116, 172)] {
        let mut found: Vec<f32> = (20..height - 20)
            .flat_map(|y| (from..to).map(move |x| (y * width + x) as usize))
            .map(|i| focus[i])
            .collect();
        found.sort_by(f32::total_cmp);
        let median = f64::from(found[found.len() / 2]);
        assert!((median - focus_at(from)).abs() < 0.1, "{median} at {from}");
    }
    assert!(uncertainty.iter().all(|s| s.is_nan() || *s > 0.0));
    for file in ["depth.png", "fused.png", "report.json"] {
        assert!(fs::metadata(sweep.out().join(file)).unwrap().len() > 0);
    }
}

#[test]
fn what_is_no_sweep_is_refused_in_plain_words() {
    let sweep = Sweep::new(3);
    let refused = |extra: &[&str], words: &[&str]| {
        let output = sweep.stack(extra);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && !sweep.out().exists(), "{told}");
        assert!(words.iter().all(|word| told.contains(word)), "{told}");
    };
    refused(&["--positions", "0,1"], &["2 positions for 3 frames"]);
    refused(&["--positions", "0,2,1"], &["ascending"]);
    refused(&["--reference", "4"], &["--reference 4", "3 frames"]);
}
