//! Compares two frames of a sweep where the first is the sharper.
//!
//! It computes the linear system for du, and the sums of their registration.
//!
//! Frame k is focused at the setting p_k. A point that is in focus at u is blurred in it by `v_k = c (p_k - u)²`. For a
//! pair
//!
//! ```text
//! V = v_j - v_i = 2 c (p_j - p_i)(m - u),  m = (p_i + p_j)/2          affine in u
//! S = (h(V) * I_i - I_j)/√n,  n = 1 + f/(f + V)                       of equal noise at every V
//! ```
//!
//! The linear system for du is that of a pair for dV times dV/du, summed over all pairs: D = Σ w S_u², b = -Σ w S S_u.
//! With S_c, the derivative by the logarithm of c, q = Σ w S_u S_c says how c depends on u.
//!
//! Where c is held, two estimates of the part of D that noise makes replace q. For noise alone, the variance of S_V is
//! `½ f/(n (f + V)³)` times that of the noise, since S has the noise of one frame at every V. One estimate is for noise
//! of variance 1. The other is for noise as large as S: the mean of `w S² (1 + ½ ln(1 + S²/η²))` is within a tenth of
//! the mean of w times that of S².
//!
//! Where the camera moved, frame k is read at `T (x + p_k u)`. The derivative by u is then that by blur and by place:
//!
//! ```text
//! S_u = S_V dV/du + ∇S (p_j - p_i),  ∇S by the place in frame j
//! ```
//!
//! A second run on the same pair makes the sums of a step of p instead: those with w ∇S ∇Sᵀ u and w ∇S S u in the place of
//! the step of T, and of w ∇S ∇Sᵀ u² in that of the roughness and the spread.
//!
//! f, px², is the correlation of noise that pixel and low pass leave. Section 11 of `docs/method.md`.

use super::pass::{Memory, Pass};
use super::rows::{self, Rows};
use super::stack::{self, Slopes};
use super::sums::{Layout, Line};
use super::{Number, Raster, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::half_pair::*;

/// The variant for a kernel's slopes, for held T and c (no sums), and for homographies.
pub(crate) fn variant(slopes: Slopes, stays: bool, projective: bool) -> Variant {
    Variant::LISTED
        | Variant::ANY_KERNEL.when(slopes == Slopes::Layers)
        | Variant::STAYS.when(stays)
        | Variant::PROJECTIVE.when(projective)
}

/// Lines per invocation.
const ROWS: u32 = shaders::half_pair::ROWS;
/// Pixels along the border that low pass and high pass reach.
const FILTERED: f64 = shaders::half_pair::FILTERED;
/// Layers of the system: D, b, q; for held T and c: D, b and two estimates of D made by noise.
pub const LAYERS: u32 = 4;

/// Width and height of a workgroup's pixels.
pub(crate) const TILE: [u32; 2] = [WORKGROUP[0], WORKGROUP[1] * ROWS];

/// Workgroups over a level: a row of partial sums each.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(TILE[0]), height.div_ceil(TILE[1]), 1]
}

impl Pass for Bindings {
    /// Compulsory traffic: u, two nodes and the other frame read, the system read and written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        40 * pixels(c.width, c.height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let size = [c.width as usize, c.height as usize];
        let mut system = [0, 1, 2, 3].map(|layer| memory.take_layer(self.system, layer));
        system
            .iter_mut()
            .filter(|layer| layer.data.is_empty())
            .for_each(|layer| *layer = Raster::zeros(size[0], size[1]));
        let nodes = &memory.layers(self.stacks)[..c.nodes as usize * slopes(variant).layers()];
        let (focus, other) = (memory.layer(self.focus, 0), memory.layer(self.aligned, c.other as usize));
        let sums = cpu_reference(c, variant, focus, nodes, other, memory.words(self.hidden), &mut system);
        system.into_iter().enumerate().for_each(|(layer, field)| memory.set_layer(self.system, layer, field));
        let first = Layout::of_variant(variant).length * c.row as usize;
        let rows = &mut memory.numbers_mut(self.partials, first + sums.len())[first..];
        rows.iter_mut().zip(sums).for_each(|(number, sum)| *number = N::of(sum));
    }
}

fn slopes(variant: Variant) -> Slopes {
    if variant.has(Variant::ANY_KERNEL) { Slopes::Layers } else { Slopes::Laplacian }
}

/// Adds the contribution of each pixel to the system: D, b, q; or D, b and two of noise. Returns a row of partial sums
/// of the registration for each tile.
pub(crate) fn cpu_reference<N: Number>(
    c: &Constants,
    variant: Variant,
    focus: &Raster<N>,
    stack: &[Raster<N>],
    other: &Raster<N>,
    hidden: &[u32],
    system: &mut [Raster<N>; LAYERS as usize],
) -> Vec<f64> {
    let [left, top, right, bottom] = c.shown.map(f64::from);
    let shows = |[x, y]: [usize; 2], reach: f64| {
        let (x, y) = (x as f64, y as f64);
        (x - left).min(right - x).min(y - top).min(bottom - y) >= reach
    };
    let hides = |pixel: usize, frame: u32| {
        c.words > 0 && hidden[pixel * c.words as usize + frame as usize / 32] >> (frame % 32) & 1 == 1
    };
    let [rate, grain, eta, limit, far] = [c.rate, c.grain, c.eta, c.limit, c.far].map(f64::from);
    let settings = [c.own_setting, c.other_setting].map(f64::from);
    let (moves, per_u) = (c.baseline.map(f64::from), f64::from(c.per_u));
    let [columns, rows, _] = tiles([c.width, c.height]);
    let columns = columns as usize;
    let lines = rows::map(system.each_mut().map(Rows::from), |y, mut system| {
        let mut lines: Vec<Line> = (0..columns).map(|_| Line::default()).collect();
        for x in 0..focus.width {
            let line = &mut lines[x / TILE[0] as usize];
            let away = settings.map(|p| p - focus.get(x, y));
            let (v, before) = (rate * (away[1].powi(2) - away[0].powi(2)), rate * away[0].powi(2));
            if !(v > 0.0 && v < limit && before <= far && shows([x, y], 3.0 * v.sqrt() + FILTERED)) {
                continue;
            }
            if [c.own, c.other].iter().any(|&frame| hides(y * focus.width + x, frame)) {
                continue;
            }
            let blurred = match slopes(variant) {
                Slopes::Laplacian => stack::read_near(stack, v, [x, y]),
                Slopes::Layers => stack::read(stack, Slopes::Layers, v, x as f64, y as f64),
            };
            let (n, slope) = (1.0 + grain / (grain + v), -grain / (grain + v).powi(2));
            let root = 1.0 / n.sqrt();
            let left = blurred.value - other.get(x, y);
            let (s, by_v) = (root * left, root * (blurred.slope - 0.5 * left * slope / n));
            let [jx, jy] = [blurred.dx, blurred.dy].map(|d| -root * d);
            let v_by_u = -2.0 * rate * (settings[1] - settings[0]);
            let (by_u, by_rate) = (v_by_u * by_v + moves[0] * jx + moves[1] * jy, by_v * v);
            // A frame that is far out of focus has little texture left: mostly noise.
            let share = 1.0 / (1.0 + 4.0 * (before - limit).max(0.0) / limit);
            let w = share / (s * s + eta * eta).sqrt();
            let place = (x as f64 - f64::from(c.centre[0])) / f64::from(c.length);
            if per_u != 0.0 {
                let d = per_u * focus.get(x, y);
                let [xx, xy, yy] = [d * w * jx * jx, d * w * jx * jy, d * w * jy * jy];
                line.add([xx, xy, yy], [d * w * s * jx, d * w * s * jy], place);
                line.roughness = [line.roughness[0] + d * xx, line.roughness[1] + d * xy];
                line.spread += d * yy;
                continue;
            }
            line.valid += share;
            let rest = if variant.has(Variant::STAYS) {
                let squares = v_by_u.powi(2) / (grain + v) + moves[0].powi(2) + moves[1].powi(2);
                let of_noise = 0.5 * grain / (n * (grain + v).powi(2)) * squares;
                [of_noise, of_noise * s * s * (1.0 + 0.5 * (s / eta).powi(2).ln_1p())]
            } else {
                line.add([w * jx * jx, w * jx * jy, w * jy * jy], [w * s * jx, w * s * jy], place);
                line.energy += w * s * s;
                line.roughness[0] += w * by_rate * by_rate;
                line.roughness[1] += w * by_rate * s;
                [by_u * by_rate, 0.0]
            };
            let terms = [by_u * by_u, -by_u * s, rest[0], rest[1]];
            system.iter_mut().zip(terms).for_each(|(row, term)| row[x] += N::of(w * term));
        }
        lines
    });
    let layout = Layout::of_variant(variant);
    let mut sums = vec![0.0; layout.length * columns * rows as usize];
    for (y, lines) in lines.iter().enumerate() {
        let place = (y as f64 - f64::from(c.centre[1])) / f64::from(c.length);
        let tiles = sums.chunks_exact_mut(layout.length).skip(columns * (y / TILE[1] as usize));
        lines.iter().zip(tiles).for_each(|(line, sums)| line.add_to(sums, place, layout));
    }
    sums
}
