//! Whether both photographs determine V beside brightness and noise. Section 5 of `docs/method.md`.

use nalgebra::{DMatrix, DVector};

use super::stages::sums::UNKNOWNS;

/// Changes of a side of the residual at a pixel: by 1 px² of V, by an offset, by a gain, and by a gain that varies over
/// the picture to second degree.
pub(crate) fn effects(value: f64, laplacian: f64, [x, y]: [f64; 2]) -> [f64; UNKNOWNS] {
    [0.5 * laplacian, 1.0, value, value * x, value * y, value * x * x, value * x * y, value * y * y]
}

/// The least share of the effect of V that brightness does not have too.
///
/// Brightness and V are fitted in turn. Of an error of V the share that brightness takes up stays after each turn, and
/// brightness is matched three times on a level. Gratings of one frequency leave 0.0003 and less. With three or four
/// harmonics V was within 0.05 px² where 0.12 or more was left, and off by 0.2 and 0.6 of 4 px² at 0.034 and 0.049.
/// Pairs that fit leave 0.12 to 0.9.
const LEAST_SHARE: f64 = 0.1;
/// The largest standard deviation by noise, px², of an error of V that is the same everywhere. Real pairs have up to
/// 0.05, pairs of noise 0.05 have 0.08.
const MOST_DEVIATION: f64 = 0.5;

/// The fewest pixels that say anything.
const FEWEST: f64 = 256.0;

/// Whether V is determined, by the sums over pixels of the products of the [`effects`] on both sides, one with the
/// other.
///
/// `valid` pixels have a V, and the difference of the photographs has `noise`.
pub(crate) fn determine_v(sums: &[[f64; UNKNOWNS]; UNKNOWNS], fits_brightness: bool, valid: f64, noise: f64) -> bool {
    let [of_v, pixels] = [sums[0][0], sums[1][1]];
    if pixels < FEWEST {
        return true;
    }
    let share = if fits_brightness { share(sums) } else { 1.0 };
    // Noise is smoothed less than the effect of V, but over as many pixels as smoothing makes alike: both cancel.
    let deviation = noise / (valid * share * of_v / pixels).sqrt();
    // Not so if either is not a number.
    share >= LEAST_SHARE && deviation <= MOST_DEVIATION
}

/// The share of the effect of V that no change of brightness has.
fn share(sums: &[[f64; UNKNOWNS]; UNKNOWNS]) -> f64 {
    let at = |i: usize, j: usize| sums[i.min(j)][i.max(j)];
    let scale = |i: usize| at(i, i).abs().sqrt().max(f64::MIN_POSITIVE);
    let brightness =
        DMatrix::from_fn(UNKNOWNS - 1, UNKNOWNS - 1, |i, j| at(i + 1, j + 1) / (scale(i + 1) * scale(j + 1)));
    let with_v = DVector::from_fn(UNKNOWNS - 1, |i, _| at(0, i + 1) / scale(i + 1));
    let brightness = brightness.symmetric_eigen();
    let least = 1e-6 * brightness.eigenvalues.max();
    let taken = brightness.eigenvalues.iter().zip(brightness.eigenvectors.column_iter());
    let taken: f64 = taken.filter(|(v, _)| **v > least).map(|(v, vector)| vector.dot(&with_v).powi(2) / v).sum();
    1.0 - taken / at(0, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    /// The sums over a picture of waves of these frequencies and amplitudes. Both sides have noise.
    fn sums(waves: &[[f64; 2]], noise: f64, seed: u64) -> [[f64; UNKNOWNS]; UNKNOWNS] {
        let mut random = Random::new(seed, 3);
        let mut sums = [[0.0; UNKNOWNS]; UNKNOWNS];
        for n in 0..64 * 64 {
            let [x, y] = [n % 64, n / 64].map(f64::from);
            let (mut value, mut laplacian) = (0.5, 0.0);
            for [k, amplitude] in waves {
                let wave = amplitude * ((k * x).cos() + (k * y + 0.4).cos());
                value += wave;
                laplacian -= k * k * wave;
            }
            let place = [x, y].map(|v| v / 32.0 - 1.0);
            let mut side = || effects(value + noise * random.normal(), laplacian + noise * random.normal(), place);
            let (first, second) = (side(), side());
            for i in 0..UNKNOWNS {
                for j in i..UNKNOWNS {
                    sums[i][j] += 0.5 * (first[i] * second[j] + second[i] * first[j]);
                }
            }
        }
        sums
    }

    #[test]
    fn a_grating_of_one_frequency_does_not_determine_v_if_brightness_is_fitted() {
        for seed in 1..5 {
            let one = sums(&[[0.6, 0.1]], 0.002, seed);
            assert!(share(&one).abs() < 0.01, "{}", share(&one));
            assert!(!determine_v(&one, true, 4096.0, 0.003) && determine_v(&one, false, 4096.0, 0.003));
            // The share of two waves is the variance of k² over the mean of k⁴, by their powers.
            let two = sums(&[[0.3, 0.1], [0.9, 0.1]], 0.002, seed);
            let [low, high] = [0.09, 0.81];
            let expected = 0.25 * (high - low) * (high - low) / (0.5 * (low * low + high * high));
            assert!((share(&two) - expected).abs() < 0.05, "{} {expected}", share(&two));
            assert!(determine_v(&two, true, 4096.0, 0.003));
        }
    }

    #[test]
    fn noise_hides_what_blur_changes_in_a_smooth_picture() {
        let smooth = sums(&[[0.03, 0.1], [0.09, 0.01]], 0.0, 1);
        let determined = |noise| determine_v(&smooth, false, 4096.0, noise);
        assert!(determined(0.0005) && !determined(0.01));
        // No windows say nothing.
        assert!(determine_v(&[[0.0; UNKNOWNS]; UNKNOWNS], true, 4096.0, 0.01));
    }
}
