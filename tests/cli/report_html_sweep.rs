//! `report.html` of a focus sweep in a real browser.

use std::fs;
use std::sync::OnceLock;

use parfocal::image_io::read_field;

use crate::browser::Browser;
use crate::desk::Desk;
use crate::page::{assert_holds, assert_reads, assert_surface, choose, half_step, pixels, point, shown};
use crate::synthetic::blurred_waves;

const FRAMES: [&str; 4] = ["a & b.png", "<i>2.png", "3.png", "4.png"];

/// A folder with the results of a sweep over a slope. Its focus rises from 0.5 at the left to 2.5 at the right.
fn results() -> &'static Desk {
    static FOLDER: OnceLock<Desk> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let desk = Desk::new();
        for (n, name) in FRAMES.iter().enumerate() {
            let value = |x: u32, y: u32| {
                let focus = 0.5 + 2.0 * f64::from(x) / 192.0;
                (255.0 * blurred_waves(x, y, 2.0 * (n as f64 - focus).powi(2) + 0.3)).round() as u8
            };
            image::GrayImage::from_fn(192, 128, |x, y| image::Luma([value(x, y)])).save(desk.path(name)).unwrap();
        }
        // Focus settings from 4 to 4.3 1/m.
        stack(&desk, &["--focus-at", "250,243.9024,238.0952,232.5581"]);
        desk
    })
}

fn stack(desk: &Desk, extra: &[&str]) {
    desk.done(&[&["stack"], &FRAMES[..], &["-o", "out"], extra].concat());
}

fn opened() -> Browser {
    let mut browser = Browser::start(1280, 900);
    browser.open(&results().path("out/report.html"), "window.page");
    browser
}

#[test]
fn the_page_is_self_contained_and_shows_the_parts_of_a_sweep() {
    let mut browser = opened();
    assert_eq!(browser.evaluate("document.querySelector('h1').textContent"), "a & b.png to 4.png");
    assert_eq!(browser.evaluate("document.querySelectorAll('#frames tr').length"), 1 + FRAMES.len());
    let hidden = "[...document.querySelectorAll('[data-kind]')].map(e => e.dataset.kind + (e.hidden ? ' hidden' : ''))";
    assert_eq!(browser.evaluate(&format!("{hidden}.sort().join()")), "pair hidden,pair hidden,sweep,sweep");
    assert_surface(&mut browser);
    let note = browser.evaluate("document.getElementById('surface-note').textContent");
    assert!(note.as_str().unwrap().contains(" mm from far to near"), "{note}");
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn frames_can_be_browsed_and_any_two_pictures_compared() {
    let mut browser = opened();
    choose(&mut browser, "compare");
    let mut seen = vec![pixels(&mut browser, "stage")];
    let mut look = |browser: &mut Browser, what: &str| {
        let picture = pixels(browser, "stage");
        assert!(!seen.contains(&picture), "{what}");
        seen.push(picture);
    };
    browser.evaluate("page.viewer.setSplit(0.2)");
    look(&mut browser, "slider");
    let left = "{ const s = document.getElementById('left'); s.value = 0; \
                s.dispatchEvent(new Event('change', { bubbles: true })) }";
    browser.evaluate(left);
    look(&mut browser, "another picture");
    choose(&mut browser, "frames");
    for (n, name) in FRAMES.iter().enumerate() {
        let to = "{ const s = document.getElementById('frame'); s.value = N; s.dispatchEvent(new Event('input')) }";
        browser.evaluate(&to.replace('N', &n.to_string()));
        look(&mut browser, "frame");
        let tag = browser.evaluate("document.getElementById('tag-1').textContent");
        assert!(tag.as_str().unwrap().starts_with(name), "{tag}");
    }
    for mode in ["difference", "fused"] {
        choose(&mut browser, mode);
        look(&mut browser, mode);
    }
    let mut maps = Vec::new();
    for mode in ["focus", "uncertainty", "depth", "depth_deviation"] {
        choose(&mut browser, mode);
        let map = pixels(&mut browser, "map");
        assert!(!maps.contains(&map), "{mode}");
        maps.push(map);
    }
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn the_focus_curve_shows_the_frames_and_marks_the_sharpest() {
    let mut browser = opened();
    point(&mut browser, 40, 100);
    let note = browser.evaluate("document.getElementById('focus-note').textContent");
    let note = note.as_str().unwrap();
    assert!(note.starts_with("At 40, 100: ") && note.contains("is the sharpest. In focus at"), "{note}");
    assert_eq!(browser.evaluate("document.querySelectorAll('#focus-curve circle').length"), FRAMES.len());
    assert_eq!(browser.evaluate("document.querySelectorAll('#focus-curve .wins, #focus-curve .model').length"), 2);
    // One scene as a whole picture, as of the reference, and reduced to a quarter, as of the other frames of a long
    // sweep.
    let ratio = "(() => {
        const whole = canvasOf(grid.width, grid.height), reduced = canvasOf(grid.width / 4, grid.height / 4);
        const context = whole.getContext('2d');
        for (let i = 0; i < grid.width * grid.height / 64; i++) {
            context.fillStyle = `hsl(0 0% ${(i * 37) % 100}%)`;
            context.fillRect(8 * (i % (grid.width / 8)), 8 * Math.floor(i / (grid.width / 8)), 8, 8);
        }
        const small = Object.assign(reduced.getContext('2d'), { imageSmoothingQuality: 'high' });
        small.drawImage(whole, 0, 0, reduced.width, reduced.height);
        const curve = new FocusCurve([whole, reduced]);
        return curve.sharpness(whole, 60, 60) / curve.sharpness(reduced, 60, 60);
    })()";
    let ratio = browser.evaluate(ratio).as_f64().unwrap();
    assert!((0.5..2.0).contains(&ratio), "{ratio}");
    assert_eq!(browser.complaints(), Vec::<String>::new());
}

#[test]
fn values_under_the_cursor_match_the_exr() {
    let mut browser = opened();
    let read = |file: &str| read_field(&results().path("out").join(file)).unwrap();
    let ((width, _, focus), sigma, depth) = (read("focus.exr"), read("uncertainty.exr").2, read("depth_mm.exr").2);
    let step = half_step(&mut browser, "focus", &sigma);
    for (x, y) in [(96, 64), (40, 100), (3, 2)] {
        point(&mut browser, x, y);
        let i = (y * width + x) as usize;
        assert_reads(&shown(&mut browser, "focus"), focus[i], step);
        assert_reads(&shown(&mut browser, "uncertainty"), sigma[i], 0.011 * f64::from(sigma[i]));
    }
    assert_holds(&mut browser, "focus", &focus, |_| step);
    assert_holds(&mut browser, "uncertainty", &sigma, |i| 0.0051 * f64::from(sigma[i]));
    let digits = browser.evaluate("page.fields.depth.digits").as_i64().unwrap() as i32;
    assert_holds(&mut browser, "depth", &depth, |_| 0.51 * 10f64.powi(-digits));
}

#[test]
fn no_html_removes_an_earlier_page() {
    let desk = Desk::new();
    for name in FRAMES {
        fs::copy(results().path(name), desk.path(name)).unwrap();
    }
    stack(&desk, &[]);
    assert!(desk.has("out/report.html"));
    stack(&desk, &["--no-html"]);
    assert!(!desk.has("out/report.html") && desk.has("out/report.json"));
}
