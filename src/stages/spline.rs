//! Cubic B-splines: the twin of `glsl/include/spline.glsl`.

use super::field::{Field, mirror};

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

/// Weights of the four coefficients around a place `t` of a pixel right of the second one, with first and second derivatives.
fn weights(t: f64) -> [[f64; 4]; 3] {
    let u = 1.0 - t;
    [
        [u * u * u / 6.0, 2.0 / 3.0 - t * t + t * t * t / 2.0, 2.0 / 3.0 - u * u + u * u * u / 2.0, t * t * t / 6.0],
        [-u * u / 2.0, 1.5 * t * t - 2.0 * t, 2.0 * u - 1.5 * u * u, t * t / 2.0],
        [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t],
    ]
}

/// The spline of these coefficients at (x, y), in pixels.
pub fn read(coefficients: &Field, x: f64, y: f64) -> Jet {
    // Further out there is nothing to see, and an index must stay within an integer.
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
