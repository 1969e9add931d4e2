//! Tests of results that are written and read.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use super::*;
use crate::base::{
    Channels, Decode, Depth, DeviceInfo, Error, Photometric, Region, Samples, Settings, Shading, Similarity,
};
use crate::engine::{Findings, LevelHistory, Solution, Timings};
use crate::files::image_io::{self, Values};

fn solution() -> Solution {
    let findings = Findings {
        width: 3,
        height: 2,
        origin: [0, 0],
        photograph: [3, 2],
        fused_channels: Channels::Gray,
        transform: Similarity::new(1.25, -0.5, 0.15, 1.01).into(),
        other_motion: None,
        photometric: Photometric { gain: 1.02, offset: -0.01 },
        shading: Shading::NONE,
        solved: Region { x: 0, y: 0, width: 3, height: 2 },
        regularization: 0.003,
        kernel_shape: Some(0.5),
        levels: vec![LevelHistory { width: 2, height: 1, energy: vec![0.5, f64::NAN] }],
        converged: true,
        warnings: vec!["a warning".to_string()],
        valid_fraction: 4.0 / 6.0,
        mean_confidence: 0.0,
        saturated_fraction: f64::NAN,
        timings: Timings { total_ms: 9.0, gpu_ms: 7.0, passes_ms: vec![("warp", 1.0), ("blur", 2.0), ("apply", 3.0)] },
    };
    Solution {
        relative_blur: vec![f32::NAN, -1.5, 0.1, 2.0, 4.0, f32::NAN],
        uncertainty: vec![f32::NAN, 3f32.sqrt(), 1.0, (1.0f32 / 3.0).sqrt(), 0.0, f32::NAN],
        residual: vec![f32::NAN, 0.01, 0.02, 0.01, 0.03, f32::NAN],
        confidence: vec![0.0, 0.25, 0.5, 0.75, 1.0, 0.0],
        fused: vec![-0.1, 0.0, 0.2, 0.5, 1.0, 1.5],
        findings,
    }
}

fn device() -> DeviceInfo {
    DeviceInfo {
        index: 0,
        name: "a device".to_string(),
        driver: "a driver 1.2".to_string(),
        uuid: "00000000-0000-0000-0000-000000000001".to_string(),
        kind: "CPU",
        api_version: "1.3.0".to_string(),
        subgroup_size: 8,
        memory_bytes: 1,
        max_image_size: 1,
        max_storage_buffer: 1,
        unusable: None,
    }
}

fn report() -> Report {
    Report::pair(&solution(), &Settings::default(), &device(), Nearer::First)
}

fn write(out: &Path, solution: &Solution, depth: Depth) -> Result<(), Error> {
    let mut report = report();
    report.values = Values::stated(Decode::None);
    Results::of_pair(solution, report, [depth; 2])?.write(out, &Drawing::default(), Vec::new())
}

fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

#[test]
fn the_report_has_the_fields_that_scripts_read() {
    let text = report().to_json().unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let mut expected = vec![
        "program",
        "kind",
        "version",
        "frames",
        "reference",
        "regularization",
        "method",
        "settings",
        "size",
        "kernel_shape",
        "levels",
        "converged",
        "relative_blur",
        "valid_fraction",
        "mean_confidence",
        "saturated_fraction",
        "nearer",
        "nearer_by",
        "warnings",
        "device",
        "validated",
        "values",
        "inputs",
        "photograph",
        "region",
        "texture",
        "timings_ms",
    ];
    expected.sort_unstable();
    assert_eq!(keys(&json), expected);
    assert_eq!((&json["program"], &json["kind"]), (&"parfocal".into(), &"pair".into()));
    assert_eq!(keys(&json["frames"][1]), ["file", "gain", "offset", "shading", "transform"]);
    assert_eq!(keys(&json["frames"][1]["transform"]), ["rotation_deg", "scale", "tx_px", "ty_px"]);
    assert_eq!(keys(&json["frames"][1]["shading"]), ["coefficients", "range", "region"]);
    assert_eq!((&json["frames"][0]["gain"], &json["frames"][1]["gain"]), (&1.0.into(), &1.02.into()));
    assert_eq!(keys(&json["levels"][0]), ["energy", "height", "iterations", "width"]);
    assert_eq!(keys(&json["relative_blur"]), ["max", "median", "min"]);
    assert_eq!(keys(&json["timings_ms"]), ["gpu", "passes", "total"]);
    assert_eq!((&json["method"], &json["nearer"]), (&Value::from("unified"), &Value::from(1)));
    assert_eq!(json["settings"]["levels"], Value::Null);
    assert_eq!(json["settings"]["start_photometric"]["gain"], Value::from(1.0));
    assert_eq!(json["levels"][0]["iterations"], Value::from(2));
    assert_eq!((&json["levels"][0]["energy"][1], &json["saturated_fraction"]), (&Value::Null, &Value::Null));
    assert_eq!(json["relative_blur"]["median"], Value::from(1.05));
    let places: Vec<_> = ["\"warp\"", "\"blur\"", "\"apply\""].map(|name| text.find(name).unwrap()).to_vec();
    assert!(places.is_sorted(), "passes are out of order");
    let again = serde_json::from_str::<Report>(&text).unwrap().to_json().unwrap();
    let mut back: Value = serde_json::from_str(&again).unwrap();
    // Transforms pass through a matrix, and serde_json reads the last bit of a number either way.
    back["frames"] = json["frames"].clone();
    assert_eq!(back, json, "it is read as it was written");
}

#[test]
fn without_a_valid_pixel_the_range_is_null() {
    let json = serde_json::to_value(RangeReport::of(&[f32::NAN; 4])).unwrap();
    assert!(["min", "max", "median"].iter().all(|name| json[name].is_null()));
}

#[test]
fn the_files_of_a_solve_are_read_as_they_were_written() {
    let base = TempDir::new().unwrap();
    let out = base.path().join("deep/out");
    write(&out, &solution(), Depth::U8).unwrap();
    let mut found: Vec<_> =
        fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    let mut expected = Kind::Pair.files();
    found.sort_unstable();
    expected.sort_unstable();
    assert_eq!(found, expected);

    let results = Results::read(&out).unwrap();
    assert_eq!(results.field("confidence").unwrap(), solution().confidence);
    assert!(results.field("focus").unwrap_err().to_string().contains("the fields are relative_blur"));
    assert!(results.values()[0].is_nan() && results.values()[1..5] == solution().relative_blur[1..5]);
    let stated: Vec<_> = results.report.fields.iter().map(|field| (&*field.name, &*field.file)).collect();
    assert_eq!(stated[0], ("relative_blur", "relative_blur.exr"));
    let hashed: Vec<_> = results.report.hashes.keys().map(String::as_str).collect();
    assert!(hashed.len() + 1 == expected.len() && !hashed.contains(&"report.json"));
    let registration = Registration::read(&out.join("report.json")).unwrap();
    let second = registration.second().unwrap();
    assert!(second.transform.corner_distance(solution().transform, 4000, 3000) < 1e-9);
    assert_eq!(second.photometric, Some(solution().photometric));

    let image = exr::prelude::read_first_flat_layer_from_file(out.join("relative_blur.exr")).unwrap();
    assert_eq!(image.layer_data.channel_data.list[0].name.to_string(), "Y");
    let attributes = &image.layer_data.attributes;
    assert!(attributes.software_name.as_ref().unwrap().to_string().starts_with("parfocal "));
    assert_eq!(attributes.other.len(), 1);
}

#[test]
fn the_fused_image_has_the_depth_of_the_inputs() {
    let base = TempDir::new().unwrap();
    let path = base.path().join("fused.png");
    write(base.path(), &solution(), Depth::U8).unwrap();
    assert_eq!(image_io::read(&path).unwrap().samples(), &Samples::U8(vec![0, 0, 51, 128, 255, 255]));
    for (depth, has_floats) in [(Depth::U16, false), (Depth::F32, true)] {
        write(base.path(), &solution(), depth).unwrap();
        assert_eq!(image_io::read(&path).unwrap().samples(), &Samples::U16(vec![0, 0, 13107, 32768, 65535, 65535]));
        assert_eq!(base.path().join("fused.exr").exists(), has_floats);
    }
    let fused = Results::read(base.path()).unwrap().fused().unwrap();
    assert_eq!(fused.samples(), &Samples::F32(solution().fused));
}

#[test]
fn a_solution_that_contradicts_itself_is_not_written() {
    let base = TempDir::new().unwrap();
    let out = base.path().join("out");
    let mut wrong = solution();
    wrong.fused.pop();
    assert!(matches!(write(&out, &wrong, Depth::U8), Err(Error::Mismatch(_))));
    let mut wrong = solution();
    wrong.residual.pop();
    assert!(matches!(write(&out, &wrong, Depth::U8), Err(Error::Mismatch(_))));
    assert!(!out.exists());
}
