//! Computes the linear system for the step of the unknown: V of a pair, or u of a sweep.
//!
//! D and b are those of a [pair](super::linearise), or [summed over the pairs](super::half_pair) of a sweep, averaged
//! over a window. The system combines them with the smoothness of ρ: V, or √c u in px of blur. For a sweep the pass
//! also computes the step of c, with u eliminated as dV is from a pair's registration. Equations 26 to 28, sections 4
//! and 11 of `docs/method.md`.
//!
//! ```text
//! (D + Σ a_n) du = b + Σ a_n (u_n - u - g_n) + Σ a_n du_n,  a_n = α c (φ + φ_n)/2,  φ = 1/sqrt(c |∇u|² + η²),  c of a pair 1
//! ```
//!
//! g_n is the rise of V to that neighbour by its slope over `REACH` pixels on either side, so that smoothness does not
//! flatten slopes. It is their harmonic mean, the limiter of van Leer (Journal of Computational Physics 14, 1974),
//! which is 0 at a jump. For a sweep it is 0.
//!
//! The system is stored divided by its diagonal, with weights in half precision. At the solution, dV = 0, their
//! rounding has no effect.

use super::grid::Grid;
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Field, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// α; for a pair the factor on the state's α.
    alpha: f32,
    /// c, px² of the level per squared setting; 1 for a pair.
    rate: f32,
    /// η of the smoothness term, px of blur per pixel; for a pair px² per pixel.
    smoothness_eta: f32,
}

/// Pixels over which slopes on either side of two neighbours are computed. Over fewer, noise counts as slope; over
/// more, bends of V are straightened.
const REACH: isize = shaders::system::REACH as isize;

/// The variant for a sweep.
pub(crate) const SWEEP: Variant = [true, false, false, false];

/// Layers of the equations that a variant reads: D, b, and for a sweep q.
pub(crate) fn layers(variant: Variant) -> u32 {
    if variant == SWEEP { 3 } else { 2 }
}

bindings! {
    SYSTEM:
    /// V or u.
    unknown: Reads<RelativeBlur>,
    /// D, b, and for a sweep q, each averaged over a window.
    equations: Reads<Plane>,
    /// Right sides.
    right_sides: Writes<RightSides>,
    /// Weights.
    weights: Writes<Weights>,
    /// For a sweep Σ q b/(D + Σa) and Σ q²/(D + Σa).
    partials: Writes<Partials>,
    /// State, with α of a pair.
    state: Reads<State>,
    /// The equations of the first coarse grid.
    grid: Writes<GridEquations>,
}

/// Floats per workgroup.
pub(crate) const SUMS: usize = shaders::system::SUMS as usize;

/// Workgroups over a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(WORKGROUP[0]), height.div_ceil(WORKGROUP[1]), 1]
}

impl Pass for Bindings {
    /// Compulsory traffic: the unknown and its equations read, right side, weights and a quarter of a
    /// grid's equation written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        (28 + 4 * u64::from(layers(variant))) * pixels(c.width, c.height)
    }

    fn run(&self, c: &Constants, variant: Variant, memory: &mut Memory) {
        let alpha = f64::from(c.alpha) * if variant == SWEEP { 1.0 } else { memory.state(self.state).alpha };
        let equations = &memory.layers(self.equations)[..layers(variant) as usize];
        let ([right_side, weights @ ..], sums, grid) =
            cpu_reference(c, alpha, memory.layer(self.unknown, 0), equations);
        memory.set_layer(self.right_sides, 0, right_side);
        weights.into_iter().enumerate().for_each(|(n, weight)| memory.set_layer(self.weights, n, weight));
        let coarse = grid.halved().numbers();
        memory.numbers_mut(self.grid, coarse.len())[..coarse.len()].copy_from_slice(&coarse);
        if variant == SWEEP {
            memory.numbers_mut(self.partials, SUMS)[..SUMS].copy_from_slice(&sums);
        }
    }
}

/// The system: right side, then the weights of the right, left, lower and upper neighbour; the sums; and the
/// system as that of a grid. `equations` holds D, b, and for a sweep q.
pub fn cpu_reference(
    c: &Constants,
    alpha: f64,
    unknown: &Field,
    equations: &[Field],
) -> ([Field; 5], [f64; SUMS], Grid) {
    let [rate, eta] = [c.rate, c.smoothness_eta].map(f64::from);
    let (width, height) = (unknown.width as isize, unknown.height as isize);
    let at = |x: isize, y: isize| unknown.clamped(x, y);
    let phi = |x: isize, y: isize| {
        let rise = [0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1))];
        1.0 / (rate * (rise[0].powi(2) + rise[1].powi(2)) + eta * eta).sqrt()
    };
    let slope = |x: isize, y: isize, dx: isize, dy: isize| {
        if equations.len() == layers(SWEEP) as usize {
            return 0.0;
        }
        let along = |n: isize| at(x + n * dx, y + n * dy);
        let (before, behind) = (along(0) - along(-REACH), along(REACH + 1) - along(1));
        if before * behind > 0.0 { 2.0 * before * behind / (REACH as f64 * (before + behind)) } else { 0.0 }
    };
    let mut system: [Field; 5] = std::array::from_fn(|_| Field::zeros(unknown.width, unknown.height));
    let mut sums = [0.0; SUMS];
    let zeros = || Field::zeros(unknown.width, unknown.height);
    let mut grid = Grid { d: zeros(), r: zeros(), right: zeros(), below: zeros() };
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let n = (y * width + x) as usize;
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(dx, dy)| (x + dx, y + dy));
        let a = beside.map(|(i, j)| {
            let exists = (0..width).contains(&i) && (0..height).contains(&j);
            if exists { 0.5 * alpha * rate * (phi(x, y) + phi(i, j)) } else { 0.0 }
        });
        let slopes = [slope(x, y, 1, 0), -slope(x - 1, y, 1, 0), slope(x, y, 0, 1), -slope(x, y - 1, 0, 1)];
        let pull: f64 = (0..4).map(|n| a[n] * (at(beside[n].0, beside[n].1) - at(x, y) - slopes[n])).sum();
        let (d, b) = (equations[0].data[n], equations[1].data[n]);
        (grid.d.data[n], grid.r.data[n], grid.right.data[n], grid.below.data[n]) = (d, b + pull, a[0], a[2]);
        let whole = (d + a.iter().sum::<f64>()).max(1e-12);
        system[0].data[n] = (b + pull) / whole;
        a.iter().enumerate().for_each(|(k, a)| system[k + 1].data[n] = a / whole);
        if let Some(q) = equations.get(2) {
            sums[0] += q.data[n] * b / whole;
            sums[1] += q.data[n] * q.data[n] / whole;
        }
    }
    (system, sums, grid)
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::relax::{half, interleaved};
    use super::super::state::{DoubleState, State};
    use super::*;
    use crate::engine::vulkan::Resource;

    fn check(width: usize, height: usize, variant: Variant, flat: bool) {
        let mut fields: Vec<Field> = (1..5).map(|seed| random_field(width, height, seed)).collect();
        if flat {
            fields.iter_mut().for_each(|field| field.data.fill(0.25));
        }
        let state = State { alpha: 0.4, ..State::new(&DoubleState::default().registration) };
        let (width, height) = (width as u32, height as u32);
        let c = Constants { width, height, alpha: 0.05, rate: 0.7, smoothness_eta: 0.1 };
        let alpha = f64::from(c.alpha) * if variant == SWEEP { 1.0 } else { f64::from(state.alpha) };
        let (expected, sums, grid) = cpu_reference(&c, alpha, &fields[0], &fields[1..1 + layers(variant) as usize]);
        let rig = Rig::new();
        // The pixel beyond an odd width is written too.
        let before = |floats: u32| {
            let nothing = Field::from_fn((floats * width.div_ceil(2)) as usize, height as usize, |_, _| f64::NAN);
            [nothing.clone(), nothing]
        };
        let images = [rig.image(&fields[..1]), rig.image(&fields[1..]), rig.image(&before(1)), rig.weights(&before(4))];
        let groups = tiles([width, height]);
        let partials = rig.upload(&vec![0; 4 * SUMS * (groups[0] * groups[1]) as usize]);
        let state = rig.upload(bytemuck::bytes_of(&state));
        let coarse = grid.halved().numbers();
        let cells = rig.upload(&vec![0; 4 * coarse.len()]);
        let mut resources: Vec<_> = images.iter().map(Resource::Image).collect();
        resources.extend([&partials, &state, &cells].map(Resource::Buffer));
        rig.run_variant(&STAGE, variant, &resources, &c, groups);
        // Single precision, over diagonals of down to 0.1.
        rig.assert_close(&images[2], &[0, 1].map(|color| half(&expected[0], color)), 1e-4);
        // Half precision, rounded either way.
        rig.assert_close(&images[3], &interleaved(&expected), 3e-4);
        for (f, e) in rig.floats(&cells).iter().zip(&coarse) {
            assert!((f64::from(*f) - e).abs() < 1e-4, "{f}, not {e}");
        }
        let actual = rig.floats(&partials);
        for (n, sum) in sums.iter().enumerate() {
            let total: f64 = actual.chunks(SUMS).map(|row| f64::from(row[n])).sum();
            assert!((total - sum).abs() <= 1e-4 * sum.abs(), "{n}: {total} {sum}");
        }
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(67, 43), (64, 4), (33, 18), (1, 2)] {
            check(width, height, SWEEP, false);
            check(width, height, [false; 4], false);
        }
        check(35, 20, [false; 4], true);
    }

    /// The right sides of the middle row of 121 x 5 pixels. The unknown depends on x alone, D is 1 and b is 0.
    fn pulls(unknown: impl Fn(f64) -> f64) -> Vec<f64> {
        let c = Constants { width: 121, height: 5, alpha: 1.0, rate: 1.0, smoothness_eta: 0.1 };
        let unknown = Field::from_fn(121, 5, |x, _| unknown(x as f64));
        let [ones, zeros] = [1.0, 0.0].map(|value| Field::from_fn(121, 5, |_, _| value));
        cpu_reference(&c, 0.1, &unknown, &[ones, zeros]).0[0].data[2 * 121..3 * 121].to_vec()
    }

    #[test]
    fn slopes_are_not_flattened() {
        let pulls = pulls(|x| 0.2 * x.min(80.0));
        // Both sides are on the slope.
        assert!(pulls[17..64].iter().all(|pull| pull.abs() < 1e-12), "{pulls:?}");
        // The end of the slope.
        assert!(pulls[80] < -1e-3, "{pulls:?}");
    }

    #[test]
    fn a_jump_does_not_count_as_slope() {
        // The pull on either side is that of the whole jump: a = α φ, with φ of a rise of 2 px² per pixel.
        let pulls = pulls(|x| if x < 30.0 { 1.0 } else { 5.0 });
        let (a, flat) = (0.1 / (2.0f64.powi(2) + 0.01).sqrt(), 0.1 / 0.1);
        let expected = 4.0 * a / (1.0 + 3.0 * a + 0.5 * (flat + a));
        assert!((pulls[29] - expected).abs() < 1e-6 && (pulls[30] + expected).abs() < 1e-6, "{pulls:?} {expected}");
    }

    /// Lemma 1 of the paper, which implies that relaxation converges for all photographs.
    #[test]
    fn is_diagonally_dominant() {
        let c = Constants { width: 41, height: 30, alpha: 1.0, rate: 1.0, smoothness_eta: 0.1 };
        for seed in 0..6 {
            let [mut v, d, b] = [1, 2, 3].map(|n| random_field(41, 30, 10 * seed + n));
            v.data.iter_mut().for_each(|v| *v = 12.0 * (*v - 0.5));
            let ([_, weights @ ..], ..) = cpu_reference(&c, 0.01, &v, &[d, b]);
            for i in 0..v.data.len() {
                let row = weights.each_ref().map(|weight| weight.data[i]);
                assert!(row.iter().all(|w| *w >= 0.0) && row.iter().sum::<f64>() <= 1.0 + 1e-12, "{row:?} at {i}");
            }
        }
    }
}
