//! Half a relaxation sweep on the linear system for dV: one color of the red-black scheme, equation 28.
//!
//! The system is divided by its diagonal: `dV = r + Σ_n a_n dV_n`. Red pixels have x + y even.

use super::pass::{Memory, Pass, bindings, push_constants};
use super::segments::vectorised;
use super::{Field, Number, Raster, WORKGROUP, pixels};
use crate::engine::vulkan::Variant;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// 0 red, 1 black.
    color: u32,
    /// [`ROWS`].
    rows: u32,
    /// ω of successive over-relaxation.
    over_relaxation: f32,
}

/// Lines of one color per invocation.
pub const ROWS: u32 = 4;

/// Workgroups over a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(2 * WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * ROWS), 1]
}

/// The variant for the first relaxation sweep, which starts from dV of the coarse grid.
pub(crate) const FIRST: Variant = [true, false, false, false, false];

bindings! {
    RELAX:
    /// Right sides.
    right_sides: Reads<RightSides>,
    /// Weights.
    weights: Reads<Weights>,
    /// dV of the other color.
    other: Reads<Change>,
    /// dV of this color.
    own: Updates<Change>,
    /// dV of the coarse grids.
    coarse: Reads<GridSteps>,
}

impl Pass for Bindings {
    /// Compulsory traffic: right side, four weights and dV of both colors read, dV of one written. The first relaxation
    /// sweep reads dV of the coarse grid instead, for red of both colors.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let floats = match (variant == FIRST, c.color) {
            (true, 0) => 6,
            (true, _) => 7,
            (false, _) => 8,
        };
        4 * floats * pixels(c.width.div_ceil(2), c.height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let mut own = memory.take_layer(self.own, 0);
        let start = |reused, color| started(reused, memory.numbers(self.coarse), [c.width, c.height], color);
        if variant == FIRST {
            own = start(own, c.color);
        }
        let system = memory.system((self.right_sides, c.color as usize), self.weights, c.color as usize);
        if variant == FIRST && c.color == 0 {
            cpu_reference(c, &system, &start(Raster::default(), 1), &mut own);
        } else {
            cpu_reference(c, &system, memory.layer(self.other, 0), &mut own);
        }
        memory.set_layer(self.own, 0, own);
    }
}

/// dV of one color of a level before the first relaxation sweep, by dV of its coarse grids; 0 where a row has no pixel
/// left.
pub(crate) fn start<N: Number>(steps: &[N], size: [u32; 2], color: u32) -> Raster<N> {
    started(Raster::default(), steps, size, color)
}

/// As [`start`], in the memory of a raster.
fn started<N: Number>(reused: Raster<N>, steps: &[N], [width, height]: [u32; 2], color: u32) -> Raster<N> {
    let columns = width.div_ceil(2) as usize;
    let mut start = reused.of_size([columns, height as usize]);
    start.fill_rows(|y, row| {
        row.copy_from_slice(&steps[y / 2 * columns..][..columns]);
        if width % 2 == 1 && (y + color as usize) % 2 == 1 {
            row[columns - 1] = N::default();
        }
    });
    start
}

/// Relaxes dV of one color, by that of the other. All are of one color, as the device stores them: the linear system,
/// which is the right side and the weights of the right, left, lower and upper neighbours, and dV.
pub fn cpu_reference<N: Number>(c: &Constants, system: &[&Raster<N>; 5], other: &Raster<N>, own: &mut Raster<N>) {
    let omega = N::of(c.over_relaxation.into());
    let (last, height) = (own.width - 1, own.height);
    own.fill_rows(|y, own| {
        let [up, here, down] = [y.saturating_sub(1), y, (y + 1).min(height - 1)].map(|y| other.row(y));
        let parts = system.map(|part| part.row(y));
        // Pixel 2 h + shift of the row is between the pixels h - 1 + shift and h + shift of the other color. The first
        // or the last has only one neighbour in the row: the weight of the other is 0.
        let shift = (y + c.color as usize) & 1;
        let end = if shift == 0 { 0 } else { last };
        let pull = parts[3][end] * down[end] + parts[4][end] * up[end];
        let target = parts[0][end] + parts[1][end] * here[end] + parts[2][end] * here[end] + pull;
        own[end] += omega * (target - own[end]);
        let inner = 1 - shift..last + 1 - shift;
        let [side, right, left, below, above] = parts.map(|part| &part[inner.clone()]);
        let (up, down, own) = (&up[inner.clone()], &down[inner.clone()], &mut own[inner]);
        let (before, behind) = (&here[..last], &here[1..]);
        vectorised(
            #[inline(always)]
            || {
                let (side, right, left) = (&side[..last], &right[..last], &left[..last]);
                let (below, above, up, down) = (&below[..last], &above[..last], &up[..last], &down[..last]);
                let own = &mut own[..last];
                for h in 0..last {
                    let pull = below[h] * down[h] + above[h] * up[h];
                    let target = side[h] + right[h] * behind[h] + left[h] * before[h] + pull;
                    own[h] += omega * (target - own[h]);
                }
            },
        );
    });
}

/// A field with the red pixels of one field and the black pixels of another, as the device stores them.
#[cfg(test)]
pub(crate) fn both<N: Number>([red, black]: [&Raster<N>; 2], width: usize) -> Raster<N> {
    Raster::from_fn(width, red.height, |x, y| if (x + y) % 2 == 0 { red } else { black }.get(x / 2, y))
}

/// The pixels of one color as the device stores them: column x/2 of a half-width field; 0 where a row has no pixel
/// left.
pub fn half<N: Number>(field: &Raster<N>, color: usize) -> Raster<N> {
    Raster::from_fn(field.width.div_ceil(2), field.height, |h, y| {
        let x = 2 * h + ((y + color) & 1);
        if x < field.width { field.get(x, y) } else { 0.0 }
    })
}

/// The weights of both colors of a system as the device stores them: four adjacent numbers per pixel.
pub fn interleaved(system: &[[Field; 5]; 2]) -> [Field; 2] {
    system.each_ref().map(|[_, weights @ ..]| {
        Field::from_fn(4 * weights[0].width, weights[0].height, |x, y| weights[x % 4].get(x / 4, y))
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::Arc;

    use ::half::f16;

    use super::super::Field;
    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::engine::vulkan::{Buffer, Resource};

    /// A random system like those of `system`: half-precision weights, zero across the border, with a sum below one.
    pub(crate) fn system(width: usize, height: usize) -> [[Field; 5]; 2] {
        let mut system: [Field; 5] = std::array::from_fn(|i| {
            let mut f = random_field(width, height, 20 + i as u64);
            f.data.iter_mut().for_each(|v| *v = f16::from_f64(0.24 * *v).to_f64());
            f
        });
        for y in 0..height {
            system[1].data[y * width + width - 1] = 0.0;
            system[2].data[y * width] = 0.0;
        }
        for x in 0..width {
            system[3].data[(height - 1) * width + x] = 0.0;
            system[4].data[x] = 0.0;
        }
        [0, 1].map(|color| system.each_ref().map(|part| half(part, color)))
    }

    fn constants(width: usize, height: usize, color: usize) -> Constants {
        let (width, height, color) = (width as u32, height as u32, color as u32);
        Constants { width, height, color, rows: ROWS, over_relaxation: 1.8 }
    }

    /// Relaxes the pixels of one color.
    fn relax(c: &Constants, system: &[[Field; 5]; 2], change: &mut [Field; 2]) {
        let color = c.color as usize;
        let other = change[1 - color].clone();
        cpu_reference(c, &system[color].each_ref(), &other, &mut change[color]);
    }

    /// dV of a random coarse grid as the device stores it, and as the starts of both colors of a level.
    pub(crate) fn coarse_steps(rig: &Rig, width: usize, height: usize) -> (Arc<Buffer>, [Field; 2]) {
        let coarse = random_field(width.div_ceil(2), height.div_ceil(2), 30);
        let buffer = rig.numbers(coarse.data.clone());
        (buffer, [0, 1].map(|color| start(&coarse.data, [width as u32, height as u32], color)))
    }

    #[test]
    fn the_first_relaxation_sweep_starts_from_the_coarse_grid() {
        let (width, height) = (37usize, 21usize);
        let (system, rig) = (system(width, height), Rig::new());
        let (steps, mut change) = coarse_steps(&rig, width, height);
        let right_sides = rig.image(&[0, 1].map(|color: usize| system[color][0].clone()));
        let weights = rig.weights(&interleaved(&system));
        let nothing = Field::from_fn(width.div_ceil(2), height, |_, _| f64::NAN);
        let changes = [0, 1].map(|_| rig.field(&nothing));
        for color in [0, 1] {
            let c = constants(width, height, color);
            relax(&c, &system, &mut change);
            let mut resources =
                [&right_sides, &weights, &changes[1 - color], &changes[color]].map(Resource::Image).to_vec();
            resources.push(Resource::Buffer(&steps));
            rig.run_variant(&STAGE, [true, false, false, false, false], &resources, &c, tiles([c.width, c.height]));
        }
        for color in [0, 1] {
            rig.assert_close(&changes[color], &change[color..=color], 1e-5);
        }
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(37usize, 21usize), (64, 16), (17, 18), (2, 2)] {
            let (system, change) = (system(width, height), random_field(width, height, 4));
            let mut change = [0, 1].map(|color| half(&change, color));
            let rig = Rig::new();
            let (steps, _) = coarse_steps(&rig, width, height);
            let right_sides = rig.image(&[0, 1].map(|color: usize| system[color][0].clone()));
            let weights = rig.weights(&interleaved(&system));
            let changes = change.each_ref().map(|half| rig.field(half));
            for color in [0, 1, 0, 1] {
                let c = constants(width, height, color);
                relax(&c, &system, &mut change);
                let mut resources =
                    [&right_sides, &weights, &changes[1 - color], &changes[color]].map(Resource::Image).to_vec();
                resources.push(Resource::Buffer(&steps));
                rig.run_groups(&STAGE, &resources, &c, tiles([c.width, c.height]));
            }
            for color in [0, 1] {
                rig.assert_close(&changes[color], &change[color..=color], 1e-5);
            }
        }
    }

    #[test]
    fn solves_a_membrane() {
        // -Δu + u/100 = f with a known u: cosine modes of the Neumann grid.
        let n = 24;
        let truth = Field::from_fn(n, n, |x, y| {
            let mode = |k: f64, i: usize| (std::f64::consts::PI * k * (i as f64 + 0.5) / n as f64).cos();
            mode(1.0, x) * mode(2.0, y)
        });
        let mut system: [Field; 5] = std::array::from_fn(|_| Field::zeros(n, n));
        for y in 0..n {
            for x in 0..n {
                let exists = [x + 1 < n, x > 0, y + 1 < n, y > 0];
                let diagonal = 0.01 + exists.iter().filter(|e| **e).count() as f64;
                let (xi, yi) = (x as isize, y as isize);
                let around = [(xi + 1, yi), (xi - 1, yi), (xi, yi + 1), (xi, yi - 1)];
                let mut f = 0.01 * truth.get(x, y);
                for i in 0..4 {
                    if exists[i] {
                        f += truth.get(x, y) - truth.clamped(around[i].0, around[i].1);
                        system[i + 1].data[y * n + x] = 1.0 / diagonal;
                    }
                }
                system[0].data[y * n + x] = f / diagonal;
            }
        }
        let system = [0, 1].map(|color| system.each_ref().map(|part| half(part, color)));
        let mut actual = [(); 2].map(|()| Field::zeros(n / 2, n));
        for color in (0..400).map(|half| half % 2) {
            relax(&constants(n, n, color), &system, &mut actual);
        }
        let actual = both(actual.each_ref(), n);
        for (actual, expected) in actual.data.iter().zip(&truth.data) {
            assert!((actual - expected).abs() < 1e-8, "{actual} {expected}");
        }
    }

    #[test]
    fn a_missing_barrier_between_red_and_black_is_reported() {
        let (width, height) = (32usize, 16usize);
        let rig = Rig::alone();
        if !rig.validates() {
            return;
        }
        let system = system(width, height);
        let right_sides = rig.image(&[0, 1].map(|color: usize| system[color][0].clone()));
        let weights = rig.weights(&interleaved(&system));
        let changes = [0, 1].map(|_| rig.image(&[Field::zeros(width / 2, height)]));
        let (steps, _) = coarse_steps(&rig, width, height);
        let pass = |color: usize| {
            let images = [&right_sides, &weights, &changes[1 - color], &changes[color]];
            let mut resources = images.map(Resource::Image).to_vec();
            resources.push(Resource::Buffer(&steps));
            (resources, constants(width, height, color))
        };
        let record = |omit: bool| {
            rig.record(|recorder, compile| {
                let pipeline = compile(&STAGE);
                for color in [0, 1] {
                    let (resources, constants) = pass(color);
                    if !(omit && color == 1) {
                        recorder.barrier();
                    }
                    let groups =
                        crate::engine::vulkan::Workgroups::Direct(STAGE.groups([width as u32 / 2, height as u32]));
                    recorder.dispatch(&pipeline, &resources, bytemuck::bytes_of(&constants), groups).unwrap();
                }
            });
        };
        record(false);
        assert_eq!(rig.take_messages(), Vec::<String>::new(), "with the barrier");
        record(true);
        let messages = rig.take_messages();
        assert!(messages.iter().any(|m| m.contains("SYNC-HAZARD")), "without the barrier: {messages:?}");
    }
}
