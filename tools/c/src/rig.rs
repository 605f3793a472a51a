//! Cameras of every kind: rigs, and views of them.

use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;

use decouplegs::asset::cameras_from_text;
use decouplegs::scene::{Camera, Intrinsics, Motion, Pose, Rig, RigCamera, Sensor};
use decouplegs::session::save_png;
use glam::DVec3;

use crate::arguments::{array, give_text, one, out, out_handle, text};
use crate::batch_renderer::{BATCH_RENDERERS, DgsBatchRenderer, Seen};
use crate::boundary::{Call, guarded};
use crate::handles::Registry;
use crate::scene::{DgsScene, SCENES};
use crate::status::{DgsStatus, Failure};
use crate::types::{DgsCamera, DgsImage, DgsImageKind, DgsPose};
use crate::world::DgsWorld;

/// Cameras of every kind on one vehicle: with lenses, rolling shutters, windshields and photometric
/// calibrations.
pub struct DgsRig(());

pub static RIGS: Registry<Arc<Rig>> = Registry::new("rig");

/// A world, and a rig that looks at it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DgsRigView {
    /// World to render. The same world may be in many views.
    pub world: *const DgsWorld,
    /// Rig; all its cameras are drawn, in its order.
    pub rig: *const DgsRig,
    /// Pose of the rig: world from rig.
    pub world_from_rig: DgsPose,
    /// Velocity of the rig, along the axes of the world, meters per second. Rolling shutters and
    /// images of flow show it.
    pub velocity_mps: [f64; 3],
    /// Rotation vector of the rig per second, in its own axes, radians per second.
    pub turn_rad_per_s: [f64; 3],
}

/// The rig that a text describes, to be closed: TOML with the [[rig]] tables of a scene file, or
/// JSON: such a table as an object, an array of them, or an object whose "rig" is that array. The
/// keys are those of engine/asset/scene-file.md: width_px, height_px, fx_px, fy_px, cx_px, cy_px,
/// position_m, rotation_wxyz or look, lens, shutter, photometry, windshield, name. The first three
/// are needed; a camera without the others is a pinhole at the origin of the rig.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_rig_from_text(
    description: *const c_char,
    rig: *mut *mut DgsRig,
) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers.
        let (made, description) =
            unsafe { (out_handle("rig", rig)?, text("description", description)?) };
        let cameras = cameras_from_text(description)
            .map_err(|reason| Failure::argument(format!("description: {reason}")))?;
        made.write(RIGS.add(Arc::new(Rig::from_iter(cameras))));
        Ok(())
    })
}

/// The cameras of a scene's own rig, to be closed; NOT_FOUND for a file of splats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_rig(scene: *const DgsScene, rig: *mut *mut DgsRig) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let made = unsafe { out_handle("rig", rig) }?;
        let held = SCENES.find(call, scene)?;
        let mut cameras = held.scene.rig().clone();
        cameras
            .sensors
            .retain(|sensor| matches!(sensor, Sensor::Camera(_)));
        if cameras.sensors.is_empty() {
            return Err(Failure::not_found(
                "the scene has no cameras: describe some with dgs_rig_from_text()",
            ));
        }
        made.write(RIGS.add(Arc::new(cameras)));
        Ok(())
    })
}

/// Closes a rig.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_rig_close(rig: *mut DgsRig) -> DgsStatus {
    guarded(|_| RIGS.close(rig))
}

/// Number of cameras of a rig.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_rig_camera_count(rig: *const DgsRig, count: *mut usize) -> DgsStatus {
    guarded(|call| {
        let held = RIGS.find(call, rig)?;
        // SAFETY: as the header asks of all pointers.
        let count = unsafe { out("count", count) }?;
        count.write(held.cameras().count());
        Ok(())
    })
}

/// The name of camera `index` of a rig, from 0. `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_rig_camera_name(
    rig: *const DgsRig,
    index: usize,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        let held = RIGS.find(call, rig)?;
        let count = held.cameras().count();
        let mut cameras = held.cameras();
        let camera: &RigCamera = cameras.nth(index).ok_or_else(|| {
            let text = format!("the rig has no camera {index}: it has {count}, counted from 0");
            Failure::not_found(text)
        })?;
        // SAFETY: as the header asks of all pointers.
        unsafe { give_text(&camera.name, buffer, capacity, length) }
    })
}

/// Draws `count` views of rigs, at least one, as dgs_batch_renderer_draw() draws views of pinholes.
/// Camera `index` of a view's images is that of its rig.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_draw_rigs(
    renderer: *mut DgsBatchRenderer,
    views: *const DgsRigView,
    count: usize,
) -> DgsStatus {
    guarded(|call| {
        let held = BATCH_RENDERERS.find(call, renderer)?;
        let mut drawing = held.lock()?;
        drawing.forget();
        // SAFETY: as the header asks of all pointers; a view is of handles and numbers.
        let views = unsafe { array("views", views, count) }?;
        let seen = views.iter().enumerate().map(|(index, view)| {
            let world = held.world(call, index, view.world)?;
            let cameras = cameras_of(call, index, view)?;
            Ok(Seen { world, cameras })
        });
        let seen = seen.collect::<Result<Vec<_>, Failure>>()?;
        drawing.draw_seen(&seen)
    })
}

/// The cameras of view number `index` in the world.
fn cameras_of(call: &mut Call, index: usize, view: &DgsRigView) -> Result<Vec<Camera>, Failure> {
    let subject = format!("view {index}");
    let rig = RIGS
        .find(call, view.rig)
        .map_err(|failure| failure.with_subject(&subject))?;
    let pose = view
        .world_from_rig
        .to_pose(&format!("the rig of view {index}"))?;
    let motion = Motion {
        velocity_mps: DVec3::from_array(view.velocity_mps),
        turn_rad_per_s: DVec3::from_array(view.turn_rad_per_s),
    };
    motion
        .check()
        .map_err(|reason| Failure::argument(format!("{subject}: {reason}")))?;
    Ok(rig.moving_at(&pose, &motion))
}

/// A pinhole that looks from `eye` at `target`, with `up` up in its image: three doubles each,
/// meters. `fov_rad` is the horizontal field of view, above 0 and below pi.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_camera_look_at(
    width_px: u32,
    height_px: u32,
    fov_rad: f64,
    eye: *const f64,
    target: *const f64,
    up: *const f64,
    camera: *mut DgsCamera,
) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers; three doubles are aligned as one is.
        let (given, [eye, target, up]) = unsafe {
            let places = [
                three("eye", eye)?,
                three("target", target)?,
                three("up", up)?,
            ];
            (out("camera", camera)?, places)
        };
        if !(fov_rad > 0.0 && fov_rad < std::f64::consts::PI) {
            let text = format!("fov_rad is {fov_rad}: expected radians above 0 and below pi");
            return Err(Failure::argument(text));
        }
        let intrinsics = Intrinsics::from_horizontal_fov(width_px, height_px, fov_rad);
        intrinsics
            .check()
            .map_err(|fault| Failure::argument(fault.to_string()))?;
        let pose = Pose::look_at(eye, target, up)
            .filter(|pose| eye.is_finite() && pose.rotation.is_finite());
        let pose = pose.ok_or_else(|| {
            Failure::argument(format!(
                "eye is {eye}, target {target}, up {up}: expected finite numbers, another target than eye, and up across the view"
            ))
        })?;
        given.write(DgsCamera::from_camera(&Camera::new(
            "camera", intrinsics, pose,
        ))?);
        Ok(())
    })
}

/// Three numbers.
///
/// # Safety
/// `first` is NULL or points to three doubles.
unsafe fn three(what: &str, first: *const f64) -> Result<DVec3, Failure> {
    // SAFETY: promised by our caller.
    unsafe { one(what, first.cast::<[f64; 3]>()) }.map(DVec3::from_array)
}

/// A pinhole that shows all splats of a splat file: the middle 90 % of them on each axis. It stands
/// towards `direction`, with `up` up in its image: three doubles each, or NULL for what `decouplegs
/// render` has, with -y up for splat files. Scenes with cameras of their own are NOT_FOUND.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_frame(
    scene: *const DgsScene,
    width_px: u32,
    height_px: u32,
    direction: *const f64,
    up: *const f64,
    camera: *mut DgsCamera,
) -> DgsStatus {
    guarded(|call| {
        let held = SCENES.find(call, scene)?;
        // SAFETY: as the header asks of all pointers.
        let (given, direction, up) = unsafe {
            let some = |what: &str, first: *const f64| {
                (!first.is_null()).then(|| three(what, first)).transpose()
            };
            let (direction, up) = (some("direction", direction)?, some("up", up)?);
            (out("camera", camera)?, direction, up)
        };
        let framed = held.scene.frame([width_px, height_px], direction, up);
        let framed = framed.ok_or_else(|| {
            Failure::not_found(format!(
                "nothing is framed: expected a splat file without cameras of its own, a size above 0 and a direction across up, found {} cameras and {width_px}x{height_px} pixels",
                held.scene.rig().cameras().count()
            ))
        })?;
        given.write(DgsCamera::from_camera(&framed)?);
        Ok(())
    })
}

/// Writes an image of DGS_IMAGE_KIND_RGBA_U8 to a PNG file: red, green and blue. The file is there
/// whole or not at all, and replaces one that was there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_save_png(path: *const c_char, image: *const DgsImage) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers; an image is of numbers and a pointer.
        let (path, image) = unsafe { (text("path", path)?, one("image", image)?) };
        if image.kind != DgsImageKind::RgbaU8 as u32 || image.pixel_bytes != 4 {
            let text = format!(
                "the image is of kind {} with {} bytes a pixel: expected DGS_IMAGE_KIND_RGBA_U8 with 4",
                image.kind, image.pixel_bytes
            );
            return Err(Failure::argument(text));
        }
        let row_bytes = 4 * image.width_px as usize;
        if image.height_px == 0 || image.width_px == 0 || image.row_bytes < row_bytes {
            let text = format!(
                "the image is {}x{} with {} bytes a row: expected at least 1x1, and 4 bytes a pixel",
                image.width_px, image.height_px, image.row_bytes
            );
            return Err(Failure::argument(text));
        }
        let rows = image.height_px as usize - 1;
        let bytes = image
            .row_bytes
            .checked_mul(rows)
            .and_then(|bytes| bytes.checked_add(row_bytes));
        let bytes = bytes.ok_or_else(|| Failure::argument("the image is larger than memory"))?;
        // SAFETY: the pixels of an image are where it says, and bytes are of any value.
        let pixels = unsafe { array("data of image", image.data.cast::<u8>(), bytes) }?;
        let rows = pixels.chunks(image.row_bytes);
        let rgba: Vec<u8> = rows.flat_map(|row| &row[..row_bytes]).copied().collect();
        Ok(save_png(
            Path::new(path),
            [image.width_px, image.height_px],
            &rgba,
        )?)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_of_a_rig_stays_as_it_was_published() {
        assert_eq!(size_of::<DgsRigView>(), 120);
    }
}
