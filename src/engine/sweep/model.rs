//! The scripts of a sweep as [`PyramidSolver`](super::pyramid::PyramidSolver) runs them, without a device, for
//! [`model`](crate::engine::model).

use super::pyramid::{RELAXATION_SWEEPS, first_level};
use super::shared::{ITERATIONS, SharedParameters};
use super::{MAX_RELATIVE_BLUR, outlines};
use crate::base::{Error, Format, Homography, Kernel, Settings, Shading};
use crate::engine::plan::{Level, Plan};
use crate::engine::script::Script;
use crate::engine::script::sweep::{self, RegistrationStep};
use crate::engine::stages::Field;
use crate::engine::tiles::Ranges;

/// The blur of a point in focus in the first frame in the last one, σ in px: that of simulated sweeps
/// ([`SweepScene`](crate::lab::scene::SweepScene)).
const END: f64 = 6.0;

/// The plan of a sweep.
pub(crate) fn plan([width, height]: [u32; 2], format: Format) -> Result<Plan, Error> {
    let (max_relative_blur, relaxation_sweeps) = (Some(MAX_RELATIVE_BLUR), RELAXATION_SWEEPS);
    let settings = Settings { kernel: Kernel::Gaussian, max_relative_blur, relaxation_sweeps, ..Settings::default() };
    Plan::new(width, height, [format; 2], &settings)
}

/// The scripts of a sweep, and those of its search for outlines. It has `frames` frames at even settings, and shows a
/// plane that is in focus in the first frame on the left and in the last one on the right. In each iteration the T of
/// every frame but the reference moves, as long as it is not held: an upper bound.
pub(crate) fn scripts(plan: &Plan, frames: usize) -> (Vec<Script>, Vec<Script>) {
    let last = (frames - 1) as f64;
    let shared = SharedParameters {
        settings: (0..frames).map(|n| n as f64).collect(),
        middle: 0.5 * last,
        reference: frames / 2,
        rate: (END / last).powi(2),
        transforms: vec![Homography::IDENTITY; frames],
        resampled: vec![None; frames],
        parallax: vec![[0.0; 2]; frames],
        parallax_deviation: vec![[0.0; 2]; frames],
        parallax_scale: 0.0,
        brightness: vec![(1.0, Shading::NONE); frames],
        pairs_per_pixel: 1.0,
        unlike: Vec::new(),
    };
    let align = |level: &Level, also_reference: bool| {
        let moved = (0..frames).filter(|&n| also_reference || n != shared.reference);
        sweep::align(plan, level, &moved.map(|n| (n as u32, shared.alignment(level, n))).collect::<Vec<_>>())
    };
    let first = first_level(plan);
    let mut scripts = vec![sweep::upload(plan, frames as u32)];
    for level in plan.pyramid[..=first].iter().rev() {
        if level.index < first {
            scripts.push(sweep::prolong(plan, level, shared.limit(level) as f32));
        }
        let [width, height] = level.size.map(|side| side as usize);
        let plane = |x: usize, _| last * (x as f64 / (width - 1) as f64 - 0.5);
        let ranges = Ranges::of(&Field::from_fn(width, height, plane));
        let (system, update) = shared.step(level, shared.rate_on(level));
        let hold = level.index == 0;
        let iterations = if hold { shared.finest_iterations() } else { ITERATIONS[usize::from(level.index < first)] };
        let registration = if hold { RegistrationStep::Held } else { RegistrationStep::Free };
        let (frames, _) = shared.half_pairs(level, 0, &ranges, registration);
        for n in 0..iterations {
            if n == 0 || !hold {
                scripts.push(align(level, n == 0));
            }
            scripts.push(sweep::half_pairs(plan, level, &frames, registration));
            scripts.push(sweep::step(plan, level, &system, &update));
        }
    }
    let mut search = vec![sweep::begin_outlines(plan)];
    for level in outlines::levels(plan) {
        search.push(sweep::outlines(plan, &outlines::on_level(&shared, plan.size, level)));
    }
    (scripts, search)
}
