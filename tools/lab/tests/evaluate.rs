//! `tools/evaluate --quick` on the CPU device: its tables and figures, with and without data.

use std::fs;
use std::path::Path;

use assert_cmd::Command;
use assert_cmd::cargo::cargo_bin;
use serde_json::Value;
use tempfile::TempDir;

/// Runs a quick evaluation in a folder. Returns its exit status and stderr.
fn run(folder: &TempDir, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = Command::new(cargo_bin("parfocal-lab"));
    let output = command.current_dir(folder).args(["evaluate", "--quick", "--device", "cpu"]).args(arguments).output();
    let output = output.unwrap();
    assert!(output.stdout.is_empty());
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// Evaluates one part with a data folder. Returns report.json, report.md and stderr.
fn evaluated(folder: &TempDir, part: &str, data: &str) -> (Value, String, String) {
    let (status, log) = run(folder, &["--only", part, "--data", data, "-o", "made/out"]);
    assert_eq!(status, Some(0), "{log}");
    let text = |name: &str| fs::read_to_string(folder.path().join("made/out").join(name)).unwrap();
    (serde_json::from_str(&text("report.json")).unwrap(), text("report.md"), log)
}

fn cases(section: &Value) -> &Vec<Value> {
    section["cases"].as_array().unwrap()
}

#[test]
fn the_paper_s_part_without_data_writes_tables_figures_and_verdicts() {
    let folder = TempDir::new().unwrap();
    let (report, text, log) = evaluated(&folder, "paper", "pairs");
    assert!(log.contains("table 1: plane") && log.contains("robustness"), "{log}");
    let sections = report["paper"].as_array().unwrap();
    let names: Vec<&str> = sections.iter().map(|section| section["name"].as_str().unwrap()).collect();
    assert_eq!(names[..3], ["Targets", "Table 1: registration errors", "Table 2: photographs"]);
    assert!(names.len() == 8 && names[3..].iter().all(|name| name.starts_with("Robustness: ")), "{names:?}");
    for target in cases(&sections[0]) {
        assert!(
            target["values"][0]["met"].is_boolean() && target["values"][1]["value"].as_f64() > Some(0.0),
            "{target}"
        );
    }
    // Two scenes with six cases each: the truth, no registration, three methods and the aligned pair.
    assert_eq!(cases(&sections[1]).len(), 2 * 6);
    let unified: Vec<&Value> =
        cases(&sections[1]).iter().filter(|c| c["name"].as_str().unwrap().ends_with("unified")).collect();
    for case in &unified {
        let value = |name: &str| {
            case["values"].as_array().unwrap().iter().find(|v| v["name"] == name).unwrap()["value"].as_f64().unwrap()
        };
        assert!(value("corners, px") < 0.25 && value("V to aligned, px²") > 0.0, "{case}");
    }
    assert_eq!((unified.len(), cases(&sections[2]).len()), (2, 6));
    assert!(report["defaults"].as_array().unwrap().is_empty() && report["sweeps"].as_array().unwrap().is_empty());

    assert!(
        text.contains("Table 1") && !text.contains("## Default settings") && !text.contains("## Focus sweeps"),
        "{text}"
    );
    assert!(text.contains("absent: looked for pairs/cup/breakfast_near.png"), "{text}");
    let links: Vec<&str> = text.split("](").skip(1).filter_map(|rest| rest.split(')').next()).collect();
    assert_eq!(links, ["fig4-scenes.png", "robustness.png"]);
    let out = folder.path().join("made/out");
    for link in links {
        assert!(image::open(out.join(link)).unwrap().width() > 500, "{link}");
    }
    assert_eq!(fs::read_dir(&out).unwrap().count(), 4);
}

#[test]
fn bounds_of_the_default_settings_are_measured_where_data_exist() {
    let folder = TempDir::new().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data");
    let (report, text, log) = evaluated(&folder, "defaults", data.to_str().unwrap());
    let sections = report["defaults"].as_array().unwrap();
    assert_eq!(sections.len(), 7);
    for section in sections {
        for case in cases(section) {
            // Only cases without data have no values.
            let absent = case["note"].as_str().unwrap().contains("no such file");
            assert_eq!(case["values"].as_array().unwrap().is_empty(), absent, "{}: {case}", section["name"]);
        }
    }
    assert!(log.contains("| part 57 |") && log.contains("### Shading: "), "{log}");
    assert!(!log.contains("part 57 | – |"), "the data for the part exist in the repository: {log}");
    assert!(text.contains("## Default settings") && !text.contains("Table 1"), "{text}");
}

#[test]
fn absent_sweeps_get_a_row_and_the_simulated_sweep_is_solved() {
    let folder = TempDir::new().unwrap();
    let (report, text, log) = evaluated(&folder, "sweeps", "none");
    assert!(log.contains("## Focus sweeps") && text.contains("### Simulated sweep: "), "{log}");
    let sections = report["sweeps"].as_array().unwrap();
    assert!(sections.len() == 4 && sections.iter().all(|section| cases(section).len() == 1), "{report}");
    assert!(cases(&sections[0])[0]["note"].as_str().unwrap().contains("no such file"), "{report}");
    for section in &sections[1..] {
        assert!(!cases(section)[0]["values"].as_array().unwrap().is_empty(), "{report}");
    }
    assert!(report["paper"].as_array().unwrap().is_empty() && report["defaults"].as_array().unwrap().is_empty());
}

#[test]
fn inputs_that_do_not_fit_are_asked_and_counted() {
    let folder = TempDir::new().unwrap();
    let (report, text, log) = evaluated(&folder, "judgement", "none");
    assert!(log.contains("## Judgement") && text.contains("### Sweeps that do not fit: "), "{log}");
    let sections = report["judgement"].as_array().unwrap();
    let names: Vec<&str> = sections.iter().map(|section| section["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["Sweeps that do not fit", "Pairs that do not fit", "Inputs that fit"]);
    for case in sections.iter().flat_map(cases) {
        let value = |name: &str| case["values"].as_array().unwrap().iter().find(|v| v["name"] == name).unwrap();
        assert_eq!(value("asked")["value"], 1.0, "{case}");
        let right = value("answered rightly");
        // What is wrong is a missed bound with its reason.
        assert_eq!(right["met"].as_bool().unwrap(), right["value"] == 1.0, "{case}");
        assert_eq!(case["note"].as_str().unwrap().is_empty(), right["value"] == 1.0, "{case}");
    }
    assert!(sections.iter().all(|section| cases(section).len() == 2), "{report}");
}

#[test]
fn a_file_and_files_of_other_programs_are_refused_before_any_work() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("out"), "x").unwrap();
    let (status, log) = run(&folder, &["-o", "out"]);
    assert!(status == Some(1) && log.lines().count() == 1 && log.contains("give a folder"), "{log}");
    for name in ["report.md", "robustness.png"] {
        fs::create_dir_all(path("made")).unwrap();
        fs::write(path("made").join(name), "mine").unwrap();
        let (status, log) = run(&folder, &["-o", "made"]);
        assert!(
            status == Some(1) && [name, "is there already", "--force"].iter().all(|part| log.contains(part)),
            "{log}"
        );
        assert_eq!(fs::read_to_string(path("made").join(name)).unwrap(), "mine");
        fs::remove_file(path("made").join(name)).unwrap();
    }
}
