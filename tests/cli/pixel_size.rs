//! `--pixel-size`: surfaces, profiles, views and roughness in mm without a lens.

use serde_json::Value;

use crate::desk::Desk;

/// The vertices of `surface.obj`.
fn vertices(desk: &Desk, out: &str) -> Vec<[f64; 3]> {
    let text = desk.text(&format!("{out}/surface.obj"));
    let numbers = |line: &str| line.split(' ').skip(1).map(|word| word.parse().unwrap()).collect::<Vec<f64>>();
    text.lines().filter(|line| line.starts_with("v ")).map(numbers).map(|v| [v[0], v[1], v[2]]).collect()
}

fn to_scale(desk: &Desk, out: &str) -> bool {
    let page = desk.text(&format!("{out}/report.html"));
    let data = page.split_once("id=\"data\">").unwrap().1.split_once("</script>").unwrap().0;
    serde_json::from_str::<Value>(data).unwrap()["surface"]["to_scale"] == true
}

/// The columns of a profile by their names.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let n = csv.lines().next().unwrap().split(',').position(|cell| cell == name).unwrap();
    csv.lines().skip(1).map(|line| line.split(',').nth(n).unwrap().parse().unwrap_or(f64::NAN)).collect()
}

#[test]
fn a_sweep_of_a_stage_with_a_pixel_size_is_a_surface_in_mm() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "frames", "--frames", "4", "--size", "96x80"]);
    let stage = ["--focus-at", "0,0.1,0.2,0.3", "--stage"];
    let solve = |out: &str, extra: &[&str]| {
        let own = ["stack", "frames", "-o", out, "--export", "obj", "--profile", "10,40,70,40"];
        desk.done(&[&own[..], extra].concat());
    };
    solve("px", &stage);
    solve("mm", &[&stage[..], &["--pixel-size", "5"]].concat());
    assert_eq!(
        (&desk.report("px")["surface"]["unit"], &desk.report("mm")["surface"]["unit"]),
        (&"px".into(), &"mm".into())
    );
    assert_eq!(desk.report("mm")["pixel_size_um"], 5.0);
    assert!(!to_scale(&desk, "px") && to_scale(&desk, "mm"));
    // The grid is of 5 µm; heights are the depths, near up.
    let (_, _, depth) = parfocal::image_io::read_field(&desk.path("mm/depth_mm.exr")).unwrap();
    let points = vertices(&desk, "mm");
    assert!(points.len() > 5000);
    // The first frame is focused nearest, at the least position.
    for [x, y, z] in &points {
        let [column, row] = [x / 0.005, -y / 0.005];
        assert!((column - column.round()).abs() < 1e-3 && (row - row.round()).abs() < 1e-3);
        let expected = f64::from(depth[row.round() as usize * 96 + column.round() as usize]);
        assert!((z.abs() - expected.abs()).abs() < 1e-5 && *z <= 1e-6, "{z}, {expected}");
    }
    // Profiles and roughness follow.
    let csv = desk.text("mm/profile_1.csv");
    assert!((column(&csv, "distance_mm")[60] - 0.3).abs() < 1e-9);
    assert!(!desk.text("px/profile_1.csv").contains("distance_mm"));
    let rough = |out: &str, extra: &[&str]| desk.printed(&[&["roughness", out, "--realizations", "2"], extra].concat());
    let (followed, stated) = (rough("mm", &[]), rough("px", &["--pixel-size", "5"]));
    assert_eq!((&followed["lateral_unit"], &followed["parameters"]), (&"µm".into(), &stated["parameters"]));
    assert!(followed["parameters"][8]["value"].as_f64().unwrap() > 0.0, "Sdr is known");
    desk.done(&["view", "mm", "--width", "64"]);

    // The pixel size can be added later, and the page, the surface and the report follow.
    let printed = desk.printed(&["depth", "px", "--pixel-size", "5"]);
    assert_eq!((&printed["pixel_size_um"], &printed["stage"]), (&5.0.into(), &true.into()));
    assert!(to_scale(&desk, "px"));
    assert_eq!(vertices(&desk, "px"), points);
    assert_eq!(desk.report("px")["depth"], desk.report("mm")["depth"]);
}

#[test]
fn a_pair_without_a_lens_has_lateral_lengths_and_no_metric_surface() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "pair", "--size", "96x80"]);
    let own = ["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--export", "obj", "--pixel-size", "2.5"];
    desk.done(&own);
    assert_eq!(desk.report("out")["surface"]["unit"], "px");
    assert!(!to_scale(&desk, "out"));
    let found = desk.printed(&["roughness", "out", "--realizations", "2"]);
    assert_eq!((&found["unit"], &found["lateral_unit"]), (&"px²".into(), &"µm".into()));
    assert_eq!(found["parameters"][8]["value"], Value::Null);
    desk.done(&["measure", "out", "--profile", "10,40,50,40"]);
    let csv = desk.text("out/profile_1.csv");
    assert!((column(&csv, "distance_mm")[40] - 0.1).abs() < 1e-9);
    // Without depth in mm it can be changed too.
    let printed = desk.printed(&["depth", "out", "--pixel-size", "5"]);
    assert_eq!(printed, serde_json::json!({ "pixel_size_um": 5.0 }));
    assert!(!desk.has("out/depth_mm.exr") && desk.report("out")["pixel_size_um"] == 5.0);
    for (arguments, status, parts) in [
        (&["depth", "out", "--pixel-size", "0"][..], 2, &["above 0"][..]),
        (&["depth", "out", "--pixel-size", "5", "--nearer", "1"], 2, &["needs a lens"]),
        (&["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--pixel-size", "nan"], 2, &["above 0"]),
    ] {
        desk.refuses(arguments, status, parts);
    }
    let report = desk.text("out/report.json");
    desk.write("out/report.json", report.replace("\"pixel_size_um\": 5.0", "\"pixel_size_um\": -5.0"));
    desk.refuses(&["roughness", "out"], 1, &["report.json", "a pixel of -5 µm"]);
}
