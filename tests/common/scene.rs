//! Scenes with known V and T, rendered in closed form without any code of the solver.
//!
//! The radiance is a sum of cosines. A Gaussian blur of variance v scales each cosine by `exp(-v k²/2)`, so the blurred
//! radiance is exact at any point.

use std::f64::consts::{LN_2, LOG2_E, TAU};

use parfocal::{
    Frame,
    transform::{Homography, Parallax, Similarity, centre},
};

/// Pseudo-random numbers from a seed (splitmix64).
pub struct Random(pub u64);

impl Random {
    /// Returns a number in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a normal number of mean 0 and standard deviation 1 (Box-Muller transform).
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

struct Wave {
    k: [f64; 2],
    phase: f64,
    amplitude: f64,
}

/// Waves that are added side by side, so that the compiler vectorises the sum; `k` is by axis.
#[derive(Clone, Copy, Default)]
struct Four {
    k: [[f64; 4]; 2],
    phase: [f64; 4],
    amplitude: [f64; 4],
}

/// A random radiance: the sum of four Gaussian random fields of correlation lengths 0.7 to 10 px and equal strength.
pub struct Radiance(Vec<Four>);

/// `cos x`, to 2e-7. The functions of the C library took two thirds of the time of the tests that render pairs.
#[inline(always)]
fn cosine(x: f64) -> f64 {
    let turns = x * (1.0 / TAU);
    let angle = TAU * (turns - (turns + TO_INTEGER - TO_INTEGER));
    let z = angle * angle;
    // Taylor's series, up to x¹⁶: |angle| is at most π.
    let mut sum = 1.0;
    for divisor in [240.0, 182.0, 132.0, 90.0, 56.0, 30.0, 12.0, 2.0] {
        sum = 1.0 - sum * z * (1.0 / divisor);
    }
    sum
}

/// `exp(x)` for x from -700 to 0, to a relative error of 2e-7.
#[inline(always)]
fn exponential(x: f64) -> f64 {
    let shifted = x * LOG2_E + TO_INTEGER;
    let rest = x - (shifted - TO_INTEGER) * LN_2;
    let power = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1f64.to_bits()));
    // Taylor's series, up to the sixth power: |rest| is at most ln 2 / 2.
    let mut sum = 1.0;
    for divisor in [6.0, 5.0, 4.0, 3.0, 2.0, 1.0] {
        sum = 1.0 + sum * rest * (1.0 / divisor);
    }
    power * sum
}

/// Added to a number, it leaves no bits for a fraction: the number is rounded.
const TO_INTEGER: f64 = 1.5 * (1u64 << 52) as f64;

impl Radiance {
    pub fn new(seed: u64) -> Self {
        let (mut random, waves) = (Random(seed), 120);
        let mut all = Vec::new();
        for sigma in [0.7, 1.5, 4.0, 10.0] {
            for _ in 0..waves {
                // Frequencies above 2.6 are too close to the Nyquist frequency π.
                let k =
                    std::iter::repeat_with(|| [random.normal(), random.normal()].map(|n| n / (2f64.sqrt() * sigma)))
                        .find(|k| k[0].hypot(k[1]) < 2.6)
                        .unwrap();
                let amplitude = 0.06 * (2.0 / f64::from(waves)).sqrt();
                all.push(Wave { k, phase: TAU * random.uniform(), amplitude });
            }
        }
        Self::of(&all)
    }

    /// Stripes of several periods, whose direction is `degrees` from that of the rows.
    pub fn stripes(seed: u64, degrees: f64) -> Self {
        let (mut random, across) = (Random(seed), (degrees + 90.0).to_radians());
        let wave = |_| {
            let k = 0.2 + 1.8 * random.uniform();
            Wave { k: [k * across.cos(), k * across.sin()], phase: TAU * random.uniform(), amplitude: 0.06 }
        };
        Self::of(&(0..12).map(wave).collect::<Vec<_>>())
    }

    /// Waves along x and along y of each frequency, rad per px, and amplitude.
    pub fn gratings(waves: &[[f64; 2]]) -> Self {
        let both = |&[k, amplitude]: &[f64; 2]| [[k, 0.0], [0.0, k]].map(|k| Wave { k, phase: 0.4, amplitude });
        Self::of(&waves.iter().flat_map(both).collect::<Vec<_>>())
    }

    fn of(waves: &[Wave]) -> Self {
        let four = |waves: &[Wave]| {
            let mut four = Four::default();
            for (n, wave) in waves.iter().enumerate() {
                (four.k[0][n], four.k[1][n]) = (wave.k[0], wave.k[1]);
                (four.phase[n], four.amplitude[n]) = (wave.phase, wave.amplitude);
            }
            four
        };
        Self(waves.chunks(4).map(four).collect())
    }

    /// Returns the radiance as a camera sees it that moves along a straight path, px, during the exposure.
    fn shaken(&self, path: [f64; 2]) -> Self {
        let shaken = |four: &Four| {
            let mut four = *four;
            for n in 0..4 {
                let half = 0.5 * (four.k[0][n] * path[0] + four.k[1][n] * path[1]);
                four.amplitude[n] *= if half == 0.0 { 1.0 } else { half.sin() / half };
            }
            four
        };
        Self(self.0.iter().map(shaken).collect())
    }

    /// Returns the radiance at a point, blurred by a Gaussian of variance `v` per axis, px².
    pub fn blurred(&self, [x, y]: [f64; 2], v: f64) -> f64 {
        let mut sum = [0.0; 4];
        for Four { k, phase, amplitude } in &self.0 {
            for n in 0..4 {
                let k2 = k[0][n] * k[0][n] + k[1][n] * k[1][n];
                let wave = cosine(k[0][n] * x + k[1][n] * y + phase[n]) * exponential(-v * k2 / 2.0);
                sum[n] += amplitude[n] * wave;
            }
        }
        0.5 + sum.iter().sum::<f64>()
    }
}

#[test]
fn fast_functions_are_those_of_the_library() {
    for x in (-4000..4000).map(|n| 0.0317 * f64::from(n)) {
        assert!((cosine(x) - x.cos()).abs() < 2e-7 && (exponential(-x.abs()) / (-x.abs()).exp() - 1.0).abs() < 2e-7);
    }
}

/// Renders a pair with `I2(T x) = I1(x)` up to blur and Gaussian noise. `blur` returns the variances of I1 and I2 at x.
pub fn pair(
    size: [u32; 2],
    transform: impl Into<Homography>,
    blur: impl Fn([f64; 2]) -> [f64; 2],
    noise: f64,
    seed: u64,
) -> [Frame; 2] {
    pair_of(&Radiance::new(seed), size, transform, blur, noise, seed)
}

/// How a pair was taken: the noise of each photograph, the path of the camera during each exposure, px, and the parallax
/// of its movement between them.
#[derive(Clone, Copy, Default)]
pub struct Exposures {
    pub noise: [f64; 2],
    pub paths: [[f64; 2]; 2],
    pub parallax: Parallax,
}

/// The point of I1 that the parallax displaces to a place, by iteration: V changes little over the displacement.
fn displaced_from(
    place: [f64; 2],
    c: [f64; 2],
    Parallax { across, along }: Parallax,
    v: impl Fn([f64; 2]) -> f64,
) -> [f64; 2] {
    (0..20).fold(place, |x, _| [0, 1].map(|n| place[n] - (across[n] + along * (x[n] - c[n])) * v(x)))
}

/// As [`pair`], taken so.
pub fn pair_by(
    exposures: Exposures,
    size: [u32; 2],
    transform: impl Into<Homography>,
    blur: impl Fn([f64; 2]) -> [f64; 2],
    seed: u64,
) -> [Frame; 2] {
    rendered(&Radiance::new(seed), exposures, size, transform, blur, seed)
}

/// As [`pair`], of this radiance; `seed` is that of the noise.
pub fn pair_of(
    radiance: &Radiance,
    size: [u32; 2],
    transform: impl Into<Homography>,
    blur: impl Fn([f64; 2]) -> [f64; 2],
    noise: f64,
    seed: u64,
) -> [Frame; 2] {
    let exposures = Exposures { noise: [noise; 2], ..Exposures::default() };
    rendered(radiance, exposures, size, transform, blur, seed)
}

fn rendered(
    radiance: &Radiance,
    Exposures { noise, paths, parallax }: Exposures,
    [width, height]: [u32; 2],
    transform: impl Into<Homography>,
    blur: impl Fn([f64; 2]) -> [f64; 2],
    seed: u64,
) -> [Frame; 2] {
    let (back, c) = (transform.into().inverse(), centre(width, height));
    let mut random = Random(seed + 1000);
    [0, 1].map(|image| {
        let radiance = radiance.shaken(paths[image]);
        let values = (0..height).flat_map(|y| (0..width).map(move |x| [f64::from(x), f64::from(y)]));
        let values = values.map(|place| {
            let v = |x| blur(x)[1] - blur(x)[0];
            let x = if image == 0 { place } else { displaced_from(back.apply(place, c), c, parallax, v) };
            (radiance.blurred(x, blur(x)[image]) + noise[image] * random.normal()) as f32
        });
        Frame::gray(width, height, values.collect()).unwrap()
    })
}

/// Returns the blur of a slanted plane: V falls from +4 px² at the left border to -4 px² at the right border.
pub fn slanted(width: u32) -> impl Fn([f64; 2]) -> [f64; 2] {
    move |[x, _]| {
        let ramp = x / (f64::from(width) - 1.0);
        [0.3 + 4.0 * ramp, 0.3 + 4.0 * (1.0 - ramp)].map(|v| v.max(0.0))
    }
}

/// Returns the luminance of a frame in [0, 1] (Rec. 601).
pub fn luminance(frame: &Frame) -> Vec<f64> {
    use parfocal::frame::Samples;
    let values: Vec<f64> = match frame.samples() {
        Samples::U8(s) => s.iter().map(|&v| f64::from(v) / 255.0).collect(),
        Samples::U16(s) => s.iter().map(|&v| f64::from(v) / 65535.0).collect(),
        Samples::F32(s) => s.iter().map(|&v| f64::from(v)).collect(),
    };
    match frame.format().channels.count() {
        1 => values,
        _ => values.chunks_exact(3).map(|p| 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]).collect(),
    }
}

/// Resamples a frame to J with `J(T x) = frame(x)`, by a windowed sinc of radius 12 (flat to 0.8 of Nyquist).
pub fn displaced(frame: &Frame, transform: &Similarity) -> Frame {
    const RADIUS: isize = 12;
    let (width, height) = (frame.width(), frame.height());
    let (grey, back, c) = (luminance(frame), transform.inverse(), centre(width, height));
    let taps = |p: f64, size: u32| {
        let (first, last) = (p.floor() as isize - RADIUS + 1, size as isize - 1);
        let weights: Vec<(usize, f64)> = (first..first + 2 * RADIUS)
            .map(|i| {
                let d = std::f64::consts::PI * (p - i as f64);
                let sinc = if d.abs() < 1e-9 { 1.0 } else { d.sin() / d };
                let window = (d / (2.0 * RADIUS as f64)).cos().powi(2);
                let i = if i < 0 { -i } else { i };
                let i = if i > last { 2 * last - i } else { i };
                (i.clamp(0, last) as usize, sinc * window)
            })
            .collect();
        let sum: f64 = weights.iter().map(|w| w.1).sum();
        weights.into_iter().map(move |(i, w)| (i, w / sum)).collect::<Vec<_>>()
    };
    let mut values = Vec::with_capacity(grey.len());
    for y in 0..height {
        for x in 0..width {
            let [px, py] = back.apply([f64::from(x), f64::from(y)], c);
            let columns = taps(px, width);
            let row = |j: usize| columns.iter().map(|&(i, w)| w * grey[j * width as usize + i]).sum::<f64>();
            values.push(taps(py, height).iter().map(|&(j, w)| w * row(j)).sum::<f64>() as f32);
        }
    }
    Frame::gray(width, height, values).unwrap()
}

/// Returns `gain * frame + offset`.
pub fn exposed(frame: &Frame, gain: f64, offset: f64) -> Frame {
    let values = luminance(frame).into_iter().map(|v| (gain * v + offset) as f32).collect();
    Frame::gray(frame.width(), frame.height(), values).unwrap()
}
