//! A filter along x, then one along y, in one dispatch, with mirrored borders. With stride 2 it halves the image.
//!
//! It computes the Gaussian pyramid (σ 1 px, stride 2; pixel i of a level is at pixel 2i of the level below), the cubic
//! B-spline prefilter, the blur stacks and the means over a window. A filter that is not separable is a sum of separable
//! ones: a variant adds to the target. A filter is bound by its traffic, so a workgroup filters lines along x into shared
//! memory, and these along y. Adjacent tiles filter the lines that they share twice. The CPU device runs both filters on
//! bands of rows instead.

use super::pass::{Memory, Pass};
use super::rows::{self, Rows};
use super::segments::streamed;
use super::spline::fold;
use super::{Number, Raster, WORKGROUP, pixels, stack};
use crate::base::weighted;
use crate::engine::shaders::filter::{SPAN, TAPS};
use crate::engine::shaders::separable::{ANY_LINES, COLUMNS, LINES, TOTAL, VECTORS};
use crate::engine::vulkan::Variant;
use crate::engine::{filter, shaders};

pub use super::interface::separable::*;

/// Weights per block of a filter; the last block is padded with zeros. Filters of `TAPS` have a pipeline without a loop:
/// most of a Gaussian's blur stack.
pub const BLOCK: u32 = shaders::separable::BLOCK;

/// The most weights of all filters: the 16 KiB that each device allows a uniform buffer.
pub const WEIGHTS: usize = 4 * VECTORS as usize;

/// Whether filters need the variant for any: they are long, or longer than the sides that they filter, so that one
/// reflection does not suffice.
pub(crate) fn is_any(sides: [u32; 2], radii: [u32; 2], periods: [u32; 2]) -> bool {
    const REACH: u32 = TAPS / 2;
    [0, 1].iter().any(|&n| radii[n] > REACH || sides[n] <= REACH || sides[n] + REACH > periods[n])
}

/// The variant that filters or, with stride 2, halves. `any`: any filters; `listed`: listed tiles; `joins`: two layers
/// of floats, of two images; `packs`: to packed layers, from such too unless it joins.
pub(crate) fn variant(stride: u32, [any, listed, joins, packs]: [bool; 4]) -> Variant {
    Variant::ANY.when(any)
        | Variant::JOINS.when(joins)
        | Variant::LISTED.when(listed)
        | Variant::HALVING.when(stride == 2)
        | Variant::PACKED.when(packs)
}

/// Width and height of a workgroup's results, pixels of the filtered image.
pub(crate) fn tile(stride: u32, any: bool) -> [u32; 2] {
    [COLUMNS, if any { ANY_LINES } else { LINES - TAPS + 1 } / stride]
}

/// Workgroups over an image of this size before the filters, of `planes` layers. Packed ones count as one.
pub(crate) fn groups(size: [u32; 2], stride: u32, any: bool, planes: u32) -> [u32; 3] {
    let [width, height] = tile(stride, any);
    let [columns, rows] = size.map(|side| side.div_ceil(stride));
    [columns.div_ceil(width), rows.div_ceil(height), planes]
}

impl Pass for Bindings {
    /// Compulsory traffic: every value read, every result written, and read first where it is added to.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let [columns, rows] = [c.width, c.height].map(|side| side.div_ceil(stride(variant)));
        let packs = stack::is_packed(variant);
        let [read, written] =
            [packs && !variant.has(Variant::JOINS), packs].map(|is_packed| stack::bytes(c.planes, is_packed));
        read * pixels(c.width, c.height) + u64::from(1 + c.add) * written * pixels(columns, rows)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let weights = memory.numbers(self.filters);
        let filters =
            [0, 1].map(|axis| weights[4 * c.offsets[axis] as usize..][..2 * c.radii[axis] as usize + 1].to_vec());
        let (white, stride, periods) =
            (memory.white(variant), stride(variant) as usize, c.periods.map(|period| period as usize));
        for plane in 0..c.planes {
            let to = (c.to_layer + plane * c.to_step) as usize;
            let before = memory.take_layer(self.to, to);
            let image = match plane {
                0 => memory.layer(self.from, c.from_layer as usize),
                _ => memory.layer(self.second, (c.from_layer + c.from_step) as usize),
            };
            let size = [image.width, image.height].map(|side| side.div_ceil(stride));
            let mut result = if c.add == 1 { before } else { before.of_size(size) };
            filter_both(&mut result, image, filters.each_ref().map(Vec::as_slice), stride, periods, c.add == 1);
            memory.set_layer(self.to, to, stack::stored(result, white));
        }
    }
}

/// The stride of a variant.
pub(crate) fn stride(variant: Variant) -> u32 {
    if variant.has(Variant::HALVING) { 2 } else { 1 }
}

/// `out(i) = Σ_n filter(n) input(stride i + n)` along x, then along y, mirrored about the border pixels.
pub(crate) fn filtered<N: Number>(image: &Raster<N>, filters: [&[N]; 2], stride: usize) -> Raster<N> {
    let periods = [image.width, image.height].map(|side| 2 * (side - 1));
    filtered_mirrored(image, filters, stride, periods)
}

/// The filtered image, mirrored about the first pixel and half a period from it.
pub(crate) fn filtered_mirrored<N: Number>(
    image: &Raster<N>,
    filters: [&[N]; 2],
    stride: usize,
    periods: [usize; 2],
) -> Raster<N> {
    let mut result = Raster::zeros(image.width.div_ceil(stride), image.height.div_ceil(stride));
    filter_both(&mut result, image, filters, stride, periods, false);
    result
}

/// The image under a Gaussian of `sigma` px.
pub(crate) fn smoothed<N: Number>(image: &Raster<N>, sigma: f64) -> Raster<N> {
    let filter: Vec<N> = filter::gaussian(sigma * sigma).into_iter().map(N::of).collect();
    filtered(image, [&filter; 2], 1)
}

/// Sums at either end of a row for which mirrored numbers are copied.
const EDGE: usize = 32;

/// A row filtered along x, mirrored about its first number and half a period from it.
fn filter_row<N: Number>(sums: &mut [N], row: &[N], filter: &[N], stride: usize, period: usize) {
    let (radius, width) = (filter.len() / 2, row.len());
    if stride > 1 || radius > EDGE || width < 2 * EDGE {
        return filter_part(sums, row, filter, stride, [0, period]);
    }
    filter_part(&mut sums[..EDGE], row, filter, 1, [0, period]);
    filter_part(&mut sums[width - EDGE..], row, filter, 1, [width - EDGE, period]);
    let inner = (0..filter.len()).map(|n| &row[EDGE - radius + n..]).collect::<Vec<_>>();
    weigh(&mut sums[EDGE..width - EDGE], filter, &inner);
}

/// The sums of a filtered row from pixel `first` of the row on.
fn filter_part<N: Number>(sums: &mut [N], row: &[N], filter: &[N], stride: usize, [first, period]: [usize; 2]) {
    let (radius, first) = ((filter.len() / 2) as isize, first as isize);
    let end = first + ((sums.len().max(1) - 1) * stride) as isize + radius + 1;
    let [least, most] = [(first - radius).clamp(0, row.len() as isize), end.clamp(0, row.len() as isize)];
    let outside = |x: isize| row[fold(x, period)];
    let mut mirrored = Vec::with_capacity((end - first + radius) as usize);
    mirrored.extend((first - radius..least).map(outside));
    mirrored.extend_from_slice(&row[least as usize..most as usize]);
    mirrored.extend((most..end).map(outside));
    // Every stride-th number from the first, from the second, ...: a filter reads contiguous numbers.
    let parts: Vec<Vec<N>> = match stride {
        1 => vec![mirrored],
        _ => (0..stride).map(|n| mirrored.iter().skip(n).step_by(stride).copied().collect()).collect(),
    };
    weigh(sums, filter, &(0..filter.len()).map(|n| &parts[n % stride][n / stride..]).collect::<Vec<_>>());
}

/// The sums of rows with the weights of a filter.
pub(crate) fn weigh<N: Number>(sums: &mut [N], filter: &[N], rows: &[&[N]]) {
    streamed::<N, _>(
        #[inline(always)]
        || weighted::sum(sums, filter, rows),
    );
}

/// The bands of an image that is filtered along both axes. At the border of two, rows are filtered twice.
const BANDS: usize = 16;

/// Filters an image along x, then along y, while the rows are in the cache; with `add` it adds to the result, which has
/// the size of the filtered image.
pub(super) fn filter_both<N: Number>(
    result: &mut Raster<N>,
    input: &Raster<N>,
    [along_x, along_y]: [&[N]; 2],
    stride: usize,
    periods: [usize; 2],
    add: bool,
) {
    let (width, height, radius) = (result.width, result.height, (along_y.len() / 2) as isize);
    let lines = height.div_ceil(BANDS).max(2 * along_y.len() / stride);
    rows::map([Rows::from(result).joined(lines)], |band, [rows]| {
        let mut ring = vec![vec![N::default(); width]; along_y.len()];
        let slot = |y: isize| (y + radius) as usize % along_y.len();
        let mut next = (band * lines * stride) as isize - radius;
        let mut sums = vec![N::default(); if add { width } else { 0 }];
        for (n, row) in rows.chunks_exact_mut(width.max(1)).enumerate() {
            let y = ((band * lines + n) * stride) as isize;
            while next <= y + radius {
                filter_row(&mut ring[slot(next)], input.row(fold(next, periods[1])), along_x, stride, periods[0]);
                next += 1;
            }
            let filtered: Vec<&[N]> = (y - radius..=y + radius).map(|y| &ring[slot(y)][..]).collect();
            if add {
                weigh(&mut sums, along_y, &filtered);
                row.iter_mut().zip(&sums).for_each(|(before, sum)| *before += *sum);
            } else {
                weigh(row, along_y, &filtered);
            }
        }
    });
}

const _: () = assert!(TOTAL == WORKGROUP[0] * WORKGROUP[1]);
// A span along y for each invocation.
const _: () = assert!(LINES * COLUMNS <= SPAN * TOTAL && ANY_LINES * COLUMNS <= SPAN * TOTAL);
const _: () = assert!(ANY_LINES.is_multiple_of(2 * SPAN));

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;
    use crate::engine::filter;

    #[test]
    fn short_sides_and_long_filters_need_the_variant_for_any() {
        assert!(!is_any([11, 16], [9, 9], [20, 30]) && is_any([10, 16], [9, 9], [18, 30]));
        assert!(!is_any([16, 16], [9, 9], [30, 30]) && !is_any([32, 20], [9, 4], [61, 38]));
        assert!(is_any([16, 16], [10, 9], [30, 30]) && is_any([9, 16], [9, 9], [16, 30]));
    }

    #[test]
    fn a_gaussian_blob_gains_the_filters_variance() {
        let blob = |v: f64| {
            Field::from_fn(65, 65, |x, y| {
                let (dx, dy) = (x as f64 - 32.0, y as f64 - 30.0);
                (-(dx * dx + dy * dy) / (2.0 * v)).exp() / v
            })
        };
        let filter = filter::gaussian(3.0);
        let blurred = filtered(&blob(4.0), [&filter; 2], 1);
        for (actual, expected) in blurred.data.iter().zip(blob(7.0).data) {
            assert!((actual - expected).abs() < 1e-5, "{actual} {expected}");
        }
    }
}
