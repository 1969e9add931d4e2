//! Where the frames of a sweep lie, without what else a solve finds.

use super::part::{cut, in_order, restate};
use super::{Counted, Positions, Sweep, SweepOptions, position, solver};
use crate::base::{Brightness, Decode, Error, Frame, Homography};
use crate::engine::{Engine, JointRegistration};

/// The registration of a sweep's frames; fields as those of [`Sweep`].
#[derive(Clone, Debug)]
pub struct RegisteredSweep {
    /// Width and height of the frames, about whose centre the transforms are stated.
    pub photograph: [u32; 2],
    /// The frame on whose pixels the others are brought.
    pub reference: usize,
    /// The focus setting of each frame, in which blur is linear.
    pub positions: Vec<f64>,
    /// What the frames are focused at, as stated.
    pub stated: Positions,
    /// Where each pixel of the reference lies in each frame.
    pub transforms: Vec<Homography>,
    /// What brings each frame to the reference's brightness.
    pub brightness: Vec<Brightness>,
    /// c: by how many px² of variance blur grows with the squared distance from the focus, in settings.
    pub blur_rate: f64,
    /// How stored values became intensities.
    pub decode: Decode,
    /// Which of the frames that were given each of them is, from 0.
    pub order: Vec<usize>,
    /// What the user should know; a sentence each.
    pub warnings: Vec<String>,
}

/// Registers a sweep as [`solve_sweep`](super::solve_sweep) does, and finds no focus: the finest level, on which the registration stays, is
/// left out.
///
/// # Errors
/// Those of [`solve_sweep`](super::solve_sweep).
pub fn register_sweep(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<RegisteredSweep, Error> {
    let (mut found, order) = in_order(frames, options, |frames, options| match cut(frames, options)? {
        None => register(engine, frames, options),
        Some((part, cut, within)) => {
            let mut found = register(engine, &cut, &within)?;
            found.photograph = [frames[0].width(), frames[0].height()];
            restate(&mut found.transforms, &mut found.brightness, part, found.photograph);
            Ok(found)
        }
    })?;
    found.warnings = order.warnings;
    found.warnings.extend(position::told(&options.positions, &found.positions, &order.frames));
    found.order = order.frames;
    Ok(found)
}

/// Registers all of the frames, which fit the options.
fn register(engine: &Engine, frames: &[Frame], options: &SweepOptions) -> Result<RegisteredSweep, Error> {
    let counted = Counted::of(frames.len(), options);
    let mut solver = solver(engine, frames, options)?;
    let mut report = |progress| options.scope.report(progress);
    let JointRegistration { transforms, brightness, rate, settings } =
        solver.register(frames, &counted.input(options), &options.scope.cancel, &mut report)?;
    Ok(RegisteredSweep {
        photograph: [frames[0].width(), frames[0].height()],
        reference: counted.reference,
        positions: counted.positions(&settings),
        stated: options.positions.clone(),
        transforms,
        brightness,
        blur_rate: rate / counted.step.powi(2),
        decode: options.settings.decode.resolved([frames[0].format().depth]),
        order: (0..frames.len()).collect(),
        warnings: Vec::new(),
    })
}

impl Sweep {
    /// Where its frames lie.
    pub fn registration(&self) -> RegisteredSweep {
        RegisteredSweep {
            photograph: self.photograph,
            reference: self.reference,
            positions: self.positions.clone(),
            stated: self.stated.clone(),
            transforms: self.transforms.clone(),
            brightness: self.brightness.clone(),
            blur_rate: self.blur_rate,
            decode: self.decode,
            order: self.order.clone(),
            warnings: self.warnings.clone(),
        }
    }
}
