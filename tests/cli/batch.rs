//! `parfocal batch` and `watch` on small synthetic pairs.

use std::fs;
use std::process::Output;

use serde_json::Value;

use crate::desk::{Desk, assert_fails, assert_refused, printed, stderr_of};

/// Returns a folder with pairs in `shots`: copies of one small scene under several names.
fn desk(names: &[[&str; 2]]) -> Desk {
    let desk = Desk::new();
    desk.done(&["simulate", "plane", "--size", "80x64", "-o", "scene", "--quiet"]);
    fs::create_dir(desk.path("shots")).unwrap();
    for pair in names {
        for (name, from) in pair.iter().zip(["i1.png", "i2.png"]) {
            fs::copy(desk.path("scene").join(from), desk.path("shots").join(name)).unwrap();
        }
    }
    desk
}

fn batch(desk: &Desk, source: &str, extra: &[&str]) -> Output {
    desk.run(&[&["batch", source, "-o", "out", "--outer-iterations", "6", "--json"], extra].concat())
}

/// Runs a batch and asserts its exit status. Returns batch.json, which must equal the printed JSON.
#[track_caller]
fn tally(desk: &Desk, source: &str, extra: &[&str], status: i32) -> Value {
    let output = batch(desk, source, extra);
    assert_eq!(output.status.code(), Some(status), "{}", stderr_of(&output));
    let written = desk.json("out/batch.json");
    assert_eq!(printed(&output), written);
    written
}

fn statuses(summary: &Value) -> Vec<String> {
    let row = |row: &Value| format!("{} {}", row["name"].as_str().unwrap(), row["status"].as_str().unwrap());
    summary["pairs"].as_array().unwrap().iter().map(row).collect()
}

#[test]
fn resume_solves_only_pairs_that_changed() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_near.png", "b_far.png"]]);
    let summary = tally(&desk, "shots", &[], 0);
    assert_eq!(statuses(&summary), ["a solved", "b solved"]);
    assert!(summary["pairs"][0]["relative_blur"]["median"].is_f64(), "{summary}");
    let report = desk.json("out/a/report.json");
    assert_eq!(report["inputs"][0]["file"].as_str().unwrap().replace('\\', "/"), "shots/a_1.png");
    assert_eq!(report["inputs"][0]["sha256"].as_str().unwrap().len(), 64);

    assert_eq!(statuses(&tally(&desk, "shots", &["--resume", "--timeout", "99"], 0)), ["a kept", "b kept"]);
    fs::remove_file(desk.path("out/a/depth.png")).unwrap();
    assert_eq!(statuses(&tally(&desk, "shots", &["--resume"], 0)), ["a solved", "b kept"]);
    fs::remove_file(desk.path("out/b/report.html")).unwrap();
    assert_eq!(statuses(&tally(&desk, "shots", &["--resume"], 0)), ["a kept", "b solved"]);
    fs::copy(desk.path("shots/b_far.png"), desk.path("shots/b_near.png")).unwrap();
    assert_eq!(statuses(&tally(&desk, "shots", &["--resume"], 0)), ["a kept", "b solved"]);
    assert_eq!(
        statuses(&tally(&desk, "shots", &["--resume", "--relaxation-sweeps", "6"], 0)),
        ["a solved", "b solved"]
    );
    assert_eq!(
        statuses(&tally(&desk, "shots", &["--resume", "--relaxation-sweeps", "6", "--nearer", "2"], 0)),
        ["a solved", "b solved"]
    );
}

#[test]
fn a_failed_pair_does_not_stop_the_batch() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    desk.write("shots/b_2.png", "no picture");
    let output = batch(&desk, "shots", &[]);
    let stderr = stderr_of(&output);
    assert!(stderr.contains("1 of 3 pairs failed: b") && stderr.contains("b_2.png: "), "{stderr}");
    let summary = tally(&desk, "shots", &["--quiet"], 1);
    assert_eq!(statuses(&summary), ["a solved", "b failed", "c solved"]);
    assert!(summary["pairs"][1]["error"].as_str().unwrap().contains("b_2.png"), "{summary}");
    assert!(!desk.has("out/b"));
}

#[test]
fn a_pair_that_cannot_be_named_or_written_fails_alone() {
    let desk = desk(&[
        ["batch-1-of-1.json_1.png", "batch-1-of-1.json_2.png"],
        ["c_1.png", "c_2.png"],
        ["good_1.png", "good_2.png"],
        ["index.html_1.png", "index.html_2.png"],
        ["new\nline_1.png", "new\nline_2.png"],
    ]);
    fs::create_dir(desk.path("out")).unwrap();
    desk.write("out/c", "mine");
    let expected = ["batch-1-of-1.json failed", "c failed", "good solved", "index.html failed", "new\nline failed"];
    let output = batch(&desk, "shots", &["--shard", "1/1"]);
    let stderr = stderr_of(&output);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert_eq!(statuses(&printed(&output)), expected);
    assert!(stderr.contains("4 of 5 pairs failed: batch-1-of-1.json, c, index.html, new\\nline"), "{stderr}");
    let watch = ["watch", "shots", "-o", "out", "--outer-iterations", "6", "--json", "--settle", "0"];
    let output = desk.exits(&[&watch[..], &["--until-idle", "0.1"]].concat(), 1);
    let summary = printed(&output);
    assert_eq!(statuses(&summary), expected.map(|row| row.replace("solved", "kept")));
    assert!(summary["pairs"][1]["error"].as_str().unwrap().contains("c: is a file"), "{summary}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_batch_under_a_memory_limit_survives_long_files() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    // These files take almost no space on the disk. A TIFF may be of 4 GiB, and has its header anywhere.
    for (name, start, length) in [("b_1.png", &b""[..], 64 << 30), ("c_1.png", b"II*\0", 3 << 30)] {
        fs::write(desk.path("shots").join(name), start).unwrap();
        fs::File::options().write(true).open(desk.path("shots").join(name)).unwrap().set_len(length).unwrap();
    }
    let batch = "ulimit -v 2500000; exec \"$0\" batch shots -o out --device cpu --outer-iterations 6 --json";
    let output = std::process::Command::new("sh")
        .args(["-c", batch])
        .arg(assert_cmd::cargo::cargo_bin("parfocal"))
        .current_dir(desk.folder())
        .output()
        .unwrap();
    let stderr = stderr_of(&output);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let summary = printed(&output);
    assert_eq!(statuses(&summary), ["a solved", "b failed", "c failed"]);
    for (row, part) in [(1, "b_1.png: is too long (68719476736 bytes"), (2, "c_1.png: is too long (no memory for")] {
        assert!(summary["pairs"][row]["error"].as_str().unwrap().contains(part), "{summary}");
    }
}

#[test]
fn pairs_of_a_manifest_may_differ_in_size_and_bit_depth() {
    let desk = desk(&[["a_1.png", "a_2.png"]]);
    for name in ["1", "2"] {
        let image = image::open(desk.path(&format!("shots/a_{name}.png"))).unwrap();
        image.crop_imm(3, 0, 70, 61).to_luma8().save(desk.path(&format!("small{name}.png"))).unwrap();
    }
    fs::write(desk.path("list.csv"), "near;far;called\nshots/a_1.png;shots/a_2.png;one\nsmall1.png;small2.png;two\n")
        .unwrap();
    assert_eq!(statuses(&tally(&desk, "list.csv", &[], 0)), ["one solved", "two solved"]);
    assert!(desk.path("out/two/relative_blur.exr").is_file());
}

#[test]
fn an_unpaired_image_is_reported_and_the_pairs_are_solved() {
    let desk = desk(&[["a_1.png", "a_2.png"]]);
    fs::copy(desk.path("shots/a_1.png"), desk.path("shots/overview.png")).unwrap();
    let summary = tally(&desk, "shots", &[], 0);
    assert_eq!(statuses(&summary), ["a solved"]);
    assert!(summary["left_over"][0].as_str().unwrap().starts_with("overview.png belongs to no pair"), "{summary}");
    let output = batch(&desk, "shots", &["--strict", "--progress", "json"]);
    assert_fails(&output, &["left over"]);
    let line: Value = serde_json::from_str(stderr_of(&output).lines().next().unwrap()).unwrap();
    assert_eq!((&line["done"], &line["of"], &line["name"]), (&1.into(), &1.into(), &"a".into()));
}

#[test]
fn invalid_sources_and_options_are_refused_before_any_work() {
    let desk = desk(&[["a_1.png", "a_2.png"]]);
    fs::create_dir(desk.path("odd")).unwrap();
    fs::copy(desk.path("shots/a_1.png"), desk.path("odd/a_3.png")).unwrap();
    for (source, extra, status, part) in [
        ("odd", &[][..], 1, "a_3.png is left over"),
        ("shot", &[], 1, "did you mean 'shots'?"),
        ("shots", &["--relaxation-sweeps", "0"], 2, "--relaxation-sweeps is 0"),
        ("cache", &[], 1, "cache"),
    ] {
        let output = batch(&desk, source, extra);
        let stderr = stderr_of(&output);
        assert_eq!(output.status.code(), Some(status), "{stderr}");
        assert!(stderr.starts_with("error: ") && stderr.contains(part), "{stderr}");
        assert!(!desk.has("out"));
    }
    desk.exits(&["batch", "shots", "more", "-o", "out"], 2);
}

#[cfg(unix)]
#[test]
fn an_interrupt_leaves_only_complete_results() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    let names: Vec<[String; 2]> = (0..40).map(|i| [format!("p{i:02}_1.png"), format!("p{i:02}_2.png")]).collect();
    let names: Vec<[&str; 2]> = names.iter().map(|[a, b]| [a.as_str(), b.as_str()]).collect();
    let desk = desk(&names);
    let mut child = desk.process(&["batch", "shots", "-o", "out"]).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let first = lines.next().unwrap().unwrap();
    assert!(first.starts_with("1/40 p00: solved"), "{first}");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:#?}");
    assert!(rest.last().unwrap().starts_with("error: interrupted after "), "{rest:#?}");
    let summary = desk.json("out/batch.json");
    assert!(summary["interrupted"] == true && summary["not_done"].as_u64().unwrap() > 0, "{summary}");
    for row in summary["pairs"].as_array().unwrap() {
        let folder = desk.path("out").join(row["name"].as_str().unwrap());
        assert_eq!(folder.join("report.json").is_file(), row["status"] == "solved", "{row}");
        assert_eq!(folder.exists(), row["status"] == "solved", "{row}");
    }
}

#[test]
fn subfolders_may_be_sweeps_and_a_failed_sweep_does_not_stop_the_batch() {
    let desk = desk(&[]);
    let scene = ["simulate", "relief", "--frames", "4", "--size", "96x72", "--quiet", "-o"];
    for name in ["good", "bad"] {
        desk.done(&[&scene[..], &[&format!("shots/{name}")]].concat());
    }
    fs::create_dir(desk.path("shots/pair")).unwrap();
    for name in ["i1.png", "i2.png"] {
        fs::copy(desk.path("scene").join(name), desk.path("shots/pair").join(name)).unwrap();
    }
    fs::copy(desk.path("scene/i1.png"), desk.path("shots/bad/frame_02.png")).unwrap();
    let summary = tally(&desk, "shots", &[], 1);
    assert_eq!(statuses(&summary), ["bad failed", "good solved", "pair solved"]);
    let [bad, good, pair] = [0, 1, 2].map(|n| &summary["pairs"][n]);
    assert!(bad["error"].as_str().unwrap().contains("frame 2 is 80x64"), "{bad}");
    assert!(
        good["frames"][3].as_str().unwrap().ends_with("frame_04.png") && good["focus"]["median"].is_f64(),
        "{good}"
    );
    assert!(good.get("i1").is_none() && pair["i1"].is_string() && pair["converged"].is_boolean(), "{pair}");
    let written = |name: &str| desk.path("out/good").join(name).is_file();
    assert!(written("focus.exr") && written("report.html") && written("valid.png"));

    assert_eq!(statuses(&tally(&desk, "shots", &["--resume"], 1)), ["bad failed", "good kept", "pair kept"]);
    fs::remove_file(desk.path("out/good/focus.exr")).unwrap();
    fs::copy(desk.path("shots/good/frame_02.png"), desk.path("shots/bad/frame_02.png")).unwrap();
    assert_eq!(statuses(&tally(&desk, "shots", &["--resume"], 0)), ["bad solved", "good solved", "pair kept"]);
    let again = tally(&desk, "shots", &["--resume", "--export", "depth16"], 0);
    assert_eq!(statuses(&again), ["bad solved", "good solved", "pair solved"]);
    assert_refused(&batch(&desk, "shots", &["--method", "sift"]), 2, &["--method"]);

    let lines = "{\"sweep\": \"shots/good\", \"name\": \"a\"}\n\
                 {\"sweep\": [\"shots/good/frame_01.png\", \"shots/good/frame_02.png\", \"shots/good/frame_03.png\"]}\n\
                 {\"i1\": \"scene/i1.png\", \"i2\": \"scene/i2.png\"}\n";
    desk.write("list.jsonl", lines);
    assert_eq!(statuses(&tally(&desk, "list.jsonl", &[], 0)), ["a solved", "frame_01 solved", "i1 solved"]);
    for (line, words) in [
        ("{\"sweep\": [\"shots/good/frame_01.png\"]}", "three or more"),
        ("{\"sweep\": \"shots/good\", \"i1\": \"scene/i1.png\"}", "line 1: is not {"),
        ("{\"sweep\": \"nowhere\"}", "nowhere"),
    ] {
        desk.write("list.jsonl", line);
        assert_fails(&batch(&desk, "list.jsonl", &[]), &[words]);
    }
}

#[test]
fn photographs_beside_a_sweep_are_left_out_and_listed() {
    let desk = desk(&[]);
    fs::remove_dir(desk.path("shots")).unwrap();
    let scene = ["simulate", "relief", "--frames", "8", "--size", "80x64", "-o", "shots/one", "--quiet"];
    desk.done(&scene);
    fs::copy(desk.path("shots/one/frame_01.png"), desk.path("shots/one/mask.png")).unwrap();
    let summary = tally(&desk, "shots", &[], 0);
    assert_eq!(statuses(&summary), ["one solved"]);
    assert_eq!(summary["pairs"][0]["frames"].as_array().unwrap().len(), 8);
    let listed = summary["left_over"].to_string();
    assert!(listed.contains("one: mask.png: not named like frame_01.png to frame_08.png"), "{listed}");
    let report = desk.json("out/one/report.json");
    assert_eq!(report["left_out"], serde_json::json!(["mask.png"]));
    // The folder itself: one sweep, four pairs, or neither.
    assert_fails(&batch(&desk, "shots/one", &[]), &["are a series of 8 beside other photographs"]);
    // The same folder for `stack`, and with a second series.
    let stack = |extra: &[&str]| {
        let output = desk.run(&[&["stack", "shots/one", "-o", "stacked", "--no-html"], extra].concat());
        (output.status.success(), stderr_of(&output))
    };
    let (is_done, stderr) = stack(&[]);
    assert!(is_done && stderr.contains("note: left out: mask.png, not named like frame_01.png to"), "{stderr}");
    let frames = "frames     8, frame_01.png to frame_08.png; left out: mask.png";
    assert!(stderr.contains(frames), "{stderr}");
    for n in 1..4 {
        fs::copy(desk.path("shots/one/mask.png"), desk.path(&format!("shots/one/again_{n}.png"))).unwrap();
    }
    let (is_done, stderr) = stack(&["--quiet"]);
    let problem = "holds 2 series of photographs: again_1.png to again_3.png (3), frame_01.png to frame_08.png (8)";
    assert!(!is_done && stderr.replace('\n', " ").contains(problem), "{stderr}");
    assert_fails(&batch(&desk, "shots", &[]), &["again_1.png to again_3.png are a series of 3"]);
}

#[test]
fn shards_together_solve_the_whole_batch() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    for (shard, names) in [("1/2", &["a solved", "c solved"][..]), ("2/2", &["b solved"]), ("5/5", &[])] {
        let output = batch(&desk, "shots", &["--shard", shard]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr_of(&output));
        let written = desk.json(&format!("out/batch-{}.json", shard.replace('/', "-of-")));
        assert_eq!(statuses(&written), names);
    }
    assert!(!desk.has("out/batch.json") && !desk.has("out/index.html"));
    assert_eq!(statuses(&tally(&desk, "shots", &["--resume"], 0)), ["a kept", "b kept", "c kept"]);
    assert!(desk.path("out/index.html").is_file());
    assert_refused(&batch(&desk, "shots", &["--shard", "3/2"]), 2, &["share I of N"]);
}

#[test]
fn all_devices_share_a_batch() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]).on_vulkan();
    desk.write("shots/b_2.png", "not a picture");
    // A driver that is installed twice gives two devices.
    let drivers = std::env::var("VK_DRIVER_FILES").unwrap();
    fs::copy(&drivers, desk.path("again.json")).unwrap();
    let twice = format!("{drivers}:{}", desk.path("again.json").display());
    let batch = |extra: &[&str]| {
        let mut command = desk.command(&["batch", "shots", "-o", "out", "--outer-iterations", "6", "--json"]);
        command.env("VK_DRIVER_FILES", &twice).env("VK_ICD_FILENAMES", &twice).args(extra).output().unwrap()
    };
    let output = batch(&["--device", "all"]);
    let stderr = stderr_of(&output);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let summary = printed(&output);
    assert_eq!(statuses(&summary), ["a solved", "b failed", "c solved"], "{stderr}");
    fs::copy(desk.path("shots/a_2.png"), desk.path("shots/b_2.png")).unwrap();
    let resumed = batch(&["--resume", "--device", "1"]);
    let summary = printed(&resumed);
    assert_eq!(statuses(&summary), ["a kept", "b solved", "c kept"]);
    let solve = ["solve", "scene/i1.png", "scene/i2.png", "-o", "one", "--device", "all"];
    desk.refuses(&solve, 2, &["--device all is for batch and watch"]);
}

#[cfg(unix)]
#[test]
fn watch_solves_pairs_as_they_arrive() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"]]);
    let whole = desk.bytes("shots/b_2.png");
    desk.write("shots/b_2.png", &whole[..whole.len() / 2]);
    fs::copy(desk.path("shots/a_1.png"), desk.path("shots/c_1.png")).unwrap();
    // When pair b fails, the script completes its truncated file and adds the missing file of pair c.
    let script = "echo \"$PARFOCAL_NAME $PARFOCAL_STATUS $1\" >> calls\n\
                  if [ $PARFOCAL_STATUS = failed ]; then cp whole.png shots/b_2.png; cp whole.png shots/c_2.png; fi\n";
    desk.write("whole.png", whole);
    desk.write_script("done.sh", script);
    let watch = |settle: &str, idle: &str| {
        let watch = ["watch", "shots", "-o", "out", "--outer-iterations", "6", "--no-html", "--json"];
        desk.run(&[&watch[..], &["--settle", settle, "--until-idle", idle, "--on-done", "./done.sh"]].concat())
    };
    let output = watch("0.1", "2");
    let stderr = stderr_of(&output);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let summary = printed(&output);
    let mut found = statuses(&summary);
    found.sort();
    assert_eq!(found, ["a solved", "b solved", "c solved"], "{stderr}");
    let mut calls: Vec<String> = desk.text("calls").lines().map(String::from).collect();
    calls.sort();
    assert_eq!(calls, ["a solved out/a", "b failed out/b", "b solved out/b", "c solved out/c"]);
    // A second run keeps existing results and does not call the script.
    let output = watch("0", "0.2");
    let summary = printed(&output);
    assert!(statuses(&summary).iter().all(|row| row.ends_with(" kept")), "{summary}");
    assert_eq!(desk.text("calls").lines().count(), 4);
}

#[cfg(unix)]
#[test]
fn watch_fails_if_its_folder_is_gone_at_the_end() {
    let desk = desk(&[["a_1.png", "a_2.png"]]);
    let watch = ["watch", "shots", "-o", "out", "--outer-iterations", "6", "--no-html", "--settle", "0"];
    desk.write_script("gone.sh", "exec mv shots moved\n");
    let watched = desk.exits(&[&watch[..], &["--until-idle", "0.1", "--on-done", "./gone.sh"]].concat(), 1);
    let stderr = stderr_of(&watched);
    assert!(stderr.contains("a: solved"), "{stderr}");
    assert!(stderr.ends_with("error: shots: there is no such folder; check the path\n"), "{stderr}");
}

#[cfg(unix)]
#[test]
fn a_pair_is_passed_on_until_the_program_succeeds() {
    let desk = desk(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"]]);
    let run = |idle: &str, script: &str| {
        desk.write_script("done.sh", &format!("echo \"$PARFOCAL_NAME $PARFOCAL_STATUS\" >> calls\n{script}\n"));
        let watch = ["watch", "shots", "-o", "out", "--outer-iterations", "6", "--no-html", "--settle", "0"];
        desk.run(&[&watch[..], &["--until-idle", idle, "--on-done", "./done.sh"]].concat())
    };
    let names = || {
        let mut names: Vec<String> = desk.text("calls").lines().map(String::from).collect();
        names.sort();
        names.dedup();
        fs::remove_file(desk.path("calls")).unwrap();
        names
    };
    // Killed after the results of a pair were written, and before the program has succeeded.
    assert_eq!(run("0.2", "kill -9 $PPID").status.code(), None);
    assert_eq!(names().len(), 1);
    // No broker can be reached.
    let failed = run("0.2", "exit 7");
    let printed = stderr_of(&failed);
    assert_eq!(failed.status.code(), Some(1), "{printed}");
    assert!(printed.contains("warning: --on-done ./done.sh of a: exit status: 7; it is tried again"), "{printed}");
    assert!(printed.contains("has not succeeded for 2 parts: a, b; the next start tries again if "), "{printed}");
    assert!(printed.ends_with("remove out/.undelivered\n"), "{printed}");
    assert_eq!(names(), ["a solved", "b solved"]);
    // It succeeds for one pair at once, and for the other when it is tried again.
    let passed = run("2", "test $PARFOCAL_NAME = a -o -e again || { touch again; exit 7; }");
    assert_eq!(passed.status.code(), Some(0), "{}", stderr_of(&passed));
    assert_eq!(names(), ["a solved", "b solved"]);
    assert!(!desk.has("out/.undelivered"));
    assert_eq!(run("0.2", "exit 7").status.code(), Some(0));
    assert!(!desk.has("calls"));
}

#[cfg(unix)]
#[test]
fn a_second_interrupt_ends_a_program_of_on_done_that_hangs() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};

    let desk = desk(&[["a_1.png", "a_2.png"]]);
    // The shell starts a program of its own, which holds stdout open while it runs.
    desk.write_script("hang.sh", "echo begun\nsleep 600\necho ended\n");
    let mut child = desk
        .process(&["watch", "shots", "-o", "out", "--no-html", "--settle", "0", "--on-done", "./hang.sh"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut stdout, mut stderr) =
        (BufReader::new(child.stdout.take().unwrap()), BufReader::new(child.stderr.take().unwrap()).lines());
    let mut line = String::new();
    stdout.read_line(&mut line).unwrap();
    assert_eq!(line, "begun\n");
    let interrupt =
        || assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    interrupt();
    while !stderr.next().unwrap().unwrap().starts_with("finishing") {}
    interrupt();
    stdout.read_to_string(&mut line).unwrap();
    assert_eq!((child.wait().unwrap().code(), line.as_str()), (Some(130), "begun\n"));
    // The next start passes the pair on.
    desk.write_script("done.sh", "echo \"$PARFOCAL_NAME $PARFOCAL_STATUS\" >> calls\n");
    let watch = ["watch", "shots", "-o", "out", "--no-html", "--settle", "0", "--until-idle", "0.2"];
    let summary = printed(&desk.done(&[&watch[..], &["--json", "--on-done", "./done.sh"]].concat()));
    assert_eq!((statuses(&summary), desk.text("calls").as_str()), (vec!["a kept".to_string()], "a solved\n"));
}
