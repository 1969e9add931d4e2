//! Passes over a part of an image: lists of tiles, a workgroup each.
//!
//! A pixel of a sweep asks for the few frames that are nearly in focus there, so a frame's stack is made only where it is asked for.
//! Software devices run what is dispatched to its end, however early it returns; so it is not dispatched.

use super::stages::Field;

/// Pixels of a cell, on either side.
const CELL: usize = 16;
/// Sizes of tile that the passes of one frame have, at most.
const KINDS: u64 = 8;
/// None of them is narrower or lower, pixels.
const SMALLEST: [u32; 2] = [64, 8];

/// Words that the lists of so many frames take at most.
pub(crate) fn capacity([width, height]: [u32; 2], frames: u32) -> u64 {
    KINDS * u64::from(frames) * u64::from(width.div_ceil(SMALLEST[0])) * u64::from(height.div_ceil(SMALLEST[1]))
}

/// The least and the most of a field in each cell.
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

    /// The cells that hold something between the two.
    pub(crate) fn between(&self, low: f64, high: f64) -> DeviceRequirements {
        let holds = |[least, most]: &[f64; 2]| *most >= low && *least <= high;
        DeviceRequirements { size: self.size, cells: self.cells.iter().map(holds).collect() }
    }
}

/// The cells of a level that are wanted.
#[derive(Clone, Debug)]
pub(crate) struct DeviceRequirements {
    size: [usize; 2],
    cells: Vec<bool>,
}

impl DeviceRequirements {
    /// The tiles of so many pixels that come within `margin` pixels of them, a word each: x, and y from bit 16 on.
    pub(crate) fn tiles(&self, tile: [u32; 2], margin: u32) -> Vec<u32> {
        let [columns, rows] = [0, 1].map(|axis| self.size[axis].div_ceil(tile[axis] as usize) as u32);
        let cells = |axis: usize, n: u32| {
            let (first, end) = ((tile[axis] * n).saturating_sub(margin), tile[axis] * (n + 1) + margin);
            first as usize / CELL..(end as usize).min(self.size[axis]).div_ceil(CELL)
        };
        let across = self.size[0].div_ceil(CELL);
        let wanted = |x: u32, y: u32| cells(1, y).any(|row| self.cells[row * across..][cells(0, x)].contains(&true));
        let all = (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y]));
        all.filter(|&[x, y]| wanted(x, y)).map(|[x, y]| x | y << 16).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_those_near_what_is_wanted() {
        let field = Field::from_fn(200, 70, |x, y| if (x, y) == (130, 40) { 3.0 } else { 0.0 });
        let ranges = Ranges::of(&field);
        assert_eq!(ranges.between(-1.0, 1.0).tiles([64, 8], 0).len(), 4 * 9);
        // The cell is 128 to 143, 32 to 47.
        let wanted = ranges.between(2.5, 4.0);
        assert_eq!(wanted.tiles([64, 32], 0), [2 | 1 << 16]);
        assert_eq!(wanted.tiles([64, 32], 1), [1, 2, 1 | 1 << 16, 2 | 1 << 16]);
        assert_eq!(wanted.tiles([128, 128], 0), [1]);
        assert!(ranges.between(5.0, 6.0).tiles([64, 8], 100).is_empty());
    }

    #[test]
    fn all_lists_fit() {
        let field = Field::zeros(333, 257);
        let longest = Ranges::of(&field).between(0.0, 0.0).tiles(SMALLEST, 0).len() as u64;
        assert!(KINDS * longest <= capacity([333, 257], 1));
    }
}
