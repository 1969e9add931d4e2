//! Computes the normal equations for the step of T and of the parallax together, in windows of a level.
//!
//! A camera that moved between the photographs displaces a point by an amount that is linear in one over its distance,
//! as V is. So `I2(T (x + (p + q (x - c)) V(x)))` lines up with I1(x), with three numbers for the whole photograph.
//! Derivatives of S by p and q are those by place times V. dV is eliminated as in [`linearise`](mod@super::linearise).
//!
//! A window has 16 x 16 px. The scatter over the windows determines the deviation of the parallax, because residuals of
//! photographs are alike over a feature.

use super::blur::Samples;
use super::linearise::{Datum, spread};
use super::links::Links;
use super::mask::{self, Masks};
use super::noise;
use super::pass::{Memory, Pass};
use super::state::{Displacement, DoubleState, inside};
use super::sums;
use super::{Number, Raster, WORKGROUP, law::Variances};
use crate::base::{Parallax, workers};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::parallax_windows::*;

/// Side of a window, pixels.
const SIDE: usize = shaders::parallax_windows::SIDE as usize;
/// The most windows along a side of the level: 400 determine the parallax well, and more take longer.
const MOST_ALONG: u32 = 20;
/// The unknowns: those of T, and the parallax across the axis and along it.
pub(super) const ALL: usize = OF_T + 3;
/// The unknowns of T.
pub(super) const OF_T: usize = shaders::parallax::OF_T as usize;
/// The place of the gradient.
pub(super) const GRADIENT: usize = ALL * (ALL + 1) / 2;
/// The place of the pixels that count, of V times these, and of V² times these.
pub(super) const PIXELS: usize = GRADIENT + ALL;
/// The place of the smoothness term, of the evidence for the scale of V, and of that by parallax.
pub(super) const ROUGHNESS: usize = PIXELS + 3;
/// Numbers of a window: the upper triangle of N, row by row; then these.
pub(super) const NUMBERS: usize = ROUGHNESS + 3;
// An invocation for each.
const _: () = assert!(NUMBERS <= (WORKGROUP[0] * WORKGROUP[1]) as usize);

/// Columns and rows of windows on a level.
pub(crate) fn grid(size: [u32; 2]) -> [u32; 2] {
    size.map(|side| (side / SIDE as u32).clamp(1, MOST_ALONG))
}

/// The most floats of all windows of a level.
pub(crate) const FLOATS: u64 = NUMBERS as u64 * (MOST_ALONG * MOST_ALONG) as u64;

/// Whether a level is large enough for a window.
pub(crate) fn fits([width, height]: [u32; 2]) -> bool {
    width.min(height) >= SIDE as u32
}

/// Whether a step is taken: not once the level has settled.
pub(super) fn is_due(state: &DoubleState, level: u32) -> bool {
    state.levels[level as usize].settled == 0 && state.parallax != Parallax::NONE
}

impl Pass for Bindings {
    /// Compulsory traffic: of the pixels of the windows V and two nodes of either stack.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        20 * u64::from(c.grid[0] * c.grid[1]) * (SIDE * SIDE) as u64
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        if !is_due(state, c.level) {
            return;
        }
        let masks = mask::of(memory, self.masks, variant);
        let lens = (c.mean, c.factor, c.centre);
        let samples = Samples::of(state, memory.layers(self.stacks), [c.second_stack, c.nodes], lens, variant);
        let windows = cpu_reference(c, state, &samples, memory.layer(self.unknown, 0), masks);
        let numbers = memory.numbers_mut(self.partials, FLOATS as usize);
        numbers.iter_mut().zip(windows.as_flattened()).for_each(|(to, from)| *to = N::of(*from));
    }
}

/// The numbers of all windows, row by row.
fn cpu_reference<N: Number>(
    c: &Constants,
    state: &DoubleState,
    samples: &Samples<N>,
    v: &Raster<N>,
    masks: Option<&Masks<N>>,
) -> Vec<[f64; NUMBERS]> {
    let [columns, rows] = c.grid.map(|n| n as usize);
    let corner = |n: usize, of: usize, side: usize| (2 * n + 1) * side / (2 * of) - SIDE / 2;
    let links = Links::new(v, [state.alpha, 1.0, c.smoothness_eta.into()], true);
    let rows = workers::map(rows, |row| {
        let (top, mut windows) = (corner(row, rows, v.height), vec![[0.0; NUMBERS]; columns]);
        let mut links = links.rows_from(top);
        for y in top..top + SIDE {
            links.advance(y);
            for (n, numbers) in windows.iter_mut().enumerate() {
                let (left, mut sums) = (corner(n, columns, v.width), [[N::default(); SIDE]; 2]);
                let [weights, pulls] = &mut sums;
                links.sums(left, [weights, pulls]);
                for x in left..left + SIDE {
                    let [weight, pull] = sums.map(|sums| sums[x - left].into());
                    let smoothness = [weight, pull, links.roughness(v, [x, y])];
                    add_pixel(c, state, samples, (v, masks), ([x, y], smoothness), numbers);
                }
            }
        }
        windows
    });
    rows.concat()
}

/// Adds a pixel to the numbers of its window.
fn add_pixel<N: Number>(
    c: &Constants,
    state: &DoubleState,
    samples: &Samples<N>,
    (v, masks): (&Raster<N>, Option<&Masks<N>>),
    (at @ [x, y], [total, pull, roughness]): ([usize; 2], [f64; 3]),
    numbers: &mut [f64; NUMBERS],
) {
    let (Displacement { r, centre, .. }, place) = (samples.displacement, at.map(|x| x as f64));
    let (of_v, size) = (v.get(x, y), [v.width, v.height]);
    let d = samples.displacement.of(place, of_v);
    if !inside(at, d, size, Variances::new(of_v, samples.separation).both(), r.scale()) {
        return;
    }
    let share = mask::counts(masks, at, d);
    if share == 0.0 {
        return;
    }
    let level = Datum {
        gain: r.gain,
        offset: r.offset,
        eta: c.eta.into(),
        separation: samples.separation,
        spread: spread(c.eta, state.spread),
        noise: &c.noise,
    };
    let [b1, b2] = samples.read(at, d, of_v);
    let (moves, second) = (samples.displacement.by_v(place), [b2.value, b2.slope, b2.dx, b2.dy]);
    let displaced = [moves, noise::interpolated_slope(d)];
    let t = level.of([of_v, share, noise::interpolated(d)], [b1.value, b1.slope], second, displaced);
    let by_place = t.by_place;
    let diagonal = t.weight * t.by_v * t.by_v;
    let over = 1.0 / (diagonal + f64::from(c.elimination) * total).max(1e-12);
    let p = [0, 1].map(|k| (place[k] - centre[k]) / f64::from(c.scale_length));
    let mut column = [0.0; ALL];
    for (number, displaced) in column.iter_mut().zip(sums::displacements(p)) {
        *number = displaced[0] * by_place[0] + displaced[1] * by_place[1];
    }
    column[OF_T] = of_v * by_place[0];
    column[OF_T + 1] = of_v * by_place[1];
    column[OF_T + 2] = of_v * (p[0] * by_place[0] + p[1] * by_place[1]);
    let weight = level.broadened(t.psi) * t.weight;
    let side = weight * (t.s + t.by_v * over * (pull - t.weight * t.s * t.by_v));
    let mut n = 0;
    for i in 0..ALL {
        for j in i..ALL {
            numbers[n] += weight * (1.0 - diagonal * over) * column[i] * column[j];
            n += 1;
        }
        numbers[GRADIENT + i] += side * column[i];
    }
    let by_parallax = of_v * (by_place[0] * moves[0] + by_place[1] * moves[1]);
    let added = [
        share,
        share * of_v,
        share * of_v * of_v,
        level.broadened(t.psi) * roughness,
        weight * (of_v * t.by_v).powi(2),
        weight * by_parallax.powi(2),
    ];
    numbers[PIXELS..].iter_mut().zip(added).for_each(|(sum, number)| *sum += number);
}
