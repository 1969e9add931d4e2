//! The finest level of photographs too large for one solve, part by part.
//!
//! T and c are found at half the size, where all of each frame is visible, and stay on the finest level.

use super::device::Limits;
use super::pyramid::{IterationDone, PyramidSolver};
use super::shared::SharedParameters;
use super::validity::ExcludedPixels;
use crate::base::statistics::median;
use crate::base::{Error, Frame, Region, Settings};
use crate::engine::Engine;
use crate::engine::parts::{self, Grid};
use crate::engine::plan::Plan;
use crate::engine::stages::{Field, prolong};

/// The least overlap of a part, px: windows of σ 4 px and the relaxation sweeps of an iteration do not reach farther.
const OVERLAP: u32 = 32;
/// The overlap as a share of a part's side. Frames that breathe or turn by a few per cent are cut where the part's
/// middle lies in them.
const OVERLAP_SHARE: f64 = 0.03;
/// The least side of a part, px: smaller ones are mostly overlap.
const MIN_SIDE: u32 = 192;

/// A solver for the finest level of one size, format and number of frames.
pub(super) struct PartSolver {
    solver: PyramidSolver,
    size: [u32; 2],
    grid: Grid,
}

impl PartSolver {
    /// Prepares for the planned photographs, in parts that take at most `bytes` each.
    pub(super) fn new(engine: &Engine, plan: &Plan, frames: usize, bytes: u64) -> Result<Self, Error> {
        let [width, height] = plan.size;
        let pixels = f64::from(width) * f64::from(height);
        let share = bytes as f64 / plan.sweep_bytes(frames as u32) as f64;
        let side = ((share * pixels).sqrt() as u32).max(MIN_SIDE);
        let grid = Grid::covering(plan.size, side, OVERLAP + (OVERLAP_SHARE * f64::from(side)) as u32);
        let settings = Settings { levels: Some(1), ..plan.settings.clone() };
        let [width, height] = grid.side();
        let part = Plan::new(width, height, plan.formats, &settings)?.for_device(engine.info());
        Ok(Self { solver: PyramidSolver::new(engine, part, frames)?, size: plan.size, grid })
    }

    pub(super) fn set_limits(&mut self, limits: Limits) {
        self.solver.set_limits(limits);
    }

    /// The work on each part, with the search for outlines, in pixels of an iteration.
    pub(super) fn work(&self) -> impl Iterator<Item = u64> {
        std::iter::repeat_n(self.solver.final_work(), self.grid.count())
    }

    /// Solves all parts from u at half the size and what levels measured there; returns u relative to the middle setting
    /// and its standard deviation, and the median of the parts' median deviations before outlines move. `done` is called after each iteration of a
    /// part, and each level of its search for outlines.
    pub(super) fn solve(
        &mut self,
        frames: &[Frame],
        coarse: (&Field, Option<&[Field; 2]>),
        shared: &SharedParameters,
        done: &mut IterationDone<'_>,
    ) -> Result<([Field; 2], Option<f64>), Error> {
        let [width, height] = self.size.map(|side| side as usize);
        let (mut whole, mut medians) = ([0, 1].map(|_| Field::zeros(width, height)), Vec::new());
        for part in self.grid.parts().collect::<Vec<_>>() {
            let solved = self.solve_part(part.solved, frames, (coarse, shared), done)?;
            medians.extend(self.solver.median_deviation);
            for (whole, solved) in whole.iter_mut().zip(solved) {
                part.copy_interior(&solved.data, &mut whole.data, width, 1);
            }
        }
        Ok((whole, median(medians)))
    }

    fn solve_part(
        &mut self,
        part: Region,
        frames: &[Frame],
        ((coarse, measured), shared): ((&Field, Option<&[Field; 2]>), &SharedParameters),
        done: &mut IterationDone<'_>,
    ) -> Result<[Field; 2], Error> {
        let (mut shared, places) = shared_by_part(shared, part, self.size);
        let cut = frames.iter().zip(places).map(|(frame, place)| frame.cropped(place).map_err(Error::Region));
        let cut = cut.collect::<Result<Vec<Frame>, Error>>()?;
        let excluded = ExcludedPixels::new(&cut, shared.reference, self.solver.settings(), 1);
        self.solver.upload(&cut, shared.reference)?;
        let start = prolonged(coarse, part, shared.limit(self.solver.finest()));
        self.solver.measured = measured.map(|fields| fields.each_ref().map(|field| halved_part(field, part)));
        self.solver.finish_from(&start, &mut shared, &excluded, done)
    }
}

/// u of a part from u at half the size.
fn prolonged(coarse: &Field, part: Region, limit: f64) -> Field {
    let constants = prolong::Constants { width: part.width, height: part.height, limit: limit as f32, gain: 1.0 };
    prolong::cpu_reference(&constants, &halved_part(coarse, part))
}

/// A part of a field at half the size.
fn halved_part(coarse: &Field, part: Region) -> Field {
    let [x, y] = [part.x / 2, part.y / 2];
    let [width, height] =
        [(coarse.width as u32 - x).min(part.width / 2 + 1), (coarse.height as u32 - y).min(part.height / 2 + 1)];
    let data = Region { x, y, width, height }.crop(&coarse.data, coarse.width, 1);
    Field { width: width as usize, height: height as usize, data }
}

/// The shared parameters as a part sees them, and the region of each frame that it is cut to: where its middle lies
/// there.
fn shared_by_part(shared: &SharedParameters, part: Region, size: [u32; 2]) -> (SharedParameters, Vec<Region>) {
    let (places, transforms): (Vec<_>, Vec<_>) =
        shared.transforms.iter().map(|t| parts::matching_region(t, part, size)).unzip();
    let brightness = shared.brightness.iter().zip(&places);
    let brightness =
        brightness.map(|((gain, shading), place)| parts::shading_of_region(*gain, shading, *place, size)).collect();
    (SharedParameters { transforms, brightness, ..shared.clone() }, places)
}

/// The shared parameters of photographs of twice the size.
pub(super) fn doubled(shared: &SharedParameters, size: [u32; 2]) -> SharedParameters {
    let transforms = shared.transforms.iter().map(|t| parts::doubled_transform(t, size)).collect();
    let brightness =
        shared.brightness.iter().map(|(gain, shading)| parts::doubled_shading(*gain, shading, size)).collect();
    let [parallax, parallax_deviation] = [&shared.parallax, &shared.parallax_deviation]
        .map(|frames| frames.iter().map(|moves| moves.map(|px| 2.0 * px)).collect());
    let rate = 4.0 * shared.rate;
    SharedParameters { rate, transforms, parallax, parallax_deviation, brightness, ..shared.clone() }
}

/// Luminance of photographs at half their size, as a level of their pyramid would be.
pub(super) fn halved(frames: &[Frame], settings: &Settings) -> Result<Vec<Frame>, Error> {
    frames.iter().map(|frame| parts::halved(frame, settings.decode)).collect()
}
