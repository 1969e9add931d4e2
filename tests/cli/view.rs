//! `parfocal view`: its pictures, and its errors for missing or damaged files. No test needs a device.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use image::{ImageBuffer, Luma, RgbImage};
use tempfile::TempDir;

/// A results folder with the files that `view` reads: a step from far (left) to near (right), with a hole.
struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        fs::create_dir(desk.path("out")).unwrap();
        let blur = |x: usize, y: usize| match (x, y) {
            (20..30, 20..30) => f32::NAN,
            (0..48, _) => -4.0,
            _ => 6.0,
        };
        desk.field("relative_blur.exr", (96, 64), blur);
        desk.field("uncertainty.exr", (96, 64), |_, _| 0.5);
        RgbImage::from_pixel(96, 64, image::Rgb([90, 140, 60])).save(desk.path("out/fused.png")).unwrap();
        fs::write(desk.path("out/report.json"), crate::report_of_pair([96, 64], 1).to_string()).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn field(&self, name: &str, size: (usize, usize), value: impl Fn(usize, usize) -> f32 + Sync) {
        crate::write_field(&self.path("out").join(name), size, value);
    }

    fn view(&self, extra: &[&str]) -> Output {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        command.current_dir(self.0.path()).args(["view", "out", "--width", "150", "--turntable-width", "80"]);
        command.args(extra).output().unwrap()
    }

    fn viewed(&self, extra: &[&str]) {
        let output = self.view(extra);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn the_picture_has_both_panels_and_is_reproducible() {
    let desk = Desk::new();
    let from_above = ["--elevation", "90", "--azimuth", "0"];
    desk.viewed(&from_above);
    let at = |x: u32| {
        let picture = image::open(desk.path("out/view.png")).unwrap().into_rgb8();
        picture.get_pixel(x, picture.height() / 2 + 30).0
    };
    // The textured panel is green. The other has the colours of depth.png: purple at the left (far), yellow at right.
    assert!(at(40)[1] > at(40)[0] && at(40)[1] > at(40)[2], "{:?}", at(40));
    assert!(at(180)[2] > at(180)[1] && at(180)[1] < 60, "{:?}", at(180));
    assert!(at(260)[0] > 150 && at(260)[1] > 150 && at(260)[2] < 80, "{:?}", at(260));
    let first = fs::read(desk.path("out/view.png")).unwrap();
    desk.viewed(&[&from_above[..], &["-o", "deep/other.png"]].concat());
    assert_eq!(first, fs::read(desk.path("deep/other.png")).unwrap());
    // The colour map of the paper: blue and red.
    desk.viewed(&[&from_above[..], &["--colors", "red-blue"]].concat());
    assert!(at(180)[2] > 150 && at(180)[0] < 120, "{:?}", at(180));
    assert!(at(260)[0] > 150 && at(260)[2] < 80, "{:?}", at(260));
}

#[test]
fn the_turntable_is_an_animation_of_both_panels() {
    let desk = Desk::new();
    desk.viewed(&["--turntable", "turn.gif"]);
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(fs::File::open(desk.path("turn.gif")).unwrap()).unwrap();
    assert_eq!((decoder.width(), decoder.repeat()), (160, gif::Repeat::Infinite));
    let mut frames: Vec<Vec<u8>> = Vec::new();
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        frames.push(frame.buffer.to_vec());
    }
    assert_eq!(frames.len(), 48);
    // The view turns there and back.
    assert!(frames[1] == frames[47] && frames[0] != frames[24]);
}

#[test]
fn results_without_a_valid_pixel_give_an_empty_picture() {
    let desk = Desk::new();
    desk.field("relative_blur.exr", (96, 64), |_, _| f32::NAN);
    desk.viewed(&["--turntable", "turn.gif"]);
    assert!(desk.path("out/view.png").is_file() && desk.path("turn.gif").is_file());
}

#[track_caller]
fn refused(output: &Output, status: i32, parts: &[&str]) {
    crate::assert_refused(output, status, parts);
    assert_eq!(String::from_utf8_lossy(&output.stderr).lines().count(), 1);
}

#[test]
fn a_missing_or_damaged_file_is_named() {
    for name in ["relative_blur.exr", "uncertainty.exr", "fused.png", "report.json"] {
        let desk = Desk::new();
        fs::remove_file(desk.path("out").join(name)).unwrap();
        refused(&desk.view(&[]), 1, &[name]);
        fs::write(desk.path("out").join(name), "odd").unwrap();
        refused(&desk.view(&[]), 1, &[name]);
        assert!(!desk.path("out/view.png").exists());
    }
    let desk = Desk::new();
    desk.field("uncertainty.exr", (95, 64), |_, _| 0.5);
    refused(&desk.view(&[]), 1, &["uncertainty.exr", "95x64", "96x64"]);
    let desk = Desk::new();
    ImageBuffer::<Luma<u16>, _>::new(96, 63).save(desk.path("out/fused.png")).unwrap();
    refused(&desk.view(&[]), 1, &["fused.png", "96x63"]);
    fs::write(
        desk.path("out/report.json"),
        crate::report_of_pair([96, 64], 1).to_string().replace("\"nearer\":1", "\"nearer\":3"),
    )
    .unwrap();
    refused(&desk.view(&[]), 1, &["report.json", "nearer"]);
    fs::remove_dir_all(desk.path("out")).unwrap();
    refused(&desk.view(&[]), 1, &["out: is no folder"]);
    assert!(!desk.path("out").exists());
}

#[test]
fn wrong_usage_is_reported_before_anything_is_written() {
    let desk = Desk::new();
    refused(&desk.view(&["--elevation", "5"]), 2, &["elevation is 5", "10 to 90"]);
    refused(&desk.view(&["--relief", "nan"]), 2, &["relief"]);
    refused(&desk.view(&["-o", "view.jpg"]), 2, &["view.jpg", ".png"]);
    refused(&desk.view(&["--turntable", "turn.png"]), 2, &["turn.png", ".gif"]);
    refused(&desk.view(&["-o", "out/fused.png"]), 2, &["out/fused.png", "result of the solve"]);
    assert!(!desk.path("out/view.png").exists());
}
