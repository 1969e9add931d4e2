//! The search for outlines of u at depth edges, after the solve. Sections 7 and 11 of `docs/method.md`.
//!
//! It begins on a coarse level, because u may pass from one side to the other over 20 px, and ends on the finest.

use super::device::SweepDevice;
use super::shared::SharedParameters;
use super::validity::{self, Rectangle};
use crate::base::Error;
use crate::engine::arguments::{self, Edges};
use crate::engine::plan::{Level, Plan};
use crate::engine::script::outlines::{OF_SWEEPS, Search};
use crate::engine::script::sweep::{self, Outlines};
use crate::engine::slot::Slot;
use crate::engine::stages::{Field, edge_cells, edge_coarsen, edge_costs};

/// Frames closer than this to the one used before are left out, px of blur: they are hardly sharper.
const APART: f64 = 1.5;
/// The largest distance of two frames, px of blur: √2 + √18. Of frames that are farther apart no edge with at most 4
/// px² of blur in all has at most 16 px² of V on both sides.
const FARTHEST: f64 = 5.66;

/// u, relative to the middle setting, and its standard deviation, with sharp outlines where two layers explain them.
/// `counts`: whether a pixel counts in two frames. Others have no deviation, and keep it. `done` is called after each
/// level.
pub(super) fn sharpen(
    plan: &Plan,
    device: &mut SweepDevice,
    shared: &SharedParameters,
    solved: [Field; 2],
    counts: impl Fn(usize) -> bool,
    done: &mut dyn FnMut(&Level),
) -> Result<[Field; 2], Error> {
    let range = shared.settings[shared.settings.len() - 1] - shared.settings[0];
    let [mut u, mut deviation] = solved;
    // Where no pair contributes, between the sides of an edge, nothing is known of u.
    let known = |(i, deviation): (usize, &f64)| if deviation.is_nan() && counts(i) { range } else { *deviation };
    let known = deviation.data.iter().enumerate().map(known).collect();
    let slot = Slot::RelativeBlur { level: 0 };
    device.fill(slot, &Field { data: known, ..deviation })?;
    device.run(&sweep::begin_outlines(plan))?;
    device.fill(slot, &u)?;
    device.write_words(Slot::Arguments, &arguments::initial_words(&[], &[]))?;
    for level in levels(plan) {
        device.run(&sweep::outlines(plan, &on_level(shared, plan.size, level)))?;
        done(level);
    }
    let sharp = [device.read(slot, plan.size, 0..1)?, device.read(Slot::Stacks, plan.size, 1..2)?];
    for i in 0..u.data.len() {
        let [now, deviation_now] = [0, 1].map(|n| sharp[n][0].data[i]);
        // The device has single precision: what the search left alone keeps its digits.
        if now != f64::from(u.data[i] as f32) && !deviation_now.is_nan() {
            (u.data[i], deviation.data[i]) = (now, deviation_now);
        }
    }
    Ok([u, deviation])
}

/// The levels of the search, coarse to fine; none without it.
pub(super) fn levels(plan: &Plan) -> impl Iterator<Item = &Level> {
    let count = if plan.settings.edges { Edges::COARSEST + 1 } else { 0 };
    plan.pyramid.iter().take(count).rev()
}

/// The search on one level.
pub(super) fn on_level<'a>(shared: &SharedParameters, finest: [u32; 2], level: &'a Level) -> Outlines<'a> {
    let rate = shared.rate_on(level);
    let frames = spaced(&shared.settings, APART / rate.sqrt());
    let shown = frames.iter().map(|&n| validity::visible(&shared.transforms[n], level));
    let shown = shown.fold([f64::MIN, f64::MIN, f64::MAX, f64::MAX], |a: Rectangle, b| validity::intersection([a, b]));
    let cells = edge_cells::Constants::of_sweep(level.index, level.size, rate, shown.map(|side| side as f32));
    let pairs = pairs(shared, level, &frames);
    let frames = frames.iter().map(|&n| (n as u32, shared.alignment(level, n))).collect();
    let coarsening = edge_coarsen::Constants::of_sweep(level, finest);
    Outlines { level, search: Search { coarsening, cells, levels: 0, criteria: OF_SWEEPS }, frames, pairs }
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
    let near = both.filter(|&[i, j]| j < i && setting(i) - setting(j) <= FARTHEST / rate.sqrt());
    near.map(|layers| edge_costs::Constants {
        rate: rate as f32,
        settings: layers.map(|n| setting(n) as f32),
        layers: layers.map(|n| n as u32),
        ..edge_costs::Constants::of_pair(level, 0)
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
}
