//! `parfocal bench` on a device. The images are too small for the times to mean anything.

use std::fs;
use std::process::Output;

use serde_json::Value;

use crate::desk::{Desk, assert_refused, printed, stderr_of};

/// Runs `bench` on the test device with these arguments; the default size is 64x64.
fn measure(desk: &Desk, arguments: &[&str]) -> Output {
    let sizes: &[&str] = if arguments.contains(&"--sizes") { &[] } else { &["--sizes", "64x64"] };
    desk.run(&[&["bench"], sizes, &["--repeats", "2", "--outer-iterations", "8"], arguments].concat())
}

/// Writes two different photographs of 80x64 px.
fn photographs(desk: &Desk, names: [&str; 2]) {
    for (name, shift) in names.into_iter().zip([0, 1]) {
        let value = |x: u32, y: u32| (x + shift + 7 * (y / 5)).wrapping_mul(2_654_435_761) >> 24;
        let path = desk.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::GrayImage::from_fn(80, 64, |x, y| image::Luma([value(x, y) as u8])).save(path).unwrap();
    }
}

/// Asserts success and returns the text on stdout.
#[track_caller]
fn stdout_of(output: &Output) -> String {
    assert!(output.status.success(), "{}", stderr_of(output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[track_caller]
fn positive(value: &Value) -> f64 {
    let number = value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"));
    assert!(number > 0.0, "{number}");
    number
}

#[track_caller]
fn spread(value: &Value, samples: usize) {
    let [min, median, max] = ["min", "median", "max"].map(|name| positive(&value[name]));
    assert!(min <= median && median <= max, "{value}");
    assert_eq!(value["samples"].as_array().unwrap().len(), samples);
}

fn check_run(run: &Value) {
    assert_eq!((&run["scene"], &run["width"], &run["height"]), (&"synthetic".into(), &64.into(), &64.into()));
    assert!(run["converged"].is_boolean(), "{run}");
    spread(&run["solve_ms"], 2);
    spread(&run["device_ms"], 2);
    for name in ["mpx_per_s", "device_mpx_per_s"] {
        positive(&run[name]);
    }
    let megapixels = 64.0 * 64.0 * 1e-6;
    let ratio = positive(&run["mpx_per_s"]) * positive(&run["solve_ms"]["median"]) / (1e3 * megapixels);
    assert!((ratio - 1.0).abs() < 1e-9, "{ratio}");
    for (group, name) in [
        ("cold", "prepare_ms"),
        ("cold", "first_ms"),
        ("memory", "device_bytes_per_px"),
        ("memory", "host_bytes_per_px"),
        ("relaxation", "mpx_sweeps_per_s"),
        ("relaxation", "share_of_copy"),
    ] {
        positive(&run[group][name]);
    }
    // Input: two 16-bit photographs, an 8-bit mask. Output: V, deviation, residual and fused image, 32 bits each.
    assert_eq!(run["memory"]["host_bytes_per_px"], 21.0);

    let [recorded, executed] = ["recorded", "executed"].map(|name| run["dispatches"][name].as_u64().unwrap());
    assert!(executed <= recorded);
    let levels = run["levels"].as_array().unwrap();
    let iterations: Vec<u64> = levels.iter().map(|l| l["iterations"].as_u64().unwrap()).collect();
    assert_eq!(levels.iter().map(|l| l["width"].as_u64().unwrap()).collect::<Vec<_>>(), [32, 64]);
    assert!(iterations.iter().all(|n| (1..=8).contains(n)), "{iterations:?}");

    let passes = run["passes"].as_array().unwrap();
    let count = |name: &str| passes.iter().find(|p| p["name"] == name).map_or(0, |p| p["dispatches"].as_u64().unwrap());
    assert_eq!(passes.iter().map(|p| p["dispatches"].as_u64().unwrap()).sum::<u64>(), executed);
    assert_eq!(count("linearise"), iterations.iter().sum::<u64>());
    // The last iteration of a level only evaluates the state that the others have reached.
    let relaxed: u64 = iterations.iter().map(|&n| n - 1).sum();
    // One pass performs all relaxation sweeps.
    assert_eq!((count("relax_tiles"), count("relax")), (relaxed, 0));
    for pass in passes {
        let (bytes, ms) = (positive(&pass["bytes"]), positive(&pass["ms"]));
        assert!((positive(&pass["gb_per_s"]) * ms / (bytes * 1e-6) - 1.0).abs() < 1e-9, "{pass}");
        positive(&pass["share_of_copy"]);
    }
}

#[test]
fn the_report_and_the_trace_are_complete() {
    let desk = Desk::new().on_vulkan();
    let methods = ["--methods", "unified,appearance", "--json", "-o", "made/a.json", "--trace", "t.json"];
    let report = printed(&measure(&desk, &methods));
    assert_eq!(desk.json("made/a.json"), report);
    for name in ["name", "driver", "uuid"] {
        assert!(!report["device"][name].as_str().unwrap().is_empty(), "{report}");
    }
    positive(&report["device"]["subgroup_size"]);
    positive(&report["engine_ms"]);
    spread(&report["copy_gb_per_s"], 8);
    let runs = report["runs"].as_array().unwrap();
    assert_eq!(runs.iter().map(|r| r["method"].as_str().unwrap()).collect::<Vec<_>>(), ["unified", "appearance"]);
    assert_eq!(runs[0]["kernel"], "auto");
    runs.iter().for_each(check_run);
    assert!(runs[1]["passes"].as_array().unwrap().iter().any(|p| p["name"] == "appearance"));

    let trace = desk.json("t.json");
    let events = trace["traceEvents"].as_array().unwrap();
    let spans: Vec<&Value> = events.iter().filter(|e| e["ph"] == "X").collect();
    assert!(spans.iter().all(|e| e["ts"].is_f64() && e["dur"].as_f64().unwrap() >= 0.0 && e["name"].is_string()));
    let recorded: u64 = runs.iter().map(|r| r["dispatches"]["recorded"].as_u64().unwrap()).sum();
    // Each of the two runs adds four spans of the host.
    assert_eq!(spans.len() as u64, recorded + 8);
    assert!(spans.iter().any(|e| e["name"] == "relax_tiles" && e["args"]["iteration"] == 0 && e["args"]["level"] == 1));
}

#[test]
fn the_text_report_is_a_table_with_ratios_to_an_earlier_report() {
    let desk = Desk::new();
    let text = stdout_of(&measure(&desk, &["-o", "a.json"]));
    for part in ["copy ", "GB/s", "64x64 unified auto", "Mpx-sweeps/s", "bytes a pixel", "linearise", "of copy"] {
        assert!(text.contains(part), "{part} is missing in {text}");
    }
    let output = measure(&desk, &["--kernels", "gaussian,half-gaussian", "--json", "--against", "a.json", "--quiet"]);
    let report = printed(&output);
    assert_eq!([0, 1].map(|n| &report["runs"][n]["kernel"]), ["gaussian", "half-gaussian"]);
    let ratios = stderr_of(&output);
    assert!(
        ratios.contains("new/old") && ratios.contains("only in the new report: synthetic 64x64 unified half-gaussian")
    );

    let text = stdout_of(&desk.run(&["bench", "--compare", "a.json", "a.json"]));
    for name in ["solve", "device", "relax"] {
        let line = text.lines().find(|line| line.trim_start().starts_with(name)).unwrap();
        assert_eq!(line.split_whitespace().nth(3), Some("1.00"), "{text}");
    }
}

#[test]
fn an_unsupported_size_is_reported_and_the_others_are_measured() {
    let desk = Desk::new().on_vulkan();
    let output = measure(&desk, &["--sizes", "400000x400000,64x64,8x8", "--json"]);
    assert_refused(&output, 1, &["400000x400000", "too large", "8x8", "too small"]);
    let report = printed(&output);
    assert_eq!((report["runs"].as_array().unwrap().len(), report["refused"].as_array().unwrap().len()), (1, 2));
    check_run(&report["runs"][0]);
}

#[test]
fn the_pair_option_measures_two_photographs() {
    let desk = Desk::new();
    photographs(&desk, ["a.png", "b.png"]);
    let pair = ["bench", "--pair", "a.png", "b.png", "--repeats", "1", "--outer-iterations", "5", "--quiet"];
    let report = desk.printed(&pair);
    assert_eq!((&report["runs"][0]["scene"], &report["runs"][0]["width"]), (&"pair".into(), &80.into()));
    // Input: two 8-bit photographs and a mask. Output: four 32-bit channels, as for simulated pairs.
    assert_eq!(report["runs"][0]["memory"]["host_bytes_per_px"], 19.0);
    desk.refuses(&[&pair[..], &["-o", "a.png"]].concat(), 1, &["a.png", "is an input"]);
    desk.refuses(&[&pair[..], &["--sizes", "64x64"]].concat(), 2, &["--sizes"]);
}

#[test]
fn shipped_pairs_come_before_synthetic_ones_and_absent_pairs_are_named() {
    let desk = Desk::new();
    let measure = |arguments: &[&str]| {
        let quick = ["bench", "--repeats", "1", "--warmup", "0", "--outer-iterations", "5", "--no-fused", "--quiet"];
        stdout_of(&desk.run(&[&quick[..], arguments].concat()))
    };
    photographs(&desk, ["data/heatsink/frame_15.png", "data/heatsink/frame_30.png"]);
    let report: Value = serde_json::from_str(&measure(&["--json", "-o", "a.json"])).unwrap();
    let runs = report["runs"].as_array().unwrap();
    let scenes: Vec<&str> = runs.iter().map(|run| run["scene"].as_str().unwrap()).collect();
    assert_eq!(scenes, ["heatsink", "synthetic", "synthetic"]);
    assert!(!runs[0]["levels"].as_array().unwrap().is_empty() && runs[0]["converged"].is_boolean(), "{report}");
    assert_eq!(report["absent"], serde_json::json!(["part"]));

    fs::rename(desk.path("data"), desk.path("photographs")).unwrap();
    let text = measure(&["--data", "photographs", "--sizes", "64x64", "--against", "a.json"]);
    assert!(text.lines().nth(1).unwrap().starts_with("heatsink   80x64  unified"), "{text}");
    assert!(text.contains("absent     part: give") && text.contains("\n  iterations "), "{text}");

    let text = measure(&["--sizes", "64x64"]);
    assert!(text.lines().nth(1).unwrap().starts_with("synthetic  64x64") && !text.contains("absent"), "{text}");
}

#[test]
fn invalid_options_are_refused_before_any_work() {
    let desk = Desk::new();
    desk.write("no.json", "{}");
    desk.refuses(&["bench", "--sizes", "64"], 2, &["'64'", "WIDTHxHEIGHT"]);
    desk.refuses(&["bench", "--kernels", "none"], 2, &["none", "gaussian"]);
    desk.refuses(&["bench", "--outer-iterations", "1"], 2, &["--outer-iterations is 1"]);
    desk.refuses(&["bench", "--compare", "no.json", "no.json"], 1, &["no.json", "no report of a bench"]);
    desk.refuses(&["bench", "--against", "none.json"], 1, &["none.json", "check the path"]);
    desk.refuses(&["bench", "--pair", "a.png", "b.png"], 1, &["a.png"]);
    desk.refuses(&["bench", "-o", "."], 1, &["is a folder"]);
    desk.refuses(&["bench", "-o", "x.json", "--trace", "x.json"], 2, &["one file"]);
}
