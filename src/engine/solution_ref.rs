//! Results where the device has left them.

use std::ops::Deref;

use super::solution::{self, Findings, Solution};
use crate::base::workers;

/// The results of a solve in the solver's own memory: nothing is copied, and they stand until its next pair is handed over.
///
/// ```
/// # use parfocal::{Engine, EngineOptions, Error, Frame, Settings, PairSolver};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let (i1, i2) = (photograph(0.4), photograph(0.3));
/// let engine = Engine::new(&EngineOptions::default())?;
/// let mut solver = PairSolver::for_pair(&engine, &i1, &i2, &Settings::default())?;
/// let view = solver.solve_in_place(&i1, &i2)?;
/// println!("V {:.2} px², {:?}", view.relative_blur()[64 * 24], view.transform);
/// # assert_eq!(view.to_owned().relative_blur.len(), view.relative_blur().len());
/// # Ok(())
/// # }
/// ```
pub struct SolutionRef<'a> {
    findings: Findings,
    /// V, its standard deviation, the residual, the fused channels, one after the other.
    maps: &'a [f32],
}

impl<'a> SolutionRef<'a> {
    pub(super) fn new(findings: Findings, maps: &'a [f32]) -> Self {
        Self { findings, maps }
    }

    fn map(&self, n: usize) -> &'a [f32] {
        let pixels = self.findings.width as usize * self.findings.height as usize;
        &self.maps[n * pixels..(n + 1) * pixels]
    }

    /// V, px², as [`Solution::relative_blur`].
    pub fn relative_blur(&self) -> &'a [f32] {
        self.map(0)
    }

    /// Its standard deviation, px², as [`Solution::uncertainty`].
    pub fn uncertainty(&self) -> &'a [f32] {
        self.map(1)
    }

    /// What nothing explains, intensities, as [`Solution::residual`].
    pub fn residual(&self) -> &'a [f32] {
        self.map(2)
    }

    /// A channel of the pseudo-radiance, from 0; `None` where there are fewer, or none was asked for.
    pub fn fused(&self, channel: usize) -> Option<&'a [f32]> {
        let pixels = self.findings.width as usize * self.findings.height as usize;
        (channel < self.maps.len() / pixels - 3).then(|| self.map(3 + channel))
    }

    /// A copy that stands by itself.
    pub fn to_owned(&self) -> Solution {
        let channels: Vec<&[f32]> = (0..).map_while(|channel| self.fused(channel)).collect();
        let mut fused = vec![0.0; channels.len() * self.relative_blur().len()];
        // In pieces that a thread takes at a time.
        let (row, count) = (1 << 14, channels.len());
        workers::for_each(fused.chunks_mut((row * count).max(1)).enumerate(), |(n, pixels)| {
            for (i, pixel) in pixels.chunks_exact_mut(count).enumerate() {
                pixel.iter_mut().zip(&channels).for_each(|(value, channel)| *value = channel[n * row + i]);
            }
        });
        Solution {
            relative_blur: self.relative_blur().to_vec(),
            uncertainty: self.uncertainty().to_vec(),
            confidence: self.uncertainty().iter().map(|&deviation| solution::confidence(deviation)).collect(),
            residual: self.residual().to_vec(),
            fused,
            findings: self.findings.clone(),
        }
    }
}

impl Deref for SolutionRef<'_> {
    type Target = Findings;

    fn deref(&self) -> &Findings {
        &self.findings
    }
}
