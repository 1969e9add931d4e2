//! Commands that update results also regenerate the page, the meshes and the arrays.

use std::collections::BTreeMap;
use std::fs;

use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use serde_json::Value;

use crate::desk::{Desk, python, stderr_of};
use crate::synthetic::CUP_LENS;

/// Returns a folder with a simulated pair.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "pair", "--size", "120x90", "--range", "1.2"]);
    desk
}

fn solve(desk: &Desk, out: &str, extra: &[&str]) {
    desk.done(&[&["solve", "pair/i1.png", "pair/i2.png", "-o", out], extra].concat());
}

/// The `<script>` elements of a page that hold data, by id.
fn elements(desk: &Desk, out: &str) -> BTreeMap<String, String> {
    let page = desk.text(&format!("{out}/report.html"));
    let parts = page.split("<script type=\"").skip(1).filter_map(|part| part.split_once("\" id=\""));
    let parts = parts.filter_map(|(_, rest)| rest.split_once("\">"));
    parts.map(|(id, text)| (id.to_string(), text.split("</script>").next().unwrap().to_string())).collect()
}

/// The JSON data of a page.
fn page_data(desk: &Desk, out: &str) -> Value {
    serde_json::from_str(&elements(desk, out)["data"]).unwrap()
}

const SURFACES: [&str; 5] = ["surface.ply", "points.ply", "surface.glb", "surface.stl", "surface.obj"];
const ARRAYS: [&str; 5] = ["depth.npy", "deviation.npy", "depth.tiff", "deviation.tiff", "depth.zarr.zip"];
const EXPORT: [&str; 4] = ["--export", "ply,cloud,glb,stl,obj,depth16,npy,tiff,zarr", "--mesh-cells", "40"];

#[test]
fn depth_command_gives_the_same_files_as_solve_with_a_lens() {
    let desk = desk();
    solve(&desk, "at_once", &[&CUP_LENS[..], &EXPORT].concat());
    solve(&desk, "later", &[&EXPORT[..], &["--nearer", "2"]].concat());
    assert_eq!(desk.report("later")["surface"]["unit"], "px");
    let before = desk.bytes("later/surface.ply");
    // The command must not need the photographs.
    fs::rename(desk.path("pair"), desk.path("elsewhere")).unwrap();
    desk.done(&[&["depth", "later"], &CUP_LENS[..]].concat());
    let [at_once, later] = ["at_once", "later"].map(|out| desk.report(out));
    assert_eq!((&later["surface"], &later["surface"]["unit"]), (&at_once["surface"], &"mm".into()));
    assert_ne!(before, desk.bytes("later/surface.ply"));
    for name in SURFACES.iter().chain(&ARRAYS).chain(&["depth16.png", "depth.png", "depth_mm.exr"]) {
        let [a, b] = ["at_once", "later"].map(|out| desk.bytes(&format!("{out}/{name}")));
        assert!(a == b, "{name}");
        assert_eq!(later["hashes"][name], at_once["hashes"][name], "{name}");
    }
    let ([mut a, mut b], data) = (["at_once", "later"].map(|out| elements(&desk, out)), page_data(&desk, "later"));
    assert_eq!(data["report"]["depth"], later["depth"]);
    assert_eq!(
        (&data["surface"], &data["names"]),
        (&page_data(&desk, "at_once")["surface"], &serde_json::json!(["i1.png", "i2.png"]))
    );
    assert!(a.remove("data").is_some() && b.remove("data").is_some());
    assert!(a == b && a.contains_key("field-relative_blur") && a.contains_key("picture-2"));

    // A lens with the two focus distances exchanged: near and far swap.
    let turned = ["--focus=869,529"];
    desk.done(&[&["depth", "later", "--lens", "later/report.json"], &turned[..]].concat());
    let again = desk.report("later");
    assert_eq!((&again["nearer"], &page_data(&desk, "later")["report"]["nearer"]), (&2.into(), &2.into()));
    assert!(SURFACES.iter().all(|name| desk.path("later").join(name).is_file()));
    assert_ne!(elements(&desk, "later")["heights"], a["heights"]);
}

#[test]
fn the_page_shows_measurements_and_an_unreadable_page_is_reported() {
    let desk = desk();
    solve(&desk, "out", &[&CUP_LENS[..], &["--colors", "red-blue"]].concat());
    let pictures = elements(&desk, "out")["picture-1"].clone();
    desk.done(&["measure", "out", "--step", "10,10,20,20", "70,40,20,20"]);
    let data = page_data(&desk, "out");
    assert_eq!(data["report"]["measurements"], desk.report("out")["measurements"]);
    assert!(data["report"]["measurements"]["steps"][0]["depth_mm"].is_object() && data["colormap"] == 1);
    assert_eq!(elements(&desk, "out")["picture-1"], pictures);

    let view = desk.path("out/view.png");
    desk.done(&["view", "out", "--width", "64"]);
    let depth = [&["depth", "out"], &CUP_LENS[..]].concat();
    assert!(stderr_of(&desk.done(&depth)).contains(view.file_name().unwrap().to_str().unwrap()));
    desk.write("out/report.html", "<html>");
    let stderr = stderr_of(&desk.done(&depth));
    assert!(stderr.contains("report.html cannot be written again"), "{stderr}");
    assert!(!desk.has("out/report.html") && desk.report("out")["hashes"].get("report.html").is_none());
}

/// Distance between two points.
fn apart(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|k| f64::from(a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn independent_readers_read_the_surface_in_millimetres() {
    let desk = desk();
    solve(&desk, "out", &[&CUP_LENS[..], &["--export", "stl,obj,ply"]].concat());
    let stl = stl_io::read_stl(&mut fs::File::open(desk.path("out/surface.stl")).unwrap()).unwrap();
    stl.validate().unwrap_err(); // The mesh has a border, which `validate` refuses.
    let (models, _) = tobj::load_obj(desk.path("out/surface.obj"), &tobj::LoadOptions::default()).unwrap();
    let mesh = &models[0].mesh;
    assert_eq!(mesh.indices.len(), 3 * stl.faces.len());
    assert_eq!(mesh.vertex_color.len(), mesh.positions.len());
    let corner = |k: usize| -> [f32; 3] { mesh.positions[3 * k..3 * k + 3].try_into().unwrap() };
    for (face, corners) in stl.faces.iter().zip(mesh.indices.chunks_exact(3)) {
        let found = face.vertices.map(|i| stl.vertices[i].0);
        assert!((0..3).all(|k| apart(found[k], corner(corners[k] as usize)) < 1e-3));
    }
    let ply = Parser::<DefaultElement>::new();
    let ply = ply.read_ply(&mut fs::File::open(desk.path("out/surface.ply")).unwrap()).unwrap();
    let number = |vertex: &DefaultElement, name: &str| match vertex[name] {
        Property::Float(value) => value,
        ref other => panic!("{name} is {other:?}"),
    };
    let vertices = &ply.payload["vertex"];
    assert_eq!((vertices.len() * 3, ply.payload["face"].len() * 3), (mesh.positions.len(), mesh.indices.len()));
    // The OBJ reader stores vertices in the order in which faces refer to them.
    for (face, corners) in ply.payload["face"].iter().zip(mesh.indices.chunks_exact(3)) {
        let Property::ListInt(found) = &face["vertex_indices"] else { panic!("{face:?}") };
        for (i, k) in found.iter().zip(corners) {
            assert_eq!(["x", "y", "z"].map(|name| number(&vertices[*i as usize], name)), corner(*k as usize));
        }
    }
    // Each point lies at its depth on the ray through its pixel and the front focal point.
    let report = desk.report("out");
    let [near, far] = ["min", "max"].map(|key| report["depth"][key].as_f64().unwrap());
    for point in mesh.positions.chunks_exact(3) {
        let z = -f64::from(point[2]);
        assert!((near - 0.01..=far + 0.01).contains(&z), "{point:?}, {near} to {far}");
        let column = f64::from(point[0]) / (0.01304 * (z - 25.0) / 25.0) + 59.5;
        assert!((column - column.round()).abs() < 1e-2 && (0.0..120.0).contains(&column.round()), "{point:?}");
    }
}

/// Python script that prints the shape, the number of finite values and their sum for each exported array.
///
/// It fails if the three file formats differ.
const READER: &str = "
import json, sys, numpy, tifffile, zarr
folder, quantity = sys.argv[1:]
stored = zarr.open_group(zarr.storage.ZipStore(folder + '/depth.zarr.zip', mode='r'), mode='r')
found = {}
for name, within in (('depth', quantity), ('deviation', 'standard_deviation')):
    arrays = [numpy.load(f'{folder}/{name}.npy'), tifffile.imread(f'{folder}/{name}.tiff'), stored[within][:]]
    assert all(a.dtype == numpy.float32 and a.shape == arrays[0].shape for a in arrays)
    assert all(numpy.array_equal(a, arrays[0], equal_nan=True) for a in arrays)
    number = numpy.isfinite(arrays[0])
    found[name] = [*arrays[0].shape, int(number.sum()), float(arrays[0][number].astype(float).sum())]
found['units'] = stored[quantity].attrs['units']
print(json.dumps(found))
";

#[test]
fn numpy_tifffile_and_zarr_read_the_same_values() {
    let desk = desk();
    // The image spans two Zarr chunks, both incomplete.
    desk.done(&["simulate", "relief", "-o", "pair", "--size", "530x40", "--range", "1.2", "--force"]);
    for (lens, quantity, units, file) in
        [(&[][..], "relative_blur", "px^2", "relative_blur.exr"), (&CUP_LENS, "depth", "mm", "depth_mm.exr")]
    {
        solve(&desk, "out", &[lens, &["--export", "npy,tiff,zarr"]].concat());
        let found = python(READER, &[desk.path("out").to_str().unwrap(), quantity]);
        let (width, height, values) = parfocal::image_io::read_field(&desk.path("out").join(file)).unwrap();
        let (_, _, sigma) = parfocal::image_io::read_field(&desk.path("out/uncertainty.exr")).unwrap();
        let most = desk.report("out")["texture"]["max_uncertainty_px2"].as_f64().unwrap() as f32;
        let measured: Vec<f64> =
            values.iter().zip(sigma).filter(|(v, s)| v.is_finite() && *s <= most).map(|(v, _)| f64::from(*v)).collect();
        assert_eq!(
            (&found["depth"][0], &found["depth"][1], &found["units"]),
            (&height.into(), &width.into(), &units.into())
        );
        assert_eq!(found["depth"][2].as_u64(), Some(measured.len() as u64));
        assert!((found["depth"][3].as_f64().unwrap() - measured.iter().sum::<f64>()).abs() < 1e-3);
        assert_eq!(found["deviation"][2], found["depth"][2]);
    }
}
