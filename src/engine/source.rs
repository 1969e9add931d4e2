//! Where photographs are taken from.

use std::any::Any;
use std::sync::Arc;

use super::plan::Plan;
use super::vulkan::{Device, DeviceSource, SharedMemory, SourceCopy};
use crate::base::{Depth, Error, Frame, RowLayout, workers};

/// Where a photograph of a pair is taken from, in the solver's [format](crate::PixelFormat). Unless both are frames, the device looks itself for
/// pixels that are clipped. Floats that it fetches are not looked at: they are finite and at most 1e6.
#[derive(Clone, Copy, Debug)]
pub enum Source<'a> {
    /// Copied before `submit` returns.
    Frame(&'a Frame),
    /// Rows of the caller's memory, the start of one `pitch` bytes from that of the next, 0 where they follow one another without a gap;
    /// copied before `submit` returns.
    Rows {
        /// From the first row on.
        bytes: &'a [u8],
        /// Bytes.
        pitch: usize,
    },
    /// What was written to where [`PairSolver::input`](crate::PairSolver::input) lends.
    Written,
    /// On the engine's device, which fetches it.
    OnDevice(DeviceSource),
    /// Rows of memory that was [shared](crate::Engine::share): the device fetches them, or where it cannot, they are copied before `submit` returns.
    Shared {
        /// Of the same engine.
        memory: &'a Arc<SharedMemory>,
        /// Of the first row, bytes.
        offset: usize,
        /// As of [`Source::Rows`].
        pitch: usize,
    },
}

/// How a photograph comes.
pub(super) enum Way<'a> {
    /// It is there.
    There,
    /// The host copies it.
    Frame(&'a Frame),
    /// The host copies its rows.
    Rows(Rows<'a>),
    /// The device copies it.
    Fetch(SourceCopy),
}

/// Rows of a photograph in memory of the host.
pub(super) struct Rows<'a> {
    from: From<'a>,
    /// Bytes from the first row to the end of the last.
    length: usize,
    pitch: usize,
    row_bytes: usize,
    are_floats: bool,
}

enum From<'a> {
    Bytes(&'a [u8]),
    /// From a byte on.
    Shared(&'a SharedMemory, usize),
}

impl From<'_> {
    fn length(&self) -> usize {
        match self {
            Self::Bytes(bytes) => bytes.len(),
            Self::Shared(memory, offset) => memory.bytes().saturating_sub(*offset),
        }
    }

    /// Reads the first so many.
    fn read<T>(&self, length: usize, read: impl FnOnce(&[u8]) -> T) -> T {
        match self {
            Self::Bytes(bytes) => read(&bytes[..length]),
            Self::Shared(memory, offset) => memory.read(*offset..offset + length, read),
        }
    }
}

impl<'a> Source<'a> {
    /// How it comes to a solver, if it fits that.
    pub(super) fn way(self, plan: &Plan, image: usize, device: &Arc<Device>) -> Result<Way<'a>, Error> {
        match self {
            Self::Frame(frame) => check_frame(plan, image, frame).map(|()| Way::Frame(frame)),
            Self::Written => Ok(Way::There),
            Self::Rows { bytes, pitch } => Rows::new(plan, image, From::Bytes(bytes), pitch).map(Way::Rows),
            Self::OnDevice(source) => fetch(plan, image, source.location(), None).map(Way::Fetch),
            Self::Shared { memory, offset, pitch } => {
                memory.check(device)?;
                let rows = Rows::new(plan, image, From::Shared(memory, offset), pitch)?;
                match memory.location(offset as u64, pitch as u64) {
                    Some(place) => fetch(plan, image, place, Some(memory.clone() as Arc<_>)).map(Way::Fetch),
                    None => Ok(Way::Rows(rows)),
                }
            }
        }
    }
}

/// A frame of the size and format that a solver was prepared for.
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

/// What the device copies.
fn fetch(
    plan: &Plan,
    image: usize,
    place: super::vulkan::SourceLocation,
    keep: Option<Arc<dyn Any + Send + Sync>>,
) -> Result<SourceCopy, Error> {
    let row_bytes = rows(plan, image, place.pitch() as usize)?.row_bytes as u64;
    Ok(SourceCopy { location: place, size: plan.size, row_bytes, bytes: plan.packed_bytes(image), owner: keep })
}

/// The rows of a photograph whose rows start `pitch` bytes apart.
fn rows(plan: &Plan, image: usize, pitch: usize) -> Result<RowLayout, Error> {
    plan.packed[image].rows(plan.size, pitch).map_err(Error::Mismatch)
}

impl<'a> Rows<'a> {
    fn new(plan: &Plan, image: usize, from: From<'a>, pitch: usize) -> Result<Self, Error> {
        let RowLayout { row_bytes, pitch, bytes } = rows(plan, image, pitch)?;
        if from.length() < bytes {
            let ([width, height], packed, found) = (plan.size, plan.packed[image], from.length());
            let problem = format!("{width}x{height} of {packed} take {bytes} bytes, and there are {found}");
            return Err(Error::Mismatch(problem));
        }
        Ok(Self { from, length: bytes, pitch, row_bytes, are_floats: plan.formats[image].depth == Depth::F32 })
    }

    /// Writes them without gaps, by all threads; whether they are numbers that frames may hold.
    pub(super) fn bring(&self, to: &mut [u8]) -> bool {
        self.from.read(self.length, |bytes| self.bring_from(bytes, to))
    }

    fn bring_from(&self, bytes: &[u8], to: &mut [u8]) -> bool {
        // A piece is some 256 KiB: a thread's start is next to nothing beside it.
        let rows = ((1 << 18) / self.row_bytes).max(1);
        let rows_of = bytes.chunks(self.pitch * rows).zip(to.chunks_mut(self.row_bytes * rows));
        workers::for_each(rows_of, |(from, to)| {
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
