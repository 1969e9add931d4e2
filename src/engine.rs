//! A device, ready to work.

use std::time::Duration;

use crate::Error;

/// How an [`Engine`] is made.
#[derive(Clone, Debug)]
pub struct EngineOptions {
    /// Index, part of the name (case ignored), or UUID of the device; `None` takes the most capable.
    pub device: Option<String>,
    /// Turns core and synchronization validation on; needs the Khronos validation layer.
    pub validation: bool,
    /// The longest wait for one solve.
    pub timeout: Duration,
}

impl Default for EngineOptions {
    fn default() -> Self {
        Self { device: None, validation: false, timeout: Duration::from_secs(600) }
    }
}

/// What is known of a Vulkan device before it is used.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceInfo {
    /// Position in the loader's list; what `--device` takes.
    pub index: usize,
    /// The device's name.
    pub name: String,
    /// Driver name and version.
    pub driver: String,
    /// UUID in the usual 8-4-4-4-12 form.
    pub uuid: String,
    /// "discrete GPU", "integrated GPU", "virtual GPU", "CPU" or "other".
    pub kind: &'static str,
    /// Vulkan version, as "1.3.230".
    pub api_version: String,
    /// Invocations in a subgroup.
    pub subgroup_size: u32,
    /// Bytes of the largest device-local heap.
    pub memory_bytes: u64,
    /// Widest or tallest image, pixels.
    pub max_image_size: u32,
    /// Most bytes in one storage buffer binding.
    pub max_storage_buffer: u64,
    /// Why parfocal cannot use it, if it cannot.
    pub unusable: Option<String>,
}

/// A Vulkan device with its queue, memory and pipelines.
pub struct Engine {
    info: DeviceInfo,
}

impl Engine {
    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`], [`Error::NoSuchDevice`], [`Error::Vulkan`].
    pub fn new(_options: &EngineOptions) -> Result<Self, Error> {
        Err(Error::NoDevice(String::new()))
    }

    /// Lists the devices, usable or not.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::Vulkan`].
    pub fn devices() -> Result<Vec<DeviceInfo>, Error> {
        Ok(Vec::new())
    }

    /// The device in use.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }
}
