//! `report.html` in a real browser: that it opens by itself, moves, turns, and reads as the EXR does.

#[path = "common/browser.rs"]
mod browser;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use assert_cmd::Command;
use parfocal::image_io::read_field;
use serde_json::{Value, json};
use tempfile::TempDir;

use browser::Browser;

/// A name as an attacker would choose it.
const ODD_NAME: &str = "<img src=x onerror=alert(1)>&amp;.png";

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
        solve(folder.path(), &[]);
        folder
    });
    folder.path()
}

fn solve(folder: &Path, extra: &[&str]) {
    let mut command = Command::cargo_bin("parfocal").unwrap();
    command.env("PARFOCAL_CACHE_DIR", folder.join("cache")).arg("solve");
    command.args([ODD_NAME, "far.png"].map(|name| folder.join(name))).arg("-o").arg(folder.join("out")).args(extra);
    if let Ok(device) = std::env::var("PARFOCAL_DEVICE") {
        command.args(["--device", &device]);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn page(folder: &Path) -> PathBuf {
    folder.join("out/report.html")
}

fn opened(width: u32) -> Browser {
    let mut browser = Browser::start(width, 900);
    browser.open(&page(results()), "window.page");
    browser
}

/// Puts a canvas in the middle of the window and says where it then is: left, top, width, height.
fn canvas(browser: &mut Browser, id: &str) -> [f64; 4] {
    let place = format!(
        "(() => {{ const c = document.getElementById('{id}'); c.scrollIntoView({{ block: 'center', behavior: 'instant' }});
           const b = c.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; }})()"
    );
    serde_json::from_value(browser.evaluate(&place)).unwrap()
}

/// What a canvas shows.
fn pixels(browser: &mut Browser, id: &str) -> String {
    browser.evaluate(&format!("document.getElementById('{id}').toDataURL()")).as_str().unwrap().to_string()
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
    for mode in ["difference", "fused", "relative_blur", "confidence"] {
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
    let (width, _, blur) = read_field(&results().join("out/relative_blur.exr")).unwrap();
    let (_, _, confidence) = read_field(&results().join("out/confidence.exr")).unwrap();
    let hole = blur.iter().position(|v| v.is_nan()).expect("a pixel that is not valid") as u32;
    assert_eq!(browser.evaluate("page.viewer.values.relative_blur.length"), blur.len());
    for (x, y) in [(120, 80), (37, 55), (201, 101), (hole % width, hole / width)] {
        let [left, top, ..] = canvas(&mut browser, "stage");
        let at = browser.evaluate(&format!(
            "[page.viewer.left + page.viewer.scale * ({x} + .5), page.viewer.top + page.viewer.scale * ({y} + .5)]"
        ));
        browser.mouse(&[[left + at[0].as_f64().unwrap(), top + at[1].as_f64().unwrap()]], false);
        let shown = browser.evaluate(
            "['x', 'y', 'relative_blur', 'confidence'].map(n => document.getElementById('at-' + n).textContent)",
        );
        assert_eq!((&shown[0], &shown[1]), (&json!(x.to_string()), &json!(y.to_string())));
        let i = (y * width + x) as usize;
        if blur[i].is_nan() {
            assert_eq!(shown[2], "not valid");
        } else {
            let read: f64 = shown[2].as_str().unwrap().replace('−', "-").parse().unwrap();
            assert!((read - f64::from(blur[i])).abs() <= 0.5001e-4, "{read} {}", blur[i]);
        }
        let read: f64 = shown[3].as_str().unwrap().parse().unwrap();
        assert!((read - f64::from(confidence[i])).abs() <= 1e-3 * f64::from(confidence[i]), "{read} {}", confidence[i]);
    }
    // All of them, bit by bit.
    let bits = "{ const b = new Uint32Array(page.viewer.values.relative_blur.buffer); let s = 0; \
                b.forEach((v, i) => { s = (Math.imul(s, 31) + (v ^ i)) >>> 0 }); s }";
    let sum = blur.iter().zip(0u32..).fold(0u32, |s, (v, i)| s.wrapping_mul(31).wrapping_add(v.to_bits() ^ i));
    assert_eq!(browser.evaluate(bits), sum);
}

#[test]
fn the_surface_is_drawn_and_turns_with_the_mouse_and_the_keys() {
    let mut browser = opened(1280);
    let [left, top, width, height] = canvas(&mut browser, "surface");
    let drawn = "(() => { const gl = page.surface.renderer.getContext(); \
                 const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight]; const p = new Uint8Array(4 * w * h); \
                 gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p); \
                 let n = 0; const colors = new Set(); \
                 for (let i = 0; i < p.length; i += 4) if (p[i + 3]) { n++; colors.add(p[i] << 16 | p[i + 1] << 8 | p[i + 2]) } \
                 return [n / w / h, colors.size]; })()";
    let found = browser.evaluate(drawn);
    assert!(found[0].as_f64().unwrap() > 0.1 && found[1].as_f64().unwrap() > 100.0, "{found}");
    let before = pixels(&mut browser, "surface");
    let (x, y) = (left + width / 2.0, top + height / 2.0);
    browser.mouse(&[[x, y], [x + 40.0, y + 10.0], [x + 90.0, y + 20.0]], true);
    let turned = pixels(&mut browser, "surface");
    assert!(before != turned);
    let key = json!({ "type": "keyDown", "key": "ArrowLeft", "code": "ArrowLeft" });
    browser.call("Input.dispatchKeyEvent", key);
    let by_key = pixels(&mut browser, "surface");
    assert!(turned != by_key);
    browser.evaluate("document.querySelector('[data-skin=relative_blur]').click()");
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
    assert!(page(folder.path()).is_file());
    solve(folder.path(), &["--no-html"]);
    assert!(!page(folder.path()).exists() && folder.path().join("out/report.json").is_file());
}
