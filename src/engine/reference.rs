//! The CPU reference of the solver, in double precision.
//!
//! It runs a script as the CPU device does, for tests and for learning.

use super::cpu;
use super::plan::{MAP_LAYERS, Plan};
use super::same_size;
use super::script::compose;
use super::slot::Slot;
use super::stages::Field;
use super::stages::pass::Memory;
use super::stages::state::{DoubleState, Registration};
use crate::base::{Error, Frame, Homography, Mask, Method, Photometric, Settings};

/// A solution of the CPU reference.
pub struct Reference {
    /// V where it is valid, NaN elsewhere, px².
    pub relative_blur: Field,
    /// Standard deviation of V, px², NaN where V is.
    pub uncertainty: Field,
    /// Root mean square residual, intensities, NaN where V is.
    pub residual: Field,
    /// The fused image, a field for each channel.
    pub fused: Vec<Field>,
    /// T.
    pub transform: Homography,
    /// Gain and offset.
    pub photometric: Photometric,
    /// Energy by level, coarse to fine, and outer iteration.
    pub energies: Vec<Vec<f64>>,
}

/// Solves one pair on the CPU.
///
/// # Errors
/// [`Error::Setting`], [`Error::TooSmall`], [`Error::Mismatch`] where the sizes differ, [`Error::NoKeyPoints`] for
/// SIFT.
pub fn solve(i1: &Frame, i2: &Frame, settings: &Settings) -> Result<Reference, Error> {
    solve_masked(i1, i2, settings, None)
}

/// Solves one pair on the CPU, without the pixels of I1 that a mask leaves out.
///
/// # Errors
/// As [`solve`].
pub fn solve_masked(i1: &Frame, i2: &Frame, settings: &Settings, mask: Option<&Mask>) -> Result<Reference, Error> {
    same_size([i1, i2])?;
    let plan = Plan::new(i1.width(), i1.height(), [i1.format(), i2.format()], settings)?;
    if settings.method == Method::Sift {
        return Err(Error::NoKeyPoints);
    }
    let start = Registration::new(settings.start, &settings.start_photometric);
    let mut state = DoubleState::new(start);
    state.alpha = settings.regularization.unwrap_or(state.alpha);
    let mut memory = Memory::with_filters(&plan.weights.banks);
    [i1, i2].into_iter().enumerate().for_each(|(image, frame)| memory.upload_photograph(image, frame.clone()));
    memory.upload_mask(mask.cloned());
    memory.upload_state(state);
    // With masks, which also leave out clipped pixels.
    let script = compose(&plan, true);
    memory.upload_arguments(&script.arguments);
    cpu::run(script.entries(), &mut memory, &mut |_| Ok(()))?;
    Ok(results(&plan, memory))
}

/// The results from their slots.
fn results(plan: &Plan, mut memory: Memory<f64>) -> Reference {
    let state = memory.state_in(Slot::EndState).clone();
    let (energies, outer) = (memory.numbers_in(Slot::EndEnergies), plan.settings.outer_iterations as usize);
    let energies = plan.coarse_to_fine().map(|level| {
        let done = state.levels[level.index].iterations as usize;
        energies[level.index * outer..][..done].to_vec()
    });
    let energies = energies.collect();
    let mut layers = memory.take(Slot::Stacks).into_iter();
    let mut next = || layers.next().unwrap_or_else(|| Field::zeros(0, 0));
    let [relative_blur, uncertainty, residual] = [(); MAP_LAYERS as usize].map(|()| next());
    Reference {
        relative_blur,
        uncertainty,
        residual,
        fused: (0..plan.fused_count()).map(|_| next()).collect(),
        transform: state.registration.transform,
        photometric: state.registration.photometric(),
        energies,
    }
}
