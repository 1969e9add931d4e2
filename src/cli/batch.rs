//! `parfocal batch`: many pairs and sweeps, one after the other, while the next is read and the last is written.

use std::io::{self, IsTerminal, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use parfocal::export::{FileKind, abandon, is_whole, write_named};
use parfocal::focus_stack::{Positions, Sweep};
use parfocal::image_io::Input;
use parfocal::{DeviceInfo, Engine, Error, Kept, Solution};
use serde_json::json;

use super::failure::{Failure, plain};
use super::headings::OUTPUT;
use super::help;
use super::on_done::OnDone;
use super::options::SolveOptions;
use super::pairs::Group;
use super::request::Request;
use super::run::RunArguments;
use super::shard::Shard;
use super::sweep_work::{self, SweepFrames, SweepJob};
use super::tally::{INDEX, Outcome, REPORT, Row, SUMMARY, Tally};
use super::work::{self, Job, Photographs};
use super::{ending, output, pairs};

/// Solve many pairs and focus sweeps: those of a folder, or of a list.
#[derive(clap::Args, Debug)]
#[command(after_long_help = after_help())]
pub(super) struct Arguments {
    /// Folder of photographs or of folders, or list of pairs and sweeps, as CSV or JSON lines
    #[arg(value_name = "DIR|MANIFEST")]
    source: PathBuf,
    #[command(flatten)]
    options: SolveOptions,
    /// Folder for a folder of results for each pair, and batch.json; made if it is missing
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT, display_order = 0)]
    output: PathBuf,
    /// Leave out pairs whose results are there, whole, and of the same photographs and options
    #[arg(long, help_heading = OUTPUT)]
    resume: bool,
    /// Solve the I-th of N shares, I from 1, for N processes or machines over one folder of results
    ///
    /// The first pair is of share 1, the second of share 2, and so on. The summary is batch-I-of-N.json; when all are
    /// done, the same batch with --resume and without --shard solves what is missing and writes batch.json and
    /// index.html.
    #[arg(long, value_name = "I/N", help_heading = OUTPUT)]
    shard: Option<Shard>,
}

fn after_help() -> String {
    format!(
        "{}\n\nA pair that fails is reported and the others go on. Ctrl-C finishes the pair at hand and writes the summary;\n\
         a second one ends at once.\n\nExit status: 0 all done, 1 a pair failed, 2 wrong usage, 130 ended by Ctrl-C.\n\n\
         Examples:\n  parfocal batch shots -o results --regularization 0.001\n  parfocal batch list.csv -o results --resume",
        help::wrapped(pairs::RULE, help::WIDTH)
    )
}

/// What is the same for all pairs.
pub(super) struct Shared {
    pub(super) request: Request,
    pub(super) resume: bool,
    /// What all are solved on.
    pub(super) device: DeviceInfo,
    /// Set by Ctrl-C.
    pub(super) stop: Arc<AtomicBool>,
    /// What is run of each that was solved.
    pub(super) on_done: Option<OnDone>,
}

/// A pair or a sweep, and what its results are called.
pub(super) struct Named {
    name: String,
    task: Task,
}

enum Task {
    Pair(Job),
    Sweep(SweepJob),
}

/// One on its way from the reader to the solver.
enum Read {
    Photographs(Box<Photographs>),
    Frames(Box<SweepFrames>),
    Whole,
    Failed(Failure),
}

/// One on its way from the solver to the writer.
enum Solved {
    Solution(Box<(Photographs, Solution, DeviceInfo)>),
    Sweep(Box<(SweepFrames, (Sweep, f64), DeviceInfo)>),
    Whole,
    Failed(Failure),
}

/// Solves all pairs and says what came of each.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let started = Instant::now();
    let (source, out) = (&arguments.source, &arguments.output);
    let request = arguments.options.request()?;
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let summary = arguments.shard.map_or_else(|| SUMMARY.to_string(), Shard::summary);
    output::check_folder(out)?;
    request.force.to(out).check_named(FileKind::Batch, &[&summary])?;
    let has_page = request.page && arguments.shard.is_none();
    if has_page {
        request.force.to(out).check_named(FileKind::BatchPage, &[INDEX])?;
    }
    let found = pairs::find(source, out, arguments.options.raw())?;
    let jobs: Vec<Named> = shard.of(found.groups).map(|group| Named::new(out, group)).collect();
    jobs.iter().try_for_each(|named| named.check(&request))?;
    let stop = on_interrupt();
    let mut bench = Bench::new(request.run.open_engine()?);
    let (resume, device) = (arguments.resume, bench.engine.info().clone());
    let shared = Shared { request, resume, device, stop, on_done: None };
    let Request { run, force, .. } = &shared.request;
    let bar = Bar::new(jobs.len(), run);
    let (rows, ended) = work_off(&mut bench, &jobs, &shared, &bar)?;
    drop(bar);
    let interrupted = shared.stop.load(Ordering::Relaxed);
    let tally = Tally::new(source, rows, found.left_over, interrupted, started.elapsed());
    let json = tally.to_json()?;
    write_named(force.to(out), &summary, FileKind::Batch, format!("{json}\n").as_bytes())?;
    if has_page {
        write_named(force.to(out), INDEX, FileKind::BatchPage, tally.page(out).as_bytes())?;
    }
    run.told.tell(&tally.table(&out.join(&summary)), || Ok(json))?;
    ended?;
    tally.check(run.strict)
}

impl Named {
    pub(super) fn new(out: &Path, Group { name, files }: Group) -> Self {
        let out = out.join(&name);
        let task = match <[PathBuf; 2]>::try_from(files) {
            Ok(files) => Task::Pair(Job { files, out }),
            Err(files) => Task::Sweep(SweepJob { files, positions: Positions::Counted, reference: None, out }),
        };
        Self { name, task }
    }

    pub(super) fn row(&self, outcome: Outcome) -> Row {
        Row::new(&self.name, self.task.files(), self.task.out(), outcome)
    }

    /// Refuses what cannot be done, before any work.
    pub(super) fn check(&self, request: &Request) -> Result<(), Failure> {
        match &self.task {
            Task::Pair(job) => work::check(request, job),
            Task::Sweep(job) => sweep_work::check(request, job),
        }
    }
}

impl Task {
    fn files(&self) -> &[PathBuf] {
        match self {
            Self::Pair(job) => &job.files,
            Self::Sweep(job) => &job.files,
        }
    }

    fn out(&self) -> &Path {
        match self {
            Self::Pair(job) => &job.out,
            Self::Sweep(job) => &job.out,
        }
    }

    /// Reads the photographs, unless the results are there.
    fn read(&self, shared: &Shared) -> Result<Read, Failure> {
        let request = &shared.request;
        let settled = |inputs: &[Input]| self.is_settled(shared, inputs);
        let device = || Ok(shared.device.clone());
        Ok(match self {
            Self::Pair(job) => {
                work::read(request, job, settled, device)?.map_or(Read::Whole, |read| Read::Photographs(Box::new(read)))
            }
            Self::Sweep(job) => sweep_work::read(request, job, settled, device)?
                .map_or(Read::Whole, |read| Read::Frames(Box::new(read))),
        })
    }

    /// Whether the results are there, all that the report names and as they were written, and of what is asked.
    fn is_settled(&self, shared: &Shared, inputs: &[Input]) -> Result<bool, Failure> {
        let Some(report) = shared.resume.then(|| Outcome::report(self.out())).flatten() else { return Ok(false) };
        let digest = match self {
            Self::Pair(_) => shared.request.digest(&[])?,
            Self::Sweep(job) => job.digest(&shared.request)?,
        };
        let is_of = |(i, input): (usize, &Input)| {
            let page = report["inputs"][i]["page"].as_u64().map(|page| page as usize);
            report["inputs"][i]["sha256"].as_str() == Some(&input.sha256) && page == input.page
        };
        let known = report["inputs"].as_array().map_or(0, Vec::len);
        Ok(report["request"].as_str() == Some(&digest)
            && known == inputs.len()
            && inputs.iter().enumerate().all(is_of)
            && is_whole(self.out(), REPORT, &report))
    }

    /// Writes what was solved; what is said of it.
    fn write(&self, request: &Request, solved: Solved) -> Result<Outcome, Failure> {
        match (self, solved) {
            (Self::Pair(job), Solved::Solution(solved)) => {
                let (photographs, solution, device) = *solved;
                let (report, _) = work::write(request, job, &device, &photographs, &solution)?;
                Ok(Outcome::solved(&report))
            }
            (Self::Sweep(job), Solved::Sweep(solved)) => {
                let (frames, sweep, device) = *solved;
                Ok(Outcome::solved(&sweep_work::write(request, job, &device, &frames, &sweep)?))
            }
            (_, Solved::Failed(failure)) => Err(failure),
            _ => Ok(Outcome::kept(self.out())),
        }
    }
}

/// A flag that the first Ctrl-C or SIGTERM sets; the second removes what is half written and ends the program.
pub(super) fn on_interrupt() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ending::listen(move |status| {
        if flag.swap(true, Ordering::Relaxed) {
            abandon();
            std::process::exit(status);
        }
        let _ = writeln!(io::stderr(), "\nfinishing the pair at hand; Ctrl-C again ends at once");
    });
    stop
}

/// What came of each pair, and whether the device held out to the end.
pub(super) type Worked = (Vec<Row>, Result<(), Failure>);

/// Three threads in a row, each at most one pair ahead of the next: what is read and not yet solved stays small. Where there
/// are not so many threads, one does the work of the other.
pub(super) fn work_off(bench: &mut Bench, jobs: &[Named], shared: &Shared, bar: &Bar) -> Result<Worked, Failure> {
    thread::scope(|scope| {
        let (to_solver, from_reader) = sync_channel(1);
        let read = all_read(jobs, shared);
        let reader = thread::Builder::new().spawn_scoped(scope, move || send_all(read, &to_solver));
        let read: Box<dyn Iterator<Item = (usize, Read)>> = match reader {
            Ok(_) => Box::new(from_reader.into_iter()),
            Err(_) => Box::new(all_read(jobs, shared)),
        };
        let (to_writer, from_solver) = sync_channel(1);
        let writer = thread::Builder::new().spawn_scoped(scope, move || {
            let mut rows = not_done(jobs);
            from_solver.into_iter().for_each(|(index, solved)| write(jobs, shared, bar, &mut rows, index, solved));
            rows
        });
        let Ok(writer) = writer else {
            let mut rows = not_done(jobs);
            let solved = solve_all(bench, jobs, shared, read, |index, solved| {
                write(jobs, shared, bar, &mut rows, index, solved);
                true
            });
            return Ok((rows, solved));
        };
        let solved = solve_all(bench, jobs, shared, read, |index, solved| to_writer.send((index, solved)).is_ok());
        drop(to_writer);
        let rows =
            writer.join().map_err(|_| Failure::Failed("the thread that writes results has stopped".to_string()))?;
        Ok((rows, solved))
    })
}

/// What a fault of the program would end ends this pair alone.
fn guarded<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        let problem = "a fault of parfocal, of which more stands above, or no more threads; the other pairs go on";
        Err(Failure::Failed(problem.to_string()))
    })
}

/// All pairs as they are read, until the batch is to end.
fn all_read<'a>(jobs: &'a [Named], shared: &'a Shared) -> impl Iterator<Item = (usize, Read)> + Send + 'a {
    let goes_on = |_: &(usize, &Named)| !shared.stop.load(Ordering::Relaxed);
    let read = |named: &Named| guarded(|| named.task.read(shared)).unwrap_or_else(Read::Failed);
    jobs.iter().enumerate().take_while(goes_on).map(move |(index, named)| (index, read(named)))
}

fn send_all(read: impl Iterator<Item = (usize, Read)>, to_solver: &SyncSender<(usize, Read)>) {
    for one in read {
        if to_solver.send(one).is_err() {
            return;
        }
    }
}

/// Hands each pair on as it is solved, for as long as that `goes_on`.
fn solve_all(
    bench: &mut Bench,
    jobs: &[Named],
    shared: &Shared,
    read: impl Iterator<Item = (usize, Read)>,
    mut goes_on: impl FnMut(usize, Solved) -> bool,
) -> Result<(), Failure> {
    let mut broken = false;
    for (index, read) in read {
        if shared.stop.load(Ordering::Relaxed) {
            break;
        }
        let Request { run, .. } = &shared.request;
        let solved = match read {
            Read::Whole => Ok(Solved::Whole),
            Read::Failed(failure) => Ok(Solved::Failed(failure)),
            Read::Photographs(photographs) => bench
                .solve(&photographs)
                .map(|solution| Solved::Solution(Box::new((*photographs, solution, bench.engine.info().clone())))),
            Read::Frames(frames) => sweep_work::solve(&bench.engine, &frames, &mut |_, _| ())
                .map(|sweep| Solved::Sweep(Box::new((*frames, sweep, bench.engine.info().clone())))),
        };
        let solved = solved.unwrap_or_else(|error| {
            broken = matches!(error, Error::Timeout { .. } | Error::Poisoned | Error::Vulkan { .. });
            Solved::Failed(Failure::of_solve(error, &jobs[index].task.files()[0]))
        });
        if !goes_on(index, solved) {
            break;
        }
        if std::mem::take(&mut broken) {
            // The engine is of no more use, and the pairs to come need one.
            *bench = Bench::new(run.open_engine()?);
        }
    }
    super::check_validation(&bench.engine)
}

/// The device, and a solver for pairs like the last one.
pub(super) struct Bench {
    pub(super) engine: Engine,
    kept: Option<Kept>,
}

impl Bench {
    pub(super) fn new(engine: Engine) -> Self {
        Self { engine, kept: None }
    }

    fn solve(&mut self, Photographs { scope, frames, settings, .. }: &Photographs) -> Result<Solution, Error> {
        scope.solve(&self.engine, &mut self.kept, frames.each_ref(), settings, &mut |_| ())
    }
}

fn not_done(jobs: &[Named]) -> Vec<Row> {
    jobs.iter().map(|named| named.row(Outcome::NotDone)).collect()
}

/// Writes what came of a pair, and tells of it.
fn write(jobs: &[Named], shared: &Shared, bar: &Bar, rows: &mut [Row], index: usize, solved: Solved) {
    let written = guarded(|| jobs[index].task.write(&shared.request, solved));
    let outcome = written.unwrap_or_else(|failure| Outcome::Failed { error: failure.message() });
    rows[index] = jobs[index].row(outcome);
    bar.show(index, &rows[index]);
    if let Some(on_done) = &shared.on_done {
        on_done.run(&rows[index]);
    }
}

/// Progress over the pairs: a bar on a terminal, elsewhere a line a pair.
pub(super) struct Bar {
    bar: ProgressBar,
    lines: bool,
    /// Whether a program is told, a line of JSON a pair.
    json: bool,
    /// In all; 0 where nobody knows.
    pairs: usize,
}

impl Bar {
    /// A line a pair, of which nobody knows how many there will be.
    pub(super) fn endless(run: &RunArguments) -> Self {
        let (quiet, json) = (run.told.is_quiet(), run.tells_programs());
        Self { bar: ProgressBar::hidden(), lines: !quiet && !json, json, pairs: 0 }
    }

    fn new(pairs: usize, run: &RunArguments) -> Self {
        let (quiet, json) = (run.told.is_quiet() || run.tells_programs(), run.tells_programs());
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
        Self { bar, lines: !terminal && !quiet, json, pairs }
    }

    pub(super) fn show(&self, index: usize, row: &Row) {
        if matches!(row.outcome(), Outcome::Kept(_)) {
            // What is left out took no time and says nothing about the rest.
            self.bar.dec_length(1);
        } else {
            self.bar.inc(1);
        }
        self.bar.set_message(plain(row.name()));
        if self.json {
            let (done, name) = (index + 1, row.name());
            let mut line = json!({ "name": name, "status": row.outcome().status() });
            if self.pairs > 0 {
                (line["done"], line["of"]) = (done.into(), self.pairs.into());
            }
            let _ = writeln!(io::stderr(), "{line}");
            return;
        }
        let line = match self.pairs {
            0 => row.line(),
            pairs => format!("{}/{pairs} {}", index + 1, row.line()),
        };
        if self.lines {
            let _ = writeln!(io::stderr(), "{line}");
        } else if matches!(row.outcome(), Outcome::Failed { .. }) {
            self.bar.println(line);
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
