//! Brings what the search for outlines changed on a coarser level to the finest one.
//!
//! Of the coarser level, V of both sides, their deviation, and the share by which each counts are interpolated between its
//! pixels. Which side a pixel shows is decided here, so that the outline is as sharp as on the finest level. Where the
//! share is 0, nothing is written.

use super::edge::{self, COARSE_DEVIATION, COARSE_FAR, COARSE_NEAR_SHARE, COARSE_SHARE, SIDES};
use super::edge_coarsen::Constants;
use super::pass::{Memory, Pass, bindings};
use super::{Number, Raster, pixels};
use crate::engine::vulkan::Variant;

bindings! {
    EDGE_REFINE:
    /// V of the near side at outlines of the coarser level.
    coarse: Reads<RelativeBlur>,
    /// V of the finest level.
    v: Updates<RelativeBlur>,
    /// Layers: V, its standard deviation; sides; of the coarser level the deviation, V of the far side, and the shares.
    results: Updates<Results>,
}

impl Pass for Bindings {
    /// Compulsory traffic: the share read. What is written depends on the scene.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let mut fine = [0, 1, SIDES].map(|n| memory.take_layer(self.results, n));
        let mut v = memory.take_layer(self.v, 0);
        let [deviation, far, share, near_share] =
            [COARSE_DEVIATION, COARSE_FAR, COARSE_SHARE, COARSE_NEAR_SHARE].map(|n| memory.layer(self.results, n));
        let coarse = [memory.layer(self.coarse, 0), deviation, far, share, near_share];
        cpu_reference(c, coarse, &mut v, fine.each_mut());
        memory.set_layer(self.v, 0, v);
        [0, 1, SIDES].into_iter().zip(fine).for_each(|(n, layer)| memory.set_layer(self.results, n, layer));
    }
}

/// Changes V, and of the results V, its standard deviation and the sides, by those of the coarser level: V of the near side,
/// the deviation, V of the far side, the share, negative if the far side is in front, and the near side's part of it.
pub(crate) fn cpu_reference<N: Number>(
    c: &Constants,
    [nears, deviations, fars, shares, near_shares]: [&Raster<N>; 5],
    v: &mut Raster<N>,
    [masked, deviation, sides]: [&mut Raster<N>; 3],
) {
    let [last_x, last_y] = [c.width, c.height].map(|side| side as usize - 1);
    let (pixels, scale) = (c.pixels as usize, f64::from(c.scale));
    for (y, x) in (0..=last_y).flat_map(|y| (0..=last_x).map(move |x| (y, x))) {
        let (right, below) = ((x + 1).min(last_x), (y + 1).min(last_y));
        let four = |field: &Raster<N>| [(x, y), (right, y), (x, below), (right, below)].map(|(x, y)| field.get(x, y));
        let shares = four(shares);
        if shares == [0.0; 4] {
            continue;
        }
        let [nears, deviations, fars, near_shares] = [nears, deviations, fars, near_shares].map(four);
        let (columns, rows) = (pixels * x..v.width.min(pixels * (x + 1)), pixels * y..v.height.min(pixels * (y + 1)));
        for (j, i) in rows.flat_map(|j| columns.clone().map(move |i| (j, i))) {
            let [fx, fy] = [i % pixels, j % pixels].map(|step| step as f64 / pixels as f64);
            let places = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
            let order: f64 = places.into_iter().zip(shares).map(|(place, share)| place * share).sum();
            let weights = [0, 1, 2, 3].map(|n| places[n] * shares[n].abs());
            let share: f64 = weights.iter().sum();
            let before = deviation.get(i, j);
            // Where there are no results, it is NaN.
            if share == 0.0 || before.is_nan() {
                continue;
            }
            // Where nothing changes, the others may be NaN.
            let sum = |four: [f64; 4], weights: [f64; 4]| -> f64 {
                (0..4).filter(|&n| weights[n] > 0.0).map(|n| four[n] * weights[n]).sum()
            };
            let [near, far, of_sides] = [nears, fars, deviations].map(|four| sum(four, weights) / (scale * share));
            let changing = [0, 1, 2, 3].map(|n| if weights[n] > 0.0 { places[n] } else { 0.0 });
            let p = sum(near_shares, changing) / share;
            let shown = edge::shown_near(p);
            let mixed = |before: f64, after: f64| before + share * (after - before);
            let (now, n) = (mixed(v.get(i, j), far + shown * (near - far)), j * v.width + i);
            (v.data[n], masked.data[n]) = (N::of(now), N::of(now));
            let between = edge::deviation_between(p, shown) * (near - far).abs();
            deviation.data[n] = N::of(mixed(before, between + of_sides));
            if near * far < 0.0 {
                let front = if order > 0.0 { near } else { far };
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

    #[test]
    fn matches_the_cpu_reference() {
        for (index, width, height) in [(1, 37, 21), (2, 57, 42), (1, 16, 9)] {
            let level = Level::new(index, width, height, 16.0);
            let ([columns, rows], [width, height]) =
                (level.size.map(|side| side as usize), [width, height].map(|side| side as usize));
            let random = |seed| random_field(width, height, seed);
            let [v, near, far] = [1, 2, 3].map(random);
            let is_changed = |x: usize, y: usize| x > columns / 3 && y > 1 && x + 2 < columns;
            // The far side is in front in the lower half.
            let changed = |x: usize, y: usize| f64::from(u8::from(is_changed(x, y))) * random(4).get(x, y).abs();
            let share = Field::from_fn(width, height, |x, y| if y > rows / 2 { -changed(x, y) } else { changed(x, y) });
            let near_share = Field::from_fn(width, height, |x, y| {
                if is_changed(x, y) { changed(x, y) * random(7).get(x, y).abs().min(1.0) } else { f64::NAN }
            });
            // Unknown where nothing changes, on some pixels and not on others.
            let unknown = |x: usize, y: usize| !is_changed(x, y) && y < rows / 2;
            let mut layers = vec![Field::zeros(width, height); LAYERS as usize];
            let known = random(6);
            let coarse_deviation = |x, y| if unknown(x, y) { f64::NAN } else { known.get(x, y) };
            layers[COARSE_DEVIATION] = Field::from_fn(width, height, coarse_deviation);
            layers[1] = Field::from_fn(width, height, |x, _| if x + 5 > width { f64::NAN } else { 1.0 });
            (layers[0], layers[SIDES]) = (v.clone(), random(5));
            layers[COARSE_FAR] =
                Field::from_fn(width, height, |x, y| if unknown(x, y) { f64::NAN } else { -far.get(x, y) });
            (layers[COARSE_SHARE], layers[COARSE_NEAR_SHARE]) = (share, near_share);
            let of = if index == 1 { Constants::of_sweep } else { Constants::of_pair };
            let c = of(&level, [width as u32, height as u32]);
            let [coarse, fine] = [&near, &v].map(|field| Input::Image(std::slice::from_ref(field)));
            let inputs = [coarse, fine, Input::Image(&layers)];
            let trial = Trial::run::<Bindings>(&inputs, &c, NO_VARIANT, STAGE.groups(level.size));
            // Where both sides are about as probable, their probability counts ten times, and V by ten times as much.
            trial.assert_within(2e-4);
            let changed = trial.layers(1)[0].data.iter().zip(&v.data).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
            assert!(changed * 9 > v.data.len(), "{changed} of {}", v.data.len());
        }
    }

    #[test]
    fn where_all_pixels_show_the_near_side_it_is_prolonged() {
        let level = Level::new(1, 37, 22, 16.0);
        let [columns, rows] = level.size.map(|side| side as usize);
        let coarse = random_field(columns, rows, 3);
        let [mut v, far, mut sides] = [(37, 22), (columns, rows), (37, 22)].map(|(w, h)| Field::zeros(w, h));
        let [mut deviation, half, one] = [(37, 22, 0.5), (columns, rows, 0.5), (columns, rows, 1.0)]
            .map(|(w, h, value)| Field::from_fn(w, h, |_, _| value));
        let mut masked = v.clone();
        let c = Constants::of_pair(&level, [37, 22]);
        let results = [&mut masked, &mut deviation, &mut sides];
        cpu_reference(&c, [&coarse, &half, &far, &one, &one], &mut v, results);
        let expected =
            prolong::cpu_reference(&prolong::Constants { width: 37, height: 22, limit: f32::MAX, gain: 4.0 }, &coarse);
        assert!(v.data.iter().zip(&expected.data).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(deviation.data.iter().all(|&deviation| deviation == 2.0) && masked == v);
    }
}
