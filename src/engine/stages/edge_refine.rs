//! Brings what the search for outlines changed on a coarser level to the finest one.
//!
//! The change of V and the standard deviation are interpolated between the pixels of the coarser level. Where the change
//! is 0, nothing is written.

use super::edge::{COARSE_DEVIATION, COARSE_FRONT, SIDES};
use super::edge_coarsen::Constants;
use super::pass::{Memory, Pass, bindings};
use super::{Number, Raster, pixels};
use crate::engine::vulkan::Variant;

bindings! {
    EDGE_REFINE:
    /// The change of V on the coarser level.
    change: Reads<RelativeBlur>,
    /// V of the finest level.
    v: Updates<RelativeBlur>,
    /// Layers: V, its standard deviation; sides; on the coarser level the deviation, and V of the front.
    results: Updates<Results>,
}

impl Pass for Bindings {
    /// Compulsory traffic: the change read. What is written depends on the scene.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let mut fine = [0, 1, SIDES].map(|n| memory.take_layer(self.results, n));
        let mut v = memory.take_layer(self.v, 0);
        let layer = |n| memory.layer(self.results, n);
        let coarse = [memory.layer(self.change, 0), layer(COARSE_DEVIATION), layer(COARSE_FRONT)];
        cpu_reference(c, coarse, &mut v, fine.each_mut());
        memory.set_layer(self.v, 0, v);
        [0, 1, SIDES].into_iter().zip(fine).for_each(|(n, layer)| memory.set_layer(self.results, n, layer));
    }
}

/// Changes V, and of the results V, its standard deviation and the sides, by the change of V, the deviation and V of the
/// front on the coarser level.
pub(crate) fn cpu_reference<N: Number>(
    c: &Constants,
    [changes, deviations, fronts]: [&Raster<N>; 3],
    v: &mut Raster<N>,
    [masked, deviation, sides]: [&mut Raster<N>; 3],
) {
    let (pixels, gain) = (c.pixels as usize, 1.0 / f64::from(c.gain));
    for (y, x) in (0..changes.height).flat_map(|y| (0..changes.width).map(move |x| (y, x))) {
        let four = |field: &Raster<N>| {
            let at = |i: usize, j: usize| field.get((x + i).min(changes.width - 1), (y + j).min(changes.height - 1));
            [at(0, 0), at(1, 0), at(0, 1), at(1, 1)]
        };
        let change = four(changes);
        if change == [0.0; 4] {
            continue;
        }
        let around = four(deviations);
        if around.iter().any(|deviation| deviation.is_nan()) {
            continue;
        }
        let front = gain * fronts.get(x, y);
        let (columns, rows) = (pixels * x..v.width.min(pixels * (x + 1)), pixels * y..v.height.min(pixels * (y + 1)));
        for (j, i) in rows.flat_map(|j| columns.clone().map(move |i| (j, i))) {
            let [fx, fy] = [i % pixels, j % pixels].map(|step| step as f64 / pixels as f64);
            let shares = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
            let mean = |four: [f64; 4]| gain * four.iter().zip(shares).map(|(value, share)| value * share).sum::<f64>();
            let (more, n) = (mean(change), j * v.width + i);
            if more == 0.0 {
                continue;
            }
            let now = v.get(i, j) + more;
            v.data[n] = N::of(now);
            // Where there are no results, both are NaN.
            if !deviation.get(i, j).is_nan() {
                masked.data[n] = N::of(now);
                deviation.data[n] = N::of(mean(around));
                sides.data[n] = N::of(if now * front > 0.0 { front.abs() } else { -front.abs() });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::edge::LAYERS;
    use super::super::harness::{Input, Trial, random_field};
    use super::super::{Field, prolong};
    use super::*;
    use crate::engine::plan::Level;
    use crate::engine::stages::NO_VARIANT;

    /// What the search leaves on a coarser level: a change in the middle; fields of the size of the finest level.
    fn changed(level: &Level, width: usize, height: usize) -> [Field; 3] {
        let [columns, rows] = level.size.map(|side| side as usize);
        let change = random_field(columns, rows, 3);
        let is_changed = |x: usize, y: usize| x > columns / 3 && y > 1 && x + 2 < columns;
        let change = Field::from_fn(columns, rows, |x, y| if is_changed(x, y) { change.get(x, y) } else { 0.0 });
        let [deviation, front] = [4, 5].map(|seed| random_field(width, height, seed));
        let excluded = |x: usize, y: usize| x > columns / 2 && y > rows / 2;
        let deviation =
            Field::from_fn(width, height, |x, y| if excluded(x, y) { f64::NAN } else { 1.0 + deviation.get(x, y) });
        [change, deviation, front]
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (index, width, height) in [(1, 37, 21), (2, 57, 42), (1, 16, 9)] {
            let level = Level::new(index, width, height, 16.0);
            let (columns, rows) = (width as usize, height as usize);
            let [change, coarse_deviation, front] = changed(&level, columns, rows);
            let [v, sides] = [1, 2].map(|seed| random_field(columns, rows, seed));
            let mut layers = vec![Field::zeros(columns, rows); LAYERS as usize];
            layers[1] = Field::from_fn(columns, rows, |x, _| if x + 5 > columns { f64::NAN } else { 1.0 });
            layers[0] = v.clone();
            (layers[COARSE_DEVIATION], layers[COARSE_FRONT], layers[SIDES]) = (coarse_deviation, front, sides);
            let c = Constants::new(&level, [width, height], index == 1);
            let [change, fine] = [&change, &v].map(|field| Input::Image(std::slice::from_ref(field)));
            let inputs = [change, fine, Input::Image(&layers)];
            let trial = Trial::run::<Bindings>(&inputs, &c, NO_VARIANT, STAGE.groups(level.size));
            trial.assert_within(1e-5);
            let changed = trial.layers(1)[0].data.iter().zip(&v.data).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
            assert!(changed * 9 > v.data.len(), "{changed} of {}", v.data.len());
        }
    }

    #[test]
    fn a_change_is_prolonged_as_v_is() {
        let level = Level::new(1, 37, 22, 16.0);
        let [columns, rows] = level.size.map(|side| side as usize);
        let change = random_field(columns, rows, 3);
        let [mut v, front, mut sides] = [(37, 22), (columns, rows), (37, 22)].map(|(w, h)| Field::zeros(w, h));
        let [mut deviation, coarse] = [(37, 22), (columns, rows)].map(|(w, h)| Field::from_fn(w, h, |_, _| 0.5));
        let mut masked = v.clone();
        let c = Constants::new(&level, [37, 22], true);
        cpu_reference(&c, [&change, &coarse, &front], &mut v, [&mut masked, &mut deviation, &mut sides]);
        let expected =
            prolong::cpu_reference(&prolong::Constants { width: 37, height: 22, limit: f32::MAX, gain: 4.0 }, &change);
        assert!(v.data.iter().zip(&expected.data).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(deviation.data.iter().all(|&deviation| deviation == 2.0) && masked == v);
    }
}
