//! `parfocal evaluate --quick` on a device: what it writes, and what it says of data that are absent.

use std::fs;
use std::path::Path;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

fn evaluate(folder: &Path, extra: &[&str]) -> Output {
    let mut program = Command::cargo_bin("parfocal").unwrap();
    program.env("PARFOCAL_CACHE_DIR", folder.join("cache")).current_dir(folder).args(["evaluate", "--quick"]);
    program.args(extra).output().unwrap()
}

/// A run of one part with data of this folder: its report, its tables, and what was said.
fn evaluated(folder: &TempDir, part: &str, data: &str) -> (Value, String, String) {
    let output = evaluate(folder.path(), &["--only", part, "--data", data, "-o", "made/out"]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && output.stdout.is_empty(), "{stderr}");
    let out = folder.path().join("made/out");
    let report = serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap();
    (report, fs::read_to_string(out.join("report.md")).unwrap(), stderr)
}

#[test]
fn the_paper_s_part_without_data_writes_tables_figures_and_verdicts() {
    let folder = TempDir::new().unwrap();
    let (report, text, said) = evaluated(&folder, "paper", "pairs");
    assert!(said.contains("table 1: plane") && said.contains("robustness"), "{said}");
    assert_eq!(report["absent"].as_array().unwrap().len(), 6);
    assert_eq!(report["registration"].as_array().unwrap().len(), 2);
    for case in report["registration"].as_array().unwrap() {
        let systems = case["systems"].as_array().unwrap();
        assert_eq!(systems.len(), 5, "{case}");
        let unified = systems.iter().find(|s| s["system"] == "unified").unwrap();
        assert!(unified["error"]["corner_px"].as_f64().unwrap() < 0.25, "{unified}");
        assert!(unified["v_rms_to_aligned"].is_f64() && unified["failure"].is_null());
    }
    for target in report["targets"].as_array().unwrap() {
        assert!(target["met"].is_boolean() && target["judged"].as_u64().unwrap() > 0, "{target}");
    }
    assert_eq!(report["robustness"].as_array().unwrap().len(), 5);
    assert_eq!(report["descent"].as_array().unwrap().len(), 3);
    assert!(report["kernels"].as_array().unwrap().len() >= 4);
    assert!(report["itself"].as_array().unwrap().is_empty() && report["sweeps"].as_array().unwrap().is_empty());

    assert!(text.contains("Table 1") && !text.contains("## By itself") && !text.contains("## Sweeps"), "{text}");
    assert!(text.contains("cup: absent: looked for pairs/cup/breakfast_near.png"), "{text}");
    let links: Vec<&str> = text.split("](").skip(1).filter_map(|rest| rest.split(')').next()).collect();
    assert_eq!(links, ["figures/fig4-scenes.png", "figures/robustness.png", "figures/descent.png"]);
    let out = folder.path().join("made/out");
    for link in links {
        assert!(image::open(out.join(link)).unwrap().width() > 500, "{link}");
    }
    assert_eq!(fs::read_dir(&out).unwrap().count(), 3);
}

#[test]
fn what_is_asked_of_defaults_is_measured_wherever_there_are_data() {
    let folder = TempDir::new().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let (report, text, said) = evaluated(&folder, "itself", data.to_str().unwrap());
    let sections = report["itself"].as_array().unwrap();
    assert_eq!(sections.len(), 7);
    for section in sections {
        let name = section["name"].as_str().unwrap();
        for case in section["cases"].as_array().unwrap() {
            // Only what data are absent for could not be measured.
            let absent = case["note"].as_str().unwrap().contains("no such file");
            assert_eq!(case["figures"].as_array().unwrap().is_empty(), absent, "{name}: {case}");
        }
    }
    assert!(said.contains("| part 57 |") && said.contains("### Shading: "), "{said}");
    assert!(!said.contains("part 57 | – |"), "the project's own part is there: {said}");
    assert!(text.contains("## By itself") && !text.contains("Table 1"), "{text}");
}

#[test]
fn sweeps_that_are_absent_are_a_row_and_the_simulated_one_is_solved() {
    let folder = TempDir::new().unwrap();
    let (report, text, said) = evaluated(&folder, "sweeps", "none");
    assert!(said.contains("## Sweeps") && text.contains("### Simulated sweep: "), "{said}");
    assert_eq!(report["sweeps"].as_array().unwrap().len(), 4);
    let cases = |n: usize| report["sweeps"][n]["cases"].as_array().unwrap();
    assert!(cases(0).len() == 1 && cases(0)[0]["note"].as_str().unwrap().contains("no such file"), "{report}");
    assert!(cases(1).len() == 1 && !cases(1)[0]["figures"].as_array().unwrap().is_empty(), "{report}");
    assert!(cases(2).len() == 1 && !cases(2)[0]["figures"].as_array().unwrap().is_empty(), "{report}");
    assert!(report["itself"].as_array().unwrap().is_empty() && report["registration"].as_array().unwrap().is_empty());
}

#[test]
fn a_file_where_the_folder_should_be_is_refused_before_any_work() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("out"), "x").unwrap();
    let output = evaluate(folder.path(), &["-o", "out"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!((output.status.code(), stderr.contains("give a folder")), (Some(1), true), "{stderr}");
    assert_eq!(stderr.lines().count(), 1);
}
