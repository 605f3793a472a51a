//! Scenes: what is on the device once for all worlds.

use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;

use decouplegs::asset::LoadedAgent;
use decouplegs::scene::{Pose, Rig, RigCamera};
use decouplegs::session::{Scene, Session};

use crate::arguments::{give_text, one, out, out_handle, text};
use crate::boundary::{Call, guarded};
use crate::handles::Registry;
use crate::session::{DgsSession, SESSIONS};
use crate::status::{DgsStatus, Failure};
use crate::types::{DgsAgent, DgsCamera, DgsPose};

/// A background, assets, a rig of cameras and a way of the ego vehicle.
pub struct DgsScene(());

/// Object behind a scene handle. Several may stand for the same scene.
pub struct HeldScene {
    pub session: Arc<Session>,
    pub scene: Arc<Scene>,
}

pub static SCENES: Registry<HeldScene> = Registry::new("scene");

/// Loads a scene file or a file of splats, unless another handle holds it already: a scene is on
/// the device once, and leaves it when its handles and worlds are closed. Each call gives a handle
/// of its own, to be closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_open(
    session: *const DgsSession,
    path: *const c_char,
    scene: *mut *mut DgsScene,
) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers.
        let (opened, path) = unsafe { (out_handle("scene", scene)?, text("path", path)?) };
        // A call of its own: a file whose reader panics leaves the session as good as it was.
        let session = Arc::clone(&*SESSIONS.find(&mut Call::default(), session)?);
        let scene = session.open_scene(Path::new(path))?;
        opened.write(SCENES.add(HeldScene { session, scene }));
        Ok(())
    })
}

/// Closes a handle of a scene. Worlds over the scene go on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_close(scene: *mut DgsScene) -> DgsStatus {
    guarded(|_| SCENES.close(scene))
}

/// Writes what `read` finds in a scene to `pointer`.
///
/// # Safety
/// `pointer` is NULL or as the header asks.
unsafe fn read<T>(
    scene: *const DgsScene,
    what: &str,
    pointer: *mut T,
    read: impl FnOnce(&Scene) -> Result<T, Failure>,
) -> DgsStatus {
    guarded(|call| {
        let held = SCENES.find(call, scene)?;
        // SAFETY: promised by our caller.
        let pointer = unsafe { out(what, pointer) }?;
        pointer.write(read(&held.scene)?);
        Ok(())
    })
}

/// Number of splats of the background.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_splat_count(
    scene: *const DgsScene,
    count: *mut usize,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "count", count, |scene| Ok(scene.background_splats())) }
}

/// Number of cameras of the rig: 0 for a file of splats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_camera_count(
    scene: *const DgsScene,
    count: *mut usize,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe {
        read(scene, "count", count, |scene| {
            Ok(scene.rig().cameras().count())
        })
    }
}

/// The name of camera `index` of the rig, from 0. `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_camera_name(
    scene: *const DgsScene,
    index: usize,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        let held = SCENES.find(call, scene)?;
        // SAFETY: as the header asks of all pointers.
        unsafe {
            give_text(
                &rig_camera(&held.scene, index)?.name,
                buffer,
                capacity,
                length,
            )
        }
    })
}

/// Camera `index` of the rig, where it is when the ego vehicle is where the scene file has it at
/// `time_s`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_camera_at(
    scene: *const DgsScene,
    index: usize,
    time_s: f64,
    camera: *mut DgsCamera,
) -> DgsStatus {
    let at = |scene: &Scene| camera_on(scene, index, &scene.ego().at(moment(time_s)?));
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "camera", camera, at) }
}

/// Camera `index` of the rig, where it is when the ego vehicle is at `ego`, world from ego.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_camera_on(
    scene: *const DgsScene,
    index: usize,
    ego: *const DgsPose,
    camera: *mut DgsCamera,
) -> DgsStatus {
    let on = |scene: &Scene| {
        // SAFETY: as the header asks of all pointers; a pose is of numbers.
        let ego = unsafe { one("ego", ego) }?;
        camera_on(scene, index, &ego.to_pose("the ego")?)
    };
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "camera", camera, on) }
}

fn rig_camera(scene: &Scene, index: usize) -> Result<&RigCamera, Failure> {
    let mut cameras = scene.rig().cameras();
    let missing = || {
        Failure::not_found(format!(
            "the rig has no camera {index}: it has {}, counted from 0",
            scene.rig().cameras().count()
        ))
    };
    cameras.nth(index).ok_or_else(missing)
}

fn camera_on(scene: &Scene, index: usize, ego: &Pose) -> Result<DgsCamera, Failure> {
    let rig = Rig::from_iter([rig_camera(scene, index)?.clone()]);
    DgsCamera::from_camera(&rig.at(ego)[0])
}

/// Start and end of the ego vehicle's trajectory, seconds. `start_s` and `end_s` are the same where
/// it stands.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_ego_span(
    scene: *const DgsScene,
    start_s: *mut f64,
    end_s: *mut f64,
) -> DgsStatus {
    guarded(|call| {
        let held = SCENES.find(call, scene)?;
        // SAFETY: as the header asks of all pointers.
        let (start_s, end_s) = unsafe { (out("start_s", start_s)?, out("end_s", end_s)?) };
        start_s.write(held.scene.ego().start_s());
        end_s.write(held.scene.ego().end_s());
        Ok(())
    })
}

/// Pose of the ego vehicle at `time_s` from the scene file: world from ego. Before its way begins
/// and after it ends, it stands.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_ego_at(
    scene: *const DgsScene,
    time_s: f64,
    pose: *mut DgsPose,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe {
        read(scene, "pose", pose, |scene| {
            Ok(DgsPose::from_pose(&scene.ego().at(moment(time_s)?)))
        })
    }
}

/// A moment, which must be one.
pub fn moment(time_s: f64) -> Result<f64, Failure> {
    if time_s.is_finite() {
        Ok(time_s)
    } else {
        Err(Failure::argument(format!(
            "the time is {time_s}: expected seconds"
        )))
    }
}

/// Number of movable agents in the scene file: those that a new world has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_agent_count(
    scene: *const DgsScene,
    count: *mut usize,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "count", count, |scene| Ok(scene.agents().len())) }
}

/// The name of agent `index` of the scene file, from 0. `length` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_agent_name(
    scene: *const DgsScene,
    index: usize,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        let held = SCENES.find(call, scene)?;
        // SAFETY: as the header asks of all pointers.
        unsafe {
            give_text(
                &loaded_agent(&held.scene, index)?.name,
                buffer,
                capacity,
                length,
            )
        }
    })
}

/// Agent `index` of the scene file, where that has it at `time_s`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_agent_at(
    scene: *const DgsScene,
    index: usize,
    time_s: f64,
    agent: *mut DgsAgent,
) -> DgsStatus {
    let at = |scene: &Scene| {
        let agent = loaded_agent(scene, index)?;
        let pose = DgsPose::from_pose(&agent.trajectory.at(moment(time_s)?));
        Ok(DgsAgent {
            pose,
            asset: agent.asset as u32,
            instance: agent.instance.into(),
        })
    };
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "agent", agent, at) }
}

/// 1 if agent `index` of the scene file is in the scene at `time_s`, otherwise 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_agent_present_at(
    scene: *const DgsScene,
    index: usize,
    time_s: f64,
    present: *mut u32,
) -> DgsStatus {
    let at = |scene: &Scene| {
        let agent = loaded_agent(scene, index)?;
        Ok(agent.present.includes(moment(time_s)?).into())
    };
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "present", present, at) }
}

fn loaded_agent(scene: &Scene, index: usize) -> Result<&LoadedAgent, Failure> {
    let agents = scene.agents();
    let missing = || {
        Failure::not_found(format!(
            "the scene has no agent {index} that moves: it has {}, counted from 0",
            agents.len()
        ))
    };
    agents.get(index).ok_or_else(missing)
}

/// Number of assets that agents may use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_asset_count(
    scene: *const DgsScene,
    count: *mut usize,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "count", count, |scene| Ok(scene.asset_count())) }
}

/// Length, width and height of the box of asset number `asset`, from 0, meters, into three floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_asset_size(
    scene: *const DgsScene,
    asset: u32,
    size_m: *mut f32,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers; three floats are aligned as one is.
    unsafe {
        read(scene, "size_m", size_m.cast::<[f32; 3]>(), |scene| {
            Ok(scene.asset_dims_m(asset as usize)?)
        })
    }
}

/// Copies another compressed asset (.safetensors) to the device, for all worlds over this scene.
/// Its number goes into `asset`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_add_asset(
    scene: *const DgsScene,
    path: *const c_char,
    asset: *mut u32,
) -> DgsStatus {
    let add = |scene: &Scene| {
        // SAFETY: as the header asks of all pointers.
        let path = unsafe { text("path", path) }?;
        Ok(scene.add_asset(Path::new(path))? as u32)
    };
    // SAFETY: as the header asks of all pointers.
    unsafe { read(scene, "asset", asset, add) }
}
