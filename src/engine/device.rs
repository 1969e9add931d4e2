//! The device that an engine runs passes on.

use std::sync::Arc;
use std::time::Duration;

use super::stages::Pipelines;
use super::vulkan::{Device, available_memory};
use crate::base::{CPU, CPU_DEVICE, DeviceInfo};

/// Where passes run.
#[derive(Clone)]
pub(crate) enum AnyDevice {
    Vulkan(Arc<Device>, Arc<Pipelines>),
    Cpu(Arc<CpuDevice>),
}

impl AnyDevice {
    pub(crate) fn vulkan(device: Arc<Device>) -> Self {
        let pipelines = Arc::new(Pipelines::new(&device));
        Self::Vulkan(device, pipelines)
    }

    pub(crate) fn info(&self) -> &DeviceInfo {
        match self {
            Self::Vulkan(device, _) => device.info(),
            Self::Cpu(device) => &device.info,
        }
    }

    pub(crate) fn timeout(&self) -> Duration {
        match self {
            Self::Vulkan(device, _) => device.timeout(),
            Self::Cpu(device) => device.timeout,
        }
    }

    /// The Vulkan device, if it is one.
    pub(crate) fn as_vulkan(&self) -> Option<&Arc<Device>> {
        match self {
            Self::Vulkan(device, _) => Some(device),
            Self::Cpu(_) => None,
        }
    }
}

/// The processor as a device.
pub(crate) struct CpuDevice {
    pub(crate) info: DeviceInfo,
    /// The time limit of one solve.
    pub(crate) timeout: Duration,
}

impl CpuDevice {
    /// The name of the device, for `--device`.
    pub(crate) const NAME: &str = CPU_DEVICE;
    const UUID: &str = "00000000-0000-0000-0000-000000000001";

    pub(crate) fn new(index: usize, timeout: Duration) -> Self {
        Self { info: Self::describe(index), timeout }
    }

    /// Whether a name or UUID is that of the processor.
    pub(crate) fn has_name(name: &str) -> bool {
        [Self::NAME, Self::UUID].iter().any(|own| own.eq_ignore_ascii_case(name))
    }

    /// Describes the device. `index` is the number of devices before it.
    pub(crate) fn describe(index: usize) -> DeviceInfo {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        DeviceInfo {
            index,
            name: Self::NAME.into(),
            driver: format!("parfocal {}, {threads} threads", env!("CARGO_PKG_VERSION")),
            uuid: Self::UUID.into(),
            kind: CPU,
            api_version: String::new(),
            subgroup_size: 1,
            // The rest is for results and their page.
            memory_bytes: available_memory().map_or(u64::MAX, |bytes| bytes / 4 * 3),
            max_image_size: 1 << 16,
            max_storage_buffer: u64::MAX,
            unusable: None,
        }
    }
}
