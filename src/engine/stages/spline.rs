//! Fields of numbers with the border rule of the shaders, and cubic B-splines over them.
//!
//! The CPU reference of `glsl/include/border.glsl` and `glsl/include/spline.glsl`.

/// `height` rows of `width` numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Numbers per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub data: Vec<f64>,
}

impl Field {
    /// A field with `value(x, y)` at each place.
    pub fn from_fn(width: usize, height: usize, value: impl Fn(usize, usize) -> f64) -> Self {
        let data = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect();
        Self { width, height, data }
    }

    /// A field of zeros.
    pub fn zeros(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![0.0; width * height] }
    }

    /// From the numbers of an image on the device.
    pub fn from_f32(width: usize, height: usize, data: &[f32]) -> Self {
        Self { width, height, data: data.iter().map(|&v| f64::from(v)).collect() }
    }

    /// The corner of a wider image on the device with `row` numbers per row.
    pub(crate) fn corner(data: &[f32], row: usize, [width, height]: [usize; 2]) -> Self {
        let mut corner = Self { width, height, data: Vec::with_capacity(width * height) };
        for row in data.chunks_exact(row).take(height) {
            corner.data.extend(row[..width].iter().map(|&v| f64::from(v)));
        }
        corner
    }

    /// As numbers of an image on the device.
    pub fn to_f32(&self) -> Vec<f32> {
        self.data.iter().map(|&v| v as f32).collect()
    }

    /// The number at a place inside.
    pub fn get(&self, x: usize, y: usize) -> f64 {
        self.data[y * self.width + x]
    }

    /// The number at a place, mirrored about the border pixels.
    pub fn mirrored(&self, x: isize, y: isize) -> f64 {
        self.get(mirror(x, self.width), mirror(y, self.height))
    }

    /// The number at the nearest place inside.
    pub fn clamped(&self, x: isize, y: isize) -> f64 {
        self.get(x.clamp(0, self.width as isize - 1) as usize, y.clamp(0, self.height as isize - 1) as usize)
    }
}

/// Reflects about 0 and `size - 1`, repeatedly.
pub fn mirror(i: isize, size: usize) -> usize {
    fold(i, 2 * (size - 1))
}

/// Reflects about 0 and half a period, repeatedly.
pub fn fold(i: isize, period: usize) -> usize {
    let j = i.unsigned_abs() % period.max(1);
    j.min(period.max(1) - j)
}

/// Value, gradient and Laplacian of a spline at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jet {
    /// Value.
    pub value: f64,
    /// Derivative to the right.
    pub dx: f64,
    /// Derivative downwards.
    pub dy: f64,
    /// Second derivatives, added.
    pub laplacian: f64,
}

/// Weights of four coefficients at a fraction `t` after the second, with their first and second derivatives.
pub(crate) fn weights(t: f64) -> [[f64; 4]; 3] {
    let u = 1.0 - t;
    [
        [u * u * u / 6.0, 2.0 / 3.0 - t * t + t * t * t / 2.0, 2.0 / 3.0 - u * u + u * u * u / 2.0, t * t * t / 6.0],
        [-u * u / 2.0, 1.5 * t * t - 2.0 * t, 2.0 * u - 1.5 * u * u, t * t / 2.0],
        [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t],
    ]
}

/// The spline at a small shift from pixel (x, y), to first order. Without a shift it is exact, from nine coefficients
/// instead of sixteen.
///
/// Not to second order: at frequency ω the second derivative of a cubic spline on the pixels, `-6 (1 - cos ω)/(2 + cos
/// ω)`, outweighs the square of its first. Noise would then fall with the shift, all over the image, and T would drift
/// from where I2 was last warped: by 0.2 px on the dimple pair, whose texture is weak.
pub fn near(coefficients: &Field, x: usize, y: usize, [sx, sy]: [f64; 2]) -> Jet {
    let (x, y) = (x as isize, y as isize);
    let c: [[f64; 3]; 3] = std::array::from_fn(|j| {
        std::array::from_fn(|i| {
            let column = mirror(x + i as isize - 1, coefficients.width);
            coefficients.get(column, mirror(y + j as isize - 1, coefficients.height))
        })
    });
    let [value, slope, bend] = [[1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0], [-0.5, 0.0, 0.5], [1.0, -2.0, 1.0]];
    let apply = |wx: [f64; 3], wy: [f64; 3]| -> f64 {
        (0..3).map(|j| wy[j] * (0..3).map(|i| wx[i] * c[j][i]).sum::<f64>()).sum()
    };
    let (dx, dy) = (apply(slope, value), apply(value, slope));
    let laplacian = apply(bend, value) + apply(value, bend);
    Jet { value: apply(value, value) + dx * sx + dy * sy, dx, dy, laplacian }
}

/// The spline of these coefficients at (x, y), pixels.
pub fn read(coefficients: &Field, x: f64, y: f64) -> Jet {
    // Clamped, so that the index stays within an integer.
    let x = x.clamp(-1.0, coefficients.width as f64);
    let y = y.clamp(-1.0, coefficients.height as f64);
    let (column, row) = (x.floor(), y.floor());
    let (wx, wy) = (weights(x - column), weights(y - row));
    let columns: [usize; 4] = std::array::from_fn(|i| mirror(column as isize + i as isize - 1, coefficients.width));
    let mut jet = Jet::default();
    for j in 0..4 {
        let [weight, slope, bend] = wy.map(|w| w[j]);
        let y = mirror(row as isize + j as isize - 1, coefficients.height);
        let mut line = [0.0; 3];
        for i in 0..4 {
            let c = coefficients.get(columns[i], y);
            for (sum, w) in line.iter_mut().zip(&wx) {
                *sum += w[i] * c;
            }
        }
        jet.value += weight * line[0];
        jet.dx += weight * line[1];
        jet.dy += slope * line[0];
        jet.laplacian += weight * line[2] + bend * line[0];
    }
    jet
}

#[cfg(test)]
mod tests {
    use super::super::harness::smooth_field;
    use super::*;

    #[test]
    fn near_a_pixel_the_first_order_is_exact_enough() {
        let coefficients = smooth_field(24, 17, 1);
        for (x, y) in [(0, 0), (5, 7), (23, 16), (23, 3)] {
            let on = near(&coefficients, x, y, [0.0; 2]);
            let there = read(&coefficients, x as f64, y as f64);
            for (actual, expected) in
                [(on.value, there.value), (on.dx, there.dx), (on.dy, there.dy), (on.laplacian, there.laplacian)]
            {
                assert!((actual - expected).abs() < 1e-12, "({x}, {y}): {actual} {expected}");
            }
            // Second derivatives of up to 0.5 per squared pixel leave 0.5 · 0.02²/2.
            let actual = near(&coefficients, x, y, [0.02, -0.01]).value;
            let expected = read(&coefficients, x as f64 + 0.02, y as f64 - 0.01).value;
            assert!((actual - expected).abs() < 1e-4, "({x}, {y}): {actual} {expected}");
        }
    }

    #[test]
    fn mirror_reflects_about_the_border_pixels() {
        let expected = [1, 0, 1, 2, 1, 0, 1, 2, 1, 0];
        let actual: Vec<usize> = (-5..5).map(|i| mirror(i, 3)).collect();
        assert_eq!(actual, expected);
        assert_eq!(mirror(-7, 1), 0);
    }
}
