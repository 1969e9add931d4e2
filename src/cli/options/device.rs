//! The options of the device.

use std::time::Duration;

use parfocal::{Engine, EngineOptions, Error, internals::baseline, settings::DeviceInfo};

use crate::cli::help::DEVICE;
use crate::cli::output::failure::Failure;

/// The environment variable with the default of --device.
const DEFAULT: &str = "PARFOCAL_DEVICE";

/// The value of --device for all devices.
const ALL: &str = "all";

/// The device and its limits.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct EngineArguments {
    /// Index, part of the name, or UUID [default: PARFOCAL_DEVICE, else the most capable]
    ///
    /// batch and watch also take all: each pair goes to the next free device. The processor is used only if there is no
    /// other device.
    #[arg(long, value_name = "D", help_heading = DEVICE)]
    device: Option<String>,
    /// Longest time of one solve on the device, s
    #[arg(long, value_name = "SECONDS", help_heading = DEVICE, default_value_t = EngineOptions::default().timeout.as_secs(),
          value_parser = clap::value_parser!(u64).range(1..))]
    timeout: u64,
    /// Device memory for a pair, MiB (64 to 16777216); larger pairs are solved in parts [default: all]
    #[arg(long, value_name = "MIB", help_heading = DEVICE, value_parser = clap::value_parser!(u64).range(64..=1 << 24))]
    memory: Option<u64>,
    /// Measure each pass, for the times in the report; slows the solve down
    #[arg(long, help_heading = DEVICE)]
    timings: bool,
}

impl EngineArguments {
    /// Opens the device.
    pub(crate) fn open(&self) -> Result<Engine, Failure> {
        let options = self.options();
        if is_all(&options) {
            return Err(Failure::Usage("--device all is for batch and watch: give one device".to_string()));
        }
        Engine::new(&options).map_err(|error| match error {
            Error::NoSuchDevice { .. } if self.device.is_none() => Failure::Failed(format!("{DEFAULT}: {error}")),
            other => other.into(),
        })
    }

    /// The options of each requested device.
    pub(crate) fn each(&self) -> Result<Vec<Self>, Failure> {
        if !is_all(&self.options()) {
            return Ok(vec![self.clone()]);
        }
        let devices = Engine::devices()?;
        let found = DeviceInfo::usable(&devices);
        // If there is no device, opening it returns the reason.
        let named = |index: usize| Self { device: Some(index.to_string()), ..self.clone() };
        Ok(if found.is_empty() { vec![named(0)] } else { found.iter().map(|device| named(device.index)).collect() })
    }

    /// The options of the library.
    pub(crate) fn options(&self) -> EngineOptions {
        EngineOptions {
            device: self.device.clone().or_else(|| std::env::var(DEFAULT).ok().filter(|device| !device.is_empty())),
            validation: crate::cli::is_validation_requested(),
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
