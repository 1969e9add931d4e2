//! A synthetic pair for benchmarks, rendered in a fraction of a second per megapixel: approximate, not for accuracy.
//!
//! The radiance is periodic noise of four correlation lengths on a tile of 512x512 px. The tile is blurred periodically
//! by Gaussians of a few variances. Between these variances the blurred tile is interpolated linearly. V1 and V2 are
//! the blur of the images, which varies slowly. With `q = T x`:
//!
//! ```text
//! I1(x) = tile(x; V1(x)),  I2(q) = 0.96 tile(x; V2(x)) + 0.02
//! V2 - V1 = 6 sin(2π x/W) cos(2π y/H) px²
//! ```
//!
//! I2 is interpolated by Keys' cubic. A [`scene`](crate::internals::scene) is exact, but takes seconds per megapixel.

use std::f64::consts::TAU;

use crate::base::random::Random;
use crate::base::{Channels, Frame, Samples, Similarity, centre};
use crate::engine::filter;

/// Side of the tile, px; a power of two.
const SIDE: usize = 512;
/// Variances of the blurred tiles, px².
const VARIANCES: [f64; 10] = [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.5];
/// Least blur, and half the range of V, px².
const BLUR: [f64; 2] = [0.5, 3.0];
/// Standard deviations of the Gaussians that make the noise's correlation lengths, px.
const GRAINS: [f64; 4] = [0.8, 1.8, 4.0, 10.0];
/// Half the range of the uniform noise of each image.
const NOISE: f64 = 0.004;

/// T of all pairs.
pub(super) fn transform() -> Similarity {
    Similarity::new(3.4, -2.2, 0.15, 1.003)
}

/// V at a position in a pair of this size, px².
pub(super) fn relative_blur([x, y]: [f64; 2], [width, height]: [u32; 2]) -> f64 {
    2.0 * BLUR[1] * (TAU * x / f64::from(width)).sin() * (TAU * y / f64::from(height)).cos()
}

/// I1 and I2, grey, 16 bits.
pub(super) fn pair(size: [u32; 2]) -> Result<[Frame; 2], String> {
    let tiles = tiles();
    let (back, centre) = (transform().inverse(), centre(size[0], size[1]));
    let mut noise = Random::new(1, 1);
    let mut frame = |sign: f64, gain: f64, offset: f64, place: &dyn Fn([f64; 2]) -> [f64; 2]| {
        let mut samples = Vec::with_capacity(size[0] as usize * size[1] as usize);
        for y in 0..size[1] {
            for x in 0..size[0] {
                let at = place([x.into(), y.into()]);
                let v = BLUR[0] + BLUR[1] + 0.5 * sign * relative_blur(at, size);
                let value = gain * read(&tiles, at, v) + offset + NOISE * (2.0 * noise.uniform() - 1.0);
                samples.push((65535.0 * value.clamp(0.0, 1.0)) as u16);
            }
        }
        Frame::new(size[0], size[1], Channels::Gray, Samples::U16(samples))
    };
    Ok([frame(-1.0, 1.0, 0.0, &|x| x)?, frame(1.0, 0.96, 0.02, &|q| back.apply(q, centre))?])
}

/// The tile at each of the variances.
fn tiles() -> Vec<Vec<f32>> {
    let mut random = Random::new(1, 0);
    let mut sharp = vec![0.5; SIDE * SIDE];
    for sigma in GRAINS {
        let noise: Vec<f32> = (0..SIDE * SIDE).map(|_| (random.uniform() - 0.5) as f32).collect();
        let grain = blurred(&noise, sigma * sigma);
        let deviation = (grain.iter().map(|g| g * g).sum::<f32>() / grain.len() as f32).sqrt();
        sharp.iter_mut().zip(grain).for_each(|(s, g)| *s += 0.07 / deviation * g);
    }
    VARIANCES.iter().map(|&v| if v > 0.0 { blurred(&sharp, v) } else { sharp.clone() }).collect()
}

/// A tile blurred periodically by a Gaussian of this variance, px².
fn blurred(tile: &[f32], variance: f64) -> Vec<f32> {
    let weights: Vec<f32> = filter::gaussian(variance).iter().map(|&w| w as f32).collect();
    let radius = weights.len() / 2;
    // Each call transposes, so two calls blur both axes.
    let along_rows = |from: &[f32]| {
        let mut to = vec![0.0; SIDE * SIDE];
        for (y, row) in from.chunks_exact(SIDE).enumerate() {
            for x in 0..SIDE {
                let first = x + SIDE * (radius / SIDE + 1) - radius;
                to[x * SIDE + y] = weights.iter().enumerate().map(|(n, w)| w * row[(first + n) % SIDE]).sum();
            }
        }
        to
    };
    along_rows(&along_rows(tile))
}

/// The repeated tile at a position and a variance.
fn read(tiles: &[Vec<f32>], [x, y]: [f64; 2], v: f64) -> f64 {
    let above = VARIANCES.iter().position(|&node| node > v).unwrap_or(VARIANCES.len() - 1).max(1);
    let share = ((v - VARIANCES[above - 1]) / (VARIANCES[above] - VARIANCES[above - 1])).clamp(0.0, 1.0);
    let (low, high) = (&tiles[above - 1], &tiles[above]);
    let columns = taps(x);
    let mut sum = 0.0;
    for (row, w) in taps(y) {
        let line: f64 = columns
            .iter()
            .map(|&(column, w)| {
                let i = row * SIDE + column;
                w * ((1.0 - share) * f64::from(low[i]) + share * f64::from(high[i]))
            })
            .sum();
        sum += w * line;
    }
    sum
}

/// Indices on the tile around a coordinate, and Keys' cubic weights.
fn taps(x: f64) -> [(usize, f64); 4] {
    let (whole, f) = (x.floor(), x - x.floor());
    let first = (whole as i64 - 1).rem_euclid(SIDE as i64) as usize;
    let weights = [
        ((-0.5 * f + 1.0) * f - 0.5) * f,
        (1.5 * f - 2.5) * f * f + 1.0,
        ((-1.5 * f + 2.0) * f + 0.5) * f,
        (0.5 * f - 0.5) * f * f,
    ];
    std::array::from_fn(|n| ((first + n) % SIDE, weights[n]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Settings;
    use crate::engine::{Engine, EngineOptions};
    use crate::solve::{PairSolver, SolveOptions};

    #[test]
    fn the_solver_finds_the_transform_and_both_signs_of_blur() {
        let size = [256, 192];
        let [i1, i2] = pair(size).unwrap();
        let engine = Engine::new(&EngineOptions { device: Some("cpu".into()), ..EngineOptions::default() }).unwrap();
        let solution = PairSolver::new(&engine, &Settings::default())
            .unwrap()
            .solve([&i1, &i2], &SolveOptions::default())
            .unwrap();
        let corner = solution.transform.corner_distance(transform(), size[0], size[1]);
        assert!(corner < 0.1, "{:?}", solution.transform);
        let errors: Vec<f64> = (0..size[1])
            .flat_map(|y| (0..size[0]).map(move |x| [x, y]))
            .zip(&solution.relative_blur)
            .filter(|(_, v)| !v.is_nan())
            .map(|([x, y], &v)| f64::from(v) - relative_blur([x.into(), y.into()], size))
            .collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!(errors.len() > 40_000 && rms < 0.5, "{} pixels, rms {rms} px²", errors.len());
    }
}
