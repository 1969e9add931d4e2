//! A one-dimensional filter along x or y with mirrored borders. With stride 2 it also halves that axis.
//!
//! It computes the Gaussian pyramid (σ 1 px, stride 2; pixel i of a level is at pixel 2i of the level below), the cubic
//! B-spline prefilter, the blur stacks and the means over a window. A variant takes filters of any length and can add
//! to the target: a filter that is not separable is a sum of separable ones. Axis and stride are variants too: loads
//! and stores whose addresses depend on push constants take a tenth longer on a software device.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::rows::{self, Rows};
use super::segments::streamed;
use super::spline::{Raster, fold};
use super::{Number, WORKGROUP, pixels};
use crate::base::weighted;
use crate::engine::slot::{Bound, Slot};
use crate::engine::vulkan::Variant;
use crate::engine::{filter, shaders};

push_constants! {
    /// Pixels along the filtered axis, before the filter.
    length: u32,
    /// Pixels across it.
    breadth: u32,
    /// First layer read.
    from_layer: u32,
    /// First layer written.
    to_layer: u32,
    /// From a layer read to the next.
    from_step: u32,
    /// From a layer written to the next.
    to_step: u32,
    /// The number of layers: workgroups along z.
    planes: u32,
    /// First weight of the filter, in units of four weights.
    offset: u32,
    /// [`BLOCK`]s of weights of the filter, the last padded with zeros.
    blocks: u32,
    /// The filter has 2 radius + 1 weights.
    radius: u32,
    /// 1: adds to the target; only with the variant for any filter.
    add: u32,
    /// Pixels after which the mirrored image repeats, at least 1.
    period: u32,
    /// First entry of the list of tiles; only with the variant for lists.
    listed: u32,
}

/// Adjacent results per invocation: each weight and each value is loaded once for all of them.
pub const SPAN: u32 = shaders::convolve::SPAN;

/// Weights per block. Filters of [`TAPS`] have a pipeline without a loop: most of a Gaussian's blur stack.
/// Software devices load a weight with a constant index once per subgroup, and keep arrays in registers.
pub const BLOCK: u32 = shaders::convolve::BLOCK;

/// The most weights of a filter that is not of the variant for any: all such filters have an odd number.
pub const TAPS: u32 = shaders::convolve::TAPS;

/// The most weights of all filters: the 16 KiB that each device allows a uniform buffer.
pub const WEIGHTS: usize = 4 * shaders::convolve::VECTORS as usize;

/// Workgroups of a filter along x, or along y, over `length` pixels along it and `breadth` across it, of `planes`
/// layers.
pub(crate) fn groups([length, breadth]: [u32; 2], vertical: bool, planes: u32) -> [u32; 3] {
    let spans = length.div_ceil(SPAN);
    let [x, y, _] = STAGE.groups(if vertical { [breadth, spans] } else { [spans, breadth] });
    [x, y, planes]
}

/// The variant that takes any filter on any image, adds to the target if that is asked for, and filters along y.
const ANY: usize = 0;
const VERTICAL: usize = 1;
const HALVING: usize = 3;

/// The variant for a filter of some blocks along an axis of an image. `listed`: for listed tiles.
pub(crate) fn variant(c: &Constants, vertical: bool, stride: u32, listed: bool) -> Variant {
    // One reflection suffices if the period exceeds the last value that the last span reads.
    let reach = c.length.next_multiple_of(SPAN) + TAPS;
    let any = c.add == 1 || 2 * c.radius + 1 > TAPS || c.period < reach;
    let mut variant = [false, false, listed, false, false];
    (variant[ANY], variant[VERTICAL], variant[HALVING]) = (any, vertical, stride == 2);
    variant
}

/// Whether a variant filters along y.
pub(crate) fn is_vertical(variant: Variant) -> bool {
    variant[VERTICAL]
}

fn stride(variant: Variant) -> u32 {
    if variant[HALVING] { 2 } else { 1 }
}

/// Width and height of a listed tile, pixels before the filter. Along y it is a workgroup's; along x a quarter as wide.
pub(crate) fn tile(vertical: bool) -> [u32; 2] {
    let [width, height] = WORKGROUP;
    if vertical { [width, SPAN * height] } else { [SPAN * width / 4, 4 * height] }
}

bindings! {
    CONVOLVE:
    /// Image that is filtered.
    from: Reads<Plane>,
    to: Updates<Plane>,
    filters: Reads<Filters>,
    tiles: Reads<Tiles>,
}

impl Pass for Bindings {
    /// Compulsory traffic: every value read, every result written, and read first where it is added to.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let touched = if c.add == 1 { 2 } else { 1 };
        4 * u64::from(c.planes)
            * (pixels(c.length, c.breadth) + touched * pixels(c.length.div_ceil(stride(variant)), c.breadth))
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let first = 4 * c.offset as usize;
        let filter = memory.numbers(self.filters)[first..first + 2 * c.radius as usize + 1].to_vec();
        let (stride, vertical, period) = (stride(variant) as usize, is_vertical(variant), c.period as usize);
        for plane in 0..c.planes {
            let [from, to] = [c.from_layer + plane * c.from_step, c.to_layer + plane * c.to_step].map(|n| n as usize);
            let before = memory.take_layer(self.to, to);
            let (reused, added) = if c.add == 1 { (Raster::default(), before) } else { (before, Raster::default()) };
            let mut filtered = filter_into(reused, memory.layer(self.from, from), &filter, stride, vertical, period);
            filtered.data.iter_mut().zip(&added.data).for_each(|(sum, before)| *sum += *before);
            memory.set_layer(self.to, to, filtered);
        }
    }
}

/// `out(i) = Σ_n filter(n) input(stride i + n)` along x or y, mirrored about the border pixels.
pub fn cpu_reference<N: Number>(input: &Raster<N>, filter: &[N], stride: usize, vertical: bool) -> Raster<N> {
    let period = 2 * (if vertical { input.height } else { input.width } - 1);
    cpu_reference_mirrored(input, filter, stride, vertical, period)
}

/// As [`cpu_reference`], mirrored about the first pixel and half a period from it.
pub fn cpu_reference_mirrored<N: Number>(
    input: &Raster<N>,
    filter: &[N],
    stride: usize,
    vertical: bool,
    period: usize,
) -> Raster<N> {
    filter_into(Raster::default(), input, filter, stride, vertical, period)
}

/// As [`cpu_reference_mirrored`], in the memory of a raster, so that no new memory has to be zeroed.
fn filter_into<N: Number>(
    result: Raster<N>,
    input: &Raster<N>,
    filter: &[N],
    stride: usize,
    vertical: bool,
    period: usize,
) -> Raster<N> {
    let halved = |side: usize, along: bool| if along { side.div_ceil(stride) } else { side };
    let mut result = result.of_size([halved(input.width, !vertical), halved(input.height, vertical)]);
    let radius = (filter.len() / 2) as isize;
    result.fill_rows(|y, sums| {
        if vertical {
            let row = |n: usize| input.row(fold((y * stride + n) as isize - radius, period));
            weigh(sums, filter, &(0..filter.len()).map(row).collect::<Vec<_>>());
        } else {
            filter_row(sums, input.row(y), filter, stride, period);
        }
    });
    result
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
    streamed(
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

/// The filters along x and along y. With stride 2 they halve the image.
pub(crate) fn filtered<N: Number>(image: &Raster<N>, filters: [&[N]; 2], stride: usize) -> Raster<N> {
    let mut result = Raster::zeros(image.width.div_ceil(stride), image.height.div_ceil(stride));
    let periods = [image.width, image.height].map(|side| 2 * (side - 1));
    filter_both(&mut result, image, filters, stride, periods, false);
    result
}

/// Runs a filter along x and one of its results along y at once, so that rows stay in the cache. The scratch image in
/// between is not written. Returns false for other passes, which have to run one after the other.
pub(crate) fn run_both<N: Number>(
    [(x, of_x, along_x), (y, of_y, along_y)]: [(Bindings, Constants, Variant); 2],
    memory: &mut Memory<N>,
) -> bool {
    let written = (x.to.slot(), of_x.to_layer, of_x.to_step, of_x.planes);
    let read = (y.from.slot(), of_y.from_layer, of_y.from_step, of_y.planes);
    let layers = |plane: u32| {
        [
            of_x.from_layer + plane * of_x.from_step,
            of_y.to_layer + plane * of_y.to_step,
            of_x.to_layer + plane * of_x.to_step,
        ]
        .map(|n| n as usize)
    };
    let is_in_place =
        x.from.slot() == y.to.slot() && (0..of_x.planes).all(|plane| layers(plane)[0] == layers(plane)[1]);
    // One after the other, all layers are filtered along x before the first result of both is written.
    let reads_results = x.from.slot() == y.to.slot()
        && (0..of_x.planes)
            .any(|plane| (0..plane + u32::from(!is_in_place)).any(|before| layers(before)[1] == layers(plane)[0]));
    if [is_vertical(along_x), is_vertical(along_y)] != [false, true]
        || stride(along_x) != stride(along_y)
        || written != read
        || written.0 != Slot::Scratch
        || of_x.add == 1
        || of_y.add == 1 && is_in_place
        || reads_results
    {
        return false;
    }
    let stride = stride(along_x) as usize;
    let filtered_size = |input: &Raster<N>| [input.width, input.height].map(|side| side.div_ceil(stride));
    let fits = |[from, to, _]: [usize; 3]| {
        let before = memory.layers.get(&y.to.slot()).and_then(|layers| layers.get(to));
        before.is_some_and(|sums| [sums.width, sums.height] == filtered_size(memory.layer(x.from, from)))
    };
    if of_y.add == 1 && !(0..of_x.planes).map(layers).all(fits) {
        return false;
    }
    let filters = [(x.filters, of_x), (y.filters, of_y)]
        .map(|(filters, c)| memory.numbers(filters)[4 * c.offset as usize..][..2 * c.radius as usize + 1].to_vec());
    let filters = filters.each_ref().map(Vec::as_slice);
    let periods = [of_x.period, of_y.period].map(|period| period as usize);
    for plane in 0..of_x.planes {
        let [from, to, between] = layers(plane);
        // In place, the results go to the memory of the scratch image, which gets that of the layer.
        let reused = if is_in_place { memory.take_layer(x.to, between) } else { memory.take_layer(y.to, to) };
        let input = memory.layer(x.from, from);
        let mut result = if of_y.add == 1 { reused } else { reused.of_size(filtered_size(input)) };
        filter_both(&mut result, input, filters, stride, periods, of_y.add == 1);
        if is_in_place {
            let input = memory.take_layer(y.to, to);
            memory.set_layer(x.to, between, input);
        }
        memory.set_layer(y.to, to, result);
    }
    true
}

/// The image under a Gaussian of `sigma` px.
pub(crate) fn smoothed<N: Number>(image: &Raster<N>, sigma: f64) -> Raster<N> {
    let filter: Vec<N> = filter::gaussian(sigma * sigma).into_iter().map(N::of).collect();
    filtered(image, [&filter; 2], 1)
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::engine::vulkan::Resource;

    fn times(field: &Field, factor: f64) -> Field {
        Field { data: field.data.iter().map(|value| factor * value).collect(), ..*field }
    }

    fn check(input: &Field, filter: &[f64], stride: usize, vertical: bool, odd_period: bool) {
        let length = if vertical { input.height } else { input.width };
        let period = 2 * (length - 1) + usize::from(odd_period);
        let expected = cpu_reference_mirrored(input, filter, stride, vertical, period);
        let rig = Rig::new();
        let size = [expected.width as u32, expected.height as u32];
        // From layers 1 and 3 into layers 0 and 2, to test that layers are respected.
        let [blank, negative] = [0.0, -1.0].map(|factor| times(input, factor));
        let from = rig.image(&[blank.clone(), input.clone(), blank, negative]);
        let to = rig.empty(size, 3);
        let weights = rig.filter(2, filter);
        let (length, breadth) = if vertical { (input.height, input.width) } else { (input.width, input.height) };
        let constants = Constants {
            length: length as u32,
            breadth: breadth as u32,
            from_layer: 1,
            to_layer: 0,
            from_step: 2,
            to_step: 2,
            planes: 2,
            offset: 2,
            blocks: (filter.len() as u32).div_ceil(BLOCK),
            radius: (filter.len() / 2) as u32,
            add: 0,
            period: period.max(1) as u32,
            listed: 1,
        };
        let tiles = rig.upload(bytemuck::cast_slice(&[9, 0, 1 << 16]));
        let resources =
            [Resource::Image(&from), Resource::Image(&to), Resource::Uniform(&weights), Resource::Buffer(&tiles)];
        let groups = groups([constants.length, constants.breadth], vertical, 2);
        let both = |result: &Field| [times(result, 1.0), times(result, 0.0), times(result, -1.0)];
        let of = |constants: &Constants, listed| variant(constants, vertical, stride as u32, listed);
        let mut any = of(&constants, false);
        if !any[ANY] {
            rig.run_variant(&STAGE, any, &resources, &constants, groups);
            rig.assert_close(&to, &both(&expected), 1e-5);
        }
        any[ANY] = true;
        rig.run_variant(&STAGE, any, &resources, &constants, groups);
        // 1e-5: up to 41 products of single precision, with weights of the prefilter that sum to 3 in absolute value.
        rig.assert_close(&to, &both(&expected), 1e-5);
        if stride == 2 {
            return;
        }
        let twice = times(&expected, 2.0);
        let adding = Constants { add: 1, ..constants };
        rig.run_variant(&STAGE, of(&adding, false), &resources, &adding, groups);
        rig.assert_close(&to, &both(&twice), 2e-5);
        // Adds once more to the tiles at the left end of the first two rows of tiles.
        let [right, below] = [tile(vertical)[0], 2 * tile(vertical)[1]].map(|side| side as usize);
        let thrice = Field::from_fn(size[0] as usize, size[1] as usize, |x, y| {
            twice.get(x, y) * if x < right && y < below { 1.5 } else { 1.0 }
        });
        rig.run_variant(&STAGE, of(&adding, true), &resources, &adding, [2, 1, 2]);
        rig.assert_close(&to, &both(&thrice), 3e-5);
    }

    #[test]
    fn matches_the_cpu_reference_on_odd_sizes_and_filters_wider_than_the_image() {
        for (width, height) in [(37, 21), (150, 80), (64, 9), (28, 35), (2, 1)] {
            let input = random_field(width, height, 7);
            for filter in [filter::gaussian(1.0), filter::spline_prefilter(), filter::gaussian(17.5)] {
                for (stride, vertical) in [(1, false), (1, true), (2, false), (2, true)] {
                    check(&input, &filter, stride, vertical, false);
                    check(&input, &filter, stride, vertical, true);
                }
            }
        }
    }

    /// The filters along x and along y from layers to others, by way of the scratch image.
    fn passes(
        [from, to]: [(Slot, [u32; 2]); 2],
        size: [u32; 2],
        radius: u32,
        stride: u32,
        add: u32,
        planes: u32,
    ) -> [(Bindings, Constants, Variant); 2] {
        let through = (Slot::Scratch, [0, 1]);
        [false, true].map(|vertical| {
            let [(source, [from_layer, from_step]), (target, [to_layer, to_step])] =
                if vertical { [through, to] } else { [from, through] };
            let [length, breadth] = if vertical { [size[1], size[0].div_ceil(stride)] } else { size };
            let constants = Constants {
                length,
                breadth,
                from_layer,
                to_layer,
                from_step,
                to_step,
                planes,
                offset: 2,
                blocks: (2 * radius + 1).div_ceil(BLOCK),
                radius,
                add: if vertical { add } else { 0 },
                period: (2 * (length - 1)).max(1),
                listed: 0,
            };
            let bindings = Bindings {
                from: Bound::of(source),
                to: Bound::of(target),
                filters: Bound::of(Slot::Filters { bank: 0 }),
                tiles: Bound::of(Slot::Tiles),
            };
            (bindings, constants, variant(&constants, vertical, stride, false))
        })
    }

    /// Memory with a filter, images in four layers of two slots, and one of another size in the last layer.
    fn memory(size: [u32; 2], filtered: [u32; 2], filter: &[f64]) -> Memory<f32> {
        let weights = [&[9.0; 8][..], filter].concat();
        let mut memory = Memory::with_filters(&[weights]);
        let image = |[width, height]: [u32; 2], seed| {
            let field = random_field(width as usize, height as usize, seed);
            Raster { width: field.width, height: field.height, data: field.to_f32() }
        };
        let aligned = (0..4).map(|n| image(size, n)).collect();
        let stacks = (0..5).map(|n| image(if n == 4 { [3, 2] } else { filtered }, 10 + n)).collect();
        memory.layers = [(Slot::Aligned, aligned), (Slot::Stacks, stacks)].into();
        memory
    }

    #[test]
    fn both_filters_at_once_give_the_bits_of_one_after_the_other() {
        let bits = |memory: &Memory<f32>, slot: Slot| {
            memory.layers[&slot]
                .iter()
                .map(|layer| (layer.width, layer.data.iter().map(|v| v.to_bits()).collect::<Vec<_>>()))
                .collect::<Vec<_>>()
        };
        let (from, others) = ((Slot::Aligned, [1, 2]), [(Slot::Aligned, [0, 2]), (Slot::Stacks, [0, 3])]);
        for size in [[37, 21], [150, 80], [70, 65], [1, 1]] {
            for (planes, stride, add) in [1, 2]
                .into_iter()
                .flat_map(|planes| [1, 2].map(|stride| (planes, stride)))
                .flat_map(|(planes, stride)| [0, 1].map(|add| (planes, stride, add)))
            {
                let filtered = size.map(|side: u32| side.div_ceil(stride));
                for filter in [filter::gaussian(1.0), filter::spline_prefilter(), filter::gaussian(17.5)] {
                    for to in [from, others[0], others[1]] {
                        let radius = (filter.len() / 2) as u32;
                        let pair = passes([from, to], size, radius, stride, add, planes);
                        let [mut once, mut twice] = [(); 2].map(|()| memory(size, filtered, &filter));
                        // Results that are added have no memory of their own in place, and need sums of their size.
                        let runs = add == 0 || to != from && (to.0 == Slot::Stacks || size == filtered);
                        assert_eq!(run_both(pair, &mut once), runs, "{size:?} {planes} {stride} {add} {to:?}");
                        if runs {
                            pair.iter().for_each(|(pass, c, variant)| pass.run(c, *variant, &mut twice));
                        }
                        for slot in [Slot::Aligned, Slot::Stacks] {
                            assert!(bits(&once, slot) == bits(&twice, slot), "{size:?} {planes} {stride} {add} {to:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn filters_that_depend_on_earlier_planes_are_left_to_run_one_after_the_other() {
        let (size, filter) = ([37, 21], filter::gaussian(1.0));
        let runs = |from: (Slot, [u32; 2]), to: (Slot, [u32; 2]), add: u32| {
            let mut memory = memory(size, size, &filter);
            run_both(passes([from, to], size, (filter.len() / 2) as u32, 1, add, 2), &mut memory)
        };
        let aligned = |first, step| (Slot::Aligned, [first, step]);
        assert!(runs(aligned(0, 1), aligned(0, 1), 0) && runs(aligned(0, 1), aligned(2, 1), 0));
        assert!(!runs(aligned(0, 1), aligned(1, 1), 0), "the second plane reads the first one's result");
        assert!(!runs(aligned(1, 1), aligned(1, 2), 0), "only the first plane is in place");
        assert!(!runs(aligned(0, 2), aligned(1, 1), 0), "the second plane reads its own result's layer");
        assert!(runs(aligned(0, 1), (Slot::Stacks, [0, 1]), 1));
        assert!(!runs(aligned(0, 1), (Slot::Stacks, [3, 1]), 1), "the sums have another size");
        assert!(!runs(aligned(0, 1), (Slot::Stacks, [5, 1]), 1), "a layer was never written");
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
