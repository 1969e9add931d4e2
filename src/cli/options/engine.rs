//! The device that a subcommand runs on, or, of a batch, all of them.

use std::time::Duration;

use parfocal::{DeviceInfo, Engine, EngineOptions, Error, baseline};

use crate::cli::options::headings::DEVICE;
use crate::cli::output::failure::Failure;

/// Environment variable with the device where --device states none.
const DEFAULT: &str = "PARFOCAL_DEVICE";

/// What stands for every device.
const ALL: &str = "all";

/// Which device, and for how long it is waited.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct EngineArguments {
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

    /// The same of every device that is asked for, one each.
    pub(crate) fn each(&self) -> Result<Vec<Self>, Failure> {
        if !is_all(&self.options()) {
            return Ok(vec![self.clone()]);
        }
        let devices = Engine::devices()?;
        let found = DeviceInfo::usable(&devices);
        // Without any, the error says why.
        let named = |index: usize| Self { device: Some(index.to_string()), ..self.clone() };
        Ok(if found.is_empty() { vec![named(0)] } else { found.iter().map(|device| named(device.index)).collect() })
    }

    /// How it is opened.
    pub(crate) fn options(&self) -> EngineOptions {
        EngineOptions {
            device: self.device.clone().or_else(|| std::env::var(DEFAULT).ok().filter(|device| !device.is_empty())),
            validation: crate::cli::validation_asked(),
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
