//! `parfocal solve` on Vulkan: its files, its output, and its errors without a device.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use serde_json::Value;

use crate::desk::{Desk, assert_refused_in_one_line, printed, stderr_of};
use crate::synthetic::waves;

const RESULTS: [&str; 6] =
    ["relative_blur.exr", "confidence.exr", "depth.png", "fused.png", "report.json", "uncertainty.exr"];

/// Returns a folder with a pair that differs in blur and a photograph of constant grey.
fn desk() -> Desk {
    let desk = Desk::new();
    for (name, contrast) in [("near.png", 90.0), ("far.png", 70.0), ("grey.png", 0.0)] {
        let value = |x: u32, y: u32| (128.0 + contrast / 3.0 * waves(x, y)) as u8;
        let image = image::RgbImage::from_fn(96, 64, |x, y| image::Rgb([value(x, y), value(x, y), value(x, y) / 2]));
        image.save(desk.path(name)).unwrap();
    }
    desk
}

fn solve(desk: &Desk, [i1, i2]: [&str; 2], extra: &[&str]) -> Output {
    desk.run(&[&["solve", i1, i2, "-o", "out"], extra].concat())
}

/// Solves a pair and returns its report.
#[track_caller]
fn solved(desk: &Desk, [i1, i2]: [&str; 2], extra: &[&str]) -> Value {
    let report = desk.printed(&[&["solve", i1, i2, "-o", "out"], extra].concat());
    for name in RESULTS {
        assert!(desk.path("out").join(name).is_file(), "{name} is missing");
    }
    assert_eq!(desk.report("out"), report);
    report
}

#[test]
fn solve_writes_five_files_and_prints_the_report_on_stdout() {
    let desk = desk().on_vulkan();
    let report = solved(&desk, ["near.png", "far.png"], &["--timings"]);
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
    let desk = desk();
    let pair = ["near.png", "far.png"];
    let files = ["surface.ply", "points.ply", "surface.glb"].map(|name| desk.path("out").join(name));
    solved(&desk, pair, &["--export", "ply,cloud,glb,ply", "--mesh-cells", "48", "--z-scale", "2.5"]);
    let [mesh, cloud, glb] = files.each_ref().map(|file| fs::read(file).unwrap());
    let holds = |bytes: &[u8], text: &str| bytes.windows(text.len()).any(|w| w == text.as_bytes());
    assert!(holds(&mesh, "2.5 px per px^2") && holds(&mesh, "element face") && !holds(&cloud, "element face"));
    assert!(glb.starts_with(b"glTF") && glb.len() % 4 == 0 && mesh.len() < 2 * cloud.len());
    solved(&desk, pair, &["--export", "glb", "--no-html"]);
    assert!(files[2].is_file() && !files[0].exists() && !files[1].exists());
    for wrong in [&["--export", "step"][..], &["--z-scale", "-1"], &["--mesh-cells", "1"]] {
        assert_eq!(solve(&desk, pair, wrong).status.code(), Some(2));
    }
    // An empty surface is not an error.
    solved(&desk, ["grey.png", "grey.png"], &["--export", "ply,cloud,glb", "--max-relative-blur", "256"]);
}

#[test]
fn a_held_transform_is_returned_unchanged() {
    let desk = desk();
    let transform = r#"{"transform": {"tx_px": 0.25, "ty_px": -0.5, "rotation_deg": 0.1, "scale": 1.002}}"#;
    desk.write("saved.json", transform);
    let report = solved(&desk, ["near.png", "far.png"], &["--transform", "saved.json", "--hold"]);
    assert_eq!(report["method"], "aligned");
    for (name, value) in [("tx_px", 0.25), ("ty_px", -0.5), ("rotation_deg", 0.1), ("scale", 1.002)] {
        let found = report["frames"][1]["transform"][name].as_f64().unwrap();
        assert!((found - value).abs() < 1e-5, "{name} {found}");
    }
}

#[test]
fn a_pair_without_texture_gives_a_warning_and_zero_confidence() {
    let desk = desk().on_vulkan();
    let report = solved(&desk, ["grey.png", "grey.png"], &[]);
    assert_eq!(report["converged"], false);
    assert!(report["warnings"][0].as_str().unwrap().contains("texture"), "{report}");
    assert_eq!(report["mean_confidence"], 0.0);
}

#[test]
fn mixed_bit_depths_give_the_same_result_and_are_reported() {
    let desk = desk();
    let image = image::open(desk.path("far.png")).unwrap();
    image::DynamicImage::from(image.to_rgb16()).save(desk.path("far16.png")).unwrap();
    image::DynamicImage::from(image.to_rgb32f()).save(desk.path("far32.tif")).unwrap();
    let median = |report: &Value| report["relative_blur"]["median"].as_f64().unwrap();
    let plain = solved(&desk, ["near.png", "far.png"], &[]);
    assert_eq!(plain["inputs"][0]["bits"], 8);
    for (name, bits) in [("far16.png", 16), ("far32.tif", 32)] {
        let report = solved(&desk, ["near.png", name], &[]);
        assert!((median(&report) - median(&plain)).abs() < 1e-3, "{name} {report}");
        let input = &report["inputs"][1];
        assert!(input["file"].as_str().unwrap().ends_with(name) && input["bits"] == bits, "{input}");
        assert!(input["sha256"].as_str().unwrap().len() == 64 && input["channels"] == 3, "{input}");
    }
}

#[test]
fn pixels_at_the_limit_of_v_do_not_count_as_measured() {
    let desk = desk();
    let scene = ["simulate", "plane", "--range", "12", "--size", "160x120", "--quiet", "-o", "scene"];
    desk.done(&scene);
    let pair = ["scene/i1.png", "scene/i2.png"];
    let limited = |limit: &str| {
        let output = solve(&desk, pair, &["--max-relative-blur", limit, "--json", "--no-html"]);
        let report = printed(&output);
        (report, stderr_of(&output))
    };
    let (report, stderr) = limited("4");
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
    let (report, _) = limited("36");
    assert!(number(&report["saturated_fraction"]) == 0.0 && number(&report["texture"]["marked_fraction"]) < 0.05);
}

#[test]
fn clipped_pixels_are_counted_and_too_many_leave_t_undetermined() {
    let desk = desk();
    let scene = ["simulate", "relief", "--size", "160x120", "--quiet", "-o", "scene"];
    desk.done(&scene);
    // A share of the brightest pixels of both photographs is white. They are all over the frame.
    let clipped = |share: f64| {
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
        let output = solve(&desk, ["i1.png", "i2.png"], &["--json", "--no-html"]);
        let report = printed(&output);
        let stderr = stderr_of(&output).split_whitespace().collect::<Vec<_>>().join(" ");
        for (frame, count) in report["frames"].as_array().unwrap().iter().zip(&counts) {
            assert!((frame["clipped_fraction"].as_f64().unwrap() - count).abs() < 1e-9, "{frame}");
        }
        let warned = report["warnings"].to_string().contains("are clipped, so that");
        (report["converged"].as_bool().unwrap(), warned, stderr)
    };
    let (converged, warned, stderr) = clipped(0.0);
    assert!(converged && !warned && !stderr.contains("clipped"), "{stderr}");
    let (converged, warned, stderr) = clipped(0.02);
    assert!(converged && !warned && stderr.contains("clipped 2.0 % of the pixels of I1"), "{stderr}");
    for share in [0.6, 0.75, 0.92] {
        let (converged, warned, stderr) = clipped(share);
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
    let report = solved(&desk, ["i1.png", "i2.png"], &["--no-html", "--mask", "mask.png"]);
    assert_eq!(report["frames"][1]["clipped_fraction"], 0.0);
    assert!(report["converged"] == true && report["warnings"] == serde_json::json!([]), "{}", report["warnings"]);
}

#[test]
fn strict_fails_on_warnings_and_still_writes_the_results() {
    let desk = desk();
    let output = solve(&desk, ["near.png", "near.png"], &["--strict", "--quiet"]);
    assert_refused_in_one_line(&output, 1, &["error: --strict", "same picture"]);
    assert!(desk.path("out/report.json").is_file());
    image::open(desk.path("far.png")).unwrap().to_luma8().save(desk.path("gray.png")).unwrap();
    let report = solved(&desk, ["near.png", "gray.png"], &[]);
    assert!(report["warnings"].to_string().contains("gray.png is grey and"), "{report}");
    assert!(!desk.text("out/report.json").contains("-0.0,"));
}

#[test]
fn devices_are_listed() {
    let desk = desk();
    let devices = desk.printed(&["devices"]);
    assert!(devices[0]["name"].is_string() && devices[0]["uuid"].as_str().unwrap().len() == 36, "{devices}");
    let text = String::from_utf8(desk.done(&["devices"]).stdout).unwrap();
    let name = devices[0]["name"].as_str().unwrap();
    assert!(
        text.starts_with(&format!("0  {name} (")) && text.contains("\n   usable") && text.contains("GiB"),
        "{text}"
    );
}

#[test]
fn a_missing_device_gives_a_one_line_error_and_no_files() {
    let desk = desk();
    let solve_on = |device: &[&str]| {
        let mut command = desk.command(&["solve", "near.png", "far.png", "-o", "out"]);
        command.args(device).env("PARFOCAL_DEVICE", "another GPU").output().unwrap()
    };
    assert_refused_in_one_line(&solve_on(&["--device", "no such GPU"]), 1, &["no such GPU"]);
    assert_refused_in_one_line(&solve_on(&[]), 1, &["PARFOCAL_DEVICE", "another GPU"]);
    let mut command = desk.command(&["solve", "near.png", "far.png", "-o", "out", "--device", "vulkan"]);
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(name, desk.path("no-driver.json"));
    }
    assert_refused_in_one_line(&command.output().unwrap(), 1, &["no Vulkan device"]);
    assert!(!desk.has("out"));
}

#[test]
fn images_that_are_too_small_or_too_large_are_refused_by_file_name() {
    let desk = desk().on_vulkan();
    for (width, height, part) in [(1, 1, "at least"), (8, 8, "at least"), (40_000, 16, "too large")] {
        image::GrayImage::new(width, height).save(desk.path("odd.png")).unwrap();
        assert_refused_in_one_line(&solve(&desk, ["odd.png", "odd.png"], &[]), 1, &["odd.png", part]);
    }
    assert!(!desk.has("out"));
}

#[test]
fn a_damaged_pipeline_cache_is_ignored() {
    let desk = desk().on_vulkan();
    solved(&desk, ["near.png", "far.png"], &[]);
    let caches: Vec<PathBuf> = fs::read_dir(desk.path("cache/pipelines")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(caches.len(), 1, "{caches:?}");
    let whole = fs::read(&caches[0]).unwrap();
    fs::write(&caches[0], &whole[..whole.len() / 2]).unwrap();
    solved(&desk, ["near.png", "far.png"], &[]);
    assert_eq!(fs::read(&caches[0]).unwrap().len(), whole.len(), "the cache must be written again");
}
