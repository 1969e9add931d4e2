//! A device at work on a stream of focus sweeps.

use std::sync::Arc;

use super::queue;
use super::worker::is_of_device;
use crate::base::{Error, Frame};
use crate::engine::Engine;
use crate::solve::focus_stack::{Sweep, SweepOptions, solve_sweep};

pub(super) type Queue = queue::Queue<Vec<Frame>, Result<Sweep, Error>>;

/// One thread's: it solves one sweep after the other, and what its host does goes on while the device works for another thread.
pub(super) struct Worker {
    queue: Arc<Queue>,
    engine: Engine,
    options: SweepOptions,
    taken: Option<queue::Job<Vec<Frame>>>,
    fault: Option<Error>,
}

impl Worker {
    pub(super) fn new(queue: &Arc<Queue>, engine: &Engine, options: &SweepOptions) -> Self {
        let (queue, engine, options) = (queue.clone(), engine.beside(), options.clone());
        Self { queue, engine, options, taken: None, fault: None }
    }

    /// Solves until the stream is gone or the device fails.
    pub(super) fn run(mut self) {
        while let Some(job) = self.queue.take(true) {
            let job = self.taken.insert(job);
            match solve_sweep(&self.engine, &job.given, &self.options, &mut |_, _| ()) {
                Err(error) if is_of_device(&error) => {
                    self.fault = Some(error);
                    return;
                }
                solved => self.queue.done(job, solved),
            }
            self.taken = None;
        }
    }
}

impl Drop for Worker {
    /// However it ends, by a panic too, the sweep that it has taken has a result in the end.
    fn drop(&mut self) {
        self.queue.retire(self.taken.take(), self.fault.take().map(Err));
    }
}
