//! What the tests of `report.html` ask of a page.

use serde_json::Value;

use crate::browser::Browser;

/// Puts a canvas in the middle of the window and says where it then is: left, top, width, height.
pub fn canvas(browser: &mut Browser, id: &str) -> [f64; 4] {
    let place = format!(
        "(() => {{ const c = document.getElementById('{id}'); c.scrollIntoView({{ block: 'center', behavior: 'instant' }});
           const b = c.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; }})()"
    );
    serde_json::from_value(browser.evaluate(&place)).unwrap()
}

/// What a canvas shows.
pub fn pixels(browser: &mut Browser, id: &str) -> String {
    browser.evaluate(&format!("document.getElementById('{id}').toDataURL()")).as_str().unwrap().to_string()
}

/// Points the mouse at a pixel of the pictures.
pub fn point(browser: &mut Browser, x: u32, y: u32) {
    let [left, top, ..] = canvas(browser, "stage");
    let at = browser.evaluate(&format!(
        "[page.viewer.left + page.viewer.scale * ({x} + .5), page.viewer.top + page.viewer.scale * ({y} + .5)]"
    ));
    browser.mouse(&[[left + at[0].as_f64().unwrap(), top + at[1].as_f64().unwrap()]], false);
}

/// What the read-out shows of a field.
pub fn shown(browser: &mut Browser, key: &str) -> String {
    browser.evaluate(&format!("document.getElementById('at-{key}').textContent")).as_str().unwrap().to_string()
}

/// That a number of the read-out is a value to so many digits after the point.
#[track_caller]
pub fn assert_reads(text: &str, value: f32, digits: i32) {
    if value.is_nan() {
        return assert_eq!(text, "not valid");
    }
    assert_eq!(text.split_once('.').map(|(_, after)| after.len()), Some(digits as usize), "{text}");
    let read: f64 = text.replace('−', "-").parse().unwrap();
    assert!((read - f64::from(value)).abs() <= 0.5001 * 10f64.powi(-digits), "{read} {value}");
}

/// That the page holds every value of a field to so many digits.
#[track_caller]
pub fn assert_holds(browser: &mut Browser, key: &str, values: &[f32], digits: i32) {
    let unit = 10f64.powi(digits);
    let expected = values.iter().zip(0u32..).fold(0u32, |sum, (v, i)| {
        let integer = if v.is_nan() { 7 } else { (f64::from(*v) * unit).round() as i64 as u32 };
        sum.wrapping_mul(31).wrapping_add(integer ^ i)
    });
    let found = browser.evaluate(&format!(
        "{{ let s = 0; page.fields.{key}.values.forEach((v, i) => {{ \
         s = (Math.imul(s, 31) + ((Number.isNaN(v) ? 7 : Math.round(v * {unit})) ^ i)) >>> 0 }}); s }}"
    ));
    assert_eq!(found, expected, "{key}");
}

/// That the surface covers part of its canvas, in many colours.
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
