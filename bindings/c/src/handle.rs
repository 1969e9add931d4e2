//! Handles: boxes that C holds by a pointer.

use crate::fault::{Fault, value};

/// Hands a new handle out; nothing where there is no place for it.
///
/// # Safety
/// `out` is NULL, or a pointer may be written to it.
pub(crate) unsafe fn give<T>(out: *mut *mut T, make: impl FnOnce() -> Result<T, Fault>) -> Result<(), Fault> {
    // SAFETY: the contract is the same.
    unsafe { give_any(out, || make().map(Some)) }
}

/// The same of what there may be: NULL where there is none.
///
/// # Safety
/// As [`give`].
pub(crate) unsafe fn give_any<T>(
    out: *mut *mut T,
    make: impl FnOnce() -> Result<Option<T>, Fault>,
) -> Result<(), Fault> {
    if out.is_null() {
        return Err(Fault::argument("the place for the new handle is NULL"));
    }
    // SAFETY: not NULL, so writable.
    unsafe { out.write(std::ptr::null_mut()) };
    if let Some(made) = make()? {
        // SAFETY: as before.
        unsafe { out.write(Box::into_raw(Box::new(made))) };
    }
    Ok(())
}

/// What a handle holds.
///
/// # Safety
/// `handle` is NULL, or was given out and not freed, and no other thread changes it meanwhile.
pub(crate) unsafe fn get<'a, T>(handle: *const T, name: &str) -> Result<&'a T, Fault> {
    // SAFETY: as the caller promises.
    unsafe { handle.as_ref() }.ok_or_else(|| Fault::argument(format!("{name} is NULL")))
}

/// The same, to be changed.
///
/// # Safety
/// `handle` is NULL, or was given out and not freed, and no other thread uses it meanwhile.
pub(crate) unsafe fn get_mut<'a, T>(handle: *mut T, name: &str) -> Result<&'a mut T, Fault> {
    // SAFETY: as the caller promises.
    unsafe { handle.as_mut() }.ok_or_else(|| Fault::argument(format!("{name} is NULL")))
}

/// Frees a handle; nothing if it is NULL.
///
/// # Safety
/// `handle` is NULL, or was given out and not freed, and no one uses it any more.
pub(crate) unsafe fn free<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: it came of `Box::into_raw` in `give`, once.
        let boxed = unsafe { Box::from_raw(handle) };
        value((), move || drop(boxed));
    }
}

/// Many values of C's.
///
/// # Safety
/// `from` is NULL, or `length` values can be read there, which live as long as is said.
pub(crate) unsafe fn slice<'a, T>(from: *const T, length: usize, name: &str) -> Result<&'a [T], Fault> {
    check(from, length, name)?;
    // SAFETY: not NULL, aligned, no longer than memory can be, and readable as the caller promises.
    Ok(unsafe { std::slice::from_raw_parts(from, length) })
}

/// Many values of C's, to be written.
///
/// # Safety
/// `to` is NULL, or `length` initialised values are there that nothing else uses meanwhile.
pub(crate) unsafe fn slice_mut<'a, T>(to: *mut T, length: usize, name: &str) -> Result<&'a mut [T], Fault> {
    check(to, length, name)?;
    // SAFETY: not NULL, aligned, no longer than memory can be, and the caller's as it promises.
    Ok(unsafe { std::slice::from_raw_parts_mut(to, length) })
}

fn check<T>(at: *const T, length: usize, name: &str) -> Result<(), Fault> {
    if at.is_null() || !at.is_aligned() {
        return Err(Fault::argument(format!("{name} is {}", if at.is_null() { "NULL" } else { "not aligned" })));
    }
    let fits = length.checked_mul(size_of::<T>()).is_some_and(|bytes| isize::try_from(bytes).is_ok());
    fits.then_some(()).ok_or_else(|| Fault::argument(format!("{name}: {length} values are too many")))
}
