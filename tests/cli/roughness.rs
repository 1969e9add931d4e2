//! `parfocal roughness` on synthetic results of a pair.

use std::f64::consts::{PI, TAU};

use serde_json::Value;

use crate::desk::{Desk, printed, stderr_of};
use crate::synthetic::{CUP_LENS, write_pair};

const SIZE: (usize, usize) = (96, 64);
const AMPLITUDE: f64 = 1.5;

/// Returns results of a pair: V is a sine of a period of 16 px on a tilt, with a hole of 100 px.
fn desk() -> Desk {
    let desk = Desk::new();
    let is_hole = |x: usize, y: usize| (20..30).contains(&x) && (20..30).contains(&y);
    let blur = |x: usize, y: usize| {
        let v = AMPLITUDE * (TAU * (x as f64 + 0.5) / 16.0).sin() + 0.02 * x as f64 - 0.05 * y as f64;
        if is_hole(x, y) { f32::NAN } else { v as f32 }
    };
    write_pair(&desk, "out", SIZE, 2, [&blur, &|x, y| if is_hole(x, y) { f32::NAN } else { 0.05 }]);
    desk
}

/// Returns the report and the summary.
#[track_caller]
fn roughness(desk: &Desk, arguments: &[&str]) -> (Value, String) {
    let output = desk.done(&[&["roughness", "out", "--json", "--realizations", "10"], arguments].concat());
    println!("{}", stderr_of(&output));
    (printed(&output), stderr_of(&output))
}

#[track_caller]
fn refuses(desk: &Desk, arguments: &[&str], status: i32, parts: &[&str]) {
    desk.refuses(&[&["roughness"], arguments].concat(), status, parts);
}

/// A member of a parameter of the report.
fn of(report: &Value, name: &str, member: &str) -> f64 {
    let all = report["parameters"].as_array().unwrap();
    let parameter = all.iter().find(|parameter| parameter["name"] == name).unwrap();
    parameter[member].as_f64().unwrap_or_else(|| panic!("{name}: {member} of {parameter}"))
}

#[track_caller]
fn close(value: f64, expected: f64, share: f64) {
    assert!((value - expected).abs() <= share * expected.abs(), "{value}, expected {expected}");
}

#[test]
fn a_sine_on_a_tilt_has_its_closed_forms() {
    let desk = desk();
    let (report, summary) = roughness(&desk, &[]);
    close(of(&report, "Sa", "value"), 2.0 * AMPLITUDE / PI, 0.03);
    close(of(&report, "Sq", "value"), AMPLITUDE / 2f64.sqrt(), 0.03);
    // The plane takes a part of the six periods.
    close(of(&report, "Sku", "value"), 1.5, 0.06);
    close(of(&report, "Sdq", "value"), TAU * AMPLITUDE / 16.0 / 2f64.sqrt(), 0.03);
    close(of(&report, "Rz", "value"), 2.0 * AMPLITUDE, 0.05);
    let missing = report["missing_fraction"].as_f64().unwrap();
    close(missing, 100.0 / 6144.0, 1e-9);
    assert_eq!((&report["unit"], &report["lateral_unit"]), (&Value::from("px²"), &Value::from("px")));
    assert_eq!((&report["parameters"][8]["name"], &report["parameters"][8]["value"]), (&"Sdr".into(), &Value::Null));
    assert_eq!((&report["str_is_upper_bound"], &report["profiles"]), (&true.into(), &64.into()));
    assert!((0.0001..0.05).contains(&of(&report, "Sq", "by_noise")), "{report}");
    for part in ["1.6 % of 6144 px missing", "Str            at most ", "not defined without heights in mm", "px²/px"]
    {
        assert!(summary.contains(part), "{part} in {summary}");
    }
}

#[test]
fn heights_are_positive_towards_the_camera() {
    let desk = desk();
    let peak = |x: usize, y: usize| if (40..44).contains(&x) && (30..34).contains(&y) { 5.0 } else { 0.0 };
    // Positive V is near if I1 is focused nearer.
    for (nearer, sign) in [(1, 1.0), (2, -1.0)] {
        write_pair(&desk, "out", SIZE, nearer, [&peak, &|_, _| 0.05]);
        let (report, _) = roughness(&desk, &["--form", "none"]);
        assert!(sign * of(&report, "Ssk", "value") > 5.0, "{report}");
        let [peak, pit] = ["Sp", "Sv"].map(|name| of(&report, name, "value"));
        assert_eq!(peak > pit, nearer == 1);
    }
}

#[test]
fn the_scale_of_v_is_a_part_of_the_standard_deviation() {
    let desk = desk();
    // Of |V| up to 4 px², 0.01 is below the standard deviation of each pixel.
    let mut stated = desk.report("out");
    stated["scale_deviation"] = 0.01.into();
    desk.write("out/report.json", stated.to_string());
    let (report, summary) = roughness(&desk, &[]);
    for name in ["Sa", "Sq", "Sz", "Sdq", "Ra", "Rz"] {
        close(of(&report, name, "by_scale"), 0.01 * of(&report, name, "value"), 1e-3);
    }
    assert!(of(&report, "Ssk", "by_scale").abs() < 1e-6 && report["scale_deviation"] == 0.01);
    let total = of(&report, "Sa", "by_noise").hypot(of(&report, "Sa", "by_scale"));
    close(of(&report, "Sa", "standard_deviation"), total, 1e-9);
    assert!(summary.contains(", scale 0.0"), "{summary}");
}

#[test]
fn with_a_lens_and_a_pixel_size_heights_are_in_mm_and_lengths_in_micrometres() {
    let desk = desk();
    desk.done(&[&["depth", "out"], &CUP_LENS[..]].concat());
    let (px, _) = roughness(&desk, &[]);
    let (report, _) =
        roughness(&desk, &["--pixel-size", "500", "--s-filter", "2000", "--l-filter", "20000", "--form", "quadric"]);
    assert_eq!((&report["unit"], &report["lateral_unit"]), (&Value::from("mm"), &Value::from("µm")));
    assert_eq!(
        (&report["s_filter_px"], &report["l_filter_px"], &report["form"]),
        (&4.0.into(), &40.0.into(), &"quadric".into())
    );
    assert!(of(&report, "Sdr", "value") > 0.0 && of(&report, "Sdr", "standard_deviation") > 0.0);
    let (wide, _) = roughness(&desk, &["--pixel-size", "500"]);
    close(of(&wide, "Sal", "value"), 500.0 * of(&px, "Sal", "value"), 1e-9);
    let unit = |report: &Value, name: &str| {
        let all = report["parameters"].as_array().unwrap();
        all.iter().find(|parameter| parameter["name"] == name).unwrap()["unit"].as_str().unwrap().to_string()
    };
    assert_eq!(["Sa", "Sdq"].map(|name| unit(&px, name)), ["µm", "µm/px"]);
    assert_eq!(["Sa", "Sdq", "Rz"].map(|name| unit(&wide, name)), ["µm", "", "µm"]);
    // A pixel is 500 µm.
    close(of(&wide, "Sdq", "value"), of(&px, "Sdq", "value") / 500.0, 1e-9);
    assert!((1e6..1e7).contains(&of(&wide, "Sz", "value")), "it is some metres: {wide}");
    close(of(&wide, "Sa", "value"), of(&px, "Sa", "value"), 1e-9);
}

#[test]
fn a_region_a_mask_and_a_line_select_pixels() {
    let desk = desk();
    image::GrayImage::from_fn(96, 64, |x, _| image::Luma([if x < 48 { 255 } else { 0 }]))
        .save(desk.path("mask.png"))
        .unwrap();
    let (masked, _) = roughness(&desk, &["--mask", "mask.png"]);
    let (region, _) = roughness(&desk, &["--roi", "0,0,48,64"]);
    assert_eq!((&masked["area_px"], &region["area_px"]), (&3072.into(), &3072.into()));
    close(of(&masked, "Sq", "value"), of(&region, "Sq", "value"), 1e-9);
    let (line, summary) = roughness(&desk, &["--line", "2,50,90,50,3", "--l-filter", "40", "--robust"]);
    assert_eq!((&line["profiles"], &line["sections"]), (&1.into(), &2.into()));
    assert!(summary.contains("1 line, 2 section lengths") && summary.contains("L 40 px, robust"), "{summary}");
    image::GrayImage::new(10, 10).save(desk.path("small.png")).unwrap();
    refuses(&desk, &["out", "--mask", "small.png"], 1, &["small.png", "10x10", "96x64"]);
}

#[test]
fn options_that_cannot_be_are_wrong_usage() {
    let desk = desk();
    for (arguments, parts) in [
        (&["--s-filter", "-3"][..], &["above 0"][..]),
        (&["--l-filter", "0"], &["above 0"]),
        (&["--s-filter", "nan"], &["above 0"]),
        (&["--s-filter", "2"], &["S-filter is 2.0000 px", "at least 4 px"]),
        (&["--s-filter", "30", "--l-filter", "20"], &["not below the L-filter"]),
        (&["--l-filter", "65"], &["longer than the area"]),
        (&["--roi", "90,0,20,20"], &["90,0,20,20", "96x64"]),
        (&["--roi", "0,0,8,8"], &["only 64 of", "larger area"]),
        (&["--line", "0,0,96,0"], &["leaves the image"]),
        (&["--line", "0,0,96"], &["as in"]),
        (&["--robust"], &["--l-filter"]),
        (&["--form", "sphere"], &["sphere", "cylinder"]),
        (&["--pixel-size", "0"], &["above 0"]),
        (&["--realizations", "1"], &["2 to 10000"]),
        (&["--noise-window", "-1"], &["0 to 100"]),
        (&["--roi", "0,0,96,1"], &["only 96 of"]),
    ] {
        refuses(&desk, &[&["out"], arguments].concat(), 2, parts);
    }
    refuses(&desk, &["absent"], 1, &["absent", "no folder"]);
    refuses(&desk, &["out", "--mask", "absent.png"], 1, &["absent.png"]);
}
