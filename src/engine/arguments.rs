//! The protocol of indirect dispatch: recorded dispatches that run no workgroups when not needed.
//!
//! Each level has [`WORDS`] words of arguments: the workgroups of what passes run over ([`Over`]); then three for each
//! pass that warps I2 again. Before a solve they are the [`initial_words`].
//! The step of T, by [`update_transform`](super::stages::update_transform) or the last workgroup of `linearise`, zeroes
//! a level's words when it settles. Before an iteration that may warp it restores the words of the warping passes, or
//! zeroes them.
//!
//! After those of all levels come the workgroups of the passes over [`Edges`]: zero until
//! [`edge_cells`](super::stages::edge_cells) finds an edge. The last word is [`NOT_CANCELLED`]. The host sets it to
//! [`CANCELLED`] at any time; the step of T then ends its level and all finer ones.

use std::ops::Range;

use super::shaders;
use super::stages::state::{LevelState, MAX_LEVELS};

/// The most coarse grids that have workgroups of their own: those of a level of 65536 x 65536 pixels.
const COARSE: usize = 11;
/// The number of [`Over`] without those of coarse grids.
const FIRST: usize = 5;
/// The number of all [`Over`]: each coarse grid has one, and one for its tiles.
const GRIDS: usize = FIRST + 2 * COARSE;
/// Words of all grids of a level.
const GRID_WORDS: usize = 3 * GRIDS;
/// Words of a level. The last are those of the passes that warp I2 again.
pub(crate) const WORDS: usize = shaders::update_transform::WORDS as usize;
const _: () = assert!(WORDS == GRID_WORDS + shaders::update_transform::WARP_WORDS as usize);

/// The last word unless the solve is cancelled.
pub(crate) const NOT_CANCELLED: u32 = 0;
/// The last word of a cancelled solve.
pub(crate) const CANCELLED: u32 = 1;

/// What a pass over depth edges runs over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Edges {
    /// The pixels of the fused image, if any level has an edge.
    Fused,
    /// The cells of a level that have an edge.
    Cells(usize),
    /// Pixels of a level.
    Pixels(usize),
}

impl Edges {
    /// The coarsest level that is searched for edges.
    pub(crate) const COARSEST: usize = 2;

    /// The index of its first word, of a solve of `levels` levels.
    pub(crate) fn word(self, levels: usize) -> usize {
        let n = match self {
            Edges::Fused => 0,
            Edges::Cells(level) => 3 + LEVEL_EDGE_WORDS * level,
            Edges::Pixels(level) => 6 + LEVEL_EDGE_WORDS * level,
        };
        levels * WORDS + n
    }
}

/// Words of the passes over edges of a level: the workgroups over cells and over pixels, and the number of cells.
const LEVEL_EDGE_WORDS: usize = shaders::edge::COUNT_PLACE as usize + 1;
/// Words of the passes over edges.
const EDGE_WORDS: usize = 3 + LEVEL_EDGE_WORDS * (Edges::COARSEST + 1);

/// Bytes of the words of `levels` levels, of those of the passes over edges, and of the last word.
pub(crate) fn bytes(levels: usize) -> u64 {
    4 * (levels * WORDS + EDGE_WORDS + 1) as u64
}

/// What a dispatch of a level runs over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Over {
    /// Tiles of `linearise`.
    Tiles,
    /// The pixels of one color.
    Half,
    SystemTiles,
    /// One workgroup.
    One,
    RelaxTiles,
    /// The n-th coarse grid.
    Coarse(usize),
    /// The tiles of `relax_grid_tiles` on the n-th coarse grid.
    CoarseTiles(usize),
}

/// The workgroups of a dispatch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Grid {
    /// A fixed number.
    Direct([u32; 3]),
    /// A number from the arguments on the device.
    Indirect(Indirect),
}

/// The workgroups of a dispatch that the device determines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Indirect {
    /// Those over a level; none once it has settled.
    Level { level: usize, over: Over },
    /// The n-th of a level's passes that warp I2 again; none unless T or the shading has changed.
    IfMoved { level: usize, n: usize },
    /// Those over depth edges, of a solve of `levels` levels; none if that level has no edge.
    Edges { levels: usize, over: Edges },
}

impl Grid {
    /// The index of its first word, if the dispatch is indirect.
    pub(crate) fn word(self) -> Option<usize> {
        if let Grid::Indirect(indirect) = self { Some(indirect.word()) } else { None }
    }
}

impl Indirect {
    /// The index of its first word.
    pub(crate) fn word(self) -> usize {
        match self {
            Self::Level { level, over } => level * WORDS + 3 * over.index(),
            Self::IfMoved { level, n } => level * WORDS + GRID_WORDS + 3 * n,
            Self::Edges { levels, over } => over.word(levels),
        }
    }
}

impl Over {
    /// All, in the order of their words.
    pub(crate) fn all() -> [Over; GRIDS] {
        use Over::{Half, One, RelaxTiles, SystemTiles, Tiles};
        let first = [Tiles, Half, SystemTiles, One, RelaxTiles].into_iter();
        let mut all = first.chain((0..COARSE).map(Over::Coarse)).chain((0..COARSE).map(Over::CoarseTiles));
        std::array::from_fn(|_| all.next().unwrap_or(One))
    }

    fn index(self) -> usize {
        match self {
            Over::Tiles => 0,
            Over::Half => 1,
            Over::SystemTiles => 2,
            Over::One => 3,
            Over::RelaxTiles => 4,
            Over::Coarse(n) => FIRST + n,
            Over::CoarseTiles(n) => FIRST + COARSE + n,
        }
    }
}

/// The words before a solve: for each level, finest first, the workgroups of [`Over::all`] and of the passes that
/// warp I2 again; zeros for the passes over edges; then [`NOT_CANCELLED`].
pub(crate) fn initial_words(levels: &[[[u32; 3]; GRIDS]], warps: &[Vec<[u32; 3]>]) -> Vec<u32> {
    let words = levels.iter().zip(warps).flat_map(|(grids, warps)| {
        let mut words = [grids.as_flattened(), warps.as_flattened()].concat();
        assert!(words.len() <= WORDS, "{} warping passes on a level", warps.len());
        words.resize(WORDS, 0);
        words
    });
    words.chain([0; EDGE_WORDS]).chain([NOT_CANCELLED]).collect()
}

/// The words of a level, and those of them that belong to its passes that warp I2 again.
pub(crate) fn words(level: usize) -> [Range<usize>; 2] {
    let first = level * WORDS;
    [first..first + WORDS, first + GRID_WORDS..first + WORDS]
}

/// The place of a dispatch in the method.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Place {
    /// 0 the finest.
    pub(crate) level: usize,
    /// Outer iteration of the level, if it is part of one.
    pub(crate) iteration: Option<u32>,
    /// Whether it comes after the iteration's step of T.
    pub(crate) after_step: bool,
    /// Whether it is part of a registration that comes before V.
    pub(crate) registering: bool,
}

impl Place {
    /// A place on a level, before or after its iterations.
    pub(crate) fn level(level: usize) -> Self {
        Self { level, ..Self::default() }
    }

    /// A place on a level of a registration that comes first.
    pub(crate) fn registering(level: usize) -> Self {
        Self { level, registering: true, ..Self::default() }
    }

    /// A place in iteration k of the same level.
    pub(crate) fn iteration(self, k: u32) -> Self {
        Self { iteration: Some(k), after_step: false, ..self }
    }

    /// A place in the same iteration, after the step of T.
    pub(crate) fn after_step(self) -> Self {
        Self { after_step: true, ..self }
    }

    /// Whether a dispatch here had any workgroups, by the final state of the levels of the solve and of the
    /// registration before it.
    pub(crate) fn executed(self, grid: Grid, done: &[[LevelState; MAX_LEVELS]; 2]) -> bool {
        let level = done[usize::from(self.registering)][self.level];
        let done = level.iterations;
        let if_moved = matches!(grid, Grid::Indirect(Indirect::IfMoved { .. }));
        if if_moved && self.iteration.is_some_and(|k| level.warps >> k.ilog2() & 1 == 0) {
            return false;
        }
        self.iteration.is_none_or(|k| if self.after_step { k < relaxed(done) } else { k < done })
    }
}

/// The iterations of a level in which dV was relaxed: all but its last.
pub(crate) fn relaxed(done: u32) -> u32 {
    done.saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;

    #[test]
    fn a_settled_level_ends_after_its_transform_is_updated() {
        let mut done = [[LevelState::zeroed(); MAX_LEVELS]; 2];
        done[0][1].iterations = 3;
        done[0][1].warps = 0b10;
        done[1][1].iterations = 5;
        let grid = Grid::Indirect(Indirect::Level { level: 1, over: Over::Tiles });
        let place = Place::level(1);
        assert!(place.executed(Grid::Direct([1; 3]), &done));
        let runs: Vec<bool> = (0..5).map(|k| place.iteration(k).executed(grid, &done)).collect();
        assert_eq!(runs, [true, true, true, false, false]);
        let runs: Vec<bool> = (0..5).map(|k| place.iteration(k).after_step().executed(grid, &done)).collect();
        assert_eq!(runs, [true, true, false, false, false]);
        assert!(Place::registering(1).iteration(4).executed(grid, &done), "a level that has not settled");
        let warping = Grid::Indirect(Indirect::IfMoved { level: 1, n: 0 });
        let runs: Vec<bool> = [1, 2, 4].map(|k| place.iteration(k).executed(warping, &done)).to_vec();
        assert_eq!(runs, [false, true, false]);
        assert_eq!([0, 3].map(relaxed), [0, 2]);
    }

    #[test]
    fn the_grids_of_a_level_are_consecutive() {
        let word = |over| Indirect::Level { level: 2, over }.word();
        let first = 2 * WORDS;
        let words = Over::all().map(word);
        assert_eq!(words.to_vec(), (0..GRIDS).map(|n| first + 3 * n).collect::<Vec<_>>());
        assert_eq!(Indirect::IfMoved { level: 2, n: 1 }.word(), first + GRID_WORDS + 3);
    }
}
