//! What a user sees of a device.

/// What is known of a Vulkan device before it is used.
#[derive(Clone, Debug, Default, PartialEq)]
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
    /// Bytes of the largest device-local heap; of a device of software, what the system can give.
    pub memory_bytes: u64,
    /// Widest or tallest image, pixels.
    pub max_image_size: u32,
    /// Most bytes in one storage buffer binding.
    pub max_storage_buffer: u64,
    /// Why parfocal cannot use it, if it cannot.
    pub unusable: Option<String>,
}
