//! The tiles of an image that the passes of a sweep run over, a workgroup each.
//!
//! Few frames are nearly in focus at a pixel, so a frame's blur stack is made only in the tiles that need it. Software
//! devices execute every workgroup of a dispatch, even one that returns early, so the other tiles are not dispatched.

use super::stages::Field;

/// The side of a cell, px.
const CELL: usize = 16;
/// The largest number of tile sizes that the passes of one frame have.
const TILE_SIZES: u64 = 8;
/// Width and height of the tile with the longest lists, px.
const MIN_TILE: [u32; 2] = [64, 8];

/// The largest number of words that the lists of all frames take.
pub(crate) fn capacity([width, height]: [u32; 2], frames: u32) -> u64 {
    let [columns, rows] = [width.div_ceil(MIN_TILE[0]), height.div_ceil(MIN_TILE[1])];
    TILE_SIZES * u64::from(frames) * u64::from(columns) * u64::from(rows)
}

/// The minimum and maximum of a field in each cell.
pub(crate) struct Ranges {
    size: [usize; 2],
    cells: Vec<[f64; 2]>,
}

impl Ranges {
    pub(crate) fn of(field: &Field) -> Self {
        let columns = field.width.div_ceil(CELL);
        let mut cells = vec![[f64::INFINITY, f64::NEG_INFINITY]; columns * field.height.div_ceil(CELL)];
        for (y, row) in field.data.chunks_exact(field.width).enumerate() {
            for (values, [least, most]) in row.chunks(CELL).zip(&mut cells[y / CELL * columns..]) {
                *least = values.iter().copied().fold(*least, f64::min);
                *most = values.iter().copied().fold(*most, f64::max);
            }
        }
        Self { size: [field.width, field.height], cells }
    }

    /// The cells that may hold a value from `low` to `high`.
    pub(crate) fn between(&self, low: f64, high: f64) -> NeededCells {
        let overlaps = |[least, most]: &[f64; 2]| *most >= low && *least <= high;
        NeededCells { size: self.size, needed: self.cells.iter().map(overlaps).collect() }
    }
}

/// The cells of a level that a pass needs.
#[derive(Clone, Debug)]
pub(crate) struct NeededCells {
    size: [usize; 2],
    needed: Vec<bool>,
}

impl NeededCells {
    /// The tiles of this size that come within `margin` pixels of a needed cell, a word each: x, and y from bit 16 on.
    pub(crate) fn tiles(&self, tile: [u32; 2], margin: u32) -> Vec<u32> {
        let [columns, rows] = [0, 1].map(|axis| self.size[axis].div_ceil(tile[axis] as usize) as u32);
        let cells = |axis: usize, n: u32| {
            let (first, end) = ((tile[axis] * n).saturating_sub(margin), tile[axis] * (n + 1) + margin);
            first as usize / CELL..(end as usize).min(self.size[axis]).div_ceil(CELL)
        };
        let across = self.size[0].div_ceil(CELL);
        let is_needed =
            |x: u32, y: u32| cells(1, y).any(|row| self.needed[row * across..][cells(0, x)].contains(&true));
        let all = (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y]));
        all.filter(|&[x, y]| is_needed(x, y)).map(|[x, y]| x | y << 16).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_near_a_needed_cell_are_listed() {
        let field = Field::from_fn(200, 70, |x, y| if (x, y) == (130, 40) { 3.0 } else { 0.0 });
        let ranges = Ranges::of(&field);
        assert_eq!(ranges.between(-1.0, 1.0).tiles([64, 8], 0).len(), 4 * 9);
        // The cell is 128 to 143, 32 to 47.
        let needed = ranges.between(2.5, 4.0);
        assert_eq!(needed.tiles([64, 32], 0), [2 | 1 << 16]);
        assert_eq!(needed.tiles([64, 32], 1), [1, 2, 1 | 1 << 16, 2 | 1 << 16]);
        assert_eq!(needed.tiles([128, 128], 0), [1]);
        assert!(ranges.between(5.0, 6.0).tiles([64, 8], 100).is_empty());
    }

    #[test]
    fn the_longest_lists_fit_the_capacity() {
        let field = Field::zeros(333, 257);
        let longest = Ranges::of(&field).between(0.0, 0.0).tiles(MIN_TILE, 0).len() as u64;
        assert!(TILE_SIZES * longest <= capacity([333, 257], 1));
    }
}
