//! Commands on the results of a focus sweep.

use std::fs;
use std::process::Output;

use parfocal::export::Registration;
use parfocal::image_io::{read, read_field};
use parfocal::resample::registered;
use parfocal::{settings::Decode, transform::Brightness};
use serde_json::Value;

use crate::desk::{Desk, assert_fails, stderr_of};
use crate::stack::{SIZE, Sweep, depth, planes, slope};

fn on(sweep: &Sweep, subcommand: &str, extra: &[&str]) -> Output {
    sweep.desk.run(&[&[subcommand, "out"], extra].concat())
}

/// Asserts success and returns the JSON on stdout, if any.
#[track_caller]
fn done(output: &Output) -> Value {
    assert!(output.status.success(), "{}", stderr_of(output));
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

fn report(sweep: &Sweep) -> Value {
    sweep.desk.report("out")
}

fn lists(report: &Value, name: &str) -> bool {
    report["files"].as_array().unwrap().iter().any(|file| file == name)
}

/// Whether a pixel of `depth.png` is filled in: more than half of its colour is white.
fn is_filled_in(sweep: &Sweep, x: u32, y: u32) -> bool {
    let picture = image::open(sweep.out().join("depth.png")).unwrap().into_rgba8();
    picture.get_pixel(x, y).0.iter().all(|c| *c >= 140)
}

#[test]
fn steps_profiles_and_views_work_as_for_a_pair() {
    let sweep = Sweep::new(5, planes);
    done(&sweep.stack(&["--quiet", "--no-html"]));
    let step = ["--step", "20,20,50,80", "120,20,50,80", "--profile", "10,64,180,64,9"];
    let measured = done(&on(&sweep, "measure", &[&step[..], &["--json"]].concat()));
    let focus = &measured["steps"][0]["difference"];
    let [value, error] = ["value", "standard_error"].map(|key| focus[key].as_f64().unwrap());
    assert!((value - 1.6).abs() < 0.1 && error > 0.0 && error < 0.1, "{focus}");
    assert!(measured["steps"][0]["depth_mm"].is_null() && measured["steps"][0]["quantity"] == "focus");
    let csv = sweep.desk.text("out/profile_1.csv");
    assert!(csv.starts_with("distance_px,x_px,y_px,focus_settings,focus_deviation_settings\n"), "{csv}");
    assert!(lists(&report(&sweep), "profile_1.png") && report(&sweep)["measurements"] == measured);

    // With focus distances steps are measured in mm.
    done(&on(&sweep, "depth", &["--focus-at", "0,0.5,1,1.5,2", "--stage", "--quiet"]));
    let output = on(&sweep, "measure", &[&step[..], &["--json"]].concat());
    let measured = done(&output);
    let depth = measured["steps"][0]["depth_mm"]["value"].as_f64().unwrap();
    assert!((depth - 0.8).abs() < 0.05, "{depth}");
    assert!(
        stderr_of(&output).contains("mm, +1.") && stderr_of(&output).contains("settings"),
        "{}",
        stderr_of(&output)
    );
    let csv = sweep.desk.text("out/profile_1.csv");
    assert!(csv.lines().next().unwrap().ends_with(",depth_mm,depth_deviation_mm"), "{csv}");

    done(&on(&sweep, "view", &["--width", "200"]));
    let view = image::open(sweep.out().join("view.png")).unwrap();
    assert!(view.width() >= 400);
    assert_fails(&on(&sweep, "view", &["-o", sweep.out().join("valid.png").to_str().unwrap()]), &["is a result"]);
    let refused = on(&sweep, "calibrate", &["--reference", "10,10,20,20", "230"]);
    assert!(!refused.status.success(), "{}", stderr_of(&refused));
}

#[test]
fn depth_command_gives_the_same_depth_as_stack() {
    let sweep = Sweep::new(5, slope);
    let inverse = |setting: f64| 1000.0 / (4.0 + 0.1 * setting);
    let at = (0..5).map(|n| inverse(f64::from(n)).to_string()).collect::<Vec<_>>().join(",");
    done(&sweep.stack(&["--quiet", "--focus-at", &at]));
    let [stated, _] = depth(&sweep);
    let at_once = sweep.desk.bytes("out/depth.png");

    done(&sweep.stack(&["--quiet", "--export", "depth16,ply"]));
    let (before, surface) = (report(&sweep), sweep.desk.bytes("out/surface.ply"));
    assert!(!sweep.out().join("depth_mm.exr").exists() && before["depth16"]["quantity"] == "focus");
    let printed = done(&on(&sweep, "depth", &["--focus-at", &at, "--json"]));
    let after = report(&sweep);
    assert!((printed["median"].as_f64().unwrap() - inverse(2.0)).abs() < 1.0, "{printed}");
    assert_eq!((&after["depth16"]["unit"], &after["nearer"]), (&"mm".into(), &2.into()));
    assert!((after["depth"]["median"].as_f64().unwrap() - printed["median"].as_f64().unwrap()).abs() < 1e-3);
    assert_eq!(after["frames"][1]["focus_mm"].as_f64(), Some(inverse(1.0)));
    assert_eq!((&after["focus"], &after["focus_unit"]), (&before["focus"], &"settings".into()));
    // Near and far are exchanged, so the surface and the page are written again.
    assert!(lists(&after, "depth_mm.exr") && lists(&after, "surface.ply"));
    assert_ne!(surface, sweep.desk.bytes("out/surface.ply"));
    assert!(sweep.desk.text("out/report.html").contains("field-depth"));
    let [later, _] = depth(&sweep);
    assert!(stated.iter().zip(&later).all(|(a, b)| a.is_nan() && b.is_nan() || (a - b).abs() < 0.01));
    let pictures = [image::load_from_memory(&at_once).unwrap(), image::open(sweep.out().join("depth.png")).unwrap()];
    let [a, b] = pictures.map(|picture| picture.into_rgba8());
    let off = a.pixels().zip(b.pixels()).filter(|(a, b)| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > 8)).count();
    assert!(a.dimensions() == b.dimensions() && off < 200, "{off}");

    // The page embeds the frames and does not need their files.
    fs::remove_file(&sweep.files[1]).unwrap();
    done(&on(&sweep, "depth", &["--focus-at", &at]));
    assert!(sweep.out().join("report.html").exists() && lists(&report(&sweep), "report.html"));

    for (extra, words) in [
        (&["--focus-at", "1,2,3"][..], "3 positions for 5 frames"),
        (&["--focus-at", "5,4,3,2,0"], "0 mm"),
        (&["--focal-length", "50"], "give --focus-at"),
        (&[], "give --focus-at"),
    ] {
        assert_fails(&on(&sweep, "depth", extra), &[words]);
    }
}

#[test]
fn pixels_without_focus_are_marked_and_exports_hold_the_others() {
    // Remove the texture in the middle of each frame.
    let sweep = Sweep::new(4, slope);
    for file in &sweep.files {
        let mut frame = image::open(file).unwrap().into_luma16();
        for (x, y) in (60..130).flat_map(|x| (30..100).map(move |y| (x, y))) {
            frame.put_pixel(x, y, image::Luma([32768]));
        }
        frame.save(file).unwrap();
    }
    let options =
        ["--export", "depth16,ply,cloud,glb,labels", "--colors", "grey", "--nearer", "2", "--mesh-cells", "48"];
    let found = done(&sweep.stack(&[&options[..], &["--json"]].concat()));
    let files = ["depth16.png", "depth16.tiff", "surface.ply", "points.ply", "surface.glb", "labels.png", "valid.png"];
    for name in files {
        assert!(lists(&found, name) && sweep.out().join(name).is_file(), "{name}");
    }
    let (width, _, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    let open = |name: &str| image::open(sweep.out().join(name)).unwrap();
    let (valid, depth16) = (open("valid.png").into_luma8(), open("depth16.png").into_luma16());
    let picture = open("depth.png").into_rgba8();
    let [scale, offset] = ["scale", "offset"].map(|key| found["depth16"][key].as_f64().unwrap());
    let mut unknown = 0;
    for (i, u) in focus.iter().enumerate() {
        let (x, y) = (i as u32 % width, i as u32 / width);
        assert_eq!(valid.get_pixel(x, y).0[0], if u.is_nan() { 0 } else { 255 });
        let [sample] = depth16.get_pixel(x, y).0;
        let back = offset + scale * f64::from(sample);
        assert!(if u.is_nan() { sample == 0 } else { (back - f64::from(*u)).abs() < 2.0 * scale }, "{u} {sample}");
        unknown += usize::from(u.is_nan());
    }
    assert!(unknown > 1000, "{unknown}");
    let mut within = (60..126).flat_map(|x| (30..100).map(move |y| (x, y)));
    let (x, y) = within.find(|&(x, y)| focus[(y * width + x) as usize].is_nan()).unwrap();
    assert!(is_filled_in(&sweep, x, y));
    // The last frame is near, which is white.
    let [left, right] = [20, 172].map(|x| picture.get_pixel(x, 10).0);
    assert!(left[0] < 60 && right[0] > 195 && left[0] == left[1], "{left:?} {right:?}");
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(sweep.out().join("labels.png")).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut labels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut labels).unwrap();
    let label = |x: usize, y: usize| labels[y * SIZE[0] as usize + x];
    assert_eq!([label(15, 10), label(x as usize, y as usize), label(185, 10)], [2, 0, 4]);
    let ply = sweep.desk.bytes("out/surface.ply");
    assert!(String::from_utf8_lossy(&ply[..600]).contains("reference frame"));
    done(&sweep.stack(&["--quiet"]));
    assert!(files[..6].iter().all(|name| !sweep.out().join(name).exists()));
}

#[test]
fn results_of_a_region_match_the_whole_and_a_mask_leaves_holes() {
    let sweep = Sweep::new(4, slope);
    let whole = done(&sweep.stack(&["--json", "--no-html"]));
    let (_, _, of_whole) = read_field(&sweep.out().join("focus.exr")).unwrap();
    let mask = sweep.desk.path("mask.png");
    let kept = image::GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        image::Luma([if (80..100).contains(&x) && (40..60).contains(&y) { 0 } else { 255 }])
    });
    kept.save(&mask).unwrap();
    let found = done(&sweep.stack(&["--json", "--roi", "60,30,90,70", "--mask", mask.to_str().unwrap()]));
    assert_eq!(found["region"], serde_json::json!({"x": 60, "y": 30, "width": 90, "height": 70}));
    assert_eq!(found["photograph"], serde_json::json!({"width": SIZE[0], "height": SIZE[1]}));
    let (width, height, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    assert_eq!((width, height), (90, 70));
    let mut off = Vec::new();
    for (i, u) in focus.iter().enumerate() {
        let (x, y) = (60 + i as u32 % 90, 30 + i as u32 / 90);
        let is_out = kept.get_pixel(x, y).0[0] == 0;
        assert!(!is_out || u.is_nan(), "{u} at {x}, {y}");
        off.extend((!is_out && !u.is_nan()).then(|| (u - of_whole[(y * SIZE[0] + x) as usize]).abs()));
    }
    off.sort_by(f32::total_cmp);
    assert!(off.len() > 5000 && off[off.len() / 2] < 0.05, "{} {}", off.len(), off[off.len() / 2]);
    assert!(is_filled_in(&sweep, 28, 20));
    let fused = read(&sweep.out().join("fused.png")).unwrap();
    assert_eq!((fused.width(), fused.height()), (90, 70));
    for n in 0..4 {
        let [part, all] = [&found, &whole].map(|report| report["frames"][n]["transform"]["tx_px"].as_f64().unwrap());
        assert!((part - all).abs() < 0.1, "{part} {all}");
    }
    assert!(sweep.desk.text("out/report.html").contains("field-focus"));
    done(&on(&sweep, "view", &["--width", "100"]));
    done(&on(&sweep, "depth", &["--focus-at", "1,2,3,4", "--stage", "--quiet"]));
    assert_eq!(read_field(&sweep.out().join("focus.exr")).unwrap().0, 90);

    let found = done(&sweep.stack(&["--json", "--crop-valid", "--mask", mask.to_str().unwrap(), "--no-html"]));
    let (_, _, focus) = read_field(&sweep.out().join("focus.exr")).unwrap();
    assert!(focus.iter().all(|u| u.is_finite()) && focus.len() < (SIZE[0] * SIZE[1]) as usize, "{}", found["size"]);

    let small = sweep.desk.path("small.png");
    image::GrayImage::new(9, 9).save(&small).unwrap();
    for (extra, words) in [
        (&["--mask", small.to_str().unwrap()][..], "is of 9x9"),
        (&["--roi", "100,100,200,10"], "not within"),
        (&["--crop-valid", "--step", "1,1,2,2", "3,3,2,2"], "--crop-valid moves"),
    ] {
        assert_fails(&sweep.stack(extra), &[words]);
    }
}

#[test]
fn frames_are_registered_and_aligned_to_the_reference() {
    let desk = Desk::new();
    let (path, run) = (|name: &str| desk.path(name), |arguments: &[&str]| desk.run(arguments));
    let scene = ["simulate", "relief", "-o", "sweep", "--frames", "4", "--size", "120x90", "--quiet"];
    done(&run(&[&scene[..], &["--breathing", "2", "--drift", "3"]].concat()));
    let found = done(&run(&["register", "sweep", "-o", "rig.json", "--json"]));
    let written = desk.json("rig.json");
    assert_eq!(written["frames"].as_array().unwrap().len(), 4);
    let solved = done(&run(&["stack", "sweep", "-o", "out", "--json", "--roi", "20,10,60,50"]));
    let tx = |report: &Value, n: usize| report["frames"][n]["transform"]["tx_px"].as_f64().unwrap();
    for n in 0..4 {
        assert!((tx(&found, n) - tx(&written, n)).abs() < 1e-9 && (tx(&found, n) - tx(&solved, n)).abs() < 0.3);
    }
    let frames = [1, 2, 3, 4].map(|n| format!("sweep/frame_0{n}.png"));
    let images = frames.each_ref().map(String::as_str);
    done(&run(&[&["apply"], &images[..], &["--transform", "rig.json", "-o", "aligned", "--json"]].concat()));
    let frame = |name: &str| read(&path(name)).unwrap();
    assert_eq!(frame("aligned/frame_03.png"), frame("sweep/frame_03.png"), "the reference must not change");
    let (transform, none) = (Registration::read(&path("rig.json")).unwrap().frames[0].transform, [120, 90]);
    let moved = registered(&frame(images[0]), &transform, &Brightness::identity(none), Decode::None);
    let aligned = frame("aligned/frame_01.png");
    assert_eq!(aligned.format(), frame(images[0]).format());
    assert!(aligned == moved && aligned != frame(images[0]));

    // `apply` also accepts the report of `stack`, with its region, and a folder of frames.
    let applied =
        done(&run(&["apply", "sweep", "--transform", "out/report.json", "-o", "part", "--exposure", "--json"]));
    assert_eq!(applied["files"].as_array().unwrap().len(), 4);
    assert_eq!((frame("part/frame_01.png").width(), frame("part/frame_01.png").height()), (60, 50));
    // An earlier registration is replaced; a foreign file is not.
    done(&run(&["register", "sweep", "-o", "rig.json", "--reference", "1", "--quiet"]));
    assert_fails(&run(&["register", "sweep", "-o", "sweep/truth.json"]), &["--force"]);

    assert_fails(
        &run(&[&["apply"], &images[..3], &["--transform", "rig.json", "-o", "few"]].concat()),
        &["registers 4 frames, and 3"],
    );
    image::GrayImage::new(9, 9).save(path("sweep/frame_04.png")).unwrap();
    assert_fails(&run(&["apply", "sweep", "--transform", "rig.json", "-o", "none"]), &["frame_04.png: is 9x9"]);
    assert!(!path("none").exists(), "no file may be written if one is refused");
    for (extra, words) in [(&["--method", "sift"][..], "--method"), (&["--reference", "9"], "no reference frame 9")] {
        assert_fails(&run(&[&["register", "sweep"], extra].concat()), &[words]);
    }
}

#[test]
fn a_damaged_folder_is_refused_with_a_reason() {
    let sweep = Sweep::new(3, planes);
    done(&sweep.stack(&["--quiet", "--no-html"]));
    let good = report(&sweep);
    let json = sweep.out().join("report.json");
    let damages: [(&str, Value); 6] = [
        ("frames", serde_json::json!([])),
        ("reference", 99.into()),
        ("size", serde_json::json!({"width": 7, "height": 4_000_000})),
        ("region", serde_json::json!({"x": 4_294_967_295u32, "y": 0, "width": 192, "height": 128})),
        ("values", serde_json::json!({"decode": "rot13", "by": "files"})),
        ("nearer", Value::Null),
    ];
    for (key, value) in damages {
        let mut bad = good.clone();
        bad[key] = value;
        fs::write(&json, bad.to_string()).unwrap();
        for (subcommand, extra) in [
            ("view", &["--width", "64"][..]),
            ("measure", &["--step", "1,1,9,9", "20,20,9,9"]),
            ("depth", &["--focus-at", "1,2,3"]),
        ] {
            let output = on(&sweep, subcommand, extra);
            let stderr = stderr_of(&output);
            assert!(
                output.status.code() == Some(1) && stderr.contains("again") && stderr.lines().count() == 1,
                "{key}: {stderr}"
            );
        }
    }
    fs::write(&json, good.to_string()).unwrap();
    fs::write(sweep.out().join("focus.exr"), "no image").unwrap();
    assert_fails(&on(&sweep, "view", &[]), &["focus.exr"]);
}
