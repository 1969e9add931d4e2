//! The passes of the search for outlines at depth edges, of pairs and of sweeps. Section 7 of `docs/method.md`.
//!
//! It starts on a coarse level, where a wide blur spans few pixels, and ends on the finest.

use super::compose::Composer;
use crate::engine::arguments::{Edges, Grid, Indirect, Place};
use crate::engine::plan::Level;
use crate::engine::slot::{Reads, Slot};
use crate::engine::stages::{
    NO_VARIANT, edge, edge_agree, edge_apply, edge_cells, edge_coarsen, edge_costs, edge_decide, edge_refine,
    edge_straighten,
};
use crate::engine::vulkan::Variant;

/// How the edges of V, or of u of a sweep, are found on a level, and their outlines moved.
pub(crate) struct Search {
    pub(crate) coarsening: edge_coarsen::Constants,
    pub(crate) cells: edge_cells::Constants,
    /// The number of levels of the solve; 0 for a sweep, because its levels have no words in the arguments.
    pub(crate) levels: usize,
    pub(crate) criteria: Criteria,
}

/// When an outline is accepted.
#[derive(Clone, Copy)]
pub(crate) struct Criteria {
    /// σ² of the weights of cells along an edge, px².
    pub(crate) spread: f32,
    /// The least saving over the cost of V as it is where residuals are independent, per cell; below 0, what an outline
    /// may cost more.
    pub(crate) least_saving: f32,
}

/// The criteria of pairs on the finest level. V as it is was fitted to the pixels that are costed, the two layers were
/// not: they may cost a little more.
const FINEST: Criteria = Criteria { spread: 4.0, least_saving: -1.0 };
/// The criteria of pairs on a coarser level, where noise of V is less. True outlines of generated scenes cost 9 to 70
/// less than V as it is.
const COARSE: Criteria = Criteria { spread: 4.0, least_saving: 8.0 };
/// The criteria of sweeps. With the spread of pairs 14.0 % of the pixels at bars were off by
/// more than half a frame, with 8 to 16 px² 13.2 % (an earlier version), and the sides of a metal part are straighter.
pub(crate) const OF_SWEEPS: Criteria = Criteria { spread: 8.0, ..FINEST };

impl Composer<'_> {
    /// V and its standard deviation at depth edges, by the outlines that explain the photographs best.
    pub(super) fn edges(&mut self) {
        let plan = self.plan;
        let [sides, end] = [edge::SIDES, edge::SIDES + 1].map(|n| n as u32);
        self.empty(Slot::Stacks, plan.size, sides..end);
        let is_searched = |level: &&Level| is_searched(level.index, plan.settings.blur_limit());
        for level in plan.pyramid.iter().filter(is_searched).rev() {
            let cells = edge_cells::Constants::of_pair(level.index, level.size, plan.solved, plan.size);
            let coarsening = edge_coarsen::Constants::of_pair(level, plan.size);
            let criteria = if level.index == 0 { FINEST } else { COARSE };
            let search = Search { coarsening, cells, levels: plan.solved, criteria };
            let images =
                [Slot::Luminance { image: 0, level: level.index }, Slot::Luminance { image: 1, level: level.index }]
                    .map(Slot::read);
            let constants = edge_costs::Constants::of_pair(level, plan.solved);
            self.outlines(level, &search, |s, cells| s.edge_costs(level, images, &constants, NO_VARIANT, cells));
        }
    }

    /// Adds the costs of displaced outlines by two photographs.
    pub(super) fn edge_costs(
        &mut self,
        level: &Level,
        [image1, image2]: [Reads; 2],
        constants: &edge_costs::Constants,
        variant: Variant,
        cells: Grid,
    ) {
        let bindings = edge_costs::Bindings { image1, image2, ..edge_costs::Bindings::on(level.index) };
        self.dispatch(bindings, constants, variant, cells);
    }

    /// Finds the edges of V on a level, and moves their outlines by the costs that `costs` adds. V and its standard
    /// deviation are those of the finest level.
    pub(super) fn outlines(&mut self, level: &Level, search: &Search, costs: impl FnOnce(&mut Self, Grid)) {
        self.place = Place::level(level.index);
        let (size @ [width, height], index) = (level.size, level.index);
        let v = Slot::RelativeBlur { level: index };
        let over = |over| Grid::Indirect(Indirect::Edges { levels: search.levels, over });
        let (cells, pixels) = (over(Edges::Cells(level.index)), over(Edges::Pixels(level.index)));
        if level.index > 0 {
            let bindings = edge_coarsen::Bindings { coarse: v.write(), ..edge_coarsen::Bindings::on(0) };
            self.over(size, bindings, &search.coarsening, NO_VARIANT);
        }
        self.over(edge::cells(size), edge_cells::Bindings::on(index), &search.cells, NO_VARIANT);
        let argument_place = search.cells.argument_place;
        let constants = edge_straighten::Constants { width, height, argument_place };
        self.dispatch(edge_straighten::Bindings::on(index), &constants, NO_VARIANT, cells);
        costs(self, cells);
        let constants = edge_decide::Constants { width, height, argument_place };
        self.dispatch(edge_decide::Bindings::on(index), &constants, NO_VARIANT, cells);
        for n in 0..edge_agree::PASSES {
            let (from, to) = (edge_agree::place(n), edge_agree::place(n + 1));
            let constants = edge_agree::Constants { width, height, from, to, argument_place };
            self.dispatch(edge_agree::Bindings::on(index), &constants, NO_VARIANT, cells);
        }
        let (decided, coarse) = (edge_agree::place(edge_agree::PASSES), u32::from(level.index > 0));
        let Criteria { spread, least_saving } = search.criteria;
        let constants = edge_apply::Constants { width, height, decided, spread, least_saving, coarse };
        self.dispatch(edge_apply::Bindings::on(index), &constants, NO_VARIANT, pixels);
        if level.index > 0 {
            let bindings = edge_refine::Bindings { coarse: v.read(), ..edge_refine::Bindings::on(0) };
            self.dispatch(bindings, &search.coarsening, NO_VARIANT, pixels);
        }
    }
}

/// Whether a level of a pair is searched for edges, by the largest |V|, px²: the finest, and coarser ones as far as |V|
/// can be too large for the next finer level.
fn is_searched(level: usize, max_relative_blur: f64) -> bool {
    let too_large = |finer: usize| max_relative_blur / f64::from(1u32 << (2 * finer)) > f64::from(edge_costs::LARGEST);
    level == 0 || level <= Edges::COARSEST && too_large(level - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_searched_as_far_as_the_limit_of_v_needs() {
        let searched = |limit: f64| (0..5).filter(|&level| is_searched(level, limit)).count();
        assert_eq!([16.0, 16.5, 64.0, 65.0, 4096.0].map(searched), [1, 2, 2, 3, 3]);
    }
}
