//! The device that a subcommand runs on, or, of a batch, all of them.

use std::collections::HashSet;
use std::time::Duration;

use parfocal::{DeviceInfo, Engine, EngineOptions, Error, baseline};

use super::failure::Failure;
use super::headings::DEVICE;

/// Environment variable with the device where --device states none.
const DEFAULT: &str = "PARFOCAL_DEVICE";

/// What stands for every device.
const ALL: &str = "all";

/// What Vulkan calls a device that is none beside the processor.
const PROCESSOR: &str = "CPU";

/// Which device, and for how long it is waited.
#[derive(clap::Args, Clone, Debug, Default)]
pub(super) struct EngineArguments {
    /// Index, part of the name, or UUID [default: PARFOCAL_DEVICE, else the most capable]
    ///
    /// batch and watch take all as well: each pair goes to whichever device is free; the processor counts only where there
    /// is no other.
    #[arg(long, value_name = "D", help_heading = DEVICE)]
    device: Option<String>,
    /// Longest wait for the device in one solve, seconds
    #[arg(long, value_name = "SECONDS", help_heading = DEVICE, default_value_t = EngineOptions::default().timeout.as_secs(),
          value_parser = clap::value_parser!(u64).range(1..))]
    timeout: u64,
    /// Device memory that a pair may take, MiB; larger ones are solved in parts. What the device has without it
    #[arg(long, value_name = "MIB", help_heading = DEVICE, value_parser = clap::value_parser!(u64).range(64..=1 << 24))]
    memory: Option<u64>,
    /// Read the device's clock from pass to pass, for the times in the report; that takes time itself
    #[arg(long, help_heading = DEVICE)]
    timings: bool,
}

impl EngineArguments {
    /// Opens it, under validation where the environment asks for that.
    pub(super) fn open(&self) -> Result<Engine, Failure> {
        let options = self.options();
        if is_all(&options) {
            return Err(Failure::Usage("--device all is for batch and watch: give one device".to_string()));
        }
        Engine::new(&options).map_err(|error| match error {
            Error::NoSuchDevice { .. } if self.device.is_none() => Failure::Failed(format!("{DEFAULT}: {error}")),
            other => other.into(),
        })
    }

    /// The same of every device that is asked for, one each.
    pub(super) fn each(&self) -> Result<Vec<Self>, Failure> {
        if !is_all(&self.options()) {
            return Ok(vec![self.clone()]);
        }
        let found = every(&Engine::devices()?);
        // Without any, the error says why.
        let named = |device: String| Self { device: Some(device), ..self.clone() };
        Ok(if found.is_empty() { vec![named("0".to_string())] } else { found.into_iter().map(named).collect() })
    }

    /// How it is opened.
    pub(super) fn options(&self) -> EngineOptions {
        EngineOptions {
            device: self.device.clone().or_else(|| std::env::var(DEFAULT).ok().filter(|device| !device.is_empty())),
            validation: super::validation_asked(),
            timeout: Duration::from_secs(self.timeout),
            memory: self.memory.map(|mib| mib << 20),
            key_points: Some(baseline::key_points),
            timed: self.timings,
        }
    }
}

fn is_all(options: &EngineOptions) -> bool {
    options.device.as_deref() == Some(ALL)
}

/// Indices of the devices that work as one: the usable ones, each once though two drivers list it; those that are the
/// processor, which reads and writes meanwhile, only where there is no other.
fn every(devices: &[DeviceInfo]) -> Vec<String> {
    let usable = || devices.iter().filter(|device| device.unusable.is_none());
    let mut seen = HashSet::new();
    let beside: Vec<&DeviceInfo> =
        usable().filter(|device| device.kind != PROCESSOR && seen.insert(&device.uuid)).collect();
    let all = if beside.is_empty() { usable().collect() } else { beside };
    all.into_iter().map(|device| device.index.to_string()).collect()
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
        let mut devices = vec![device(0, "l", PROCESSOR, None), device(1, "l", PROCESSOR, None)];
        assert_eq!(every(&devices), ["0", "1"]);
        devices.extend([
            device(2, "a", "discrete GPU", None),
            device(3, "a", "discrete GPU", None),
            device(4, "b", "discrete GPU", None),
            device(5, "c", "integrated GPU", Some("it lacks Vulkan 1.3")),
        ]);
        assert_eq!(every(&devices), ["2", "4"]);
    }
}
