//! The loader, the instance, and what the validation layer says.

use std::{
    collections::BTreeSet,
    ffi::{CStr, c_void},
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use ash::{ext, vk};

use crate::{GpuError, drivers, error::failed};

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Messages kept until they are taken; a frame in a loop that is wrong would otherwise fill
/// the memory.
const MESSAGES_MAX: usize = 1000;

/// Warnings and errors of the validation layer, oldest first.
type Messages = Mutex<Vec<String>>;

/// A Vulkan instance, with its messenger where validation is on.
pub(crate) struct Instance {
    pub(crate) raw: ash::Instance,
    /// True if `VK_EXT_debug_utils` is available, for names and labels.
    pub(crate) labels: bool,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    messages: Arc<Messages>,
    /// Libraries that were loaded before it.
    before: BTreeSet<PathBuf>,
    /// Keeps the loader's library open: declared last, dropped last.
    _entry: ash::Entry,
}

impl Instance {
    pub(crate) fn new(validation: bool) -> Result<Self, GpuError> {
        let before = drivers::loaded();
        // SAFETY: the system's Vulkan loader has no initialization duties, and `Instance` keeps the
        // library open while it is used.
        let entry = unsafe { ash::Entry::load() }.map_err(|error| GpuError::LoaderMissing {
            detail: error.to_string(),
        })?;
        if validation && !has_validation_layer(&entry)? {
            return Err(GpuError::ValidationMissing);
        }
        let labels = has_extension(&entry, None, ext::debug_utils::NAME)?;
        let mut extensions = Vec::new();
        if labels {
            extensions.push(ext::debug_utils::NAME.as_ptr());
        }
        let mut layers = Vec::new();
        if validation {
            layers.push(VALIDATION_LAYER.as_ptr());
            if has_extension(
                &entry,
                Some(VALIDATION_LAYER),
                ext::validation_features::NAME,
            )? {
                extensions.push(ext::validation_features::NAME.as_ptr());
            }
        }
        let raw = create(&entry, validation, &layers, &extensions)?;
        let messages = Arc::default();
        let messenger = if validation && labels {
            Some(listen(&entry, &raw, &messages)?)
        } else {
            None
        };
        Ok(Self {
            raw,
            labels,
            messenger,
            messages,
            before,
            _entry: entry,
        })
    }

    /// Warnings and errors since the last call.
    pub(crate) fn take_messages(&self) -> Vec<String> {
        std::mem::take(&mut *self.messages.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((debug, messenger)) = self.messenger.take() {
            // SAFETY: created from this instance, destroyed once, and no Vulkan call of this
            // instance runs any more.
            unsafe { debug.destroy_debug_utils_messenger(messenger, None) };
        }
        drivers::keep_since(&self.before);
        // SAFETY: everything made from the instance holds its context alive, so all of it is gone
        // when this runs.
        unsafe { self.raw.destroy_instance(None) };
    }
}

fn create(
    entry: &ash::Entry,
    validation: bool,
    layers: &[*const std::ffi::c_char],
    extensions: &[*const std::ffi::c_char],
) -> Result<ash::Instance, GpuError> {
    let application = vk::ApplicationInfo::default()
        .application_name(c"decouplegs")
        .engine_name(c"decouplegs")
        .api_version(vk::API_VERSION_1_3);
    let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
    let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
    let mut create = vk::InstanceCreateInfo::default()
        .application_info(&application)
        .enabled_layer_names(layers)
        .enabled_extension_names(extensions);
    if validation {
        create = create.push_next(&mut features);
    }
    // SAFETY: all pointers in `create` outlive the call, and its layers and extensions were found
    // to be present.
    unsafe { entry.create_instance(&create, None) }.map_err(|code| match code {
        // What the loader says when it finds no driver at all.
        vk::Result::ERROR_INCOMPATIBLE_DRIVER => GpuError::NoDevice,
        _ => failed("vkCreateInstance")(code),
    })
}

fn has_validation_layer(entry: &ash::Entry) -> Result<bool, GpuError> {
    // SAFETY: a query without preconditions.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }
        .map_err(failed("vkEnumerateInstanceLayerProperties"))?;
    Ok(layers
        .iter()
        .any(|layer| layer.layer_name_as_c_str() == Ok(VALIDATION_LAYER)))
}

fn has_extension(entry: &ash::Entry, layer: Option<&CStr>, name: &CStr) -> Result<bool, GpuError> {
    // SAFETY: a query; `layer`, where given, was found to be present.
    let extensions = unsafe { entry.enumerate_instance_extension_properties(layer) }
        .map_err(failed("vkEnumerateInstanceExtensionProperties"))?;
    Ok(extensions
        .iter()
        .any(|extension| extension.extension_name_as_c_str() == Ok(name)))
}

fn listen(
    entry: &ash::Entry,
    instance: &ash::Instance,
    messages: &Arc<Messages>,
) -> Result<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT), GpuError> {
    use vk::{
        DebugUtilsMessageSeverityFlagsEXT as Severity, DebugUtilsMessageTypeFlagsEXT as Type,
    };
    let debug = ext::debug_utils::Instance::new(entry, instance);
    let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(Severity::WARNING | Severity::ERROR)
        .message_type(Type::GENERAL | Type::VALIDATION | Type::PERFORMANCE)
        .pfn_user_callback(Some(keep_message))
        .user_data(Arc::as_ptr(messages).cast_mut().cast());
    // SAFETY: `Instance` holds `messages`, which the callback reads, until after the messenger is
    // destroyed.
    let messenger = unsafe { debug.create_debug_utils_messenger(&create, None) }
        .map_err(failed("vkCreateDebugUtilsMessengerEXT"))?;
    Ok((debug, messenger))
}

/// Validation callback; runs on the thread of the offending call.
unsafe extern "system" fn keep_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _types: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    messages: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: `listen` gave a pointer to `Messages` that outlives the messenger.
    let messages = unsafe { &*messages.cast::<Messages>() };
    // SAFETY: the layer hands a valid structure for the time of the call.
    let data = unsafe { &*data };
    // SAFETY: its message is a C string or null, valid as long.
    let text = unsafe { data.message_as_c_str() }
        .map_or_else(String::new, |text| text.to_string_lossy().into_owned());
    let mut messages = messages.lock().unwrap_or_else(PoisonError::into_inner);
    if messages.len() < MESSAGES_MAX {
        messages.push(text);
    }
    vk::FALSE
}
