//! Photon transfer: whether the noise of 8-bit photographs grows with brightness as it does in linear light.

use std::iter;

use crate::base::{Channels, Frame, Samples, workers};

/// Width and height of a block whose noise is measured, px.
const BLOCK: usize = 8;
/// Pixels beyond a block that the coarser difference reads.
const BEYOND: usize = 3;
/// The most blocks of a frame, which limits the time.
const MOST_BLOCKS: usize = 1 << 14;
/// Least and greatest sample of a block that counts. Beyond them values may be clipped, which removes noise.
const SAMPLES: std::ops::Range<i32> = 2..250;
/// Brightness of the first level, and the width of a level.
const FIRST: f64 = 8.0;
const WIDTH: f64 = 16.0;
/// Number of levels.
const LEVELS: usize = 15;
/// The fewest blocks of a level.
const FEWEST_BLOCKS: usize = 100;
/// The share of the blocks of a level that have less noise than the value taken. Texture raises the others.
const QUANTILE: f64 = 0.1;

// Bounds of a decision. Pairs of a linear camera that are found have 11 levels or more, white 1.05 to 1.41, a share of
// shot noise of 0.95 to 1.02, deviations up to 0.074. docs/experiments/transfer-curve.md has those of others.
/// The fewest levels, and the least ratio of their greatest to their least brightness.
const FEWEST_LEVELS: usize = 6;
const LEAST_RANGE: f64 = 3.0;
/// The least variance at the brightest level. Rounding to 8 bits makes 1/12.
const LEAST_VARIANCE: f64 = 0.5;
/// The range of the noise of 2 x 2 means relative to white noise.
const WHITE: std::ops::Range<f64> = 0.7..1.5;
/// The range of the share of shot noise at the brightest level. It is above 1 if black is stored above 0.
const SHOT: std::ops::Range<f64> = 0.85..1.1;
/// The greatest root mean square of the relative deviations from a straight line.
const MOST_DEVIATION: f64 = 0.12;
/// The greatest ratio of the deviations from a straight line to those from a constant and a square. Noise without
/// photons and a texture as fine as the pixels make a constant and a square, whatever the curve.
const MOST_OF_TEXTURE: f64 = 0.5;

/// The noise at one level of brightness.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Level {
    /// Mean brightness, 0 to 255.
    brightness: f64,
    /// Variance from differences of adjacent pixels.
    variance: f64,
    /// Variance from differences of 2 x 2 means, times four. Equal to `variance` if the noise is white.
    of_means: f64,
}

/// A block: mean brightness, and the two variances of a [`Level`].
type Block = [f32; 3];

/// What the noise of photographs says.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Noise {
    /// Median ratio of the noise of 2 x 2 means to that of white noise.
    white: f64,
    /// Share of the variance at the brightest level that is proportional to brightness.
    shot: f64,
    /// Root mean square of the relative deviations of the variance from a straight line.
    deviation: f64,
    /// Root mean square of the relative deviations of the variance from a constant and a square.
    of_texture: f64,
}

/// Pixels of a frame: each `step`-th along both axes, beginning with that at `phase`.
#[derive(Clone, Copy, Debug)]
struct Lattice {
    step: usize,
    phase: [usize; 2],
}

impl Lattice {
    const ALL: Self = Self { step: 1, phase: [0, 0] };
    /// If colours are interpolated from a Bayer pattern, green is measured on one of these and interpolated on the
    /// other.
    const MOSAIC: [Self; 2] = [Self { step: 2, phase: [0, 0] }, Self { step: 2, phase: [1, 0] }];
}

/// Returns whether the noise of photographs of one scene shows that their 8-bit samples are linear. `false` also if
/// the noise shows nothing.
///
/// The variance of photons is proportional to their number. In linear samples it is a straight line over brightness;
/// the sRGB curve makes it level or falling. Texture, denoising, interpolation and JPEG make noise that is not white.
pub(crate) fn is_linear(frames: &[&Frame]) -> bool {
    let is_colour = frames.iter().all(|frame| frame.format().channels == Channels::Rgb);
    let mosaics = Lattice::MOSAIC.iter().take(if is_colour { 2 } else { 0 });
    iter::once(&Lattice::ALL).chain(mosaics).any(|&lattice| {
        let blocks: Vec<Block> = frames.iter().flat_map(|frame| blocks(frame, lattice)).collect();
        is_noise_linear(&levels(&blocks))
    })
}

/// Returns whether the noise at these levels is clearly that of linear samples.
fn is_noise_linear(levels: &[Level]) -> bool {
    let (Some(first), Some(last)) = (levels.first(), levels.last()) else { return false };
    let is_wide = levels.len() >= FEWEST_LEVELS && last.brightness >= LEAST_RANGE * first.brightness;
    if !is_wide || last.variance < LEAST_VARIANCE {
        return false;
    }
    let noise = Noise::of(levels);
    let is_line = noise.deviation <= MOST_DEVIATION.min(MOST_OF_TEXTURE * noise.of_texture);
    is_line && WHITE.contains(&noise.white) && SHOT.contains(&noise.shot)
}

/// Measures blocks of a lattice without clipped samples: of grey, or of green. None of a frame of more than 8 bits.
fn blocks(frame: &Frame, lattice: Lattice) -> Vec<Block> {
    let Samples::U8(samples) = frame.samples() else { return Vec::new() };
    let (width, channels) = (frame.width() as usize, frame.format().channels.count() as usize);
    let sides = [width, frame.height() as usize];
    let count = |axis: usize| {
        let pixels = sides[axis].saturating_sub(lattice.phase[axis]).div_ceil(lattice.step);
        pixels.saturating_sub(BEYOND) / BLOCK
    };
    let [across, down] = [0, 1].map(count);
    let step = (across * down).div_ceil(MOST_BLOCKS).max(1);
    let row = |n: usize| {
        let first = |x: usize| [BLOCK * x, BLOCK * n * step];
        let sample = |[x, y]: [usize; 2]| {
            let [x, y] = [lattice.phase[0] + lattice.step * x, lattice.phase[1] + lattice.step * y];
            i32::from(samples[(y * width + x) * channels + channels / 2])
        };
        (0..across).filter_map(|x| block(sample, first(x))).collect::<Vec<Block>>()
    };
    workers::map(down.div_ceil(step), row).into_iter().flatten().collect()
}

/// Measures the block whose first sample is given. `None` if a sample may be clipped.
fn block(sample: impl Fn([usize; 2]) -> i32, [left, top]: [usize; 2]) -> Option<Block> {
    const SIDE: usize = BLOCK + BEYOND;
    let mut values = [[0; SIDE]; SIDE];
    for (y, row) in values.iter_mut().enumerate() {
        row.iter_mut().enumerate().for_each(|(x, value)| *value = sample([left + x, top + y]));
    }
    if !values.as_flattened().iter().all(|v| SAMPLES.contains(v)) {
        return None;
    }
    let mut sums = [[0; SIDE - 1]; SIDE - 1];
    for (y, row) in sums.iter_mut().enumerate() {
        for (x, sum) in row.iter_mut().enumerate() {
            *sum = values[y][x] + values[y][x + 1] + values[y + 1][x] + values[y + 1][x + 1];
        }
    }
    let [mut total, mut fine, mut coarse] = [0; 3];
    for y in 0..BLOCK {
        for x in 0..BLOCK {
            let difference = values[y][x] - values[y][x + 1] - values[y + 1][x] + values[y + 1][x + 1];
            let of_sums = sums[y][x] - sums[y][x + 2] - sums[y + 2][x] + sums[y + 2][x + 2];
            total += values[y][x];
            fine += difference * difference;
            coarse += of_sums * of_sums;
        }
    }
    // White noise of variance 1 makes differences of variance 4, of the sums of four 16.
    let scale = 1.0 / (BLOCK * BLOCK) as f32;
    Some([total as f32 * scale, fine as f32 * scale / 4.0, coarse as f32 * scale / 16.0])
}

/// The noise at the levels of brightness with enough blocks, darkest first.
fn levels(blocks: &[Block]) -> Vec<Level> {
    let level = |n: usize| {
        let from = FIRST + WIDTH * n as f64;
        let within = blocks.iter().filter(|block| (from..from + WIDTH).contains(&f64::from(block[0])));
        let within: Vec<Block> = within.copied().collect();
        let quantile = |of: usize| {
            let mut values: Vec<f32> = within.iter().map(|block| block[of]).collect();
            let rank = (QUANTILE * values.len() as f64) as usize;
            f64::from(*values.select_nth_unstable_by(rank, f32::total_cmp).1)
        };
        (within.len() >= FEWEST_BLOCKS).then(|| Level {
            brightness: within.iter().map(|block| f64::from(block[0])).sum::<f64>() / within.len() as f64,
            variance: quantile(1),
            of_means: quantile(2),
        })
    };
    (0..LEVELS).filter_map(level).collect()
}

impl Noise {
    fn of(levels: &[Level]) -> Self {
        let mut ratios: Vec<f64> = levels.iter().map(|level| level.of_means / level.weighable()).collect();
        ratios.sort_by(f64::total_cmp);
        let (shot, deviation) = fit(levels, |brightness| brightness);
        let (_, of_texture) = fit(levels, |brightness| brightness * brightness);
        Self { white: ratios[ratios.len() / 2], shot, deviation, of_texture }
    }
}

impl Level {
    /// The variance, by which deviations are divided. A level without noise, as in a drawing, has a small one.
    fn weighable(&self) -> f64 {
        self.variance.max(1e-3)
    }
}

/// Fits a constant and a multiple of a function of brightness to the variance, by least squares of relative deviations.
/// Returns the share of that multiple at the brightest level, and the root mean square of the relative deviations.
fn fit(levels: &[Level], function: impl Fn(f64) -> f64) -> (f64, f64) {
    let [mut aa, mut ab, mut bb, mut a, mut b] = [0.0; 5];
    for level in levels {
        let [constant, multiple] = [1.0, function(level.brightness)].map(|term| term / level.weighable());
        aa += constant * constant;
        ab += constant * multiple;
        bb += multiple * multiple;
        a += constant;
        b += multiple;
    }
    let determinant = aa * bb - ab * ab;
    let (constant, factor) = ((a * bb - b * ab) / determinant, (b * aa - a * ab) / determinant);
    let fitted = |level: &Level| constant + factor * function(level.brightness);
    let squares = levels.iter().map(|level| (fitted(level) / level.weighable() - 1.0).powi(2));
    let deviation = (squares.sum::<f64>() / levels.len() as f64).sqrt();
    let share = levels.last().map_or(f64::NAN, |last| factor * function(last.brightness) / fitted(last));
    (share, deviation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::PixelFormat;
    use crate::base::color::linear_to_srgb;
    use crate::base::random::Random;

    const SIZE: [usize; 2] = [512, 256];

    /// A ramp from dark to bright, row-major, with noise of a variance that depends on the light. White is 1.
    fn ramp(seed: u64, variance: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut random = Random::new(seed, 1);
        let light = |n: usize| 0.02 + 0.94 * (n % SIZE[0]) as f64 / SIZE[0] as f64;
        (0..SIZE[0] * SIZE[1]).map(|n| light(n) + variance(light(n)).sqrt() * random.normal()).collect()
    }

    /// The variance of a sensor that counts 4000 electrons at white, with read noise in electrons.
    fn sensor(read: f64) -> impl Fn(f64) -> f64 {
        move |light| light / 4000.0 + (read / 4000.0).powi(2)
    }

    fn frame(values: &[f64], channels: Channels) -> Frame {
        let count = channels.count() as usize;
        let samples = values.iter().flat_map(|v| std::iter::repeat_n((255.0 * v).round() as u8, count)).collect();
        Frame::new(SIZE[0] as u32, SIZE[1] as u32, channels, Samples::U8(samples)).unwrap()
    }

    fn srgb(values: &[f64]) -> Vec<f64> {
        values.iter().map(|&v| f64::from(linear_to_srgb(v as f32))).collect()
    }

    fn noise(values: &[f64]) -> Noise {
        Noise::of(&levels(&blocks(&frame(values, Channels::Gray), Lattice::ALL)))
    }

    fn is_linear_pair(values: [Vec<f64>; 2]) -> bool {
        let [a, b] = values.map(|values| frame(&values, Channels::Gray));
        is_linear(&[&a, &b])
    }

    #[test]
    fn the_noise_of_photons_is_measured_on_linear_samples() {
        // Rounding adds 1/12.
        for read in [0.0, 40.0] {
            let values = ramp(1, sensor(read));
            let levels = levels(&blocks(&frame(&values, Channels::Gray), Lattice::ALL));
            assert_eq!(levels.len(), LEVELS - 1, "the last one is clipped");
            let last = levels[LEVELS - 2].brightness / 255.0;
            let expected = last / 4000.0 / (sensor(read)(last) + 1.0 / 12.0 / 255.0 / 255.0);
            let found = noise(&values);
            assert!((found.shot - expected).abs() < 0.03, "{found:?}, expected {expected}");
            assert!((found.white - 1.0).abs() < 0.1 && found.deviation < 0.05, "{found:?}");
        }
    }

    #[test]
    fn linear_photographs_are_found_in_grey_and_in_green() {
        let pair = [1, 2].map(|seed| ramp(seed, sensor(10.0)));
        let [a, b] = pair.clone().map(|values| frame(&values, Channels::Rgb));
        assert!(is_linear(&[&a, &b]));
        assert!(is_linear_pair(pair));
    }

    #[test]
    fn linear_photographs_are_found_behind_a_bayer_pattern() {
        for pattern in ["RG", "GR", "GB", "BG"] {
            let format: PixelFormat = format!("Bayer{pattern}8").parse().unwrap();
            let interpolated = |values: Vec<f64>| {
                let Samples::U8(mosaic) = frame(&values, Channels::Gray).samples().clone() else { unreachable!() };
                format.frame(SIZE.map(|side| side as u32), &mosaic).unwrap()
            };
            let of = |stored: fn(&[f64]) -> Vec<f64>| {
                // A lattice has a quarter of the blocks.
                let frames = [1, 2, 3, 4].map(|seed| interpolated(stored(&ramp(seed, sensor(10.0)))));
                is_linear(&frames.each_ref())
            };
            assert!(of(|values| values.to_vec()), "{pattern}");
            assert!(!of(srgb), "{pattern}");
        }
    }

    #[test]
    fn photographs_with_the_srgb_curve_are_never_linear() {
        for read in [0.0, 10.0, 100.0] {
            let pair = [1, 2].map(|seed| srgb(&ramp(seed, sensor(read))));
            let found = noise(&pair[0]);
            assert!(found.shot < 0.5, "read noise {read}: {found:?}");
            assert!(!is_linear_pair(pair));
        }
    }

    #[test]
    fn other_noise_decides_nothing() {
        // Rounding alone; noise that does not depend on light; texture whose contrast does not; both.
        let texture = |light: f64| (0.02 * light).powi(2);
        let variances: [&dyn Fn(f64) -> f64; 4] = [&|_| 0.0, &|_| 1e-4, &texture, &|light| 4e-5 + texture(light)];
        for variance in variances {
            assert!(!is_linear_pair([1, 2].map(|seed| ramp(seed, variance))));
            assert!(!is_linear_pair([1, 2].map(|seed| srgb(&ramp(seed, variance)))));
        }
        // Denoised, by the mean of neighbours.
        let denoised = [1, 2].map(|seed| {
            let values = ramp(seed, sensor(10.0));
            (0..values.len()).map(|n| (values[n] + values[(n + 1) % values.len()]) / 2.0).collect()
        });
        assert!(!is_linear_pair(denoised));
        // One brightness, and too small a photograph.
        assert!(!is_linear_pair([1, 2].map(|_| vec![0.5; SIZE[0] * SIZE[1]])));
        assert!(!is_linear(&[&Frame::new(2, 1, Channels::Gray, Samples::U8(vec![1, 2])).unwrap()]));
        // More than 8 bits.
        assert!(!is_linear(&[&Frame::gray(16, 16, vec![0.5; 256]).unwrap()]));
    }
}
