//! What is worked out once V and T are found.

use super::compose::{BOTH, Composer};
use crate::engine::slot;
use crate::engine::stages::{NO_VARIANT, fuse, linearise, residual, uncertainty, uncertainty_terms};

impl Composer<'_> {
    /// What decided V and what nothing explains, averaged over a window around each pixel.
    pub(super) fn evidence(&mut self) {
        let size = uncertainty_terms::size(self.plan.size);
        let bindings = uncertainty_terms::Bindings {
            v: slot::relative_blur(0).read(),
            equations: slot::NORMAL_EQUATIONS.read(),
            evidence: slot::EVIDENCE.write(),
        };
        self.over(size, bindings, &self.plan.evidence(), NO_VARIANT);
        let bindings = residual::Bindings {
            i1: slot::i1(0).read(),
            v: slot::relative_blur(0).read(),
            stacks: slot::STACKS.read(),
            evidence: slot::EVIDENCE.write(),
            state: slot::STATE.read(),
        };
        let variant = linearise::variant(self.plan.slopes(), self.plan.warps(&self.plan.pyramid[0]), false, false);
        self.over(size, bindings, &self.plan.residual(), variant);
        for layer in 0..uncertainty_terms::LAYERS as u32 {
            self.smooth((slot::EVIDENCE.plane(), layer), size);
        }
    }

    /// V where it is valid, its standard deviation and the residual, into the first layers of the results.
    pub(super) fn uncertainty(&mut self) {
        let bindings = uncertainty::Bindings {
            v: slot::relative_blur(0).read(),
            evidence: slot::EVIDENCE.read(),
            results: slot::RESULTS.write(),
            state: slot::STATE.read(),
            mask: slot::MASK.read(),
        };
        let variant = if self.masked { uncertainty::MASKED } else { NO_VARIANT };
        self.over(self.plan.size, bindings, &self.plan.uncertainty(), variant);
    }

    /// One channel of the pseudo-radiance, equation 37. The channel takes the luminance's place.
    pub(super) fn fuse(&mut self, channel: u32) {
        let mut weights = [0.0; 3];
        weights[channel as usize] = 1.0;
        for image in BOTH {
            // A grey photograph beside a coloured one gives its only channel to all three.
            self.ingest(image, weights);
        }
        self.spline2(&self.plan.pyramid[0]);
        let bindings = fuse::Bindings {
            channel1: slot::i1(0).read(),
            spline2: slot::SPLINE2.read(),
            v: slot::relative_blur(0).read(),
            results: slot::RESULTS.write(),
            state: slot::STATE.read(),
        };
        self.over(self.plan.size, bindings, &self.plan.fuse(channel), NO_VARIANT);
    }
}
