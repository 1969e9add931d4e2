//! Parallel loops over all processors.

use std::num::NonZero;
use std::sync::{Mutex, PoisonError};
use std::thread;

/// Calls `function` with each item, in parallel. The calling thread takes part, and does all the work if the system
/// refuses other threads.
pub(crate) fn for_each<T: Send>(items: impl Iterator<Item = T> + Send, function: impl Fn(T) + Sync) {
    let max_threads = items.size_hint().1.unwrap_or(usize::MAX).saturating_sub(1);
    let items = Mutex::new(items);
    let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        while let Some(item) = next() {
            function(item);
        }
    };
    let others = (thread::available_parallelism().map_or(1, NonZero::get) - 1).min(max_threads);
    thread::scope(|scope| {
        for _ in 0..others {
            if are_threads_refused() || thread::Builder::new().spawn_scoped(scope, work).is_err() {
                break;
            }
        }
        work();
    });
}

/// Returns `function(n)` for n from 0 to `count - 1`, computed in parallel.
pub(crate) fn map<T: Send>(count: usize, function: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let mut results: Vec<Option<T>> = (0..count).map(|_| None).collect();
    for_each(results.iter_mut().enumerate(), |(n, result)| *result = Some(function(n)));
    results.into_iter().flatten().collect()
}

/// Whether a test simulates a system that refuses threads, as it does beyond a user's limit.
fn are_threads_refused() -> bool {
    #[cfg(test)]
    return no_threads::IS_SET.get();
    #[cfg(not(test))]
    false
}

/// Simulates a system that refuses new threads.
#[cfg(test)]
pub(crate) mod no_threads {
    use std::cell::Cell;

    thread_local! {
        pub(super) static IS_SET: Cell<bool> = const { Cell::new(false) };
    }

    /// Runs `function` while this thread can start no other.
    pub(crate) fn run<T>(function: impl FnOnce() -> T) -> T {
        IS_SET.set(true);
        let result = function();
        IS_SET.set(false);
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_visited_with_and_without_threads() {
        let squares = || {
            let mut values = vec![0; 1000];
            for_each(values.iter_mut().enumerate(), |(n, value)| *value = n * n);
            values
        };
        let expected: Vec<usize> = (0..1000).map(|n| n * n).collect();
        assert_eq!(squares(), expected);
        assert_eq!(no_threads::run(squares), expected);
        assert_eq!(map(1000, |n| n * n), expected);
        no_threads::run(|| for_each(std::iter::empty::<()>(), |()| unreachable!()));
    }

    #[test]
    fn without_threads_the_calling_thread_does_all() {
        let here = thread::current().id();
        no_threads::run(|| for_each(0..9, |_| assert_eq!(thread::current().id(), here)));
    }

    #[test]
    fn a_panic_of_a_worker_reaches_the_caller() {
        let caught = std::panic::catch_unwind(|| for_each(0..100, |n| assert_ne!(n, 50)));
        assert!(caught.is_err());
    }
}
