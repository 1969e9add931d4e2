//! Refines cubic B-splines on every other pixel to those on every pixel: the same functions, exactly.
//!
//! The two-scale relation is `β(x/2) = Σ h(k) β(x - k)`, h = (1 4 6 4 1)/8 (Unser 1999). A coefficient on a pixel of
//! the coarse grid is (1 6 1)/8 of those around it; one between two pixels is their mean. Pixel i of the coarse grid is
//! at pixel 2i. The image is mirrored about the border pixels of the *fine* grid: for an even size, half-way between
//! the last pixel of the coarse grid and the next.

use super::pass::{Memory, Pass};
use super::segments::streamed;
use super::spline::{Raster, fold};
use super::{Number, pixels, stack};
use crate::engine::vulkan::Variant;

pub use super::interface::subdivide::*;

/// Workgroups over the pixels of a coarse image, of `planes` layers. Packed ones count as one.
pub(crate) fn groups(size: [u32; 2], planes: u32) -> [u32; 3] {
    let [x, y, _] = STAGE.groups(size);
    [x, y, planes]
}

/// The variant for listed tiles, and for packed layers.
pub(crate) fn variant(listed: bool, packed: bool) -> Variant {
    Variant::LISTED.when(listed) | Variant::PACKED.when(packed)
}

impl Pass for Bindings {
    /// Compulsory traffic: a quarter of the pixels read, all written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let coarse = pixels(c.width.div_ceil(2), c.height.div_ceil(2));
        stack::bytes(c.planes, stack::is_packed(variant)) * (coarse + pixels(c.width, c.height))
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        for plane in 0..c.planes {
            let to = (c.layer + plane * c.step) as usize;
            let fine = memory.take_layer(self.fine, to).of_size([c.width as usize, c.height as usize]);
            let coarse = memory.layer(self.coarse, (c.from_layer + plane * c.from_step) as usize);
            let fine = stack::stored(refined(fine, coarse), memory.white(variant));
            memory.set_layer(self.fine, to, fine);
        }
    }
}

/// The fine image.
pub fn cpu_reference<N: Number>([width, height]: [usize; 2], coarse: &Raster<N>) -> Raster<N> {
    refined(Raster::zeros(width, height), coarse)
}

/// The fine image, in the memory of one of its size.
fn refined<N: Number>(mut fine: Raster<N>, coarse: &Raster<N>) -> Raster<N> {
    let ([half, eighth, most], [width, height]) = ([0.5, 0.125, 0.75].map(N::of), [fine.width, fine.height]);
    fine.fill_rows(|y, fine| {
        let row = |n: isize| coarse.row(fold((y / 2) as isize + n, height - 1));
        let [above, here, below] = [-1, 0, 1].map(row);
        let (count, last) = (coarse.width, (width - 1) / 2);
        let mut line = vec![N::default(); count];
        streamed::<N, _>(
            #[inline(always)]
            || {
                let (above, here, below, line) = (&above[..count], &here[..count], &below[..count], &mut line[..count]);
                let [outer, middle] = if y % 2 == 0 { [eighth, most] } else { [N::default(), half] };
                let after = if y % 2 == 0 { eighth } else { half };
                for x in 0..count {
                    line[x] = outer * above[x] + middle * here[x] + after * below[x];
                }
                // Adjacent pixels from the second pair to the last but one.
                let inner = last.max(1) - 1;
                let (before, here) = (&line[..inner], &line[count - 1 - inner..][..inner]);
                let behind = &line[count - inner..][..inner];
                let pairs = &mut fine.as_chunks_mut::<2>().0[inner.min(1)..][..inner];
                for x in 0..inner {
                    let even = eighth * before[x] + most * here[x] + eighth * behind[x];
                    pairs[x] = [even, half * here[x] + half * behind[x]];
                }
            },
        );
        let at = |x: isize| line[fold(x, width - 1)];
        for x in [0, last] {
            let [before, here, behind] = [-1, 0, 1].map(|n| at(x as isize + n));
            fine[2 * x] = eighth * before + most * here + eighth * behind;
            if 2 * x + 1 < width {
                fine[2 * x + 1] = half * here + half * behind;
            }
        }
    });
    fine
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::random_field;
    use super::super::spline;

    use super::*;

    #[test]
    fn coarse_and_fine_are_the_same_spline() {
        let coarse = random_field(20, 17, 6);
        let fine = cpu_reference([39, 33], &coarse);
        for (x, y) in [(0.0, 0.0), (7.0, 12.0), (10.3, 3.7), (37.6, 31.2), (38.0, 32.0)] {
            let (one, other) = (spline::read(&coarse, x / 2.0, y / 2.0), spline::read(&fine, x, y));
            assert!((one.value - other.value).abs() < 1e-12, "({x}, {y}): {} {}", one.value, other.value);
        }
    }

    #[test]
    fn even_sizes_are_mirrored_about_the_fine_border() {
        // As if the mirrored image continued.
        for size in [39, 40] {
            let coarse = random_field(20, 1, 8);
            let beyond = Field::from_fn(40, 1, |x, _| coarse.get(fold(x as isize, size - 1), 0));
            let (fine, wide) = (cpu_reference([size, 1], &coarse), cpu_reference([79, 1], &beyond));
            for x in 0..70 {
                let (actual, expected) = (fine.get(fold(x, 2 * (size - 1)), 0), wide.get(x as usize, 0));
                assert!((actual - expected).abs() < 1e-12, "{x} of {size}: {actual} {expected}");
            }
        }
    }
}
