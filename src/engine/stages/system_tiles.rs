//! Computes the [linear system](super::system) for the step of the unknown in one dispatch with the window over D and b
//! before it and the first coarse [grids](super::grid) behind it.
//!
//! Each dispatch takes longer than its work on small levels, and on large ones the means of D and b take as long as their
//! traffic. A workgroup averages a tile of 32 x 32 pixels in shared memory, reading D and b beyond it, and sums its
//! equations up to five grids. It stores the means of D, which the update of V reads, and the right sides.

use super::grid::{FLOATS, Grid, grids};
use super::pass::{Memory, Pass};
use super::separable::filter_both;
use super::{Number, WORKGROUP, pixels, system};
use crate::engine::plan::FilterRange;
use crate::engine::shaders;
use crate::engine::shaders::filter::{SPAN, TAPS};
use crate::engine::shaders::system_tiles::{CELLS, LINES, TILE, TOTAL};
use crate::engine::vulkan::Variant;

pub use super::interface::system_tiles::*;

/// The most grids of a dispatch.
pub(crate) const GRIDS: usize = shaders::system_tiles::GRIDS as usize;

/// The layer of the right sides.
const RIGHT_SIDE: usize = shaders::system_tiles::RIGHT_SIDE as usize;

const _: () = assert!(TOTAL == WORKGROUP[0] * WORKGROUP[1] && TOTAL == CELLS * CELLS && TILE == 2 * CELLS);
const _: () = assert!(1 << GRIDS == TILE && LINES == TILE + TAPS - 1 && TILE.is_multiple_of(SPAN));
const _: () = assert!(shaders::system_tiles::RIGHT_SIDE == shaders::relax_tiles::RIGHT_SIDE);
const _: () = assert!(shaders::system_tiles::RIGHT_SIDE == shaders::relax::RIGHT_SIDE);

impl Constants {
    /// The constants of the system, with the window before it and the number of grids behind it.
    pub(crate) fn new(system: &system::Constants, window: FilterRange, grids: usize) -> Self {
        let &system::Constants { width, height, alpha, rate, smoothness_eta } = system;
        let (offset, radius, grids) = (window.offset, window.radius, grids.min(GRIDS) as u32);
        Self { width, height, alpha, rate, smoothness_eta, offset, radius, grids }
    }

    fn system(&self) -> system::Constants {
        let &Self { width, height, alpha, rate, smoothness_eta, .. } = self;
        system::Constants { width, height, alpha, rate, smoothness_eta }
    }
}

/// Workgroups over a level.
pub(crate) fn tiles(size: [u32; 2]) -> [u32; 3] {
    let [x, y] = size.map(|side| side.div_ceil(TILE));
    [x, y, 1]
}

impl Pass for Bindings {
    /// Compulsory traffic: the unknown and its equations read; D, right side, weights and the equations of the grids
    /// written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let layers = u64::from(system::layers(variant));
        let grids = grids([c.width, c.height]).into_iter().take(c.grids as usize);
        let cells: u64 = grids.map(|grid| pixels(grid.size[0], grid.size[1])).sum();
        (20 + 4 * layers) * pixels(c.width, c.height) + 4 * FLOATS as u64 * cells
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let alpha = f64::from(c.alpha) * if variant == system::SWEEP { 1.0 } else { memory.state(self.state).alpha };
        let mut smoothed: Vec<_> = (1..system::layers(variant)).map(|_| memory.take_spare()).collect();
        smoothed.insert(0, memory.take_layer(self.smoothed, 0));
        let mut colors = [0, 1].map(|color| {
            std::array::from_fn(|n| match n {
                0 => memory.take_layer(self.smoothed, RIGHT_SIDE + color),
                _ => memory.take_layer(self.weights, 4 * color + n - 1),
            })
        });
        let mut cells = memory.take_numbers(self.grid_equations);
        let window = &memory.numbers(self.filters)[4 * c.offset as usize..][..2 * c.radius as usize + 1];
        let (size, periods) = ([c.width, c.height], [c.width, c.height].map(|side| 2 * (side as usize - 1)));
        for (smoothed, layer) in smoothed.iter_mut().zip(memory.layers(self.normal_equations)) {
            *smoothed = std::mem::take(smoothed).of_size(size.map(|side| side as usize));
            filter_both(smoothed, layer, [window; 2], 1, periods, false);
        }
        let unknown = memory.layer(self.unknown, 0);
        let sums = system::compute(&c.system(), alpha, unknown, &smoothed, &mut colors, &mut cells, true);
        for places in grids(size)[..c.grids as usize].windows(2) {
            let coarser = Grid::of(&cells, places[0].first as usize, places[0].size).halved();
            let first = FLOATS * places[1].first as usize;
            cells.resize(cells.len().max(first + FLOATS * coarser.cells.len()), N::default());
            cells[first..][..FLOATS * coarser.cells.len()].copy_from_slice(coarser.cells.as_flattened());
        }
        memory.put_numbers(self.grid_equations, cells);
        for (color, [right_side, weights @ ..]) in colors.into_iter().enumerate() {
            memory.set_layer(self.smoothed, RIGHT_SIDE + color, right_side);
            memory.set_weights(self.weights, color, weights);
        }
        memory.set_layer(self.smoothed, 0, smoothed.remove(0));
        smoothed.into_iter().for_each(|raster| memory.keep_spare(raster));
        if variant == system::SWEEP {
            memory.set_numbers(self.partials, &sums);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::harness::{Rig, random_field};
    use super::super::relax::{both, interleaved};
    use super::super::separable::filtered;
    use super::super::state::{DoubleState, State};
    use super::super::system::tests::cpu_reference;
    use super::*;
    use crate::engine::stages::uncertainty_terms;
    use crate::engine::vulkan::Resource;

    fn check([width, height]: [usize; 2], variant: Variant) {
        let fields: Vec<Field> = (1..5).map(|seed| random_field(width, height, seed)).collect();
        let (window, size) = (uncertainty_terms::window(), [width as u32, height as u32]);
        let system = system::Constants { width: size[0], height: size[1], alpha: 0.05, rate: 0.7, smoothness_eta: 0.1 };
        let range = FilterRange { bank: 0, offset: 3, blocks: 1, radius: window.len() as u32 / 2 };
        let places = grids(size);
        let c = Constants::new(&system, range, places.len());
        let state = State { alpha: 0.4, ..State::new(&DoubleState::default().registration) };
        let alpha = f64::from(c.alpha) * if variant == system::SWEEP { 1.0 } else { f64::from(state.alpha) };
        let equations = &fields[1..1 + system::layers(variant) as usize];
        let smoothed: Vec<Field> = equations.iter().map(|layer| filtered(layer, [&window; 2], 1)).collect();
        let (expected, sums, mut cells) = cpu_reference(&system, alpha, &fields[0], &smoothed, false);
        for finer in &places[..places.len().min(GRIDS) - 1] {
            let coarser = Grid::of(&cells, finer.first as usize, finer.size).halved();
            cells.extend_from_slice(coarser.cells.as_flattened());
        }
        let rig = Rig::new();
        // The pixel beyond an odd width is written too.
        let before = |width: usize| [(); 2].map(|()| Field::from_fn(width, height, |_, _| f64::NAN));
        let images = [
            rig.image(&fields[..1]),
            rig.image(equations),
            rig.image(&before(width)),
            rig.weights(&before(4 * width.div_ceil(2))),
        ];
        let groups = tiles(size);
        let partials = rig.upload(&vec![0; 4 * system::SUMS * (groups[0] * groups[1]) as usize]);
        let state = rig.upload(bytemuck::bytes_of(&state));
        // Grids beyond those that are stored are left alone.
        let (buffer, weights) = (rig.numbers(vec![f64::NAN; cells.len() + 8]), rig.filter(3, &window));
        let mut resources: Vec<_> = images.iter().map(Resource::Image).collect();
        resources.extend([&partials, &state, &buffer].map(Resource::Buffer));
        resources.push(Resource::Uniform(&weights));
        rig.run_variant(&STAGE, variant, &resources, &c, groups);
        // Single precision, over diagonals of down to 0.1.
        let right_sides = both(expected.each_ref().map(|[right_side, ..]| right_side), width);
        rig.assert_close(&images[2], &[smoothed[0].clone(), right_sides], 1e-4);
        // Half precision, rounded to nearest.
        rig.assert_close(&images[3], &interleaved(&expected), 2.5e-4);
        let actual = rig.floats(&buffer);
        for (n, (f, e)) in actual.iter().zip(&cells).enumerate() {
            // Of up to 1024 numbers.
            assert!((f64::from(*f) - e).abs() < 1e-4 + 1e-5 * e.abs(), "{n}: {f}, not {e}");
        }
        assert!(actual[cells.len()..].iter().all(|number| number.is_nan()), "beyond the grids");
        let actual = rig.floats(&partials);
        for (n, sum) in sums.iter().enumerate() {
            let total: f64 = actual.chunks(system::SUMS).map(|row| f64::from(row[n])).sum();
            assert!((total - sum).abs() <= 1e-4 * sum.abs(), "{n}: {total} {sum}");
        }
    }

    /// Five grids, and sides that are shorter than the window.
    #[test]
    fn matches_the_cpu_reference() {
        for size in [[8, 9], [1030, 530]] {
            check(size, system::SWEEP);
            check(size, Variant::NONE);
        }
    }
}
