//! `parfocal simulate`: the files that it writes and the input that it refuses. No test needs a device.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use parfocal::{
    Frame, export,
    frame::{Channels, Samples},
    image_io,
};
use serde_json::Value;

use crate::desk::{Desk, assert_refused, stderr_of};

fn run(desk: &Desk, scene: &str, extra: &[&str]) -> Output {
    desk.run(&[&["simulate", scene, "-o", "made/out"], extra].concat())
}

/// Renders a scene and returns truth.json.
#[track_caller]
fn simulate(desk: &Desk, scene: &str, extra: &[&str]) -> Value {
    let truth = desk.printed(&[&["simulate", scene, "-o", "made/out"], extra].concat());
    assert_eq!(desk.json("made/out/truth.json"), truth);
    truth
}

fn out(desk: &Desk, name: &str) -> PathBuf {
    desk.path("made/out").join(name)
}

#[track_caller]
fn refuses(desk: &Desk, scene: &str, extra: &[&str], status: i32, parts: &[&str]) {
    assert_refused(&run(desk, scene, extra), status, parts);
    assert!(!desk.has("made"));
}

fn floats(path: &Path) -> Vec<f32> {
    match image_io::read(path).unwrap().samples() {
        Samples::F32(values) => values.clone(),
        other => panic!("{other:?}"),
    }
}

fn words(frame: &Frame) -> &[u16] {
    match frame.samples() {
        Samples::U16(values) => values,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_scene_writes_its_files_and_the_truth() {
    let plain = ["plane", "half-gaussian-texture", "half-gaussian-dots", "cylinders", "steps", "relief"];
    for scene in plain.into_iter().chain(["card", "blocks", "bars"]) {
        let desk = Desk::new();
        let truth = simulate(&desk, scene, &["--size", "48x32"]);
        let (i1, i2) = image_io::read_pair(&out(&desk, "i1.png"), &out(&desk, "i2.png")).unwrap();
        assert_eq!((i1.width(), i1.height(), i1.format().channels), (48, 32, Channels::Gray));
        assert!(words(&i1).len() == 48 * 32 && words(&i1) != words(&i2));
        assert_eq!(floats(&out(&desk, "relative_blur.exr")).len(), 48 * 32);
        let occlusion = if plain.contains(&scene) { "ignored" } else { "rendered" };
        let has_lens = scene == "cylinders" || occlusion == "rendered";
        assert_eq!(out(&desk, "depth.exr").exists(), has_lens);
        assert_eq!(truth["lens"].is_object(), has_lens);
        assert_eq!(truth["depth"].is_string(), has_lens);
        assert_eq!((truth["scene"].as_str(), truth["occlusion"].as_str()), (Some(scene), Some(occlusion)));
        assert_eq!(truth["clipped_samples"], 0);
        let kernel = if scene.starts_with("half") { "half-gaussian" } else { "gaussian" };
        assert_eq!(truth["kernel"], if occlusion == "rendered" { "pillbox" } else { kernel });
    }
}

#[test]
fn the_truth_is_a_readable_registration_and_the_seed_fixes_the_files() {
    let desk = Desk::new();
    let options = ["--size", "48x32", "--noise", "0.01", "--i2-gain", "0.9", "--i2-offset", "0.05", "--seed", "7"];
    let moved = ["--translation", "-2,0.5", "--rotation", "-1", "--scale", "0.98"];
    let all = [&options[..], &moved].concat();
    simulate(&desk, "relief", &all);
    let registration = export::Registration::read(&out(&desk, "truth.json")).unwrap();
    let second = registration.second().unwrap();
    let (t, photometric) = (second.transform, second.photometric());
    assert_eq!((t.translation(), t.scale()), ([-2.0, 0.5], 0.98));
    assert!((t.rotation_deg() + 1.0).abs() < 1e-12);
    let p = photometric.unwrap();
    assert!((p.gain - 1.0 / 0.9).abs() < 1e-12 && (p.offset + 0.05 / 0.9).abs() < 1e-12);
    let first = ["i1.png", "i2.png", "relative_blur.exr"].map(|name| fs::read(out(&desk, name)).unwrap());
    simulate(&desk, "relief", &all);
    assert_eq!(first, ["i1.png", "i2.png", "relative_blur.exr"].map(|name| fs::read(out(&desk, name)).unwrap()));
}

#[test]
fn depth_of_an_earlier_scene_is_removed() {
    let desk = Desk::new();
    simulate(&desk, "cylinders", &["--size", "48x32"]);
    assert!(out(&desk, "depth.exr").exists());
    simulate(&desk, "steps", &["--size", "48x32"]);
    assert!(!out(&desk, "depth.exr").exists());
}

#[test]
fn a_colour_texture_on_a_depth_map_is_rendered() {
    let desk = Desk::new();
    let color = |x: u32, y: u32| image::Rgb([(5 * x) as u8, (7 * y) as u8, (3 * x + 2 * y) as u8]);
    image::RgbImage::from_fn(40, 24, color).save(desk.path("photo.png")).unwrap();
    let depth = |x: u32, _| image::Luma([(20_000 + 100 * x) as u16]);
    image::ImageBuffer::<_, Vec<u16>>::from_fn(40, 24, depth).save(desk.path("depth.png")).unwrap();
    let lens = ["--focal-length", "50", "--f-number", "2.8", "--pixel-pitch", "0.02", "--focus", "200,240"];
    let files = ["--radiance", "photo.png", "--depth", "depth.png", "--depth-unit", "0.01"];
    let truth = simulate(&desk, "image", &[&files[..], &lens, &["--kernel", "pillbox"]].concat());
    assert_eq!(image_io::read(&out(&desk, "i2.png")).unwrap().format().channels, Channels::Rgb);
    assert_eq!(floats(&out(&desk, "depth.exr"))[39], 239.0);
    let v = floats(&out(&desk, "relative_blur.exr"));
    assert!(v[0] > 0.0 && v[39] < 0.0, "V must be positive in the near part, where I1 is in focus");
    assert_eq!(truth["shape"]["kind"], "depth-file");
    assert_eq!(truth["size"]["width"], 40);
}

#[test]
fn relative_blur_read_from_a_file_is_reproduced() {
    let desk = Desk::new();
    simulate(&desk, "relief", &["--size", "48x32"]);
    fs::rename(desk.path("made/out"), desk.path("first")).unwrap();
    simulate(&desk, "image", &["--radiance", "first/i1.png", "--relative-blur", "first/relative_blur.exr"]);
    for (a, b) in floats(&desk.path("first/relative_blur.exr")).iter().zip(floats(&out(&desk, "relative_blur.exr"))) {
        assert!((a - b).abs() < 1e-5);
    }
}

#[test]
fn invalid_scenes_are_refused() {
    let desk = Desk::new();
    image::GrayImage::new(40, 24).save(desk.path("photo.png")).unwrap();
    image::GrayImage::new(30, 24).save(desk.path("other.png")).unwrap();
    let lens = ["--focal-length", "50", "--f-number", "2.8", "--pixel-pitch", "0.02", "--focus", "200,240"];
    let with_lens = |files: &[&'static str]| [files, &lens].concat();
    let usage: [(&str, Vec<&str>, &str); 17] = [
        ("plane", vec!["--size", "99999x99999"], "number of pixels"),
        ("plane", vec!["--size", "wide"], "640x480"),
        ("plane", vec!["--noise", "-0.1"], "noise is -0.1"),
        ("plane", vec!["--noise", "nan"], "noise"),
        ("plane", vec!["--contrast", "2"], "contrast"),
        ("plane", vec!["--i2-gain", "0"], "gain of I2"),
        ("plane", vec!["--scale", "-1"], "scale"),
        ("plane", vec!["--range", "-4"], "largest relative blur"),
        ("half-gaussian-dots", vec!["--sigma", "-17"], "uniform relative blur"),
        ("plane", vec!["--sigma", "2"], "--sigma"),
        ("cylinders", vec!["--range", "2"], "--range"),
        ("cylinders", vec!["--focus", "200,200"], "focus distance"),
        ("steps", vec!["--focus", "200,240"], "lens"),
        ("relief", vec!["--radiance", "photo.png"], "image"),
        ("image", vec!["--radiance", "photo.png"], "needs a shape"),
        ("image", vec!["--radiance", "photo.png", "--depth", "photo.png"], "needs the lens"),
        ("pyramid", vec![], "pyramid"),
    ];
    for (scene, extra, part) in usage {
        refuses(&desk, scene, &extra, 2, &[part]);
    }
    let failed: [(&str, Vec<&str>, &[&str]); 6] = [
        ("plane", vec!["--size", "8x8"], &["8x8 is too small"]),
        ("image", vec!["--radiance", "none.png", "--relative-blur", "v.exr"], &["none.png", "no such file"]),
        ("image", vec!["--radiance", "photo.png", "--relative-blur", "v.exr"], &["v.exr", "no such file"]),
        ("image", vec!["--radiance", "photo.png", "--relative-blur", "photo.png"], &["photo.png", "floats"]),
        ("image", with_lens(&["--radiance", "photo.png", "--depth", "other.png"]), &["other.png", "30x24"]),
        ("image", with_lens(&["--radiance", "photo.png", "--depth", "photo.png"]), &["photo.png", "depth of 0 mm"]),
    ];
    for (scene, extra, parts) in failed {
        refuses(&desk, scene, &extra, 1, parts);
    }
}

#[test]
fn an_input_is_not_overwritten() {
    let desk = Desk::new();
    simulate(&desk, "relief", &["--size", "48x32"]);
    let before = fs::read(out(&desk, "i1.png")).unwrap();
    let files = ["--radiance", "made/out/i1.png", "--relative-blur", "made/out/relative_blur.exr"];
    assert_refused(&run(&desk, "image", &files), 1, &["would replace it"]);
    assert_eq!(fs::read(out(&desk, "i1.png")).unwrap(), before);
}

#[test]
fn clipping_is_reported() {
    let desk = Desk::new();
    let output = run(&desk, "plane", &["--size", "32x32", "--i2-gain", "1.5"]);
    assert!(output.status.success());
    assert!(stderr_of(&output).contains("were clipped"));
}

#[test]
fn a_sweep_writes_its_frames_focus_and_truth() {
    let desk = Desk::new();
    let moved = ["--breathing", "5", "--drift", "4", "--rotation", "0.3", "--gain-drift", "5", "--blur-rate", "0.5"];
    let moved = [&moved[..], &["--vignetting", "6"]].concat();
    for scene in ["plane", "relief", "steps", "cylinders", "card", "blocks", "bars"] {
        let truth =
            simulate(&desk, scene, &[&["--frames", "5", "--size", "48x32", "--noise", "0.005"][..], &moved].concat());
        let names: Vec<&str> = truth["files"].as_array().unwrap().iter().map(|f| f.as_str().unwrap()).collect();
        let frames = ["frame_01.png", "frame_02.png", "frame_03.png", "frame_04.png", "frame_05.png"];
        assert_eq!(names, [&frames[..], &["focus.exr", "truth.json"]].concat());
        assert_eq!(
            fs::read_dir(desk.path("made/out")).unwrap().count(),
            7,
            "{scene}: files of the last scene must be removed"
        );
        for (k, (name, expected)) in frames.iter().zip(truth["frames"].as_array().unwrap()).enumerate() {
            assert_eq!((expected["file"].as_str(), expected["position"].as_f64()), (Some(*name), Some(k as f64)));
            let frame = image_io::read(&out(&desk, name)).unwrap();
            assert_eq!((frame.width(), frame.height(), words(&frame).len()), (48, 32, 48 * 32));
            let (gain, undone) = (&expected["exposure"]["gain"], &expected["gain"]);
            assert!((gain.as_f64().unwrap() - (0.95 + 0.025 * k as f64)).abs() < 1e-12);
            assert!((gain.as_f64().unwrap() * undone.as_f64().unwrap() - 1.0).abs() < 1e-12);
            assert!((expected["vignetting"].as_f64().unwrap() - 0.03 * (k as f64 - 2.0)).abs() < 1e-12);
        }
        assert_eq!((&truth["reference"], &truth["blur_rate_px2"]), (&2.into(), &0.5.into()));
        let of = |k: usize, what: &str| truth["frames"][k]["transform"][what].as_f64().unwrap();
        assert_eq!(["tx_px", "ty_px", "rotation_deg", "scale"].map(|what| of(2, what)), [0.0, 0.0, 0.0, 1.0]);
        let over = |what: &str| of(4, what) - of(0, what);
        assert!((over("tx_px").hypot(over("ty_px")) - 4.0).abs() < 1e-9);
        assert!((over("rotation_deg") - 0.3).abs() < 1e-9 && (over("scale") - 0.05).abs() < 1e-9);
        let focus = floats(&out(&desk, "focus.exr"));
        assert!(focus.len() == 48 * 32 && focus.iter().all(|u| (0.39..3.61).contains(u)), "{scene}");
    }
    // A pair replaces the files of the sweep.
    simulate(&desk, "plane", &["--size", "48x32"]);
    assert!(!out(&desk, "frame_01.png").exists() && out(&desk, "i1.png").exists());
}

#[test]
fn invalid_sweep_options_are_refused() {
    let desk = Desk::new();
    let five = |extra: &[&'static str]| [&["--frames", "5"], extra].concat();
    for (scene, extra, part) in [
        ("plane", vec!["--frames", "2"], "number of frames is 2"),
        ("plane", vec!["--frames", "1000"], "number of frames"),
        ("plane", vec!["--frames", "five"], "invalid value"),
        ("plane", vec!["--frames", "999", "--size", "2000x2000"], "pixels of all frames"),
        ("plane", vec!["--breathing", "5"], "--frames"),
        ("plane", five(&["--breathing", "21"]), "breathing"),
        ("plane", five(&["--drift", "-1"]), "drift"),
        ("plane", five(&["--gain-drift", "nan"]), "gain drift"),
        ("plane", five(&["--vignetting", "51"]), "vignetting"),
        ("plane", five(&["--blur-rate", "0"]), "blur rate"),
        ("plane", five(&["--blur-rate", "100"]), "largest variance"),
        ("plane", five(&["--range", "2"]), "--range"),
        ("plane", five(&["--translation", "1,1"]), "--drift"),
        ("plane", five(&["--scale", "1.1"]), "--breathing"),
        ("plane", five(&["--i2-gain", "1.1"]), "--gain-drift"),
        ("cylinders", five(&["--focus", "200,240"]), "the lens"),
    ] {
        refuses(&desk, scene, &extra, 2, &[part]);
    }
    refuses(&desk, "half-gaussian-dots", &five(&[]), 1, &["no depth to sweep through"]);
    desk.write("made/out/frame_03.png", "mine");
    assert_refused(&run(&desk, "plane", &five(&["--size", "32x32"])), 1, &["frame_03.png", "--force"]);
    assert_eq!(desk.text("made/out/frame_03.png"), "mine");
}
