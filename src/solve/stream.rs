//! Streams: many pairs of one size, or many focus sweeps, in sequence, on one device or several.

use std::collections::VecDeque;
use std::fmt;
use std::iter;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use super::queue::{Job, Queue};
use crate::base::{CPU_DEVICE, CancellationToken, Error, Format, Frame, Settings};
use crate::engine::{Engine, PairOptions, Pending, PreparedSolver, Solution, Source};
use crate::solve::SolveOptions;
use crate::solve::sweep::{Sweep, SweepOptions, SweepSolver};

/// Solves many pairs of one size and format and returns their results in the same order.
///
/// One thread per device keeps several pairs in flight: while the device solves, the next pair is uploaded and the
/// previous results are read back. Each pair goes to a free device.
///
/// In one thread, use [`Stream::map`]:
///
/// ```
/// # use parfocal::{Engine, EngineOptions, Error, Frame, Settings, Stream};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let pairs: Vec<[Frame; 2]> = [0.1, 0.2, 0.3, 0.4].map(|soft| [photograph(0.4), photograph(soft)]).to_vec();
/// # let mut solved = 0;
/// let engine = Engine::new(&EngineOptions::default())?;
/// let [i1, i2] = &pairs[0];
/// let (size, formats) = ([i1.width(), i1.height()], [i1.format(), i2.format()]);
/// let mut stream = Stream::new(&[&engine], 3, size, formats, &Settings::default())?;
/// for solution in stream.map(pairs) {
///     let solution = solution?;
///     println!("V {:.2} px², {:?}", solution.relative_blur[64 * 24], solution.transform);
/// #   solved += 1;
/// }
/// # assert_eq!(solved, 4);
/// # Ok(())
/// # }
/// ```
///
/// If one thread takes the pictures and another uses the results, the first pushes and the second reads:
///
/// ```
/// # use std::{thread, time::Duration};
/// # use parfocal::{Error, Frame, QueueFull, Stream};
/// # fn two(stream: &Stream, camera: impl Iterator<Item = [Frame; 2]> + Send) -> Result<(), Error> {
/// thread::scope(|scope| {
///     scope.spawn(|| {
///         for pair in camera {
///             if let Err(QueueFull(_missed)) = stream.push(pair, Duration::from_millis(40)) {
///                 eprintln!("the devices are too slow for the camera: a pair was left out");
///             }
///         }
///         stream.finish();
///     });
///     for solution in stream.results() {
///         println!("{:?}", solution?.transform);
///     }
///     Ok(())
/// })
/// # }
/// ```
///
/// **Memory.** A stream holds [`Stream::capacity`] pairs, twice as many as its devices have frames in flight. Half are
/// in flight; the others wait, or are solved and not yet read. Only reading makes room.
///
/// **Order.** Results come in the order in which pairs were pushed, one for each pair. They equal those of
/// [`PairSolver::solve`](crate::PairSolver::solve) bit by bit, but each pair is solved once: the limit of |V| stays, and a
/// registration in doubt is not tried again. A device much slower than the others delays all results; leave it out.
///
/// **Errors.** The error of one pair, another size for example, is its result; later pairs are unaffected. If a device
/// fails or exceeds [`EngineOptions::timeout`](crate::EngineOptions::timeout), the stream stops using it, and the other
/// devices solve its pairs. The last device returns its error, then [`Error::Poisoned`] for every pair.
///
/// Dropping a stream discards the waiting pairs, and blocks until the devices have solved the pairs in flight.
///
/// [`Stream::of_sweeps`] solves focus sweeps.
pub struct Stream<P = [Frame; 2], R = Solution> {
    queue: Arc<Queue<P, Result<R, Error>>>,
    workers: Vec<JoinHandle<()>>,
}

/// The error of a stream that had no room for a pair or sweep within the time limit. It returns the pair or sweep.
pub struct QueueFull<P = [Frame; 2]>(pub P);

impl<P> fmt::Display for QueueFull<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the stream is full: read a result before the next pair, or wait longer while another thread reads")
    }
}

impl<P> fmt::Debug for QueueFull<P> {
    /// Prints the name only, without the pixels.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("QueueFull")
    }
}

impl<P> std::error::Error for QueueFull<P> {}

impl Stream {
    /// Prepares each device for pairs of this size in px and these formats of I1 and I2. Each device has at most
    /// `frames_in_flight` pairs in flight, at least 1; 3 keep it busy.
    ///
    /// # Errors
    /// As for [`PairSolver::for_size`](crate::PairSolver::for_size), [`Error::NoDevice`] without engines,
    /// [`Error::NoThread`].
    pub fn new(
        engines: &[&Engine],
        frames_in_flight: usize,
        size: [u32; 2],
        formats: [Format; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        let count = frames_in_flight.max(1);
        let mut stream = Self::without_workers(engines, count, engines.len())?;
        for engine in engines {
            let solver = PreparedSolver::new(engine, size, formats, settings, count, None, engine.reading())?;
            let worker = PairWorker::new(&stream.queue, solver, count);
            stream.start(&engine.info().name, || worker.run())?;
        }
        Ok(stream)
    }
}

impl Stream<Vec<Frame>, Sweep> {
    /// Makes a stream of focus sweeps of three or more frames each. Size, format and number of frames may change from
    /// sweep to sweep; sweeps of one kind reuse a [`SweepSolver`]. Each device has `threads` threads (at least 1), and
    /// each thread solves one sweep. Two threads keep a device busy, since the host computes much of a sweep. Each
    /// thread needs the memory of a sweep.
    ///
    /// ```
    /// # use parfocal::sweep::SweepOptions;
    /// # use parfocal::{Engine, EngineOptions, Error, Frame, Stream};
    /// # fn frame(soft: f32) -> Frame {
    /// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
    /// #     Frame::gray(64, 64, (0..64 * 64).map(value).collect()).unwrap()
    /// # }
    /// # fn main() -> Result<(), Error> {
    /// # let sweeps = vec![[0.2, 0.4, 0.3].map(frame).to_vec(), [0.1, 0.3, 0.2].map(frame).to_vec()];
    /// let engine = Engine::new(&EngineOptions::default())?;
    /// let mut stream = Stream::of_sweeps(&[&engine], 2, &SweepOptions::default())?;
    /// for sweep in stream.map(sweeps) {
    ///     println!("in focus in the first pixel at {} of the frames", sweep?.focus[0]);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::NoDevice`] without engines, [`Error::NoThread`]. The error of a sweep is its
    /// result.
    pub fn of_sweeps(engines: &[&Engine], threads: usize, options: &SweepOptions) -> Result<Self, Error> {
        if engines.is_empty() {
            return Err(Error::NoDevice(String::new()));
        }
        let solvers = engines.iter().flat_map(|engine| (0..threads.max(1)).map(|_| SweepSolver::new(engine, options)));
        let worker = |mut solver: SweepSolver| {
            move |frames: &Vec<Frame>| match solver.solve(frames, &SolveOptions::default()) {
                Err(fault) if is_device_fault(&fault) => Err(fault),
                solved => Ok(solved),
            }
        };
        let workers: Vec<_> = solvers.map(|solver| solver.map(worker)).collect::<Result<_, Error>>()?;
        let capacity = 2 * workers.len();
        Self::of_workers(workers, capacity)
    }
}

impl<P: Send + 'static, R: Send + 'static> Stream<P, R> {
    /// Makes a stream that solves items by functions, each in its own thread. `capacity` is the greatest number of
    /// items that are pushed and not yet read.
    ///
    /// A function returns the result of an item. If it can solve no more items, it returns the fault, and another
    /// function solves the item. The fault of the last function is the result of the item.
    ///
    /// # Errors
    /// [`Error::NoThread`] if no thread could be started.
    pub fn of_workers<F>(workers: Vec<F>, capacity: usize) -> Result<Self, Error>
    where
        F: FnMut(&P) -> Result<Result<R, Error>, Error> + Send + 'static,
    {
        let queue = Arc::new(Queue::new(workers.len(), capacity.max(1), || Err(Error::Poisoned)));
        let mut stream = Self { queue, workers: Vec::new() };
        let mut started = Ok(());
        for solve in workers {
            let worker = FunctionWorker { queue: stream.queue.clone(), solve, taken: None, fault: None };
            started = stream.start("a stream", || worker.run());
        }
        if stream.workers.is_empty() { started.map(|()| stream) } else { Ok(stream) }
    }
}

impl<P, R> Stream<P, R> {
    fn without_workers(engines: &[&Engine], in_flight: usize, workers: usize) -> Result<Self, Error> {
        if engines.is_empty() {
            return Err(Error::NoDevice(String::new()));
        }
        let capacity = in_flight.max(1).saturating_mul(engines.len()).saturating_mul(2);
        let queue = Arc::new(Queue::new(workers, capacity, || Err(Error::Poisoned)));
        Ok(Self { queue, workers: Vec::new() })
    }

    /// Starts a worker. If no thread can be started, dropping the stream ends the earlier workers.
    fn start(&mut self, device: &str, run: impl FnOnce() + Send + 'static) -> Result<(), Error> {
        let thread = Builder::new().name("parfocal stream".to_string()).spawn(run);
        self.workers.push(
            thread.map_err(|problem| Error::NoThread { device: device.to_string(), problem: problem.to_string() })?,
        );
        Ok(())
    }

    /// Pushes a pair. Waits at most `limit` for room. [`Duration::ZERO`] does not wait; use it in a program that reads
    /// in the same thread.
    ///
    /// # Errors
    /// [`QueueFull`], with the pair. The error of the pair itself is its result.
    pub fn push(&self, pair: P, limit: Duration) -> Result<(), QueueFull<P>> {
        self.queue.push(pair, limit).map_err(QueueFull)
    }

    /// Returns the result of the oldest pair that has not been read. Waits at most `limit`. Returns `None` if the pair
    /// is not solved by then, or no pair was pushed. After [`Stream::finish`] it returns `None` at once if all results
    /// have been read.
    ///
    /// # Errors
    /// The error of that pair, as of [`PairSolver::solve`](crate::PairSolver::solve). Later pairs are unaffected.
    pub fn next(&self, limit: Duration) -> Result<Option<R>, Error> {
        self.queue.next(limit).transpose()
    }

    /// Marks the end of input: [`next`](Self::next) returns `None` after the last pair. Another push reopens the input.
    pub fn finish(&self) {
        self.queue.finish();
    }

    /// Iterates over results as they come, until all have been read after [`Stream::finish`].
    pub fn results(&self) -> impl Iterator<Item = Result<R, Error>> {
        iter::from_fn(|| self.queue.next(Duration::MAX))
    }

    /// Pushes `pairs` as room becomes available and iterates over their results. Results of pairs that were pushed
    /// before come first. If the iterator is dropped early, the pairs that it has pushed stay in the stream.
    pub fn map(&mut self, pairs: impl IntoIterator<Item = P>) -> impl Iterator<Item = Result<R, Error>> {
        let mut pairs = pairs.into_iter().fuse();
        iter::from_fn(move || {
            // Push at least one pair. Otherwise the devices would idle while available results are read.
            while self.len() < self.capacity()
                && let Some(pair) = pairs.next()
            {
                // This succeeds: no other thread pushes.
                let _ = self.push(pair, Duration::ZERO);
                if self.queue.is_next_ready() {
                    break;
                }
            }
            self.finish();
            self.queue.next(Duration::MAX)
        })
    }

    /// The number of pairs that may be pushed and not yet read.
    pub fn capacity(&self) -> usize {
        self.queue.capacity()
    }

    /// The number of pairs that were pushed and not yet read.
    pub fn len(&self) -> usize {
        self.queue.len()
    }

    /// Returns whether all results have been read.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl<P, R> Drop for Stream<P, R> {
    fn drop(&mut self) {
        self.queue.close();
        for worker in self.workers.drain(..) {
            // The panic message is on standard error, and its pairs have their results.
            let _ = worker.join();
        }
    }
}

/// The interval at which a worker with room for a pair polls the queue while the device works on other pairs.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// The thread that uploads pairs to one device and reads their results back.
struct PairWorker {
    queue: Arc<Queue<[Frame; 2], Result<Solution, Error>>>,
    solver: PreparedSolver,
    frames_in_flight: usize,
    /// Pairs without results. All are in flight, except for a moment the last one.
    taken: VecDeque<Job<[Frame; 2]>>,
    in_flight: VecDeque<Pending>,
    fault: Option<Error>,
}

impl PairWorker {
    fn new(
        queue: &Arc<Queue<[Frame; 2], Result<Solution, Error>>>,
        solver: PreparedSolver,
        frames_in_flight: usize,
    ) -> Self {
        let (taken, in_flight) = (VecDeque::new(), VecDeque::new());
        Self { queue: queue.clone(), solver, frames_in_flight, taken, in_flight, fault: None }
    }

    /// Solves until the stream is dropped or the device fails.
    fn run(mut self) {
        self.fault = self.solve_all().err();
    }

    fn solve_all(&mut self) -> Result<(), Error> {
        loop {
            while self.in_flight.len() < self.frames_in_flight
                && let Some(job) = self.queue.take(self.patience())
            {
                self.submit(job)?;
            }
            if self.in_flight.is_empty() {
                return Ok(());
            }
            self.collect()?;
        }
    }

    /// How long the worker waits for the next pair: it collects those in flight first.
    fn patience(&self) -> Duration {
        if self.in_flight.is_empty() { Duration::MAX } else { Duration::ZERO }
    }

    fn submit(&mut self, job: Job<[Frame; 2]>) -> Result<(), Error> {
        self.taken.push_back(job);
        let Some(Job { input: [i1, i2], .. }) = self.taken.back() else { return Ok(()) };
        let cancel = CancellationToken::default();
        let options = PairOptions::new(None, &cancel, &|_| ());
        match self.solver.submit([i1, i2].map(Source::Frame), &[], options) {
            Ok(pending) => self.in_flight.push_back(pending),
            Err(error) if is_device_fault(&error) => return Err(error),
            Err(error) => {
                let job = self.taken.pop_back();
                self.finish(job, Err(error));
            }
        }
        Ok(())
    }

    /// Reads back the results of the oldest pair in flight, once it is solved.
    fn collect(&mut self) -> Result<(), Error> {
        let is_full = self.in_flight.len() == self.frames_in_flight;
        let Some(pending) = self.in_flight.front_mut() else { return Ok(()) };
        let Some(solution) = pending.wait_timeout(if is_full { Duration::MAX } else { POLL_INTERVAL })? else {
            return Ok(());
        };
        let solution = solution.to_owned();
        self.in_flight.pop_front();
        let job = self.taken.pop_front();
        self.finish(job, Ok(solution));
        Ok(())
    }

    fn finish(&self, job: Option<Job<[Frame; 2]>>, result: Result<Solution, Error>) {
        if let Some(job) = job {
            self.queue.done(&job, result);
        }
    }
}

impl Drop for PairWorker {
    /// Stores a result for each pair, also after a panic.
    fn drop(&mut self) {
        self.queue.retire(self.taken.drain(..), self.fault.take().map(Err));
    }
}

/// A thread that solves items in sequence by a function.
struct FunctionWorker<P, R, F> {
    queue: Arc<Queue<P, Result<R, Error>>>,
    solve: F,
    taken: Option<Job<P>>,
    fault: Option<Error>,
}

impl<P, R, F: FnMut(&P) -> Result<Result<R, Error>, Error>> FunctionWorker<P, R, F> {
    /// Solves until the stream is dropped or the function returns a fault.
    fn run(mut self) {
        while let Some(job) = self.queue.take(Duration::MAX) {
            let job = self.taken.insert(job);
            match (self.solve)(&job.input) {
                Ok(result) => self.queue.done(job, result),
                Err(fault) => {
                    self.fault = Some(fault);
                    return;
                }
            }
            self.taken = None;
        }
    }
}

impl<P, R, F> Drop for FunctionWorker<P, R, F> {
    /// Stores a result for the item, also after a panic.
    fn drop(&mut self) {
        self.queue.retire(self.taken.take(), self.fault.take().map(Err));
    }
}

/// Returns whether the next pair would fail as well.
fn is_device_fault(error: &Error) -> bool {
    // The processor is usable after a pair that took too long.
    matches!(error, Error::Timeout { device, .. } if device != CPU_DEVICE)
        || matches!(error, Error::Poisoned | Error::Vulkan { .. })
}
