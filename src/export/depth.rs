//! V as a picture: red near, blue far, as in the paper; nothing where V is not valid.

use std::io::Write;

use image::ExtendedColorType::Rgba8;

use super::fused::png;
use super::{Nearer, Scale};

/// Writes `depth.png`.
pub(super) fn write(writer: impl Write, size: (u32, u32), blur: &[f32], nearer: Nearer) -> Result<(), String> {
    png(writer, &picture(blur, nearer), size, Rgba8)
}

/// RGBA of every pixel; the scale runs from the 1st to the 99th percentile, and over half a px² at least.
fn picture(blur: &[f32], nearer: Nearer) -> Vec<u8> {
    let scale = Scale::of(blur, nearer);
    blur.iter().flat_map(|&v| scale.rgba(v)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::color;
    use super::*;

    fn opaque(nearness: f64) -> [u8; 4] {
        let [r, g, b] = color(nearness);
        [r, g, b, 255]
    }

    #[test]
    fn the_image_focused_nearer_decides_which_end_is_near() {
        let ramp: Vec<f32> = (0..101).map(|i| i as f32 - 50.0).collect();
        let (first, second) = (picture(&ramp, Nearer::First), picture(&ramp, Nearer::Second));
        assert_eq!(first[400..], opaque(1.0));
        assert_eq!(second[400..], opaque(0.0));
        assert_eq!(first[..4], second[400..]);
    }

    #[test]
    fn what_is_not_valid_is_transparent_and_one_value_is_drawn() {
        assert_eq!(picture(&[f32::NAN, 2.0], Nearer::First)[..4], [0; 4]);
        assert_eq!(picture(&[f32::NAN, 2.0], Nearer::First)[4..], opaque(0.5));
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
