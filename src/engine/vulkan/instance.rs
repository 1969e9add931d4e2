//! The Vulkan instance, validation, and the list of devices with their optional extensions.

use std::ffi::{CStr, c_void};
use std::sync::{Arc, Mutex, PoisonError};

use ash::{ext, khr, vk};

use crate::base::{DeviceInfo, Error};

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Validation messages, oldest first.
type Messages = Mutex<Vec<String>>;

/// The invocations of a workgroup that each usable device has.
pub(crate) const LEAST_WORKGROUP: u32 = 256;

/// The name of the loader in errors.
const LOADER: &str = "the Vulkan loader";

/// Returns the error of a failed Vulkan call, with advice if there is any.
pub(super) fn vulkan_error(call: &str, device: &str, result: vk::Result) -> Error {
    let advice = match result {
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            "; use smaller images, or free memory on the device"
        }
        vk::Result::ERROR_DEVICE_LOST => "; make a new Engine, and check for an update of the driver",
        _ => "",
    };
    Error::Vulkan { call: call.into(), device: device.into(), result: format!("{result:?}"), advice }
}

/// A Vulkan 1.3 instance.
pub(crate) struct Instance {
    pub(super) handle: ash::Instance,
    /// Whether `VK_EXT_debug_utils` is enabled, so that objects can be named.
    pub(super) debug_utils: bool,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    messages: Arc<Messages>,
    /// Keeps the loader's library open while the instance lives. `None`: the embedding program owns the instance, which
    /// is not destroyed here.
    entry: Option<ash::Entry>,
}

/// A physical device and its properties.
pub(crate) struct PhysicalDevice {
    pub(super) handle: vk::PhysicalDevice,
    pub(super) queue_family: u32,
    pub(crate) info: DeviceInfo,
    pub(super) limits: vk::PhysicalDeviceLimits,
    pub(super) driver_version: u32,
    pub(super) cache_uuid: [u8; vk::UUID_SIZE],
    pub(super) timestamp_bits: u32,
    pub(super) optional: OptionalExtensions,
}

/// Device extensions that an engine uses if they and their features are enabled. None is required.
///
/// - `VK_EXT_conditional_rendering`, with its feature `conditionalRendering`: the device skips levels that have
///   settled, and a solve is one submission.
/// - `VK_EXT_external_memory_host`: the device reads host memory in place ([`Engine::share`](crate::Engine::share)).
/// - The last three together: the device reads dma-bufs in place.
pub const OPTIONAL_EXTENSIONS: [&CStr; 5] = [
    ext::conditional_rendering::NAME,
    ext::external_memory_host::NAME,
    khr::external_memory_fd::NAME,
    ext::external_memory_dma_buf::NAME,
    ext::queue_family_foreign::NAME,
];

/// Which of the [`OPTIONAL_EXTENSIONS`] a device has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct OptionalExtensions {
    pub(crate) conditional_rendering: bool,
    pub(crate) host_memory: bool,
    /// All three extensions for dma-bufs.
    pub(crate) dma_buf: bool,
    /// `VK_KHR_portability_subset`, which Vulkan requires to be enabled: the driver translates to another API, as
    /// MoltenVK does. The engine needs none of its features.
    pub(crate) portability_subset: bool,
}

impl OptionalExtensions {
    /// Returns the extensions of a device for which `has` is true.
    pub(super) fn supported(has: impl Fn(&CStr) -> bool) -> Self {
        let [conditional_rendering, host_memory, dma_buf @ ..] = OPTIONAL_EXTENSIONS;
        Self {
            conditional_rendering: has(conditional_rendering),
            host_memory: has(host_memory),
            dma_buf: dma_buf.iter().all(|name| has(name)),
            portability_subset: has(khr::portability_subset::NAME),
        }
    }

    /// Returns the names of the extensions.
    pub(super) fn names(self) -> impl Iterator<Item = &'static CStr> {
        let Self { conditional_rendering, host_memory, dma_buf, portability_subset } = self;
        let has = [conditional_rendering, host_memory, dma_buf, dma_buf, dma_buf, portability_subset];
        OPTIONAL_EXTENSIONS
            .into_iter()
            .chain([khr::portability_subset::NAME])
            .zip(has)
            .filter(|(_, has)| *has)
            .map(|(name, _)| name)
    }

    /// Returns the extensions that both have.
    pub(super) fn intersection(self, other: Self) -> Self {
        Self {
            conditional_rendering: self.conditional_rendering && other.conditional_rendering,
            host_memory: self.host_memory && other.host_memory,
            dma_buf: self.dma_buf && other.dma_buf,
            portability_subset: self.portability_subset && other.portability_subset,
        }
    }
}

impl Instance {
    /// Loads the Vulkan loader and creates an instance. `validation` enables core and synchronization validation.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`] without a driver or the requested validation layer, [`Error::Vulkan`].
    pub(crate) fn new(validation: bool) -> Result<Arc<Self>, Error> {
        // SAFETY: loading the system's Vulkan loader runs its initializers, which are trusted.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| Error::NoLoader(e.to_string()))?;
        #[cfg(test)]
        let entry = super::faults::hook_entry(entry);
        let failed = |call: &str, result: vk::Result| match result {
            // Loaders return these for a driver whose manifest is broken or names a missing file. The call needs too
            // little host memory for that to be the cause.
            vk::Result::ERROR_OUT_OF_HOST_MEMORY
            | vk::Result::ERROR_INITIALIZATION_FAILED
            | vk::Result::ERROR_INCOMPATIBLE_DRIVER => Error::NoDevice(no_driver(result)),
            _ => vulkan_error(call, LOADER, result),
        };
        // SAFETY: the entry is loaded, and no layer name is passed.
        let available = unsafe { entry.enumerate_instance_extension_properties(None) }
            .map_err(|e| failed("vkEnumerateInstanceExtensionProperties", e))?;
        let debug_utils = has(&available, ext::debug_utils::NAME) || validation;
        let (mut layers, mut extensions, mut flags) = (Vec::new(), Vec::new(), vk::InstanceCreateFlags::empty());
        // Without it the loader hides drivers that translate to another API, as MoltenVK does.
        if has(&available, khr::portability_enumeration::NAME) {
            extensions.push(khr::portability_enumeration::NAME.as_ptr());
            flags |= vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR;
        }
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
            .flags(flags)
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
                    " under validation: the Khronos validation layer is missing (of the Vulkan SDK; Debian: vulkan-validationlayers)"
                        .into(),
                )
            }
            other => failed("vkCreateInstance", other),
        })?;
        let messages = Arc::<Messages>::default();
        let mut instance = Self { handle, debug_utils, messenger: None, messages, entry: Some(entry.clone()) };
        if validation {
            instance.create_messenger(&entry)?;
        }
        Ok(Arc::new(instance))
    }

    /// Wraps an instance of the embedding program, without validation messages.
    pub(super) fn external(handle: ash::Instance) -> Arc<Self> {
        Arc::new(Self { handle, debug_utils: false, messenger: None, messages: Arc::default(), entry: None })
    }

    /// Collects validation messages.
    fn create_messenger(&mut self, entry: &ash::Entry) -> Result<(), Error> {
        let utils = ext::debug_utils::Instance::new(entry, &self.handle);
        let user_data = Arc::as_ptr(&self.messages);
        let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            )
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(collect_message))
            .user_data(user_data.cast_mut().cast());
        // SAFETY: `user_data` points to the messages, which outlive the messenger (`Drop`).
        let messenger = unsafe { utils.create_debug_utils_messenger(&create, None) }
            .map_err(|e| vulkan_error("vkCreateDebugUtilsMessengerEXT", LOADER, e))?;
        self.messenger = Some((utils, messenger));
        Ok(())
    }

    /// Returns the validation messages so far.
    pub(crate) fn messages(&self) -> Vec<String> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Takes the validation messages, for tests that provoke some.
    #[cfg(test)]
    pub(crate) fn take_messages(&self) -> Vec<String> {
        std::mem::take(&mut self.messages.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Lists the physical devices in the loader's order.
    pub(crate) fn physical_devices(&self) -> Result<Vec<PhysicalDevice>, Error> {
        // SAFETY: the instance is not destroyed.
        let handles = unsafe { self.handle.enumerate_physical_devices() }
            .map_err(|e| vulkan_error("vkEnumeratePhysicalDevices", LOADER, e))?;
        handles.into_iter().enumerate().map(|(index, handle)| self.describe(index, handle)).collect()
    }

    /// Describes a physical device with a queue family chosen by the embedding program.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if the device lacks a required feature, or the family does not support compute.
    pub(super) fn physical_device(
        &self,
        handle: vk::PhysicalDevice,
        queue_family: u32,
    ) -> Result<PhysicalDevice, Error> {
        let mut described = self.describe(0, handle)?;
        if let Some(why) = &described.info.unusable {
            return Err(Error::NoDevice(format!(" ({}: {why})", described.info.name)));
        }
        // SAFETY: `handle` belongs to this instance.
        let families = unsafe { self.handle.get_physical_device_queue_family_properties(handle) };
        let family = families.get(queue_family as usize).filter(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE));
        let Some(family) = family else {
            return Err(Error::NoDevice(format!(
                " ({}: queue family {queue_family} does not support compute)",
                described.info.name
            )));
        };
        (described.queue_family, described.timestamp_bits) = (queue_family, family.timestamp_valid_bits);
        Ok(described)
    }

    fn describe(&self, index: usize, handle: vk::PhysicalDevice) -> Result<PhysicalDevice, Error> {
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        // Vulkan 1.0 devices have no properties2. They are listed as unusable, so the version is queried first.
        // SAFETY: `handle` belongs to this instance.
        let basic = unsafe { self.handle.get_physical_device_properties(handle) };
        let is_supported_version = basic.api_version >= vk::API_VERSION_1_3;
        if is_supported_version {
            let mut properties = vk::PhysicalDeviceProperties2::default()
                .push_next(&mut id)
                .push_next(&mut subgroup)
                .push_next(&mut driver);
            // SAFETY: `handle` belongs to this instance; a 1.3 device fills the three chained structures.
            unsafe { self.handle.get_physical_device_properties2(handle, &mut properties) };
        }
        let extensions = if is_supported_version { self.extensions(handle)? } else { Vec::new() };
        let memory_bytes = self.memory_bytes(handle, basic.device_type, &extensions);
        // SAFETY: `handle` belongs to this instance.
        let families = unsafe { self.handle.get_physical_device_queue_family_properties(handle) };
        let queue_family = compute_family(&families);
        let unusable = if is_supported_version {
            self.missing_requirement(handle, &basic.limits, &subgroup, queue_family)
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
            memory_bytes,
            max_image_size: basic.limits.max_image_dimension2_d,
            max_storage_buffer: u64::from(basic.limits.max_storage_buffer_range),
            unusable,
        };
        let (queue_family, is_usable) = (queue_family.unwrap_or(0), info.unusable.is_none());
        Ok(PhysicalDevice {
            handle,
            queue_family,
            timestamp_bits: families.get(queue_family as usize).map_or(0, |f| f.timestamp_valid_bits),
            optional: if is_usable { self.supported(handle, &extensions) } else { OptionalExtensions::default() },
            info,
            limits: basic.limits,
            driver_version: basic.driver_version,
            cache_uuid: basic.pipeline_cache_uuid,
        })
    }

    /// Enumerates the extensions of a Vulkan 1.3 device.
    fn extensions(&self, handle: vk::PhysicalDevice) -> Result<Vec<vk::ExtensionProperties>, Error> {
        // SAFETY: `handle` belongs to this instance.
        unsafe { self.handle.enumerate_device_extension_properties(handle) }.map_err(|e| {
            // SAFETY: `handle` belongs to this instance.
            let properties = unsafe { self.handle.get_physical_device_properties(handle) };
            vulkan_error("vkEnumerateDeviceExtensionProperties", &text(properties.device_name_as_c_str()), e)
        })
    }

    /// Enumerates the optional extensions of a usable device.
    pub(super) fn optional_extensions(&self, handle: vk::PhysicalDevice) -> Result<OptionalExtensions, Error> {
        self.extensions(handle).map(|extensions| self.supported(handle, &extensions))
    }

    /// The optional extensions among those of a usable device.
    fn supported(&self, handle: vk::PhysicalDevice, extensions: &[vk::ExtensionProperties]) -> OptionalExtensions {
        let has = |name: &CStr| has(extensions, name);
        let mut optional = OptionalExtensions::supported(has);
        #[cfg(test)]
        if no_conditional_rendering::IS_SET.get() {
            optional.conditional_rendering = false;
        }
        if optional.conditional_rendering {
            let mut conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default();
            let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut conditional);
            // SAFETY: `handle` belongs to this instance; a device with the extension fills the structure.
            unsafe { self.handle.get_physical_device_features2(handle, &mut features) };
            optional.conditional_rendering = conditional.conditional_rendering == vk::TRUE;
        }
        optional
    }

    /// The bytes of the largest device-local heap, or what other programs leave of it if the driver says so. A software
    /// device allocates from the system's memory, so that its available memory is returned: lavapipe 22.3 reports a heap
    /// of 2 GiB on every machine.
    fn memory_bytes(
        &self,
        handle: vk::PhysicalDevice,
        kind: vk::PhysicalDeviceType,
        extensions: &[vk::ExtensionProperties],
    ) -> u64 {
        // SAFETY: `handle` belongs to this instance.
        let memory = unsafe { self.handle.get_physical_device_memory_properties(handle) };
        let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let has_budget = has(extensions, ext::memory_budget::NAME);
        if has_budget {
            let mut properties = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut budget);
            // SAFETY: `handle` belongs to this instance; a 1.3 device with the extension fills the chained structure.
            unsafe { self.handle.get_physical_device_memory_properties2(handle, &mut properties) };
        }
        let left = budget.heap_budget.iter().zip(budget.heap_usage).map(|(&all, used)| all.saturating_sub(used));
        let local = memory.memory_heaps_as_slice().iter().zip(left);
        let local = local.filter(|(heap, _)| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let largest = local.map(|(heap, left)| if has_budget { heap.size.min(left) } else { heap.size });
        let heap = largest.max().unwrap_or(0);
        if kind == vk::PhysicalDeviceType::CPU { super::available_memory().unwrap_or(heap) } else { heap }
    }

    /// Names the first requirement of the passes that a Vulkan 1.3 device does not meet.
    fn missing_requirement(
        &self,
        handle: vk::PhysicalDevice,
        limits: &vk::PhysicalDeviceLimits,
        subgroup: &vk::PhysicalDeviceSubgroupProperties,
        queue_family: Option<u32>,
    ) -> Option<String> {
        let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut v12).push_next(&mut v13);
        // SAFETY: `handle` belongs to this instance; a 1.3 device fills both chained structures.
        unsafe { self.handle.get_physical_device_features2(handle, &mut features) };
        let mut sizes = vk::PhysicalDeviceVulkan13Properties::default();
        let mut floats = vk::PhysicalDeviceVulkan12Properties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut sizes).push_next(&mut floats);
        // SAFETY: `handle` belongs to this instance; a 1.3 device fills both chained structures.
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
            "eight storage images per shader"
        } else if limits.max_per_stage_descriptor_storage_buffers < 6 {
            "six storage buffers per shader"
        } else if limits.max_compute_work_group_invocations < LEAST_WORKGROUP {
            "workgroups of 256"
        } else if limits.max_compute_shared_memory_size < 1 << 15 {
            "32 KiB of memory that a workgroup shares"
        } else if floats.shader_signed_zero_inf_nan_preserve_float32 == 0 {
            // `glsl/include/nan.glsl`
            "NaN in 32-bit shaders"
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
            // SAFETY: devices keep the instance alive by an Arc, so that no device is left.
            unsafe { self.handle.destroy_instance(None) };
        }
    }
}

/// Environment variables of the loader that choose drivers.
const DRIVER_VARIABLES: [&str; 3] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES"];

/// Explains why the loader has no driver.
fn no_driver(result: vk::Result) -> String {
    let set: Vec<&str> = DRIVER_VARIABLES.into_iter().filter(|name| std::env::var_os(name).is_some()).collect();
    let place = match set.as_slice() {
        [] => "the manifests of drivers, on Linux in /usr/share/vulkan/icd.d and /etc/vulkan/icd.d".to_string(),
        set => format!("the files that {} names", set.join(" or ")),
    };
    format!(
        ", since no driver could be loaded ({result:?}; look at {place}, and at the output of VK_LOADER_DEBUG=error)"
    )
}

/// Chooses a queue family with compute support, preferably without graphics, since that is less busy.
fn compute_family(families: &[vk::QueueFamilyProperties]) -> Option<u32> {
    let has_compute = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
    let has_graphics = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::GRAPHICS);
    families
        .iter()
        .position(|f| has_compute(f) && !has_graphics(f) && f.timestamp_valid_bits > 0)
        .or_else(|| families.iter().position(has_compute))
        .and_then(|i| u32::try_from(i).ok())
}

pub(super) fn text(name: Result<&CStr, std::ffi::FromBytesUntilNulError>) -> String {
    name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

fn uuid(bytes: &[u8; vk::UUID_SIZE]) -> String {
    let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    format!("{}-{}-{}-{}-{}", &hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..])
}

fn has(extensions: &[vk::ExtensionProperties], name: &CStr) -> bool {
    extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name))
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

/// Stores a validation message.
extern "system" fn collect_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user_data: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data, and `user_data` points to the `Messages`, which outlive the messenger.
    let (message, messages) = unsafe {
        let message = (*data).message_as_c_str().map(|m| m.to_string_lossy().into_owned()).unwrap_or_default();
        (message, &*user_data.cast_const().cast::<Messages>())
    };
    #[cfg(test)]
    super::faults::log_message(&message);
    messages.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    vk::FALSE
}

/// Hides conditional rendering from the instances of a thread.
#[cfg(test)]
pub(crate) mod no_conditional_rendering {
    use std::cell::Cell;

    thread_local! {
        pub(super) static IS_SET: Cell<bool> = const { Cell::new(false) };
    }

    /// Runs `function` while devices opened by this thread have no conditional rendering.
    pub(crate) fn run<T>(function: impl FnOnce() -> T) -> T {
        IS_SET.set(true);
        let result = function();
        IS_SET.set(false);
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::vulkan::faults::{self, Fault};

    #[test]
    fn a_failed_enumeration_of_device_extensions_is_an_error() {
        let name = "vkEnumerateDeviceExtensionProperties";
        let list = || Instance::new(false)?.physical_devices().map(|devices| devices.len());
        let _alone = faults::alone();
        faults::begin(None, None);
        assert!(list().unwrap() > 0);
        let call = faults::end().calls.iter().position(|call| call.name == name).unwrap();
        faults::begin(Some(Fault { call, result: 0, is_permanent: false }), None);
        let failed = list();
        faults::end();
        assert!(matches!(&failed, Err(Error::Vulkan { call, .. }) if call == name), "{failed:?}");
    }
}
