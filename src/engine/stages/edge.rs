//! Cells of 4 x 4 px at depth edges: what the passes over edges share.
//!
//! The numbers of a cell are in layers of the results beyond V, its deviation and the residual. Each cell has 16
//! numbers in a layer, at its own pixels. The CPU reference of `glsl/include/edge.glsl`.
//!
//! - Layer `EDGES`: 0 whether the cell has an edge; 1, 2 its place; 3, 4 its normal; 5, 6 V of the near and the far
//!   side; 7, 8 their deviations; 9 [`TOTAL`]; 10 to 15 place, normal and V of the straightened edge.
//! - Layer `DECISIONS`, in two places in turn (`edge_agree::place`): 0, 1 the saving over V as it is, by order; 2, 3 the
//!   variance of the displacement, by order, or `OUTSIDE` where its mean is at an end of the range; 4 the lead of
//!   order 0 over order 1; 5 how many cells continue the edge.
//!
//! Order 0 has the near side in front, order 1 the far side.

use super::{Number, Raster, pixels};
use crate::engine::shaders::edge;

/// Side of a cell, pixels.
pub(crate) const CELL: usize = edge::CELL as usize;
/// The layer of the costs with the near side in front, and of the cost of V as it is in that order, behind them.
pub(crate) const COSTS: usize = edge::COSTS as usize;
/// The layer of the same with the far side in front.
pub(crate) const REVERSED_COSTS: usize = edge::REVERSED_COSTS as usize;
/// The layer of the edges.
pub(crate) const EDGES: usize = edge::EDGES as usize;
/// The layers of the distributions of the outline's place, by order.
pub(crate) const OUTLINES: [usize; 2] = [edge::OUTLINES as usize, edge::REVERSED_OUTLINES as usize];
/// The layer of the decisions.
pub(crate) const DECISIONS: usize = edge::DECISIONS as usize;
/// The layer that tells `edge_fuse` which surface a pixel shows, near accepted outlines where V changes sign: |V| of the
/// surface in front, positive on it and negative behind it. 0 elsewhere.
pub(crate) const SIDES: usize = edge::SIDES as usize;
/// The layer of the standard deviation of V on a coarser level than the finest.
pub(crate) const COARSE_DEVIATION: usize = edge::COARSE_DEVIATION as usize;
/// The layer of V of the far side near an accepted outline of a coarser level.
pub(crate) const COARSE_FAR: usize = edge::COARSE_FAR as usize;
/// The layer of how much V may change near an accepted outline of a coarser level, 0 to 1; negative if the far side is
/// in front. 0 elsewhere.
pub(crate) const COARSE_SHARE: usize = edge::COARSE_SHARE as usize;
/// The layer of the probability that a pixel of a coarser level shows the near side.
pub(crate) const COARSE_NEAR: usize = edge::COARSE_NEAR as usize;
/// The layer of a pixel's distance from where V was halfway, towards the near side, pixels of the coarser level.
pub(crate) const COARSE_TOWARDS_NEAR: usize = edge::COARSE_TOWARDS_NEAR as usize;

/// The layer of the standard deviation of V, on the finest level or on a coarser one.
pub(super) fn deviation_layer(finest: bool) -> usize {
    if finest { 1 } else { COARSE_DEVIATION }
}

/// Layers of the results that the passes over edges need.
pub(crate) const LAYERS: u32 = edge::LAYERS;
/// Displacements of an outline, a pixel apart.
pub(crate) const DISPLACEMENTS: usize = edge::DISPLACEMENTS as usize;
/// The first displacement is this many pixels away from the side in front.
pub(crate) const BACKWARD: usize = edge::BACKWARD as usize;
/// The number of the cost of V as it is, in the layers of the costs.
pub(crate) const BEFORE: usize = DISPLACEMENTS;

/// The number of the sum of the shares of all pairs of frames in the costs, in the layer of the edges: 1 for a pair.
pub(crate) const TOTAL: usize = edge::TOTAL as usize;

/// The number of the place on the straightened edge, of the normal and of V of either side there, in the layer of the
/// edges.
pub(super) const STRAIGHT: usize = edge::STRAIGHT as usize;

/// The compulsory traffic of a pass over the cells at edges, bytes: a number of each cell read. What is read and written
/// at edges depends on the scene.
pub(super) fn traffic([width, height]: [u32; 2]) -> u64 {
    4 * pixels(width, height) / (CELL * CELL) as u64
}

/// Columns and rows of cells of an image.
pub(crate) fn cells([width, height]: [u32; 2]) -> [u32; 2] {
    [width / edge::CELL, height / edge::CELL]
}

/// All cells of an image, row by row.
pub(super) fn all_cells(size: [u32; 2]) -> impl Iterator<Item = [usize; 2]> {
    let [columns, rows] = cells(size).map(|side| side as usize);
    (0..rows).flat_map(move |y| (0..columns).map(move |x| [x, y]))
}

/// The cells that have an edge, as they are listed: row by row, where the device lists them as it finds them.
pub(super) fn listed<N: Number>(edges: &Raster<N>, size: [u32; 2]) -> Vec<u32> {
    let found = all_cells(size).filter(|&cell| Edge::found(edges, cell).is_some());
    found.map(|[x, y]| (x | y << edge::ROW_BIT) as u32).collect()
}

/// The words of the passes over edges of a level with `count` cells that have one: the workgroups over these, and over
/// pixels; the number of cells.
pub(super) fn words(count: u32, [x, y]: [u32; 2]) -> [u32; 7] {
    [count.min(edge::ALONG_X), count.div_ceil(edge::ALONG_X), 1, x, y, 1, count]
}

/// The cells within `around` of a cell.
pub(super) fn cells_around(
    [x, y]: [usize; 2],
    around: usize,
    size: [u32; 2],
) -> impl Iterator<Item = [usize; 2]> + use<> {
    let [columns, rows] = cells(size).map(|side| side as usize);
    let (xs, ys) = (
        x.saturating_sub(around)..=(x + around).min(columns - 1),
        y.saturating_sub(around)..=(y + around).min(rows - 1),
    );
    ys.flat_map(move |y| xs.clone().map(move |x| [x, y]))
}

/// The n-th number of a cell in a layer.
pub(super) fn number<N: Number>(layer: &Raster<N>, [x, y]: [usize; 2], n: usize) -> f64 {
    layer.get(CELL * x + n % CELL, CELL * y + n / CELL)
}

/// Sets the numbers of a cell in a layer, from the `first` on.
pub(super) fn set<N: Number>(layer: &mut Raster<N>, [x, y]: [usize; 2], first: usize, numbers: &[f64]) {
    for (n, number) in (first..).zip(numbers) {
        layer.data[(CELL * y + n / CELL) * layer.width + CELL * x + n % CELL] = N::of(*number);
    }
}

/// Adds to the n-th number of a cell in a layer.
pub(super) fn add<N: Number>(layer: &mut Raster<N>, cell: [usize; 2], n: usize, more: f64) {
    set(layer, cell, n, &[number(layer, cell, n) + more]);
}

/// The value between pixels, of the nearest place inside.
pub(super) fn between<N: Number>(field: &Raster<N>, [x, y]: [f64; 2]) -> f64 {
    let (low, f) = ([x.floor(), y.floor()], [x - x.floor(), y - y.floor()]);
    let [columns, rows] = [(low[0], field.width), (low[1], field.height)]
        .map(|(low, size)| [low as isize, low as isize + 1].map(|i| i.clamp(0, size as isize - 1) as usize));
    let row = |y: usize| {
        let row = field.row(y);
        let [here, next]: [f64; 2] = [row[columns[0]].into(), row[columns[1]].into()];
        here * (1.0 - f[0]) + next * f[0]
    };
    row(rows[0]) * (1.0 - f[1]) + row(rows[1]) * f[1]
}

/// The edge of a cell. Near is the side of the larger V, far the other. In a sweep V is u, in settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    /// Where V is halfway, pixels.
    pub(super) place: [f64; 2],
    /// The unit normal towards the near side.
    pub(super) normal: [f64; 2],
    /// V of the near and of the far side, px².
    pub(super) levels: [f64; 2],
    /// Their standard deviations, px².
    pub(super) deviations: [f64; 2],
}

impl Edge {
    /// The edge of a cell in the layer of edges, straightened.
    pub(super) fn of<N: Number>(edges: &Raster<N>, cell: [usize; 2]) -> Option<Self> {
        Self::on(edges, cell, [STRAIGHT, STRAIGHT + 4])
    }

    /// The edge of a cell before it is straightened.
    pub(super) fn found<N: Number>(edges: &Raster<N>, cell: [usize; 2]) -> Option<Self> {
        Self::on(edges, cell, [1, 5])
    }

    /// The edge of a cell with the place and the normal from the number `line` on, and V of the sides from `sides` on.
    fn on<N: Number>(edges: &Raster<N>, cell: [usize; 2], [line, sides]: [usize; 2]) -> Option<Self> {
        let at = |n: usize| number(edges, cell, n);
        (at(0) != 0.0).then(|| Self {
            place: [at(line), at(line + 1)],
            normal: [at(line + 2), at(line + 3)],
            levels: [at(sides), at(sides + 1)],
            deviations: [at(7), at(8)],
        })
    }

    /// As numbers of a cell that is not straightened yet and has no costs.
    pub(super) fn numbers(&self) -> [f64; 10] {
        let Self { place, normal, levels, deviations } = self;
        [1.0, place[0], place[1], normal[0], normal[1], levels[0], levels[1], deviations[0], deviations[1], 0.0]
    }

    /// How far two cells lie on one edge, 0 to 1: the cosine of the angle between their normals. 0 if one is off the
    /// line of the other.
    pub(super) fn agreement(&self, other: &Self) -> f64 {
        let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
        let along = dot(self.normal, other.normal);
        let apart = [other.place[0] - self.place[0], other.place[1] - self.place[1]];
        let both = [self.normal[0] + other.normal[0], self.normal[1] + other.normal[1]];
        let off = 0.5 * dot(apart, both).abs();
        if along < 0.7 || off > 2.0 + 0.25 * apart[0].hypot(apart[1]) { 0.0 } else { along }
    }
}

/// Which side a pixel shows, 1 the near and 0 the far one, by the probability that it shows the near one. It shows one
/// of them, not a V between. Only within 1/20 of a half it is mixed, so that rounding does not decide.
pub(super) fn shown_near(probability: f64) -> f64 {
    (edge::STEEPNESS * (probability - 0.5) + 0.5).clamp(0.0, 1.0)
}

/// The standard deviation of V around that of the side shown, as a share of the jump.
pub(super) fn deviation_between(probability: f64, near: f64) -> f64 {
    let probability = probability.clamp(0.0, 1.0);
    (probability * (1.0 - near).powi(2) + (1.0 - probability) * near.powi(2)).sqrt()
}

/// How far V changes at a distance from where it was halfway, towards the near side, px, to V of the side shown, 0 to
/// 1: fully if it shows the other side now. V passes from one side to the other over some 5 px; what stays on its side
/// hardly changes beyond.
pub(super) fn change(towards_near: f64, near: f64) -> f64 {
    let passes = ((edge::PASSED - towards_near.abs()) / (edge::PASSED - edge::PASSING)).clamp(edge::UNCHANGED, 1.0);
    passes + (1.0 - passes) * if towards_near > 0.0 { 1.0 - near } else { near }
}

/// Fields for the tests of the passes over edges.
#[cfg(test)]
pub(super) mod testing {
    use super::super::Field;
    use super::super::harness::smooth_field;
    use super::super::{edge_cells, edge_costs, edge_decide, edge_straighten};
    use super::*;

    /// V with an edge along a curve, the near side right of it, and a deviation. NaN in a corner of the deviation.
    pub(in super::super) fn solved(width: usize, height: usize, levels: [f64; 2]) -> [Field; 2] {
        let v = Field::from_fn(width, height, |x, y| {
            let from_edge = x as f64 - 0.45 * width as f64 - 4.0 * (y as f64 / 9.0).sin();
            let share = 0.5 + 0.5 * (from_edge / 2.0).tanh();
            share * levels[0] + (1.0 - share) * levels[1]
        });
        let deviation =
            Field::from_fn(width, height, |x, y| if x < 5 && y < 7 { f64::NAN } else { 0.05 + 0.01 * (x % 3) as f64 });
        [v, deviation]
    }

    /// The layers of the results up to `until`, by the CPU references.
    pub(in super::super) fn layers(size: [u32; 2], levels: [f64; 2], until: usize) -> Vec<Field> {
        let [width, height] = size.map(|side| side as usize);
        let [v, deviation] = solved(width, height, levels);
        let mut layers = vec![Field::zeros(width, height); LAYERS as usize];
        layers[0] =
            Field::from_fn(width, height, |x, y| if deviation.get(x, y).is_nan() { f64::NAN } else { v.get(x, y) });
        layers[1] = deviation.clone();
        layers[COARSE_DEVIATION] =
            Field::from_fn(width, height, |x, y| if x + y > width { f64::NAN } else { 0.2 + 0.01 * (y % 5) as f64 });
        layers[SIDES] = Field::from_fn(width, height, |_, _| 0.7);
        let found = edge_cells::cpu_reference(&edge_cells::Constants::of_pair(0, size, 0, size), &v, &deviation);
        layers[EDGES] = edge_straighten::cpu_reference(size, &found);
        if until > COSTS {
            let photographs = [1, 2].map(|seed| smooth_field(width, height, seed));
            let c = edge_costs::testing::constants(size);
            [layers[COSTS], layers[REVERSED_COSTS], layers[EDGES]] =
                edge_costs::testing::of_pair(&c, photographs.each_ref(), &v, layers[EDGES].clone());
        }
        if until >= OUTLINES[0] {
            let [near, far, decisions] =
                edge_decide::cpu_reference(size, [&layers[COSTS], &layers[REVERSED_COSTS]], &layers[EDGES]);
            (layers[OUTLINES[0]], layers[OUTLINES[1]], layers[DECISIONS]) = (near, far, decisions);
        }
        layers
    }

    /// The number of cells with an edge.
    pub(in super::super) fn count(edges: &Field) -> usize {
        all_cells([edges.width as u32, edges.height as u32]).filter(|&cell| Edge::found(edges, cell).is_some()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_listed_cell_has_a_workgroup() {
        let groups = |count| words(count, [2, 3]);
        assert_eq!(groups(1), [1, 1, 1, 2, 3, 1, 1]);
        assert_eq!(groups(edge::ALONG_X)[..3], [edge::ALONG_X, 1, 1]);
        assert_eq!(groups(edge::ALONG_X + 1)[..3], [edge::ALONG_X, 2, 1]);
    }

    #[test]
    fn cells_on_one_line_agree_and_parallel_lines_do_not() {
        let edge = |place, angle: f64| Edge {
            place,
            normal: [angle.cos(), angle.sin()],
            levels: [1.0, 0.0],
            deviations: [0.1; 2],
        };
        let here = edge([10.0, 10.0], 0.0);
        assert_eq!(here.agreement(&here), 1.0);
        assert_eq!(here.agreement(&edge([10.5, 18.0], 0.0)), 1.0);
        assert_eq!(here.agreement(&edge([16.0, 12.0], 0.0)), 0.0);
        assert!((here.agreement(&edge([10.0, 14.0], 0.5)) - 0.5f64.cos()).abs() < 1e-12);
        assert_eq!(here.agreement(&edge([10.0, 14.0], 1.0)), 0.0);
    }
}
