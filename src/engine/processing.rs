//! What a camera or a program did to a photograph after its exposure: compression in blocks, and sharpening, looked
//! for on the windows of a solved pair. Section 5 of `docs/method.md`.

use super::stages::spline::Field;

/// The side of the blocks that JPEG compresses each by itself, px.
const BLOCK: usize = 8;
/// The least step at the borders of blocks over that at the next largest place, by which blocks are seen.
///
/// Of a slanted plane, a relief and plates, compressed with a quality of 10, 20, 30, 50 and 75, it was 3.4 to 5.3, 2.0
/// to 2.7, 1.6 to 2.1, 1.4 to 1.7 and 1.2 to 1.4, and V was beyond 3 σ at 11 to 18, 13 to 16, 14 to 17, 3 to 9 and 2 to
/// 3 % of the pixels. JPEG photographs of cameras have up to 1.44, pictures without blocks up to 1.03.
const LEAST_STEP: f64 = 1.6;
/// The most of all change along an axis that may lie at the borders of blocks. Squares of 8 px, as of a chart, change
/// nowhere else; the worst JPEG changes inside of its blocks too.
const MOST_AT_BORDERS: f64 = 0.6;

/// The change from pixel to pixel of one photograph, summed by place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Steps {
    /// Σ |difference| along x and along y, by the place of the first of both pixels from the first of a block.
    sums: [[f64; BLOCK]; 2],
    /// The number of differences.
    counts: [[f64; BLOCK]; 2],
}

impl Steps {
    /// Of a part of a photograph, whose first pixel lies at `origin`.
    pub(crate) fn of(part: &Field, origin: [u32; 2]) -> Self {
        let mut steps = Self::default();
        for y in 0..part.height - 1 {
            for x in 0..part.width - 1 {
                let value = part.get(x, y);
                for (axis, next) in [part.get(x + 1, y), part.get(x, y + 1)].into_iter().enumerate() {
                    let place = (origin[axis] as usize + [x, y][axis]) % BLOCK;
                    steps.sums[axis][place] += (next - value).abs();
                    steps.counts[axis][place] += 1.0;
                }
            }
        }
        steps
    }

    pub(crate) fn add(&mut self, other: &Self) {
        let add = |sum: &mut [[f64; BLOCK]; 2], other: &[[f64; BLOCK]; 2]| {
            sum.iter_mut().flatten().zip(other.iter().flatten()).for_each(|(sum, v)| *sum += v);
        };
        add(&mut self.sums, &other.sums);
        add(&mut self.counts, &other.counts);
    }

    /// Whether the photograph was compressed in blocks that show: its values step at one place in 8 along both axes.
    fn has_blocks(&self) -> bool {
        let along = |axis: usize| {
            let mut means: [f64; BLOCK] = std::array::from_fn(|n| self.sums[axis][n] / self.counts[axis][n]);
            means.sort_by(f64::total_cmp);
            let [.., second, largest] = means;
            largest > LEAST_STEP * second && largest < MOST_AT_BORDERS * means.iter().sum::<f64>()
        };
        along(0) && along(1)
    }
}

/// The warning if one of the photographs, or both, were compressed in blocks that show.
pub(crate) fn blocks_warning(steps: &[Steps; 2]) -> Option<String> {
    let which = match steps.each_ref().map(Steps::has_blocks) {
        [false, false] => return None,
        [true, false] => "I1 was",
        [false, true] => "I2 was",
        [true, true] => "both photographs were",
    };
    Some(format!(
        "{which} compressed as JPEG so far that its blocks of {BLOCK} px show, and V is off by more than its standard deviation says: save with a quality of 75 or more, or without loss"
    ))
}

/// The least blur by which one photograph is softer than the other where its noise is looked at, px²: the noise of the
/// sharper, blurred by it, keeps a fortieth of its power at a wavelength of 4 px, and less at shorter ones.
pub(super) const LEAST_BLUR: f64 = 1.5;
/// The fewest windows and pixels by which noise is judged.
const FEWEST_WINDOWS: usize = 3;
const FEWEST_PIXELS: f64 = 400.0;
/// The slopes from which on noise counts as white, or as that of a sharpened photograph if it also exceeds 1 by three
/// standard errors.
///
/// White noise has 1, and less beside texture that V does not explain: generated pictures have 0.02 to 1. Sharpened by
/// the difference from the mean of 3 x 3 px it has 1.49. Photographs that a camera saved as JPEG or interpolated from a
/// pattern of colours have at most 0.6.
const WHITE: f64 = 0.75;
const SHARPENED: f64 = 1.2;
const ERRORS: f64 = 3.0;
/// The largest slope and the largest power at the short wavelengths of a denoised photograph, relative to the other.
///
/// A median of 3 x 3 px at noise of 0.02 leaves 0.4 and 0.12. Texture that V does not explain lowers the slope too, but
/// not the power. Exposures that differ by a half leave a quarter of the power, but not the slope.
const DENOISED: [f64; 2] = [0.5, 0.25];
/// The variance of the logarithm of a slope of white noise, times the number of pixels: twice the mean, over all
/// frequencies, of the squared difference of what the two sets of filters pass.
const VARIANCE: f64 = 5.8;

/// The noise of a photograph in a window, where it is the softer of the two: sums of power over pixels, relative to the
/// power of white noise of variance 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Noise {
    /// At wavelengths of 2 to 3 px.
    short: f64,
    /// At a wavelength of 4 px.
    long: f64,
    pixels: f64,
}

impl Noise {
    /// Sums over the pixels that count, from the difference between a photograph and the other, blurred as this one is.
    pub(super) fn of(difference: &Field, counts: impl Fn(usize, usize) -> bool) -> Self {
        let mut noise = Self::default();
        for y in 0..difference.height {
            for x in (0..difference.width).filter(|x| counts(*x, y)) {
                noise.add_pixel(difference, [x as isize, y as isize]);
            }
        }
        noise
    }

    fn add_pixel(&mut self, difference: &Field, [x, y]: [isize; 2]) {
        // The power of a filter along x and another along y, over the power that it leaves of white noise.
        let power = |along_x: [f64; 5], along_y: [f64; 5]| {
            let row = |y| (-2..3).zip(along_x).map(|(i, weight)| weight * difference.clamped(x + i, y)).sum::<f64>();
            let sum: f64 = (-2..3).zip(along_y).map(|(j, weight)| weight * row(y + j)).sum();
            let squares = [along_x, along_y].map(|weights| weights.iter().map(|w| w * w).sum::<f64>());
            sum * sum / (squares[0] * squares[1])
        };
        let (second, mean) = ([0.0, 1.0, -2.0, 1.0, 0.0], [0.0, 1.0, 2.0, 1.0, 0.0]);
        let (wide_second, wide_mean) = ([1.0, 0.0, -2.0, 0.0, 1.0], [1.0, 4.0, 6.0, 4.0, 1.0]);
        self.short += (power(second, second) + power(second, mean) + power(mean, second)) / 3.0;
        self.long += 0.5 * (power(wide_second, wide_mean) + power(wide_mean, wide_second));
        self.pixels += 1.0;
    }
}

/// The noise of a photograph over all windows.
struct Spectrum {
    /// The power at short wavelengths over that at long ones.
    slope: f64,
    /// The standard error of the logarithm of the slope.
    error: f64,
    /// The power at short wavelengths.
    short: f64,
}

impl Spectrum {
    /// `None` if there is too little to judge by.
    fn of(windows: &[Noise]) -> Option<Self> {
        let windows: Vec<&Noise> = windows.iter().filter(|noise| noise.pixels > 0.0).collect();
        let sum = |of: fn(&Noise) -> f64| windows.iter().map(|noise| of(noise)).sum::<f64>();
        let [short, long, pixels] = [sum(|noise| noise.short), sum(|noise| noise.long), sum(|noise| noise.pixels)];
        let (count, slope) = (windows.len() as f64, short / long);
        let deviations = windows.iter().map(|noise| (noise.short - slope * noise.long).powi(2)).sum::<f64>();
        let scatter = count / (count - 1.0) * deviations / short.powi(2);
        (windows.len() >= FEWEST_WINDOWS && pixels >= FEWEST_PIXELS && slope.is_finite() && slope > 0.0).then(|| Self {
            slope,
            error: scatter.max(VARIANCE / pixels).sqrt(),
            short: short / pixels,
        })
    }

    fn is_sharpened(&self) -> bool {
        self.slope > SHARPENED && self.slope.ln() > ERRORS * self.error
    }

    /// Whether it is that of a denoised photograph, beside that of another.
    fn is_denoised(&self, other: &Self) -> bool {
        other.slope > WHITE && self.slope < DENOISED[0] * other.slope && self.short < DENOISED[1] * other.short
    }
}

/// The warning if one photograph was sharpened or denoised, and the other was not. Nothing is said if one of them is
/// softer nowhere, because both may have been treated alike, which leaves V right.
pub(crate) fn filtered_warning([first, second]: &[Vec<Noise>; 2]) -> Option<String> {
    let [first, second] = [Spectrum::of(first)?, Spectrum::of(second)?];
    let (what, how) = match [first.is_sharpened(), second.is_sharpened()] {
        [true, false] => ("I1 grows towards short wavelengths", "sharpened"),
        [false, true] => ("I2 grows towards short wavelengths", "sharpened"),
        _ if first.is_denoised(&second) => ("I1 is weaker than that of I2, at short wavelengths most", "denoised"),
        _ if second.is_denoised(&first) => ("I2 is weaker than that of I1, at short wavelengths most", "denoised"),
        _ => return None,
    };
    Some(format!(
        "the noise of {what}, as in a picture that was {how}, and V is off by what that changed: switch off sharpening \
         and noise reduction, or treat both photographs alike"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    /// Smooth waves, noise, and blocks of random height. The picture begins `phase` px inside of a block.
    fn picture(noise: f64, step: f64, phase: usize, seed: u64) -> Field {
        let mut random = Random::new(seed, 1);
        let heights: Vec<f64> = (0..400).map(|_| step * random.normal()).collect();
        let noise: Vec<f64> = (0..64 * 48).map(|_| noise * random.normal()).collect();
        Field::from_fn(64, 48, |x, y| {
            let wave = 0.1 * (0.31 * x as f64).sin() * (0.23 * y as f64).cos();
            wave + heights[(y + phase) / BLOCK * 20 + (x + phase) / BLOCK] + noise[y * 64 + x]
        })
    }

    #[test]
    fn steps_of_8_px_are_blocks_wherever_they_begin() {
        for seed in 1..5 {
            for phase in [0, 3, 7] {
                let of = |noise, step| Steps::of(&picture(noise, step, phase, seed), [5, 2]);
                let [without, with] = [of(0.003, 0.0), of(0.003, 0.05)];
                assert!(!without.has_blocks() && with.has_blocks(), "{phase}: {without:?} {with:?}");
                // Noise hides small ones.
                assert!(!of(0.03, 0.005).has_blocks());
            }
        }
    }

    /// White noise to which a share of its difference from its binomial mean of 3 x 3 px was added, and waves.
    fn noise_of(seed: u64, filter: f64, texture: f64) -> Vec<Noise> {
        let mut random = Random::new(seed, 2);
        let window = |n: usize| {
            let white = Field { data: (0..28 * 28).map(|_| random.normal()).collect(), ..Field::zeros(28, 28) };
            let mean = |x: usize, y: usize| {
                let row = |y: isize| -> f64 {
                    (-1..2).zip([0.25, 0.5, 0.25]).map(|(i, w)| w * white.clamped(x as isize + i, y)).sum()
                };
                (-1..2).zip([0.25, 0.5, 0.25]).map(|(j, w)| w * row(y as isize + j)).sum::<f64>()
            };
            let value = |x: usize, y: usize| {
                let wave = texture * (1.3 * x as f64 + 0.4 * y as f64 + n as f64).sin();
                white.get(x, y) + filter * (white.get(x, y) - mean(x, y)) + wave
            };
            Noise::of(&Field::from_fn(28, 28, value), |x, y| (2..26).contains(&x) && (2..26).contains(&y))
        };
        (0..12).map(window).collect()
    }

    #[test]
    fn noise_that_one_photograph_has_not_as_the_other_is_processing() {
        let says = |first: &[Noise], second: &[Noise]| filtered_warning(&[first.to_vec(), second.to_vec()]);
        for seed in 1..6 {
            let of = |filter: f64, texture: f64| noise_of(seed, filter, texture);
            let [white, sharpened, denoised] = [0.0, 1.0, -0.9].map(|filter| of(filter, 0.0));
            let spectrum = |windows: &[Noise]| Spectrum::of(windows).unwrap();
            let is_near = |found: Spectrum, slope: f64| (found.slope / slope).ln().abs() < 3.0 * found.error;
            // By the means of (1 + f (1 - cos²(kx/2) cos²(ky/2)))² over the frequencies that the filters pass.
            assert!(is_near(spectrum(&white), 1.0) && is_near(spectrum(&sharpened), 1.486));
            assert!((0.8..1.2).contains(&spectrum(&white).short));
            assert!(says(&white, &sharpened).unwrap().contains("noise of I2 grows"));
            assert!(says(&sharpened, &white).unwrap().contains("noise of I1 grows"));
            assert!(says(&white, &denoised).unwrap().contains("noise of I2 is weaker"));
            assert!(says(&denoised, &white).unwrap().contains("noise of I1 is weaker"));
            // Alike, or texture that V does not explain, or an exposure by half, or nothing to compare with.
            assert_eq!(says(&white, &noise_of(seed + 10, 0.0, 0.0)), None);
            assert_eq!(says(&sharpened, &noise_of(seed + 10, 1.0, 0.0)), None);
            assert_eq!(says(&of(0.0, 1.0), &white), None);
            let half: Vec<Noise> =
                white.iter().map(|n| Noise { short: 0.2 * n.short, long: 0.2 * n.long, ..*n }).collect();
            assert_eq!([says(&half, &white), says(&sharpened, &[]), says(&[], &denoised)], [None, None, None]);
            // Too few windows.
            assert_eq!(says(&white, &sharpened[..2]), None);
        }
    }

    #[test]
    fn windows_add_up_by_their_place_in_the_photograph() {
        let picture = picture(0.003, 0.05, 0, 1);
        // They share a column, so that each difference is in one of them.
        let part = |x: usize, width| Field::from_fn(width, 48, |i, j| picture.get(x + i, j));
        let mut sum = Steps::of(&part(0, 32), [0, 0]);
        sum.add(&Steps::of(&part(31, 33), [31, 0]));
        let whole = Steps::of(&picture, [0, 0]);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!((0..BLOCK).all(|n| close(sum.sums[0][n], whole.sums[0][n])), "{sum:?} {whole:?}");
    }

    #[test]
    fn squares_of_a_chart_are_no_blocks() {
        for blur in [0.0, 0.5, 1.0] {
            // The share of a square's side that a pixel of a blurred picture sees.
            let edge = |x: usize| {
                let at = (x % 16) as f64 + 0.5 - 8.0;
                if blur == 0.0 { f64::from(at > 0.0) } else { 0.5 + 0.5 * (at / blur).tanh() }
            };
            let chart = Field::from_fn(64, 64, |x, y| (edge(x) - 0.5) * (edge(y) - 0.5));
            assert!(!Steps::of(&chart, [0, 0]).has_blocks(), "{blur}");
        }
    }

    #[test]
    fn the_warning_names_the_photographs() {
        let [none, some] = [0.0, 0.05].map(|step| Steps::of(&picture(0.003, step, 0, 1), [0, 0]));
        let said = |steps| blocks_warning(&steps).unwrap_or_default();
        assert_eq!(said([none, none]), "");
        assert!(said([none, some]).starts_with("I2 was compressed") && said([some, none]).starts_with("I1 was"));
        assert!(said([some, some]).starts_with("both photographs were compressed as JPEG"));
    }
}
