//! `parfocal stack` on sweeps over scenes of known focus.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use parfocal::image_io::read_field;

use crate::desk::{Desk, printed, stderr_of};
use crate::synthetic::blurred_waves;

/// A sweep over a scene with known focus u per column. Frame p has a blur variance of 2 (p - u)² px².
pub struct Sweep {
    pub desk: Desk,
    pub files: Vec<PathBuf>,
}

pub const SIZE: [u32; 2] = [192, 128];
const RATE: f64 = 2.0;

/// Focus of two planes: setting 1 at the left, 2.6 at the right.
pub fn planes(x: u32) -> f64 {
    if x < SIZE[0] / 2 { 1.0 } else { 2.6 }
}

/// Focus of a slope from setting 1 to 3.
pub fn slope(x: u32) -> f64 {
    1.0 + 2.0 * f64::from(x) / f64::from(SIZE[0])
}

impl Sweep {
    pub fn new(frames: u32, focus_at: fn(u32) -> f64) -> Self {
        let desk = Desk::new();
        let files = (0..frames).map(|n| desk.path(&format!("frame_{n}.png"))).collect::<Vec<_>>();
        for (n, file) in files.iter().enumerate() {
            let value = |x: u32, y: u32| blurred_waves(x, y, RATE * (n as f64 - focus_at(x)).powi(2) + 0.3);
            let image = image::ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
                image::Luma([(value(x, y) * 65535.0).round() as u16])
            });
            image.save(file).unwrap();
        }
        Self { desk, files }
    }

    /// Has the program run on Vulkan, as [`Desk::on_vulkan`].
    fn on_vulkan(self) -> Self {
        Self { desk: self.desk.on_vulkan(), ..self }
    }

    pub fn stack(&self, extra: &[&str]) -> Output {
        let mut command = self.desk.command(&["stack"]);
        command.args(&self.files).args(["-o", "out"]).args(extra).output().unwrap()
    }

    pub fn out(&self) -> PathBuf {
        self.desk.path("out")
    }
}

#[test]
fn a_sweep_gives_the_focus_of_both_planes() {
    let sweep = Sweep::new(5, planes).on_vulkan();
    // The folder holds earlier results of a pair, whose report lists relative_blur.exr.
    fs::create_dir(sweep.out()).unwrap();
    for name in ["relative_blur.exr", "labels.png", "focus.exr"] {
        fs::write(sweep.out().join(name), name).unwrap();
    }
    let before = r#"{"program": "parfocal", "kind": "pair", "files": ["relative_blur.exr", "report.json"]}"#;
    fs::write(sweep.out().join("report.json"), before).unwrap();
    let refused = sweep.stack(&["--device", "no such GPU"]);
    let stderr = stderr_of(&refused);
    assert!(stderr.contains("focus.exr: is there already") && stderr.contains("--force"), "{stderr}");
    fs::remove_file(sweep.out().join("focus.exr")).unwrap();
    let output = sweep.stack(&["--json", "--reference", "3"]);
    assert!(output.status.success(), "{}", stderr_of(&output));
    let report = printed(&output);
    assert_eq!(sweep.desk.report("out"), report);
    assert!(report["files"].to_string().contains("report.html"), "{}", report["files"]);
    assert!(!sweep.out().join("relative_blur.exr").exists() && sweep.out().join("labels.png").exists());
    let rate = report["blur_rate_px2"].as_f64().unwrap();
    assert!((rate / RATE - 1.0).abs() < 0.1, "{rate}");
    assert_eq!((&report["reference"], report["frames"].as_array().unwrap().len()), (&2.into(), 5));
    let (width, height, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    let (_, _, uncertainty) = read_field(&sweep.out().join("uncertainty.exr")).unwrap();
    for (from, to) in [(20, 76), (116, 172)] {
        let mut found: Vec<f32> = (20..height - 20)
            .flat_map(|y| (from..to).map(move |x| (y * width + x) as usize))
            .map(|i| focus[i])
            .collect();
        found.sort_by(f32::total_cmp);
        let median = f64::from(found[found.len() / 2]);
        assert!((median - planes(from)).abs() < 0.1, "{median} at {from}");
    }
    assert!(uncertainty.iter().all(|s| s.is_nan() || *s > 0.0));
    for file in ["depth.png", "fused.png", "report.json"] {
        assert!(fs::metadata(sweep.out().join(file)).unwrap().len() > 0);
    }
    // The frames nearest to the two planes are the second and the fourth.
    let frames = image::open(sweep.out().join("frames.png")).unwrap().into_luma8();
    let share = |from: u32, to: u32, number: u8| {
        let places = (20..height - 20).flat_map(|y| (from..to).map(move |x| (x, y)));
        let all: Vec<bool> = places.map(|(x, y)| frames.get_pixel(x, y).0[0] == number).collect();
        all.iter().filter(|is| **is).count() as f64 / all.len() as f64
    };
    assert!(share(20, 76, 2) > 0.95 && share(116, 172, 4) > 0.95, "{} {}", share(20, 76, 2), share(116, 172, 4));
    assert!(report["files"].to_string().contains("frames.png") && frames.dimensions() == (width, height));
}

/// Reads depth and its standard deviation, in mm.
pub fn depth(sweep: &Sweep) -> [Vec<f64>; 2] {
    use exr::prelude::read_first_flat_layer_from_file;
    let layer = read_first_flat_layer_from_file(sweep.out().join("depth_mm.exr")).unwrap().layer_data;
    ["Y", "standard_deviation"].map(|name| {
        let found = layer.channel_data.list.iter().find(|c| c.name.to_string() == name).unwrap();
        found.sample_data.values_as_f32().map(f64::from).collect()
    })
}

/// Compares depth with the truth per column, at least 20 px from the border.
///
/// Returns the median absolute error in mm and the fraction of pixels within two standard deviations of the truth.
fn depth_error(sweep: &Sweep, truth: impl Fn(u32) -> f64) -> (f64, f64) {
    let [depth, deviation] = depth(sweep);
    let inside = (20..SIZE[1] - 20).flat_map(|y| (20..SIZE[0] - 20).map(move |x| (x, (y * SIZE[0] + x) as usize)));
    let mut off: Vec<(f64, bool)> = inside
        .filter(|&(_, i)| !depth[i].is_nan())
        .map(|(x, i)| ((depth[i] - truth(x)).abs(), (depth[i] - truth(x)).abs() < 2.0 * deviation[i]))
        .collect();
    assert!(off.len() > 12_000, "only {} pixels have a depth", off.len());
    off.sort_by(|a, b| a.0.total_cmp(&b.0));
    let within = off.iter().filter(|o| o.1).count() as f64 / off.len() as f64;
    (off[off.len() / 2].0, within)
}

#[test]
fn focus_distances_and_stage_positions_give_depth_within_its_deviation() {
    let sweep = Sweep::new(5, slope);
    // Focus distances of 4 to 4.4 1/m: later frames are focused nearer.
    let inverse = |setting: f64| 1000.0 / (4.0 + 0.1 * setting);
    let at = (0..5).map(|n| inverse(f64::from(n)).to_string()).collect::<Vec<_>>().join(",");
    let output = sweep.stack(&["--json", "--focus-at", &at]);
    assert!(output.status.success(), "{}", stderr_of(&output));
    let report = printed(&output);
    assert_eq!((&report["focus_unit"], &report["nearer"]), (&"1/m".into(), &2.into()));
    assert_eq!(report["frames"][1]["focus_mm"].as_f64(), Some(inverse(1.0)));
    let summary = stderr_of(&output);
    assert!(summary.contains("depth ") && summary.contains(" mm, median "), "{summary}");
    // One step of the setting is 6 mm here.
    let (median, within) = depth_error(&sweep, |x| inverse(slope(x)));
    assert!(median < 0.3 && within > 0.9, "{median} mm, {within}");
    let median = report["depth"]["median"].as_f64().unwrap();
    assert!((median - inverse(2.0)).abs() < 1.0, "{median}");

    let output = sweep.stack(&["--focus-at", "-1:0.5", "--stage", "up", "--hold", "--json"]);
    assert!(output.status.success(), "{}", stderr_of(&output));
    let report = printed(&output);
    let moved = |frame: &serde_json::Value| frame["transform"]["tx_px"] != 0.0 || frame["transform"]["scale"] != 1.0;
    assert!(!report["frames"].as_array().unwrap().iter().any(moved), "{}", report["frames"]);
    assert_eq!((&report["nearer"], &report["nearer_by"]), (&2.into(), &"stated".into()));
    let (median, within) = depth_error(&sweep, |x| -1.0 + 0.5 * slope(x));
    assert!(median < 0.025 && within > 0.9, "{median} mm, {within}");

    // Frames of one scale do not show which is focused nearest.
    let output = sweep.stack(&["--json"]);
    assert!(output.status.success() && !sweep.out().join("depth_mm.exr").exists());
    assert_eq!(printed(&output)["nearer_by"], "assumed");
    assert!(stderr_of(&output).contains("nothing shows which is focused nearer"), "{}", stderr_of(&output));
}

/// Focus of two planes. The right plane lies one step beyond the last of four frames.
fn half_beyond(x: u32) -> f64 {
    if x < SIZE[0] / 2 { 1.0 } else { 4.0 }
}

#[test]
fn pixels_in_focus_in_no_frame_are_reported_with_their_side() {
    let sweep = Sweep::new(4, half_beyond);
    let output = sweep.stack(&["--json"]);
    assert!(output.status.success(), "{}", stderr_of(&output));
    let report = printed(&output);
    // Fractions of the right half. Pixels along the edge between the planes may stay undetermined.
    let half = f64::from(SIZE[0] * SIZE[1] / 2);
    let count = |key: &str| report["never_in_focus"][key].as_f64().unwrap() / half;
    assert!(
        count("before_first_px") < 0.02 && (0.7..1.05).contains(&count("beyond_last_px")),
        "{}",
        report["never_in_focus"]
    );
    let stderr = stderr_of(&output);
    assert!(stderr.contains("never") && stderr.contains("beyond the last"), "{stderr}");
    let sides = image::open(sweep.out().join("beyond.png")).unwrap().into_luma8();
    let depth = image::open(sweep.out().join("depth.png")).unwrap().into_rgba8();
    let (_, _, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    let at = [150, 64];
    assert!(sides.get_pixel(at[0], at[1]).0 == [2] && focus[(at[1] * SIZE[0] + at[0]) as usize].is_nan());
    assert!(sides.get_pixel(30, 64).0 == [0] && !focus[(64 * SIZE[0] + 30) as usize].is_nan());
    // Pixels beyond the last frame have stripes of the far end's colour and grey, unlike pixels of unknown focus.
    let [one, other] = [0, 4].map(|dx| depth.get_pixel(at[0] + dx, at[1]).0);
    let is_grey = |[r, g, b, _]: [u8; 4]| r == g && g == b;
    assert!(is_grey(one) != is_grey(other), "{one:?} {other:?}");
}

#[test]
fn frames_out_of_order_are_sorted_and_duplicates_dropped() {
    let mut sweep = Sweep::new(6, |x| 5.0 * f64::from(x) / f64::from(SIZE[0]));
    // Frames out of natural name order are accepted only with positions, so the contents of two files are exchanged.
    let [third, fourth] = [2, 3].map(|n| fs::read(&sweep.files[n]).unwrap());
    fs::write(&sweep.files[2], &fourth).unwrap();
    fs::write(&sweep.files[3], &third).unwrap();
    let twice = sweep.desk.path("frame_5_again.png");
    fs::copy(&sweep.files[5], &twice).unwrap();
    sweep.files.push(twice);
    let output = sweep.stack(&["--json"]);
    let stderr = stderr_of(&output);
    assert!(output.status.success() && stderr.contains("taken as 1, 2, 4, 3, 5, 6"), "{stderr}");
    assert!(stderr.contains("frame 7 is the same photograph as frame 6"), "{stderr}");
    let report = printed(&output);
    assert_eq!(report["order"], serde_json::json!([0, 1, 3, 2, 4, 5]));
    assert!(report["frames"][2]["file"].as_str().unwrap().ends_with("frame_3.png"), "{}", report["frames"][2]);
    let (width, _, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    for x in [40, 96, 150] {
        let found = f64::from(focus[(64 * width + x) as usize]);
        assert!((found - 5.0 * f64::from(x) / f64::from(SIZE[0])).abs() < 0.2, "{found} at {x}");
    }
    // Stated positions override the estimated order.
    sweep.files.pop();
    let output = sweep.stack(&["--quiet", "--json", "--positions", "0:1"]);
    let report = printed(&output);
    assert_eq!(report["order"], serde_json::json!([0, 1, 2, 3, 4, 5]));
    assert!(report["warnings"].to_string().contains("as given"), "{}", report["warnings"]);
}

#[test]
fn frames_with_most_of_their_pixels_clipped_are_named() {
    let sweep = Sweep::new(5, planes);
    for (n, from) in [(1, 100), (2, 170)] {
        let mut frame = image::open(&sweep.files[n]).unwrap().into_luma16();
        frame.enumerate_pixels_mut().filter(|(x, _, _)| *x >= from - 60).for_each(|(_, _, value)| value.0 = [65535]);
        frame.save(&sweep.files[n]).unwrap();
    }
    // With positions stated the frames stay in order. The mostly white frame is kept on request.
    let output = sweep.stack(&["--json", "--no-html", "--keep-frames", "--positions", "0,1,2,3,4"]);
    let report = printed(&output);
    let shares: Vec<f64> =
        report["frames"].as_array().unwrap().iter().map(|frame| frame["clipped_fraction"].as_f64().unwrap()).collect();
    let [second, third] = [152.0, 82.0].map(|columns: f64| columns / f64::from(SIZE[0]));
    // The waves themselves clip a few pixels.
    let near = |share: f64, expected: f64| (share - expected).abs() < 0.005;
    assert!(near(shares[1], second) && near(shares[2], third) && near(shares[0], 0.0), "{shares:?}");
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("79 % of the pixels are clipped in the frames 2, and do not count"), "{warnings}");
    let stderr = stderr_of(&output);
    assert!(stderr.contains("clipped    up to 79."), "{stderr}");
}

#[test]
fn invalid_sweeps_are_refused_with_a_reason() {
    let sweep = Sweep::new(3, planes);
    let refused = |extra: &[&str], words: &[&str]| {
        let output = sweep.stack(extra);
        let stderr = stderr_of(&output);
        assert!(!output.status.success() && !sweep.out().exists(), "{stderr}");
        assert!(words.iter().all(|word| stderr.contains(word)), "{stderr}");
    };
    refused(&["--positions", "0,1"], &["2 positions for 3 frames"]);
    refused(&["--positions", "0,2,1"], &["ascending"]);
    refused(&["--focus-at", "100,0,-100"], &["0 mm", "distance"]);
    refused(&["--focus-at", "100,200,300", "--nearer", "2"], &["--nearer", "--focus-at"]);
    refused(&["--stage"], &["--focus-at"]);
    refused(&["--reference", "4"], &["no reference frame 4", "there are 3"]);
}
