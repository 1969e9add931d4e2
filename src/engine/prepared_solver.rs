//! A solver prepared for pairs of one size, format and settings, and its pairs in flight.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::cpu::pair::CpuPair;
use super::device::AnyDevice;
use super::frame_in_flight::{FrameInFlight, Memory, SURE_CORRELATION, Start};
use super::pair_memory::Shared;
use super::parallax_start;
use super::plan::Plan;
use super::record::{Profile, Reading, Workspace};
use super::script::{CountedPixels, Script};
use super::solution::{Registered, SolutionRef};
use super::source::{Source, Transfer};
use super::vulkan::{
    Clock, DeviceSolution, DeviceSource, ExternalCommandBuffer, Recorder, SemaphoreWait, SolutionBuffer, SourceCopy,
};
use super::vulkan_pair::VulkanPair;
use super::{Engine, KeyPoints};
use crate::base::{
    CancellationToken, Error, Frame, Mask, Method, Motion, Parallax, ParallaxSearch, PixelFormat, Progress, Settings,
    Shading,
};

/// Everything that is prepared before the first pair: memory, recordings and compiled passes.
pub(crate) struct PreparedSolver {
    shared: Arc<Shared>,
    device: AnyDevice,
    pool: Arc<Pool>,
    key_points: Option<KeyPoints>,
}

/// By how much another T must correlate better to be the start of a second solve. Where both are right, 0.003 to 0.02.
const BETTER: f64 = 0.1;

/// How one pair is solved.
#[derive(Clone, Copy)]
pub(crate) struct PairOptions<'a> {
    pub(crate) mask: Option<&'a Mask>,
    pub(crate) cancel: &'a CancellationToken,
    pub(crate) progress: &'a dyn Fn(Progress),
    /// The values that the pair starts from; `None`: those of the settings.
    pub(super) start: Option<Start>,
}

impl<'a> PairOptions<'a> {
    pub(crate) fn new(mask: Option<&'a Mask>, cancel: &'a CancellationToken, progress: &'a dyn Fn(Progress)) -> Self {
        Self { mask, cancel, progress, start: None }
    }
}

impl PreparedSolver {
    /// Prepares for pairs of a size and of the formats of I1 and I2. `None` prepares for both kinds of
    /// pixels.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`], [`Error::Poisoned`], [`Error::Vulkan`].
    pub(crate) fn new(
        engine: &Engine,
        [width, height]: [u32; 2],
        formats: [impl Into<PixelFormat>; 2],
        settings: &Settings,
        frames_in_flight: usize,
        pixels: Option<CountedPixels>,
        reading: Reading,
    ) -> Result<Self, Error> {
        let plan = Plan::new(width, height, formats, settings)?.for_device(engine.info());
        Self::of_plan(engine, plan, frames_in_flight, pixels, reading)
    }

    fn of_plan(
        engine: &Engine,
        plan: Plan,
        frames_in_flight: usize,
        pixels: Option<CountedPixels>,
        reading: Reading,
    ) -> Result<Self, Error> {
        let (device, count) = (engine.device().clone(), frames_in_flight.max(1));
        if let AnyDevice::Vulkan(device, _) = &device {
            device.check_usable()?;
        }
        engine.admits(&plan, count as u64)?;
        let shared = Arc::new(Shared { plan, reading });
        let memories = match &device {
            AnyDevice::Vulkan(device, pipelines) => {
                let plan = &shared.plan;
                let first = Workspace::new(device, plan, &plan.pair_layout())?;
                let mut recorder = Recorder::new(device, Clock::Never)?;
                recorder.initialize(&first.images());
                recorder.finish()?.run()?;
                let others = (1..count).map(|_| first.beside(device, plan)).collect::<Result<Vec<_>, Error>>()?;
                let pair = |workspace| VulkanPair::new(&shared, (device, pipelines), workspace, pixels);
                let pairs = [first].into_iter().chain(others).map(pair);
                pairs.map(|pair| pair.map(|pair| Memory::Vulkan(Box::new(pair)))).collect::<Result<Vec<_>, _>>()?
            }
            AnyDevice::Cpu(device) => {
                (0..count).map(|_| Memory::Cpu(Box::new(CpuPair::new(device, &shared)))).collect()
            }
        };
        let frame = |memory| FrameInFlight::new(shared.clone(), memory);
        let idle = memories.into_iter().map(frame).collect::<Result<_, _>>()?;
        let pool = Arc::new(Pool { idle: Mutex::new(idle), count });
        Ok(Self { shared, device, pool, key_points: engine.key_points() })
    }

    /// Prepares for pairs like this one: with clipped pixels if it has some. The first pair of the other kind compiles
    /// more passes.
    ///
    /// # Errors
    /// As [`PreparedSolver::new`], and [`Error::Mismatch`] where the sizes differ.
    pub(crate) fn for_frames(engine: &Engine, frames: [&Frame; 2], settings: &Settings) -> Result<Self, Error> {
        same_size(frames)?;
        let plan = Plan::new(frames[0].width(), frames[0].height(), frames.map(Frame::format), settings)?;
        Self::of_plan_for(engine, frames, plan.for_device(engine.info()))
    }

    /// Prepares for pairs like this one, of this plan.
    ///
    /// # Errors
    /// As [`PreparedSolver::new`].
    pub(crate) fn of_plan_for(engine: &Engine, frames: [&Frame; 2], plan: Plan) -> Result<Self, Error> {
        // The CPU device prepares nothing for clipped pixels.
        let is_vulkan = engine.device().as_vulkan().is_some();
        let clips = |frame: &&Frame| frame.has_clipped_pixels(plan.settings.clipped(frame.format().depth));
        let clipped = is_vulkan && frames.iter().any(clips);
        let pixels = if clipped { CountedPixels::Unmasked } else { CountedPixels::All };
        Self::of_plan(engine, plan, 1, Some(pixels), engine.reading())
    }

    /// Solves a pair and waits for it.
    pub(crate) fn solve(&mut self, frames: [&Frame; 2], options: PairOptions<'_>) -> Result<Pending, Error> {
        let frame = self.run(frames, options, |script| script.parts.len())?;
        Ok(Pending { frame, is_fetched: [false; 2] })
    }

    /// Registers a pair and waits for it.
    pub(crate) fn register(&mut self, frames: [&Frame; 2], options: PairOptions<'_>) -> Result<Registered, Error> {
        self.run(frames, options, |script| script.registered)?.registered()
    }

    /// Runs the first parts of the script, and again from key-points if T correlates worse than they do.
    fn run(
        &mut self,
        frames: [&Frame; 2],
        options: PairOptions<'_>,
        parts: fn(&Script) -> usize,
    ) -> Result<Lease, Error> {
        let (mut frame, _) = self.upload(frames.map(Source::Frame), options)?;
        frame.run(parts, options.progress)?;
        let settings = &self.shared.plan.settings;
        let is_free = options.start.is_none() && settings.motion.unknowns() >= Motion::Similarity.unknowns();
        let doubtful = frame.registered_correlation()?.filter(|found| is_free && *found <= SURE_CORRELATION);
        let (Some(find), Some(found)) = (self.key_points, doubtful) else { return Ok(frame) };
        let Ok(transform) = find(frames, settings.decode, options.mask) else { return Ok(frame) };
        if frame.correlation(transform.into())?.is_none_or(|other| other < found + BETTER) {
            return Ok(frame);
        }
        drop(frame);
        let start = Some(Start { transform: transform.into(), ..self.start(None, None)? });
        let (mut frame, _) = self.upload(frames.map(Source::Frame), PairOptions { start, ..options })?;
        frame.run(parts, &|_| ())?;
        Ok(frame)
    }

    /// Submits a pair. The device begins with it after `waits`.
    pub(crate) fn submit(
        &mut self,
        sources: [Source<'_>; 2],
        waits: &[SemaphoreWait],
        options: PairOptions<'_>,
    ) -> Result<Pending, Error> {
        let (mut frame, fetches) = self.upload(sources, options)?;
        if fetches.is_empty() {
            frame.submit(waits)?;
        } else {
            frame.vulkan("queue to wait on")?.fetch(&fetches, waits)?;
            frame.submit(&[])?;
        }
        let is_fetched = [0, 1].map(|image| fetches.iter().any(|(of, _)| *of == image));
        Ok(Pending { frame, is_fetched })
    }

    /// Records a pair into a command buffer of the embedding program.
    pub(crate) fn encode(
        &mut self,
        commands: ExternalCommandBuffer,
        sources: [DeviceSource; 2],
        options: PairOptions<'_>,
    ) -> Result<Encoded, Error> {
        let (mut frame, fetches) = self.upload(sources.map(Source::OnDevice), options)?;
        let pair = frame.vulkan("command buffers")?;
        pair.encode(commands, &fetches)?;
        let results = pair.result_buffer();
        Ok(Encoded { frame, results })
    }

    /// What does not depend on the pixels.
    pub(crate) fn plan(&self) -> &Plan {
        &self.shared.plan
    }

    /// Takes an idle frame in flight, and copies the photographs into it that the host copies. Returns the frame in
    /// flight, and the copies that the device makes.
    fn upload(
        &mut self,
        sources: [Source<'_>; 2],
        options: PairOptions<'_>,
    ) -> Result<(Lease, Vec<(usize, SourceCopy)>), Error> {
        let (plan, device) = (&self.shared.plan, &self.device);
        let mut frame = self.pool.take()?;
        let [first, second] = [0, 1].map(|image| sources[image].transfer(plan, image, device.as_vulkan()));
        let transfers = [first?, second?];
        // The device solves pairs in order, so the limit includes the time of all pairs in flight.
        let limit = device.timeout().saturating_mul(self.pool.in_use());
        frame.begin(options.mask, options.cancel, limit)?;
        let frames = if let [Transfer::Frame(i1), Transfer::Frame(i2)] = transfers { Some([i1, i2]) } else { None };
        let mut is_masked = options.mask.is_some() || frames.is_none();
        let mut fetches = Vec::new();
        for (image, transfer) in transfers.into_iter().enumerate() {
            match transfer {
                Transfer::Write(write) => {
                    let bytes = plan.packed_bytes(image) as usize;
                    frame.fill(image, &mut |mapped| write(&mut mapped[..bytes]))?;
                }
                Transfer::Frame(photograph) => {
                    let levels = plan.settings.clipped(photograph.format().depth);
                    is_masked |= frame.upload(image, photograph, levels)?;
                }
                Transfer::Rows(rows) => {
                    let mut are_numbers = true;
                    let filled = frame.fill(image, &mut |bytes| are_numbers = rows.copy(bytes));
                    if !are_numbers {
                        let problem = "a sample is not finite, or beyond 1e6: white is 1";
                        return Err(Error::Mismatch(format!("photograph {}: {problem}", image + 1)));
                    }
                    filled?;
                }
                Transfer::Fetch(fetch) => fetches.push((image, fetch)),
            }
        }
        let start = options.start.map_or_else(|| self.start(frames, options.mask), Ok)?;
        let pixels = if is_masked { CountedPixels::Unmasked } else { CountedPixels::All };
        frame.prepare(&start, pixels)?;
        Ok((frame, fetches))
    }

    /// Returns the values that a pair starts from by the settings. The method SIFT finds T by key-points.
    fn start(&self, frames: Option<[&Frame; 2]>, mask: Option<&Mask>) -> Result<Start, Error> {
        let settings = &self.shared.plan.settings;
        let transform = match (settings.method, frames, self.key_points) {
            (Method::Sift, Some(frames), Some(find)) => find(frames, settings.decode, mask)?.into(),
            (Method::Sift, ..) => return Err(Error::NoKeyPoints),
            _ => settings.start,
        };
        let found = frames
            .filter(|_| settings.parallax == ParallaxSearch::On && self.shared.plan.solves_transform())
            .and_then(|frames| parallax_start::find(frames, &self.shared.plan, mask));
        let (transform, parallax) = found.unwrap_or((transform, Parallax::NONE));
        Ok(Start {
            transform,
            photometric: settings.start_photometric,
            shading: Shading::NONE,
            kernel_shape: 0.0,
            separation: 0.0,
            parallax,
        })
    }
}

/// The frames in flight of a solver. Pairs take them and give them back.
struct Pool {
    idle: Mutex<Vec<FrameInFlight>>,
    /// Idle or not.
    count: usize,
}

impl Pool {
    fn idle(&self) -> MutexGuard<'_, Vec<FrameInFlight>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn in_use(&self) -> u32 {
        (self.count - self.idle().len()) as u32
    }

    fn take(self: &Arc<Self>) -> Result<Lease, Error> {
        let frame = self.idle().pop();
        if frame.is_none() {
            let count = self.count;
            return Err(Error::Busy { frames: count });
        }
        Ok(Lease { frame, pool: self.clone() })
    }
}

/// A frame in flight that a pair uses. Dropping it cancels a pair that is not solved, waits for it, and gives the frame
/// back.
struct Lease {
    /// `None` only inside `drop`.
    frame: Option<FrameInFlight>,
    pool: Arc<Pool>,
}

impl Deref for Lease {
    type Target = FrameInFlight;

    fn deref(&self) -> &FrameInFlight {
        self.frame.as_ref().expect("a lease has its frame until it is dropped")
    }
}

impl DerefMut for Lease {
    fn deref_mut(&mut self) -> &mut FrameInFlight {
        self.frame.as_mut().expect("a lease has its frame until it is dropped")
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        if let Some(mut frame) = self.frame.take() {
            frame.release();
            self.pool.idle().push(frame);
        }
    }
}

/// A pair that was [submitted](crate::PairSolver::submit).
///
/// It occupies one frame in flight of its solver until it is dropped. Dropping it cancels a pair that is not solved,
/// waits until the device has left it, for the engine's time limit at most, and returns the frame in flight to the
/// solver. The solver may be dropped first.
pub struct Pending {
    frame: Lease,
    is_fetched: [bool; 2],
}

impl Pending {
    /// Waits for the pair and returns its results, in mapped memory.
    ///
    /// # Errors
    /// [`Error::Cancelled`]; [`Error::Timeout`] past the engine's time limit, which poisons the engine;
    /// [`Error::Poisoned`], [`Error::Vulkan`]. The limit of a pair is
    /// [`EngineOptions::timeout`](crate::EngineOptions::timeout) for each pair in flight when it was submitted, itself
    /// included.
    pub fn wait(&mut self) -> Result<SolutionRef<'_>, Error> {
        self.frame.wait(Duration::MAX)?;
        self.frame.solution()
    }

    /// Waits for `limit` at most. Returns `None` if the pair is not solved by then.
    ///
    /// # Errors
    /// As [`Pending::wait`].
    pub fn wait_timeout(&mut self, limit: Duration) -> Result<Option<SolutionRef<'_>>, Error> {
        if !self.frame.wait(limit)? {
            return Ok(None);
        }
        self.frame.solution().map(Some)
    }

    /// Returns whether the device is done with the pair, solved or cancelled. Does not wait.
    ///
    /// # Errors
    /// As [`Pending::wait`], except [`Error::Cancelled`].
    pub fn poll(&mut self) -> Result<bool, Error> {
        self.frame.wait(Duration::ZERO)
    }

    /// Cancels the pair. The device skips the rest of it, and [`wait`](Self::wait) returns [`Error::Cancelled`].
    pub fn cancel(&self) {
        self.frame.cancel();
    }

    /// Which of the two photographs the device fetches. The host copied the others before `submit` returned.
    pub fn is_fetched(&self) -> [bool; 2] {
        self.is_fetched
    }

    /// Waits until the device has fetched its photographs, for `limit` at most. Returns whether it has: they may then
    /// be overwritten.
    ///
    /// # Errors
    /// As [`Pending::wait`], except [`Error::Cancelled`].
    pub fn wait_fetched(&mut self, limit: Duration) -> Result<bool, Error> {
        self.frame.wait_fetched(limit)
    }

    /// The buffer on the device that receives the results, and the semaphores that say when. For programs that use the
    /// results on the same device ([`Engine::from_vulkan`](crate::Engine::from_vulkan)) without a wait of the host.
    ///
    /// # Errors
    /// [`Error::Mismatch`] on the CPU device.
    pub fn on_device(&self) -> Result<DeviceSolution, Error> {
        Ok(self.frame.as_vulkan("buffer of results")?.on_device())
    }

    /// Returns the dispatches of the solve and their times.
    pub(crate) fn profile(&self) -> Result<Profile, Error> {
        self.frame.profile()
    }
}

/// A pair that was recorded into a command buffer of the embedding program
/// ([`PairSolver::encode`](crate::PairSolver::encode)).
///
/// It occupies one frame in flight of its solver until it is dropped.
pub struct Encoded {
    frame: Lease,
    results: SolutionBuffer,
}

impl Encoded {
    /// The results of the latest execution, in mapped memory; `None` until the device has executed the commands to
    /// their end.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Vulkan`].
    pub fn results(&mut self) -> Result<Option<SolutionRef<'_>>, Error> {
        if !self.frame.vulkan("command buffers")?.is_executed()? {
            return Ok(None);
        }
        self.frame.solution().map(Some)
    }

    /// Cancels the pair: executions in flight and later ones leave out what is left of the solve.
    pub fn cancel(&self) {
        self.frame.cancel();
    }

    /// The buffer on the device that receives the results.
    pub fn on_device(&self) -> SolutionBuffer {
        self.results
    }
}

/// Checks that both photographs of a pair have one size.
pub(crate) fn same_size([i1, i2]: [&Frame; 2]) -> Result<(), Error> {
    let [[w1, h1], [w2, h2]] = [i1, i2].map(|frame| [frame.width(), frame.height()]);
    if [w1, h1] == [w2, h2] {
        return Ok(());
    }
    Err(Error::Mismatch(format!("the images differ in size: {w1}x{h1} and {w2}x{h2}")))
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::base::{Kernel, Motion};
    use crate::engine::vulkan::no_conditional_rendering;
    use crate::engine::{EngineOptions, testing};

    fn submit(solver: &mut PreparedSolver, frames: &[Frame; 2]) -> Pending {
        let cancel = CancellationToken::default();
        solver.submit(frames.each_ref().map(Source::Frame), &[], PairOptions::new(None, &cancel, &|_| ())).unwrap()
    }

    #[test]
    fn the_device_leaves_out_the_rest_of_a_cancelled_pair() {
        let (engine, frames) = (Engine::new(&testing::options()).unwrap(), testing::pair([96; 2]));
        let mut solver = PreparedSolver::for_frames(&engine, frames.each_ref(), &Settings::default()).unwrap();
        let executed = |pending: &Pending| pending.profile().unwrap().executed().count();
        let mut pending = submit(&mut solver, &frames);
        pending.wait().unwrap();
        let whole = executed(&pending);
        drop(pending);
        let mut pending = submit(&mut solver, &frames);
        pending.cancel();
        assert!(matches!(pending.wait().map(drop), Err(Error::Cancelled)));
        let part = executed(&pending);
        assert!(part < whole, "{part} of {whole} dispatches");
    }

    /// The finest level is warped. Noise moves T there, so that it is warped again before some iterations.
    #[test]
    fn conditional_rendering_does_not_change_results() {
        let texture = testing::smooth_field(170, 140, 1);
        let frames = [0, 3].map(|shift| {
            let noise = testing::random(160 * 136, shift as u64);
            let value =
                |i: usize| (texture.data[(i / 160 + shift) * 170 + i % 160 + 2 * shift] + 0.4 * noise[i]) as f32;
            Frame::gray(160, 136, (0..160 * 136).map(value).collect()).unwrap()
        });
        let solve = || {
            let engine = Engine::new(&testing::options()).unwrap();
            let mut solver = PreparedSolver::for_frames(&engine, frames.each_ref(), &Settings::default()).unwrap();
            let mut pending = submit(&mut solver, &frames);
            let (bits, levels) = {
                let solution = pending.wait().unwrap();
                let bits: Vec<u32> = solution.relative_blur().iter().map(|v| v.to_bits()).collect();
                (bits, solution.levels.clone())
            };
            let dispatches = pending.profile().unwrap().dispatches;
            let linearised: Vec<_> =
                dispatches.iter().filter(|ran| ran.pass == "linearise" && ran.executed).map(|ran| ran.place).collect();
            // Of the finest level, before iterations that it had.
            let warps = dispatches.iter().filter(|ran| ran.pass == "warp" && linearised.contains(&ran.place));
            let executed: Vec<bool> = warps.map(|ran| ran.executed).collect();
            assert!(executed.contains(&true) && executed.contains(&false), "{executed:?}");
            assert!(engine.validation_messages().is_empty(), "{:?}", engine.validation_messages());
            (engine.vulkan().is_conditional(), bits, levels, executed)
        };
        let (is_conditional, bits, levels, executed) = solve();
        assert_eq!((false, bits, levels, executed), no_conditional_rendering::run(solve));
        println!("the device has conditional rendering: {is_conditional}");
    }

    /// Vulkan devices give the V of the CPU device but for rounding: with odd sizes, a coarsest grid too long for shared
    /// memory, more sweeps than one tile of each grid has room for, and more than tiles have room for.
    #[test]
    fn devices_give_the_same_relative_blur() {
        let default = Settings::default().relaxation_sweeps;
        for (size, sweeps) in [([1501, 45], default), ([331, 287], 6), ([163, 141], 9)] {
            check_devices(size, CountedPixels::All, Settings { relaxation_sweeps: sweeps, ..Settings::default() });
        }
        check_devices(
            [163, 141],
            CountedPixels::Unmasked,
            Settings { motion: Motion::Homography, ..Settings::default() },
        );
        let kernel = Kernel::HalfGaussian;
        check_devices([163, 141], CountedPixels::All, Settings { kernel, photometric: false, ..Settings::default() });
    }

    fn check_devices(size: [u32; 2], pixels: CountedPixels, settings: Settings) {
        let frames = testing::pair(size);
        let cpu = EngineOptions { device: Some("CPU".into()), ..EngineOptions::default() };
        let [vulkan, cpu] = [testing::options(), cpu].map(|options| {
            let engine = Engine::new(&options).unwrap();
            let plan = Plan::new(size[0], size[1], frames.each_ref().map(Frame::format), &settings).unwrap();
            let plan = Plan { may_pack: false, ..plan.for_device(engine.info()) };
            let mut solver = PreparedSolver::of_plan(&engine, plan, 1, Some(pixels), Reading::Never).unwrap();
            let mut pending = submit(&mut solver, &frames);
            pending.wait().unwrap().relative_blur().to_vec()
        });
        let difference = |(a, b): (&f32, &f32)| if a.is_nan() && b.is_nan() { 0.0 } else { (a - b).abs() };
        let largest = vulkan.iter().zip(&cpu).map(difference).max_by(f32::total_cmp).unwrap();
        println!("largest difference of V: {largest} px²");
        assert!(largest < 1e-3, "{size:?}: {largest}");
    }

    #[test]
    fn dropping_a_pair_in_flight_cancels_it_and_leaves_the_engine_usable() {
        let (engine, frames) = (Engine::new(&testing::options()).unwrap(), testing::pair([128; 2]));
        // With 400 iterations a whole solve takes many times as long as the end of a cancelled one.
        let settings = Settings { outer_iterations: 400, ..Settings::default() };
        let mut solver = PreparedSolver::for_frames(&engine, frames.each_ref(), &settings).unwrap();
        let started = Instant::now();
        let pending = submit(&mut solver, &frames);
        drop(solver);
        drop(pending);
        println!("dropped after {:.2} s", started.elapsed().as_secs_f64());
        assert!(!engine.vulkan().is_poisoned());
        let mut solver = PreparedSolver::for_frames(&engine, frames.each_ref(), &Settings::default()).unwrap();
        let pending = submit(&mut solver, &frames);
        let cancel = CancellationToken::default();
        let busy = solver.solve(frames.each_ref(), PairOptions::new(None, &cancel, &|_| ())).map(drop);
        assert!(matches!(busy, Err(Error::Busy { frames: 1 })), "{busy:?}");
        drop(pending);
        assert!(submit(&mut solver, &frames).wait().is_ok());
    }

    #[test]
    fn a_pair_has_the_time_of_those_before_it() {
        let options = EngineOptions { timeout: Duration::from_secs(40), ..testing::options() };
        let (engine, frames) = (Engine::new(&options).unwrap(), testing::pair([64; 2]));
        let format = [frames[0].format(); 2];
        let mut solver =
            PreparedSolver::new(&engine, [64; 2], format, &Settings::default(), 2, None, Reading::Never).unwrap();
        let pending = [0, 1].map(|_| submit(&mut solver, &frames));
        let left = pending.each_ref().map(|pending| pending.frame.time_left().as_secs());
        assert!(left[0] <= 40 && (60..=80).contains(&left[1]), "{left:?}");
    }
}
