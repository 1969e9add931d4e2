//! The instance, device and queue of the renderer.

use std::error::Error;
use std::ffi::CStr;
use std::sync::Arc;

use parfocal::interop::ash::{self, ext, vk};
use parfocal::interop::{DeviceRequirements, ExternalDevice, REQUIRED_VERSION, SharedQueue};

use crate::messages::Messages;

const VALIDATION: &CStr = c"VK_LAYER_KHRONOS_validation";

/// A Vulkan device with one queue for graphics and compute.
pub struct Gpu {
    pub instance: ash::Instance,
    pub physical: vk::PhysicalDevice,
    pub device: ash::Device,
    pub family: u32,
    pub queue: vk::Queue,
    /// The lock of the queue that the renderer and the engine share.
    pub shared_queue: Arc<SharedQueue>,
    requirements: DeviceRequirements,
    messages: Option<Messages>,
    // Keeps the loader's library open.
    _entry: ash::Entry,
}

impl Gpu {
    /// Opens the first suitable device, optionally with validation.
    pub fn new(validate: bool) -> Result<Self, Box<dyn Error>> {
        // SAFETY: the library is the Vulkan loader of the system.
        let entry = unsafe { ash::Entry::load() }?;
        let instance = instance(&entry, validate)?;
        let messages = validate.then(|| Messages::of(&entry, &instance)).transpose()?;
        let (physical, family) =
            choose(&instance)?.ok_or("no Vulkan 1.3 device with a queue for graphics and compute")?;
        // SAFETY: the physical device belongs to this instance, which is for Vulkan 1.3.
        let mut requirements = unsafe { DeviceRequirements::for_device(&instance, physical) }?;
        let device = device(&instance, physical, family, &mut requirements)?;
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(family, 0) };
        let shared_queue = Arc::default();
        Ok(Self { instance, physical, device, family, queue, shared_queue, requirements, messages, _entry: entry })
    }

    /// Returns the device in the form that an engine takes.
    ///
    /// # Safety
    /// The engine and its solvers are dropped before `self`.
    pub unsafe fn external_device(&self) -> ExternalDevice {
        // SAFETY: the caller ensures that the handles outlive the engine. All uses of the queue lock it.
        unsafe {
            ExternalDevice::new(self.instance.clone(), self.physical, self.device.clone(), self.family, self.queue)
                .with_queue_lock(self.shared_queue.clone())
                .with_requirements(&self.requirements)
        }
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        // SAFETY: all objects of the device were destroyed before.
        unsafe { self.device.destroy_device(None) };
        let messages = self.messages.take().map(Messages::end).unwrap_or_default();
        // SAFETY: all objects of the instance were destroyed before.
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
    // SAFETY: the structs that `create` points to outlive the call.
    unsafe { entry.create_instance(&create, None) }
}

/// Returns the first Vulkan 1.3 device that has a queue family for graphics and compute.
fn choose(instance: &ash::Instance) -> Result<Option<(vk::PhysicalDevice, u32)>, vk::Result> {
    // SAFETY: the instance is valid.
    let devices = unsafe { instance.enumerate_physical_devices() }?;
    let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let fits = |physical: vk::PhysicalDevice| {
        // SAFETY: the physical device belongs to the instance.
        let (properties, families) = unsafe {
            let properties = instance.get_physical_device_properties(physical);
            (properties, instance.get_physical_device_queue_family_properties(physical))
        };
        let family = families.iter().position(|family| family.queue_flags.contains(both))?;
        (properties.api_version >= REQUIRED_VERSION).then_some((physical, family as u32))
    };
    Ok(devices.into_iter().find_map(fits))
}

/// Creates a device with the features that the renderer and the engine require.
fn device(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    family: u32,
    requirements: &mut DeviceRequirements,
) -> Result<ash::Device, vk::Result> {
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
    let extensions: Vec<_> = requirements.extensions().iter().map(|name| name.as_ptr()).collect();
    let mut own = vk::PhysicalDeviceVulkan13Features::default().dynamic_rendering(true);
    let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
    // SAFETY: the chained structs outlive the call. Every Vulkan 1.3 device supports these features.
    unsafe {
        let create = requirements.enable_features(create.push_next(&mut own));
        instance.create_device(physical, &create, None)
    }
}
