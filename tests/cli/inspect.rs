//! `parfocal inspect`: a part that is shifted against the golden part, with and without a bump.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::Value;

use crate::desk::{Desk, printed, stderr_of};

/// Inspects a part against the golden part and asserts the exit status.
#[track_caller]
fn inspect(desk: &Desk, part: &str, status: i32, extra: &[&str]) -> Output {
    desk.exits(&[&["inspect", part, "--golden", "golden", "--tolerance", "1"], extra].concat(), status)
}

/// States the file's present size and SHA-256 in the report, as if the solve had written it.
fn sign(folder: &Path, name: &str) {
    let file = folder.join(name);
    let output = std::process::Command::new("sha256sum").arg(&file).output().unwrap();
    let sha256 = String::from_utf8(output.stdout).unwrap().split(' ').next().unwrap().to_string();
    let path = folder.join("report.json");
    let mut report: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    report["hashes"][name] = serde_json::json!({ "bytes": fs::metadata(&file).unwrap().len(), "sha256": sha256 });
    fs::write(&path, report.to_string()).unwrap();
}

/// Adds a square bump of 4 px², 12 px wide, to V of a results folder.
fn add_bump(folder: &Path, [left, top]: [u32; 2]) {
    use exr::prelude::*;
    let file = folder.join("relative_blur.exr");
    let (width, height, mut values) = parfocal::image_io::read_field(&file).unwrap();
    for (i, v) in (0u32..).zip(&mut values) {
        let (x, y) = (i % width, i / width);
        let within = (left..left + 12).contains(&x) && (top..top + 12).contains(&y);
        *v += if within { 4.0 } else { 0.0 };
    }
    let size = (width as usize, height as usize);
    let value = move |at: Vec2<usize>| (values[at.y() * size.0 + at.x()],);
    let channels = SpecificChannels::build().with_channel("Y").with_pixel_fn(value);
    Image::from_channels(size, channels).write().to_file(&file).unwrap();
    sign(folder, "relative_blur.exr");
}

#[test]
fn a_shifted_part_is_go_and_a_part_with_a_bump_is_no_go() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "shots", "--size", "160x120"]);
    // The part lies 6 px further left and 4 px higher than the golden part.
    for (out, region) in [("golden", "0,0,144,108"), ("part", "6,4,144,108")] {
        desk.done(&["solve", "shots/i1.png", "shots/i2.png", "-o", out, "--roi", region, "--no-html"]);
    }
    let output = inspect(&desk, "part", 0, &["--json"]);
    let found = printed(&output);
    assert_eq!((&found["verdict"], &found["unit"]), (&"go".into(), &"px²".into()));
    let [x, y] = ["tx_px", "ty_px"].map(|name| found["transform"][name].as_f64().unwrap());
    assert!((x + 6.0).hypot(y + 4.0) < 0.2, "{x}, {y}");
    assert!(!desk.has("part/inspect.json"), "inspect.json is written only with -o");

    add_bump(&desk.path("part"), [70, 50]);
    let output = inspect(&desk, "part", 3, &["-o", "part"]);
    assert!(
        !stderr_of(&output).contains("error:") && stderr_of(&output).contains("verdict        no-go"),
        "{}",
        stderr_of(&output)
    );
    let report = desk.json("part/inspect.json");
    let region = &report["regions"][0];
    let number = |value: &Value| value.as_f64().unwrap();
    assert_eq!(report["regions"].as_array().unwrap().len(), 1, "{report:#}");
    assert!(
        (number(&region["area_px"]) - 144.0).abs() < 24.0 && (number(&region["mean"]) - 4.0).abs() < 0.5,
        "{region}"
    );
    let places = [("centroid_px", [81.5, 59.5]), ("centroid_in_part_px", [75.5, 55.5])];
    for (name, place) in places {
        let off = (number(&region[name][0]) - place[0]).hypot(number(&region[name][1]) - place[1]);
        assert!(off < 0.7, "{name} {region}");
    }
    let picture = image::open(desk.path("part/inspect.png")).unwrap().into_rgb8();
    let [red, _, blue] = picture.get_pixel(81, 59).0;
    assert!(red > blue + 50, "nearer is red");
    assert_eq!(report["files"], serde_json::json!(["inspect.png", "inspect.json"]));

    // The command overwrites its own results, but no foreign file.
    let again = inspect(&desk, "part", 3, &["-o", "part", "--max-unjudged", "0"]);
    assert!(stderr_of(&again).contains("have no height of the part"), "{}", stderr_of(&again));
    fs::create_dir(desk.path("other")).unwrap();
    desk.write("other/inspect.png", "mine");
    assert!(stderr_of(&inspect(&desk, "part", 1, &["-o", "other"])).contains("inspect.png: is there already"));
    inspect(&desk, "part", 0, &["--min-area", "400"]);
    assert!(stderr_of(&inspect(&desk, "shots", 1, &[])).contains("report.json"));
    inspect(&desk, "part", 2, &["--max-unjudged", "2"]);
}

#[test]
fn a_part_too_uncertain_for_the_tolerance_cannot_be_judged() {
    let desk = Desk::new();
    let simulate = ["simulate", "relief", "-o", "shots", "--size", "160x120", "--noise", "0.02"];
    desk.done(&simulate);
    desk.done(&["solve", "shots/i1.png", "shots/i2.png", "-o", "golden", "--no-html"]);
    let tight = ["inspect", "golden", "--golden", "golden", "--tolerance", "0.05", "--in-place", "--json"];
    let found = printed(&desk.exits(&tight, 4));
    assert_eq!(found["verdict"], "cannot-judge");
    let least = found["least_tolerance"].as_f64().unwrap();
    assert!(found["reasons"][0].as_str().unwrap().contains("could be judged") && least > 0.05, "{found:#}");
    let tolerance = format!("{:.2}", least + 0.01);
    let wide = ["inspect", "golden", "--golden", "golden", "--tolerance", &tolerance, "--in-place"];
    desk.done(&wide);

    // A solve that was stopped says nothing.
    let hasty = ["solve", "shots/i1.png", "shots/i2.png", "-o", "hasty", "--no-html", "--outer-iterations", "5"];
    desk.done(&hasty);
    let report = desk.report("hasty");
    assert_eq!(report["converged"], false);
    let hasty = ["inspect", "hasty", "--golden", "golden", "--tolerance", "5", "--in-place"];
    desk.refuses(&hasty, 4, &["hasty had not converged"]);
}

#[test]
fn results_that_were_changed_or_have_other_settings_are_refused() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "shots", "--size", "160x120"]);
    let solve = |out: &str, extra: &[&str]| {
        let own = ["solve", "shots/i1.png", "shots/i2.png", "-o", out, "--no-html"];
        desk.done(&[&own, extra].concat());
    };
    solve("golden", &[]);
    // These change the path of the solve, and not its result.
    solve("part", &["--outer-iterations", "90", "--levels", "2"]);
    inspect(&desk, "part", 0, &["--in-place"]);

    solve("smooth", &["--regularization", "0.3", "--kernel", "gaussian"]);
    let refused = stderr_of(&inspect(&desk, "smooth", 1, &["--in-place"]));
    assert!(refused.contains("smooth and golden: have other settings: regularization is 0.3 and null"), "{refused}");
    assert!(refused.contains(r#"kernel is "gaussian" and "auto"; solve both with the same settings"#), "{refused}");

    for name in ["uncertainty.exr", "fused.png"] {
        let (file, taken) = (desk.path("part").join(name), desk.path("smooth").join(name));
        let own = fs::read(&file).unwrap();
        fs::copy(&taken, &file).unwrap();
        let refused = stderr_of(&inspect(&desk, "part", 1, &["--in-place"]));
        let problem = format!("{name}: has changed since the solve: its SHA-256 is not the one in report.json");
        assert!(refused.contains(&problem) && refused.contains("solve again"), "{refused}");
        fs::write(&file, own).unwrap();
    }
    inspect(&desk, "part", 0, &["--in-place"]);
    let golden = desk.run(&["inspect", "part", "--golden", "part", "smooth", "--tolerance", "1", "--in-place"]);
    assert!(stderr_of(&golden).contains("smooth and part: have other settings"), "{}", stderr_of(&golden));
}

#[test]
fn a_part_that_lies_more_tilted_than_allowed_cannot_be_judged() {
    let desk = Desk::new();
    for (name, range) in [("golden", "0.5"), ("part", "2.5")] {
        let simulate = ["simulate", "plane", "-o", "shots", "--size", "120x90", "--range", range];
        desk.done(&simulate);
        let shots = ["i1.png", "i2.png"].map(|shot| format!("shots/{shot}"));
        desk.done(&["solve", &shots[0], &shots[1], "-o", name, "--no-html"]);
    }
    // The plane falls by 2 px² more on each side of the middle.
    let output = inspect(&desk, "part", 0, &["--in-place", "--json"]);
    let found = printed(&output);
    let tilt = found["tilt"].as_f64().unwrap();
    assert!((tilt - 4.0).abs() < 0.3 && found["max_tilt"] == 10.0, "{found:#}");
    let refused = stderr_of(&inspect(&desk, "part", 4, &["--in-place", "--max-tilt", "3"]));
    assert!(refused.contains("tilted by 4.0") && refused.contains("allow more by --max-tilt"), "{refused}");
}

/// Writes a pair of photographs in which only noise shows wherever `is_bare` says.
fn cover(desk: &Desk, from: &str, to: &str, is_bare: impl Fn(f64, f64) -> bool) {
    fs::create_dir(desk.path(to)).unwrap();
    let mut random = 1u32;
    for name in ["i1.png", "i2.png"] {
        let mut picture = image::open(desk.path(from).join(name)).unwrap().into_luma16();
        for (x, y, pixel) in picture.enumerate_pixels_mut().filter(|(x, y, _)| is_bare(f64::from(*x), f64::from(*y))) {
            // The sum of four uniform numbers, about 1 % of white.
            let mut uniform = || {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f64::from(random >> 8) / f64::from(1 << 24) - 0.5
            };
            let noise = uniform() + uniform() + uniform() + uniform();
            *pixel = image::Luma([(32768.0 + 1100.0 * noise + f64::from((x + y) % 2)) as u16]);
        }
        picture.save(desk.path(to).join(name)).unwrap();
    }
}

#[test]
fn a_bare_area_is_no_go_and_an_empty_wall_is_not_go() {
    for seed in ["1", "2", "3"] {
        let desk = Desk::new();
        let simulate = ["simulate", "plane", "-o", "good", "--size", "160x120", "--noise", "0.005", "--seed", seed];
        desk.done(&simulate);
        cover(&desk, "good", "hole", |x, y| (x - 110.0).hypot(y - 70.0) < 14.0);
        cover(&desk, "good", "half", |x, _| x < 64.0);
        cover(&desk, "good", "wall", |_, _| true);
        for (shots, out) in [("good", "golden"), ("hole", "a"), ("half", "b"), ("wall", "c")] {
            let [first, second] = ["i1.png", "i2.png"].map(|name| format!("{shots}/{name}"));
            desk.done(&["solve", &first, &second, "-o", out, "--no-html"]);
        }
        let found = printed(&inspect(&desk, "a", 3, &["--json"]));
        let gap = &found["gaps"][0];
        let [x, y] = [0, 1].map(|n| gap["centroid_px"][n].as_f64().unwrap());
        // The rim of the covered disk, radius 14 px, is sharp in both photographs, which no blur explains around it.
        assert!((x - 110.0).hypot(y - 70.0) < 8.0 && gap["is_bare"] == true, "{found:#}");
        assert!(found["reasons"].to_string().contains("lacks the texture that the golden part has"), "{found:#}");
        let found = printed(&inspect(&desk, "b", 3, &["--json"]));
        let unjudged = found["unjudged"].as_f64().unwrap();
        assert!((unjudged - 0.4).abs() < 0.04, "40 % are grey, not {unjudged}");
        assert!(matches!(
            desk.run(&["inspect", "c", "--golden", "golden", "--tolerance", "1", "--in-place"]).status.code(),
            Some(3 | 4)
        ));
    }
}

#[test]
fn a_golden_part_that_disagrees_with_the_others_is_named() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "shots", "--size", "160x120"]);
    for name in ["part", "good1", "good2", "bad", "good3"] {
        let solve = ["solve", "shots/i1.png", "shots/i2.png", "-o", name, "--no-html"];
        desk.done(&solve);
    }
    let judge = |goldens: &[&str]| {
        let output = desk.run(&[&["inspect", "part", "--tolerance", "1", "--in-place", "--golden"], goldens].concat());
        (output.status.code(), stderr_of(&output))
    };
    assert_eq!(judge(&["good1", "good2", "bad", "good3"]).0, Some(0));
    add_bump(&desk.path("bad"), [70, 50]);
    let (status, found) = judge(&["good1", "good2", "bad", "good3"]);
    assert!(status == Some(4) && found.contains("the golden part bad disagrees with the others at 76,56"), "{found}");
    let (status, found) = judge(&["bad", "good1"]);
    assert!(found.contains("the golden parts bad and good1 disagree at 76,56 by -4"), "{status:?} {found}");
}

#[test]
fn a_part_whose_texture_hardly_exceeds_its_noise_cannot_be_judged() {
    for seed in ["1", "2", "3"] {
        let desk = Desk::new();
        let solved = |out: &str, extra: &[&str]| {
            let own = ["simulate", "plane", "-o", "shots", "--size", "160x120", "--seed", seed];
            desk.done(&[&own, extra].concat());
            let solve = ["solve", "shots/i1.png", "shots/i2.png", "-o", out, "--no-html"];
            desk.done(&solve);
        };
        solved("golden", &["--noise", "0.003"]);
        solved("sharp", &["--noise", "0.01"]);
        solved("noisy", &["--noise", "0.15"]);
        solved("faint", &["--noise", "0.005", "--contrast", "0.03"]);
        inspect(&desk, "sharp", 0, &["--in-place"]);
        for part in ["noisy", "faint"] {
            inspect(&desk, part, 4, &["--in-place"]);
        }
    }
}
