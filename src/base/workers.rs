//! Work for all processors, by as many threads as the system gives.

use std::num::NonZero;
use std::sync::{Mutex, PoisonError};
use std::thread;

/// Does something with each item. Threads that the system refuses are done without: the calling one takes its share, and where
/// it is alone, all.
pub(crate) fn each<T: Send>(items: impl Iterator<Item = T> + Send, of: impl Fn(T) + Sync) {
    let most = items.size_hint().1.unwrap_or(usize::MAX).saturating_sub(1);
    let items = Mutex::new(items);
    let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        while let Some(item) = next() {
            of(item);
        }
    };
    let others = (thread::available_parallelism().map_or(1, NonZero::get) - 1).min(most);
    thread::scope(|scope| {
        for _ in 0..others {
            if is_refused() || thread::Builder::new().spawn_scoped(scope, work).is_err() {
                break;
            }
        }
        work();
    });
}

/// What comes of each of so many.
pub(crate) fn collect<T: Send>(count: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let mut results: Vec<Option<T>> = (0..count).map(|_| None).collect();
    each(results.iter_mut().enumerate(), |(n, result)| *result = Some(of(n)));
    results.into_iter().flatten().collect()
}

/// Whether a test has the system refuse threads, as it does to a user who has too many.
fn is_refused() -> bool {
    #[cfg(test)]
    return refused::IS.get();
    #[cfg(not(test))]
    false
}

/// A system without threads.
#[cfg(test)]
pub(crate) mod refused {
    use std::cell::Cell;

    thread_local! {
        pub(super) static IS: Cell<bool> = const { Cell::new(false) };
    }

    /// What is done where this thread may start no other.
    pub(crate) fn during<T>(of: impl FnOnce() -> T) -> T {
        IS.set(true);
        let done = of();
        IS.set(false);
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_is_done_with_threads_and_without() {
        let squares = || {
            let mut values = vec![0; 1000];
            each(values.iter_mut().enumerate(), |(n, value)| *value = n * n);
            values
        };
        let expected: Vec<usize> = (0..1000).map(|n| n * n).collect();
        assert_eq!(squares(), expected);
        assert_eq!(refused::during(squares), expected);
        assert_eq!(collect(1000, |n| n * n), expected);
        refused::during(|| each(std::iter::empty::<()>(), |()| unreachable!()));
    }

    #[test]
    fn without_threads_the_calling_one_does_it() {
        let here = thread::current().id();
        refused::during(|| each(0..9, |_| assert_eq!(thread::current().id(), here)));
    }

    #[test]
    fn a_panic_in_one_is_one_of_the_caller() {
        let caught = std::panic::catch_unwind(|| each(0..100, |n| assert_ne!(n, 50)));
        assert!(caught.is_err());
    }
}
