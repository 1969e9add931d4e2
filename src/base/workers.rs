//! Parallel loops over all processors.

use std::num::NonZero;
use std::sync::{Mutex, PoisonError};
use std::thread;

/// Calls `function` with each item, in parallel. The calling thread takes part, and does all the work if the system
/// refuses other threads.
pub(crate) fn for_each<T: Send>(items: impl Iterator<Item = T> + Send, function: impl Fn(T) + Sync) {
    let others = items.size_hint().1.unwrap_or(usize::MAX).saturating_sub(1).min(processors() - 1);
    let items = Mutex::new(items);
    let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        while let Some(item) = next() {
            function(item);
        }
    };
    if others == 0 || are_threads_refused() {
        return work();
    }
    #[cfg(feature = "files")]
    if let Some(pool) = waiting_threads() {
        return pool.in_place_scope(|scope| {
            (0..others).for_each(|_| scope.spawn(|_| work()));
            work();
        });
    }
    thread::scope(|scope| {
        for _ in 0..others {
            if thread::Builder::new().spawn_scoped(scope, work).is_err() {
                break;
            }
        }
        work();
    });
}

/// Threads that wait for work, since starting a thread takes some 50 µs. `None` in a forked process, which does not have
/// them.
#[cfg(feature = "files")]
fn waiting_threads() -> Option<&'static rayon_core::ThreadPool> {
    use std::process;
    use std::sync::LazyLock;

    use rayon_core::{ThreadPool, ThreadPoolBuilder};

    static POOL: LazyLock<Option<(u32, ThreadPool)>> =
        LazyLock::new(|| Some((process::id(), ThreadPoolBuilder::new().num_threads(processors() - 1).build().ok()?)));
    POOL.as_ref().filter(|(owner, _)| *owner == process::id()).map(|(_, pool)| pool)
}

fn processors() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
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
        let expected: Vec<usize> = (0..1000).map(|n| n * n).collect();
        let squares = || {
            let mut values = vec![0; 1000];
            for_each(values.iter_mut().enumerate(), |(n, value)| *value = n * n);
            values
        };
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
