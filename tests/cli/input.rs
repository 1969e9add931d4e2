//! Error messages for invalid input. No test needs a device: each fails before one is opened.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use tempfile::TempDir;

/// A temporary folder with a valid photograph. Results would go into `made`.
struct Desk {
    folder: TempDir,
    out: PathBuf,
}

impl Desk {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        let out = folder.path().join("made/out");
        let desk = Self { folder, out };
        image(64, 48).save(desk.path("good.png")).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs `solve` on two files in the folder.
    fn solve(&self, i1: &str, i2: &str, extra: &[&str]) -> Output {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        command.arg("solve").arg(self.path(i1)).arg(self.path(i2)).arg("-o").arg(&self.out).args(extra);
        command.output().unwrap()
    }

    /// Asserts exit status 1, a one-line message that contains every part, and no output folder.
    fn refuses(&self, i1: &str, i2: &str, parts: &[&str]) {
        self.refuses_with(i1, i2, &[], 1, parts);
    }

    fn refuses_with(&self, i1: &str, i2: &str, extra: &[&str], status: i32, parts: &[&str]) {
        let output = self.solve(i1, i2, extra);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(status), "{stderr}");
        assert!(stderr.starts_with("error: ") && stderr.ends_with('\n'), "{stderr}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
        for part in parts {
            assert!(stderr.contains(part), "'{part}' is missing in: {stderr}");
        }
        assert!(output.stdout.is_empty());
        assert!(!self.path("made").exists(), "{stderr}");
    }
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
    let desk = Desk::new();
    desk.refuses("missing.png", "good.png", &["missing.png", "no such file"]);
    desk.refuses("good.png", "missing.png", &["missing.png", "no such file"]);
}

#[test]
fn a_folder_as_photograph_is_refused() {
    let desk = Desk::new();
    fs::create_dir(desk.path("folder.png")).unwrap();
    desk.refuses("folder.png", "good.png", &["folder.png", "is a folder"]);
}

#[test]
fn empty_files_and_files_that_are_not_images_are_refused() {
    let desk = Desk::new();
    fs::write(desk.path("empty.png"), "").unwrap();
    desk.refuses("empty.png", "good.png", &["empty.png", "is empty"]);
    fs::write(desk.path("text.png"), "these are not pixels").unwrap();
    desk.refuses("text.png", "good.png", &["text.png", "convert it to PNG"]);
    fs::write(desk.path("one.gif"), "GIF89a\x01\0\x01\0\0\0\0").unwrap();
    desk.refuses("one.gif", "good.png", &["one.gif", "Gif", "convert it to PNG"]);
}

#[test]
fn a_truncated_file_is_refused() {
    let desk = Desk::new();
    for name in ["cut.png", "cut.jpg", "cut.tif", "cut.pgm"] {
        image(64, 48).save(desk.path(name)).unwrap();
    }
    write_exr(&desk.path("cut.exr"), (0..64).map(|i| i as f32).collect());
    for name in ["cut.png", "cut.jpg", "cut.tif", "cut.pgm", "cut.exr"] {
        let bytes = fs::read(desk.path(name)).unwrap();
        fs::write(desk.path(name), &bytes[..bytes.len() * 2 / 3]).unwrap();
        desk.refuses("good.png", name, &[name]);
        fs::write(desk.path(name), &bytes[..12]).unwrap();
        desk.refuses(name, "good.png", &[name]);
    }
}

#[test]
fn photographs_of_different_sizes_are_refused() {
    let desk = Desk::new();
    image(60, 48).save(desk.path("small.png")).unwrap();
    desk.refuses("good.png", "small.png", &["good.png", "64x48", "small.png", "60x48"]);
}

#[test]
fn an_excessive_image_size_is_refused() {
    let desk = Desk::new();
    fs::write(desk.path("huge.pgm"), "P5 70000 70000 255\n").unwrap();
    desk.refuses("good.png", "huge.pgm", &["huge.pgm", "70000x70000"]);
}

#[test]
fn a_nan_pixel_is_refused() {
    let desk = Desk::new();
    let mut values = vec![0.5; 64];
    values[19] = f32::NAN;
    write_exr(&desk.path("nan.exr"), values);
    desk.refuses("nan.exr", "nan.exr", &["nan.exr", "(3, 2)", "NaN"]);
}

#[test]
fn settings_out_of_range_are_refused() {
    let desk = Desk::new();
    let cases = [
        (["--levels", "99"], "levels is 99, and must be 1 to 12"),
        (["--max-relative-blur", "1e9"], "--max-relative-blur is"),
        (["--regularization", "nan"], "--regularization is NaN"),
        (["--outer-iterations", "1"], "--outer-iterations is"),
        (["--relaxation-sweeps", "0"], "--relaxation-sweeps is"),
    ];
    for (extra, part) in cases {
        desk.refuses_with("good.png", "good.png", &extra, 2, &[part]);
    }
}

#[test]
fn invalid_arguments_exit_with_status_2() {
    let desk = Desk::new();
    let cases: [(&[&str], &str); 6] = [
        (&["--levels", "few"], "--levels"),
        (&["--hold"], "--transform"),
        (&["--nearer", "3"], "--nearer"),
        (&["--method", "magic"], "--method"),
        (&["--timeout", "0"], "--timeout"),
        (&["--no-such-flag"], "--no-such-flag"),
    ];
    for (extra, part) in cases {
        let output = desk.solve("good.png", "good.png", extra);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(part), "{stderr}");
        assert!(!desk.path("made").exists());
    }
}

#[test]
fn an_invalid_transform_is_refused() {
    let desk = Desk::new();
    let file = desk.path("t.json");
    let cases = [
        ("not json", "is not JSON"),
        ("{}", "tx_px"),
        (r#"{"transform": {"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": -1}}"#, "scale is -1"),
    ];
    for (text, part) in cases {
        fs::write(&file, text).unwrap();
        let extra = ["--transform", file.to_str().unwrap(), "--hold"];
        desk.refuses_with("good.png", "good.png", &extra, 1, &["t.json", part]);
    }
    fs::remove_file(&file).unwrap();
    desk.refuses_with("good.png", "good.png", &["--transform", file.to_str().unwrap()], 1, &["t.json"]);
}

#[test]
fn an_output_folder_that_is_a_file_or_holds_the_input_is_refused() {
    let mut desk = Desk::new();
    let folder = desk.folder.path().to_path_buf();
    image(64, 48).save(desk.path("depth.png")).unwrap();
    let before = fs::read(desk.path("depth.png")).unwrap();
    desk.out = desk.path("good.png");
    desk.refuses("good.png", "good.png", &["good.png", "is a file"]);
    desk.out = folder;
    desk.refuses("good.png", "depth.png", &["depth.png", "would replace it"]);
    assert_eq!(fs::read(desk.path("depth.png")).unwrap(), before);
}

#[test]
fn a_file_name_with_a_line_break_is_printed_on_one_line() {
    let desk = Desk::new();
    desk.refuses("missing\nfile.png", "good.png", &["missing file.png"]);
}

#[test]
fn every_subcommand_has_help() {
    for (command, part) in
        [("solve", "--max-relative-blur"), ("register", "--method"), ("devices", "--json"), ("help", "parfocal")]
    {
        let argument = if command == "help" { &[command][..] } else { &[command, "--help"] };
        let output = Command::cargo_bin("parfocal").unwrap().args(argument).output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty());
        assert!(String::from_utf8(output.stdout).unwrap().contains(part));
    }
    let help = Command::cargo_bin("parfocal").unwrap().args(["solve", "--help"]).output().unwrap().stdout;
    assert!(String::from_utf8(help).unwrap().contains("PARFOCAL_VALIDATE"));
}
