//! What a user sees of a device.

use std::collections::HashSet;

/// What Vulkan calls a device that is none beside the processor.
const PROCESSOR: &str = "CPU";

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

impl DeviceInfo {
    /// Of these, those that work as one: the usable ones, each once though two drivers list it; those that are the processor, which reads and
    /// writes meanwhile, only where there is no other.
    pub fn every(devices: &[Self]) -> Vec<&Self> {
        let usable = || devices.iter().filter(|device| device.unusable.is_none());
        let mut seen = HashSet::new();
        let beside: Vec<&Self> =
            usable().filter(|device| device.kind != PROCESSOR && seen.insert(&device.uuid)).collect();
        if beside.is_empty() { usable().collect() } else { beside }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_devices_are_those_beside_the_processor_each_once() {
        let device = |index: usize, uuid: &str, kind, unusable: Option<&str>| DeviceInfo {
            index,
            uuid: uuid.to_string(),
            kind,
            unusable: unusable.map(str::to_string),
            ..DeviceInfo::default()
        };
        let every = |devices: &[DeviceInfo]| -> Vec<usize> {
            DeviceInfo::every(devices).into_iter().map(|device| device.index).collect()
        };
        let mut devices = vec![device(0, "l", PROCESSOR, None), device(1, "l", PROCESSOR, None)];
        assert_eq!(every(&devices), [0, 1]);
        devices.extend([
            device(2, "a", "discrete GPU", None),
            device(3, "a", "discrete GPU", None),
            device(4, "b", "discrete GPU", None),
            device(5, "c", "integrated GPU", Some("it lacks Vulkan 1.3")),
        ]);
        assert_eq!(every(&devices), [2, 4]);
    }
}
