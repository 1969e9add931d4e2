//! Many pairs of one size, or many focus sweeps, one after the other, on one device or several.

mod queue;
mod sweeps;
mod worker;

use std::fmt;
use std::iter;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use queue::Queue;
use worker::Worker;

use crate::base::{Error, Format, Frame, Settings};
use crate::engine::{Engine, Solution};
use crate::solve::focus_stack::{Sweep, SweepOptions};

/// Many pairs of one size and format in, their results out in the same order: one thread a device keeps all slots of a [`PairSolver`](crate::PairSolver)
/// busy, so that the next pair goes up and the one before comes down while the device solves. Each pair goes to whichever device is free.
///
/// In one thread, [`Stream::map`] is all it takes:
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
/// Where one thread takes the pictures and another uses the results, the first pushes and the second reads:
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
/// **Memory.** A stream holds [`Stream::capacity`] pairs, twice as many as its devices have slots: those under way, and as many that wait or are
/// solved and not yet read. Only reading makes room.
///
/// **Order.** Results come in the order in which pairs were pushed, one for each, and have the bits that [`PairSolver::solve`](crate::PairSolver::solve)
/// gives. So a device much slower than the others, which makes results wait for its own, is better left out.
///
/// **Errors.** What is wrong with a pair, another size say, is the result in its place, and the others go on. Where a device fails or takes longer
/// than [`EngineOptions::timeout`](crate::EngineOptions::timeout), the others solve anew what it had, and it is used no more; of the last one the
/// error comes out, and then [`Error::Poisoned`] for every pair.
///
/// Dropping a stream forgets what waits, and ends when the devices have solved what they have.
///
/// [`Stream::of_sweeps`] does the same of focus sweeps.
pub struct Stream<P = [Frame; 2], R = Solution> {
    queue: Arc<Queue<P, Result<R, Error>>>,
    workers: Vec<JoinHandle<()>>,
}

/// There is no room in a stream by the time stated: the pair, or sweep, comes back.
pub struct QueueFull<P = [Frame; 2]>(pub P);

impl<P> fmt::Display for QueueFull<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the stream is full: read a result before the next pair, or wait longer while another thread reads")
    }
}

impl<P> fmt::Debug for QueueFull<P> {
    /// Without the pixels.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("QueueFull")
    }
}

impl<P> std::error::Error for QueueFull<P> {}

impl Stream {
    /// Prepares each device, with so many slots (at least one; three keep it busy), for pairs of a width and height in px and of the formats of I1
    /// and I2.
    ///
    /// # Errors
    /// Those of [`PairSolver::with_slots`](crate::PairSolver::with_slots): a pair that a device does not hold is for a [`SolveOptions`](crate::SolveOptions).
    /// [`Error::NoDevice`] without engines, [`Error::NoThread`].
    pub fn new(
        engines: &[&Engine],
        slots: usize,
        size: [u32; 2],
        formats: [Format; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        let mut stream = Self::without_workers(engines, slots, engines.len())?;
        for engine in engines {
            let worker = Worker::new(&stream.queue, engine, slots.max(1), size, formats, settings)?;
            stream.begin(engine, || worker.run())?;
        }
        Ok(stream)
    }
}

impl Stream<Vec<Frame>, Sweep> {
    /// A stream of focus sweeps, each of three or more frames of one size and format, of any from sweep to sweep: on each device so many threads (at
    /// least one) solve one each. Two keep a device busy, since much of a sweep is the host's; each takes the memory of a sweep.
    ///
    /// ```
    /// # use parfocal::focus_stack::SweepOptions;
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
    /// [`Error::NoDevice`] without engines, [`Error::NoThread`]. What is wrong with a sweep is its result, as of
    /// [`solve_sweep`](crate::focus_stack::solve_sweep).
    pub fn of_sweeps(engines: &[&Engine], slots: usize, options: &SweepOptions) -> Result<Self, Error> {
        let slots = slots.max(1);
        let mut stream = Self::without_workers(engines, slots, slots.saturating_mul(engines.len()))?;
        for engine in engines {
            for _ in 0..slots {
                let worker = sweeps::Worker::new(&stream.queue, engine, options);
                stream.begin(engine, || worker.run())?;
            }
        }
        Ok(stream)
    }
}

impl<P, R> Stream<P, R> {
    /// Where the workers are to come, so many in all.
    fn without_workers(engines: &[&Engine], slots: usize, workers: usize) -> Result<Self, Error> {
        if engines.is_empty() {
            return Err(Error::NoDevice(String::new()));
        }
        let capacity = slots.max(1).saturating_mul(engines.len()).saturating_mul(2);
        let queue = Arc::new(Queue::new(workers, capacity, || Err(Error::Poisoned)));
        Ok(Self { queue, workers: Vec::new() })
    }

    /// A worker begins; where there is no thread for it, those before it are sent home as the stream is dropped.
    fn begin(&mut self, engine: &Engine, run: impl FnOnce() + Send + 'static) -> Result<(), Error> {
        let thread = Builder::new().name("parfocal stream".to_string()).spawn(run);
        self.workers.push(
            thread.map_err(|problem| Error::NoThread {
                device: engine.info().name.clone(),
                problem: problem.to_string(),
            })?,
        );
        Ok(())
    }

    /// Hands a pair over, once there is room for it, and waits so long at most for that: not at all by [`Duration::ZERO`], which is what is of
    /// use where no other thread reads.
    ///
    /// # Errors
    /// [`QueueFull`], with the pair. What is wrong with the pair itself is its result.
    pub fn push(&self, pair: P, limit: Duration) -> Result<(), QueueFull<P>> {
        self.queue.push(pair, limit).map_err(QueueFull)
    }

    /// The result of the oldest pair that has not been read, for which it waits so long at most. `None`: it is not solved by then, or no pair was
    /// pushed; after [`Stream::finish`] at once where all have been read.
    ///
    /// # Errors
    /// What the pair failed of, as [`PairSolver::solve`](crate::PairSolver::solve): those after it go on.
    pub fn next(&self, limit: Duration) -> Result<Option<R>, Error> {
        self.queue.next(limit).transpose()
    }

    /// Says that no more pairs come, so that who waits for results waits for those of the pairs there are. Another push takes it back.
    pub fn finish(&self) {
        self.queue.finish();
    }

    /// Results as they come, until all have been read after [`Stream::finish`].
    pub fn results(&self) -> impl Iterator<Item = Result<R, Error>> {
        iter::from_fn(|| self.queue.next(Duration::MAX))
    }

    /// The results of these pairs, which are taken as there is room for them; those of pairs that were pushed before come first. Of what is
    /// dropped before its end, the pairs that it has taken stay in the stream.
    pub fn map(&mut self, pairs: impl IntoIterator<Item = P>) -> impl Iterator<Item = Result<R, Error>> {
        let mut pairs = pairs.into_iter().fuse();
        iter::from_fn(move || {
            // One at least, or devices would have nothing to do while results are read that are there.
            while self.len() < self.capacity()
                && let Some(pair) = pairs.next()
            {
                // There is room, since nobody else pushes.
                let _ = self.push(pair, Duration::ZERO);
                if self.queue.is_next_there() {
                    break;
                }
            }
            self.finish();
            self.queue.next(Duration::MAX)
        })
    }

    /// How many pairs may be pushed and not yet read.
    pub fn capacity(&self) -> usize {
        self.queue.capacity()
    }

    /// How many pairs were pushed and not yet read.
    pub fn len(&self) -> usize {
        self.queue.len()
    }

    /// Whether all results have been read.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl<P, R> Drop for Stream<P, R> {
    fn drop(&mut self) {
        self.queue.close();
        for worker in self.workers.drain(..) {
            // What it panicked of stands on standard error, and its pairs have their results.
            let _ = worker.join();
        }
    }
}
