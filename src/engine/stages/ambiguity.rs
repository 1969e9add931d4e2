//! Finds where another V explains the photographs better, and lowers the certainty of V there.
//!
//! The energy may have several minima, and σ_V by its curvature knows only the one that was found. Near V = 0 the
//! derivative of a residual by V is a Laplacian: where noise hides the texture, it is almost all noise, which counts as
//! certainty, and V may stay near 0 whatever the blur. So each block of 32 x 32 px is tried with other V, the same in
//! the whole block. The energy of a V is the mean of the squared residual, divided by what noise adds to it at that V
//! and by the mean around the pixel.
//!
//! Where the best other V has less than 0.9 of the energy of V, the curvature is lowered until σ_V is at least the
//! distance between the two. Where it has less than 1.05 of it, is beyond σ_V, and the curvature is less than three
//! times that of noise alone, the photographs do not determine V: the curvature becomes 0.
//!
//! A photograph that is solved in parts has other blocks at their borders.
//!
//! Section 7 of `docs/method.md`.

use super::blur::{Sample, Samples};
use super::law::Variances;
use super::pass::{Memory, Pass};
use super::segments::SEGMENT;
use super::{Number, Raster, pixels, uncertainty_terms};
use crate::base::workers;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::ambiguity::*;

/// Side of a block, px. Blocks of a workgroup along x and y: 2.
const BLOCK: usize = shaders::ambiguity::BLOCK as usize;
/// Every fourth pixel along x and y is a sample: the pass takes 3 to 6 % of a solve of three real pairs on the CPU
/// device. With every second one it would take four times as long.
const STEP: usize = shaders::ambiguity::STEP as usize;
/// The other V: the limit times (k/6)² on either side of 0, k = 1 to 6, spaced as widely as the blurs they stand for.
const OTHERS: usize = shaders::ambiguity::OTHERS as usize;
/// The least number of samples of a block for another V, of 64: a wide blur near the border of the image reaches beyond
/// it. With 48 half of the pixels of dark pictures of 256 px, near their borders, were tried with no wide blur.
const LEAST: f64 = shaders::ambiguity::LEAST;
/// Another V is better below this share of the energy. With 1 the σ of single blocks of generated scenes grew at noise
/// 0.03; with 0.9 none did.
const BETTER: f64 = shaders::ambiguity::BETTER;
/// The curvature may be that of noise below this multiple of that of noise alone. In windows of noise it varies by a
/// fifth, and up to 2.3 times of it come from the interpolation between the nodes of a stack. With 4 and 6 the dark
/// background of `tools/evaluate --only judgement` is as with 3, and 1 and 3 % more of a relief of noise 0.03 are not
/// measured.
const BY_NOISE: f64 = shaders::ambiguity::BY_NOISE;
/// Another V is no worse below this share of the energy, where the curvature is that of noise. With 1.2 up to 7 % of
/// the pixels of generated scenes were not measured at noise 0.03, with 1.05 up to 2 %.
const NO_WORSE: f64 = shaders::ambiguity::NO_WORSE;
/// Among other V whose energies differ by less than rounding, the first one counts.
const LESS: f64 = shaders::ambiguity::LESS;

/// Workgroups of an image.
pub(crate) fn tiles(size: [u32; 2]) -> [u32; 3] {
    let [columns, rows] = size.map(|side| side.div_ceil(2 * BLOCK as u32));
    [columns, rows, 1]
}

impl Pass for Bindings {
    /// Compulsory traffic: at each sample two nodes of either stack for each V read; on every fourth pixel V and three terms
    /// read and the curvature written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        let samples = pixels(c.width, c.height) / (STEP * STEP) as u64;
        16 * (OTHERS as u64 + 1) * samples + 20 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let state = memory.state(self.state);
        let layers = memory.layers(self.stacks);
        let samples = Samples::of(state, layers, [c.second_stack, c.nodes], (c.mean, 1.0, c.centre), variant);
        let terms = memory.layers(self.terms);
        let terms = [&terms[0], &terms[1], &terms[uncertainty_terms::RESIDUAL]];
        let mask = memory.mask_bytes().filter(|_| variant.has(Variant::MASKED));
        let curvature = cpu_reference(c, &samples, memory.layer(self.relative_blur, 0), terms, mask);
        memory.set_layer(self.terms, 0, curvature);
    }
}

/// The largest other V, px². Steps of a wider limit would pass over the small V at which noise hides texture.
pub(crate) const FARTHEST: f64 = 144.0;

/// The other V of index n, px².
fn other(n: usize, limit: f64) -> f64 {
    let share = (n / 2 + 1) as f64 / (OTHERS / 2) as f64;
    let size = limit * share * share;
    if n.is_multiple_of(2) { size } else { -size }
}

/// The curvature, lowered where another V explains the photographs better, from the means of the curvature, b² and the
/// squared residual. `mask` has a byte per pixel, 0 where there are no results.
fn cpu_reference<N: Number>(
    c: &Constants,
    samples: &Samples<N>,
    v: &Raster<N>,
    [curvature, b2, square]: [&Raster<N>; 3],
    mask: Option<&[u8]>,
) -> Raster<N> {
    let ([width, height], r, limit) =
        ([c.width, c.height].map(|side| side as usize), samples.displacement.r, f64::from(c.limit));
    let residual = |Sample { blurred: [b1, b2], .. }: &Sample| b1 - (r.gain * b2 + r.offset);
    let by_noise = |v: f64| c.noise.of_both(&Variances::new(v, samples.separation));
    let columns = width.div_ceil(BLOCK);
    let others: [f64; OTHERS] = std::array::from_fn(|n| other(n, limit));
    let others = others.map(|v| ([N::of(v); SEGMENT], by_noise(v)));
    // Of the blocks of a row, the other V of least energy relative to that of V, and both energies' ratio; `NO_WORSE`
    // if all are worse. Each V reads other layers of the stacks: one V after the other, so that rows are read in order.
    let best = |row: usize| {
        let mut sums = vec![[[0.0; 3]; OTHERS]; columns];
        // Of each sample of a row, the mean of the squared residual, and the energy of V relative to it.
        let mut own: Vec<Option<[f64; 2]>> = vec![None; width.div_ceil(STEP)];
        for y in (row * BLOCK..((row + 1) * BLOCK).min(height)).step_by(STEP) {
            own.fill(None);
            let of_pixels = |x: usize| &v.row(y)[x..];
            samples.visit_row(y, STEP, of_pixels, |sample| {
                let (x, near) = (sample.x, square.get(sample.x / 2, y / 2));
                if near > 0.0 && mask.is_none_or(|mask| mask[y * width + x] != 0) {
                    own[x / STEP] = Some([near, residual(&sample).powi(2) / by_noise(sample.v) / near]);
                }
            });
            for (n, (v, by_noise)) in others.iter().enumerate() {
                samples.visit_row(
                    y,
                    STEP,
                    |_| v,
                    |sample| {
                        let Some([near, own]) = own[sample.x / STEP] else { return };
                        let terms = [own, residual(&sample).powi(2) / by_noise / near, 1.0];
                        sums[sample.x / BLOCK][n].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                    },
                );
            }
        }
        sums.into_iter().map(|sums| {
            let mut best = [0.0, NO_WORSE];
            for (n, [own, energy, count]) in sums.into_iter().enumerate() {
                if count >= LEAST && energy < LESS * best[1] * own {
                    best = [other(n, limit), energy / own];
                }
            }
            best
        })
    };
    let found: Vec<_> = workers::map(height.div_ceil(BLOCK), best).into_iter().flatten().collect();
    Raster::from_fn(curvature.width, curvature.height, |x, y| {
        let [other, share] = found[2 * y / BLOCK * columns + 2 * x / BLOCK];
        let (v, curvature) = (v.get(2 * x, 2 * y), curvature.get(x, y));
        let of_noise = c.noise.curvature(&Variances::new(v, samples.separation), square.get(x, y), c.eta.into());
        // The curvature at which σ_V is the distance.
        let reaching = (b2.get(x, y) / f64::from(c.pixels)).sqrt() / (v - other).abs().max(1e-9);
        if share >= NO_WORSE || curvature <= reaching {
            curvature
        } else if curvature < BY_NOISE * of_noise {
            0.0
        } else if share < BETTER {
            reaching
        } else {
            curvature
        }
    })
}

#[cfg(test)]
mod tests {
    use super::super::Field;
    use super::super::blur::Stacks;
    use super::super::harness::build_stack;
    use super::super::noise::Noise;
    use super::super::stack::{self, Slopes};
    use super::super::state::{Displacement, Registration};
    use super::super::uncertainty::WINDOW_PIXELS;
    use super::*;
    use crate::base::{Kernel, Parallax, Photometric, Similarity};

    /// The constants of an image of 96 x 64 px.
    fn constants() -> Constants {
        let (limit, eta, pixels, noise) = (9.0, 0.01, WINDOW_PIXELS, Noise::new(0));
        let ([width, height], centre, mean) = ([96, 64], [47.5, 31.5], [0.0; 2]);
        Constants { width, height, nodes: 0, second_stack: 0, centre, mean, limit, eta, pixels, noise }
    }

    /// Waves in closed form, the second photograph blurred by 4 px².
    #[test]
    fn a_wrong_v_is_uncertain_by_its_distance_and_a_right_one_is_not() {
        let size = [96, 64];
        let [i1, i2] = [0.0, 4.0].map(|variance: f64| {
            let wave = |k: f64, x: f64| (-variance * k * k / 2.0).exp() * (k * x).cos();
            Field::from_fn(size[0], size[1], |x, y| 0.5 + 0.1 * (wave(0.7, x as f64) + wave(0.5, y as f64)))
        });
        let (nodes, slopes) = (stack::node_count(9.0), Slopes::of(&Kernel::Gaussian));
        let [first, second] = [&i1, &i2].map(|image| build_stack(image, &Kernel::Gaussian, nodes));
        let stacks = Stacks { first: &first, second: &second, slopes };
        let flat = |value: f64| Field::from_fn(48, 32, |_, _| value);
        let (curvature, b2, square) = (flat(30.0), flat(f64::from(WINDOW_PIXELS)), flat(1e-4));
        let r = Registration::new(Similarity::IDENTITY, &Photometric::IDENTITY);
        let c = constants();
        let displacement =
            Displacement { r: &r, parallax: Parallax::NONE, factor: 1.0, centre: c.centre.map(f64::from) };
        let samples = Samples { mean: c.mean.map(f64::from), displacement, warped: None, separation: 0.0, stacks };
        let found = |v: &Field, terms| cpu_reference(&c, &samples, v, terms, None).get(20, 20);
        for (v, certain) in [(4.0, 30.0), (0.0, 0.25), (-1.0, 0.2)] {
            let v = Field::from_fn(size[0], size[1], |_, _| v);
            let found = found(&v, [&curvature, &b2, &square]);
            assert!((found - certain).abs() < 1e-9, "{found} {certain}");
        }
        // The curvature of noise alone.
        let (v, weak) = (Field::zeros(size[0], size[1]), flat(1e-3));
        // σ of the weak curvature reaches farther than the other V.
        assert_eq!(found(&v, [&weak, &b2, &square]), 1e-3);
        assert_eq!(found(&v, [&weak, &flat(1e-6), &square]), 0.0);
    }
}
