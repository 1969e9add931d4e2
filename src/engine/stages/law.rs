//! By how much each photograph is blurred for a relative blur V: the CPU reference of `glsl/include/law.glsl`.
//!
//! A point whose relative blur is V looks alike in h(V₂) * I1 and h(V₁) * I2, because convolutions commute, whatever
//! the kernel h. V₂ - V₁ = V; a law states both. Section 2 of `docs/method.md`.

use super::Real;
use crate::engine::shaders;

/// ε, the range of V around 0 in which both images are blurred, px²: the smooth step of equation 35.
pub const EPSILON: f64 = shaders::law::EPSILON;

/// The variances by which I1 and I2 are blurred so that both look alike, px², and their derivatives by V.
#[derive(Clone, Copy, Debug)]
pub(super) struct Variances<R> {
    pub(super) first: R,
    pub(super) second: R,
    pub(super) first_by_v: R,
    pub(super) second_by_v: R,
}

impl<R: Real> Variances<R> {
    /// The variances at V. `separation` is that of the two focus settings, p, in px² of the level. At 0 the sharper
    /// image alone is blurred, but for a range of [`EPSILON`] around V = 0.
    #[inline(always)]
    pub(super) fn new(v: R, separation: f64) -> Self {
        let half = R::of(0.5);
        if separation > 0.0 {
            let (p, quarter) = (R::of(separation), R::of(0.25 / separation));
            let (sum, difference, by_v) = (v + p, v - p, R::of(0.5 / separation));
            let (first, second) = (quarter * sum * sum, quarter * difference * difference);
            return Self { first, second, first_by_v: by_v * sum, second_by_v: by_v * difference };
        }
        let epsilon = R::of(EPSILON);
        let root = (v * v + epsilon * epsilon).sqrt();
        // The smaller one without cancellation.
        let larger = half * (v.abs() + root);
        let smaller = R::of(0.25) * epsilon * epsilon / larger;
        let along = v / root;
        let [first, second] = [v.choose(larger, smaller), v.choose(smaller, larger)];
        Self { first, second, first_by_v: half + half * along, second_by_v: half * along - half }
    }

    /// Those of I1 and I2.
    #[inline(always)]
    pub(super) fn both(&self) -> [R; 2] {
        [self.first, self.second]
    }
}

/// The smooth step at V, equation 35: the share of I1 where both photographs are blended.
#[inline(always)]
pub fn share_of_first<R: Real>(v: R) -> R {
    Variances::new(v, 0.0).first_by_v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variances_differ_by_v_and_their_slopes_are_derivatives() {
        for separation in [0.0, 0.7, 10.0, 144.0] {
            for v in [-150.0, -9.0, -0.1, 0.0, 0.03, 2.0, 10.0, 80.0f64] {
                let of = |v: f64| Variances::new(v, separation);
                let ([here, before, after], step) = ([of(v), of(v - 1e-4), of(v + 1e-4)], 2e-4);
                assert!((here.first - here.second - v).abs() < 1e-9 * (1.0 + v.abs()), "{separation} {v}: {here:?}");
                assert!(here.first >= 0.0 && here.second >= 0.0);
                let slopes = [(after.first - before.first) / step, (after.second - before.second) / step];
                assert!((slopes[0] - here.first_by_v).abs() < 1e-5 && (slopes[1] - here.second_by_v).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_lens_blurs_by_the_squared_distance_from_either_focus_setting() {
        // c (u - u1)² and c (u - u2)² with c = 3 px², u1 = 0, u2 = 2: p = 12 px².
        for u in [-1.0, 0.0, 0.7, 1.0, 2.0, 2.5f64] {
            let blurs = [3.0 * u * u, 3.0 * (u - 2.0) * (u - 2.0)];
            let of = Variances::new(blurs[1] - blurs[0], 12.0);
            assert!((of.first - blurs[1]).abs() < 1e-12 && (of.second - blurs[0]).abs() < 1e-12, "{u}: {of:?}");
        }
    }
}
