//! `parfocal teach`, and `batch` and `watch` that judge each part.

use std::collections::BTreeMap;
use std::fs;
use std::process::Command;

use serde_json::Value;

use crate::desk::{Desk, printed, stderr_of};

/// Returns a folder with photographs of four good parts in `good`, and results of them in `taught`.
///
/// The parts differ by their noise alone.
fn line() -> Desk {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "scene", "--size", "96x80", "-q"]);
    for n in 0..4 {
        part(&desk, &format!("good/{n}"), n, |_, _| false);
    }
    desk.done(&["batch", "good", "-o", "taught", "--no-html"]);
    desk
}

/// Photographs a part: those of the scene with noise of its own. Where `is_turned` says, they are exchanged, so that
/// V has the other sign.
fn part(desk: &Desk, folder: &str, seed: u32, is_turned: impl Fn(f64, f64) -> bool) {
    fs::create_dir_all(desk.path(folder)).unwrap();
    let [a, b] = ["i1.png", "i2.png"].map(|name| image::open(desk.path("scene").join(name)).unwrap().into_luma16());
    let mut random = 77 + 1000 * seed;
    for (name, own, other) in [("i1.png", &a, &b), ("i2.png", &b, &a)] {
        let picture = image::ImageBuffer::from_fn(own.width(), own.height(), |x, y| {
            let from = if is_turned(f64::from(x), f64::from(y)) { other } else { own };
            let mut uniform = || {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                f64::from(random >> 8) / f64::from(1 << 24) - 0.5
            };
            let noise = uniform() + uniform() + uniform() + uniform();
            image::Luma([(f64::from(from.get_pixel(x, y).0[0]) + 500.0 * noise).clamp(0.0, 65535.0) as u16])
        });
        picture.save(desk.path(folder).join(name)).unwrap();
    }
}

fn dent(x: f64, y: f64) -> bool {
    (x - 48.0).hypot(y - 40.0) < 11.0
}

/// The verdicts of batch.json by serial number.
fn verdicts(summary: &Value) -> BTreeMap<String, String> {
    let rows = summary["pairs"].as_array().unwrap().iter().map(|row| &row["inspection"]);
    let text = |value: &Value| value.as_str().unwrap().to_string();
    rows.map(|part| (text(&part["serial"]), text(&part["verdict"]))).collect()
}

#[test]
fn each_part_of_a_batch_has_one_verdict_in_each_output() {
    let desk = line();
    let taught = desk.done(&["teach", "taught", "-o", "golden.exr", "--json"]);
    let report = printed(&taught);
    let tolerance = report["tolerance"].as_f64().unwrap();
    assert!(tolerance > 0.0 && report["suggested"] == true && report["kind"] == "golden", "{report}");
    assert_eq!(report["parts"].as_array().unwrap().len(), 4);

    part(&desk, "in/SN1", 10, |_, _| false);
    part(&desk, "in/SN2", 11, dent);
    part(&desk, "in/SN3", 12, |_, _| false);
    desk.write("in/SN3/i2.png", "no picture");
    desk.write("line.toml", "golden = 'golden.exr'\nno-html = true\nlog = 'line.jsonl'\n");
    let output = desk.exits(&["batch", "in", "-o", "out", "--config", "line.toml"], 3);
    let summary = desk.json("out/batch.json");
    let expected = [("SN1", "go"), ("SN2", "no-go"), ("SN3", "cannot-judge")];
    let expected = expected.map(|(serial, verdict)| (serial.to_string(), verdict.to_string())).into();
    assert_eq!(verdicts(&summary), expected);
    for table in ["verdicts.csv", "verdicts.xml"] {
        let sum = Command::new("sha256sum").arg(desk.path(&format!("out/{table}"))).output().unwrap().stdout;
        let sum = String::from_utf8(sum).unwrap();
        assert_eq!(summary["hashes"][table]["sha256"].as_str(), sum.split_whitespace().next(), "{table}");
    }
    let counts = &summary["verdicts"];
    assert_eq!((&counts["go"], &counts["no_go"], &counts["cannot_judge"]), (&1.into(), &1.into(), &1.into()));
    assert!(counts["seconds_p50"].as_f64().unwrap() <= counts["seconds_p99"].as_f64().unwrap(), "{counts}");
    let printed = stderr_of(&output);
    assert!(printed.contains("1 go, 1 no-go, 1 cannot judge; from photographs to verdict p50 "), "{printed}");
    assert!(printed.contains("no-go: SN2: deviates at one place"), "{printed}");
    assert!(!printed.contains("error:"), "{printed}");

    // The schema lists what each has.
    let schema = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/guide/src/examples/batch.schema.json");
    let schema: Value = serde_json::from_slice(&fs::read(schema).unwrap()).unwrap();
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let inspection = &schema["$defs"]["inspection"];
    for (of, found) in [
        (&schema, &summary),
        (&schema["properties"]["verdicts"], counts),
        (inspection, &summary["pairs"][0]["inspection"]),
    ] {
        assert_eq!((&of["required"], keys(&of["properties"])), (&serde_json::json!(keys(found)), keys(found)));
    }

    let report = desk.json("out/SN2/inspect.json");
    assert_eq!(
        (&report["serial"], &report["verdict"], &report["tolerance"]),
        (&"SN2".into(), &"no-go".into(), &tolerance.into())
    );
    let time = report["time"].as_str().unwrap();
    assert!(time.starts_with("20") && time.ends_with('Z'), "{time}");
    assert!(desk.path("out/SN2/inspect.png").is_file());
    assert!(!desk.has("out/SN3"), "a part without results has no folder");

    let rows: Vec<Vec<String>> = csv::Reader::from_path(desk.path("out/verdicts.csv"))
        .unwrap()
        .records()
        .map(|row| row.unwrap().iter().map(String::from).collect())
        .collect();
    assert_eq!(rows.iter().map(|row| row[3].as_str()).collect::<Vec<_>>(), ["go", "no-go", "cannot-judge"]);
    assert!(rows[1][0] == "SN2" && rows[1][1] == time && rows[2][5].contains("i2.png"), "{rows:?}");
    let cases = desk.text("out/verdicts.xml");
    assert!(cases.contains("tests=\"3\" failures=\"1\" errors=\"1\""), "{cases}");
    assert!(cases.contains("name=\"SN2\"") && cases.contains(time), "{cases}");
    let log: Vec<Value> = desk.text("line.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(log.iter().map(|line| &line["event"]).collect::<Vec<_>>(), ["start", "part", "part", "part", "end"]);
    assert_eq!((&log[0]["golden"][0], &log[0]["limits"]["tolerance"]), (&"golden.exr".into(), &tolerance.into()));
    assert!(log[2]["inspection"]["reasons"][0].as_str().unwrap().contains("deviates"), "{}", log[2]);

    // The same folders as golden parts judge alike, one part by itself too, and so does a later run of kept results.
    let folders = ["0", "1", "2", "3"].map(|n| format!("taught/{n}"));
    let tolerance = tolerance.to_string();
    let golden = folders.iter().map(String::as_str);
    let own = ["inspect", "out/SN1", "--tolerance", &tolerance, "--golden"].into_iter().chain(golden.clone());
    desk.done(&own.collect::<Vec<_>>());
    desk.done(&["inspect", "out/SN1", "--config", "line.toml"]);
    desk.exits(&["inspect", "out/SN2", "--config", "line.toml"], 3);
    let again = ["batch", "in", "-o", "out", "--resume", "--no-html", "--tolerance", &tolerance, "--golden"];
    desk.exits(&again.into_iter().chain(golden).collect::<Vec<_>>(), 3);
    assert_eq!(verdicts(&desk.json("out/batch.json")), expected);
    // A region that leaves the dent out.
    let output =
        desk.exits(&["batch", "in", "-o", "out", "--resume", "--config", "line.toml", "--inspect-roi", "0,0,24,80"], 4);
    assert_eq!(desk.json("out/batch.json")["verdicts"]["go"], 2, "{}", stderr_of(&output));
    assert_eq!(desk.json("out/SN2/inspect.json")["judged_regions"][0]["width"], 24);
    assert_eq!(desk.json("out/batch.json")["pairs"][0]["inspection"]["seconds"], Value::Null, "it was kept");

    // An inspection that cannot be written leaves no go, and an earlier one does not stay if the solve fails.
    for serial in ["SN1", "SN2"] {
        fs::remove_file(desk.path(&format!("out/{serial}/inspect.json"))).unwrap();
        desk.write(&format!("out/{serial}/inspect.png"), "mine");
    }
    let kept = ["batch", "in", "-o", "out", "--resume", "--config", "line.toml"];
    desk.exits(&kept, 3);
    let summary = desk.json("out/batch.json");
    let found = verdicts(&summary);
    assert_eq!((found["SN1"].as_str(), found["SN2"].as_str()), ("cannot-judge", "no-go"));
    let reasons = summary["pairs"][0]["inspection"]["reasons"].to_string();
    assert!(reasons.contains("inspect.png: is there already"), "{reasons}");
    assert_eq!(desk.text("out/SN1/inspect.png"), "mine");
    fs::remove_file(desk.path("out/SN1/inspect.png")).unwrap();
    desk.exits(&kept, 3);
    assert_eq!(desk.json("out/SN1/inspect.json")["verdict"], "go");
    desk.write("in/SN1/i2.png", "no picture");
    desk.exits(&kept, 3);
    assert_eq!(verdicts(&desk.json("out/batch.json"))["SN1"], "cannot-judge");
    assert!(!desk.has("out/SN1/inspect.json") && !desk.has("out/SN1/inspect.png"));
    desk.exits(&["batch", "in", "-o", "out", "--resume", "--no-html"], 1);
    assert!(!desk.has("out/verdicts.csv") && !desk.has("out/verdicts.xml"));
    assert_eq!(desk.json("out/batch.json")["hashes"], Value::Null);
    // A failed part of a batch is not taught, though earlier results of it exist.
    let few = desk.done(&["teach", "out", "-o", "few.exr", "--tolerance", "3"]);
    assert!(stderr_of(&few).contains("out/SN2") && !stderr_of(&few).contains("out/SN1"), "{}", stderr_of(&few));
}

#[test]
fn golden_parts_that_disagree_are_not_taught() {
    let desk = line();
    part(&desk, "bad/4", 4, dent);
    desk.done(&["batch", "bad", "-o", "bent", "--no-html"]);
    let refused = desk.exits(&["teach", "taught", "bent/4", "-o", "golden.exr"], 4);
    let printed = stderr_of(&refused);
    assert!(printed.contains("part bent/4 ") && printed.contains("; leave it out, or solve it again"), "{printed}");
    assert!(printed.contains("golden.exr is not written") && !desk.has("golden.exr"), "{printed}");
    let few = desk.done(&["teach", "taught/0", "-o", "golden.exr", "--tolerance", "3"]);
    assert!(stderr_of(&few).contains("fewer than three good parts") && stderr_of(&few).contains("3 px², stated"));
    // A tighter tolerance than that of the comparison.
    desk.refuses(
        &["inspect", "taught/1", "--golden", "golden.exr", "--tolerance", "1"],
        2,
        &["teach them again with --tolerance 1"],
    );
    desk.refuses(&["teach", "taught", "-o", "golden.exr", "--sigmas", "0"], 2, &["--sigmas 0 "]);
    desk.refuses(&["teach", "taught", "-o", "taught/1/relative_blur.exr", "--force"], 1, &["is an input"]);
    desk.refuses(
        &["batch", "good", "-o", "taught", "--golden", "taught/0", "--tolerance", "3"],
        1,
        &["taught/0: is a golden part in the folder"],
    );
    desk.write("notes.exr", "my notes");
    desk.refuses(&["teach", "taught", "-o", "notes.exr"], 1, &["notes.exr: is there already"]);
    desk.refuses(&["inspect", "taught/1", "--golden", "notes.exr"], 1, &["notes.exr: "]);
    for (extra, part) in [
        (&["--golden", "taught/0"][..], "--tolerance is missing"),
        (&["--golden", "taught/0", "golden.exr"], "golden.exr is a file beside others"),
        (&["--tolerance", "1"], "--tolerance needs golden parts"),
        (&["--golden", "golden.exr", "--inspect-roi", "90,0,20,20"], "--inspect-roi: "),
        (&["--max-tilt", "1"], "--max-tilt needs golden parts"),
        (&["--in-place"], "--in-place needs golden parts"),
        (&["--log", "-"], "--log -: "),
    ] {
        desk.refuses(&[&["batch", "good", "-o", "out"], extra].concat(), 2, &[part]);
        assert!(!desk.has("out"));
    }
}

#[test]
fn parts_that_are_not_what_they_seem_cannot_be_judged() {
    let desk = line();
    let taught = desk.done(&["teach", "taught", "-o", "golden.exr", "--json"]);
    let range = &printed(&taught)["placement"];
    assert!(range["max_shift_px"].as_f64().unwrap() < 5.0 && range["max_rotation_deg"] == 0.5, "{range}");
    part(&desk, "in/good", 10, |_, _| false);
    let changed = |folder: &str, of: [&str; 2], change: &dyn Fn(image::DynamicImage) -> image::DynamicImage| {
        part(&desk, &format!("in/{folder}"), 11 + folder.len() as u32, |_, _| false);
        let folder = desk.path("in").join(folder);
        let pictures = of.map(|name| image::open(folder.join(name)).unwrap());
        for (name, picture) in ["i1.png", "i2.png"].into_iter().zip(pictures) {
            change(picture).save(folder.join(name)).unwrap();
        }
    };
    changed("turned", ["i1.png", "i2.png"], &|picture| picture.rotate180());
    changed("same", ["i1.png", "i1.png"], &|picture| picture);
    changed("swap", ["i2.png", "i1.png"], &|picture| picture);
    // The samples of another part, in other files.
    fs::create_dir(desk.path("in/frozen")).unwrap();
    for name in ["i1.png", "i2.png"] {
        let picture = image::open(desk.path("in/good").join(name)).unwrap();
        picture.save(desk.path("in/frozen").join(name.replace("png", "tiff"))).unwrap();
    }
    desk.exits(&["batch", "in", "-o", "out", "--golden", "golden.exr", "--no-html"], 4);
    let found = verdicts(&desk.json("out/batch.json"));
    assert_eq!(found.values().filter(|verdict| *verdict == "go").count(), 1, "{found:?}");
    let first = if found["good"] == "go" { "good" } else { "frozen" };
    assert_eq!((found[first].as_str(), found.values().filter(|verdict| *verdict == "cannot-judge").count()), ("go", 4));
    for (serial, reason) in [
        ("turned", "the part lies turned by 180.0°"),
        ("same", "the solve of out/same had not converged"),
        ("swap", "with the other sign"),
        (if first == "good" { "frozen" } else { "good" }, &format!("a photograph is the same as one of {first}")),
    ] {
        let reasons = desk.json(&format!("out/{serial}/inspect.json"))["reasons"].to_string();
        assert!(reasons.contains(reason), "{serial}: {reasons}");
    }
    let small = |width: &str| {
        let inspect = ["inspect", "out/good", "--golden", "golden.exr", "--tolerance", "9", "--json", "--inspect-roi"];
        desk.run(&[&inspect[..], &["30,24,36,32", "--smallest", width]].concat())
    };
    let (wide, narrow) = (printed(&small("40")), printed(&small("2")));
    assert_eq!((&wide["smallest_px"], &wide["verdict"]), (&40.0.into(), &"go".into()), "{wide:#}");
    assert_eq!((&narrow["verdict"], &narrow["gaps"][0]["is_unseen"]), (&"cannot-judge".into(), &true.into()));
    assert!(
        narrow["reasons"].to_string().contains("a defect 2 px wide and 9 px² high would not be seen"),
        "{narrow:#}"
    );
    let allowed = ["inspect", "out/turned", "--golden", "golden.exr", "--max-rotation", "180", "--max-shift", "9"];
    assert!(!stderr_of(&desk.run(&allowed)).contains("the part lies turned"));
}

#[cfg(unix)]
#[test]
fn watch_hands_each_verdict_on_and_hostile_parts_cannot_be_judged() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let desk = line();
    desk.done(&["teach", "taught", "-o", "golden.exr"]);
    fs::create_dir(desk.path("in")).unwrap();
    let put = |name: &[u8], from: &str| {
        for end in ["1", "2"] {
            let file = [name, b"_", end.as_bytes(), b".png"].concat();
            let from = desk.path(from).join(format!("i{end}.png"));
            fs::copy(from, desk.path("in").join(std::path::Path::new(OsStr::from_bytes(&file)))).unwrap();
        }
    };
    part(&desk, "part", 20, |_, _| false);
    part(&desk, "dented", 21, dent);
    put(b"good", "part");
    put(b"dented", "dented");
    part(&desk, "other", 22, |_, _| false);
    put(b"\xff\xfe", "other");
    for name in [&b"a\\b"[..], b"new\nline", b"\x01", b"batch.json", b"index.html", b"verdicts.xml", b"long"] {
        put(name, "part");
    }
    fs::OpenOptions::new().write(true).open(desk.path("in/long_2.png")).unwrap().set_len(1 << 40).unwrap();
    let script = "echo \"$PARFOCAL_VERDICT $PARFOCAL_STATUS $PARFOCAL_REASONS\" >> calls\n";
    desk.write_script("done.sh", script);
    let output = desk.exits(
        &[
            "watch",
            "in",
            "-o",
            "out",
            "--golden",
            "golden.exr",
            "--no-html",
            "--settle",
            "0",
            "--until-idle",
            "0.2",
            "--on-done",
            "./done.sh",
            "--log",
            "out/log.jsonl",
        ],
        3,
    );
    assert_eq!(desk.text("out/log.jsonl").lines().count(), 12);
    let found = verdicts(&desk.json("out/batch.json"));
    assert_eq!(found.len(), 10, "{found:?} {}", stderr_of(&output));
    let cannot: Vec<&str> =
        found.iter().filter(|(_, verdict)| *verdict == "cannot-judge").map(|(name, _)| name.as_str()).collect();
    assert_eq!(cannot, ["\u{1}", "a\\b", "batch.json", "index.html", "long", "new\nline", "verdicts.xml"]);
    assert_eq!((found["good"].as_str(), found["dented"].as_str()), ("go", "no-go"));
    assert_eq!(found["\u{fffd}\u{fffd}"], "go");
    let calls = desk.text("calls");
    assert_eq!(calls.lines().count(), 10, "{calls}");
    assert!(
        calls.contains("no-go solved deviates at one place") && calls.contains("cannot-judge failed in/long_2.png")
    );
}

#[test]
fn a_photograph_without_a_pair_cannot_be_judged_and_names_alone_give_a_summary() {
    let desk = line();
    desk.done(&["teach", "taught", "-o", "golden.exr"]);
    part(&desk, "in/SN1", 10, |_, _| false);
    part(&desk, "in/SN2", 10, |_, _| false);
    fs::remove_file(desk.path("in/SN2/i1.png")).unwrap();
    fs::create_dir(desk.path("in/SN3")).unwrap();
    desk.write("in/SN3/notes.txt", "no photograph");
    let expected = [("SN1", "go"), ("SN2", "cannot-judge"), ("SN3", "cannot-judge")];
    let expected = expected.map(|(serial, verdict)| (serial.to_string(), verdict.to_string())).into();
    let batch = ["batch", "in", "-o", "out", "--golden", "golden.exr", "--no-html"];
    let watch =
        ["watch", "in", "-o", "out", "--golden", "golden.exr", "--no-html", "--settle", "0", "--until-idle", "0.5"];
    for command in [&batch[..], &watch] {
        let output = desk.exits(command, 4);
        assert_eq!(verdicts(&desk.json("out/batch.json")), expected);
        let printed = stderr_of(&output);
        assert!(printed.contains("cannot judge: SN2: in/SN2: i2.png is left over"), "{printed}");
        assert!(printed.contains("cannot judge: SN3: in/SN3: holds no photograph"), "{printed}");
    }
    // In one folder of all parts it is listed.
    let flat = desk.path("flat");
    fs::create_dir(&flat).unwrap();
    for (name, from) in [("SN1_1.png", "i1.png"), ("SN1_2.png", "i2.png"), ("SN2_1.png", "i1.png")] {
        fs::copy(desk.path("in/SN1").join(from), flat.join(name)).unwrap();
    }
    desk.exits(&["batch", "flat", "-o", "listed", "--golden", "golden.exr", "--no-html"], 4);
    let summary = desk.json("listed/batch.json");
    assert!(summary["left_over"][0].as_str().unwrap().starts_with("SN2_1.png is left over"), "{summary}");
    fs::create_dir(desk.path("only")).unwrap();
    for name in ["index.html_1.png", "index.html_2.png"] {
        fs::copy(desk.path("in/SN1/i1.png"), desk.path("only").join(name)).unwrap();
    }
    desk.exits(&["batch", "only", "-o", "named", "--no-html"], 1);
    assert_eq!(desk.json("named/batch.json")["failed"], 1);
}
