//! Spatial parameters of ISO 25178-2, from the autocorrelation of a surface: Sal and Str.

use std::f64::consts::PI;

use nalgebra::Complex;

use super::areal::Surface;

/// The longest side of a tile, px. The autocorrelation of a larger surface is the mean over tiles, for lags within one.
const TILE: usize = 512;
/// The autocorrelation at which heights count as not correlated (ISO 25178-3).
const THRESHOLD: f64 = 0.2;
/// Steps of the search for the threshold along a ray, per px.
const STEPS: f64 = 8.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SpatialParameters {
    /// Autocorrelation length Sal, px. NaN if heights are correlated everywhere.
    pub(super) sal: f64,
    /// Texture aspect ratio Str, or an upper bound of it.
    pub(super) str: f64,
    /// Whether Str is an upper bound, because heights are correlated up to the largest lag in some direction.
    pub(super) is_bound: bool,
}

impl Surface {
    /// Returns Sal and Str at the autocorrelation 0.2.
    pub(super) fn spatial_parameters(&self) -> SpatialParameters {
        Autocorrelation::new(self).parameters()
    }
}

/// The autocorrelation for lags from `-reach` to `reach`, row-major, 1 at lag 0. NaN where no pair of pixels is
/// measured.
struct Autocorrelation {
    reach: [usize; 2],
    values: Vec<f64>,
}

impl Autocorrelation {
    /// Each lag is the mean over the pairs of measured pixels at this lag, without wrapping around.
    fn new(surface: &Surface) -> Self {
        let (sides, heights) = ([surface.width, surface.height()], surface.height_parameters());
        // Heights in units of Sq, so that rounding of the mask's transform does not reach them.
        let (level, unit) = (surface.mean(), if heights.ssk.is_finite() { heights.sq } else { f64::NAN });
        let counts = sides.map(|side| side.div_ceil(TILE).max(1));
        let tile = [0, 1].map(|n| sides[n].div_ceil(counts[n]).max(1));
        // With zeros beyond the tile, pairs do not wrap around.
        let padded = tile.map(|side| (2 * side).next_power_of_two());
        let mut spectrum = vec![Complex::new(0.0, 0.0); padded[0] * padded[1]];
        for (row, column) in (0..counts[1]).flat_map(|row| (0..counts[0]).map(move |column| (row, column))) {
            let mut field = vec![Complex::new(0.0, 0.0); padded[0] * padded[1]];
            for y in (row * tile[1]..sides[1].min((row + 1) * tile[1])).map(|y| (y, y - row * tile[1])) {
                for x in column * tile[0]..sides[0].min((column + 1) * tile[0]) {
                    let z = (surface.values[y.0 * surface.width + x] - level) / unit;
                    if z.is_finite() {
                        // The real part has the heights, the imaginary part the mask.
                        field[y.1 * padded[0] + x - column * tile[0]] = Complex::new(z, 1.0);
                    }
                }
            }
            transform(&mut field, padded);
            for (y, x) in (0..padded[1]).flat_map(|y| (0..padded[0]).map(move |x| (y, x))) {
                let opposite = ((padded[1] - y) % padded[1]) * padded[0] + (padded[0] - x) % padded[0];
                let (a, b) = (field[y * padded[0] + x], field[opposite].conj());
                // The power of both parts. Both autocorrelations are real, so that one inverse gives both.
                spectrum[y * padded[0] + x] += Complex::new((a + b).norm_sqr() / 4.0, (a - b).norm_sqr() / 4.0);
            }
        }
        // Both powers are even, so that the forward transform is the inverse but for a factor.
        transform(&mut spectrum, padded);
        let reach = tile.map(|side| side - 1);
        let pairs = |i: usize| {
            let [x, y] = [i % (2 * reach[0] + 1), i / (2 * reach[0] + 1)];
            let index = ((y + padded[1] - reach[1]) % padded[1]) * padded[0] + (x + padded[0] - reach[0]) % padded[0];
            let sums = spectrum[index] / spectrum.len() as f64;
            if sums.im > 0.5 { sums.re / sums.im } else { f64::NAN }
        };
        let mut values: Vec<f64> = (0..(2 * reach[0] + 1) * (2 * reach[1] + 1)).map(pairs).collect();
        let variance = values[values.len() / 2];
        values.iter_mut().for_each(|value| *value /= variance);
        Self { reach, values }
    }

    /// Returns the value at whole lags; NaN outside.
    fn get(&self, [x, y]: [isize; 2]) -> f64 {
        let [reach_x, reach_y] = self.reach.map(|reach| reach as isize);
        if x.abs() > reach_x || y.abs() > reach_y {
            return f64::NAN;
        }
        self.values[((y + reach_y) * (2 * reach_x + 1) + x + reach_x) as usize]
    }

    /// Returns the value between lags, by the cubic of Catmull and Rom; linearly where a neighbour is missing.
    fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let ([i, j], [a, b]) = ([x, y].map(|v| v.floor() as isize), [x, y].map(|v| v - v.floor()));
        let cubic = |t: f64| {
            [
                0.5 * t * (t * (2.0 - t) - 1.0),
                0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
                0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
                0.5 * t * t * (t - 1.0),
            ]
        };
        let sum = |across: &[f64], down: &[f64], first: isize| {
            let mut sum = 0.0;
            for (n, v) in down.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                for (m, u) in across.iter().enumerate().filter(|(_, u)| **u != 0.0) {
                    sum += u * v * self.get([i + first + m as isize, j + first + n as isize]);
                }
            }
            sum
        };
        let value = sum(&cubic(a), &cubic(b), -1);
        if value.is_finite() { value } else { sum(&[1.0 - a, a], &[1.0 - b, b], 0) }
    }

    /// Sal is the shortest, and Sal/Str the longest distance from lag 0 at which the autocorrelation falls to the
    /// threshold: on the rays to the lags just outside of the connected region around lag 0 in which it is larger.
    fn parameters(&self) -> SpatialParameters {
        let [reach_x, reach_y] = self.reach.map(|reach| reach as isize);
        let columns = 2 * reach_x + 1;
        let mut visited = vec![false; self.values.len()];
        let mut pending = vec![[0, 0]];
        visited[self.values.len() / 2] = true;
        let (mut shortest, mut longest, mut is_bound) = (f64::INFINITY, 0.0f64, false);
        while let Some([x, y]) = pending.pop() {
            for lag in [[x + 1, y], [x - 1, y], [x, y + 1], [x, y - 1]] {
                let value = self.get(lag);
                if value.is_nan() {
                    is_bound = true;
                    longest = longest.max((x as f64).hypot(y as f64));
                    continue;
                }
                let index = ((lag[1] + reach_y) * columns + lag[0] + reach_x) as usize;
                if std::mem::replace(&mut visited[index], true) {
                    continue;
                }
                if value > THRESHOLD {
                    pending.push(lag);
                } else {
                    let distance = self.crossing(lag);
                    (shortest, longest) = (shortest.min(distance), longest.max(distance));
                }
            }
        }
        if shortest.is_infinite() {
            return SpatialParameters { sal: f64::NAN, str: f64::NAN, is_bound: false };
        }
        SpatialParameters { sal: shortest, str: shortest / longest, is_bound }
    }

    /// Returns the distance from lag 0 of the last crossing of the threshold on the ray to a lag below it.
    fn crossing(&self, lag: [isize; 2]) -> f64 {
        let end = lag.map(|v| v as f64);
        let length = end[0].hypot(end[1]);
        let above = |distance: f64| self.at(end.map(|v| v * distance / length)) - THRESHOLD;
        let (mut far, mut near) = (length, length);
        while near > 0.0 && above(near).is_nan() | (above(near) <= 0.0) {
            (far, near) = (near, (near - 1.0 / STEPS).max(0.0));
        }
        // The autocorrelation is linear over so short a distance.
        let [at_near, at_far] = [above(near), above(far)];
        let share = if at_near > at_far { at_near / (at_near - at_far) } else { 0.0 };
        near + (far - near) * share.clamp(0.0, 1.0)
    }
}

/// Transforms a field of power-of-two sides in place: the discrete Fourier transform, not normalised.
fn transform(field: &mut Vec<Complex<f64>>, [width, height]: [usize; 2]) {
    let mut turned = vec![Complex::new(0.0, 0.0); field.len()];
    for [width, height] in [[width, height], [height, width]] {
        let twiddles = twiddles(width);
        field.chunks_exact_mut(width).for_each(|row| transform_row(row, &twiddles));
        for (i, value) in field.iter().enumerate() {
            turned[(i % width) * height + i / width] = *value;
        }
        std::mem::swap(field, &mut turned);
    }
}

fn twiddles(length: usize) -> Vec<Complex<f64>> {
    (0..length / 2).map(|k| Complex::from_polar(1.0, -2.0 * PI * k as f64 / length as f64)).collect()
}

/// The transform of Cooley and Tukey with radix 2.
fn transform_row(row: &mut [Complex<f64>], twiddles: &[Complex<f64>]) {
    let length = row.len();
    if length < 2 {
        return;
    }
    let shift = usize::BITS - length.trailing_zeros();
    for i in 0..length {
        let reversed = i.reverse_bits() >> shift;
        if i < reversed {
            row.swap(i, reversed);
        }
    }
    let mut half = 1;
    while half < length {
        let stride = length / (2 * half);
        for block in row.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for k in 0..half {
                let turned = high[k] * twiddles[k * stride];
                (low[k], high[k]) = (low[k] + turned, low[k] - turned);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::areal::tests::{close, surface};
    use super::*;
    use crate::base::statistics::tests::smooth_noise;

    fn noise(size: [usize; 2], sigma: f64, seed: u64) -> Surface {
        Surface { width: size[0], values: smooth_noise(size, sigma, seed) }
    }

    #[test]
    fn the_autocorrelation_is_that_of_a_direct_sum_with_missing_pixels() {
        let mut bumpy = surface([13, 9], |x, y| (0.9 * x).sin() * (0.6 * y).cos() + 0.1 * x);
        for i in [5, 30, 31, 77] {
            bumpy.values[i] = f64::NAN;
        }
        let found = Autocorrelation::new(&bumpy);
        let level = bumpy.mean();
        let direct = |dx: isize, dy: isize| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (y, x) in (0..9isize).flat_map(|y| (0..13isize).map(move |x| (y, x))) {
                let (u, v) = (x + dx, y + dy);
                if (0..13).contains(&u) && (0..9).contains(&v) {
                    let product =
                        (bumpy.values[(y * 13 + x) as usize] - level) * (bumpy.values[(v * 13 + u) as usize] - level);
                    if product.is_finite() {
                        (sum, count) = (sum + product, count + 1.0);
                    }
                }
            }
            sum / count
        };
        for (dx, dy) in [(0, 0), (1, 0), (-3, 2), (7, -5), (12, 8), (0, -8)] {
            close(found.get([dx, dy]) * direct(0, 0), direct(dx, dy), 1e-9);
        }
        assert!(found.get([13, 0]).is_nan());
    }

    #[test]
    fn sal_and_str_of_noise_of_known_autocorrelation() {
        // Noise smoothed by a Gaussian of σ has the autocorrelation exp(-d²/(4 σ²)), 0.2 at d = 2 σ sqrt(ln 5).
        let sigma = 2.5;
        let expected = 2.0 * sigma * 5f64.ln().sqrt();
        // Over 512 px in one side it is the mean of two tiles.
        for size in [[400, 400], [600, 300]] {
            let found = noise(size, sigma, 7).spatial_parameters();
            println!("{size:?}: Sal {:.3}, expected {expected:.3}, Str {:.3}", found.sal, found.str);
            close(found.sal, expected, 0.08);
            assert!((0.8..=1.0).contains(&found.str) && !found.is_bound, "{found:?}");
        }
    }

    #[test]
    fn stripes_have_a_short_sal_and_a_small_str() {
        let period = 24.0;
        let stripes = surface([240, 200], |x, _| (TAU * x / period).sin()).spatial_parameters();
        // cos(2π d/period) is 0.2.
        close(stripes.sal, period * 0.2f64.acos() / TAU, 0.02);
        assert!(stripes.is_bound && stripes.str < 0.03, "{stripes:?}");
        // Stretched noise has the ratio of its lengths.
        let tall = noise([300, 300], 2.0, 3);
        let wide = surface([300, 300], |x, y| {
            let at = |x: f64| tall.values[y as usize * 300 + x as usize];
            let (i, a) = ((x / 4.0).floor(), (x / 4.0).fract());
            (1.0 - a) * at(i) + a * at(i + 1.0)
        });
        let found = wide.spatial_parameters();
        println!("stretched by 4: {found:?}");
        assert!((0.19..0.32).contains(&found.str) && !found.is_bound, "{found:?}");
    }

    #[test]
    fn a_flat_surface_has_no_autocorrelation() {
        assert!(surface([40, 30], |_, _| 2.0).spatial_parameters().sal.is_nan());
        let single = surface([1, 1], |_, _| 2.0).spatial_parameters();
        assert!(single.sal.is_nan() && single.str.is_nan());
    }

    #[test]
    fn missing_pixels_do_not_shorten_the_autocorrelation() {
        let whole = noise([300, 300], 3.0, 11);
        let mut holes = whole.clone();
        for i in 0..holes.values.len() {
            if (i % 300) % 20 < 5 && (i / 300) % 15 < 6 {
                holes.values[i] = f64::NAN;
            }
        }
        let [a, b] = [whole, holes].map(|s| s.spatial_parameters());
        close(b.sal, a.sal, 0.05);
        close(b.str, a.str, 0.1);
    }
}
