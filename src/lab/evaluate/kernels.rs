//! What it costs to solve with another kernel than the scene's.

use serde::Serialize;

use super::bench::{Bench, settings};
use super::cases::model;
use super::errors::{TransformError, rms_error};
use crate::base::{Kernel, Method};
use crate::lab::scene::{self, Preset, Scene};

/// The unified method on one scene with one kernel.
#[derive(Serialize)]
pub(super) struct KernelResult {
    pub scene: &'static str,
    pub scene_kernel: String,
    pub model_kernel: String,
    pub error: Option<TransformError>,
    /// Rms of V less the true V, px².
    pub v_rms_to_truth: Option<f64>,
    /// Why there is no solution.
    pub failure: Option<String>,
}

/// Runs each scene with its own kernel and with another.
pub(super) fn run(bench: &mut Bench) -> Vec<KernelResult> {
    let mut results = Vec::new();
    for (preset, kernel, models) in [
        (Preset::Plane, scene::Kernel::Gaussian, [Kernel::Gaussian, Kernel::Pillbox]),
        (Preset::Plane, scene::Kernel::Pillbox, [Kernel::Pillbox, Kernel::Gaussian]),
        (Preset::HalfGaussianTexture, scene::Kernel::HalfGaussian, [Kernel::HalfGaussian, Kernel::Gaussian]),
    ] {
        let mut scene = Scene { kernel, ..preset.scene() };
        if bench.quick {
            (scene.width, scene.height) = (128, 128);
        }
        for model in models {
            bench.say(&format!("kernels: {}, solved with {}", scene.name, model.name()));
            results.push(one(bench, preset, &scene, &model));
        }
    }
    results
}

fn one(bench: &mut Bench, preset: Preset, scene: &Scene, kernel: &Kernel) -> KernelResult {
    let pair = scene.render().map_err(|e| e.to_string());
    let solved =
        pair.and_then(|pair| Ok((bench.solve([&pair.i1, &pair.i2], &settings(Method::Unified, kernel))?, pair)));
    let (error, v_rms_to_truth, failure) = match solved {
        Ok((solution, pair)) => (
            Some(TransformError::of(&solution.transform.at_centre(), &pair.transform, [scene.width, scene.height])),
            rms_error(&solution, &pair.relative_blur),
            None,
        ),
        Err(e) => (None, None, Some(e)),
    };
    let (scene_kernel, model_kernel) = (model(scene.kernel).name().to_string(), kernel.name().to_string());
    KernelResult { scene: preset.name(), scene_kernel, model_kernel, error, v_rms_to_truth, failure }
}
