//! One level of the pyramid.

use crate::base::centre;
use crate::engine::stages::stack::node_count;
use crate::engine::stages::{self, linearise};

/// The stack of I2 is read at s² V: a fifth above the limit leaves room for s up to 1.095.
const READ_BEYOND: f64 = 1.2;
/// One level of the pyramid; level 0 is the image itself.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Level {
    /// Index, 0 the finest.
    pub(crate) index: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
    /// Pixels of the full-size image a pixel of this level.
    pub(crate) factor: f64,
    /// The image centre in pixels of this level: not the middle of its own grid.
    pub(crate) centre: [f64; 2],
    /// L, which scales a and b of the registration step to pixels: a quarter of the diagonal.
    pub(crate) length: f64,
    /// Largest |V|, px² of this level.
    pub(crate) limit: f64,
    /// Nodes of the stack of blurred images.
    pub(crate) nodes: usize,
}

impl Level {
    pub(crate) fn new(index: usize, width: u32, height: u32, max_relative_blur: f64) -> Self {
        let factor = f64::from(1u32 << index);
        let size = [half_size(width, index), half_size(height, index)];
        // At least 1 px²: on a coarse level less blur than that says nothing, and V must be free to move.
        let limit = (max_relative_blur / (factor * factor)).max(1.0);
        Self {
            index,
            size,
            factor,
            centre: centre(width, height).map(|c| c / factor),
            length: f64::from(size[0]).hypot(size[1].into()) / 4.0,
            limit,
            nodes: node_count(READ_BEYOND * limit),
        }
    }

    /// Workgroups of `linearise`, and so rows of partial sums.
    pub(crate) fn tiles(&self) -> [u32; 3] {
        linearise::tiles(self.size)
    }

    /// Pixels.
    pub(crate) fn pixels(&self) -> u64 {
        pixels(self.size)
    }

    /// Width and height of one colour.
    pub(crate) fn half(&self) -> [u32; 2] {
        [self.size[0].div_ceil(2), self.size[1]]
    }
}

fn pixels([width, height]: [u32; 2]) -> u64 {
    stages::pixels(width, height)
}

/// A side after so many halvings; pixel i of a level sits on pixel 2i of its parent.
pub(super) fn half_size(side: u32, halvings: usize) -> u32 {
    side.div_ceil(1 << halvings)
}
