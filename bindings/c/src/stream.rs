//! Many pairs one after the other.

use std::time::Duration;

use parfocal::{Engine, Settings, Stream};

use crate::engine::parfocal_engine;
use crate::fault::{Fault, call, parfocal_status, value};
use crate::handle::{free, get, give, give_any, slice};
use crate::image::{frame, kind, parfocal_image};
use crate::settings::{Told, parfocal_settings};
use crate::solution::parfocal_solution;

/// Many pairs of one size and kind in, their solutions out in the same order: on each device several are under way, so that the next goes up
/// and the one before comes down while it solves. One thread may push while another reads.
pub struct parfocal_stream {
    stream: Stream,
    settings: Settings,
}

/// Prepares devices, count of them, with so many slots each (three keep a device busy), for pairs like i1 and i2, of which no pixel is read;
/// settings may be NULL. Each pair goes to whichever device is free; what a device that fails had the others solve.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_new(
    engines: *const *const parfocal_engine,
    count: usize,
    slots: u32,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    settings: *const parfocal_settings,
    stream: *mut *mut parfocal_stream,
) -> parfocal_status {
    let make = || {
        // SAFETY: the contract is the same.
        let (engines, told) = unsafe { (self::engines(engines, count)?, Told::read(settings)?) };
        // SAFETY: the contract is the same.
        let ((size, first), (other, second)) = unsafe { (kind(i1, "i1")?, kind(i2, "i2")?) };
        if size != other {
            return Err(Fault::argument(format!("i1 is {}x{} and i2 {}x{}", size[0], size[1], other[0], other[1])));
        }
        let settings = told.of_depths([first.depth, second.depth].into_iter());
        let stream = Stream::new(&engines, slots as usize, size, [first, second], &settings)?;
        Ok(parfocal_stream { stream, settings })
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give(stream, make) })
}

/// # Safety
/// `engines` is NULL, or begins `count` handles.
unsafe fn engines<'a>(engines: *const *const parfocal_engine, count: usize) -> Result<Vec<&'a Engine>, Fault> {
    // SAFETY: the contract is the same.
    let handles = unsafe { slice(engines, count, "engines") }?;
    // SAFETY: each is a handle, or NULL.
    handles.iter().map(|&engine| Ok(&*unsafe { get(engine, "an engine") }?.engine)).collect()
}

/// Copies a pair and hands it over, once there is room for it, for which it waits so many seconds at most: 0 does not wait, INFINITY for ever,
/// which is of use where another thread reads. PARFOCAL_FULL where there was no room: read a solution first. What is wrong with
/// a pair, another size say, is told where its solution is read.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_push(
    stream: *const parfocal_stream,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    seconds: f64,
) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        let (stream, i1, i2) = unsafe { (get(stream, "stream")?, frame(i1, "i1")?, frame(i2, "i2")?) };
        Ok(stream.stream.push([i1, i2], limit(seconds)?)?)
    })
}

/// The solution of the oldest pair that has not been read, for which it waits so many seconds at most, as parfocal_stream_push. NULL
/// where it is not there by then, and after parfocal_stream_finish at once where all have been read. Fails of what that pair failed of; those
/// behind it go on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_next(
    stream: *const parfocal_stream,
    seconds: f64,
    solution: *mut *mut parfocal_solution,
) -> parfocal_status {
    let make = || {
        // SAFETY: the contract is the same.
        let parfocal_stream { stream, settings } = unsafe { get(stream, "stream") }?;
        Ok(stream.next(limit(seconds)?)?.map(|solved| parfocal_solution::solved(solved, settings)))
    };
    // SAFETY: the contract is the same.
    call(|| unsafe { give_any(solution, make) })
}

/// Says that no more pairs come, so that who reads waits for the last and no longer. Another push takes it back.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_finish(stream: *const parfocal_stream) -> parfocal_status {
    call(|| {
        // SAFETY: the contract is the same.
        unsafe { get(stream, "stream") }?.stream.finish();
        Ok(())
    })
}

/// How many pairs may be pushed and not yet read, two for each slot: only reading makes room; 0 of NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_capacity(stream: *const parfocal_stream) -> usize {
    // SAFETY: the contract is the same.
    unsafe { get(stream, "stream") }.map_or(0, |stream| stream.stream.capacity())
}

/// How many pairs were pushed and not yet read; 0 of NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_length(stream: *const parfocal_stream) -> usize {
    // SAFETY: the contract is the same.
    unsafe { get(stream, "stream") }.map_or(0, |stream| value(0, || stream.stream.len()))
}

/// Frees a stream, once the devices have solved what they have; what waits is forgotten. Its solutions live on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_free(stream: *mut parfocal_stream) {
    // SAFETY: the contract is the same.
    unsafe { free(stream) };
}

/// Seconds, or for ever.
fn limit(seconds: f64) -> Result<Duration, Fault> {
    if seconds == f64::INFINITY {
        return Ok(Duration::MAX);
    }
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| Fault::argument(format!("seconds is {seconds}: give 0 or more, or INFINITY")))
}

/// What the header says of threads.
const _: () = {
    const fn may_be_shared<T: Send + Sync>() {}
    may_be_shared::<parfocal_stream>();
};
