//! `report.html` of a pair in a real browser: self-contained, interactive, with the values of the EXR files.

use std::fs;
use std::sync::OnceLock;

use parfocal::image_io::read_field;
use serde_json::{Value, json};

use crate::browser::Browser;
use crate::desk::Desk;
use crate::page::{assert_holds, assert_reads, assert_surface, canvas, choose, half_step, pixels, point, shown};
use crate::synthetic::{CUP_LENS, waves};

/// A file name that contains HTML, as an attacker would choose it.
const ODD_NAME: &str = "<img src=x onerror=alert(1)>&amp;.png";

/// The folder of [`solved`] that the tests share.
fn results() -> &'static Desk {
    static FOLDER: OnceLock<Desk> = OnceLock::new();
    FOLDER.get_or_init(solved)
}

/// A folder with the results of one solve. One photograph is named `ODD_NAME`.
fn solved() -> Desk {
    let desk = Desk::new();
    for (name, contrast) in [(ODD_NAME, 90.0), ("far.png", 70.0)] {
        let value = |x: u32, y: u32| (128.0 + contrast / 3.0 * waves(x, y)) as u8;
        let image = image::RgbImage::from_fn(240, 160, |x, y| image::Rgb([value(x, y), value(x, y), x as u8]));
        image.save(desk.path(name)).unwrap();
    }
    solve(&desk, &CUP_LENS);
    desk
}

fn solve(desk: &Desk, extra: &[&str]) {
    desk.done(&[&["solve", ODD_NAME, "far.png", "-o", "out"], extra].concat());
}

fn opened(width: u32) -> Browser {
    opened_of(results(), width)
}

fn opened_of(desk: &Desk, width: u32) -> Browser {
    let mut browser = Browser::start(width, 900);
    browser.open(&desk.path("out/report.html"), "window.page");
    browser
}

#[test]
fn the_page_is_self_contained_and_escapes_file_names() {
    let mut browser = opened(1280);
    assert_eq!(browser.evaluate("document.querySelector('h1').textContent"), format!("{ODD_NAME} with far.png"));
    assert_eq!(browser.evaluate("document.querySelectorAll('img').length"), 0);
    assert_eq!(browser.evaluate("page.surface !== null"), true);
    let shown: Value =
        serde_json::from_str(browser.evaluate("document.getElementById('json').textContent").as_str().unwrap())
            .unwrap();
    let written = results().report("out");
    assert_eq!(shown["frames"][1]["transform"], written["frames"][1]["transform"]);
    assert_eq!(shown["levels"].as_array().unwrap().len(), written["levels"].as_array().unwrap().len());
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn the_page_fits_a_phone_screen() {
    let mut browser = opened(390);
    let widths = browser.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]");
    assert_eq!(widths[0], widths[1]);
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn the_slider_moves_and_every_mode_shows_another_picture() {
    let mut browser = opened(1280);
    let mut seen = vec![pixels(&mut browser, "stage")];
    choose(&mut browser, "compare");
    let [left, top, width, height] = canvas(&mut browser, "stage");
    let before = pixels(&mut browser, "stage");
    let (middle, y) = (left + width / 2.0, top + height / 2.0);
    browser.mouse(&[[middle, y], [middle + 40.0, y], [middle + 80.0, y]], true);
    assert!(browser.evaluate("page.viewer.split").as_f64().unwrap() > 0.55);
    let moved = pixels(&mut browser, "stage");
    assert!(before != moved);
    browser.evaluate(
        "{ const s = document.getElementById('split'); s.value = 100; s.dispatchEvent(new Event('input')); }",
    );
    assert!(moved != pixels(&mut browser, "stage"));
    seen.push(pixels(&mut browser, "stage"));
    choose(&mut browser, "difference");
    assert!(!seen.contains(&pixels(&mut browser, "stage")));
    let mut seen = Vec::new();
    for mode in ["depth", "relative_blur", "uncertainty", "confidence", "depth_deviation", "residual"] {
        choose(&mut browser, mode);
        let shown = pixels(&mut browser, "map");
        assert!(!seen.contains(&shown), "{mode}");
        seen.push(shown);
    }
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn flicker_alternates_the_photographs() {
    let mut browser = opened(1280);
    choose(&mut browser, "compare");
    browser.evaluate("document.getElementById('flicker').click()");
    // The canvas is read in the same event loop turn in which the expected photograph is shown.
    let [first, second] = [false, true].map(|second| {
        browser.evaluate(&format!(
            "new Promise(r => {{ const f = () => page.viewer.second === {second} \
             ? r(document.getElementById('stage').toDataURL()) : setTimeout(f, 10); f(); }})"
        ))
    });
    assert!(first != second);
}

#[test]
fn values_under_the_cursor_match_the_exr() {
    let mut browser = opened(1280);
    let read = |file: &str| read_field(&results().path("out").join(file)).unwrap();
    let (width, _, blur) = read("relative_blur.exr");
    let (sigma, confidence, depth) = (read("uncertainty.exr").2, read("confidence.exr").2, read("depth_mm.exr").2);
    let step = half_step(&mut browser, "relative_blur", &sigma);
    // The page computes depth from rounded V. Where depth is steep in V, the allowed error is large.
    let slope = |i: usize| {
        let near = (1..blur.len()).map(|k| (i + k) % blur.len());
        let other = near.take(9).find(|&k| depth[k].is_finite() && (blur[k] - blur[i]).abs() > 1e-3);
        other.map_or(1e3, |k| f64::from(((depth[k] - depth[i]) / (blur[k] - blur[i])).abs()))
    };
    // The search skips the first 20 rows, because the picture has rounded corners.
    let hole = (20 * width as usize..blur.len()).find(|&i| blur[i].is_nan()).expect("a pixel that is not valid") as u32;
    let is_deep = |i: &usize| depth[*i].is_finite();
    let deep = (0..blur.len()).find(is_deep).expect("a pixel with a depth") as u32;
    for (x, y) in [(120, 80), (37, 55), (201, 101), (hole % width, hole / width), (deep % width, deep / width)] {
        point(&mut browser, x, y);
        assert_eq!((shown(&mut browser, "x"), shown(&mut browser, "y")), (x.to_string(), y.to_string()));
        let i = (y * width + x) as usize;
        assert_reads(&shown(&mut browser, "relative_blur"), blur[i], step);
        assert_reads(&shown(&mut browser, "uncertainty"), sigma[i], 0.011 * f64::from(sigma[i]));
        let tip = browser.evaluate("document.getElementById('map-tip').textContent");
        // Depth towards infinity has no standard deviation, and none is shown without one.
        let is_known = shown(&mut browser, "depth_deviation").contains(|c: char| c.is_ascii_digit());
        assert!(is_known <= depth[i].is_finite());
        assert!(tip.as_str().unwrap().contains(if is_known { " ± " } else { "not measured" }), "{tip}");
    }
    // Every pixel.
    assert_holds(&mut browser, "relative_blur", &blur, |_| step);
    assert_holds(&mut browser, "uncertainty", &sigma, |i| 0.0051 * f64::from(sigma[i]));
    assert_holds(&mut browser, "confidence", &confidence, |i| 0.012 * f64::from(confidence[i]) + 1e-6);
    let known = browser.evaluate("[...page.fields.depth.values].map(v => Number.isFinite(v) ? v : null)");
    let known: Vec<Option<f64>> = serde_json::from_value(known).unwrap();
    // At the ends of the depth range rounding decides whether a pixel has a depth.
    let differ = known.iter().zip(&depth).filter(|(a, b)| a.is_some() != b.is_finite()).count();
    assert!(differ * 100 < depth.iter().filter(|z| z.is_finite()).count(), "{differ}");
    for (i, (read, z)) in known.iter().zip(&depth).enumerate() {
        let Some(read) = read.filter(|_| z.is_finite()) else { continue };
        let off = (read - f64::from(*z)).abs();
        assert!(off <= 3.0 * step * slope(i) + 1e-3, "{read}, expected {z} at {i}");
    }
}

#[test]
fn the_summary_is_one_sentence_and_three_pictures() {
    let mut browser = opened(1400);
    let sentence = browser.evaluate("document.getElementById('sentence').textContent");
    let sentence = sentence.as_str().unwrap();
    assert!(sentence.starts_with("Depth ") && sentence.contains("\u{a0}mm, typically ±"), "{sentence}");
    assert!(sentence.ends_with("measured; near is I1 (by the lens)."), "{sentence}");
    let within = "['sentence', 'stage', 'map', 'scale', 'surface', 'figures'].filter(id => \
                  document.getElementById(id).getBoundingClientRect().bottom > innerHeight).join()";
    assert_eq!(browser.evaluate(within), "");
    let [photo, map, surface] = ["stage", "map", "surface"].map(|id| canvas(&mut browser, id));
    assert!(photo[0] < map[0] && map[0] < surface[0] && photo[1] == map[1] && map[1] == surface[1]);
    // Show one picture alone, then all three again.
    browser.evaluate("document.querySelector('[data-enlarge=map]').click()");
    assert!(canvas(&mut browser, "map")[2] > 2.0 * map[2]);
    browser.evaluate("document.querySelector('[data-enlarge=map]').click()");
    // A lower limit of σ hatches more pixels and reduces the measured fraction.
    let share = |browser: &mut Browser| {
        let text = browser.evaluate("document.getElementById('sigma-value').textContent");
        let text = text.as_str().unwrap().to_string();
        text.split("· ").nth(1).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap()
    };
    let (whole, before) = (share(&mut browser), pixels(&mut browser, "map"));
    browser
        .evaluate("{ const s = document.getElementById('sigma'); s.value = 300; s.dispatchEvent(new Event('input')) }");
    assert!(share(&mut browser) < whole && before != pixels(&mut browser, "map"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn measurements_on_the_page_match_the_measure_command() {
    // `measure` writes page and report again, while other tests read them.
    let desk = solved();
    let mut browser = opened_of(&desk, 1280);
    browser.evaluate("document.querySelector('[data-tool=step]').click()");
    let at = |browser: &mut Browser, [x, y]: [u32; 2]| {
        let [left, top, ..] = canvas(browser, "map");
        let place = browser.evaluate(&format!(
            "(({{ left, top, scale }}) => [left + scale * ({x} + .5), top + scale * ({y} + .5)])(page.map)"
        ));
        [left + place[0].as_f64().unwrap(), top + place[1].as_f64().unwrap()]
    };
    for [from, to] in [[[30, 40], [69, 99]], [[150, 40], [199, 99]]] {
        let (from, to) = (at(&mut browser, from), at(&mut browser, to));
        browser.mouse(&[from, [(from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0], to], true);
    }
    // Draw a profile line with the keyboard.
    browser.evaluate(
        "{ document.querySelector('[data-tool=line]').click(); page.map.canvas.focus(); page.view.point(20, 80) }",
    );
    for key in ["Enter", "ArrowRight", "ArrowRight", "Enter"] {
        let modifiers = if key == "ArrowRight" { 8 } else { 0 };
        browser.call("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": key, "modifiers": modifiers }));
    }
    let command = browser.evaluate("document.getElementById('command').textContent");
    let command = command.as_str().unwrap().to_string();
    let out = desk.path("out").canonicalize().unwrap();
    let expected = format!("parfocal measure {} --step 30,40,40,60 150,40,50,60 --profile 20,80,40,80", out.display());
    assert_eq!(command, expected);
    let text = browser.evaluate("document.getElementById('measured-text').textContent");
    let text = text.as_str().unwrap().replace('−', "-");

    let found = desk.printed(&command.split(' ').skip(1).collect::<Vec<_>>());
    let blur = &found["steps"][0]["difference"];
    let numbers: Vec<f64> = text.split([' ', ':', ',']).filter_map(|word| word.parse().ok()).collect();
    let [value, error] = ["value", "standard_error"].map(|key| blur[key].as_f64().unwrap());
    let close = |number: &f64| (number - value).abs() < 0.2 * error + 0.05;
    assert!(text.starts_with("Step from 1 to 2") && numbers.iter().any(close), "{text}, {blur}");
    assert!(browser.evaluate("document.querySelectorAll('#profile polyline').length") == 1);

    // The link restores the same view.
    browser.evaluate("{ page.view.zoomBy(2); document.querySelector('[data-mode=uncertainty]').click() }");
    browser.evaluate("{ window.prompt = () => {}; document.getElementById('copy-link').click() }");
    let (hash, before) = (browser.evaluate("location.hash"), pixels(&mut browser, "map"));
    let mut other = opened_of(&desk, 1280);
    other.evaluate(&format!("{{ location.hash = {hash}; location.reload() }}"));
    other.wait("window.page && page.map.mode === 'uncertainty'");
    assert!(pixels(&mut other, "map") == before, "{hash}");
    assert_eq!(other.evaluate("document.getElementById('command').textContent"), command);
    assert_eq!(other.complaints(), Vec::<String>::new());
}

#[test]
fn controls_have_names_and_are_large_enough_for_touch() {
    let mut browser = opened(390);
    let nameless = "[...document.querySelectorAll('button, select, input, canvas[role], summary')].filter(e => !(e.ariaLabel \
                    || e.textContent.trim() || e.closest('label')?.textContent.trim())).map(e => e.outerHTML).join()";
    assert_eq!(browser.evaluate(nameless), "");
    let small = "[...document.querySelectorAll('button, select, input, summary')].filter(e => e.offsetParent \
                 && Math.min(e.offsetWidth, e.offsetHeight) < 44).map(e => e.outerHTML).join()";
    assert_eq!(browser.evaluate(small), "");
    let twice = "(ids => ids.filter((id, i) => ids.indexOf(id) !== i).join())([...document.querySelectorAll('[id]')].map(e => e.id))";
    assert_eq!(browser.evaluate(twice), "");
    // Scrolling by touch must work on top of a picture.
    let held = "[...document.querySelectorAll('canvas[role]')].filter(c => getComputedStyle(c).touchAction !== 'pan-y').map(c => c.id).join()";
    assert_eq!(browser.evaluate(held), "");
}

#[test]
fn the_surface_is_drawn_and_turns_by_mouse_and_keys() {
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
    assert!(before == pixels(&mut browser, "surface"), "reset must restore the first view");
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn no_html_removes_an_earlier_page() {
    let desk = Desk::new();
    for name in [ODD_NAME, "far.png"] {
        fs::copy(results().path(name), desk.path(name)).unwrap();
    }
    solve(&desk, &[]);
    assert!(desk.has("out/report.html"));
    solve(&desk, &["--no-html"]);
    assert!(!desk.has("out/report.html") && desk.has("out/report.json"));
}
