//! A frame in flight: one pair in the memory of a device, and its cancellation.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use super::contrast::correlation;
use super::cpu::pair::CpuPair;
use super::judgement::Counts;
use super::motion::QuadraticForm;
use super::pair_memory::{CancelFlag, PairMemory, Shared};
use super::record::{Phases, Profile, Ran, SUBMIT_WAIT};
use super::script::{CountedPixels, Dispatch, Script};
use super::slot::Slot;
use super::solution::{Findings, LevelHistory, Registered, SolutionRef, Timings, widened};
use super::stages::linearise;
use super::stages::state::{Double, Registration, State};
use super::stages::sums::{Layout, Sums};
use super::vulkan::SemaphoreWait;
use super::vulkan_pair::VulkanPair;
use super::windows::{self, Gradients, Photograph, SMOOTHING};
use crate::base::{
    CancelSignal, CancellationToken, Deadline, Error, Frame, Homography, Kernel, Mask, Parallax, Photometric, Progress,
    Region, Shading,
};

/// The correlation of the gradients of the registered photographs above which T is not in doubt. Right ones have less
/// only where blur differs much.
pub(super) const SURE_CORRELATION: f64 = 0.5;
/// The least correlation of the gradients of one scene, whatever the photographs have at low pass. Right registrations
/// of real and generated pairs have 0.41 to 0.99, 120 generated ones that were 10 px and more off up to 0.21.
const LEAST_CORRELATION: f32 = 0.25;
/// Smoothings, times that of the windows, by which photographs are compared that correlate less by that: blur that
/// differs much leaves only coarse detail in common. They count if they leave this share of the power of the softer one:
/// 0.5 to 0.8 of real pairs that differ much, 0.0015 to 0.07 of texture without low frequencies, where what is left
/// correlates wherever it lies.
const COARSER: [f64; 2] = [2.0, 4.0];
const SHARED_POWER: f64 = 0.2;

/// The values that a pair starts from. What is not solved for keeps them.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub(super) transform: Homography,
    pub(super) photometric: Photometric,
    pub(super) shading: Shading,
    pub(super) kernel_shape: f64,
    pub(super) separation: f64,
    pub(super) parallax: Parallax,
}

/// The memory of a pair by kind of device.
pub(super) enum Memory {
    Vulkan(Box<VulkanPair>),
    Cpu(Box<CpuPair>),
}

impl Memory {
    fn pair(&self) -> &dyn PairMemory {
        match self {
            Self::Vulkan(pair) => &**pair,
            Self::Cpu(pair) => &**pair,
        }
    }

    fn pair_mut(&mut self) -> &mut dyn PairMemory {
        match self {
            Self::Vulkan(pair) => &mut **pair,
            Self::Cpu(pair) => &mut **pair,
        }
    }
}

/// One pair in flight.
pub(super) struct FrameInFlight {
    shared: Arc<Shared>,
    memory: Memory,
    /// The mask that was uploaded.
    mask: Option<Mask>,
    started: Instant,
    deadline: Deadline,
    phases: Phases,
    cancel: Arc<CancelFlag>,
    signal: Arc<CancelSignal>,
    /// The correlation of the latest pair by the T that was registered, once it was asked for.
    correlation: OnceLock<Option<f64>>,
}

impl Drop for FrameInFlight {
    fn drop(&mut self) {
        self.cancel.end();
    }
}

impl FrameInFlight {
    /// A frame in flight with the memory of one pair.
    pub(super) fn new(shared: Arc<Shared>, mut memory: Memory) -> Result<Self, Error> {
        let cancel = memory.pair_mut().cancel_flag()?;
        Ok(Self {
            mask: None,
            started: Instant::now(),
            deadline: Deadline::after(Duration::MAX),
            phases: Phases::default(),
            signal: cancel.signal(),
            cancel,
            shared,
            memory,
            correlation: OnceLock::new(),
        })
    }

    /// Begins a pair, which may be cancelled from here on. No pair is in flight.
    pub(super) fn begin(
        &mut self,
        mask: Option<&Mask>,
        cancel: &CancellationToken,
        limit: Duration,
    ) -> Result<(), Error> {
        if let Memory::Vulkan(pair) = &mut self.memory {
            pair.begin()?;
        }
        (self.started, self.phases, self.deadline) = (Instant::now(), Phases::default(), Deadline::after(limit));
        self.correlation = OnceLock::new();
        self.cancel.end();
        self.cancel = self.memory.pair_mut().cancel_flag()?;
        self.signal = self.cancel.signal();
        cancel.register(&self.signal);
        cancel.check()?;
        if self.mask.as_ref() != mask {
            self.memory.pair_mut().upload_mask(mask)?;
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
        let Memory::Vulkan(pair) = &mut self.memory else { return };
        if pair.is_in_flight() {
            self.cancel.cancel();
            // A failed wait poisons the device, which the next pair reports.
            let _ = self.wait(Duration::MAX);
        } else {
            pair.abandon(self.deadline);
        }
    }

    /// The pair on a Vulkan device.
    ///
    /// # Errors
    /// [`Error::Mismatch`] on the CPU device, which has none of `what`.
    pub(super) fn vulkan(&mut self, what: &str) -> Result<&mut VulkanPair, Error> {
        match &mut self.memory {
            Memory::Vulkan(pair) => Ok(pair),
            Memory::Cpu(_) => Err(no(what)),
        }
    }

    /// As [`vulkan`](Self::vulkan), shared.
    pub(super) fn as_vulkan(&self, what: &str) -> Result<&VulkanPair, Error> {
        match &self.memory {
            Memory::Vulkan(pair) => Ok(pair),
            Memory::Cpu(_) => Err(no(what)),
        }
    }

    /// Calls a function that writes a photograph into the memory that the passes read.
    pub(super) fn fill(&mut self, image: usize, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error> {
        self.memory.pair_mut().fill(image, write)
    }

    /// Uploads a frame. Returns whether it has pixels that are clipped by these levels.
    pub(super) fn upload(&mut self, image: usize, photograph: &Frame, levels: [f32; 2]) -> Result<bool, Error> {
        self.memory.pair_mut().upload(image, photograph, levels)
    }

    /// Prepares the pair for submission, after its photographs were copied.
    pub(super) fn prepare(&mut self, start: &Start, pixels: CountedPixels) -> Result<(), Error> {
        self.phases.end("upload");
        let settings = &self.shared.plan.settings;
        let mut state = State::new(&Registration::new(start.transform, &start.photometric));
        state.shading = start.shading.coefficients.map(|c| c as f32);
        state.kernel_shape = start.kernel_shape as f32;
        state.separation = start.separation as f32;
        state.parallax = Double::single(&start.parallax);
        state.alpha = settings.regularization.map_or(state.alpha, |alpha| alpha as f32);
        self.memory.pair_mut().prepare(&state, pixels)?;
        self.phases.end("start");
        Ok(())
    }

    /// Submits the pair and returns. On the CPU device, and on devices without conditional rendering, it blocks until
    /// the solve is done.
    pub(super) fn submit(&mut self, waits: &[SemaphoreWait]) -> Result<(), Error> {
        match &mut self.memory {
            Memory::Vulkan(pair) => {
                pair.submit(waits, self.deadline)?;
                if !pair.is_in_flight() {
                    self.phases.end(SUBMIT_WAIT);
                }
                Ok(())
            }
            Memory::Cpu(_) if !waits.is_empty() => {
                Err(Error::Mismatch("the CPU device waits for no semaphores: use a Vulkan device".into()))
            }
            Memory::Cpu(_) => self.run(|script| script.parts.len(), &|_| ()),
        }
    }

    /// Waits until the device has fetched the photographs of the latest pair, for `limit` at most. Returns whether it
    /// has.
    pub(super) fn wait_fetched(&mut self, limit: Duration) -> Result<bool, Error> {
        match &mut self.memory {
            Memory::Vulkan(pair) => pair.wait_fetched(limit, self.deadline),
            Memory::Cpu(_) => Ok(true),
        }
    }

    /// Waits until the pair is solved, for `limit` at most. Returns whether it is.
    pub(super) fn wait(&mut self, limit: Duration) -> Result<bool, Error> {
        let Memory::Vulkan(pair) = &mut self.memory else { return Ok(true) };
        if !pair.is_in_flight() {
            return Ok(true);
        }
        let is_solved = pair.wait(limit, self.deadline)?;
        if is_solved {
            self.phases.end(SUBMIT_WAIT);
        }
        Ok(is_solved)
    }

    /// Runs the first parts of the script and waits for them.
    pub(super) fn run(&mut self, parts: fn(&Script) -> usize, progress: &dyn Fn(Progress)) -> Result<(), Error> {
        self.memory.pair_mut().run(parts, self.deadline, progress)?;
        self.phases.end(SUBMIT_WAIT);
        Ok(())
    }

    /// Returns the dispatches of the latest solve and their times.
    pub(super) fn profile(&self) -> Result<Profile, Error> {
        let [solved, registered] = [Slot::EndState, Slot::RegisteredState].map(|slot| self.state(slot));
        let done = [solved?.levels, registered?.levels];
        let pair = self.memory.pair();
        let ran = |d: &Dispatch| Ran {
            pass: d.stage.shader.name,
            place: d.place,
            bytes: d.bytes,
            executed: d.place.executed(d.grid, &done),
        };
        let (dispatches, ends_ms) = (pair.script().dispatches().map(ran).collect(), pair.times()?.ends_ms);
        Ok(Profile { dispatches, ends_ms, phases: self.phases.clone() })
    }

    /// σ of the noise in S, units: that of the last step of T; or, where T moved too far for it to be measured, of all
    /// that is left of S.
    fn noise(&self, state: &State) -> f64 {
        let eta = self.shared.plan.settings.data_eta;
        let left = || (f64::from(state.levels[0].energy).powi(2) - eta * eta).max(0.0).sqrt();
        let spread = if state.spread > 0.0 { state.spread.into() } else { left() };
        spread.max(eta / linearise::BROAD)
    }

    /// The results, borrowed from the pair's memory. The device is done with the pair.
    pub(super) fn solution(&mut self) -> Result<SolutionRef<'_>, Error> {
        self.cancel.check()?;
        let [width, height] = self.shared.plan.size;
        let state = self.judged(self.state(Slot::EndState)?)?;
        let (unit, parallax) = (f64::from(state.unit), state.parallax.double());
        let settings = &self.shared.plan.settings;
        let mut findings = Findings {
            width,
            height,
            photograph: [width, height],
            fused_channels: self.shared.plan.fused_channels(),
            transform: state.registration().transform,
            photometric: state.registration().in_intensities(unit).photometric(),
            shading: state.applied_shading(),
            solved: Region { x: 0, y: 0, width, height },
            regularization: state.alpha.into(),
            max_relative_blur: settings.blur_limit(),
            kernel_shape: (settings.kernel == Kernel::Auto).then(|| state.kernel_shape.into()),
            separation: (state.separation > 0.0).then(|| state.separation.into()),
            parallax,
            // It is per px² of V: an error of V's scale is one of its size.
            parallax_deviation: state.parallax_deviation.double().with(parallax, state.scale_deviation.into()),
            scale_deviation: state.scale_deviation.into(),
            levels: self.levels(&state, Slot::EndEnergies)?,
            unsettled_fraction: f64::from(state.levels[0].moving.min(1.0)),
            noise: unit * self.noise(&state),
            timings: self.timings()?,
            ..Findings::default()
        };
        let maps = self.memory.pair().maps()?;
        let pixels = width as usize * height as usize;
        let [v, deviation, residual] = [0, 1, 2].map(|layer| &maps[layer * pixels..(layer + 1) * pixels]);
        let counts = Counts::new([v, deviation, residual], &findings);
        findings.set_counts(&counts);
        findings.judge(&state, self.mask.as_ref().map_or(1.0, Mask::coverage), counts.texture());
        if !self.shared.plan.solves_transform() {
            findings.doubt(&self.registered()?);
        } else if findings.converged || findings.is_stopped() {
            let form = self.quadratic_form()?;
            let gradients = self.gradients(&findings, v, SMOOTHING)?;
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
        let shift = findings.color_shift.filter(|shift| shift.included > 0.0);
        let widened = shift.map(|shift| widened(deviation, v, |_| shift.included as f32));
        if let Some(widened) = &widened {
            findings.set_counts(&Counts::new([v, widened, residual], &findings));
        }
        self.phases.end("collect");
        findings.timings.total_ms = self.started.elapsed().as_secs_f64() * 1e3;
        Ok(SolutionRef::new(findings, self.memory.pair().maps()?, widened))
    }

    /// The registration. The device is done with the pair.
    pub(super) fn registered(&self) -> Result<Registered, Error> {
        self.cancel.check()?;
        let (plan, state) = (&self.shared.plan, self.judged(self.state(Slot::RegisteredState)?)?);
        let unit = f64::from(state.unit);
        let mut registered = Registered {
            width: plan.size[0],
            height: plan.size[1],
            transform: state.registration().transform,
            photometric: state.registration().in_intensities(unit).photometric(),
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
        let partials = self.memory.pair().numbers(Slot::EndPartials, floats)?;
        let blocks = partials.chunks_exact(layout.length).map(|row| Sums::from_partials(row, layout)).collect();
        Ok(QuadraticForm::new(blocks, finest.length, finest.centre))
    }

    /// The gradients of both photographs. `None` if a camera packed a photograph: only the device unpacks it.
    fn gradients(&self, findings: &Findings, v: &[f32], smoothing: f64) -> Result<Option<Gradients>, Error> {
        let plan = &self.shared.plan;
        if [0, 1].iter().any(|&image| plan.unpacks(image)) {
            return Ok(None);
        }
        let photographs = [0, 1].map(|image| Photograph {
            bytes: self.memory.pair().photograph(image),
            format: plan.formats[image],
            size: plan.size,
            decode: plan.settings.decode,
        });
        let (transform, brightness) = (findings.transform, findings.brightness());
        let (length, relative_blur) = (plan.pyramid[0].length, v);
        let parallax = findings.parallax;
        windows::Pair { photographs, transform, parallax, brightness, relative_blur, length, smoothing }
            .gradients()
            .map(Some)
    }

    /// The correlation of both photographs, I2 on I1's pixels by T, by their gradients in the windows, with the
    /// smoothing by which they correlate most; `None` if a camera packed a photograph.
    pub(super) fn correlation(&self, transform: Homography) -> Result<Option<f64>, Error> {
        let [width, height] = self.shared.plan.size;
        let solved = Region { x: 0, y: 0, width, height };
        let is_shown = |x: u32, y: u32| {
            let at = transform.apply([x.into(), y.into()], solved.centre());
            let inside = (0.0..width.into()).contains(&at[0]) && (0.0..height.into()).contains(&at[1]);
            inside && self.mask.as_ref().is_none_or(|mask| mask.contains(x.into(), y.into()))
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let v: Vec<f32> = pixels.map(|(x, y)| if is_shown(x, y) { 0.0 } else { f32::NAN }).collect();
        let findings = Findings { transform, solved, ..Findings::default() };
        let smoothed = |factor: f64| {
            let gradients = self.gradients(&findings, &v, factor * SMOOTHING)?;
            Ok::<_, Error>(gradients.and_then(|gradients| correlation(&gradients.unmatched?)))
        };
        let Some((mut most, power)) = smoothed(1.0)? else { return Ok(None) };
        for factor in COARSER {
            if most <= SURE_CORRELATION {
                let coarser = smoothed(factor)?;
                most =
                    coarser.filter(|(_, left)| *left > SHARED_POWER * power).map_or(most, |(found, _)| most.max(found));
            }
        }
        Ok(Some(most))
    }

    /// The state with the correlation that is judged: that of the gradients, if the one at low pass is less, or if they
    /// hardly have one.
    fn judged(&self, mut state: State) -> Result<State, Error> {
        if let Some(plain) = self.registered_correlation()?.map(|plain| plain as f32)
            && (plain < LEAST_CORRELATION || plain > state.correlation)
        {
            state.correlation = plain;
        }
        Ok(state)
    }

    /// The correlation by T that was registered, if the solve found it.
    pub(super) fn registered_correlation(&self) -> Result<Option<f64>, Error> {
        if !self.shared.plan.solves_transform() {
            return Ok(None);
        }
        // A pair that was encoded may be executed again, on other photographs.
        let is_encoded = matches!(&self.memory, Memory::Vulkan(pair) if pair.is_encoded());
        if let Some(known) = self.correlation.get().filter(|_| !is_encoded) {
            return Ok(*known);
        }
        let found = self.correlation(self.state(Slot::RegisteredState)?.registration().transform)?;
        // Set already only for a pair that was encoded, which does not read it.
        let _ = self.correlation.set(found);
        Ok(found)
    }

    /// Device time by its clock; without one, from the submission to the end of the wait.
    fn timings(&self) -> Result<Timings, Error> {
        if matches!(&self.memory, Memory::Vulkan(pair) if pair.is_encoded()) {
            // The embedding program knows when it executed the pair.
            return Ok(Timings::default());
        }
        let times = self.memory.pair().times()?;
        let gpu_ms = if times.passes_ms.is_empty() { self.phases.waited_ms() } else { times.total_ms };
        Ok(Timings { total_ms: 0.0, gpu_ms, passes_ms: times.passes_ms })
    }

    fn state(&self, slot: Slot) -> Result<State, Error> {
        self.memory.pair().state(slot)
    }

    /// The histories of the levels, coarse to fine.
    fn levels(&self, state: &State, energies: Slot) -> Result<Vec<LevelHistory>, Error> {
        let plan = &self.shared.plan;
        let outer = plan.settings.outer_iterations as usize;
        let energies = self.memory.pair().numbers(energies, plan.solved * outer)?;
        let levels = plan.coarse_to_fine().map(|level| {
            let done = (state.levels[level.index].iterations as usize).min(outer);
            let energy = energies[level.index * outer..][..done].iter().map(|&e| e.into()).collect();
            LevelHistory { width: level.size[0], height: level.size[1], energy }
        });
        Ok(levels.collect())
    }
}

fn no(what: &str) -> Error {
    Error::Mismatch(format!("the CPU device has no {what}: use a Vulkan device"))
}
