//! `parfocal register` on a device, and `solve` with its result.

use std::fs;
use std::process::Output;

use serde_json::Value;

use crate::desk::{Desk, assert_refused, stderr_of};

/// Returns a folder with two photographs displaced by (2, -1) px and one of constant grey.
fn desk() -> Desk {
    let desk = Desk::new();
    for (name, shift, contrast) in [("near.png", [0, 0], 90.0), ("far.png", [2, -1], 90.0), ("grey.png", [0, 0], 0.0)] {
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

fn solve_or_register(desk: &Desk, command: &str, extra: &[&str]) -> Value {
    desk.printed(&[&[command, "near.png", "far.png"], extra].concat())
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
    let desk = desk().on_vulkan();
    let (file, out) = ("made/t.json", "out");
    for method in ["unified", "appearance", "sift"] {
        let report = solve_or_register(&desk, "register", &["--method", method, "-o", file]);
        assert_eq!(report["method"], method);
        assert_eq!((&report["size"]["width"], &report["size"]["height"]), (&128.into(), &96.into()));
        assert!(report["frames"][1]["gain"].is_f64() && report["device"]["name"].is_string(), "{report}");
        assert_displaced(&report);
        assert_eq!(desk.json(file), report);
        let held = solve_or_register(&desk, "solve", &["--transform", file, "--hold", "-o", out]);
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
    let desk = desk();
    for method in ["appearance", "sift"] {
        let report = solve_or_register(&desk, "solve", &["--method", method, "-o", "out"]);
        assert_eq!(report["method"], method);
        assert_displaced(&report);
    }
}

#[test]
fn without_json_the_registration_is_printed_to_stderr() {
    let desk = desk();
    let output = desk.run(&["register", "near.png", "far.png", "--method", "appearance"]);
    let stderr = stderr_of(&output);
    assert!(output.status.success() && output.stdout.is_empty(), "{stderr}");
    for part in ["appearance", "px right", "gain", "converged"] {
        assert!(stderr.contains(part), "{part} is missing in {stderr}");
    }
}

#[track_caller]
fn refuses(desk: &Desk, arguments: &[&str], status: i32, parts: &[&str]) -> Output {
    let output = desk.run(arguments);
    assert_refused(&output, status, parts);
    assert!(output.stdout.is_empty());
    output
}

#[test]
fn too_few_key_points_give_a_one_line_error_and_no_files() {
    let desk = desk();
    for command in ["register", "solve"] {
        let arguments = [command, "near.png", "grey.png", "--method", "sift", "-o", "out"];
        let output = refuses(&desk, &arguments, 1, &["0 key-points in I2", "unified or appearance"]);
        // A slow machine may print progress before the error.
        let stderr = stderr_of(&output);
        assert_eq!(stderr.lines().filter(|line| line.contains("key-points")).count(), 1, "{stderr}");
        assert!(stderr.lines().last().is_some_and(|line| line.contains("key-points")), "{stderr}");
        assert!(!desk.has("out"));
    }
}

#[test]
fn invalid_outputs_and_options_are_refused_before_any_work() {
    let desk = desk();
    let pair = ["register", "near.png", "far.png"];
    let before = desk.bytes("near.png");
    refuses(&desk, &[&pair[..], &["-o", "near.png"]].concat(), 1, &["near.png", "is an input"]);
    refuses(&desk, &[&pair[..], &["-o", "."]].concat(), 1, &["is a folder"]);
    refuses(&desk, &[&pair[..], &["--method", "aligned"]].concat(), 2, &["--method"]);
    refuses(&desk, &["register", "near.png", "none.png"], 1, &["none.png"]);
    assert_eq!(desk.bytes("near.png"), before);
}
