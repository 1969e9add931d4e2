//! Required features and optional extensions of a device that the embedding program creates for an engine.

use std::ffi::CStr;

use ash::vk::{self, StructureType};

use super::instance::{Instance, OptionalExtensions};
use crate::base::Error;

/// The lowest Vulkan version that the instance and the device must be created for.
pub const REQUIRED_VERSION: u32 = vk::API_VERSION_1_3;

/// Enables the features that an engine requires: timeline semaphores, synchronization2 and maintenance4. Other features
/// keep their values. [`DeviceRequirements`] does the same in any `pNext` chain, with the optional extensions.
pub fn enable_required_features(
    v12: &mut vk::PhysicalDeviceVulkan12Features<'_>,
    v13: &mut vk::PhysicalDeviceVulkan13Features<'_>,
) {
    v12.timeline_semaphore = vk::TRUE;
    v13.synchronization2 = vk::TRUE;
    v13.maintenance4 = vk::TRUE;
}

/// The required features and the available [`OPTIONAL_EXTENSIONS`](super::OPTIONAL_EXTENSIONS) of a physical device, for the creation of a device.
///
/// A `pNext` chain may hold the structure of a feature once, and not beside that of the Vulkan version that promoted
/// it. This type extends a chain that other code has begun. A program that writes the whole chain itself can use
/// [`enable_required_features`].
pub struct DeviceRequirements {
    timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures<'static>,
    synchronization2: vk::PhysicalDeviceSynchronization2Features<'static>,
    maintenance4: vk::PhysicalDeviceMaintenance4Features<'static>,
    conditional_rendering: Option<vk::PhysicalDeviceConditionalRenderingFeaturesEXT<'static>>,
    optional: OptionalExtensions,
}

impl DeviceRequirements {
    /// Returns the requirements for a physical device.
    ///
    /// # Errors
    /// [`Error::Vulkan`] if the extensions of the device cannot be enumerated.
    ///
    /// # Safety
    /// `physical` belongs to `instance`, which was created for [`REQUIRED_VERSION`] or later.
    pub unsafe fn for_device(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Result<Self, Error> {
        Instance::external(instance.clone()).optional_extensions(physical).map(Self::new)
    }

    fn new(optional: OptionalExtensions) -> Self {
        let conditional = vk::PhysicalDeviceConditionalRenderingFeaturesEXT::default().conditional_rendering(true);
        Self {
            timeline_semaphore: vk::PhysicalDeviceTimelineSemaphoreFeatures::default().timeline_semaphore(true),
            synchronization2: vk::PhysicalDeviceSynchronization2Features::default().synchronization2(true),
            maintenance4: vk::PhysicalDeviceMaintenance4Features::default().maintenance4(true),
            conditional_rendering: optional.conditional_rendering.then_some(conditional),
            optional,
        }
    }

    /// Returns the names of the extensions to enable.
    pub fn extensions(&self) -> Vec<&'static CStr> {
        self.optional.names().collect()
    }

    pub(super) fn optional(&self) -> OptionalExtensions {
        self.optional
    }

    /// Enables the features in the structures that are chained to `create`, and chains the missing structures. Call it
    /// last: a structure chained later may be a duplicate.
    ///
    /// # Safety
    /// The chain is valid and its structures may be written, as those chained by `push_next` may.
    pub unsafe fn enable_features<'a>(&'a mut self, mut create: vk::DeviceCreateInfo<'a>) -> vk::DeviceCreateInfo<'a> {
        // An earlier call may have chained them.
        self.timeline_semaphore.p_next = std::ptr::null_mut();
        self.synchronization2.p_next = std::ptr::null_mut();
        self.maintenance4.p_next = std::ptr::null_mut();
        self.conditional_rendering.iter_mut().for_each(|conditional| conditional.p_next = std::ptr::null_mut());
        let mut is_enabled = [false; 4];
        let mut next = create.p_next.cast_mut().cast::<vk::BaseOutStructure<'_>>();
        while !next.is_null() {
            // SAFETY: the caller guarantees that the chain is valid and may be written.
            let (enabled, following) = unsafe { (enable_features_in(next), (*next).p_next) };
            (0..4).for_each(|n| is_enabled[n] |= enabled[n]);
            next = following;
        }
        let [timeline_semaphore, synchronization2, maintenance4, conditional_rendering] = is_enabled;
        if !timeline_semaphore {
            create = create.push_next(&mut self.timeline_semaphore);
        }
        if !synchronization2 {
            create = create.push_next(&mut self.synchronization2);
        }
        if !maintenance4 {
            create = create.push_next(&mut self.maintenance4);
        }
        if let Some(features) = self.conditional_rendering.as_mut().filter(|_| !conditional_rendering) {
            create = create.push_next(features);
        }
        create
    }
}

/// Enables the features of a structure, and returns which of timeline semaphores, synchronization2, maintenance4 and
/// conditional rendering it holds. The last is in no valid chain of a device without the extension.
///
/// # Safety
/// The structure belongs to a valid chain and may be written.
unsafe fn enable_features_in(structure: *mut vk::BaseOutStructure<'_>) -> [bool; 4] {
    // SAFETY: a structure in a valid chain has the type that its `s_type` states.
    unsafe {
        match (*structure).s_type {
            StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceVulkan12Features<'_>>()).timeline_semaphore = vk::TRUE;
                [true, false, false, false]
            }
            StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceTimelineSemaphoreFeatures<'_>>()).timeline_semaphore = vk::TRUE;
                [true, false, false, false]
            }
            StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES => {
                let features = structure.cast::<vk::PhysicalDeviceVulkan13Features<'_>>();
                ((*features).synchronization2, (*features).maintenance4) = (vk::TRUE, vk::TRUE);
                [false, true, true, false]
            }
            StructureType::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceSynchronization2Features<'_>>()).synchronization2 = vk::TRUE;
                [false, true, false, false]
            }
            StructureType::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES => {
                (*structure.cast::<vk::PhysicalDeviceMaintenance4Features<'_>>()).maintenance4 = vk::TRUE;
                [false, false, true, false]
            }
            StructureType::PHYSICAL_DEVICE_CONDITIONAL_RENDERING_FEATURES_EXT => {
                let features = structure.cast::<vk::PhysicalDeviceConditionalRenderingFeaturesEXT<'_>>();
                (*features).conditional_rendering = vk::TRUE;
                [false, false, false, true]
            }
            _ => [false; 4],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn requirements() -> DeviceRequirements {
        DeviceRequirements::new(OptionalExtensions { conditional_rendering: true, ..OptionalExtensions::default() })
    }

    /// Returns the types of the chained structures, sorted.
    fn chained_types(create: &vk::DeviceCreateInfo<'_>) -> Vec<StructureType> {
        let mut types = Vec::new();
        let mut next = create.p_next.cast::<vk::BaseInStructure<'_>>();
        while !next.is_null() {
            // SAFETY: the structures that the tests chain outlive this call.
            unsafe {
                types.push((*next).s_type);
                next = (*next).p_next;
            }
        }
        types.sort_unstable();
        types
    }

    #[test]
    fn each_feature_is_enabled_in_exactly_one_structure() {
        let mut empty = requirements();
        // SAFETY: the chain is empty.
        let create = unsafe { empty.enable_features(vk::DeviceCreateInfo::default()) };
        let each = [
            StructureType::PHYSICAL_DEVICE_CONDITIONAL_RENDERING_FEATURES_EXT,
            StructureType::PHYSICAL_DEVICE_TIMELINE_SEMAPHORE_FEATURES,
            StructureType::PHYSICAL_DEVICE_SYNCHRONIZATION_2_FEATURES,
            StructureType::PHYSICAL_DEVICE_MAINTENANCE_4_FEATURES,
        ];
        assert_eq!(chained_types(&create), each);

        let mut v12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
        let create = vk::DeviceCreateInfo::default().push_next(&mut v12).push_next(&mut v13);
        let mut chained = requirements();
        // SAFETY: both chained structures are local and alive.
        let types = chained_types(&unsafe { chained.enable_features(create) });
        let versions =
            [StructureType::PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, StructureType::PHYSICAL_DEVICE_VULKAN_1_3_FEATURES];
        assert_eq!(types, [&versions[..], &each[..1]].concat());
        assert_eq!([v12.timeline_semaphore, v13.synchronization2, v13.maintenance4], [vk::TRUE; 3]);

        let mut maintenance4 = vk::PhysicalDeviceMaintenance4Features::default();
        let create = vk::DeviceCreateInfo::default().push_next(&mut maintenance4);
        let mut chained = requirements();
        // SAFETY: the chained structure is local and alive.
        assert_eq!(chained_types(&unsafe { chained.enable_features(create) }), each);
        assert_eq!(maintenance4.maintenance4, vk::TRUE);
    }
}
