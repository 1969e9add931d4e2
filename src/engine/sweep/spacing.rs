//! How far apart the frames of a sweep are focused, by the sweep itself, on the level where it starts: frames may be missing, or have been taken
//! at uneven steps.
//!
//! What a pair says of V hangs on the settings of both its frames: `V = c ((p_j - u)² - (p_i - u)²)`. So they are unknowns as c is, one a frame,
//! and steps of Gauss and Newton find them, u eliminated pixel by pixel over a window. That c is known as if they were even does no harm: it
//! scales all steps alike.

use nalgebra::{DMatrix, DVector};

use super::start::{self, Blurred, GRAIN, WINDOWS};
use crate::base::workers;
use crate::engine::stages::Field;

/// How many frames the two of a pair are apart: more pairs than the joint solve asks, since here each tells of single steps. With its own alone a step
/// of the heat sink's seven frames comes out three times as long as with these.
const STRIDES: [usize; 8] = [1, 2, 3, 4, 6, 8, 12, 16];
/// η of the data term, as of the joint solve.
const ETA: f64 = 0.005;
/// Times that u is found anew, on the coarser level, which need only say whether there is anything to look at, and on the finer; and steps of the
/// settings in between.
const ROUNDS: [usize; 2] = [1, 3];
const STEPS: usize = 3;
/// The largest change of a step, of the mean step.
const LARGEST: f64 = 0.4;
/// The least that a step may become, of the mean step: frames stay in order.
const LEAST: f64 = 0.05;
/// Each setting is held where it is by so much of what is told of one in the median: of what stands all at one distance nothing is told.
const HELD: f64 = 1e-3;
/// Bands of the level, each left out once, by which the settings' errors are judged.
const BANDS: usize = 8;

/// Blur of the sharper frame up to which a pair is asked, px² of the level; in steps, of frames that are farther apart.
const FAR: f64 = 2.0;
const FAR_STEPS: f64 = 1.5;

/// Settings of a sweep that is not even, the first at 0; `None` where it may be. By the frames on the reference's pixels of the level where the
/// sweep starts; where these say so, by those of the next `finer` one, if there is one, which are surer by much.
pub(super) fn uneven<E>(
    frames: &[Field],
    settings: &[f64],
    rate: f64,
    finer: impl FnOnce() -> Result<Option<Vec<Field>>, E>,
) -> Result<Option<Vec<f64>>, E> {
    let found = spacing(frames, settings, rate, ROUNDS[0]);
    if !found.is_odd() {
        return Ok(None);
    }
    let surer = match finer()? {
        Some(frames) => spacing(&frames, &found.settings, 4.0 * rate, ROUNDS[1]),
        None => spacing(frames, &found.settings, rate, ROUNDS[1]),
    };
    Ok(surer.counted())
}

/// Settings as the sweep tells them, and the standard error of each step.
struct Spacing {
    settings: Vec<f64>,
    errors: Vec<f64>,
}

/// The settings of frames on the reference's pixels, from where they are taken to be.
fn spacing(frames: &[Field], settings: &[f64], rate: f64, rounds: usize) -> Spacing {
    let images = workers::collect(frames.len(), |n| start::band_passed(&frames[n]));
    let blurred = Blurred::new(&images);
    let mut found = Spacing { settings: settings.to_vec(), errors: Vec::new() };
    for _ in 0..rounds {
        let focus = blurred.focus(&found.settings, rate);
        for _ in 0..STEPS {
            let bands = Asked { blurred: &blurred, settings: &found.settings, rate, focus: &focus }.bands();
            let steps = Steps::of(&bands);
            found.errors = steps.errors;
            step(&mut found.settings, &steps.change);
        }
    }
    found
}

/// Moves settings, less far where a step would change by much.
fn step(settings: &mut [f64], change: &DVector<f64>) {
    let mean = (settings[settings.len() - 1] - settings[0]) / (settings.len() - 1) as f64;
    let most = (1..settings.len()).map(|k| (change[k] - change[k - 1]).abs()).fold(0.0, f64::max);
    let share = (LARGEST * mean / most).min(1.0);
    settings.iter_mut().zip(change).for_each(|(p, by)| *p += share * by);
    for k in 1..settings.len() {
        settings[k] = settings[k].max(settings[k - 1] + LEAST * mean);
    }
}

/// Normal equations of the settings.
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    fn zero(frames: usize) -> Self {
        Self { matrix: DMatrix::zeros(frames, frames), right: DVector::zeros(frames) }
    }

    /// The change of the settings, the first held, each by so much; none where nothing tells.
    fn solved(mut self, held: f64) -> DVector<f64> {
        let frames = self.right.len();
        (0..frames).for_each(|k| self.matrix[(k, k)] += held);
        self.matrix.row_mut(0).fill(0.0);
        self.matrix.column_mut(0).fill(0.0);
        (self.matrix[(0, 0)], self.right[0]) = (1.0, 0.0);
        self.matrix.cholesky().map_or_else(|| DVector::zeros(frames), |cholesky| cholesky.solve(&self.right))
    }
}

/// The change of the settings, and the standard error of each step from one to the next.
struct Steps {
    change: DVector<f64>,
    errors: Vec<f64>,
}

impl Steps {
    /// By all bands; the errors by leaving out one at a time.
    fn of(bands: &[Normal]) -> Self {
        let frames = bands[0].right.len();
        let without = |left_out: Option<usize>| {
            let kept = bands.iter().enumerate().filter(|(n, _)| Some(*n) != left_out);
            kept.fold(Normal::zero(frames), |sum, (_, band)| Normal {
                matrix: sum.matrix + &band.matrix,
                right: sum.right + &band.right,
            })
        };
        let all = without(None);
        let mut told: Vec<f64> = all.matrix.diagonal().iter().copied().collect();
        told.sort_by(f64::total_cmp);
        let held = HELD * told[frames / 2] + f64::MIN_POSITIVE;
        let change = all.solved(held);
        let each: Vec<DVector<f64>> = (0..bands.len()).map(|n| without(Some(n)).solved(held)).collect();
        let count = bands.len() as f64;
        let error = |k: usize| {
            let steps: Vec<f64> = each.iter().map(|change| change[k + 1] - change[k]).collect();
            let mean = steps.iter().sum::<f64>() / count;
            ((count - 1.0) / count * steps.iter().map(|step| (step - mean).powi(2)).sum::<f64>()).sqrt()
        };
        Self { errors: (0..frames - 1).map(error).collect(), change }
    }
}

/// Where settings and u are before a step.
struct Asked<'a> {
    blurred: &'a Blurred,
    settings: &'a [f64],
    rate: f64,
    focus: &'a Field,
}

/// What the pairs say of a band: its normal equations before u is eliminated, and D, b and, by frame, Σ w S_u S_p.
struct Said {
    normal: Normal,
    fields: Vec<Vec<f64>>,
}

impl Asked<'_> {
    /// The normal equations of each band.
    fn bands(&self) -> Vec<Normal> {
        let (width, height, frames) = (self.focus.width, self.focus.height, self.settings.len());
        let rows = |band: usize| band * height / BANDS..(band + 1) * height / BANDS;
        let of_stride = |s: &usize| (0..frames.saturating_sub(*s)).map(|i| [i, i + s]).collect::<Vec<_>>();
        let pairs: Vec<[usize; 2]> = STRIDES.iter().flat_map(of_stride).collect();
        let said = workers::collect(BANDS, |band| self.said(&pairs, rows(band)));
        let whole = |n: usize| Field {
            data: said.iter().flat_map(|said| said.fields[n].iter().copied()).collect(),
            ..Field::zeros(width, height)
        };
        let fields = workers::collect(frames + 2, |n| start::smoothed(&whole(n), WINDOWS[1]));
        let floor = 1e-3 * fields[0].data.iter().sum::<f64>() / (width * height) as f64 + f64::MIN_POSITIVE;
        let normals: Vec<Normal> = said.into_iter().map(|said| said.normal).collect();
        workers::collect(BANDS, |band| {
            let mut normal = Normal { matrix: normals[band].matrix.clone(), right: normals[band].right.clone() };
            for i in rows(band).flat_map(|y| y * width..(y + 1) * width) {
                let over = 1.0 / (fields[0].data[i] + floor);
                let by_frame = DVector::from_iterator(frames, fields[2..].iter().map(|field| field.data[i]));
                normal.matrix.ger(-over, &by_frame, &by_frame, 1.0);
                normal.right.axpy(-over * fields[1].data[i], &by_frame, 1.0);
            }
            normal
        })
    }

    fn said(&self, pairs: &[[usize; 2]], rows: std::ops::Range<usize>) -> Said {
        let (width, frames, first) = (self.focus.width, self.settings.len(), rows.start);
        let mut said = Said { normal: Normal::zero(frames), fields: vec![vec![0.0; width * rows.len()]; frames + 2] };
        let step = FAR_STEPS * (self.settings[frames - 1] - self.settings[0]) / (frames - 1) as f64;
        let far = FAR.max(self.rate * step * step);
        for pair in pairs {
            for (y, x) in rows.clone().flat_map(|y| (0..width).map(move |x| (y, x))) {
                let Some(told) = self.told(*pair, [x, y], far) else { continue };
                let Told { s, w, by_u, by } = told;
                let at = (y - first) * width + x;
                said.fields[0][at] += w * by_u * by_u;
                said.fields[1][at] -= w * s * by_u;
                for (k, by_k) in by {
                    said.fields[2 + k][at] += w * by_u * by_k;
                    said.normal.right[k] -= w * s * by_k;
                    by.iter().for_each(|(l, by_l)| said.normal.matrix[(k, *l)] += w * by_k * by_l);
                }
            }
        }
        said
    }

    /// What a pair says of a pixel; `None` where it says nothing.
    fn told(&self, [i, j]: [usize; 2], [x, y]: [usize; 2], far: f64) -> Option<Told> {
        let (width, height) = (self.focus.width, self.focus.height);
        let u = self.focus.get(x, y);
        let away = |k: usize| self.settings[k] - u;
        let [own, other] = if away(i).abs() <= away(j).abs() { [i, j] } else { [j, i] };
        let before = self.rate * away(own).powi(2);
        let v = self.rate * away(other).powi(2) - before;
        let from_border = x.min(y).min(width - 1 - x).min(height - 1 - y) as f64;
        if !(v > 0.0 && v < super::LIMIT && before < far && from_border > 2.0 * v.sqrt() + 3.0) {
            return None;
        }
        let (value, slope) = self.blurred.read(own, v, y * width + x);
        let left = value - self.blurred.sharp(other, y * width + x);
        let (n, by_v) = (1.0 + GRAIN / (GRAIN + v), -GRAIN / (GRAIN + v).powi(2));
        let (s, s_v) = (left / n.sqrt(), (slope - 0.5 * left * by_v / n) / n.sqrt());
        let by = |k: usize| 2.0 * self.rate * away(k) * s_v;
        Some(Told { s, w: 1.0 / s.hypot(ETA), by_u: by(own) - by(other), by: [(own, -by(own)), (other, by(other))] })
    }
}

/// S of a pair at a pixel, its weight, its slope by u, and by the settings of both frames.
struct Told {
    s: f64,
    w: f64,
    by_u: f64,
    by: [(usize, f64); 2],
}

/// A step that is off the others by less than this is as they are. Of even sweeps, simulated, generated and photographed, steps were found
/// 0.82 to 1.2 times the median; where one of their frames was left out 1.8 to 2.5 times (`docs/experiments/focus-sweeps.md`).
const TOLERANCE: f64 = 0.35;
/// The largest standard error of a step, of the median step, at which anything is said.
const CERTAIN: f64 = 0.1;
/// Fewer steps cannot tell which of them is the odd one.
const FEWEST: usize = 3;

impl Spacing {
    fn steps(&self) -> impl Iterator<Item = f64> {
        self.settings.windows(2).map(|p| p[1] - p[0])
    }

    fn median(&self) -> f64 {
        let mut sorted: Vec<f64> = self.steps().collect();
        sorted.sort_by(f64::total_cmp);
        sorted[(sorted.len() - 1) / 2]
    }

    /// Whether any step is not as the others are.
    fn is_odd(&self) -> bool {
        let median = self.median();
        self.errors.len() >= FEWEST && self.steps().any(|step| (step / median - 1.0).abs() > TOLERANCE)
    }

    /// From 0 on, where that is certain and not even: in whole steps, if all are about so many times the median step; else in mean steps.
    fn counted(&self) -> Option<Vec<f64>> {
        let median = self.median();
        if !self.is_odd() || self.errors.iter().any(|error| *error > CERTAIN * median) {
            return None;
        }
        let whole = |step: f64| (step / median).round().max(1.0);
        let are_whole = self.steps().all(|step| (step / median - whole(step)).abs() <= TOLERANCE);
        let mean = self.steps().sum::<f64>() / self.errors.len() as f64;
        let mut at = 0.0;
        let sums = self.steps().map(|step| {
            at += if are_whole { whole(step) } else { step / mean };
            at
        });
        Some([0.0].into_iter().chain(sums).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Decode;
    use crate::lab::scene::{Preset, Scene, SweepScene};

    fn of(settings: &[f64], error: f64) -> Option<Vec<f64>> {
        Spacing { settings: settings.to_vec(), errors: vec![error; settings.len() - 1] }.counted()
    }

    /// px² a squared step.
    const RATE: f64 = 0.4;

    /// A relief in so many frames, some of them left out, as it is found.
    fn found(frames: usize, left_out: &[usize]) -> Option<Vec<f64>> {
        let scene = Scene { width: 72, height: 56, noise: 0.003, ..Preset::Relief.scene() };
        let sweep = SweepScene { blur_rate: RATE, ..SweepScene::new(scene, frames) }.render().unwrap();
        let field = |n: usize| Field::from_f32(72, 56, &sweep.frames[n].intensities(Decode::None));
        let fields: Vec<Field> = (0..frames).filter(|n| !left_out.contains(n)).map(field).collect();
        let settings: Vec<f64> = (0..fields.len()).map(|n| n as f64).collect();
        uneven(&fields, &settings, RATE, || Ok::<_, ()>(None)).unwrap()
    }

    #[test]
    fn frames_that_are_missing_leave_gaps() {
        assert_eq!(found(7, &[]), None);
        assert_eq!(found(9, &[2, 5, 6]), Some(vec![0.0, 1.0, 3.0, 4.0, 7.0, 8.0]));
    }

    #[test]
    fn steps_are_even_or_whole_or_as_they_are_found() {
        assert_eq!(of(&[0.0, 0.8, 1.8, 3.0, 4.1], 0.02), None);
        assert_eq!(of(&[0.0, 0.5, 1.5, 2.0, 2.5], 0.02), Some(vec![0.0, 1.0, 3.0, 4.0, 5.0]));
        assert_eq!(of(&[0.0, 1.0, 4.1, 5.2, 6.1, 8.0], 0.02), Some(vec![0.0, 1.0, 4.0, 5.0, 6.0, 8.0]));
        let uneven = of(&[0.0, 0.5, 1.3, 2.5, 4.0], 0.02).unwrap();
        assert!(uneven.iter().zip([0.0, 0.5, 1.3, 2.5, 4.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{uneven:?}");
        // Too few, or not certain.
        assert_eq!((of(&[0.0, 1.0, 3.0], 0.02), of(&[0.0, 1.0, 3.0, 4.0, 5.0], 0.2)), (None, None));
    }
}
