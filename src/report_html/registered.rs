//! I2 on I1's pixels, to look at: where T puts them, with gain and offset.

use image::{Rgb, RgbImage};

use crate::export::stored;
use crate::stages::ingest::srgb_to_linear;
use crate::{Decode, Photometric, Similarity, centre};

/// Where I2 does not reach.
const NOTHING: Rgb<u8> = Rgb([128; 3]);

/// The picture of I2 resampled onto I1's pixels by cubic convolution (Keys 1981, a = -1/2).
pub(super) fn registered(i2: &RgbImage, t: &Similarity, photometric: &Photometric, decode: Decode) -> RgbImage {
    let (width, height) = i2.dimensions();
    let centre = centre(width, height);
    let exposed: Vec<f32> = (0..=255).map(|byte| exposed(byte, photometric, decode)).collect();
    let reach = |at: f64, size: u32| at >= -0.5 && at <= f64::from(size) - 0.5;
    RgbImage::from_fn(width, height, |x, y| {
        let [u, v] = t.apply([x.into(), y.into()], centre);
        if reach(u, width) && reach(v, height) { sample(i2, u, v, &exposed) } else { NOTHING }
    })
}

/// What I2's stored value becomes beside I1, 0 to 255 and, so that interpolation goes on from it, not clamped.
fn exposed(byte: u8, photometric: &Photometric, decode: Decode) -> f32 {
    let (gain, offset) = (photometric.gain, photometric.offset);
    let value = f64::from(byte) / 255.0;
    match decode {
        Decode::None => (255.0 * (gain * value + offset)) as f32,
        Decode::Srgb => 255.0 * stored((gain * srgb_to_linear(value) + offset) as f32, decode),
    }
}

fn sample(image: &RgbImage, u: f64, v: f64, exposed: &[f32]) -> Rgb<u8> {
    let (width, height) = image.dimensions();
    let ((left, wx), (top, wy)) = (weights(u), weights(v));
    let inside = |at: i64, size: u32| at.clamp(0, i64::from(size) - 1) as u32;
    let columns = [0, 1, 2, 3].map(|i| inside(left + i, width));
    let mut sum = [0.0f32; 3];
    for (j, wy) in (0..).zip(wy) {
        let row = inside(top + j, height);
        for (column, wx) in columns.into_iter().zip(wx) {
            let pixel = image.get_pixel(column, row).0;
            (0..3).for_each(|c| sum[c] += wx * wy * exposed[usize::from(pixel[c])]);
        }
    }
    Rgb(sum.map(|value| value.round().clamp(0.0, 255.0) as u8))
}

/// The first of four pixels around a place, and their weights.
fn weights(at: f64) -> (i64, [f32; 4]) {
    let before = at.floor();
    let t = (at - before) as f32;
    let (t2, t3) = (t * t, t * t * t);
    let weights =
        [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3];
    (before as i64 - 1, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_moves_by_t_and_is_grey_where_nothing_is() {
        let i2 = RgbImage::from_fn(20, 10, |x, y| Rgb([10 * x as u8, 10 * y as u8, 7]));
        let t = Similarity::new(1.5, -0.25, 0.0, 1.0);
        let found = registered(&i2, &t, &Photometric::IDENTITY, Decode::None);
        // Rounded, half away from zero.
        assert_eq!(found.get_pixel(4, 5).0, [55, 48, 7]);
        assert_eq!(*found.get_pixel(19, 5), NOTHING);
        assert_eq!(registered(&i2, &Similarity::IDENTITY, &Photometric::IDENTITY, Decode::None), i2);
    }

    #[test]
    fn exposure_is_taken_over_in_intensities() {
        let photometric = Photometric { gain: 2.0, offset: 0.1 };
        assert!((exposed(50, &photometric, Decode::None) - 125.5).abs() < 1e-3);
        // 188 is half the intensity of white.
        assert!((exposed(188, &Photometric { gain: 0.5, offset: 0.0 }, Decode::Srgb) - 137.0).abs() < 1.0);
    }
}
