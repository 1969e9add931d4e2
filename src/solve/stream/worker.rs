//! A device at work on a stream of pairs.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::queue;
use crate::base::{Error, Format, Frame, Settings};
use crate::engine::{Engine, PairSolver, Solution, Ticket};

pub(super) type Solved = Result<Solution, Error>;
pub(super) type Queue = queue::Queue<[Frame; 2], Solved>;
type Job = queue::Job<[Frame; 2]>;

/// How often a worker with a free slot looks whether there is a pair for it, while the device is at work on others.
const STEP: Duration = Duration::from_millis(1);

/// One thread's: it brings pairs up and results down while the device solves.
pub(super) struct Worker {
    queue: Arc<Queue>,
    solver: PairSolver,
    device: String,
    /// The longest wait for one solve.
    patience: Duration,
    slots: usize,
    /// Where the next pair goes: pairs end in the order in which they were submitted, so slots become free in turn.
    slot: usize,
    /// What it has taken; all but, for a moment, the last is submitted.
    taken: VecDeque<Job>,
    tickets: VecDeque<Ticket>,
    /// When the device began with the oldest of them.
    began: Instant,
    fault: Option<Error>,
}

impl Worker {
    /// All that can be prepared before the first pair.
    pub(super) fn new(
        queue: &Arc<Queue>,
        engine: &Engine,
        slots: usize,
        size: [u32; 2],
        formats: [Format; 2],
        settings: &Settings,
    ) -> Result<Self, Error> {
        let solver = PairSolver::with_slots(slots, engine, size, formats, settings)?;
        Ok(Self {
            queue: queue.clone(),
            solver,
            device: engine.info().name.clone(),
            patience: engine.timeout(),
            slots,
            slot: 0,
            taken: VecDeque::new(),
            tickets: VecDeque::new(),
            began: Instant::now(),
            fault: None,
        })
    }

    /// Solves until the stream is gone or the device fails.
    pub(super) fn run(mut self) {
        self.fault = self.work().err();
    }

    fn work(&mut self) -> Result<(), Error> {
        loop {
            while self.tickets.len() < self.slots
                && let Some(job) = self.queue.take(self.tickets.is_empty())
            {
                self.submit(job)?;
            }
            if self.tickets.is_empty() {
                return Ok(());
            }
            self.collect()?;
        }
    }

    fn submit(&mut self, job: Job) -> Result<(), Error> {
        self.taken.push_back(job);
        let Some(Job { given: [i1, i2], .. }) = self.taken.back() else { return Ok(()) };
        match self.solver.submit(self.slot, i1, i2) {
            Ok(ticket) => {
                if self.tickets.is_empty() {
                    self.began = Instant::now();
                }
                self.slot = (self.slot + 1) % self.slots;
                self.tickets.push_back(ticket);
                Ok(())
            }
            Err(error) if is_of_device(&error) => Err(error),
            Err(error) => {
                let job = self.taken.pop_back();
                self.hand_out(job, Err(error));
                Ok(())
            }
        }
    }

    /// Takes the results of the oldest pair down, once they are there.
    fn collect(&mut self) -> Result<(), Error> {
        let Some(ticket) = self.tickets.front() else { return Ok(()) };
        let left = self.patience.saturating_sub(self.began.elapsed());
        let limit = if self.tickets.len() < self.slots { left.min(STEP) } else { left };
        if let Some(view) = self.solver.wait(ticket, limit)? {
            let solution = view.to_owned();
            self.tickets.pop_front();
            self.began = Instant::now();
            let job = self.taken.pop_front();
            self.hand_out(job, Ok(solution));
        } else if left.is_zero() {
            return Err(Error::Timeout { device: self.device.clone(), seconds: self.patience.as_secs() });
        }
        Ok(())
    }

    fn hand_out(&self, job: Option<Job>, solved: Solved) {
        if let Some(job) = job {
            self.queue.done(&job, solved);
        }
    }
}

impl Drop for Worker {
    /// However it ends, by a panic too, every pair that it has taken has a result in the end.
    fn drop(&mut self) {
        self.queue.retire(self.taken.drain(..), self.fault.take().map(Err));
    }
}

/// Whether the next pair would fail as well.
pub(super) fn is_of_device(error: &Error) -> bool {
    matches!(error, Error::Timeout { .. } | Error::Poisoned | Error::Vulkan { .. })
}
