//! The contrast of both photographs in windows, compared whatever the noise of each. Section 5 of `docs/method.md`.

use super::stages::uncertainty::LARGEST;

/// The largest |V|, px², that counts as no difference of blur.
///
/// Brightness is matched to 0.3 to 0.6 % on generated pairs of one focus setting. V that stands for it is up to 0.04 px².
const NO_DIFFERENCE: f64 = 0.1;
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
    /// Of I1's side with itself.
    first: f64,
    /// Of I2's side with itself.
    second: f64,
    /// Of one side with the other.
    both: f64,
    /// The Laplacian of one side times that of the other.
    curvature: f64,
}

impl Contrast {
    /// Adds the gradients and the Laplacians of both sides at a pixel.
    pub(crate) fn add_pixel(&mut self, [first, second]: [[f64; 2]; 2], laplacians: [f64; 2]) {
        let product = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
        self.first += product(first, first);
        self.second += product(second, second);
        self.both += product(first, second);
        self.curvature += laplacians[0] * laplacians[1];
    }

    fn add(&mut self, other: &Self) {
        self.first += other.first;
        self.second += other.second;
        self.both += other.both;
        self.curvature += other.curvature;
    }

    /// The least and the largest logarithm of the factor from the contrast of I1's side to that of I2's. The least is
    /// true if all noise is in I1, the largest if all is in I2. `None` if the two share nothing.
    fn change(&self) -> Option<[f64; 2]> {
        let change = [(self.both / self.first).ln(), (self.second / self.both).ln()];
        change.iter().all(|v| v.is_finite()).then_some(change)
    }
}

/// The least and the largest V, px², by which two photographs may differ that differ alike everywhere, from their
/// contrasts as photographed. `None` if they share nothing.
fn uniform_difference(windows: &[Contrast]) -> Option<[f64; 2]> {
    let mut sum = Contrast::default();
    windows.iter().for_each(|window| sum.add(window));
    let [least, most] = sum.change()?;
    // A blur of variance V multiplies the contrast at the frequency k by exp(-V k²/2).
    let square = sum.curvature / sum.both;
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
    pub(crate) fn of(windows: &[Contrast], relative_blur: &[f32], uncertainty: &[f32]) -> Option<Self> {
        let range = uniform_difference(windows)?;
        if 0f64.clamp(range[0], range[1]).abs() > NO_DIFFERENCE {
            return None;
        }
        let pixels = relative_blur.iter().zip(uncertainty);
        let measured = pixels.filter(|(v, deviation)| v.is_finite() && **deviation < LARGEST);
        let measured = measured.map(|(v, deviation)| [*v, *deviation].map(f64::from));
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
            let gradients = [[noisy(sides[0], noise[0]), 0.0], [noisy(sides[1], noise[1]), 0.0]];
            sum.add_pixel(gradients, sides.map(|side| side * k * phase.cos()));
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
        let found = |windows: &[Contrast], v: &[f32]| OneFocus::of(windows, v, &vec![0.05; v.len()]);
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
}
