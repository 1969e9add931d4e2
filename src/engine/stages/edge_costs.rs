//! The costs of displaced outlines at a depth edge. Section 7 of `docs/method.md`.
//!
//! The model has two layers. The front one is in focus at its own V and hides part of the other. `h(v)` is a Gaussian
//! of variance v, V_f and V_b are those of the front and of the back, and m is 1 inside the outline. With the
//! photograph `I_s` in which the front is the sharper, and the other one `I_o`, the front's light in `I_o` is
//! `A = h(|V_f|) * (m I_s)`, and the share `t = 1 - h(|V_f|) * m` of the back's light passes the front's rim. The back
//! is `(I_o - A)/t` where its V has the other sign, and `I_s` outside where it has the same. Both photographs are
//! compared with what this predicts, and residuals r of variance s cost `ln(1 + r²/s) + ½ ln(s/s₀)`: the second term is
//! the price of texture that is not predicted. Without it outlines are biased.
//!
//! The outline of a cell is straight and is displaced along the normal. So all filters are along the normal, after one
//! blur across it. The other order, with the far side in front, is the same seen from the other side.

use std::ops::Range;

use super::edge::{self, BACKWARD, COSTS, DISPLACEMENTS, EDGES, Edge, REVERSED_COSTS, TOTAL, between};
use super::pass::{Memory, Pass};
use super::segments::vectorised;
use super::state::{DoubleState, from_centre};
use super::{Number, Raster};
use crate::base::workers;
use crate::engine::arguments::Edges;
use crate::engine::plan::Level;
use crate::engine::vulkan::Variant;

pub use super::interface::edge_costs::*;
use crate::engine::shaders::edge_costs as shader;

/// Two frames of a sweep, on one frame's pixels; their costs are added to those of other frames.
pub(crate) const SWEEP: Variant = Variant::SWEEP;

/// The largest |V| of a side, px²: the blur that the samples have room for.
pub(crate) const LARGEST: f32 = shader::LARGEST as f32;

impl Constants {
    /// Those of a pair on a level, in a solve of `levels` levels.
    pub(crate) fn of_pair(level: &Level, levels: usize) -> Self {
        let ([width, height], centre, factor) = (level.size, level.centre.map(|c| c as f32), level.factor as f32);
        let argument_place = Edges::Cells(level.index).word(levels) as u32;
        Self { width, height, centre, factor, rate: 0.0, settings: [0.0; 2], layers: [0; 2], argument_place }
    }

    /// V between two frames of a sweep where u is in focus.
    fn relative_blur(&self, u: f64) -> f64 {
        let [first, second] = self.settings.map(f64::from);
        f64::from(self.rate) * (first - second) * (2.0 * u - first - second)
    }

    /// The edge with V of its sides, and the share of two frames of a sweep in its costs; `None` if they have none.
    fn in_frames(&self, edge: &Edge) -> Option<(Edge, f64)> {
        let levels @ [near, far] = edge.levels.map(|u| self.relative_blur(u));
        let away = |side: usize| (edge.levels[side] - f64::from(self.settings[side])).powi(2);
        let blur = f64::from(self.rate) * (away(0) + away(1));
        let fits = near > 0.0 && far < 0.0 && near.max(-far) <= shader::LARGEST && blur <= shader::FAR;
        fits.then(|| (Edge { levels, ..*edge }, (-blur / (2.0 * shader::FOCUSED)).exp()))
    }
}

impl Pass for Bindings {
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        edge::traffic([c.width, c.height])
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let mut layers = CHANGED_LAYERS.map(|layer| memory.take_layer(self.results, layer));
        let [first, second] = c.layers.map(|layer| layer as usize);
        let photographs = [memory.layer(self.image1, first), memory.layer(self.image2, second)];
        let v = memory.layer(self.relative_blur, 0);
        cpu_reference(c, variant, memory.state(self.state), photographs, v, &mut layers);
        for (n, layer) in CHANGED_LAYERS.into_iter().zip(layers) {
            memory.set_layer(self.results, n, layer);
        }
    }
}

const HALF: usize = shader::HALF as usize;
const ALONG: usize = 2 * HALF + 1;
const LINES: usize = shader::LINES as usize;
const REACH: usize = shader::REACH as usize;
const ROWS: usize = LINES + 2 * REACH;
const WINDOW: usize = shader::WINDOW as usize;
/// Places that costs are summed over on a line. All kernels stay on the line there.
const COSTED: usize = 2 * WINDOW + 1;
const _: () = assert!(HALF >= WINDOW + REACH);
/// The first of these places.
const FIRST_COSTED: usize = HALF - WINDOW;
/// The place of the first outline.
const FIRST: usize = HALF - BACKWARD;

/// Samples of a photograph along the normal, on lines side by side.
type Profile = [[f64; ALONG]; ROWS];
/// The same on the lines that costs are summed over.
type Lines = [[f64; ALONG]; LINES];

/// The layers that the pass changes: the costs in both orders; the edges, which hold the share.
const CHANGED_LAYERS: [usize; 3] = [COSTS, REVERSED_COSTS, EDGES];

/// Sets the costs in both orders and their share, or adds to them for two frames of a sweep. `layers`: those of
/// [`CHANGED_LAYERS`].
pub(crate) fn cpu_reference<N: Number>(
    c: &Constants,
    variant: Variant,
    state: &DoubleState,
    [i1, i2]: [&Raster<N>; 2],
    v: &Raster<N>,
    layers: &mut [Raster<N>; 3],
) {
    let is_sweep = variant == SWEEP;
    let found: Vec<_> = edge::all_cells([c.width, c.height])
        .filter_map(|cell| {
            let edge = Edge::of(&layers[2], cell)?;
            let (edge, share) = if is_sweep { c.in_frames(&edge)? } else { (edge, 1.0) };
            Some((cell, edge, share))
        })
        .collect();
    let state = (!is_sweep).then_some(state);
    let costs = |n: usize| {
        let (_, edge, _) = &found[n];
        let profiles = profiles(c, state, [i1, i2], edge);
        let near_in = &profiles[usize::from(edge.levels[0] <= 0.0)];
        let samples = || near_in[REACH..REACH + LINES].iter().flatten();
        let average = samples().sum::<f64>() / (LINES * ALONG) as f64;
        let square = samples().map(|i| i * i).sum::<f64>() / (LINES * ALONG) as f64;
        let least = shader::LEAST.powi(2) + shader::CONTRAST.powi(2) * (square - average * average).max(0.0);
        let [near, far] = edge.levels;
        let middle = 0.5 * (near + far);
        let v_at = |line: usize, k: usize| {
            let v = between(v, place_on(edge, line as f64, k));
            if is_sweep { c.relative_blur(v) } else { v }
        };
        let of_near = TwoLayers::new(&profiles, [near, far], average, least);
        let of_far = TwoLayers::new(&profiles.map(|profile| reversed(&profile)), [far, near], average, least);
        let before = [
            of_near.cost_before(|v| v > middle, v_at),
            of_far.cost_before(|v| v <= middle, |line, k| v_at(LINES - 1 - line, ALONG - 1 - k)),
        ];
        ([of_near.costs(), of_far.costs()], before)
    };
    let size = |layer: &Raster<N>| [layer.width, layer.height];
    if !is_sweep || size(&layers[0]) != size(v) {
        (layers[0], layers[1]) = (Raster::zeros(v.width, v.height), Raster::zeros(v.width, v.height));
    }
    for ((both, before), (cell, _, share)) in workers::map(found.len(), costs).into_iter().zip(&found) {
        for ((costs, before), layer) in both.iter().zip(before).zip(&mut *layers) {
            for (n, cost) in costs.iter().copied().chain([before]).enumerate() {
                edge::add(layer, *cell, n, share * cost);
            }
        }
        edge::add(&mut layers[2], *cell, TOTAL, *share);
    }
}

/// V of the side on which a sample is.
fn side_of(edge: &Edge, k: usize) -> f64 {
    edge.levels[usize::from(k < HALF)]
}

/// The place of a sample.
fn place_on(edge: &Edge, line: f64, k: usize) -> [f64; 2] {
    let (along, across) = (k as f64 - HALF as f64, line - 0.5 * (LINES - 1) as f64);
    let [nx, ny] = edge.normal;
    [edge.place[0] + along * nx - across * ny, edge.place[1] + along * ny + across * nx]
}

/// Samples of I1, and of I2 on I1's pixels with I1's brightness. `state`: `None` if I2 is so already.
fn profiles<N: Number>(
    c: &Constants,
    state: Option<&DoubleState>,
    [i1, i2]: [&Raster<N>; 2],
    edge: &Edge,
) -> [Profile; 2] {
    let (centre, factor) = (c.centre.map(f64::from), f64::from(c.factor));
    let last = [i1.width as f64 - 1.0, i1.height as f64 - 1.0];
    let inside = |x: [f64; 2]| [0, 1].map(|i| x[i].clamp(0.0, last[i]));
    // Shading hardly changes around an edge.
    let matched = state.map(|state| {
        let r = &state.registration;
        let [dx, dy] = r.displacement_at(edge.place, factor, centre);
        (
            state.displacement(c.factor, c.centre),
            state.applied_shading.at(from_centre([edge.place[0] + dx, edge.place[1] + dy], centre)),
        )
    });
    let mut profiles = [[[0.0; ALONG]; ROWS]; 2];
    for (row, k) in (0..ROWS).flat_map(|row| (0..ALONG).map(move |k| (row, k))) {
        let x = inside(place_on(edge, row as f64 - REACH as f64, k));
        profiles[0][row][k] = between(i1, x);
        profiles[1][row][k] = matched.map_or_else(
            || between(i2, x),
            |(displacement, shading)| {
                let (d, r) = (displacement.of(x, side_of(edge, k)), displacement.r);
                r.gain * shading * between(i2, inside([x[0] + d[0], x[1] + d[1]])) + r.offset
            },
        );
    }
    profiles
}

/// A profile as seen from the other side.
fn reversed(profile: &Profile) -> Profile {
    std::array::from_fn(|row| std::array::from_fn(|k| profile[ROWS - 1 - row][ALONG - 1 - k]))
}

/// The weights of a Gaussian.
#[derive(Clone, Copy)]
struct Kernel {
    /// The last place with a weight, px.
    reach: usize,
    /// At every distance that samples can have, from `-AWAY` on.
    weights: [f64; 2 * AWAY + 1],
}

/// The largest distance of a sample to a place beyond the last.
const AWAY: usize = ALONG + REACH;

impl Kernel {
    fn new(variance: f64) -> Self {
        let variance = variance.max(shader::LEAST_VARIANCE);
        let reach = ((shader::EXTENT * variance.sqrt()).ceil() as usize).min(REACH);
        // exp(-i²/2v) by its ratios.
        let first = (-0.5 / variance).exp();
        let (mut half, mut ratio, mut sum) = ([1.0; REACH + 1], first, 1.0);
        for i in 1..=reach {
            half[i] = ratio * half[i - 1];
            ratio = ratio * first * first;
            sum += 2.0 * half[i];
        }
        let mut weights = [0.0; 2 * AWAY + 1];
        for i in 0..=reach {
            weights[AWAY + i] = half[i] / sum;
            weights[AWAY - i] = half[i] / sum;
        }
        Self { reach, weights }
    }

    /// The weights on either side of the middle one, and that.
    #[inline(always)]
    fn taps(&self) -> &[f64] {
        &self.weights[AWAY - self.reach..=AWAY + self.reach]
    }

    /// The weights of all samples at place q.
    #[inline(always)]
    fn about(&self, q: usize) -> &[f64] {
        &self.weights[AWAY - q..][..ALONG]
    }
}

/// Blur across the normal.
#[inline(always)]
fn across(profile: &Profile, kernel: &Kernel) -> Lines {
    let mut lines = [[0.0; ALONG]; LINES];
    for line in 0..LINES {
        let rows = &profile[REACH + line - kernel.reach..];
        for (row, w) in rows.iter().zip(kernel.taps()) {
            for k in 0..ALONG {
                lines[line][k] += w * row[k];
            }
        }
    }
    lines
}

/// Blur along the normal, at the places that costs are summed over.
#[inline(always)]
fn along(kernel: &Kernel, layer: &[f64; ALONG]) -> [f64; COSTED] {
    let mut sums = [0.0; COSTED];
    for (n, w) in kernel.taps().iter().enumerate() {
        let values = &layer[FIRST_COSTED - kernel.reach + n..][..COSTED];
        for k in 0..COSTED {
            sums[k] += w * values[k];
        }
    }
    sums
}

/// Blur along the normal of the values inside each outline, then of all values, at each place.
#[inline(always)]
fn inside(kernel: &Kernel, value: impl Fn(usize) -> f64) -> [[f64; ALONG]; DISPLACEMENTS + 1] {
    let mut sums = [[0.0; ALONG]; DISPLACEMENTS + 1];
    let [of_outlines @ .., all] = &mut sums;
    for q in (0..ALONG + REACH).rev() {
        let (weights, value) = (kernel.about(q), value(q));
        for k in 0..ALONG {
            all[k] += weights[k] * value;
        }
        if (FIRST..FIRST + DISPLACEMENTS).contains(&q) {
            of_outlines[q - FIRST] = *all;
        }
    }
    sums
}

/// The mean of the values around place k over some samples; over all where none of them is in reach.
fn mean_of(kernel: &Kernel, k: usize, values: &[f64; ALONG], samples: Range<usize>) -> f64 {
    let mean = |samples: Range<usize>| {
        let near = k.saturating_sub(kernel.reach).max(samples.start)..samples.end.min(k + kernel.reach + 1);
        let weights = kernel.about(k);
        let (mut sum, mut weight) = (0.0, 0.0);
        for q in near {
            sum += weights[q] * values[q];
            weight += weights[q];
        }
        (weight > 1e-3).then_some(sum / weight)
    };
    mean(samples).or_else(|| mean(0..ALONG)).unwrap_or_default()
}

fn is(condition: bool) -> f64 {
    f64::from(u8::from(condition))
}

/// e to twice the cost of a residual: `(1 + r²/s)² s/s₀`. Products of eight are far from the largest number.
#[inline(always)]
fn factor(residual: f64, variance: f64, least: f64) -> f64 {
    let explained = 1.0 + residual * residual / variance;
    explained * explained * variance / least
}

/// The two layers around a cell in one order, and what their costs share.
struct TwoLayers {
    /// Whether V of the front is positive.
    front_is_positive: bool,
    /// Whether the back is the sharper in the other photograph.
    opposite: bool,
    /// The photograph in which the front is the sharper, and the other.
    in_sharper: Lines,
    in_other: Lines,
    /// The front blurred across the normal by its own kernel, and by that of local means.
    front: Lines,
    near: Lines,
    /// The back, where it is the sharper, by its own kernel and by that of texture; the front by the front's and those.
    back: [Lines; 2],
    hiding: [Lines; 2],
    /// The kernels along the normal: of the front; of the back and of texture; of local means.
    of_front: Kernel,
    of_back: [Kernel; 2],
    of_mean: Kernel,
    /// Of the photograph in which the near side is the sharper, on the lines.
    average: f64,
    /// The least variance of a residual.
    least: f64,
    /// Variance of the texture: in front; outside it in the same photograph; behind, where the front's blur does not
    /// reach.
    textures: [f64; 3],
}

impl TwoLayers {
    fn new(profiles: &[Profile; 2], [front_v, back_v]: [f64; 2], average: f64, least: f64) -> Self {
        let (sharper, other) = if front_v > 0.0 { (&profiles[0], &profiles[1]) } else { (&profiles[1], &profiles[0]) };
        let opposite = (front_v > 0.0) != (back_v > 0.0);
        let on_lines = |profile: &Profile| -> Lines { std::array::from_fn(|line| profile[REACH + line]) };
        let back_in = if opposite { other } else { sharper };
        let behind = [back_v.abs(), shader::TEXTURE_VARIANCE];
        let (of_front, of_mean) = (Kernel::new(front_v.abs()), Kernel::new(shader::MEAN_VARIANCE));
        let (of_back, of_both) = (behind.map(Kernel::new), behind.map(|behind| Kernel::new(front_v.abs() + behind)));
        let [front, near] = [&of_front, &of_mean].map(|kernel| across(sharper, kernel));
        let mut layers = Self {
            front_is_positive: front_v > 0.0,
            opposite,
            in_sharper: on_lines(sharper),
            in_other: on_lines(other),
            front,
            near,
            back: of_back.each_ref().map(|kernel| across(back_in, kernel)),
            hiding: of_both.each_ref().map(|kernel| across(sharper, kernel)),
            of_front,
            of_back,
            of_mean,
            average,
            least,
            textures: [0.0; 3],
        };
        let variance = |from: isize, to: isize, difference: &dyn Fn(usize, usize) -> f64| {
            let range = HALF.wrapping_add_signed(from)..=HALF.wrapping_add_signed(to);
            let squares = range.clone().flat_map(|k| (0..LINES).map(move |line| (line, k)));
            squares.map(|(line, k)| difference(line, k).powi(2)).sum::<f64>() / (LINES * range.count()) as f64
        };
        layers.textures = [
            variance(4, 16, &|line, k| layers.of_front_texture(line, k, HALF + 2..ALONG)),
            variance(-14, 0, &|line, k| layers.of_front_texture(line, k, 0..HALF + 2)),
            variance(-16, -4, &|line, k| layers.of_back_texture(line, k, HALF - 1)),
        ];
        layers
    }

    /// The photograph in which the front is the sharper, less its local mean over some samples.
    fn of_front_texture(&self, line: usize, k: usize, samples: Range<usize>) -> f64 {
        self.in_sharper[line][k] - mean_of(&self.of_mean, k, &self.near[line], samples)
    }

    /// The photograph in which the back is the sharper, less its local mean over the samples before `end`.
    fn of_back_texture(&self, line: usize, k: usize, end: usize) -> f64 {
        let back_sharp = if self.opposite { &self.in_other } else { &self.in_sharper };
        back_sharp[line][k] - mean_of(&self.of_back[1], k, &self.back[1][line], 0..end)
    }

    /// The costs of all displacements.
    fn costs(&self) -> [f64; DISPLACEMENTS] {
        let mut factors = [[1.0; COSTED]; DISPLACEMENTS];
        // Doubles, but in solves too: for all instructions, as single precision is.
        vectorised::<f32, _>(
            #[inline(always)]
            || self.multiply(&mut factors),
        );
        factors.map(|factors| factors.iter().map(|factor| 0.5 * factor.ln()).sum())
    }

    /// Multiplies by the factors of both photographs at each displacement and place.
    #[inline(always)]
    fn multiply(&self, factors: &mut [[f64; COSTED]; DISPLACEMENTS]) {
        let ([front_texture, outside_texture, back_texture], last) = (self.textures, ALONG - 1);
        let (least, some) = (self.least, 1e-3);
        let in_front = inside(&self.of_front, |_| 1.0);
        let rims = inside(&Kernel::new(shader::RIM_VARIANCE), |_| 1.0);
        let means = inside(&self.of_mean, |q| is(q <= last));
        for line in 0..LINES {
            let near = inside(&self.of_mean, |q| if q <= last { self.near[line][q] } else { 0.0 });
            let lit = inside(&self.of_front, |q| self.front[line][q.min(last)]);
            let hidden = [
                inside(&self.of_front, |q| self.hiding[0][line][q.min(last)]),
                inside(&self.of_front, |q| self.hiding[1][line][q.min(last)]),
            ];
            for n in 0..DISPLACEMENTS {
                let outline = FIRST + n;
                let (mut weights, mut layers) = ([0.0; ALONG], [[0.0; ALONG]; 2]);
                for k in 0..ALONG {
                    let open = 1.0 - in_front[n][k];
                    let by_light = if open < shader::DIM { 0.0 } else { open * open };
                    weights[k] = if self.opposite { by_light } else { is(k < outline) };
                    for which in 0..2 {
                        let back = self.back[which][line][k];
                        let restored = ((back - hidden[which][n][k]) / open.max(shader::DIM)).clamp(-0.3, 1.3);
                        layers[which][k] = weights[k] * if self.opposite { restored } else { back };
                    }
                }
                let [of_back, of_texture] = &self.of_back;
                let (known, fine) = (along(of_back, &weights), along(of_back, &layers[0]));
                let (weighed, coarse) = (along(of_texture, &weights), along(of_texture, &layers[1]));
                for place in 0..COSTED {
                    let k = FIRST_COSTED + place;
                    let average = |sum: f64, weight: f64| if weight > some { sum / weight } else { self.average };
                    let known = known[place];
                    let coarse = average(coarse[place], weighed[place]);
                    let fine = if known > some { fine[place] / known } else { coarse };
                    let hidden = (1.0 - known).clamp(0.0, 1.0);
                    let gap = shader::HIDDEN * hidden * hidden * back_texture;
                    let near_mean = average(near[n][k], means[n][k]);
                    let far_weight = means[DISPLACEMENTS][k] - means[n][k];
                    let far_mean = average(near[DISPLACEMENTS][k] - near[n][k], far_weight);
                    let (open, lit, rim) = (1.0 - in_front[n][k], lit[n][k], rims[n][k]);
                    // The other photograph: the front's blur over the back.
                    let (behind, texture) = if self.opposite { (coarse, back_texture) } else { (fine, gap) };
                    let other =
                        factor(lit + open * behind - self.in_other[line][k], least + open * open * texture, least);
                    // The sharper photograph: inside like its neighbours inside, outside like the back.
                    let of_rim = rim * rim * front_texture + (1.0 - rim) * (1.0 - rim) * gap;
                    let (outside, texture) = match self.opposite {
                        true => (rim * near_mean + (1.0 - rim) * fine, of_rim),
                        false => (far_mean, outside_texture),
                    };
                    let (model, texture) = if k >= outline { (near_mean, front_texture) } else { (outside, texture) };
                    factors[n][place] *= other * factor(self.in_sharper[line][k] - model, least + texture, least);
                }
            }
        }
    }

    /// The cost of V as it is: S takes the place of the two layers, and texture costs the same as there. The front ends
    /// where V is halfway.
    ///
    /// S is that of a Gaussian, as in the costs of outlines: the solve's is less, since it knows the kernel better.
    /// Across the normal the blur is that of the side's V.
    fn cost_before(&self, is_front: impl Fn(f64) -> bool, v_at: impl Fn(usize, usize) -> f64) -> f64 {
        let least = self.least;
        let [front_texture, outside_texture, back_texture] = self.textures;
        let places = (0..LINES).flat_map(|line| (FIRST_COSTED..FIRST_COSTED + COSTED).map(move |k| (line, k)));
        places
            .map(|(line, k)| {
                let v = v_at(line, k);
                let front = is_front(v);
                // S by the photograph that is the sharper at this V.
                let by_front = if self.opposite { (v > 0.0) == self.front_is_positive } else { front };
                let (lines, against) = match (by_front, self.opposite) {
                    (true, _) => (&self.front, &self.in_other),
                    (false, true) => (&self.back[0], &self.in_sharper),
                    (false, false) => (&self.back[0], &self.in_other),
                };
                let s = mean_of(&Kernel::new(v.abs()), k, &lines[line], 0..ALONG) - against[line][k];
                let (texture, variance) = match (front, self.opposite) {
                    (true, _) => (self.of_front_texture(line, k, HALF..ALONG), front_texture),
                    (false, true) => (self.of_back_texture(line, k, HALF), back_texture),
                    (false, false) => (self.of_front_texture(line, k, 0..HALF), outside_texture),
                };
                0.5 * (factor(s, least, least) * factor(texture, least + variance, least)).ln()
            })
            .sum()
    }
}

/// Costs for the tests of the passes over edges.
#[cfg(test)]
pub(super) mod testing {
    use super::super::Field;
    use super::*;
    use crate::engine::stages::NO_VARIANT;

    /// The constants of a pair.
    pub(in super::super) fn constants([width, height]: [u32; 2]) -> Constants {
        Constants::of_pair(&Level::new(0, width, height, 36.0), 0)
    }

    /// The layers of the costs of a pair whose photographs lie on each other, and of the edges.
    pub(in super::super) fn of_pair(c: &Constants, photographs: [&Field; 2], v: &Field, edges: Field) -> [Field; 3] {
        let mut layers = [Field::default(), Field::default(), edges];
        cpu_reference(c, NO_VARIANT, &DoubleState::default(), photographs, v, &mut layers);
        layers
    }
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::edge::BEFORE;

    use super::super::harness::random_field;

    use super::testing::{constants, of_pair};
    use super::*;

    use crate::engine::stages::{edge_cells, edge_straighten, separable};

    /// A textured front over a textured back under Gaussian blur: the costs are least at the true outline, in the true
    /// order, and less than that of V as it is.
    #[test]
    fn the_true_outline_and_order_cost_least() {
        let size @ [width, height] = [96usize, 256];
        let cases = [[5.0, -4.0], [9.0, -8.0], [2.0, -3.0], [-1.0, -6.0], [6.0, 1.0]];
        for (seed, levels) in (1..).zip(cases) {
            let [front, back] =
                [seed, seed + 10].map(|seed| separable::smoothed(&random_field(width, height, seed), 1.0));
            let matte = Field::from_fn(width, height, |x, _| f64::from(u8::from(x >= 48)));
            // V = σ2² - σ1² of each layer, the sharper one in focus.
            let photograph = |image: usize| {
                let sigma = levels.map(|v: f64| if (v > 0.0) == (image == 0) { 0.6 } else { (0.36 + v.abs()).sqrt() });
                let lit =
                    Field { data: front.data.iter().zip(&matte.data).map(|(i, m)| i * m).collect(), ..front.clone() };
                let [lit, cover] = [lit, matte.clone()].map(|field| separable::smoothed(&field, sigma[0]));
                let behind = separable::smoothed(&back, sigma[1]);
                Field::from_fn(width, height, |x, y| lit.get(x, y) + (1.0 - cover.get(x, y)) * behind.get(x, y))
            };
            let photographs = [photograph(0), photograph(1)];
            // V passes from one side to the other 4 px too far out.
            let v = Field::from_fn(width, height, |x, _| {
                let share = 0.5 + 0.5 * ((x as f64 - 43.5) / 2.0).tanh();
                share * levels[0] + (1.0 - share) * levels[1]
            });
            let deviation = Field::from_fn(width, height, |_, _| 0.05);
            let image = [width as u32, height as u32];
            let edges = edge_cells::cpu_reference(&edge_cells::Constants::of_pair(0, image, 0, image), &v, &deviation);
            let edges = edge_straighten::cpu_reference(image, &edges);
            let [costs, reversed, edges] = of_pair(&constants(image), photographs.each_ref(), &v, edges);
            let mut sums = [[0.0; DISPLACEMENTS + 1]; 2];
            let mut place = 0.0;
            let cells: Vec<_> = edge::all_cells(image)
                .filter(|cell| cell[1] > 3 && cell[1] < 60)
                .filter(|&cell| Edge::of(&edges, cell).is_some())
                .collect();
            assert!(cells.len() >= 8, "{size:?}");
            for &cell in &cells {
                place += Edge::of(&edges, cell).unwrap().place[0] / cells.len() as f64;
                for (sums, layer) in sums.iter_mut().zip([&costs, &reversed]) {
                    let numbers = (0..).map(|n| edge::number(layer, cell, n));
                    sums.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number / cells.len() as f64);
                }
            }
            let before = sums.map(|sums| sums[BEFORE]);
            let least = |sums: &[f64]| sums[..DISPLACEMENTS].iter().copied().fold(f64::MAX, f64::min);
            let best = (0..DISPLACEMENTS).min_by(|&a, &b| sums[0][a].total_cmp(&sums[0][b])).unwrap();
            // The first sample inside is pixel 48.
            let found = place + best as f64 - BACKWARD as f64;
            println!("{levels:?}: {found:.1}, {:.0}, reversed {:.0}, {before:.0?}", least(&sums[0]), least(&sums[1]));
            assert!((found - 48.0).abs() <= 1.0, "{levels:?}: {found}");
            assert!(least(&sums[0]) < least(&sums[1]), "{levels:?}");
            assert!(least(&sums[0]) < before[0], "{levels:?}");
        }
    }
}
