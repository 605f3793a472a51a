//! Devices and sessions.

use std::sync::Arc;

use decouplegs::gpu::{DeviceChoice, Gpu};
use decouplegs::render::{ColorFormat, Storage};
use decouplegs::scene::Rules;
use decouplegs::session::{Session, SessionOptions};

use crate::arguments::{give_growing, growing, out, out_handle, text};
use crate::boundary::guarded;
use crate::handles::Registry;
use crate::status::{DgsStatus, Failure};
use crate::types::{DgsColor, DgsDevice, DgsSessionOptions};

/// A device and the scenes on it.
pub struct DgsSession(());

/// Sessions, shared with what was made of them: what belongs to different ones must not meet.
pub static SESSIONS: Registry<Arc<Session>> = Registry::new("session");

/// Writes the number of Vulkan devices, usable or not, to `count`. None is DGS_STATUS_DEVICE.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_device_count(count: *mut usize) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers.
        let count = unsafe { out("count", count) }?;
        count.write(Gpu::list()?.len());
        Ok(())
    })
}

/// Describes device number `index`, from 0, in `device`, whose `struct_bytes` is set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_device(index: usize, device: *mut DgsDevice) -> DgsStatus {
    guarded(|_| {
        let devices = Gpu::list()?;
        let info = devices.get(index).ok_or_else(|| {
            Failure::not_found(format!(
                "there is no device {index}: Vulkan finds {}, counted from 0",
                devices.len()
            ))
        })?;
        // SAFETY: as the header asks of all pointers.
        unsafe {
            give_growing(
                "device",
                device,
                DgsDevice::FIRST_BYTES,
                &DgsDevice::from_info(info),
            )
        }
    })
}

/// Opens a device. `options` may be NULL for the best device and images in bytes. With
/// DECOUPLEGS_VALIDATION=1 in the environment the Khronos validation layer watches, which is slow.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_session_open(
    options: *const DgsSessionOptions,
    session: *mut *mut DgsSession,
) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers.
        let session = unsafe { out_handle("session", session) }?;
        // SAFETY: likewise.
        let options = unsafe { session_options(options) }?;
        session.write(SESSIONS.add(Arc::new(Session::open(&options)?)));
        Ok(())
    })
}

/// Storage of the backgrounds' splats on the device.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsStorage {
    /// 152 bytes per splat of degree 3.
    Exact = 0,
    /// 120 bytes per splat of degree 3, with an error of less than one step of a byte.
    Compact = 1,
}

/// Options requested by the caller.
///
/// # Safety
/// `options` is NULL or as the header asks.
unsafe fn session_options(options: *const DgsSessionOptions) -> Result<SessionOptions, Failure> {
    let mut session = SessionOptions::default();
    if options.is_null() {
        return Ok(session);
    }
    // SAFETY: as the header asks of all pointers; the struct is of numbers and a pointer.
    let options = unsafe {
        growing(
            "options",
            options,
            DgsSessionOptions::FIRST_BYTES,
            DgsSessionOptions::DEFAULT,
        )
    }?;
    session.render.outputs.color = match options.color {
        color if color == DgsColor::U8 as u32 => ColorFormat::U8,
        color if color == DgsColor::F32 as u32 => ColorFormat::F32,
        other => {
            return Err(Failure::argument(format!(
                "color is {other}: expected a DgsColor, 0 or 1"
            )));
        }
    };
    session.render.storage = match options.storage {
        storage if storage == DgsStorage::Exact as u32 => Storage::Exact,
        storage if storage == DgsStorage::Compact as u32 => Storage::Compact,
        other => {
            return Err(Failure::argument(format!(
                "storage is {other}: expected a DgsStorage, 0 or 1"
            )));
        }
    };
    match options.background_pitch_px {
        0.0 => {}
        pitch_px if pitch_px.is_finite() && pitch_px > 0.0 => {
            session.render.background_pitch_px = Some(pitch_px);
        }
        other => {
            let text = format!("background_pitch_px is {other}: expected 0 or a positive number");
            return Err(Failure::argument(text));
        }
    }
    session.render.outputs.planes = options.planes()?;
    match options.flow_interval_s {
        0.0 => {}
        interval_s if interval_s.is_finite() && interval_s > 0.0 => {
            session.render.flow_interval_s = interval_s;
        }
        other => {
            let text = format!("flow_interval_s is {other}: expected 0 or a positive number");
            return Err(Failure::argument(text));
        }
    }
    if !options.device.is_null() {
        // SAFETY: as the header asks of all pointers.
        let Ok(choice) = unsafe { text("device", options.device) }?.parse::<DeviceChoice>();
        session.device.choice = choice;
    }
    if !options.rules.is_null() {
        // SAFETY: as the header asks of all pointers.
        let name = unsafe { text("rules", options.rules) }?;
        let rules = Rules::by_name(name).ok_or_else(|| {
            let names = Rules::NAMES.join(", ");
            Failure::argument(format!(
                "rules is {name:?}: expected NULL or one of {names}"
            ))
        })?;
        session.rules = Some(rules);
    }
    Ok(session)
}

/// Closes a session. Scenes, worlds and batch renderers that were made of it go on; the device is
/// let go with the last of them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_session_close(session: *mut DgsSession) -> DgsStatus {
    guarded(|_| SESSIONS.close(session))
}

/// Describes the device of a session in `device`, whose `struct_bytes` is set.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_session_device(
    session: *const DgsSession,
    device: *mut DgsDevice,
) -> DgsStatus {
    guarded(|call| {
        let session = SESSIONS.find(call, session)?;
        // SAFETY: as the header asks of all pointers.
        unsafe {
            give_growing(
                "device",
                device,
                DgsDevice::FIRST_BYTES,
                &DgsDevice::from_info(session.gpu().info()),
            )
        }
    })
}

/// Bytes that a session's scenes and batch renderers hold on the device.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_session_memory(
    session: *const DgsSession,
    bytes: *mut u64,
) -> DgsStatus {
    guarded(|call| {
        let session = SESSIONS.find(call, session)?;
        // SAFETY: as the header asks of all pointers.
        let bytes = unsafe { out("bytes", bytes) }?;
        bytes.write(session.gpu().memory().total_bytes);
        Ok(())
    })
}
