//! The scenes of the laboratory: as exact as they were, and smoothness and σ that fit each of them.

use super::truth::{Errors, Known};
use super::weight::best_weight;
use crate::lab::evaluate::bench::Bench;
use crate::lab::evaluate::section::{Case, Section};
use crate::lab::scene::{Preset, Scene, Shape};

/// A scene without noise, and what it was when the bounds were set: corner in px, rms of V in px².
type Today = (Preset, f64, [f64; 2]);

/// σ of the half-Gaussian scenes; 0 where the scene has its own.
const TODAY: [Today; 10] = [
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

/// How much worse than that is still as good.
const AS_GOOD: f64 = 1.1;
/// Half of the last digit of docs/evaluation.md, px: corners are off by a few thousandths of a pixel.
const DIGIT: f64 = 0.0005;

/// Without noise.
pub(super) fn accuracy(bench: &mut Bench) -> Section {
    let all = if bench.quick { &TODAY[..1] } else { &TODAY[..] };
    let mut cases = Vec::new();
    for (preset, sigma, [corner, rms]) in all {
        let mut scene = preset.scene();
        let mut name = preset.name().to_string();
        if *sigma > 0.0 {
            scene.shape = Shape::Uniform { variance: sigma * sigma };
            name = format!("{name}, σ {sigma}");
        }
        bench.say(&format!("itself: accuracy, {name}"));
        cases.push(match Known::of(&scene).and_then(|known| known.errors(bench)) {
            Ok(e) => {
                let case = Case::new(name).at_most("corner, px", e.corner, AS_GOOD * corner + DIGIT);
                case.at_most("V rms, px²", e.rms, AS_GOOD * rms).told("V bias, px²", e.bias)
            }
            Err(e) => Case::failed(name, e),
        });
    }
    let what = "Scenes without noise: within a tenth of what they were when the bounds were set.".to_string();
    Section { name: "Accuracy", what, cases }
}

const SCENES: [Preset; 5] = [Preset::Plane, Preset::Relief, Preset::Steps, Preset::Cylinders, Preset::HalfGaussianDots];

const NOISES: [f64; 4] = [0.0, 0.003, 0.01, 0.03];

/// One scene under one noise, for both sections that follow.
pub(super) struct Solved {
    name: String,
    /// By default settings, and the best α and its error.
    result: Result<(Errors, [f64; 2]), String>,
}

/// Solves all scenes under all noises, by default settings and by every fixed α.
pub(super) fn solve(bench: &mut Bench) -> Vec<Solved> {
    let (scenes, noises) = if bench.quick { (&SCENES[..1], &NOISES[2..3]) } else { (&SCENES[..], &NOISES[..]) };
    let pairs = scenes.iter().flat_map(|preset| noises.iter().map(move |noise| (*preset, *noise)));
    let mut all = Vec::new();
    for (preset, noise) in pairs {
        let name = format!("{}, noise {noise}", preset.name());
        bench.say(&format!("itself: smoothness, {name}"));
        let known = Known::of(&Scene { noise, ..preset.scene() });
        let result = known.and_then(|known| {
            let by_itself = known.errors(bench)?;
            let rms = |settings: &_| known.errors_by(bench, settings).map_or(f64::INFINITY, |e| e.rms);
            Ok((by_itself, best_weight(&known.settings, noise, rms)))
        });
        all.push(Solved { name, result });
    }
    all
}

/// The default smoothness against the best that is the same for every pixel.
pub(super) fn smoothness(solved: &[Solved]) -> Vec<Case> {
    let case = |s: &Solved| match &s.result {
        Ok((by_itself, best)) => against(s.name.clone(), by_itself.rms, *best),
        Err(e) => Case::failed(s.name.clone(), e),
    };
    solved.iter().map(case).collect()
}

/// By default against the best α and its error.
pub(super) fn against(name: String, by_itself: f64, [alpha, least]: [f64; 2]) -> Case {
    let case = Case::new(name).told("by default", by_itself).told("best", least).told("best α", alpha);
    case.at_most(RATIO, by_itself / least, WORST)
}

/// The figure of [`against`] that is judged.
pub(super) const RATIO: &str = "times the best";
/// What it may be at worst, and in the middle.
pub(super) const WORST: f64 = 1.25;
pub(super) const USUAL: f64 = 1.15;

/// Whether σ is what V is off by.
pub(super) fn sigma(solved: &[Solved]) -> Vec<Case> {
    let case = |s: &Solved| match &s.result {
        Ok((by_itself, _)) => by_itself.sigma.case(s.name.clone()),
        Err(e) => Case::failed(s.name.clone(), e),
    };
    solved.iter().map(case).collect()
}
