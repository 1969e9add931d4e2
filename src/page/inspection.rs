//! The picture of an inspected part with its deviations from the golden part.

use image::{Rgb, RgbImage};

use super::figure::{Align, Area, BLACK, Canvas, Color, GRAY, WHITE, text_width};
use crate::base::Frame;
use crate::files::image_io::preview;
use crate::metric::inspect::{Deviation, Inspection};

/// Colours of regions nearer to the camera than the golden part, and further away.
const NEARER: Color = [214, 39, 40];
const FURTHER: Color = [31, 119, 180];
/// Size of text as a fraction of the longer side, and the least size of text, px.
const TEXT: f32 = 0.02;
const LEAST_TEXT: f32 = 11.0;
/// Greatest number of regions with a number. More numbers would hide the picture.
const MOST_NUMBERS: usize = 99;
/// Least size of a region that has its number inside, in text sizes.
const ROOM: f32 = 3.0;
/// Period of the stripes over pixels that are not judged, px.
const STRIPES: u32 = 6;

/// Draws the part on the golden part's pixels: regions are filled, outlined and numbered, and pixels that are not
/// judged are striped. A key and the verdict are below.
pub fn draw(part: &Frame, inspection: &Inspection, unit: &str, verdict: &str) -> RgbImage {
    let picture = marked(&preview(part), inspection);
    let (width, height) = picture.dimensions();
    let size = (TEXT * width.max(height) as f32).max(LEAST_TEXT);
    let line = 1.5 * size;
    let unjudged = inspection.unjudged_share() + inspection.uncertain_share();
    let keys = [
        (Some(NEARER), format!("nearer to the camera: {}", extreme(inspection, unit, NEARER))),
        (Some(FURTHER), format!("further away: {}", extreme(inspection, unit, FURTHER))),
        (Some(GRAY), format!("striped: not judged, {:.1} %", 100.0 * unjudged)),
        (None, verdict.to_string()),
    ];
    let widest = keys.iter().map(|(_, words)| text_width(words, size)).fold(0.0, f32::max);
    let below = line * (keys.len() as f32 + 0.5);
    let mut canvas = Canvas::new(width.max((widest + 3.0 * size).ceil() as u32), height + below.ceil() as u32);
    canvas.image(&picture, (0, 0));
    for (n, region) in inspection.regions.iter().take(MOST_NUMBERS).enumerate() {
        number(&mut canvas, n + 1, region, size, width as f32);
    }
    for (n, (color, words)) in keys.iter().enumerate() {
        let y = height as f32 + (n + 1) as f32 * line;
        if let Some(color) = color {
            canvas.fill(Area { x: 0.5 * size, y: y - 0.8 * size, width: size, height: size }, *color);
        }
        let x = if color.is_some() { 2.0 } else { 0.5 } * size;
        canvas.text(words, (x, y), size, Align::Left, BLACK);
    }
    canvas.into_image()
}

/// Writes the number of a region at its centroid, or next to a small region, on white.
fn number(canvas: &mut Canvas, n: usize, region: &Deviation, size: f32, picture_width: f32) {
    let (words, bounds) = (n.to_string(), region.bounds_px);
    let (width, height) = (text_width(&words, size) + 0.4 * size, 1.2 * size);
    let hides = (bounds.width as f32) < ROOM * width || (bounds.height as f32) < ROOM * height;
    let [x, y] = if hides {
        [((bounds.x + bounds.width) as f32 + 2.0).min(picture_width - width), bounds.y as f32]
    } else {
        [region.centroid_px[0] as f32 - width / 2.0, region.centroid_px[1] as f32 - height / 2.0]
    };
    canvas.fill(Area { x, y, width, height }, WHITE);
    canvas.text(&words, (x + 0.2 * size, y + size), size, Align::Left, color(region));
}

fn color(region: &Deviation) -> Color {
    if region.mean > 0.0 { NEARER } else { FURTHER }
}

/// The largest deviation to the side of this colour, as text.
fn extreme(inspection: &Inspection, unit: &str, side: Color) -> String {
    let of_side = inspection.regions.iter().filter(|region| color(region) == side);
    let most = of_side.map(|region| region.extreme).max_by(|a, b| a.abs().total_cmp(&b.abs()));
    most.map_or("none".to_string(), |most| format!("up to {most:+.3} {unit}"))
}

/// The picture in grey with coloured regions.
fn marked(part: &RgbImage, inspection: &Inspection) -> RgbImage {
    let (width, height) = part.dimensions();
    let label = |x: u32, y: u32| {
        let inside = x < width && y < height;
        if inside { inspection.labels[y as usize * width as usize + x as usize] } else { 0 }
    };
    RgbImage::from_fn(width, height, |x, y| {
        let Rgb([r, g, b]) = *part.get_pixel(x, y);
        let grey = [((u16::from(r) + u16::from(g) + u16::from(b)) / 3) as u8; 3];
        let own = label(x, y);
        if let Some(region) = inspection.regions.get((own as usize).wrapping_sub(1)) {
            let beside = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
            let is_rim = beside.into_iter().any(|(x, y)| label(x, y) != own);
            return Rgb(if is_rim { color(region) } else { mixed(grey, color(region)) });
        }
        let is_judged = inspection.difference[y as usize * width as usize + x as usize].is_finite();
        Rgb(if is_judged || (x + y) % STRIPES > 1 { grey } else { mixed(grey, GRAY) })
    })
}

/// Mean of two colours.
fn mixed(a: Color, b: Color) -> Color {
    std::array::from_fn(|c| a[c] / 2 + b[c] / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::inspect::{Heights, Limits, inspect};

    #[test]
    fn regions_are_coloured_by_side_and_holes_are_striped() {
        let field = |of: &dyn Fn(usize, usize) -> f32| {
            let values: Vec<f32> = (0..60 * 40).map(|i| of(i % 60, i / 60)).collect();
            Heights::new([60, 40], &values, &[0.01; 2400]).unwrap()
        };
        let bump = |x: usize, y: usize| match (x, y) {
            (10..20, 10..20) => 1.0,
            (30..38, 20..28) => -1.0,
            (50.., _) => f32::NAN,
            _ => 0.0,
        };
        let found = inspect(&field(&bump), &field(&|_, _| 0.0), &Limits::new(0.1)).unwrap();
        let part = Frame::gray(60, 40, vec![0.5; 2400]).unwrap();
        let drawn = draw(&part, &found, "mm", "no-go");
        assert!(drawn.width() > 60 && drawn.height() > 60, "the key stands below");
        let at = |x, y| drawn.get_pixel(x, y).0;
        assert_eq!((at(10, 15), at(15, 15), at(34, 24)), (NEARER, mixed([128; 3], NEARER), mixed([128; 3], FURTHER)));
        assert_eq!((at(5, 5), at(54, 0), at(57, 0)), ([128; 3], mixed([128; 3], GRAY), [128; 3]));
        assert!(extreme(&found, "mm", NEARER).contains("+1.000 mm"));
    }
}
