//! One pair on its way through a solver: mapped memory of its own, and recordings that use it. What only the device sees is shared by all.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::OtherMotion;
use super::cancel_flag::CancelFlag;
use super::motion::Form;
use super::plan::Plan;
use super::profile::{Phases, Profile, Ran, Reading, SUBMIT_WAIT};
use super::progress::Progress;
use super::record::{record, record_with};
use super::registered::Registered;
use super::script::{Dispatch, Script, compose};
use super::slot::Slot;
use super::solution::{Counts, Findings, LevelHistory, Timings};
use super::solution_ref::SolutionRef;
use super::stages::Pipelines;
use super::stages::state::{Registration, State};
use super::stages::sums::{Layout, Sums};
use super::vulkan::{
    Buffer, Clock, Device, DeviceSolution, ExternalCommandBuffer, Recorder, Recording, SemaphoreWait, SourceCopy,
};
use super::workspace::Workspace;
use crate::base::{
    CancelSignal, CancellationToken, Deadline, Error, Homography, Kernel, Mask, Photometric, Region, Shading,
};

/// A script, and its recording.
struct Prepared {
    script: Script,
    recording: Recording,
}

/// Where a pair starts; T, gain, offset and shading stay there where they are not solved for.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub(super) transform: Homography,
    pub(super) photometric: Photometric,
    pub(super) shading: Shading,
    pub(super) kernel_shape: f64,
}

/// What all lanes of a solver share.
pub(super) struct Common {
    pub(super) plan: Plan,
    pub(super) device: Arc<Device>,
    pub(super) pipelines: Arc<Pipelines>,
    pub(super) reading: Reading,
}

/// One pair on its way.
pub(super) struct FrameInFlight {
    common: Arc<Common>,
    workspace: Workspace,
    /// What the latest pair takes.
    latest: Prepared,
    /// Whether that has masked or clipped pixels.
    is_masked: bool,
    /// What pairs of the other kind take, once it is recorded.
    other: Option<Prepared>,
    started: Instant,
    /// When the latest pair has taken too long.
    deadline: Deadline,
    phases: Phases,
    /// What has the device fetch photographs of the latest pair.
    fetching: Option<Recording>,
    /// What was recorded into a command buffer of someone else's for it.
    encoded: Option<Recording>,
    /// What the timeline of the latest recording reaches when the pair that was submitted is solved.
    under_way: Option<u64>,
    /// Pairs so far.
    pairs: u64,
    /// Whether the latest is fetched by the device.
    fetches: bool,
    /// What calls the latest off, and is told to.
    call: Arc<CancelFlag>,
    signal: Arc<CancelSignal>,
}

impl Drop for FrameInFlight {
    fn drop(&mut self) {
        self.call.end();
    }
}

impl FrameInFlight {
    /// Prepared for pairs with masked or clipped pixels, or for those without; by `None` for both, and neither kind's first waits.
    pub(super) fn new(common: Arc<Common>, workspace: Workspace, is_masked: Option<bool>) -> Result<Self, Error> {
        let prepared = |is_masked| prepared(&common, &workspace, is_masked);
        let other = if is_masked.is_none() { Some(prepared(true)?) } else { None };
        let is_masked = is_masked.unwrap_or(false);
        let latest = prepared(is_masked)?;
        let (started, phases) = (Instant::now(), Phases::default());
        let call = CancelFlag::of(workspace.buffer(Slot::StartArguments), &common.plan);
        let signal = call.signal();
        let (under_way, pairs) = (None, 0);
        let deadline = Deadline::after(common.device.timeout());
        Ok(Self {
            common,
            workspace,
            latest,
            is_masked,
            other,
            started,
            deadline,
            phases,
            fetching: None,
            encoded: None,
            under_way,
            pairs,
            fetches: false,
            call,
            signal,
        })
    }

    /// Which pair the latest is, counted from 1.
    pub(super) fn pairs(&self) -> u64 {
        self.pairs
    }

    /// A new pair comes, which may be called off: what was under way is waited for.
    pub(super) fn begin(&mut self, cancel: &CancellationToken) -> Result<(), Error> {
        self.rest()?;
        // Whatever comes of it, results of the one before are no more asked for.
        self.pairs += 1;
        self.fetches = false;
        self.call.end();
        let words = self.workspace.buffer(Slot::StartArguments);
        self.call = CancelFlag::of(words, &self.common.plan);
        self.signal = self.call.signal();
        self.call.go_on(words)?;
        cancel.register(&self.signal);
        cancel.check()
    }

    /// Calls the latest pair off.
    pub(super) fn cancel(&self) {
        self.call.cancel();
    }

    /// Waits for what is under way.
    pub(super) fn rest(&mut self) -> Result<(), Error> {
        self.wait(Duration::MAX)?;
        if self.common.device.is_poisoned() {
            return Err(Error::Poisoned);
        }
        self.is_taken(Duration::MAX)?;
        self.deadline = Deadline::after(self.common.device.timeout());
        (self.started, self.phases) = (Instant::now(), Phases::default());
        Ok(())
    }

    /// Where a photograph is brought to.
    pub(super) fn entry(&self, image: usize) -> &Arc<Buffer> {
        self.workspace.buffer(self.common.plan.entry(image))
    }

    /// Has a photograph written where the device reads it; nothing may be under way.
    pub(super) fn fill(&self, image: usize, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        self.entry(image).write_with(write)
    }

    /// A byte a pixel, of all lanes.
    pub(super) fn mask(&self) -> &Buffer {
        self.workspace.buffer(Slot::Mask)
    }

    /// Takes the pair that was brought up: where it starts, and whether some of its pixels are masked or clipped.
    pub(super) fn take(&mut self, start: &Start, is_masked: bool) -> Result<(), Error> {
        self.phases.end("upload");
        let settings = &self.common.plan.settings;
        let mut state = State::new(&Registration::new(start.transform, &start.photometric));
        state.shading = start.shading.coefficients.map(|c| c as f32);
        state.kernel_shape = start.kernel_shape as f32;
        state.alpha = settings.regularization.map_or(state.alpha, |alpha| alpha as f32);
        self.workspace.buffer(Slot::StartState).write(bytemuck::bytes_of(&state))?;
        if self.is_masked != is_masked {
            let next = self.other.take().map_or_else(|| prepared(&self.common, &self.workspace, is_masked), Ok)?;
            self.other = Some(std::mem::replace(&mut self.latest, next));
            self.is_masked = is_masked;
        }
        self.encoded = None;
        self.phases.end("start");
        Ok(())
    }

    /// Has the device fetch photographs, once what is waited for has happened; before the pair is handed over.
    pub(super) fn fetch(&mut self, fetches: &[(usize, SourceCopy)], waits: &[SemaphoreWait]) -> Result<(), Error> {
        let mut recorder = Recorder::new(&self.common.device, Clock::Never)?;
        for (image, fetch) in fetches {
            recorder.copy_source(fetch, self.entry(*image));
        }
        let (recording, earlier) = (recorder.finish()?, self.fetching.take());
        // What waits for the timeline may still be pending on another queue: it lives as long as the lane.
        let recording = if let Some(earlier) = earlier { recording.with_timeline_of(earlier) } else { recording };
        self.fetching.insert(recording).submit(1, waits)?;
        self.fetches = true;
        Ok(())
    }

    /// Hands it to the device, and does not wait for it; on a device that has to be asked while it works, does.
    pub(super) fn submit(&mut self, waits: &[SemaphoreWait]) -> Result<(), Error> {
        let parts = self.latest.script.parts.len();
        if self.latest.recording.has_optional_parts() {
            // What is waited for begins a submission of its own.
            if !waits.is_empty() {
                self.fetch(&[], waits)?;
            }
            return self.run(|script| script.parts.len(), &mut |_| ());
        }
        self.under_way = Some(self.latest.recording.submit(parts, waits)?);
        Ok(())
    }

    /// Records it, with what fetches its photographs, into a command buffer of someone else's.
    pub(super) fn encode(
        &mut self,
        commands: ExternalCommandBuffer,
        fetches: &[(usize, SourceCopy)],
    ) -> Result<(), Error> {
        let mut recorder = Recorder::into_external(&self.common.device, commands);
        for (image, fetch) in fetches {
            recorder.copy_source(fetch, self.entry(*image));
        }
        recorder.barrier();
        self.encoded = Some(record_with(recorder, &self.common.pipelines, &self.workspace, &self.latest.script)?);
        Ok(())
    }

    /// Where the results of the latest pair will be.
    pub(super) fn on_device(&self) -> DeviceSolution {
        let fetching = self.fetching.as_ref().filter(|_| self.fetches);
        DeviceSolution::new(self.workspace.buffer(Slot::EndMaps), &self.latest.recording, fetching)
    }

    /// Waits so long at most; whether the device has fetched what it fetches of the latest pair.
    pub(super) fn is_taken(&mut self, limit: Duration) -> Result<bool, Error> {
        let Some(fetching) = &mut self.fetching else { return Ok(true) };
        let is_taken = fetching.wait(fetching.completion().1, limit, self.deadline)?;
        if is_taken {
            fetching.release();
        }
        Ok(is_taken)
    }

    /// [`Error::Cancelled`] where the latest pair was called off, and its results are half-way ones.
    fn check_wanted(&self) -> Result<(), Error> {
        if self.call.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Waits so long at most; whether the pair is solved.
    pub(super) fn wait(&mut self, limit: Duration) -> Result<bool, Error> {
        let Some(value) = self.under_way else { return Ok(true) };
        let is_done = self.latest.recording.wait(value, limit, self.deadline)?;
        if is_done {
            self.under_way = None;
            self.phases.end(SUBMIT_WAIT);
        }
        Ok(is_done)
    }

    /// Runs the first parts, and waits.
    pub(super) fn run(
        &mut self,
        wanted_parts: fn(&Script) -> usize,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), Error> {
        let common = self.common.clone();
        let (plan, on_the_way) = (&common.plan, self.workspace.buffer(Slot::Progress).clone());
        let Prepared { script, recording } = &mut self.latest;
        let parts = wanted_parts(script);
        let levels = |parts: usize| script.parts[..parts].iter().filter_map(|part| part.level_done);
        let count = |parts: usize| levels(parts).count() as u32;
        let pixels =
            |parts: usize| levels(parts).map(|index| plan.pyramid[index].size.map(u64::from)).map(|[w, h]| w * h).sum();
        let mut wanted = |part: usize| {
            let state = on_the_way.read::<State>(0, 1)?[0];
            Ok(script.parts[part].continues.is_none_or(|level| state.levels[level].settled == 0))
        };
        recording.run_parts(parts, self.deadline, &mut wanted, &mut |part| {
            if let Some(level) = script.parts[part - 1].level_done.map(|index| &plan.pyramid[index]) {
                let [width, height] = level.size;
                let (pixels_done, pixels) = (pixels(part), pixels(parts));
                progress(Progress { done: count(part), levels: count(parts), pixels_done, pixels, width, height });
            }
        })?;
        self.phases.end(SUBMIT_WAIT);
        Ok(())
    }

    /// What the latest solve did, dispatch by dispatch.
    pub(super) fn profile(&self) -> Result<Profile, Error> {
        let states = [Slot::EndState, Slot::RegisteredState].map(|slot| self.state(slot));
        let [solved, registered] = states;
        let done = [solved?.levels, registered?.levels];
        let Prepared { script, recording } = &self.latest;
        let ran = |d: &Dispatch| Ran {
            pass: d.stage.shader.name,
            place: d.place,
            bytes: d.bytes,
            executed: d.place.executed(d.grid, &done),
        };
        let (dispatches, ends_ms) = (script.dispatches().map(ran).collect(), recording.times()?.ends_ms);
        Ok(Profile { dispatches, ends_ms, phases: self.phases.clone() })
    }

    /// The results where they are.
    pub(super) fn view(&mut self, mask: Option<&Mask>) -> Result<SolutionRef<'_>, Error> {
        self.check_wanted()?;
        let [width, height] = self.common.plan.size;
        let state = self.state(Slot::EndState)?;
        let mut findings = Findings {
            width,
            height,
            origin: [0, 0],
            photograph: [width, height],
            fused_channels: self.common.plan.fused_channels(),
            transform: state.registration().transform,
            photometric: state.registration().photometric(),
            shading: state.applied_shading(),
            solved: Region { x: 0, y: 0, width, height },
            regularization: state.alpha.into(),
            kernel_shape: (self.common.plan.settings.kernel == Kernel::Auto).then(|| state.kernel_shape.into()),
            other_motion: None,
            levels: self.levels(&state, Slot::EndEnergies)?,
            converged: false,
            warnings: Vec::new(),
            valid_fraction: 0.0,
            mean_confidence: 0.0,
            saturated_fraction: 0.0,
            timings: self.timings()?,
        };
        let settings = &self.common.plan.settings;
        let maps = self.workspace.buffer(Slot::EndMaps).mapped_floats()?;
        let pixels = width as usize * height as usize;
        let counts = Counts::of(&maps[..pixels], &maps[pixels..2 * pixels], settings.max_relative_blur);
        findings.tell(&counts);
        findings.judge(&state, settings, mask.map_or(1.0, Mask::coverage));
        if !self.common.plan.solves_transform() {
            findings.doubt(&self.registered()?);
        } else if findings.converged {
            findings.other_motion = self.other_motion(&state)?;
        }
        self.phases.end("collect");
        findings.timings.total_ms = self.started.elapsed().as_secs_f64() * 1e3;
        Ok(SolutionRef::new(findings, self.workspace.buffer(Slot::EndMaps).mapped_floats()?))
    }

    /// The registration, out of mapped memory.
    pub(super) fn registered(&self) -> Result<Registered, Error> {
        self.check_wanted()?;
        let (plan, state) = (&self.common.plan, self.state(Slot::RegisteredState)?);
        let mut registered = Registered {
            width: plan.size[0],
            height: plan.size[1],
            transform: state.registration().transform,
            photometric: state.registration().photometric(),
            shading: state.applied_shading(),
            other_motion: None,
            levels: self.levels(&state, Slot::RegisteredEnergies)?,
            converged: false,
            warnings: Vec::new(),
            timings: self.timings()?,
        };
        registered.judge(&state);
        if plan.solves_transform() && registered.converged {
            registered.other_motion = self.other_motion(&state)?;
        }
        registered.timings.total_ms = self.started.elapsed().as_secs_f64() * 1e3;
        Ok(registered)
    }

    /// What the last sums say of motion models.
    fn other_motion(&self, state: &State) -> Result<Option<OtherMotion>, Error> {
        let (layout, finest) = (Layout::of(true), &self.common.plan.pyramid[0]);
        let [columns, rows, _] = finest.tiles();
        let floats = (columns * rows) as usize * layout.length;
        let partials: Vec<f32> = self.workspace.buffer(Slot::EndPartials).read(0, floats)?;
        let blocks = partials.chunks_exact(layout.length).map(|row| Sums::from_partials(row, layout)).collect();
        let form = Form::new(blocks, finest.length, finest.centre);
        Ok(form.other(self.common.plan.settings.motion, &state.registration().transform))
    }

    /// By the device's clock; where that is not read, from submitting to the last answer.
    fn timings(&self) -> Result<Timings, Error> {
        if self.encoded.is_some() {
            // By whom, and when, is the program's to know.
            return Ok(Timings::default());
        }
        let times = self.latest.recording.times()?;
        let gpu_ms = if times.passes_ms.is_empty() { self.phases.waited_ms() } else { times.total_ms };
        Ok(Timings { total_ms: 0.0, gpu_ms, passes_ms: times.passes_ms })
    }

    fn state(&self, slot: Slot) -> Result<State, Error> {
        Ok(self.workspace.buffer(slot).read::<State>(0, 1)?[0])
    }

    /// What the levels did, coarse to fine.
    fn levels(&self, state: &State, energies: Slot) -> Result<Vec<LevelHistory>, Error> {
        let plan = &self.common.plan;
        let outer = plan.settings.outer_iterations as usize;
        let energies: Vec<f32> = self.workspace.buffer(energies).read(0, plan.solved * outer)?;
        let levels = plan.coarse_to_fine().map(|level| {
            let done = (state.levels[level.index].iterations as usize).min(outer);
            let energy = energies[level.index * outer..][..done].iter().map(|&e| e.into()).collect();
            LevelHistory { width: level.size[0], height: level.size[1], energy }
        });
        Ok(levels.collect())
    }
}

fn prepared(common: &Common, workspace: &Workspace, masked: bool) -> Result<Prepared, Error> {
    let script = compose(&common.plan, masked);
    let recording = record(&common.device, &common.pipelines, workspace, &script, common.reading)?;
    // All but the last word, by which the pair may have been called off meanwhile.
    let words = &script.arguments[..script.arguments.len() - 1];
    workspace.buffer(Slot::StartArguments).write(bytemuck::cast_slice(words))?;
    Ok(Prepared { script, recording })
}
