//! `parfocal apply`: resamples photographs by a known registration.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use image::{ImageBuffer, Luma, Rgb};
use tempfile::TempDir;

struct Desk(TempDir);

impl Desk {
    /// Writes a 16-bit grey ramp, an 8-bit colour ramp, and a registration for images of their size.
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        let ramp = ImageBuffer::from_fn(40, 30, |x, y| Luma([(1000 * x + 100 * y) as u16]));
        ramp.save(desk.path("ramp.png")).unwrap();
        let color = ImageBuffer::from_fn(40, 30, |x, y| Rgb([4 * x as u8, 5 * y as u8, 90]));
        color.save(desk.path("color.png")).unwrap();
        let transform = r#"{"tx_px": 2.5, "ty_px": -1, "rotation_deg": 0, "scale": 1}"#;
        let identity = r#"{"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1}"#;
        let frames =
            format!(r#"[{{"transform": {identity}}}, {{"transform": {transform}, "gain": 0.5, "offset": 0.1}}]"#);
        let report = format!(r#"{{"frames": {frames}, "size": {{"width": 40, "height": 30}}}}"#);
        fs::write(desk.path("report.json"), report).unwrap();
        fs::write(desk.path("transform.json"), transform).unwrap();
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn apply(&self, images: &[&str], transform: &str, extra: &[&str]) -> Output {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        command.arg("apply").args(images.iter().map(|image| self.path(image)));
        command.arg("--transform").arg(self.path(transform)).arg("-o").arg(self.path("out")).args(extra);
        command.output().unwrap()
    }
}

#[test]
fn a_ramp_is_moved_by_the_registration() {
    let desk = Desk::new();
    let output = desk.apply(&["ramp.png", "color.png"], "report.json", &["--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("color.png"));
    let moved = image::open(desk.path("out/ramp.png")).unwrap().into_luma16();
    // Pixel (x, y) of I1 lies at (x + 2.5, y - 1) in I2. The spline mirrors the image at its border pixels.
    // There the ramp reverses: half a pixel inside the border the error is 0.16 of the rise of 1000 per pixel.
    // The error falls by a factor of 2 + √3 per pixel.
    for (x, y, far) in [(5, 15, 1.0), (20, 15, 1.0), (30, 20, 1.0), (35, 15, 43.5)] {
        let expected = 1000.0 * (f64::from(x) + 2.5) + 100.0 * (f64::from(y) - 1.0);
        let off = (f64::from(moved.get_pixel(x, y)[0]) - expected).abs();
        assert!(off <= far, "({x}, {y}): {off}");
    }
    assert_eq!((moved.get_pixel(38, 10)[0], moved.get_pixel(10, 0)[0]), (0, 0), "black outside");
    let color = image::open(desk.path("out/color.png")).unwrap().into_rgb8();
    assert_eq!(color.get_pixel(10, 10).0, [50, 45, 90]);
}

#[test]
fn exposure_is_applied_on_request() {
    let desk = Desk::new();
    assert!(desk.apply(&["color.png"], "report.json", &["--exposure"]).status.success());
    let color = image::open(desk.path("out/color.png")).unwrap().into_rgb8();
    // 0.5 v + 25.5
    assert_eq!(color.get_pixel(10, 10).0, [51, 48, 71]);
    let output = desk.apply(&["color.png"], "transform.json", &["--exposure"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("states no gain"), "{output:?}");
}

#[test]
fn images_of_another_size_and_outputs_over_inputs_are_refused() {
    let desk = Desk::new();
    ImageBuffer::from_pixel(20, 15, Luma([7u8])).save(desk.path("half.png")).unwrap();
    let output = desk.apply(&["half.png"], "report.json", &[]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && stderr.contains("20x15") && stderr.contains("40x30"), "{stderr}");
    let over = Command::cargo_bin("parfocal")
        .unwrap()
        .arg("apply")
        .arg(desk.path("ramp.png"))
        .arg("--transform")
        .arg(desk.path("report.json"))
        .arg("-o")
        .arg(desk.0.path())
        .output()
        .unwrap();
    assert!(String::from_utf8_lossy(&over.stderr).contains("is an input"), "{over:?}");
}
