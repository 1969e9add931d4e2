//! An image file as radiance: the cubic spline through its pixels.

use super::kernel::gaussian_rule;
use super::view::split;

/// A channel as a continuous function, mirrored at the border.
pub(super) struct Raster {
    coefficients: Vec<f64>,
    width: usize,
    height: usize,
}

/// Pole of the cubic B-spline (Unser 1999).
const POLE: f64 = -0.267_949_192_431_122_7;

impl Raster {
    /// Makes the spline through `width * height` values, row-major.
    pub(super) fn new(mut values: Vec<f64>, width: usize, height: usize) -> Self {
        values.chunks_mut(width).for_each(prefilter);
        for x in 0..width {
            let mut column: Vec<f64> = (0..height).map(|y| values[y * width + x]).collect();
            prefilter(&mut column);
            column.into_iter().enumerate().for_each(|(y, v)| values[y * width + x] = v);
        }
        Self { coefficients: values, width, height }
    }

    /// The value at a position, px.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let ((x0, dx), (y0, dy)) = (split(x), split(y));
        let (wx, wy) = (weights(dx), weights(dy));
        let (xs, ys) = (taps(x0, self.width), taps(y0, self.height));
        let row = |j: usize| {
            let row = &self.coefficients[ys[j] * self.width..][..self.width];
            wx[0] * row[xs[0]] + wx[1] * row[xs[1]] + wx[2] * row[xs[2]] + wx[3] * row[xs[3]]
        };
        wy[0] * row(0) + wy[1] * row(1) + wy[2] * row(2) + wy[3] * row(3)
    }
}

impl Raster {
    /// The value at a position after a Gaussian blur of standard deviation `sigma` px. Spline and Gaussian separate
    /// along the axes, and so do the weights of the coefficients. So the cost grows with σ², not with the nodes of a
    /// quadrature in the plane.
    pub(super) fn gaussian(&self, [x, y]: [f64; 2], sigma: f64) -> f64 {
        let rule = gaussian_rule(sigma);
        let (xs, ys) = (spread(x, &rule), spread(y, &rule));
        let inside = xs.first >= 0 && xs.first + xs.weights.len() as i64 <= self.width as i64;
        let row = |y: i64| {
            let row = &self.coefficients[mirror(y, self.height) * self.width..][..self.width];
            if inside {
                let row = &row[xs.first as usize..];
                return xs.weights.iter().zip(row).map(|(w, c)| w * c).sum::<f64>();
            }
            xs.weights.iter().zip(xs.first..).map(|(w, x)| w * row[mirror(x, self.width)]).sum()
        };
        ys.weights.iter().zip(ys.first..).map(|(w, y)| w * row(y)).sum()
    }
}

/// The weights of the coefficients from `first` on along one axis.
struct Spread {
    first: i64,
    weights: Vec<f64>,
}

/// The sum of the splines at the nodes of a quadrature rule around `x`.
fn spread(x: f64, rule: &[(f64, f64)]) -> Spread {
    let reach = rule.last().map_or(0.0, |node| node.0);
    let first = split(x - reach).0 - 1;
    let mut weights = vec![0.0; (split(x + reach).0 + 3 - first) as usize];
    for (u, weight) in rule {
        let (i, t) = split(x - u);
        let at = (i - 1 - first) as usize;
        self::weights(t).iter().zip(&mut weights[at..]).for_each(|(w, sum)| *sum += weight * w);
    }
    Spread { first, weights }
}

/// Converts samples to coefficients in place, by a forward and a backward recursion, mirrored about the border samples.
fn prefilter(line: &mut [f64]) {
    let n = line.len();
    if n < 2 {
        return;
    }
    // z^40 is 1e-23. In a shorter line, the line and its mirror image repeat within the sum.
    let start: f64 = (0..40).map(|i| POLE.powi(i) * line[mirror(i64::from(i), n)]).sum();
    line.iter_mut().for_each(|v| *v *= 6.0);
    line[0] = 6.0 * start;
    for i in 1..n {
        line[i] += POLE * line[i - 1];
    }
    line[n - 1] = POLE / (POLE * POLE - 1.0) * (line[n - 1] + POLE * line[n - 2]);
    for i in (0..n - 1).rev() {
        line[i] = POLE * (line[i + 1] - line[i]);
    }
}

/// The cubic B-spline at the four samples around a position that is `t` after the second.
fn weights(t: f64) -> [f64; 4] {
    let r = 1.0 - t;
    [r * r * r / 6.0, 2.0 / 3.0 - t * t * (1.0 + r) / 2.0, 2.0 / 3.0 - r * r * (1.0 + t) / 2.0, t * t * t / 6.0]
}

fn taps(second: i64, length: usize) -> [usize; 4] {
    if second >= 1 && second + 2 < length as i64 {
        let first = second as usize - 1;
        return [first, first + 1, first + 2, first + 3];
    }
    [-1, 0, 1, 2].map(|i| mirror(second + i, length))
}

fn mirror(i: i64, length: usize) -> usize {
    let last = length as i64 - 1;
    if last == 0 {
        return 0;
    }
    let i = i.rem_euclid(2 * last);
    i.min(2 * last - i) as usize
}

#[cfg(test)]
mod tests {
    use super::super::Kernel;
    use super::super::kernel::Rules;
    use super::*;
    use crate::base::random::Random;

    #[test]
    fn the_spline_interpolates_the_pixels_and_mirrors() {
        for (width, height) in [(7, 5), (2, 3), (40, 17)] {
            let values: Vec<f64> = (0..width * height).map(|i| ((i * i * 7 + 3 * i) % 11) as f64 / 11.0).collect();
            let raster = Raster::new(values.clone(), width, height);
            for (i, value) in values.iter().enumerate() {
                let (x, y) = ((i % width) as f64, (i / width) as f64);
                assert!((raster.at([x, y]) - value).abs() < 1e-12, "{width}x{height} at ({x}, {y})");
                assert!((raster.at([-x, y]) - raster.at([x, y])).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_gaussian_blur_separates_along_the_axes() {
        let mut random = Random::new(1, 0);
        let raster = Raster::new((0..23 * 31).map(|_| random.uniform()).collect(), 23, 31);
        for sigma in [0.3, 1.0, 2.9] {
            let rules = Rules::new(Kernel::Gaussian, sigma);
            for x in [[11.2, 15.7], [0.4, 29.1], [-3.0, 2.0]] {
                let plane = rules.of(sigma).iter();
                let expected: f64 =
                    plane.map(|n| n.weight * raster.at([x[0] - sigma * n.u[0], x[1] - sigma * n.u[1]])).sum();
                let error = (raster.gaussian(x, sigma) - expected).abs();
                // Between noisy pixels the spline has some detail beyond the bandwidth of the quadrature rules.
                assert!(error < 1e-4, "σ {sigma} at {x:?}: {error}");
            }
        }
    }

    #[test]
    fn a_slow_cosine_is_interpolated_between_pixels() {
        let value = |x: f64, y: f64| 0.5 + 0.4 * (0.4 * x + 0.3 * y).cos();
        let size = 64;
        let values = (0..size * size).map(|i| value((i % size) as f64, (i / size) as f64)).collect();
        let raster = Raster::new(values, size, size);
        for i in 0..200 {
            let (x, y) = (20.0 + 0.113 * f64::from(i), 25.0 + 0.071 * f64::from(i));
            assert!((raster.at([x, y]) - value(x, y)).abs() < 1e-4);
        }
    }
}
