//! A sweep of which it is known where its frames lie and where each pixel is in focus: what an image sharp all over is made of.

use crate::base::{Channels, Decode, Frame};
use crate::engine::JointSolution;
use crate::solve::resample::brightened;

pub(super) struct Focused<'a> {
    pub(super) frames: &'a [Frame],
    pub(super) reference: usize,
    /// Of the frames, steps.
    pub(super) positions: &'a [f64],
    /// Filled in where nothing tells.
    pub(super) found: &'a JointSolution,
    pub(super) decode: Decode,
}

impl Focused<'_> {
    pub(super) fn size(&self) -> [usize; 2] {
        let reference = &self.frames[self.reference];
        [reference.width() as usize, reference.height() as usize]
    }

    pub(super) fn channels(&self) -> Channels {
        self.frames[self.reference].format().channels
    }

    /// Frame n, as bright as the reference. It is decoded to choose and again to fuse: that takes 5 ms a Mpx in colour, and frames that were held in
    /// between would take 12 bytes of each pixel, 1 GB of 41 frames of 2 Mpx.
    pub(super) fn values(&self, n: usize) -> Vec<f32> {
        brightened(&self.frames[n], &self.found.registration.brightness[n], self.decode)
    }
}
