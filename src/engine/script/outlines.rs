//! The passes of the search for outlines at depth edges, of pairs and of sweeps. Section 7 of `docs/method.md`.
//!
//! It begins on a coarse level, where much blur is little, and ends on the finest.

use super::compose::Composer;
use crate::engine::arguments::{Edges, Grid};
use crate::engine::plan::Level;
use crate::engine::slot::{self, Slot};
use crate::engine::stages::{
    NO_VARIANT, edge, edge_agree, edge_apply, edge_cells, edge_coarsen, edge_costs, edge_decide, edge_refine,
};

/// σ² of the weights of cells along an edge of a pair, px².
const SPREAD: f32 = 4.0;
/// By how much an outline of a pair must cost less than V as it is on a coarser level than the finest, per cell. True
/// outlines of generated scenes cost 9 to 70 less.
const COARSE_GAIN: f32 = 8.0;
/// The cells that must continue an edge of a pair there.
const COARSE_LENGTH: f32 = 3.0;

/// How the edges of V, or of u of a sweep, are found on a level, and their outlines moved.
pub(crate) struct Search {
    pub(crate) scaled: edge_coarsen::Constants,
    pub(crate) found: edge_cells::Constants,
    /// σ² of the weights of cells along an edge, px².
    pub(crate) spread: f32,
    /// By how much an outline must cost less than V as it is, per cell.
    pub(crate) gain: f32,
    /// The cells that must continue an edge.
    pub(crate) length: f32,
    /// The levels of the solve; 0 for a sweep, whose levels have no words of their own.
    pub(crate) levels: usize,
}

impl Search {
    /// By how much an outline must cost less than V as it is, and the cells that must continue an edge, where much is
    /// known of V: noise of V makes shorter edges.
    pub(crate) const LEAST: (f32, f32) = (0.0, 4.0);
}

impl Composer<'_> {
    /// V and its standard deviation at depth edges, by the outlines that explain the photographs best.
    ///
    /// Of the coarser levels only those are searched on which |V| can be too large for the next finer one.
    pub(super) fn edges(&mut self) {
        let plan = self.plan;
        let [sides, end] = [edge::SIDES, edge::SIDES + 1].map(|n| n as u32);
        self.empty(Slot::Stacks, plan.size, sides..end);
        let largest = f64::from(edge_costs::LARGEST);
        let is_searched = |level: &&Level| {
            let finer = plan.settings.max_relative_blur / (level.factor / 2.0).powi(2);
            level.index == 0 || level.index <= Edges::COARSEST && finer > largest
        };
        for level in plan.pyramid.iter().filter(is_searched).rev() {
            let found = edge_cells::Constants::of_pair(level.index, level.size, plan.solved, plan.size);
            let scaled = edge_coarsen::Constants::of_pair(level, plan.size);
            let (gain, length) = if level.index == 0 { Search::LEAST } else { (COARSE_GAIN, COARSE_LENGTH) };
            let search = Search { scaled, found, spread: SPREAD, gain, length, levels: plan.solved };
            self.outlines(level, &search, |s, tiles| {
                let bindings = edge_costs::Bindings {
                    i1: slot::i1(level.index).read(),
                    i2: slot::i2(level.index).read(),
                    v: slot::relative_blur(level.index).read(),
                    results: slot::RESULTS.update(),
                    state: slot::STATE.read(),
                };
                s.dispatch(bindings, &edge_costs::Constants::of_pair(level), NO_VARIANT, tiles);
            });
        }
    }

    /// Finds the edges of V on a level, and moves their outlines by the costs that `costs` adds. V and its standard
    /// deviation are those of the finest level.
    pub(super) fn outlines(&mut self, level: &Level, search: &Search, costs: impl FnOnce(&mut Self, Grid)) {
        let (size @ [width, height], v) = (level.size, slot::relative_blur(level.index));
        let (finest, results) = (slot::relative_blur(0), slot::RESULTS.update());
        let over = |over| Grid::Edges { levels: search.levels, over };
        let (cells, pixels) = (over(Edges::Cells(level.index)), over(Edges::Pixels(level.index)));
        if level.index > 0 {
            let bindings = edge_coarsen::Bindings { v: finest.read(), coarse: v.write(), results };
            self.over(size, bindings, &search.scaled, NO_VARIANT);
        }
        let bindings = edge_cells::Bindings { v: v.read(), results, arguments: slot::ARGUMENTS.write() };
        self.over(edge::cells(size), bindings, &search.found, NO_VARIANT);
        costs(self, over(Edges::Tiles(level.index)));
        let bindings = edge_decide::Bindings { results };
        self.dispatch(bindings, &edge_decide::Constants { width, height }, NO_VARIANT, cells);
        for n in 0..edge_agree::PASSES {
            let bindings = edge_agree::Bindings { results };
            let (from, to) = (edge_agree::place(n), edge_agree::place(n + 1));
            self.dispatch(bindings, &edge_agree::Constants { width, height, from, to }, NO_VARIANT, cells);
        }
        let bindings = edge_apply::Bindings { v: v.update(), results };
        let (decided, coarse) = (edge_agree::place(edge_agree::PASSES), u32::from(level.index > 0));
        let &Search { spread, gain, length, .. } = search;
        let constants = edge_apply::Constants { width, height, decided, spread, gain, length, coarse };
        self.dispatch(bindings, &constants, NO_VARIANT, pixels);
        if level.index > 0 {
            let bindings = edge_refine::Bindings { coarse: v.read(), v: finest.update(), results };
            self.dispatch(bindings, &search.scaled, NO_VARIANT, pixels);
        }
    }
}
