//! The passes of the outputs: what each binds, its push constants and what it is dispatched over.

use super::compose::{BOTH, Composer};
use super::passes::single;
use crate::engine::arguments::{Edges, Grid};
use crate::engine::plan::MAP_LAYERS;
use crate::engine::slot;
use crate::engine::stages::noise::Noise;
use crate::engine::stages::{
    NO_VARIANT, ambiguity, edge_fuse, fuse, linearise, residual, scale_deviation, stack, total_deviation, uncertainty,
    uncertainty_terms,
};

impl Composer<'_> {
    /// The terms of the uncertainty and the squared residual, averaged over a window around each pixel.
    pub(super) fn uncertainty_terms(&mut self) {
        let (plan, finest, s) = (self.plan, &self.plan.pyramid[0], &self.plan.settings);
        let ([width, height], size) = (plan.size, uncertainty_terms::size(plan.size));
        let bindings = uncertainty_terms::Bindings {
            v: slot::relative_blur(0).read(),
            equations: slot::NORMAL_EQUATIONS.read(),
            terms: slot::UNCERTAINTY_TERMS.write(),
        };
        let (eta, noise, least) = (s.data_eta as f32, uncertainty_terms::NOISE, uncertainty_terms::LEAST);
        let constants = uncertainty_terms::Constants { width, height, eta, noise, least };
        self.over(size, bindings, &constants, NO_VARIANT);
        let bindings = residual::Bindings {
            i1: slot::i1(0).read(),
            v: slot::relative_blur(0).read(),
            stacks: slot::STACKS.read(),
            terms: slot::UNCERTAINTY_TERMS.write(),
            state: slot::STATE.read(),
        };
        let constants = residual::Constants {
            width,
            height,
            layer: uncertainty_terms::RESIDUAL as u32 + 1,
            nodes: finest.nodes as u32,
            second_stack: plan.second_stack(finest),
            centre: single(finest.centre),
            mean: single(s.kernel.mean()),
            epsilon: s.heaviside_epsilon as f32,
        };
        let variant = linearise::variant(plan.slopes(), plan.warps(finest), false, false);
        let variant = stack::packed(variant, plan.packs(finest));
        self.over(size, bindings, &constants, variant);
        for n in 0..uncertainty_terms::LAYERS as u32 {
            self.smooth([n + 1, n].map(|n| (slot::UNCERTAINTY_TERMS.plane(), n)), size);
        }
        let bindings = ambiguity::Bindings {
            i1: slot::i1(0).read(),
            v: slot::relative_blur(0).read(),
            stacks: slot::STACKS.read(),
            terms: slot::UNCERTAINTY_TERMS.update(),
            state: slot::STATE.read(),
            mask: slot::MASK.read(),
        };
        let variant = linearise::variant(plan.slopes(), plan.warps(finest), self.masked, false);
        let variant = stack::packed(variant, plan.packs(finest));
        let constants = ambiguity::Constants {
            width,
            height,
            nodes: finest.nodes as u32,
            second_stack: plan.second_stack(finest),
            centre: single(finest.centre),
            mean: single(s.kernel.mean()),
            limit: finest.limit as f32,
            eta: s.data_eta as f32,
            pixels: uncertainty::WINDOW_PIXELS,
            noise: Noise::new(0),
        };
        self.dispatch(bindings, &constants, variant, Grid::Direct(ambiguity::tiles(plan.size)));
    }

    /// V where it is valid, its standard deviation and the residual, into the first layers of the results; and the
    /// correlation of neighbouring residuals and the deviation of V's scale, into the state.
    pub(super) fn uncertainty(&mut self) {
        let bindings = uncertainty::Bindings {
            v: slot::relative_blur(0).read(),
            terms: slot::UNCERTAINTY_TERMS.read(),
            results: slot::RESULTS.write(),
            state: slot::STATE.read(),
            mask: slot::MASK.read(),
        };
        let (plan, variant) = (self.plan, if self.masked { uncertainty::MASKED } else { NO_VARIANT });
        let constants = uncertainty::Constants::new(plan.size, plan.pyramid[0].centre, &plan.settings);
        self.over(plan.size, bindings, &constants, variant);
        let (v, terms) = (slot::relative_blur(0).read(), slot::UNCERTAINTY_TERMS.read());
        let bindings = scale_deviation::Bindings { v, terms, state: slot::STATE.update() };
        let constants = scale_deviation::Constants::new(plan.size, &plan.settings);
        self.dispatch(bindings, &constants, NO_VARIANT, Grid::Direct([1; 3]));
    }

    /// Adds the correlation of neighbouring residuals and the deviation of V's scale to the standard deviation of V.
    pub(super) fn total_deviation(&mut self) {
        let (plan, terms, state) = (self.plan, slot::UNCERTAINTY_TERMS.read(), slot::STATE.read());
        let bindings = total_deviation::Bindings { terms, results: slot::RESULTS.update(), state };
        self.over(plan.size, bindings, &total_deviation::Constants::new(plan.size), NO_VARIANT);
    }

    /// One channel of the fused image, equation 37. Its photographs replace the luminance.
    pub(super) fn fuse(&mut self, channel: u32) {
        let (plan, finest) = (self.plan, &self.plan.pyramid[0]);
        for image in BOTH {
            // A grey photograph beside a colored one uses its only channel for all three.
            self.channel(image, channel);
        }
        self.spline2(finest);
        let bindings = fuse::Bindings {
            channel1: slot::i1(0).read(),
            spline2: slot::SPLINE2.read(),
            v: slot::relative_blur(0).read(),
            results: slot::RESULTS.write(),
            state: slot::STATE.read(),
        };
        let constants = fuse::Constants {
            width: plan.size[0],
            height: plan.size[1],
            layer: MAP_LAYERS + channel,
            centre: single(finest.centre),
            epsilon: plan.settings.heaviside_epsilon as f32,
        };
        self.over(plan.size, bindings, &constants, NO_VARIANT);
        if plan.settings.edges {
            let fuse::Constants { width, height, layer, centre, .. } = constants;
            let bindings = edge_fuse::Bindings {
                channel1: slot::i1(0).read(),
                spline2: slot::SPLINE2.read(),
                v: slot::relative_blur(0).read(),
                results: slot::RESULTS.update(),
                state: slot::STATE.read(),
            };
            let constants = edge_fuse::Constants { width, height, layer, centre };
            let grid = Grid::Edges { levels: plan.solved, over: Edges::Fused };
            self.dispatch(bindings, &constants, NO_VARIANT, grid);
        }
    }
}
