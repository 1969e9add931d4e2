//! The linear system for du of a sweep, of [what all its pairs say](super::half_pair) and of the smoothness of ρ = √c u, px of blur; and
//! how c would step, u eliminated as a pair's registration eliminates dV.
//!
//! ```text
//! (D + Σ a_n) du = b + Σ a_n (u_n - u) + Σ a_n du_n,  a_n = α c (φ + φ_n)/2,  φ = 1/sqrt(c |∇u|² + η²)
//! ```
//!
//! Stored divided by its diagonal, as `linearise` does.

use bytemuck::{Pod, Zeroable};

use super::memory::Memory;
use super::pass::{Pass, bindings};
use super::{Field, WORKGROUP, pixels};
use crate::engine::vulkan::{Stage, Variant};

/// Push constants.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Constants {
    /// Pixels a row of the level.
    pub width: u32,
    /// Rows of the level.
    pub height: u32,
    /// α.
    pub alpha: f32,
    /// c, px² of the level by squared settings.
    pub rate: f32,
    /// η of the smoothness term, pixels of blur a pixel.
    pub smoothness_eta: f32,
}

bindings! {
    JOINT_SYSTEM:
    /// u.
    focus: Reads<RelativeBlur>,
    /// D, b, q, each the mean over a window.
    system: Reads<Plane>,
    /// Right sides.
    right_sides: Writes<RightSides>,
    /// Weights.
    weights: Writes<Weights>,
    /// Σ q b/(D + Σa) and Σ q²/(D + Σa).
    partials: Writes<Partials>,
}

/// Floats a workgroup leaves.
pub(crate) const SUMS: usize = 2;

/// Workgroups that cover a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(WORKGROUP[0]), height.div_ceil(WORKGROUP[1]), 1]
}

impl Pass for Bindings {
    type Constants = Constants;
    const STAGE: &'static Stage = &STAGE;

    /// Bytes that must move: u and the system read, right side and weights written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        36 * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, _variant: Variant, memory: &mut Memory) {
        let system = memory.layers(self.system);
        let ([right_side, weights @ ..], sums) =
            twin(c, memory.layer(self.focus, 0), [&system[0], &system[1], &system[2]]);
        memory.set_layer(self.right_sides, 0, right_side);
        weights.into_iter().enumerate().for_each(|(n, weight)| memory.set_layer(self.weights, n, weight));
        memory.numbers_mut(self.partials, SUMS)[..SUMS].copy_from_slice(&sums);
    }
}

/// The system, right side first, then the weights of the right, left, lower and upper neighbour; and the sums.
pub fn twin(c: &Constants, focus: &Field, [d, b, q]: [&Field; 3]) -> ([Field; 5], [f64; SUMS]) {
    let [alpha, rate, eta] = [c.alpha, c.rate, c.smoothness_eta].map(f64::from);
    let (width, height) = (focus.width as isize, focus.height as isize);
    let at = |x: isize, y: isize| focus.clamped(x, y);
    let phi = |x: isize, y: isize| {
        let (x, y) = (x.clamp(0, width - 1), y.clamp(0, height - 1));
        let rise = [0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1))];
        1.0 / (rate * (rise[0].powi(2) + rise[1].powi(2)) + eta * eta).sqrt()
    };
    let mut system: [Field; 5] = std::array::from_fn(|_| Field::zeros(focus.width, focus.height));
    let mut sums = [0.0; SUMS];
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let n = (y * width + x) as usize;
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(dx, dy)| (x + dx, y + dy));
        let a = beside.map(|(i, j)| {
            let exists = (0..width).contains(&i) && (0..height).contains(&j);
            if exists { 0.5 * alpha * rate * (phi(x, y) + phi(i, j)) } else { 0.0 }
        });
        let pull: f64 = a.iter().zip(beside).map(|(a, (i, j))| a * (at(i, j) - at(x, y))).sum();
        let whole = (d.data[n] + a.iter().sum::<f64>()).max(1e-12);
        system[0].data[n] = (b.data[n] + pull) / whole;
        a.iter().enumerate().for_each(|(k, a)| system[k + 1].data[n] = a / whole);
        sums[0] += q.data[n] * b.data[n] / whole;
        sums[1] += q.data[n] * q.data[n] / whole;
    }
    (system, sums)
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::relax::{half, interleaved};
    use super::*;
    use crate::engine::vulkan::Resource;

    #[test]
    fn agrees_with_the_twin() {
        for (width, height) in [(67usize, 43usize), (64, 4), (33, 18)] {
            let fields: Vec<Field> = (1..5).map(|seed| random_field(width, height, seed)).collect();
            let c =
                Constants { width: width as u32, height: height as u32, alpha: 0.05, rate: 0.7, smoothness_eta: 0.1 };
            let (expected, sums) = twin(&c, &fields[0], [&fields[1], &fields[2], &fields[3]]);
            let rig = Rig::new();
            let half_size = [c.width.div_ceil(2), c.height];
            let images = [
                rig.image(&fields[..1]),
                rig.image(&fields[1..]),
                rig.empty(half_size, 2),
                rig.empty_weights(half_size),
            ];
            let groups = tiles([c.width, c.height]);
            let partials = rig.upload(&vec![0; 4 * SUMS * (groups[0] * groups[1]) as usize]);
            let mut resources: Vec<_> = images.iter().map(Resource::Image).collect();
            resources.push(Resource::Buffer(&partials));
            rig.run_groups(&STAGE, &resources, &c, groups);
            // Single precision, over diagonals of down to 0.1.
            rig.assert_close(&images[2], &[0, 1].map(|color| half(&expected[0], color)), 1e-4);
            rig.assert_close(&images[3], &interleaved(&expected), 1e-4);
            let found = rig.floats(&partials);
            for (n, sum) in sums.iter().enumerate() {
                let total: f64 = found.chunks(SUMS).map(|row| f64::from(row[n])).sum();
                assert!((total - sum).abs() < 1e-4 * sum.abs(), "{n}: {total} {sum}");
            }
        }
    }
}
