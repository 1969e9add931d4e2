//! Brings what the search for outlines changed on a coarser level to the finest one.
//!
//! Of the coarser level, V of both sides, their deviation, how much V may change, the probability of the near side and
//! the distance towards it are interpolated between its pixels. Which side a pixel shows is decided here, so that the
//! outline is as sharp as on the finest level. Where V may not change, nothing is written.

use super::edge::{self, COARSE_DEVIATION, COARSE_FAR, COARSE_NEAR, COARSE_SHARE, COARSE_TOWARDS_NEAR, SIDES};
use super::pass::{Memory, Pass};
use super::{Number, Raster, pixels};
use crate::engine::vulkan::Variant;

pub use super::interface::edge_refine::*;

impl Pass for Bindings {
    /// Compulsory traffic: the share read. What is written depends on the scene.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let mut fine = [0, 1, SIDES].map(|n| memory.take_layer(self.results, n));
        let mut v = memory.take_layer(self.relative_blur, 0);
        let layer = |n| memory.layer(self.results, n);
        let near = [memory.layer(self.coarse, 0), layer(COARSE_DEVIATION), layer(COARSE_FAR), layer(COARSE_SHARE)];
        let [v_near, deviation, far, share] = near;
        let coarse = [v_near, deviation, far, share, layer(COARSE_NEAR), layer(COARSE_TOWARDS_NEAR)];
        cpu_reference(c, coarse, &mut v, fine.each_mut());
        memory.set_layer(self.relative_blur, 0, v);
        [0, 1, SIDES].into_iter().zip(fine).for_each(|(n, layer)| memory.set_layer(self.results, n, layer));
    }
}

/// Changes V, and of the results V, its standard deviation and the sides, by those of the coarser level: V of the near
/// side, the deviation, V of the far side, how much V may change, the probability of the near side, and the distance
/// towards it.
pub(crate) fn cpu_reference<N: Number>(
    c: &Constants,
    [nears, deviations, fars, shares, probabilities, distances]: [&Raster<N>; 6],
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
        let others = [nears, fars, deviations, probabilities, distances].map(four);
        let (columns, rows) = (pixels * x..v.width.min(pixels * (x + 1)), pixels * y..v.height.min(pixels * (y + 1)));
        for (j, i) in rows.flat_map(|j| columns.clone().map(move |i| (j, i))) {
            let [fx, fy] = [i % pixels, j % pixels].map(|step| step as f64 / pixels as f64);
            let places = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
            let sum = |of: &dyn Fn(usize) -> f64| (0..4).map(|n| places[n] * of(n)).sum::<f64>();
            let (share, order) = (sum(&|n| shares[n].abs()), sum(&|n| shares[n]));
            let before = deviation.get(i, j);
            // Where there are no results, it is NaN.
            if share == 0.0 || before.is_nan() {
                continue;
            }
            // Where nothing changes, the others may be NaN.
            let changing = sum(&|n| f64::from(u8::from(shares[n] != 0.0)));
            let mean = |four: &[f64; 4]| sum(&|n| if shares[n] == 0.0 { 0.0 } else { four[n] }) / changing;
            let [near, far, of_sides, p, towards_near] = others.each_ref().map(mean);
            let [near, far, of_sides] = [near, far, of_sides].map(|value| value / scale);
            let shown = edge::shown_near(p);
            let share = share * edge::change(towards_near, shown);
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

    use super::super::harness::random_field;
    use super::super::{Field, prolong};
    use super::*;
    use crate::engine::plan::Level;

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
        cpu_reference(&c, [&coarse, &half, &far, &one, &one, &one], &mut v, results);
        let expected =
            prolong::cpu_reference(&prolong::Constants { width: 37, height: 22, limit: f32::MAX, gain: 4.0 }, &coarse);
        assert!(v.data.iter().zip(&expected.data).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(deviation.data.iter().all(|&deviation| deviation == 2.0) && masked == v);
    }

    /// V was halfway at x = 10; the outline is 8 px of the level farther out.
    #[test]
    fn a_displaced_outline_has_no_v_between_its_sides() {
        let level = Level::new(1, 48, 20, 16.0);
        let [columns, rows] = level.size.map(|side| side as usize);
        let coarse = |value: &(dyn Fn(f64) -> f64 + Sync)| Field::from_fn(columns, rows, |x, _| value(x as f64));
        let [near, far, none, one] = [4.0, -4.0, 0.0, 1.0].map(|value| coarse(&|_| value));
        let (probability, distance) = (coarse(&|x| f64::from(u8::from(x >= 2.0))), coarse(&|x| x - 10.0));
        let mut v = Field::from_fn(48, 20, |x, _| if x < 20 { -16.0 } else { 16.0 });
        let [mut masked, mut deviation, mut sides] = [(); 3].map(|()| Field::zeros(48, 20));
        let before = [&near, &none, &far, &one, &probability, &distance];
        let results = [&mut masked, &mut deviation, &mut sides];
        cpu_reference(&Constants::of_pair(&level, [48, 20]), before, &mut v, results);
        let row: Vec<f64> = (0..48).map(|x| v.get(x, 9)).collect();
        let between = row.iter().filter(|v| v.abs() < 15.9).count();
        assert!(between <= 1 && row[2] < -15.9 && row[4] > 15.9, "{row:?}");
    }
}
