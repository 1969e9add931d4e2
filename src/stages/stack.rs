//! The stack of uniformly blurred images: the twin of `glsl/include/stack.glsl`.
//!
//! The gather `Î(x; V)` is the uniformly V-blurred image read at x. Between two nodes of the stack it is a cubic in V,
//! whose slopes at the nodes are known: for a Gaussian dÎ/dV is half the Laplacian (the heat equation).

use super::field::Field;
use super::spline;

/// σ of a node in px: 0, ½, 1, 1½, then a third more from each to the next.
///
/// From σ 1½ on the cubic's error is at most `0.012 (h/v)⁴`, 0.0045 of the contrast of the worst frequency, h the step in
/// variance from the node at v; even steps of σ would waste nodes on wide blur. Even steps of ¼
/// instead of ½ px moved V rms of the slanted plane by 0.0015 px² and T by 0.0001 px, in a trial on the CPU.
pub fn node_sigma(k: usize) -> f64 {
    if k <= 3 { 0.5 * k as f64 } else { 1.5 * (4.0f64 / 3.0).powi(k as i32 - 3) }
}

/// Nodes needed to reach a variance in px².
pub fn node_count(limit: f64) -> usize {
    let mut count = 2;
    while node_sigma(count - 1).powi(2) < limit {
        count += 1;
    }
    count
}

/// The last node whose variance is at most v, and never the last of all.
fn node_below(v: f64, count: usize) -> usize {
    let sigma = v.sqrt();
    let k = if sigma < 1.5 { (2.0 * sigma).floor() } else { 3.0 + ((sigma / 1.5).ln() / (4.0f64 / 3.0).ln()).floor() };
    (k as usize).min(count - 2)
}

/// An image blurred by one variance, read at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Blurred {
    /// Value.
    pub value: f64,
    /// Derivative by the variance.
    pub slope: f64,
    /// Derivative to the right.
    pub dx: f64,
    /// Derivative downwards.
    pub dy: f64,
}

/// Reads a stack of spline coefficients at variance v in px² and place (x, y).
pub fn read(stack: &[Field], v: f64, x: f64, y: f64) -> Blurred {
    let k = node_below(v, stack.len());
    let (v0, v1) = (node_sigma(k).powi(2), node_sigma(k + 1).powi(2));
    let (p, q) = (spline::read(&stack[k], x, y), spline::read(&stack[k + 1], x, y));
    let h = v1 - v0;
    // Beyond the top node the value is held.
    let (t, beyond) = (((v - v0) / h).min(1.0), v > v1);
    let (m, n) = (h * p.laplacian / 2.0, h * q.laplacian / 2.0);
    let (t2, t3) = (t * t, t * t * t);
    Blurred {
        value: p.value + (3.0 * t2 - 2.0 * t3) * (q.value - p.value) + (t3 - 2.0 * t2 + t) * m + (t3 - t2) * n,
        slope: if beyond {
            0.0
        } else {
            ((6.0 * t - 6.0 * t2) * (q.value - p.value) + (3.0 * t2 - 4.0 * t + 1.0) * m + (3.0 * t2 - 2.0 * t) * n) / h
        },
        dx: p.dx + t * (q.dx - p.dx),
        dy: p.dy + t * (q.dy - p.dy),
    }
}
