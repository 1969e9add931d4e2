//! The Vulkan instance, validation, and the list of devices.

use std::ffi::{CStr, c_void};
use std::sync::{Arc, Mutex, PoisonError};

use ash::{ext, vk};

use super::failure::failure;
use super::optional_extensions::Liked;
use crate::base::{DeviceInfo, Error};

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Validation messages so far.
type Messages = Mutex<Vec<String>>;

/// A Vulkan 1.3 instance.
pub(crate) struct Instance {
    pub(super) handle: ash::Instance,
    /// Names of objects can be set.
    pub(super) debug_utils: bool,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    messages: Arc<Messages>,
    // Holds the loader's library open for as long as the instance lives; `None`: the instance is someone else's, and stays.
    entry: Option<ash::Entry>,
}

/// A physical device and what was read of it.
pub(crate) struct PhysicalDevice {
    pub(super) handle: vk::PhysicalDevice,
    pub(super) queue_family: u32,
    pub(crate) info: DeviceInfo,
    pub(super) limits: vk::PhysicalDeviceLimits,
    pub(super) driver_version: u32,
    pub(super) cache_uuid: [u8; vk::UUID_SIZE],
    pub(super) timestamp_bits: u32,
    /// Of extensions that are liked.
    pub(super) liked: Liked,
}

impl Instance {
    /// Opens the loader; with `validation`, core and synchronization validation are on and must be installed.
    pub(crate) fn new(validation: bool) -> Result<Arc<Self>, Error> {
        // SAFETY: loading the system's Vulkan loader runs its initialisers; it is the library that this crate exists to use.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| Error::NoLoader(e.to_string()))?;
        #[cfg(test)]
        let entry = super::faults::hooked(entry);
        let failed = |call: &str, result: vk::Result| match result {
            // What loaders say of a driver whose manifest is broken, or leads nowhere: so little of the host's memory is asked
            // for here that it is never what is missing.
            vk::Result::ERROR_OUT_OF_HOST_MEMORY
            | vk::Result::ERROR_INITIALIZATION_FAILED
            | vk::Result::ERROR_INCOMPATIBLE_DRIVER => Error::NoDevice(no_driver(result)),
            _ => failure(call, "the Vulkan loader", result),
        };
        // SAFETY: the entry is loaded, and no layer is named.
        let available = unsafe { entry.enumerate_instance_extension_properties(None) }
            .map_err(|e| failed("vkEnumerateInstanceExtensionProperties", e))?;
        let debug_utils =
            available.iter().any(|e| e.extension_name_as_c_str() == Ok(ext::debug_utils::NAME)) || validation;
        let mut layers = Vec::new();
        let mut extensions = Vec::new();
        if debug_utils {
            extensions.push(ext::debug_utils::NAME.as_ptr());
        }
        if validation {
            layers.push(VALIDATION_LAYER.as_ptr());
            extensions.push(ext::validation_features::NAME.as_ptr());
        }
        let application = vk::ApplicationInfo::default().application_name(c"parfocal").api_version(vk::API_VERSION_1_3);
        let synchronization = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&synchronization);
        let mut create = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_layer_names(&layers)
            .enabled_extension_names(&extensions);
        if validation {
            create = create.push_next(&mut features);
        }
        // SAFETY: every pointer in `create` outlives the call.
        let handle = unsafe { entry.create_instance(&create, None) }.map_err(|e| match e {
            vk::Result::ERROR_LAYER_NOT_PRESENT | vk::Result::ERROR_EXTENSION_NOT_PRESENT if validation => {
                Error::NoDevice(
                    " under validation: the Khronos validation layer is missing (Debian: vulkan-validationlayers)"
                        .into(),
                )
            }
            other => failed("vkCreateInstance", other),
        })?;
        let messages = Arc::<Messages>::default();
        let mut instance = Self { handle, debug_utils, messenger: None, messages, entry: Some(entry.clone()) };
        if validation {
            instance.listen(&entry)?;
        }
        Ok(Arc::new(instance))
    }

    /// Someone else's, whose validation is theirs.
    pub(super) fn foreign(handle: ash::Instance) -> Arc<Self> {
        Arc::new(Self { handle, debug_utils: false, messenger: None, messages: Arc::default(), entry: None })
    }

    fn listen(&mut self, entry: &ash::Entry) -> Result<(), Error> {
        let utils = ext::debug_utils::Instance::new(entry, &self.handle);
        let user_data = Arc::as_ptr(&self.messages);
        let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            )
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(collect))
            .user_data(user_data.cast_mut().cast());
        // SAFETY: the messages that `user_data` points to are dropped after the messenger is destroyed.
        let messenger = unsafe { utils.create_debug_utils_messenger(&create, None) }
            .map_err(|e| failure("vkCreateDebugUtilsMessengerEXT", "the Vulkan loader", e))?;
        self.messenger = Some((utils, messenger));
        Ok(())
    }

    /// The validation messages so far.
    pub(crate) fn messages(&self) -> Vec<String> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The validation messages so far, and forgets them: for tests that mean to cause some.
    #[cfg(test)]
    pub(crate) fn take_messages(&self) -> Vec<String> {
        std::mem::take(&mut self.messages.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The devices in the loader's order.
    pub(crate) fn physical_devices(&self) -> Result<Vec<PhysicalDevice>, Error> {
        // SAFETY: the instance is alive.
        let handles = unsafe { self.handle.enumerate_physical_devices() }
            .map_err(|e| failure("vkEnumeratePhysicalDevices", "the Vulkan loader", e))?;
        Ok(handles.into_iter().enumerate().map(|(index, handle)| self.describe(index, handle)).collect())
    }

    /// One of them, and a queue family of it that someone else has chosen.
    pub(super) fn described(&self, handle: vk::PhysicalDevice, queue_family: u32) -> Result<PhysicalDevice, Error> {
        let mut described = self.describe(0, handle);
        if let Some(why) = &described.info.unusable {
            return Err(Error::NoDevice(format!(" ({}: {why})", described.info.name)));
        }
        // SAFETY: `handle` is of this instance.
        let families = unsafe { self.handle.get_physical_device_queue_family_properties(handle) };
        let family = families.get(queue_family as usize).filter(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE));
        let Some(family) = family else {
            return Err(Error::NoDevice(format!(
                " ({}: queue family {queue_family} does not compute)",
                described.info.name
            )));
        };
        (described.queue_family, described.timestamp_bits) = (queue_family, family.timestamp_valid_bits);
        Ok(described)
    }

    fn describe(&self, index: usize, handle: vk::PhysicalDevice) -> PhysicalDevice {
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        // Vulkan 1.0 devices know no properties2; asking for the version first keeps them listed.
        // SAFETY: `handle` came from this instance.
        let basic = unsafe { self.handle.get_physical_device_properties(handle) };
        let recent = basic.api_version >= vk::API_VERSION_1_3;
        if recent {
            let mut properties = vk::PhysicalDeviceProperties2::default()
                .push_next(&mut id)
                .push_next(&mut subgroup)
                .push_next(&mut driver);
            // SAFETY: `handle` came from this instance, and a 1.3 device fills all three structures.
            unsafe { self.handle.get_physical_device_properties2(handle, &mut properties) };
        }
        // SAFETY: `handle` came from this instance.
        let memory = unsafe { self.handle.get_physical_device_memory_properties(handle) };
        // SAFETY: `handle` came from this instance.
        let families = unsafe { self.handle.get_physical_device_queue_family_properties(handle) };
        let queue_family = compute_family(&families);
        let unusable = if recent {
            self.missing(handle, &basic.limits, &subgroup, queue_family)
        } else {
            Some("it lacks Vulkan 1.3".into())
        };
        let version = basic.api_version;
        let info = DeviceInfo {
            index,
            name: text(basic.device_name_as_c_str()),
            driver: format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str()))
                .trim()
                .into(),
            uuid: uuid(&id.device_uuid),
            kind: kind(basic.device_type),
            api_version: format!(
                "{}.{}.{}",
                vk::api_version_major(version),
                vk::api_version_minor(version),
                vk::api_version_patch(version)
            ),
            subgroup_size: subgroup.subgroup_size,
            memory_bytes: memory_bytes(basic.device_type, memory.memory_heaps_as_slice()),
            max_image_size: basic.limits.max_image_dimension2_d,
            max_storage_buffer: u64::from(basic.limits.max_storage_buffer_range),
            unusable,
        };
        let (queue_family, usable) = (queue_family.unwrap_or(0), info.unusable.is_none());
        PhysicalDevice {
            handle,
            queue_family,
            timestamp_bits: families.get(queue_family as usize).map_or(0, |f| f.timestamp_valid_bits),
            liked: if usable { self.liked(handle) } else { Liked::default() },
            info,
            limits: basic.limits,
            driver_version: basic.driver_version,
            cache_uuid: basic.pipeline_cache_uuid,
        }
    }

    /// What a device has of what is liked.
    pub(super) fn liked(&self, handle: vk::PhysicalDevice) -> Liked {
        // SAFETY: `handle` came from this instance.
        let extensions = unsafe { self.handle.enumerate_device_extension_properties(handle) }.unwrap_or_default();
        let mut liked = Liked::of(|name| extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name)));
        #[cfg(test)]
        if unconditional::IS.get() {
            liked.conditional = false;
        }
        if liked.conditional {
            let mut conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default();
            let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut conditional);
            // SAFETY: `handle` came from this instance, and a device with the extension fills the structure.
            unsafe { self.handle.get_physical_device_features2(handle, &mut features) };
            liked.conditional = conditional.conditional_rendering == vk::TRUE;
        }
        liked
    }

    /// What a 1.3 device lacks that the passes need.
    fn missing(
        &self,
        handle: vk::PhysicalDevice,
        limits: &vk::PhysicalDeviceLimits,
        subgroup: &vk::PhysicalDeviceSubgroupProperties,
        queue_family: Option<u32>,
    ) -> Option<String> {
        let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut v12).push_next(&mut v13);
        // SAFETY: `handle` came from this instance, and a 1.3 device fills both structures.
        unsafe { self.handle.get_physical_device_features2(handle, &mut features) };
        let mut sizes = vk::PhysicalDeviceVulkan13Properties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut sizes);
        // SAFETY: as above.
        unsafe { self.handle.get_physical_device_properties2(handle, &mut properties) };
        let operations = vk::SubgroupFeatureFlags::BASIC | vk::SubgroupFeatureFlags::ARITHMETIC;
        let what = if queue_family.is_none() {
            "a compute queue"
        } else if v13.synchronization2 == 0 || v13.maintenance4 == 0 || v12.timeline_semaphore == 0 {
            "synchronization2, maintenance4 or timeline semaphores"
        } else if !subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE)
            || !subgroup.supported_operations.contains(operations)
        {
            "subgroup arithmetic in compute shaders"
        } else if sizes.min_subgroup_size < 4 || sizes.max_subgroup_size > 128 {
            "subgroups of 4 to 128"
        } else if limits.max_per_stage_descriptor_storage_images < 8 {
            "eight storage images a shader"
        } else if limits.max_per_stage_descriptor_storage_buffers < 5 {
            "five storage buffers a shader"
        } else if limits.max_compute_work_group_invocations < 256 {
            "workgroups of 256"
        } else {
            return None;
        };
        Some(format!("it lacks {what}"))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((utils, messenger)) = &self.messenger {
            // SAFETY: the messenger came from this instance, and nothing else holds it.
            unsafe { utils.destroy_debug_utils_messenger(*messenger, None) };
        }
        if self.entry.is_some() {
            // SAFETY: devices keep the instance alive by an Arc, so none is left.
            unsafe { self.handle.destroy_instance(None) };
        }
    }
}

/// Variables by which drivers are chosen.
const DRIVER_VARIABLES: [&str; 3] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"];

/// Why the loader has no driver, as far as is known.
fn no_driver(result: vk::Result) -> String {
    let set: Vec<&str> = DRIVER_VARIABLES.into_iter().filter(|name| std::env::var_os(name).is_some()).collect();
    let look = match set.as_slice() {
        [] => "the manifests of drivers, in /usr/share/vulkan/icd.d and /etc/vulkan/icd.d".to_string(),
        set => format!("the files that {} names", set.join(" or ")),
    };
    format!(", since no driver could be loaded ({result:?}; look at {look}, and at what VK_LOADER_DEBUG=error says)")
}

/// A family that computes and does not draw where there is one, since it is the less busy.
fn compute_family(families: &[vk::QueueFamilyProperties]) -> Option<u32> {
    let computes = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
    let draws = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::GRAPHICS);
    families
        .iter()
        .position(|f| computes(f) && !draws(f) && f.timestamp_valid_bits > 0)
        .or_else(|| families.iter().position(computes))
        .and_then(|i| u32::try_from(i).ok())
}

fn text(name: Result<&CStr, std::ffi::FromBytesUntilNulError>) -> String {
    name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

fn uuid(bytes: &[u8; vk::UUID_SIZE]) -> String {
    let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    format!("{}-{}-{}-{}-{}", &hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..])
}

/// The largest heap of the device. A device of software allocates from the system's memory, whatever size of heap it
/// states: lavapipe 22.3 states 2 GiB everywhere.
fn memory_bytes(device_type: vk::PhysicalDeviceType, heaps: &[vk::MemoryHeap]) -> u64 {
    let local = heaps.iter().filter(|h| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
    let heap = local.map(|h| h.size).max().unwrap_or(0);
    if device_type == vk::PhysicalDeviceType::CPU { available_memory().unwrap_or(heap) } else { heap }
}

/// Bytes that the system can give without swapping, where Linux tells.
fn available_memory() -> Option<u64> {
    let report = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = report.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix(" kB")?.parse::<u64>().ok().map(|kibibytes| kibibytes << 10)
}

fn kind(device_type: vk::PhysicalDeviceType) -> &'static str {
    match device_type {
        vk::PhysicalDeviceType::DISCRETE_GPU => "discrete GPU",
        vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated GPU",
        vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual GPU",
        vk::PhysicalDeviceType::CPU => "CPU",
        _ => "other",
    }
}

/// Keeps what validation says.
extern "system" fn collect(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user_data: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data, and `user_data` is the `Messages` that outlive the messenger.
    let (message, messages) = unsafe {
        let message = (*data).message_as_c_str().map(|m| m.to_string_lossy().into_owned()).unwrap_or_default();
        (message, &*user_data.cast_const().cast::<Messages>())
    };
    #[cfg(test)]
    super::faults::hear(&message);
    messages.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    vk::FALSE
}

/// A device that cannot leave commands out by itself.
#[cfg(test)]
pub(crate) mod unconditional {
    use std::cell::Cell;

    thread_local! {
        pub(super) static IS: Cell<bool> = const { Cell::new(false) };
    }

    /// What is done where this thread opens such devices.
    pub(crate) fn during<T>(of: impl FnOnce() -> T) -> T {
        IS.set(true);
        let done = of();
        IS.set(false);
        done
    }
}
