//! Engines: opening a device, its options, name and validation messages.

use std::ffi::{CStr, CString, c_char};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use parfocal::{Engine, EngineOptions};

use crate::fault::{Fault, call, parfocal_status, text, value};
use crate::handle::{free, get, give};
use crate::sized::{Versioned, read};

/// A device. Solvers, streams and results keep it alive, so it may be freed before them.
pub struct parfocal_engine {
    pub(crate) engine: Arc<Engine>,
    device: CString,
    /// The validation messages as of the last query.
    messages: Mutex<CString>,
}

/// The options of an engine.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_engine_options {
    /// sizeof(parfocal_engine_options).
    pub size: usize,
    /// Index, part of the name, or UUID of the device, UTF-8. NULL selects the most capable device.
    pub device: *const c_char,
    /// Time limit of one solve, seconds. 0 means 600.
    pub timeout_s: f64,
    /// Not 0 enables validation, which needs the Khronos validation layer.
    pub validation: i32,
}

// SAFETY: `repr(C)`, numbers and a pointer, the size first.
unsafe impl Versioned for parfocal_engine_options {
    const NAME: &'static str = "parfocal_engine_options";

    fn start() -> Self {
        Self { size: size_of::<Self>(), device: std::ptr::null(), timeout_s: 0.0, validation: 0 }
    }
}

/// Returns the version of the library, for example "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn parfocal_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}

/// Opens a device. options may be NULL. One engine per process is enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_new(
    options: *const parfocal_engine_options,
    engine: *mut *mut parfocal_engine,
) -> parfocal_status {
    // SAFETY: by the C contract.
    call(|| unsafe { give(engine, || open(options)) })
}

/// # Safety
/// The C contract holds for `options`.
unsafe fn open(options: *const parfocal_engine_options) -> Result<parfocal_engine, Fault> {
    let asked = match options.is_null() {
        true => parfocal_engine_options::start(),
        // SAFETY: by the C contract.
        false => unsafe { read(options) }?,
    };
    // SAFETY: by the C contract.
    let options = unsafe { engine_options(&asked) }?;
    Ok(parfocal_engine::of(Engine::new(&options)?))
}

/// Converts the options of C.
///
/// # Safety
/// `asked.device` is NULL or a string.
pub(crate) unsafe fn engine_options(asked: &parfocal_engine_options) -> Result<EngineOptions, Fault> {
    let mut options = EngineOptions { validation: asked.validation != 0, ..EngineOptions::default() };
    if asked.timeout_s != 0.0 {
        let timeout = Duration::try_from_secs_f64(asked.timeout_s).ok().filter(|timeout| !timeout.is_zero());
        options.timeout = timeout
            .ok_or_else(|| Fault::argument(format!("timeout_s is {}: give a number of seconds", asked.timeout_s)))?;
    }
    if !asked.device.is_null() {
        // SAFETY: not NULL, so by the C contract a NUL-terminated string.
        let device = unsafe { CStr::from_ptr(asked.device) }.to_str();
        options.device = Some(device.map_err(|_| Fault::argument("device is not UTF-8"))?.to_string());
    }
    Ok(options)
}

impl parfocal_engine {
    pub(crate) fn of(engine: Engine) -> Self {
        let device = text(&engine.info().name);
        Self { engine: Arc::new(engine), device, messages: Mutex::default() }
    }
}

/// Returns the name of the device; "" if engine is NULL. Valid until the engine is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_device(engine: *const parfocal_engine) -> *const c_char {
    // SAFETY: by the C contract.
    unsafe { get(engine, "engine") }.map_or(c"".as_ptr(), |engine| engine.device.as_ptr())
}

/// Returns the validation messages so far, one per line; "" if there are none or engine is NULL. Valid until the next call
/// of this function for the engine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_messages(engine: *const parfocal_engine) -> *const c_char {
    // SAFETY: by the C contract.
    let Ok(engine) = (unsafe { get(engine, "engine") }) else { return c"".as_ptr() };
    value(c"".as_ptr(), || {
        let mut messages = engine.messages.lock().unwrap_or_else(PoisonError::into_inner);
        *messages = text(&engine.engine.validation_messages().join("\n"));
        messages.as_ptr()
    })
}

/// Frees an engine. Handles made from it stay valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_free(engine: *mut parfocal_engine) {
    // SAFETY: by the C contract.
    unsafe { free(engine) };
}
