//! Synthetic scenes: shading, noise, accuracy, smoothness, and the coverage of errors by σ.

use parfocal::{
    Frame, Settings,
    frame::Samples,
    internals::scene::{Preset, Scene, Shape},
};

use crate::errors::Errors;
use crate::pairs::KnownPair;
use crate::section::{Case, Runner, Section};

const CORNER: &str = "corner, px";
const RMS: &str = "V rms, px²";
const BIAS: &str = "V bias, px²";

/// Shading q, from -1 to 1, over x and y from 0 to 1: I2 is brighter by a factor `1 + amount q(x, y)`.
type Shading = (&'static str, fn(f64, f64) -> f64);

const SHADINGS: [Shading; 5] = [
    ("radial", |x, y| 1.0 - 4.0 * ((x - 0.5).powi(2) + (y - 0.5).powi(2))),
    ("cos⁴", |x, y| 1.0 - 2.0 * cos4(x, y)),
    ("ramp", |x, _| 2.0 * x - 1.0),
    ("diagonal", |x, y| x + y - 1.0),
    // The distance of the farthest corner, (1, 0), is √1.13.
    ("off-centre", |x, y| 1.0 - 2.0 * ((x - 0.3).powi(2) + (y - 0.8).powi(2)) / 1.13),
];

/// 1 - cos⁴ of the angle to the axis, divided by its value in the corners, at 30°.
fn cos4(x: f64, y: f64) -> f64 {
    let corner = (30f64.to_radians().tan()).powi(2);
    let lost = |tan2: f64| 1.0 - (1.0 + tan2).powi(-2);
    lost(corner * ((x - 0.5).powi(2) + (y - 0.5).powi(2)) / 0.5) / lost(corner)
}

/// Amounts of shading, and the bounds: corner in px, rms of V in px².
const AMOUNTS: [(f64, f64, f64); 2] = [(0.06, 0.012, 0.08), (0.15, 0.02, 0.12)];

/// Noise of the shaded pairs, white = 1.
const SHADED_NOISE: f64 = 0.003;

/// Measures the slanted plane with a smoothly shaded I2.
pub(crate) fn shading(runner: &mut Runner) -> Section {
    let shadings = if runner.quick { &SHADINGS[2..3] } else { &SHADINGS };
    let mut cases = Vec::new();
    for (amount, corner, rms) in AMOUNTS {
        for (name, shading) in shadings {
            cases.push(runner.case("shading", format!("{:.0} %, {name}", 100.0 * amount), |runner, case| {
                let mut pair = KnownPair::render(&Scene { noise: SHADED_NOISE, ..Preset::Plane.scene() })?;
                pair.images[1] = shaded(&pair.images[1], |x, y| 1.0 + amount * shading(x, y))?;
                let e = Errors::solve(runner, &pair, &pair.default_settings())?;
                Ok(case.at_most(CORNER, e.corner, corner).at_most(RMS, e.rms, rms).value(BIAS, e.bias))
            }));
        }
    }
    let what = format!(
        "A slanted plane of 256 x 256 px, V ±4 px², noise {SHADED_NOISE}; I2 is brighter and darker by up to the \
         percentage."
    );
    Section::new("Shading", what, cases)
}

fn shaded(frame: &Frame, gain: impl Fn(f64, f64) -> f64) -> Result<Frame, String> {
    let Samples::F32(values) = frame.samples() else { return Err("a scene's pixels are floats".to_string()) };
    let (width, last) = (frame.width() as usize, [frame.width() - 1, frame.height() - 1].map(f64::from));
    let shaded = values.iter().enumerate().map(|(i, v)| {
        let (x, y) = ((i % width) as f64 / last[0], (i / width) as f64 / last[1]);
        (f64::from(*v) * gain(x, y)) as f32
    });
    Frame::gray(frame.width(), frame.height(), shaded.collect())
}

/// Noise, and the bounds: bias and rms of V in px², and the corner error at the time when the bounds were set, px.
const NOISES: [(f64, f64, f64, f64); 3] =
    [(0.003, 0.01, 0.06, 0.0045), (0.01, 0.02, 0.13, 0.016), (0.03, 0.05, 0.35, 0.0552)];

/// Seeds of texture and noise.
const SEEDS: [u64; 5] = [1, 2, 3, 4, 5];

/// Measures the slanted plane with noise.
pub(crate) fn noise(runner: &mut Runner) -> Section {
    let noises = if runner.quick { &NOISES[1..2] } else { &NOISES[..] };
    let case = |&(noise, bias, rms, corner): &(f64, f64, f64, f64)| {
        runner.case("noise", noise.to_string(), |runner, case| {
            let one = |seed| {
                let pair = KnownPair::render(&Scene { noise, seed, ..Preset::Plane.scene() })?;
                Errors::solve(runner, &pair, &pair.default_settings())
            };
            let all = SEEDS.into_iter().map(one).collect::<Result<Vec<_>, String>>()?;
            let e = Errors::median(&all).ok_or("no numbers")?;
            let case = case.within(BIAS, e.bias, [-bias, bias]);
            Ok(case.at_most(RMS, e.rms, rms).at_most(CORNER, e.corner, corner))
        })
    };
    let cases = noises.iter().map(case).collect();
    let what = format!(
        "The same plane, noise in both images: medians of {} seeds. Corners must be no worse than when the bounds were \
         set.",
        SEEDS.len()
    );
    Section::new("Noise", what, cases)
}

/// Scenes without noise: σ of the half-Gaussian (0 for the scene's own), the corner error in px and the rms of V in px²
/// at the time when the bounds were set.
const ACCURACY: [(Preset, f64, [f64; 2]); 10] = [
    (Preset::Plane, 0.0, [0.00265, 0.0107]),
    (Preset::Relief, 0.0, [0.00115, 0.0626]),
    (Preset::Steps, 0.0, [0.00200, 0.170]),
    (Preset::Cylinders, 0.0, [0.00327, 0.238]),
    (Preset::HalfGaussianTexture, 1.0, [0.00750, 0.0107]),
    (Preset::HalfGaussianTexture, 1.5, [0.00337, 0.00804]),
    (Preset::HalfGaussianTexture, 2.5, [0.00228, 0.0138]),
    (Preset::HalfGaussianDots, 1.0, [0.00707, 0.0348]),
    (Preset::HalfGaussianDots, 1.5, [0.00214, 0.0279]),
    (Preset::HalfGaussianDots, 2.5, [0.00134, 0.0182]),
];

/// The factor by which an error may exceed its value at that time.
const AS_GOOD: f64 = 1.1;
/// Half of the last digit in docs/evaluation.md, px. Corner errors are a few thousandths of a pixel.
const DIGIT: f64 = 0.0005;

/// Measures every scene without noise.
pub(crate) fn accuracy(runner: &mut Runner) -> Section {
    let scenes = if runner.quick { &ACCURACY[..1] } else { &ACCURACY[..] };
    let case = |&(preset, sigma, [corner, rms]): &(Preset, f64, [f64; 2])| {
        let mut scene = preset.scene();
        let mut name = preset.name().to_string();
        if sigma > 0.0 {
            scene.shape = Shape::Uniform { variance: sigma * sigma };
            name = format!("{name}, σ {sigma}");
        }
        runner.case("accuracy", name, |runner, case| {
            let pair = KnownPair::render(&scene)?;
            let e = Errors::solve(runner, &pair, &pair.default_settings())?;
            let case = case.at_most(CORNER, e.corner, AS_GOOD * corner + DIGIT);
            Ok(case.at_most(RMS, e.rms, AS_GOOD * rms).value(BIAS, e.bias))
        })
    };
    let what = "Scenes without noise: within a tenth of the errors when the bounds were set.";
    Section::new("Accuracy", what, scenes.iter().map(case).collect())
}

const SCENES: [Preset; 5] = [Preset::Plane, Preset::Relief, Preset::Steps, Preset::Cylinders, Preset::HalfGaussianDots];
const SCENE_NOISES: [f64; 4] = [0.0, 0.003, 0.01, 0.03];

/// Measures scenes with noise, with default settings and with the best fixed α: the cases of smoothness and of σ.
pub(crate) fn smoothness_and_sigma(runner: &mut Runner) -> [Vec<Case>; 2] {
    let (scenes, noises) =
        if runner.quick { (&SCENES[..1], &SCENE_NOISES[2..3]) } else { (&SCENES[..], &SCENE_NOISES[..]) };
    let pairs = scenes.iter().flat_map(|preset| noises.iter().map(move |noise| (*preset, *noise)));
    let (mut smoothness, mut sigma) = (Vec::new(), Vec::new());
    for (preset, noise) in pairs {
        let name = format!("{}, noise {noise}", preset.name());
        let mut coverage = None;
        smoothness.push(runner.case("smoothness", name.clone(), |runner, case| {
            let pair = KnownPair::render(&Scene { noise, ..preset.scene() })?;
            let settings = pair.default_settings();
            let by_default = Errors::solve(runner, &pair, &settings)?;
            coverage = Some(by_default.coverage);
            let rms = |settings: &_| Errors::solve(runner, &pair, settings).map_or(f64::INFINITY, |e| e.rms);
            Ok(against_best(case, by_default.rms, best_alpha(&settings, noise, rms)))
        }));
        let failed = || Case::failed(name.clone(), "not solved: see Smoothness");
        sigma.push(coverage.map_or_else(failed, |coverage| coverage.all(Case::new(name.clone()))));
    }
    [smoothness, sigma]
}

/// Adds the error with default settings relative to the least error with a fixed α.
pub(crate) fn against_best(case: Case, by_default: f64, [alpha, least]: [f64; 2]) -> Case {
    let case = case.value("by default", by_default).value("best", least).value("best α", alpha);
    case.at_most(RATIO, by_default / least, WORST)
}

/// The name of the value of [`against_best`] that has a bound.
pub(crate) const RATIO: &str = "times the best";
/// The bound on the ratio for each case, and the bound on their median.
const WORST: f64 = 1.25;
pub(crate) const USUAL: f64 = 1.15;

/// The tested values of α, two per decade.
const ALPHAS: [f64; 9] = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0];

/// The fixed α with the least error, and that error. Descends from a guess based on noise, then tests the vertex of a
/// parabola through the three best, in logarithms of α and error. The error has one minimum over α.
pub(crate) fn best_alpha(settings: &Settings, noise: f64, mut error: impl FnMut(&Settings) -> f64) -> [f64; 2] {
    let mut known = [f64::NAN; ALPHAS.len()];
    let mut at = |i: usize, error: &mut dyn FnMut(&Settings) -> f64| {
        if known[i].is_nan() {
            known[i] = error(&with_alpha(settings, ALPHAS[i]));
        }
        known[i]
    };
    // For the plane the best α is 0.0003 without noise, and 0.01, 0.03 and 0.1 at noise 0.003, 0.01 and 0.03.
    let mut best = ALPHAS.partition_point(|alpha| *alpha < 3.0 * noise).clamp(1, ALPHAS.len() - 2);
    loop {
        let [low, middle, high] = [best - 1, best, best + 1].map(|i| at(i, &mut error));
        let next = if low < middle { best - 1 } else { best + 1 };
        if low.min(high) >= middle || next == 0 || next == ALPHAS.len() - 1 {
            break;
        }
        best = next;
    }
    let three = [best - 1, best, best + 1].map(|i| [ALPHAS[i], known[i]]);
    let tried = vertex(three).map(|alpha| [alpha, error(&with_alpha(settings, alpha))]);
    three.into_iter().chain(tried).min_by(|a, b| a[1].total_cmp(&b[1])).unwrap_or([f64::NAN; 2])
}

/// The x of the vertex of the parabola through three points, in logarithms of both coordinates; `None` if it is outside
/// them.
fn vertex(points: [[f64; 2]; 3]) -> Option<f64> {
    let [[x0, y0], [x1, y1], [x2, y2]] = points.map(|point| point.map(f64::ln));
    let (left, right) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let curvature = (right - left) / (x2 - x0);
    let x = (x0 + x1) / 2.0 - left / (2.0 * curvature);
    (curvature > 0.0 && x > x0 && x < x2).then(|| x.exp())
}

/// The same settings with this smoothness α.
fn with_alpha(settings: &Settings, alpha: f64) -> Settings {
    Settings { regularization: Some(alpha), ..settings.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shading_runs_from_darkest_to_brightest() {
        for (name, shading) in SHADINGS {
            let places = (0..=100).flat_map(|y| (0..=100).map(move |x| (f64::from(x) / 100.0, f64::from(y) / 100.0)));
            let values: Vec<f64> = places.map(|(x, y)| shading(x, y)).collect();
            let (low, high) = values.iter().fold((1.0f64, -1.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
            assert!((low + 1.0).abs() < 1e-9 && (high - 1.0).abs() < 1e-3, "{name}: {low} to {high}");
        }
    }

    #[test]
    fn the_vertex_of_a_parabola_is_found_from_every_guess() {
        for least in [2e-4, 1.3e-3, 0.04] {
            for noise in [0.0, 0.003, 0.03] {
                let mut calls = 0;
                let error = |s: &Settings| {
                    calls += 1;
                    (0.1 * (s.regularization.unwrap() / least).ln().powi(2)).exp()
                };
                let [alpha, value] = best_alpha(&Settings::default(), noise, error);
                assert!((alpha / least - 1.0).abs() < 1e-6 && (value - 1.0).abs() < 1e-9, "{alpha}, not {least}");
                assert!(calls <= ALPHAS.len() + 1);
            }
        }
    }

    #[test]
    fn a_monotonic_error_is_least_at_the_end() {
        let [alpha, _] = best_alpha(&Settings::default(), 0.01, |s| 1.0 / s.regularization.unwrap());
        assert_eq!(alpha, 1.0);
    }
}
