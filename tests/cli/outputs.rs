//! Content and metadata of the files that `solve` writes.

use std::collections::HashMap;
use std::fs;

use parfocal::{frame::Samples, image_io};
use png::{ColorType, Transformations};
use serde_json::Value;

use crate::desk::Desk;
use crate::synthetic::{WIDE_LENS, waves};

const SIZE: [u32; 2] = [96, 64];

/// Returns a folder with 8-bit photographs of different blur, and a float photograph with a highlight above white.
fn desk() -> Desk {
    let desk = Desk::new();
    for (name, contrast) in [("near.png", 0.35), ("far.png", 0.28)] {
        image::DynamicImage::from(photograph(contrast, 0.0)).into_rgb8().save(desk.path(name)).unwrap();
    }
    image::DynamicImage::from(photograph(0.35, 1.0)).save(desk.path("near.tif")).unwrap();
    desk
}

/// Runs the program and returns the report in `out`.
#[track_caller]
fn reported(desk: &Desk, arguments: &[&str]) -> Value {
    desk.done(arguments);
    desk.report("out")
}

#[track_caller]
fn solve(desk: &Desk, extra: &[&str]) -> Value {
    reported(desk, &[&["solve", "near.png", "far.png", "-o", "out", "--no-html"], extra].concat())
}

fn field(desk: &Desk, name: &str) -> Vec<f32> {
    let (width, height, values) = image_io::read_field(&desk.path(name)).unwrap();
    assert_eq!([width, height], SIZE);
    values
}

fn png(desk: &Desk, name: &str) -> Png {
    let file = std::io::BufReader::new(fs::File::open(desk.path(name)).unwrap());
    let mut decoder = png::Decoder::new(file);
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut bytes).unwrap();
    let info = reader.info();
    let text = info.uncompressed_latin1_text.iter().map(|t| (t.keyword.clone(), t.text.clone())).collect();
    Png { width: info.width, color: frame.color_type, text, bytes }
}

/// A photograph of waves of this contrast. The highlight may exceed white.
fn photograph(contrast: f32, highlight: f32) -> image::Rgb32FImage {
    image::Rgb32FImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let value = 0.5 + contrast / 3.0 * waves(x, y) as f32 + if x < 16 { highlight } else { 0.0 };
        image::Rgb([value, value, value / 2.0])
    })
}

/// A PNG file with its samples as stored and its text chunks.
struct Png {
    width: u32,
    color: ColorType,
    text: HashMap<String, String>,
    bytes: Vec<u8>,
}

impl Png {
    fn number(&self, keyword: &str) -> f64 {
        self.text[keyword].parse().unwrap()
    }

    /// Asserts the program's name, the unit, and these words in the description.
    #[track_caller]
    fn states(&self, units: &str, words: &[&str]) {
        assert!(self.text["Software"].starts_with("parfocal ") && self.text["Units"] == units, "{:?}", self.text);
        let description = &self.text["Description"];
        assert!(words.iter().all(|word| description.contains(word)), "{description}");
    }
}

/// Asserts that both 16-bit files reproduce the field within half a step of their stated scale, and NaN as 0.
#[track_caller]
fn holds(desk: &Desk, report: &Value, field: &[f32], unit: &str) {
    let stated = &report["depth16"];
    let png = png(desk, "out/depth16.png");
    let [scale, offset] = ["Scale", "Offset"].map(|name| png.number(name));
    assert_eq!(png.color, ColorType::Grayscale);
    for (name, expected) in [("scale", scale), ("offset", offset)] {
        // serde_json may round the last bit of a number up or down.
        let found = stated[name].as_f64().unwrap();
        assert!((found - expected).abs() <= f64::EPSILON * expected.abs(), "{found} {expected}");
    }
    assert_eq!(stated["unit"], unit);
    png.states(unit, &["sample 0 is not valid"]);
    let file = fs::File::open(desk.path("out/depth16.tiff")).unwrap();
    let mut tiff = tiff::decoder::Decoder::new(std::io::BufReader::new(file)).unwrap();
    let description = tiff.get_tag_ascii_string(tiff::tags::Tag::ImageDescription).unwrap();
    assert!(description.contains(&format!("units={unit}\nscale={scale}\noffset={offset}\n")), "{description}");
    let tiff::decoder::DecodingResult::U16(samples) = tiff.read_image().unwrap() else { panic!("not 16 bits") };
    let of_png: Vec<u16> = png.bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    assert_eq!(samples, of_png);
    for (&sample, &value) in samples.iter().zip(field) {
        assert_eq!(sample == 0, !value.is_finite());
        let found = offset + scale * f64::from(sample);
        assert!(sample == 0 || (found - f64::from(value)).abs() <= 0.501 * scale, "{found}, not {value}");
    }
    assert!(samples.contains(&1) && samples.contains(&65535) && samples.contains(&0));
}

#[test]
fn depth16_files_hold_v_or_depth_if_a_lens_is_given() {
    let desk = desk();
    let report = solve(&desk, &["--export", "depth16"]);
    holds(&desk, &report, &field(&desk, "out/relative_blur.exr"), "px^2");
    // The lens is given later, by `depth`.
    let report = reported(&desk, &[&["depth", "out"], &WIDE_LENS[..]].concat());
    holds(&desk, &report, &field(&desk, "out/depth_mm.exr"), "mm");
    let report = solve(&desk, &[&["--export", "depth16"], &WIDE_LENS[..]].concat());
    holds(&desk, &report, &field(&desk, "out/depth_mm.exr"), "mm");
    assert!(
        solve(&desk, &[]).get("depth16").is_none() && !desk.has("out/depth16.png") && !desk.has("out/depth16.tiff")
    );
}

#[test]
fn the_depth_map_has_a_colour_key_and_states_its_range() {
    let desk = desk();
    solve(&desk, &[]);
    let map = png(&desk, "out/depth.png");
    map.states("px^2", &["relative blur V", "yellow near (", "purple far (", "right of column 96"]);
    assert!(map.width > SIZE[0] && map.color == ColorType::Rgba);
    let row = 4 * map.width as usize;
    for (i, v) in field(&desk, "out/relative_blur.exr").iter().enumerate() {
        let opacity = map.bytes[i / 96 * row + 4 * (i % 96) + 3];
        assert_eq!(opacity, if v.is_nan() { 0 } else { 255 });
    }
    assert!(map.bytes.chunks_exact(row).all(|line| line[row - 1] == 255), "the colour key must be opaque");

    reported(&desk, &["solve", "near.png", "far.png", "-o", "out", "--colors", "red-blue"]);
    assert!(desk.text("out/report.html").contains("\"colormap\":1,"));
    png(&desk, "out/depth.png").states("px^2", &["red near", "blue far"]);
    reported(&desk, &[&["depth", "out", "--colors", "grey"], &WIDE_LENS[..]].concat());
    let map = png(&desk, "out/depth.png");
    map.states("mm", &["depth in mm", "white near", "black far"]);
    let depth = field(&desk, "out/depth_mm.exr");
    let alpha = |i: usize| map.bytes[4 * (i / 96 * map.width as usize + i % 96) + 3];
    assert!((0..depth.len()).all(|i| (alpha(i) == 255) == depth[i].is_finite()));
    desk.exits(&["solve", "near.png", "far.png", "-o", "out", "--colors", "jet"], 2);
}

#[test]
fn labels_identify_the_sharper_photograph() {
    let desk = desk();
    solve(&desk, &["--export", "labels,ply,glb"]);
    let labels = png(&desk, "out/labels.png");
    assert_eq!((labels.width, labels.color), (SIZE[0], ColorType::Indexed));
    labels.states("label", &["1 the first", "2 the second", "3 undecided"]);
    let (blur, deviation) = (field(&desk, "out/relative_blur.exr"), field(&desk, "out/uncertainty.exr"));
    for ((label, v), sigma) in labels.bytes.iter().zip(blur).zip(deviation) {
        let expected = if v.is_nan() {
            0
        } else if v.abs() <= sigma {
            3
        } else if v > 0.0 {
            1
        } else {
            2
        };
        assert_eq!(*label, expected, "{v} ± {sigma}");
    }
    // Programs that ignore the label metadata still show colours.
    let seen = image::open(desk.path("out/labels.png")).unwrap();
    assert!(seen.color().has_color() && seen.color().has_alpha());
}

#[test]
fn every_file_has_metadata_about_its_content() {
    let desk = desk();
    solve(&desk, &["--export", "ply,cloud,glb", "--profile", "10,10,80,10"]);
    png(&desk, "out/fused.png").states("1", &["Best focus", "white at the largest sample"]);
    png(&desk, "out/profile_1.png").states("1", &["Profile"]);
    for name in ["surface.ply", "points.ply"] {
        let bytes = fs::read(desk.path("out").join(name)).unwrap();
        let header = String::from_utf8_lossy(&bytes[..600]).into_owned();
        for words in ["comment parfocal ", "comment unit: px; x right, y up", "px per px^2 times the relative blur V"] {
            assert!(header.contains(words), "{name}: {words:?} in {header}");
        }
    }
    let glb = gltf::Gltf::open(desk.path("out/surface.glb")).unwrap().document.into_json();
    assert!(glb.asset.generator.unwrap().starts_with("parfocal "));
    let bytes = desk.bytes("out/surface.glb");
    let text = String::from_utf8_lossy(&bytes[20..3000]).into_owned();
    assert!(text.contains(r#""unit":"px""#) && text.contains("relative blur V; near is up"), "{text}");
    for (name, units) in [("relative_blur", "px^2"), ("uncertainty", "px^2"), ("confidence", "1")] {
        let file = exr::prelude::read_first_flat_layer_from_file(desk.path(&format!("out/{name}.exr"))).unwrap();
        let attributes = file.layer_data.attributes;
        let found = attributes.other.values().next().unwrap();
        assert_eq!(*found, exr::prelude::AttributeValue::Text(exr::prelude::Text::from(units)));
        assert!(attributes.comments.is_some() && attributes.software_name.is_some());
    }
}

#[test]
fn float_photographs_give_an_unclipped_float_fused_image() {
    let desk = desk();
    let pair = ["near.tif", "near.tif", "-o", "out", "--no-html"];
    reported(&desk, &[&["solve"], &pair[..]].concat());
    let fused = image_io::read(&desk.path("out/fused.exr")).unwrap();
    let Samples::F32(values) = fused.samples() else { panic!("not in floats") };
    assert_eq!((fused.width(), values.len()), (96, 3 * 96 * 64));
    assert!(values.iter().any(|v| *v > 1.2), "clipped");
    let blue_is_half = values.chunks_exact(3).filter(|p| (p[2] - p[0] / 2.0).abs() < 0.01).count();
    assert!(blue_is_half == 96 * 64 && desk.has("out/fused.png"));
    solve(&desk, &[]);
    assert!(!desk.has("out/fused.exr"), "8-bit photographs give no fused.exr, and the earlier file must be removed");
}

#[test]
fn measure_replaces_only_measurements_of_the_same_kind() {
    let desk = desk();
    let report = solve(&desk, &["--step", "8,8,20,20", "50,8,20,20", "--profile", "10,10,80,10"]);
    let step = report["measurements"]["steps"][0].clone();
    let report = reported(&desk, &["measure", "out", "--profile", "10,40,80,40", "--profile", "10,50,80,50"]);
    let measured = &report["measurements"];
    assert_eq!((&measured["steps"][0], measured["profiles"].as_array().unwrap().len()), (&step, 2));
    assert_eq!(measured["profiles"][0]["from"], serde_json::json!([10.0, 40.0]));
    let csv = desk.text("out/profile_1.csv");
    assert!(csv.lines().nth(1).unwrap().starts_with("0,10,40,"), "{csv}");
    let report = reported(&desk, &["measure", "out", "--step", "8,30,20,20", "50,30,20,20"]);
    assert_eq!(report["measurements"]["steps"][0]["from"], serde_json::json!([8, 30, 20, 20]));
    assert!(report["measurements"]["profiles"][1]["csv"] == "profile_2.csv" && desk.has("out/profile_2.png"));
}

#[test]
fn a_photograph_with_the_name_of_a_profile_is_not_replaced() {
    let desk = desk();
    fs::create_dir(desk.path("out")).unwrap();
    fs::copy(desk.path("near.png"), desk.path("out/profile_2.png")).unwrap();
    for extra in [&["--profile", "10,10,80,10", "--profile", "10,20,80,20"][..], &[]] {
        let solve = [&["solve", "out/profile_2.png", "far.png", "-o", "out"], extra].concat();
        desk.refuses(&solve, 1, &["profile_2.png would replace it"]);
    }
    assert!(!desk.has("out/report.json"));
}
