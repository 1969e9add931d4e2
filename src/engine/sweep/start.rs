//! The start of a sweep, on the host, on a coarse level.
//!
//! The registration comes from appearance, c from an exhaustive search, and u from the minimum of a volume of energies.

use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::pairs;
use super::validity::mapped;
use crate::base::{Homography, Shading, brightness, workers};
use crate::engine::filter;
use crate::engine::plan::{LOW_PASS, Level, band};
use crate::engine::stages::separable::{filtered, smoothed};
use crate::engine::stages::state::from_centre;
use crate::engine::stages::sums::{UNKNOWNS, displacements};
use crate::engine::stages::update_transform::displacing;
use crate::engine::stages::{Field, spline};

/// The frames of a sweep on one level.
pub(in crate::engine) struct Frames {
    pub(in crate::engine) images: Vec<Field>,
    pub(in crate::engine) level: Level,
}

/// f, the variance of the filter that correlates noise: a pixel and the low pass, px².
pub(super) const NOISE_CORRELATION: f64 = LOW_PASS * LOW_PASS + 1.0 / (4.0 * PI);

/// The image after the low pass and the high pass that the device applies.
pub(super) fn band_passed(image: &Field) -> Field {
    let [low, along_x, along_y] = band();
    let mut image = filtered(image, [&low; 2], 1);
    let high = filtered(&image, [&along_x, &along_y], 1);
    image.data.iter_mut().zip(high.data).for_each(|(value, high)| *value += high);
    image
}

/// The coefficients of the spline through an image.
fn coefficients(image: &Field) -> Field {
    let filter = filter::spline_prefilter();
    filtered(image, [&filter; 2], 1)
}

/// How the pixels of the reference are mapped to those of a frame: by T, after what is in focus at u was displaced by u
/// times the parallax, px of the full-size image per setting.
#[derive(Clone, Copy, PartialEq)]
pub(in crate::engine) struct Motion {
    pub(in crate::engine) transform: Homography,
    pub(in crate::engine) parallax: [f64; 2],
}

impl Motion {
    const NONE: Self = Self { transform: Homography::IDENTITY, parallax: [0.0; 2] };

    /// Where a pixel of a level lies in the frame. `focus`: u of all pixels of the level; `None` without parallax.
    fn mapped(&self, level: &Level, [x, y]: [usize; 2], focus: Option<&Field>) -> [f64; 2] {
        let u = focus.map_or(0.0, |focus| focus.get(x, y) / level.factor);
        mapped(&self.transform, level, [x as f64 + u * self.parallax[0], y as f64 + u * self.parallax[1]])
    }
}

/// The frames on the reference's pixels, with its brightness.
pub(in crate::engine) fn resample(
    frames: &Frames,
    motions: &[Motion],
    focus: Option<&Field>,
    brightness: &[(f64, Shading)],
) -> Vec<Field> {
    workers::map(frames.images.len(), |n| {
        let (gain, shading) = brightness[n];
        if (motions[n], gain, shading) == (Motion::NONE, 1.0, Shading::NONE) {
            return frames.images[n].clone();
        }
        let moved = resampled(&coefficients(&frames.images[n]), &motions[n], &frames.level, focus);
        Field::from_fn(moved.width, moved.height, |x, y| {
            let at = from_centre(motions[n].mapped(&frames.level, [x, y], focus), frames.level.centre);
            gain * shading.at(at) * moved.get(x, y)
        })
    })
}

/// A frame on the reference's pixels.
fn resampled(spline: &Field, motion: &Motion, level: &Level, focus: Option<&Field>) -> Field {
    spline::resampled(spline, |at| motion.mapped(level, at, focus))
}

/// σ of the low pass under which neighbouring frames look alike whatever their blur, px of the level.
const APPEARANCE_BLUR: f64 = 1.5;
/// Gauss-Newton steps of a frame's registration by appearance, and again with parallax.
const STEPS: [usize; 2] = [8, 4];
/// The share of the contrast of a frame that the next one does not have, at which another start is tried. Of 9 real sweeps
/// it is 0.01 to 0.2, and 0.5 to 1 where a frame is displaced by 8 % of the width; with steps of 6 px of blur up to 0.8.
const DOUBTFUL: f64 = 0.3;
/// The part of that share that another start must leave to be taken.
const LESS: f64 = 0.7;
/// σ of the low passes of that start, px of the level, which reach as far.
const WIDE: [f64; 2] = [16.0, 6.0];

/// A frame registered to the one before it.
#[derive(Clone, Copy)]
pub(in crate::engine) struct Registered {
    pub(in crate::engine) motion: Motion,
    /// The mean difference that is left.
    pub(in crate::engine) left: f64,
    /// The share of the contrast of the frame before that does not correlate with it.
    pub(in crate::engine) unlike: f64,
    /// The least over the largest power of its gradient in a direction: 0 of stripes.
    pub(in crate::engine) isotropy: f64,
}

/// What the motion of a frame is found with.
pub(in crate::engine) struct Registration<'a> {
    /// The motion of the frames before.
    pub(in crate::engine) start: &'a [Motion],
    /// Unknowns of T.
    pub(in crate::engine) unknowns: usize,
    /// u relative to the middle setting, with which parallax is found too.
    pub(in crate::engine) focus: Option<&'a Field>,
}

/// The coefficients of the frames under the low pass by which they are registered.
pub(in crate::engine) fn appearance(frames: &Frames) -> Frames {
    let spline = |n: usize| coefficients(&smoothed(&frames.images[n], APPEARANCE_BLUR));
    Frames { images: workers::map(frames.images.len(), spline), level: frames.level.clone() }
}

/// The motion of each frame by [`appearance`], each relative to its neighbour, starting at the reference.
pub(in crate::engine) fn register(
    Frames { images: splines, level }: &Frames,
    reference: usize,
    registration: &Registration<'_>,
) -> Vec<Registered> {
    // The two sides of the reference are independent.
    let sides: [Vec<usize>; 2] = [(reference + 1..splines.len()).collect(), (0..reference).rev().collect()];
    let registered = workers::map(2, |n| register_side(splines, reference, &sides[n], level, registration));
    let mut all = vec![Registered { motion: Motion::NONE, left: 0.0, unlike: 0.0, isotropy: 0.0 }; splines.len()];
    sides.iter().flatten().zip(registered.into_iter().flatten()).for_each(|(n, registered)| all[*n] = registered);
    all
}

/// The motion of frames in order, each from the one before it, the first from the reference.
fn register_side(
    splines: &[Field],
    reference: usize,
    frames: &[usize],
    level: &Level,
    registration: &Registration<'_>,
) -> Vec<Registered> {
    let (mut before, mut motion) = (reference, Motion::NONE);
    let next = |&n: &usize| {
        let target = resampled(&splines[before], &motion, level, registration.focus);
        let start = registration.start.get(n).copied().unwrap_or(motion);
        let from = |start| register_frame(&target, &splines[n], start, level, registration);
        let mut registered = from(start);
        // Parallax is found from a registration without it.
        if registered.unlike > DOUBTFUL && registration.focus.is_none() {
            let shift = Registration { unknowns: registration.unknowns.min(2), ..*registration };
            let wide = |start, sigma: &f64| {
                let [target, frame] = [&target, &splines[n]].map(|image| smoothed(image, *sigma));
                register_frame(&target, &frame, start, level, &shift).motion
            };
            let displaced = from(WIDE.iter().fold(start, wide));
            registered = if displaced.unlike < LESS * registered.unlike { displaced } else { registered };
        }
        (before, motion) = (n, registered.motion);
        registered
    };
    frames.iter().map(next).collect()
}

/// A thread adds up the sums of this many rows.
const ROWS: usize = 16;
/// The most unknowns of a frame: T, parallax, gain and offset.
const TERMS: usize = UNKNOWNS + 4;

/// What a step of a frame's registration adds up over pixels.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// On and below the diagonal.
    normal: [[f64; TERMS]; TERMS],
    right: [f64; TERMS],
    left: f64,
    count: f64,
    /// Of the target and the frame, their squares and their product.
    moments: [f64; 5],
}

impl Sums {
    /// Adds a pixel with `count` derivatives of the frame, and the values of target and frame.
    #[inline(always)]
    fn add(&mut self, terms: [f64; TERMS], count: usize, [a, b]: [f64; 2]) {
        let s = b - a;
        if !terms.iter().sum::<f64>().is_finite() {
            return;
        }
        let w = 1.0 / (s * s + 1e-4).sqrt();
        (self.left, self.count) = (self.left + w * s * s, self.count + 1.0);
        self.moments.iter_mut().zip([a, b, a * a, b * b, a * b]).for_each(|(sum, term)| *sum += term);
        for a in 0..count {
            let weighted = w * terms[a];
            self.right[a] -= weighted * s;
            (0..=a).for_each(|b| self.normal[a][b] += weighted * terms[b]);
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            normal: std::array::from_fn(|a| std::array::from_fn(|b| self.normal[a][b] + other.normal[a][b])),
            right: std::array::from_fn(|a| self.right[a] + other.right[a]),
            left: self.left + other.left,
            count: self.count + other.count,
            moments: std::array::from_fn(|n| self.moments[n] + other.moments[n]),
        }
    }
}

/// The motion of a frame that looks like the target, by Gauss-Newton steps, and what differed before the last one.
fn register_frame(
    target: &Field,
    spline: &Field,
    mut motion: Motion,
    level: &Level,
    &Registration { unknowns, focus, .. }: &Registration<'_>,
) -> Registered {
    let length = (target.width as f64).hypot(target.height as f64) / 4.0;
    let all = unknowns + if focus.is_some() { 2 } else { 0 };
    let (mut left, mut unlike, mut isotropy) = (0.0, 0.0, 0.0);
    for _ in 0..STEPS[usize::from(focus.is_some())] {
        let moved = resampled(spline, &motion, level, focus);
        let last = [target.width as f64 - 3.0, target.height as f64 - 3.0];
        let of_rows = |rows: Range<usize>| {
            let mut sums = Sums::default();
            for (y, x) in rows.flat_map(|y| (1..target.width - 1).map(move |x| (y, x))) {
                let [px, py] = motion.mapped(level, [x, y], focus);
                // No pixel where u is unknown is inside.
                if !((2.0..=last[0]).contains(&px) && (2.0..=last[1]).contains(&py)) {
                    continue;
                }
                let gradient = [
                    0.5 * (moved.get(x + 1, y) - moved.get(x - 1, y)),
                    0.5 * (moved.get(x, y + 1) - moved.get(x, y - 1)),
                ];
                let at = [(x as f64 - level.centre[0]) / length, (y as f64 - level.centre[1]) / length];
                let by = displacements(at);
                let u = focus.map_or(0.0, |focus| focus.get(x, y) / level.factor);
                // T, parallax, gain and offset.
                let terms = std::array::from_fn(|a| match (a < unknowns, a.checked_sub(all)) {
                    (true, _) => by[a][0] * gradient[0] + by[a][1] * gradient[1],
                    (_, None) => u * gradient[a - unknowns],
                    (_, Some(0)) => moved.get(x, y),
                    (_, Some(_)) => 1.0,
                });
                sums.add(terms, all + 2, [target.get(x, y), moved.get(x, y)]);
            }
            sums
        };
        let bands = (target.height - 2).div_ceil(ROWS);
        let band = |n: usize| 1 + n * ROWS..(1 + (n + 1) * ROWS).min(target.height - 1);
        let Sums { normal, right, left: sum, count, moments } =
            workers::map(bands, |n| of_rows(band(n))).into_iter().fold(Sums::default(), Sums::plus);
        left = sum / f64::max(count, 1.0);
        let [a, b, aa, bb, ab] = moments;
        let variances = (count * aa - a * a) * (count * bb - b * b);
        unlike = (1.0 - (count * ab - a * b).powi(2) / variances.max(f64::MIN_POSITIVE)).max(0.0).sqrt();
        let [along_x, along_y] = [normal[0][0], normal[1][1]];
        let (mean, by) = (0.5 * (along_x + along_y), (0.5 * (along_x - along_y)).hypot(normal[1][0]));
        isotropy = (mean - by) / (mean + by).max(f64::MIN_POSITIVE);
        let ridge = |a: usize, b: usize| if a == b { normal[a][b] * 1e-9 + 1e-12 } else { 0.0 };
        let matrix = DMatrix::from_fn(all + 2, all + 2, |a, b| normal[a.max(b)][a.min(b)] + ridge(a, b));
        let Some(cholesky) = matrix.cholesky() else { return Registered { motion, left, unlike, isotropy } };
        let step = cholesky.solve(&DVector::from_column_slice(&right[..all + 2]));
        let x: [f64; UNKNOWNS] = std::array::from_fn(|a| if a < unknowns { step[a] } else { 0.0 });
        motion.transform = motion.transform.after(&displacing(length, level.factor, x));
        if focus.is_some() {
            (0..2).for_each(|c| motion.parallax[c] += step[unknowns + c]);
        }
    }
    Registered { motion, left, unlike, isotropy }
}

/// σ of the window over which mean brightness is compared, px of the level: blur moves no light across it.
const BRIGHTNESS_WINDOW: f64 = 4.0;

/// Gain and shading that map each frame to the reference's brightness.
pub(super) fn brightness(frames: &Frames, motions: &[Motion], reference: usize) -> Vec<(f64, Shading)> {
    let means: Vec<Field> = workers::map(frames.images.len(), |n| smoothed(&frames.images[n], BRIGHTNESS_WINDOW));
    workers::map(means.len(), |n| {
        if n == reference {
            return (1.0, Shading::NONE);
        }
        let spline = coefficients(&means[n]);
        let moved = resampled(&spline, &motions[n], &frames.level, None);
        let places = (0..moved.height).step_by(2).flat_map(|y| (0..moved.width).step_by(2).map(move |x| [x, y]));
        let inside =
            |p: &[f64; 2]| p[0] >= 0.0 && p[1] >= 0.0 && p[0] < moved.width as f64 && p[1] < moved.height as f64;
        let samples = places.filter_map(|at| {
            let place = Some(motions[n].mapped(&frames.level, at, None)).filter(inside)?;
            Some((from_centre(place, frames.level.centre), moved.get(at[0], at[1]), means[reference].get(at[0], at[1])))
        });
        fit_brightness(&samples.collect::<Vec<_>>())
    })
}

/// Gain and shading that map the second values of the samples, at their places, to the third; least squares, reweighted
/// by Cauchy's function.
///
/// There is no offset: only contrast tells an offset from a gain, and blur changes contrast. The high pass removes an
/// offset.
fn fit_brightness(samples: &[([f64; 2], f64, f64)]) -> (f64, Shading) {
    const TERMS: usize = Shading::TERMS + 1;
    let (mut fitted, mut scale) = (DVector::<f64>::zeros(TERMS), f64::INFINITY);
    for _ in 0..3 {
        let (mut normal, mut right) = (DMatrix::<f64>::zeros(TERMS, TERMS), DVector::zeros(TERMS));
        let (mut squares, mut weights) = (0.0, 0.0);
        for (place, value, target) in samples {
            let terms = DVector::from_row_slice(&brightness::terms(*place)) * *value;
            let residual = target - terms.dot(&fitted);
            let w = 1.0 / (1.0 + (residual / scale).powi(2));
            squares += w * residual * residual;
            weights += w;
            normal.ger(w, &terms, &terms, 1.0);
            right.axpy(w * target, &terms, 1.0);
        }
        // Keeps terms small that the samples hardly determine.
        let ridge = 1e-4 * normal[(0, 0)];
        (1..TERMS).for_each(|a| normal[(a, a)] += ridge);
        let Some(cholesky) = normal.cholesky() else { break };
        scale = if scale.is_finite() { 2.0 * (squares / weights.max(1.0)).sqrt() + 1e-6 } else { 0.1 };
        fitted = cholesky.solve(&right);
    }
    let gain = fitted[0];
    if !(gain > 0.1 && gain < 10.0) {
        return (1.0, Shading::NONE);
    }
    (gain, Shading { coefficients: std::array::from_fn(|n| fitted[n + 1] / gain) })
}

/// Distance of the nodes of a blur stack, px of σ. Between nodes it is interpolated linearly.
const NODE_STEP: f64 = 0.35;

/// The blur stacks of band-passed frames.
pub(super) struct BlurStacks {
    /// By frame and node.
    nodes: Vec<Vec<Vec<f32>>>,
    size: [usize; 2],
}

impl BlurStacks {
    pub(super) fn new(frames: &[Field]) -> Self {
        let count = (MAX_RELATIVE_BLUR.sqrt() / NODE_STEP).ceil() as usize + 1;
        let nodes = workers::map(frames.len(), |n| {
            let mut nodes = vec![frames[n].clone()];
            for k in 1..count {
                let variance = NODE_STEP * NODE_STEP * ((k * k) as f64 - ((k - 1) * (k - 1)) as f64);
                let filter = filter::gaussian(variance);
                nodes.push(filtered(&nodes[k - 1], [&filter; 2], 1));
            }
            nodes.iter().map(Field::to_f32).collect()
        });
        Self { nodes, size: [frames[0].width, frames[0].height] }
    }

    /// Adds the squared difference of a frame blurred by v and another, times `weight`.
    fn add(&self, [sharper, other]: [usize; 2], v: f64, weight: f32, sum: &mut [f32]) {
        let nodes = &self.nodes[sharper];
        let k = ((v.sqrt() / NODE_STEP) as usize).min(nodes.len() - 2);
        let at = |k: usize| (NODE_STEP * k as f64).powi(2);
        let t = (((v - at(k)) / (at(k + 1) - at(k))).min(1.0)) as f32;
        let pixels = nodes[k].iter().zip(&nodes[k + 1]).zip(&self.nodes[other][0]);
        for (sum, ((low, high), other)) in sum.iter_mut().zip(pixels) {
            let s = low + t * (high - low) - other;
            *sum += weight * s * s;
        }
    }

    pub(super) fn sharp(&self, frame: usize, pixel: usize) -> f64 {
        f64::from(self.nodes[frame][0][pixel])
    }

    /// A pixel of a frame blurred by v, and its derivative by v.
    pub(super) fn read(&self, frame: usize, v: f64, pixel: usize) -> (f64, f64) {
        let nodes = &self.nodes[frame];
        let k = ((v.sqrt() / NODE_STEP) as usize).min(nodes.len() - 2);
        let [before, after] = [k, k + 1].map(|k| (NODE_STEP * k as f64).powi(2));
        let [low, high] = [k, k + 1].map(|k| f64::from(nodes[k][pixel]));
        let slope = (high - low) / (after - before);
        (low + slope * (v.min(after) - before), slope)
    }

    /// The energy at each candidate u, averaged over a window.
    fn volume(&self, settings: &[f64], pairs: &[[usize; 2]], rate: f64, candidates: &[f64], window: f64) -> Vec<Field> {
        workers::map(candidates.len(), |n| {
            let mut sum = vec![0.0; self.size[0] * self.size[1]];
            for &[i, j] in pairs {
                let [mut own, mut other] = [i, j].map(|k| (k, rate * (settings[k] - candidates[n]).powi(2)));
                if own.1 > other.1 {
                    (own, other) = (other, own);
                }
                // All pairs count at every candidate; otherwise candidates with few pairs would win.
                let v = (other.1 - own.1).min(MAX_RELATIVE_BLUR);
                self.add(
                    [own.0, other.0],
                    v,
                    (1.0 / (1.0 + NOISE_CORRELATION / (NOISE_CORRELATION + v))) as f32,
                    &mut sum,
                );
            }
            smoothed(&Field::from_f32(self.size[0], self.size[1], &sum), window)
        })
    }
}

/// The largest V of the start, px² of its level.
const MAX_RELATIVE_BLUR: f64 = 36.0;
/// σ of the windows for c and for u, px.
pub(super) const WINDOWS: [f64; 2] = [3.0, 2.5];
/// The largest number of frames that c is searched with.
const MAX_FRAMES_FOR_RATE: usize = 24;

/// How often less than 1 px of blur over the sweep is halved. With a sixteenth of a pixel neighbouring levels of c
/// hardly differ in energy.
const LESS_BLUR: u32 = 4;

/// c in px² of this level by squared settings: the least Σ_x min_u E over octaves, from pairs 1, 2, 4, 8 and 16 frames
/// apart.
pub(super) fn rate(frames: &[Field], settings: &[f64]) -> f64 {
    let every = frames.len().div_ceil(MAX_FRAMES_FOR_RATE);
    let chosen: Vec<usize> = (0..frames.len()).step_by(every).collect();
    let settings: Vec<f64> = chosen.iter().map(|&n| settings[n]).collect();
    let images = workers::map(chosen.len(), |n| band_passed(&frames[chosen[n]]));
    let (last, stacks) = (chosen.len() - 1, BlurStacks::new(&images));
    let pairs: Vec<[usize; 2]> =
        [1, 2, 4, 8, 16].iter().flat_map(|s| (0..(last + 1).saturating_sub(*s)).map(move |i| [i, i + s])).collect();
    let range = settings[last] - settings[0];
    let count = (2 * last + 1).clamp(25, 41);
    let candidates: Vec<f64> = (0..count).map(|n| settings[0] + range * n as f64 / (count - 1) as f64).collect();
    let cost = |octave: f64| {
        let volume = stacks.volume(&settings, &pairs, octave.exp2(), &candidates, WINDOWS[0]);
        let least = |n: usize| volume.iter().map(|field| field.data[n]).fold(f64::INFINITY, f64::min);
        (0..volume[0].data.len()).map(least).sum::<f64>()
    };
    // From 1 px of blur over the sweep to 32.
    let first = -2.0 * range.log2();
    let best = |octaves: Vec<f64>| {
        let costs = octaves.into_iter().map(|octave| (octave, cost(octave)));
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(first, |(octave, _)| octave)
    };
    let mut coarse = best((0..6).map(|n| first + 2.0 * f64::from(n)).collect());
    // If the least blur fits best, less is tried: the frames may not differ in focus at all.
    if coarse == first {
        coarse = best((0..=LESS_BLUR).map(|n| first - 2.0 * f64::from(n)).collect());
    }
    let octave = best(vec![coarse - 1.0, coarse, coarse + 1.0]);
    let [a, b, c] = [-1.0, 0.0, 1.0].map(|by| cost(octave + by));
    let bend = a - 2.0 * b + c;
    let beside = if b <= a.min(c) && bend > 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
    (octave + beside).exp2()
}

/// u at every pixel of frames on the reference's pixels.
pub(super) fn focus(frames: &[Field], settings: &[f64], rate: f64) -> Field {
    BlurStacks::new(&workers::map(frames.len(), |n| band_passed(&frames[n]))).focus(settings, rate)
}

impl BlurStacks {
    /// u at every pixel: the minimum of a parabola through the least energy of candidates 0.2 px of blur apart and its
    /// neighbours.
    pub(super) fn focus(&self, settings: &[f64], rate: f64) -> Field {
        let last = settings.len() - 1;
        let range = settings[last] - settings[0];
        let count = ((range * rate.sqrt() / 0.2).ceil() as usize + 1).clamp(13, 200);
        let step = range / (count - 1) as f64;
        let candidates: Vec<f64> = (0..count).map(|n| settings[0] + step * n as f64).collect();
        let volume = self.volume(settings, &pairs::choose(settings, rate), rate, &candidates, WINDOWS[1]);
        let [width, height] = self.size;
        Field::from_fn(width, height, |x, y| {
            let energy = |k: usize| volume[k].get(x, y);
            let k = (1..count - 1).min_by(|a, b| energy(*a).total_cmp(&energy(*b))).unwrap_or(1);
            let [a, b, c] = [energy(k - 1), energy(k), energy(k + 1)];
            let bend = a - 2.0 * b + c;
            let beside = if bend > 0.0 { (0.5 * (a - c) / bend).clamp(-1.0, 1.0) } else { 0.0 };
            candidates[k] + step * beside
        })
    }
}
