//! What a frame in flight needs of the memory of one pair, on any device, and the cancellation of a pair.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::arguments;
use super::plan::Plan;
use super::record::Reading;
use super::script::{CountedPixels, Script};
use super::slot::Slot;
use super::stages::state::State;
use super::vulkan::{Buffer, DeviceTimes};
use super::windows::Bytes;
use crate::base::{CancelSignal, Deadline, Error, Frame, Mask, Progress};

/// What all frames in flight of a solver share.
pub(super) struct Shared {
    pub(super) plan: Plan,
    pub(super) reading: Reading,
}

/// One pair in the memory of a device.
pub(super) trait PairMemory {
    /// Uploads the mask of I1; `None`: all pixels count.
    fn upload_mask(&mut self, mask: Option<&Mask>) -> Result<(), Error>;
    /// Calls a function that writes a photograph into the memory that the passes read.
    fn fill(&mut self, image: usize, write: &mut dyn FnMut(&mut [u8])) -> Result<(), Error>;
    /// Uploads a frame. Returns whether it has pixels that are clipped by these levels.
    fn upload(&mut self, image: usize, photograph: &Frame, levels: [f32; 2]) -> Result<bool, Error> {
        let mut is_clipped = false;
        self.fill(image, &mut |bytes| is_clipped = photograph.copy_samples(bytes, levels))?;
        Ok(is_clipped)
    }
    /// The flag that cancels the next pair.
    fn cancel_flag(&mut self) -> Result<Arc<CancelFlag>, Error>;
    /// Prepares the pair, after its photographs were copied.
    fn prepare(&mut self, state: &State, pixels: CountedPixels) -> Result<(), Error>;
    /// Runs the first parts of the script and waits for them.
    fn run(
        &mut self,
        parts: fn(&Script) -> usize,
        deadline: Deadline,
        progress: &dyn Fn(Progress),
    ) -> Result<(), Error>;
    fn state(&self, slot: Slot) -> Result<State, Error>;
    /// The first `count` numbers in a slot.
    fn numbers(&self, slot: Slot, count: usize) -> Result<Vec<f32>, Error>;
    /// The layers of the results.
    fn maps(&self) -> Result<&[f32], Error>;
    /// A photograph as it was uploaded.
    fn photograph(&self, image: usize) -> Bytes<'_>;
    /// The times of the latest run.
    fn times(&self) -> Result<DeviceTimes, Error>;
    /// The script of the latest pair.
    fn script(&self) -> &Script;
}

/// Cancels one pair.
pub(super) struct CancelFlag {
    is_cancelled: Arc<AtomicBool>,
    /// `None` once the pair has ended.
    target: Mutex<Option<Target>>,
}

/// The word of a buffer that a device reads between iterations, the last of its [arguments](super::arguments), and its
/// byte offset. The CPU device has none: it reads the flag.
type Target = Option<(Arc<Buffer>, u64)>;

impl CancelFlag {
    pub(super) fn new(is_cancelled: Arc<AtomicBool>, target: Target) -> Arc<Self> {
        Arc::new(Self { is_cancelled, target: Mutex::new(Some(target)) })
    }

    /// [`Error::Cancelled`] if the pair was cancelled: its results are unfinished.
    pub(super) fn check(&self) -> Result<(), Error> {
        if self.is_cancelled.load(Ordering::SeqCst) { Err(Error::Cancelled) } else { Ok(()) }
    }

    fn target(&self) -> MutexGuard<'_, Option<Target>> {
        self.target.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn cancel(&self) {
        let target = self.target();
        if target.is_some() {
            self.is_cancelled.store(true, Ordering::SeqCst);
        }
        if let Some(Some((words, offset))) = &*target {
            // If the word cannot be written, the device solves the pair to its end.
            let _ = words.store_word(*offset, arguments::CANCELLED);
        }
    }

    /// Makes later calls of [`cancel`](Self::cancel) do nothing.
    pub(super) fn end(&self) {
        *self.target() = None;
    }

    /// The callback for a [`CancellationToken`].
    pub(super) fn signal(self: &Arc<Self>) -> Arc<CancelSignal> {
        let flag = self.clone();
        Arc::new(move || flag.cancel())
    }
}
