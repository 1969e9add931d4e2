//! Existing files in output folders: the program replaces its own files and keeps foreign files.

use std::fs;

use serde_json::{Value, json};

use crate::desk::Desk;
use crate::synthetic::WIDE_LENS;

/// Options that name a missing device. A file check must fail before the device is opened.
const NO_DEVICE: [&str; 2] = ["--device", "no such GPU"];
#[track_caller]
fn solve(desk: &Desk, extra: &[&str]) {
    let quick = ["solve", "i1.png", "i2.png", "-o", "out", "--outer-iterations", "6", "--no-html"];
    desk.done(&[&quick[..], extra].concat());
}

/// Writes a foreign file, one that the program did not write.
fn write_foreign(desk: &Desk, name: &str) {
    desk.write(name, "mine");
}

#[track_caller]
fn assert_foreign_kept(desk: &Desk, name: &str) {
    assert_eq!(desk.text(name), "mine", "{name}");
}

#[test]
fn solve_keeps_files_that_it_did_not_write() {
    let desk = Desk::with_pair();
    let foreign =
        ["surface.ply", "labels.png", "focus.exr", "profile_1.csv", "depth_mm.exr", "fused.exr", "report.html"];
    let foreign = foreign.map(|name| format!("out/{name}"));
    foreign.iter().for_each(|name| write_foreign(&desk, name));
    solve(&desk, &[]);
    solve(&desk, &["--force"]);
    foreign.iter().for_each(|name| assert_foreign_kept(&desk, name));
}

#[test]
fn solve_removes_only_files_that_its_report_lists_within_the_folder() {
    let desk = Desk::with_pair();
    solve(&desk, &["--export", "ply,labels", "--profile", "10,10,60,10"]);
    let mut report = desk.report("out");
    for name in ["surface.ply", "labels.png", "profile_1.csv", "profile_1.png", "report.json"] {
        assert!(report["files"].as_array().unwrap().contains(&json!(name)), "{name} in {}", report["files"]);
    }
    for name in ["victim", "out/deep/victim", "out/kept"] {
        write_foreign(&desk, name);
    }
    let absolute = desk.path("victim").display().to_string();
    let names = report["files"].as_array_mut().unwrap();
    names.extend(["../victim", "deep/victim", "deep", "link", "..", "", &absolute].map(Value::from));
    desk.write("out/report.json", report.to_string());
    #[cfg(unix)]
    std::os::unix::fs::symlink("../victim", desk.path("out/link")).unwrap();
    solve(&desk, &[]);
    for name in ["surface.ply", "labels.png", "profile_1.csv", "profile_1.png"] {
        assert!(!desk.has(&format!("out/{name}")), "{name}");
    }
    for name in ["victim", "out/deep/victim", "out/kept"] {
        assert_foreign_kept(&desk, name);
    }
    #[cfg(unix)]
    assert!(fs::symlink_metadata(desk.path("out/link")).is_ok());
}

#[test]
fn foreign_files_are_refused_before_any_work_and_overwritten_by_force() {
    let desk = Desk::with_pair();
    write_foreign(&desk, "out/fused.png");
    let own = ["solve", "i1.png", "i2.png", "-o", "out"];
    desk.refuses_in_one_line(&[&own[..], &NO_DEVICE].concat(), &["out/fused.png: is there already", "--force"]);
    assert_foreign_kept(&desk, "out/fused.png");
    for (extra, name) in [
        (&["--export", "glb"][..], "surface.glb"),
        (&["--profile", "10,10,60,10"], "profile_1.png"),
        (&WIDE_LENS, "depth_mm.exr"),
        (&[], "report.json"),
    ] {
        fs::remove_dir_all(desk.path("out")).unwrap();
        write_foreign(&desk, &format!("out/{name}"));
        desk.refuses_in_one_line(&[&own[..], &NO_DEVICE, extra].concat(), &[name, "--force"]);
    }
    solve(&desk, &["--force"]);
    assert!(desk.report("out")["files"].as_array().unwrap().contains(&json!("fused.png")));
    // A report of another program does not make its listed files ours.
    desk.write("out/report.json", r#"{"version": "1.0", "files": ["fused.png"]}"#);
    desk.refuses_in_one_line(&[&own[..], &NO_DEVICE].concat(), &["is there already", "--force"]);
    assert!(desk.has("out/fused.png"));
}

#[test]
fn files_of_later_commands_are_listed_and_replaced() {
    let desk = Desk::with_pair();
    solve(&desk, &[]);
    for _ in 0..2 {
        desk.done(&[&["depth", "out"], &WIDE_LENS[..]].concat());
        desk.done(&["measure", "out", "--profile", "10,10,60,10", "--profile", "10,20,60,20"]);
        desk.done(&["view", "out", "--turntable", "out/turn.gif", "--turntable-width", "64", "--width", "64"]);
        let region = ["--known", "2,2,30,30=500"];
        desk.done(&[&["calibrate", "out", "-o", "out/lens.json"], &WIDE_LENS[..], &region].concat());
    }
    let listed = desk.report("out")["files"].clone();
    let listed = listed.as_array().unwrap();
    for name in ["depth_mm.exr", "profile_1.csv", "profile_2.png"] {
        assert_eq!(listed.iter().filter(|n| *n == name).count(), 1, "{name} in {listed:?}");
    }
    write_foreign(&desk, "out/profile_3.csv");
    desk.done(&["measure", "out", "--profile", "10,10,60,10"]);
    assert!(!desk.has("out/profile_2.csv") && !desk.report("out")["files"].to_string().contains("profile_2"));
    assert_foreign_kept(&desk, "out/profile_3.csv");
    let three = ["--profile", "1,1,9,9", "--profile", "1,1,9,9", "--profile", "1,1,9,9"];
    desk.refuses_in_one_line(&[&["measure", "out"], &three[..]].concat(), &["profile_3.csv", "--force"]);
    solve(&desk, &[]);
    assert!(!desk.has("out/depth_mm.exr") && !desk.has("out/profile_1.csv") && desk.has("out/lens.json"));
    for (command, name) in [("view", "view.png"), ("depth", "depth_mm.exr")] {
        write_foreign(&desk, &format!("out/{name}"));
        let arguments = [&[command, "out"][..], if command == "depth" { &WIDE_LENS[..] } else { &[] }].concat();
        desk.refuses_in_one_line(&arguments, &[name, "--force"]);
        assert_foreign_kept(&desk, &format!("out/{name}"));
        desk.done(&[&arguments[..], &["--force"]].concat());
    }
}

#[test]
fn simulate_and_solve_do_not_replace_each_other_s_files() {
    let desk = Desk::with_pair();
    solve(&desk, &[]);
    let simulate =
        |extra: &[&'static str]| [&["simulate", "plane", "--size", "48x32", "--quiet", "-o"], extra].concat();
    desk.refuses_in_one_line(&simulate(&["out"]), &["relative_blur.exr", "--force"]);
    desk.refuses_in_one_line(&["solve", "i1.png", "i2.png", "-o", "scene"], &["relative_blur.exr", "--force"]);
    write_foreign(&desk, "scene/depth.exr");
    desk.done(&simulate(&["scene"]));
    assert_foreign_kept(&desk, "scene/depth.exr");
    write_foreign(&desk, "new/i1.png");
    desk.refuses_in_one_line(&simulate(&["new"]), &["new/i1.png", "--force"]);
    desk.done(&simulate(&["new", "--force"]));
}

#[test]
fn every_command_refuses_to_overwrite_foreign_files() {
    let desk = Desk::with_pair();
    let files =
        ["t.json", "bench/report.json", "moved/i2.png", "pages/parfocal.1", "many/batch.json", "many/a/report.json"];
    let figures = ["tables/report.md", "figures/robustness.png"];
    files.iter().chain(&figures).for_each(|name| write_foreign(&desk, name));
    for (arguments, name) in [
        (&["register", "i1.png", "i2.png", "-o", "t.json", "--device", "none"][..], "t.json"),
        (&["bench", "-o", "bench/report.json", "--device", "none"], "bench/report.json"),
        (&["bench", "--trace", "t.json", "--device", "none"], "t.json"),
        (&["apply", "scene/i1.png", "i2.png", "--transform", "scene/truth.json", "-o", "moved"], "moved/i2.png"),
        (&["man", "-o", "pages"], "pages/parfocal.1"),
        (&["batch", "list.csv", "-o", "many", "--device", "none"], "many/batch.json"),
    ] {
        desk.write("list.csv", "i1.png,i2.png,a\n");
        desk.refuses_in_one_line(arguments, &[name, "is there already", "--force"]);
        assert_foreign_kept(&desk, name);
    }
    assert!(!desk.has("moved/i1.png"), "no file may be written if one is refused");
    fs::remove_file(desk.path("many/batch.json")).unwrap();
    // The summary says so too.
    let parts = ["failed: a: many/a/report.json", "--force", "error: 1 of 1 pairs failed: a"];
    desk.refuses(&["batch", "list.csv", "-o", "many", "--device", "none"], 1, &parts);
    assert_foreign_kept(&desk, "many/a/report.json");
    for _ in 0..2 {
        let apply = ["apply", "scene/i1.png", "i2.png", "--transform", "scene/truth.json", "-o", "moved", "--force"];
        desk.done(&apply);
        desk.done(&["man", "-o", "pages", "--force"]);
    }
    desk.done(&["man", "-o", "pages"]);
}

#[test]
fn no_pair_of_a_batch_is_written_outside_its_folder() {
    let desk = Desk::with_pair();
    fs::copy(desk.path("i1.png"), desk.path("...png")).unwrap();
    fs::copy(desk.path("i1.png"), desk.path("..png")).unwrap();
    for (line, name) in [("...png,i2.png", "'..'"), ("..png,i2.png", "'.'"), ("scene/..,i2.png", "''")] {
        desk.write("list.csv", format!("i1.png,i2.png\n{line}\n"));
        desk.refuses_in_one_line(&["batch", "list.csv", "-o", "out/many"], &["list.csv: line 2", name]);
        assert!(!desk.has("out"));
    }
}

#[cfg(unix)]
mod links_and_devices {
    use std::os::unix::fs::{FileTypeExt, symlink};

    use super::*;

    #[test]
    fn links_and_pipes_in_a_results_folder_are_refused() {
        let desk = Desk::with_pair();
        write_foreign(&desk, "victim");
        solve(&desk, &[]);
        fs::remove_file(desk.path("out/fused.png")).unwrap();
        symlink("../victim", desk.path("out/fused.png")).unwrap();
        let own = ["solve", "i1.png", "i2.png", "-o", "out", "--force", NO_DEVICE[0], NO_DEVICE[1]];
        desk.refuses_in_one_line(&own, &["out/fused.png: is a symbolic link"]);
        fs::remove_file(desk.path("out/fused.png")).unwrap();
        desk.make_pipe("out/fused.png");
        desk.refuses_in_one_line(&own, &["out/fused.png: is a device or a pipe"]);
        assert_foreign_kept(&desk, "victim");
    }

    #[test]
    fn links_and_pipes_named_as_output_are_written_through() {
        let desk = Desk::with_pair();
        let register = |to: &str| {
            ["register", "i1.png", "i2.png", "--method", "appearance", "--quiet", "-o", to].map(String::from)
        };
        let register = |to: &str, extra: &[&str]| {
            let all = register(to);
            desk.run(&all.iter().map(String::as_str).chain(extra.iter().copied()).collect::<Vec<_>>())
        };
        let output = register("/dev/stdout", &[]);
        assert_eq!(crate::desk::printed(&output)["method"], "appearance");

        symlink("kept/t.json", desk.path("link.json")).unwrap();
        fs::create_dir(desk.path("kept")).unwrap();
        assert_eq!(register("link.json", &[]).status.code(), Some(1), "a dangling link must be refused");
        write_foreign(&desk, "kept/t.json");
        assert_eq!(register("link.json", &[]).status.code(), Some(1));
        assert_foreign_kept(&desk, "kept/t.json");
        assert!(register("link.json", &["--force"]).status.success());
        assert!(register("link.json", &[]).status.success(), "the target was written by parfocal and may be replaced");
        assert!(fs::symlink_metadata(desk.path("link.json")).unwrap().is_symlink());
        assert!(desk.text("kept/t.json").contains("transform"));

        let pipe = desk.path("pipe");
        desk.make_pipe("pipe");
        let reader = std::thread::spawn(move || fs::read_to_string(pipe).unwrap());
        assert!(register("pipe", &[]).status.success());
        assert!(reader.join().unwrap().contains("transform"));
        assert!(fs::symlink_metadata(desk.path("pipe")).unwrap().file_type().is_fifo());
    }
}
