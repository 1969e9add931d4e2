//! c and u of a sweep by contrast, which hardly depends on the registration.
//!
//! Blur of variance v leaves `exp(-ω² v)` of the power of a texture at the frequency ω. So the logarithm of the power of
//! fine detail is a parabola of the focus setting, with its top at u:
//!
//! ```text
//! ln P_k = ln P - ω² c (p_k - u)²
//! ```
//!
//! Windows are wider than what the registration leaves. So this holds where frames do not lie on each other, and their
//! differences say nothing of blur.

use nalgebra::{Matrix3, Vector3};

use crate::base::statistics::median;
use crate::base::workers;
use crate::engine::stages::Field;
use crate::engine::stages::separable::smoothed;

/// σ of the Gaussians whose difference passes fine detail, px.
const BAND: [f64; 2] = [0.6, 1.2];
/// σ of the windows, px.
const WINDOW: f64 = 4.0;
/// What is added to the power of both photographs of a pair, in shares of the mean of I1: areas without texture have V of 0.
const LEAST_POWER: f64 = 0.03;
/// ω², px⁻². The joint solve then finds 0.8 to 1.5 times c on five real sweeps, 3 times where steps are of 5 px of blur.
const FREQUENCY: f64 = 0.7;

/// c and u by contrast.
pub(super) struct ByContrast {
    /// c, px² of the frames' level by squared settings; 0 if contrast has no peak.
    pub(super) rate: f64,
    /// u, between the first and the last setting.
    pub(super) focus: Field,
}

/// A parabola of the contrast in a window.
pub(super) struct Peak {
    pub(super) u: f64,
    /// ω² c.
    bend: f64,
    /// Power of the sharpest frame.
    power: f64,
}

/// The power of fine detail about every `every`-th pixel.
fn detail(frame: &Field, every: usize) -> Field {
    let [fine, coarse] = BAND.map(|sigma| smoothed(frame, sigma));
    let square = |x, y| (fine.get(x, y) - coarse.get(x, y)).powi(2);
    let windows = smoothed(&Field::from_fn(fine.width, fine.height, square), WINDOW);
    let at = |x, y| windows.get(every * x, every * y);
    Field::from_fn(fine.width.div_ceil(every), fine.height.div_ceil(every), at)
}

/// V of a pair at every `every`-th pixel, px² of its level, of photographs that lie roughly on each other.
pub(in crate::engine) fn relative_blur(pair: &[Field], every: usize) -> Field {
    let powers = workers::map(2, |n| detail(&pair[n], every));
    let least = LEAST_POWER * powers[0].data.iter().sum::<f64>() / powers[0].data.len() as f64;
    Field::from_fn(powers[0].width, powers[0].height, |x, y| {
        let [first, second] = [0, 1].map(|n| powers[n].get(x, y) + least);
        (first / second).ln() / FREQUENCY
    })
}

/// c, and u at every `every`-th pixel, of frames that lie roughly on each other.
pub(super) fn by_contrast(frames: &[Field], settings: &[f64], every: usize) -> ByContrast {
    let powers = workers::map(frames.len(), |n| detail(&frames[n], every));
    let peaks = workers::map(powers[0].data.len(), |i| {
        let powers: Vec<f64> = powers.iter().map(|power| power.data[i]).collect();
        peak(&powers, settings)
    });
    // Half of the windows: the others have little texture.
    let textured = median(peaks.iter().map(|peak| peak.power)).unwrap_or(0.0);
    let bends = peaks.iter().filter(|peak| peak.power >= textured).map(|peak| peak.bend);
    let rate = median(bends).map_or(0.0, |bend| bend.max(0.0) / FREQUENCY);
    let focus =
        Field { data: peaks.iter().map(|peak| peak.u).collect(), ..Field::zeros(powers[0].width, powers[0].height) };
    ByContrast { rate, focus }
}

/// The parabola through the logarithms of powers, which count by themselves: weak ones are mostly noise.
pub(super) fn peak(powers: &[f64], settings: &[f64]) -> Peak {
    let [first, last] = [settings[0], settings[settings.len() - 1]];
    let (middle, power) = (0.5 * (first + last), powers.iter().copied().fold(f64::MIN_POSITIVE, f64::max));
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (share, setting) in powers.iter().map(|p| (p / power).max(1e-9)).zip(settings) {
        let terms = Vector3::new(1.0, setting - middle, (setting - middle).powi(2));
        normal += share * terms * terms.transpose();
        right += share * share.ln() * terms;
    }
    let fitted = normal.cholesky().map_or_else(Vector3::zeros, |cholesky| cholesky.solve(&right));
    let (slope, bend) = (fitted[1], -fitted[2]);
    let u = if bend > 0.0 {
        middle + 0.5 * slope / bend
    } else if slope > 0.0 {
        last
    } else {
        first
    };
    Peak { u: u.clamp(first, last), bend, power }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_of_contrast_has_its_top_at_the_focus() {
        let settings = [0.0, 1.0, 2.0, 3.0, 5.0];
        let powers = settings.map(|p: f64| 3.0 * (-0.2 * (p - 1.3).powi(2)).exp());
        let found = peak(&powers, &settings);
        assert!((found.u - 1.3).abs() < 1e-9 && (found.bend - 0.2).abs() < 1e-9, "{} {}", found.u, found.bend);
        // Contrast that grows to the end has its focus there.
        assert_eq!(peak(&settings.map(|p: f64| (p * p).exp()), &settings).u, 5.0);
    }
}
