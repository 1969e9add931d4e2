//! Two photographs to relative blur and registration, on a Vulkan device: the engine that other programs embed.

pub(crate) mod arguments;
mod cancel_flag;
#[cfg(test)]
mod faults;
pub(crate) mod filter;
mod frame_in_flight;
pub(crate) mod large;
mod motion;
mod parts;
pub(crate) mod plan;
pub(crate) mod profile;
mod progress;
mod record;
pub mod reference;
mod registered;
mod script;
mod shaders;
pub(crate) mod slot;
pub(crate) mod solution;
mod solution_ref;
mod solver;
mod source;
pub mod stages;
mod submissions;
mod sweep;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod tiles;
#[allow(unsafe_code, reason = "the one room that talks to Vulkan")]
pub(crate) mod vulkan;
mod workspace;

use std::sync::Arc;
use std::time::Duration;

/// An engine on a Vulkan device that belongs to the embedding program: [`Engine::from_vulkan`].
pub mod interop {
    pub use ash;

    pub use super::vulkan::{
        DeviceRequirements, DeviceSolution, DeviceSource, ExternalCommandBuffer, ExternalDevice, OPTIONAL_EXTENSIONS,
        QueueGuard, QueueLock, REQUIRED_VERSION, SemaphoreWait, SharedQueue, enable_required_features,
    };
}

pub use motion::OtherMotion;
pub use progress::Progress;
pub use registered::Registered;
pub use solution::{Findings, LevelHistory, Solution, Timings};
pub use solution_ref::SolutionRef;
pub use solver::PairSolver;
pub(crate) use solver::same_size;
pub use source::Source;
pub use submissions::Ticket;
pub(crate) use sweep::{JointRegistration, JointSolution, JointSolver, SweepInput};
#[cfg(target_os = "linux")]
pub use vulkan::external_memory::dma_buf::DmaBuf;
pub use vulkan::{HostMemory, SharedMemory};

use crate::base::{Decode, DeviceInfo, Error, Frame, Mask, PixelFormat, Settings, Similarity};
use crate::engine::plan::Plan;
use crate::engine::stages::Pipelines;
use crate::engine::vulkan::{Device, ExternalDevice, Instance};

/// How an [`Engine`] is made.
#[derive(Clone, Debug)]
pub struct EngineOptions {
    /// Index, part of the name (case ignored), or UUID of the device; `None` takes the most capable.
    pub device: Option<String>,
    /// SharedQueue core and synchronization validation on; needs the Khronos validation layer.
    pub validation: bool,
    /// The longest wait for one solve.
    pub timeout: Duration,
    /// Bytes of the device that a pair may take; `None`: what the device has. Larger photographs are solved in parts by a
    /// [`SolveOptions`](crate::SolveOptions), and refused by a [`PairSolver`].
    pub memory: Option<u64>,
    /// How [`Method::Sift`](crate::base::Method::Sift) finds where T starts; `baseline::key_points` does. `None`: that method is refused.
    pub key_points: Option<KeyPoints>,
    /// Whether solves read the device's clock from pass to pass, for [`Timings::passes_ms`]; that takes time itself.
    pub timed: bool,
}

/// T by key-points of I1, but for those that a mask leaves out, and of I2.
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

/// A Vulkan device with its queue, memory, and passes, which are compiled when a solver first takes them.
pub struct Engine {
    device: Arc<Device>,
    pipelines: Arc<Pipelines>,
    memory: u64,
    key_points: Option<KeyPoints>,
    timed: bool,
}

impl Engine {
    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`], [`Error::NoSuchDevice`], [`Error::Vulkan`].
    pub fn new(options: &EngineOptions) -> Result<Self, Error> {
        Ok(Self::on(open(options)?, options))
    }

    /// Takes a device that belongs to the embedding program, which keeps and destroys it. Of the options `device` and `validation` say nothing
    /// here.
    ///
    /// # Errors
    /// [`Error::NoDevice`] where the device lacks what the passes need, or its queue does not compute; [`Error::Vulkan`].
    pub fn from_vulkan(device: ExternalDevice, options: &EngineOptions) -> Result<Self, Error> {
        Ok(Self::on(Device::external(device, options.timeout)?, options))
    }

    fn on(device: Arc<Device>, options: &EngineOptions) -> Self {
        let pipelines = Arc::new(Pipelines::new(&device));
        let memory = options.memory.unwrap_or(u64::MAX);
        Self { device, pipelines, memory, key_points: options.key_points, timed: options.timed }
    }

    /// Lists the devices, usable or not.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::Vulkan`].
    pub fn devices() -> Result<Vec<DeviceInfo>, Error> {
        Ok(Instance::new(false)?.physical_devices()?.into_iter().map(|d| d.info).collect())
    }

    /// The device in use.
    pub fn info(&self) -> &DeviceInfo {
        self.device.info()
    }

    /// Refuses pairs that are too large for a device like this one, which may be known before a photograph is decoded.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::TooSmall`], [`Error::TooLarge`].
    pub fn check_size(
        device: &DeviceInfo,
        [width, height]: [u32; 2],
        formats: [impl Into<PixelFormat>; 2],
        settings: &Settings,
    ) -> Result<(), Error> {
        Plan::new(width, height, formats, settings)?.check_described(device)
    }

    /// Shares memory of the embedding program, a camera's ring for one, with the device: pairs are then fetched from where they are, by
    /// [`Source::Shared`]. Where the device cannot (VK_EXT_external_memory_host), the host copies.
    pub fn share(&self, memory: HostMemory) -> Arc<SharedMemory> {
        SharedMemory::new(&self.device, memory)
    }

    /// The same of memory that Linux hands over by a descriptor, a capture card's for one (VK_EXT_external_memory_dma_buf).
    ///
    /// # Errors
    /// [`Error::Mismatch`] where it is shorter than stated, or can be neither imported nor read.
    #[cfg(target_os = "linux")]
    pub fn share_dma_buf(&self, memory: DmaBuf) -> Result<Arc<SharedMemory>, Error> {
        vulkan::external_memory::dma_buf::share(&self.device, memory)
    }

    /// What validation has said so far; empty without [`EngineOptions::validation`].
    pub fn validation_messages(&self) -> Vec<String> {
        self.device.instance.messages()
    }

    /// Refuses what the device, or the memory that a pair may take of it, does not hold.
    pub(crate) fn admits(&self, plan: &Plan, slots: u64) -> Result<(), Error> {
        plan.check(&self.device, self.memory, slots)
    }

    /// Bytes of the device that a pair may take.
    pub(crate) fn memory(&self) -> u64 {
        self.memory.min(self.info().memory_bytes)
    }

    /// The longest wait for one solve.
    pub(crate) fn timeout(&self) -> Duration {
        self.device.timeout()
    }

    /// Another of the same device, for another thread.
    pub(crate) fn beside(&self) -> Self {
        let Self { device, pipelines, memory, key_points, timed } = self;
        let (device, pipelines) = (device.clone(), pipelines.clone());
        Self { device, pipelines, memory: *memory, key_points: *key_points, timed: *timed }
    }

    pub(crate) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    pub(crate) fn pipelines(&self) -> &Arc<Pipelines> {
        &self.pipelines
    }
}

impl Drop for Engine {
    /// What was compiled the next engine finds.
    fn drop(&mut self) {
        if !self.device.is_poisoned() {
            self.device.save_pipeline_cache();
        }
    }
}

/// Opens the device that the options ask for.
pub(crate) fn open(options: &EngineOptions) -> Result<Arc<Device>, Error> {
    let instance = Instance::new(options.validation)?;
    let mut devices = instance.physical_devices()?;
    let infos: Vec<DeviceInfo> = devices.iter().map(|d| d.info.clone()).collect();
    let chosen = choose(&infos, options.device.as_deref())?;
    Device::new(instance, devices.swap_remove(chosen), options.timeout)
}

/// The position of the device that is asked for, or of the most capable.
fn choose(devices: &[DeviceInfo], wanted: Option<&str>) -> Result<usize, Error> {
    let Some(wanted) = wanted else {
        let rank = |kind: &str| {
            ["CPU", "other", "virtual GPU", "integrated GPU", "discrete GPU"].iter().position(|k| *k == kind)
        };
        let usable = (0..devices.len()).rev().filter(|&i| devices[i].unusable.is_none());
        return usable.max_by_key(|&i| rank(devices[i].kind)).ok_or_else(|| Error::NoDevice(reasons(devices)));
    };
    let matches = |d: &DeviceInfo| {
        d.index.to_string() == wanted
            || d.uuid.eq_ignore_ascii_case(wanted)
            || (wanted.parse::<usize>().is_err() && d.name.to_lowercase().contains(&wanted.to_lowercase()))
    };
    let found = devices.iter().position(matches).ok_or_else(|| Error::NoSuchDevice {
        wanted: wanted.into(),
        available: if devices.is_empty() {
            "none".into()
        } else {
            devices.iter().map(|d| format!("{} {}", d.index, d.name)).collect::<Vec<_>>().join(", ")
        },
    })?;
    match &devices[found].unusable {
        None => Ok(found),
        Some(_) => Err(Error::NoDevice(reasons(&devices[found..=found]))),
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
    fn what_a_solve_that_timed_out_used_is_freed() {
        let engine = Engine::new(&EngineOptions { timeout: Duration::from_millis(1), ..testing::options() }).unwrap();
        let instance = Arc::downgrade(&engine.device.instance);
        let frame = |n: usize| {
            let value = |i: usize| 0.5 + 0.3 * ((i % 160 + n) as f32 * 0.9).sin() * ((i / 160) as f32 * 0.8).cos();
            Frame::gray(160, 160, (0..160 * 160).map(value).collect()).unwrap()
        };
        let (i1, i2) = (frame(0), frame(1));
        let solved = PairSolver::for_pair(&engine, &i1, &i2, &Settings::default()).and_then(|mut s| s.solve(&i1, &i2));
        assert!(matches!(solved, Err(Error::Timeout { .. })), "{:?}", solved.map(|s| s.findings.timings));
        assert!(engine.device.is_poisoned());
        drop(engine);
        assert!(instance.upgrade().is_none(), "all that kept it is gone");
    }

    #[test]
    fn what_a_pair_takes_is_compiled_once_and_nothing_else() {
        let frame = |n: usize, highest: f32| {
            let value =
                |i: usize| (0.5 + 0.3 * ((i % 64 + n) as f32 * 0.9).sin() * ((i / 64) as f32 * 0.8).cos()).min(highest);
            Frame::gray(64, 64, (0..64 * 64).map(|i| if value(i) < highest { value(i) } else { 1.0 }).collect())
                .unwrap()
        };
        let pairs = [0.75, 2.0].map(|highest| [frame(0, highest), frame(1, highest)]);
        let counts = pairs.each_ref().map(|[i1, i2]| {
            let engine = Engine::new(&testing::options()).unwrap();
            let mut solver = PairSolver::for_pair(&engine, i1, i2, &Settings::default()).unwrap();
            let prepared = engine.pipelines().count();
            solver.solve(i1, i2).unwrap();
            assert_eq!(engine.pipelines().count(), prepared, "a pair like the one prepared for");
            prepared
        });
        let engine = Engine::new(&testing::options()).unwrap();
        let formats = [pairs[0][0].format(); 2];
        let mut solver = PairSolver::with_slots(1, &engine, [64, 64], formats, &Settings::default()).unwrap();
        let prepared = engine.pipelines().count();
        assert!(counts.iter().all(|&one| one < prepared), "{counts:?} of {prepared}");
        for [i1, i2] in &pairs {
            solver.solve(i1, i2).unwrap();
        }
        assert_eq!(engine.pipelines().count(), prepared, "prepared for any pair");
    }

    #[test]
    fn a_device_that_leaves_out_what_has_settled_solves_as_one_that_is_asked() {
        let frame = |n: usize| {
            let value = |i: usize| 0.5 + 0.3 * ((i % 96 + n) as f32 * 0.9).sin() * ((i / 96) as f32 * 0.8).cos();
            Frame::gray(96, 80, (0..96 * 80).map(value).collect()).unwrap()
        };
        let (i1, i2) = (frame(0), frame(1));
        let solve = || {
            let engine = Engine::new(&testing::options()).unwrap();
            let solution =
                PairSolver::for_pair(&engine, &i1, &i2, &Settings::default()).unwrap().solve(&i1, &i2).unwrap();
            assert!(engine.validation_messages().is_empty(), "{:?}", engine.validation_messages());
            let bits: Vec<u32> = solution.relative_blur.iter().map(|v| v.to_bits()).collect();
            (engine.device.is_conditional(), bits, solution.findings.levels)
        };
        let (is_conditional, bits, levels) = solve();
        assert_eq!((false, bits, levels), vulkan::no_conditional_rendering::run(solve));
        println!("the device leaves commands out by itself: {is_conditional}");
    }
}
