//! How far the texture of a picture supports the heights that were measured from it.

/// Half of the side of the window, px, without its middle: 9 by 9 px hold as much as the smallest region that counts by
/// default.
const RADIUS: usize = 4;
/// The least noise, as a fraction of white. Less is rounding.
const LEAST_NOISE: f64 = 1e-6;

/// Returns the standard deviation of a picture in a window around each pixel over the noise there, both in intensities.
/// Noise alone has at most 1, since the picture's noise is part of the noise. NaN where the noise is.
pub(crate) fn evidence(picture: &[f32], noise: &[f32], width: usize) -> Vec<f32> {
    let height = picture.len() / width.max(1);
    // Sums of all pixels above and to the left, of values and squares; about their mean, against rounding.
    let mean = picture.iter().map(|v| f64::from(*v)).sum::<f64>() / picture.len().max(1) as f64;
    let mut sums = vec![[0.0; 2]; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = [0.0; 2];
        for x in 0..width {
            let value = f64::from(picture[y * width + x]) - mean;
            row = [row[0] + value, row[1] + value * value];
            let above = sums[y * (width + 1) + x + 1];
            sums[(y + 1) * (width + 1) + x + 1] = [above[0] + row[0], above[1] + row[1]];
        }
    }
    let at = |x: usize, y: usize| sums[y * (width + 1) + x];
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        let ([left, top], [right, bottom]) = (
            [x.saturating_sub(RADIUS), y.saturating_sub(RADIUS)],
            [(x + RADIUS + 1).min(width), (y + RADIUS + 1).min(height)],
        );
        let count = ((right - left) * (bottom - top)) as f64;
        let sum = |n: usize| at(right, bottom)[n] - at(left, bottom)[n] - at(right, top)[n] + at(left, top)[n];
        let variance = (sum(1) / count - (sum(0) / count).powi(2)).max(0.0);
        let noise = f64::from(noise[i]);
        if noise.is_nan() { f32::NAN } else { (variance.sqrt() / noise.max(LEAST_NOISE)) as f32 }
    };
    (0..picture.len()).map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    #[test]
    fn texture_is_told_from_noise() {
        for seed in 0..3 {
            let mut random = Random::new(seed, 0);
            let picture: Vec<f32> = (0..60 * 40)
                .map(|i| {
                    let texture = if i % 60 < 30 { 0.2 * (0.9 * (i % 60) as f64).sin() } else { 0.0 };
                    (0.5 + texture + 0.01 * random.normal()) as f32
                })
                .collect();
            let mut noise = vec![0.01; 60 * 40];
            noise[0] = f32::NAN;
            let found = evidence(&picture, &noise, 60);
            assert!(found[0].is_nan());
            for y in 1..40 {
                let [textured, bare] = [10, 45].map(|x| found[y * 60 + x]);
                assert!((textured - 14.1).abs() < 3.0 && (bare - 1.0).abs() < 0.4, "{textured} {bare}");
            }
        }
        assert_eq!(evidence(&[0.5; 30], &[0.0; 30], 6), [0.0; 30], "without noise");
    }
}
