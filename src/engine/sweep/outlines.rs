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
/// The least blur at a jump that is searched for on a coarser level than the finest, px² of the level. At less the next
/// finer level finds the jump too, and sees more: with 0.75 px² here too, 1.0 and 17.8 % of the pixels at a card and
/// at blocks were off by more than half a frame, with 2 px² 0.4 and 15.6 % (by the earlier price of V as it is).
const COARSE_BLUR: f64 = 2.0;
/// σ² of the weights of cells along an edge, px². With the 4 px² of pairs 14.0 % at bars were off, with 8 to 16 px²
/// 13.2 %, and the sides of a metal part are straighter.
const SPREAD: f32 = 8.0;
/// The largest distance of the frames used, px of blur, where frames are so dense: those between them are hardly
/// sharper.
const APART: f64 = 1.5;
/// The largest distance of two frames, px of blur: √2 + √18. Of frames that are farther apart no edge with at most 4
/// px² of blur in all has at most 16 px² of V on both sides.
const WIDEST: f64 = 5.66;

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
            let changes = coarser.map(|field| prolonged(level, &field));
            for (i, change, deviation) in changed(&changes).filter(|&(i, ..)| !before[1].data[i].is_nan()) {
                now[0].data[i] += change;
                now[1].data[i] = deviation;
            }
        }
        let [u, deviation] = on_level(plan, device, shared, level, now)?;
        let change = Field::from_fn(u.width, u.height, |x, y| u.get(x, y) - before[0].get(x, y));
        coarser = Some([change, deviation]);
    }
    let mut result = solved;
    for (i, change, deviation) in coarser.iter().flat_map(changed) {
        result[0].data[i] += change;
        result[1].data[i] = deviation;
    }
    Ok(result)
}

/// Where u has changed and has a deviation: the pixel, the change, and the deviation.
fn changed([change, deviation]: &[Field; 2]) -> impl Iterator<Item = (usize, f64, f64)> {
    let pixels = change.data.iter().zip(&deviation.data).enumerate();
    pixels.map(|(i, (change, deviation))| (i, *change, *deviation)).filter(|(_, c, d)| *c != 0.0 && !d.is_nan())
}

/// A field of the next coarser level, as exact as the device holds it: what the search leaves alone must not change.
/// NaN where all pixels of the finer level are, so that excluded areas do not grow.
fn halved(field: &Field) -> Field {
    Field::from_fn(field.width.div_ceil(2), field.height.div_ceil(2), |x, y| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (j, i) in (-1..=1).flat_map(|j: isize| (-1..=1).map(move |i: isize| (j, i))) {
            let (value, share) = (field.clamped(2 * x as isize + i, 2 * y as isize + j), (2 - i.abs()) * (2 - j.abs()));
            if !value.is_nan() {
                (sum, weight) = (sum + share as f64 * value, weight + share as f64);
            }
        }
        f64::from((sum / weight) as f32)
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

/// The first and the last frame, and the fewest between them that leave no gap over `apart`, if the settings allow it.
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
    fn a_plane_is_the_same_on_a_coarser_level_and_nan_does_not_spread() {
        let level = Level::new(0, 37, 22, 16.0);
        let field = Field::from_fn(37, 22, |x, y| x as f64 - 2.0 * y as f64);
        let coarse = halved(&field);
        assert_eq!((coarse.width, coarse.height), (19, 11));
        let back = prolonged(&level, &coarse);
        // A plane is returned as it is, away from the border.
        assert!((2..34).all(|x| (2..19).all(|y| (back.get(x, y) - field.get(x, y)).abs() < 1e-5)));
        let masked = Field::from_fn(37, 22, |x, y| if x > 20 && y > 7 { f64::NAN } else { 1.0 });
        let coarse = halved(&masked);
        assert!((0..19).all(|x| (0..11).all(|y| coarse.get(x, y).is_nan() == (x > 10 && y > 4))));
        assert_eq!(coarse.get(10, 4), 1.0);
    }
}
