//! How much of the height of a small defect shows: the response of V to its width, where a part is as textured as here.
//!
//! A solve weighs what the photographs say about V against its smoothness. The balance for a square defect on level
//! ground is computed by the same iterations as on the finest level, for an even texture.

use crate::base::workers;

/// σ of the window over which a solve averages what the photographs say, px.
const WINDOW: f64 = 2.0;
/// Pixels around a defect that count. Farther ones have less than a hundredth of its height.
const MARGIN: usize = 18;
/// Sweeps of over-relaxation for the equations of an iteration, and ω. They leave a thousandth.
const SWEEPS: usize = 40;
const OMEGA: f64 = 1.7;
/// The largest step of an iteration, px² of V.
const LARGEST_STEP: f64 = 1.0;
/// The sensitivities of a table, one octave apart: beyond the first nothing shows, beyond the last all does.
const OCTAVES: usize = 14;
const LEAST_SENSITIVITY: f64 = 1e-4;

/// How a solve of a pair smooths V.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// Smoothness α of the finest level.
    pub regularization: f64,
    /// η of the data term, in units of intensity.
    pub data_eta: f64,
    /// η of the smoothness term, px² per pixel.
    pub smoothness_eta: f64,
    /// What neither blur nor registration explains, in units of intensity.
    pub noise: f64,
    /// Iterations of the finest level.
    pub iterations: usize,
    /// V for a unit of height, px².
    pub px2_per_height: f64,
}

/// The detail that a height map resolves.
#[derive(Clone, Debug, PartialEq)]
pub struct Detail {
    /// How much the photographs change with V at each pixel, in units of intensity per px².
    pub sensitivity: Vec<f32>,
    /// How V was smoothed.
    pub smoothing: Smoothing,
}

/// What shows of a defect of one width, as shares of its height.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shown {
    /// At its middle.
    top: f64,
    /// At least this over the least area of a region.
    over_area: f64,
    /// How wide it is at half of what shows, px.
    width: f64,
}

/// What shows of defects of several widths and one height, by the sensitivity.
#[derive(Clone, Debug)]
pub struct Response(Vec<[Shown; OCTAVES]>);

impl Response {
    /// Computes what shows of square defects of these widths, px, in ascending order.
    pub fn new(smoothing: &Smoothing, widths: &[f64], height: f64, min_area_px: usize) -> Self {
        let rise = (height * smoothing.px2_per_height).max(1e-6);
        let shown = |n: usize| {
            let sensitivity = LEAST_SENSITIVITY * 2f64.powi((n % OCTAVES) as i32);
            shown(smoothing, widths[n / OCTAVES], rise, sensitivity, min_area_px)
        };
        let all = workers::map(widths.len() * OCTAVES, shown);
        Self(all.chunks_exact(OCTAVES).map(|row| std::array::from_fn(|n| row[n])).collect())
    }

    /// Returns what shows of the defect of this index at a sensitivity.
    fn at(&self, index: usize, sensitivity: f32) -> Shown {
        // Also if it is not known.
        let octaves = (f64::from(sensitivity).max(LEAST_SENSITIVITY) / LEAST_SENSITIVITY).log2();
        let (place, row) = (octaves.min((OCTAVES - 1) as f64), &self.0[index]);
        let first = (place as usize).min(OCTAVES - 2);
        let (share, a, b) = (place - first as f64, row[first], row[first + 1]);
        let between = |a: f64, b: f64| a + share * (b - a);
        let (top, over_area) = (between(a.top, b.top), between(a.over_area, b.over_area));
        Shown { top, over_area, width: between(a.width, b.width) }
    }

    /// Returns the share of the height of a defect of this index that shows over the least area.
    pub fn over_area(&self, index: usize, sensitivity: f32) -> f64 {
        self.at(index, sensitivity).over_area
    }

    /// Returns the share of its height that shows at the top of what is seen with this width, px. What is seen
    /// narrower than the narrowest defect counts as that.
    pub(crate) fn top(&self, seen_width: f64, sensitivity: f32) -> f64 {
        let all: Vec<Shown> = (0..self.0.len()).map(|index| self.at(index, sensitivity)).collect();
        let wider = all.iter().position(|shown| shown.width >= seen_width);
        let Some(n) = wider.filter(|n| *n > 0) else {
            return if wider.is_some() { all[0] } else { all[all.len() - 1] }.top;
        };
        let (a, b) = (all[n - 1], all[n]);
        let share = (seen_width - a.width) / (b.width - a.width).max(1e-9);
        a.top + share.clamp(0.0, 1.0) * (b.top - a.top)
    }
}

/// Computes V of a square defect. Only a quadrant is computed, since the other three mirror it.
fn shown(smoothing: &Smoothing, width: f64, rise: f64, sensitivity: f64, min_area_px: usize) -> Shown {
    let Smoothing { regularization, data_eta, smoothness_eta, noise, iterations, .. } = *smoothing;
    let side = (width / 2.0).ceil() as usize + MARGIN;
    let within = |n: usize| (width / 2.0 - n as f64).clamp(0.0, 1.0);
    let truth: Vec<f64> = (0..side * side).map(|i| rise * within(i % side) * within(i / side)).collect();
    let curvature = sensitivity * sensitivity;
    let mut v = vec![0.0; side * side];
    for _ in 0..iterations.clamp(1, 100) {
        let weigh = |e: f64| curvature / (curvature * e * e + noise * noise + data_eta * data_eta).sqrt();
        let errors: Vec<f64> = v.iter().zip(&truth).map(|(v, truth): (&f64, &f64)| truth - v).collect();
        let data = windowed(&errors.iter().map(|e| weigh(*e)).collect::<Vec<_>>(), side);
        let pull = windowed(&errors.iter().map(|e| e * weigh(*e)).collect::<Vec<_>>(), side);
        let at = |x: isize, y: isize| v[fold(y, side) * side + fold(x, side)];
        let slope = |i: usize| {
            let (x, y) = ((i % side) as isize, (i / side) as isize);
            let across = 0.5 * (at(x + 1, y) - at(x - 1, y));
            let down = 0.5 * (at(x, y + 1) - at(x, y - 1));
            1.0 / (across * across + down * down + smoothness_eta * smoothness_eta).sqrt()
        };
        let flat: Vec<f64> = (0..side * side).map(slope).collect();
        let link = |i: usize, other: usize| 0.5 * regularization * (flat[i] + flat[other]);
        let right: Vec<f64> =
            (0..side * side).map(|i| if i % side + 1 < side { link(i, i + 1) } else { 0.0 }).collect();
        let down: Vec<f64> =
            (0..side * side).map(|i| if i / side + 1 < side { link(i, i + side) } else { 0.0 }).collect();
        let mut step = vec![0.0; side * side];
        for _ in 0..SWEEPS {
            for parity in 0..2 {
                for y in 0..side {
                    for x in ((y + parity) % 2..side).step_by(2) {
                        let i = y * side + x;
                        let beside = [
                            (x + 1 < side, &right, i, i + 1),
                            (x > 0, &right, i.wrapping_sub(1), i.wrapping_sub(1)),
                            (y + 1 < side, &down, i, i + side),
                            (y > 0, &down, i.wrapping_sub(side), i.wrapping_sub(side)),
                        ];
                        let (mut sum, mut links) = (pull[i], data[i]);
                        for (_, of, n, other) in beside.into_iter().filter(|(is_within, ..)| *is_within) {
                            sum += of[n] * (v[other] - v[i] + step[other]);
                            links += of[n];
                        }
                        step[i] += OMEGA * (sum / links.max(1e-12) - step[i]);
                    }
                }
            }
        }
        v.iter_mut().zip(&step).for_each(|(v, step)| *v += step.clamp(-LARGEST_STEP, LARGEST_STEP));
    }
    let half = v.iter().filter(|value| **value >= 0.5 * v[0]).count();
    let top = v[0] / rise;
    v.sort_by(|a, b| b.total_cmp(a));
    let over_area = v.get(min_area_px.div_ceil(4).max(1) - 1).map_or(0.0, |value| value / rise);
    Shown { top, over_area: over_area.max(0.0), width: (4.0 * half as f64).sqrt() }
}

/// The index of a cell, mirrored at the middle of the defect, and level beyond the margin.
fn fold(n: isize, side: usize) -> usize {
    if n < 0 { (-1 - n) as usize } else { (n as usize).min(side - 1) }
}

/// A field under the window, mirrored at the middle of the defect.
fn windowed(field: &[f64], side: usize) -> Vec<f64> {
    let reach = (3.0 * WINDOW) as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|n| (-0.5 * (n as f64 / WINDOW).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let along = |from: &[f64], step: [usize; 2]| -> Vec<f64> {
        let at = |i: usize| {
            let (own, other) = if step[0] == 1 { (i % side, i / side) } else { (i / side, i % side) };
            let terms = weights.iter().enumerate().map(|(n, weight)| {
                weight * from[fold(own as isize + n as isize - reach, side) * step[0] + other * step[1]]
            });
            terms.sum::<f64>() / sum
        };
        (0..side * side).map(at).collect()
    };
    along(&along(field, [1, side]), [side, 1])
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// That of a solve of a texture at noise 0.003.
    pub(crate) const SMOOTHING: Smoothing = Smoothing {
        regularization: 0.0088,
        data_eta: 0.01,
        smoothness_eta: 0.1,
        noise: 0.0026,
        iterations: 4,
        px2_per_height: 1.0,
    };

    #[test]
    fn wide_defects_of_a_clear_texture_show_and_narrow_ones_of_a_faint_one_do_not() {
        let response = Response::new(&SMOOTHING, &[8.0, 12.0, 24.0], 3.5, 50);
        for (index, (least, most)) in [(0.2, 0.35), (0.5, 0.7), (0.9, 1.0)].into_iter().enumerate() {
            let top = response.at(index, 0.0075).top;
            assert!((least..most).contains(&top), "{index}: {top}");
            assert!(response.over_area(index, 0.0075) <= top && response.at(index, 1e-4).top < 0.05);
            assert!(response.at(index, 0.05).top > top && response.at(index, f32::NAN).top < 0.05);
        }
        // A hill that is seen as wide as a wide defect shows as much.
        let seen = response.at(2, 0.0075).width;
        assert!(seen > 20.0 && (response.top(seen, 0.0075) - response.at(2, 0.0075).top).abs() < 1e-9, "{seen}");
        assert!(response.top(1.0, 0.0075) <= response.top(0.5 * seen, 0.0075));
    }
}
