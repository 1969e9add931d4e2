//! Masks, regions and flat references in `solve`, and later commands on the results of a region.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use image::{GrayImage, Luma};
use parfocal::image_io::read_field;
use serde_json::Value;
use tempfile::TempDir;

const SIZE: (u32, u32) = (240, 200);

struct Desk(TempDir);

impl Desk {
    /// Simulates a pair of 240x200 px.
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        let output = desk.run(&["simulate", "plane", "--size", "240x200", "-o", "pair", "--seed", "3"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::cargo_bin("parfocal").unwrap().current_dir(self.0.path()).args(arguments).output().unwrap()
    }

    fn photographs(&self) -> [String; 2] {
        ["i1", "i2"].map(|stem| {
            let found = fs::read_dir(self.path("pair")).unwrap().map(|entry| entry.unwrap().path());
            let mut found = found.filter(|path| path.file_stem().is_some_and(|s| s == stem));
            found.next().unwrap().display().to_string()
        })
    }

    fn solve(&self, out: &str, extra: &[&str]) -> Output {
        let [i1, i2] = self.photographs();
        let all = [&["solve", &i1, &i2, "-o", out, "--max-relative-blur", "16", "--no-html"], extra].concat();
        self.run(&all)
    }

    fn solved(&self, out: &str, extra: &[&str]) -> Value {
        let output = self.solve(out, extra);
        assert!(output.status.success(), "{extra:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_str(&fs::read_to_string(self.path(out).join("report.json")).unwrap()).unwrap()
    }

    fn field(&self, name: &str) -> (u32, u32, Vec<f32>) {
        read_field(&self.path(name)).unwrap()
    }
}

#[test]
fn results_of_a_region_match_those_of_the_whole_images() {
    let desk = Desk::new();
    let whole = desk.solved("whole", &[]);
    let part = desk.solved("part", &["--roi", "60,50,120,90", "--export", "labels,depth16"]);
    assert_eq!(part["region"], serde_json::json!({ "x": 60, "y": 50, "width": 120, "height": 90 }));
    assert_eq!(part["photograph"], serde_json::json!({ "width": 240, "height": 200 }));
    let (width, height, v) = desk.field("part/relative_blur.exr");
    assert_eq!((width, height), (120, 90));
    let (_, _, all) = desk.field("whole/relative_blur.exr");
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
    let [_, i2] = desk.photographs();
    let output = desk.run(&["apply", &i2, "--transform", "part/report.json", "-o", "moved"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let moved = fs::read_dir(desk.path("moved")).unwrap().next().unwrap().unwrap().path();
    let moved = parfocal::image_io::read(&moved).unwrap();
    assert_eq!((moved.width(), moved.height()), (120, 90));
    // The report of the region can initialize a solve of the whole images.
    let held = desk.solved("held", &["--transform", "part/report.json", "--hold"]);
    for name in ["tx_px", "ty_px", "rotation_deg", "scale"] {
        let [a, b] = [&held, &part].map(|report| report["frames"][1]["transform"][name].as_f64().unwrap());
        assert!((a - b).abs() < 1e-4, "{name}: {a} {b}");
    }
}

#[test]
fn masked_and_cropped_pixels_are_absent_from_the_results() {
    let desk = Desk::new();
    GrayImage::from_fn(SIZE.0, SIZE.1, |x, _| Luma([if x < 80 { 0 } else { 255 }]))
        .save(desk.path("mask.png"))
        .unwrap();
    desk.solved("masked", &["--mask", "mask.png"]);
    let (_, _, v) = desk.field("masked/relative_blur.exr");
    assert!(v.chunks_exact(SIZE.0 as usize).all(|row| row[..80].iter().all(|v| v.is_nan())));
    assert!(v[100 * SIZE.0 as usize + 150].is_finite());
    let valid = image::open(desk.path("masked/valid.png")).unwrap().into_luma8();
    assert_eq!((valid.get_pixel(40, 100)[0], valid.get_pixel(150, 100)[0]), (0, 255));
    let cropped = desk.solved("cropped", &["--crop-valid"]);
    assert_eq!(cropped["valid_fraction"], 1.0);
    let (width, height, v) = desk.field("cropped/relative_blur.exr");
    assert!(v.iter().all(|v| v.is_finite()) && width > 200 && height > 160, "{width}x{height}");
    let (_, _, residual) = desk.field("cropped/residual.exr");
    assert!(residual.iter().all(|r| (0.0..0.05).contains(r)));
}

#[test]
fn untextured_pixels_are_marked() {
    let desk = Desk::new();
    let report = desk.solved("all", &["--max-uncertainty", "1e-6", "--export", "depth16"]);
    assert!(report["texture"]["marked_fraction"].as_f64().unwrap() > 0.5);
    let valid = image::open(desk.path("all/valid.png")).unwrap().into_luma8();
    assert!(valid.pixels().all(|p| p[0] == 0), "no deviation may be below so small a limit");
    // A lens given later must not turn marked pixels into measurements.
    let lens = "--focal-length 50 --f-number 4 --pixel-pitch 0.0075 --focus 300,310 --telecentric";
    let output = desk.run(&[&["depth", "all"][..], &lens.split(' ').collect::<Vec<_>>()].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let depth16 = image::open(desk.path("all/depth16.png")).unwrap().into_luma16();
    assert!(depth16.pixels().all(|p| p[0] == 0));
    let report = desk.solved("none", &[]);
    assert!(report["texture"]["marked_fraction"].as_f64().unwrap() < 0.05);
}

#[test]
fn a_flat_reference_is_subtracted() {
    let desk = Desk::new();
    desk.solved("flat", &[]);
    desk.solved("flattened", &["--flat", "flat", "--crop-valid"]);
    let (_, _, v) = desk.field("flattened/relative_blur.exr");
    assert!(v.iter().all(|v| v.abs() < 0.5), "a plane minus itself must be flat");
}

#[test]
fn unsuitable_masks_regions_and_references_are_refused() {
    let desk = Desk::new();
    GrayImage::new(30, 20).save(desk.path("small.png")).unwrap();
    let refused = |extra: &[&str], status: i32| {
        let output = desk.solve("out", extra);
        assert_eq!(output.status.code(), Some(status), "{extra:?}");
        assert!(!desk.path("out").join("report.json").exists());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let message = refused(&["--mask", "small.png"], 1);
    assert!(message.contains("small.png") && message.contains("30x20") && message.contains("240x200"), "{message}");
    let message = refused(&["--roi", "200,0,100,50"], 2);
    assert!(message.contains("--roi") && message.contains("200,0,100,50"), "{message}");
    let message = refused(&["--flat", "nowhere"], 1);
    assert!(message.contains("nowhere"), "{message}");
    let output = desk.solve("out", &["--crop-valid", "--profile", "0,10,100,10"]);
    assert_eq!(output.status.code(), Some(2), "a profile must be refused, because cropping moves its pixels");
    desk.solved("part", &["--roi", "60,50,120,90"]);
    let lens = "--focal-length 50 --f-number 4 --pixel-pitch 0.0075 --focus 300,310 --telecentric --plane 300,305,300";
    let output = desk.run(&[&["calibrate", "part"][..], &lens.split(' ').collect::<Vec<_>>()].concat());
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && message.contains("--roi"), "{message}");
    let output = desk.solve("out", &["--roi", "1,2,3"]);
    assert_eq!(output.status.code(), Some(2));
}
