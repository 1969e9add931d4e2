//! Results that stay on the device, for programs that share it.

use ash::vk;

use super::memory::Buffer;
use super::recording::Recording;

/// The results of a pair in device memory ([`Pending::on_device`](crate::Pending::on_device)).
///
/// The buffer holds planes of f32, row-major and without padding: V, its standard deviation, the residual, and the
/// channels of the fused image, with the units of a [`SolutionRef`](crate::SolutionRef).
///
/// A submission to a queue of the engine's family that waits for `semaphore` to reach `value` may read `buffer`, as a
/// source of copies and as a storage buffer. It must complete before the [`Pending`](crate::Pending) is
/// dropped, and so must a submission that waits for `inputs_read`.
#[derive(Clone, Copy, Debug)]
pub struct DeviceSolution {
    /// A buffer of the engine's device, in host-visible memory that the host also reads.
    pub buffer: vk::Buffer,
    /// The size of the buffer, in bytes.
    pub bytes: u64,
    /// A timeline semaphore.
    pub semaphore: vk::Semaphore,
    /// The value of `semaphore` once the results are written.
    pub value: u64,
    /// The timeline semaphore and its value once the device has read all photographs, which may then be overwritten.
    /// `None` if the host has copied them.
    pub inputs_read: Option<(vk::Semaphore, u64)>,
}

/// The buffer that receives the results of an [encoded](crate::interop::Encoded) pair, in the planes of a [`DeviceSolution`].
#[derive(Clone, Copy, Debug)]
pub struct SolutionBuffer {
    /// A buffer of the engine's device, in host-visible memory that the host also reads.
    pub buffer: vk::Buffer,
    /// The size of the buffer, in bytes.
    pub bytes: u64,
}

impl SolutionBuffer {
    pub(crate) fn new(buffer: &Buffer) -> Self {
        Self { buffer: buffer.handle, bytes: buffer.size() }
    }
}

impl DeviceSolution {
    /// The solution that `solve` writes to a buffer, after `input_copies` has copied the photographs.
    pub(crate) fn new(buffer: &Buffer, solve: &Recording, input_copies: Option<&Recording>) -> Self {
        let (semaphore, value) = solve.completion();
        let inputs_read = input_copies.map(Recording::completion);
        Self { buffer: buffer.handle, bytes: buffer.size(), semaphore, value, inputs_read }
    }
}
