//! Exports for metrology, read by programs that are not ours.

use std::fs;

use serde_json::Value;

use crate::desk::{Desk, python};

const METRIC: &str = "x3p,sdf,sdf-ascii,xyz";
const FILES: [&str; 6] =
    ["surface.x3p", "surface.sdf", "surface_ascii.sdf", "surface_x.tiff", "surface_y.tiff", "surface_z.tiff"];

/// Compares each file with depth.npy: by zipfile, hashlib and ElementTree of Python, tifffile, zarr, and surfalize,
/// SurfaceTopography and xarray where they are installed.
///
/// X3P and SDF begin with the bottom row. `sign` is 1 where larger depths are nearer. Prints the readers and the
/// largest difference of heights, mm.
const READER: &str = r#"
import hashlib, importlib.util, json, sys, xml.etree.ElementTree as ElementTree, zipfile
import numpy, tifffile, zarr
folder, sign, pixel, lens = sys.argv[1], float(sys.argv[2]), float(sys.argv[3]), sys.argv[4] == "lens"
heights = sign * numpy.load(folder + "/depth.npy").astype(float)
rows, columns = heights.shape
missing, readers, worst = numpy.isnan(heights), ["zipfile", "tifffile"], 0.0
assert numpy.nanmax(abs(heights[::-1] - heights)) > 0.01 * numpy.nanmax(abs(heights))

def compare(name, found, step=None):
    global worst
    found = numpy.asarray(found, dtype=float)
    assert found.shape == heights.shape and (numpy.isnan(found) == missing).all(), name
    worst = max(worst, float(numpy.nanmax(abs(found - heights))))
    assert step is None or abs(step / pixel - 1) < 1e-4, (name, step)

with zipfile.ZipFile(folder + "/surface.x3p") as archive:
    assert archive.testzip() is None
    main, data = archive.read("main.xml"), archive.read("bindata/data.bin")
    assert archive.read("md5checksum.hex").split()[0].decode() == hashlib.md5(main).hexdigest()
root = ElementTree.fromstring(main)
assert root.find("Record3/DataLink/MD5ChecksumPointData").text == hashlib.md5(data).hexdigest().upper()
size = [int(root.find("Record3/MatrixDimension/" + side).text) for side in ("SizeX", "SizeY", "SizeZ")]
assert size == [columns, rows, 1]
step = 1e3 * float(root.find("Record1/Axes/CX/Increment").text)
compare("x3p", 1e3 * numpy.frombuffer(data, "<f8").reshape(rows, columns)[::-1], step)

x, y, z = [tifffile.imread(f"{folder}/surface_{axis}.tiff") for axis in "xyz"]
compare("xyz", -z)
assert (numpy.isnan(x) == missing).all() and (numpy.isnan(y) == missing).all()
across, down = numpy.diff(x, axis=1), numpy.diff(y, axis=0)
assert (lens or abs(numpy.nanmedian(across) / pixel - 1) < 1e-3) and numpy.nanmin(across) > 0 and numpy.nanmin(down) > 0

group = zarr.open_group(zarr.storage.ZipStore(folder + "/depth.zarr.zip", mode="r"), mode="r")
compare("zarr", sign * group["depth"][:])
readers.append("zarr " + zarr.__version__)
def has(name):
    return importlib.util.find_spec(name) is not None
if has("surfalize"):
    from surfalize import Surface
    for name in ("surface.x3p", "surface.sdf", "surface_ascii.sdf"):
        surface = Surface.load(f"{folder}/{name}")
        compare(name + " by surfalize", surface.data[::-1] / 1e3, surface.step_x / 1e3)
    readers.append("surfalize")
if has("SurfaceTopography"):
    from SurfaceTopography import read_topography
    for name in ("surface.x3p", "surface.sdf", "surface_ascii.sdf"):
        surface = read_topography(f"{folder}/{name}")
        of = {"m": 1e3, "µm": 1e-3, "mm": 1.0}[surface.unit]
        found = numpy.ma.filled(numpy.ma.asarray(of * surface.heights(), dtype=float), numpy.nan).T
        compare(name + " by SurfaceTopography", found[::-1], of * surface.physical_sizes[0] / columns)
    readers.append("SurfaceTopography")
if has("xarray"):
    import xarray
    data = xarray.open_zarr(zarr.storage.ZipStore(folder + "/depth.zarr.zip", mode="r"))
    compare("xarray", sign * data["depth"].values)
    assert data["depth"].attrs["units"] == "mm" and data["depth"].dims == ("y", "x")
    readers.append("xarray")
print(json.dumps({"readers": readers, "worst_mm": worst}))
"#;

fn read(desk: &Desk, out: &str, [sign, pixel, kind]: [&str; 3]) -> Value {
    let found = python(READER, &[desk.path(out).to_str().unwrap(), sign, pixel, kind]);
    println!("{found}");
    found
}

#[test]
fn metric_exports_of_a_sweep_are_read_by_other_programs() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "frames", "--frames", "4", "--size", "530x64"]);
    let export = format!("{METRIC},npy,zarr,tiff");
    let own = ["stack", "frames", "-o", "out", "--stage", "--pixel-size", "4.5", "--export", &export];
    for (nearer, sign) in [("1", "-1"), ("2", "1")] {
        desk.done(&[&own[..], &["--focus-at", "0,0.1,0.2,0.3", "--nearer", nearer]].concat());
        let found = read(&desk, "out", [sign, "0.0045", "stage"]);
        assert!(found["worst_mm"].as_f64().unwrap() < 1e-7, "{found}");
    }
    // What is added later is regenerated, and files are listed and replaced.
    desk.done(&["depth", "out", "--focus-at", "0,0.2,0.4,0.6", "--stage", "--pixel-size", "9"]);
    read(&desk, "out", ["-1", "0.009", "stage"]);
    let report = desk.report("out");
    assert!(FILES.iter().all(|file| report["hashes"][file].is_object()), "{report}");
    desk.done(&["stack", "frames", "-o", "out"]);
    assert!(FILES.iter().all(|file| !desk.path("out").join(file).exists()));
    // Chunks are compressed: less than half of two arrays in floats.
    desk.done(&[&own[..], &["--focus-at", "0,0.1,0.2,0.3"]].concat());
    let bytes = fs::metadata(desk.path("out/depth.zarr.zip")).unwrap().len();
    assert!(bytes < 2 * 530 * 64 * 4, "{bytes}");
}

#[test]
fn metric_exports_of_a_pair_follow_its_lens() {
    let desk = Desk::new();
    desk.done(&["simulate", "cylinders", "-o", "pair", "--size", "160x120"]);
    let own = ["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--lens", "pair/truth.json"];
    desk.done(&[&own[..], &["--export", &format!("{METRIC},npy,zarr")]].concat());
    let lens = desk.json("pair/truth.json");
    let number = |name: &str| lens["lens"][name].as_f64().unwrap();
    let (f, u) = (number("focal_length_mm"), lens["lens"]["focus_mm"][0].as_f64().unwrap());
    let report = desk.report("out");
    // The depth scale's middle is near the middle of the range.
    let [near, far] = ["min", "max"].map(|end| report["depth"][end].as_f64().unwrap());
    let side = |z: f64| number("pixel_pitch_mm") * z * (u - f) / (f * u);
    let text = desk.text("out/surface_ascii.sdf");
    let scale = text.lines().find_map(|line| line.strip_prefix("Xscale      = ")).unwrap().parse::<f64>().unwrap();
    assert!((side(near)..side(far)).contains(&(1e3 * scale)), "{scale}");
    let found = read(&desk, "out", ["-1", &(1e3 * scale).to_string(), "lens"]);
    // Some readers round to 32-bit floats.
    assert!(found["worst_mm"].as_f64().unwrap() < 2e-5, "{found}");
}

#[test]
fn metric_exports_without_units_are_refused_before_the_solve() {
    let desk = Desk::new();
    desk.done(&["simulate", "relief", "-o", "frames", "--frames", "3", "--size", "64x48"]);
    desk.done(&["simulate", "relief", "-o", "pair", "--size", "64x48"]);
    let stage = ["--focus-at", "0,1,2", "--stage"];
    let stack = ["stack", "frames", "-o", "out", "--export"];
    let pair = ["solve", "pair/i1.png", "pair/i2.png", "-o", "out", "--export"];
    for (arguments, parts) in [
        ([&stack[..], &["x3p"]].concat(), &["--export x3p", "--pixel-size"][..]),
        ([&stack[..], &["sdf"], &stage].concat(), &["--export sdf", "--pixel-size"]),
        ([&stack[..], &["xyz", "--pixel-size", "4"]].concat(), &["--export xyz", "--focus-at"]),
        ([&pair[..], &["sdf-ascii", "--pixel-size", "4"]].concat(), &["--export sdf-ascii", "the lens"]),
        ([&stack[..], &["xyz", "--pixel-size", "4", "--z-scale", "3"], &stage].concat(), &["--z-scale"]),
    ] {
        desk.refuses(&arguments, 2, parts);
        assert!(!desk.has("out"));
    }
}
