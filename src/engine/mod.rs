//! The engine: two photographs or a focus sweep to blur and registration, on a Vulkan device or on the processor.

pub(crate) mod arguments;
mod channels;
mod contrast;
mod cpu;
mod device;
mod effects;
pub(crate) mod filter;
mod frame_in_flight;
mod judgement;
#[cfg(feature = "program")]
pub mod model;
mod motion;
mod pair_memory;
pub(crate) mod parallax_start;
pub(crate) mod parts;
pub(crate) mod plan;
mod prepared_solver;
mod processing;
mod progress;
pub(crate) mod record;
#[cfg(any(test, debug_assertions, feature = "reference"))]
pub mod reference;
#[cfg(test)]
mod replay;
mod script;
mod shaders;
pub(crate) mod slot;
pub(crate) mod solution;
mod source;
pub mod stages;
mod sweep;
pub(crate) mod tiles;
#[allow(unsafe_code, reason = "the only room that calls Vulkan")]
pub(crate) mod vulkan;
mod vulkan_pair;
mod windows;

use std::sync::Arc;
use std::time::Duration;

/// Engines on a Vulkan device of the embedding program, photographs and results on it, and shared memory.
pub mod interop {
    pub use ash;

    pub use super::prepared_solver::Encoded;
    #[cfg(target_os = "linux")]
    pub use super::vulkan::external_memory::dma_buf::DmaBuf;
    pub use super::vulkan::{
        DeviceRequirements, DeviceSolution, DeviceSource, ExternalCommandBuffer, ExternalDevice, HostMemory,
        OPTIONAL_EXTENSIONS, QueueGuard, QueueLock, REQUIRED_VERSION, SemaphoreWait, SharedMemory, SharedQueue,
        SolutionBuffer, enable_required_features,
    };
}

pub use channels::ColorShift;
pub use motion::{OtherMotion, TransformDeviation};
pub use prepared_solver::{Encoded, Pending};
pub(crate) use prepared_solver::{PairOptions, PreparedSolver, same_size};
pub(crate) use script::CountedPixels;
pub use solution::{Findings, LevelHistory, Registered, Solution, SolutionRef, Timings};
pub use source::Source;
#[cfg(test)]
pub(crate) use stages::harness as testing;
pub(crate) use sweep::{JointRegistration, JointSolution, JointSolver, MAX_RELATIVE_BLUR, SweepInput};
pub use vulkan::available_memory;

use crate::base::{CPU, Decode, DeviceInfo, Error, Frame, Mask, PixelFormat, Settings, Similarity};
use crate::engine::device::{AnyDevice, CpuDevice};
use crate::engine::plan::Plan;
use crate::engine::record::Reading;
use crate::engine::vulkan::{Device, ExternalDevice, HostMemory, Instance, SharedMemory};

/// The options of an [`Engine`].
#[derive(Clone, Debug)]
pub struct EngineOptions {
    /// Index, part of the name (case ignored), or UUID of the device. "cpu" is the processor, "vulkan" the most capable
    /// Vulkan device. `None`: the most capable GPU, or the processor if there is none; with validation as "vulkan".
    pub device: Option<String>,
    /// Whether to turn on core and synchronization validation. Needs the Khronos validation layer.
    pub validation: bool,
    /// The time limit of one solve. Past it the solve fails with [`Error::Timeout`], and a Vulkan engine is poisoned.
    /// The processor checks the limit between passes. A focus sweep has one limit for all of its work; a pair that is
    /// solved in parts has one for each part.
    pub timeout: Duration,
    /// Bytes of the device that a pair or a sweep may use; `None`: all that it has, 4 GiB for a sweep.
    /// [`PairSolver::solve`](crate::PairSolver::solve) and sweeps solve larger photographs in parts.
    pub memory: Option<u64>,
    /// Finds the start of T for [`Method::Sift`](crate::settings::Method::Sift), and a second one for frames whose
    /// registration is in doubt. `None`: that method is refused, and there is no second start.
    pub key_points: Option<KeyPoints>,
    /// Whether solves read the device's clock between passes, for [`Timings::passes_ms`]. Reading takes time itself.
    pub timed: bool,
}

/// Finds T by key-points of I2 and of the unmasked pixels of I1.
pub type KeyPoints = fn([&Frame; 2], Decode, Option<&Mask>) -> Result<Similarity, Error>;

impl Default for EngineOptions {
    fn default() -> Self {
        Self {
            device: None,
            validation: false,
            timeout: Duration::from_secs(600),
            memory: None,
            key_points: None,
            timed: false,
        }
    }
}

/// A device with its memory and compiled passes. Clones share them.
#[derive(Clone)]
pub struct Engine(Arc<Inner>);

struct Inner {
    device: AnyDevice,
    memory: u64,
    key_points: Option<KeyPoints>,
    timed: bool,
}

impl Engine {
    /// Opens a device: the named one, else the most capable GPU, else the processor.
    ///
    /// # Errors
    /// [`Error::NoLoader`] or [`Error::NoDevice`] if a Vulkan device is named or must validate;
    /// [`Error::NoSuchDevice`], [`Error::Vulkan`].
    pub fn new(options: &EngineOptions) -> Result<Self, Error> {
        let device = if options.device.as_deref().is_some_and(CpuDevice::has_name) {
            AnyDevice::Cpu(Arc::new(CpuDevice::new(usize::MAX, options.timeout)))
        } else {
            open(options)?
        };
        Ok(Self::on(device, options))
    }

    /// Uses a device of the embedding program, which keeps and destroys it. Ignores the options `device` and
    /// `validation`.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if the device lacks what the passes need, or its queue does not compute; [`Error::Vulkan`].
    pub fn from_vulkan(device: ExternalDevice, options: &EngineOptions) -> Result<Self, Error> {
        Ok(Self::on(AnyDevice::vulkan(Device::external(device, options.timeout)?), options))
    }

    fn on(device: AnyDevice, options: &EngineOptions) -> Self {
        let memory = options.memory.unwrap_or(u64::MAX);
        Self(Arc::new(Inner { device, memory, key_points: options.key_points, timed: options.timed }))
    }

    /// Lists all devices, the processor last. [`DeviceInfo::unusable`] says why one cannot be used.
    ///
    /// # Errors
    /// [`Error::Vulkan`].
    pub fn devices() -> Result<Vec<DeviceInfo>, Error> {
        let mut devices: Vec<_> = match Instance::new(false).and_then(|instance| instance.physical_devices()) {
            Ok(devices) => devices.into_iter().map(|device| device.info).collect(),
            Err(Error::NoLoader(_) | Error::NoDevice(_)) => Vec::new(),
            Err(other) => return Err(other),
        };
        devices.push(CpuDevice::describe(devices.len()));
        Ok(devices)
    }

    /// Describes the device in use.
    pub fn info(&self) -> &DeviceInfo {
        self.0.device.info()
    }

    /// Checks whether a device like this one can hold a pair, for example before photographs are decoded.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`].
    pub fn check_size(
        device: &DeviceInfo,
        [width, height]: [u32; 2],
        formats: [impl Into<PixelFormat>; 2],
        settings: &Settings,
    ) -> Result<(), Error> {
        Plan::new(width, height, formats, settings)?.for_device(device).check_described(device)
    }

    /// Shares memory of the embedding program, a camera's ring buffer for example, with the device, for
    /// [`Source::Shared`]. The device reads it by VK_EXT_external_memory_host; without that the host copies.
    pub fn share(&self, memory: HostMemory) -> Arc<SharedMemory> {
        SharedMemory::new(self.0.device.as_vulkan(), memory)
    }

    /// Shares a dma-buf, of a capture card for example, by VK_EXT_external_memory_dma_buf; without that the host
    /// copies.
    ///
    /// # Errors
    /// [`Error::Mismatch`] if it is shorter than stated, or can be neither imported nor read.
    #[cfg(target_os = "linux")]
    pub fn share_dma_buf(&self, memory: vulkan::external_memory::dma_buf::DmaBuf) -> Result<Arc<SharedMemory>, Error> {
        vulkan::external_memory::dma_buf::share(self.0.device.as_vulkan(), memory)
    }

    /// The messages of the validation layer so far; empty without [`EngineOptions::validation`].
    pub fn validation_messages(&self) -> Vec<String> {
        self.0.device.as_vulkan().map_or_else(Vec::new, |device| device.instance.messages())
    }

    /// Checks that the device, and the memory that a pair may use, hold a plan with a number of frames in flight.
    pub(crate) fn admits(&self, plan: &Plan, frames_in_flight: u64) -> Result<(), Error> {
        plan.check(&self.0.device, self.0.memory, frames_in_flight)
    }

    /// Bytes of the device that a pair may use.
    pub(crate) fn memory(&self) -> u64 {
        self.0.memory.min(self.info().memory_bytes)
    }

    /// The time limit of one solve.
    pub(crate) fn timeout(&self) -> Duration {
        self.0.device.timeout()
    }

    pub(crate) fn key_points(&self) -> Option<KeyPoints> {
        self.0.key_points
    }

    /// When solves read the device's clock.
    pub(crate) fn reading(&self) -> Reading {
        if self.0.timed { Reading::Passes } else { Reading::Never }
    }

    pub(crate) fn device(&self) -> &AnyDevice {
        &self.0.device
    }

    /// The Vulkan device of an engine that has one.
    #[cfg(test)]
    pub(crate) fn vulkan(&self) -> &Arc<Device> {
        self.0.device.as_vulkan().expect("a Vulkan device")
    }
}

impl Drop for Inner {
    /// Saves the compiled pipelines for the next engine.
    fn drop(&mut self) {
        if let Some(device) = self.device.as_vulkan().filter(|device| !device.is_poisoned()) {
            device.save_pipeline_cache();
        }
    }
}

/// The name of the most capable Vulkan device.
const VULKAN: &str = "vulkan";

/// Opens the device that the options name; without a name a GPU, or the processor if there is none and nothing must
/// validate.
pub(crate) fn open(options: &EngineOptions) -> Result<AnyDevice, Error> {
    let cpu = |index| Ok(AnyDevice::Cpu(Arc::new(CpuDevice::new(index, options.timeout))));
    let may_be_cpu = options.device.is_none() && !options.validation;
    let listed = Instance::new(options.validation).and_then(|instance| {
        let devices = instance.physical_devices()?;
        Ok((instance, devices))
    });
    // Without Vulkan the list of devices begins with the processor.
    let is_first = options.device.as_deref() == Some("0") && !options.validation;
    let (instance, mut devices) = match listed {
        Err(_) if may_be_cpu => return cpu(0),
        Err(Error::NoLoader(_) | Error::NoDevice(_)) if is_first => return cpu(0),
        listed => listed?,
    };
    let infos: Vec<DeviceInfo> = devices.iter().map(|d| d.info.clone()).collect();
    let wanted = options.device.as_deref().filter(|name| !name.eq_ignore_ascii_case(VULKAN));
    if wanted.is_some_and(|name| name == infos.len().to_string()) {
        return cpu(infos.len());
    }
    let chosen = match choose(&infos, wanted) {
        Ok(chosen) if may_be_cpu && infos[chosen].kind == CPU => return cpu(infos.len()),
        Err(_) if may_be_cpu => return cpu(infos.len()),
        chosen => chosen?,
    };
    Device::new(instance, devices.swap_remove(chosen), options.timeout).map(AnyDevice::vulkan)
}

/// The position of the named device, or of the most capable one.
fn choose(devices: &[DeviceInfo], wanted: Option<&str>) -> Result<usize, Error> {
    let Some(wanted) = wanted else {
        let rank = |kind: &str| {
            [CPU, "other", "virtual GPU", "integrated GPU", "discrete GPU"].iter().position(|k| *k == kind)
        };
        let usable = (0..devices.len()).rev().filter(|&i| devices[i].unusable.is_none());
        return usable
            .max_by_key(|&i| (rank(devices[i].kind), devices[i].memory_bytes))
            .ok_or_else(|| Error::NoDevice(reasons(devices)));
    };
    let matches = |d: &DeviceInfo| {
        d.index.to_string() == wanted
            || d.uuid.eq_ignore_ascii_case(wanted)
            || (wanted.parse::<usize>().is_err() && d.name.to_lowercase().contains(&wanted.to_lowercase()))
    };
    let position = devices.iter().position(matches).ok_or_else(|| Error::NoSuchDevice {
        wanted: wanted.into(),
        available: devices.iter().map(|d| format!("{} {}, ", d.index, d.name)).collect::<String>() + CpuDevice::NAME,
    })?;
    match &devices[position].unusable {
        None => Ok(position),
        Some(_) => Err(Error::NoDevice(reasons(&devices[position..=position]))),
    }
}

fn reasons(devices: &[DeviceInfo]) -> String {
    let reasons: Vec<String> =
        devices.iter().filter_map(|d| d.unusable.as_ref().map(|why| format!("{}: {why}", d.name))).collect();
    if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join("; ")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::{PairSolver, SolveOptions};

    fn device(index: usize, name: &str, kind: &'static str) -> DeviceInfo {
        DeviceInfo {
            index,
            name: name.into(),
            driver: String::new(),
            uuid: format!("0000000{index}-0000-0000-0000-000000000000"),
            kind,
            api_version: "1.3.0".into(),
            subgroup_size: 8,
            memory_bytes: 0,
            max_image_size: 0,
            max_storage_buffer: 0,
            unusable: None,
        }
    }

    #[test]
    fn devices_are_chosen_by_index_name_uuid_or_rank() {
        let mut devices = [
            device(0, "llvmpipe", "CPU"),
            device(1, "GeForce A", "discrete GPU"),
            device(2, "GeForce B", "discrete GPU"),
        ];
        assert_eq!(choose(&devices, None).unwrap(), 1);
        devices[2].memory_bytes = 1;
        assert_eq!(choose(&devices, None).unwrap(), 2, "the one with more memory");
        devices[2].memory_bytes = 0;
        assert_eq!(choose(&devices, Some("2")).unwrap(), 2);
        assert_eq!(choose(&devices, Some("LLVM")).unwrap(), 0);
        assert_eq!(choose(&devices, Some("00000002-0000-0000-0000-000000000000")).unwrap(), 2);
        assert!(matches!(choose(&devices, Some("7")), Err(Error::NoSuchDevice { .. })));
        devices[1].unusable = Some("it lacks Vulkan 1.3".into());
        assert_eq!(choose(&devices, None).unwrap(), 2);
        assert!(matches!(choose(&devices, Some("1")), Err(Error::NoDevice(_))));
        assert!(matches!(choose(&[], None), Err(Error::NoDevice(_))));
    }

    #[test]
    fn the_processor_opens_by_name_uuid_and_index() {
        let listed = Engine::devices().unwrap();
        let cpu = listed.last().unwrap();
        for name in ["cpu", "CPU", &cpu.uuid, &cpu.index.to_string()] {
            let engine = Engine::new(&EngineOptions { device: Some(name.into()), ..EngineOptions::default() }).unwrap();
            assert_eq!(engine.info().name, "cpu", "{name}");
        }
        let vulkan = Engine::new(&EngineOptions { device: Some("Vulkan".into()), ..EngineOptions::default() }).unwrap();
        assert_ne!(vulkan.info().name, "cpu");
    }

    #[test]
    fn memory_of_a_timed_out_solve_is_freed() {
        let engine = Engine::new(&EngineOptions { timeout: Duration::from_nanos(1), ..testing::options() }).unwrap();
        let instance = Arc::downgrade(&engine.vulkan().instance);
        let [i1, i2] = testing::pair([160; 2]);
        let solved = PairSolver::for_frames(&engine, [&i1, &i2], &Settings::default())
            .and_then(|mut s| s.solve([&i1, &i2], &SolveOptions::default()));
        assert!(matches!(solved, Err(Error::Timeout { .. })), "{:?}", solved.map(|s| s.findings.timings));
        assert!(engine.vulkan().is_poisoned());
        drop(engine);
        assert!(instance.upgrade().is_none(), "nothing keeps the instance alive");
    }

    /// The number of pipelines compiled so far.
    fn pipelines(engine: &Engine) -> usize {
        match engine.device() {
            AnyDevice::Vulkan(_, pipelines) => pipelines.count(),
            AnyDevice::Cpu(_) => 0,
        }
    }

    #[test]
    fn passes_are_compiled_once_and_only_if_needed() {
        // A pair without and one with clipped pixels.
        let clip = |frame: Frame, highest: f32| {
            let values = frame.intensities(Decode::None);
            let clipped = values.into_iter().map(|v| if v < highest { v } else { 1.0 }).collect();
            Frame::gray(64, 64, clipped).unwrap()
        };
        let pairs = [2.0, 0.75].map(|highest| testing::pair([64; 2]).map(|frame| clip(frame, highest)));
        let counts = pairs.each_ref().map(|[i1, i2]| {
            let engine = Engine::new(&testing::options()).unwrap();
            let mut solver = PairSolver::for_frames(&engine, [i1, i2], &Settings::default()).unwrap();
            let prepared = pipelines(&engine);
            solver.solve([i1, i2], &SolveOptions::default()).unwrap();
            assert_eq!(pipelines(&engine), prepared, "a pair like the one prepared for");
            prepared
        });
        let engine = Engine::new(&testing::options()).unwrap();
        let formats = [pairs[0][0].format(); 2];
        let mut solver = PairSolver::for_size(&engine, [64, 64], formats, 1, &Settings::default()).unwrap();
        let prepared = pipelines(&engine);
        assert!(counts.iter().all(|&one| one < prepared), "{counts:?} of {prepared}");
        for [i1, i2] in &pairs {
            solver.solve([i1, i2], &SolveOptions::default()).unwrap();
        }
        assert_eq!(pipelines(&engine), prepared, "prepared for any pair");
    }
}
