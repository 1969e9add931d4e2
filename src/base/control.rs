//! Progress, cancellation and time limit of a solve.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use crate::base::Error;

/// A callback that cancels one piece of work in flight.
pub(crate) type CancelSignal = dyn Fn() + Send + Sync;

/// Cancels solves, from any thread.
///
/// A pair or a sweep that is being solved with a clone of the token ends soon with [`Error::Cancelled`], and so does
/// every solve that begins with one later. Solver and engine stay usable. Make a new token for the next solve.
///
/// ```
/// # use std::sync::Arc;
/// # use parfocal::{CancellationToken, Engine, EngineOptions, Error, Frame, PairSolver, Settings, SolveOptions};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let (i1, i2) = (photograph(0.4), photograph(0.3));
/// let engine = Engine::new(&EngineOptions::default())?;
/// let mut solver = PairSolver::new(&engine, &Settings::default())?;
/// let cancel = CancellationToken::default();
/// let cancelled = cancel.clone();
/// let options = SolveOptions {
///     cancel,
///     // The progress function cancels here; another thread may do so as well.
///     progress: Some(Arc::new(move |_| cancelled.cancel())),
///     ..SolveOptions::default()
/// };
/// assert!(matches!(solver.solve([&i1, &i2], &options), Err(Error::Cancelled)));
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Default)]
pub struct CancellationToken(Arc<Inner>);

#[derive(Default)]
struct Inner {
    is_cancelled: AtomicBool,
    in_flight: Mutex<Vec<Weak<CancelSignal>>>,
}

impl CancellationToken {
    /// Cancels all solves in flight that use a clone of this token, and all that begin with one later.
    pub fn cancel(&self) {
        self.0.is_cancelled.store(true, Ordering::SeqCst);
        let in_flight = self.0.in_flight.lock().unwrap_or_else(PoisonError::into_inner);
        in_flight.iter().filter_map(Weak::upgrade).for_each(|signal| signal());
    }

    /// Returns whether [`cancel`](Self::cancel) was called.
    pub fn is_cancelled(&self) -> bool {
        self.0.is_cancelled.load(Ordering::SeqCst)
    }

    /// Returns [`Error::Cancelled`] if the token is cancelled.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Registers a callback for as long as it lives. [`check`](Self::check) afterwards: the token may be cancelled
    /// already.
    pub(crate) fn register(&self, signal: &Arc<CancelSignal>) {
        let mut in_flight = self.0.in_flight.lock().unwrap_or_else(PoisonError::into_inner);
        let signal = Arc::downgrade(signal);
        in_flight.retain(|other| other.strong_count() > 0 && !other.ptr_eq(&signal));
        in_flight.push(signal);
    }
}

impl fmt::Debug for CancellationToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CancellationToken {{ is_cancelled: {} }}", self.is_cancelled())
    }
}

/// The progress of a solve, after a few iterations of a pair, a part of a large pair, or an iteration or a level of the
/// search for outlines of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Levels done, or parts of a large pair. By the method appearance levels of the registration count too.
    pub done: u32,
    /// Levels or parts in all.
    pub total: u32,
    /// The share of the work that is done, 0 to 1: about that of the time. How many iterations levels will need is
    /// estimated. A pair that is solved again, with a wider limit of |V|, goes on from a half.
    pub share: f64,
}

impl Progress {
    /// The progress after `done` equal steps of `total`.
    pub(crate) fn of_steps(done: usize, total: usize) -> Self {
        Self { done: done as u32, total: total as u32, share: done as f64 / total.max(1) as f64 }
    }
}

/// The time limit of one solve, from its start on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Deadline {
    limit: Duration,
    /// `None`: later than the clock can state.
    end: Option<Instant>,
}

impl Deadline {
    /// A deadline that ends `limit` from now.
    pub(crate) fn after(limit: Duration) -> Self {
        Self { limit, end: Instant::now().checked_add(limit) }
    }

    /// The time left; zero once the deadline has passed.
    pub(crate) fn left(&self) -> Duration {
        self.end.map_or(Duration::MAX, |end| end.saturating_duration_since(Instant::now()))
    }

    /// Returns [`Error::Timeout`] of a solve on `device` once the deadline has passed.
    pub(crate) fn check(&self, device: &str) -> Result<(), Error> {
        if self.left().is_zero() { Err(self.error(device)) } else { Ok(()) }
    }

    /// The error of a solve on `device` that takes longer.
    pub(crate) fn error(&self, device: &str) -> Error {
        Error::Timeout { device: device.to_string(), seconds: self.limit.as_secs() }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;

    #[test]
    fn a_token_calls_each_living_signal_once() {
        let (cancel, calls) = (CancellationToken::default(), Arc::new(AtomicUsize::new(0)));
        let signal = || {
            let calls = calls.clone();
            Arc::new(move || {
                calls.fetch_add(1, Ordering::SeqCst);
            }) as Arc<CancelSignal>
        };
        let (living, dropped) = (signal(), signal());
        [&living, &dropped, &living].iter().for_each(|signal| cancel.register(signal));
        drop(dropped);
        assert!(cancel.check().is_ok() && !cancel.is_cancelled());
        cancel.clone().cancel();
        assert_eq!(calls.load(Ordering::SeqCst), 1);
        assert!(matches!(cancel.check(), Err(Error::Cancelled)));
    }

    #[test]
    fn a_deadline_beyond_the_clock_never_passes() {
        assert_eq!(Deadline::after(Duration::MAX).left(), Duration::MAX);
        assert_eq!(Deadline::after(Duration::ZERO).left(), Duration::ZERO);
    }
}
