//! All relaxation sweeps on the linear system for dV in one dispatch, on tiles with a halo.
//!
//! On a GPU the half-sweeps of [`relax`](super::relax) take as long as their traffic and their barriers. A tile is read
//! once, with a halo as wide as there are half-sweeps, and is relaxed in shared memory. Workgroups compute the halo
//! again instead of waiting for each other.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::{Number, WORKGROUP, pixels, relax, relax_level};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// Width and height of a tile with its halo, pixels.
const SIDE: u32 = shaders::relaxation_tile::SIDE;

/// The most relaxation sweeps: with more, less than a quarter of the tile is in its interior.
const MOST_SWEEPS: u32 = 8;

const _: () = assert!(WORKGROUP[0] * WORKGROUP[1] * 2 * shaders::relaxation_tile::ROWS == SIDE * SIDE);

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Relaxation sweeps.
    sweeps: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
}

bindings! {
    RELAX_TILES:
    /// Right sides.
    right_sides: Reads<RightSides>,
    /// Weights.
    weights: Reads<Weights>,
    /// dV of the red pixels.
    red: Writes<Change>,
    /// dV of the black pixels.
    black: Writes<Change>,
    /// dV of the coarse grids.
    coarse: Reads<GridSteps>,
}

/// Whether a halo for this number of relaxation sweeps leaves enough of a tile.
pub(crate) fn takes(sweeps: u32) -> bool {
    sweeps <= MOST_SWEEPS
}

/// Width and height of a tile without its halo.
fn interior(sweeps: u32) -> u32 {
    SIDE - 4 * sweeps
}

/// Workgroups over a level or a grid.
pub(crate) fn tiles(size: [u32; 2], sweeps: u32) -> [u32; 3] {
    let [x, y] = size.map(|side| side.div_ceil(interior(sweeps)));
    [x, y, 1]
}

/// The pixels of all tiles of a level or a grid, with their halos.
pub(crate) fn pixels_with_halos(size: [u32; 2], sweeps: u32) -> u64 {
    let [width, height] = size.map(|side| {
        let begins = (0..side).step_by(interior(sweeps) as usize);
        begins.map(|x| (x + SIDE - 2 * sweeps).min(side) - x.saturating_sub(2 * sweeps)).sum()
    });
    pixels(width, height)
}

impl Pass for Bindings {
    /// Compulsory traffic: for tiles with their halos, right sides, four weights, and dV of the coarse grid, a quarter
    /// of a number per pixel; dV written once.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        13 * pixels_with_halos([c.width, c.height], c.sweeps) + 4 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, _variant: Variant, memory: &mut Memory<N>) {
        let &Constants { width, height, sweeps, over_relaxation } = c;
        let start = [0, 1].map(|color| relax::start(memory.numbers(self.coarse), [width, height], color));
        let system = [0, 1].map(|color| memory.system(self.right_sides, self.weights, color));
        let constants = relax_level::Constants { width, height, sweeps, over_relaxation };
        let [red, black] = relax_level::cpu_reference(&constants, &system, start);
        memory.set_layer(self.red, 0, red);
        memory.set_layer(self.black, 0, black);
    }
}

#[cfg(test)]
mod tests {
    use super::super::harness::Rig;
    use super::super::relax::{
        interleaved,
        tests::{coarse_steps, system},
    };
    use super::super::{Field, NO_VARIANT};
    use super::*;
    use crate::engine::vulkan::Resource;

    /// The same values as by half-sweeps of `relax`, and those of the CPU reference.
    #[test]
    fn matches_half_sweeps_and_the_cpu_reference() {
        for (width, height, sweeps) in
            [(137usize, 121usize, 3), (64, 16, 3), (17, 18, 1), (2, 2, 3), (200, 53, 8), (53, 104, 3), (105, 52, 2)]
        {
            let (system, rig) = (system(width, height), Rig::new());
            let c = Constants { width: width as u32, height: height as u32, sweeps, over_relaxation: 1.8 };
            let right_sides = rig.image(&system.each_ref().map(|[right_side, ..]| right_side.clone()));
            let weights = rig.weights(&interleaved(&system));
            let nothing = Field::from_fn(width.div_ceil(2), height, |_, _| f64::NAN);
            let [changes, by_halves] = [(); 2].map(|()| [0, 1].map(|_| rig.field(&nothing)));
            let (steps, start) = coarse_steps(&rig, width, height);
            let mut resources = [&right_sides, &weights, &changes[0], &changes[1]].map(Resource::Image).to_vec();
            resources.push(Resource::Buffer(&steps));
            rig.run_groups(&STAGE, &resources, &c, tiles([c.width, c.height], sweeps));
            for half in 0..2 * sweeps {
                let (color, rows) = (half % 2, relax::ROWS);
                let [own, other] = [color, 1 - color].map(|color| &by_halves[color as usize]);
                let mut resources = [&right_sides, &weights, other, own].map(Resource::Image).to_vec();
                resources.push(Resource::Buffer(&steps));
                let variant = if half < 2 { relax::FIRST } else { NO_VARIANT };
                let Constants { width, height, over_relaxation, .. } = c;
                let constants = relax::Constants { width, height, color, rows, over_relaxation };
                rig.run_variant(&relax::STAGE, variant, &resources, &constants, relax::tiles([width, height]));
            }
            let constants = relax_level::Constants { width: c.width, height: c.height, sweeps, over_relaxation: 1.8 };
            let expected = relax_level::cpu_reference(&constants, &system.each_ref().map(|p| p.each_ref()), start);
            for color in [0, 1] {
                rig.assert_close(&changes[color], &expected[color..=color], 1e-4);
                rig.assert_close(&changes[color], &rig.layers(&by_halves[color]), 1e-6);
            }
        }
    }

    #[test]
    fn halos_overlap_their_neighbours_and_end_at_the_border() {
        // Two tiles of 52 px: 58 and 54 px with the halo of 6 px.
        assert_eq!(tiles([100, 52], 3), [2, 1, 1]);
        assert_eq!(pixels_with_halos([100, 52], 3), (58 + 54) * 52);
        assert!(takes(8) && !takes(9));
    }
}
