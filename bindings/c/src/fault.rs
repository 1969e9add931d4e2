//! What goes wrong, as a number and in words; panics end here.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use parfocal::{Error, QueueFull};

/// How a call ended.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum parfocal_status {
    /// Done.
    PARFOCAL_OK = 0,
    /// A pointer is NULL, a size field not set, a number none of its enumeration, an image not of numbers.
    PARFOCAL_INVALID_ARGUMENT = 1,
    /// No Vulkan loader, or no device that will do, or none of the name asked for.
    PARFOCAL_NO_DEVICE = 2,
    /// A Vulkan call failed.
    PARFOCAL_VULKAN = 3,
    /// The device did not finish in time: a new engine is needed.
    PARFOCAL_TIMEOUT = 4,
    /// An earlier call timed out or lost the device: a new engine is needed.
    PARFOCAL_POISONED = 5,
    /// The images are larger than the device takes.
    PARFOCAL_TOO_LARGE = 6,
    /// The images are too small to find any blur in.
    PARFOCAL_TOO_SMALL = 7,
    /// Sizes or formats that do not fit each other.
    PARFOCAL_MISMATCH = 8,
    /// A setting is out of range.
    PARFOCAL_SETTING = 9,
    /// A region or a line is not within the image.
    PARFOCAL_REGION = 10,
    /// A fault of parfocal itself: free the handles of the call, and report it.
    PARFOCAL_PANIC = 11,
    /// Anything else.
    PARFOCAL_OTHER = 12,
    /// A stream had no room for the pair in time, which was not taken: read a result first.
    PARFOCAL_FULL = 13,
    /// The call was called off.
    PARFOCAL_CANCELLED = 14,
}

use parfocal_status::*;

/// What a call is ended by.
pub(crate) struct Fault {
    status: parfocal_status,
    message: String,
}

impl Fault {
    /// Something that the caller handed over is not what it must be.
    pub(crate) fn argument(message: impl Into<String>) -> Self {
        Self { status: PARFOCAL_INVALID_ARGUMENT, message: message.into() }
    }
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::NoLoader(_) | Error::NoDevice(_) | Error::NoSuchDevice { .. } => PARFOCAL_NO_DEVICE,
            Error::Vulkan { .. } => PARFOCAL_VULKAN,
            Error::Timeout { .. } => PARFOCAL_TIMEOUT,
            Error::Poisoned => PARFOCAL_POISONED,
            Error::TooLarge { .. } => PARFOCAL_TOO_LARGE,
            Error::TooSmall { .. } => PARFOCAL_TOO_SMALL,
            Error::Mismatch(_) => PARFOCAL_MISMATCH,
            Error::Setting { .. } | Error::Kernel { .. } => PARFOCAL_SETTING,
            Error::Region(_) => PARFOCAL_REGION,
            Error::Cancelled => PARFOCAL_CANCELLED,
            _ => PARFOCAL_OTHER,
        };
        Self { status, message: error.to_string() }
    }
}

impl From<QueueFull> for Fault {
    fn from(full: QueueFull) -> Self {
        Self { status: PARFOCAL_FULL, message: full.to_string() }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// A string for C: what it has of NUL is left out.
pub(crate) fn text(words: &str) -> CString {
    CString::new(words.replace('\0', "")).unwrap_or_default()
}

/// Runs a call of C to its status, and keeps what is to be said of it.
pub(crate) fn call(run: impl FnOnce() -> Result<(), Fault>) -> parfocal_status {
    // What a panic leaves half done is a handle's own, and memory-safe; the message says to free it.
    let done = catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|panic| Err(of_panic(&*panic)));
    let (status, message) = done.err().map_or((PARFOCAL_OK, String::new()), |fault| (fault.status, fault.message));
    // A thread that is ending has no place for a message any more.
    let _ = LAST.try_with(|last| *last.borrow_mut() = text(&message));
    status
}

/// Runs what cannot fail but by a panic, on which it gives the value of `otherwise`.
pub(crate) fn value<T>(otherwise: T, run: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(run)).unwrap_or(otherwise)
}

fn of_panic(panic: &(dyn Any + Send)) -> Fault {
    let words = panic.downcast_ref::<&str>().map(ToString::to_string).or(panic.downcast_ref::<String>().cloned());
    let message = format!("a fault of parfocal itself, {}: free the handles of this call", words.unwrap_or_default());
    Fault { status: PARFOCAL_PANIC, message }
}

/// What the last call of this thread that returned a status failed by, and what to do; "" where it did not fail. Valid until
/// this thread's next such call.
#[unsafe(no_mangle)]
pub extern "C" fn parfocal_last_error() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use super::*;

    fn said() -> String {
        // SAFETY: what is returned is a string of this thread's, and no call follows before it is copied.
        unsafe { CStr::from_ptr(parfocal_last_error()) }.to_string_lossy().into_owned()
    }

    #[test]
    fn a_panic_is_a_status_and_success_says_nothing() {
        assert_eq!(call(|| panic!("at {}", 7)), PARFOCAL_PANIC);
        assert!(said().contains("at 7"), "{}", said());
        assert_eq!(call(|| Err(Fault::argument("a\0b"))), PARFOCAL_INVALID_ARGUMENT);
        assert_eq!(said(), "ab");
        assert_eq!(call(|| Err(Error::Poisoned.into())), PARFOCAL_POISONED);
        assert_eq!(call(|| Ok(())), PARFOCAL_OK);
        assert_eq!(said(), "");
        assert_eq!(value(3, || panic!("here")), 3);
    }
}
