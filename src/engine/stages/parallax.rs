//! Steps T and the parallax together.
//!
//! The sums over the [windows](super::parallax_windows) determine both. The covariance of the parallax is by the scatter of what each
//! window alone would move it by, at the step (the sandwich estimate of M-estimators: Huber, Robust Statistics, 1981,
//! section 6.3).
//!
//! Where displacement outweighs blur, a smaller V with a larger parallax fits as well, and is smoother. So the parallax is
//! found as if the smoothness were of the displacement: what it pulls V by is taken from the gradient, as far as V is known
//! by parallax.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::parallax_windows::{ALL, GRADIENT, NUMBERS, OF_T, PIXELS, ROUGHNESS, is_due};
use super::pass::{Memory, Pass};
use super::state::DoubleState;
use super::update_transform::displacing;
use super::{Number, WORKGROUP, sums::UNKNOWNS};
use crate::base::Parallax;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::parallax::*;

const _: () = assert!(OF_T == UNKNOWNS);
// An invocation for each element of N, of the right side and of the unit vectors of the parallax.
const _: () = assert!(ALL * (ALL + 4) <= (WORKGROUP[0] * WORKGROUP[1]) as usize);

/// The least number of windows that count, by their pixels. With fewer, nothing changes.
const LEAST_COUNT: usize = shaders::parallax::LEAST_COUNT as usize;
/// The share of the evidence for the scale of V from which on the parallax keeps its size, because displacement is all of it:
/// up to 0.74 of generated pairs with 6 px between near and far of 256, 0.95 to 0.99 of pairs taken by hand.
const DISPLACED: f64 = shaders::parallax::DISPLACED;
/// The standard deviation of the size of a start by contrast, as a share. V of three pairs taken by hand is 0.83 to 1.28 times
/// that of their sweeps, and the rate of blur of five real sweeps 0.8 to 1.5 times that by contrast.
const OF_START: f64 = shaders::parallax::OF_START;
/// The largest step of the parallax, of one deviation of V, pixels of the level: gradients hold about so far.
const LARGEST: f64 = shaders::parallax::LARGEST;
/// A level settles only once the square of the parallax's step over its deviation is less than this, or the step less than
/// [`STILL`].
const MOVING: f64 = shaders::parallax::MOVING;
/// A step at rest, of one deviation of V, pixels of the level.
const STILL: f64 = shaders::parallax::STILL;
/// Below this a pivot has no digits left in single precision.
const LEAST_PIVOT: f64 = shaders::parallax::LEAST_PIVOT;

impl Pass for Bindings {
    /// Compulsory traffic: the numbers of the windows.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * NUMBERS as u64 * u64::from(c.windows)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        if !is_due(memory.state(self.state), c.level) {
            return;
        }
        let numbers: Vec<f64> =
            memory.numbers(self.partials)[..NUMBERS * c.windows as usize].iter().map(|&n| n.into()).collect();
        step(c, memory.state_mut(self.state), numbers.as_chunks().0);
    }
}

/// The normal equations of a window, or their sum.
struct Equations {
    normal: SMatrix<f64, ALL, ALL>,
    gradient: SVector<f64, ALL>,
}

impl Equations {
    fn of(numbers: &[f64; NUMBERS]) -> Self {
        let product = |i: usize, j: usize| {
            let (low, high) = (i.min(j), i.max(j));
            numbers[low * (2 * ALL + 1 - low) / 2 + high - low]
        };
        Self { normal: SMatrix::from_fn(product), gradient: SVector::from_fn(|i, _| numbers[GRADIENT + i]) }
    }
}

/// The inverse of N by Gauss and Jordan; unknowns that are held or that others explain are left out.
fn inverse(normal: &SMatrix<f64, ALL, ALL>, is_held: impl Fn(usize) -> bool) -> SMatrix<f64, ALL, ALL> {
    let scale = SVector::<f64, ALL>::from_fn(|i, _| {
        let diagonal = normal[(i, i)];
        if is_held(i) || diagonal.is_nan() || diagonal <= 0.0 { 0.0 } else { 1.0 / diagonal.sqrt() }
    });
    let mut left = SMatrix::<f64, ALL, ALL>::from_fn(|i, j| scale[i] * scale[j] * normal[(i, j)]);
    let mut right = SMatrix::<f64, ALL, ALL>::from_diagonal(&scale);
    for k in 0..ALL {
        let pivot = left[(k, k)];
        let counts = pivot > LEAST_PIVOT;
        for i in 0..ALL {
            if i == k && !counts {
                left.row_mut(k).fill(0.0);
                right.row_mut(k).fill(0.0);
            } else if i != k && counts {
                let share = left[(i, k)] / pivot;
                let [of_left, of_right] = [left.row(k) * share, right.row(k) * share];
                left.set_row(i, &(left.row(i) - of_left));
                right.set_row(i, &(right.row(i) - of_right));
            } else if i != k {
                left[(i, k)] = 0.0;
            }
        }
    }
    SMatrix::from_fn(|i, j| if left[(i, i)] > 0.0 { right[(i, j)] / left[(i, i)] * scale[i] } else { 0.0 })
}

/// Steps T and the parallax by the numbers of all windows.
fn step(c: &Constants, state: &mut DoubleState, windows: &[[f64; NUMBERS]]) {
    let totals: [f64; NUMBERS] = std::array::from_fn(|n| windows.iter().map(|window| window[n]).sum());
    let counting: Vec<_> = windows.iter().filter(|window| window[PIXELS] > 0.0).map(Equations::of).collect();
    state.parallax_moves = 0;
    if counting.len() < LEAST_COUNT {
        return;
    }
    let all = Equations::of(&totals);
    let inverse = inverse(&all.normal, |i| i >= c.unknowns as usize && i < OF_T);
    let (factor, length) = (f64::from(c.factor), f64::from(c.scale_length));
    let Parallax { across: [px, py], along } = state.parallax;
    // On the level: px per px², and the same at L.
    let before = Vector3::new(factor * px, factor * py, factor * factor * length * along);
    let [roughness, evidence, by_parallax] = [0, 1, 2].map(|n| totals[ROUGHNESS + n]);
    let mut gradient = all.gradient;
    let pull = roughness * by_parallax / evidence.max(1e-30) / before.norm_squared();
    (0..3).for_each(|n| gradient[OF_T + n] += pull * before[n]);
    let step = -(inverse * gradient);
    let of_parallax = inverse.fixed_rows::<3>(OF_T);
    let covariance = counting.iter().fold(Matrix3::zeros(), |sum: Matrix3<f64>, window| {
        let moves: Vector3<f64> = of_parallax * (window.gradient + window.normal * step);
        sum + moves * moves.transpose()
    });
    let mut step_of_parallax: Vector3<f64> = step.fixed_rows::<3>(OF_T).into_owned();
    state.parallax_size = 0.0;
    if by_parallax > DISPLACED * evidence {
        state.parallax_size = OF_START;
        // The coarser levels have found its direction, and the finest settles.
        step_of_parallax = match c.level {
            0 => Vector3::zeros(),
            _ => step_of_parallax - before * (before.dot(&step_of_parallax) / before.norm_squared()),
        };
    }
    let mean = totals[PIXELS + 1] / totals[PIXELS];
    let spread = (totals[PIXELS + 2] / totals[PIXELS] - mean * mean).max(0.0).sqrt();
    let square = covariance.cholesky().map_or(0.0, |root| step_of_parallax.dot(&root.solve(&step_of_parallax)));
    let information = inverse.fixed_view::<3, 3>(OF_T, OF_T).into_owned().cholesky();
    let pull = information.map_or(Vector3::zeros(), |root| root.solve(&step_of_parallax));
    let is_moving = square > MOVING && spread * step_of_parallax.norm() > STILL;
    state.parallax_moves = is_moving.into();
    let share = (LARGEST / (spread * step_of_parallax.norm()).max(1e-12)).min(1.0);
    let found: Vector3<f64> = before + step_of_parallax * share;
    // T follows the parallax. Its own step is that of all pixels, elsewhere.
    let of_t: SVector<f64, ALL> = inverse.fixed_columns::<3>(OF_T) * pull;
    let moves = displacing(length, factor, std::array::from_fn(|n| share * of_t[n]));
    state.registration = state.registration.after(&moves);
    let [to_across, to_along] = [1.0 / factor, 1.0 / (factor * factor * length)];
    state.parallax = Parallax { across: [to_across * found.x, to_across * found.y], along: to_along * found.z };
    let deviations = covariance.diagonal().map(f64::sqrt);
    let across = [to_across * deviations.x, to_across * deviations.y];
    state.parallax_deviation = Parallax { across, along: to_along * deviations.z };
}
