//! Finds the cells at depth edges, their normals, and V of either side. Section 7 of `docs/method.md`.
//!
//! A cell has an edge if V jumps over about ±5 px, and hardly more over ±9 px: a slope that goes on is no jump. The
//! edge is where V is halfway between the extremes, its normal the slope of V there. V of a side is a weighted mean
//! along the normal, from 4 px on, beyond the pixels over which the solve passes from one side to the other. Pixels
//! with a large deviation count little: in the blurred light of a near surface V is not measured, farther on it is.

use super::edge::{self, CELL, EDGES, Edge, between, deviation_layer};
use super::pass::{Memory, Pass};
use super::{Number, Raster, edge_apply, edge_costs, pixels};
use crate::base::workers;
use crate::engine::arguments::Edges;
use crate::engine::vulkan::Variant;

pub use super::interface::edge_cells::*;
use crate::engine::shaders::edge_cells as shader;

/// The least blur at a jump, px²: each side's in the focus of the other. V differs by twice as much.
const LEAST_BLUR: f64 = 0.75;
/// The same on a coarser level than the finest, px² of the level. At less the next finer level finds the jump too, and
/// sees more: of sweeps, with 0.75 px² here too, 1.0 and 17.8 % of the pixels at a card and at blocks were off by more
/// than half a frame, with 2 px² 0.4 and 15.6 % (by the earlier price of V as it is).
const COARSE_BLUR: f64 = 2.0;
/// The deviation of V at which a pixel of a side has half the weight, px² of the level. With 0.75 px², on the finest
/// level the near side of a cylinder is taken from where it is flatter: 0.378 instead of 0.373 px² rms. With 8 px² on
/// the coarsest level, 83 instead of 118 cells of pcb-header have an edge there.
const HALF_WEIGHT: f32 = 2.0;
/// The widest jump of u in a sweep, px of blur. Of the frames with at most 4 px² in all at a jump of D px, the two
/// nearest to each other are D - 2.8 px apart, so that |V| is D (D - 2.8), which must not exceed
/// [`edge_costs::LARGEST`].
const WIDEST_JUMP: f64 = 5.6;
/// The least deviation of u at a jump of a sweep, as a share of it. Where a near surface's blur makes u pass from one
/// side to the other it is 0.08 and more (card, bars and blocks, 11 frames), on the steepest slopes of three
/// generated reliefs of 41 frames up to 0.04.
const UNCERTAIN: f32 = 0.06;

impl Constants {
    /// Those of a pair on a level of `size`, in a solve of `levels` levels, the finest of `finest`.
    pub(crate) fn of_pair(level: usize, size @ [width, height]: [u32; 2], levels: usize, finest: [u32; 2]) -> Self {
        let along = |[x, y, _]: [u32; 3]| [x, y];
        let pixels = |size| along(edge_apply::STAGE.groups(size));
        Self {
            width,
            height,
            argument_place: Edges::Cells(level).word(levels) as u32,
            pixels: pixels(size),
            fused_place: Edges::Fused.word(levels) as u32,
            fused: pixels(finest),
            deviation_layer: deviation_layer(level == 0) as u32,
            least_jump: 2.0 * least_blur(level) as f32,
            half_weight: HALF_WEIGHT,
            // On a coarser level V has opposite signs on both sides. Of the same sign, neither photograph shows what is
            // behind sharper than the other does, and dirt on a smooth surface makes such edges of V.
            share: if level == 0 { 0.35 } else { 1.0 },
            largest: edge_costs::LARGEST,
            widest: f32::MAX,
            uncertain: 0.0,
            shown: [0.0, 0.0, width as f32, height as f32],
        }
    }

    /// Those of a sweep on a level with c px² by squared settings.
    pub(crate) fn of_sweep(level: usize, size: [u32; 2], rate: f64, shown: [f32; 4]) -> Self {
        let pair = Self::of_pair(level, size, 0, [0; 2]);
        let [least_jump, widest] = [least_blur(level).sqrt(), WIDEST_JUMP].map(|jump| (jump / rate.sqrt()) as f32);
        Self {
            least_jump,
            half_weight: 2.0 * least_jump,
            uncertain: UNCERTAIN,
            share: 0.0,
            largest: f32::MAX,
            widest,
            shown,
            ..pair
        }
    }
}

fn least_blur(level: usize) -> f64 {
    if level == 0 { LEAST_BLUR } else { COARSE_BLUR }
}

impl Pass for Bindings {
    /// Compulsory traffic: V and its deviation read, a number per cell written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        8 * pixels(c.width, c.height) + 4 * pixels(c.width, c.height) / (CELL * CELL) as u64
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let edges = cpu_reference(
            c,
            memory.layer(self.relative_blur, 0),
            memory.layer(self.results, c.deviation_layer as usize),
        );
        let listed = edge::listed(&edges, [c.width, c.height]);
        if !listed.is_empty() {
            let (words, [x, y]) = (memory.words_mut(self.arguments), c.fused);
            let mut set = |place: u32, set: &[u32]| words[place as usize..][..set.len()].copy_from_slice(set);
            set(c.argument_place, &edge::words(listed.len() as u32, c.pixels));
            set(c.fused_place, &[x, y, 1]);
        }
        *memory.words_mut(self.listed) = listed;
        memory.set_layer(self.results, EDGES, edges);
    }
}

/// The edges of all cells.
pub(crate) fn cpu_reference<N: Number>(c: &Constants, v: &Raster<N>, deviation: &Raster<N>) -> Raster<N> {
    let mut edges = Raster::zeros(v.width, v.height);
    let [columns, rows] = edge::cells([c.width, c.height]).map(|side| side as usize);
    // Of each cell and `AROUND` more on either side of all.
    let ranges = workers::map(rows + 2 * AROUND, |y| {
        let range = |x| Range::of_cell(v, deviation, [x, y].map(|n| (CELL * n) as isize - (CELL * AROUND) as isize));
        (0..columns + 2 * AROUND).map(range).collect::<Vec<_>>()
    });
    let around = |[x, y]: [usize; 2], reach: usize| {
        let [first_x, first_y] = [x, y].map(|n| n + AROUND - reach);
        let rows = ranges[first_y..=first_y + 2 * reach].iter();
        rows.flat_map(move |row| &row[first_x..=first_x + 2 * reach]).fold(Range::NONE, Range::and)
    };
    let edge = |cell| edge_of(c, [v, deviation], cell, [around(cell, AROUND), around(cell, 1)]);
    let found = |y| (0..columns).filter_map(|x| Some(([x, y], edge([x, y])?))).collect::<Vec<_>>();
    for (cell, edge) in workers::map(rows, found).into_iter().flatten() {
        edge::set(&mut edges, cell, 0, &edge.numbers());
    }
    edges
}

/// The cells on either side of one that the outer range of V is of.
const AROUND: usize = 2;

/// The range of V, and the least deviation, of every other pixel of some cells.
#[derive(Clone, Copy)]
struct Range {
    v: [f64; 2],
    deviation: f64,
}

impl Range {
    const NONE: Self = Self { v: [f64::MAX, f64::MIN], deviation: f64::MAX };

    /// That of the cell with its corner at a place, which may be outside.
    fn of_cell<N: Number>(v: &Raster<N>, deviation: &Raster<N>, [x, y]: [isize; 2]) -> Self {
        let places = [(1, 1), (3, 1), (1, 3), (3, 3)].map(|(i, j)| (x + i, y + j));
        places.into_iter().fold(Self::NONE, |range, (x, y)| {
            range.and(&Self { v: [v.clamped(x, y); 2], deviation: deviation.clamped(x, y) })
        })
    }

    fn and(self, other: &Self) -> Self {
        Self {
            v: [self.v[0].min(other.v[0]), self.v[1].max(other.v[1])],
            deviation: self.deviation.min(other.deviation),
        }
    }
}

/// The edge of a cell, by the ranges of the cells around it and of its neighbours.
fn edge_of<N: Number>(
    c: &Constants,
    [v, deviation]: [&Raster<N>; 2],
    cell: [usize; 2],
    [Range { v: outer, deviation: least }, Range { v: inner, .. }]: [Range; 2],
) -> Option<Edge> {
    let corner = cell.map(|c| (CELL * c) as isize);
    let (jump, range) = (inner[1] - inner[0], outer[1] - outer[0]);
    let least_jump = f64::from(c.least_jump);
    if !(jump > least_jump && jump > shader::STEEP * range && jump > shader::CERTAIN * least) {
        return None;
    }
    let halfway = 0.5 * (outer[0] + outer[1]);
    let (mut best, mut found) = (1.5, None);
    for n in 0..(CELL * CELL) as isize {
        let [x, y] = [corner[0] + n % CELL as isize, corner[1] + n / CELL as isize];
        let at = |i: isize, j: isize| v.clamped(x + i, y + j);
        let column = |i: isize| at(i, -1) + 2.0 * at(i, 0) + at(i, 1);
        let row = |j: isize| at(-1, j) + 2.0 * at(0, j) + at(1, j);
        let slope = [(column(1) - column(-1)) / 8.0, (row(1) - row(-1)) / 8.0];
        let steepness = slope[0].hypot(slope[1]);
        if steepness < (0.02 * range).max(1e-6) {
            continue;
        }
        let away = (halfway - (row(-1) + 2.0 * row(0) + row(1)) / 16.0) / steepness;
        if away.abs() < best {
            let normal = slope.map(|s| s / steepness);
            best = away.abs();
            found = Some(([x as f64 + away * normal[0], y as f64 + away * normal[1]], normal));
        }
    }
    let (place, normal): ([f64; 2], _) = found?;
    // Each piece of an edge belongs to one cell.
    if place.map(|p| ((p + 0.5) / CELL as f64).floor()) != cell.map(|c| c as f64) {
        return None;
    }
    let [left, top, right, bottom] = c.shown.map(f64::from);
    if place[0] < left || place[1] < top || place[0] > right || place[1] > bottom {
        return None;
    }
    let level = |side| level([v, deviation], place, normal, halfway, side, c.half_weight.into());
    let (near, far) = (level(1.0)?, level(-1.0)?);
    let (highest, difference) = (near[0].abs().max(far[0].abs()), near[0] - far[0]);
    let [share, largest, widest, uncertain] = [c.share, c.largest, c.widest, c.uncertain].map(f64::from);
    let least = (shader::LEVELS * least_jump).max(share * highest).max(shader::SURE * near[1].hypot(far[1]));
    if uncertain > 0.0 {
        let around = [-1.0, 0.0, 1.0].map(|k| between(deviation, [0, 1].map(|i| place[i] + k * normal[i])));
        if around.into_iter().fold(0.0, f64::max) < uncertain * difference {
            return None;
        }
    }
    (difference > least && highest <= largest && difference <= widest).then_some(Edge {
        place,
        normal,
        levels: [near[0], far[0]],
        deviations: [near[1], far[1]],
    })
}

/// The means of V and of its deviation on the near (1) or far (-1) side, along the normal until V is halfway. A pixel
/// with the deviation `half` has half the weight; one in the slope to the other side has none.
fn level<N: Number>(
    [v, deviation]: [&Raster<N>; 2],
    place: [f64; 2],
    normal: [f64; 2],
    halfway: f64,
    side: f64,
    half: f64,
) -> Option<[f64; 2]> {
    let first = if side > 0.0 { 4 } else { 5 };
    let sampled = |k: f64| {
        let at = [0, 1].map(|i| place[i] + side * k * normal[i]);
        [k, between(v, at), between(deviation, at)]
    };
    let beyond = |v: f64| side * (v - halfway);
    let samples: Vec<[f64; 3]> = (first..=shader::FARTHEST)
        .map(|k| sampled(f64::from(k)))
        .take_while(|&[_, v, deviation]| beyond(v) > 0.0 && !deviation.is_nan())
        .collect();
    let crest = samples.iter().map(|&[_, v, _]| beyond(v)).fold(0.0, f64::max);
    let (mut sums, mut sum) = ([0.0; 2], 0.0);
    for &[k, v, deviation] in samples.iter().filter(|&&[_, v, _]| beyond(v) >= shader::CREST * crest) {
        let weight = (-k * k / (2.0 * shader::WEIGHT)).exp() / (1.0 + (deviation / half).powi(2));
        sums = [sums[0] + weight * v, sums[1] + weight * deviation];
        sum += weight;
    }
    (samples.len() >= 2).then(|| sums.map(|s| s / sum))
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::edge::testing::count;

    use super::*;

    #[test]
    fn the_level_of_a_narrow_bar_is_that_of_its_middle() {
        // A bar 10 px wide, between slopes of some 6 px: 3.64 px² would be the mean of the pixels above halfway.
        let [near, far] = [5.0, -5.0];
        let rise = |x: f64| 0.5 + 0.5 * (x / 3.0).tanh();
        let v = Field::from_fn(64, 48, |x, _| far + (near - far) * rise(x as f64 - 25.0) * rise(35.0 - x as f64));
        let c = Constants::of_pair(0, [64, 48], 0, [64, 48]);
        let edges = cpu_reference(&c, &v, &Field::from_fn(64, 48, |_, _| 0.1));
        let edge = edge::all_cells([64, 48]).find_map(|cell| Edge::found(&edges, cell)).unwrap();
        let middle = v.get(30, 20);
        assert!(middle - edge.levels[0] < 0.5 && edge.levels[0] < middle, "{edge:?}, {middle}");
    }

    #[test]
    fn an_edge_is_where_v_is_halfway_with_the_levels_of_its_sides() {
        let [near, far] = [5.0, -2.0];
        let v = Field::from_fn(64, 48, |x, _| {
            let share = 0.5 + 0.5 * ((x as f64 - 30.3) / 1.5).tanh();
            share * near + (1.0 - share) * far
        });
        let deviation = Field::from_fn(64, 48, |x, _| if x > 30 { 0.2 } else { 0.1 });
        let c = Constants::of_pair(0, [64, 48], 0, [64, 48]);
        let edge = Edge::found(&cpu_reference(&c, &v, &deviation), [7, 5]).unwrap();
        assert!((edge.place[0] - 30.3).abs() < 0.1, "{edge:?}");
        assert!((edge.normal[0] - 1.0).abs() < 1e-12 && edge.normal[1].abs() < 1e-12);
        assert!((edge.levels[0] - near).abs() < 0.05 && (edge.levels[1] - far).abs() < 0.05, "{edge:?}");
        assert!((edge.deviations[0] - 0.2).abs() < 1e-9 && (edge.deviations[1] - 0.1).abs() < 1e-9, "{edge:?}");
        // Nor has one of the same sign on both sides an edge on a coarser level.
        let coarse = Constants::of_pair(1, [64, 48], 0, [64, 48]);
        let edges_above = |least: f64| {
            let v = Field::from_fn(64, 48, |x, y| v.get(x, y) + least - far);
            count(&cpu_reference(&coarse, &v, &deviation)) > 0
        };
        assert_eq!([-3.0, 1.0].map(edges_above), [true, false]);
        // A slope that goes on is none.
        let slope = Field::from_fn(64, 48, |x, _| 0.4 * x as f64);
        assert_eq!(count(&cpu_reference(&c, &slope, &deviation)), 0);
        // In a sweep neither is a jump on which u is certain, a jump that is too wide, or one beyond what frames show.
        let of_sweep = |certain: f64, rate: f64, left: f32| {
            let deviation = Field::from_fn(64, 48, |x, _| if x.abs_diff(30) < 3 { certain * 7.0 } else { 0.1 });
            let c = Constants::of_sweep(0, [64, 48], rate, [left, 0.0, 63.0, 47.0]);
            count(&cpu_reference(&c, &v, &deviation)) > 0
        };
        let found = [(0.07, 0.5, 0.0), (0.05, 0.5, 0.0), (0.07, 0.7, 0.0), (0.07, 0.5, 31.0)];
        assert_eq!(found.map(|(certain, rate, left)| of_sweep(certain, rate, left)), [true, false, false, false]);
    }
}
