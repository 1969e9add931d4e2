//! Helpers for the tests of `report.html`.

use serde_json::Value;

use crate::browser::Browser;

/// Scrolls a canvas to the middle of the window. Returns its left, top, width and height in px.
pub fn canvas(browser: &mut Browser, id: &str) -> [f64; 4] {
    let place = format!(
        "(() => {{ const c = document.getElementById('{id}'); c.scrollIntoView({{ block: 'center', behavior: 'instant' }});
           const b = c.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; }})()"
    );
    serde_json::from_value(browser.evaluate(&place)).unwrap()
}

/// The content of a canvas as a data URL.
pub fn pixels(browser: &mut Browser, id: &str) -> String {
    browser.evaluate(&format!("document.getElementById('{id}').toDataURL()")).as_str().unwrap().to_string()
}

/// Moves the mouse to a pixel of the picture.
pub fn point(browser: &mut Browser, x: u32, y: u32) {
    let [left, top, ..] = canvas(browser, "stage");
    let at = browser.evaluate(&format!(
        "[page.viewer.left + page.viewer.scale * ({x} + .5), page.viewer.top + page.viewer.scale * ({y} + .5)]"
    ));
    browser.mouse(&[[left + at[0].as_f64().unwrap(), top + at[1].as_f64().unwrap()]], false);
}

/// The text of the read-out for a field.
pub fn shown(browser: &mut Browser, key: &str) -> String {
    browser.evaluate(&format!("document.getElementById('at-{key}').textContent")).as_str().unwrap().to_string()
}

/// Selects the picture or map with this mode.
pub fn choose(browser: &mut Browser, mode: &str) {
    browser.evaluate(&format!("document.querySelector('[data-mode={mode}]').click()"));
}

/// Asserts that a number of the read-out differs from `value` by at most `allowed`. NaN must read "not valid".
#[track_caller]
pub fn assert_reads(text: &str, value: f32, allowed: f64) {
    if value.is_nan() {
        return assert_eq!(text, "not valid");
    }
    let read: f64 =
        text.replace('−', "-").parse().unwrap_or_else(|_| panic!("{text} is not a number, expected {value}"));
    assert!((read - f64::from(value)).abs() <= allowed, "{read}, expected {value} within {allowed}");
}

/// Asserts that the page holds every value of a field, each within `allowed` of its index.
#[track_caller]
pub fn assert_holds(browser: &mut Browser, key: &str, values: &[f32], allowed: impl Fn(usize) -> f64) {
    let found = browser.evaluate(&format!("[...page.fields.{key}.values].map(v => Number.isFinite(v) ? v : null)"));
    let found = found.as_array().unwrap();
    assert_eq!(found.len(), values.len(), "{key}");
    for (i, (read, value)) in found.iter().zip(values).enumerate() {
        assert_eq!(read.is_null(), !value.is_finite(), "{key} at {i}: {read}, expected {value}");
        let Some(read) = read.as_f64() else { continue };
        let off = (read - f64::from(*value)).abs();
        assert!(off <= allowed(i), "{key} at {i}: {read}, expected {value} within {}", allowed(i));
    }
}

/// Returns half a step of the last digit that the page stores for a field.
///
/// Asserts that the step is at most a fifth of the median deviation.
#[track_caller]
pub fn half_step(browser: &mut Browser, key: &str, deviation: &[f32]) -> f64 {
    let digits = browser.evaluate(&format!("page.fields.{key}.digits")).as_i64().unwrap() as i32;
    let mut known: Vec<f32> = deviation.iter().copied().filter(|s| s.is_finite()).collect();
    known.sort_by(f32::total_cmp);
    let (step, typical) = (10f64.powi(-digits), f64::from(known[known.len() / 2]));
    assert!(step <= (typical / 5.0).max(1e-4) && digits >= 1, "{key}: {digits} digits for ± {typical}");
    // The margin covers rounding to the page's 32-bit floats.
    0.51 * step
}

/// Asserts that the surface covers over 10 % of its canvas in over 100 colours.
#[track_caller]
pub fn assert_surface(browser: &mut Browser) {
    let drawn = "(() => { const gl = page.surface.renderer.getContext(); \
                 const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight]; const p = new Uint8Array(4 * w * h); \
                 gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p); \
                 let n = 0; const colors = new Set(); \
                 for (let i = 0; i < p.length; i += 4) if (p[i + 3]) { n++; colors.add(p[i] << 16 | p[i + 1] << 8 | p[i + 2]) } \
                 return [n / w / h, colors.size]; })()";
    let found: Value = browser.evaluate(drawn);
    assert!(found[0].as_f64().unwrap() > 0.1 && found[1].as_f64().unwrap() > 100.0, "{found}");
}
