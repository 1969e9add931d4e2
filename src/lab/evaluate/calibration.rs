//! Whether the uncertainty that a solve states is what its V is off by, on scenes whose V is known.

use serde::Serialize;

use super::bench::{Bench, settings};
use super::cases::model;
use crate::base::Method;
use crate::engine::Solution;
use crate::lab::scene::{Preset, Scene};

/// Groups of pixels of like stated uncertainty, of equal size.
const GROUPS: usize = 10;

/// One scene.
#[derive(Serialize)]
pub(super) struct Calibration {
    pub scene: &'static str,
    /// Noise σ, white = 1.
    pub noise: f64,
    /// From the most certain tenth of the valid pixels to the least.
    pub deciles: Vec<Decile>,
    /// Why there is no solution.
    pub failure: Option<String>,
}

/// A tenth of the valid pixels.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Decile {
    /// Median confidence.
    pub confidence: f64,
    /// Median stated standard deviation, px².
    pub stated_px2: f64,
    /// Rms of V less the true V, px².
    pub rms_error_px2: f64,
}

/// Runs the symmetric scenes with and without noise.
pub(super) fn run(bench: &mut Bench) -> Vec<Calibration> {
    let presets: &[Preset] =
        if bench.quick { &[Preset::Plane] } else { &[Preset::Plane, Preset::Relief, Preset::Steps, Preset::Cylinders] };
    let cases = presets.iter().flat_map(|&preset| [0.0, 0.01].map(|noise| (preset, noise)));
    cases.map(|(preset, noise)| one(bench, preset, noise)).collect()
}

fn one(bench: &mut Bench, preset: Preset, noise: f64) -> Calibration {
    bench.say(&format!("calibration: {}, noise {noise}", preset.name()));
    let mut scene = Scene { noise, ..preset.scene() };
    if bench.quick {
        (scene.width, scene.height) = (128, 128);
    }
    let settings = settings(Method::Unified, &model(scene.kernel));
    let pair = scene.render().map_err(|e| e.to_string());
    let solved = pair.and_then(|pair| Ok((bench.solve([&pair.i1, &pair.i2], &settings)?, pair)));
    let (deciles, failure) = match solved {
        Ok((solution, pair)) => (deciles(&solution, &pair.relative_blur), None),
        Err(e) => (Vec::new(), Some(e)),
    };
    Calibration { scene: preset.name(), noise, deciles, failure }
}

fn deciles(solution: &Solution, truth: &[f32]) -> Vec<Decile> {
    let mut pixels: Vec<(f64, f64)> = solution
        .uncertainty
        .iter()
        .zip(solution.relative_blur.iter().zip(truth))
        .map(|(&stated, (v, true_v))| (f64::from(stated), f64::from(v - true_v)))
        .filter(|(stated, error)| !stated.is_nan() && !error.is_nan())
        .collect();
    pixels.sort_by(|a, b| a.0.total_cmp(&b.0));
    let group = |n: usize| &pixels[n * pixels.len() / GROUPS..(n + 1) * pixels.len() / GROUPS];
    let of = |group: &[(f64, f64)]| {
        let stated = group[group.len() / 2].0;
        Decile {
            confidence: f64::from(crate::engine::solution::confidence(stated as f32)),
            stated_px2: stated,
            rms_error_px2: (group.iter().map(|(_, e)| e * e).sum::<f64>() / group.len() as f64).sqrt(),
        }
    };
    (0..GROUPS).map(group).filter(|group| !group.is_empty()).map(of).collect()
}
