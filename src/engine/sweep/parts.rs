//! A sweep whose photographs are too large for one solve: T and c are found at half their size, where all of each frame is seen, and the
//! finest level, on which they stay, is solved part by part.

use super::common::Common;
use super::hidden::Hidden;
use super::joint::Joint;
use crate::base::{CancellationToken, Deadline, Error, Frame, Mask, Region, Settings};
use crate::engine::Engine;
use crate::engine::parts::{self, Grid};
use crate::engine::plan::Plan;
use crate::engine::stages::{Field, prolong};

/// Px that a part reaches beyond what is taken of it, at least: windows of σ 4 px and as many sweeps as an iteration has are felt less far.
const HALO: u32 = 32;
/// The same as a share of its side: frames that breathe, or turn, by a few per cent are cut where the part's middle lies in them.
const HALO_SHARE: f64 = 0.03;
/// The least side of a part, px: of smaller ones most is halo.
const LEAST: u32 = 192;

/// The finest level of a size and a number of frames, prepared to be solved by parts.
pub(super) struct Parts {
    joint: Joint,
    size: [u32; 2],
    grid: Grid,
}

impl Parts {
    /// Prepares for photographs as planned, in parts that take so many bytes at most.
    ///
    /// # Errors
    /// As [`Joint::new`].
    pub(super) fn new(engine: &Engine, plan: &Plan, frames: usize, bytes: u64) -> Result<Self, Error> {
        let [width, height] = plan.size;
        let pixels = f64::from(width) * f64::from(height);
        let share = bytes as f64 / plan.sweep_bytes(frames as u32) as f64;
        let most = ((share * pixels).sqrt() as u32).max(LEAST);
        let grid = Grid::covering(plan.size, most, HALO + (HALO_SHARE * f64::from(most)) as u32);
        let settings = Settings { levels: Some(1), ..plan.settings.clone() };
        let [width, height] = grid.side();
        let part = Plan::new(width, height, plan.formats, &settings)?;
        Ok(Self { joint: Joint::new(engine, part, frames)?, size: plan.size, grid })
    }

    pub(super) fn set_cancel(&mut self, cancel: &CancellationToken) {
        self.joint.cancel = cancel.clone();
    }

    pub(super) fn set_deadline(&mut self, deadline: Deadline) {
        self.joint.deadline = deadline;
    }

    /// Parts in all.
    pub(super) fn count(&self) -> usize {
        self.grid.count()
    }

    /// u less the middle setting, and its standard deviation, from u at half the size.
    pub(super) fn solve(
        &mut self,
        frames: &[Frame],
        mask: Option<&Mask>,
        coarse: &Field,
        common: &Common,
        say: &mut dyn FnMut(),
    ) -> Result<[Field; 2], Error> {
        let [width, height] = self.size.map(|side| side as usize);
        let mut whole = [0, 1].map(|_| Field::zeros(width, height));
        for part in self.grid.parts().collect::<Vec<_>>() {
            let solved = self.solve_part(part.solved, frames, mask, coarse, common)?;
            for (whole, solved) in whole.iter_mut().zip(solved) {
                part.bring(&solved.data, &mut whole.data, width, 1);
            }
            say();
        }
        Ok(whole)
    }

    fn solve_part(
        &mut self,
        part: Region,
        frames: &[Frame],
        mask: Option<&Mask>,
        coarse: &Field,
        common: &Common,
    ) -> Result<[Field; 2], Error> {
        let (mut common, places) = within(common, part, self.size);
        let cut = frames.iter().zip(places).map(|(frame, place)| frame.cropped(place).map_err(Error::Region));
        let cut = cut.collect::<Result<Vec<Frame>, Error>>()?;
        let mask = mask.map(|mask| mask.cropped(part));
        let hidden = Hidden::of(&cut, mask.as_ref(), self.joint.settings(), 1);
        self.joint.bring_up(cut.iter())?;
        let start = prolonged(coarse, part, common.limit(self.joint.finest()));
        self.joint.finish_from(&start, &mut common, &hidden)
    }
}

/// u of a part from that at half the size.
fn prolonged(coarse: &Field, part: Region, limit: f64) -> Field {
    let [x, y] = [part.x / 2, part.y / 2];
    let [width, height] =
        [(coarse.width as u32 - x).min(part.width / 2 + 1), (coarse.height as u32 - y).min(part.height / 2 + 1)];
    let data = Region { x, y, width, height }.of(&coarse.data, coarse.width, 1);
    let constants = prolong::Constants { width: part.width, height: part.height, limit: limit as f32, gain: 1.0 };
    prolong::twin(&constants, &Field { width: width as usize, height: height as usize, data })
}

/// What is common to all pixels of a part, and where it is cut out of each frame: where its middle lies there.
fn within(common: &Common, part: Region, size: [u32; 2]) -> (Common, Vec<Region>) {
    let (places, transforms): (Vec<_>, Vec<_>) = common.transforms.iter().map(|t| parts::cut(t, part, size)).unzip();
    let brightness = common.brightness.iter().zip(&places);
    let brightness =
        brightness.map(|((gain, shading), place)| parts::shading_within(*gain, shading, *place, size)).collect();
    (Common { transforms, brightness, ..common.clone() }, places)
}

/// What is common to all pixels of photographs of twice the size.
pub(super) fn doubled(common: &Common, size: [u32; 2]) -> Common {
    let transforms = common.transforms.iter().map(|t| parts::doubled(t, size)).collect();
    let brightness =
        common.brightness.iter().map(|(gain, shading)| parts::shading_doubled(*gain, shading, size)).collect();
    Common { rate: 4.0 * common.rate, transforms, brightness, ..common.clone() }
}

/// Luminance of photographs at half their size, as a level of their pyramid would be.
pub(super) fn halved(frames: &[Frame], settings: &Settings) -> Result<Vec<Frame>, Error> {
    frames.iter().map(|frame| parts::halved(frame, settings.decode)).collect()
}
