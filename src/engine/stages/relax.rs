//! Half a relaxation sweep on the linear system for dV: one color of the red-black scheme, equation 28.
//!
//! The system is divided by its diagonal: `dV = r + Σ_n a_n dV_n`. Red pixels have x + y even.

use super::pass::{Memory, Pass};
use super::rows::{self, Rows};
use super::segments::vectorised;
use super::{Field, Number, Raster, WORKGROUP, grid, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::relax::*;

/// Lines of one color per invocation.
pub const ROWS: u32 = 4;

/// Workgroups over a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(2 * WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * ROWS), 1]
}

/// The variant for the first relaxation sweep, which starts from dV of the coarse grid.
pub(crate) const FIRST: Variant = Variant::FIRST;

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
        let (size, color, first) = ([c.width, c.height], c.color as usize, c.first as usize);
        let level = first..first + (c.width * c.height) as usize;
        memory.numbers_mut(self.own_steps, level.end);
        let steps = memory.numbers(self.steps);
        let from = |color: usize, is_coarse: bool| {
            let mut dv = Raster::zeros(c.width.div_ceil(2) as usize, c.height as usize);
            let (coarse, own) = (start_of(steps, c.width, color), own_of(&steps[level.clone()], c.width, color));
            dv.fill_rows(|y, row| if is_coarse { coarse(y, row) } else { own(y, row) });
            dv
        };
        let is_first = variant == FIRST;
        let (other, mut own) = (from(1 - color, is_first && color == 0), from(color, is_first));
        let system = memory.system((self.smoothed, RIGHT_SIDE + color), self.weights, color);
        cpu_reference(c, &system, &other, &mut own);
        let dv = &mut memory.numbers_mut(self.own_steps, level.end)[level];
        for (y, row) in dv.chunks_exact_mut(size[0] as usize).enumerate() {
            row.iter_mut().skip((y + color) & 1).step_by(2).zip(own.row(y)).for_each(|(to, dv)| *to = *dv);
        }
    }
}

/// The layer of the right sides of red, as [`system_tiles`](super::system_tiles) stores them.
const RIGHT_SIDE: usize = shaders::relax::RIGHT_SIDE as usize;

/// Sets a row of dV of one color before the first relaxation sweep; 0 where a row has no pixel left.
pub(super) fn start_of<N: Number>(steps: &[N], width: u32, color: usize) -> impl Fn(usize, &mut [N]) {
    let columns = width.div_ceil(2) as usize;
    move |y, row| {
        row.copy_from_slice(&steps[y / 2 * columns..][..columns]);
        if width % 2 == 1 && (y + color) % 2 == 1 {
            row[columns - 1] = N::default();
        }
    }
}

/// Sets a row of dV of one color to that of the level; 0 where a row has no pixel left.
pub(super) fn own_of<N: Number>(dv: &[N], width: u32, color: usize) -> impl Fn(usize, &mut [N]) {
    move |y, row| {
        row.fill(N::default());
        let own = dv[y * width as usize..][..width as usize].iter().skip((y + color) & 1).step_by(2);
        row.iter_mut().zip(own).for_each(|(to, dv)| *to = *dv);
    }
}

/// dV of both colors after relaxation sweeps on a level. `start` sets a row of each color before; the rasters in `reused`
/// give their memory. The numbers are those of one half of a sweep after the other.
pub(super) fn relaxed<N: Number>(
    reused: [Raster<N>; 2],
    [width, height]: [u32; 2],
    (sweeps, over_relaxation): (u32, f32),
    system: &[[&Raster<N>; 5]; 2],
    start: [impl Fn(usize, &mut [N]) + Sync; 2],
) -> [Raster<N>; 2] {
    let ([columns, height], halves) = ([width.div_ceil(2), height].map(|side| side as usize), 2 * sweeps as usize);
    let omega = N::of(over_relaxation.into());
    let mut relaxed = reused.map(|raster| raster.of_size([columns, height]));
    let lines = grid::band(halves);
    rows::map(relaxed.each_mut().map(|raster| Rows::from(raster).joined(lines)), |band, results| {
        let rows = band * lines..(band * lines + lines).min(height);
        let around = |reach: usize| rows.start.saturating_sub(reach)..(rows.end + reach).min(height);
        let top = around(halves).start;
        let mut dv = [0, 1].map(|color| {
            let mut dv = Raster { width: columns, height: 0, data: vec![N::default(); columns * around(halves).len()] };
            dv.data.chunks_exact_mut(columns).enumerate().for_each(|(n, row)| start[color](top + n, row));
            dv
        });
        for half in 0..halves {
            let [own, other] = &mut dv;
            for y in around(halves - 1 - half) {
                let near = [y.saturating_sub(1), y, (y + 1).min(height - 1)].map(|y| other.row(y - top));
                let parts = system[half % 2].map(|part| part.row(y));
                relax_row(parts, near, &mut own.data[(y - top) * columns..][..columns], (y + half) & 1, omega);
            }
            dv.swap(0, 1);
        }
        for (result, dv) in results.into_iter().zip(dv) {
            result.copy_from_slice(&dv.data[(rows.start - top) * columns..][..result.len()]);
        }
    });
    relaxed
}

/// Relaxes dV of one color, by that of the other. All are of one color, as the device stores them: the linear system,
/// which is the right side and the weights of the right, left, lower and upper neighbours, and dV.
pub fn cpu_reference<N: Number>(c: &Constants, system: &[&Raster<N>; 5], other: &Raster<N>, own: &mut Raster<N>) {
    let (omega, height) = (N::of(c.over_relaxation.into()), own.height);
    own.fill_rows(|y, own| {
        let near = [y.saturating_sub(1), y, (y + 1).min(height - 1)].map(|y| other.row(y));
        relax_row(system.map(|part| part.row(y)), near, own, (y + c.color as usize) & 1, omega);
    });
}

/// Relaxes a row of one color by the rows of its system, and by the rows of the other color above, here and below.
/// Pixel 2 h + `shift` of the row is between the pixels h - 1 + shift and h + shift of the other color. The first or
/// the last has only one neighbour in the row: the weight of the other is 0.
fn relax_row<N: Number>(parts: [&[N]; 5], [up, here, down]: [&[N]; 3], own: &mut [N], shift: usize, omega: N) {
    let last = own.len() - 1;
    let end = if shift == 0 { 0 } else { last };
    let pull = parts[3][end] * down[end] + parts[4][end] * up[end];
    let target = parts[0][end] + parts[1][end] * here[end] + parts[2][end] * here[end] + pull;
    own[end] += omega * (target - own[end]);
    let inner = 1 - shift..last + 1 - shift;
    let [side, right, left, below, above] = parts.map(|part| &part[inner.clone()]);
    let (up, down, own) = (&up[inner.clone()], &down[inner.clone()], &mut own[inner]);
    let (before, behind) = (&here[..last], &here[1..]);
    vectorised::<N, _>(
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
    use ::half::f16;

    use super::super::Field;
    use super::super::harness::{Rig, random_field};
    use super::*;
    use crate::engine::vulkan::Resource;

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
        Constants { width, height, color, rows: ROWS, over_relaxation: 1.8, first: 0 }
    }

    /// Relaxes the pixels of one color.
    fn relax(c: &Constants, system: &[[Field; 5]; 2], change: &mut [Field; 2]) {
        let color = c.color as usize;
        let other = change[1 - color].clone();
        cpu_reference(c, &system[color].each_ref(), &other, &mut change[color]);
    }

    /// dV of both colors of a level before the first relaxation sweep.
    fn start(coarse: &[f64], width: usize, height: usize) -> [Field; 2] {
        [0, 1].map(|color| {
            let mut start = Field::zeros(width.div_ceil(2), height);
            start.fill_rows(start_of(coarse, width as u32, color));
            start
        })
    }

    #[test]
    fn all_sweeps_at_once_are_one_half_after_the_other() {
        for (width, height) in [(37usize, 21usize), (64, 133), (9, 64), (1, 40), (2, 2)] {
            let (system, coarse) = (system(width, height), random_field(width.div_ceil(2), height.div_ceil(2), 5).data);
            for sweeps in [1, 3, 9] {
                let mut expected = start(&coarse, width, height);
                for half in 0..2 * sweeps {
                    relax(&constants(width, height, half % 2), &system, &mut expected);
                }
                let size = [width as u32, height as u32];
                let parts = system.each_ref().map(|parts| parts.each_ref());
                let starts = [0, 1].map(|color| start_of(&coarse, size[0], color));
                let actual = relaxed(Default::default(), size, (sweeps as u32, 1.8), &parts, starts);
                assert!(actual == expected, "{width} x {height}, {sweeps} sweeps");
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
        let sides = both(system.each_ref().map(|[right_side, ..]| right_side), width);
        let images = [rig.image(&[sides.clone(), sides]), rig.weights(&interleaved(&system))];
        let steps = rig.numbers(vec![0.0; width * height]);
        let pass = |color: usize| {
            let images = [&images[0], &images[1]].map(Resource::Image).into_iter();
            let resources: Vec<_> = images.chain([&steps, &steps].map(Resource::Buffer)).collect();
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
