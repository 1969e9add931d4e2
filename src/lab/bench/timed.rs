//! One size, method and kernel: a cold solve, some that are not counted, and those that are.

use std::time::Instant;

use super::{Cold, Dispatches, LevelReport, Memory, Options, PassReport, Relaxation, RunReport, Spread};
use crate::base::{CancellationToken, Error, Frame, Settings};
use crate::engine::arguments;
use crate::engine::profile::{Profile, Reading};
use crate::engine::{Engine, PairOptions, PreparedSolver, Solution};

/// The passes that relax: by half-iterations, and small levels in one.
const RELAX: [&str; 2] = ["relax", "relax_level"];

/// What one run took.
pub(super) struct Timed {
    size: [u32; 2],
    settings: Settings,
    cold: Cold,
    solve_ms: Vec<f64>,
    /// From submitting to the last answer.
    device_ms: Vec<f64>,
    /// By pass, in order of first use, of one solve; empty where the device has no clock.
    passes_ms: Vec<(&'static str, f64)>,
    levels: Vec<LevelReport>,
    memory: Memory,
    counts: Vec<(&'static str, usize, u64)>,
    dispatches: Dispatches,
}

/// Measures one run; where the time goes is told by one more solve, in which the device's clock is read. Each solver is gone before the next
/// comes, so that that has the memory. `pair` is the pair of this size, made here if it is not there yet: only when the size is known
/// to fit.
pub(super) fn run(
    engine: &Engine,
    options: &Options,
    size: [u32; 2],
    settings: &Settings,
    pair: &mut Option<[Frame; 2]>,
) -> Result<(Timed, Profile), Error> {
    let prepare =
        |reading| PreparedSolver::new(engine, size, options.input.formats(), settings, 1, Some(false), reading);
    let started = Instant::now();
    let mut solver = prepare(Reading::Never)?;
    let prepare_ms = milliseconds(started);
    let [i1, i2] = match pair {
        Some(pair) => pair,
        None => pair.insert(options.input.pair(size)?),
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
    let (solve_ms, device_ms) = measured.into_iter().unzip();
    drop(solver);
    let mut solver = prepare(if options.traced { Reading::Dispatches } else { Reading::Passes })?;
    let mut solved = solver.solve([i1, i2], pair_options)?;
    let (last, profile) = (solved.wait()?.to_owned(), solved.profile()?);
    let (device, host) = solver.plan().bytes();
    let pixels = f64::from(size[0]) * f64::from(size[1]);
    let timed = Timed {
        size,
        settings: settings.clone(),
        cold: Cold { prepare_ms, first_ms },
        solve_ms,
        device_ms,
        levels: levels(&last),
        passes_ms: last.findings.timings.passes_ms,
        memory: Memory { device_bytes_per_px: device as f64 / pixels, host_bytes_per_px: host as f64 / pixels },
        counts: counts(&profile),
        dispatches: Dispatches { recorded: profile.dispatches.len(), executed: profile.executed().count() },
    };
    Ok((timed, profile))
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

fn levels(solution: &Solution) -> Vec<LevelReport> {
    let of = |level: &crate::engine::LevelHistory| LevelReport {
        width: level.width,
        height: level.height,
        iterations: level.energy.len(),
    };
    solution.levels.iter().map(of).collect()
}

/// By pass: dispatches over any workgroups, and the bytes that they must move.
fn counts(profile: &Profile) -> Vec<(&'static str, usize, u64)> {
    let mut counts = Vec::<(&'static str, usize, u64)>::new();
    for dispatch in profile.executed() {
        match counts.iter_mut().find(|(known, ..)| *known == dispatch.pass) {
            Some((_, dispatches, bytes)) => (*dispatches, *bytes) = (*dispatches + 1, *bytes + dispatch.bytes),
            None => counts.push((dispatch.pass, 1, dispatch.bytes)),
        }
    }
    counts
}

impl Timed {
    /// The report, beside what the copy does in 10⁹ bytes a second.
    pub(super) fn report(self, copy: Option<f64>) -> RunReport {
        let [width, height] = self.size;
        let megapixels = f64::from(width) * f64::from(height) * 1e-6;
        let solve_ms = Spread::of(&self.solve_ms).unwrap_or_default();
        let device_ms = Spread::of(&self.device_ms);
        let passes: Vec<PassReport> = self.passes_ms.iter().map(|&(name, ms)| self.pass(name, ms, copy)).collect();
        RunReport {
            width,
            height,
            method: self.settings.method.name().to_string(),
            kernel: self.settings.kernel.name().to_string(),
            mpx_per_s: megapixels / solve_ms.median * 1e3,
            device_mpx_per_s: device_ms.as_ref().map(|ms| megapixels / ms.median * 1e3),
            solve_ms,
            device_ms,
            cold: self.cold,
            memory: self.memory,
            dispatches: self.dispatches,
            relaxation: self.relaxation(&passes, copy),
            levels: self.levels,
            passes,
        }
    }

    fn pass(&self, name: &str, ms: f64, copy: Option<f64>) -> PassReport {
        let (_, dispatches, bytes) = self.counts.iter().find(|(n, ..)| *n == name).copied().unwrap_or_default();
        let gb_per_s = if ms > 0.0 { bytes as f64 / ms * 1e-6 } else { 0.0 };
        PassReport {
            name: name.to_string(),
            ms,
            dispatches,
            bytes,
            gb_per_s,
            share_of_copy: copy.map(|c| gb_per_s / c),
        }
    }

    /// Of all levels; none where no pass has a time.
    fn relaxation(&self, passes: &[PassReport], copy: Option<f64>) -> Option<Relaxation> {
        let relaxing = || passes.iter().filter(|pass| RELAX.contains(&pass.name.as_str()));
        let ms: f64 = relaxing().map(|pass| pass.ms).sum();
        let bytes: u64 = relaxing().map(|pass| pass.bytes).sum();
        if ms <= 0.0 {
            return None;
        }
        let swept = |level: &LevelReport| {
            let iterations = arguments::relaxed(level.iterations as u32);
            f64::from(level.width) * f64::from(level.height) * f64::from(iterations * self.settings.relaxation_sweeps)
        };
        let megapixels = self.levels.iter().map(swept).sum::<f64>() * 1e-6;
        let share_of_copy = copy.map(|c| bytes as f64 / ms * 1e-6 / c);
        Some(Relaxation { mpx_sweeps_per_s: megapixels / ms * 1e3, share_of_copy })
    }
}
