//! `parfocal batch` and `watch` on small synthetic pairs.

use std::fs;
use std::path::PathBuf;
use std::process::Output;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

/// A temporary folder with pairs in `shots`: copies of one small scene under several names.
struct Desk(TempDir);

impl Desk {
    fn new(names: &[[&str; 2]]) -> Self {
        let desk = Self(TempDir::new().unwrap());
        let scene = ["simulate", "plane", "--size", "80x64", "-o", "scene", "--quiet"];
        let output = desk.command().args(scene).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        fs::create_dir(desk.path("shots")).unwrap();
        for pair in names {
            for (name, from) in pair.iter().zip(["i1.png", "i2.png"]) {
                fs::copy(desk.path("scene").join(from), desk.path("shots").join(name)).unwrap();
            }
        }
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self) -> Command {
        let mut command = Command::cargo_bin("parfocal").unwrap();
        command.env("PARFOCAL_CACHE_DIR", self.path("cache")).current_dir(self.0.path());
        command
    }

    fn batch(&self, source: &str, extra: &[&str]) -> Output {
        let mut command = self.command();
        command.args(["batch", source, "-o", "out", "--outer-iterations", "6", "--json"]).args(extra);
        command.output().unwrap()
    }

    /// Runs a batch and asserts its exit status. Returns batch.json, which must equal the printed JSON.
    #[track_caller]
    fn tally(&self, source: &str, extra: &[&str], status: i32) -> Value {
        let output = self.batch(source, extra);
        assert_eq!(output.status.code(), Some(status), "{}", String::from_utf8_lossy(&output.stderr));
        let written: Value = serde_json::from_slice(&fs::read(self.path("out/batch.json")).unwrap()).unwrap();
        assert_eq!(serde_json::from_slice::<Value>(&output.stdout).unwrap(), written);
        written
    }
}

fn statuses(tally: &Value) -> Vec<String> {
    let row = |row: &Value| format!("{} {}", row["name"].as_str().unwrap(), row["status"].as_str().unwrap());
    tally["pairs"].as_array().unwrap().iter().map(row).collect()
}

#[test]
fn resume_solves_only_pairs_that_changed() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"], ["b_near.png", "b_far.png"]]);
    let tally = desk.tally("shots", &[], 0);
    assert_eq!(statuses(&tally), ["a solved", "b solved"]);
    assert!(tally["pairs"][0]["relative_blur"]["median"].is_f64(), "{tally}");
    let report: Value = serde_json::from_slice(&fs::read(desk.path("out/a/report.json")).unwrap()).unwrap();
    assert_eq!(report["inputs"][0]["file"], "shots/a_1.png");
    assert_eq!(report["inputs"][0]["sha256"].as_str().unwrap().len(), 64);

    assert_eq!(statuses(&desk.tally("shots", &["--resume", "--timeout", "99"], 0)), ["a kept", "b kept"]);
    fs::remove_file(desk.path("out/a/depth.png")).unwrap();
    assert_eq!(statuses(&desk.tally("shots", &["--resume"], 0)), ["a solved", "b kept"]);
    fs::remove_file(desk.path("out/b/report.html")).unwrap();
    assert_eq!(statuses(&desk.tally("shots", &["--resume"], 0)), ["a kept", "b solved"]);
    fs::copy(desk.path("shots/b_far.png"), desk.path("shots/b_near.png")).unwrap();
    assert_eq!(statuses(&desk.tally("shots", &["--resume"], 0)), ["a kept", "b solved"]);
    assert_eq!(statuses(&desk.tally("shots", &["--resume", "--relaxation-sweeps", "6"], 0)), ["a solved", "b solved"]);
    assert_eq!(
        statuses(&desk.tally("shots", &["--resume", "--relaxation-sweeps", "6", "--nearer", "2"], 0)),
        ["a solved", "b solved"]
    );
}

#[test]
fn a_failed_pair_does_not_stop_the_batch() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    fs::write(desk.path("shots/b_2.png"), "no picture").unwrap();
    let output = desk.batch("shots", &[]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains("1 of 3 pairs failed: b") && stderr.contains("b_2.png: "), "{stderr}");
    let tally = desk.tally("shots", &["--quiet"], 1);
    assert_eq!(statuses(&tally), ["a solved", "b failed", "c solved"]);
    assert!(tally["pairs"][1]["error"].as_str().unwrap().contains("b_2.png"), "{tally}");
    assert!(!desk.path("out/b").exists());
}

#[test]
fn a_pair_that_cannot_be_named_or_written_fails_alone() {
    let desk = Desk::new(&[
        ["batch-1-of-1.json_1.png", "batch-1-of-1.json_2.png"],
        ["c_1.png", "c_2.png"],
        ["good_1.png", "good_2.png"],
        ["index.html_1.png", "index.html_2.png"],
        ["new\nline_1.png", "new\nline_2.png"],
    ]);
    fs::create_dir(desk.path("out")).unwrap();
    fs::write(desk.path("out/c"), "mine").unwrap();
    let expected = ["batch-1-of-1.json failed", "c failed", "good solved", "index.html failed", "new\nline failed"];
    let output = desk.batch("shots", &["--shard", "1/1"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert_eq!(statuses(&serde_json::from_slice(&output.stdout).unwrap()), expected);
    assert!(stderr.contains("4 of 5 pairs failed: batch-1-of-1.json, c, index.html, new\\nline"), "{stderr}");
    let mut watch = desk.command();
    watch.args(["watch", "shots", "-o", "out", "--outer-iterations", "6", "--json", "--settle", "0"]);
    let output = watch.args(["--until-idle", "0.1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let tally: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(statuses(&tally), expected.map(|row| row.replace("solved", "kept")));
    assert!(tally["pairs"][1]["error"].as_str().unwrap().contains("c: is a file"), "{tally}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_batch_under_a_memory_limit_survives_long_files() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    // These files take almost no space on the disk. A TIFF may be of 4 GiB, and has its header anywhere.
    for (name, start, length) in [("b_1.png", &b""[..], 64 << 30), ("c_1.png", b"II*\0", 3 << 30)] {
        fs::write(desk.path("shots").join(name), start).unwrap();
        fs::File::options().write(true).open(desk.path("shots").join(name)).unwrap().set_len(length).unwrap();
    }
    let batch = "ulimit -v 2500000; exec \"$0\" batch shots -o out --device cpu --outer-iterations 6 --json";
    let output = std::process::Command::new("sh")
        .args(["-c", batch])
        .arg(assert_cmd::cargo::cargo_bin("parfocal"))
        .current_dir(desk.0.path())
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let tally: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(statuses(&tally), ["a solved", "b failed", "c failed"]);
    for (row, part) in [(1, "b_1.png: is too long (68719476736 bytes"), (2, "c_1.png: is too long (no memory for")] {
        assert!(tally["pairs"][row]["error"].as_str().unwrap().contains(part), "{tally}");
    }
}

#[test]
fn pairs_of_a_manifest_may_differ_in_size_and_bit_depth() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"]]);
    for name in ["1", "2"] {
        let image = image::open(desk.path(&format!("shots/a_{name}.png"))).unwrap();
        image.crop_imm(3, 0, 70, 61).to_luma8().save(desk.path(&format!("small{name}.png"))).unwrap();
    }
    fs::write(desk.path("list.csv"), "near;far;called\nshots/a_1.png;shots/a_2.png;one\nsmall1.png;small2.png;two\n")
        .unwrap();
    assert_eq!(statuses(&desk.tally("list.csv", &[], 0)), ["one solved", "two solved"]);
    assert!(desk.path("out/two/relative_blur.exr").is_file());
}

#[test]
fn an_unpaired_image_is_reported_and_the_pairs_are_solved() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"]]);
    fs::copy(desk.path("shots/a_1.png"), desk.path("shots/overview.png")).unwrap();
    let tally = desk.tally("shots", &[], 0);
    assert_eq!(statuses(&tally), ["a solved"]);
    assert!(tally["left_over"][0].as_str().unwrap().starts_with("overview.png belongs to no pair"), "{tally}");
    let output = desk.batch("shots", &["--strict", "--progress", "json"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && stderr.contains("left over"), "{stderr}");
    let line: Value = serde_json::from_str(stderr.lines().next().unwrap()).unwrap();
    assert_eq!((&line["done"], &line["of"], &line["name"]), (&1.into(), &1.into(), &"a".into()));
}

#[test]
fn invalid_sources_and_options_are_refused_before_any_work() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"]]);
    fs::create_dir(desk.path("odd")).unwrap();
    fs::copy(desk.path("shots/a_1.png"), desk.path("odd/a_3.png")).unwrap();
    for (source, extra, status, part) in [
        ("odd", &[][..], 1, "a_3.png is left over"),
        ("shot", &[], 1, "did you mean 'shots'?"),
        ("shots", &["--relaxation-sweeps", "0"], 2, "--relaxation-sweeps is 0"),
        ("cache", &[], 1, "cache"),
    ] {
        let output = desk.batch(source, extra);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{stderr}");
        assert!(stderr.starts_with("error: ") && stderr.contains(part), "{stderr}");
        assert!(!desk.path("out").exists());
    }
    let output = desk.command().args(["batch", "shots", "more", "-o", "out"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

#[cfg(unix)]
#[test]
fn an_interrupt_leaves_only_complete_results() {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    let names: Vec<[String; 2]> = (0..40).map(|i| [format!("p{i:02}_1.png"), format!("p{i:02}_2.png")]).collect();
    let names: Vec<[&str; 2]> = names.iter().map(|[a, b]| [a.as_str(), b.as_str()]).collect();
    let desk = Desk::new(&names);
    let mut child = Command::new(assert_cmd::cargo::cargo_bin("parfocal"))
        .args(["batch", "shots", "-o", "out"])
        .env("PARFOCAL_CACHE_DIR", desk.path("cache"))
        .current_dir(desk.0.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let first = lines.next().unwrap().unwrap();
    assert!(first.starts_with("1/40 p00: solved"), "{first}");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let rest: Vec<String> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:#?}");
    assert!(rest.last().unwrap().starts_with("error: interrupted after "), "{rest:#?}");
    let tally: Value = serde_json::from_slice(&fs::read(desk.path("out/batch.json")).unwrap()).unwrap();
    assert!(tally["interrupted"] == true && tally["not_done"].as_u64().unwrap() > 0, "{tally}");
    for row in tally["pairs"].as_array().unwrap() {
        let folder = desk.path("out").join(row["name"].as_str().unwrap());
        assert_eq!(folder.join("report.json").is_file(), row["status"] == "solved", "{row}");
        assert_eq!(folder.exists(), row["status"] == "solved", "{row}");
    }
}

#[test]
fn subfolders_may_be_sweeps_and_a_failed_sweep_does_not_stop_the_batch() {
    let desk = Desk::new(&[]);
    let scene = ["simulate", "relief", "--frames", "4", "--size", "96x72", "--quiet", "-o"];
    for name in ["good", "bad"] {
        let output = desk.command().args(scene).arg(desk.path("shots").join(name)).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    fs::create_dir(desk.path("shots/pair")).unwrap();
    for name in ["i1.png", "i2.png"] {
        fs::copy(desk.path("scene").join(name), desk.path("shots/pair").join(name)).unwrap();
    }
    fs::copy(desk.path("scene/i1.png"), desk.path("shots/bad/frame_02.png")).unwrap();
    let tally = desk.tally("shots", &[], 1);
    assert_eq!(statuses(&tally), ["bad failed", "good solved", "pair solved"]);
    let [bad, good, pair] = [0, 1, 2].map(|n| &tally["pairs"][n]);
    assert!(bad["error"].as_str().unwrap().contains("frame 2 is 80x64"), "{bad}");
    assert!(
        good["frames"][3].as_str().unwrap().ends_with("frame_04.png") && good["focus"]["median"].is_f64(),
        "{good}"
    );
    assert!(good.get("i1").is_none() && pair["i1"].is_string() && pair["converged"].is_boolean(), "{pair}");
    let written = |name: &str| desk.path("out/good").join(name).is_file();
    assert!(written("focus.exr") && written("report.html") && written("valid.png"));

    assert_eq!(statuses(&desk.tally("shots", &["--resume"], 1)), ["bad failed", "good kept", "pair kept"]);
    fs::remove_file(desk.path("out/good/focus.exr")).unwrap();
    fs::copy(desk.path("shots/good/frame_02.png"), desk.path("shots/bad/frame_02.png")).unwrap();
    assert_eq!(statuses(&desk.tally("shots", &["--resume"], 0)), ["bad solved", "good solved", "pair kept"]);
    let again = desk.tally("shots", &["--resume", "--export", "depth16"], 0);
    assert_eq!(statuses(&again), ["bad solved", "good solved", "pair solved"]);
    let output = desk.batch("shots", &["--method", "sift"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && stderr.contains("--method"), "{stderr}");

    let lines = "{\"sweep\": \"shots/good\", \"name\": \"a\"}\n\
                 {\"sweep\": [\"shots/good/frame_01.png\", \"shots/good/frame_02.png\", \"shots/good/frame_03.png\"]}\n\
                 {\"i1\": \"scene/i1.png\", \"i2\": \"scene/i2.png\"}\n";
    fs::write(desk.path("list.jsonl"), lines).unwrap();
    assert_eq!(statuses(&desk.tally("list.jsonl", &[], 0)), ["a solved", "frame_01 solved", "i1 solved"]);
    for (line, words) in [
        ("{\"sweep\": [\"shots/good/frame_01.png\"]}", "three or more"),
        ("{\"sweep\": \"shots/good\", \"i1\": \"scene/i1.png\"}", "line 1: is not {"),
        ("{\"sweep\": \"nowhere\"}", "nowhere"),
    ] {
        fs::write(desk.path("list.jsonl"), line).unwrap();
        let output = desk.batch("list.jsonl", &[]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && stderr.contains(words), "{stderr}");
    }
}

#[test]
fn photographs_beside_a_sweep_are_left_out_and_listed() {
    let desk = Desk::new(&[]);
    fs::remove_dir(desk.path("shots")).unwrap();
    let scene = ["simulate", "relief", "--frames", "8", "--size", "80x64", "-o", "shots/one", "--quiet"];
    desk.command().args(scene).assert().success();
    fs::copy(desk.path("shots/one/frame_01.png"), desk.path("shots/one/mask.png")).unwrap();
    let tally = desk.tally("shots", &[], 0);
    assert_eq!(statuses(&tally), ["one solved"]);
    assert_eq!(tally["pairs"][0]["frames"].as_array().unwrap().len(), 8);
    let listed = tally["left_over"].to_string();
    assert!(listed.contains("one: mask.png: not named like frame_01.png to frame_08.png"), "{listed}");
    let report: Value = serde_json::from_slice(&fs::read(desk.path("out/one/report.json")).unwrap()).unwrap();
    assert_eq!(report["left_out"], serde_json::json!(["mask.png"]));
    // The folder itself: one sweep, four pairs, or neither.
    let output = desk.batch("shots/one", &[]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && stderr.contains("are a series of 8 beside other photographs"), "{stderr}");
    // The same folder for `stack`, and with a second series.
    let stack = |extra: &[&str]| {
        let output = desk.command().args(["stack", "shots/one", "-o", "stacked", "--no-html"]).args(extra).output();
        let output = output.unwrap();
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
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
    let output = desk.batch("shots", &[]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && stderr.contains("again_1.png to again_3.png are a series of 3"), "{stderr}");
}

#[test]
fn shards_together_solve_the_whole_batch() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    for (shard, names) in [("1/2", &["a solved", "c solved"][..]), ("2/2", &["b solved"]), ("5/5", &[])] {
        let output = desk.batch("shots", &["--shard", shard]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let summary = desk.path(&format!("out/batch-{}.json", shard.replace('/', "-of-")));
        let written: Value = serde_json::from_slice(&fs::read(summary).unwrap()).unwrap();
        assert_eq!(statuses(&written), names);
    }
    assert!(!desk.path("out/batch.json").exists() && !desk.path("out/index.html").exists());
    assert_eq!(statuses(&desk.tally("shots", &["--resume"], 0)), ["a kept", "b kept", "c kept"]);
    assert!(desk.path("out/index.html").is_file());
    let output = desk.batch("shots", &["--shard", "3/2"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && stderr.contains("share I of N"), "{stderr}");
}

#[test]
fn all_devices_share_a_batch() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"], ["c_1.png", "c_2.png"]]);
    fs::write(desk.path("shots/b_2.png"), "not a picture").unwrap();
    // A driver that is installed twice gives two devices.
    let drivers = std::env::var("VK_DRIVER_FILES").unwrap();
    let manifest: Value = serde_json::from_slice(&fs::read(&drivers).unwrap()).unwrap();
    fs::write(desk.path("again.json"), manifest.to_string()).unwrap();
    let twice = format!("{drivers}:{}", desk.path("again.json").display());
    let batch = |extra: &[&str]| {
        let mut command = desk.command();
        command.env("VK_DRIVER_FILES", &twice).env("VK_ICD_FILENAMES", &twice);
        command.args(["batch", "shots", "-o", "out", "--outer-iterations", "6", "--json"]).args(extra);
        command.output().unwrap()
    };
    let output = batch(&["--device", "all"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let tally: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(statuses(&tally), ["a solved", "b failed", "c solved"], "{stderr}");
    fs::copy(desk.path("shots/a_2.png"), desk.path("shots/b_2.png")).unwrap();
    let resumed = batch(&["--resume", "--device", "1"]);
    let tally: Value = serde_json::from_slice(&resumed.stdout).unwrap();
    assert_eq!(statuses(&tally), ["a kept", "b solved", "c kept"]);
    let mut solve = desk.command();
    let refused =
        solve.args(["solve", "scene/i1.png", "scene/i2.png", "-o", "one", "--device", "all"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && stderr.contains("--device all is for batch and watch"), "{stderr}");
}

#[cfg(unix)]
#[test]
fn watch_solves_pairs_as_they_arrive() {
    use std::os::unix::fs::PermissionsExt;

    let desk = Desk::new(&[["a_1.png", "a_2.png"], ["b_1.png", "b_2.png"]]);
    let whole = fs::read(desk.path("shots/b_2.png")).unwrap();
    fs::write(desk.path("shots/b_2.png"), &whole[..whole.len() / 2]).unwrap();
    fs::copy(desk.path("shots/a_1.png"), desk.path("shots/c_1.png")).unwrap();
    // When pair b fails, the script completes its truncated file and adds the missing file of pair c.
    let script = "#!/bin/sh\necho \"$PARFOCAL_NAME $PARFOCAL_STATUS $1\" >> told\nif [ $PARFOCAL_STATUS = failed ]; then cp whole.png shots/b_2.png; \
                  cp whole.png shots/c_2.png; fi\n";
    fs::write(desk.path("whole.png"), whole).unwrap();
    fs::write(desk.path("done.sh"), script).unwrap();
    fs::set_permissions(desk.path("done.sh"), fs::Permissions::from_mode(0o755)).unwrap();
    let watch = |settle: &str, idle: &str| {
        let mut command = desk.command();
        command.args(["watch", "shots", "-o", "out", "--outer-iterations", "6", "--no-html", "--json"]);
        command.args(["--settle", settle, "--until-idle", idle, "--on-done", "./done.sh"]).output().unwrap()
    };
    let output = watch("0.1", "2");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let tally: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut found = statuses(&tally);
    found.sort();
    assert_eq!(found, ["a solved", "b solved", "c solved"], "{stderr}");
    let mut calls: Vec<String> = fs::read_to_string(desk.path("told")).unwrap().lines().map(String::from).collect();
    calls.sort();
    assert_eq!(calls, ["a solved out/a", "b failed out/b", "b solved out/b", "c solved out/c"]);
    // A second run keeps existing results and does not call the script.
    let output = watch("0", "0.2");
    let tally: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(statuses(&tally).iter().all(|row| row.ends_with(" kept")), "{tally}");
    assert_eq!(fs::read_to_string(desk.path("told")).unwrap().lines().count(), 4);
}

#[cfg(unix)]
#[test]
fn watch_fails_if_its_folder_is_gone_at_the_end() {
    let desk = Desk::new(&[["a_1.png", "a_2.png"]]);
    let mut watch = desk.command();
    watch.args(["watch", "shots", "-o", "out", "--outer-iterations", "6", "--no-html", "--settle", "0"]);
    fs::write(desk.path("gone.sh"), "#!/bin/sh\nexec mv shots moved\n").unwrap();
    fs::set_permissions(desk.path("gone.sh"), std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let output = watch.args(["--until-idle", "0.1", "--on-done", "./gone.sh"]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && stderr.contains("a: solved"), "{stderr}");
    assert!(stderr.ends_with("error: shots: there is no such folder; check the path\n"), "{stderr}");
}

#[cfg(unix)]
#[test]
fn a_second_interrupt_ends_a_program_of_on_done_that_hangs() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};

    let desk = Desk::new(&[["a_1.png", "a_2.png"]]);
    // The shell starts a program of its own, which holds stdout open while it runs.
    fs::write(desk.path("hang.sh"), "#!/bin/sh\necho begun\nsleep 600\necho ended\n").unwrap();
    fs::set_permissions(desk.path("hang.sh"), std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin("parfocal"))
        .args(["watch", "shots", "-o", "out", "--no-html", "--settle", "0", "--on-done", "./hang.sh"])
        .env("PARFOCAL_CACHE_DIR", desk.path("cache"))
        .current_dir(desk.0.path())
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
}
