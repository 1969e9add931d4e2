//! The passes of the outputs: what each binds, its push constants and what it is dispatched over.

use super::compose::{BOTH, Composer};
use super::passes::single;
use crate::engine::arguments::{Edges, Grid, Indirect};
use crate::engine::plan::MAP_LAYERS;
use crate::engine::slot::Slot;
use crate::engine::stages::noise::Noise;
use crate::engine::stages::{
    NO_VARIANT, ambiguity, edge_fuse, fuse, linearise, residual, scale_deviation, stack, total_deviation, uncertainty,
    uncertainty_terms,
};
use crate::engine::vulkan::Variant;

impl Composer<'_> {
    /// The terms of the uncertainty and the squared residual, averaged over a window around each pixel.
    pub(super) fn uncertainty_terms(&mut self) {
        let (plan, finest, s) = (self.plan, &self.plan.pyramid[0], &self.plan.settings);
        let ([width, height], size) = (plan.size, uncertainty_terms::size(plan.size));
        let (eta, noise, least) = (s.data_eta as f32, uncertainty_terms::NOISE, uncertainty_terms::LEAST);
        let constants = uncertainty_terms::Constants { width, height, eta, noise, least };
        self.over(size, uncertainty_terms::Bindings::on(0), &constants, NO_VARIANT);
        let constants = residual::Constants {
            width,
            height,
            layer: uncertainty_terms::RESIDUAL as u32 + 1,
            nodes: finest.nodes as u32,
            second_stack: plan.second_stack(finest),
            centre: single(finest.centre),
            mean: single(s.kernel.mean()),
        };
        let variant = linearise::variant(plan.slopes(), plan.warps(finest), false, false);
        let variant = stack::packed(variant, plan.packs(finest));
        self.over(size, residual::Bindings::on(0), &constants, variant);
        for n in 0..uncertainty_terms::LAYERS as u32 {
            self.smooth([n + 1, n].map(|n| (Slot::UncertaintyTerms, n)), size);
        }
        let variant = variant | Variant::MASKED.when(self.masked);
        let constants = ambiguity::Constants {
            width,
            height,
            nodes: finest.nodes as u32,
            second_stack: plan.second_stack(finest),
            centre: single(finest.centre),
            mean: single(s.kernel.mean()),
            limit: finest.limit.min(ambiguity::FARTHEST) as f32,
            eta: s.data_eta as f32,
            pixels: uncertainty::WINDOW_PIXELS,
            noise: Noise::new(0),
        };
        self.dispatch(ambiguity::Bindings::on(0), &constants, variant, Grid::Direct(ambiguity::tiles(plan.size)));
    }

    /// V where it is valid, its standard deviation and the residual, into the first layers of the results; and the
    /// correlation of neighbouring residuals and the deviation of V's scale, into the state.
    pub(super) fn uncertainty(&mut self) {
        let (plan, variant) = (self.plan, Variant::MASKED.when(self.masked));
        let constants =
            uncertainty::Constants::new(plan.size, plan.pyramid[0].centre, plan.pyramid[0].nodes, &plan.settings);
        self.over(plan.size, uncertainty::Bindings::on(0), &constants, variant);
        let constants = scale_deviation::Constants::new(plan.size, &plan.settings);
        self.dispatch(scale_deviation::Bindings::on(0), &constants, NO_VARIANT, Grid::Direct([1; 3]));
    }

    /// Adds the correlation of neighbouring residuals and the deviation of V's scale to the standard deviation of V.
    pub(super) fn total_deviation(&mut self) {
        let (size, bindings) = (self.plan.size, total_deviation::Bindings::on(0));
        self.over(size, bindings, &total_deviation::Constants::new(size), NO_VARIANT);
    }

    /// One channel of the fused image, equation 37. Its photographs replace the luminance.
    pub(super) fn fuse(&mut self, channel: u32) {
        let (plan, finest) = (self.plan, &self.plan.pyramid[0]);
        for image in BOTH {
            // A grey photograph beside a colored one uses its only channel for all three.
            self.channel(image, channel);
        }
        self.spline2(finest);
        let constants = fuse::Constants {
            width: plan.size[0],
            height: plan.size[1],
            layer: MAP_LAYERS + channel,
            centre: single(finest.centre),
        };
        self.over(plan.size, fuse::Bindings::on(0), &constants, NO_VARIANT);
        if plan.settings.edges {
            let fuse::Constants { width, height, layer, centre, .. } = constants;
            let constants = edge_fuse::Constants { width, height, layer, centre };
            let grid = Grid::Indirect(Indirect::Edges { levels: plan.solved, over: Edges::Fused });
            self.dispatch(edge_fuse::Bindings::on(0), &constants, NO_VARIANT, grid);
        }
    }
}
