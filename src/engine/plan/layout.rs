//! The images and buffers of a solver with their sizes, and checks of these against a device's limits.

use super::{Plan, SCRATCH_LAYERS};
use crate::base::{DeviceInfo, Error};
use crate::engine::arguments;
use crate::engine::device::AnyDevice;
use crate::engine::slot::Slot;
use crate::engine::stages::state::State;
use crate::engine::stages::sums::Layout;
use crate::engine::stages::{
    edge, exposure, grid, half_pair, lens_windows, linearise, parallax_windows, pixels, separable, system,
    system_tiles, uncertainty_terms,
};
use crate::engine::tiles;
use crate::engine::vulkan::{MIB, Texel, image_limits};

/// An image or a buffer to be allocated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Allocation {
    pub(crate) slot: Slot,
    pub(crate) kind: AllocationKind,
}

/// What is allocated, and its size.
#[derive(Clone, Copy, Debug)]
pub(crate) enum AllocationKind {
    Image { size: [u32; 2], layers: u32, texel: Texel },
    Buffer { bytes: u64, host: HostAccess },
}

/// How the host accesses a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HostAccess {
    /// Not at all.
    None,
    /// Writes.
    Upload,
    /// Writes, and reads what it wrote.
    Exchange,
    /// Reads.
    Readback,
    /// Reads, and borrows its memory to the caller.
    Results,
}

impl Allocation {
    /// Bytes of the texels or of the buffer.
    pub(crate) fn bytes(&self) -> u64 {
        match self.kind {
            AllocationKind::Image { layers, .. } => u64::from(layers) * self.layer_bytes(),
            AllocationKind::Buffer { bytes, .. } => bytes,
        }
    }

    /// Bytes of a layer of the image, or of the buffer.
    pub(crate) fn layer_bytes(&self) -> u64 {
        match self.kind {
            AllocationKind::Image { size: [width, height], texel, .. } => {
                let bytes = if texel == Texel::One { 4 } else { 8 };
                bytes * pixels(width, height)
            }
            AllocationKind::Buffer { bytes, .. } => bytes,
        }
    }

    /// Whether it counts in a budget of memory: it has a value for each pixel. Sums, states, arguments, filters and
    /// lists of tiles are left out; of a pair they are under 0.2 %. Budgets decide into which parts a pair or a sweep
    /// is split.
    fn is_budgeted(&self) -> bool {
        use Slot::{EndMaps, GridEquations, GridSteps, Hidden, Mask, Packed, Photograph};
        let pixels = matches!(
            self.slot,
            Photograph { .. } | Packed { .. } | Mask | EndMaps | Hidden | GridEquations | GridSteps
        );
        pixels || matches!(self.kind, AllocationKind::Image { .. })
    }

    /// Whether it is a buffer that the host accesses.
    pub(crate) fn is_mapped(&self) -> bool {
        matches!(self.kind, AllocationKind::Buffer { host, .. } if host != HostAccess::None)
    }
}

fn image(slot: Slot, size: [u32; 2], layers: u32) -> Allocation {
    Allocation { slot, kind: AllocationKind::Image { size, layers, texel: Texel::One } }
}

fn buffer(slot: Slot, bytes: u64, host: HostAccess) -> Allocation {
    Allocation { slot, kind: AllocationKind::Buffer { bytes, host } }
}

impl Plan {
    /// Bytes of a frame as it is uploaded.
    pub(crate) fn packed_bytes(&self, frame: usize) -> u64 {
        self.packed[frame].bytes(self.size)
    }

    /// Bytes of a frame once it is unpacked.
    pub(crate) fn frame_bytes(&self, frame: usize) -> u64 {
        let format = self.formats[frame];
        self.pixels() * u64::from(format.channels.count() * format.depth.bytes())
    }

    /// Bytes of the mask of I1, a whole number of words.
    pub(crate) fn mask_bytes(&self) -> u64 {
        self.pixels().next_multiple_of(4)
    }

    pub(super) fn pixels(&self) -> u64 {
        pixels(self.size[0], self.size[1])
    }

    /// Everything that a solver of pairs keeps. What lives only within a level is as large as the finest one and
    /// shared: coarser levels use its corner.
    pub(crate) fn pair_layout(&self) -> Vec<Allocation> {
        use HostAccess::{Exchange, None, Readback, Results, Upload};
        let mut list = self.common_layout();
        list.extend([
            image(Slot::Stacks, self.size, self.stack_layers()),
            image(Slot::NormalEquations, self.size, linearise::LAYERS),
            image(Slot::UncertaintyTerms, uncertainty_terms::size(self.size), uncertainty_terms::STORED as u32),
        ]);
        for level in &self.pyramid {
            list.extend([0, 1].map(|image| self::image(Slot::Luminance { image, level: level.index }, level.size, 1)));
            list.push(image(Slot::Masks { level: level.index }, level.size, 2));
        }
        let rows = self.pyramid.iter().map(|l| l.tiles()[0] * l.tiles()[1]).max().unwrap_or(1);
        let row = 4 * Layout::of(true).length as u64;
        let samples = self.pyramid.iter().map(|level| exposure::bytes_of_samples(level.size)).max().unwrap_or(0);
        let partials = (row * u64::from(rows)).max(4 * lens_windows::FLOATS.max(parallax_windows::FLOATS)).max(samples);
        let energies = 4 * self.solved as u64 * u64::from(self.settings.outer_iterations);
        let arguments = arguments::bytes(self.solved);
        let state = size_of::<State>() as u64;
        list.extend([
            self.photograph(1),
            buffer(Slot::Mask, self.mask_bytes(), Upload),
            buffer(Slot::Partials, partials, None),
            buffer(Slot::Energies, energies, None),
            buffer(Slot::Arguments, arguments, None),
            buffer(Slot::StartState, state, Upload),
            buffer(Slot::StartArguments, arguments, Upload),
            // Pairs list no tiles.
            buffer(Slot::Tiles, 4, Upload),
            buffer(Slot::EndMaps, 4 * self.pixels() * u64::from(self.map_layers()), Results),
            buffer(Slot::Progress, state, Readback),
            buffer(Slot::EndPartials, partials, Readback),
            buffer(Slot::EndState, state, Readback),
            buffer(Slot::EndEnergies, energies, Readback),
            buffer(Slot::RegisteredState, state, Readback),
            buffer(Slot::RegisteredEnergies, energies, Readback),
        ]);
        let packed = [0, 1].into_iter().filter(|&image| self.unpacks(image));
        list.extend(packed.map(|image| buffer(Slot::Packed { image }, self.packed_bytes(image), Exchange)));
        list
    }

    /// Everything that a solver of sweeps of `frames` frames keeps. Each frame is kept as it is and on the reference's
    /// pixels.
    pub(crate) fn sweep_layout(&self, frames: u32) -> Vec<Allocation> {
        let mut list = self.common_layout();
        list.extend([
            // At the end the first layers are those of the passes over edges.
            image(Slot::Stacks, self.size, self.layers_of(&self.pyramid[0]).max(edge::LAYERS)),
            image(Slot::NormalEquations, self.size, half_pair::LAYERS),
            image(Slot::Luminance { image: 0, level: 0 }, self.size, 1),
            image(Slot::Aligned, self.size, frames),
            // `relax_tiles` binds it; steps of sweeps are not kept.
            image(Slot::UncertaintyTerms, [1; 2], uncertainty_terms::STORED as u32),
        ]);
        list.extend(self.pyramid.iter().map(|level| image(Slot::Frames { level: level.index }, level.size, frames)));
        // The sums of all half-pairs, four of a frame at most on either side, and of parallax as many again.
        let [columns, rows, _] = half_pair::tiles(self.size);
        let row = 4 * Layout::of(self.projective()).length as u64;
        let half_pairs = 16 * u64::from(frames) * u64::from(columns * rows) * row;
        let [columns, rows, _] = system_tiles::tiles(self.size);
        let steps = 4 * (system::SUMS as u64) * u64::from(columns * rows);
        // A bit a frame.
        let hidden = 4 * u64::from(frames.div_ceil(32)) * self.pixels();
        list.extend([
            buffer(Slot::Partials, half_pairs.max(steps), HostAccess::Readback),
            buffer(Slot::Tiles, 4 * tiles::capacity(self.size, frames), HostAccess::Upload),
            buffer(Slot::Hidden, hidden, HostAccess::Upload),
            buffer(Slot::Arguments, arguments::bytes(0), HostAccess::Upload),
        ]);
        list
    }

    fn common_layout(&self) -> Vec<Allocation> {
        let (half, cells) = (self.pyramid[0].half(), grid::cells(self.size));
        let steps = self.pyramid.iter().map(|level| self.grid_steps(level)).max().unwrap_or(cells);
        let mut list = vec![
            image(Slot::Spline2, self.size, 1),
            image(Slot::Scratch, self.size, SCRATCH_LAYERS),
            Allocation {
                slot: Slot::Weights,
                kind: AllocationKind::Image { size: half, layers: 2, texel: Texel::FourHalf },
            },
            buffer(Slot::GridEquations, 4 * grid::FLOATS as u64 * cells, HostAccess::None),
            buffer(Slot::GridSteps, 4 * steps, HostAccess::None),
            buffer(Slot::State, size_of::<State>() as u64, HostAccess::None),
            self.photograph(0),
        ];
        let solved = &self.pyramid[..self.solved];
        list.extend(solved.iter().map(|level| image(Slot::RelativeBlur { level: level.index }, level.size, 1)));
        let weights = 4 * separable::WEIGHTS as u64;
        list.extend(
            (0..self.weights.banks.len()).map(|bank| buffer(Slot::Filters { bank }, weights, HostAccess::Upload)),
        );
        list
    }

    /// Mapped, unless the device unpacks it from a mapped buffer.
    fn photograph(&self, image: usize) -> Allocation {
        let host = if self.unpacks(image) { HostAccess::None } else { HostAccess::Exchange };
        buffer(Slot::Photograph { image }, self.frame_bytes(image), host)
    }

    /// The budget of a solver of pairs: bytes on the device, and bytes that the host accesses.
    pub(crate) fn bytes(&self) -> (u64, u64) {
        let list = self.pair_layout();
        let budgeted = || list.iter().filter(|allocation| allocation.is_budgeted());
        let mapped: u64 = budgeted().filter(|allocation| allocation.is_mapped()).map(Allocation::bytes).sum();
        (budgeted().map(Allocation::bytes).sum::<u64>() - mapped, mapped)
    }

    /// The budget of a solver of sweeps of `frames` frames, bytes.
    pub(crate) fn sweep_bytes(&self, frames: u32) -> u64 {
        self.sweep_layout(frames).iter().filter(|allocation| allocation.is_budgeted()).map(Allocation::bytes).sum()
    }

    /// Checks that a device can solve sweeps of `frames` frames.
    pub(crate) fn check_sweep(&self, device: &AnyDevice, frames: u32) -> Result<(), Error> {
        self.check_photographs(device.info())?;
        let names = ["the frames of a sweep", "a sweep", "a sweep"];
        self.check_limits(device, &self.sweep_layout(frames), names, &format!("{frames} frames"))?;
        let (needed, limit) = (self.sweep_bytes(frames), device.info().memory_bytes);
        if needed > limit {
            return Err(self.too_large(device.info(), "the sweep", mib(needed), format!("{} in all", mib(limit))));
        }
        Ok(())
    }

    /// Checks a solver of pairs with `slots` slots against a device's limits and against `memory` bytes, so that
    /// nothing fails half-way.
    pub(crate) fn check(&self, device: &AnyDevice, memory: u64, slots: u64) -> Result<(), Error> {
        self.check_photographs(device.info())?;
        let names = ["the stacks of blurred images", "the stacks of blurred images", "the result"];
        let layers = format!("{} layers", self.stack_layers());
        self.check_limits(device, &self.pair_layout(), names, &layers)?;
        self.check_memory(device.info(), memory, slots)
    }

    /// Checks the largest image and the largest buffer against a device's limits. `names` are those of the largest
    /// image, of the image with the most layers and of the largest buffer.
    fn check_limits(
        &self,
        device: &AnyDevice,
        list: &[Allocation],
        [image, layered, buffer]: [&'static str; 3],
        layers_in_words: &str,
    ) -> Result<(), Error> {
        let too_large = |what, needed, limit| Err(self.too_large(device.info(), what, needed, limit));
        let (mut image_bytes, mut buffer_bytes, mut most_layers) = (0, 0, 0);
        for allocation in list {
            match allocation.kind {
                AllocationKind::Image { layers, .. } => {
                    image_bytes = allocation.bytes().max(image_bytes);
                    most_layers = layers.max(most_layers);
                }
                AllocationKind::Buffer { bytes, .. } => buffer_bytes = bytes.max(buffer_bytes),
            }
        }
        let Some(device) = device.as_vulkan() else { return Ok(()) };
        let (largest, layers) = image_limits(device)?;
        let (allocation, largest_buffer) = device.allocation_limits();
        if most_layers > layers {
            return too_large(layered, layers_in_words.to_string(), format!("{layers}"));
        }
        let largest = largest.min(allocation);
        if image_bytes > largest {
            return too_large(image, mib(image_bytes), format!("{} for an image", mib(largest)));
        }
        let largest = largest_buffer.min(allocation);
        if buffer_bytes > largest {
            return too_large(buffer, mib(buffer_bytes), format!("{} for a buffer", mib(largest)));
        }
        Ok(())
    }

    /// Checks the photographs against the limits that a description of a device states.
    fn check_photographs(&self, info: &DeviceInfo) -> Result<(), Error> {
        let longest = self.size[0].max(self.size[1]);
        if longest > info.max_image_size {
            let limit = format!("{} px", info.max_image_size);
            return Err(self.too_large(info, "the longer side", format!("{longest} px"), limit));
        }
        let upload = [0, 1].map(|n| self.frame_bytes(n).max(self.packed_bytes(n)));
        let upload = upload[0].max(upload[1]);
        if upload > info.max_storage_buffer {
            let limit = format!("{} for a buffer", mib(info.max_storage_buffer));
            return Err(self.too_large(info, "one photograph", mib(upload), limit));
        }
        let grids = 4 * grid::FLOATS as u64 * grid::cells(self.size);
        if grids > info.max_storage_buffer {
            let limit = format!("{} for a buffer", mib(info.max_storage_buffer));
            return Err(self.too_large(info, "the linear system of the cascade", mib(grids), limit));
        }
        Ok(())
    }

    /// Checks the memory that a solver of pairs needs against that of a device and against `memory` bytes.
    fn check_memory(&self, info: &DeviceInfo, memory: u64, slots: u64) -> Result<(), Error> {
        let (on_device, host) = self.bytes();
        // A discrete GPU keeps mapped buffers in the host's memory; other devices have one memory for both.
        let needed =
            if info.kind == "discrete GPU" { on_device } else { on_device.saturating_add(slots.saturating_mul(host)) };
        let limit = memory.min(info.memory_bytes);
        if needed > limit {
            return Err(self.too_large(info, "the solve", mib(needed), format!("{} in all", mib(limit))));
        }
        Ok(())
    }

    /// Checks the plan against a description of a device.
    pub(crate) fn check_described(&self, info: &DeviceInfo) -> Result<(), Error> {
        self.check_photographs(info).and_then(|()| self.check_memory(info, u64::MAX, 1))
    }

    fn too_large(&self, info: &DeviceInfo, what: &'static str, needed: String, limit: String) -> Error {
        let [width, height] = self.size;
        Error::TooLarge { width, height, device: info.name.clone(), what, needed, limit }
    }
}

fn mib(bytes: u64) -> String {
    format!("{} MiB", bytes.div_ceil(MIB))
}
