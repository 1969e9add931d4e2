//! `parfocal view`: its pictures, and its errors for missing or damaged files. No test needs a device.

use std::fs;
use std::process::Output;

use image::{ImageBuffer, Luma, RgbImage};

use crate::desk::{Desk, assert_refused_in_one_line, stderr_of};
use crate::synthetic::{report_of_pair, write_field, write_pair};

const SIZE: (usize, usize) = (96, 64);

/// Returns a results folder with the files that `view` reads: a step from far (left) to near (right), with a hole.
fn results() -> Desk {
    let desk = Desk::new();
    let blur = |x: usize, y: usize| match (x, y) {
        (20..30, 20..30) => f32::NAN,
        (0..48, _) => -4.0,
        _ => 6.0,
    };
    write_pair(&desk, "out", SIZE, 1, [&blur, &|_, _| 0.5]);
    RgbImage::from_pixel(96, 64, image::Rgb([90, 140, 60])).save(desk.path("out/fused.png")).unwrap();
    desk
}

fn view(desk: &Desk, extra: &[&str]) -> Output {
    desk.run(&[&["view", "out", "--width", "150", "--turntable-width", "80"], extra].concat())
}

#[track_caller]
fn viewed(desk: &Desk, extra: &[&str]) {
    let output = view(desk, extra);
    assert!(output.status.success(), "{}", stderr_of(&output));
}

#[test]
fn the_picture_has_both_panels_and_is_reproducible() {
    let desk = results();
    let from_above = ["--elevation", "90", "--azimuth", "0"];
    viewed(&desk, &from_above);
    let at = |x: u32| {
        let picture = image::open(desk.path("out/view.png")).unwrap().into_rgb8();
        picture.get_pixel(x, picture.height() / 2 + 30).0
    };
    // The textured panel is green. The other has the colours of depth.png: purple at the left (far), yellow at right.
    assert!(at(40)[1] > at(40)[0] && at(40)[1] > at(40)[2], "{:?}", at(40));
    assert!(at(180)[2] > at(180)[1] && at(180)[1] < 60, "{:?}", at(180));
    assert!(at(260)[0] > 150 && at(260)[1] > 150 && at(260)[2] < 80, "{:?}", at(260));
    let first = desk.bytes("out/view.png");
    viewed(&desk, &[&from_above[..], &["-o", "deep/other.png"]].concat());
    assert_eq!(first, desk.bytes("deep/other.png"));
    // The colour map of the paper: blue and red.
    viewed(&desk, &[&from_above[..], &["--colors", "red-blue"]].concat());
    assert!(at(180)[2] > 150 && at(180)[0] < 120, "{:?}", at(180));
    assert!(at(260)[0] > 150 && at(260)[2] < 80, "{:?}", at(260));
}

#[test]
fn the_turntable_is_an_animation_of_both_panels() {
    let desk = results();
    viewed(&desk, &["--turntable", "turn.gif"]);
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
    let desk = results();
    write_field(&desk.path("out/relative_blur.exr"), (96, 64), |_, _| f32::NAN);
    viewed(&desk, &["--turntable", "turn.gif"]);
    assert!(desk.path("out/view.png").is_file() && desk.path("turn.gif").is_file());
}

#[test]
fn a_missing_or_damaged_file_is_named() {
    for name in ["relative_blur.exr", "uncertainty.exr", "fused.png", "report.json"] {
        let desk = results();
        fs::remove_file(desk.path("out").join(name)).unwrap();
        assert_refused_in_one_line(&view(&desk, &[]), 1, &[name]);
        fs::write(desk.path("out").join(name), "odd").unwrap();
        assert_refused_in_one_line(&view(&desk, &[]), 1, &[name]);
        assert!(!desk.has("out/view.png"));
    }
    let desk = results();
    write_field(&desk.path("out/uncertainty.exr"), (95, 64), |_, _| 0.5);
    assert_refused_in_one_line(&view(&desk, &[]), 1, &["uncertainty.exr", "95x64", "96x64"]);
    let desk = results();
    ImageBuffer::<Luma<u16>, _>::new(96, 63).save(desk.path("out/fused.png")).unwrap();
    assert_refused_in_one_line(&view(&desk, &[]), 1, &["fused.png", "96x63"]);
    let odd = report_of_pair(SIZE, 1).to_string().replace("\"nearer\":1", "\"nearer\":3");
    desk.write("out/report.json", odd);
    assert_refused_in_one_line(&view(&desk, &[]), 1, &["report.json", "nearer"]);
    fs::remove_dir_all(desk.path("out")).unwrap();
    assert_refused_in_one_line(&view(&desk, &[]), 1, &["out: is no folder"]);
    assert!(!desk.has("out"));
}

#[test]
fn wrong_usage_is_reported_before_anything_is_written() {
    let desk = results();
    assert_refused_in_one_line(&view(&desk, &["--elevation", "5"]), 2, &["elevation is 5", "10 to 90"]);
    assert_refused_in_one_line(&view(&desk, &["--relief", "nan"]), 2, &["relief"]);
    assert_refused_in_one_line(&view(&desk, &["-o", "view.jpg"]), 2, &["view.jpg", ".png"]);
    assert_refused_in_one_line(&view(&desk, &["--turntable", "turn.png"]), 2, &["turn.png", ".gif"]);
    assert_refused_in_one_line(&view(&desk, &["-o", "out/fused.png"]), 2, &["out/fused.png", "result of the solve"]);
    assert!(!desk.has("out/view.png"));
}
