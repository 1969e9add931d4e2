//! For tests: the device that they run on.

use crate::engine::EngineOptions;

/// The device named by PARFOCAL_DEVICE, or the default one, under validation unless PARFOCAL_VALIDATE is 0. A missing
/// device or layer fails the test.
pub(crate) fn options() -> EngineOptions {
    EngineOptions {
        device: std::env::var("PARFOCAL_DEVICE").ok(),
        validation: std::env::var("PARFOCAL_VALIDATE").as_deref() != Ok("0"),
        ..EngineOptions::default()
    }
}
