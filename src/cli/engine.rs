//! The device that a subcommand runs on.

use std::time::Duration;

use parfocal::{Engine, EngineOptions, Error, baseline};

use super::failure::Failure;
use super::headings::DEVICE;

/// Environment variable with the device where --device states none.
const DEFAULT: &str = "PARFOCAL_DEVICE";

/// Which device, and for how long it is waited.
#[derive(clap::Args, Clone, Debug, Default)]
pub(super) struct EngineArguments {
    /// Index, part of the name, or UUID [default: PARFOCAL_DEVICE, else the most capable]
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
        Engine::new(&self.options()).map_err(|error| match error {
            Error::NoSuchDevice { .. } if self.device.is_none() => Failure::Failed(format!("{DEFAULT}: {error}")),
            other => other.into(),
        })
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
