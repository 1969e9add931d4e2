//! The device memory of a sweep, and the command buffers that its scripts are recorded in.

use std::ops::Range;
use std::sync::Arc;

use crate::base::{CancellationToken, Deadline, Error, Frame};
use crate::engine::Engine;
use crate::engine::plan::Plan;
use crate::engine::record::{Reading, Workspace, record, record_with};
use crate::engine::script::{Script, sweep};
use crate::engine::slot::Slot;
use crate::engine::stages::{Field, Pipelines};
use crate::engine::vulkan::{Buffer, Clock, Device, Recorder, Recording};

/// What ends a solve early.
#[derive(Clone)]
pub(super) struct Limits {
    pub(super) cancel: CancellationToken,
    /// One time limit for all scripts of a solve.
    pub(super) deadline: Deadline,
}

/// Device memory for sweeps of one size, format and number of frames.
///
/// Most scripts hold constants of the moment, so each is recorded again. All share one command pool, its descriptor
/// sets and one timeline. The upload of the frames never changes and is recorded once.
pub(super) struct SweepDevice {
    pub(super) limits: Limits,
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
    workspace: Workspace,
    /// Part n uploads frame n.
    upload: Recording,
    /// The latest script or copy, whose memory the next one takes over.
    commands: Option<Recording>,
    /// Mapped memory for images, as large as the largest so far.
    readback: Option<Arc<Buffer>>,
    staging: Option<Arc<Buffer>>,
}

impl SweepDevice {
    /// Allocates the memory, and records the upload of the frames.
    pub(super) fn new(engine: &Engine, plan: &Plan, frames: u32) -> Result<Self, Error> {
        let (device, pipelines) = (engine.device().clone(), engine.pipelines().clone());
        device.check_usable()?;
        plan.check_sweep(&device, frames)?;
        let workspace = Workspace::new(&device, plan, &plan.sweep_layout(frames))?;
        let mut recorder = Recorder::new(&device, Clock::Never)?;
        recorder.initialize(&workspace.images());
        let mut commands = recorder.finish()?;
        commands.run()?;
        let upload = record(&device, &pipelines, &workspace, &sweep::upload(plan, frames), Reading::Never)?;
        let limits = Limits { cancel: CancellationToken::default(), deadline: Deadline::after(device.timeout()) };
        let commands = Some(commands);
        Ok(Self { limits, device, pipelines, workspace, upload, commands, readback: None, staging: None })
    }

    /// Uploads the frames and computes their pyramids.
    pub(super) fn upload_frames<'a>(&mut self, frames: impl Iterator<Item = &'a Frame>) -> Result<(), Error> {
        for (n, frame) in frames.enumerate() {
            self.limits.cancel.check()?;
            self.buffer(Slot::Photograph { image: 0 }).write(frame.bytes())?;
            self.upload.run_part(n, self.limits.deadline)?;
        }
        Ok(())
    }

    /// The buffer in a slot.
    pub(super) fn buffer(&self, slot: Slot) -> &Buffer {
        self.workspace.buffer(slot)
    }

    /// Runs a script.
    pub(super) fn run(&mut self, script: &Script) -> Result<(), Error> {
        self.run_after_zeroing(script, 0)
    }

    /// Zeroes the first bytes of the partial sums, then runs a script.
    pub(super) fn run_after_zeroing(&mut self, script: &Script, bytes: u64) -> Result<(), Error> {
        self.buffer(Slot::Tiles).write(bytemuck::cast_slice(&script.tiles))?;
        let mut recorder = self.recorder()?;
        if bytes > 0 {
            recorder.clear_buffer(self.workspace.buffer(Slot::Partials), bytes);
            recorder.barrier();
        }
        let commands = record_with(recorder, &self.pipelines, &self.workspace, script)?;
        self.execute(commands)
    }

    /// Reads layers of an image back, each the corner of the given size.
    pub(super) fn read(
        &mut self,
        slot: Slot,
        [width, height]: [u32; 2],
        layers: Range<u32>,
    ) -> Result<Vec<Field>, Error> {
        let image = self.workspace.image(slot).clone();
        let pixels = image.width as usize * image.height as usize;
        let bytes = 4 * (pixels * layers.len()) as u64;
        let buffer = at_least(&mut self.readback, bytes, || Buffer::for_readback(&self.device, "readback", bytes))?;
        let mut recorder = self.recorder()?;
        recorder.copy_image_to_buffer(&image, layers.clone(), &buffer);
        self.execute(recorder.finish()?)?;
        let layer = |n: usize| {
            let values: Vec<f32> = buffer.read(4 * n * pixels, pixels)?;
            Ok(Field::corner(&values, image.width as usize, [width as usize, height as usize]))
        };
        (0..layers.len()).map(layer).collect()
    }

    /// Fills the image in a slot.
    pub(super) fn fill(&mut self, slot: Slot, field: &Field) -> Result<(), Error> {
        let values = field.to_f32();
        let bytes = 4 * values.len() as u64;
        let buffer = at_least(&mut self.staging, bytes, || Buffer::for_upload(&self.device, "staging", bytes))?;
        buffer.write(bytemuck::cast_slice(&values))?;
        let mut recorder = self.recorder()?;
        recorder.copy_buffer_to_image(&buffer, self.workspace.image(slot));
        self.execute(recorder.finish()?)
    }

    /// Begins the next recording, in the memory of the latest one.
    fn recorder(&mut self) -> Result<Recorder, Error> {
        self.limits.cancel.check()?;
        self.commands.take().map_or_else(|| Recorder::new(&self.device, Clock::Never), Recorder::reusing)
    }

    fn execute(&mut self, commands: Recording) -> Result<(), Error> {
        self.commands.insert(commands).run_within(self.limits.deadline)
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
