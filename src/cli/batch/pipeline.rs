//! A batch at work: for each device three threads in a row, which take whatever pair or sweep is next.

use std::iter;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use parfocal::{Engine, Error, PairSolver, Solution, settings::DeviceInfo};

use crate::cli::batch::batch_summary::{Outcome, Row};
use crate::cli::batch::pairs_bar::PairsBar;
use crate::cli::batch::task::{Named, Read, Shared, Solved};
use crate::cli::jobs::sweep_work;
use crate::cli::jobs::work::Photographs;
use crate::cli::options::engine::EngineArguments;
use crate::cli::output::failure::Failure;

/// A device, and a solver for pairs like the last one.
pub(crate) struct Bench {
    engine: Engine,
    solver: Option<PairSolver>,
    /// How it is opened again, if need be.
    arguments: EngineArguments,
}

impl Bench {
    /// Every device that is asked for; and the one with the least memory, by which is told what is too large.
    pub(crate) fn open(arguments: &EngineArguments) -> Result<(Vec<Self>, DeviceInfo), Failure> {
        let benches = arguments.each()?.into_iter().map(Self::new).collect::<Result<Vec<_>, _>>()?;
        let least = benches.iter().map(|bench| bench.engine.info()).min_by_key(|info| info.memory_bytes).cloned();
        Ok((benches, least.ok_or(Error::NoDevice(String::new()))?))
    }

    fn new(arguments: EngineArguments) -> Result<Self, Failure> {
        Ok(Self { engine: arguments.open()?, solver: None, arguments })
    }

    fn solve(&mut self, Photographs { scope, frames, settings, .. }: &Photographs) -> Result<Solution, Error> {
        let mut solver = match self.solver.take() {
            Some(solver) => solver,
            None => PairSolver::new(&self.engine, settings)?,
        };
        solver.set_settings(settings)?;
        self.solver.insert(solver).solve(frames.each_ref(), scope)
    }
}

/// What came of each pair, and whether the devices held out to the end.
pub(crate) type Worked = (Vec<Row>, Result<(), Failure>);

/// Solves all, on all devices; a device that cannot be opened again leaves the rest to the others.
pub(crate) fn work_off(
    benches: &mut [Bench],
    jobs: &[Named],
    shared: &Shared,
    bar: &PairsBar,
) -> Result<Worked, Failure> {
    let work = &Work { jobs, next: AtomicUsize::new(0), shared, bar };
    let worked: Vec<Result<Done, Failure>> = thread::scope(|scope| {
        let mut benches = benches.iter_mut();
        let first = benches.next();
        // Where there are no more threads, the first does the work of the others.
        let others: Vec<_> =
            benches.filter_map(|bench| thread::Builder::new().spawn_scoped(scope, || work.run(bench)).ok()).collect();
        let first = first.map(|bench| work.run(bench));
        let others = others.into_iter().map(|other| other.join().unwrap_or_else(|_| Err(stopped("solves"))));
        first.into_iter().chain(others).collect()
    });
    let mut rows: Vec<Row> = jobs.iter().map(|named| named.row(Outcome::NotDone)).collect();
    let mut held = Ok(());
    for one in worked {
        let (done, ended) = one?;
        done.into_iter().for_each(|(index, row)| rows[index] = row);
        held = held.and(ended);
    }
    Ok((rows, held))
}

/// The pairs and sweeps that one device was given, by number, and whether it held out.
type Done = (Vec<(usize, Row)>, Result<(), Failure>);

/// What all devices work on.
struct Work<'a> {
    jobs: &'a [Named],
    /// The first that none has taken.
    next: AtomicUsize,
    shared: &'a Shared,
    bar: &'a PairsBar,
}

impl Work<'_> {
    /// Three threads in a row, each at most one pair ahead of the next: what is read and not yet solved stays small. Where there
    /// are not so many threads, one does the work of the other.
    fn run(&self, bench: &mut Bench) -> Result<Done, Failure> {
        thread::scope(|scope| {
            let (to_solver, from_reader) = sync_channel(1);
            let reader = thread::Builder::new().spawn_scoped(scope, move || self.send_all(&to_solver));
            let read: Box<dyn Iterator<Item = (usize, Read)>> = match reader {
                Ok(_) => Box::new(from_reader.into_iter()),
                Err(_) => Box::new(self.read()),
            };
            let (to_writer, from_solver) = sync_channel(1);
            let writer = thread::Builder::new().spawn_scoped(scope, move || {
                let written = from_solver.into_iter().map(|(index, solved)| (index, self.write(index, solved)));
                written.collect::<Vec<_>>()
            });
            let Ok(writer) = writer else {
                let mut done = Vec::new();
                let held = self.solve(bench, read, |index, solved| {
                    done.push((index, self.write(index, solved)));
                    true
                });
                return Ok((done, held));
            };
            let held = self.solve(bench, read, |index, solved| to_writer.send((index, solved)).is_ok());
            drop(to_writer);
            Ok((writer.join().map_err(|_| stopped("writes results"))?, held))
        })
    }

    /// Pairs as they are taken and read, until there is none or the batch is to end.
    fn read(&self) -> impl Iterator<Item = (usize, Read)> {
        iter::from_fn(|| {
            let goes_on = !self.shared.stop.load(Ordering::Relaxed);
            let index = goes_on.then(|| self.next.fetch_add(1, Ordering::Relaxed))?;
            let named = self.jobs.get(index)?;
            Some((index, guarded(|| named.read(self.shared)).unwrap_or_else(Read::Failed)))
        })
    }

    fn send_all(&self, to_solver: &SyncSender<(usize, Read)>) {
        for one in self.read() {
            if to_solver.send(one).is_err() {
                return;
            }
        }
    }

    /// Hands each pair on as it is solved, for as long as that `goes_on`.
    fn solve(
        &self,
        bench: &mut Bench,
        read: impl Iterator<Item = (usize, Read)>,
        mut goes_on: impl FnMut(usize, Solved) -> bool,
    ) -> Result<(), Failure> {
        let mut broken = false;
        for (index, read) in read {
            if self.shared.stop.load(Ordering::Relaxed) {
                break;
            }
            let solved = match read {
                Read::Whole => Ok(Solved::Whole),
                Read::Failed(failure) => Ok(Solved::Failed(failure)),
                Read::Photographs(photographs) => bench
                    .solve(&photographs)
                    .map(|solution| Solved::Solution(Box::new((*photographs, solution, bench.engine.info().clone())))),
                Read::Frames(frames) => sweep_work::solve(&bench.engine, &frames, None)
                    .map(|sweep| Solved::Sweep(Box::new((*frames, sweep, bench.engine.info().clone())))),
            };
            let solved = solved.unwrap_or_else(|error| {
                broken = matches!(error, Error::Timeout { .. } | Error::Poisoned | Error::Vulkan { .. });
                Solved::Failed(Failure::of_solve(error, self.jobs[index].first()))
            });
            if !goes_on(index, solved) {
                break;
            }
            if std::mem::take(&mut broken) {
                // The engine is of no more use, and the pairs to come need one.
                *bench = Bench::new(bench.arguments.clone())?;
            }
        }
        crate::cli::check_validation(&bench.engine)
    }

    /// Writes what came of a pair, and tells of it.
    fn write(&self, index: usize, solved: Solved) -> Row {
        let named = &self.jobs[index];
        let written = guarded(|| named.write(&self.shared.request, solved));
        let row = named.row(written.unwrap_or_else(|failure| Outcome::Failed { error: failure.message() }));
        self.bar.show(&row);
        if let Some(on_done) = &self.shared.on_done {
            on_done.run(&row);
        }
        row
    }
}

fn stopped(what: &str) -> Failure {
    Failure::Failed(format!("the thread that {what} has stopped"))
}

/// What a fault of the program would end ends this pair alone.
fn guarded<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        let problem = "a fault of parfocal, of which more stands above, or no more threads; the other pairs go on";
        Err(Failure::Failed(problem.to_string()))
    })
}
