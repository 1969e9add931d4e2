//! Parallel loops over all processors.

use std::num::NonZero;
use std::sync::{Mutex, PoisonError};
use std::thread;

/// Calls `function` with each item, in parallel. The calling thread takes part, and does all the work if the system
/// refuses other threads.
pub(crate) fn for_each<T: Send>(items: impl Iterator<Item = T> + Send, function: impl Fn(T) + Sync) {
    let most = most_others(&items);
    on_new_threads(most, worker(items, function));
}

/// Does the work on the calling thread and on new ones, `most` at most.
fn on_new_threads(most: usize, work: impl Fn() + Sync) {
    thread::scope(|scope| {
        for _ in 0..most.min(processors() - 1) {
            if are_threads_refused() || thread::Builder::new().spawn_scoped(scope, &work).is_err() {
                break;
            }
        }
        work();
    });
}

#[cfg(not(feature = "files"))]
pub(crate) use for_each as for_each_short;

/// As [`for_each`], for items of some milliseconds in all: on threads that wait for such work, since starting a thread
/// takes some 50 µs. Longer items would delay those of other callers.
#[cfg(feature = "files")]
pub(crate) fn for_each_short<T: Send>(items: impl Iterator<Item = T> + Send, function: impl Fn(T) + Sync) {
    use std::process;
    use std::sync::LazyLock;

    use rayon_core::{ThreadPool, ThreadPoolBuilder};

    static POOL: LazyLock<Option<(u32, ThreadPool)>> = LazyLock::new(|| match processors() {
        1 => None,
        count => Some((process::id(), ThreadPoolBuilder::new().num_threads(count - 1).build().ok()?)),
    });
    let most = most_others(&items);
    let work = worker(items, function);
    match POOL.as_ref().filter(|_| most > 0 && !are_threads_refused()) {
        // A forked process does not have the threads that wait.
        Some((owner, _)) if *owner != process::id() => on_new_threads(most, work),
        Some((_, pool)) => pool.in_place_scope(|scope| {
            for _ in 0..pool.current_num_threads().min(most) {
                scope.spawn(|_| work());
            }
            work();
        }),
        None => work(),
    }
}

/// What each thread does: it takes items until none is left.
fn worker<T: Send>(items: impl Iterator<Item = T> + Send, function: impl Fn(T) + Sync) -> impl Fn() + Sync {
    let items = Mutex::new(items);
    move || {
        let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
        while let Some(item) = next() {
            function(item);
        }
    }
}

/// The most threads that can help the calling one.
fn most_others<T>(items: &impl Iterator<Item = T>) -> usize {
    items.size_hint().1.unwrap_or(usize::MAX).saturating_sub(1)
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
        for is_short in [false, true] {
            let squares = || {
                let mut values = vec![0; 1000];
                let items = values.iter_mut().enumerate();
                let square = |(n, value): (usize, &mut usize)| *value = n * n;
                if is_short {
                    for_each_short(items, square)
                } else {
                    for_each(items, square)
                }
                values
            };
            assert_eq!(squares(), expected);
            assert_eq!(no_threads::run(squares), expected);
        }
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
