//! The images and buffers of one solver, allocated once: what stands in each slot.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::arguments;
use super::plan::Plan;
use super::slot::Slot;
use super::stages::state::State;
use super::stages::sums::Layout;
use super::stages::{convolve, evidence, half_pair, linearise, shape_windows, system};
use super::tiles;
use super::vulkan::{Buffer, Device, Image, Texel};
use crate::base::Error;

/// All of them. What only lives within a level is as large as the finest and shared: coarser levels use its corner.
pub(crate) struct Workspace {
    images: BTreeMap<Slot, Arc<Image>>,
    buffers: BTreeMap<Slot, Arc<Buffer>>,
}

impl Workspace {
    /// Besides what a pair takes, what a sweep of so many frames does.
    pub(crate) fn for_sweep(device: &Arc<Device>, plan: &Plan, frames: u32) -> Result<Self, Error> {
        let mut workspace = Self::new(device, plan)?;
        let mut wanted =
            vec![(Slot::Aligned, plan.size, frames), (Slot::NormalEquations, plan.size, half_pair::LAYERS)];
        wanted.extend(plan.pyramid.iter().map(|level| (Slot::Frames { level: level.index }, level.size, frames)));
        for (slot, size, layers) in wanted {
            let image = Image::new(device, &format!("{slot:?}"), size, layers, Texel::One)?;
            workspace.images.insert(slot, image);
        }
        // What all half-pairs say, four of a frame at most on either side, read by the host.
        let [columns, rows, _] = half_pair::tiles(plan.size);
        let half_pairs = 8 * u64::from(frames) * u64::from(columns * rows) * 4 * Layout::of(true).length as u64;
        let [columns, rows, _] = system::tiles(plan.size);
        let steps = 4 * (system::SUMS as u64) * u64::from(columns * rows);
        let partials = Buffer::for_readback(device, "Partials", half_pairs.max(steps))?;
        workspace.buffers.insert(Slot::Partials, partials);
        let tiles = Buffer::for_upload(device, "Tiles", 4 * tiles::capacity(plan.size, frames))?;
        workspace.buffers.insert(Slot::Tiles, tiles);
        Ok(workspace)
    }

    pub(crate) fn new(device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        let images = images(device, plan)?;
        let buffers = buffers(device, plan)?;
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

fn images(device: &Arc<Device>, plan: &Plan) -> Result<BTreeMap<Slot, Arc<Image>>, Error> {
    let half = plan.pyramid[0].half();
    let mut wanted = vec![
        (Slot::Stacks, plan.size, plan.stack_layers(), Texel::One),
        (Slot::Spline2, plan.size, 1, Texel::One),
        (Slot::Scratch, plan.size, 1, Texel::One),
        (Slot::NormalEquations, plan.size, linearise::LAYERS, Texel::One),
        (Slot::RightSides, half, 2, Texel::One),
        (Slot::Weights, half, 2, Texel::FourHalf),
        (Slot::Change { color: 0 }, half, 1, Texel::One),
        (Slot::Change { color: 1 }, half, 1, Texel::One),
        (Slot::Evidence, evidence::size(plan.size), evidence::LAYERS as u32, Texel::One),
    ];
    for level in &plan.pyramid {
        let (size, level) = (level.size, level.index);
        wanted.extend([0, 1].map(|image| (Slot::Luminance { image, level }, size, 1, Texel::One)));
        wanted.push((Slot::Masks { level }, size, 2, Texel::One));
        if level < plan.solved {
            wanted.push((Slot::RelativeBlur { level }, size, 1, Texel::One));
        }
    }
    let make = |(slot, size, layers, texel): (Slot, _, _, _)| {
        Ok((slot, Image::new(device, &format!("{slot:?}"), size, layers, texel)?))
    };
    wanted.into_iter().map(make).collect()
}

fn buffers(device: &Arc<Device>, plan: &Plan) -> Result<BTreeMap<Slot, Arc<Buffer>>, Error> {
    let partial_rows = plan.pyramid.iter().map(|l| l.tiles()[0] * l.tiles()[1]).max().unwrap_or(1);
    let energies = 4 * plan.solved as u64 * u64::from(plan.settings.outer_iterations);
    let arguments = (4 * arguments::WORDS * plan.solved) as u64;
    let state = size_of::<State>() as u64;
    let row = 4 * Layout::of(true).length as u64;
    let partials = (row * u64::from(partial_rows)).max(4 * shape_windows::FLOATS);
    type Make = fn(&Arc<Device>, &str, u64) -> Result<Arc<Buffer>, Error>;
    let (on_device, up, down): (Make, Make, Make) = (Buffer::on_device, Buffer::for_upload, Buffer::for_readback);
    let mut wanted = vec![
        (Slot::State, state, on_device),
        (Slot::Partials, partials, on_device),
        (Slot::Energies, energies, on_device),
        (Slot::Arguments, arguments, on_device),
        (Slot::StartState, state, up),
        (Slot::StartArguments, arguments, up),
        (Slot::Photograph { image: 0 }, plan.frame_bytes(0), up),
        (Slot::Photograph { image: 1 }, plan.frame_bytes(1), up),
        (Slot::Mask, plan.mask_bytes(), up),
        // Pairs list none.
        (Slot::Tiles, 4, up),
        (Slot::EndMaps, plan.result_bytes(), down),
        (Slot::Progress, state, down),
        (Slot::EndPartials, partials, down),
        (Slot::EndState, state, down),
        (Slot::EndEnergies, energies, down),
        (Slot::RegisteredState, state, down),
        (Slot::RegisteredEnergies, energies, down),
    ];
    let bytes = 4 * convolve::WEIGHTS as u64;
    wanted.extend((0..plan.weights.banks.len()).map(|bank| (Slot::Filters { bank }, bytes, up)));
    let make = |(slot, bytes, make): (Slot, u64, Make)| Ok((slot, make(device, &format!("{slot:?}"), bytes)?));
    wanted.into_iter().map(make).collect()
}
