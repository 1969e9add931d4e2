//! Depth in mm, calibration and measurements on synthetic results, a simulated pair and a real pair.

use std::path::{Path, PathBuf};

use parfocal::{Lens, image_io};
use serde_json::Value;

use crate::desk::{Desk, stderr_of};
use crate::synthetic::{CUP_LENS, write_field, write_pair};

const SIZE: (usize, usize) = (96, 64);

/// The lens of the Cup pair.
const CUP: Lens = Lens {
    focal_length: 25.0,
    f_number: 8.3,
    pixel_pitch: 0.01304,
    focus: [529.0, 869.0],
    kappa: Lens::DISK,
    telecentric: true,
    field: None,
};
/// Returns a results folder with the files that these commands read.
///
/// V corresponds to 600 mm at the left and 700 mm at the right, by the lens of the Cup pair.
/// It has a hole and a pixel outside the range of the lens.
fn desk() -> Desk {
    let desk = Desk::new();
    let blur = |x: usize, y: usize| match (x, y) {
        (20..30, 20..30) => f32::NAN,
        (90, 60) => -50.0,
        (0..48, _) => CUP.relative_blur(600.0, 1.0) as f32,
        _ => CUP.relative_blur(700.0, 1.0) as f32,
    };
    let deviation = |x: usize, y: usize| match (x, y) {
        (20..30, 20..30) => f32::NAN,
        _ => 0.02,
    };
    write_pair(&desk, "out", SIZE, 2, [&blur, &deviation]);
    write_field(&desk.path("out/confidence.exr"), SIZE, |_, _| 0.5);
    desk
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// The median depth in a region, given as x, y, width and height in px.
fn median(depth_file: &Path, [x, y, w, h]: [usize; 4]) -> f64 {
    let (width, _, values) = image_io::read_field(depth_file).unwrap();
    let mut inside: Vec<f32> =
        (y..y + h).flat_map(|y| values[y * width as usize + x..][..w].to_vec()).filter(|z| z.is_finite()).collect();
    assert!(inside.len() > w * h / 2);
    inside.sort_by(f32::total_cmp);
    f64::from(inside[inside.len() / 2])
}

/// The values of the standard deviation channel.
fn deviations(depth_file: &Path) -> Vec<f64> {
    let file = exr::prelude::read_first_flat_layer_from_file(depth_file).unwrap();
    let channels = &file.layer_data.channel_data.list;
    let channel = channels.iter().find(|c| c.name.to_string() == "standard_deviation").unwrap();
    channel.sample_data.values_as_f32().map(f64::from).collect()
}

#[test]
fn depth_is_added_to_a_results_folder() {
    let desk = desk();
    let printed = desk.printed(&[&["depth", "out"], &CUP_LENS[..]].concat());
    let report = desk.report("out");
    assert_eq!(report["depth"], printed);
    assert_eq!((&printed["out_of_range"], &report["nearer"]), (&Value::from(1), &Value::from(1)));
    assert_eq!(report["nearer_by"], "lens");
    assert_eq!(printed["lens"]["telecentric"], true);
    assert!((number(&printed["min"]) - 600.0).abs() < 0.01 && (number(&printed["max"]) - 700.0).abs() < 0.01);

    let (_, _, depth) = image_io::read_field(&desk.path("out/depth_mm.exr")).unwrap();
    assert!(depth[25 * 96 + 25].is_nan() && depth[60 * 96 + 90].is_nan() && (depth[0] - 600.0).abs() < 0.01);
    let file = exr::prelude::read_first_flat_layer_from_file(desk.path("out/depth_mm.exr")).unwrap();
    let names: Vec<String> = file.layer_data.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["Y", "standard_deviation"]);
    let picture = image::open(desk.path("out/depth.png")).unwrap().into_rgba8();
    let ([r, _, b, _], [far_r, _, far_b, _]) = (picture.get_pixel(5, 5).0, picture.get_pixel(90, 5).0);
    assert!(r > b && far_b > far_r, "near must be yellow and far purple, by the lens");

    // The lens comes from the report. Another constant changes the depth.
    let again = desk.printed(&["depth", "out", "--lens", "out/report.json", "--kappa", "0.6"]);
    assert_eq!((number(&again["lens"]["kappa"]), number(&again["lens"]["f_number"])), (0.6, 8.3));
    assert!((number(&again["min"]) - 600.0).abs() > 1.0);
}

#[test]
fn an_invalid_or_contradictory_lens_is_refused() {
    let desk = desk();
    desk.write("lens.json", r#"{"focal_length": 25}"#);
    desk.refuses(&["depth", "out", "--lens", "lens.json"], 1, &["lens.json", "`focal_length`", "`focal_length_mm`"]);
    desk.refuses(&["depth", "out", "--lens", "absent.json"], 1, &["absent.json", "check the path"]);
    desk.refuses(&["depth", "out"], 2, &["--lens"]);
    desk.refuses(&["depth", "out", "--f-number=8"], 2, &["--focal-length, --pixel-pitch, --focus"]);
    desk.refuses(&[&["depth", "absent"], &CUP_LENS[..]].concat(), 1, &["absent", "no folder"]);
    let contradicted = [&["solve", "a.png", "b.png", "-o", "o", "--nearer", "2"], &CUP_LENS[..]].concat();
    desk.refuses(&contradicted, 2, &["--nearer 2 contradicts the lens", "I1"]);
    assert!(!desk.has("out/depth_mm.exr"));
}

#[test]
fn steps_and_profiles_are_measured_in_px2_and_with_a_lens_in_mm() {
    let desk = desk();
    let arguments = [
        "measure",
        "out",
        "--step",
        "2,2,40,60",
        "52,2,30,60",
        "--profile",
        "10,10,90,10,5",
        "--profile",
        "25,0,25,60",
    ];
    let measured = desk.printed(&arguments);
    let expected = CUP.relative_blur(700.0, 1.0) - CUP.relative_blur(600.0, 1.0);
    let step = &measured["steps"][0];
    assert!((number(&step["difference"]["value"]) - expected).abs() < 1e-5, "{step}");
    assert_eq!((number(&step["difference"]["standard_error"]), &step["depth_mm"]), (0.0, &Value::Null));
    let csv = desk.text("out/profile_2.csv");
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!((lines.len(), lines[0].split(',').count()), (62, 5));
    assert!(lines[26].ends_with(",,"), "a hole must give empty columns: {}", lines[26]);

    desk.printed(&[&["depth", "out"], &CUP_LENS[..]].concat());
    let in_mm = desk.printed(&arguments[..7]);
    assert!((number(&in_mm["steps"][0]["depth_mm"]["value"]) - 100.0).abs() < 0.01, "{in_mm}");
    let csv = desk.text("out/profile_1.csv");
    let last: Vec<f64> = csv.lines().last().unwrap().split(',').map(|n| n.parse().unwrap()).collect();
    assert_eq!(&last[..3], [80.0, 90.0, 10.0]);
    assert!((last[5] - 700.0).abs() < 0.01 && csv.starts_with("distance_px,x_px,y_px,relative_blur_px2,"), "{csv}");
    assert!(image::open(desk.path("out/profile_1.png")).unwrap().width() == 800);
    assert!(!desk.has("out/profile_2.png"), "the profile of the earlier run must be removed");

    desk.refuses(&["measure", "out"], 2, &["--step", "--profile"]);
    desk.refuses(&["measure", "out", "--step", "0,0,9,9", "90,0,9,9"], 1, &["90,0,9,9", "96x64"]);
    desk.refuses(&["measure", "out", "--profile", "0,0,96,0"], 1, &["0 to 95"]);
    desk.refuses(&["measure", "out", "--profile", "0,0,96"], 2, &["as in"]);
}

#[test]
fn known_steps_calibrate_the_lens_and_undetermined_parameters_are_reported() {
    let desk = desk();
    desk.write("steps.json", r#"[{"region": [2, 2, 40, 60], "depth_mm": 600}]"#);
    let start = [&["calibrate", "out", "--kappa", "0.7"], &CUP_LENS[..]].concat();
    let both = ["--known-from", "steps.json", "--known", "52,2,30,60=700", "--fit", "kappa,focus1", "-o", "lens.json"];
    let found = desk.printed(&[&start, &both[..]].concat());
    assert!((number(&found["lens"]["kappa"]) - 0.5).abs() < 1e-4, "{found}");
    assert!((number(&found["found"][1]["value"]) - 529.0).abs() < 0.1 && found["found"][1]["unknown"] == "focus1");
    let depth = desk.printed(&["depth", "out", "--lens", "lens.json"]);
    assert!((number(&depth["max"]) - 700.0).abs() < 0.1, "{depth}");

    let one = desk.printed(&[&start, &["--known", "2,2,40,60=600", "--fit", "kappa,focus1"][..]].concat());
    assert_eq!((&one["undetermined"][0], number(&one["lens"]["focus_mm"][0])), (&Value::from("focus1"), 529.0));

    desk.refuses(&start, 2, &["--plane"]);
    // Depth rises from 600 mm at the left to 700 mm at the right. A plane of opposite slope determines nothing.
    let reversed = [&start, &["--plane", "710,590,710"][..]].concat();
    desk.refuses(&reversed, 1, &["did you mean --plane 590.000,710.000,590.000?", "top left"]);
    desk.refuses(&[&start, &["--plane", "600,700"][..]].concat(), 2, &["as in"]);
    desk.refuses(&[&start, &["--plane", "20,700,600"][..]].concat(), 2, &["depth of the target is 20"]);
    desk.refuses(&[&start, &["--known", "2,2,400,60=600"][..]].concat(), 1, &["not within the image"]);
    let twice = [&start, &["--plane", "600,700,600", "--fit", "kappa,kappa"][..]].concat();
    desk.refuses(&twice, 2, &["twice"]);
    let onto = [&start, &["--known-from", "steps.json", "-o", "steps.json"][..]].concat();
    desk.refuses(&onto, 1, &["steps.json", "is an input"]);
}

/// Writes results of a surface at `depth`, from column `left` of the photographs on. V has a gain and an offset that
/// grow towards the corners, and noise of up to 0.02 px².
fn write_bowed(desk: &Desk, folder: &str, left: usize, depth: impl Fn(usize, usize) -> f64 + Sync) {
    let square = |x: usize, y: usize| {
        ((x as f64 - 47.5).powi(2) + (y as f64 - 31.5).powi(2))
            / (SIZE.0 as f64 / 2.0).hypot(SIZE.1 as f64 / 2.0).powi(2)
    };
    let blur = |x: usize, y: usize| {
        let (x, noise) = (left + x, 0.02 * f64::from((x * 7919 + y * 104_729) as u32 % 13) / 6.0 - 0.02);
        ((1.0 - 0.2 * square(x, y)) * CUP.relative_blur(depth(x, y), 1.0) + 0.3 * square(x, y) + noise) as f32
    };
    let part = (SIZE.0 - left, SIZE.1);
    write_pair(desk, folder, part, 2, [&blur, &|_, _| 0.02]);
    write_field(&desk.path(&format!("{folder}/confidence.exr")), part, |_, _| 0.99);
    let mut report = desk.report(folder);
    report["photograph"]["width"] = SIZE.0.into();
    report["region"]["x"] = left.into();
    desk.write(&format!("{folder}/report.json"), report.to_string());
}

#[test]
fn a_plane_at_two_distances_calibrates_the_field_of_the_lens() {
    let desk = Desk::new();
    write_bowed(&desk, "near", 0, |_, _| 560.0);
    write_bowed(&desk, "far", 0, |_, _| 800.0);
    write_bowed(&desk, "part", 0, |x, _| if x < 48 { 600.0 } else { 700.0 });
    let first = [&["calibrate", "near", "--plane", "560,560,560"], &CUP_LENS[..]].concat();
    let second = ["--second", "far", "--second-plane", "800,800,800"];
    let both = [&first, &second[..], &["--fit", "kappa,focus2", "-o", "lens.json"]].concat();
    let found = desk.printed(&both);
    assert!((number(&found["lens"]["kappa"]) - 0.5).abs() < 2e-3, "{found}");
    let field = &found["lens"]["field"];
    assert!(
        (number(&field["gain"][2]) + 0.2).abs() < 0.03 && (number(&field["gain"][4]) + 0.2).abs() < 0.03,
        "{found}"
    );
    assert!(number(&found["field"]["gain"]["standard_error"]) < 0.01, "{found}");
    let text = stderr_of(&desk.done(&[&both[..], &["--force"]].concat()));
    assert!(text.contains("gain of V      0.8") && text.contains("px² over the field"), "{text}");

    // Off the centre V is not that of the lens.
    let range = |depth: &Value| [number(&depth["min"]), number(&depth["max"])];
    let [near, far] = range(&desk.printed(&[&["depth", "part"], &CUP_LENS[..]].concat()));
    assert!(near < 590.0 || far > 715.0, "{near} to {far} mm without the field");
    let [near, far] = range(&desk.printed(&["depth", "part", "--lens", "lens.json"]));
    assert!(near > 594.0 && far < 710.0, "{near} to {far} mm");
    // A part of the photographs has its place in the field.
    write_bowed(&desk, "right", 60, |_, _| 700.0);
    let [near, far] = range(&desk.printed(&["depth", "right", "--lens", "lens.json"]));
    assert!(near > 690.0 && far < 710.0, "{near} to {far} mm of a part");
    // Photographs of another size have another field.
    let mut report = desk.report("part");
    (report["photograph"]["width"], report["region"]["x"]) = (192.into(), 96.into());
    desk.write("part/report.json", report.to_string());
    let warned = stderr_of(&desk.done(&["depth", "part", "--lens", "lens.json"]));
    assert!(warned.contains("96x64") && warned.contains("192x64"), "{warned}");
    // A second warning is not hidden.
    let mut wrong: Value = serde_json::from_str(&desk.text("lens.json")).unwrap();
    wrong["lens"]["pixel_pitch_mm"] = 13.04.into();
    desk.write("wrong.json", wrong.to_string());
    let warned = stderr_of(&desk.done(&["depth", "part", "--lens", "wrong.json"]));
    assert!(warned.contains("192x64") && warned.contains("did you mean a pixel pitch of 0.01304 mm"), "{warned}");

    // A field in the results is replaced by that of the next lens, or by none.
    let mut plain: Value = serde_json::from_str(&desk.text("lens.json")).unwrap();
    plain["lens"].as_object_mut().unwrap().remove("field");
    desk.write("plain.json", plain["lens"].to_string());
    for (file, has_field) in [("lens.json", true), ("plain.json", false), ("lens.json", true)] {
        desk.done(&["depth", "near", "--lens", file]);
        assert_eq!(desk.report("near")["depth"]["lens"].get("field").is_some(), has_field, "{file}");
    }
    desk.refuses(&["depth", "near", "--f-number", "2"], 2, &["--f-number", "lens of the results"]);
    desk.refuses(&["depth", "near", "--lens", "lens.json", "--focus", "869,529"], 2, &["--focus", "lens.json"]);
    let known = ["calibrate", "near", "--lens", "plain.json", "--known", "2,2,40,60=560"];
    desk.refuses(&[&known, &second[..]].concat(), 2, &["--known", "--second"]);
    let region = ["calibrate", "right", "--lens", "lens.json", "--known", "2,2,30,60=700"];
    desk.refuses(&region, 1, &["right", "part of the photographs"]);
    let same = [&first, &["--second", "near", "--second-plane", "800,800,800"][..]].concat();
    desk.refuses(&same, 2, &["near", "another distance"]);
    let equal = [&first, &["--second", "far", "--second-plane", "560,560,560"][..]].concat();
    desk.refuses(&equal, 2, &["--second-plane", "equal"]);

    let twice = desk.printed(&["calibrate", "far", "--plane", "800,800,800", "--lens", "lens.json"]);
    assert_eq!(&twice["lens"]["field"], field, "one plane keeps the field");
    desk.refuses(&[&first, &second[..2]].concat(), 2, &["--second-plane"]);
    desk.refuses(&[&first, &["--second-plane", "8,8,8"][..]].concat(), 2, &["--second"]);
    desk.refuses(&[&first, &second[..], &["-o", "far/report.json"]].concat(), 1, &["far/report.json"]);
    write_pair(&desk, "small", (48, 64), 2, [&|_, _| 1.0, &|_, _| 0.02]);
    let small = [&first, &["--second", "small", "--second-plane", "800,800,800"][..]].concat();
    desk.refuses(&small, 1, &["96x64", "48x64"]);
    let mut report = desk.report("far");
    report["flattened"] = true.into();
    desk.write("far/report.json", report.to_string());
    desk.refuses(&[&first, &second[..]].concat(), 1, &["far", "--flat"]);
    assert!(stderr_of(&desk.done(&["depth", "far", "--lens", "lens.json"])).contains("--flat"));
    desk.refuses(&["simulate", "cylinders", "-o", "s", "--lens", "lens.json"], 2, &["lens.json", "field"]);
    desk.write("bad.json", desk.text("lens.json").replace("\"gain\": [", "\"gain\": [9,"));
    desk.refuses(&["depth", "far", "--lens", "bad.json"], 1, &["bad.json"]);
}

/// Renders a plane in perspective (linear in 1/z) through a lens, solves the pair, and calibrates the lens by it.
#[test]
fn calibration_by_a_simulated_plane_recovers_the_lens() {
    for telecentric in ["--telecentric=false", "--telecentric"] {
        calibrate_by_a_simulated_plane(telecentric);
    }
}

fn calibrate_by_a_simulated_plane(telecentric: &str) {
    let desk = Desk::new();
    let (size, near, far) = (256, 227.0, 233.0);
    let depth = |x: usize, y: usize| {
        let share = (x as f64 + 0.25 * y as f64) / (1.25 * (size - 1) as f64);
        1.0 / ((1.0 - share) / near + share / far)
    };
    write_field(&desk.path("depth.exr"), (size, size), |x, y| depth(x, y) as f32);
    let shade = |x: u32, y: u32| {
        let hash = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77)).wrapping_mul(0xc2b2_ae3d);
        image::Luma([40 + (hash >> 24) as u8 / 2])
    };
    image::GrayImage::from_fn(size as u32, size as u32, |x, y| shade(x / 2, y / 2))
        .save(desk.path("texture.png"))
        .unwrap();
    let optics = ["--focal-length=50", "--f-number=5.6", "--pixel-pitch=0.0075", telecentric];
    let scene = ["simulate", "image", "-o", "pair", "--radiance", "texture.png", "--depth", "depth.exr"];
    desk.printed(&[&scene, &optics[..], &["--focus=226.5,233.5", "--noise=0.003"]].concat());
    desk.printed(&["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--lens", "pair/truth.json"]);

    let corners = [depth(0, 0), depth(size - 1, 0), depth(0, size - 1)].map(|z| z.to_string()).join(",");
    let stated = ["calibrate", "out", "--focus=226.5,235", "--kappa=0.4", "--fit=kappa,focus2", "--plane", &corners];
    let found = desk.printed(&[&stated, &optics[..]].concat());
    let (kappa, focus) = (number(&found["lens"]["kappa"]), number(&found["lens"]["focus_mm"][1]));
    println!("{found}");
    assert!((kappa - 0.5).abs() < 0.02 && (focus - 233.5).abs() < 0.2, "{found}");

    // Depth computed with the true lens.
    let (_, _, measured) = image_io::read_field(&desk.path("out/depth_mm.exr")).unwrap();
    let errors = measured.iter().enumerate().map(|(i, &z)| f64::from(z) - depth(i % size, i / size));
    let valid: Vec<f64> = errors.filter(|e| e.is_finite()).collect();
    let rms = (valid.iter().map(|e| e * e).sum::<f64>() / valid.len() as f64).sqrt();
    println!("depth rms {rms:.4} mm over {} pixels, of 6 mm", valid.len());
    let claimed: Vec<f64> = deviations(&desk.path("out/depth_mm.exr"));
    let ratios =
        measured.iter().zip(&claimed).enumerate().map(|(i, (&z, s))| (f64::from(z) - depth(i % size, i / size)) / s);
    let ratios: Vec<f64> = ratios.filter(|r| r.is_finite()).collect();
    let within = ratios.iter().filter(|r| r.abs() < 1.0).count() as f64 / ratios.len() as f64;
    println!("{:.1} % of the pixels are within one standard deviation", 100.0 * within);
    assert!(ratios.len() == valid.len() && (0.5..0.95).contains(&within), "{within}");
    assert!(rms < 0.15 && valid.len() > size * size * 8 / 10);
}

/// Needs the Cup pair, which may not be copied into the repository.
#[test]
fn depths_of_bread_cup_and_background_are_in_order_between_the_focus_distances() {
    let folder = std::env::var_os("PARFOCAL_PAIRS")
        .map_or(Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from)
        .join("cup");
    let [near, far] = ["breakfast_near.png", "breakfast_far.png"].map(|name| folder.join(name).display().to_string());
    if !Path::new(&near).is_file() {
        eprintln!("the pair 'cup' is absent: set PARFOCAL_PAIRS to the folder that holds it; nothing was tested");
        return;
    }
    let desk = Desk::new();
    let measure = ["--step", "60,200,140,200", "280,220,200,100", "--profile", "20,300,600,300,9"];
    let report = desk.printed(&[&["solve", &near, &far, "-o", "out"], &CUP_LENS[..], &measure].concat());
    let file = desk.path("out/depth_mm.exr");
    let bread = median(&file, [60, 200, 140, 200]);
    let cup = median(&file, [280, 220, 200, 100]);
    let background = median(&file, [260, 20, 240, 110]);
    println!("bread {bread:.1}, cup {cup:.1}, background {background:.1} mm; {}", report["depth"]);
    assert!(529.0 < bread && bread < cup && cup + 50.0 < background && background < 869.0);
    let step = &report["measurements"]["steps"][0]["depth_mm"];
    assert!((number(&step["value"]) - (cup - bread)).abs() < 5.0, "{step}");
    assert_eq!(report["depth"]["out_of_range"], 0);
    assert_eq!(report["measurements"]["profiles"][0]["csv"], "profile_1.csv");
    assert!(desk.path("out/profile_1.csv").is_file() && desk.path("out/profile_1.png").is_file());
}
