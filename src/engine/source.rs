//! The places that photographs are taken from.

use std::any::Any;
use std::sync::Arc;

use super::plan::Plan;
use super::vulkan::{Device, DeviceSource, SharedMemory, SourceCopy, SourceLocation};
use crate::base::{Depth, Error, Frame, RowLayout, workers};

/// Where a photograph of a pair is taken from, in the solver's [format](crate::PixelFormat).
///
/// The host looks for clipped pixels in pairs of two frames. In all other pairs the device does, by the passes for
/// pairs that have some. Floats that the device fetches are not checked: they must be finite and at most 1e6.
#[derive(Clone, Copy)]
pub enum Source<'a> {
    /// A frame, copied before `submit` returns.
    Frame(&'a Frame),
    /// Rows in memory of the caller, copied before `submit` returns.
    Rows {
        /// The bytes from the first row on.
        bytes: &'a [u8],
        /// Bytes from the start of one row to that of the next; 0 if there are no gaps.
        pitch: usize,
    },
    /// A function that writes the rows, without gaps, into the memory that the device reads. `submit` calls it once.
    /// Write from front to back: reading this memory may be slow.
    Write(&'a dyn Fn(&mut [u8])),
    /// A photograph on the engine's device, which fetches it.
    OnDevice(DeviceSource),
    /// Rows of [shared memory](crate::Engine::share). The device fetches them; if it cannot, they are copied before
    /// `submit` returns.
    Shared {
        /// Memory that was shared with the same engine.
        memory: &'a Arc<SharedMemory>,
        /// Byte offset of the first row.
        offset: usize,
        /// As in [`Source::Rows`].
        pitch: usize,
    },
}

impl<'a> From<&'a Frame> for Source<'a> {
    fn from(frame: &'a Frame) -> Self {
        Self::Frame(frame)
    }
}

/// How a photograph gets into the memory that the passes read.
pub(super) enum Transfer<'a> {
    /// The caller writes it.
    Write(&'a dyn Fn(&mut [u8])),
    /// The host copies a frame.
    Frame(&'a Frame),
    /// The host copies rows.
    Rows(Rows<'a>),
    /// The device copies it.
    Fetch(SourceCopy),
}

impl<'a> Source<'a> {
    /// Checks the source against a solver's plan.
    pub(super) fn transfer(
        self,
        plan: &Plan,
        image: usize,
        device: Option<&Arc<Device>>,
    ) -> Result<Transfer<'a>, Error> {
        match self {
            Self::Frame(frame) => check_frame(plan, image, frame).map(|()| Transfer::Frame(frame)),
            Self::Write(write) => Ok(Transfer::Write(write)),
            Self::Rows { bytes, pitch } => Rows::new(plan, image, Bytes::Slice(bytes), pitch).map(Transfer::Rows),
            Self::OnDevice(_) if device.is_none() => {
                Err(Error::Mismatch("the CPU device reads no photographs of a Vulkan device: pass their rows".into()))
            }
            Self::OnDevice(source) => fetch(plan, image, source.location(), None).map(Transfer::Fetch),
            Self::Shared { memory, offset, pitch } => {
                memory.check(device)?;
                let rows = Rows::new(plan, image, Bytes::Shared(memory, offset), pitch)?;
                match memory.location(offset as u64, pitch as u64) {
                    Some(location) => fetch(plan, image, location, Some(memory.clone() as Arc<_>)).map(Transfer::Fetch),
                    None => Ok(Transfer::Rows(rows)),
                }
            }
        }
    }
}

fn check_frame(plan: &Plan, image: usize, frame: &Frame) -> Result<(), Error> {
    let ([width, height], packed) = (plan.size, plan.packed[image]);
    if [frame.width(), frame.height()] == plan.size && frame.format() == plan.formats[image] && packed.is_plain() {
        return Ok(());
    }
    Err(Error::Mismatch(format!(
        "this solver was prepared for {width}x{height} {packed}, not {}x{} {:?}: prepare another",
        frame.width(),
        frame.height(),
        frame.format()
    )))
}

fn fetch(
    plan: &Plan,
    image: usize,
    location: SourceLocation,
    owner: Option<Arc<dyn Any + Send + Sync>>,
) -> Result<SourceCopy, Error> {
    let row_bytes = rows(plan, image, location.pitch() as usize)?.row_bytes as u64;
    Ok(SourceCopy { location, size: plan.size, row_bytes, bytes: plan.packed_bytes(image), owner })
}

/// The rows of a photograph whose rows start `pitch` bytes apart.
fn rows(plan: &Plan, image: usize, pitch: usize) -> Result<RowLayout, Error> {
    plan.packed[image].rows(plan.size, pitch).map_err(Error::Mismatch)
}

/// Rows of a photograph in memory of the host.
pub(super) struct Rows<'a> {
    bytes: Bytes<'a>,
    /// Bytes from the first row to the end of the last.
    length: usize,
    pitch: usize,
    row_bytes: usize,
    are_floats: bool,
}

enum Bytes<'a> {
    Slice(&'a [u8]),
    /// Shared memory from an offset on.
    Shared(&'a SharedMemory, usize),
}

impl<'a> Rows<'a> {
    fn new(plan: &Plan, image: usize, bytes: Bytes<'a>, pitch: usize) -> Result<Self, Error> {
        let RowLayout { row_bytes, pitch, bytes: length } = rows(plan, image, pitch)?;
        let available = match bytes {
            Bytes::Slice(bytes) => bytes.len(),
            Bytes::Shared(memory, offset) => memory.bytes().saturating_sub(offset),
        };
        if available < length {
            let ([width, height], packed) = (plan.size, plan.packed[image]);
            let problem = format!("{width}x{height} of {packed} take {length} bytes, and there are {available}");
            return Err(Error::Mismatch(problem));
        }
        Ok(Self { bytes, length, pitch, row_bytes, are_floats: plan.formats[image].depth == Depth::F32 })
    }

    /// Copies the rows without gaps. Returns whether they hold numbers that frames may hold.
    pub(super) fn copy(&self, to: &mut [u8]) -> bool {
        match self.bytes {
            Bytes::Slice(bytes) => self.copy_from(&bytes[..self.length], to),
            Bytes::Shared(memory, offset) => {
                memory.read(offset..offset + self.length, |bytes| self.copy_from(bytes, to))
            }
        }
    }

    fn copy_from(&self, bytes: &[u8], to: &mut [u8]) -> bool {
        // Some 256 KiB a thread at a time: its start costs next to nothing beside that.
        let rows = ((1 << 18) / self.row_bytes).max(1);
        let chunks = bytes.chunks(self.pitch * rows).zip(to.chunks_mut(self.row_bytes * rows));
        workers::for_each(chunks, |(from, to)| {
            for (from, to) in from.chunks(self.pitch).zip(to.chunks_mut(self.row_bytes)) {
                to[..self.row_bytes].copy_from_slice(&from[..self.row_bytes]);
            }
        });
        !self.are_floats || {
            let floats = bytes.chunks(self.pitch).flat_map(|row| row[..self.row_bytes].chunks_exact(4));
            floats.map(bytemuck::pod_read_unaligned::<f32>).all(Frame::is_valid_sample)
        }
    }
}
