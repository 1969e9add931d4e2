//! Masks, regions and flat references in `solve`, and later commands on the results of a region.

use std::process::Output;

use image::{GrayImage, Luma};
use parfocal::image_io::read_field;
use serde_json::Value;

use crate::desk::{Desk, stderr_of};

const SIZE: (u32, u32) = (240, 200);

/// Returns a folder with a simulated pair of 240x200 px.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.done(&["simulate", "plane", "--size", "240x200", "-o", "pair", "--seed", "3"]);
    desk
}

fn solve(desk: &Desk, out: &str, extra: &[&str]) -> Output {
    let own = ["solve", "pair/i1.png", "pair/i2.png", "-o", out, "--max-relative-blur", "16", "--no-html"];
    desk.run(&[&own[..], extra].concat())
}

#[track_caller]
fn solved(desk: &Desk, out: &str, extra: &[&str]) -> Value {
    let output = solve(desk, out, extra);
    assert!(output.status.success(), "{extra:?}: {}", stderr_of(&output));
    desk.report(out)
}

fn field(desk: &Desk, name: &str) -> (u32, u32, Vec<f32>) {
    read_field(&desk.path(name)).unwrap()
}

#[test]
fn results_of_a_region_match_those_of_the_whole_images() {
    let desk = desk();
    let whole = solved(&desk, "whole", &[]);
    let part = solved(&desk, "part", &["--roi", "60,50,120,90", "--export", "labels,depth16"]);
    assert_eq!(part["region"], serde_json::json!({ "x": 60, "y": 50, "width": 120, "height": 90 }));
    assert_eq!(part["photograph"], serde_json::json!({ "width": 240, "height": 200 }));
    let (width, height, v) = field(&desk, "part/relative_blur.exr");
    assert_eq!((width, height), (120, 90));
    let (_, _, all) = field(&desk, "whole/relative_blur.exr");
    let apart = (0..90)
        .flat_map(|y| (0..120).map(move |x| (x, y)))
        .map(|(x, y)| f64::from(v[y * 120 + x]) - f64::from(all[(y + 50) * SIZE.0 as usize + x + 60]));
    let squares: Vec<f64> = apart.map(|d| d * d).filter(|d| !d.is_nan()).collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!(rms < 0.1 && squares.len() > 9000, "V {rms} px² apart, {} valid", squares.len());
    for name in ["tx_px", "ty_px"] {
        let [a, b] = [&whole, &part].map(|report| report["frames"][1]["transform"][name].as_f64().unwrap());
        assert!((a - b).abs() < 0.05, "{name}: {a} {b}");
    }
    // `apply` moves a photograph onto the pixels of the region.
    desk.done(&["apply", "pair/i2.png", "--transform", "part/report.json", "-o", "moved"]);
    let moved = parfocal::image_io::read(&desk.path("moved/i2.png")).unwrap();
    assert_eq!((moved.width(), moved.height()), (120, 90));
    // The report of the region can initialize a solve of the whole images.
    let held = solved(&desk, "held", &["--transform", "part/report.json", "--hold"]);
    for name in ["tx_px", "ty_px", "rotation_deg", "scale"] {
        let [a, b] = [&held, &part].map(|report| report["frames"][1]["transform"][name].as_f64().unwrap());
        assert!((a - b).abs() < 1e-4, "{name}: {a} {b}");
    }
}

#[test]
fn masked_and_cropped_pixels_are_absent_from_the_results() {
    let desk = desk();
    GrayImage::from_fn(SIZE.0, SIZE.1, |x, _| Luma([if x < 80 { 0 } else { 255 }]))
        .save(desk.path("mask.png"))
        .unwrap();
    solved(&desk, "masked", &["--mask", "mask.png"]);
    let (_, _, v) = field(&desk, "masked/relative_blur.exr");
    assert!(v.chunks_exact(SIZE.0 as usize).all(|row| row[..80].iter().all(|v| v.is_nan())));
    assert!(v[100 * SIZE.0 as usize + 150].is_finite());
    let valid = image::open(desk.path("masked/valid.png")).unwrap().into_luma8();
    assert_eq!((valid.get_pixel(40, 100)[0], valid.get_pixel(150, 100)[0]), (0, 255));
    let cropped = solved(&desk, "cropped", &["--crop-valid"]);
    assert_eq!(cropped["valid_fraction"], 1.0);
    let (width, height, v) = field(&desk, "cropped/relative_blur.exr");
    assert!(v.iter().all(|v| v.is_finite()) && width > 200 && height > 160, "{width}x{height}");
    let (_, _, residual) = field(&desk, "cropped/residual.exr");
    assert!(residual.iter().all(|r| (0.0..0.05).contains(r)));
}

#[test]
fn untextured_pixels_are_marked() {
    let desk = desk();
    let report = solved(&desk, "all", &["--max-uncertainty", "1e-6", "--export", "depth16"]);
    assert!(report["texture"]["marked_fraction"].as_f64().unwrap() > 0.5);
    let valid = image::open(desk.path("all/valid.png")).unwrap().into_luma8();
    assert!(valid.pixels().all(|p| p[0] == 0), "no deviation may be below so small a limit");
    // A lens given later must not turn marked pixels into measurements.
    let lens = "--focal-length 50 --f-number 4 --pixel-pitch 0.0075 --focus 300,310 --telecentric";
    desk.done(&[&["depth", "all"][..], &lens.split(' ').collect::<Vec<_>>()].concat());
    let depth16 = image::open(desk.path("all/depth16.png")).unwrap().into_luma16();
    assert!(depth16.pixels().all(|p| p[0] == 0));
    let report = solved(&desk, "none", &[]);
    assert!(report["texture"]["marked_fraction"].as_f64().unwrap() < 0.05);
}

#[test]
fn a_flat_reference_is_subtracted() {
    let desk = desk();
    solved(&desk, "flat", &[]);
    solved(&desk, "flattened", &["--flat", "flat", "--crop-valid"]);
    let (_, _, v) = field(&desk, "flattened/relative_blur.exr");
    assert!(v.iter().all(|v| v.abs() < 0.5), "a plane minus itself must be flat");
}

#[test]
fn unsuitable_masks_regions_and_references_are_refused() {
    let desk = desk();
    GrayImage::new(30, 20).save(desk.path("small.png")).unwrap();
    let refused = |extra: &[&str], status: i32| {
        let output = solve(&desk, "out", extra);
        assert_eq!(output.status.code(), Some(status), "{extra:?}");
        assert!(!desk.has("out/report.json"));
        stderr_of(&output)
    };
    let message = refused(&["--mask", "small.png"], 1);
    assert!(message.contains("small.png") && message.contains("30x20") && message.contains("240x200"), "{message}");
    let message = refused(&["--roi", "200,0,100,50"], 2);
    assert!(message.contains("--roi") && message.contains("200,0,100,50"), "{message}");
    let message = refused(&["--flat", "nowhere"], 1);
    assert!(message.contains("nowhere"), "{message}");
    let output = solve(&desk, "out", &["--crop-valid", "--profile", "0,10,100,10"]);
    assert_eq!(output.status.code(), Some(2), "a profile must be refused, because cropping moves its pixels");
    solved(&desk, "part", &["--roi", "60,50,120,90"]);
    let lens = "--focal-length 50 --f-number 4 --pixel-pitch 0.0075 --focus 300,310 --telecentric --plane 300,305,300";
    desk.refuses(&[&["calibrate", "part"][..], &lens.split(' ').collect::<Vec<_>>()].concat(), 1, &["--roi"]);
    let output = solve(&desk, "out", &["--roi", "1,2,3"]);
    assert_eq!(output.status.code(), Some(2));
}
