//! Handles and slices: Rust values behind C pointers.

use crate::fault::{Fault, value};

/// Writes a new handle to `out`. Makes nothing if `out` is NULL.
///
/// # Safety
/// `out` is NULL, or a pointer may be written to it.
pub(crate) unsafe fn give<T>(out: *mut *mut T, make: impl FnOnce() -> Result<T, Fault>) -> Result<(), Fault> {
    // SAFETY: the caller guarantees the same for `out`.
    unsafe { give_any(out, || make().map(Some)) }
}

/// Writes a new handle, or NULL if `make` returns `None`.
///
/// # Safety
/// As [`give`].
pub(crate) unsafe fn give_any<T>(
    out: *mut *mut T,
    make: impl FnOnce() -> Result<Option<T>, Fault>,
) -> Result<(), Fault> {
    if out.is_null() {
        return Err(Fault::argument("the pointer for the new handle is NULL"));
    }
    // SAFETY: not NULL, so writable by the caller's guarantee.
    unsafe { out.write(std::ptr::null_mut()) };
    if let Some(made) = make()? {
        // SAFETY: `out` is writable, as above.
        unsafe { out.write(Box::into_raw(Box::new(made))) };
    }
    Ok(())
}

/// Borrows the value of a handle.
///
/// # Safety
/// `handle` is NULL, or was made by `give` and is not freed, and no other thread changes it meanwhile.
pub(crate) unsafe fn get<'a, T>(handle: *const T, name: &str) -> Result<&'a T, Fault> {
    // SAFETY: guaranteed by the caller.
    unsafe { handle.as_ref() }.ok_or_else(|| Fault::argument(format!("{name} is NULL")))
}

/// Borrows the value of a handle mutably.
///
/// # Safety
/// `handle` is NULL, or was made by `give` and is not freed, and no other thread uses it meanwhile.
pub(crate) unsafe fn get_mut<'a, T>(handle: *mut T, name: &str) -> Result<&'a mut T, Fault> {
    // SAFETY: guaranteed by the caller.
    unsafe { handle.as_mut() }.ok_or_else(|| Fault::argument(format!("{name} is NULL")))
}

/// Frees a handle. NULL is ignored.
///
/// # Safety
/// `handle` is NULL, or was made by `give` and is not freed, and is not used afterwards.
pub(crate) unsafe fn free<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: `give` made it with `Box::into_raw`, and it is freed once.
        let boxed = unsafe { Box::from_raw(handle) };
        value((), move || drop(boxed));
    }
}

/// Borrows `length` values of the caller.
///
/// # Safety
/// `from` is NULL, or `length` values are readable there for the lifetime `'a`.
pub(crate) unsafe fn slice<'a, T>(from: *const T, length: usize, name: &str) -> Result<&'a [T], Fault> {
    check(from, length, name)?;
    // SAFETY: not NULL, aligned, at most `isize::MAX` bytes, and readable by the caller's guarantee.
    Ok(unsafe { std::slice::from_raw_parts(from, length) })
}

/// Borrows `length` values of the caller mutably.
///
/// # Safety
/// `to` is NULL, or `length` initialised values are there, which nothing else uses meanwhile.
pub(crate) unsafe fn slice_mut<'a, T>(to: *mut T, length: usize, name: &str) -> Result<&'a mut [T], Fault> {
    check(to, length, name)?;
    // SAFETY: not NULL, aligned, at most `isize::MAX` bytes, and exclusive by the caller's guarantee.
    Ok(unsafe { std::slice::from_raw_parts_mut(to, length) })
}

fn check<T>(at: *const T, length: usize, name: &str) -> Result<(), Fault> {
    if at.is_null() || !at.is_aligned() {
        return Err(Fault::argument(format!("{name} is {}", if at.is_null() { "NULL" } else { "not aligned" })));
    }
    let fits = length.checked_mul(size_of::<T>()).is_some_and(|bytes| isize::try_from(bytes).is_ok());
    fits.then_some(()).ok_or_else(|| Fault::argument(format!("{name}: {length} values are too many")))
}
