//! The description of a device.

use std::collections::HashSet;

/// The kind of a software device.
pub(crate) const CPU: &str = "CPU";
/// The name of the processor as a device.
pub(crate) const CPU_DEVICE: &str = "cpu";

/// A device as listed by [`Engine::devices`](crate::Engine::devices).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceInfo {
    /// The index in the list, as for the option `--device`. `usize::MAX` of the processor opened by its name.
    pub index: usize,
    /// The device's name.
    pub name: String,
    /// Driver name and version.
    pub driver: String,
    /// The UUID in the form 8-4-4-4-12.
    pub uuid: String,
    /// "discrete GPU", "integrated GPU", "virtual GPU", "CPU" or "other".
    pub kind: &'static str,
    /// The Vulkan version, such as "1.3.230"; empty for the processor.
    pub api_version: String,
    /// Invocations per subgroup.
    pub subgroup_size: u32,
    /// What other programs leave of the largest device-local heap, bytes; its size if the driver does not say. For a
    /// software device, the system's available memory.
    pub memory_bytes: u64,
    /// The largest width and height of an image, px.
    pub max_image_size: u32,
    /// The largest size of a storage buffer binding, bytes.
    pub max_storage_buffer: u64,
    /// Why parfocal cannot use the device. `None` if it can.
    pub unusable: Option<String>,
}

impl DeviceInfo {
    /// Whether it is the processor, by a software driver or without one.
    pub(crate) fn is_processor(&self) -> bool {
        self.kind == CPU
    }

    /// Returns the devices to use together: the usable GPUs, each once even if two drivers list it. Without a GPU, the
    /// processor alone, with which software drivers would compete; if solves must be validated, these.
    pub fn usable(devices: &[Self], must_validate: bool) -> Vec<&Self> {
        let can_validate = |device: &&Self| !must_validate || device.name != CPU_DEVICE;
        let all = || devices.iter().filter(|device| device.unusable.is_none()).filter(can_validate);
        let mut uuids = HashSet::new();
        let hardware: Vec<&Self> = all().filter(|device| device.kind != CPU && uuids.insert(&device.uuid)).collect();
        match all().find(|device| device.name == CPU_DEVICE) {
            _ if !hardware.is_empty() => hardware,
            Some(processor) => vec![processor],
            None => all().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gpus_are_used_once_and_the_processor_only_without_them() {
        let device = |index: usize, uuid: &str, kind, unusable: Option<&str>| DeviceInfo {
            index,
            uuid: uuid.to_string(),
            kind,
            unusable: unusable.map(str::to_string),
            ..DeviceInfo::default()
        };
        let usable = |devices: &[DeviceInfo]| -> Vec<usize> {
            DeviceInfo::usable(devices, false).into_iter().map(|device| device.index).collect()
        };
        let mut devices = vec![device(0, "l", CPU, None), device(1, "l", CPU, None)];
        assert_eq!(usable(&devices), [0, 1]);
        devices[1].name = CPU_DEVICE.to_string();
        assert_eq!(usable(&devices), [1]);
        assert_eq!(DeviceInfo::usable(&devices, true), [&devices[0]]);
        devices.extend([
            device(2, "a", "discrete GPU", None),
            device(3, "a", "discrete GPU", None),
            device(4, "b", "discrete GPU", None),
            device(5, "c", "integrated GPU", Some("it lacks Vulkan 1.3")),
        ]);
        assert_eq!(usable(&devices), [2, 4]);
    }
}
