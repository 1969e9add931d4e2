//! The progress of a solve: the share of its work that is done.
//!
//! Work is the compulsory traffic of the dispatches, times a measured weight of their pass. How many iterations a level
//! will take is not known before. The coarsest is expected to run [`EXPECTED`] optional parts, any other as many as the
//! level before it.

use super::script::{self, Action, Script};
use super::stages::state::State;
use crate::base::Progress;

/// Parts of two iterations each that a level is expected to have beyond its first part, until a level is done.
const EXPECTED: usize = 2;

/// What an average pass moves, on the CPU device and on lavapipe.
const BYTES_PER_SECOND: f64 = 3e9;

/// What a device's time consists of.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Costs {
    /// The CPU device: passes that compute little for what they read are fast, since rows stay in the cache.
    Cpu,
    /// A Vulkan device, whose dispatches take time without work too.
    Vulkan,
}

impl Costs {
    /// The work of a dispatch, in bytes that an average pass moves in the same time.
    fn work(self, dispatch: &script::Dispatch) -> f64 {
        let (bytes, pass) = (dispatch.bytes as f64, dispatch.stage.shader.name);
        // Of a dispatch without work: 0.1 ms on lavapipe, and 0.03 ms on a CPU device that started threads for each.
        match self {
            Self::Cpu => 0.03e-3 * BYTES_PER_SECOND + bytes * Self::on_host(pass),
            Self::Vulkan => 0.1e-3 * BYTES_PER_SECOND + bytes * Self::on_lavapipe(pass),
        }
    }

    /// Time of a byte on the CPU device, relative to that of an average pass: medians of the heat sink, the metal part,
    /// pcb-header, pcb-macro and Cup, two threads. The passes over edges compute much for each cell that has one. How
    /// many have is known only when they run.
    fn on_host(pass: &str) -> f64 {
        match pass {
            "relax" => 0.1,
            "relax_grid_tiles" => 0.2,
            "relax_tiles" => 0.5,
            "shape" => 0.5,
            "subdivide" | "halve_grid" => 0.6,
            "separable" | "system_tiles" => 1.2,
            "uncertainty" => 1.2,
            "fuse" => 1.7,
            "edge_coarsen" => 1.9,
            "prolong" => 2.0,
            "uncertainty_terms" => 2.3,
            "warp" | "mask" => 2.6,
            "linearise" => 3.8,
            "blur_matched_pair" => 5.0,
            "lens_windows" => 6.0,
            "residual" | "edge_fuse" => 7.0,
            "ambiguity" => 8.0,
            "edge_cells" => 8.5,
            "edge_refine" => 10.0,
            "edge_straighten" => 15.0,
            "edge_agree" => 20.0,
            "edge_decide" => 26.0,
            "edge_apply" => 105.0,
            "edge_costs" => 500.0,
            _ => 1.0,
        }
    }

    /// Time of a byte on lavapipe, relative to that of an average pass. Only passes over edges differ.
    fn on_lavapipe(pass: &str) -> f64 {
        match pass {
            "edge_coarsen" => 0.5,
            "edge_refine" => 2.0,
            "edge_straighten" | "edge_agree" => 4.0,
            "edge_fuse" => 9.0,
            "edge_decide" => 15.0,
            "edge_apply" => 340.0,
            "edge_costs" => 1080.0,
            _ => 1.0,
        }
    }
}

/// The work of a part of the script.
struct PartWork {
    /// The level that it belongs to, counted from the coarsest.
    level: usize,
    /// The iteration before which it is skipped if the level has settled.
    optional: Option<Iteration>,
    work: f64,
}

/// An outer iteration of a level.
#[derive(Clone, Copy)]
struct Iteration {
    /// 0 the finest.
    level: usize,
    k: u32,
}

impl Iteration {
    /// Whether the level had not settled before it, by a state from then or from later: the host sees a batch of parts
    /// only when all of it is done. True without a state.
    fn runs(self, state: Option<&State>) -> bool {
        state.is_none_or(|state| {
            let level = &state.levels[self.level];
            level.settled == 0 || level.iterations > self.k
        })
    }
}

/// Counts the work of the parts that are done.
pub(crate) struct WorkCounter {
    parts: Vec<PartWork>,
    /// Levels that are complete after each part.
    levels_done: Vec<u32>,
    done: f64,
    /// Optional parts of the current level that ran.
    ran: usize,
    expected: usize,
    share: f64,
}

impl WorkCounter {
    /// Counts the first `parts` parts of a script.
    pub(crate) fn new(script: &Script, parts: usize, costs: Costs) -> Self {
        let (mut level, mut optional, mut done) = (0, None, 0);
        let (mut list, mut levels_done) = (Vec::new(), Vec::new());
        for part in &script.parts[..parts] {
            // Parts without a mark belong to what is before them; after the last iteration come the results.
            let continued = part.continues.zip(part.iteration()).map(|(level, k)| Iteration { level, k });
            optional = continued.or(optional.filter(|_| part.begins.is_none()));
            let work = part.entries.iter().map(|entry| match &entry.action {
                Action::Dispatch(dispatch) => costs.work(dispatch),
                _ => 0.0,
            });
            list.push(PartWork { level, optional, work: work.sum() });
            if part.level_done.is_some() {
                (level, optional, done) = (level + 1, None, done + 1);
            }
            levels_done.push(done);
        }
        Self { parts: list, levels_done, done: 0.0, ran: 0, expected: EXPECTED, share: 0.0 }
    }

    /// The progress to print once part n is over, by the state that it has left behind or a later one.
    pub(crate) fn part_done(&mut self, part: &script::Part, n: usize, state: Option<&State>) -> Option<Progress> {
        let runs = |part: &PartWork| part.optional.is_none_or(|iteration| iteration.runs(state));
        let (ran, goes_on) = (runs(&self.parts[n]), self.parts.get(n + 1).is_none_or(runs));
        let PartWork { level, optional, work } = self.parts[n];
        if ran {
            self.done += work;
            self.ran += usize::from(optional.is_some());
        }
        let ends = self.parts.get(n + 1).is_none_or(|next| next.level != level);
        let mut left = if goes_on { self.expected.saturating_sub(self.ran).max(1) } else { 0 };
        if ends {
            self.expected = if level == 0 { EXPECTED } else { self.ran.max(1) };
            (self.ran, left) = (0, 0);
        }
        let mut remaining = 0.0;
        let mut current = level;
        for part in &self.parts[n + 1..] {
            if part.level != current {
                (current, left) = (part.level, self.expected);
            }
            if part.optional.is_none() {
                remaining += part.work;
            } else if left > 0 {
                remaining += part.work;
                left -= 1;
            }
        }
        let share = if self.done > 0.0 { self.done / (self.done + remaining) } else { 0.0 };
        // A level that needs more than was expected must not take progress back.
        self.share = self.share.max(share);
        let total = self.levels_done.last().copied().unwrap_or(0);
        let latest = Progress { done: self.levels_done[n], total, share: self.share };
        (total > 0 && (ran || part.level_done.is_some())).then_some(latest)
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;
    use crate::base::{Channels, Depth, Format, Settings};
    use crate::engine::plan::Plan;
    use crate::engine::script::{CountedPixels, compose};

    /// The shares that are printed during a solve whose levels, coarsest first, run this many optional parts: if each
    /// part is a batch, and if all are one, which ends with the last.
    fn shares(ran: &[usize]) -> [Vec<f64>; 2] {
        let gray = Format { channels: Channels::Gray, depth: Depth::F32 };
        let script = compose(&Plan::new(320, 256, [gray; 2], &Settings::default()).unwrap(), CountedPixels::All);
        let count = script.parts.len();
        let counter = || WorkCounter::new(&script, count, Costs::Vulkan);
        // Each part copies the state for the optional part behind it.
        let (mut state, mut optional) = (State::zeroed(), vec![0; ran.len()]);
        let mut states = Vec::new();
        let parts = counter().parts;
        for n in 0..count {
            if let Some(PartWork { level: place, optional: Some(Iteration { level, k }), .. }) = parts.get(n + 1) {
                let level = &mut state.levels[*level];
                if level.settled == 0 {
                    level.iterations = *k;
                    level.settled = u32::from(optional[*place] == ran[*place]);
                }
                optional[*place] += 1;
            }
            states.push(state);
        }
        [states, vec![state; count]].map(|seen| {
            let mut counter = counter();
            let done = (0..count).filter_map(|n| counter.part_done(&script.parts[n], n, Some(&seen[n])));
            done.map(|progress| progress.share).collect()
        })
    }

    #[test]
    fn progress_rises_to_one_however_many_iterations_levels_need_and_parts_a_batch_has() {
        for ran in [[5, 2, 2, 2], [9, 3, 8, 20], [0, 0, 0, 0], [1, 0, 7, 1]] {
            let [by_parts, by_batches] = shares(&ran);
            assert_eq!(by_parts, by_batches);
            assert!(by_parts.is_sorted() && by_parts[0] > 0.0, "{by_parts:?}");
            assert!((by_parts[by_parts.len() - 1] - 1.0).abs() < 1e-12, "{by_parts:?}");
            // One for each level that starts, for each optional part that runs, and for the results.
            assert!(by_parts.len() > ran.iter().sum(), "{by_parts:?}");
        }
    }
}
