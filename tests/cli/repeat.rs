//! `parfocal repeat` on synthetic results, and on tables of gauge studies.

use serde_json::Value;

use crate::desk::{Desk, printed, stderr_of};
use crate::synthetic::write_pair;

const SIZE: (usize, usize) = (96, 64);

/// The example of AIAG, Measurement Systems Analysis, 4th edition (2010), chapter III; McNeese 2015, Three Ways to
/// Analyze a Gage R&R Study, table 1. A row is one trial of one operator.
const AIAG: [(&str, [f64; 10]); 9] = [
    ("A", [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36]),
    ("A", [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25]),
    ("A", [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31]),
    ("B", [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68]),
    ("B", [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62]),
    ("B", [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50]),
    ("C", [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49]),
    ("C", [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77]),
    ("C", [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16]),
];

/// A number from -√3 to √3 with the standard deviation 1, which looks random.
fn noise(seed: usize, i: usize) -> f64 {
    let mut z = (seed as u64 * 7919 + i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    12f64.sqrt() * ((z ^ (z >> 31)) as f64 / u64::MAX as f64 - 0.5)
}

/// Writes results of a pair: a step of 2 px² at the middle, noise of 0.05 px², and a stated deviation.
fn write_results(desk: &Desk, name: &str, seed: usize, stated: f32) {
    let blur = |x: usize, y: usize| {
        let step = if x < SIZE.0 / 2 { 0.0 } else { 2.0 };
        (step + 0.1 * seed as f64 + 0.05 * noise(seed, y * SIZE.0 + x)) as f32
    };
    write_pair(desk, name, SIZE, 1, [&blur, &|_, _| stated]);
}

/// Changes one value of the report of results.
fn change(desk: &Desk, name: &str, key: &str, value: f64) {
    let mut report = desk.report(name);
    report[key] = value.into();
    desk.write(&format!("{name}/report.json"), report.to_string());
}

/// Returns the report and the summary.
#[track_caller]
fn repeated(desk: &Desk, arguments: &[&str]) -> (Value, String) {
    let output = desk.done(&[&["repeat"], arguments, &["--json"]].concat());
    println!("{}", stderr_of(&output));
    (printed(&output), stderr_of(&output))
}

#[track_caller]
fn refuses(desk: &Desk, arguments: &[&str], status: i32, parts: &[&str]) {
    desk.refuses(&[&["repeat"], arguments].concat(), status, parts);
}

fn write_aiag(desk: &Desk, name: &str) {
    let mut text = "operator,part,value_mm\n".to_string();
    for (operator, row) in AIAG {
        (1..).zip(row).for_each(|(part, value)| text += &format!("{operator},part {part},{value}\n"));
    }
    desk.write(name, text);
}

#[track_caller]
fn close(value: &Value, expected: f64, within: f64) {
    let value = value.as_f64().unwrap_or_else(|| panic!("{value}"));
    assert!((value - expected).abs() <= within, "{value}, expected {expected}");
}

const STEP: [&str; 3] = ["--step", "4,4,32,48", "60,4,32,48"];

#[test]
fn noise_and_steps_of_repeated_results_are_those_that_were_added() {
    let desk = Desk::new();
    let names = ["r1", "r2", "r3", "r4"];
    (1..).zip(names).for_each(|(seed, name)| write_results(&desk, name, seed, 0.05));
    let (report, summary) = repeated(&desk, &[&names[..], &STEP, &["-o", "repeated"]].concat());
    let maps = &report["maps"];
    close(&maps["noise"]["value"], 0.05, 0.001);
    close(&maps["seen_over_stated"]["value"], 1.0, 0.02);
    close(&maps["repeatability_limit"]["value"], 0.14, 0.003);
    // The shifts are 0.1, 0.2, 0.3 and 0.4.
    close(&maps["shift_deviation"]["value"], 0.1291, 0.002);
    assert_eq!((&maps["measured_px"], maps["pairs"].as_array().unwrap().len()), (&6144.into(), 6));
    close(&report["values"][0]["repeatability"]["mean"], 2.0, 0.01);
    assert_eq!((&report["unit"], &report["kind"]), (&"px²".into(), &"repeatability".into()));
    for part in ["noise          0.0", "pairs          median", "sigma          stated 0.0", "step 1         +"] {
        assert!(summary.contains(part), "{part} in {summary}");
    }
    let files = ["repeat.json", "repeat.html", "repeat_readings.csv", "repeat_pairs.csv"];
    let [written, page, readings, pairs] = files.map(|name| desk.text(&format!("repeated/{name}")));
    let written: Value = serde_json::from_str(&written).unwrap();
    assert_eq!(written["maps"], report["maps"]);
    assert!(page.contains("parfocal repeat") && page.contains("ISO 25178-700") && page.len() < 300_000);
    assert!(readings.starts_with("name,operator,part,trial,value_px2,standard_error_px2,results\nstep 1,,,1,"));
    assert_eq!((readings.lines().count(), pairs.lines().count()), (5, 7));
    // The files are replaced by those of the next run, and those of others never are.
    let (_, _) = repeated(&desk, &["r1", "r2", "-o", "repeated"]);
    assert!(!desk.has("repeated/repeat_readings.csv"));
    desk.write("other/repeat.html", "mine");
    refuses(&desk, &["r1", "r2", "-o", "other"], 1, &["repeat.html", "--force"]);
    assert_eq!(desk.text("other/repeat.html"), "mine");
}

#[test]
fn a_stated_deviation_that_is_too_small_is_seen() {
    let desk = Desk::new();
    (1..).zip(["r1", "r2"]).for_each(|(seed, name)| write_results(&desk, name, seed, 0.025));
    let (report, summary) = repeated(&desk, &["r1", "r2", "--roi", "10,10,60,40"]);
    close(&report["maps"]["seen_over_stated"]["value"], 2.0, 0.06);
    assert_eq!(report["region"], serde_json::json!([10, 10, 60, 40]));
    // An error of V's scale, which results have in common, is not in steps.
    for name in ["r1", "r2"] {
        change(&desk, name, "scale_deviation", 0.1);
    }
    let (report, _) = repeated(&desk, &[&["r1", "r2"][..], &STEP].concat());
    close(&report["values"][0]["readings"][0]["standard_error"], 0.0, 0.05);
    assert!(summary.contains("seen over stated 2.0") || summary.contains("seen over stated 1.9"), "{summary}");
}

#[test]
fn a_type_one_study_has_its_indices_and_says_that_few_readings_are_few() {
    let desk = Desk::new();
    let names: Vec<String> = (1..7).map(|n| format!("r{n}")).collect();
    (1..).zip(&names).for_each(|(seed, name)| write_results(&desk, name, seed, 0.05));
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let (report, summary) = repeated(
        &desk,
        &[&names[..], &STEP, &["--true-value", "2.01", "--tolerance-width", "0.5", "-o", "one"]].concat(),
    );
    let value = &report["values"][0];
    let (mean, s) = (&value["repeatability"]["mean"], &value["repeatability"]["standard_deviation"]["value"]);
    let (mean, s) = (mean.as_f64().unwrap(), s.as_f64().unwrap());
    close(&value["type_one"]["cg"]["value"], 0.1 / (6.0 * s), 1e-9);
    close(&value["type_one"]["cgk"]["value"], (0.05 - (mean - 2.01).abs()) / (3.0 * s), 1e-9);
    let table = desk.text("one/repeat_values.csv");
    let [names, numbers] = [0, 1].map(|n| table.lines().nth(n).unwrap().split(',').collect::<Vec<_>>());
    let cell = |name: &str| numbers[names.iter().position(|found| *found == name).unwrap()].parse::<f64>().unwrap();
    assert_eq!((names.len(), numbers.len(), cell("readings")), (19, 19, 6.0));
    close(&value["type_one"]["cgk"]["low"], cell("cgk_low"), 1e-12);
    close(&value["type_one"]["bias"]["value"], cell("bias_px2"), 1e-12);
    assert!(
        summary.contains("Cgk            ") && summary.contains("of 6 readings is uncertain; take 25"),
        "{summary}"
    );
}

#[test]
fn the_table_of_the_example_of_aiag_gives_its_published_components() {
    let desk = Desk::new();
    write_aiag(&desk, "study.csv");
    let (report, summary) = repeated(&desk, &["--study", "study.csv", "--tolerance-width", "10", "-o", "study"]);
    for (n, name, deviation, study) in [
        (0, "repeatability", 0.199933, 18.4),
        (1, "operator", 0.226838, 20.9),
        (4, "gauge R&R", 0.302373, 27.9),
        (5, "part", 1.042327, 96.0),
    ] {
        let component = &report["gauge"]["components"][n];
        assert_eq!(component["name"], name);
        close(&component["standard_deviation"]["value"], deviation, 6e-6);
        close(&component["study_percent"]["value"], study, 0.06);
        close(&component["tolerance_percent"]["value"], 60.0 * deviation, 1e-3);
    }
    assert_eq!(report["gauge"]["is_interaction_pooled"], true);
    assert!(summary.contains("categories     4, rounded down from 4.86"), "{summary}");
    let tables = ["anova", "components", "categories"];
    let tables = tables.map(|name| desk.text(&format!("study/repeat_{name}.csv")));
    let [anova, components, categories] = &tables;
    assert!(anova.starts_with("source,degrees_of_freedom,sum_of_squares_mm2,mean_square_mm2,f,"), "{anova}");
    assert!(anova.contains("\nrepeatability,60,2.7589"), "{anova}");
    assert!(anova.contains("\npooled error,78,3.1179"), "{anova}");
    assert!(components.starts_with("component,variance_mm2,standard_deviation_mm,"), "{components}");
    assert!(components.contains(",standard_deviation_low_mm,") && components.contains(",study_high_percent,"));
    assert!(categories.starts_with("categories,categories_low,categories_high\n4.86"), "{categories}");
    assert!(desk.path("study/repeat.html").is_file());
}

#[test]
fn a_table_of_results_is_measured() {
    let desk = Desk::new();
    let mut text = "operator,part,results\n".to_string();
    for (n, (operator, part)) in
        [("A", 1), ("A", 1), ("A", 2), ("A", 2), ("B", 1), ("B", 1), ("B", 2), ("B", 2)].into_iter().enumerate()
    {
        write_results(&desk, &format!("r{n}"), n + 1, 0.05);
        text += &format!("{operator},{part},r{n}\n");
    }
    desk.write("study.csv", &text);
    let (report, _) = repeated(&desk, &[&["--study", "study.csv"][..], &STEP].concat());
    assert_eq!((&report["gauge"]["operators"], &report["quantity"]), (&2.into(), &"step".into()));
    let readings = report["values"][0]["readings"].as_array().unwrap();
    assert!(readings.len() == 8 && readings.iter().all(|r| r["standard_error"].as_f64().unwrap() > 0.0));
    // One operator and one part are repeated readings.
    desk.write("one.csv", "results\nr0\nr1\nr2\n");
    let (report, _) = repeated(&desk, &[&["--study", "one.csv"][..], &STEP].concat());
    assert_eq!(report["values"][0]["repeatability"]["count"], 3);
    refuses(&desk, &["--study", "study.csv"], 2, &["needs --step once"]);
    desk.write("twice.csv", text.replace("B,2,r7", "B,2,./r6"));
    refuses(&desk, &[&["--study", "twice.csv"][..], &STEP].concat(), 2, &["r6: was given twice"]);
    desk.write("gap.csv", text.replace("B,2,r7\n", ""));
    refuses(&desk, &[&["--study", "gap.csv"][..], &STEP].concat(), 1, &["gap.csv", "'B' has 1 readings of part '2'"]);
}

#[test]
fn what_cannot_be_repeated_is_refused() {
    let desk = Desk::new();
    (1..).zip(["r1", "r2"]).for_each(|(seed, name)| write_results(&desk, name, seed, 0.05));
    write_aiag(&desk, "study.csv");
    desk.write("bad.csv", "operator,value\nA,x\n");
    for (arguments, status, parts) in [
        (&["r1"][..], 2, &["1 results", "2 to 200"][..]),
        (&[], 2, &["RESULTS"]),
        (&["r1", "r1"], 2, &["r1: was given twice"]),
        (&["r1", "absent"], 1, &["absent", "no folder"]),
        (&["r1", "r2", "--form", "cylinder"], 2, &["no cylinder"]),
        (&["r1", "r2", "--true-value", "1"], 2, &["--tolerance-width"]),
        (&["r1", "r2", "--true-value", "1", "--tolerance-width", "1"], 2, &["give --step once"]),
        (&["r1", "r2", "--tolerance-width", "0"], 2, &["above 0"]),
        (&["r1", "r2", "--tolerance-width", "1"], 2, &["--true-value"]),
        (&["--study", "study.csv", "--roi", "0,0,8,8"], 2, &["--roi"]),
        (&["--study", "study.csv", "--form", "none"], 2, &["--form"]),
        (&["r1", "r2", "--step", "0,0,200,9", "0,0,9,9"], 2, &["r1", "0,0,200,9"]),
        (&["r1", "r2", "--roi", "0,0,8,8"], 2, &["larger area"]),
        (&["r1", "--study", "study.csv"], 2, &["--study"]),
        (&["--study", "absent.csv"], 1, &["absent.csv", "cannot be read"]),
        (&["--study", "bad.csv"], 1, &["bad.csv", "line 2", "'x' is no value"]),
        (&["--study", "study.csv", "--true-value", "1", "--tolerance-width", "1"], 2, &["one part by one operator"]),
    ] {
        refuses(&desk, arguments, status, parts);
    }
    // A pair and results of another size.
    write_pair(&desk, "small", (40, 40), 1, [&|_, _| 0.1; 2]);
    refuses(&desk, &["r1", "small"], 2, &["small has 40 x 40 px", "different sizes"]);
    // Another size of a pixel.
    change(&desk, "r2", "pixel_size_um", 4.5);
    refuses(&desk, &["r1", "r2"], 1, &["r2 and r1 differ in pixel size", "one lens"]);
}
