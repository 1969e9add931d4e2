//! I2 on I1's pixels, to look at: where T puts them, with gain and offset.

use image::{Rgb, RgbImage};

use crate::export::stored;
use crate::resample::{Grid, Interpolation, onto};
use crate::stages::ingest::srgb_to_linear;
use crate::{Decode, Photometric, Similarity};

/// Where I2 does not reach.
const NOTHING: Rgb<u8> = Rgb([128; 3]);

/// The picture of I2 resampled onto I1's pixels.
pub(super) fn registered(i2: &RgbImage, t: &Similarity, photometric: &Photometric, decode: Decode) -> RgbImage {
    let exposed: Vec<f32> = (0..=255).map(|byte| exposed(byte, photometric, decode)).collect();
    let values: Vec<f32> = i2.as_raw().iter().map(|&byte| exposed[usize::from(byte)]).collect();
    let [width, height] = [i2.width() as usize, i2.height() as usize];
    let grid = Grid { width, height, channels: 3, values: &values };
    let found = onto(&grid, t, [width, height], Interpolation::Cubic);
    let mut pixels = found.chunks_exact(3);
    RgbImage::from_fn(i2.width(), i2.height(), |_, _| match pixels.next() {
        Some(&[r, g, b]) if !r.is_nan() => Rgb([r, g, b].map(|v| v.round().clamp(0.0, 255.0) as u8)),
        _ => NOTHING,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_moves_by_t_and_is_grey_where_nothing_is() {
        let i2 = RgbImage::from_fn(20, 10, |x, y| Rgb([10 * x as u8, 10 * y as u8, 7]));
        let t = Similarity::new(1.5, -0.3, 0.0, 1.0);
        let found = registered(&i2, &t, &Photometric::IDENTITY, Decode::None);
        assert_eq!(found.get_pixel(4, 5).0, [55, 47, 7]);
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
