//! Hostile and damaged input: malicious files, pipes, modified results, terminated programs.

use std::fs;
use std::path::Path;

use crate::desk::{Desk, assert_refused, stderr_of};
use crate::synthetic::WIDE_LENS;

/// An EXR file with one changed byte that makes the decoder allocate all memory.
const DWAA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/hostile/dwaa_abort.exr");

/// Runs `batch` on list.csv and asserts its exit status. Returns the status of each pair.
#[track_caller]
fn batch(desk: &Desk, extra: &[&str], status: i32) -> Vec<String> {
    let own = ["batch", "list.csv", "-o", "many", "--outer-iterations", "6", "--no-html", "--quiet"];
    desk.exits(&[&own[..], extra].concat(), status);
    let summary = desk.json("many/batch.json");
    summary["pairs"].as_array().unwrap().iter().map(|row| row["status"].as_str().unwrap().to_string()).collect()
}

#[cfg(unix)]
fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
}

#[test]
fn a_malicious_file_does_not_end_a_batch() {
    let desk = Desk::with_pair();
    fs::copy(DWAA, desk.path("broken.exr")).unwrap();
    desk.write("list.csv", "i1.png,i2.png,a\nbroken.exr,broken.exr,b\ni1.png,i2.png,c\n");
    assert_eq!(batch(&desk, &[], 1), ["solved", "failed", "solved"]);
    desk.refuses_in_one_line(
        &["solve", "broken.exr", "broken.exr", "-o", "out"],
        &["broken.exr: is compressed by DWAA", "ZIP"],
    );
}

#[test]
fn resume_solves_pairs_again_whose_results_were_modified() {
    let desk = Desk::with_pair();
    desk.write("list.csv", "i1.png,i2.png,a\ni2.png,i1.png,b\n");
    assert_eq!(batch(&desk, &[], 0), ["solved", "solved"]);
    assert_eq!(batch(&desk, &["--resume"], 0), ["kept", "kept"]);

    let cut = desk.path("many/a/relative_blur.exr");
    let whole = fs::read(&cut).unwrap();
    fs::write(&cut, &whole[..whole.len() - 1]).unwrap();
    assert_eq!(batch(&desk, &["--resume"], 0), ["solved", "kept"]);
    fs::copy(desk.path("many/b/uncertainty.exr"), desk.path("many/a/uncertainty.exr")).unwrap();
    assert_eq!(batch(&desk, &["--resume"], 0), ["solved", "kept"]);

    // Reports of early versions have no hashes.
    let mut report = desk.report("many/b");
    report.as_object_mut().unwrap().remove("hashes").unwrap();
    desk.write("many/b/report.json", report.to_string());
    assert_eq!(batch(&desk, &["--resume"], 0), ["kept", "solved"]);
}

#[test]
fn files_of_later_commands_are_covered_by_hashes() {
    let desk = Desk::with_pair();
    desk.write("list.csv", "i1.png,i2.png,a\n");
    assert_eq!(batch(&desk, &[], 0), ["solved"]);
    desk.done(&[&["depth", "many/a", "--quiet"], &WIDE_LENS[..]].concat());
    assert_eq!(batch(&desk, &["--resume"], 0), ["kept"]);
    fs::copy(desk.path("many/a/relative_blur.exr"), desk.path("many/a/depth_mm.exr")).unwrap();
    assert_eq!(batch(&desk, &["--resume"], 0), ["solved"]);
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_as_any_input() {
    let desk = Desk::with_pair();
    desk.make_pipe("pipe");
    let solve = ["solve", "i1.png", "i2.png", "-o", "out"];
    for file in ["pipe", "/dev/zero"] {
        desk.refuses_in_one_line(&["solve", "i1.png", file, "-o", "out"], &[file, "regular file"]);
        for flag in ["--mask", "--lens", "--transform", "--config"] {
            desk.refuses_in_one_line(&[&solve[..], &[flag, file]].concat(), &[file, "regular file"]);
        }
        desk.refuses_in_one_line(&["batch", file, "-o", "many"], &[file, "regular file"]);
    }
}

#[cfg(unix)]
#[test]
fn a_folder_locked_by_another_parfocal_is_refused() {
    let desk = Desk::with_pair();
    fs::create_dir(desk.path("out")).unwrap();
    let other = fs::File::open(desk.path("out")).unwrap();
    other.lock().unwrap();
    desk.refuses_in_one_line(
        &["simulate", "plane", "--size", "48x32", "-o", "out", "--quiet"],
        &["out", "another parfocal"],
    );
    drop(other);
    assert!(names_in(&desk.path("out")).is_empty());
    desk.done(&["simulate", "plane", "--size", "48x32", "-o", "out", "--quiet"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_terminated_program_leaves_no_partial_files() {
    let desk = Desk::with_pair();
    for (signal, status) in [("-TERM", 143), ("-INT", 130)] {
        let out = desk.path(signal);
        let arguments = ["simulate", "plane", "--size", "700x500", "--quiet", "-o"];
        let mut running = desk.process(&arguments).arg(&out).spawn().unwrap();
        while names_in(&out).is_empty() && running.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let kill = std::process::Command::new("kill").args([signal, &running.id().to_string()]).status().unwrap();
        let ended = running.wait().unwrap();
        let left = names_in(&out);
        assert!(left.iter().all(|name| !name.starts_with(".parfocal")), "{signal}: {left:?}");
        // The program may finish before the signal arrives.
        assert!(ended.code() == Some(status) || (ended.success() && left.len() > 3), "{kill} {ended}: {left:?}");
    }
}

#[test]
fn images_too_large_for_the_device_are_not_decoded() {
    let desk = Desk::with_pair().on_vulkan();
    let mut bytes = Vec::new();
    let wide = image::GrayImage::new(60_000, 300);
    wide.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    // The file is truncated, so decoding it would give another error.
    desk.write("wide.png", &bytes[..bytes.len() / 2]);
    // `solve` supports this size in tiles, so its error is of the truncated file.
    desk.refuses_in_one_line(&["solve", "wide.png", "wide.png", "-o", "out"], &["wide.png"]);
    desk.refuses_in_one_line(&["register", "wide.png", "wide.png"], &["wide.png: 60000x300 is too large", "60000 px"]);
    desk.refuses_in_one_line(
        &["stack", "wide.png", "wide.png", "wide.png", "-o", "out"],
        &["wide.png: 60000x300 is too large"],
    );
    desk.write("list.csv", "wide.png,wide.png,a\ni1.png,i2.png,b\n");
    assert_eq!(batch(&desk, &[], 1), ["failed", "solved"]);
}

#[cfg(unix)]
#[test]
fn control_characters_in_names_are_escaped() {
    let desk = Desk::with_pair();
    let shot = "a\x1b[2J\nb.png";
    fs::copy(desk.path("i1.png"), desk.path(shot)).unwrap();
    desk.write("list.csv", format!("\"{shot}\",i2.png,a\n\"gone{shot}\",i2.png,b\n"));
    let output = desk.run(&["batch", "list.csv", "-o", "many\x1b[2J", "--outer-iterations", "6", "--no-html"]);
    let text = stderr_of(&output);
    assert!(!text.contains('\x1b') && text.contains(r"gonea\u{1b}[2J b.png: there is no such file"), "{text}");
    assert!(text.contains("1 solved, 0 kept, 1 failed"), "{text}");
    assert!(text.lines().any(|line| line.ends_with(r"many\u{1b}[2J/batch.json")), "{text}");
    let solve = ["solve", "gone\x1b[2J.png", "i2.png", "-o", "out\x1b[2J"];
    desk.refuses_in_one_line(&solve, &[r"gone\u{1b}[2J.png: there is no such file"]);
    assert!(!stderr_of(&desk.run(&solve)).contains('\x1b'));
    // Invalid arguments are escaped as well.
    let typed = "x\x1b[2J\nerror: y\u{9b}1m";
    let [option, value] = [format!("--{typed}"), format!("--relaxation-sweeps={typed}")];
    for arguments in
        [&[typed][..], &["solve", &option], &["solve", &value], &["--", typed], &["solve", "a", "b", typed]]
    {
        let text = stderr_of(&desk.exits(arguments, 2));
        assert!(text.contains(r"x\u{1b}[2J\nerror: y\u{9b}1m"), "{text}");
        assert!(!text.contains(['\x1b', '\u{9b}']) && text.matches("\nerror").count() == 0, "{text}");
    }
}

#[test]
fn a_driver_that_cannot_be_loaded_is_the_reported_error() {
    let desk = Desk::with_pair();
    for text in ["no manifest", r#"{"file_format_version": "1.0.0", "ICD": {"library_path": "/nowhere.so"}}"#, "{}"] {
        desk.write("driver.json", text);
        let mut command = desk.command(&["register", "i1.png", "i2.png", "--device", "vulkan"]);
        command.env("VK_DRIVER_FILES", desk.path("driver.json")).env("VK_ICD_FILENAMES", desk.path("driver.json"));
        let output = command.output().unwrap();
        assert_refused(&output, 1, &["error: no Vulkan device", "no driver could be loaded", "VK_DRIVER_FILES"]);
        assert!(!stderr_of(&output).contains("smaller"), "{text}: {}", stderr_of(&output));
    }
}
