//! The focus settings of a sweep that states none, estimated on the level of the start.
//!
//! Frames may be missing, or have been taken at uneven steps. V of a pair depends on the settings of both frames:
//!
//! ```text
//! V = c ((p_j - u)² - (p_i - u)²)
//! ```
//!
//! So the settings are unknowns, one per frame, found by Gauss-Newton steps with u eliminated at each pixel over a
//! window. c is held as found for even settings, which only scales all steps alike.

use nalgebra::{DMatrix, DVector};

use super::pairs::MAX_RELATIVE_BLUR;
use super::start::{self, BlurStacks, NOISE_CORRELATION, WINDOWS};
use crate::base::workers;
use crate::engine::stages::Field;
use crate::engine::stages::separable::smoothed;

/// Distances of the frames of a pair. These are more pairs than the joint solve has, because single steps are to be
/// determined: with its pairs alone, a step of the heat sink's seven frames comes out three times as long.
const STRIDES: [usize; 8] = [1, 2, 3, 4, 6, 8, 12, 16];
/// η of the data term, that of the joint solve.
const ETA: f64 = 0.005;
/// Rounds on the coarser level, which only decides whether the finer one is worth it, and on the finer. u is found
/// again in each.
const ROUNDS: [usize; 2] = [1, 3];
/// Steps of the settings per round.
const STEPS: usize = 3;
/// The largest change of a step from setting to setting, in mean steps.
const MAX_CHANGE: f64 = 0.4;
/// The least step, in mean steps: frames stay in order.
const MIN_STEP: f64 = 0.05;
/// Damping of each setting, in shares of the median information about one. A scene at one distance determines none.
const DAMPING: f64 = 1e-3;
/// Bands of the image, each left out once to estimate the errors of the settings.
const BANDS: usize = 8;
/// The largest blur of the sharper frame of a pair that counts, px² of the level.
const MAX_SHARPER_BLUR: f64 = 2.0;
/// The largest distance of the sharper frame of a pair from focus, in mean steps. The larger of both limits counts.
const MAX_SHARPER_STEPS: f64 = 1.5;

/// The settings of an uneven sweep, the first at 0; `None` if it may be even.
///
/// `frames` are on the reference's pixels, on the level where the sweep starts. If they say that it is uneven, the
/// frames of the next `finer` level decide, if there is one: they are much more certain.
pub(super) fn uneven_settings<E>(
    frames: &[Field],
    settings: &[f64],
    rate: f64,
    finer: impl FnOnce() -> Result<Option<Vec<Field>>, E>,
) -> Result<Option<Vec<f64>>, E> {
    let estimate = Estimate::new(frames, settings, rate, ROUNDS[0]);
    if !estimate.is_uneven() {
        return Ok(None);
    }
    let estimate = match finer()? {
        Some(frames) => Estimate::new(&frames, &estimate.settings, 4.0 * rate, ROUNDS[1]),
        None => Estimate::new(frames, &estimate.settings, rate, ROUNDS[1]),
    };
    Ok(estimate.adopted())
}

/// A step that differs from the others by less counts as equal. Steps of even sweeps, simulated, generated and
/// photographed, were found 0.82 to 1.2 times the median; where a frame was left out, 1.8 to 2.5 times.
const TOLERANCE: f64 = 0.35;
/// The largest standard error of a step, in median steps, at which the estimate is adopted.
const MAX_ERROR: f64 = 0.1;
/// The least share of a step that the frames determine, and not the damping: a hundredth of the median information. A
/// step beyond the scene, where nothing is near focus, would else be found as it was assumed, by all bands alike.
const LEAST_DETERMINED: f64 = 0.9;
/// The least step, in median steps, at which the estimate is adopted. A frame that was shaken is more blurred than any
/// setting between its neighbours' explains, and seems to lie beside one of them: 0.05 to 0.07.
const LEAST_STEP: f64 = 0.1;
/// The least growth of steps, in median steps, and in standard errors.
const GROWTH: f64 = 0.25;
const CERTAIN: f64 = 4.0;
/// Fewer steps do not determine which of them is the odd one.
const MIN_STEPS: usize = 3;

/// Estimated settings, and the standard error of each step from one to the next.
struct Estimate {
    settings: Vec<f64>,
    errors: Vec<f64>,
}

impl Estimate {
    /// Estimates the settings of frames on the reference's pixels, from those that are assumed.
    fn new(frames: &[Field], assumed: &[f64], rate: f64, rounds: usize) -> Self {
        let images = workers::map(frames.len(), |n| start::band_passed(&frames[n]));
        let stacks = BlurStacks::new(&images);
        let mut estimate = Self { settings: assumed.to_vec(), errors: Vec::new() };
        for _ in 0..rounds {
            let focus = stacks.focus(&estimate.settings, rate);
            for _ in 0..STEPS {
                let settings = &estimate.settings;
                let steps =
                    Steps::from_bands(&Linearization { stacks: &stacks, settings, rate, focus: &focus }.bands());
                estimate.errors = steps.errors;
                step(&mut estimate.settings, &steps.change);
            }
        }
        estimate
    }

    fn steps(&self) -> impl Iterator<Item = f64> {
        self.settings.windows(2).map(|p| p[1] - p[0])
    }

    fn median(&self) -> f64 {
        let mut sorted: Vec<f64> = self.steps().collect();
        sorted.sort_by(f64::total_cmp);
        sorted[(sorted.len() - 1) / 2]
    }

    /// Whether a step differs from the others, or steps grow.
    fn is_uneven(&self) -> bool {
        let steps: Vec<f64> = self.steps().collect();
        self.errors.len() >= MIN_STEPS && are_uneven(&steps, self.median())
    }

    /// The steps but those at either end that are not certain: beyond the scene nothing comes into focus.
    fn certain(&self) -> Option<std::ops::Range<usize>> {
        let most = MAX_ERROR * self.median();
        let first = self.errors.iter().position(|error| *error <= most)?;
        let last = self.errors.iter().rposition(|error| *error <= most)?;
        let certain = first..last + 1;
        (certain.len() >= MIN_STEPS && self.errors[certain.clone()].iter().all(|error| *error <= most))
            .then_some(certain)
    }

    /// Settings from 0 on if the estimate is certain and uneven: in whole steps if frames are missing, else in mean
    /// steps. Steps at the ends that are not certain are taken as the median.
    fn adopted(&self) -> Option<Vec<f64>> {
        let (median, certain) = (self.median(), self.certain()?);
        if self.steps().any(|step| step < LEAST_STEP * median) {
            return None;
        }
        let steps = self.steps().enumerate().map(|(k, step)| if certain.contains(&k) { step } else { median });
        let steps: Vec<f64> = steps.collect();
        if !are_uneven(&steps, median) {
            return None;
        }
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        let steps = whole(&steps, median).unwrap_or_else(|| steps.iter().map(|step| step / mean).collect());
        let mut at = 0.0;
        let sums = steps.iter().map(|step| {
            at += step;
            at
        });
        Some([0.0].into_iter().chain(sums).collect())
    }
}

/// The steps as multiples of one step; `None` if they are not near multiples, if all are single, or if half of them or
/// fewer are, since steps that grow along a sweep are near multiples of its shortest too.
///
/// That one step is fitted to all by their multiples of the median, which is too short where single steps lie between
/// 0.8 and 1 of it: two gaps of the machined part's 13 frames are 2.4 times the median, and 2.2 times the fitted step.
fn whole(steps: &[f64], median: f64) -> Option<Vec<f64>> {
    let multiples = |unit: f64| steps.iter().map(|step| (step / unit).round().max(1.0)).collect::<Vec<_>>();
    let rough = multiples(median);
    let products: f64 = steps.iter().zip(&rough).map(|(step, multiple)| step * multiple).sum();
    let unit = products / rough.iter().map(|multiple| multiple * multiple).sum::<f64>();
    let multiples = multiples(unit);
    let are_near = steps.iter().zip(&multiples).all(|(step, multiple)| (step / unit - multiple).abs() <= TOLERANCE);
    let single = multiples.iter().filter(|multiple| **multiple == 1.0).count();
    (are_near && single < steps.len() && 2 * single > steps.len()).then_some(multiples)
}

/// Whether a step differs from the median, or the last third of them from the first by more than their scatter
/// explains, as of a motor that moves ever faster.
fn are_uneven(steps: &[f64], median: f64) -> bool {
    let (count, third) = (steps.len(), steps.len() / 3);
    let mean = |steps: &[f64]| steps.iter().sum::<f64>() / steps.len() as f64;
    let growth = (mean(&steps[count - third..]) - mean(&steps[..third])).abs();
    let bends = steps.windows(3).map(|s| (s[0] - 2.0 * s[1] + s[2]).powi(2));
    let scatter = (bends.sum::<f64>() / (6 * (count - 2)) as f64).sqrt();
    let grows = growth > (GROWTH * median).max(CERTAIN * scatter * (2.0 / third as f64).sqrt());
    grows || steps.iter().any(|step| (step / median - 1.0).abs() > TOLERANCE)
}

/// Moves the settings, by less than `change` if a step would change too much.
fn step(settings: &mut [f64], change: &DVector<f64>) {
    let mean = (settings[settings.len() - 1] - settings[0]) / (settings.len() - 1) as f64;
    let most = (1..settings.len()).map(|k| (change[k] - change[k - 1]).abs()).fold(0.0, f64::max);
    let share = (MAX_CHANGE * mean / most).min(1.0);
    settings.iter_mut().zip(change).for_each(|(p, by)| *p += share * by);
    for k in 1..settings.len() {
        settings[k] = settings[k].max(settings[k - 1] + MIN_STEP * mean);
    }
}

/// Normal equations of the settings.
#[derive(Clone)]
struct NormalEquations {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl NormalEquations {
    fn zero(frames: usize) -> Self {
        Self { matrix: DMatrix::zeros(frames, frames), right: DVector::zeros(frames) }
    }

    /// The matrix with the first setting held.
    fn held(mut self) -> Self {
        self.matrix.row_mut(0).fill(0.0);
        self.matrix.column_mut(0).fill(0.0);
        (self.matrix[(0, 0)], self.right[0]) = (1.0, 0.0);
        self
    }

    /// The change of the settings, the first held, the others damped; zero if they are not determined.
    fn solve(self, damping: f64) -> DVector<f64> {
        let frames = self.right.len();
        let Self { mut matrix, right } = self.held();
        (1..frames).for_each(|k| matrix[(k, k)] += damping);
        matrix.cholesky().map_or_else(|| DVector::zeros(frames), |cholesky| cholesky.solve(&right))
    }

    /// The share of the step from setting k to the next that would be found of an error of it.
    fn determined(&self, k: usize, damping: f64) -> f64 {
        let held = self.clone().held();
        let mut error = DVector::zeros(self.right.len());
        (error[k], error[k + 1]) = (if k == 0 { 0.0 } else { -1.0 }, 1.0);
        let found = Self { right: &held.matrix * &error, ..held }.solve(damping);
        found.dot(&error) / error.norm_squared()
    }
}

/// The change of the settings, and the standard error of each step from one to the next.
struct Steps {
    change: DVector<f64>,
    errors: Vec<f64>,
}

impl Steps {
    /// The change from all bands, and its errors from leaving out one at a time.
    fn from_bands(bands: &[NormalEquations]) -> Self {
        let frames = bands[0].right.len();
        let without = |left_out: Option<usize>| {
            let others = bands.iter().enumerate().filter(|(n, _)| Some(*n) != left_out);
            others.fold(NormalEquations::zero(frames), |sum, (_, band)| NormalEquations {
                matrix: sum.matrix + &band.matrix,
                right: sum.right + &band.right,
            })
        };
        let all = without(None);
        let mut information: Vec<f64> = all.matrix.diagonal().iter().copied().collect();
        information.sort_by(f64::total_cmp);
        let damping = DAMPING * information[frames / 2] + f64::MIN_POSITIVE;
        let change = all.clone().solve(damping);
        let each: Vec<DVector<f64>> = (0..bands.len()).map(|n| without(Some(n)).solve(damping)).collect();
        let count = bands.len() as f64;
        let error = |k: usize| {
            let steps: Vec<f64> = each.iter().map(|change| change[k + 1] - change[k]).collect();
            let mean = steps.iter().sum::<f64>() / count;
            let square = (count - 1.0) / count * steps.iter().map(|step| (step - mean).powi(2)).sum::<f64>();
            if all.determined(k, damping) < LEAST_DETERMINED { f64::INFINITY } else { square.sqrt() }
        };
        Self { errors: (0..frames - 1).map(error).collect(), change }
    }
}

/// Settings and u before a step.
struct Linearization<'a> {
    stacks: &'a BlurStacks,
    settings: &'a [f64],
    rate: f64,
    focus: &'a Field,
}

/// The sums of all pairs over a band: the normal equations before u is eliminated, and D, b and, by frame, Σ w S_u S_p.
struct BandSums {
    normal: NormalEquations,
    fields: Vec<Vec<f64>>,
}

impl Linearization<'_> {
    /// The normal equations of each band.
    fn bands(&self) -> Vec<NormalEquations> {
        let (width, height, frames) = (self.focus.width, self.focus.height, self.settings.len());
        let rows = |band: usize| band * height / BANDS..(band + 1) * height / BANDS;
        let of_stride = |s: &usize| (0..frames.saturating_sub(*s)).map(|i| [i, i + s]).collect::<Vec<_>>();
        let pairs: Vec<[usize; 2]> = STRIDES.iter().flat_map(of_stride).collect();
        let sums = workers::map(BANDS, |band| self.sum_band(&pairs, rows(band)));
        let whole = |n: usize| Field {
            data: sums.iter().flat_map(|band| band.fields[n].iter().copied()).collect(),
            ..Field::zeros(width, height)
        };
        let fields = workers::map(frames + 2, |n| smoothed(&whole(n), WINDOWS[1]));
        let floor = 1e-3 * fields[0].data.iter().sum::<f64>() / (width * height) as f64 + f64::MIN_POSITIVE;
        let normals: Vec<NormalEquations> = sums.into_iter().map(|band| band.normal).collect();
        workers::map(BANDS, |band| {
            let mut normal = normals[band].clone();
            let mut by_frame = DVector::zeros(frames);
            for i in rows(band).flat_map(|y| y * width..(y + 1) * width) {
                let over = 1.0 / (fields[0].data[i] + floor);
                by_frame.iter_mut().zip(&fields[2..]).for_each(|(by_frame, field)| *by_frame = field.data[i]);
                normal.matrix.ger(-over, &by_frame, &by_frame, 1.0);
                normal.right.axpy(-over * fields[1].data[i], &by_frame, 1.0);
            }
            normal
        })
    }

    fn sum_band(&self, pairs: &[[usize; 2]], rows: std::ops::Range<usize>) -> BandSums {
        let (width, frames, first) = (self.focus.width, self.settings.len(), rows.start);
        let fields = vec![vec![0.0; width * rows.len()]; frames + 2];
        let mut sums = BandSums { normal: NormalEquations::zero(frames), fields };
        let step = MAX_SHARPER_STEPS * (self.settings[frames - 1] - self.settings[0]) / (frames - 1) as f64;
        let max_blur = MAX_SHARPER_BLUR.max(self.rate * step * step);
        for &[i, j] in pairs {
            let BandSums { normal: NormalEquations { matrix, right }, fields } = &mut sums;
            let Ok([d, b, of_i, of_j]) = fields.get_disjoint_mut([0, 1, 2 + i, 2 + j]) else { continue };
            // The entries of the pair stay in registers, and are added to in the order of the pixels.
            let (mut right_i, mut right_j) = (right[i], right[j]);
            let (mut ii, mut ij, mut ji, mut jj) = (matrix[(i, i)], matrix[(i, j)], matrix[(j, i)], matrix[(j, j)]);
            for y in rows.clone() {
                for x in 0..width {
                    let Some(terms) = self.terms([i, j], [x, y], max_blur) else { continue };
                    let Terms { s, w, by_u, by_settings: [by_i, by_j] } = terms;
                    let at = (y - first) * width + x;
                    d[at] += w * by_u * by_u;
                    b[at] -= w * s * by_u;
                    of_i[at] += w * by_u * by_i;
                    of_j[at] += w * by_u * by_j;
                    right_i -= w * s * by_i;
                    right_j -= w * s * by_j;
                    ii += w * by_i * by_i;
                    ij += w * by_i * by_j;
                    ji += w * by_j * by_i;
                    jj += w * by_j * by_j;
                }
            }
            (right[i], right[j]) = (right_i, right_j);
            (matrix[(i, i)], matrix[(i, j)], matrix[(j, i)], matrix[(j, j)]) = (ii, ij, ji, jj);
        }
        sums
    }

    /// The terms of a pair at a pixel; `None` if it does not count there.
    #[inline]
    fn terms(&self, [i, j]: [usize; 2], [x, y]: [usize; 2], max_blur: f64) -> Option<Terms> {
        let (width, height) = (self.focus.width, self.focus.height);
        let u = self.focus.get(x, y);
        let distance = |k: usize| self.settings[k] - u;
        let is_first_sharper = distance(i).abs() <= distance(j).abs();
        let [sharper, other] = if is_first_sharper { [i, j] } else { [j, i] };
        let blur = self.rate * distance(sharper).powi(2);
        let v = self.rate * distance(other).powi(2) - blur;
        let from_border = x.min(y).min(width - 1 - x).min(height - 1 - y) as f64;
        if !(v > 0.0 && v < MAX_RELATIVE_BLUR && blur < max_blur && from_border > 2.0 * v.sqrt() + 3.0) {
            return None;
        }
        let (value, slope) = self.stacks.read(sharper, v, y * width + x);
        let difference = value - self.stacks.sharp(other, y * width + x);
        let f = NOISE_CORRELATION;
        let (n, n_by_v) = (1.0 + f / (f + v), -f / (f + v).powi(2));
        let (s, s_by_v) = (difference / n.sqrt(), (slope - 0.5 * difference * n_by_v / n) / n.sqrt());
        let by = |k: usize| 2.0 * self.rate * distance(k) * s_by_v;
        let (by_sharper, by_other) = (by(sharper), by(other));
        Some(Terms {
            s,
            w: 1.0 / (s * s + ETA * ETA).sqrt(),
            by_u: by_sharper - by_other,
            by_settings: if is_first_sharper { [-by_sharper, by_other] } else { [by_other, -by_sharper] },
        })
    }
}

/// S of a pair at a pixel, its weight, and its derivatives by u and by the settings of both frames.
struct Terms {
    s: f64,
    w: f64,
    by_u: f64,
    by_settings: [f64; 2],
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Decode;
    use crate::lab::scene::{Preset, Scene, SweepScene};

    fn adopted(settings: &[f64], error: f64) -> Option<Vec<f64>> {
        Estimate { settings: settings.to_vec(), errors: vec![error; settings.len() - 1] }.adopted()
    }

    /// px² a squared step.
    const RATE: f64 = 0.4;

    /// A sweep over a relief, with some of its frames left out.
    fn frames_of_relief(frames: usize, left_out: &[usize]) -> Vec<Field> {
        let scene = Scene { width: 72, height: 56, noise: 0.003, ..Preset::Relief.scene() };
        let sweep = SweepScene { blur_rate: RATE, ..SweepScene::new(scene, frames) }.render().unwrap();
        let field = |n: usize| Field::from_f32(72, 56, &sweep.frames[n].intensities(Decode::None));
        (0..frames).filter(|n| !left_out.contains(n)).map(field).collect()
    }

    /// The settings found for it.
    fn found(frames: usize, left_out: &[usize]) -> Option<Vec<f64>> {
        found_for(&frames_of_relief(frames, left_out))
    }

    fn found_for(fields: &[Field]) -> Option<Vec<f64>> {
        let settings: Vec<f64> = (0..fields.len()).map(|n| n as f64).collect();
        uneven_settings(fields, &settings, RATE, || Ok::<_, ()>(None)).unwrap()
    }

    #[test]
    fn sums_of_a_band_are_those_of_its_pixels_in_order_to_the_bit() {
        let images: Vec<Field> = frames_of_relief(5, &[]).iter().map(start::band_passed).collect();
        let (stacks, settings) = (BlurStacks::new(&images), [0.0, 1.0, 2.1, 2.9, 4.0]);
        let focus = stacks.focus(&settings, RATE);
        let linearization = Linearization { stacks: &stacks, settings: &settings, rate: RATE, focus: &focus };
        let (pairs, rows) = ([[0, 1], [1, 2], [2, 3], [3, 4], [0, 2], [1, 3], [2, 4], [0, 4]], 14..42);
        let sums = linearization.sum_band(&pairs, rows.clone());
        let (mut matrix, mut right) = (DMatrix::<f64>::zeros(5, 5), DVector::<f64>::zeros(5));
        let mut fields = vec![vec![0.0; 72 * rows.len()]; 7];
        let (mut first_is_sharper, mut second_is_sharper) = (0, 0);
        for pair in pairs {
            for (at, (y, x)) in rows.clone().flat_map(|y| (0..72).map(move |x| (y, x))).enumerate() {
                let Some(terms) = linearization.terms(pair, [x, y], MAX_SHARPER_BLUR) else { continue };
                let Terms { s, w, by_u, by_settings } = terms;
                *if by_settings[0] * by_u <= 0.0 { &mut first_is_sharper } else { &mut second_is_sharper } += 1;
                fields[0][at] += w * by_u * by_u;
                fields[1][at] -= w * s * by_u;
                for (k, by_k) in pair.into_iter().zip(by_settings) {
                    fields[2 + k][at] += w * by_u * by_k;
                    right[k] -= w * s * by_k;
                    pair.iter().zip(by_settings).for_each(|(l, by_l)| matrix[(k, *l)] += w * by_k * by_l);
                }
            }
        }
        assert!(first_is_sharper > 100 && second_is_sharper > 100, "{first_is_sharper} {second_is_sharper}");
        assert!(sums.normal.matrix == matrix && sums.normal.right == right && sums.fields == fields);
    }

    #[test]
    fn missing_frames_leave_gaps() {
        assert_eq!(found(7, &[]), None);
        assert_eq!(found(9, &[2, 5, 6]), Some(vec![0.0, 1.0, 3.0, 4.0, 7.0, 8.0]));
    }

    #[test]
    fn a_shaken_frame_leaves_even_steps() {
        for shaken in [2, 4, 7] {
            let mut fields = frames_of_relief(9, &[]);
            let sharp = fields[shaken].clone();
            let at =
                |x: usize, y: usize| (0..9).map(|n| sharp.clamped(x as isize + n - 4, y as isize)).sum::<f64>() / 9.0;
            fields[shaken] = Field::from_fn(sharp.width, sharp.height, at);
            assert_eq!(found_for(&fields), None, "{shaken}");
        }
    }

    /// Frames that are added beyond the scene, where none of it comes into focus.
    #[test]
    fn steps_beyond_the_scene_are_not_certain() {
        for (preset, seed) in [(Preset::Relief, 1), (Preset::Plane, 2), (Preset::Steps, 3)] {
            let scene = Scene { width: 96, height: 72, noise: 0.003, seed, ..preset.scene() };
            let sweep =
                SweepScene { blur_rate: 1.2, span: [0.05, 0.5], ..SweepScene::new(scene, 12) }.render().unwrap();
            let field = |n: usize| Field::from_f32(96, 72, &sweep.frames[n].intensities(Decode::None));
            let fields: Vec<Field> = (0..12).filter(|n| *n != 3).map(field).collect();
            let settings: Vec<f64> = (0..11).map(f64::from).collect();
            let rate = start::rate(&fields, &settings);
            let estimate = Estimate::new(&fields, &settings, rate, ROUNDS[1]);
            let median = estimate.median();
            assert!(
                estimate.errors[9] > MAX_ERROR * median,
                "{preset:?}: {:?} {:?}",
                estimate.settings,
                estimate.errors
            );
            assert!(
                estimate.errors[2] < MAX_ERROR * median,
                "{preset:?}: {:?} {:?}",
                estimate.settings,
                estimate.errors
            );
        }
    }

    #[test]
    fn settings_are_even_or_whole_steps_or_as_found() {
        assert_eq!(adopted(&[0.0, 0.8, 1.8, 3.0, 4.1], 0.02), None);
        assert_eq!(adopted(&[0.0, 0.5, 1.5, 2.0, 2.5], 0.02), Some(vec![0.0, 1.0, 3.0, 4.0, 5.0]));
        assert_eq!(adopted(&[0.0, 1.0, 4.1, 5.2, 6.1, 8.0], 0.02), Some(vec![0.0, 1.0, 4.0, 5.0, 6.0, 8.0]));
        // Gaps that are found too wide: of a photographed sweep that lacks the frame at 4.
        let photographed = [0.0, 0.81, 1.68, 2.58, 4.56, 5.37, 6.17];
        assert_eq!(adopted(&photographed, 0.02), Some(vec![0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0]));
        // A step that differs, but is no gap.
        let longer = adopted(&[0.0, 1.0, 2.0, 3.0, 4.4], 0.02).unwrap();
        assert!(longer.iter().zip([0.0, 1.0, 2.0, 3.0, 4.4]).all(|(a, b)| (a - b / 1.1).abs() < 1e-9), "{longer:?}");
        // Steps that grow are not whole ones, though they are near multiples of the first.
        let growing = adopted(&[0.0, 0.55, 1.14, 2.32, 3.05, 4.23, 6.0], 0.02).unwrap();
        assert!(growing.iter().zip([0.0, 0.55, 1.14, 2.32, 3.05, 4.23, 6.0]).all(|(a, b)| (a - b).abs() < 1e-9));
        let uneven = adopted(&[0.0, 0.5, 1.3, 2.5, 4.0], 0.02).unwrap();
        assert!(uneven.iter().zip([0.0, 0.5, 1.3, 2.5, 4.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{uneven:?}");
        // Steps at the ends are left even where they are not certain; others must be.
        let uncertain = |which: &[usize]| {
            let errors = (0..6).map(|k| if which.contains(&k) { f64::INFINITY } else { 0.02 }).collect();
            Estimate { settings: vec![0.0, 2.3, 3.3, 4.3, 6.3, 7.3, 7.7], errors }.adopted()
        };
        assert_eq!(uncertain(&[0, 5]), Some(vec![0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0]));
        assert_eq!([&[0, 3, 4, 5][..], &[2], &[0, 1, 4, 5]].map(uncertain), [None, None, None]);
        // Too few, or not certain.
        assert_eq!((adopted(&[0.0, 1.0, 3.0], 0.02), adopted(&[0.0, 1.0, 3.0, 4.0, 5.0], 0.2)), (None, None));
    }
}
