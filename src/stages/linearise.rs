//! The fused blur-and-derivative pass: from V, I1, I2 and T to the linear system and the registration integrals.
//!
//! Equations 22 to 32 and 23 of the paper, sections 3 to 5 of `docs/method.md`.

use super::field::Field;
use super::{spline, stack};

/// Unknowns of the registration step: a, b (each times the length L), t_x, t_y, gain, offset.
pub const UNKNOWNS: usize = 6;
/// Numbers that the registration step sums: the upper triangle of N by rows, g, energy, valid pixels.
pub const SUMS: usize = 29;

/// T, gain and offset as the device holds them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// `s cos θ - 1`.
    pub a: f64,
    /// `s sin θ`.
    pub b: f64,
    /// Translation, pixels of the full-size image.
    pub t: [f64; 2],
    /// Gain of I2.
    pub gain: f64,
    /// Offset of I2.
    pub offset: f64,
}

#[derive(Clone, Copy, Debug)]
pub struct Constants {
    pub factor: f64,
    pub centre: [f64; 2],
    pub length: f64,
    pub limit: f64,
    pub alpha: f64,
    pub final_alpha: f64,
    pub eta: f64,
    pub smoothness_eta: f64,
    pub epsilon: f64,
    pub joint: f64,
}

pub struct Linearised {
    /// rhs, right, left, down, up; each over D + Σa
    pub system: [Field; 5],
    pub sums: [f64; SUMS],
}

pub fn twin(c: &Constants, r: &Registration, v: &Field, stack1: &[Field], stack2: &[Field]) -> Linearised {
    let (width, height) = (v.width, v.height);
    let mut system: [Field; 5] = std::array::from_fn(|_| Field::zeros(width, height));
    let mut sums = [0.0; SUMS];
    let s2 = (1.0 + r.a).powi(2) + r.b * r.b;
    let inverse_gradient = |x: isize, y: isize| {
        let dx = (v.clamped(x + 1, y) - v.clamped(x - 1, y)) / 2.0;
        let dy = (v.clamped(x, y + 1) - v.clamped(x, y - 1)) / 2.0;
        1.0 / (dx * dx + dy * dy + c.smoothness_eta * c.smoothness_eta).sqrt()
    };
    for y in 0..height {
        for x in 0..width {
            let blur = v.get(x, y);
            let (px, py) = (x as f64 - c.centre[0], y as f64 - c.centre[1]);
            let qx = x as f64 + r.t[0] / c.factor + r.a * px - r.b * py;
            let qy = y as f64 + r.t[1] / c.factor + r.b * px + r.a * py;
            let reach = 3.0 * blur.abs().sqrt();
            let inside = |x: f64, y: f64, reach: f64| {
                x >= reach && y >= reach && x <= width as f64 - 1.0 - reach && y <= height as f64 - 1.0 - reach
            };
            let valid = inside(x as f64, y as f64, reach) && inside(qx, qy, reach * s2.sqrt());
            let phi = inverse_gradient(x as isize, y as isize);
            let (mut d, mut rhs) = (0.0, 0.0);
            let mut q = [0.0; 6];
            let mut local = [0.0; SUMS];
            if valid {
                let i1 = spline::read(&stack1[0], x as f64, y as f64);
                let i2 = spline::read(&stack2[0], qx, qy);
                let (near1, near2) = (i1.laplacian / 2.0, i2.laplacian / 2.0);
                let (b1, b1v) = if blur >= 0.0 {
                    let i = stack::read(stack1, blur, x as f64, y as f64);
                    (i.value, i.slope)
                } else {
                    (i1.value + blur.max(-0.5) * near1, if blur > -0.5 { near1 } else { 0.0 })
                };
                let (b2, b2v, gx, gy) = if blur < 0.0 {
                    let i = stack::read(stack2, -blur * s2, qx, qy);
                    (i.value, -s2 * i.slope, i.dx, i.dy)
                } else {
                    (i2.value - s2 * blur.min(0.5) * near2, if blur < 0.5 { -s2 * near2 } else { 0.0 }, i2.dx, i2.dy)
                };
                let b2v = r.gain * b2v;
                let s1 = b1 - (r.gain * i2.value + r.offset);
                let s2_ = r.gain * b2 + r.offset - i1.value;
                let heaviside = 0.5 + (blur / c.epsilon).atan() / std::f64::consts::PI;
                let psi1 = (s1 * s1 + c.eta * c.eta).sqrt();
                let psi2 = (s2_ * s2_ + c.eta * c.eta).sqrt();
                let (w1, w2) = (heaviside / psi1, (1.0 - heaviside) / psi2);
                d = w1 * b1v * b1v + w2 * b2v * b2v;
                rhs = -(w1 * s1 * b1v + w2 * s2_ * b2v);
                let jacobian = |sign: f64, value: f64, dx: f64, dy: f64| {
                    let (dx, dy) = (r.gain * dx, r.gain * dy);
                    [
                        sign * (dx * px + dy * py) / c.length,
                        sign * (dy * px - dx * py) / c.length,
                        sign * dx,
                        sign * dy,
                        sign * (value - 0.5),
                        sign,
                    ]
                };
                let j1 = jacobian(-1.0, i2.value, i2.dx, i2.dy);
                let j2 = jacobian(1.0, b2, gx, gy);
                let mut n = 0;
                for i in 0..6 {
                    q[i] = w1 * b1v * j1[i] + w2 * b2v * j2[i];
                    local[21 + i] = w1 * s1 * j1[i] + w2 * s2_ * j2[i];
                    for j in i..6 {
                        local[n] = w1 * j1[i] * j1[j] + w2 * j2[i] * j2[j];
                        n += 1;
                    }
                }
                local[27] = heaviside * psi1 + (1.0 - heaviside) * psi2 + c.final_alpha / phi;
                local[28] = 1.0;
            }
            let mut diagonal = d;
            let mut weights = [0.0; 4];
            for (w, (dx, dy)) in weights.iter_mut().zip([(1isize, 0isize), (-1, 0), (0, 1), (0, -1)]) {
                let (nx, ny) = (x as isize + dx, y as isize + dy);
                if nx >= 0 && ny >= 0 && nx < width as isize && ny < height as isize {
                    *w = c.alpha * 0.5 * (phi + inverse_gradient(nx, ny));
                    diagonal += *w;
                    rhs += *w * (v.get(nx as usize, ny as usize) - blur);
                }
            }
            let over = 1.0 / diagonal.max(1e-12);
            if c.joint >= 0.0 && valid {
                let over = 1.0 / (d + c.joint * (diagonal - d)).max(1e-12);
                let mut n = 0;
                for i in 0..6 {
                    local[21 + i] += q[i] * rhs * over;
                    for j in i..6 {
                        local[n] -= q[i] * q[j] * over;
                        n += 1;
                    }
                }
            }
            for (sum, l) in sums.iter_mut().zip(local) {
                *sum += l;
            }
            let at = y * width + x;
            system[0].data[at] = rhs * over;
            for i in 0..4 {
                system[1 + i].data[at] = weights[i] * over;
            }
        }
    }
    Linearised { system, sums }
}
