//! Gauss-Newton against the paper's gradient descent: what either reaches with how many iterations.

use serde::Serialize;

use super::bench::{Bench, settings};
use super::cases::model;
use super::errors::energy;
use crate::base::{Method, RegistrationStep, Settings};
use crate::lab::scene::{Preset, Scene};

/// Both schemes on one scene.
#[derive(Serialize)]
pub(super) struct Race {
    pub scene: &'static str,
    /// E a pixel that no V and T go below, `η + α η_tv`, since `ψ(a²) = √(a² + η²)`: what is compared is what lies
    /// above.
    pub energy_floor: f64,
    /// The least energy that any run reached.
    pub best_energy: Option<f64>,
    pub schemes: Vec<Scheme>,
}

/// One scheme, with more and more iterations.
#[derive(Serialize)]
pub(super) struct Scheme {
    pub step: RegistrationStep,
    pub runs: Vec<Run>,
    /// The least number of iterations a level whose energy above the floor is within 1 % of the best; `null` if none
    /// is.
    pub iterations_to_best: Option<u32>,
    /// The time of that run, ms.
    pub time_to_best_ms: Option<f64>,
}

/// One whole solve.
#[derive(Serialize)]
pub(super) struct Run {
    /// Outer iterations that each level was allowed.
    pub iterations: u32,
    /// Those that the finest level took.
    pub iterations_done: Option<usize>,
    pub energy: Option<f64>,
    pub corner_px: Option<f64>,
    pub time_ms: Option<f64>,
    /// Why there is no solution.
    pub failure: Option<String>,
}

impl Race {
    /// How much higher a run's energy above the floor is than the best, as a share of that.
    pub(super) fn above_best(&self, run: &Run) -> Option<f64> {
        above_best(run, self.best_energy, self.energy_floor)
    }
}

fn above_best(run: &Run, best: Option<f64>, floor: f64) -> Option<f64> {
    let best = best? - floor;
    Some((run.energy? - floor - best) / best)
}

impl Scheme {
    /// Its name in tables and plots.
    pub(super) fn name(&self) -> &'static str {
        match self.step {
            RegistrationStep::GaussNewton => "Gauss-Newton",
            RegistrationStep::GradientDescent => "gradient descent",
        }
    }
}

/// How little above the best energy is near enough, as a share.
const NEAR: f64 = 0.01;

/// Iterations at which the two are compared as they are.
pub(super) const EQUAL: u32 = 20;

/// Runs a symmetric scene and both asymmetric ones.
pub(super) fn run(bench: &mut Bench) -> Vec<Race> {
    [Preset::Plane, Preset::HalfGaussianTexture, Preset::HalfGaussianDots]
        .into_iter()
        .map(|preset| race(bench, preset))
        .collect()
}

fn race(bench: &mut Bench, preset: Preset) -> Race {
    let mut scene = preset.scene();
    if bench.quick {
        (scene.width, scene.height) = (128, 128);
    }
    let budgets: &[u32] = if bench.quick { &[5, EQUAL] } else { &[5, 10, EQUAL, 50, 100, 200] };
    let runs = [RegistrationStep::GaussNewton, RegistrationStep::GradientDescent].map(|step| {
        let mut runs = Vec::new();
        for &iterations in budgets {
            bench.say(&format!("descent: {}, {step:?}, {iterations} iterations", scene.name));
            runs.push(solve(bench, &scene, step, iterations));
        }
        (step, runs)
    });
    let energy_floor = floor(&Settings::default());
    let best_energy = runs.iter().flat_map(|(_, runs)| runs).filter_map(|run| run.energy).reduce(f64::min);
    let schemes = runs.map(|(step, runs)| {
        let near = |run: &&Run| above_best(run, best_energy, energy_floor).is_some_and(|share| share <= NEAR);
        let first = runs.iter().find(near);
        let (iterations_to_best, time_to_best_ms) = (first.map(|r| r.iterations), first.and_then(|r| r.time_ms));
        Scheme { step, iterations_to_best, time_to_best_ms, runs }
    });
    Race { scene: preset.name(), energy_floor, best_energy, schemes: schemes.into() }
}

/// The smoothness of both, so that their energies can be compared.
const ALPHA: f64 = 0.003;

fn floor(settings: &Settings) -> f64 {
    settings.data_eta + ALPHA * settings.smoothness_eta
}

fn solve(bench: &mut Bench, scene: &Scene, registration: RegistrationStep, iterations: u32) -> Run {
    let settings = Settings {
        registration_step: registration,
        outer_iterations: iterations,
        regularization: Some(ALPHA),
        ..settings(Method::Unified, &model(scene.kernel))
    };
    let pair = scene.render().map_err(|e| e.to_string());
    let solved = pair.and_then(|pair| Ok((bench.solve([&pair.i1, &pair.i2], &settings)?, pair)));
    match solved {
        Ok((solution, pair)) => Run {
            iterations,
            iterations_done: solution.levels.last().map(|level| level.energy.len()),
            energy: energy(&solution),
            corner_px: Some(solution.transform.corner_distance(pair.transform, scene.width, scene.height)),
            time_ms: Some(solution.timings.total_ms),
            failure: None,
        },
        Err(e) => {
            Run { iterations, iterations_done: None, energy: None, corner_px: None, time_ms: None, failure: Some(e) }
        }
    }
}
