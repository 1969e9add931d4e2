//! Detects frames that do not belong to a sweep: of another scene, blank, or merged from other frames.
//!
//! Defocus hardly changes what an image shows at a sixtieth of its width. So frames of one scene correlate there, after
//! a small shift and change of scale, and a frame of anything else does not. A merged frame correlates too. It is
//! recognised by places that are sharp in it although its neighbours are blurred there and frames further away are
//! sharp again: focus passes each place once.

use std::collections::BTreeSet;

use crate::base::workers;

/// The longest side of the coarse image, px.
const LONGEST: usize = 64;
/// Half of the side of the box whose mean is subtracted, px of the coarse image: brightness that changes over a tenth
/// of the image, such as vignetting, is alike in pictures of different scenes.
const BOX: usize = 6;
/// The changes of scale at which two frames are compared. A lens changes its scale by some per cent over a sweep.
const SCALES: [f32; 5] = [0.94, 0.97, 1.0, 1.03, 1.06];
/// The largest shift at which they are compared, as a share of the short side.
const SHIFT: f32 = 0.125;
/// Frames this far apart in the sweep are compared, so that a few foreign frames in between do not split it.
const REACH: usize = 3;
/// Two frames fit if their misfit, one less their correlation, is at most this many times that of a quarter of all
/// compared frames. In three real sweeps and a generated one neighbours are at most 3.7 times as far apart.
const USUAL_MISFITS: f32 = 6.0;
/// But always up to the first, and never beyond the second. Neighbours in these sweeps have misfits of up to 0.03,
/// frames up to three apart 0.13, and two real pairs of strong defocus 0.09. Other scenes have 0.72 and more. A
/// mirrored or turned frame has 0.46 and more, but 0.19 of a drilled disc, and 0.14 of a symmetric button, which among
/// frames as far apart as that pair would not be noticed.
const MISFITS: [f32; 2] = [0.08, 0.4];
/// The least deviation of the coarse image as a share of its mean: less is rounding and noise, and no frame is judged.
const LEAST_CONTRAST: f32 = 0.003;
/// A frame is blank if its coarse image has less than this share of the usual deviation.
const BLANK: f32 = 0.05;

/// What a frame shows at coarse scale.
pub(super) struct Coarse {
    /// The image less its surroundings, over the mean of the frame.
    values: Vec<f32>,
    size: [usize; 2],
    deviation: f32,
}

impl Coarse {
    /// Reduces an image of this size.
    pub(super) fn of(values: &[f32], size: [usize; 2]) -> Self {
        let (mut values, mut size) = (values.to_vec(), size);
        while size[0].max(size[1]) > LONGEST {
            (values, size) = halved(&values, size);
        }
        let bright = (values.iter().sum::<f32>() / values.len() as f32).max(1e-3);
        let means = surroundings(&values, size);
        let values: Vec<f32> = values.iter().zip(means).map(|(value, mean)| (value - mean) / bright).collect();
        let deviation = (values.iter().map(|v| v * v).sum::<f32>() / values.len() as f32).sqrt();
        Self { values, size, deviation }
    }
}

/// The means of two by two pixels.
pub(super) fn halved(values: &[f32], [width, height]: [usize; 2]) -> (Vec<f32>, [usize; 2]) {
    let size = [width / 2, height / 2];
    let pairs = values.chunks_exact(2 * width).take(size[1]).flat_map(|rows| {
        let (upper, lower) = rows.split_at(width);
        let both = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        both.map(|(a, b)| 0.25 * (a[0] + a[1] + b[0] + b[1]))
    });
    (pairs.collect(), size)
}

/// The mean of the box around each pixel, of its part inside the image.
fn surroundings(values: &[f32], [width, height]: [usize; 2]) -> Vec<f32> {
    let around = |i: usize, side: usize| i.saturating_sub(BOX)..(i + BOX + 1).min(side);
    let mean = |pixel: usize| {
        let (columns, rows) = (around(pixel % width, width), around(pixel / width, height));
        let count = columns.len() * rows.len();
        rows.map(|y| values[y * width + columns.start..y * width + columns.end].iter().sum::<f32>()).sum::<f32>()
            / count as f32
    };
    (0..values.len()).map(mean).collect()
}

/// One less the largest correlation of two frames over shifts and changes of scale.
fn misfit(a: &Coarse, b: &Coarse) -> f32 {
    let [width, height] = a.size;
    let shift = (SHIFT * width.min(height) as f32) as usize;
    let correlations = SCALES.iter().map(|scale| {
        let b = scaled(b, *scale);
        let shifts = (0..=2 * shift).flat_map(|dy| (0..=2 * shift).map(move |dx| [dx, dy]));
        shifts.map(|by| correlation(a, &b, by, shift)).fold(0.0f32, f32::max)
    });
    1.0 - correlations.fold(0.0f32, f32::max)
}

/// The correlation of `a`, without a border of `margin`, with the part of `b` that is shifted by `by` less `margin`.
fn correlation(a: &Coarse, b: &[f32], [dx, dy]: [usize; 2], margin: usize) -> f32 {
    let [width, height] = a.size;
    let (columns, rows) = (width - 2 * margin, height - 2 * margin);
    let mut sums = [0.0f32; 5];
    for y in 0..rows {
        let first = &a.values[(y + margin) * width + margin..][..columns];
        let second = &b[(y + dy) * width + dx..][..columns];
        for (p, q) in first.iter().zip(second) {
            [*p, *q, p * p, q * q, p * q].iter().zip(&mut sums).for_each(|(term, sum)| *sum += term);
        }
    }
    let [p, q, pp, qq, pq] = sums.map(|sum| sum / (columns * rows) as f32);
    let spread = ((pp - p * p).max(0.0) * (qq - q * q).max(0.0)).sqrt();
    if spread > f32::MIN_POSITIVE { (pq - p * q) / spread } else { 0.0 }
}

/// The coarse image enlarged about its middle, linearly interpolated; its border is repeated.
fn scaled(image: &Coarse, scale: f32) -> Vec<f32> {
    let [width, height] = image.size;
    let place = |i: usize, side: usize| {
        let middle = (side - 1) as f32 / 2.0;
        let at = (middle + (i as f32 - middle) / scale).clamp(0.0, (side - 1) as f32);
        let low = (at as usize).min(side.saturating_sub(2));
        (low, at - low as f32)
    };
    let at = |x: usize, y: usize| image.values[y.min(height - 1) * width + x.min(width - 1)];
    let value = |pixel: usize| {
        let ((x, fx), (y, fy)) = (place(pixel % width, width), place(pixel / width, height));
        let row = |y: usize| at(x, y) + fx * (at(x + 1, y) - at(x, y));
        row(y) + fy * (row(y + 1) - row(y))
    };
    (0..image.values.len()).map(value).collect()
}

/// Why a frame does not belong to a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Foreign {
    /// Its coarse image has no contrast.
    Blank,
    /// Its coarse image does not fit the others'.
    OtherScene,
    /// It is sharp wherever another frame is.
    Merged,
}

impl Foreign {
    /// What the frame is, to follow "frame N".
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Blank => "is blank",
            Self::OtherScene => "does not show the scene of the other frames",
            Self::Merged => "is sharp wherever any other frame is, like an image merged from them",
        }
    }
}

/// Why each frame does not belong to the sweep, if it does not. The frames that belong are the largest group that fits.
/// Frames are compared with those near them as given, and in the `order` that they show.
pub(super) fn foreign(frames: &[Coarse], order: &[usize]) -> Vec<Option<Foreign>> {
    let mut deviations: Vec<f32> = frames.iter().map(|frame| frame.deviation).collect();
    deviations.sort_by(f32::total_cmp);
    // Up to half of the frames may be blank.
    let usual = deviations[3 * (deviations.len() - 1) / 4];
    if usual < LEAST_CONTRAST {
        return vec![None; frames.len()];
    }
    let blank: Vec<bool> = frames.iter().map(|frame| frame.deviation < BLANK * usual).collect();
    let shown: Vec<usize> = (0..frames.len()).filter(|&n| !blank[n]).collect();
    let place = |n: usize| shown.iter().position(|other| *other == n);
    let ordered: Vec<usize> = order.iter().filter_map(|n| place(*n)).collect();
    let near = |order: Vec<usize>| {
        let apart = |by: usize| order.iter().zip(order.iter().skip(by)).map(|(a, b)| [*a.min(b), *a.max(b)]);
        (1..=REACH).flat_map(apart).collect::<BTreeSet<_>>()
    };
    let compared: Vec<_> = near((0..shown.len()).collect()).union(&near(ordered)).copied().collect();
    let misfits = workers::map(compared.len(), |n| {
        let [a, b] = compared[n].map(|frame| &frames[shown[frame]]);
        misfit(a, b)
    });
    let mut sorted = misfits.clone();
    sorted.sort_by(f32::total_cmp);
    let bound = sorted.get(sorted.len().saturating_sub(1) / 4).map_or(0.0, |m| USUAL_MISFITS * m);
    let bound = bound.clamp(MISFITS[0], MISFITS[1]);
    let fitting = compared.iter().zip(&misfits).filter(|(_, misfit)| **misfit <= bound);
    let group = largest_group(shown.len(), fitting.map(|(pair, _)| *pair));
    let mut reasons: Vec<_> = blank.iter().map(|&blank| blank.then_some(Foreign::Blank)).collect();
    shown.iter().zip(group).filter(|(_, belongs)| !belongs).for_each(|(&n, _)| reasons[n] = Some(Foreign::OtherScene));
    reasons
}

/// Whether each of `count` frames is in the largest group of frames that links connect; the earliest of equal ones.
fn largest_group(count: usize, links: impl Iterator<Item = [usize; 2]>) -> Vec<bool> {
    let mut groups: Vec<usize> = (0..count).collect();
    for [a, b] in links {
        let (from, to) = (groups[a].max(groups[b]), groups[a].min(groups[b]));
        groups.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
    }
    let size = |group: usize| groups.iter().filter(|g| **g == group).count();
    let largest = (0..count).rev().max_by_key(|&group| size(group));
    groups.iter().map(|group| Some(*group) == largest).collect()
}

/// A place is sharp in a frame if its sharpness is at least this share of that in the sharpest other frame, and blurred
/// at less than the second.
const SHARP: [f32; 2] = [0.5, 0.25];
/// A merged frame is sharp at this share of the places that are blurred in some frame.
const MERGED_SHARE: f32 = 0.8;
/// The least number of those places that are blurred in the frames beside it, and the least number of frames that are
/// sharpest at them. A frame that is only out of order is sharp near its own focus alone. A frame with a wide depth of
/// field has neighbours that are sharp too.
const LEAST_PLACES: usize = 12;
const LEAST_FRAMES: usize = 2;

/// The frames that are sharp everywhere, also where the frames beside them are blurred, from the logarithm of sharpness
/// of each frame at each place of each octave. One octave suffices: in the finest, noise may outweigh the blur.
pub(super) fn merged(logarithms: &[Vec<f32>], places: usize) -> Vec<bool> {
    let [sharp, blurred] = SHARP.map(f32::ln);
    let octaves = logarithms.first().map_or(0, |frame| frame.len() / places);
    let is_merged = |n: usize, octave: usize| {
        let others = || logarithms.iter().enumerate().filter(move |(other, _)| *other != n);
        let (mut all, mut here, mut isolated, mut peaks) = (0, 0, 0, BTreeSet::new());
        for (place, own) in logarithms[n].iter().enumerate().skip(octave * places).take(places) {
            let by_sharpness = |a: &(usize, f32), b: &(usize, f32)| a.1.total_cmp(&b.1);
            let Some((peak, most)) = others().map(|(frame, at)| (frame, at[place])).max_by(by_sharpness) else {
                return false;
            };
            let is_blurred = |at: &[f32]| at[place] < most + blurred;
            if !others().any(|(_, at)| is_blurred(at)) {
                continue;
            }
            all += 1;
            if *own < most + sharp {
                continue;
            }
            here += 1;
            if others().filter(|(frame, _)| frame.abs_diff(n) == 1).all(|(_, at)| is_blurred(at)) {
                isolated += 1;
                peaks.insert(peak);
            }
        }
        isolated >= LEAST_PLACES && peaks.len() >= LEAST_FRAMES && here as f32 >= MERGED_SHARE * all as f32
    };
    (0..logarithms.len()).map(|n| (0..octaves).any(|octave| is_merged(n, octave))).collect()
}
