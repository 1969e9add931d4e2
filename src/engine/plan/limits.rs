//! What a solve takes, and whether a device has it.

use super::Plan;
use crate::base::{DeviceInfo, Error};
use crate::engine::stages::{self, half_pair, linearise, uncertainty_terms};
use crate::engine::vulkan::{Device, MIB, image_limits};

impl Plan {
    /// Bytes of a frame as it is brought up.
    pub(crate) fn packed_bytes(&self, frame: usize) -> u64 {
        self.packed[frame].bytes(self.size)
    }

    /// Bytes of a frame once it is unpacked.
    pub(crate) fn frame_bytes(&self, frame: usize) -> u64 {
        let format = self.formats[frame];
        pixels(self.size) * u64::from(format.channels.count() * format.depth.bytes())
    }

    /// Bytes of the mask of I1, a whole number of words.
    pub(crate) fn mask_bytes(&self) -> u64 {
        pixels(self.size).next_multiple_of(4)
    }

    /// Bytes of the results on their way down.
    pub(crate) fn result_bytes(&self) -> u64 {
        4 * pixels(self.size) * u64::from(self.map_layers())
    }

    /// Bytes on the device, and bytes that the host sees.
    pub(crate) fn bytes(&self) -> (u64, u64) {
        let pyramid: u64 = self.pyramid.iter().map(|l| pixels(l.size)).sum();
        let solved: u64 = self.pyramid[..self.solved].iter().map(|l| pixels(l.size)).sum();
        let full = pixels(self.size);
        let half = pixels([self.size[0].div_ceil(2), self.size[1]]);
        let stacks = u64::from(self.stack_layers());
        let evidence = uncertainty_terms::LAYERS as u64 * pixels(uncertainty_terms::size(self.size));
        let equations = u64::from(linearise::LAYERS);
        // Of either colour: right sides, four weights of half a float, dV.
        let floats = evidence + 4 * pyramid + solved + (2 + stacks + equations) * full + 2 * (1 + 2 + 1) * half;
        let brought = self.packed_bytes(0) + self.packed_bytes(1);
        let unpacked: u64 = [0, 1].into_iter().filter(|&n| self.unpacks(n)).map(|n| self.frame_bytes(n)).sum();
        (4 * floats + unpacked, brought + self.mask_bytes() + self.result_bytes())
    }

    /// Bytes of which frames of a sweep do not count where, a bit each.
    pub(crate) fn hidden_bytes(&self, frames: u32) -> u64 {
        4 * u64::from(frames.div_ceil(32)) * pixels(self.size)
    }

    /// Bytes on the device, and mapped, of a sweep of so many frames, each of which is kept as it is and on the reference's pixels.
    pub(crate) fn sweep_bytes(&self, frames: u32) -> u64 {
        let pyramid: u64 = self.pyramid.iter().map(|l| pixels(l.size)).sum();
        let full = pixels(self.size);
        let half = pixels([self.size[0].div_ceil(2), self.size[1]]);
        // Spline, scratch, luminance; of either colour right sides, four weights of half a float, du.
        let alone = u64::from(self.layers_of(&self.pyramid[0]) + half_pair::LAYERS) + 3;
        let floats = u64::from(frames) * (pyramid + full) + pyramid + alone * full + 2 * (1 + 2 + 1) * half;
        4 * floats + self.frame_bytes(0) + self.hidden_bytes(frames)
    }

    /// Checks that a device takes sweeps of so many frames.
    pub(crate) fn check_sweep(&self, device: &Device, frames: u32) -> Result<(), Error> {
        self.check_photographs(device.info())?;
        let too_large = |what, needed, limit| Err(self.too_large(device.info(), what, needed, limit));
        let (largest, layers) = image_limits(device)?;
        if frames > layers {
            return too_large("a sweep", format!("{frames} frames"), format!("{layers}"));
        }
        let (allocation, buffer) = device.allocation_limits();
        let largest = largest.min(allocation);
        let image = 4 * pixels(self.size) * u64::from(frames.max(self.layers_of(&self.pyramid[0])));
        if image > largest {
            return too_large("the frames of a sweep", mib(image), format!("{} for an image", mib(largest)));
        }
        let largest = buffer.min(allocation);
        if self.hidden_bytes(frames) > largest {
            return too_large("a sweep", mib(self.hidden_bytes(frames)), format!("{} for a buffer", mib(largest)));
        }
        let (needed, limit) = (self.sweep_bytes(frames), device.info().memory_bytes);
        if needed > limit {
            return too_large("the sweep", mib(needed), format!("{} in all", mib(limit)));
        }
        Ok(())
    }

    /// Checks the plan against a device's limits, and against so many bytes of it, so that nothing fails half-way, of a solver with so many slots.
    pub(crate) fn check(&self, device: &Device, memory: u64, slots: u64) -> Result<(), Error> {
        let info = device.info();
        let too_large = |what, needed, limit| Err(self.too_large(info, what, needed, limit));
        self.check_photographs(info)?;
        let (largest, layers) = image_limits(device)?;
        let stack = 4 * pixels(self.size) * u64::from(self.stack_layers());
        if self.stack_layers() > layers {
            return too_large(
                "the stacks of blurred images",
                format!("{} layers", self.stack_layers()),
                format!("{layers}"),
            );
        }
        let (allocation, buffer) = device.allocation_limits();
        let largest = largest.min(allocation);
        if stack > largest {
            return too_large("the stacks of blurred images", mib(stack), format!("{} for an image", mib(largest)));
        }
        let largest = buffer.min(allocation);
        if self.result_bytes() > largest {
            return too_large("the result", mib(self.result_bytes()), format!("{} for a buffer", mib(largest)));
        }
        self.check_memory(info, memory, slots)
    }

    /// Checks what a description of a device tells of each photograph.
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
        Ok(())
    }

    /// Checks what it tells of the memory that there is.
    fn check_memory(&self, info: &DeviceInfo, memory: u64, slots: u64) -> Result<(), Error> {
        let (on_device, host) = self.bytes();
        // A discrete GPU keeps what the host sees in the host's memory; the others have one memory for both.
        let needed =
            if info.kind == "discrete GPU" { on_device } else { on_device.saturating_add(slots.saturating_mul(host)) };
        let limit = memory.min(info.memory_bytes);
        if needed > limit {
            return Err(self.too_large(info, "the solve", mib(needed), format!("{} in all", mib(limit))));
        }
        Ok(())
    }

    /// Checks the plan against a description of a device: what no device like it could do.
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

fn pixels([width, height]: [u32; 2]) -> u64 {
    stages::pixels(width, height)
}
