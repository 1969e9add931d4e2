//! A filter along x, then one along y, in one dispatch: for GPUs, where scripts of other devices have two passes of
//! [`convolve`](super::convolve).
//!
//! There a filter is bound by its traffic, which this halves, and on small levels by the time of a dispatch. A
//! workgroup filters 64 lines along x into shared memory, and these along y. Adjacent tiles filter the lines that they
//! share twice. The CPU device runs the two passes of `convolve` together instead, over bands of rows, which share
//! fewer lines than tiles do.

use super::convolve::{self, filter_both};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, Raster, WORKGROUP, pixels, stack};
use crate::engine::shaders::separable::{BLOCK, COLUMNS, LINES, LONG_LINES, REACH, SPAN, TAPS, TOTAL};
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width before the filters, pixels.
    width: u32,
    /// Height before the filters, pixels.
    height: u32,
    /// First layer read.
    from_layer: u32,
    /// First layer written.
    to_layer: u32,
    /// From a layer read to the next.
    from_step: u32,
    /// From a layer written to the next.
    to_step: u32,
    /// The number of layers, at most two: workgroups along z, unless they are packed.
    planes: u32,
    /// First weights of the filters along x and along y, in units of four weights.
    offsets: [u32; 2],
    /// A filter has 2 radius + 1 weights, at most 19, or 49 with the variant for long filters.
    radii: [u32; 2],
    /// Pixels after which the mirrored image repeats, along x and along y.
    periods: [u32; 2],
    /// First entry of the list of tiles; only with the variant for lists.
    listed: u32,
    /// Blocks of weights of the filters along x and along y; only with the variant for long filters.
    blocks: [u32; 2],
}

/// Whether the filters are short enough for the sides that they filter, so that one reflection suffices.
pub(crate) fn takes(sides: [u32; 2], radii: [u32; 2], periods: [u32; 2]) -> bool {
    let reach = if is_long(radii) { REACH } else { TAPS / 2 };
    let fits = |n: usize| radii[n] <= reach && sides[n] > reach && sides[n] + reach <= periods[n];
    fits(0) && fits(1)
}

/// Whether filters of these radii need the variant for long ones.
pub(crate) fn is_long(radii: [u32; 2]) -> bool {
    2 * radii[0].max(radii[1]) >= TAPS
}

const LONG: usize = 0;
const JOINS: usize = 1;
const HALVING: usize = 3;

/// The variant that filters or, with stride 2, halves. `long`: for long filters; `listed`: for listed tiles; `joins`:
/// two layers of floats, of two images; `packs`: to packed layers, from such too unless it joins.
pub(crate) fn variant(stride: u32, [long, listed, joins, packs]: [bool; 4]) -> Variant {
    let mut variant = [false, false, listed, false, false];
    (variant[LONG], variant[JOINS], variant[HALVING]) = (long, joins, stride == 2);
    stack::packed(variant, packs)
}

/// Width and height of a workgroup's results, pixels of the filtered image.
pub(crate) fn tile(stride: u32, long: bool) -> [u32; 2] {
    [COLUMNS, if long { LONG_LINES - 2 * REACH } else { LINES - TAPS + 1 } / stride]
}

/// Workgroups over an image of this size before the filters, of `planes` layers. Packed ones count as one.
pub(crate) fn groups(size: [u32; 2], stride: u32, long: bool, planes: u32) -> [u32; 3] {
    let [width, height] = tile(stride, long);
    let [columns, rows] = size.map(|side| side.div_ceil(stride));
    [columns.div_ceil(width), rows.div_ceil(height), planes]
}

bindings! {
    SEPARABLE:
    /// Image that is filtered.
    from: Reads<Words>,
    /// The image of the second layer, with the variants that join two.
    second: Reads<Words>,
    /// Other layers than those that are read.
    to: Writes<Words>,
    filters: Reads<Filters>,
    tiles: Reads<Tiles>,
    /// State, with white.
    state: Reads<State>,
}

impl Pass for Bindings {
    /// Compulsory traffic: every value read, every result written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let [columns, rows] = [c.width, c.height].map(|side| side.div_ceil(stride(variant)));
        let packs = stack::is_packed(variant);
        let [read, written] = [packs && !variant[JOINS], packs].map(|is_packed| stack::bytes(c.planes, is_packed));
        read * pixels(c.width, c.height) + written * pixels(columns, rows)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let weights = memory.numbers(self.filters);
        let filters =
            [0, 1].map(|axis| weights[4 * c.offsets[axis] as usize..][..2 * c.radii[axis] as usize + 1].to_vec());
        let white = memory.white(variant);
        for plane in 0..c.planes {
            let image = match plane {
                0 => memory.layer(self.from, c.from_layer as usize),
                _ => memory.layer(self.second, (c.from_layer + c.from_step) as usize),
            };
            let filtered = cpu_reference(c, stride(variant), filters.each_ref().map(Vec::as_slice), image);
            let filtered = stack::stored(filtered, white);
            memory.set_layer(self.to, (c.to_layer + plane * c.to_step) as usize, filtered);
        }
    }
}

/// The stride of a variant.
pub(crate) fn stride(variant: Variant) -> u32 {
    if variant[HALVING] { 2 } else { 1 }
}

/// The image filtered along x, then along y; with stride 2 every other result along either.
pub fn cpu_reference<N: Number>(c: &Constants, stride: u32, filters: [&[N]; 2], image: &Raster<N>) -> Raster<N> {
    let (periods, stride) = (c.periods.map(|period| period as usize), stride as usize);
    let mut result = Raster::zeros(image.width.div_ceil(stride), image.height.div_ceil(stride));
    filter_both(&mut result, image, filters, stride, periods, false);
    result
}

const _: () = assert!(TAPS == convolve::TAPS && SPAN == convolve::SPAN && BLOCK == convolve::BLOCK);
const _: () = assert!(TOTAL == WORKGROUP[0] * WORKGROUP[1]);
// A span along x for each invocation, or two; one along y.
const _: () = assert!(LINES * COLUMNS == SPAN * TOTAL && LONG_LINES * COLUMNS <= 2 * SPAN * TOTAL);
const _: () = assert!((LONG_LINES - 2 * REACH).is_multiple_of(2 * SPAN) && LONG_LINES - 2 * REACH <= LINES);

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{Rig, assert_all_close, random_field};
    use super::super::stack::White;
    use super::super::state::{DoubleState, State};
    use super::*;
    use crate::engine::filter;
    use crate::engine::vulkan::Resource;

    /// Compares with the CPU reference, over all tiles or over the first and one below it. `beyond`: pixels by which
    /// the periods exceed those of the image.
    fn check([width, height]: [usize; 2], filters: [&[f64]; 2], stride: u32, listed: bool, beyond: [u32; 2]) {
        let (input, size) = (random_field(width, height, 7), [width as u32, height as u32]);
        let (radii, periods) =
            (filters.map(|filter| (filter.len() / 2) as u32), [0, 1].map(|n| 2 * (size[n] - 1) + beyond[n]));
        assert!(takes(size, radii, periods));
        let long = is_long(radii);
        let c = Constants {
            width: size[0],
            height: size[1],
            from_layer: 1,
            to_layer: 0,
            from_step: 2,
            to_step: 2,
            planes: 2,
            offsets: [2, 20],
            radii,
            periods,
            listed: 1,
            blocks: filters.map(|filter| (filter.len() as u32).div_ceil(BLOCK)),
        };
        let expected = cpu_reference(&c, stride, filters, &input);
        let rig = Rig::new();
        let times =
            |field: &Field, factor: f64| Field { data: field.data.iter().map(|v| factor * v).collect(), ..*field };
        // From layers 1 and 3 into layers 0 and 2.
        let from = rig.image(&[times(&input, f64::NAN), input.clone(), times(&input, f64::NAN), times(&input, -1.0)]);
        let to = rig.empty([expected.width as u32, expected.height as u32], 3);
        let mut weights = filters[0].to_vec();
        weights.resize(4 * (c.offsets[1] - c.offsets[0]) as usize, 0.0);
        let weights = rig.filter(c.offsets[0], &[&weights, filters[1]].concat());
        let tiles = rig.upload(bytemuck::cast_slice(&[9, 0, 1 << 16]));
        let state = State { white: 0.8, ..State::new(&DoubleState::default().registration) };
        let white = White::of(variant(stride, [long, false, false, true]), state.white.into());
        let state = rig.upload(bytemuck::bytes_of(&state));
        let (weights, [tiles, state]) = (Resource::Uniform(&weights), [&tiles, &state].map(Resource::Buffer));
        let resources = [Resource::Image(&from), Resource::Image(&from), Resource::Image(&to), weights, tiles, state];
        let all = |planes| groups(size, stride, long, planes);
        let groups = if listed { [2, 1, 2] } else { all(2) };
        rig.run_variant(&STAGE, variant(stride, [long, listed, false, false]), &resources, &c, groups);
        let [right, below] = [tile(stride, long)[0], 2 * tile(stride, long)[1]].map(|side| side as usize);
        let written = Field::from_fn(expected.width, expected.height, |x, y| {
            if !listed || x < right && y < below { expected.get(x, y) } else { 0.0 }
        });
        // 1e-5: 38 products of single precision, with weights of the prefilter that sum to 3 in absolute value.
        rig.assert_close(&to, &[times(&written, 1.0), times(&written, 0.0), times(&written, -1.0)], 1e-5);

        // Packed, from layer 1 or from those of two images into layer 0; some results are beyond what is stored.
        let [first, second] = [2.0, -1.0].map(|factor| stack::stored(times(&input, factor), white));
        let results = [&first, &second].map(|image| stack::stored(cpu_reference(&c, stride, filters, image), white));
        let [one, other] = [[&input, &first], [&input, &second]].map(|layers| rig.image(&layers.map(Field::clone)));
        let (to, joined) = (rig.empty(size.map(|side| side.div_ceil(stride)), 3), Constants { from_step: 0, ..c });
        let resources = [Resource::Image(&one), Resource::Image(&other), Resource::Image(&to), weights, tiles, state];
        rig.run_variant(&STAGE, variant(stride, [long, false, true, false]), &resources, &joined, all(2));
        let [a, b] = [&first, &second].map(|image| cpu_reference(&c, stride, filters, image));
        rig.assert_close(&to, &[a, times(&expected, 0.0), b], 2e-5);
        let stored = [second.clone(), first, input, second].map(|layer| stack::stored(layer, white));
        let white = white.unwrap();
        let both = rig.packed(&stored, white);
        for (joins, from, second, from_step) in [(true, &one, &other, 0), (false, &both, &both, 2)] {
            let blank = Field::zeros(expected.width, expected.height);
            let (to, c) = (rig.packed(&[blank.clone(), blank], white), Constants { from_step, ..c });
            let resources =
                [Resource::Image(from), Resource::Image(second), Resource::Image(&to), weights, tiles, state];
            rig.run_variant(&STAGE, variant(stride, [long, false, joins, true]), &resources, &c, all(1));
            // A step, where one rounds up and the other down.
            assert_all_close(&rig.unpacked(&to, white), &results, 1.1 * white.step(3.0 * white.coefficient(i16::MAX)));
        }
    }

    #[test]
    fn matches_the_cpu_reference_on_odd_sizes_and_at_borders() {
        let [narrow, prefilter, wide] = [filter::gaussian(0.8), filter::spline_prefilter(), filter::gaussian(4.0)];
        for size in [[37, 21], [150, 80], [11, 12], [16, 97], [65, 46], [33, 47]] {
            for filters in [[&prefilter; 2], [&narrow, &wide]] {
                for stride in [1, 2] {
                    check(size, filters.map(Vec::as_slice), stride, false, [0, 0]);
                    check(size, filters.map(Vec::as_slice), stride, false, [1, 1]);
                    check(size, filters.map(Vec::as_slice), stride, true, [0, 1]);
                }
            }
        }
    }

    #[test]
    fn long_filters_match_the_cpu_reference() {
        let [short, longest, halving] = [filter::gaussian(4.0), filter::gaussian(31.0), filter::gaussian_halving(5.5)];
        assert_eq!([&longest, &halving].map(Vec::len), [49, 33]);
        for size in [[53, 49], [150, 101], [65, 98]] {
            for filters in [[&longest; 2], [&short, &longest], [&halving, &short]] {
                for stride in [1, 2] {
                    check(size, filters.map(Vec::as_slice), stride, false, [0, 0]);
                    check(size, filters.map(Vec::as_slice), stride, true, [1, 0]);
                }
            }
        }
    }

    #[test]
    fn short_sides_and_long_filters_are_left_to_convolve() {
        assert!(takes([11, 16], [9, 9], [20, 30]) && !takes([10, 16], [9, 9], [18, 30]));
        assert!(takes([16, 16], [9, 9], [30, 30]) && takes([32, 20], [9, 4], [61, 38]));
        assert!(!takes([9, 16], [9, 9], [16, 30]), "shorter than the filter");
        assert!(!takes([16, 16], [10, 9], [30, 30]), "shorter than a long filter");
        assert!(takes([25, 48], [10, 24], [49, 94]) && !takes([90, 90], [25, 9], [178, 178]), "too many weights");
    }
}
