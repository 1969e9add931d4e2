//! `parfocal batch`: many pairs and sweeps, one after the other, while the next is read and the last is written.

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use parfocal::export::{FileKind, remove_unfinished, write_named};
use parfocal::focus_stack::{Positions, Sweep};
use parfocal::image_io::Input;
use parfocal::{DeviceInfo, Engine, Error, Kept, Solution};

use super::failure::Failure;
use super::headings::OUTPUT;
use super::help;
use super::options::SolveOptions;
use super::pairs::Group;
use super::request::Request;
use super::sweep_work::{self, SweepFrames, SweepJob};
use super::tally::{Outcome, Row, SUMMARY, Tally};
use super::work::{self, Job, Photographs};
use super::{output, pairs};

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
struct Shared {
    request: Request,
    resume: bool,
    /// Set by Ctrl-C.
    stop: Arc<AtomicBool>,
}

/// A pair or a sweep, and what its results are called.
struct Named {
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
    output::check_folder(out)?;
    request.force.to(out).check_named(FileKind::Batch, &[SUMMARY])?;
    let jobs: Vec<Named> = pairs::find(source, out)?.into_iter().map(|group| Named::new(out, group)).collect();
    jobs.iter().try_for_each(|named| named.task.check(&request))?;
    let stop = on_interrupt(jobs.iter().map(|named| named.task.out().to_path_buf()).collect())?;
    let engine = request.run.open_engine()?;
    let shared = Shared { request, resume: arguments.resume, stop };
    let Request { run, force, .. } = &shared.request;
    let bar = Bar::new(jobs.len(), run.told.is_quiet());
    let (rows, ended) = work_off(engine, &jobs, &shared, &bar)?;
    drop(bar);
    let interrupted = shared.stop.load(Ordering::Relaxed);
    let tally = Tally::new(source, rows, interrupted, started.elapsed());
    let json = tally.to_json()?;
    write_named(force.to(out), SUMMARY, FileKind::Batch, format!("{json}\n").as_bytes())?;
    run.told.tell(&tally.table(out), || Ok(json))?;
    ended?;
    tally.check(run.strict)
}

impl Named {
    fn new(out: &Path, Group { name, files }: Group) -> Self {
        let out = out.join(&name);
        let task = match <[PathBuf; 2]>::try_from(files) {
            Ok(files) => Task::Pair(Job { files, out }),
            Err(files) => Task::Sweep(SweepJob { files, positions: Positions::Counted, reference: None, out }),
        };
        Self { name, task }
    }

    fn row(&self, outcome: Outcome) -> Row {
        Row::new(&self.name, self.task.files(), self.task.out(), outcome)
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

    /// Refuses what cannot be done, before any work.
    fn check(&self, request: &Request) -> Result<(), Failure> {
        match self {
            Self::Pair(job) => work::check(request, job),
            Self::Sweep(job) => sweep_work::check(request, job),
        }
    }

    /// Reads the photographs, unless the results are there.
    fn read(&self, shared: &Shared) -> Result<Read, Failure> {
        let request = &shared.request;
        let settled = |inputs: &[Input]| self.is_settled(shared, inputs);
        Ok(match self {
            Self::Pair(job) => {
                work::read(request, job, settled)?.map_or(Read::Whole, |read| Read::Photographs(Box::new(read)))
            }
            Self::Sweep(job) => {
                sweep_work::read(request, job, settled)?.map_or(Read::Whole, |read| Read::Frames(Box::new(read)))
            }
        })
    }

    /// Whether the results are there, all that the report names, and of what is asked. The report gets its name last.
    fn is_settled(&self, shared: &Shared, inputs: &[Input]) -> Result<bool, Failure> {
        let Some(report) = shared.resume.then(|| Outcome::report(self.out())).flatten() else { return Ok(false) };
        let digest = match self {
            Self::Pair(_) => shared.request.digest(&[])?,
            Self::Sweep(job) => job.digest(&shared.request)?,
        };
        let files = report["files"].as_array().map_or(&[][..], Vec::as_slice);
        let is_there = |name: &serde_json::Value| name.as_str().is_some_and(|name| self.out().join(name).is_file());
        let is_of = |(i, input): (usize, &Input)| {
            let page = report["inputs"][i]["page"].as_u64().map(|page| page as usize);
            report["inputs"][i]["sha256"].as_str() == Some(&input.sha256) && page == input.page
        };
        let known = report["inputs"].as_array().map_or(0, Vec::len);
        Ok(!files.is_empty()
            && files.iter().all(is_there)
            && report["request"].as_str() == Some(&digest)
            && known == inputs.len()
            && inputs.iter().enumerate().all(is_of))
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

/// A flag that the first Ctrl-C sets; the second removes what is half written in the folders and ends the program.
fn on_interrupt(folders: Vec<PathBuf>) -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let handler = move || {
        if flag.swap(true, Ordering::Relaxed) {
            folders.iter().for_each(|folder| remove_unfinished(folder));
            std::process::exit(130);
        }
        let _ = writeln!(io::stderr(), "\nfinishing the pair at hand; Ctrl-C again ends at once");
    };
    ctrlc::set_handler(handler).map_err(|e| Failure::Failed(format!("Ctrl-C cannot be listened to ({e})")))?;
    Ok(stop)
}

/// What came of each pair, and whether the device held out to the end.
type Worked = (Vec<Row>, Result<(), Failure>);

/// Three threads in a row, each at most one pair ahead of the next: what is read and not yet solved stays small.
fn work_off(engine: Engine, jobs: &[Named], shared: &Shared, bar: &Bar) -> Result<Worked, Failure> {
    thread::scope(|scope| {
        let (to_solver, from_reader) = sync_channel(1);
        let (to_writer, from_solver) = sync_channel(1);
        scope.spawn(move || read_all(jobs, shared, &to_solver));
        let writer = scope.spawn(move || write_all(jobs, shared, from_solver, bar));
        let solved = solve_all(engine, jobs, shared, from_reader, &to_writer);
        drop(to_writer);
        let rows =
            writer.join().map_err(|_| Failure::Failed("the thread that writes results has stopped".to_string()))?;
        Ok((rows, solved))
    })
}

fn read_all(jobs: &[Named], shared: &Shared, to_solver: &SyncSender<(usize, Read)>) {
    for (index, Named { task, .. }) in jobs.iter().enumerate() {
        if shared.stop.load(Ordering::Relaxed) {
            return;
        }
        let read = task.read(shared).unwrap_or_else(Read::Failed);
        if to_solver.send((index, read)).is_err() {
            return;
        }
    }
}

fn solve_all(
    engine: Engine,
    jobs: &[Named],
    shared: &Shared,
    from_reader: Receiver<(usize, Read)>,
    to_writer: &SyncSender<(usize, Solved)>,
) -> Result<(), Failure> {
    let (mut bench, mut broken) = (Bench { engine, kept: None }, false);
    for (index, read) in from_reader {
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
        if to_writer.send((index, solved)).is_err() {
            break;
        }
        if std::mem::take(&mut broken) {
            // The engine is of no more use, and the pairs to come need one.
            bench = Bench { engine: run.open_engine()?, kept: None };
        }
    }
    super::check_validation(&bench.engine)
}

/// The device, and a solver for pairs like the last one.
struct Bench {
    engine: Engine,
    kept: Option<Kept>,
}

impl Bench {
    fn solve(&mut self, Photographs { scope, frames, settings, .. }: &Photographs) -> Result<Solution, Error> {
        scope.solve(&self.engine, &mut self.kept, frames.each_ref(), settings, &mut |_| ())
    }
}

fn write_all(jobs: &[Named], shared: &Shared, from_solver: Receiver<(usize, Solved)>, bar: &Bar) -> Vec<Row> {
    let mut rows: Vec<Row> = jobs.iter().map(|named| named.row(Outcome::NotDone)).collect();
    for (index, solved) in from_solver {
        let written = jobs[index].task.write(&shared.request, solved);
        let outcome = written.unwrap_or_else(|failure| Outcome::Failed { error: failure.message() });
        rows[index] = jobs[index].row(outcome);
        bar.show(index, &rows[index]);
    }
    rows
}

/// Progress over the pairs: a bar on a terminal, elsewhere a line a pair.
struct Bar {
    bar: ProgressBar,
    lines: bool,
    pairs: usize,
}

impl Bar {
    fn new(pairs: usize, quiet: bool) -> Self {
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
        Self { bar, lines: !terminal && !quiet, pairs }
    }

    fn show(&self, index: usize, row: &Row) {
        if matches!(row.outcome(), Outcome::Kept(_)) {
            // What is left out took no time and says nothing about the rest.
            self.bar.dec_length(1);
        } else {
            self.bar.inc(1);
        }
        self.bar.set_message(row.name().to_string());
        let line = format!("{}/{} {}", index + 1, self.pairs, row.line());
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
