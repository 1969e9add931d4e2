//! The description of a Vulkan device.

use std::collections::HashSet;

/// The kind of a software device.
const CPU: &str = "CPU";

/// A Vulkan device as listed by [`Engine::devices`](crate::Engine::devices).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceInfo {
    /// The index in the loader's list, as for the option `--device`.
    pub index: usize,
    /// The device's name.
    pub name: String,
    /// Driver name and version.
    pub driver: String,
    /// The UUID in the form 8-4-4-4-12.
    pub uuid: String,
    /// "discrete GPU", "integrated GPU", "virtual GPU", "CPU" or "other".
    pub kind: &'static str,
    /// The Vulkan version, such as "1.3.230".
    pub api_version: String,
    /// Invocations per subgroup.
    pub subgroup_size: u32,
    /// Size of the largest device-local heap, bytes. For a software device, the system's available memory.
    pub memory_bytes: u64,
    /// The largest width and height of an image, px.
    pub max_image_size: u32,
    /// The largest size of a storage buffer binding, bytes.
    pub max_storage_buffer: u64,
    /// Why parfocal cannot use the device. `None` if it can.
    pub unusable: Option<String>,
}

impl DeviceInfo {
    /// Returns the devices to use together: the usable ones, each once even if two drivers list it. Software devices
    /// compete with the host for the processor, and are returned only if there are no others.
    pub fn usable(devices: &[Self]) -> Vec<&Self> {
        let all = || devices.iter().filter(|device| device.unusable.is_none());
        let mut uuids = HashSet::new();
        let hardware: Vec<&Self> = all().filter(|device| device.kind != CPU && uuids.insert(&device.uuid)).collect();
        if hardware.is_empty() { all().collect() } else { hardware }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hardware_devices_are_used_once_and_software_devices_only_without_them() {
        let device = |index: usize, uuid: &str, kind, unusable: Option<&str>| DeviceInfo {
            index,
            uuid: uuid.to_string(),
            kind,
            unusable: unusable.map(str::to_string),
            ..DeviceInfo::default()
        };
        let usable = |devices: &[DeviceInfo]| -> Vec<usize> {
            DeviceInfo::usable(devices).into_iter().map(|device| device.index).collect()
        };
        let mut devices = vec![device(0, "l", CPU, None), device(1, "l", CPU, None)];
        assert_eq!(usable(&devices), [0, 1]);
        devices.extend([
            device(2, "a", "discrete GPU", None),
            device(3, "a", "discrete GPU", None),
            device(4, "b", "discrete GPU", None),
            device(5, "c", "integrated GPU", Some("it lacks Vulkan 1.3")),
        ]);
        assert_eq!(usable(&devices), [2, 4]);
    }
}
