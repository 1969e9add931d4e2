//! The queue of a stream: bounded, served by workers, with results in the order of input.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A pair for a worker, and its number.
pub(super) struct Job<P> {
    number: u64,
    pub(super) input: P,
}

/// A bounded queue of pairs and their results.
pub(super) struct Queue<P, R> {
    state: Mutex<State<P, R>>,
    /// Notified after each change. Changes are rare, a few per pair, and few threads wait.
    changed: Condvar,
    /// The greatest number of pairs that are pushed and not yet read.
    capacity: usize,
    /// Makes the result of a pair that no worker can solve any more.
    lost: fn() -> R,
}

struct State<P, R> {
    /// The result of each pair that was pushed and not yet read, in order.
    places: VecDeque<Option<R>>,
    /// The number of the first pair in `results`.
    first: u64,
    /// Pairs that no worker has taken, in order.
    waiting: VecDeque<Job<P>>,
    workers: usize,
    /// No more pairs will be pushed: readers do not wait for more.
    is_finished: bool,
    /// The stream is dropped: workers do not wait for more.
    is_closed: bool,
}

impl<P, R> State<P, R> {
    /// Stores the result of a pair, unless it has been read.
    fn put(&mut self, number: u64, result: R) {
        let place = number.checked_sub(self.first).and_then(|n| usize::try_from(n).ok());
        if let Some(place) = place.and_then(|n| self.places.get_mut(n)) {
            *place = Some(result);
        }
    }

    fn is_next_ready(&self) -> bool {
        matches!(self.places.front(), Some(Some(_)))
    }
}

impl<P, R> Queue<P, R> {
    pub(super) fn new(workers: usize, capacity: usize, lost: fn() -> R) -> Self {
        let (places, waiting) = (VecDeque::new(), VecDeque::new());
        let state = State { places, first: 0, waiting, workers, is_finished: false, is_closed: false };
        Self { state: Mutex::new(state), changed: Condvar::new(), capacity, lost }
    }

    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// The number of pairs that were pushed and not yet read.
    pub(super) fn len(&self) -> usize {
        self.lock().places.len()
    }

    /// Returns whether the next result can be read at once.
    pub(super) fn is_next_ready(&self) -> bool {
        self.lock().is_next_ready()
    }

    /// Pushes a pair, or returns it if there is no room within the time limit.
    pub(super) fn push(&self, pair: P, limit: Duration) -> Result<(), P> {
        let mut state = self.wait_until(limit, |state| state.places.len() < self.capacity);
        if state.places.len() >= self.capacity {
            return Err(pair);
        }
        let number = state.first + state.places.len() as u64;
        state.is_finished = false;
        if state.workers == 0 {
            state.places.push_back(Some((self.lost)()));
        } else {
            state.places.push_back(None);
            state.waiting.push_back(Job { number, input: pair });
        }
        self.changed.notify_all();
        Ok(())
    }

    /// The next result; `None` if it is not ready within the time limit, or all are read after
    /// [`finish`](Self::finish).
    pub(super) fn next(&self, limit: Duration) -> Option<R> {
        let ended = |state: &State<P, R>| state.is_finished && state.places.is_empty();
        let mut state = self.wait_until(limit, |state| state.is_next_ready() || ended(state));
        if !state.is_next_ready() {
            return None;
        }
        state.first += 1;
        let result = state.places.pop_front().flatten();
        self.changed.notify_all();
        result
    }

    /// Marks the end of input, until the next push.
    pub(super) fn finish(&self) {
        self.lock().is_finished = true;
        self.changed.notify_all();
    }

    /// Ends each worker after the pairs that it has taken.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        state.is_closed = true;
        state.waiting.clear();
        self.changed.notify_all();
    }

    /// The next pair for a worker, if there is one within the time limit.
    pub(super) fn take(&self, limit: Duration) -> Option<Job<P>> {
        self.wait_until(limit, |state| state.is_closed || !state.waiting.is_empty()).waiting.pop_front()
    }

    /// Stores the result of a job.
    pub(super) fn done(&self, job: &Job<P>, result: R) {
        self.lock().put(job.number, result);
        self.changed.notify_all();
    }

    /// Removes a worker. The other workers get the jobs that it had taken. Without other workers, `fault` is the result
    /// of the oldest pair, and [`Queue::lost`] makes the results of the rest.
    pub(super) fn retire(&self, taken: impl IntoIterator<Item = Job<P>>, fault: Option<R>) {
        let mut state = self.lock();
        state.workers -= 1;
        state.waiting.extend(taken);
        state.waiting.make_contiguous().sort_by_key(|job| job.number);
        if state.workers == 0 {
            let left = std::mem::take(&mut state.waiting);
            let results = fault.into_iter().chain(std::iter::repeat_with(self.lost));
            left.iter().zip(results).for_each(|(job, result)| state.put(job.number, result));
        }
        self.changed.notify_all();
    }

    /// Waits until the state is `ready`, or the time limit passes.
    fn wait_until(&self, limit: Duration, ready: impl Fn(&State<P, R>) -> bool) -> MutexGuard<'_, State<P, R>> {
        let state = self.changed.wait_timeout_while(self.lock(), limit, |state| !ready(state));
        state.unwrap_or_else(PoisonError::into_inner).0
    }

    fn lock(&self) -> MutexGuard<'_, State<P, R>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    const NOW: Duration = Duration::ZERO;

    fn queue(workers: usize, pushed: u32) -> Queue<u32, String> {
        let queue = Queue::new(workers, 4, || "lost".to_string());
        (0..pushed).for_each(|pair| assert_eq!(queue.push(pair, NOW), Ok(())));
        queue
    }

    fn read(queue: &Queue<u32, String>) -> Vec<String> {
        std::iter::from_fn(|| queue.next(NOW)).collect()
    }

    #[test]
    fn results_are_in_order_and_count_towards_capacity_until_read() {
        let queue = queue(1, 4);
        let [first, second] = [0, 1].map(|_| queue.take(Duration::ZERO).unwrap());
        queue.done(&second, "1".to_string());
        assert!(queue.next(NOW).is_none() && !queue.is_next_ready(), "the first has no result");
        queue.done(&first, "0".to_string());
        assert_eq!(queue.push(4, NOW), Err(4), "unread results occupy room");
        assert_eq!(read(&queue), ["0", "1"]);
        assert_eq!((queue.push(4, NOW), queue.len()), (Ok(()), 3));
    }

    #[test]
    fn other_workers_take_the_jobs_of_a_removed_worker() {
        let queue = queue(2, 4);
        let [a, b, c] = [0, 1, 2].map(|_| queue.take(Duration::ZERO).unwrap());
        queue.done(&b, "1".to_string());
        queue.retire([a, c], Some("broken".to_string()));
        for expected in [0, 2, 3] {
            let job = queue.take(Duration::ZERO).unwrap();
            assert_eq!(job.input, expected);
            queue.done(&job, job.input.to_string());
        }
        assert_eq!(read(&queue), ["0", "1", "2", "3"]);
    }

    #[test]
    fn without_workers_every_pair_gets_an_error() {
        let queue = queue(1, 3);
        let first = queue.take(Duration::ZERO).unwrap();
        queue.retire([first], Some("broken".to_string()));
        assert_eq!(queue.push(3, NOW), Ok(()));
        assert_eq!(read(&queue), ["broken", "lost", "lost", "lost"]);
    }

    #[test]
    fn finish_and_close_end_waits() {
        let queue = queue(1, 0);
        thread::scope(|scope| {
            let reader = scope.spawn(|| queue.next(Duration::MAX));
            let worker = scope.spawn(|| queue.take(Duration::MAX).map(|job| job.input));
            queue.finish();
            assert_eq!(reader.join().unwrap(), None);
            queue.close();
            assert_eq!(worker.join().unwrap(), None);
        });
        // Another push reopens the input.
        assert_eq!(queue.push(0, NOW), Ok(()));
        thread::scope(|scope| {
            let reader = scope.spawn(|| queue.next(Duration::MAX));
            queue.done(&queue.take(Duration::MAX).unwrap(), "0".to_string());
            assert_eq!(reader.join().unwrap().as_deref(), Some("0"));
        });
    }

    #[test]
    fn push_waits_for_room() {
        let queue = queue(1, 4);
        thread::scope(|scope| {
            let pushing = scope.spawn(|| queue.push(4, Duration::MAX));
            queue.done(&queue.take(Duration::ZERO).unwrap(), "0".to_string());
            assert_eq!(queue.next(Duration::MAX).as_deref(), Some("0"));
            assert_eq!(pushing.join().unwrap(), Ok(()));
        });
    }
}
