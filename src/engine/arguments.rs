//! The protocol of indirect dispatch: how a level that has settled stops costing, and how I2 is brought onto I1's pixels
//! only where T has moved.
//!
//! Each solved level has [`WORDS`] words of arguments: the grids of tiles, of one colour, of all pixels, of filters along x
//! and along y and of one workgroup, then three for each pass that warps anew. Before a solve they stand as [`at_the_start`] has them.
//! [`step`](super::stages::step) writes zero into a level's words when it settles, and before an iteration that may warp
//! fills in those of the warping passes, or writes zero. What was recorded then runs over no workgroups.
//!
//! One word more stands behind those of all levels, in what the host wrote before the solve: [`GO_ON`], or [`GIVEN_UP`] once the host wants no
//! result any more. `step` then ends its level and all that are finer at once.

use super::stages::state::{LevelState, MAX_LEVELS};

/// Grids of a level that are not of one workgroup.
const GRIDS: usize = 5;
/// Words of all grids of a level.
const GRID_WORDS: usize = 3 * (GRIDS + 1);
/// Words of the passes that warp anew, at most so many a level.
const WARP_WORDS: usize = 3 * 48;
/// Words a level.
pub(crate) const WORDS: usize = GRID_WORDS + WARP_WORDS;

/// The last word while a solve is wanted.
pub(crate) const GO_ON: u32 = 0;
/// The last word once it is not.
pub(crate) const GIVEN_UP: u32 = 1;

/// Bytes of the words of so many levels, and of the last.
pub(crate) fn bytes(levels: usize) -> u64 {
    4 * (levels * WORDS + 1) as u64
}

/// What a dispatch of a level covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Over {
    /// Tiles of `linearise`.
    Tiles,
    /// The pixels of one colour.
    Half,
    /// All pixels.
    Pixels,
    /// What a filter along x goes over.
    AlongX,
    /// What a filter along y goes over.
    AlongY,
    /// One workgroup.
    One,
}

/// How many workgroups a dispatch runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Grid {
    /// So many.
    Direct([u32; 3]),
    /// What covers a level; none once that has settled.
    Level { level: usize, over: Over },
    /// Of a level's passes that warp anew the n-th: none unless T has moved.
    IfMoved { level: usize, n: usize },
}

impl Grid {
    /// The first of its three words, where the device looks them up.
    pub(crate) fn word(self) -> Option<usize> {
        match self {
            Grid::Direct(_) => None,
            Grid::Level { level, over } => Some(level * WORDS + 3 * over as usize),
            Grid::IfMoved { level, n } => Some(level * WORDS + GRID_WORDS + 3 * n),
        }
    }
}

impl Over {
    /// All but that of one workgroup, in the order of their words.
    pub(crate) const GRIDS: [Over; GRIDS] = [Over::Tiles, Over::Half, Over::Pixels, Over::AlongX, Over::AlongY];
}

/// The words of all levels before a solve, finest first: the workgroups over each of [`Over::GRIDS`], and those of each level's
/// passes that warp anew; then [`GO_ON`].
pub(crate) fn at_the_start(levels: &[[[u32; 3]; GRIDS]], warps: &[Vec<[u32; 3]>]) -> Vec<u32> {
    let words = levels.iter().zip(warps).flat_map(|(grids, warps)| {
        let mut words = [grids.as_flattened(), &[1, 1, 1], warps.as_flattened()].concat();
        assert!(words.len() <= WORDS, "{} warping passes on a level", warps.len());
        words.resize(WORDS, 0);
        words
    });
    words.chain([GO_ON]).collect()
}

/// Which words `step` zeroes once a level has settled, and which it fills in or zeroes before the next iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Words {
    /// First word of the level.
    pub(crate) place: u32,
    /// Words of it.
    pub(crate) count: u32,
    /// First word of its passes that warp anew.
    pub(crate) warp_place: u32,
    /// Words of them; none where no such passes come before the next iteration.
    pub(crate) warp_count: u32,
}

/// Those of a level.
pub(crate) fn words(level: usize, may_warp: bool) -> Words {
    let first = level * WORDS;
    Words {
        place: first as u32,
        count: WORDS as u32,
        warp_place: (first + GRID_WORDS) as u32,
        warp_count: if may_warp { WARP_WORDS as u32 } else { 0 },
    }
}

/// Where in the method a dispatch stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Place {
    /// 0 the finest.
    pub(crate) level: usize,
    /// Outer iteration of the level, if it belongs to one.
    pub(crate) iteration: Option<u32>,
    /// Whether it comes after the iteration's `step`, which ends a level that has settled.
    pub(crate) after_step: bool,
    /// Whether it belongs to a registration that comes before V is solved for.
    pub(crate) registering: bool,
}

impl Place {
    /// On a level, before or after its iterations.
    pub(crate) fn level(level: usize) -> Self {
        Self { level, ..Self::default() }
    }

    /// On a level of a registration that comes first.
    pub(crate) fn registering(level: usize) -> Self {
        Self { level, registering: true, ..Self::default() }
    }

    /// In iteration k of the same level.
    pub(crate) fn iteration(self, k: u32) -> Self {
        Self { iteration: Some(k), after_step: false, ..self }
    }

    /// In the same iteration, after its step.
    pub(crate) fn after_step(self) -> Self {
        Self { after_step: true, ..self }
    }

    /// Whether a dispatch here had any workgroups, by what each level did in the solve, and in the registration before it.
    pub(crate) fn executed(self, grid: Grid, done: &[[LevelState; MAX_LEVELS]; 2]) -> bool {
        let level = done[usize::from(self.registering)][self.level];
        let done = level.iterations;
        let if_moved = matches!(grid, Grid::IfMoved { .. });
        if if_moved && self.iteration.is_some_and(|k| level.warps >> k.ilog2() & 1 == 0) {
            return false;
        }
        self.iteration.is_none_or(|k| if self.after_step { k < relaxed(done) } else { k < done })
    }
}

/// The iterations of a level in which dV was relaxed: not its last.
pub(crate) fn relaxed(done: u32) -> u32 {
    done.saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn a_settled_level_ends_after_its_step() {
        let mut done = [[LevelState::zeroed(); MAX_LEVELS]; 2];
        done[0][1].iterations = 3;
        done[0][1].warps = 0b10;
        done[1][1].iterations = 5;
        let grid = Grid::Level { level: 1, over: Over::Pixels };
        let place = Place::level(1);
        assert!(place.executed(Grid::Direct([1; 3]), &done));
        let runs: Vec<bool> = (0..5).map(|k| place.iteration(k).executed(grid, &done)).collect();
        assert_eq!(runs, [true, true, true, false, false]);
        let runs: Vec<bool> = (0..5).map(|k| place.iteration(k).after_step().executed(grid, &done)).collect();
        assert_eq!(runs, [true, true, false, false, false]);
        assert!(Place::registering(1).iteration(4).executed(grid, &done), "a level that never settled");
        let anew = Grid::IfMoved { level: 1, n: 0 };
        let runs: Vec<bool> = [1, 2, 4].map(|k| place.iteration(k).executed(anew, &done)).to_vec();
        assert_eq!(runs, [false, true, false]);
        assert_eq!([0, 3].map(relaxed), [0, 2]);
    }

    #[test]
    fn grids_of_a_level_lie_one_after_the_other() {
        let word = |over| Grid::Level { level: 2, over }.word();
        let first = 2 * WORDS;
        assert_eq!(Over::GRIDS.map(word), [0, 3, 6, 9, 12].map(|n| Some(first + n)));
        assert_eq!(word(Over::One), Some(first + 15));
        assert_eq!(Grid::IfMoved { level: 2, n: 1 }.word(), Some(first + 21));
    }
}
