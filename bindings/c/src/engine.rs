//! Devices.

use std::ffi::{CStr, CString, c_char};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use parfocal::{Engine, EngineOptions};

use crate::fault::{Fault, call, parfocal_status, text, value};
use crate::handle::{free, get, give};
use crate::sized::{Versioned, read};

/// A device. What is made of it keeps it, so that it may be freed first.
pub struct parfocal_engine {
    pub(crate) engine: Arc<Engine>,
    device: CString,
    /// What validation had said when it was asked for last.
    messages: Mutex<CString>,
}

/// How an engine is made.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct parfocal_engine_options {
    /// sizeof(parfocal_engine_options).
    pub size: usize,
    /// Index, part of the name, or UUID of the device, UTF-8; NULL takes the most capable.
    pub device: *const c_char,
    /// The longest wait for one solve, seconds; 0 takes 600.
    pub timeout_s: f64,
    /// Not 0 turns validation on; it needs the Khronos validation layer.
    pub validation: i32,
}

// SAFETY: numbers and a pointer, the size first.
unsafe impl Versioned for parfocal_engine_options {
    const NAME: &'static str = "parfocal_engine_options";

    fn start() -> Self {
        Self { size: size_of::<Self>(), device: std::ptr::null(), timeout_s: 0.0, validation: 0 }
    }
}

/// The version of the library, as in "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn parfocal_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}

/// Opens a device; options may be NULL. One engine a process is enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_new(
    options: *const parfocal_engine_options,
    engine: *mut *mut parfocal_engine,
) -> parfocal_status {
    // SAFETY: the contract is the same.
    call(|| unsafe { give(engine, || open(options)) })
}

/// # Safety
/// `options` is NULL, or as the header says.
unsafe fn open(options: *const parfocal_engine_options) -> Result<parfocal_engine, Fault> {
    let asked = match options.is_null() {
        true => parfocal_engine_options::start(),
        // SAFETY: the contract is the same.
        false => unsafe { read(options) }?,
    };
    // SAFETY: the contract is the same.
    let options = unsafe { told(&asked) }?;
    Ok(parfocal_engine::of(Engine::new(&options)?))
}

/// What is asked of an engine.
///
/// # Safety
/// `asked.device` is NULL or a string.
pub(crate) unsafe fn told(asked: &parfocal_engine_options) -> Result<EngineOptions, Fault> {
    let mut options = EngineOptions { validation: asked.validation != 0, ..EngineOptions::default() };
    if asked.timeout_s != 0.0 {
        let timeout = Duration::try_from_secs_f64(asked.timeout_s).ok().filter(|timeout| !timeout.is_zero());
        options.timeout =
            timeout.ok_or_else(|| Fault::argument(format!("timeout_s is {}: give seconds", asked.timeout_s)))?;
    }
    if !asked.device.is_null() {
        // SAFETY: the header asks for a string that ends with NUL.
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

/// The name of the device; "" of NULL. Valid until the engine is freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_device(engine: *const parfocal_engine) -> *const c_char {
    // SAFETY: the contract is the same.
    unsafe { get(engine, "engine") }.map_or(c"".as_ptr(), |engine| engine.device.as_ptr())
}

/// What validation has said so far, a line each; "" where nothing, or of NULL. Valid until the next call of this for the engine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_messages(engine: *const parfocal_engine) -> *const c_char {
    // SAFETY: the contract is the same.
    let Ok(engine) = (unsafe { get(engine, "engine") }) else { return c"".as_ptr() };
    value(c"".as_ptr(), || {
        let mut kept = engine.messages.lock().unwrap_or_else(PoisonError::into_inner);
        *kept = text(&engine.engine.validation_messages().join("\n"));
        kept.as_ptr()
    })
}

/// Frees an engine; what was made of it lives on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parfocal_engine_free(engine: *mut parfocal_engine) {
    // SAFETY: the contract is the same.
    unsafe { free(engine) };
}
