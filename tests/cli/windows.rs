//! What only Windows has: patterns that no shell expands, names of devices, long paths, lists with its line ends.

use std::fs::{self, File};

use crate::desk::{Desk, assert_refused};

#[test]
fn a_pattern_names_the_frames_of_a_sweep() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "sweep", "--size", "80x64", "--frames", "3", "--quiet"]);
    desk.done(&["stack", r"sweep\frame_*.png", "-o", "out", "--no-html"]);
    assert_eq!(desk.report("out")["frames"].as_array().unwrap().len(), 3);
}

#[test]
fn results_are_replaced_and_one_that_is_locked_is_named() {
    let desk = Desk::with_pair();
    let solve = ["solve", "i1.png", "i2.png", "-o", "out"];
    desk.done(&solve);
    let first = desk.bytes("out/relative_blur.exr");
    // Another program may read the results meanwhile, as viewers do that share them.
    let open = File::open(desk.path("out/relative_blur.exr")).unwrap();
    desk.done(&solve);
    drop(open);
    assert_eq!(desk.bytes("out/relative_blur.exr"), first);
    // Without sharing, nothing is replaced.
    let report = desk.bytes("out/report.json");
    let open = std::os::windows::fs::OpenOptionsExt::share_mode(File::options().read(true), 0)
        .open(desk.path("out/relative_blur.exr"))
        .unwrap();
    assert_refused(&desk.run(&solve), 1, &["relative_blur.exr", "close programs that show it"]);
    drop(open);
    assert_eq!(desk.bytes("out/report.json"), report);
    assert!(
        !fs::read_dir(desk.path("out")).unwrap().any(|e| e.unwrap().file_name().to_string_lossy().starts_with('.'))
    );
}

#[test]
fn names_of_devices_are_refused_and_lists_with_crlf_are_read() {
    let desk = Desk::with_pair();
    desk.write("list.csv", "\u{feff}I1,I2,NAME\r\ni1.png,i2.png,aux.1\r\n");
    desk.refuses(&["batch", "list.csv", "-o", "out"], 1, &["line 2: 'aux.1' cannot name a folder"]);
    desk.write("list.csv", "\u{feff}I1,I2,NAME\r\ni1.png,i2.png,part\r\n");
    desk.done(&["batch", "list.csv", "-o", "out"]);
    assert!(desk.has("out/part/report.json"));
}

#[test]
fn a_path_may_exceed_260_characters() {
    let desk = Desk::with_pair();
    let out = format!("{0}/{0}", "long".repeat(40));
    desk.done(&["solve", "i1.png", "i2.png", "-o", &out]);
    desk.done(&["solve", "i1.png", "i2.png", "-o", &out]);
    desk.done(&["view", &out, "--width", "64"]);
}
