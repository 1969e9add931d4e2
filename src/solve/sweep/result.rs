//! The results of a sweep.

use super::fuse::FocusedFrames;
use super::{Positions, SweepDepth, Task};
use crate::base::{Brightness, Channels, Decode, Homography, Mask, Region};
use crate::engine::JointSolution;

/// The largest standard deviation of u at which a pixel has a result, steps.
const MAX_DEVIATION: f32 = 2.0;
/// The blur at which a pixel counts as out of range, px: that of its focus in the first or the last frame. The solve
/// follows a focus for half a pixel of blur. Near that limit the focus may be anywhere further out. Below it, the frame
/// cannot be distinguished from one in focus.
const OUT_OF_RANGE: f64 = 0.4;

/// The focus of every pixel of a sweep, an all-in-focus image, and the registration.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// Pixels per row of every field below.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The region of the reference that the fields cover.
    pub region: Region,
    /// Width and height of the photographs. The transforms are stated about their centre.
    pub photograph: [u32; 2],
    /// u, the focus setting at which each pixel of the reference is sharp. NaN where it is not measured, or where no
    /// frame is in focus.
    pub focus: Vec<f32>,
    /// The standard deviation of u, in settings; NaN where no pair contributes.
    pub uncertainty: Vec<f32>,
    /// The side of pixels that no frame has in focus: -1 before the first frame, 1 beyond the last, else 0.
    pub beyond: Vec<i8>,
    /// Depth in mm, if the positions are in mm.
    pub depth: Option<SweepDepth>,
    /// The all-in-focus image. It is grey only if all frames are.
    pub fused_channels: Channels,
    /// The all-in-focus image, interleaved, in the values of the reference with white at 1.
    pub fused: Vec<f32>,
    /// The frame that supplies each pixel of the fused image, from 1; empty if the results were read from a folder.
    pub frames: Vec<u16>,
    /// The index of the reference frame in the fields below. It defines the pixels of the results.
    pub reference: usize,
    /// The focus setting of each frame; blur is linear in it.
    pub positions: Vec<f64>,
    /// The unit of the settings.
    pub unit: &'static str,
    /// The focus positions of the frames, as stated.
    pub stated: Positions,
    /// Maps the reference's pixels to those of each frame.
    pub transforms: Vec<Homography>,
    /// Maps the brightness of each frame to the reference's.
    pub brightness: Vec<Brightness>,
    /// c, the blur variance in px² at a distance of one setting from the focus.
    pub blur_rate: f64,
    /// The decoding of stored values to intensities.
    pub decode: Decode,
    /// The index of each frame among the frames that were passed. If no positions are stated, frames out of order are
    /// put in order, and repeated frames are left out.
    pub order: Vec<usize>,
    /// Conditions under which the result may be wrong, one sentence each.
    pub warnings: Vec<String>,
}

/// The registration of a sweep; the fields are those of [`Sweep`].
#[derive(Clone, Debug)]
pub struct RegisteredSweep {
    /// Width and height of the photographs. The transforms are stated about their centre.
    pub photograph: [u32; 2],
    /// The index of the reference frame, to which the others are registered.
    pub reference: usize,
    /// The focus setting of each frame; blur is linear in it.
    pub positions: Vec<f64>,
    /// The focus positions of the frames, as stated.
    pub stated: Positions,
    /// Maps the reference's pixels to those of each frame.
    pub transforms: Vec<Homography>,
    /// Maps the brightness of each frame to the reference's.
    pub brightness: Vec<Brightness>,
    /// c, the blur variance in px² at a distance of one setting from the focus.
    pub blur_rate: f64,
    /// The decoding of stored values to intensities.
    pub decode: Decode,
    /// The index of each frame among the frames that were passed.
    pub order: Vec<usize>,
    /// Conditions under which the result may be wrong, one sentence each.
    pub warnings: Vec<String>,
}

impl Task<'_> {
    /// The result of a solve for the cut frames, in order.
    pub(super) fn sweep(&self, solution: JointSolution) -> Sweep {
        let registered = self.registered(solution.registration.clone());
        let frames = FocusedFrames {
            frames: &self.frames,
            reference: self.reference,
            solution: &solution,
            decode: registered.decode,
        };
        let (fused, fused_channels) = (frames.fuse(), frames.channels());
        let pixels = solution.focus.iter().zip(&solution.deviation);
        let measured: Vec<f32> =
            pixels.map(|(&u, &deviation)| if deviation < MAX_DEVIATION { u } else { f32::NAN }).collect();
        let settings = &solution.registration.settings;
        let beyond = sides(&measured, settings[settings.len() - 1], solution.registration.rate);
        let in_range = measured.iter().zip(&beyond).map(|(&u, &side)| if side == 0 { u } else { f32::NAN });
        let focus = in_range.map(|u| (self.first + self.step * f64::from(u)) as f32).collect();
        let uncertainty = solution.deviation.iter().map(|&s| (self.step.abs() * f64::from(s)) as f32).collect();
        Sweep {
            width: self.part.width,
            height: self.part.height,
            region: self.part,
            photograph: registered.photograph,
            depth: None,
            focus,
            uncertainty,
            beyond,
            fused_channels,
            fused: fused.values,
            frames: fused.frames.iter().map(|n| n + 1).collect(),
            reference: registered.reference,
            positions: registered.positions,
            unit: registered.stated.unit(),
            stated: registered.stated,
            transforms: registered.transforms,
            brightness: registered.brightness,
            blur_rate: registered.blur_rate,
            decode: registered.decode,
            order: registered.order,
            warnings: registered.warnings,
        }
    }
}

/// The side of each pixel: -1 where u is before the first frame, 1 where it is beyond the last, else 0, also where u is
/// NaN. u and `last` are in steps from the first frame, c in px² per squared step.
fn sides(focus: &[f32], last: f64, rate: f64) -> Vec<i8> {
    let margin = (OUT_OF_RANGE / rate.sqrt()) as f32;
    let side = |u: &f32| i8::from(*u > last as f32 + margin) - i8::from(*u < -margin);
    focus.iter().map(side).collect()
}

impl Sweep {
    /// The registration alone.
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

    /// Crops the fields to a region.
    pub(super) fn crop(&mut self, part: Region) {
        let row = self.width as usize;
        for field in [&mut self.focus, &mut self.uncertainty] {
            *field = part.crop(field, row, 1);
        }
        self.beyond = part.crop(&self.beyond, row, 1);
        self.frames = part.crop(&self.frames, row, 1);
        self.fused = part.crop(&self.fused, row, self.fused_channels.count() as usize);
        self.region = Region { x: self.region.x + part.x, y: self.region.y + part.y, ..part };
        (self.width, self.height) = (part.width, part.height);
    }

    /// Clears the results of the pixels that a mask excludes.
    pub(super) fn exclude(&mut self, mask: &Mask) {
        for (pixel, _) in mask.bytes().iter().enumerate().filter(|(_, counts)| **counts == 0) {
            (self.focus[pixel], self.uncertainty[pixel], self.beyond[pixel]) = (f32::NAN, f32::NAN, 0);
        }
    }

    /// The largest rectangle in which every pixel has a u; `None` if none has.
    pub(super) fn largest_valid(&self) -> Option<Region> {
        let valid: Vec<bool> = self.focus.iter().map(|u| u.is_finite()).collect();
        Region::largest_valid(&valid, self.width as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn focus_half_a_pixel_of_blur_outside_the_frames_has_a_side() {
        // Blur grows by 2 px per step: 0.4 px are a fifth of a step.
        let focus = [f32::NAN, -0.25, -0.15, 0.0, 2.0, 3.15, 3.25];
        assert_eq!(sides(&focus, 3.0, 4.0), [0, -1, 0, 0, 0, 0, 1]);
    }
}
