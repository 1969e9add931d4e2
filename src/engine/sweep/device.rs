//! The memory of a sweep, and on Vulkan devices the command buffers that its scripts are recorded in.

use std::ops::Range;
use std::sync::Arc;

use crate::base::{CancellationToken, Deadline, Error, Frame};
use crate::engine::Engine;
use crate::engine::cpu::sweep::CpuSweep;
use crate::engine::device::AnyDevice;
use crate::engine::plan::Plan;
use crate::engine::record::{Reading, Workspace, record, record_with};
use crate::engine::script::{Script, sweep};
use crate::engine::slot::Slot;
use crate::engine::stages::state::State;
use crate::engine::stages::{Field, Pipelines};
use crate::engine::vulkan::{Buffer, Clock, Device, Recorder, Recording};

/// What ends a solve early.
#[derive(Clone)]
pub(super) struct Limits {
    pub(super) cancel: CancellationToken,
    /// One time limit for all scripts of a solve.
    pub(super) deadline: Deadline,
}

/// Memory for sweeps of one size, format and number of frames.
pub(super) struct SweepDevice {
    pub(super) limits: Limits,
    memory: SweepMemory,
}

enum SweepMemory {
    Vulkan(Box<VulkanSweep>),
    Cpu(Box<CpuSweep>),
}

impl SweepDevice {
    /// Allocates the memory, and records the upload of the frames.
    pub(super) fn new(engine: &Engine, plan: &Plan, frames: u32) -> Result<Self, Error> {
        plan.check_sweep(engine.device(), frames)?;
        let memory = match engine.device() {
            AnyDevice::Vulkan(device, pipelines) => {
                SweepMemory::Vulkan(Box::new(VulkanSweep::new(device, pipelines, plan, frames)?))
            }
            AnyDevice::Cpu(device) => SweepMemory::Cpu(Box::new(CpuSweep::new(device, plan, frames))),
        };
        let deadline = Deadline::after(engine.device().timeout());
        Ok(Self { limits: Limits { cancel: CancellationToken::default(), deadline }, memory })
    }

    /// Uploads the frames and computes their pyramids. The reference sets the unit of intensities.
    pub(super) fn upload_frames(&mut self, frames: &[Frame], reference: usize) -> Result<(), Error> {
        for (part, frame) in std::iter::once(&frames[reference]).chain(frames).enumerate() {
            self.limits.cancel.check()?;
            match &mut self.memory {
                SweepMemory::Vulkan(sweep) => sweep.upload(part, frame, self.limits.deadline)?,
                SweepMemory::Cpu(sweep) => sweep.upload(part, frame, self.limits.deadline)?,
            }
        }
        Ok(())
    }

    /// Writes the words of a buffer: a bit per pixel and frame that does not count, or indirect arguments.
    pub(super) fn write_words(&mut self, slot: Slot, words: &[u32]) -> Result<(), Error> {
        match &mut self.memory {
            SweepMemory::Vulkan(sweep) => sweep.workspace.buffer(slot).write(bytemuck::cast_slice(words)),
            SweepMemory::Cpu(sweep) => {
                sweep.write_words(slot, words);
                Ok(())
            }
        }
    }

    /// `count` partial sums from a place on.
    pub(super) fn partials(&self, first: usize, count: usize) -> Result<Vec<f32>, Error> {
        match &self.memory {
            SweepMemory::Vulkan(sweep) => sweep.workspace.buffer(Slot::Partials).read(4 * first, count),
            SweepMemory::Cpu(sweep) => Ok(sweep.partials(first, count)),
        }
    }

    pub(super) fn run(&mut self, script: &Script) -> Result<(), Error> {
        self.run_after_zeroing(script, 0)
    }

    /// Zeroes the first partial sums, then runs a script.
    pub(super) fn run_after_zeroing(&mut self, script: &Script, floats: usize) -> Result<(), Error> {
        self.limits.cancel.check()?;
        match &mut self.memory {
            SweepMemory::Vulkan(sweep) => sweep.run(script, 4 * floats as u64, self.limits.deadline),
            SweepMemory::Cpu(sweep) => sweep.run(script, floats, &self.limits.cancel, self.limits.deadline),
        }
    }

    /// Reads layers of an image back, each the corner of the given size.
    pub(super) fn read(&mut self, slot: Slot, size: [u32; 2], layers: Range<u32>) -> Result<Vec<Field>, Error> {
        self.limits.cancel.check()?;
        match &mut self.memory {
            SweepMemory::Vulkan(sweep) => sweep.read(slot, size, layers, self.limits.deadline),
            SweepMemory::Cpu(sweep) => Ok(sweep.read(slot, layers)),
        }
    }

    /// Fills the image in a slot.
    pub(super) fn fill(&mut self, slot: Slot, field: &Field) -> Result<(), Error> {
        self.limits.cancel.check()?;
        match &mut self.memory {
            SweepMemory::Vulkan(sweep) => sweep.fill(slot, field, self.limits.deadline),
            SweepMemory::Cpu(sweep) => {
                sweep.fill(slot, field);
                Ok(())
            }
        }
    }
}

/// The memory of a sweep on a Vulkan device.
///
/// Most scripts hold constants of the moment, so each is recorded again. All share one command pool, its descriptor
/// sets and one timeline. The upload of the frames never changes and is recorded once.
struct VulkanSweep {
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
    workspace: Workspace,
    /// Part 0 chooses the unit, part n + 1 uploads frame n.
    upload: Recording,
    /// The latest script or copy, whose memory the next one takes over.
    commands: Option<Recording>,
    /// Mapped memory for images, as large as the largest so far.
    readback: Option<Arc<Buffer>>,
    staging: Option<Arc<Buffer>>,
}

impl VulkanSweep {
    fn new(device: &Arc<Device>, pipelines: &Arc<Pipelines>, plan: &Plan, frames: u32) -> Result<Self, Error> {
        device.check_usable()?;
        let workspace = Workspace::new(device, plan, &plan.sweep_layout(frames))?;
        let mut recorder = Recorder::new(device, Clock::Never)?;
        recorder.initialize(&workspace.images());
        // `unit` writes one member, and `edge_apply` reads another: the correlation of residuals, 0 for a sweep.
        recorder.clear_buffer(workspace.buffer(Slot::State), size_of::<State>() as u64);
        let mut commands = recorder.finish()?;
        commands.run()?;
        let upload = record(device, pipelines, &workspace, &sweep::upload(plan, frames), Reading::Never)?;
        let (device, pipelines, commands) = (device.clone(), pipelines.clone(), Some(commands));
        Ok(Self { device, pipelines, workspace, upload, commands, readback: None, staging: None })
    }

    /// Runs a part of the upload of a frame.
    fn upload(&mut self, part: usize, frame: &Frame, deadline: Deadline) -> Result<(), Error> {
        self.workspace.buffer(Slot::Photograph { image: 0 }).write(frame.bytes())?;
        self.upload.run_part(part, deadline)
    }

    /// Zeroes the first bytes of the partial sums, then runs a script.
    fn run(&mut self, script: &Script, bytes: u64, deadline: Deadline) -> Result<(), Error> {
        self.workspace.buffer(Slot::Tiles).write(bytemuck::cast_slice(&script.tiles))?;
        let mut recorder = self.recorder()?;
        if bytes > 0 {
            recorder.clear_buffer(self.workspace.buffer(Slot::Partials), bytes);
            recorder.barrier();
        }
        let commands = record_with(recorder, &self.pipelines, &self.workspace, script)?;
        self.execute(commands, deadline)
    }

    fn read(
        &mut self,
        slot: Slot,
        [width, height]: [u32; 2],
        layers: Range<u32>,
        deadline: Deadline,
    ) -> Result<Vec<Field>, Error> {
        let image = self.workspace.image(slot).clone();
        let pixels = image.width as usize * image.height as usize;
        let bytes = 4 * (pixels * layers.len()) as u64;
        let buffer = at_least(&mut self.readback, bytes, || Buffer::for_readback(&self.device, "readback", bytes))?;
        let mut recorder = self.recorder()?;
        recorder.copy_image_to_buffer(&image, layers.clone(), &buffer);
        self.execute(recorder.finish()?, deadline)?;
        let layer = |n: usize| {
            let values: Vec<f32> = buffer.read(4 * n * pixels, pixels)?;
            Ok(Field::corner(&values, image.width as usize, [width as usize, height as usize]))
        };
        (0..layers.len()).map(layer).collect()
    }

    fn fill(&mut self, slot: Slot, field: &Field, deadline: Deadline) -> Result<(), Error> {
        let values = field.to_f32();
        let bytes = 4 * values.len() as u64;
        let buffer = at_least(&mut self.staging, bytes, || Buffer::for_upload(&self.device, "staging", bytes))?;
        buffer.write(bytemuck::cast_slice(&values))?;
        let mut recorder = self.recorder()?;
        recorder.copy_buffer_to_image(&buffer, self.workspace.image(slot));
        self.execute(recorder.finish()?, deadline)
    }

    /// Begins the next recording, in the memory of the latest one.
    fn recorder(&mut self) -> Result<Recorder, Error> {
        self.commands.take().map_or_else(|| Recorder::new(&self.device, Clock::Never), Recorder::reusing)
    }

    fn execute(&mut self, commands: Recording, deadline: Deadline) -> Result<(), Error> {
        self.commands.insert(commands).run_within(deadline)
    }
}

/// The buffer, replaced by a new one if it holds fewer bytes.
fn at_least(
    buffer: &mut Option<Arc<Buffer>>,
    bytes: u64,
    allocate: impl FnOnce() -> Result<Arc<Buffer>, Error>,
) -> Result<Arc<Buffer>, Error> {
    match buffer.take().filter(|buffer| buffer.size() >= bytes) {
        Some(large) => Ok(buffer.insert(large).clone()),
        None => Ok(buffer.insert(allocate()?).clone()),
    }
}
