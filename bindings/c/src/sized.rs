//! Structs that begin with their size, so that programs work with newer and older libraries.

use std::mem::{MaybeUninit, size_of};

use crate::fault::Fault;

/// A struct of the header.
///
/// # Safety
/// The type is `repr(C)`, begins with a `usize` that holds its size, and has only integers, floats and pointers, so that all
/// bytes are valid.
pub(crate) unsafe trait Versioned: Copy {
    /// The name in the header.
    const NAME: &'static str;

    /// The defaults of fields that the caller does not have.
    fn start() -> Self;
}

/// Copies a struct of the caller. An older one gets defaults; a newer one must have zeros in the fields unknown here.
///
/// # Safety
/// `from` is NULL, or readable for the number of bytes in its first field.
pub(crate) unsafe fn read<T: Versioned>(from: *const T) -> Result<T, Fault> {
    // SAFETY: guaranteed by the caller.
    let size = unsafe { stated_size(from)? };
    let mut value = MaybeUninit::new(T::start());
    // SAFETY: both have at least this many bytes, and any bytes are a valid T.
    let value = unsafe {
        from.cast::<u8>().copy_to(value.as_mut_ptr().cast(), size.min(size_of::<T>()));
        value.assume_init()
    };
    // SAFETY: within the size that the caller states.
    let has_unknown = (size_of::<T>()..size).any(|i| unsafe { *from.cast::<u8>().add(i) } != 0);
    match has_unknown {
        true => Err(Fault::argument(format!(
            "{} is of a newer version and sets fields that this version does not have",
            T::NAME
        ))),
        false => Ok(value),
    }
}

/// Fills in a struct of the caller up to its size. The size stays; fields unknown here become 0.
///
/// # Safety
/// `to` is NULL, or writable for the number of bytes in its first field.
pub(crate) unsafe fn write<T: Versioned>(to: *mut T, value: T) -> Result<(), Fault> {
    // SAFETY: as the caller promises; the size comes first, and is kept; T is longer than that.
    unsafe {
        let size = stated_size(to)?;
        let head = size_of::<usize>();
        to.cast::<u8>().add(head).write_bytes(0, size - head);
        (&raw const value).cast::<u8>().add(head).copy_to(to.cast::<u8>().add(head), size.min(size_of::<T>()) - head);
    }
    Ok(())
}

/// Returns the size that a struct states.
///
/// # Safety
/// `of` is NULL, or points to a `usize`.
pub(crate) unsafe fn stated_size<T: Versioned>(of: *const T) -> Result<usize, Fault> {
    if of.is_null() {
        return Err(Fault::argument(format!("{} is NULL", T::NAME)));
    }
    // SAFETY: not NULL, and begins with its size; C memory may be unaligned.
    let size = unsafe { of.cast::<usize>().read_unaligned() };
    // No version has a struct of a page or more: a larger number was never set.
    if !(size_of::<usize>()..4096).contains(&size) {
        return Err(Fault::argument(format!("{0}.size is {size}: set it to sizeof({0})", T::NAME)));
    }
    Ok(size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[repr(C)]
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Now {
        size: usize,
        a: u64,
        b: u64,
    }

    // SAFETY: of integers, the size first.
    unsafe impl Versioned for Now {
        const NAME: &'static str = "now";
        fn start() -> Self {
            Self { size: size_of::<Self>(), a: 1, b: 2 }
        }
    }

    fn read_words(words: &[usize]) -> Option<Now> {
        // SAFETY: the tests' sizes are no longer than the words.
        unsafe { read::<Now>(words.as_ptr().cast()) }.ok()
    }

    #[test]
    fn older_and_newer_structs_are_read_and_filled() {
        assert_eq!(read_words(&[16, 7]), Some(Now { size: 16, a: 7, b: 2 }));
        assert_eq!(read_words(&[24, 7, 8]), Some(Now { size: 24, a: 7, b: 8 }));
        assert_eq!(read_words(&[32, 7, 8, 0]), Some(Now { size: 32, a: 7, b: 8 }));
        assert_eq!(read_words(&[32, 7, 8, 1]), None);
        assert_eq!(read_words(&[0, 7, 8]), None);
        assert_eq!(read_words(&[1 << 40, 7, 8]), None);
        // SAFETY: NULL is allowed.
        assert!(unsafe { read::<Now>(std::ptr::null()) }.is_err());
        for (mut words, filled) in [([16usize, 9, 9, 9], [16usize, 1, 9, 9]), ([32, 9, 9, 9], [32, 1, 2, 0])] {
            // SAFETY: both sizes are within the words.
            assert!(unsafe { write(words.as_mut_ptr().cast(), Now::start()) }.is_ok());
            assert_eq!(words, filled);
        }
    }
}
