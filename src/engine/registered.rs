//! What a registration alone gives back.

use crate::base::{Brightness, Homography, Photometric, Shading};
use crate::engine::OtherMotion;
use crate::engine::solution::{self, LevelHistory, Timings};
use crate::engine::stages::state::State;

/// The result of one [`PairSolver::register`](crate::PairSolver::register).
#[derive(Clone, Debug, PartialEq)]
pub struct Registered {
    /// Pixels a row of the images.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// T, for full-size pixels.
    pub transform: Homography,
    /// Gain and offset of I2. Where the method does not solve for them, the match of mean and deviation at low pass.
    pub photometric: Photometric,
    /// How the gain varies over I2; nothing where the method finds T without V.
    pub shading: Shading,
    /// Another motion model that would do, where there is one; only with the method unified, which judges T by its energy.
    pub other_motion: Option<OtherMotion>,
    /// Coarse to fine; no energies where the method has no iterations.
    pub levels: Vec<LevelHistory>,
    /// Whether the registration settled on an answer that the images support.
    pub converged: bool,
    /// Why not; a sentence each.
    pub warnings: Vec<String>,
    /// Where the time went.
    pub timings: Timings,
}

impl Registered {
    /// What brings I2 to the brightness of I1.
    pub fn brightness(&self) -> Brightness {
        let unchanged = Brightness::identity([self.width, self.height]);
        Brightness { photometric: self.photometric, shading: self.shading, ..unchanged }
    }

    /// Fills in whether to believe it.
    pub(crate) fn judge(&mut self, state: &State) {
        self.warnings =
            solution::numbers_doubt(state).or_else(|| solution::registration_doubt(state)).into_iter().collect();
        self.converged = self.warnings.is_empty();
        self.warnings.extend(solution::shading_warning(&self.shading));
    }
}
