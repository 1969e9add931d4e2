//! `parfocal devices`: lists the Vulkan devices.

use parfocal::{Engine, Error, settings::DeviceInfo};
use serde::Serialize;

use crate::cli::output::failure::{Failure, print};

/// List the Vulkan devices and the reasons why some cannot be used
#[derive(clap::Args, Debug)]
pub(crate) struct Arguments {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

/// A device as the JSON list states it.
#[derive(Serialize)]
struct Entry<'a> {
    index: usize,
    name: &'a str,
    driver: &'a str,
    uuid: &'a str,
    kind: &'a str,
    vulkan: &'a str,
    subgroup_size: u32,
    memory_bytes: u64,
    max_image_size: u32,
    max_storage_buffer_bytes: u64,
    usable: bool,
    why_not: Option<&'a str>,
}

impl<'a> From<&'a DeviceInfo> for Entry<'a> {
    fn from(info: &'a DeviceInfo) -> Self {
        Self {
            index: info.index,
            name: &info.name,
            driver: &info.driver,
            uuid: &info.uuid,
            kind: info.kind,
            vulkan: &info.api_version,
            subgroup_size: info.subgroup_size,
            memory_bytes: info.memory_bytes,
            max_image_size: info.max_image_size,
            max_storage_buffer_bytes: info.max_storage_buffer,
            usable: info.unusable.is_none(),
            why_not: info.unusable.as_deref(),
        }
    }
}

/// Prints the devices. Without a device, prints an empty JSON list and fails.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let devices = match Engine::devices() {
        Ok(devices) if !devices.is_empty() => devices,
        none => {
            if arguments.json {
                print("[]")?;
            }
            return Err(none.err().unwrap_or_else(|| Error::NoDevice(String::new())).into());
        }
    };
    if arguments.json {
        let entries: Vec<_> = devices.iter().map(Entry::from).collect();
        let text = serde_json::to_string_pretty(&entries).map_err(|e| Failure::Failed(e.to_string()))?;
        return print(&text);
    }
    print(&devices.iter().map(describe).collect::<Vec<_>>().join("\n"))
}

fn describe(info: &DeviceInfo) -> String {
    let usable = match &info.unusable {
        None => "usable".to_string(),
        Some(why) => format!("not usable: {why}"),
    };
    let gibibytes = info.memory_bytes as f64 / f64::from(1 << 30);
    [
        format!("{}  {} ({})", info.index, info.name, info.kind),
        format!("driver {}, Vulkan {}, UUID {}", info.driver, info.api_version, info.uuid),
        format!(
            "{gibibytes:.1} GiB, subgroups of {}, images up to {} px a side",
            info.subgroup_size, info.max_image_size
        ),
        usable,
    ]
    .join("\n   ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device() -> DeviceInfo {
        DeviceInfo {
            index: 1,
            name: "a device".to_string(),
            driver: "a driver 1.2".to_string(),
            uuid: "00000000-0000-0000-0000-000000000001".to_string(),
            kind: "CPU",
            api_version: "1.3.230".to_string(),
            subgroup_size: 8,
            memory_bytes: 3 << 29,
            max_image_size: 16384,
            max_storage_buffer: 1 << 27,
            unusable: Some("no timestamps".to_string()),
        }
    }

    #[test]
    fn the_description_of_a_device_states_missing_features() {
        let text = describe(&device());
        for part in ["1  a device (CPU)", "a driver 1.2", "1.3.230", "1.5 GiB", "16384", "not usable: no timestamps"] {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
    }

    #[test]
    fn json_states_whether_a_device_is_usable() {
        let json = serde_json::to_value(Entry::from(&device())).unwrap();
        assert_eq!((&json["usable"], &json["why_not"]), (&false.into(), &"no timestamps".into()));
        assert_eq!(json["vulkan"], "1.3.230");
    }
}
