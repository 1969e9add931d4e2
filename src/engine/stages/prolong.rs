//! Computes V of a level from V of the next coarser one.
//!
//! V is read at x/2 (the mean half-way between pixels), times four, since a px² of the finer level is a quarter as
//! large.

use super::pass::{Memory, Pass};
use super::{Number, Raster, pixels};
use crate::engine::vulkan::Variant;

pub use super::interface::prolong::*;

impl Pass for Bindings {
    /// Compulsory traffic: coarse V read, fine V written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        4 * (pixels(c.width.div_ceil(2), c.height.div_ceil(2)) + pixels(c.width, c.height))
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let fine = cpu_reference(c, memory.layer(self.coarse, 0));
        memory.set_layer(self.fine, 0, fine);
    }
}

/// V of the fine level.
pub fn cpu_reference<N: Number>(c: &Constants, coarse: &Raster<N>) -> Raster<N> {
    let limit = f64::from(c.limit);
    Raster::from_fn(c.width as usize, c.height as usize, |x, y| {
        let (right, down) = (x.div_ceil(2).min(coarse.width - 1), y.div_ceil(2).min(coarse.height - 1));
        let sum =
            coarse.get(x / 2, y / 2) + coarse.get(right, y / 2) + coarse.get(x / 2, down) + coarse.get(right, down);
        (f64::from(c.gain) / 4.0 * sum).clamp(-limit, limit)
    })
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn a_plane_stays_the_same_plane() {
        let plane = Field::from_fn(9, 7, |x, y| 0.1 * x as f64 - 0.2 * y as f64);
        let fine = cpu_reference(&Constants { width: 17, height: 13, limit: 100.0, gain: 4.0 }, &plane);
        for y in 0..13 {
            for x in 0..17 {
                let expected = 4.0 * (0.05 * x as f64 - 0.1 * y as f64);
                assert!((fine.get(x, y) - expected).abs() < 1e-12);
            }
        }
    }
}
