//! A frame in flight: mapped memory and recordings of one pair, and its cancellation.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::arguments;
use super::motion::QuadraticForm;
use super::plan::Plan;
use super::progress::WorkCounter;
use super::record::{Phases, Profile, Ran, Reading, SUBMIT_WAIT, Workspace, record, record_with};
use super::script::{Dispatch, Script, compose};
use super::slot::Slot;
use super::solution::{Counts, Findings, LevelHistory, Registered, SolutionRef, Timings};
use super::stages::state::{Registration, State};
use super::stages::sums::{Layout, Sums};
use super::stages::{Pipelines, linearise};
use super::vulkan::{
    Buffer, Clock, Device, DeviceSolution, ExternalCommandBuffer, Recorder, Recording, SemaphoreWait, SolutionBuffer,
    SourceCopy,
};
use super::windows::{self, Gradients, Photograph};
use crate::base::{
    CancelSignal, CancellationToken, Deadline, Error, Homography, Kernel, Mask, Photometric, Progress, Region, Shading,
};

/// The values that a pair starts from. What is not solved for keeps them.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub(super) transform: Homography,
    pub(super) photometric: Photometric,
    pub(super) shading: Shading,
    pub(super) kernel_shape: f64,
}

/// What all frames in flight of a solver share. Device-only memory is shared too: pairs run one after the other.
pub(super) struct Shared {
    pub(super) plan: Plan,
    pub(super) device: Arc<Device>,
    pub(super) pipelines: Arc<Pipelines>,
    pub(super) reading: Reading,
}

/// A script and its recording.
struct RecordedScript {
    script: Script,
    recording: Recording,
}

impl RecordedScript {
    fn new(shared: &Shared, workspace: &Workspace, is_masked: bool) -> Result<Self, Error> {
        let script = compose(&shared.plan, is_masked);
        let recording = record(&shared.device, &shared.pipelines, workspace, &script, shared.reading)?;
        // All but the last word, which may cancel the pair meanwhile.
        let words = &script.arguments[..script.arguments.len() - 1];
        workspace.buffer(Slot::StartArguments).write(bytemuck::cast_slice(words))?;
        Ok(Self { script, recording })
    }
}

/// The memory and recordings of one pair.
pub(super) struct FrameInFlight {
    shared: Arc<Shared>,
    workspace: Workspace,
    /// The script of the latest pair.
    current: RecordedScript,
    /// Whether that is for pairs with masked or clipped pixels.
    is_masked: bool,
    /// The script of the other kind of pair, once recorded.
    other: Option<RecordedScript>,
    /// What the mask buffer holds.
    mask: Option<Mask>,
    started: Instant,
    deadline: Deadline,
    phases: Phases,
    /// The recording that fetches photographs of the latest pair.
    fetching: Option<Recording>,
    /// Whether the device fetches a photograph of the latest pair.
    is_fetched: bool,
    /// What was recorded for the latest pair into a command buffer of the embedding program.
    encoded: Option<Recording>,
    /// The completion word, by which the device signals that it has executed `encoded`.
    completion: Arc<Buffer>,
    /// The value that the timeline of the current recording reaches when the submitted pair is solved.
    in_flight: Option<u64>,
    cancel: Arc<CancelFlag>,
    signal: Arc<CancelSignal>,
}

impl Drop for FrameInFlight {
    fn drop(&mut self) {
        self.cancel.end();
    }
}

impl FrameInFlight {
    /// Records the script for pairs with masked or clipped pixels, the one for pairs without, or by `None` both.
    pub(super) fn new(shared: Arc<Shared>, workspace: Workspace, is_masked: Option<bool>) -> Result<Self, Error> {
        workspace.buffer(Slot::Mask).write(&mask_bytes(&shared.plan, None))?;
        let recorded = |is_masked| RecordedScript::new(&shared, &workspace, is_masked);
        let other = if is_masked.is_none() { Some(recorded(true)?) } else { None };
        let is_masked = is_masked.unwrap_or(false);
        let current = recorded(is_masked)?;
        let cancel = CancelFlag::new(workspace.buffer(Slot::StartArguments), &shared.plan);
        Ok(Self {
            current,
            is_masked,
            other,
            mask: None,
            started: Instant::now(),
            deadline: Deadline::after(shared.device.timeout()),
            phases: Phases::default(),
            fetching: None,
            is_fetched: false,
            encoded: None,
            completion: Buffer::for_readback(&shared.device, "completion", 4)?,
            in_flight: None,
            signal: cancel.signal(),
            cancel,
            shared,
            workspace,
        })
    }

    /// Begins a pair, which may be cancelled from here on. No pair is in flight.
    pub(super) fn begin(
        &mut self,
        mask: Option<&Mask>,
        cancel: &CancellationToken,
        limit: Duration,
    ) -> Result<(), Error> {
        self.shared.device.check_usable()?;
        (self.started, self.phases, self.deadline) = (Instant::now(), Phases::default(), Deadline::after(limit));
        self.is_fetched = false;
        self.cancel.end();
        let words = self.workspace.buffer(Slot::StartArguments);
        self.cancel = CancelFlag::new(words, &self.shared.plan);
        self.signal = self.cancel.signal();
        self.cancel.clear(words)?;
        cancel.register(&self.signal);
        cancel.check()?;
        if self.mask.as_ref() != mask {
            self.workspace.buffer(Slot::Mask).write(&mask_bytes(&self.shared.plan, mask))?;
            self.mask = mask.cloned();
        }
        Ok(())
    }

    /// Cancels the latest pair.
    pub(super) fn cancel(&self) {
        self.cancel.cancel();
    }

    /// The time that the latest pair has left.
    #[cfg(test)]
    pub(super) fn time_left(&self) -> Duration {
        self.deadline.left()
    }

    /// Cancels a pair in flight and waits until the device has left it, so that another pair can begin.
    pub(super) fn release(&mut self) {
        if self.in_flight.is_some() {
            self.cancel();
            // A failed wait poisons the device, which the next pair reports.
            let _ = self.wait(Duration::MAX);
        } else if !self.shared.device.is_poisoned() {
            // A pair whose submission failed may have submitted its fetches.
            let _ = self.wait_fetched(Duration::MAX);
        }
    }

    /// The buffer that the device reads a photograph from.
    fn input(&self, image: usize) -> &Arc<Buffer> {
        self.workspace.buffer(self.shared.plan.entry(image))
    }

    /// Calls a function that writes a photograph into that buffer.
    pub(super) fn fill(&self, image: usize, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        self.input(image).write_with(write)
    }

    /// Prepares the pair for submission, after its photographs were copied.
    pub(super) fn prepare(&mut self, start: &Start, is_masked: bool) -> Result<(), Error> {
        self.phases.end("upload");
        let settings = &self.shared.plan.settings;
        let mut state = State::new(&Registration::new(start.transform, &start.photometric));
        state.shading = start.shading.coefficients.map(|c| c as f32);
        state.kernel_shape = start.kernel_shape as f32;
        state.alpha = settings.regularization.map_or(state.alpha, |alpha| alpha as f32);
        self.workspace.buffer(Slot::StartState).write(bytemuck::bytes_of(&state))?;
        if self.is_masked != is_masked {
            let recorded = || RecordedScript::new(&self.shared, &self.workspace, is_masked);
            let next = self.other.take().map_or_else(recorded, Ok)?;
            self.other = Some(std::mem::replace(&mut self.current, next));
            self.is_masked = is_masked;
        }
        self.encoded = None;
        self.phases.end("start");
        Ok(())
    }

    /// Submits copies of photographs, which begin after `waits`. Called before [`submit`](Self::submit).
    pub(super) fn fetch(&mut self, fetches: &[(usize, SourceCopy)], waits: &[SemaphoreWait]) -> Result<(), Error> {
        let mut recorder = Recorder::new(&self.shared.device, Clock::Never)?;
        for (image, fetch) in fetches {
            recorder.copy_source(fetch, self.input(*image));
        }
        let (recording, earlier) = (recorder.finish()?, self.fetching.take());
        // Waits of another queue for the timeline may still be pending: it lives as long as this.
        let recording = if let Some(earlier) = earlier { recording.with_timeline_of(earlier) } else { recording };
        self.fetching.insert(recording).submit(1, waits)?;
        self.is_fetched = true;
        Ok(())
    }

    /// Submits the pair and returns. On devices without conditional rendering it blocks until the solve is done.
    pub(super) fn submit(&mut self, waits: &[SemaphoreWait]) -> Result<(), Error> {
        let parts = self.current.script.parts.len();
        if self.current.recording.has_optional_parts() {
            // The waits belong to a submission of their own.
            if !waits.is_empty() {
                self.fetch(&[], waits)?;
            }
            return self.run(|script| script.parts.len(), &|_| ());
        }
        self.in_flight = Some(self.current.recording.submit(parts, waits)?);
        Ok(())
    }

    /// Records the pair and its fetches into a command buffer of the embedding program.
    pub(super) fn encode(
        &mut self,
        commands: ExternalCommandBuffer,
        fetches: &[(usize, SourceCopy)],
    ) -> Result<(), Error> {
        self.completion.store_word(0, Recorder::PENDING)?;
        let mut recorder = Recorder::into_external(&self.shared.device, commands, &self.completion);
        for (image, fetch) in fetches {
            recorder.copy_source(fetch, self.input(*image));
        }
        recorder.barrier();
        self.encoded = Some(record_with(recorder, &self.shared.pipelines, &self.workspace, &self.current.script)?);
        Ok(())
    }

    /// Returns whether the device has executed what was encoded to its end.
    pub(super) fn is_executed(&self) -> Result<bool, Error> {
        Ok(self.completion.load_word(0)? == Recorder::COMPLETE)
    }

    /// The results of the latest pair on the device, and the semaphores that signal when they are complete.
    pub(super) fn on_device(&self) -> DeviceSolution {
        let fetching = self.fetching.as_ref().filter(|_| self.is_fetched);
        DeviceSolution::new(self.workspace.buffer(Slot::EndMaps), &self.current.recording, fetching)
    }

    /// The buffer on the device that holds the results.
    pub(super) fn result_buffer(&self) -> SolutionBuffer {
        SolutionBuffer::new(self.workspace.buffer(Slot::EndMaps))
    }

    /// Waits until the device has fetched the photographs of the latest pair, for `limit` at most. Returns whether it
    /// has.
    pub(super) fn wait_fetched(&mut self, limit: Duration) -> Result<bool, Error> {
        let Some(fetching) = &mut self.fetching else { return Ok(true) };
        let is_fetched = fetching.wait(fetching.completion().1, limit, self.deadline)?;
        if is_fetched {
            fetching.release();
        }
        Ok(is_fetched)
    }

    /// Waits until the pair is solved, for `limit` at most. Returns whether it is.
    pub(super) fn wait(&mut self, limit: Duration) -> Result<bool, Error> {
        let Some(value) = self.in_flight else { return Ok(true) };
        self.shared.device.check_usable()?;
        if !self.current.recording.wait(value, limit, self.deadline)? {
            return Ok(false);
        }
        self.in_flight = None;
        self.phases.end(SUBMIT_WAIT);
        self.wait_fetched(Duration::MAX)
    }

    /// Runs the first parts of the script and waits for them.
    pub(super) fn run(&mut self, parts: fn(&Script) -> usize, progress: &dyn Fn(Progress)) -> Result<(), Error> {
        let state_word = self.workspace.buffer(Slot::Progress).clone();
        let RecordedScript { script, recording } = &mut self.current;
        let parts = parts(script);
        let level_of = |part: usize| script.parts[part].continues;
        let is_settled = |level: Option<usize>| -> Result<bool, Error> {
            let state = state_word.read::<State>(0, 1)?[0];
            Ok(level.is_some_and(|level| state.levels[level].settled == 1))
        };
        let mut wanted = |part: usize| is_settled(level_of(part)).map(|settled| !settled);
        let mut counter = WorkCounter::new(script, parts);
        // Whether the level of the optional parts had settled before the latest one.
        let mut was_settled = false;
        recording.run_parts(parts, self.deadline, &mut wanted, &mut |over| {
            let part = over - 1;
            // A progress that cannot be read is shown as that of a level that goes on.
            let next = (part..parts).find_map(level_of);
            let settles = is_settled(next).unwrap_or(false);
            let ran = !counter.is_optional(part) || !was_settled;
            was_settled = settles;
            let latest = counter.after(part, ran, !settles);
            if latest.total > 0 && (ran || script.parts[part].level_done.is_some()) {
                progress(latest);
            }
        })?;
        self.phases.end(SUBMIT_WAIT);
        Ok(())
    }

    /// Returns the dispatches of the latest solve and their times.
    pub(super) fn profile(&self) -> Result<Profile, Error> {
        let [solved, registered] = [Slot::EndState, Slot::RegisteredState].map(|slot| self.state(slot));
        let done = [solved?.levels, registered?.levels];
        let RecordedScript { script, recording } = &self.current;
        let ran = |d: &Dispatch| Ran {
            pass: d.stage.shader.name,
            place: d.place,
            bytes: d.bytes,
            executed: d.place.executed(d.grid, &done),
        };
        let (dispatches, ends_ms) = (script.dispatches().map(ran).collect(), recording.times()?.ends_ms);
        Ok(Profile { dispatches, ends_ms, phases: self.phases.clone() })
    }

    /// The results in mapped memory. The device is done with the pair.
    pub(super) fn solution(&mut self) -> Result<SolutionRef<'_>, Error> {
        self.cancel.check()?;
        let [width, height] = self.shared.plan.size;
        let state = self.state(Slot::EndState)?;
        let settings = &self.shared.plan.settings;
        let mut findings = Findings {
            width,
            height,
            origin: [0, 0],
            photograph: [width, height],
            fused_channels: self.shared.plan.fused_channels(),
            transform: state.registration().transform,
            photometric: state.registration().photometric(),
            shading: state.applied_shading(),
            solved: Region { x: 0, y: 0, width, height },
            regularization: state.alpha.into(),
            kernel_shape: (settings.kernel == Kernel::Auto).then(|| state.kernel_shape.into()),
            transform_deviation: None,
            other_motion: None,
            levels: self.levels(&state, Slot::EndEnergies)?,
            converged: false,
            warnings: Vec::new(),
            valid_fraction: 0.0,
            mean_confidence: 0.0,
            saturated_fraction: 0.0,
            clipped_fractions: [0.0; 2],
            unsettled_fraction: f64::from(state.levels[0].moving.min(1.0)),
            unexplained_fraction: 0.0,
            noise: f64::from(state.spread).max(settings.data_eta / linearise::BROAD),
            timings: self.timings()?,
        };
        let maps = self.workspace.buffer(Slot::EndMaps).mapped_floats()?;
        let pixels = width as usize * height as usize;
        let [v, deviation, residual] = [0, 1, 2].map(|layer| &maps[layer * pixels..(layer + 1) * pixels]);
        let counts = Counts::new([v, deviation, residual], findings.noise, settings.max_relative_blur);
        findings.set_counts(&counts);
        findings.judge(&state, settings, self.mask.as_ref().map_or(1.0, Mask::coverage));
        if !self.shared.plan.solves_transform() {
            findings.doubt(&self.registered()?);
        } else if findings.converged || findings.is_stopped() {
            let form = self.quadratic_form()?;
            let gradients = self.gradients(&findings, v)?;
            let undetermined = gradients.as_ref().and_then(|gradients| form.undetermined(settings.motion, gradients));
            if findings.converged {
                findings.other_motion = form.other_motion(settings.motion, &findings.transform);
                findings.transform_deviation =
                    gradients.as_ref().and_then(|gradients| form.deviation(settings.motion, gradients));
            }
            findings.determine(undetermined);
            if let Some(gradients) = &gradients {
                findings.compare_contrasts(gradients, settings, [v, deviation]);
            }
        }
        self.phases.end("collect");
        findings.timings.total_ms = self.started.elapsed().as_secs_f64() * 1e3;
        Ok(SolutionRef::new(findings, self.workspace.buffer(Slot::EndMaps).mapped_floats()?))
    }

    /// The registration, out of mapped memory. The device is done with the pair.
    pub(super) fn registered(&self) -> Result<Registered, Error> {
        self.cancel.check()?;
        let (plan, state) = (&self.shared.plan, self.state(Slot::RegisteredState)?);
        let mut registered = Registered {
            width: plan.size[0],
            height: plan.size[1],
            transform: state.registration().transform,
            photometric: state.registration().photometric(),
            shading: state.applied_shading(),
            other_motion: None,
            levels: self.levels(&state, Slot::RegisteredEnergies)?,
            clipped_fractions: [0.0; 2],
            converged: false,
            warnings: Vec::new(),
            timings: self.timings()?,
        };
        registered.judge(&state, self.mask.as_ref().map_or(1.0, Mask::coverage));
        if plan.solves_transform() && registered.converged {
            let motion = plan.settings.motion;
            registered.other_motion = self.quadratic_form()?.other_motion(motion, &registered.transform);
        }
        registered.timings.total_ms = self.started.elapsed().as_secs_f64() * 1e3;
        Ok(registered)
    }

    /// The quadratic form of the energy about T, by the last sums.
    fn quadratic_form(&self) -> Result<QuadraticForm, Error> {
        let (layout, finest) = (Layout::of(true), &self.shared.plan.pyramid[0]);
        let [columns, rows, _] = finest.tiles();
        let floats = (columns * rows) as usize * layout.length;
        let partials: Vec<f32> = self.workspace.buffer(Slot::EndPartials).read(0, floats)?;
        let blocks = partials.chunks_exact(layout.length).map(|row| Sums::from_partials(row, layout)).collect();
        Ok(QuadraticForm::new(blocks, finest.length, finest.centre))
    }

    /// The gradients of both photographs. `None` if a camera packed a photograph: only the device unpacks it.
    fn gradients(&self, findings: &Findings, relative_blur: &[f32]) -> Result<Option<Gradients>, Error> {
        let plan = &self.shared.plan;
        if [0, 1].iter().any(|&image| plan.unpacks(image)) {
            return Ok(None);
        }
        let photographs = [0, 1].map(|image| Photograph {
            buffer: self.input(image),
            format: plan.formats[image],
            size: plan.size,
            decode: plan.settings.decode,
        });
        let (transform, brightness) = (findings.transform, findings.brightness());
        let length = plan.pyramid[0].length;
        windows::Pair { photographs, transform, brightness, relative_blur, length }.gradients().map(Some)
    }

    /// Device time by its clock; without one, from the submission to the end of the wait.
    fn timings(&self) -> Result<Timings, Error> {
        if self.encoded.is_some() {
            // The embedding program knows when it executed the pair.
            return Ok(Timings::default());
        }
        let times = self.current.recording.times()?;
        let gpu_ms = if times.passes_ms.is_empty() { self.phases.waited_ms() } else { times.total_ms };
        Ok(Timings { total_ms: 0.0, gpu_ms, passes_ms: times.passes_ms })
    }

    fn state(&self, slot: Slot) -> Result<State, Error> {
        Ok(self.workspace.buffer(slot).read::<State>(0, 1)?[0])
    }

    /// The histories of the levels, coarse to fine.
    fn levels(&self, state: &State, energies: Slot) -> Result<Vec<LevelHistory>, Error> {
        let plan = &self.shared.plan;
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

/// A byte for each pixel of I1, 0 where the mask excludes it.
fn mask_bytes(plan: &Plan, mask: Option<&Mask>) -> Vec<u8> {
    let mut bytes = mask.map_or_else(Vec::new, |mask| mask.bytes().to_vec());
    bytes.resize(plan.mask_bytes() as usize, 1);
    bytes
}

/// Cancels one pair by the last word of its [arguments], which the device reads between iterations.
struct CancelFlag {
    /// The arguments, until the pair has ended.
    words: Mutex<Option<Arc<Buffer>>>,
    /// Byte offset of the last word.
    offset: u64,
    is_cancelled: AtomicBool,
}

impl CancelFlag {
    fn new(words: &Arc<Buffer>, plan: &Plan) -> Arc<Self> {
        let offset = arguments::bytes(plan.solved) - 4;
        Arc::new(Self { words: Mutex::new(Some(words.clone())), offset, is_cancelled: AtomicBool::new(false) })
    }

    /// Resets the word for a new pair.
    fn clear(&self, words: &Buffer) -> Result<(), Error> {
        words.store_word(self.offset, arguments::NOT_CANCELLED)
    }

    /// [`Error::Cancelled`] if the pair was cancelled: its results are unfinished.
    fn check(&self) -> Result<(), Error> {
        if self.is_cancelled.load(Ordering::SeqCst) { Err(Error::Cancelled) } else { Ok(()) }
    }

    fn words(&self) -> MutexGuard<'_, Option<Arc<Buffer>>> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn cancel(&self) {
        if let Some(words) = &*self.words() {
            self.is_cancelled.store(true, Ordering::SeqCst);
            // If the word cannot be written, the device solves the pair to its end.
            let _ = words.store_word(self.offset, arguments::CANCELLED);
        }
    }

    /// Makes later calls of [`cancel`](Self::cancel) do nothing.
    fn end(&self) {
        *self.words() = None;
    }

    /// The callback for a [`CancellationToken`].
    fn signal(self: &Arc<Self>) -> Arc<CancelSignal> {
        let flag = self.clone();
        Arc::new(move || flag.cancel())
    }
}
