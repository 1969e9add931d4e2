//! The images and buffers of one solver, allocated once: what stands in each slot.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::arguments;
use super::plan::Plan;
use super::slot::Slot;
use super::stages::state::State;
use super::stages::sums::Layout;
use super::stages::{convolve, half_pair, linearise, shape_windows, system, uncertainty_terms};
use super::tiles;
use super::vulkan::{Buffer, Device, Image, Texel};
use crate::base::Error;

/// All of them. What only lives within a level is as large as the finest and shared: coarser levels use its corner.
pub(crate) struct Workspace {
    images: BTreeMap<Slot, Arc<Image>>,
    buffers: BTreeMap<Slot, Arc<Buffer>>,
}

impl Workspace {
    /// Of pairs.
    pub(crate) fn new(device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        Self::of(device, plan, None)
    }

    /// For another pair of the same kind: its mapped memory is its own, all else is shared.
    pub(crate) fn beside(&self, device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        let mut wanted = shared_buffers(plan);
        wanted.extend(buffers_of_pairs(plan));
        let (images, mut buffers) = (self.images.clone(), self.buffers.clone());
        let unpacked = |slot| [0, 1].iter().any(|&image| slot == Slot::Photograph { image } && plan.unpacks(image));
        let own = |slot: Slot| slot.is_of_one_pair() && !unpacked(slot);
        for (slot, bytes, make) in wanted.into_iter().filter(|(slot, ..)| own(*slot)) {
            buffers.insert(slot, make(device, &format!("{slot:?}"), bytes)?);
        }
        Ok(Self { images, buffers })
    }

    /// Of sweeps of so many frames.
    pub(crate) fn for_sweep(device: &Arc<Device>, plan: &Plan, frames: u32) -> Result<Self, Error> {
        Self::of(device, plan, Some(frames))
    }

    fn of(device: &Arc<Device>, plan: &Plan, frames: Option<u32>) -> Result<Self, Error> {
        let mut wanted = shared_images(plan);
        wanted.extend(frames.map_or_else(|| images_of_pairs(plan), |frames| images_of_sweeps(plan, frames)));
        let image = |(slot, size, layers, texel): DeviceRequirements| {
            Ok::<_, Error>((slot, Image::new(device, &format!("{slot:?}"), size, layers, texel)?))
        };
        let images = wanted.into_iter().map(image).collect::<Result<_, _>>()?;
        let mut wanted = shared_buffers(plan);
        wanted.extend(frames.map_or_else(|| buffers_of_pairs(plan), |frames| buffers_of_sweeps(plan, frames)));
        let buffer =
            |(slot, bytes, make): (Slot, u64, Make)| Ok::<_, Error>((slot, make(device, &format!("{slot:?}"), bytes)?));
        let buffers: BTreeMap<_, _> = wanted.into_iter().map(buffer).collect::<Result<_, _>>()?;
        for (bank, weights) in plan.weights.banks.iter().enumerate() {
            let single: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
            buffers[&Slot::Filters { bank }].write(bytemuck::cast_slice(&single))?;
        }
        Ok(Self { images, buffers })
    }

    /// The image in a slot.
    pub(crate) fn image(&self, slot: Slot) -> &Arc<Image> {
        &self.images[&slot]
    }

    /// The buffer in a slot.
    pub(crate) fn buffer(&self, slot: Slot) -> &Arc<Buffer> {
        &self.buffers[&slot]
    }

    /// Every image, to be made ready once.
    pub(crate) fn images(&self) -> Vec<&Arc<Image>> {
        self.images.values().collect()
    }
}

type DeviceRequirements = (Slot, [u32; 2], u32, Texel);
type Make = fn(&Arc<Device>, &str, u64) -> Result<Arc<Buffer>, Error>;

fn shared_images(plan: &Plan) -> Vec<DeviceRequirements> {
    let half = plan.pyramid[0].half();
    let mut wanted = vec![
        (Slot::Spline2, plan.size, 1, Texel::One),
        (Slot::Scratch, plan.size, 1, Texel::One),
        (Slot::RightSides, half, 2, Texel::One),
        (Slot::Weights, half, 2, Texel::FourHalf),
        (Slot::Change { color: 0 }, half, 1, Texel::One),
        (Slot::Change { color: 1 }, half, 1, Texel::One),
    ];
    let solved = &plan.pyramid[..plan.solved];
    wanted.extend(solved.iter().map(|l| (Slot::RelativeBlur { level: l.index }, l.size, 1, Texel::One)));
    wanted
}

fn images_of_pairs(plan: &Plan) -> Vec<DeviceRequirements> {
    let mut wanted = vec![
        (Slot::Stacks, plan.size, plan.stack_layers(), Texel::One),
        (Slot::NormalEquations, plan.size, linearise::LAYERS, Texel::One),
        (Slot::Evidence, uncertainty_terms::size(plan.size), uncertainty_terms::LAYERS as u32, Texel::One),
    ];
    for level in &plan.pyramid {
        let (size, level) = (level.size, level.index);
        wanted.extend([0, 1].map(|image| (Slot::Luminance { image, level }, size, 1, Texel::One)));
        wanted.push((Slot::Masks { level }, size, 2, Texel::One));
    }
    wanted
}

fn images_of_sweeps(plan: &Plan, frames: u32) -> Vec<DeviceRequirements> {
    let mut wanted = vec![
        (Slot::Stacks, plan.size, plan.layers_of(&plan.pyramid[0]), Texel::One),
        (Slot::NormalEquations, plan.size, half_pair::LAYERS, Texel::One),
        (Slot::Luminance { image: 0, level: 0 }, plan.size, 1, Texel::One),
        (Slot::Aligned, plan.size, frames, Texel::One),
    ];
    wanted
        .extend(plan.pyramid.iter().map(|level| (Slot::Frames { level: level.index }, level.size, frames, Texel::One)));
    wanted
}

const ON_DEVICE: Make = Buffer::device_local;
const UP: Make = Buffer::for_upload;
const DOWN: Make = Buffer::for_readback;

fn shared_buffers(plan: &Plan) -> Vec<(Slot, u64, Make)> {
    let mut wanted = vec![(Slot::State, size_of::<State>() as u64, ON_DEVICE), photograph(plan, 0)];
    let bytes = 4 * convolve::WEIGHTS as u64;
    wanted.extend((0..plan.weights.banks.len()).map(|bank| (Slot::Filters { bank }, bytes, UP)));
    wanted
}

/// Mapped, unless another is and it is unpacked from there.
fn photograph(plan: &Plan, image: usize) -> (Slot, u64, Make) {
    (Slot::Photograph { image }, plan.frame_bytes(image), if plan.unpacks(image) { ON_DEVICE } else { UP })
}

fn buffers_of_pairs(plan: &Plan) -> Vec<(Slot, u64, Make)> {
    let partial_rows = plan.pyramid.iter().map(|l| l.tiles()[0] * l.tiles()[1]).max().unwrap_or(1);
    let energies = 4 * plan.solved as u64 * u64::from(plan.settings.outer_iterations);
    let arguments = arguments::bytes(plan.solved);
    let state = size_of::<State>() as u64;
    let row = 4 * Layout::of(true).length as u64;
    let partials = (row * u64::from(partial_rows)).max(4 * shape_windows::FLOATS);
    let packed = [0, 1].into_iter().filter(|&image| plan.unpacks(image));
    let mut wanted: Vec<(Slot, u64, Make)> =
        packed.map(|image| (Slot::Packed { image }, plan.packed_bytes(image), UP)).collect();
    wanted.extend([
        (Slot::Partials, partials, ON_DEVICE),
        (Slot::Energies, energies, ON_DEVICE),
        (Slot::Arguments, arguments, ON_DEVICE),
        (Slot::StartState, state, UP),
        (Slot::StartArguments, arguments, UP),
        photograph(plan, 1),
        (Slot::Mask, plan.mask_bytes(), UP),
        // Pairs list none.
        (Slot::Tiles, 4, UP),
        (Slot::EndMaps, plan.result_bytes(), Buffer::for_borrowed_readback),
        (Slot::Progress, state, DOWN),
        (Slot::EndPartials, partials, DOWN),
        (Slot::EndState, state, DOWN),
        (Slot::EndEnergies, energies, DOWN),
        (Slot::RegisteredState, state, DOWN),
        (Slot::RegisteredEnergies, energies, DOWN),
    ]);
    wanted
}

fn buffers_of_sweeps(plan: &Plan, frames: u32) -> Vec<(Slot, u64, Make)> {
    // What all half-pairs say, four of a frame at most on either side, read by the host.
    let [columns, rows, _] = half_pair::tiles(plan.size);
    let half_pairs = 8 * u64::from(frames) * u64::from(columns * rows) * 4 * Layout::of(true).length as u64;
    let [columns, rows, _] = system::tiles(plan.size);
    let steps = 4 * (system::SUMS as u64) * u64::from(columns * rows);
    vec![
        (Slot::Partials, half_pairs.max(steps), DOWN),
        (Slot::Tiles, 4 * tiles::capacity(plan.size, frames), UP),
        (Slot::Hidden, plan.hidden_bytes(frames), UP),
    ]
}
