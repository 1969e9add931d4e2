//! Errors as a status and a message. Panics end here.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use parfocal::{Error, QueueFull};

/// The outcome of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum parfocal_status {
    /// Success.
    PARFOCAL_OK = 0,
    /// A pointer is NULL, a size field is not set, a number is not in its enumeration, or a sample is not a finite number.
    PARFOCAL_ERROR_INVALID_ARGUMENT = 1,
    /// There is no Vulkan loader, no usable device, or no device of the given name.
    PARFOCAL_ERROR_NO_DEVICE = 2,
    /// A Vulkan call failed.
    PARFOCAL_ERROR_VULKAN = 3,
    /// The device did not finish in time. Make a new engine.
    PARFOCAL_ERROR_TIMEOUT = 4,
    /// An earlier call timed out or lost the device. Make a new engine.
    PARFOCAL_ERROR_POISONED = 5,
    /// The images do not fit the device.
    PARFOCAL_ERROR_TOO_LARGE = 6,
    /// The images are too small to measure blur.
    PARFOCAL_ERROR_TOO_SMALL = 7,
    /// Sizes or formats do not match.
    PARFOCAL_ERROR_MISMATCH = 8,
    /// A setting is out of range.
    PARFOCAL_ERROR_INVALID_SETTING = 9,
    /// A region or a line is not inside the image.
    PARFOCAL_ERROR_INVALID_REGION = 10,
    /// An internal error: free the handles of the call, and report it.
    PARFOCAL_ERROR_INTERNAL = 11,
    /// Any other error.
    PARFOCAL_ERROR_OTHER = 12,
    /// The stream had no room in time, and did not take the pair. Read a result first.
    PARFOCAL_ERROR_FULL = 13,
    /// The call was cancelled.
    PARFOCAL_ERROR_CANCELLED = 14,
}

use parfocal_status::*;

/// An error: the status and the message.
pub(crate) struct Fault {
    status: parfocal_status,
    message: String,
}

impl Fault {
    /// An invalid argument.
    pub(crate) fn argument(message: impl Into<String>) -> Self {
        Self { status: PARFOCAL_ERROR_INVALID_ARGUMENT, message: message.into() }
    }
}

impl From<Error> for Fault {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::NoLoader(_) | Error::NoDevice(_) | Error::NoSuchDevice { .. } => PARFOCAL_ERROR_NO_DEVICE,
            Error::Vulkan { .. } => PARFOCAL_ERROR_VULKAN,
            Error::Timeout { .. } => PARFOCAL_ERROR_TIMEOUT,
            Error::Poisoned => PARFOCAL_ERROR_POISONED,
            Error::TooLarge { .. } => PARFOCAL_ERROR_TOO_LARGE,
            Error::TooSmall { .. } => PARFOCAL_ERROR_TOO_SMALL,
            Error::Mismatch(_) => PARFOCAL_ERROR_MISMATCH,
            Error::Setting { .. } | Error::Kernel { .. } => PARFOCAL_ERROR_INVALID_SETTING,
            Error::Region(_) => PARFOCAL_ERROR_INVALID_REGION,
            Error::Cancelled => PARFOCAL_ERROR_CANCELLED,
            _ => PARFOCAL_ERROR_OTHER,
        };
        Self { status, message: error.to_string() }
    }
}

impl From<QueueFull> for Fault {
    fn from(full: QueueFull) -> Self {
        Self { status: PARFOCAL_ERROR_FULL, message: full.to_string() }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Makes a C string; NUL characters are removed.
pub(crate) fn text(message: &str) -> CString {
    CString::new(message.replace('\0', "")).unwrap_or_default()
}

/// Runs a call, stores its error message, and returns its status.
pub(crate) fn call(run: impl FnOnce() -> Result<(), Fault>) -> parfocal_status {
    // A panic may leave a handle half-changed, but memory-safe. The message says to free it.
    let done = catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|panic| Err(of_panic(&*panic)));
    let (status, message) = done.err().map_or((PARFOCAL_OK, String::new()), |fault| (fault.status, fault.message));
    // A thread that is ending has no thread-local storage any more.
    let _ = LAST.try_with(|last| *last.borrow_mut() = text(&message));
    status
}

/// Runs a function that fails only by a panic, and then returns `otherwise`.
pub(crate) fn value<T>(otherwise: T, run: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(run)).unwrap_or(otherwise)
}

fn of_panic(panic: &(dyn Any + Send)) -> Fault {
    let cause = panic.downcast_ref::<&str>().map(ToString::to_string).or(panic.downcast_ref::<String>().cloned());
    let message = format!("internal error, {}: free the handles of this call and report it", cause.unwrap_or_default());
    Fault { status: PARFOCAL_ERROR_INTERNAL, message }
}

/// Returns the error message of this thread's last call that returned a status, with what to do; "" after a success. Valid
/// until this thread's next such call.
#[unsafe(no_mangle)]
pub extern "C" fn parfocal_last_error() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use super::*;

    fn last_error() -> String {
        // SAFETY: the string belongs to this thread, and no call follows before it is copied.
        unsafe { CStr::from_ptr(parfocal_last_error()) }.to_string_lossy().into_owned()
    }

    #[test]
    fn a_panic_becomes_a_status_and_success_clears_the_message() {
        assert_eq!(call(|| panic!("at {}", 7)), PARFOCAL_ERROR_INTERNAL);
        assert!(last_error().contains("at 7"), "{}", last_error());
        assert_eq!(call(|| Err(Fault::argument("a\0b"))), PARFOCAL_ERROR_INVALID_ARGUMENT);
        assert_eq!(last_error(), "ab");
        assert_eq!(call(|| Err(Error::Poisoned.into())), PARFOCAL_ERROR_POISONED);
        assert_eq!(call(|| Ok(())), PARFOCAL_OK);
        assert_eq!(last_error(), "");
        assert_eq!(value(3, || panic!("here")), 3);
    }
}
