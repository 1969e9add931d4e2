//! The instance, device and queue of the renderer.

use std::error::Error;
use std::ffi::CStr;
use std::sync::Arc;

use parfocal::interop::ash::{self, ext, vk};
use parfocal::interop::{DeviceRequirements, ExternalDevice, REQUIRED_VERSION, SharedQueue};

use crate::messages::Messages;

const VALIDATION: &CStr = c"VK_LAYER_KHRONOS_validation";

/// A device that draws and computes, with one queue.
pub struct Gpu {
    pub instance: ash::Instance,
    pub physical: vk::PhysicalDevice,
    pub device: ash::Device,
    pub family: u32,
    pub queue: vk::Queue,
    /// The lock of the queue, which renderer and engine share.
    pub turns: Arc<SharedQueue>,
    wanted: DeviceRequirements,
    messages: Option<Messages>,
    // Keeps the loader's library open.
    _entry: ash::Entry,
}

impl Gpu {
    /// Opens the first suitable device, with validation if asked for.
    pub fn new(validate: bool) -> Result<Self, Box<dyn Error>> {
        // SAFETY: the system's Vulkan loader.
        let entry = unsafe { ash::Entry::load() }?;
        let instance = instance(&entry, validate)?;
        let messages = validate.then(|| Messages::of(&entry, &instance)).transpose()?;
        let (physical, family) = choose(&instance)?.ok_or("no device of Vulkan 1.3 that draws and computes")?;
        // SAFETY: the device is of this instance, which is for Vulkan 1.3.
        let mut wanted = unsafe { DeviceRequirements::for_device(&instance, physical) }?;
        let device = device(&instance, physical, family, &mut wanted)?;
        // SAFETY: the device was made with one queue of the family.
        let queue = unsafe { device.get_device_queue(family, 0) };
        let turns = Arc::default();
        Ok(Self { instance, physical, device, family, queue, turns, wanted, messages, _entry: entry })
    }

    /// The device for an engine.
    ///
    /// # Safety
    /// The engine and its solvers are dropped before this.
    pub unsafe fn lent(&self) -> ExternalDevice {
        // SAFETY: all are of this, which outlives the engine, by the caller; whoever uses the queue takes a turn.
        unsafe {
            ExternalDevice::new(self.instance.clone(), self.physical, self.device.clone(), self.family, self.queue)
                .with_queue_lock(self.turns.clone())
                .with_requirements(&self.wanted)
        }
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        // SAFETY: whatever was made of the device is gone.
        unsafe { self.device.destroy_device(None) };
        let messages = self.messages.take().map(Messages::end).unwrap_or_default();
        // SAFETY: the device and the messenger were the last of it.
        unsafe { self.instance.destroy_instance(None) };
        assert!(std::thread::panicking() || messages.is_empty(), "validation: {messages:#?}");
    }
}

fn instance(entry: &ash::Entry, validate: bool) -> Result<ash::Instance, vk::Result> {
    let application = vk::ApplicationInfo::default().api_version(REQUIRED_VERSION);
    let (layers, extensions) =
        ([VALIDATION.as_ptr()], [ext::debug_utils::NAME.as_ptr(), ext::validation_features::NAME.as_ptr()]);
    let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
    let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
    let mut create = vk::InstanceCreateInfo::default().application_info(&application);
    if validate {
        create = create.enabled_layer_names(&layers).enabled_extension_names(&extensions).push_next(&mut features);
    }
    // SAFETY: what `create` points to is here.
    unsafe { entry.create_instance(&create, None) }
}

/// A Vulkan 1.3 device and a queue family that draws and computes.
fn choose(instance: &ash::Instance) -> Result<Option<(vk::PhysicalDevice, u32)>, vk::Result> {
    // SAFETY: the instance is there.
    let devices = unsafe { instance.enumerate_physical_devices() }?;
    let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let fits = |physical: vk::PhysicalDevice| {
        // SAFETY: the device is of the instance.
        let (properties, families) = unsafe {
            let properties = instance.get_physical_device_properties(physical);
            (properties, instance.get_physical_device_queue_family_properties(physical))
        };
        let family = families.iter().position(|family| family.queue_flags.contains(both))?;
        (properties.api_version >= REQUIRED_VERSION).then_some((physical, family as u32))
    };
    Ok(devices.into_iter().find_map(fits))
}

/// A device with the features of the renderer and of the engine.
fn device(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    family: u32,
    wanted: &mut DeviceRequirements,
) -> Result<ash::Device, vk::Result> {
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
    let extensions: Vec<_> = wanted.extensions().iter().map(|name| name.as_ptr()).collect();
    let mut own = vk::PhysicalDeviceVulkan13Features::default().dynamic_rendering(true);
    let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
    // SAFETY: what is chained is here; every device of Vulkan 1.3 has these features.
    unsafe {
        let create = wanted.enable_features(create.push_next(&mut own));
        instance.create_device(physical, &create, None)
    }
}
