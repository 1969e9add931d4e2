//! The tasks of a batch, each a pair or a sweep, their devices as workers of a [`Stream`], and their progress.

use std::io::{self, IsTerminal, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Instant, SystemTime};

use indicatif::{ProgressBar, ProgressStyle};
use parfocal::export::{INSPECT_FILES, InspectedPart, REPORT_FILE, is_whole, listed_in};
use parfocal::image_io::{Input, split_page};
use parfocal::metric::inspect::Verdict;
use parfocal::settings::DeviceInfo;
use parfocal::sweep::Positions;
use parfocal::{Engine, Error, PairSolver, Solution, Stream};
use serde_json::json;

use crate::cli::batch::on_done::OnDone;
use crate::cli::batch::outcome::Outcome;
use crate::cli::batch::pairs::Group;
use crate::cli::batch::summary::Row;
use crate::cli::inspection::judge::Judge;
use crate::cli::inspection::verdict::{PartVerdict, utc};
use crate::cli::jobs::pair::{PairJob, Photographs};
use crate::cli::jobs::sweep::SweepJob;
use crate::cli::options::photographs::SweepFiles;
use crate::cli::options::run::{EngineArguments, RunArguments, check_validation};
use crate::cli::options::solve::Request;
use crate::cli::output::failure::{Failure, plain};

/// Number of workers per device: while one solves, the others read and write.
const WORKERS_PER_DEVICE: usize = 3;

/// The data that all tasks of a batch share.
pub(crate) struct Context {
    pub(crate) request: Request,
    /// Whether complete results of the same photographs and options are kept.
    pub(crate) resume: bool,
    /// The device with the least memory, which limits the size of photographs.
    pub(crate) device: DeviceInfo,
    /// The golden parts that each part is judged by.
    pub(crate) judge: Option<Judge>,
    /// The program that each part is passed on to.
    pub(crate) on_done: Option<OnDone>,
    /// Set by Ctrl-C.
    pub(crate) stop: Arc<AtomicBool>,
}

/// The devices of a batch.
pub(crate) struct Devices(Vec<Arc<Mutex<Device>>>);

/// A device, with the solver of its last pair.
struct Device {
    /// The engine; `None` after a fault, if the device cannot be opened again.
    engine: Option<Engine>,
    solver: Option<PairSolver>,
    arguments: EngineArguments,
    /// The reason why it cannot be opened again.
    failure: Option<Failure>,
}

/// A pair or a sweep, and the name of its results.
pub(crate) struct Task {
    name: String,
    job: Job,
    /// The reason why it cannot be solved or written, found before any work.
    refused: Option<Failure>,
    /// When its photographs were complete; `None` if they were before the batch began.
    arrived: Option<Instant>,
}

/// When a task began, and when its photographs were last changed, as read before they were.
type Begun = (Instant, Option<SystemTime>);

enum Job {
    Pair(PairJob),
    Sweep(SweepJob),
}

/// The reason why a task has no results.
enum Ending {
    Failed(Failure),
    /// The batch was interrupted.
    Stopped,
    /// The device of the worker failed and cannot be opened again.
    NoDevice,
}

impl From<Failure> for Ending {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

impl Devices {
    /// Opens each requested device.
    pub(crate) fn open(arguments: &EngineArguments) -> Result<Self, Failure> {
        let open = |arguments: EngineArguments| {
            let engine = Some(arguments.open()?);
            Ok(Arc::new(Mutex::new(Device { engine, solver: None, arguments, failure: None })))
        };
        Ok(Self(arguments.each()?.into_iter().map(open).collect::<Result<_, Failure>>()?))
    }

    /// The device with the least memory.
    pub(crate) fn least(&self) -> Result<DeviceInfo, Failure> {
        let infos = self.0.iter().filter_map(|device| lock(device).engine.as_ref().map(|engine| engine.info().clone()));
        Ok(infos.min_by_key(|info| info.memory_bytes).ok_or(Error::NoDevice(String::new()))?)
    }

    /// Starts the workers.
    pub(crate) fn stream(&self, context: &Arc<Context>) -> Result<Stream<Arc<Task>, Row>, Failure> {
        let workers = self.0.iter().flat_map(|device| {
            let (device, context) = (device.clone(), context.clone());
            (0..WORKERS_PER_DEVICE).map(move |_| {
                let (device, context) = (device.clone(), context.clone());
                move |task: &Arc<Task>| task.run(&context, &device).map(Ok).ok_or(Error::Poisoned)
            })
        });
        let workers: Vec<_> = workers.collect();
        let capacity = 2 * workers.len();
        Ok(Stream::of_workers(workers, capacity)?)
    }

    /// Fails if a device failed and could not be opened again, or if the validation layer has reported a message.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        self.0.iter().try_for_each(|device| {
            let mut device = lock(device);
            device.failure.take().map_or(Ok(()), Err)?;
            device.engine.as_ref().map_or(Ok(()), check_validation)
        })
    }
}

fn lock(device: &Mutex<Device>) -> std::sync::MutexGuard<'_, Device> {
    // A panic ended a solve. The engine can still be used.
    device.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Device {
    /// Runs a solve on the engine. After a fault of the device, opens it again for later tasks.
    fn solve<T>(
        &mut self,
        context: &Context,
        first: &Path,
        solve: impl FnOnce(&Engine, &mut Option<PairSolver>) -> Result<T, Error>,
    ) -> Result<(T, DeviceInfo), Ending> {
        if context.stop.load(Ordering::Relaxed) {
            return Err(Ending::Stopped);
        }
        let Some(engine) = &self.engine else { return Err(Ending::NoDevice) };
        let solved = solve(engine, &mut self.solver);
        let info = engine.info().clone();
        if matches!(solved, Err(Error::Timeout { .. } | Error::Poisoned | Error::Vulkan { .. })) {
            (self.solver, self.engine) = (None, None);
            match self.arguments.open() {
                Ok(engine) => self.engine = Some(engine),
                Err(failure) => self.failure = Some(failure),
            }
        }
        Ok((solved.map_err(|error| Failure::of_solve(error, first))?, info))
    }
}

/// Solves a pair with the solver of the previous pair.
fn solve_pair(
    engine: &Engine,
    cached: &mut Option<PairSolver>,
    Photographs { scope, frames, settings, .. }: &Photographs,
) -> Result<Solution, Error> {
    let mut solver = match cached.take() {
        Some(solver) => solver,
        None => PairSolver::new(engine, settings)?,
    };
    solver.set_settings(settings)?;
    cached.insert(solver).solve(frames.each_ref(), scope)
}

impl Task {
    pub(crate) fn new(out: &Path, Group { name, files, left_out, problem, .. }: Group, request: &Request) -> Self {
        let out = out.join(&name);
        let job = match <[PathBuf; 2]>::try_from(files) {
            Ok(files) => Job::Pair(PairJob { files, out }),
            Err(frames) => {
                let (files, positions) = (SweepFiles { left_out, ..SweepFiles::of(frames) }, Positions::Counted);
                Job::Sweep(SweepJob { files, positions, reference: None, out })
            }
        };
        let refused = problem.map(Failure::Failed).or_else(|| job.check(request).err());
        Self { name, job, refused, arrived: None }
    }

    /// Sets when its photographs were complete.
    pub(crate) fn arrived(self, at: Instant) -> Self {
        Self { arrived: Some(at), ..self }
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn row(&self, outcome: Outcome) -> Row {
        Row::new(&self.name, self.job.files(), self.job.out(), outcome)
    }

    /// Fails, before a device is opened, if the options do not apply to a task.
    pub(crate) fn check_all(tasks: &[Arc<Self>]) -> Result<(), Failure> {
        let mut refused = tasks.iter().filter_map(|task| task.refused.as_ref());
        let usage = refused.find(|failure| matches!(failure, Failure::Usage(_)));
        usage.map_or(Ok(()), |failure| Err(failure.clone()))
    }

    /// Reads, solves and writes a task; `None` if the device is lost. A panic fails only this task.
    fn run(&self, context: &Context, device: &Mutex<Device>) -> Option<Row> {
        let begun = (self.arrived.unwrap_or_else(Instant::now), changed(self.job.files()));
        let ended = catch_unwind(AssertUnwindSafe(|| self.outcome(context, device))).unwrap_or_else(|_| {
            Err(Ending::Failed(Failure::Failed(format!("an internal error of parfocal{REPORTED}"))))
        });
        let outcome = match ended {
            Ok(outcome) => outcome,
            Err(Ending::Failed(failure)) => Outcome::Failed { error: failure.message() },
            Err(Ending::Stopped) => Outcome::NotDone,
            Err(Ending::NoDevice) => return None,
        };
        Some(self.judged_row(context.judge.as_ref(), &context.request, outcome, begun))
    }

    /// The row of a task that was refused before any work; `None` if it was not.
    pub(crate) fn refusal(&self, judge: Option<&Judge>, request: &Request) -> Option<Row> {
        let error = self.refused.as_ref()?.message();
        Some(self.judged_row(judge, request, Outcome::Failed { error }, (Instant::now(), changed(self.job.files()))))
    }

    fn judged_row(&self, judge: Option<&Judge>, request: &Request, outcome: Outcome, begun: Begun) -> Row {
        let mut row = self.row(outcome);
        row.inspection = judge.and_then(|judge| self.verdict(judge, request, &row.outcome, begun));
        row
    }

    /// Judges the results, and writes inspect.json and inspect.png beside them. A part without results, or that fails
    /// to be judged, cannot be judged, and an earlier inspection of it is removed. `None` if the part was not started.
    fn verdict(
        &self,
        judge: &Judge,
        request: &Request,
        outcome: &Outcome,
        (began, changed): Begun,
    ) -> Option<PartVerdict> {
        let (out, serial, time) = (self.job.out(), self.name.clone(), changed.map(utc));
        let label = InspectedPart {
            part: out.display().to_string(),
            serial: serial.clone(),
            time: time.clone().unwrap_or_else(|| utc(SystemTime::now())),
        };
        let mut is_written = false;
        let judged = || {
            let judged = judge.judge(out, label)?;
            let (verdict, mut reasons) = (judged.report.verdict, judged.report.reasons.clone());
            let written = judged.write(request.force.to(out));
            is_written = written.is_ok();
            // A go that nothing beside the results says is none.
            let verdict = if is_written || verdict == Verdict::NoGo { verdict } else { Verdict::CannotJudge };
            reasons.extend(written.err().map(|failure| failure.message()));
            Ok((verdict, reasons))
        };
        let ended = match outcome {
            Outcome::NotDone => return None,
            Outcome::Failed { error } => Err(Failure::Failed(error.clone())),
            Outcome::Solved(_) | Outcome::Kept(_) => catch_unwind(AssertUnwindSafe(judged))
                .unwrap_or_else(|_| Err(Failure::Failed(format!("an internal error of parfocal{REPORTED}")))),
        };
        let (verdict, mut reasons) = ended.unwrap_or_else(|failure| (Verdict::CannotJudge, vec![failure.message()]));
        // A name such as .. is refused, and is no folder of results.
        let is_own = Path::new(&self.name).file_name().is_some_and(|name| name == self.name.as_str());
        if !is_written && is_own {
            reasons.extend(remove_inspection(out).err().map(|e| format!("{}: {e}", out.display())));
        }
        let is_timed = self.refused.is_none() && !matches!(outcome, Outcome::Kept(_));
        let (judged, seconds) = (utc(SystemTime::now()), is_timed.then(|| began.elapsed().as_secs_f64()));
        Some(PartVerdict { serial, time, judged, verdict, reasons, seconds })
    }

    fn outcome(&self, context: &Context, device: &Mutex<Device>) -> Result<Outcome, Ending> {
        if context.stop.load(Ordering::Relaxed) {
            return Err(Ending::Stopped);
        }
        if let Some(failure) = &self.refused {
            return Err(Ending::Failed(failure.clone()));
        }
        let (request, first) = (&context.request, &self.job.files()[0]);
        let is_current = |inputs: &[Input]| self.job.is_current(context, inputs);
        let info = || Ok(context.device.clone());
        let mark = || context.on_done.as_ref().map_or(Ok(()), |program| program.mark(&self.name));
        match &self.job {
            Job::Pair(job) => {
                let Some(read) = job.read(request, is_current, info)? else {
                    return Ok(Outcome::kept(&job.out)?);
                };
                let (solution, device) =
                    lock(device).solve(context, first, |engine, cached| solve_pair(engine, cached, &read))?;
                mark()?;
                Ok(Outcome::solved(&job.write(request, &device, &read, &solution)?)?)
            }
            Job::Sweep(job) => {
                let Some(read) = job.read(request, is_current, info)? else {
                    return Ok(Outcome::kept(&job.out)?);
                };
                let (solved, device) = lock(device).solve(context, first, |engine, _| read.solve(engine, None))?;
                mark()?;
                Ok(Outcome::solved(&job.write(request, &device, &read, &solved)?)?)
            }
        }
    }
}

impl Job {
    fn check(&self, request: &Request) -> Result<(), Failure> {
        match self {
            Self::Pair(job) => job.check(request),
            Self::Sweep(job) => job.check(request),
        }
    }

    fn files(&self) -> &[PathBuf] {
        match self {
            Self::Pair(job) => &job.files,
            Self::Sweep(job) => &job.files.frames,
        }
    }

    fn out(&self) -> &Path {
        match self {
            Self::Pair(job) => &job.out,
            Self::Sweep(job) => &job.out,
        }
    }

    /// Whether complete results of the same photographs and options exist.
    fn is_current(&self, context: &Context, inputs: &[Input]) -> Result<bool, Failure> {
        if !context.resume {
            return Ok(false);
        }
        let Some(report) = Outcome::report(self.out())? else { return Ok(false) };
        let digest = match self {
            Self::Pair(_) => context.request.digest(&[])?,
            Self::Sweep(job) => job.digest(&context.request)?,
        };
        let is_same = |(i, input): (usize, &Input)| {
            let page = report["inputs"][i]["page"].as_u64().map(|page| page as usize);
            report["inputs"][i]["sha256"].as_str() == Some(&input.sha256) && page == input.page
        };
        let count = report["inputs"].as_array().map_or(0, Vec::len);
        Ok(report["request_sha256"].as_str() == Some(&digest)
            && count == inputs.len()
            && inputs.iter().enumerate().all(is_same)
            && is_whole(self.out(), REPORT_FILE, &report))
    }
}

/// Removes the earlier inspection in a folder, whose verdict holds no longer: the files that its report lists.
fn remove_inspection(out: &Path) -> io::Result<()> {
    let listed = listed_in(out, INSPECT_FILES[0]);
    let own = INSPECT_FILES.into_iter().filter(|name| listed.iter().any(|listed| listed == name));
    own.into_iter().try_for_each(|name| match std::fs::remove_file(out.join(name)) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    })
}

/// The end of the message of an internal error.
const REPORTED: &str = ", reported above; the other pairs go on";

/// When photographs were last changed; `None` if one is gone.
fn changed(files: &[PathBuf]) -> Option<SystemTime> {
    let times = files.iter().map(|file| split_page(file).0.metadata().and_then(|found| found.modified()).ok());
    times.collect::<Option<Vec<_>>>()?.into_iter().max()
}

/// Progress of a batch: a bar on a terminal, elsewhere a line for each pair.
pub(crate) struct BatchProgress {
    bar: ProgressBar,
    lines: bool,
    /// Whether to print a line of JSON for each pair.
    json: bool,
    /// Number of pairs; 0 if unknown.
    pairs: usize,
    done: AtomicUsize,
}

impl BatchProgress {
    /// Makes the progress of an unknown number of pairs: a line for each.
    pub(crate) fn endless(run: &RunArguments) -> Self {
        let (quiet, json) = (run.report.is_quiet(), run.is_json());
        Self { bar: ProgressBar::hidden(), lines: !quiet && !json, json, pairs: 0, done: AtomicUsize::new(0) }
    }

    /// Makes the progress of a number of pairs.
    pub(crate) fn new(pairs: usize, run: &RunArguments) -> Self {
        let (quiet, json) = (run.report.is_quiet() || run.is_json(), run.is_json());
        let terminal = io::stderr().is_terminal();
        let bar = if terminal && !quiet { ProgressBar::new(pairs as u64) } else { ProgressBar::hidden() };
        let template = "{pos}/{len} {bar:24} {elapsed}, {rate}, {eta} left  {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.with_key(
                "rate",
                |state: &indicatif::ProgressState, text: &mut dyn std::fmt::Write| {
                    let _ = match state.per_sec() {
                        rate if rate > 0.0 => write!(text, "{:.1} s a pair", 1.0 / rate),
                        _ => write!(text, "- s a pair"),
                    };
                },
            ));
        }
        bar.tick();
        Self { bar, lines: !terminal && !quiet, json, pairs, done: AtomicUsize::new(0) }
    }

    /// Counts and displays the outcome of a pair.
    pub(crate) fn show(&self, row: &Row) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if matches!(row.outcome, Outcome::Kept(_)) {
            // Kept results take no time, so they must not change the estimate.
            self.bar.dec_length(1);
        } else {
            self.bar.inc(1);
        }
        self.bar.set_message(plain(&row.name));
        if self.json {
            let mut line = json!({ "name": row.name, "status": row.outcome.status() });
            if let Some(part) = &row.inspection {
                line["verdict"] = json!(part.verdict);
            }
            if self.pairs > 0 {
                (line["done"], line["of"]) = (done.into(), self.pairs.into());
            }
            let _ = writeln!(io::stderr(), "{line}");
            return;
        }
        let line = match self.pairs {
            0 => row.line(),
            pairs => format!("{done}/{pairs} {}", row.line()),
        };
        if self.lines {
            let _ = writeln!(io::stderr(), "{line}");
        } else if matches!(row.outcome, Outcome::Failed { .. }) {
            self.bar.println(line);
        }
    }
}

impl Drop for BatchProgress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
