//! A lock of a queue for programs that have none.

use std::sync::{Condvar, Mutex, PoisonError};

use super::interop::{QueueGuard, QueueLock};

/// SharedQueue at a queue, for a program that has no lock of it yet: it takes one by [`turn`](Self::turn) for all that it does with the queue.
#[derive(Default)]
pub struct SharedQueue {
    // A guard of the mutex itself could not be given back by another call.
    is_taken: Mutex<bool>,
    given_back: Condvar,
}

impl SharedQueue {
    /// Waits until nobody else uses the queue; others wait until what this returns is dropped.
    #[must_use = "the turn is over when this is dropped"]
    pub fn turn(&self) -> QueueGuard<'_> {
        QueueGuard::take(Some(self))
    }
}

impl QueueLock for SharedQueue {
    fn lock(&self) {
        let is_taken = self.is_taken.lock().unwrap_or_else(PoisonError::into_inner);
        let free = self.given_back.wait_while(is_taken, |is_taken| *is_taken);
        *free.unwrap_or_else(PoisonError::into_inner) = true;
    }

    fn unlock(&self) {
        *self.is_taken.lock().unwrap_or_else(PoisonError::into_inner) = false;
        self.given_back.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn one_has_the_turn_at_a_time() {
        let (turns, inside) = (SharedQueue::default(), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..500 {
                        let _turn = turns.turn();
                        assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0);
                        inside.fetch_sub(1, Ordering::SeqCst);
                    }
                });
            }
        });
    }
}
