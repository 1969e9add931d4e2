//! The module `parfocal._native`: plain arrays and dictionaries. Users see the package around it, `python/parfocal`.

mod convert;
mod engine;
mod files;
mod inspection;
mod measure;
mod settings;
mod stream;
mod watch;

use pyo3::prelude::*;

use engine::Engine;

pyo3::create_exception!(
    parfocal,
    DeviceError,
    pyo3::exceptions::PyRuntimeError,
    "No device is usable, or the device failed or exceeded the time limit."
);

pyo3::create_exception!(parfocal, Cancelled, pyo3::exceptions::PyRuntimeError, "The call was cancelled.");

/// Converts an error to an exception: DeviceError, Cancelled, or ValueError for invalid arguments.
fn exception(error: parfocal::Error) -> PyErr {
    use parfocal::Error;
    match error {
        Error::NoLoader(_)
        | Error::NoDevice(_)
        | Error::NoSuchDevice { .. }
        | Error::Vulkan { .. }
        | Error::Timeout { .. }
        | Error::Poisoned => DeviceError::new_err(error.to_string()),
        Error::Cancelled => Cancelled::new_err(error.to_string()),
        _ => pyo3::exceptions::PyValueError::new_err(error.to_string()),
    }
}

/// The private module of the package.
#[pymodule]
mod _native {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::{
        Cancelled, DeviceError, Engine,
        engine::{apply, check_lens, depth, devices},
        files::{format_name, read, unpack},
        inspection::{evidence, inspect, teach},
        measure::{gauge, level, profile, readings, repeated, step, texture},
        settings::setting_table,
        stream::Stream,
        watch::CancellationToken,
    };

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
