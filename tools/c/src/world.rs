//! Worlds: agents over a scene.

use std::ffi::c_char;
use std::sync::{Arc, RwLock, RwLockReadGuard, RwLockWriteGuard};

use decouplegs::session::{Session, World, WorldAgent};

use crate::arguments::{give_text, one, out, out_handle, text};
use crate::boundary::guarded;
use crate::handles::{Registry, to_change, to_read};
use crate::scene::{DgsScene, HeldScene, SCENES, moment};
use crate::status::{DgsStatus, Failure};
use crate::types::{DgsAgent, DgsPose};

/// A set of agents over a scene.
pub struct DgsWorld(());

/// Object behind a world handle.
pub struct HeldWorld {
    pub session: Arc<Session>,
    world: RwLock<World>,
}

pub static WORLDS: Registry<HeldWorld> = Registry::new("world");

impl HeldWorld {
    fn new(session: &Arc<Session>, world: World) -> Self {
        Self {
            session: session.clone(),
            world: RwLock::new(world),
        }
    }

    /// Locks the world for reading, with others.
    pub fn read(&self) -> Result<RwLockReadGuard<'_, World>, Failure> {
        to_read("world", &self.world)
    }

    /// Locks the world for changes, alone.
    fn write(&self) -> Result<RwLockWriteGuard<'_, World>, Failure> {
        to_change("world", &self.world)
    }
}

/// A world with the agents of the scene file, where they are at time 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_new(
    scene: *const DgsScene,
    world: *mut *mut DgsWorld,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe { begin(scene, world, |held| World::new(&held.scene)) }
}

/// A world without agents.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_new_empty(
    scene: *const DgsScene,
    world: *mut *mut DgsWorld,
) -> DgsStatus {
    // SAFETY: as the header asks of all pointers.
    unsafe { begin(scene, world, |held| World::empty(&held.scene)) }
}

/// A world over `scene`, into `world`.
///
/// # Safety
/// `world` is NULL or as the header asks.
unsafe fn begin(
    scene: *const DgsScene,
    world: *mut *mut DgsWorld,
    of: impl FnOnce(&HeldScene) -> World,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: promised by our caller.
        let begun = unsafe { out_handle("world", world) }?;
        let held = SCENES.find(call, scene)?;
        begun.write(WORLDS.add(HeldWorld::new(&held.session, of(&held))));
        Ok(())
    })
}

/// Another world with agents as those of `world` are now. Over the same scene, they go their own
/// ways from here on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_clone(
    world: *const DgsWorld,
    copy: *mut *mut DgsWorld,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let copy = unsafe { out_handle("copy", copy) }?;
        let held = WORLDS.find(call, world)?;
        let cloned = held.read()?.clone();
        copy.write(WORLDS.add(HeldWorld::new(&held.session, cloned)));
        Ok(())
    })
}

/// Closes a world.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_close(world: *mut DgsWorld) -> DgsStatus {
    guarded(|_| WORLDS.close(world))
}

/// Puts the agents of the scene file that are still here where that has them at `time_s`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_set_time(world: *mut DgsWorld, time_s: f64) -> DgsStatus {
    guarded(|call| {
        let held = WORLDS.find(call, world)?;
        held.write()?.set_time(moment(time_s)?);
        Ok(())
    })
}

/// Moves the agent called `name`. One of plain splats is part of the background and cannot be
/// moved: DGS_STATUS_UNSUPPORTED.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_move(
    world: *mut DgsWorld,
    name: *const c_char,
    pose: *const DgsPose,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers; a pose is of numbers.
        let (name, pose) = unsafe { (text("name", name)?, one("pose", pose)?) };
        let pose = pose.to_pose(&format!("agent {name:?}"))?;
        Ok(WORLDS.find(call, world)?.write()?.move_to(name, pose)?)
    })
}

/// Adds an agent called `name` that shows asset number `asset`, or lets the one of that name show
/// it. Its number in images of instances goes into `instance`, which may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_place(
    world: *mut DgsWorld,
    name: *const c_char,
    asset: u32,
    pose: *const DgsPose,
    instance: *mut u32,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers; a pose is of numbers.
        let (name, pose) = unsafe { (text("name", name)?, one("pose", pose)?) };
        let pose = pose.to_pose(&format!("agent {name:?}"))?;
        let instance = if instance.is_null() {
            None
        } else {
            // SAFETY: likewise.
            Some(unsafe { out("instance", instance) }?)
        };
        let given = WORLDS
            .find(call, world)?
            .write()?
            .place(name, asset as usize, pose, None)?;
        if let Some(instance) = instance {
            instance.write(given.into());
        }
        Ok(())
    })
}

/// Takes the agent called `name` out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_remove(world: *mut DgsWorld, name: *const c_char) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let name = unsafe { text("name", name) }?;
        WORLDS.find(call, world)?.write()?.remove(name)?;
        Ok(())
    })
}

/// Number of agents of a world.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_agent_count(
    world: *const DgsWorld,
    count: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let count = unsafe { out("count", count) }?;
        count.write(WORLDS.find(call, world)?.read()?.agents().len());
        Ok(())
    })
}

/// The name of agent `index` of a world, from 0. `length` may be NULL. Removing an agent renumbers
/// those behind it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_agent_name(
    world: *const DgsWorld,
    index: usize,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        let held = WORLDS.find(call, world)?;
        let world = held.read()?;
        // SAFETY: as the header asks of all pointers.
        unsafe { give_text(&agent(&world, index)?.name, buffer, capacity, length) }
    })
}

/// Agent `index` of a world, from 0, as it stands.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_agent(
    world: *const DgsWorld,
    index: usize,
    agent: *mut DgsAgent,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let target = unsafe { out("agent", agent) }?;
        let held = WORLDS.find(call, world)?;
        let world = held.read()?;
        let placed = self::agent(&world, index)?.placed;
        target.write(DgsAgent {
            pose: DgsPose::from_pose(&placed.pose),
            asset: placed.asset as u32,
            instance: placed.instance.into(),
        });
        Ok(())
    })
}

/// 1 if agent `index` of a world is in its images, 0 where the scene file says that it is absent.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_world_agent_present(
    world: *const DgsWorld,
    index: usize,
    present: *mut u32,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let target = unsafe { out("present", present) }?;
        let held = WORLDS.find(call, world)?;
        let world = held.read()?;
        target.write(agent(&world, index)?.present.into());
        Ok(())
    })
}

fn agent(world: &World, index: usize) -> Result<&WorldAgent, Failure> {
    let agents = world.agents();
    let missing = || {
        Failure::not_found(format!(
            "the world has no agent {index}: it has {}, counted from 0",
            agents.len()
        ))
    };
    agents.get(index).ok_or_else(missing)
}
