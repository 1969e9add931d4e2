//! The contrast of both photographs in windows, compared whatever the noise of each. Section 5 of `docs/method.md`.

use super::stages::scale_deviation::without_scale;
use super::stages::uncertainty::LARGEST;

/// The largest |V|, px², that counts as no difference of blur.
///
/// Brightness is matched to 0.3 to 0.6 % on generated pairs of one focus setting. V that stands for it is up to 0.04
/// px².
const NO_DIFFERENCE: f64 = 0.1;
/// The least share by which the contrasts along and across a direction differ in photographs that moved while they were
/// taken, made equally blurred. It is at most 0.015 in generated and real pairs that fit, and 0.12 where a camera moved
/// by 9 px.
const LEAST_SHAKE: f64 = 0.03;
/// The least certainty, in standard errors.
const CERTAIN: f64 = 3.0;
/// The fewest windows that have a standard error.
const FEWEST: usize = 4;
/// The step between directions, degrees.
const STEP: usize = 15;
/// A pixel differs from the others if its V is off the mean by more than this, px², and three standard deviations.
const ALIKE: f64 = 0.2;
/// The largest share of the measured pixels that may differ from the others.
const MOST_DIFFERING: f64 = 0.001;

/// Sums over a window of products of the gradients of two images of one scene, both smoothed.
///
/// The noise of the two is independent. So the products of both contain the scene only, and the squares of each contain
/// its noise too.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Contrast {
    /// Of I1's side with itself: xx, xy, yy.
    first: [f64; 3],
    /// Of I2's side with itself.
    second: [f64; 3],
    /// Of one side with the other.
    both: [f64; 3],
    /// The Laplacian of one side times that of the other.
    curvature: f64,
}

impl Contrast {
    /// Adds the gradients of both sides at a pixel.
    pub(crate) fn add_gradients(&mut self, [first, second]: [[f64; 2]; 2]) {
        let add = |sum: &mut [f64; 3], a: [f64; 2], b: [f64; 2]| {
            sum[0] += a[0] * b[0];
            sum[1] += 0.5 * (a[0] * b[1] + a[1] * b[0]);
            sum[2] += a[1] * b[1];
        };
        add(&mut self.first, first, first);
        add(&mut self.second, second, second);
        add(&mut self.both, first, second);
    }

    /// Adds the Laplacians of both sides at a pixel.
    pub(crate) fn add_laplacians(&mut self, [first, second]: [f64; 2]) {
        self.curvature += first * second;
    }

    fn add(&mut self, other: &Self, factor: f64) {
        let sums = [&mut self.first, &mut self.second, &mut self.both];
        for (sum, other) in sums.into_iter().zip([other.first, other.second, other.both]) {
            sum.iter_mut().zip(other).for_each(|(sum, v)| *sum += factor * v);
        }
        self.curvature += factor * other.curvature;
    }

    fn sum(windows: &[Self]) -> Self {
        let mut sum = Self::default();
        windows.iter().for_each(|window| sum.add(window, 1.0));
        sum
    }

    /// The least and the largest logarithm of the factor from the contrast of I1's side to that of I2's, of the
    /// gradients weighted by `of`. The least is true if all noise is in I2, the largest if all is in I1. `None` if the
    /// two share nothing.
    fn change(&self, of: [f64; 3]) -> Option<[f64; 2]> {
        let sum = |sums: [f64; 3]| sums.iter().zip(of).map(|(sum, of)| sum * of).sum::<f64>();
        let [first, second, both] = [self.first, self.second, self.both].map(sum);
        let change = [(both / first).ln(), (second / both).ln()];
        change.iter().all(|v| v.is_finite()).then_some(change)
    }

    /// By how much more contrast I2's side has along a direction than across it, relative to I1's, at least: a
    /// logarithm.
    fn difference(&self, degrees: f64) -> Option<f64> {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let [least, _] = self.change([cos * cos, 2.0 * sin * cos, sin * sin])?;
        let [_, most] = self.change([sin * sin, -2.0 * sin * cos, cos * cos])?;
        Some(least - most)
    }
}

/// The gradients along both axes.
const ALL: [f64; 3] = [1.0, 0.0, 1.0];

/// The correlation of the gradients of both images over all windows, and the power of those of the softer one; `None`
/// without gradients.
pub(super) fn correlation(windows: &[Contrast]) -> Option<(f64, f64)> {
    let sum = Contrast::sum(windows);
    let [first, second, both] = [sum.first, sum.second, sum.both].map(|sums| sums[0] + sums[2]);
    Some((both / (first * second).sqrt(), first.min(second))).filter(|(correlation, _)| correlation.is_finite())
}

/// The least and the largest V, px², by which two photographs may differ that differ alike everywhere, from their
/// contrasts as photographed. `None` if they share nothing.
fn uniform_difference(windows: &[Contrast]) -> Option<[f64; 2]> {
    let sum = Contrast::sum(windows);
    let [least, most] = sum.change(ALL)?;
    // A blur of variance V multiplies the contrast at the frequency k by exp(-V k²/2).
    let square = sum.curvature / (sum.both[0] + sum.both[2]);
    (square > 0.0).then(|| [-2.0 * most / square, -2.0 * least / square])
}

/// Photographs that do not differ in blur.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OneFocus {
    /// The mean of V, px².
    mean: f64,
    /// The least and the largest V that the photographs allow, px².
    range: [f64; 2],
}

impl OneFocus {
    /// Whether V is the same near 0 at all measured pixels, or noise of one photograph stands for what it is off.
    ///
    /// The deviation of V's `scale` does not count, which is the same for all pixels.
    pub(crate) fn of(windows: &[Contrast], relative_blur: &[f32], uncertainty: &[f32], scale: f64) -> Option<Self> {
        let range = uniform_difference(windows)?;
        if 0f64.clamp(range[0], range[1]).abs() > NO_DIFFERENCE {
            return None;
        }
        let pixels = relative_blur.iter().zip(uncertainty);
        let measured = pixels.filter(|(v, deviation)| v.is_finite() && **deviation < LARGEST);
        let measured = measured.map(|(v, deviation)| [*v, without_scale(*deviation, scale as f32 * v)].map(f64::from));
        let (count, sum) = measured.clone().fold((0.0, 0.0), |(count, sum), [v, _]| (count + 1.0, sum + v));
        let found = Self { mean: sum / count, range };
        let differs = |[v, deviation]: &[f64; 2]| (v - found.mean).abs() > ALIKE + 3.0 * deviation;
        let differing = measured.filter(differs).count() as f64;
        // V that is not near 0 is either outside of what the photographs allow, or may be a difference that they show.
        let explained = found.mean.abs() <= NO_DIFFERENCE || found.is_noise();
        (explained && differing <= MOST_DIFFERING * count).then_some(found)
    }

    /// Whether V is what noise of one photograph made of no difference.
    pub(crate) fn is_noise(&self) -> bool {
        let off = self.mean - self.mean.clamp(self.range[0], self.range[1]);
        self.mean.abs() > NO_DIFFERENCE && off.abs() > NO_DIFFERENCE
    }

    pub(crate) fn warning(&self) -> String {
        let (mean, [least, most]) = (self.mean, self.range);
        let what = "the photographs show no difference of blur beyond noise";
        if self.is_noise() {
            format!(
                "{what}, and V of {mean:.2} px² is the noise of one of them, where they allow {least:.2} to {most:.2} px²: take both at one gain, and focus them apart"
            )
        } else {
            format!("{what}, with V {mean:.2} px² everywhere: focus them apart")
        }
    }
}

/// Photographs that differ in blur by direction after V is made equal, as if one moved while it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shaken {
    /// The direction along which I2 moved, or across which I1 did, 0 to 180: 0 is along rows.
    direction: f64,
    /// By how much the contrast along it and across it differs, at least.
    share: f64,
}

impl Shaken {
    /// From the windows of the photographs after the sharper is blurred by V.
    pub(crate) fn of(windows: &[Contrast]) -> Option<Self> {
        let sum = Contrast::sum(windows);
        let along = |degrees: usize| Some((degrees as f64, sum.difference(degrees as f64)?));
        let (across, share) = (0..180).step_by(STEP).filter_map(along).max_by(|a, b| a.1.total_cmp(&b.1))?;
        // The jackknife: how much the sums without one of the windows scatter.
        let without = |window: &Contrast| {
            let mut rest = sum;
            rest.add(window, -1.0);
            rest.difference(across)
        };
        let rest: Vec<f64> = windows.iter().map(without).collect::<Option<_>>()?;
        let count = rest.len() as f64;
        let mean = rest.iter().sum::<f64>() / count;
        let error = ((count - 1.0) / count * rest.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).sqrt();
        let is_certain = rest.len() >= FEWEST && share - CERTAIN * error > LEAST_SHAKE;
        is_certain.then(|| Self { direction: (across + 90.0).rem_euclid(180.0), share: share.exp_m1() })
    }

    pub(crate) fn warning(&self) -> String {
        let across = (self.direction + 90.0).rem_euclid(180.0);
        format!(
            "the blur of the photographs differs by direction, by {:.0} % of the contrast, and that of defocus does not: I2 moved along {:.0}° while it was taken, or I1 along {across:.0}° (0° is along rows, 90° along columns), so hold camera and scene still or expose shorter",
            100.0 * self.share,
            self.direction
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::Random;

    /// Waves of several frequencies, those of the second photograph less by a blur of `v`, with noise of each.
    fn window(v: f64, noise: [f64; 2], seed: u64) -> Contrast {
        let mut random = Random::new(seed, 1);
        let mut sum = Contrast::default();
        for n in 0..2000 {
            let k = 0.3 + 0.1 * f64::from(n % 4);
            let fall = (-0.5 * v * k * k).exp();
            let phase = random.uniform() * std::f64::consts::TAU;
            let sides = [1.0, fall].map(|fall| fall * k);
            let mut noisy = |side: f64, noise: f64| side * phase.cos() + noise * random.normal();
            sum.add_gradients([[noisy(sides[0], noise[0]), 0.0], [noisy(sides[1], noise[1]), 0.0]]);
            sum.add_laplacians(sides.map(|side| side * k * phase.cos()));
        }
        sum
    }

    #[test]
    fn the_difference_without_noise_is_v() {
        for v in [-0.5, 0.0, 0.3] {
            let [least, most] = uniform_difference(&[window(v, [0.0; 2], 1), window(v, [0.0; 2], 2)]).unwrap();
            assert!((least - v).abs() < 0.02 && (most - v).abs() < 0.02, "{v}: {least} to {most}");
        }
    }

    #[test]
    fn the_difference_is_between_the_bounds_whichever_photograph_is_noisy() {
        for (v, noise) in [(0.0, [0.1, 0.0]), (0.0, [0.0, 0.1]), (0.4, [0.1, 0.05]), (-0.4, [0.02, 0.1])] {
            for seed in 1..6 {
                let [least, most] = uniform_difference(&[window(v, noise, seed)]).unwrap();
                assert!(least - 0.1 < v && v < most + 0.1, "{v} {noise:?}: {least} to {most}");
                assert!(most - least > 0.05, "{least} to {most}");
            }
        }
        assert_eq!(uniform_difference(&[Contrast::default()]), None);
    }

    #[test]
    fn only_v_near_0_everywhere_is_no_difference() {
        let clean = [window(0.0, [0.0; 2], 1)];
        let found = |windows: &[Contrast], v: &[f32]| OneFocus::of(windows, v, &vec![0.05; v.len()], 0.0);
        let still = found(&clean, &[0.02; 5000]).unwrap();
        assert!(!still.is_noise() && still.warning().contains("with V 0.02 px² everywhere"), "{}", still.warning());
        // The photographs do not allow V of 0.4, or V is not the same everywhere.
        let off = found(&clean, &[0.4; 5000]).unwrap();
        assert!(off.is_noise() && off.warning().contains("V of 0.40 px² is the noise of one"), "{}", off.warning());
        let mut spot = [0.0; 5000];
        spot[..6].fill(1.0);
        assert_eq!(found(&clean, &spot), None);
        // V of 0.4 may be right if noise leaves 0 to 0.4.
        let noisy = [window(0.2, [0.12, 0.12], 3)];
        let [least, most] = uniform_difference(&noisy).unwrap();
        assert!(least < NO_DIFFERENCE && most > 0.35, "{least} to {most}");
        assert_eq!(found(&noisy, &[0.35; 5000]), None);
        assert_eq!(found(&[window(0.4, [0.0; 2], 1)], &[0.4; 5000]), None);
    }

    /// A window whose I2 lost `share` of its contrast along a direction, with noise of both.
    fn shaken(degrees: f64, share: f64, noise: f64, seed: u64) -> Contrast {
        let mut random = Random::new(seed, 2);
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let mut sum = Contrast::default();
        for _ in 0..512 {
            let [along, across] = [0, 1].map(|_| random.normal());
            let mut side = |lost: f64| {
                let along = (1.0 - lost) * along;
                [cos * along - sin * across, sin * along + cos * across].map(|v| v + noise * random.normal())
            };
            let sides = [side(0.0), side(share)];
            sum.add_gradients(sides);
        }
        sum
    }

    #[test]
    fn contrast_lost_along_a_direction_is_a_shake_along_it() {
        for (degrees, noise) in [(0.0, 0.0), (30.0, 0.1), (90.0, 0.1), (135.0, 0.2)] {
            let windows = |count: u64, share| (0..count).map(|n| shaken(degrees, share, noise, n)).collect::<Vec<_>>();
            let found = Shaken::of(&windows(16, 0.15)).unwrap();
            assert!(found.direction == degrees && (0.05..0.2).contains(&found.share), "{degrees}: {found:?}");
            assert!(found.warning().contains(&format!("I2 moved along {degrees:.0}°")), "{}", found.warning());
            assert_eq!((Shaken::of(&windows(16, 0.0)), Shaken::of(&windows(3, 0.15))), (None, None));
        }
        // One of 16 windows is not a shake.
        let mut windows: Vec<Contrast> = (0..16).map(|n| shaken(0.0, 0.0, 0.0, n)).collect();
        windows[0] = shaken(0.0, 0.9, 0.0, 20);
        assert_eq!(Shaken::of(&windows), None);
    }
}
