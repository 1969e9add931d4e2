//! What each stage is told: its push constants.

use super::{Level, MAP_LAYERS, Plan};
use crate::base::RegistrationStep;
use crate::engine::arguments;
use crate::engine::stages::exposure::Adopt;
use crate::engine::stages::noise::Noise;
use crate::engine::stages::{
    appearance, apply_shading, blur_matched_pair, exposure, fuse, ingest, linearise, mask, prolong, relax, relax_level,
    residual, shape_windows, system, uncertainty, uncertainty_terms, unpack, update, update_transform, warp,
};

/// Outer iterations of a level after which its steps of V and T are damped: a level that settles by whole steps mostly has by
/// then, and others swing between two states.
const UNDAMPED: f32 = 20.0;
/// How much of a step is then taken; from twice as many iterations on, less with each, since a few swing on even so (dots under
/// a half-Gaussian, 32 px: not settled after 100 iterations at a half, after 67 so).
///
/// Half heat sink, finest level: swinging by 0.04 % of the energy after 300 whole steps, settled after 23; half pcb-macro,
/// coarsest: by 1 % after 300, settled after 29.
const DAMPED: f32 = 0.5;
/// Pixels that no corner may move any more in an iteration of the finest level, for it to settle: at 0.01 half-Gaussian pairs
/// stop 0.004 px off instead of 0.002.
const STILL: f32 = 0.001;
/// The same of the levels before, which only hand on a start: they did up to 20 iterations at 0.001, and no figure was better.
const STILL_ENOUGH: f32 = 0.01;
/// Share that the energy may change by in an iteration of the finest level, for it to settle: at 1e-4 V of a plane at noise 0.03
/// stops 0.06 px² too high, here within 0.03.
const FLAT: f32 = 1e-5;
/// The same of the levels before, and where steps are damped: what swings changes by less only by chance (the finest level of the
/// heat sink went on for 21 to 100 iterations, by what came before; its energy was 0.1 % less in the end).
const FLAT_ENOUGH: f32 = 1e-4;

impl Plan {
    /// What `unpack` is told of a photograph.
    pub(crate) fn unpack(&self, image: usize) -> unpack::Constants {
        unpack::Constants::new(self.size, self.packed[image])
    }

    /// What `ingest` is told of a photograph, with the weights of its channels.
    pub(crate) fn ingest(&self, image: usize, weights: [f32; 3]) -> ingest::Constants {
        let ([width, height], format) = (self.size, self.formats[image]);
        ingest::Constants { width, height, channels: format.channels.count(), bytes: format.depth.bytes(), weights }
    }

    /// What `mask` is told of a photograph.
    pub(crate) fn mask(&self, image: usize) -> mask::Constants {
        let ([width, height], format) = (self.size, self.formats[image]);
        mask::Constants {
            width,
            height,
            channels: format.channels.count(),
            bytes: format.depth.bytes(),
            second: image as u32,
            clipped: self.settings.clipped(format.depth),
        }
    }

    /// What `prolong` is told on a level.
    pub(crate) fn prolong(&self, level: &Level) -> prolong::Constants {
        let [width, height] = level.size;
        prolong::Constants { width, height, limit: level.limit as f32, gain: 4.0 }
    }

    /// What `warp` is told on a level.
    pub(crate) fn warp(&self, level: &Level, layer: u32) -> warp::Constants {
        let [width, height] = level.size;
        warp::Constants { width, height, layer, factor: level.factor as f32, centre: level.centre.map(|c| c as f32) }
    }

    /// What `relax` is told of one half-iteration.
    pub(crate) fn relax(&self, level: &Level, color: usize) -> relax::Constants {
        let ([width, height], over_relaxation) = (level.size, self.settings.over_relaxation as f32);
        relax::Constants { width, height, color: color as u32, rows: relax::ROWS, over_relaxation }
    }

    /// What `relax_level` is told.
    pub(crate) fn relax_level(&self, level: &Level) -> relax_level::Constants {
        let ([width, height], over_relaxation) = (level.size, self.settings.over_relaxation as f32);
        relax_level::Constants { width, height, sweeps: self.settings.relaxation_sweeps, over_relaxation }
    }

    /// What `update` is told in iteration k of a level.
    pub(crate) fn update(&self, level: &Level, k: u32) -> update::Constants {
        let ([width, height], largest_step) = (level.size, self.settings.largest_step as f32);
        update::Constants { width, height, largest_step, limit: level.limit as f32, share: share(k) }
    }

    /// What `fuse` is told for a channel.
    pub(crate) fn fuse(&self, channel: u32) -> fuse::Constants {
        let ([width, height], finest) = (self.size, &self.pyramid[0]);
        fuse::Constants {
            width,
            height,
            layer: MAP_LAYERS + channel,
            centre: finest.centre.map(|c| c as f32),
            epsilon: self.settings.heaviside_epsilon as f32,
        }
    }

    /// What `sides` is told on a level: without stacks while V is zero.
    pub(crate) fn sides(&self, level: &Level, stacked: bool) -> blur_matched_pair::Constants {
        blur_matched_pair::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: if stacked { level.nodes as u32 } else { 0 },
            second_stack: if stacked { self.first_layer(1) } else { 0 },
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            mean: self.settings.kernel.mean().map(|m| m as f32),
        }
    }

    /// What `shape_windows` is told on a level.
    pub(crate) fn shape_windows(&self, level: &Level) -> shape_windows::Constants {
        shape_windows::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            second_stack: self.first_layer(1),
            grid: shape_windows::grid(level.size),
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            noise: Noise::new(level.index),
        }
    }

    /// What `exposure` is told on a level.
    pub(crate) fn exposure(&self, level: &Level, adopt: Adopt) -> exposure::Constants {
        exposure::Constants::new(level.size, level.factor, level.centre, adopt)
    }

    /// What `even` is told on a level.
    pub(crate) fn even(&self, level: &Level, layer: u32) -> apply_shading::Constants {
        let [width, height] = level.size;
        apply_shading::Constants { width, height, layer, centre: level.centre.map(|c| c as f32) }
    }

    fn descends(&self) -> bool {
        self.settings.registration_step == RegistrationStep::GradientDescent
    }

    /// What `linearise` is told in iteration k of a level.
    pub(crate) fn linearise(&self, level: &Level, k: u32) -> linearise::Constants {
        let s = &self.settings;
        linearise::Constants {
            width: level.size[0],
            height: level.size[1],
            nodes: level.nodes as u32,
            second_stack: self.first_layer(1),
            rows: linearise::rows(level.size),
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            length: level.length as f32,
            continuation: self.continued(level, k) as f32,
            eta: s.data_eta as f32,
            smoothness_eta: s.smoothness_eta as f32,
            epsilon: s.heaviside_epsilon as f32,
            // Beside so much smoothness no pixel's V answers.
            elimination: if self.descends() { 1e20 } else { linearise::ELIMINATION },
            mean: s.kernel.mean().map(|m| m as f32),
            noise: Noise::new(level.index),
        }
    }

    /// What `system` is told in iteration k of a level.
    pub(crate) fn system(&self, level: &Level, k: u32) -> system::Constants {
        let [width, height] = level.size;
        let (alpha, smoothness_eta) = (self.continued(level, k) as f32, self.settings.smoothness_eta as f32);
        system::Constants { width, height, alpha, rate: 1.0, smoothness_eta }
    }

    /// What `evidence` is told.
    pub(crate) fn evidence(&self) -> uncertainty_terms::Constants {
        let ([width, height], s) = (self.size, &self.settings);
        uncertainty_terms::Constants {
            width,
            height,
            eta: s.data_eta as f32,
            noise: uncertainty_terms::NOISE,
            least: uncertainty_terms::LEAST,
        }
    }

    /// What `residual` is told.
    pub(crate) fn residual(&self) -> residual::Constants {
        let ([width, height], finest) = (self.size, &self.pyramid[0]);
        residual::Constants {
            width,
            height,
            layer: uncertainty_terms::RESIDUAL as u32,
            nodes: finest.nodes as u32,
            second_stack: self.first_layer(1),
            centre: finest.centre.map(|c| c as f32),
            mean: self.settings.kernel.mean().map(|m| m as f32),
            epsilon: self.settings.heaviside_epsilon as f32,
        }
    }

    /// What `uncertainty` is told.
    pub(crate) fn uncertainty(&self) -> uncertainty::Constants {
        uncertainty::Constants::new(self.size, self.pyramid[0].centre)
    }

    /// What `appearance` is told on a level.
    pub(crate) fn appearance(&self, level: &Level) -> appearance::Constants {
        appearance::Constants {
            width: level.size[0],
            height: level.size[1],
            rows: linearise::rows(level.size),
            factor: level.factor as f32,
            centre: level.centre.map(|c| c as f32),
            length: level.length as f32,
            eta: self.settings.data_eta as f32,
        }
    }

    fn unknowns(&self) -> u32 {
        self.settings.motion.unknowns() as u32
    }

    /// What `step` is told after `appearance`, in iteration k of a level.
    pub(crate) fn appearance_step(&self, level: &Level, k: u32) -> update_transform::Constants {
        update_transform::Constants {
            unknowns: self.unknowns(),
            may_settle: u32::from(k > 0),
            warp_count: 0,
            ..self.step(level, k)
        }
    }

    /// What `step` is told in iteration k of a level.
    pub(crate) fn step(&self, level: &Level, k: u32) -> update_transform::Constants {
        let [columns, rows, _] = level.tiles();
        let words = arguments::words(level.index, self.warps_anew(level, k + 1));
        update_transform::Constants {
            rows: columns * rows,
            level: level.index as u32,
            energy_place: level.index as u32 * self.settings.outer_iterations + k,
            argument_place: words.place,
            argument_count: words.count,
            unknowns: if self.solves_transform() { self.unknowns() } else { 0 },
            descend: u32::from(self.descends()),
            may_settle: u32::from(self.may_settle(level, k)),
            still: if level.index == 0 { STILL } else { STILL_ENOUGH },
            warp_place: words.warp_place,
            warp_count: words.warp_count,
            factor: level.factor as f32,
            length: level.length as f32,
            half_size: level.centre.map(|c| c as f32),
            finds_alpha: u32::from(self.finds_alpha(level, k)),
            share: share(k),
            flatness: if level.index == 0 && (k as f32) < UNDAMPED { FLAT } else { FLAT_ENOUGH },
            least_spread: (self.settings.data_eta / linearise::BROAD) as f32,
        }
    }
}

/// How much of iteration k's steps is taken.
fn share(k: u32) -> f32 {
    let k = k as f32;
    if k < UNDAMPED { 1.0 } else { DAMPED * (2.0 * UNDAMPED / k).min(1.0) }
}
