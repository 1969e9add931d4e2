//! The images and buffers of one solver, allocated once.

use std::sync::Arc;

use crate::base::Error;
use crate::engine::plan::{ARGUMENT_WORDS, GRID_WORDS, Plan};
use crate::engine::stages::linearise::SUMS;
use crate::engine::stages::state::State;
use crate::engine::stages::{convolve, evidence, relax};
use crate::engine::vulkan::{Buffer, Device, Image, Texel};

/// Where a pass finds the indirect arguments of its grid, among those of a level.
#[derive(Clone, Copy)]
pub(crate) enum Grid {
    /// Tiles of `linearise`.
    Tiles,
    /// The pixels of one colour.
    Half,
    /// All pixels.
    Pixels,
    /// One workgroup.
    One,
}

/// I1 and I2 on one level.
pub(crate) struct LevelImages {
    /// Luminance of I1 and I2.
    pub(crate) images: [Arc<Image>; 2],
    /// Which of their pixels count, a layer each.
    pub(crate) masks: Arc<Image>,
}

/// All of them. What only lives within a level is as large as the finest and shared: coarser levels use its corner.
pub(crate) struct Workspace {
    /// Finest first.
    pub(crate) levels: Vec<LevelImages>,
    /// V of the levels solved, finest first.
    pub(crate) relative_blur: Vec<Arc<Image>>,
    /// Stacks of blurred images, as spline coefficients: of I1, then of I2. At the end the results stand in the first.
    pub(crate) stacks: Arc<Image>,
    /// Spline of I2.
    pub(crate) spline2: Arc<Image>,
    /// Between the two directions of a separable filter.
    pub(crate) scratch: Arc<Image>,
    /// Linear system for dV: right sides of the red (layer 0) and of the black pixels (layer 1).
    pub(crate) right_sides: Arc<Image>,
    /// Linear system for dV: weights of the right, left, lower and upper neighbour, likewise.
    pub(crate) weights: Arc<Image>,
    /// dV of the red and of the black pixels.
    pub(crate) changes: [Arc<Image>; 2],
    /// What decided V, on every other pixel.
    pub(crate) evidence: Arc<Image>,
    /// The banks of weights.
    pub(crate) filters: Vec<Arc<Buffer>>,
    pub(crate) state: Arc<Buffer>,
    pub(crate) partials: Arc<Buffer>,
    pub(crate) energies: Arc<Buffer>,
    pub(crate) arguments: Arc<Buffer>,
    /// What state and arguments are before a solve, mapped.
    pub(crate) start_state: Arc<Buffer>,
    pub(crate) start_arguments: Arc<Buffer>,
    /// The photographs, mapped.
    pub(crate) frames: [Arc<Buffer>; 2],
    /// A byte a pixel of I1, mapped: 0 where it does not count.
    pub(crate) mask: Arc<Buffer>,
    /// V, its standard deviation, the residual and the fused channels, mapped; then state and energies.
    pub(crate) results: Arc<Buffer>,
    /// State while a level is under way, mapped.
    pub(crate) progress: Arc<Buffer>,
    pub(crate) end_state: Arc<Buffer>,
    pub(crate) end_energies: Arc<Buffer>,
    /// State and energies once the registration is known, mapped.
    pub(crate) registered_state: Arc<Buffer>,
    pub(crate) registered_energies: Arc<Buffer>,
}

impl Workspace {
    pub(crate) fn new(device: &Arc<Device>, plan: &Plan) -> Result<Self, Error> {
        let image = |name: &str, size, layers| Image::new(device, name, size, layers, Texel::One);
        let finest = &plan.pyramid[0];
        let levels = plan
            .pyramid
            .iter()
            .map(|level| {
                let name = |what: &str| format!("{what}, level {}", level.index);
                let images = [image(&name("I1"), level.size, 1)?, image(&name("I2"), level.size, 1)?];
                Ok(LevelImages { images, masks: image(&name("masks"), level.size, 2)? })
            })
            .collect::<Result<_, Error>>()?;
        let relative_blur = plan.pyramid[..plan.solved]
            .iter()
            .map(|level| image(&format!("V, level {}", level.index), level.size, 1))
            .collect::<Result<_, Error>>()?;
        let partial_rows = plan.pyramid.iter().map(|l| l.tiles()[0] * l.tiles()[1]).max().unwrap_or(1);
        let energy_bytes = 4 * plan.solved as u64 * u64::from(plan.settings.outer_iterations);
        let argument_bytes = (4 * ARGUMENT_WORDS * plan.solved) as u64;
        let filters = plan.weights.banks.iter().map(|bank| {
            let buffer = Buffer::for_upload(device, "filters", 4 * convolve::WEIGHTS as u64)?;
            buffer.write(bytemuck::cast_slice(bank))?;
            Ok(buffer)
        });
        let filters = filters.collect::<Result<_, Error>>()?;
        let start_arguments = Buffer::for_upload(device, "indirect arguments at the start", argument_bytes)?;
        Ok(Self {
            levels,
            relative_blur,
            stacks: image("stacks", plan.size, plan.stack_layers())?,
            spline2: image("spline of I2", plan.size, 1)?,
            scratch: image("scratch", plan.size, 1)?,
            right_sides: image("right sides", finest.half(), 2)?,
            weights: Image::new(device, "weights", finest.half(), 2, Texel::Four)?,
            changes: [image("red dV", finest.half(), 1)?, image("black dV", finest.half(), 1)?],
            evidence: image("evidence", evidence::size(plan.size), evidence::LAYERS as u32)?,
            filters,
            state: Buffer::on_device(device, "state", size_of::<State>() as u64)?,
            partials: Buffer::on_device(device, "partial sums", 4 * SUMS as u64 * u64::from(partial_rows))?,
            energies: Buffer::on_device(device, "energies", energy_bytes)?,
            arguments: Buffer::on_device(device, "indirect arguments", argument_bytes)?,
            start_state: Buffer::for_upload(device, "state at the start", size_of::<State>() as u64)?,
            start_arguments,
            frames: [
                Buffer::for_upload(device, "photograph 1", plan.frame_bytes(0))?,
                Buffer::for_upload(device, "photograph 2", plan.frame_bytes(1))?,
            ],
            mask: Buffer::for_upload(device, "mask", plan.mask_bytes())?,
            results: Buffer::for_readback(device, "results", plan.result_bytes())?,
            progress: Buffer::for_readback(device, "state on the way", size_of::<State>() as u64)?,
            end_state: Buffer::for_readback(device, "state at the end", size_of::<State>() as u64)?,
            end_energies: Buffer::for_readback(device, "energies at the end", energy_bytes)?,
            registered_state: Buffer::for_readback(device, "state once registered", size_of::<State>() as u64)?,
            registered_energies: Buffer::for_readback(device, "energies once registered", energy_bytes)?,
        })
    }

    /// Every image, to be made ready once.
    pub(crate) fn images(&self) -> Vec<&Arc<Image>> {
        let levels = self.levels.iter().flat_map(|l| l.images.iter().chain([&l.masks])).chain(&self.relative_blur);
        levels
            .chain([&self.stacks, &self.spline2, &self.scratch, &self.right_sides, &self.weights])
            .chain(&self.changes)
            .chain([&self.evidence])
            .collect()
    }
}

impl Grid {
    /// Byte offset of a level's grid among the indirect arguments.
    pub(crate) fn offset(self, level: usize) -> u64 {
        4 * (level * ARGUMENT_WORDS + 3 * self as usize) as u64
    }

    /// Byte offset of a level's n-th pass among those that bring I2 onto I1's pixels anew.
    pub(crate) fn warp_offset(level: usize, n: usize) -> u64 {
        4 * (level * ARGUMENT_WORDS + GRID_WORDS + 3 * n) as u64
    }
}

/// The grids of every solved level, and of its passes that bring I2 onto I1's pixels anew.
pub(crate) fn arguments(plan: &Plan, warps: &[Vec<[u32; 3]>]) -> Vec<u32> {
    use crate::engine::stages::WORKGROUP;
    let groups = |[width, height]: [u32; 2]| [width.div_ceil(WORKGROUP[0]), height.div_ceil(WORKGROUP[1]), 1];
    plan.pyramid[..plan.solved]
        .iter()
        .flat_map(|level| {
            let grids = [level.tiles(), relax::tiles(level.size), groups(level.size), [1, 1, 1]];
            let mut words = [grids.as_flattened(), warps[level.index].as_flattened()].concat();
            assert!(words.len() <= ARGUMENT_WORDS, "{} warping passes on a level", warps[level.index].len());
            words.resize(ARGUMENT_WORDS, 0);
            words
        })
        .collect()
}
