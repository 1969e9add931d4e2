//! Results where the device leaves them, for programs that go on with them there.

use ash::vk;

use super::memory::Buffer;
use super::recording::Recording;

/// Results of a pair where the device leaves them ([`Pending::on_device`](crate::Pending::on_device)): planes of f32, one after the other, rows without
/// padding: V, its standard deviation, the residual, the channels of the fused image, as of a [`SolutionRef`](crate::SolutionRef).
///
/// A submission to the engine's queue, or to another of its family, that waits for `semaphore` to reach `value` may read `buffer`, as a source of copies
/// and as a storage buffer. It must be over before the [`Pending`](crate::Pending) is dropped, and so must what waits for `taken`.
#[derive(Clone, Copy, Debug)]
pub struct OnDevice {
    /// Of the device of the engine; mapped memory, which the host reads as well.
    pub buffer: vk::Buffer,
    /// Its size.
    pub bytes: u64,
    /// A timeline.
    pub semaphore: vk::Semaphore,
    /// What that reaches when the results are there.
    pub value: u64,
    /// Where the device itself fetches a photograph: a timeline, and what that reaches when all are fetched, and may be overwritten.
    pub taken: Option<(vk::Semaphore, u64)>,
}

/// The buffer that receives the results of an encoded pair ([`Encoded`](super::super::Encoded)), in the planes of [`OnDevice`].
#[derive(Clone, Copy, Debug)]
pub struct ResultBuffer {
    /// A buffer of the engine's device, in mapped memory.
    pub buffer: vk::Buffer,
    /// Its size in bytes.
    pub bytes: u64,
}

impl ResultBuffer {
    pub(crate) fn of(buffer: &Buffer) -> Self {
        Self { buffer: buffer.handle, bytes: buffer.size() }
    }
}

impl OnDevice {
    /// What a recording leaves in a buffer, after what fetches its photographs.
    pub(crate) fn of(buffer: &Buffer, recording: &Recording, fetching: Option<&Recording>) -> Self {
        let (semaphore, value) = recording.signal();
        Self { buffer: buffer.handle, bytes: buffer.size(), semaphore, value, taken: fetching.map(Recording::signal) }
    }
}
