//! `report.html` of a pair in a real browser: that it opens by itself, moves, turns, and reads as the EXR does.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use assert_cmd::Command;
use parfocal::image_io::read_field;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::browser::Browser;
use crate::page::{assert_holds, assert_reads, assert_surface, canvas, pixels, point, shown};

/// A name as an attacker would choose it.
const ODD_NAME: &str = "<img src=x onerror=alert(1)>&amp;.png";

/// So that there is depth in mm.
const LENS: [&str; 9] =
    ["--focal-length", "25", "--f-number", "8.3", "--pixel-pitch", "0.01304", "--focus", "529,869", "--telecentric"];

/// A folder with the results of one solve, of whose pair one photograph has an odd name.
fn results() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = TempDir::new().unwrap();
        for (name, contrast) in [(ODD_NAME, 90.0), ("far.png", 70.0)] {
            let value = |x: u32, y: u32| {
                let (x, y) = (f64::from(x), f64::from(y));
                let waves = (0.9 * x + 0.2 * y).sin() + (0.3 * x - 0.8 * y).cos() + (0.1 * x * y / 20.0).sin();
                (128.0 + contrast / 3.0 * waves) as u8
            };
            let image = image::RgbImage::from_fn(240, 160, |x, y| image::Rgb([value(x, y), value(x, y), x as u8]));
            image.save(folder.path().join(name)).unwrap();
        }
        solve(folder.path(), &LENS);
        folder
    });
    folder.path()
}

fn solve(folder: &Path, extra: &[&str]) {
    let mut command = Command::cargo_bin("parfocal").unwrap();
    command.env("PARFOCAL_CACHE_DIR", folder.join("cache")).arg("solve");
    command.args([ODD_NAME, "far.png"].map(|name| folder.join(name))).arg("-o").arg(folder.join("out")).args(extra);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn page_of(folder: &Path) -> PathBuf {
    folder.join("out/report.html")
}

fn opened(width: u32) -> Browser {
    let mut browser = Browser::start(width, 900);
    browser.open(&page_of(results()), "window.page");
    browser
}

#[test]
fn it_opens_by_itself_and_shows_odd_names_as_text() {
    let mut browser = opened(1280);
    assert_eq!(browser.evaluate("document.querySelector('h1').textContent"), format!("{ODD_NAME} with far.png"));
    assert_eq!(browser.evaluate("document.querySelectorAll('img').length"), 0);
    assert_eq!(browser.evaluate("page.surface !== null"), true);
    let shown: Value =
        serde_json::from_str(browser.evaluate("document.getElementById('json').textContent").as_str().unwrap())
            .unwrap();
    let written: Value = serde_json::from_slice(&fs::read(results().join("out/report.json")).unwrap()).unwrap();
    assert_eq!(shown["transform"], written["transform"]);
    assert_eq!(shown["levels"].as_array().unwrap().len(), written["levels"].as_array().unwrap().len());
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn nothing_is_wider_than_a_telephone() {
    let mut browser = opened(390);
    let widths = browser.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]");
    assert_eq!(widths[0], widths[1]);
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn the_slider_moves_by_mouse_and_by_itself_and_the_pictures_change() {
    let mut browser = opened(1280);
    let [left, top, width, height] = canvas(&mut browser, "stage");
    let before = pixels(&mut browser, "stage");
    let (middle, y) = (left + width / 2.0, top + height / 2.0);
    browser.mouse(&[[middle, y], [middle + 60.0, y], [middle + 120.0, y]], true);
    assert!(browser.evaluate("page.viewer.split").as_f64().unwrap() > 0.55);
    let moved = pixels(&mut browser, "stage");
    assert!(before != moved);
    browser.evaluate(
        "{ const s = document.getElementById('split'); s.value = 100; s.dispatchEvent(new Event('input')); }",
    );
    assert!(moved != pixels(&mut browser, "stage"));
    let mut seen = vec![pixels(&mut browser, "stage")];
    for mode in ["difference", "fused", "relative_blur", "uncertainty", "confidence", "depth", "depth_deviation"] {
        browser.evaluate(&format!("document.querySelector('[data-mode={mode}]').click()"));
        let shown = pixels(&mut browser, "stage");
        assert!(!seen.contains(&shown), "{mode}");
        seen.push(shown);
    }
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn flickering_shows_one_photograph_after_the_other() {
    let mut browser = opened(1280);
    browser.evaluate("document.getElementById('flicker').click()");
    // Read in the turn in which the picture is the one waited for.
    let [first, second] = [false, true].map(|second| {
        browser.evaluate(&format!(
            "new Promise(r => {{ const f = () => page.viewer.second === {second} \
             ? r(document.getElementById('stage').toDataURL()) : setTimeout(f, 10); f(); }})"
        ))
    });
    assert!(first != second);
}

#[test]
fn the_cursor_reads_what_the_exr_holds() {
    let mut browser = opened(1280);
    let read = |file: &str| read_field(&results().join("out").join(file)).unwrap();
    let (width, _, blur) = read("relative_blur.exr");
    let depth = read("depth_mm.exr").2;
    let fields = [
        ("relative_blur", &blur, 4),
        ("uncertainty", &read("uncertainty.exr").2, 4),
        ("confidence", &read("confidence.exr").2, 5),
        ("depth", &depth, 3),
    ];
    let hole = blur.iter().position(|v| v.is_nan()).expect("a pixel that is not valid") as u32;
    let is_deep = |i: &usize| depth[*i].is_finite();
    let deep = (0..blur.len()).find(is_deep).expect("a pixel with a depth") as u32;
    for (x, y) in [(120, 80), (37, 55), (201, 101), (hole % width, hole / width), (deep % width, deep / width)] {
        point(&mut browser, x, y);
        assert_eq!((shown(&mut browser, "x"), shown(&mut browser, "y")), (x.to_string(), y.to_string()));
        for (key, values, digits) in &fields {
            let value = values[(y * width + x) as usize];
            assert_reads(&shown(&mut browser, key), value, *digits);
        }
    }
    // All of them.
    for (key, values, digits) in fields {
        assert_holds(&mut browser, key, values, digits);
    }
}

#[test]
fn the_surface_is_drawn_and_turns_with_the_mouse_and_the_keys() {
    let mut browser = opened(1280);
    let [left, top, width, height] = canvas(&mut browser, "surface");
    assert_surface(&mut browser);
    let note = browser.evaluate("document.getElementById('surface-note').textContent");
    assert!(note.as_str().unwrap().contains(" mm from far to near"), "{note}");
    let before = pixels(&mut browser, "surface");
    let (x, y) = (left + width / 2.0, top + height / 2.0);
    browser.mouse(&[[x, y], [x + 40.0, y + 10.0], [x + 90.0, y + 20.0]], true);
    let turned = pixels(&mut browser, "surface");
    assert!(before != turned);
    let key = json!({ "type": "keyDown", "key": "ArrowLeft", "code": "ArrowLeft" });
    browser.call("Input.dispatchKeyEvent", key);
    let by_key = pixels(&mut browser, "surface");
    assert!(turned != by_key);
    browser.evaluate("document.querySelector('[data-skin=depth]').click()");
    assert!(by_key != pixels(&mut browser, "surface"));
    browser.evaluate("document.getElementById('reset').click()");
    browser.evaluate("document.querySelector('[data-skin=fused]').click()");
    assert!(before == pixels(&mut browser, "surface"), "reset is as at first");
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn without_html_none_is_left_over() {
    let folder = TempDir::new().unwrap();
    for name in [ODD_NAME, "far.png"] {
        fs::copy(results().join(name), folder.path().join(name)).unwrap();
    }
    solve(folder.path(), &[]);
    assert!(page_of(folder.path()).is_file());
    solve(folder.path(), &["--no-html"]);
    assert!(!page_of(folder.path()).exists() && folder.path().join("out/report.json").is_file());
}
