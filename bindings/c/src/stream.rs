//! Streams of pairs.

use std::time::Duration;

use parfocal::{Engine, Settings, Stream};

use crate::engine::parfocal_engine;
use crate::fault::{Fault, call, parfocal_status, value};
use crate::handle::{free, get, give, give_any, slice};
use crate::image::{frame, parfocal_image, size_and_format};
use crate::settings::{CallerSettings, parfocal_settings};
use crate::solution::parfocal_solution;

/// Solves many pairs of the same size and format. Solutions come in the order of the pairs. While a device solves one pair,
/// the next is uploaded and the one before is read back. One thread may push while another reads.
pub struct parfocal_stream {
    stream: Stream,
    settings: Settings,
}

/// Makes a stream on count engines, with slots pairs in flight on each; three keep a device busy. i1 and i2 state the size and
/// format of all pairs; their pixels are not read. settings may be NULL. Each pair goes to the first free device. The pairs of
/// a device that fails go to the others.
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
        // SAFETY: by the C contract.
        let (engines, caller_settings) = unsafe { (self::engines(engines, count)?, CallerSettings::read(settings)?) };
        // SAFETY: by the C contract.
        let ((size, first), (other, second)) = unsafe { (size_and_format(i1, "i1")?, size_and_format(i2, "i2")?) };
        if size != other {
            return Err(Fault::argument(format!(
                "i1 is {}x{} and i2 is {}x{}: give photographs of one size",
                size[0], size[1], other[0], other[1]
            )));
        }
        let settings = caller_settings.resolved_for_depths([first.depth, second.depth].into_iter());
        let stream = Stream::new(&engines, slots as usize, size, [first, second], &settings)?;
        Ok(parfocal_stream { stream, settings })
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give(stream, make) })
}

/// # Safety
/// `engines` is NULL, or points to `count` handles.
unsafe fn engines<'a>(engines: *const *const parfocal_engine, count: usize) -> Result<Vec<&'a Engine>, Fault> {
    // SAFETY: NULL, or `count` handles, by the caller's guarantee.
    let handles = unsafe { slice(engines, count, "engines") }?;
    // SAFETY: each is a handle, or NULL.
    handles.iter().map(|&engine| Ok(&*unsafe { get(engine, "an engine") }?.engine)).collect()
}

/// Copies a pair into the stream. Waits up to seconds for room: 0 does not wait; INFINITY waits without limit, for use when
/// another thread reads. Returns PARFOCAL_ERROR_FULL if there is no room in time: read a solution first. An error of the pair
/// itself, for example another size, is returned when its solution is read.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_push(
    stream: *const parfocal_stream,
    i1: *const parfocal_image,
    i2: *const parfocal_image,
    seconds: f64,
) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        let (stream, i1, i2) = unsafe { (get(stream, "stream")?, frame(i1, "i1")?, frame(i2, "i2")?) };
        Ok(stream.stream.push([i1, i2], limit(seconds)?)?)
    })
}

/// Reads the solution of the oldest pair that has not been read. Waits up to seconds, as parfocal_stream_push. The solution is
/// NULL if it is not ready in time, and after parfocal_stream_finish once all have been read. Returns that pair's error. Later
/// pairs are unaffected.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_next(
    stream: *const parfocal_stream,
    seconds: f64,
    solution: *mut *mut parfocal_solution,
) -> parfocal_status {
    let make = || {
        // SAFETY: by the C contract.
        let parfocal_stream { stream, settings } = unsafe { get(stream, "stream") }?;
        Ok(stream.next(limit(seconds)?)?.map(|solved| parfocal_solution::solved(solved, settings)))
    };
    // SAFETY: by the C contract.
    call(|| unsafe { give_any(solution, make) })
}

/// Marks the end of input, so that readers wait only for the remaining pairs. A later push reopens the stream.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_finish(stream: *const parfocal_stream) -> parfocal_status {
    call(|| {
        // SAFETY: by the C contract.
        unsafe { get(stream, "stream") }?.stream.finish();
        Ok(())
    })
}

/// Returns the number of pairs that may be pushed and not yet read, two per slot; 0 if stream is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_capacity(stream: *const parfocal_stream) -> usize {
    // SAFETY: by the C contract.
    unsafe { get(stream, "stream") }.map_or(0, |stream| stream.stream.capacity())
}

/// Returns the number of pairs pushed and not yet read; 0 if stream is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_length(stream: *const parfocal_stream) -> usize {
    // SAFETY: by the C contract.
    unsafe { get(stream, "stream") }.map_or(0, |stream| value(0, || stream.stream.len()))
}

/// Frees a stream after the pairs in flight are solved; waiting pairs are dropped. Its solutions stay valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_stream_free(stream: *mut parfocal_stream) {
    // SAFETY: by the C contract.
    unsafe { free(stream) };
}

/// Converts seconds; INFINITY is no limit.
fn limit(seconds: f64) -> Result<Duration, Fault> {
    if seconds == f64::INFINITY {
        return Ok(Duration::MAX);
    }
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| Fault::argument(format!("seconds is {seconds}: give 0 or more, or INFINITY")))
}

/// Checks what the header says about threads.
const _: () = {
    const fn may_be_shared<T: Send + Sync>() {}
    may_be_shared::<parfocal_stream>();
};
