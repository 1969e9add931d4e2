//! `parfocal register` on a device, and `solve` with its result.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

/// A temporary folder with two photographs displaced by (2, -1) px and one of constant grey.
struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        for (name, shift, contrast) in
            [("near.png", [0, 0], 90.0), ("far.png", [2, -1], 90.0), ("grey.png", [0, 0], 0.0)]
        {
            let image = image::GrayImage::from_fn(128, 96, |x, y| {
                // Blobs of several sizes, placed by a hash of their cell.
                let (x, y) = (x as i32 - shift[0] + 64, y as i32 - shift[1] + 64);
                let blob = |size: i32| {
                    let [i, j, k] = [x / size, y / size, size].map(|n| n as u32);
                    let cell = (i * 73_856_093) ^ (j * 19_349_663) ^ (k * 83_492_791);
                    let sign = if cell.wrapping_mul(2_654_435_761) >> 31 == 1 { 1.0 } else { -1.0 };
                    let [u, v] = [x, y].map(|p| (f64::from(p % size) + 0.5) / f64::from(size) - 0.5);
                    sign * (-(u * u + v * v) * 14.0).exp()
                };
                image::Luma([(128.0 + contrast / 2.0 * (blob(9) + blob(16) + blob(27))).clamp(0.0, 255.0) as u8])
            });
            image.save(desk.path(name)).unwrap();
        }
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, command: &str, pair: [&str; 2], extra: &[&str]) -> Output {
        let mut program = Command::cargo_bin("parfocal").unwrap();
        program.env("PARFOCAL_CACHE_DIR", self.path("cache")).arg(command).args(pair.map(|name| self.path(name)));
        program.args(extra).output().unwrap()
    }

    fn json(&self, command: &str, extra: &[&str]) -> Value {
        let output = self.run(command, ["near.png", "far.png"], &[extra, &["--json"]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

fn assert_displaced(report: &Value) {
    for (name, value, tolerance) in
        [("tx_px", 2.0, 0.15), ("ty_px", -1.0, 0.15), ("rotation_deg", 0.0, 0.2), ("scale", 1.0, 0.004)]
    {
        let found = report["frames"][1]["transform"][name].as_f64().unwrap();
        assert!((found - value).abs() < tolerance, "{name} {found}");
    }
}

#[test]
fn every_method_registers_and_solve_holds_its_transform() {
    let desk = Desk::new();
    let (file, out) = (desk.path("made/t.json"), desk.path("out"));
    let (file, out) = (file.to_str().unwrap(), out.to_str().unwrap());
    for method in ["unified", "appearance", "sift"] {
        let report = desk.json("register", &["--method", method, "-o", file]);
        assert_eq!(report["method"], method);
        assert_eq!((&report["size"]["width"], &report["size"]["height"]), (&128.into(), &96.into()));
        assert!(report["frames"][1]["gain"].is_f64() && report["device"]["name"].is_string(), "{report}");
        assert_displaced(&report);
        let written: Value = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
        assert_eq!(written, report);
        let held = desk.json("solve", &["--transform", file, "--hold", "-o", out]);
        assert_eq!(held["method"], "aligned");
        for name in ["tx_px", "ty_px", "rotation_deg", "scale"] {
            let [found, expected] = [&held, &report].map(|r| r["frames"][1]["transform"][name].as_f64().unwrap());
            assert!((found - expected).abs() < 1e-5, "{name} {found} {expected}");
        }
        let gains = [&held, &report].map(|r| r["frames"][1]["gain"].as_f64().unwrap());
        assert!((gains[0] - gains[1]).abs() < 1e-6, "{gains:?}");
    }
    assert_eq!(fs::read_dir(desk.path("made")).unwrap().count(), 1);
}

#[test]
fn solve_accepts_all_four_methods() {
    let desk = Desk::new();
    let out = desk.path("out");
    for method in ["appearance", "sift"] {
        let report = desk.json("solve", &["--method", method, "-o", out.to_str().unwrap()]);
        assert_eq!(report["method"], method);
        assert_displaced(&report);
    }
}

#[test]
fn without_json_the_registration_is_printed_to_stderr() {
    let desk = Desk::new();
    let output = desk.run("register", ["near.png", "far.png"], &["--method", "appearance"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && output.stdout.is_empty(), "{stderr}");
    for part in ["appearance", "px right", "gain", "converged"] {
        assert!(stderr.contains(part), "{part} is missing in {stderr}");
    }
}

#[track_caller]
fn refused(output: &Output, status: i32, parts: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{stderr}");
    assert!(output.stdout.is_empty() && parts.iter().all(|part| stderr.contains(part)), "{stderr}");
}

#[test]
fn too_few_key_points_give_a_one_line_error_and_no_files() {
    let desk = Desk::new();
    let out = desk.path("out");
    let out = out.to_str().unwrap();
    for command in ["register", "solve"] {
        let output = desk.run(command, ["near.png", "grey.png"], &["--method", "sift", "-o", out]);
        refused(&output, 1, &["0 key-points in I2", "unified or appearance"]);
        // A slow machine may print progress before the error.
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(stderr.lines().filter(|line| line.contains("key-points")).count(), 1, "{stderr}");
        assert!(stderr.lines().last().is_some_and(|line| line.contains("key-points")), "{stderr}");
        assert!(!desk.path("out").exists());
    }
}

#[test]
fn invalid_outputs_and_options_are_refused_before_any_work() {
    let desk = Desk::new();
    let [near, folder] = [desk.path("near.png"), desk.path("")].map(|p| p.to_str().unwrap().to_string());
    let pair = ["near.png", "far.png"];
    let before = fs::read(&near).unwrap();
    refused(&desk.run("register", pair, &["-o", &near]), 1, &["near.png", "is an input"]);
    refused(&desk.run("register", pair, &["-o", &folder]), 1, &["is a folder"]);
    refused(&desk.run("register", pair, &["--method", "aligned"]), 2, &["--method"]);
    refused(&desk.run("register", ["near.png", "none.png"], &[]), 1, &["none.png"]);
    assert_eq!(fs::read(near).unwrap(), before);
}
