//! `parfocal apply`: resamples photographs by a known registration.

use std::process::Output;

use image::{ImageBuffer, Luma, Rgb};

use crate::desk::{Desk, assert_refused, stderr_of};

/// Returns a folder with a 16-bit grey ramp, an 8-bit colour ramp, and a registration for images of their size.
fn desk() -> Desk {
    let desk = Desk::new();
    let ramp = ImageBuffer::from_fn(40, 30, |x, y| Luma([(1000 * x + 100 * y) as u16]));
    ramp.save(desk.path("ramp.png")).unwrap();
    let color = ImageBuffer::from_fn(40, 30, |x, y| Rgb([4 * x as u8, 5 * y as u8, 90]));
    color.save(desk.path("color.png")).unwrap();
    let transform = r#"{"tx_px": 2.5, "ty_px": -1, "rotation_deg": 0, "scale": 1}"#;
    let identity = r#"{"tx_px": 0, "ty_px": 0, "rotation_deg": 0, "scale": 1}"#;
    let frames = format!(r#"[{{"transform": {identity}}}, {{"transform": {transform}, "gain": 0.5, "offset": 0.1}}]"#);
    desk.write("report.json", format!(r#"{{"frames": {frames}, "size": {{"width": 40, "height": 30}}}}"#));
    desk.write("transform.json", transform);
    desk
}

fn apply(desk: &Desk, image: &str, transform: &str, extra: &[&str]) -> Output {
    desk.run(&[&["apply", image, "--transform", transform, "-o", "out"], extra].concat())
}

#[test]
fn a_ramp_is_moved_by_the_registration() {
    let desk = desk();
    let output = apply(&desk, "ramp.png", "report.json", &["color.png", "--json"]);
    assert!(output.status.success(), "{}", stderr_of(&output));
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
    let desk = desk();
    assert!(apply(&desk, "color.png", "report.json", &["--exposure"]).status.success());
    let color = image::open(desk.path("out/color.png")).unwrap().into_rgb8();
    // 0.5 v + 25.5
    assert_eq!(color.get_pixel(10, 10).0, [51, 48, 71]);
    let output = apply(&desk, "color.png", "transform.json", &["--exposure"]);
    assert!(stderr_of(&output).contains("states no gain"), "{output:?}");
}

#[test]
fn images_of_another_size_and_outputs_over_inputs_are_refused() {
    let desk = desk();
    ImageBuffer::from_pixel(20, 15, Luma([7u8])).save(desk.path("half.png")).unwrap();
    assert_refused(&apply(&desk, "half.png", "report.json", &[]), 1, &["20x15", "40x30"]);
    desk.refuses(&["apply", "ramp.png", "--transform", "report.json", "-o", "."], 1, &["is an input"]);
}
