//! The search for outlines of u at depth edges, after the solve. Sections 7 and 11 of `docs/method.md`.
//!
//! It begins on a coarse level, because u may pass from one side to the other over 20 px, and ends on the finest.

use super::device::SweepDevice;
use super::shared::SharedParameters;
use super::validity::{self, Rectangle};
use crate::base::Error;
use crate::engine::arguments;
use crate::engine::plan::{Level, Plan};
use crate::engine::script::sweep;
use crate::engine::slot::Slot;
use crate::engine::stages::{Field, align, edge_cells, edge_costs, prolong};

/// The coarsest level of the search.
const COARSEST: usize = 2;
/// The least blur at a jump, px²: each side's in the focus of the other. V of the two frames in focus there differs by
/// twice as much, the least jump of a pair.
const LEAST_BLUR: f64 = 0.75;
/// The least blur at a jump that is searched for on a coarser level than the finest, px² of the level. At a jump of D px of
/// blur u passes from one side to the other over some 4 D + 5 px. The next finer level finds jumps over 5 px of this level,
/// a half more with some of them missing: those with less blur.
const COARSE_BLUR: f64 = 2.0;
/// σ² of the weights of cells along an edge, px²: twice that of pairs, which have a wider range of costs.
const SPREAD: f32 = 8.0;
/// The largest distance of the frames used, px of blur, where frames are so dense: those between them are hardly sharper.
const APART: f64 = 1.5;
/// The largest distance of two frames, px of blur. V of frames that are farther apart is too large.
const WIDEST: f64 = 6.5;

/// u, relative to the middle setting, and its standard deviation, with sharp outlines where two layers explain them.
/// `counts`: whether a pixel counts in two frames. Others have no deviation, and keep it.
pub(super) fn sharpen(
    plan: &Plan,
    device: &mut SweepDevice,
    shared: &SharedParameters,
    solved: [Field; 2],
    counts: impl Fn(usize) -> bool,
) -> Result<[Field; 2], Error> {
    let range = shared.settings[shared.settings.len() - 1] - shared.settings[0];
    let [u, deviation] = &solved;
    // Where no pair contributes, between the sides of an edge, nothing is known of u.
    let known = |(i, deviation): (usize, &f64)| if deviation.is_nan() && counts(i) { range } else { *deviation };
    let known = deviation.data.iter().enumerate().map(known).collect();
    let mut levels = vec![[u.clone(), Field { data: known, ..*deviation }]];
    while levels.len() <= COARSEST.min(plan.pyramid.len() - 1) {
        levels.push(levels[levels.len() - 1].each_ref().map(halved));
    }
    let mut coarser: Option<[Field; 2]> = None;
    for (level, before) in plan.pyramid.iter().zip(levels).rev() {
        let mut now = before.clone();
        if let Some(coarser) = coarser {
            apply(coarser.map(|field| prolonged(level, &field)), &mut now);
        }
        let [u, deviation] = on_level(plan, device, shared, level, now)?;
        let change = Field::from_fn(u.width, u.height, |x, y| u.get(x, y) - before[0].get(x, y));
        coarser = Some([change, deviation]);
    }
    let mut result = solved;
    coarser.into_iter().for_each(|change| apply(change, &mut result));
    Ok(result)
}

/// Changes u and its standard deviation where the change of u is not zero.
fn apply([change, changed]: [Field; 2], [u, deviation]: &mut [Field; 2]) {
    for i in (0..u.data.len()).filter(|&i| change.data[i] != 0.0) {
        u.data[i] += change.data[i];
        deviation.data[i] = changed.data[i];
    }
}

/// A field of the next coarser level, as exact as the device holds it: what the search leaves alone must not change.
fn halved(field: &Field) -> Field {
    Field::from_fn(field.width.div_ceil(2), field.height.div_ceil(2), |x, y| {
        let row = |j: isize| {
            let at = |i: isize| field.clamped(2 * x as isize + i, 2 * y as isize + j);
            at(-1) + 2.0 * at(0) + at(1)
        };
        f64::from(((row(-1) + 2.0 * row(0) + row(1)) / 16.0) as f32)
    })
}

/// A field of a level from that of the next coarser one.
fn prolonged(level: &Level, coarse: &Field) -> Field {
    let [width, height] = level.size;
    prolong::cpu_reference(&prolong::Constants { width, height, limit: f32::MAX, gain: 1.0 }, coarse)
}

/// The search on one level.
fn on_level(
    plan: &Plan,
    device: &mut SweepDevice,
    shared: &SharedParameters,
    level: &Level,
    [u, deviation]: [Field; 2],
) -> Result<[Field; 2], Error> {
    let rate = shared.rate_on(level);
    let frames = spaced(&shared.settings, APART / rate.sqrt());
    let shown = frames.iter().map(|&n| validity::visible(&shared.transforms[n], level));
    let shown = shown.fold([f64::MIN, f64::MIN, f64::MAX, f64::MAX], |a: Rectangle, b| validity::intersection([a, b]));
    let blur = if level.index == 0 { LEAST_BLUR } else { COARSE_BLUR };
    let found = edge_cells::Constants::of_sweep(level.size, rate, blur, shown.map(|side| side as f32));
    let slot = Slot::RelativeBlur { level: level.index };
    device.fill(slot, &deviation)?;
    device.run(&sweep::begin_outlines(plan, level))?;
    device.fill(slot, &u)?;
    device.write_words(Slot::Arguments, &arguments::initial_words(&[], &[]))?;
    let aligned: Vec<(u32, align::Constants)> =
        frames.iter().map(|&n| (n as u32, shared.alignment(level, n))).collect();
    let pairs = pairs(shared, level, &frames);
    device.run(&sweep::outlines(plan, level, &aligned, &pairs, &found, SPREAD))?;
    let mut u = device.read(slot, level.size, 0..1)?;
    let mut deviation = device.read(Slot::Stacks, level.size, 1..2)?;
    Ok([u.swap_remove(0), deviation.swap_remove(0)])
}

/// As few frames as leave no more than so much between their settings, where the settings allow that; the first and the
/// last are among them.
fn spaced(settings: &[f64], apart: f64) -> Vec<usize> {
    let mut frames = vec![0];
    for n in 1..settings.len() {
        let next = settings.get(n + 1).copied().unwrap_or(f64::MAX);
        if next - settings[frames[frames.len() - 1]] > apart {
            frames.push(n);
        }
    }
    frames
}

/// The pairs of frames that can show an edge, that with the larger setting first.
fn pairs(shared: &SharedParameters, level: &Level, frames: &[usize]) -> Vec<edge_costs::Constants> {
    let (rate, setting) = (shared.rate_on(level), |n: usize| shared.settings[n] - shared.middle);
    let both = frames.iter().flat_map(|&i| frames.iter().map(move |&j| [i, j]));
    let near = both.filter(|&[i, j]| j < i && setting(i) - setting(j) <= WIDEST / rate.sqrt());
    near.map(|layers| edge_costs::Constants {
        rate: rate as f32,
        settings: layers.map(|n| setting(n) as f32),
        layers: layers.map(|n| n as u32),
        ..edge_costs::Constants::of_pair(level.size, level.centre.map(|c| c as f32))
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_as_far_apart_as_allowed() {
        let even = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(spaced(&even, 2.5), [0, 2, 4, 5]);
        assert_eq!(spaced(&even, 0.4), [0, 1, 2, 3, 4, 5]);
        assert_eq!(spaced(&even, 9.0), [0, 5]);
        assert_eq!(spaced(&[0.0, 0.2, 0.9, 3.0, 3.1], 1.0), [0, 2, 3, 4]);
    }

    #[test]
    fn a_field_without_change_returns_from_the_coarser_level_without_change() {
        let level = Level::new(0, 37, 22, 16.0);
        let field = Field::from_fn(37, 22, |x, y| x as f64 - 2.0 * y as f64);
        let coarse = halved(&field);
        assert_eq!((coarse.width, coarse.height), (19, 11));
        let back = prolonged(&level, &coarse);
        // A plane is returned as it is, away from the border.
        assert!((2..34).all(|x| (2..19).all(|y| (back.get(x, y) - field.get(x, y)).abs() < 1e-5)));
    }
}
