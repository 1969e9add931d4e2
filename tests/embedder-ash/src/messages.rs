//! What validation says.

use std::ffi::c_void;
use std::sync::{Arc, Mutex, PoisonError};

use parfocal::interop::ash::{self, ext, vk};

/// Validation messages, kept.
pub struct Messages {
    utils: ext::debug_utils::Instance,
    messenger: vk::DebugUtilsMessengerEXT,
    // In an `Arc`, where the messenger finds it wherever this is moved.
    kept: Arc<Mutex<Vec<String>>>,
}

impl Messages {
    /// Of an instance that was made with the layer and `VK_EXT_debug_utils`.
    pub fn of(entry: &ash::Entry, instance: &ash::Instance) -> Result<Self, vk::Result> {
        let utils = ext::debug_utils::Instance::new(entry, instance);
        let kept = Arc::<Mutex<Vec<String>>>::default();
        let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            )
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(keep))
            .user_data(Arc::as_ptr(&kept).cast_mut().cast());
        // SAFETY: the instance has the extension; what `user_data` points to goes after the messenger.
        let messenger = unsafe { utils.create_debug_utils_messenger(&create, None) }?;
        Ok(Self { utils, messenger, kept })
    }

    /// All so far; none are to come.
    pub fn end(self) -> Vec<String> {
        // SAFETY: the instance is still there, by `Gpu`, and nothing else has the messenger.
        unsafe { self.utils.destroy_debug_utils_messenger(self.messenger, None) };
        std::mem::take(&mut *self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

extern "system" fn keep(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    kept: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer hands on valid data, and the list that the messenger was made with.
    let (message, kept) = unsafe { ((*data).message_as_c_str(), &*kept.cast::<Mutex<Vec<String>>>()) };
    let message = message.map(|m| m.to_string_lossy().into_owned()).unwrap_or_default();
    kept.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    vk::FALSE
}
