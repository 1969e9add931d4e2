//! One run of a pair, method and kernel: a cold solve, warm-ups, and measured solves. Also measures the bandwidth of a
//! copy.

use std::sync::Arc;
use std::time::Instant;

use super::input::{Input, Options};
use super::report::{Case, Cold, Dispatches, LevelReport, Memory, PassReport, Relaxation, RunReport, Spread};
use crate::base::{CancellationToken, Error, Frame, Settings};
use crate::engine::arguments;
use crate::engine::record::{Profile, Reading};
use crate::engine::stages::NO_VARIANT;
use crate::engine::stages::copy::{self, Constants};
use crate::engine::stages::pass::Pass;
use crate::engine::vulkan::{Clock, Device, Image, Pipeline, Recorder, Resource, Texel, Workgroups};
use crate::engine::{CountedPixels, Engine, PairOptions, PreparedSolver};

/// The relaxation passes: half-iterations, whole small levels, and tiles.
const RELAX: [&str; 2] = ["relax", "relax_tiles"];

/// Measures one run. An additional solve with device timestamps measures the passes.
///
/// Each solver is dropped before the next is prepared, to free its memory. `pair` holds the frames of the
/// input, which are made here once the size is known to fit. `copy` is the bandwidth of a copy, 10⁹ bytes per second.
pub(super) fn run(
    engine: &Engine,
    options: &Options,
    input: &Input,
    settings: &Settings,
    pair: &mut Option<[Frame; 2]>,
    copy: Option<f64>,
) -> Result<(RunReport, Profile), Error> {
    let size = input.size();
    let pixels = Some(CountedPixels::All);
    let prepare = |reading| PreparedSolver::new(engine, size, input.formats(), settings, 1, pixels, reading);
    let started = Instant::now();
    let mut solver = prepare(Reading::Never)?;
    let prepare_ms = milliseconds(started);
    let [i1, i2] = match pair {
        Some(pair) => pair,
        None => pair.insert(input.pair()?),
    };
    let cancel = CancellationToken::default();
    let pair_options = PairOptions::new(None, &cancel, &|_| ());
    let mut solve = || {
        let started = Instant::now();
        let device_ms = solver.solve([i1, i2], pair_options)?.wait()?.timings.gpu_ms;
        Ok::<_, Error>((milliseconds(started), device_ms))
    };
    let (first_ms, _) = solve()?;
    for _ in 0..options.warmup {
        solve()?;
    }
    let measured = (0..options.repeats.max(1)).map(|_| solve()).collect::<Result<Vec<_>, Error>>()?;
    let (solve_ms, device_ms): (Vec<f64>, Vec<f64>) = measured.into_iter().unzip();
    drop(solver);
    let mut solver = prepare(if options.traced { Reading::Dispatches } else { Reading::Passes })?;
    let mut solved = solver.solve([i1, i2], pair_options)?;
    let (last, profile) = (solved.wait()?.to_owned(), solved.profile()?);
    let levels = last.levels.iter();
    let levels: Vec<LevelReport> =
        levels.map(|l| LevelReport { width: l.width, height: l.height, iterations: l.energy.len() }).collect();
    let passes = last.findings.timings.passes_ms.iter().map(|&(name, ms)| pass(&profile, name, ms, copy));
    let passes: Vec<PassReport> = passes.collect();
    let (device_bytes, host_bytes) = solver.plan().bytes();
    let pixels = size.map(f64::from).iter().product::<f64>();
    let solve_ms = Spread::of(&solve_ms).unwrap_or_default();
    let device_ms = Spread::of(&device_ms);
    let report = RunReport {
        case: Case::new(input, settings),
        mpx_per_s: pixels * 1e-6 / solve_ms.median * 1e3,
        device_mpx_per_s: device_ms.as_ref().map(|ms| pixels * 1e-6 / ms.median * 1e3),
        solve_ms,
        device_ms,
        cold: Cold { prepare_ms, first_ms },
        memory: Memory {
            device_bytes_per_px: device_bytes as f64 / pixels,
            host_bytes_per_px: host_bytes as f64 / pixels,
        },
        dispatches: Dispatches { recorded: profile.dispatches.len(), executed: profile.executed().count() },
        relaxation: relaxation(&levels, settings.relaxation_sweeps, &passes, copy),
        converged: Some(last.findings.converged),
        levels,
        passes,
    };
    Ok((report, profile))
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// The dispatches of a pass with at least one workgroup, and the bytes that they must move.
fn pass(profile: &Profile, name: &str, ms: f64, copy: Option<f64>) -> PassReport {
    let (mut dispatches, mut bytes) = (0, 0);
    for dispatch in profile.executed().filter(|dispatch| dispatch.pass == name) {
        (dispatches, bytes) = (dispatches + 1, bytes + dispatch.bytes);
    }
    let gb_per_s = if ms > 0.0 { bytes as f64 / ms * 1e-6 } else { 0.0 };
    PassReport { name: name.to_string(), ms, dispatches, bytes, gb_per_s, share_of_copy: copy.map(|c| gb_per_s / c) }
}

/// The relaxation on all levels; `None` if no pass has a time.
fn relaxation(levels: &[LevelReport], sweeps: u32, passes: &[PassReport], copy: Option<f64>) -> Option<Relaxation> {
    let relaxing = || passes.iter().filter(|pass| RELAX.contains(&pass.name.as_str()));
    let ms: f64 = relaxing().map(|pass| pass.ms).sum();
    let bytes: u64 = relaxing().map(|pass| pass.bytes).sum();
    if ms <= 0.0 {
        return None;
    }
    let relaxed = |level: &LevelReport| {
        let iterations = arguments::relaxed(level.iterations as u32);
        f64::from(level.width) * f64::from(level.height) * f64::from(iterations * sweeps)
    };
    let megapixels = levels.iter().map(relaxed).sum::<f64>() * 1e-6;
    let share_of_copy = copy.map(|c| bytes as f64 / ms * 1e-6 / c);
    Some(Relaxation { mpx_sweeps_per_s: megapixels / ms * 1e3, share_of_copy })
}

/// Width and height of the copied image, px, within the limits of every Vulkan device. Two images of 64 MiB exceed most
/// caches.
const COPY_SIZE: [u32; 2] = [4096, 4096];
/// Number of timed copies.
const COPIES: u32 = 8;

/// The bandwidth of a pass that copies an image of floats, in the memory that all passes use: 10⁹ bytes read and
/// written per second. `None` without device timestamps.
pub(super) fn copy_bandwidth(engine: &Engine) -> Result<Option<Spread>, Error> {
    let Some(device) = engine.device().as_vulkan() else { return Ok(None) };
    let pipeline = Arc::new(Pipeline::new(device, &copy::STAGE)?);
    let [width, height] = COPY_SIZE;
    let (from, to) = (image(device, "copied from")?, image(device, "copied to")?);
    let constants = Constants { width, height, layer: 0 };
    let copy = |recorder: &mut Recorder| {
        let resources = [Resource::Image(&from), Resource::Image(&to)];
        recorder.barrier();
        let groups = Workgroups::Direct(copy::STAGE.groups(COPY_SIZE));
        recorder.dispatch(&pipeline, &resources, bytemuck::bytes_of(&constants), groups)
    };
    // The first copy commits the memory pages.
    let mut first = Recorder::new(device, Clock::Never)?;
    first.initialize(&[&from, &to]);
    first.clear_image(&from, 0..1);
    copy(&mut first)?;
    first.finish()?.run()?;
    let mut recorder = Recorder::new(device, Clock::Dispatches(COPIES))?;
    for _ in 0..COPIES {
        copy(&mut recorder)?;
    }
    let mut recording = recorder.finish()?;
    recording.run()?;
    let ends = recording.times()?.ends_ms;
    let starts = std::iter::once(0.0).chain(ends.iter().copied());
    let rate = |ms: f64| copy::Bindings::bytes(&constants, NO_VARIANT) as f64 / ms * 1e-6;
    let rates: Vec<f64> = starts.zip(&ends).map(|(start, end)| rate(end - start)).collect();
    Ok(Spread::of(&rates))
}

fn image(device: &Arc<Device>, name: &str) -> Result<Arc<Image>, Error> {
    Image::new(device, name, COPY_SIZE, 1, Texel::One)
}
