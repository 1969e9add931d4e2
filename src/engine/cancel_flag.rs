//! One pair that may be called off while the device works on it, by the last word of [its arguments](super::arguments).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::arguments;
use super::plan::Plan;
use super::vulkan::Buffer;
use crate::base::{CancelSignal, Error};

/// What calls one pair off, and does nothing once that has ended.
pub(super) struct CancelFlag {
    /// The words that the device looks at, until then.
    words: Mutex<Option<Arc<Buffer>>>,
    /// Of the last of them, bytes.
    place: u64,
    is_cancelled: AtomicBool,
}

impl CancelFlag {
    pub(super) fn of(words: &Arc<Buffer>, plan: &Plan) -> Arc<Self> {
        let place = arguments::bytes(plan.solved) - 4;
        Arc::new(Self { words: Mutex::new(Some(words.clone())), place, is_cancelled: AtomicBool::new(false) })
    }

    /// Nobody has called it off yet: says so to the device.
    pub(super) fn go_on(&self, words: &Buffer) -> Result<(), Error> {
        words.store_word(self.place, arguments::NOT_CANCELLED)
    }

    pub(super) fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::SeqCst)
    }

    fn words(&self) -> MutexGuard<'_, Option<Arc<Buffer>>> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn cancel(&self) {
        if let Some(words) = &*self.words() {
            self.is_cancelled.store(true, Ordering::SeqCst);
            // Where it cannot be told, the device only goes on to the end.
            let _ = words.store_word(self.place, arguments::CANCELLED);
        }
    }

    /// It does nothing any more.
    pub(super) fn end(&self) {
        *self.words() = None;
    }

    /// For who calls off.
    pub(super) fn signal(self: &Arc<Self>) -> Arc<CancelSignal> {
        let call = self.clone();
        Arc::new(move || call.cancel())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crate::base::{Error, Frame, Settings};
    use crate::engine::{Engine, PairSolver, testing};

    #[test]
    fn the_device_leaves_out_what_is_called_off() {
        let value = |soft: f32, i: usize| 0.5 + soft * ((i % 96) as f32 * 1.1).sin() * ((i / 96) as f32 * 0.9).cos();
        let [i1, i2] =
            [0.4, 0.3].map(|soft| Frame::gray(96, 96, (0..96 * 96).map(|i| value(soft, i)).collect()).unwrap());
        let engine = Engine::new(&testing::options()).unwrap();
        let mut solver = PairSolver::for_pair(&engine, &i1, &i2, &Settings::default()).unwrap();
        let executed = |solver: &PairSolver| solver.profile().unwrap().dispatches.iter().filter(|d| d.executed).count();
        solver.solve(&i1, &i2).unwrap();
        let whole = executed(&solver);
        let ticket = solver.submit(0, &i1, &i2).unwrap();
        solver.cancel(&ticket).unwrap();
        assert!(matches!(solver.wait(&ticket, Duration::MAX), Err(Error::Cancelled)));
        let called_off = executed(&solver);
        println!("{called_off} of {whole} dispatches");
        assert!(called_off < whole, "{called_off} of {whole}");
    }
}
