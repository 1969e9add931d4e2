//! File formats of photographs, including raw frames of machine vision cameras, solved by the program.

use std::fs;

use parfocal::image_io;
use serde_json::Value;

use crate::desk::{Desk, assert_fails, stderr_of};

const SIZE: [u32; 2] = [121, 90];

/// Returns a folder with a simulated 16-bit pair.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "pair", "--size", &format!("{}x{}", SIZE[0], SIZE[1])]);
    desk
}

fn solve(desk: &Desk, i1: &str, i2: &str, extra: &[&str]) -> Value {
    desk.printed(&[&["solve", i1, i2, "-o", "out", "--no-html"], extra].concat())
}

/// The samples of both photographs, reduced to `bits` bits.
fn samples(desk: &Desk, bits: u32) -> [Vec<u16>; 2] {
    ["pair/i1.png", "pair/i2.png"].map(|name| {
        let image = image::open(desk.path(name)).unwrap().into_luma16();
        image.into_raw().into_iter().map(|v| v >> (16 - bits)).collect()
    })
}

/// Packs samples of `bits` bits without gaps, least significant bits first.
fn packed(samples: &[u16], bits: u32) -> Vec<u8> {
    let (mut bytes, mut rest, mut count) = (Vec::new(), 0u64, 0);
    for sample in samples {
        rest |= u64::from(*sample) << count;
        count += bits;
        while count >= 8 {
            bytes.push(rest as u8);
            (rest, count) = (rest >> 8, count - 8);
        }
    }
    bytes.extend((count > 0).then_some(rest as u8));
    bytes
}

#[test]
fn bmp_and_webp_pairs_are_solved_like_png() {
    let desk = desk();
    let pair = ["i1", "i2"].map(|name| image::open(desk.path(&format!("pair/{name}.png"))).unwrap().into_luma8());
    for (ending, format) in [("png", "PNG"), ("bmp", "BMP"), ("webp", "WebP")] {
        for (image, name) in pair.iter().zip(["i1", "i2"]) {
            let path = desk.path(&format!("{name}.{ending}"));
            // The WebP encoder has no grey format. Lossless RGB preserves the grey values.
            let gray = image::DynamicImage::from(image.clone());
            if ending == "webp" { gray.into_rgb8().save(path).unwrap() } else { gray.save(path).unwrap() }
        }
        let frame = image_io::read(&desk.path(&format!("i1.{ending}"))).unwrap();
        assert_eq!((frame.width(), frame.height()), (SIZE[0], SIZE[1]));
        let found = solve(&desk, &format!("i1.{ending}"), &format!("i2.{ending}"), &[]);
        assert_eq!(found["inputs"][0]["format"], format);
        assert!((found["frames"][1]["transform"]["scale"].as_f64().unwrap() - 1.0).abs() < 0.05);
    }
}

/// A PGM file of 8 bits: light from 0.02 to 0.94 with a pattern, and the noise of 4000 electrons at white.
fn noisy(mut seed: u64) -> Vec<u8> {
    let (width, height) = (512, 256);
    let mut uniform = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f64 / f64::from(1 << 24)
    };
    let sample = |n: usize| {
        let (x, y) = ((n % width) as f64, (n / width) as f64);
        let light = 0.05 + 0.86 * x / width as f64 + 0.03 * (x / 5.0).sin() * (y / 5.0).sin();
        // The sum of twelve uniform values has variance 1.
        let normal = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        (255.0 * (light + (light / 4000.0).sqrt() * normal)).round() as u8
    };
    [format!("P5 {width} {height} 255\n").into_bytes(), (0..width * height).map(sample).collect()].concat()
}

#[test]
fn linear_8_bit_photographs_are_found_by_their_noise() {
    let desk = desk();
    let names = ["1.pgm", "2.pgm", "3.pgm"];
    (1..).zip(names).for_each(|(seed, name)| desk.write(name, noisy(seed)));
    let by_noise = serde_json::json!({"decode": "none", "by": "noise"});
    let found = solve(&desk, names[0], names[1], &[]);
    assert_eq!(found["values"], by_noise);
    assert_eq!(found["settings"]["decode"], "none");
    assert_eq!(desk.printed(&["register", names[0], names[1]])["values"], by_noise);
    assert_eq!(desk.printed(&[&["register"][..], &names].concat())["values"], by_noise);
    // What is stated stays.
    let stated = solve(&desk, names[0], names[1], &["--decode", "srgb"]);
    assert_eq!(stated["values"], serde_json::json!({"decode": "srgb", "by": "stated"}));
    let summary = desk.run(&["solve", names[0], names[1], "-o", "printed", "--no-html"]);
    let summary = stderr_of(&summary);
    assert!(summary.contains("linear: the noise grows with brightness"), "{summary}");
}

#[test]
fn raw_frames_are_read_in_the_stated_pixel_format() {
    let desk = desk();
    let size = format!("{}x{}", SIZE[0], SIZE[1]);
    let deep = solve(&desk, "pair/i1.png", "pair/i2.png", &[]);
    let (raw, tx) =
        (format!("Mono12p:{size}"), |report: &Value| report["frames"][1]["transform"]["tx_px"].as_f64().unwrap());
    for (samples, name) in samples(&desk, 12).iter().zip(["i1", "i2"]) {
        desk.write(&format!("raw/{name}.raw"), packed(samples, 12));
        let words: Vec<u8> = samples.iter().flat_map(|v| v.to_le_bytes()).collect();
        desk.write(&format!("{name}.bin"), &words);
    }
    let found = solve(&desk, "raw/i1.raw", "raw/i2.raw", &["--raw", &raw]);
    assert!((tx(&found) - tx(&deep)).abs() < 0.02, "{} {}", tx(&found), tx(&deep));
    assert_eq!((&found["inputs"][0]["bits"], &found["inputs"][0]["format"]), (&12.into(), &"raw".into()));
    assert_eq!(found["values"]["decode"], "none");
    // The pixel format may follow the file name, and may differ between the photographs.
    let (first, second) = (format!("raw/i1.raw#{raw}"), format!("i2.bin#Mono12:{size}"));
    assert_eq!(tx(&solve(&desk, &first, &second, &[])), tx(&found));
    // A folder of raw frames can be solved as a batch.
    let batch = desk.printed(&["batch", "raw", "-o", "many", "--raw", &raw, "--no-html"]);
    assert_eq!(batch["pairs"].as_array().map(Vec::len), Some(1), "{batch}");

    for (format, parts) in [
        (format!("Mono10p:{size}"), &["takes 13613", "it may be Mono12p"][..]),
        ("Mono12p:9x9".to_string(), &["state another size"]),
        ("Mono13:9x9".to_string(), &["no supported pixel format", "Mono12Packed"]),
        ("Mono12p".to_string(), &["as in Mono12p:2448x2048"]),
    ] {
        assert_fails(&desk.run(&["solve", "raw/i1.raw", "raw/i2.raw", "-o", "none", "--raw", &format]), parts);
    }
    let output = desk.run(&["solve", "raw/i1.raw", "raw/i2.raw", "-o", "none"]);
    assert!(stderr_of(&output).contains("--raw"));
}

#[test]
fn a_pixel_pitch_in_micrometres_gets_a_suggestion() {
    let desk = desk();
    let lens = ["--focal-length=50", "--f-number=5.6", "--focus=226.5,233.5"];
    let pitch = |pitch: &str| {
        let output =
            desk.run(&[&["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--strict", pitch], &lens[..]].concat());
        (output.status.success(), stderr_of(&output))
    };
    let (done, stderr) = pitch("--pixel-pitch=3.45");
    assert!(!done && stderr.contains("did you mean a pixel pitch of 0.00345 mm?"), "{stderr}");
    let (done, stderr) = pitch("--pixel-pitch=0.00345");
    assert!(done && !stderr.contains("did you mean"), "{stderr}");
    // The `depth` command warns as well. A later run with a plausible lens removes the warning.
    let depth = |pitch: &str| {
        let output = desk.run(&[&["depth", "out", pitch], &lens[..]].concat());
        let warnings = desk.json("out/report.json");
        (stderr_of(&output), warnings["warnings"].to_string())
    };
    let (stderr, warnings) = depth("--pixel-pitch=3.45");
    assert!(stderr.contains("did you mean") && warnings.contains("did you mean"), "{stderr}");
    let (stderr, warnings) = depth("--pixel-pitch=0.00345");
    assert!(!stderr.contains("did you mean") && !warnings.contains("the lens"), "{stderr} {warnings}");
}

#[test]
fn mistaken_arguments_get_a_suggestion() {
    let desk = desk();
    let own = ["solve", "pair/i1.png", "pair/i2.png", "-o"];
    for (extra, parts) in [
        (&["out", "--nearer", "far"][..], &["give 1 or 2", "I2"][..]),
        (&["out", "--f-number", "2,8"], &["did you mean 2.8?", "point"]),
        (&["out", "--max-blur", "20"], &["--max-relative-blur"]),
        (&["out", "--alpha=0.1"], &["--regularization"]),
        (&["-"], &["--json", "folder"]),
    ] {
        desk.refuses(&[&own[..], extra].concat(), 2, parts);
    }
    assert!(!desk.has("out") && !desk.has("-"));

    // A results folder is accepted in place of its report.
    solve(&desk, "pair/i1.png", "pair/i2.png", &[]);
    let held = desk.printed(&[
        "solve",
        "pair/i1.png",
        "pair/i2.png",
        "-o",
        "held",
        "--transform",
        "out",
        "--hold",
        "--no-html",
    ]);
    assert_eq!(held["method"], "aligned");
    let black = image::GrayImage::new(SIZE[0], SIZE[1]);
    black.save(desk.path("black.png")).unwrap();
    desk.refuses(&[&own[..], &["none", "--mask", "black.png"]].concat(), 1, &["black.png: leaves no pixel"]);
    for name in ["a_1.png", "a_2.png", "a_3.png"] {
        fs::copy(desk.path("pair/i1.png"), desk.path(name)).unwrap();
    }
    image::GrayImage::new(64, 48).save(desk.path("a_2.png")).unwrap();
    let sizes = "a_2.png: frame 2 is 64x48, grey, 8 bits, and a_1.png is 121x90, grey, 16 bits";
    desk.refuses(&["stack", "a_1.png", "a_2.png", "a_3.png", "-o", "none"], 1, &[sizes]);
    assert!(!desk.has("none"));
}

#[test]
fn progress_is_printed_as_json_and_the_lens_of_a_report_is_reused() {
    let desk = desk();
    let output = desk.run(&["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--progress", "json", "-q"]);
    let stderr = stderr_of(&output);
    let lines: Vec<Value> = stderr.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(
        lines.len() >= 2 && lines.iter().all(|line| line["levels"].is_u64() && line["seconds"].is_f64()),
        "{stderr}"
    );
    assert_eq!(lines.last().unwrap()["progress"], 1.0, "{stderr}");

    let lens = ["--focal-length=50", "--f-number=5.6", "--pixel-pitch=0.00345", "--focus=226.5,233.5"];
    let depth = desk.printed(&[&["depth", "out"], &lens[..]].concat());
    let again = desk.printed(&["depth", "out", "--kappa", "0.45"]);
    assert_eq!((&again["lens"]["focus_mm"], &again["lens"]["kappa"]), (&depth["lens"]["focus_mm"], &0.45.into()));
    let refused = desk.run(&["calibrate", "out", "--known", "10,10,20,20=20"]);
    assert!(!stderr_of(&refused).contains("give the lens"));
}
