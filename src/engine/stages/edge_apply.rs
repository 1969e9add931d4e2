//! Replaces V and its standard deviation at accepted outlines by those of two layers. Section 7 of `docs/method.md`.
//!
//! With the probability p that a pixel shows the near side, from the distributions of the cells around it,
//! `V = s V_near + (1 - s) V_far` and `σ = √(p (1 - s)² + (1 - p) s²) |V_near - V_far| + p σ_near + (1 - p) σ_far`. s
//! is 0 or 1 but for p within 0.05 of a half. V changes only if the outline explains the photographs about as well as V
//! did, and better than any with the other side in front; if the photographs determine its place; and if it goes on for
//! some cells. Where the kernel does not describe the blur, V is off from place to place, and outlines of what is no
//! surface explain the photographs about as well: the more neighbouring residuals are correlated, the better it must
//! be.

use super::edge::{
    self, BACKWARD, COARSE_FAR, COARSE_NEAR, COARSE_SHARE, COARSE_TOWARDS_NEAR, DECISIONS, DISPLACEMENTS, EDGES, Edge,
    OUTLINES, SIDES,
};
use super::pass::{Memory, Pass};
use super::rows::{self, Rows};
use super::{Number, Raster, WORKGROUP};
use crate::engine::vulkan::Variant;

pub use super::interface::edge_apply::*;
use crate::engine::shaders::edge_apply as shader;

impl Pass for Bindings {
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        edge::traffic([c.width, c.height])
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let (layer, correlated) = (|n| memory.layer(self.results, n), memory.state(self.state).correlated);
        let outlines = OUTLINES.map(layer);
        let deviation_layer = edge::deviation_layer(c.coarse == 0);
        let (v, deviation) = (memory.layer(self.relative_blur, 0), layer(deviation_layer));
        if c.coarse != 0 {
            let none = Raster::zeros(v.width, v.height);
            let before = [v, deviation, &none, &none, &none, &none];
            let [v, after @ ..] = cpu_reference(c, correlated, before, layer(EDGES), outlines, layer(DECISIONS));
            memory.set_layer(self.relative_blur, 0, v);
            let layers = [deviation_layer, COARSE_FAR, COARSE_SHARE, COARSE_NEAR, COARSE_TOWARDS_NEAR];
            layers.into_iter().zip(after).for_each(|(n, layer)| memory.set_layer(self.results, n, layer));
            return;
        }
        let [v, deviation, sides] =
            cpu_reference(c, correlated, [v, deviation, layer(SIDES)], layer(EDGES), outlines, layer(DECISIONS));
        let masked =
            Raster::from_fn(
                v.width,
                v.height,
                |x, y| if deviation.get(x, y).is_nan() { f64::NAN } else { v.get(x, y) },
            );
        memory.set_layer(self.relative_blur, 0, v);
        memory.set_layer(self.results, 0, masked);
        memory.set_layer(self.results, 1, deviation);
        memory.set_layer(self.results, SIDES, sides);
    }
}

/// Cells around with an outline of the same order, with the cell itself, without which an outline does not count. Of
/// a long edge the last cell goes, as five are around it.
const LEAST_AROUND: usize = shader::LEAST_AROUND as usize;
// The shader keeps a row of cells in the bits of a word: those of the workgroup, and 2 `AROUND` on either side.
const _: () = assert!(WORKGROUP[0] as usize / edge::CELL + 4 * shader::AROUND as usize <= u32::BITS as usize);

/// V, its standard deviation, and the sides, from those before. On a coarser level: V of the near side, the deviation
/// of the sides, V of the far side, how much V may change, the probability of the near side, and the distance towards
/// it.
pub(crate) fn cpu_reference<N: Number, const COUNT: usize>(
    c: &Constants,
    correlated: f64,
    before: [&Raster<N>; COUNT],
    edges: &Raster<N>,
    outlines: [&Raster<N>; 2],
    decisions: &Raster<N>,
) -> [Raster<N>; COUNT] {
    let (size, coarse, v, deviation) = ([c.width, c.height], c.coarse != 0, before[0], before[1]);
    let mut results = before.map(Raster::clone);
    let (columns_and_rows @ [columns, _], around) = (edge::cells(size).map(|n| n as usize), shader::AROUND as usize);
    let least_saving = f64::from(c.least_saving) + correlated * (shader::CORRELATED - f64::from(c.least_saving));
    let most_variance = shader::MOST_VARIANCE + correlated * (shader::CORRELATED_VARIANCE - shader::MOST_VARIANCE);
    let of_cell = |cell| Some((Edge::of(edges, cell)?, order(c, [least_saving, most_variance], decisions, cell)?));
    let mut accepted: Vec<Option<(Edge, usize)>> = edge::all_cells(size).map(of_cell).collect();
    let orders: Vec<Option<usize>> = accepted.iter().map(|cell| Some(cell.as_ref()?.1)).collect();
    for (cell, accepted) in edge::all_cells(size).zip(&mut accepted) {
        let is_alike = |[x, y]: &[usize; 2]| orders[y * columns + x] == accepted.as_ref().map(|(_, order)| *order);
        if accepted.is_some() && edge::cells_around(cell, around, size).filter(is_alike).count() < LEAST_AROUND {
            *accepted = None;
        }
    }
    // Most pixels are far from all outlines.
    let mut is_near = vec![false; accepted.len()];
    for (cell, _) in edge::all_cells(size).zip(&accepted).filter(|(_, accepted)| accepted.is_some()) {
        edge::cells_around(cell, around, size).for_each(|[x, y]| is_near[y * columns + x] = true);
    }
    let mixed = |[x, y]: [usize; 2], accepted: &[([usize; 2], &(Edge, usize))], results: [&mut N; COUNT]| {
        let (mut sum, mut near, mut levels, mut deviations) = (0.0, 0.0, [0.0; 2], [0.0; 2]);
        let (mut nearest, mut near_in_front, mut towards_near) = (f64::MAX, 0.0, 0.0);
        for &(cell, (edge, order)) in accepted {
            // Columns and rows of pixels beyond the last cell have their own cells.
            if cell[0] + around < x / edge::CELL || cell[1] + around < y / edge::CELL {
                continue;
            }
            let apart = [x as f64 - edge.place[0], y as f64 - edge.place[1]];
            let inside = apart[0] * edge.normal[0] + apart[1] * edge.normal[1];
            let along = apart[1] * edge.normal[0] - apart[0] * edge.normal[1];
            if inside.abs() > shader::FARTHEST {
                continue;
            }
            nearest = nearest.min(inside * inside + 4.0 * along * along);
            let weight = (-along * along / (2.0 * f64::from(c.spread)) - inside * inside / (2.0 * shader::AWAY)).exp();
            let in_front = |inside: f64| in_front(outlines[*order], cell, inside);
            sum += weight;
            near += weight * if *order == 0 { in_front(inside) } else { 1.0 - in_front(-inside) };
            towards_near += weight * inside;
            near_in_front += if *order == 0 { weight } else { 0.0 };
            for i in 0..2 {
                levels[i] += weight * edge.levels[i];
                deviations[i] += weight * edge.deviations[i];
            }
        }
        if sum < 1e-3 {
            return;
        }
        let (p, towards_near) = (near / sum, towards_near / sum);
        let (shown, [near, far]) = (edge::shown_near(p), levels.map(|level| level / sum));
        let of_sides = (p * deviations[0] + (1.0 - p) * deviations[1]) / sum;
        let fading = (shader::FARTHEST - nearest.sqrt()) / (shader::FARTHEST - shader::FADING);
        let share = fading.clamp(0.0, 1.0) * (sum / 0.3).min(1.0);
        let (before, deviation, near_front) = (v.get(x, y), deviation.get(x, y), near_in_front > 0.5 * sum);
        if coarse {
            let share = if deviation.is_nan() { 0.0 } else { share };
            let numbers = [near, of_sides, far, if near_front { share } else { -share }, p, towards_near];
            results.into_iter().zip(numbers).for_each(|(result, number)| *result = N::of(number));
            return;
        }
        let share = share * edge::change(towards_near, shown);
        let now = before + share * (far + shown * (near - far) - before);
        let mixed = edge::deviation_between(p, shown) * (near - far).abs() + of_sides;
        *results[0] = N::of(now);
        *results[1] = N::of(deviation + share * (mixed - deviation));
        // By the sign of V, as the fused image takes the photographs.
        let front = if near_front { near } else { far };
        if near * far < 0.0 && !deviation.is_nan() && share > 0.0 {
            *results[2] = N::of(if now * front > 0.0 { front.abs() } else { -front.abs() });
        }
    };
    rows::map(results.each_mut().map(Rows::from), |y, mut rows| {
        let row = (y / edge::CELL).min(columns_and_rows[1] - 1);
        for column in (0..columns).filter(|column| is_near[row * columns + column]) {
            let around = edge::cells_around([column, row], around, size);
            let accepted: Vec<_> =
                around.filter_map(|cell| Some((cell, accepted[cell[1] * columns + cell[0]].as_ref()?))).collect();
            let end = if column + 1 == columns { rows[0].len() } else { edge::CELL * (column + 1) };
            (edge::CELL * column..end).for_each(|x| mixed([x, y], &accepted, rows.each_mut().map(|row| &mut row[x])));
        }
    });
    results
}

/// The order in which an outline is accepted: 0 with the near side in front, 1 with the far side.
fn order<N: Number>(
    c: &Constants,
    [least_saving, most_variance]: [f64; 2],
    decisions: &Raster<N>,
    cell: [usize; 2],
) -> Option<usize> {
    let at = |n: usize| edge::number(decisions, cell, c.decided as usize + n);
    let order = usize::from(at(4) < 0.0);
    (at(4).abs() > shader::ORDER
        && at(order) > least_saving
        && at(2 + order) < most_variance
        && at(5) > shader::LEAST_LENGTH)
        .then_some(order)
}

/// The probability that a place is in front that is `inside` px inside of where V is halfway.
fn in_front<N: Number>(outlines: &Raster<N>, cell: [usize; 2], inside: f64) -> f64 {
    let place = (inside + BACKWARD as f64 + 1.0).clamp(0.0, DISPLACEMENTS as f64);
    let n = place as usize;
    let below = if n == 0 { 0.0 } else { edge::number(outlines, cell, n - 1) };
    if n == DISPLACEMENTS { below } else { below + (place - n as f64) * (edge::number(outlines, cell, n) - below) }
}

#[cfg(test)]
mod tests {

    use super::super::edge::testing::{layers, solved};

    use super::*;

    const CONSTANTS: Constants =
        Constants { width: 0, height: 0, decided: 0, spread: 4.0, least_saving: 0.0, coarse: 0 };

    /// Whether V changes if the cells below `rows` have these decisions, and others have no evidence.
    fn changes(rows: usize, decisions: [f64; 6], correlated: f64) -> bool {
        let (size, c) = ([67, 81], Constants { width: 67, height: 81, ..CONSTANTS });
        let mut results = layers(size, [4.0, -3.0], DECISIONS);
        for cell in edge::all_cells(size) {
            edge::set(&mut results[DECISIONS], cell, 0, if cell[1] < rows { &decisions } else { &[0.0; 6] });
        }
        let [v, deviation] = solved(67, 81, [4.0, -3.0]);
        let (outlines, before) = (OUTLINES.map(|n| &results[n]), [&v, &deviation, &results[SIDES]]);
        cpu_reference(&c, correlated, before, &results[EDGES], outlines, &results[DECISIONS])[0] != v
    }

    #[test]
    fn too_little_evidence_changes_nothing() {
        let evidence = |saving, variance| [saving, 0.0, variance, 0.0, 9.0, 9.0];
        assert!(changes(20, evidence(7.0, 0.5), 0.0));
        assert!(!changes(20, [7.0, 0.0, 0.5, 0.0, shader::ORDER - 0.1, 9.0], 0.0));
        assert!(!changes(20, [7.0, 0.0, 0.5, 0.0, 9.0, shader::LEAST_LENGTH - 0.1], 0.0));
        // With correlated residuals an outline must cost 8 less.
        assert!(!changes(20, evidence(7.0, 0.5), 1.0));
        // Its place must be known to 2 px, and with correlated residuals to 1 px.
        for (variance, of_independent, of_correlated) in
            [(0.9, true, true), (1.1, true, false), (3.9, true, false), (4.1, false, false)]
        {
            let accepted = [0.0, 1.0].map(|correlated| changes(20, evidence(9.0, variance), correlated));
            assert_eq!(accepted, [of_independent, of_correlated], "{variance}");
        }
        assert_eq!([2.4, 2.6].map(|variance| changes(20, evidence(9.0, variance), 0.5)), [true, false]);
        // With the far side in front.
        assert!(changes(20, [0.0, 9.0, 9.0, 0.5, -9.0, 9.0], 0.0));
        assert!(!changes(20, [0.0, 9.0, 0.5, 9.0, -9.0, 9.0], 0.0));
    }

    #[test]
    fn fewer_than_six_cells_change_nothing() {
        let edges = &layers([67, 81], [4.0, -3.0], EDGES)[EDGES];
        let is_below = |rows: usize, cell: [usize; 2]| cell[1] < rows && Edge::of(edges, cell).is_some();
        let count = |rows| edge::all_cells([67, 81]).filter(|cell| is_below(rows, *cell)).count();
        let few = (0..20).rev().find(|rows| count(*rows) < LEAST_AROUND).unwrap();
        assert!(count(few) > 3, "{few}");
        let evidence = [7.0, 0.0, 0.5, 0.0, 9.0, 9.0];
        assert_eq!([few, 20].map(|rows| changes(rows, evidence, 0.0)), [false, true]);
    }
}
