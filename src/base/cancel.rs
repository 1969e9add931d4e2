//! Work that is called off while it goes on.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use crate::base::Error;

/// What tells work under way that it is called off.
pub(crate) type Signal = dyn Fn() + Send + Sync;

/// Calls solves off, from any thread: of a pair or a sweep that is being solved with a clone of it the call ends soon, with
/// [`Error::Cancelled`], and what it used is good for the next. For another call, make another.
///
/// ```
/// # use parfocal::{CancellationToken, Engine, EngineOptions, Error, Frame, SolveOptions, Settings};
/// # fn photograph(soft: f32) -> Frame {
/// #     let value = |i: usize| 0.5 + soft * ((i % 64) as f32 * 1.1).sin() * ((i / 64) as f32 * 0.9).cos();
/// #     Frame::gray(64, 48, (0..64 * 48).map(value).collect()).unwrap()
/// # }
/// # fn main() -> Result<(), Error> {
/// # let (i1, i2) = (photograph(0.4), photograph(0.3));
/// let engine = Engine::new(&EngineOptions::default())?;
/// let cancel = CancellationToken::default();
/// let scope = SolveOptions { cancel: cancel.clone(), ..SolveOptions::default() };
/// // Whoever is told how far the solve has come may call it off; so may another thread.
/// let mut progress = |_| cancel.cancel();
/// let solved = scope.solve(&engine, &mut None, [&i1, &i2], &Settings::default(), &mut progress);
/// assert!(matches!(solved, Err(Error::Cancelled)));
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Default)]
pub struct CancellationToken(Arc<Inner>);

#[derive(Default)]
struct Inner {
    is_cancelled: AtomicBool,
    under_way: Mutex<Vec<Weak<Signal>>>,
}

impl CancellationToken {
    /// Calls off what is under way, and all that begins with a clone of this.
    pub fn cancel(&self) {
        self.0.is_cancelled.store(true, Ordering::SeqCst);
        let under_way = self.0.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        under_way.iter().filter_map(Weak::upgrade).for_each(|signal| signal());
    }

    /// Whether it was called off.
    pub fn is_cancelled(&self) -> bool {
        self.0.is_cancelled.load(Ordering::SeqCst)
    }

    /// [`Error::Cancelled`] if it was.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Has something told for as long as it lives; after this, [`check`](Self::check) says whether it came too late.
    pub(crate) fn tells(&self, signal: &Arc<Signal>) {
        let mut under_way = self.0.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        let signal = Arc::downgrade(signal);
        under_way.retain(|other| other.strong_count() > 0 && !other.ptr_eq(&signal));
        under_way.push(signal);
    }
}

impl fmt::Debug for CancellationToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CancellationToken {{ is_cancelled: {} }}", self.is_cancelled())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;

    #[test]
    fn tells_each_that_lives_once() {
        let (cancel, told) = (CancellationToken::default(), Arc::new(AtomicUsize::new(0)));
        let signal = || {
            let told = told.clone();
            Arc::new(move || {
                told.fetch_add(1, Ordering::SeqCst);
            }) as Arc<Signal>
        };
        let (lives, dies) = (signal(), signal());
        [&lives, &dies, &lives].iter().for_each(|signal| cancel.tells(signal));
        drop(dies);
        assert!(cancel.check().is_ok() && !cancel.is_cancelled());
        cancel.clone().cancel();
        assert_eq!(told.load(Ordering::SeqCst), 1);
        assert!(matches!(cancel.check(), Err(Error::Cancelled)));
    }
}
