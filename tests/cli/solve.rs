//! `parfocal solve` on a device: its files, its output, and its errors without a device.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

const RESULTS: [&str; 6] =
    ["relative_blur.exr", "confidence.exr", "depth.png", "fused.png", "report.json", "uncertainty.exr"];

/// A temporary folder with a pair that differs in blur and a pair of constant grey.
struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(TempDir::new().unwrap());
        for (name, contrast) in [("near.png", 90.0), ("far.png", 70.0), ("grey.png", 0.0)] {
            let value = |x: u32, y: u32| {
                let (x, y) = (f64::from(x), f64::from(y));
                let waves = (0.9 * x + 0.2 * y).sin() + (0.3 * x - 0.8 * y).cos() + (0.1 * x * y / 20.0).sin();
                (128.0 + contrast / 3.0 * waves) as u8
            };
            let image =
                image::RgbImage::from_fn(96, 64, |x, y| image::Rgb([value(x, y), value(x, y), value(x, y) / 2]));
            image.save(desk.path(name)).unwrap();
        }
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self) -> Command {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        command.env("PARFOCAL_CACHE_DIR", self.path("cache"));
        command
    }

    fn solve(&self, pair: [&str; 2], extra: &[&str]) -> Output {
        let mut command = self.command();
        command.arg("solve").args(pair.map(|name| self.path(name))).arg("-o").arg(self.path("out"));
        command.args(extra).output().unwrap()
    }

    fn solved(&self, pair: [&str; 2], extra: &[&str]) -> Value {
        let output = self.solve(pair, &[extra, &["--json"]].concat());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{stderr}");
        for name in RESULTS {
            assert!(self.path("out").join(name).is_file(), "{name} is missing");
        }
        let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
        let written: Value = serde_json::from_slice(&fs::read(self.path("out/report.json")).unwrap()).unwrap();
        assert_eq!(printed, written);
        printed
    }
}

#[test]
fn solve_writes_five_files_and_prints_the_report_on_stdout() {
    let desk = Desk::new();
    let report = desk.solved(["near.png", "far.png"], &["--timings"]);
    assert_eq!(report["method"], "unified");
    assert_eq!(report["size"]["width"], 96);
    assert!(report["frames"][1]["transform"]["tx_px"].is_f64() && report["timings_ms"]["total"].is_f64());
    assert!(report["device"]["name"].is_string());
    let level = &report["levels"][0];
    assert_eq!(level["iterations"].as_u64().unwrap() as usize, level["energy"].as_array().unwrap().len());
    assert!(report["timings_ms"]["passes"]["linearise"].is_f64(), "{}", report["timings_ms"]);
    let fused = image::open(desk.path("out/fused.png")).unwrap();
    assert_eq!((fused.width(), fused.color()), (96, image::ColorType::Rgb8));
    let field = parfocal::image_io::read(&desk.path("out/confidence.exr")).unwrap();
    assert_eq!((field.width(), field.height()), (96, 64));
}

#[test]
fn the_surface_is_exported_on_request_and_removed_otherwise() {
    let desk = Desk::new();
    let pair = ["near.png", "far.png"];
    let files = ["surface.ply", "points.ply", "surface.glb"].map(|name| desk.path("out").join(name));
    desk.solved(pair, &["--export", "ply,cloud,glb,ply", "--mesh-cells", "48", "--z-scale", "2.5"]);
    let [mesh, cloud, glb] = files.each_ref().map(|file| fs::read(file).unwrap());
    let holds = |bytes: &[u8], text: &str| bytes.windows(text.len()).any(|w| w == text.as_bytes());
    assert!(holds(&mesh, "2.5 px per px^2") && holds(&mesh, "element face") && !holds(&cloud, "element face"));
    assert!(glb.starts_with(b"glTF") && glb.len() % 4 == 0 && mesh.len() < 2 * cloud.len());
    desk.solved(pair, &["--export", "glb", "--no-html"]);
    assert!(files[2].is_file() && !files[0].exists() && !files[1].exists());
    for wrong in [&["--export", "step"][..], &["--z-scale", "-1"], &["--mesh-cells", "1"]] {
        assert_eq!(desk.solve(pair, wrong).status.code(), Some(2));
    }
    // An empty surface is not an error.
    desk.solved(["grey.png", "grey.png"], &["--export", "ply,cloud,glb", "--max-relative-blur", "256"]);
}

#[test]
fn a_held_transform_is_returned_unchanged() {
    let desk = Desk::new();
    let transform = r#"{"transform": {"tx_px": 0.25, "ty_px": -0.5, "rotation_deg": 0.1, "scale": 1.002}}"#;
    fs::write(desk.path("saved.json"), transform).unwrap();
    let saved = desk.path("saved.json");
    let report = desk.solved(["near.png", "far.png"], &["--transform", saved.to_str().unwrap(), "--hold"]);
    assert_eq!(report["method"], "aligned");
    for (name, value) in [("tx_px", 0.25), ("ty_px", -0.5), ("rotation_deg", 0.1), ("scale", 1.002)] {
        let found = report["frames"][1]["transform"][name].as_f64().unwrap();
        assert!((found - value).abs() < 1e-5, "{name} {found}");
    }
}

#[test]
fn a_pair_without_texture_gives_a_warning_and_zero_confidence() {
    let desk = Desk::new();
    let report = desk.solved(["grey.png", "grey.png"], &[]);
    assert_eq!(report["converged"], false);
    assert!(report["warnings"][0].as_str().unwrap().contains("texture"), "{report}");
    assert_eq!(report["mean_confidence"], 0.0);
}

#[test]
fn mixed_bit_depths_give_the_same_result_and_are_reported() {
    let desk = Desk::new();
    let image = image::open(desk.path("far.png")).unwrap();
    image::DynamicImage::from(image.to_rgb16()).save(desk.path("far16.png")).unwrap();
    image::DynamicImage::from(image.to_rgb32f()).save(desk.path("far32.tif")).unwrap();
    let median = |report: &Value| report["relative_blur"]["median"].as_f64().unwrap();
    let plain = desk.solved(["near.png", "far.png"], &[]);
    assert_eq!(plain["inputs"][0]["bits"], 8);
    for (name, bits) in [("far16.png", 16), ("far32.tif", 32)] {
        let report = desk.solved(["near.png", name], &[]);
        assert!((median(&report) - median(&plain)).abs() < 1e-3, "{name} {report}");
        let input = &report["inputs"][1];
        assert!(input["file"].as_str().unwrap().ends_with(name) && input["bits"] == bits, "{input}");
        assert!(input["sha256"].as_str().unwrap().len() == 64 && input["channels"] == 3, "{input}");
    }
}

#[test]
fn pixels_at_the_limit_of_v_do_not_count_as_measured() {
    let desk = Desk::new();
    let scene = ["simulate", "plane", "--range", "12", "--size", "160x120", "--quiet", "-o"];
    desk.command().args(scene).arg(desk.path("scene")).assert().success();
    let pair = ["scene/i1.png", "scene/i2.png"];
    let solve = |limit: &str| {
        let output = desk.solve(pair, &["--max-relative-blur", limit, "--json", "--no-html"]);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        (report, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (report, stderr) = solve("4");
    let number = |value: &Value| value.as_f64().unwrap();
    let valid = number(&report["valid_fraction"]);
    let at_limit = valid * number(&report["saturated_fraction"]);
    assert!(at_limit > 0.3, "{at_limit}");
    let marked = number(&report["texture"]["marked_fraction"]);
    assert!(marked >= at_limit - 1e-9 && marked < at_limit + 0.1, "{marked} {at_limit}");
    let (_, _, v) = parfocal::image_io::read_field(&desk.path("out/relative_blur.exr")).unwrap();
    let (_, _, sigma) = parfocal::image_io::read_field(&desk.path("out/uncertainty.exr")).unwrap();
    let bounds = v.iter().zip(&sigma).filter(|(v, _)| v.abs() >= 3.996);
    assert!(bounds.clone().count() > 5000 && bounds.clone().all(|(_, sigma)| *sigma == 1000.0));
    let white = image::open(desk.path("out/valid.png")).unwrap().into_luma8();
    let measured = white.pixels().filter(|pixel| pixel.0[0] == 255).count() as f64 / (160.0 * 120.0);
    assert!((measured - (valid - marked)).abs() < 1e-6, "{measured}");
    let stderr = stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    for part in [format!("{:.1} % of the pixels measured", 100.0 * measured), "raise max_relative_blur".to_string()] {
        assert!(stderr.contains(&part), "{part}: {stderr}");
    }
    // Beyond the range of the scene nothing is at the limit.
    let (report, _) = solve("36");
    assert!(number(&report["saturated_fraction"]) == 0.0 && number(&report["texture"]["marked_fraction"]) < 0.05);
}

#[test]
fn clipped_pixels_are_counted_and_too_many_leave_t_undetermined() {
    let desk = Desk::new();
    let scene = ["simulate", "relief", "--size", "160x120", "--quiet", "-o"];
    desk.command().args(scene).arg(desk.path("scene")).assert().success();
    // A share of the brightest pixels of both photographs is white. They are all over the frame.
    let solve = |share: f64| {
        let read = |name: &str| image::open(desk.path(name)).unwrap().into_luma16();
        let mut sorted: Vec<u16> = read("scene/i1.png").into_raw();
        sorted.sort_unstable();
        let white = sorted[(((1.0 - share) * sorted.len() as f64) as usize).min(sorted.len() - 1)].max(1);
        let clip = |value: u16| (u64::from(value) * 65535 / u64::from(white)).min(65535) as u16;
        let counts: Vec<f64> = ["i1.png", "i2.png"]
            .map(|name| {
                let mut picture = read(&format!("scene/{name}"));
                if share > 0.0 {
                    picture.iter_mut().for_each(|value| *value = clip(*value));
                }
                picture.save(desk.path(name)).unwrap();
                picture.iter().filter(|value| **value == 65535).count() as f64 / (160.0 * 120.0)
            })
            .to_vec();
        let output = desk.solve(["i1.png", "i2.png"], &["--json", "--no-html"]);
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        for (frame, count) in report["frames"].as_array().unwrap().iter().zip(&counts) {
            assert!((frame["clipped_fraction"].as_f64().unwrap() - count).abs() < 1e-9, "{frame}");
        }
        let warned = report["warnings"].to_string().contains("are clipped, so that");
        (report["converged"].as_bool().unwrap(), warned, stderr)
    };
    let (converged, warned, stderr) = solve(0.0);
    assert!(converged && !warned && !stderr.contains("clipped"), "{stderr}");
    let (converged, warned, stderr) = solve(0.02);
    assert!(converged && !warned && stderr.contains("clipped 2.0 % of the pixels of I1"), "{stderr}");
    for share in [0.6, 0.75, 0.92] {
        let (converged, warned, stderr) = solve(share);
        assert!(!converged && warned && stderr.contains("too few to determine the registration"), "{stderr}");
    }
    // Without the clipped area a pair is as good as any: most of the frame is masked, and nothing is said.
    let mask = image::GrayImage::from_fn(160, 120, |x, _| image::Luma([if x < 110 { 255 } else { 0 }]));
    mask.save(desk.path("mask.png")).unwrap();
    for name in ["i1.png", "i2.png"] {
        let mut picture = image::open(desk.path("scene").join(name)).unwrap().into_luma16();
        picture.enumerate_pixels_mut().filter(|(x, _, _)| *x >= 110).for_each(|(_, _, value)| value.0 = [65535]);
        picture.save(desk.path(name)).unwrap();
    }
    let report = desk.solved(["i1.png", "i2.png"], &["--no-html", "--mask", desk.path("mask.png").to_str().unwrap()]);
    assert_eq!(report["frames"][1]["clipped_fraction"], 0.0);
    assert!(report["converged"] == true && report["warnings"] == serde_json::json!([]), "{}", report["warnings"]);
}

#[test]
fn strict_fails_on_warnings_and_still_writes_the_results() {
    let desk = Desk::new();
    let output = desk.solve(["near.png", "near.png"], &["--strict", "--quiet"]);
    refused(&output, &["error: --strict", "same picture"]);
    assert!(desk.path("out/report.json").is_file());
    image::open(desk.path("far.png")).unwrap().to_luma8().save(desk.path("gray.png")).unwrap();
    let report = desk.solved(["near.png", "gray.png"], &[]);
    assert!(report["warnings"].to_string().contains("gray.png is grey and"), "{report}");
    assert!(!fs::read_to_string(desk.path("out/report.json")).unwrap().contains("-0.0,"));
}

#[test]
fn devices_are_listed() {
    let desk = Desk::new();
    let output = desk.command().args(["devices", "--json"]).output().unwrap();
    let devices: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(devices[0]["name"].is_string() && devices[0]["uuid"].as_str().unwrap().len() == 36, "{devices}");
    let text = String::from_utf8(desk.command().arg("devices").output().unwrap().stdout).unwrap();
    let name = devices[0]["name"].as_str().unwrap();
    assert!(
        text.starts_with(&format!("0  {name} (")) && text.contains("\n   usable") && text.contains("GiB"),
        "{text}"
    );
}

#[track_caller]
fn refused(output: &Output, parts: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(parts.iter().all(|part| stderr.contains(part)), "{stderr}");
}

#[test]
fn a_missing_device_gives_a_one_line_error_and_no_files() {
    let desk = Desk::new();
    let solve = |device: &[&str]| {
        let mut command = desk.command();
        let pair = ["near.png", "far.png"].map(|name| desk.path(name));
        command.arg("solve").args(pair).arg("-o").arg(desk.path("out")).args(device);
        command.env("PARFOCAL_DEVICE", "another GPU").output().unwrap()
    };
    refused(&solve(&["--device", "no such GPU"]), &["no such GPU"]);
    refused(&solve(&[]), &["PARFOCAL_DEVICE", "another GPU"]);
    let mut command = desk.command();
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(name, desk.path("no-driver.json"));
    }
    command.args(["solve", "--device", "vulkan"]).args(["near.png", "far.png"].map(|name| desk.path(name)));
    refused(&command.arg("-o").arg(desk.path("out")).output().unwrap(), &["no Vulkan device"]);
    assert!(!desk.path("out").exists());
}

#[test]
fn images_that_are_too_small_or_too_large_are_refused_by_file_name() {
    let desk = Desk::new();
    for (width, height, part) in [(1, 1, "at least"), (8, 8, "at least"), (40_000, 16, "too large")] {
        image::GrayImage::new(width, height).save(desk.path("odd.png")).unwrap();
        refused(&desk.solve(["odd.png", "odd.png"], &[]), &["odd.png", part]);
    }
    assert!(!desk.path("out").exists());
}

#[test]
fn a_damaged_pipeline_cache_is_ignored() {
    let desk = Desk::new();
    desk.solved(["near.png", "far.png"], &[]);
    let caches: Vec<PathBuf> = fs::read_dir(desk.path("cache/pipelines")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(caches.len(), 1, "{caches:?}");
    let whole = fs::read(&caches[0]).unwrap();
    fs::write(&caches[0], &whole[..whole.len() / 2]).unwrap();
    desk.solved(["near.png", "far.png"], &[]);
    assert_eq!(fs::read(&caches[0]).unwrap().len(), whole.len(), "the cache must be written again");
}
