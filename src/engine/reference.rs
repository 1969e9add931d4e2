//! The CPU reference of the solver, in double precision.
//!
//! It runs a script as the CPU device does, for tests and for learning.

use super::cpu;
use super::plan::{MAP_LAYERS, Plan};
use super::same_size;
use super::script::{CountedPixels, compose};
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
    let plan = plan.for_processor();
    if settings.method == Method::Sift {
        return Err(Error::NoKeyPoints);
    }
    solve_plan(&plan, [i1, i2], mask)
}

/// Runs the script of a plan.
fn solve_plan(plan: &Plan, frames: [&Frame; 2], mask: Option<&Mask>) -> Result<Reference, Error> {
    let settings = &plan.settings;
    let start = Registration::new(settings.start, &settings.start_photometric);
    let mut state = DoubleState::new(start);
    state.alpha = settings.regularization.unwrap_or(state.alpha);
    let mut memory = Memory::with_filters(&plan.weights.banks);
    frames.into_iter().enumerate().for_each(|(image, frame)| memory.upload_photograph(image, frame.clone()));
    memory.upload_mask(mask.cloned());
    memory.upload_state(state);
    // With masks, which also leave out clipped pixels.
    let script = compose(plan, CountedPixels::Unmasked);
    memory.upload_arguments(&script.arguments);
    cpu::run(script.entries(), &mut memory, &mut |_| Ok(()))?;
    Ok(results(plan, memory))
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
        photometric: state.registration.in_intensities(state.unit).photometric(),
        energies,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{Channels, Decode, Depth, Samples};
    use crate::engine::testing;
    use crate::engine::testing::random;

    /// Blur stacks of 16 bits change V by little of its deviation, whatever the range of the photographs.
    #[test]
    fn packed_blur_stacks_give_nearly_the_same_solution() {
        for (depth, scale) in [(Depth::U8, 1.0), (Depth::U16, 1.0), (Depth::U16, 0.02), (Depth::F32, 4.0)] {
            check_packed(depth, scale);
        }
    }

    fn check_packed(depth: Depth, scale: f32) {
        let size @ [width, height] = [201, 133];
        let images = testing::pair(size).map(|image| {
            let noise = random(image.intensities(Decode::None).len(), 3);
            let sample = |(v, n): (f32, f64)| scale * (v + 0.01 * (n as f32 - 0.5)).clamp(0.0, 1.0);
            let samples = image.intensities(Decode::None).into_iter().zip(noise).map(sample);
            let samples = match depth {
                Depth::U8 => Samples::U8(samples.map(|v| (255.0 * v).round() as u8).collect()),
                Depth::U16 => Samples::U16(samples.map(|v| (65535.0 * v).round() as u16).collect()),
                Depth::F32 => Samples::F32(samples.collect()),
            };
            Frame::new(width, height, Channels::Gray, samples).unwrap()
        });
        let [i1, i2] = &images;
        // Depth edges are decisions, which a step may turn.
        let settings = Settings { edges: false, max_relative_blur: Some(30.0), ..Settings::default() };
        let packed = Plan::new(width, height, [i1.format(), i2.format()], &settings).unwrap();
        let plan = Plan { may_pack: false, ..packed.clone() };
        assert!(packed.packs(&packed.pyramid[0]) && packed.stack_layers() < plan.stack_layers());
        let [floats, packed] = [plan, packed].map(|plan| solve_plan(&plan, [i1, i2], None).unwrap());
        let (mut squares, mut count) = (0.0, 0.0);
        let deviations = floats.relative_blur.data.iter().zip(&floats.uncertainty.data);
        for ((v, deviation), other) in deviations.zip(&packed.relative_blur.data).filter(|((v, _), _)| v.is_finite()) {
            let apart = (other - v) / deviation;
            (squares, count) = (squares + if apart.is_finite() { apart * apart } else { 1.0 }, count + 1.0);
        }
        let (rms, t) = (
            (squares / f64::max(count, 1.0)).sqrt(),
            floats.transform.corner_distance(packed.transform, width, height),
        );
        testing::note(
            "packed",
            &format!("{depth:?} times {scale}: V rms {rms:.3} deviations, T {t:.1e} px, {count} pixels"),
        );
        assert!(count > 10_000.0 && rms < 0.1 && t < 1e-3);
    }
}
