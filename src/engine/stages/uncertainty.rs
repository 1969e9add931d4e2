//! Computes the results: V where it is valid and NaN elsewhere, its standard deviation, and the residual.
//!
//! The residual is the root of its mean square over a window. Section 7 of `docs/method.md`.
//!
//! Over a window of N pixels, with V as one unknown, the estimate that minimises the robust norm ψ has the variance
//! `Σb²/(ΣC)²` (Huber, Robust Statistics, 1981, section 6.3): b is the pull of each residual, by misfit and noise, and
//! C the curvature of ψ by V. Where V bends, smoothness and displacement change it in proportion. With means over the
//! window,
//!
//! ```text
//! σ_V = sqrt(mean b² / (N (mean C)²) + β mean (∇²V)²)
//! ```
//!
//! β was chosen on generated scenes: with 30, 65 to 84 % of the true errors are within σ, for planes, reliefs, steps
//! and cylinders at noise 0.003 to 0.03. With 20 up to 2.8 times as many errors exceed 5 σ on reliefs and steps; with
//! 45 one to five per cent more are within σ, which is too wide already on planes and cylinders. (mean b)² instead of
//! mean b² is no better. A slope is no error: with |∇V|² instead of (∇²V)², σ of a noiseless plane is five times its
//! error.
//!
//! A residual that noise does not explain is of another scene, of something that moved, or of a blur that the kernel
//! does not describe. It is alike over a feature of the texture, so that fewer samples of it average out: with S_V²
//! from b², `mean (S² - (3 noise)²) / S_V²` over their number is added to the square. Beyond ten times the noise, V is
//! not measured unless σ is at most 1 px²: it is the V of a pair of different things.
//!
//! Where V is at its limit, only a bound of it is known. σ there is that of a pixel that the photographs do not
//! determine, so that no count, mask or measurement takes the bound for a measured value.

use super::law::Variances;
use super::pass::{Memory, Pass};
use super::segments::{SEGMENT, segment};
use super::state::{DoubleState, margin};
use super::uncertainty_terms::{self, WINDOW, at_pixels};
use super::{Number, Raster, pixels, stack};
use crate::base::Settings;
use crate::engine::shaders;
use crate::engine::vulkan::Variant;

pub use super::interface::uncertainty::*;

/// β, px⁴.
pub const BENDING: f32 = 30.0;
/// Pixels over which a residual that is no noise is alike: those of a Gaussian of σ 1.3 px, about a feature of the
/// finest texture.
const FEATURE: f32 = 20.0;
/// Residuals beyond this many deviations of the noise are no noise.
const NOISE: f64 = shaders::uncertainty::NOISE;
/// The noise is at least η over this, as for the step of T.
const BROAD: f64 = shaders::uncertainty::BROAD;
/// Residuals beyond this many show something else. Beyond three, also depth edges and the blur of real lenses: 9 to
/// 45 % of the pixels of five real pairs.
pub(crate) const UNEXPLAINED: f64 = shaders::uncertainty::UNEXPLAINED;
/// Where they do, V is not measured if its standard deviation is more than this, px².
const CERTAIN: f64 = shaders::uncertainty::CERTAIN;
/// Pixels in a Gaussian window of σ px: 4π σ².
pub const WINDOW_PIXELS: f32 = (4.0 * std::f64::consts::PI * WINDOW * WINDOW) as f32;
/// Standard deviation where the photographs do not determine V, px²: more than any |V|.
pub const LARGEST: f32 = 1e3;

impl Constants {
    /// The constants of an image.
    pub(crate) fn new([width, height]: [u32; 2], centre: [f64; 2], nodes: usize, settings: &Settings) -> Self {
        let (centre, at_limit) = (centre.map(|c| c as f32), at_limit(settings.blur_limit()));
        let (eta, features) = (settings.data_eta as f32, WINDOW_PIXELS / FEATURE);
        Self {
            width,
            height,
            centre,
            pixels: WINDOW_PIXELS,
            bending: BENDING,
            largest: LARGEST,
            at_limit,
            widest: stack::node_sigma(nodes - 1).powi(2) as f32,
            eta,
            features,
        }
    }
}

/// |V| from which a pixel counts as at the limit, px². V reaches the limit by clamping: a thousandth below it leaves
/// room for rounding.
pub(crate) fn at_limit(max_relative_blur: f64) -> f32 {
    0.999 * max_relative_blur as f32
}

impl Pass for Bindings {
    /// Compulsory traffic: V and on every fourth pixel the terms read, three results written.
    fn bytes(c: &Constants, _variant: Variant) -> u64 {
        let [width, height] = uncertainty_terms::size([c.width, c.height]);
        16 * pixels(c.width, c.height) + 4 * uncertainty_terms::LAYERS as u64 * pixels(width, height)
    }

    fn run<N: Number>(&self, c: &Constants, variant: Variant, memory: &mut Memory<N>) {
        let mask = memory.mask_bytes().filter(|_| variant.has(Variant::MASKED));
        if let Some(terms) = memory.layers(self.terms).first_chunk() {
            let results = cpu_reference(c, memory.state(self.state), memory.layer(self.relative_blur, 0), terms, mask);
            results.into_iter().enumerate().for_each(|(n, field)| memory.set_layer(self.result, n, field));
        }
    }
}

/// V, its standard deviation and the residual in the intensities of the photographs, from the averaged terms. `mask` has
/// a byte per pixel, 0 where there are no results.
pub fn cpu_reference<N: Number>(
    c: &Constants,
    state: &DoubleState,
    v: &Raster<N>,
    terms: &[Raster<N>; uncertainty_terms::LAYERS],
    mask: Option<&[u8]>,
) -> [Raster<N>; 3] {
    let (size, displacement) = ([v.width, v.height], state.displacement(1.0, c.centre));
    let DoubleState { registration: r, spread, unit, .. } = state;
    let (spread, largest) = (spread.max(f64::from(c.eta) / BROAD), f64::from(c.largest));
    let [eta, features, bending, pixels, at_limit, widest] =
        [c.eta, c.features, c.bending, c.pixels, c.at_limit, c.widest].map(f64::from);
    let [noise, unexplained_from] = [NOISE, UNEXPLAINED].map(|times| (times * spread).powi(2));
    let mut results = Raster::fill_segments(
        [(); 3].map(|()| Raster::zeros(v.width, v.height)),
        #[inline(always)]
        |at @ [x, y]| {
            let (v, of_residual) = (segment(&v.row(y)[x..]), &terms[uncertainty_terms::RESIDUAL]);
            let [curvature, b2] = [at_pixels(&terms[0], at), at_pixels(&terms[1], at)];
            let [bend, residual] = [at_pixels(&terms[2], at), at_pixels(of_residual, at)];
            let mut numbers = [[N::default(); SEGMENT]; 3];
            for n in 0..SEGMENT {
                let (curvature, b2, residual, v): (_, _, _, f64) = (curvature[n], b2[n], residual[n], v[n].into());
                let blurs = Variances::new(v, state.separation).both();
                let place = [x as f64 + f64::from(n as i32), y as f64];
                let d = displacement.of(place, v);
                let is_inside = margin(place, d, size, blurs, r.scale()) >= 0.0;
                let data = b2 / (pixels * curvature * curvature);
                let unexplained = (residual - noise).max(0.0) * residual / (b2 * (residual + eta * eta));
                let deviation = (data + bending * bend[n] + unexplained / features).sqrt();
                let is_other = (residual > unexplained_from) & (deviation > CERTAIN);
                let is_known = (curvature > 0.0) & (v.abs() < at_limit) & (blurs[0].max(blurs[1]) < widest) & !is_other;
                let deviation = if is_known { deviation.min(largest) } else { largest };
                let of_pixel = [v, deviation, unit * residual.max(0.0).sqrt()];
                for k in 0..3 {
                    numbers[k][n] = N::of(if is_inside { of_pixel[k] } else { f64::NAN });
                }
            }
            numbers
        },
    );
    for (n, _) in mask.into_iter().flatten().enumerate().filter(|(_, counts)| **counts == 0) {
        results.iter_mut().for_each(|result| result.data[n] = N::of(f64::NAN));
    }
    results
}

#[cfg(test)]
mod tests {
    use super::super::Field;

    use super::*;

    #[test]
    fn the_deviation_of_equal_pixels_is_that_of_their_mean() {
        // N pixels with residuals of deviation s, weight w and slope g: C = w g², b² = w² g² s², σ_V = s/(g sqrt(N)).
        let (s, g, w) = (0.02, 0.01, 40.0);
        let flat = |value: f64| Field::from_fn(16, 16, |_, _| value);
        let terms = [flat(w * g * g), flat(w * w * g * g * s * s), flat(0.0), flat(0.0), flat(s * s)];
        let c =
            Constants::new([32, 32], [15.5; 2], 12, &Settings { max_relative_blur: Some(25.0), ..Settings::default() });
        let state = DoubleState { spread: s, unit: 2.0, ..DoubleState::default() };
        let [_, deviation, residual] = cpu_reference(&c, &state, &Field::zeros(32, 32), &terms, None);
        let actual = deviation.get(16, 16);
        assert!((residual.get(16, 16) / (2.0 * s) - 1.0).abs() < 1e-9, "in the intensities of the photographs");
        let expected = s / (g * f64::from(WINDOW_PIXELS).sqrt());
        assert!((actual / expected - 1.0).abs() < 1e-9, "{actual} {expected}");
        // V at its limit is a bound, whatever the residuals.
        let bound = Field::from_fn(32, 32, |_, _| -2.0);
        let c = Constants { at_limit: at_limit(2.0), ..c };
        let [v, deviation, _] = cpu_reference(&c, &state, &bound, &terms, None);
        assert_eq!((v.get(16, 16), deviation.get(16, 16)), (-2.0, f64::from(LARGEST)));
    }

    /// Residuals S of slope g and norm ψ that are beyond the noise: b² = g² S²/ψ².
    #[test]
    fn residuals_beyond_noise_are_averaged_over_features_only() {
        let (g, noise, c) = (0.05, 0.004, Constants::new([32, 32], [15.5; 2], 12, &Settings::default()));
        let state = DoubleState { spread: noise, ..DoubleState::default() };
        for s in [0.01, 0.02, 0.035] {
            let flat = |value: f64| Field::from_fn(16, 16, |_, _| value);
            let norm = f64::hypot(s, f64::from(c.eta));
            let terms = [flat(g * g / norm), flat((g * s / norm).powi(2)), flat(0.0), flat(0.0), flat(s * s)];
            let actual = cpu_reference(&c, &state, &Field::zeros(32, 32), &terms, None)[1].get(16, 16);
            let beyond: f64 = s * s - 9.0 * noise * noise;
            let by_chance = s * s / f64::from(WINDOW_PIXELS);
            let expected = (by_chance + beyond.max(0.0) * f64::from(FEATURE / WINDOW_PIXELS)).sqrt() / g;
            assert!((actual / expected - 1.0).abs() < 1e-6, "{s}: {actual} {expected}");
        }
        // Beyond ten times the noise, with a slope that leaves V uncertain.
        let (s, g) = (0.05, 0.005);
        let flat = |value: f64| Field::from_fn(16, 16, |_, _| value);
        let norm = f64::hypot(s, f64::from(c.eta));
        let terms = [flat(g * g / norm), flat((g * s / norm).powi(2)), flat(0.0), flat(0.0), flat(s * s)];
        let deviation = cpu_reference(&c, &state, &Field::zeros(32, 32), &terms, None)[1].get(16, 16);
        assert_eq!(deviation, f64::from(LARGEST));
    }
}
