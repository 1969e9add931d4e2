//! Error messages for invalid input. No test needs a device: each fails before one is opened.

use std::fs;
use std::path::Path;

use crate::desk::{Desk, assert_refused_in_one_line, stderr_of};

const OUT: [&str; 2] = ["-o", "made/out"];

/// Returns a folder with a valid photograph. Results would go into `made`.
fn desk() -> Desk {
    let desk = Desk::new();
    image(64, 48).save(desk.path("good.png")).unwrap();
    desk
}

/// Asserts that `solve` ends with status 1 and a one-line message that contains every part, and writes nothing.
#[track_caller]
fn refuses(desk: &Desk, i1: &str, i2: &str, parts: &[&str]) {
    refuses_with(desk, i1, i2, &OUT, 1, parts);
}

#[track_caller]
fn refuses_with(desk: &Desk, i1: &str, i2: &str, extra: &[&str], status: i32, parts: &[&str]) {
    let output = desk.run(&[&["solve", i1, i2], extra].concat());
    assert_refused_in_one_line(&output, status, parts);
    let stderr = stderr_of(&output);
    assert!(stderr.starts_with("error: ") && stderr.ends_with('\n'), "{stderr}");
    assert!(output.stdout.is_empty());
    assert!(!desk.has("made"), "{stderr}");
}

fn image(width: u32, height: u32) -> image::GrayImage {
    image::GrayImage::from_fn(width, height, |x, y| image::Luma([(3 * x + 2 * y) as u8]))
}

fn write_exr(path: &Path, values: Vec<f32>) {
    use exr::prelude::*;
    let channels = AnyChannels::sort(std::iter::once(AnyChannel::new("Y", FlatSamples::F32(values))).collect());
    let layer = Layer::new((8, 8), LayerAttributes::default(), Encoding::SMALL_LOSSLESS, channels);
    Image::from_layer(layer).write().to_file(path).unwrap();
}

#[test]
fn a_missing_file_is_refused() {
    let desk = desk();
    refuses(&desk, "missing.png", "good.png", &["missing.png", "no such file"]);
    refuses(&desk, "good.png", "missing.png", &["missing.png", "no such file"]);
}

#[test]
fn a_folder_as_photograph_is_refused() {
    let desk = desk();
    fs::create_dir(desk.path("folder.png")).unwrap();
    refuses(&desk, "folder.png", "good.png", &["folder.png", "is a folder"]);
}

#[test]
fn empty_files_and_files_that_are_not_images_are_refused() {
    let desk = desk();
    desk.write("empty.png", "");
    refuses(&desk, "empty.png", "good.png", &["empty.png", "is empty"]);
    desk.write("text.png", "these are not pixels");
    refuses(&desk, "text.png", "good.png", &["text.png", "convert it to PNG"]);
    desk.write("one.gif", "GIF89a\x01\0\x01\0\0\0\0");
    refuses(&desk, "one.gif", "good.png", &["one.gif", "Gif", "convert it to PNG"]);
}

#[test]
fn a_truncated_file_is_refused() {
    let desk = desk();
    for name in ["cut.png", "cut.jpg", "cut.tif", "cut.pgm"] {
        image(64, 48).save(desk.path(name)).unwrap();
    }
    write_exr(&desk.path("cut.exr"), (0..64).map(|i| i as f32).collect());
    for name in ["cut.png", "cut.jpg", "cut.tif", "cut.pgm", "cut.exr"] {
        let bytes = desk.bytes(name);
        desk.write(name, &bytes[..bytes.len() * 2 / 3]);
        refuses(&desk, "good.png", name, &[name]);
        desk.write(name, &bytes[..12]);
        refuses(&desk, name, "good.png", &[name]);
    }
}

#[test]
fn photographs_of_different_sizes_are_refused() {
    let desk = desk();
    image(60, 48).save(desk.path("small.png")).unwrap();
    refuses(&desk, "good.png", "small.png", &["good.png", "64x48", "small.png", "60x48"]);
}

#[test]
fn an_excessive_image_size_is_refused() {
    let desk = desk();
    desk.write("huge.pgm", "P5 70000 70000 255\n");
    refuses(&desk, "good.png", "huge.pgm", &["huge.pgm", "70000x70000"]);
}

#[test]
fn a_pixel_of_infinity_is_refused() {
    let desk = desk();
    let mut values = vec![0.5; 64];
    values[19] = f32::INFINITY;
    write_exr(&desk.path("inf.exr"), values);
    refuses(&desk, "inf.exr", "inf.exr", &["inf.exr", "(3, 2)", "inf"]);
}

#[test]
fn settings_out_of_range_are_refused() {
    let desk = desk();
    let cases = [
        (["--levels", "99"], "levels is 99, and must be 1 to 12"),
        (["--max-relative-blur", "1e9"], "--max-relative-blur is"),
        (["--regularization", "nan"], "--regularization is NaN"),
        (["--outer-iterations", "1"], "--outer-iterations is"),
        (["--relaxation-sweeps", "0"], "--relaxation-sweeps is"),
    ];
    for (extra, part) in cases {
        refuses_with(&desk, "good.png", "good.png", &[&extra[..], &OUT].concat(), 2, &[part]);
    }
}

#[test]
fn invalid_arguments_exit_with_status_2() {
    let desk = desk();
    let cases: [(&[&str], &str); 6] = [
        (&["--levels", "few"], "--levels"),
        (&["--hold"], "--transform"),
        (&["--nearer", "3"], "--nearer"),
        (&["--method", "magic"], "--method"),
        (&["--timeout", "0"], "--timeout"),
        (&["--no-such-flag"], "--no-such-flag"),
    ];
    for (extra, part) in cases {
        desk.refuses(&[&["solve", "good.png", "good.png"], extra, &OUT].concat(), 2, &[part]);
        assert!(!desk.has("made"));
    }
}

#[test]
fn an_invalid_transform_is_refused() {
    let desk = desk();
    let transform = ["--transform", "t.json", "-o", "made/out"];
    let cases = [
        ("not json", "is not JSON"),
        ("{}", "tx_px"),
        (r#"{"transform": {"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": -1}}"#, "scale is -1"),
    ];
    for (text, part) in cases {
        desk.write("t.json", text);
        refuses_with(&desk, "good.png", "good.png", &[&transform[..], &["--hold"]].concat(), 1, &["t.json", part]);
    }
    fs::remove_file(desk.path("t.json")).unwrap();
    refuses_with(&desk, "good.png", "good.png", &transform, 1, &["t.json"]);
}

#[test]
fn an_output_folder_that_is_a_file_or_holds_the_input_is_refused() {
    let desk = desk();
    image(64, 48).save(desk.path("depth.png")).unwrap();
    let before = desk.bytes("depth.png");
    refuses_with(&desk, "good.png", "good.png", &["-o", "good.png"], 1, &["good.png", "is a file"]);
    refuses_with(&desk, "good.png", "depth.png", &["-o", "."], 1, &["depth.png", "would replace it"]);
    assert_eq!(desk.bytes("depth.png"), before);
}

#[test]
fn a_file_name_with_a_line_break_is_printed_on_one_line() {
    let desk = desk();
    refuses(&desk, "missing\nfile.png", "good.png", &["missing file.png"]);
}

#[test]
fn every_subcommand_has_help() {
    let desk = Desk::new();
    for (command, part) in
        [("solve", "--max-relative-blur"), ("register", "--method"), ("devices", "--json"), ("help", "parfocal")]
    {
        let argument = if command == "help" { &[command][..] } else { &[command, "--help"] };
        let output = desk.run(argument);
        assert!(output.status.success() && output.stderr.is_empty());
        assert!(String::from_utf8(output.stdout).unwrap().contains(part));
    }
    let help = desk.run(&["solve", "--help"]).stdout;
    assert!(String::from_utf8(help).unwrap().contains("PARFOCAL_VALIDATE"));
}
