//! V as a picture: red near, blue far, as in the paper; nothing where V is not valid.

use std::io::Write;

use image::ExtendedColorType::Rgba8;

use super::Nearer;
use super::fused::png;
use super::ranks::Ranks;

/// The part of the valid pixels, at either end, that may leave the scale: a few wild pixels must not grey out the rest.
const TAIL: f64 = 0.01;

/// The least span of the scale, px²: less than that is rounding and noise, and must not look like relief.
const LEAST_SPAN: f32 = 0.5;

/// Writes `depth.png`.
pub(super) fn write(writer: impl Write, size: (u32, u32), blur: &[f32], nearer: Nearer) -> Result<(), String> {
    png(writer, &picture(blur, nearer), size, Rgba8)
}

/// RGBA of every pixel; the scale runs from the 1st to the 99th percentile, and over half a px² at least.
fn picture(blur: &[f32], nearer: Nearer) -> Vec<u8> {
    let mut ranks = Ranks::of(blur);
    let low = ranks.quantile(TAIL).unwrap_or(0.0);
    let high = ranks.quantile(1.0 - TAIL).unwrap_or(0.0);
    let widen = (LEAST_SPAN - (high - low)).max(0.0) / 2.0;
    let (low, high) = (low - widen, high + widen);
    blur.iter().flat_map(|&v| if v.is_finite() { color(nearness(v, low, high, nearer)) } else { [0; 4] }).collect()
}

/// 0 far, 1 near.
fn nearness(v: f32, low: f32, high: f32, nearer: Nearer) -> f64 {
    let t = f64::from((v - low) / (high - low)).clamp(0.0, 1.0);
    match nearer {
        Nearer::First => t,
        Nearer::Second => 1.0 - t,
    }
}

/// Turbo (Mikhailov 2019), blue to red with even steps in between. Its last tenth at either end darkens towards
/// violet and maroon; left out, near is plainly red and far plainly blue.
fn color(nearness: f64) -> [u8; 4] {
    let c = colorous::TURBO.eval_continuous(0.1 + 0.8 * nearness);
    [c.r, c.g, c.b, 255]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_is_red_and_far_is_blue() {
        let [r, g, b, a] = color(1.0);
        assert!(r > 150 && g < 100 && b < 50 && a == 255, "{r} {g} {b}");
        let [r, g, b, _] = color(0.0);
        assert!(b > 200 && r < 100 && g < 150, "{r} {g} {b}");
    }

    #[test]
    fn the_image_focused_nearer_decides_which_end_is_near() {
        let ramp: Vec<f32> = (0..101).map(|i| i as f32 - 50.0).collect();
        let (first, second) = (picture(&ramp, Nearer::First), picture(&ramp, Nearer::Second));
        assert_eq!(first[400..], color(1.0));
        assert_eq!(second[400..], color(0.0));
        assert_eq!(first[..4], second[400..]);
    }

    #[test]
    fn what_is_not_valid_is_transparent_and_one_value_is_drawn() {
        assert_eq!(picture(&[f32::NAN, 2.0], Nearer::First)[..4], [0; 4]);
        assert_eq!(picture(&[f32::NAN, 2.0], Nearer::First)[4..], color(0.5));
        assert_eq!(picture(&[f32::NAN], Nearer::First), [0; 4]);
    }

    #[test]
    fn rounding_does_not_look_like_relief() {
        let noise: Vec<f32> = (0..100).map(|i| 1e-3 * (i % 7) as f32).collect();
        let reds: Vec<u8> = picture(&noise, Nearer::First).chunks_exact(4).map(|p| p[0]).collect();
        let (least, most) = (reds.iter().min().unwrap(), reds.iter().max().unwrap());
        assert!(most - least < 10, "{least} to {most}");
    }

    #[test]
    fn a_wild_pixel_does_not_move_the_scale() {
        let mut ramp: Vec<f32> = (0..1000).map(|i| i as f32).collect();
        let before = picture(&ramp, Nearer::First);
        ramp[999] = 1e9;
        assert_eq!(picture(&ramp, Nearer::First), before);
    }
}
