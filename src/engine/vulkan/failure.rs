//! A Vulkan call that failed, in words.

use ash::vk;

use crate::base::Error;

/// A failed Vulkan call, with advice where there is some.
pub(super) fn failure(call: &str, device: &str, result: vk::Result) -> Error {
    let advice = match result {
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            "; use smaller images, or free memory on the device"
        }
        vk::Result::ERROR_DEVICE_LOST => "; make a new Engine, and see whether the driver is up to date",
        _ => "",
    };
    Error::Vulkan { call: call.into(), device: device.into(), result: format!("{result:?}"), advice }
}
