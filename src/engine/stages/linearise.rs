//! Computes D and b of each pixel's equation for dV, and the registration integrals.
//!
//! [`system`](super::system) makes the linear system of D and b. Equations 22 to 32 and 23 of the paper, sections 3 to 5 of `docs/method.md`:
//!
//! ```text
//! S1 = G(V) * I1 - J,  S2 = G(-V) * J - I1,  w1 = H ψ'(S1²),  w2 = (1-H) ψ'(S2²)
//! Î1v less S1 n1'/2n1, Î2v less S2 n2'/2n2: without the part of noise (noise.rs)
//! D = w1 Î1v² + w2 Î2v²,  b = -(w1 S1 Î1v + w2 S2 Î2v),  a_n = α (φ + φ_n)/2
//! r = b + Σ a_n (V_n - V)
//! N = Σ w j jᵀ - q qᵀ/(D + λ Σa),  g = Σ w j S + q r/(D + λ Σa),  q = w1 Î1v j1 + w2 Î2v j2,  j = ∂S/∂ζ
//! ```
//!
//! The terms in q eliminate each pixel's dV from the registration step (Schur complement), so that T steps as if V had
//! already responded. A neighbourhood moves together and is held less by the smoothness than a single pixel: λ = 0.25
//! accounts for that. On the slanted plane with 15 iterations per level, V rms was 0.032 px² without elimination, 0.026
//! with λ = 1 and 0.007 with 0.1; but with 0.1, black and white dots under a half-Gaussian do not settle.

use super::blur::{NEAR, PairSample, Stacks, heaviside, sample_pair};
use super::mask::{self, Masks};
use super::noise::{self, Noise};
use super::pass::{Memory, Pass, bindings, push_constants};
use super::stack::Slopes;
use super::state::{Registration, inside};
use super::sums::{Layout, Sums};
use super::{Field, WORKGROUP, pixels};
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

/// The most lines of two pixels per invocation. Values that adjacent lines share are loaded once, and the sums of a
/// workgroup are reduced once for all lines.
const MOST_ROWS: u32 = 8;
/// Levels with fewer pixels use more workgroups, so that small levels do not leave most of a device idle.
const SPREAD: u64 = 1 << 15;

/// Lines per invocation on a level.
pub(crate) fn rows([width, height]: [u32; 2]) -> u32 {
    if pixels(width, height) < SPREAD { MOST_ROWS / 4 } else { MOST_ROWS }
}

/// Layers of the equations: D, b.
pub const LAYERS: u32 = 2;
/// In T's step, residuals within this many spreads (σ of noise) count by their squares: with Gaussian noise least
/// squares are best. V, which depends on few pixels at each place, keeps η.
pub const BROAD: f64 = shaders::linearise::BROAD;
/// The spread s is an M-estimate of scale of x = ΔS/√2 between adjacent pixels. Such differences show the noise, and
/// little of the model's errors; half of them may be outliers. The mean of x²/(x² + `BOUND`² s²) is a half, as for
/// Gaussian x of deviation s.
pub const BOUND: f64 = shaders::linearise::BOUND;
/// λ.
pub const ELIMINATION: f32 = 0.25;

push_constants! {
    /// Width of the level, pixels.
    width: u32,
    /// Height of the level, pixels.
    height: u32,
    /// Nodes of the stacks.
    nodes: u32,
    /// First layer of the stack of I2.
    second_stack: u32,
    /// Lines per invocation.
    rows: u32,
    /// Pixels of the full-size image per pixel of this level.
    factor: f32,
    /// The image centre in pixels of this level.
    centre: [f32; 2],
    /// L, the length that places are divided by: a quarter of the diagonal, pixels.
    length: f32,
    /// Factor by which α is larger than its final value.
    continuation: f32,
    /// η of the data term, intensities.
    eta: f32,
    /// η of the smoothness term, px² per pixel.
    smoothness_eta: f32,
    /// ε of the Heaviside, px².
    epsilon: f32,
    /// λ; [`ELIMINATION`].
    elimination: f32,
    /// Mean of the kernel at V = 1, px.
    mean: [f32; 2],
    /// Noise of either image.
    noise: Noise,
}

/// Workgroups over a level.
pub(crate) fn tiles([width, height]: [u32; 2]) -> [u32; 3] {
    [width.div_ceil(2 * WORKGROUP[0]), height.div_ceil(WORKGROUP[1] * rows([width, height])), 1]
}

/// The variant for a kernel, for a warped I2, for masked pixels, and for the sums of homographies.
pub(crate) fn variant(slopes: Slopes, warped: bool, masked: bool, projective: bool) -> Variant {
    [slopes == Slopes::Layers, warped, masked, projective]
}

bindings! {
    LINEARISE:
    /// I1.
    i1: Reads<I1>,
    /// V.
    v: Reads<RelativeBlur>,
    /// Stacks of I1 and I2.
    stacks: Reads<Stacks>,
    /// D, b.
    equations: Writes<Plane>,
    /// State.
    state: Reads<State>,
    /// A row of sums for each workgroup.
    partials: Writes<Partials>,
    /// Masks of I1 and I2.
    masks: Reads<Masks>,
}

impl Pass for Bindings {
    /// Compulsory traffic: I1, V, the two nodes of the stacks about V and the other image, read once per pixel; D, b
    /// and a row of sums per workgroup written.
    fn bytes(c: &Constants, variant: Variant) -> u64 {
        let slopes = if variant[0] { Slopes::Layers } else { Slopes::Laplacian };
        let layers = 3 * slopes.layers() as u64;
        (8 + 4 * layers + 8) * pixels(c.width, c.height) + row_bytes([c.width, c.height], Layout::of_variant(variant))
    }

    fn run(&self, c: &Constants, variant: Variant, memory: &mut Memory) {
        let state = memory.state(self.state);
        let stacks = Stacks::of(memory.layers(self.stacks), c.second_stack, c.nodes, variant[0]);
        let warped = variant[1].then_some(&state.warped);
        let masks = mask::of(memory, self.masks, variant);
        let [i1, v] = [memory.layer(self.i1, 0), memory.layer(self.v, 0)];
        let Linearised { equations, sums } =
            cpu_reference(c, (&state.registration, state.alpha, state.spread), warped, i1, v, &stacks, masks);
        equations.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.equations, n, field));
        memory.set_sums(self.partials, sums);
    }
}

/// Bytes of a level's partial sums.
pub(crate) fn row_bytes(size: [u32; 2], layout: Layout) -> u64 {
    let [columns, rows, _] = tiles(size);
    4 * layout.length as u64 * pixels(columns, rows)
}

/// The results of the pass.
pub struct Linearised {
    /// D, b.
    pub equations: [Field; LAYERS as usize],
    /// N, g, energy, valid pixels.
    pub sums: Sums,
}

/// A residual: S, its derivative by V, its weight, and its derivatives by T's displacement in I1's pixels.
struct Residual {
    s: f64,
    by_v: f64,
    weight: f64,
    by_place: [f64; 2],
}

/// One pass over a level, with T, α and the spread of the previous iteration. `warped` is T when I2 was warped onto
/// I1's pixels, if it was.
pub fn cpu_reference(
    c: &Constants,
    (r, alpha, spread): (&Registration, f64, f64),
    warped: Option<&Registration>,
    i1: &Field,
    v: &Field,
    stacks: &Stacks,
    masks: Option<&Masks>,
) -> Linearised {
    let (width, height) = (v.width, v.height);
    let mut equations: [Field; LAYERS as usize] = std::array::from_fn(|_| Field::zeros(width, height));
    let mut sums = Sums::default();
    for y in 0..height {
        let mut before = (0.0, 0.0_f64);
        for x in 0..width {
            let d = r.displacement(x, y, c.factor.into(), c.centre.map(f64::from));
            if !inside([x, y], d, [width, height], v.get(x, y), r.scale()) {
                before = (0.0, 0.0);
                continue;
            }
            let (smoothness, pull) = smoothness_term(c, alpha, v, [x, y]);
            let sample = sample_pair((c.mean, c.factor, c.centre), r, warped, [x, y], i1, v.get(x, y), stacks);
            let share = mask::counts(masks, [x, y], d);
            let (mut residuals, psi, signed) = data_term(c, r, v.get(x, y), sample, d);
            residuals.iter_mut().for_each(|t| t.weight *= share);
            let diagonal: f64 = residuals.iter().map(|t| t.weight * t.by_v * t.by_v).sum();
            let b = -residuals.iter().map(|t| t.weight * t.s * t.by_v).sum::<f64>();
            let over = 1.0 / (diagonal + f64::from(c.elimination) * smoothness).max(1e-12);
            let place = [x as f64 - f64::from(c.centre[0]), y as f64 - f64::from(c.centre[1])];
            accumulate(
                &residuals,
                (b + pull, over),
                broadened(c, spread, psi),
                place.map(|p| p / f64::from(c.length)),
                &mut sums,
            );
            let gradient = 1.0 / inverse_gradient(c, v, x as isize, y as isize);
            sums.energy += share * (psi + alpha * gradient);
            sums.valid += share;
            let steep = (gradient.powi(2) - f64::from(c.smoothness_eta).powi(2)).max(0.0).sqrt();
            sums.variance[0] += b * b;
            sums.variance[1] += diagonal;
            sums.roughness[0] += share * b.abs().sqrt();
            sums.roughness[1] += share * steep;
            if x % 2 == 1 {
                sums.spread += before.1.min(share) * spreads(c, spread, signed - before.0);
            }
            before = (signed, share);
            equations.iter_mut().zip([diagonal, b]).for_each(|(field, value)| field.data[y * width + x] = value);
        }
    }
    Linearised { equations, sums }
}

/// φ = 1/sqrt(|∇V|² + η²) of the previous iteration.
fn inverse_gradient(c: &Constants, v: &Field, x: isize, y: isize) -> f64 {
    let dx = (v.clamped(x + 1, y) - v.clamped(x - 1, y)) / 2.0;
    let dy = (v.clamped(x, y + 1) - v.clamped(x, y - 1)) / 2.0;
    1.0 / (dx * dx + dy * dy + f64::from(c.smoothness_eta).powi(2)).sqrt()
}

/// Σ a_n over the four neighbours, zero across the border, and Σ a_n (V_n - V).
fn smoothness_term(c: &Constants, alpha: f64, v: &Field, [x, y]: [usize; 2]) -> (f64, f64) {
    let (x, y) = (x as isize, y as isize);
    let phi = inverse_gradient(c, v, x, y);
    let neighbours = [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)];
    let weights = neighbours.map(|(nx, ny)| {
        let exists = nx >= 0 && ny >= 0 && nx < v.width as isize && ny < v.height as isize;
        if exists { 0.5 * f64::from(c.continuation) * alpha * (phi + inverse_gradient(c, v, nx, ny)) } else { 0.0 }
    });
    let pull = weights.iter().zip(neighbours).map(|(a, (nx, ny))| a * (v.clamped(nx, ny) - v.clamped(x, y))).sum();
    (weights.iter().sum(), pull)
}

/// S1 and S2 at a pixel, the energy of the data term, and the signed residual H S1 - (1 - H) S2.
fn data_term(
    c: &Constants,
    r: &Registration,
    v: f64,
    PairSample { i1, i2, blurred: [b1, b2] }: PairSample,
    d: [f64; 2],
) -> ([Residual; 2], f64, f64) {
    let (s1, s2) = (b1.value - (r.gain * i2.value + r.offset), r.gain * b2.value + r.offset - i1);
    let eta2 = f64::from(c.eta).powi(2);
    let (psi1, psi2) = ((s1 * s1 + eta2).sqrt(), (s2 * s2 + eta2).sqrt());
    let h = heaviside(v, c.epsilon.into());
    let [along1, along2] = noise_slopes(c, r, v, d);
    let jacobian = |sign: f64, dx: f64, dy: f64| [sign * r.gain * dx, sign * r.gain * dy];
    let residuals = [
        Residual { s: s1, by_v: b1.slope - along1 * s1, weight: h / psi1, by_place: jacobian(-1.0, i2.dx, i2.dy) },
        Residual {
            s: s2,
            by_v: r.gain * b2.slope - along2 * s2,
            weight: (1.0 - h) / psi2,
            by_place: jacobian(1.0, b2.dx, b2.dy),
        },
    ];
    (residuals, h * psi1 + (1.0 - h) * psi2, h * s1 - (1.0 - h) * s2)
}

/// Half the derivative by V of the logarithm of the noise of both images in S1² and S2².
fn noise_slopes(c: &Constants, r: &Registration, v: f64, d: [f64; 2]) -> [f64; 2] {
    let (between, square) = (noise::interpolated(d), r.gain * r.gain);
    let (n1, n2) = if v >= 0.0 {
        (c.noise.blurred(v, 1.0), c.noise.beyond(v, between, NEAR))
    } else {
        (c.noise.beyond(-v, 1.0, NEAR), c.noise.blurred(-v, between))
    };
    let sign = if v >= 0.0 { 0.5 } else { -0.5 };
    [n1.slope / (n1.value + square * between), square * n2.slope / (square * n2.value + 1.0)].map(|n| sign * n)
}

/// The factor on a pixel's weight in T's step that broadens η to [`BROAD`] spreads.
fn broadened(c: &Constants, spread: f64, psi: f64) -> f64 {
    psi / (psi * psi - f64::from(c.eta).powi(2) + (BROAD * least_spread(c, spread)).powi(2)).sqrt()
}

/// The spread of the previous iteration, at least that of η.
fn least_spread(c: &Constants, spread: f64) -> f64 {
    spread.max(f64::from(c.eta) / BROAD)
}

/// The contribution of two adjacent pixels to the spread: a bounded square, whose mean is a half where the spread is
/// right.
fn spreads(c: &Constants, spread: f64, difference: f64) -> f64 {
    let square = 0.5 * difference * difference;
    2.0 * square / (square + (BOUND * least_spread(c, spread)).powi(2))
}

/// Adds a pixel to N and g, with its dV eliminated. `place` is from the centre, divided by L.
fn accumulate(residuals: &[Residual; 2], (right_side, over): (f64, f64), ratio: f64, place: [f64; 2], sums: &mut Sums) {
    let sum = |term: &dyn Fn(&Residual) -> f64| residuals.iter().map(|t| t.weight * term(t)).sum::<f64>();
    let q = [0, 1].map(|i| sum(&|t| t.by_v * t.by_place[i]));
    let g = [0, 1].map(|i| sum(&|t| t.s * t.by_place[i]) + q[i] * right_side * over);
    let n = [[0, 0], [0, 1], [1, 1]].map(|[i, j]| sum(&|t| t.by_place[i] * t.by_place[j]) - q[i] * q[j] * over);
    sums.add(n.map(|n| ratio * n), g.map(|g| ratio * g), place);
}

#[cfg(test)]
mod tests {
    use super::super::harness::{Rig, random_field};
    use super::super::stack::{self, Slopes};
    use super::super::state::State;
    use super::super::sums::assert_close;
    use super::*;
    use crate::base::{Aperture, Homography, Kernel, Photometric, Similarity};
    use crate::engine::stages::harness::build_stack;
    use crate::engine::vulkan::Resource;

    fn constants(width: usize, height: usize, nodes: usize, kernel: &Kernel) -> Constants {
        Constants {
            width: width as u32,
            height: height as u32,
            nodes: nodes as u32,
            second_stack: (nodes * Slopes::of(kernel).layers()) as u32,
            rows: MOST_ROWS,
            factor: 2.0,
            centre: [(width as f32 - 1.0) / 2.0, (height as f32 - 0.5) / 2.0],
            length: 20.0,
            continuation: 2.0,
            eta: 0.01,
            smoothness_eta: 0.1,
            epsilon: 0.1,
            elimination: ELIMINATION,
            mean: kernel.mean().map(|m| m as f32),
            noise: Noise::new(1),
        }
    }

    /// Compares with the CPU reference. `moved` is how T has moved since I2 was warped, if it was.
    fn check(i1: &Field, i2: &Field, v: &Field, transform: Similarity, kernel: &Kernel, moved: Option<Similarity>) {
        let masks = [7, 8].map(|seed| mask::shares(v.width, v.height, seed));
        let (transform, moved) = (transform.into(), moved.map(Homography::from));
        for (rows, projective) in [(2, false), (MOST_ROWS, true)] {
            check_rows((rows, projective), [i1, i2, v], transform, kernel, moved, None);
            check_rows((rows, projective), [i1, i2, v], transform, kernel, moved, Some(&masks));
        }
    }

    fn check_rows(
        (rows, projective): (u32, bool),
        [i1, i2, v]: [&Field; 3],
        transform: Homography,
        kernel: &Kernel,
        moved: Option<Homography>,
        masks: Option<&Masks>,
    ) {
        let ((width, height), layout) = ((v.width, v.height), Layout::of(projective));
        let nodes = stack::node_count(6.0);
        let slopes = Slopes::of(kernel);
        let stacks = [i1, i2].map(|i| build_stack(i, kernel, nodes));
        let c = Constants { rows, ..constants(width, height, nodes, kernel) };
        let registration = Registration::new(transform, &Photometric { gain: 1.1, offset: -0.03 });
        let mut state = State { spread: 0.01, ..State::new(&registration) };
        let before = moved.map(|by| Registration::new(by.after(&transform), &registration.photometric()));
        if let Some(before) = &before {
            state.warped = before.into();
        }
        let warped = Registration::from(state.warped);
        let read = Stacks { first: &stacks[0], second: &stacks[1], slopes };
        let expected = cpu_reference(
            &c,
            (&state.registration(), state.alpha.into(), state.spread.into()),
            moved.map(|_| &warped),
            i1,
            v,
            &read,
            masks,
        );

        let rig = Rig::new();
        let inputs = [rig.field(i1), rig.field(v), rig.image(&stacks.concat())];
        let equations = rig.empty([c.width, c.height], LAYERS as usize);
        let state = rig.upload(bytemuck::bytes_of(&state));
        let none = [Field::zeros(width, height), Field::zeros(width, height)];
        let (masked, masks) = (masks.is_some(), rig.image(masks.unwrap_or(&none)));
        let groups = [c.width.div_ceil(2 * WORKGROUP[0]), c.height.div_ceil(WORKGROUP[1] * rows), 1];
        let partials = rig.upload(&vec![0; 4 * layout.length * (groups[0] * groups[1]) as usize]);
        let mut resources: Vec<_> = inputs.iter().chain([&equations]).map(Resource::Image).collect();
        resources.extend([Resource::Buffer(&state), Resource::Buffer(&partials), Resource::Image(&masks)]);
        rig.run_variant(&STAGE, variant(slopes, moved.is_some(), masked, projective), &resources, &c, groups);

        // Single precision, relative to the largest.
        let most = expected.equations.iter().flat_map(|f| &f.data).fold(1.0, |most: f64, v| most.max(v.abs()));
        rig.assert_close(&equations, &expected.equations, 1e-4 * most);
        let actual = Sums::from_partials(&rig.floats(&partials), layout);
        assert_close(&actual, &expected.sums, layout, 1e-4);
    }

    #[test]
    fn matches_the_cpu_reference() {
        for (width, height) in [(67usize, 43usize), (33, 32), (40, 17)] {
            let smooth = |seed| super::super::harness::smooth_field(width, height, seed);
            let mut v = smooth(3);
            v.data.iter_mut().for_each(|v| *v = 8.0 * (*v - 0.5));
            let aperture = Aperture::new("code", 3, 2, &[1.0, 0.0, 2.0, 0.0, 1.0, 1.0]).unwrap();
            for kernel in [Kernel::Gaussian, Kernel::HalfGaussian, Kernel::Measured(aperture)] {
                check(&smooth(1), &smooth(2), &v, Similarity::new(0.7, -1.1, 0.4, 1.02), &kernel, None);
                check(
                    &random_field(width, height, 5),
                    &random_field(width, height, 6),
                    &v,
                    Similarity::new(0.0, 0.0, 3.0, 0.97),
                    &kernel,
                    None,
                );
            }
            let moved = Some(Similarity::new(0.02, -0.03, 0.01, 1.001));
            check(&smooth(1), &smooth(2), &v, Similarity::new(0.7, -1.1, 0.4, 1.02), &Kernel::Gaussian, moved);
            let steep = Homography::from_matrix([[1.02, 0.01, 0.7], [-0.02, 0.99, -1.1], [1e-4, -2e-4, 1.0]]).unwrap();
            for (kernel, moved) in [(Kernel::HalfGaussian, None), (Kernel::Gaussian, moved.map(Homography::from))] {
                check_rows((2, true), [&smooth(1), &smooth(2), &v], steep, &kernel, moved, None);
            }
        }
    }

    #[test]
    fn flat_images_give_numbers_and_no_overlap_gives_no_weight() {
        let (width, height) = (35, 20);
        let flat = Field::from_fn(width, height, |_, _| 0.5);
        check(&flat, &flat, &Field::zeros(width, height), Similarity::IDENTITY, &Kernel::Gaussian, None);
        check(&flat, &flat, &Field::zeros(width, height), Similarity::IDENTITY, &Kernel::HalfGaussian, None);
        check(
            &flat,
            &random_field(width, height, 1),
            &random_field(width, height, 2),
            Similarity::new(1e4, 0.0, 0.0, 1.0),
            &Kernel::Gaussian,
            None,
        );
        let still = Some(Similarity::IDENTITY);
        check(&flat, &flat, &Field::zeros(width, height), Similarity::IDENTITY, &Kernel::Gaussian, still);
    }
}
