//! Structs that begin with their size, so that programs and libraries of different versions understand each other.

use std::mem::{MaybeUninit, size_of};

use crate::fault::Fault;

/// A struct of the header.
///
/// # Safety
/// It is `repr(C)`, begins with a `usize` that holds its size, and is of integers, floats and pointers alone: all bytes are
/// valid.
pub(crate) unsafe trait Versioned: Copy {
    /// Its name in the header.
    const NAME: &'static str;

    /// What fields hold that the caller does not know.
    fn start() -> Self;
}

/// A struct of the caller's, which may be of an older version, or of a newer one that asks for nothing new.
///
/// # Safety
/// `from` is NULL, or readable over as many bytes as its first field says.
pub(crate) unsafe fn read<T: Versioned>(from: *const T) -> Result<T, Fault> {
    // SAFETY: as the caller promises.
    let size = unsafe { stated(from)? };
    let mut found = MaybeUninit::new(T::start());
    // SAFETY: both are at least so long, and any bytes are a valid T.
    let found = unsafe {
        from.cast::<u8>().copy_to(found.as_mut_ptr().cast(), size.min(size_of::<T>()));
        found.assume_init()
    };
    // SAFETY: within what the caller says is there.
    let asked = (size_of::<T>()..size).any(|i| unsafe { *from.cast::<u8>().add(i) } != 0);
    match asked {
        true => Err(Fault::argument(format!("{} is of a newer parfocal and asks for what this one lacks", T::NAME))),
        false => Ok(found),
    }
}

/// Fills in a struct of the caller's, as far as it goes; its size stays, and what it has more is 0.
///
/// # Safety
/// `to` is NULL, or writable over as many bytes as its first field says.
pub(crate) unsafe fn write<T: Versioned>(to: *mut T, value: T) -> Result<(), Fault> {
    // SAFETY: as the caller promises; the size comes first, and is kept; T is longer than that.
    unsafe {
        let size = stated(to)?;
        let head = size_of::<usize>();
        to.cast::<u8>().add(head).write_bytes(0, size - head);
        (&raw const value).cast::<u8>().add(head).copy_to(to.cast::<u8>().add(head), size.min(size_of::<T>()) - head);
    }
    Ok(())
}

/// The size that a struct states.
///
/// # Safety
/// `of` is NULL, or points to a `usize`.
unsafe fn stated<T: Versioned>(of: *const T) -> Result<usize, Fault> {
    if of.is_null() {
        return Err(Fault::argument(format!("{} is NULL", T::NAME)));
    }
    // SAFETY: not NULL, and begins with its size; memory of C's may be unaligned.
    let size = unsafe { of.cast::<usize>().read_unaligned() };
    // No struct of any version will be a page long: what is, was never set.
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
    fn older_and_newer_structs_are_understood() {
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
