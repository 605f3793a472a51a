//! LiDARs and their sweeps.

use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;

use decouplegs::asset::read_lidar;
use decouplegs::scene::lidar::{PointFrame, ReturnMode, ReturnOptions};
use decouplegs::scene::{LidarModel, Motion, Pose, RigLidar};
use glam::DVec3;

use crate::arguments::{growing, out, out_handle, text};
use crate::batch_renderer::{BATCH_RENDERERS, DgsBatchRenderer};
use crate::boundary::guarded;
use crate::handles::Registry;
use crate::scene::{DgsScene, SCENES};
use crate::status::{DgsStatus, Failure};
use crate::types::{DgsLidarPoint, DgsPose};
use crate::world::{DgsWorld, WORLDS};

/// The model of a LiDAR.
pub struct DgsLidar(());

static LIDARS: Registry<Arc<LidarModel>> = Registry::new("LiDAR");

/// Frame of the points of a sweep. Only the motion of the sensor is compensated.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsPointFrame {
    /// The sensor at the end of the sweep: x forward, y left, z up.
    End = 0,
    /// The sensor at the start of the sweep.
    Start = 1,
    /// The sensor at the firing of each beam.
    Raw = 2,
    /// The world.
    World = 3,
}

/// Kind of range that a beam reports.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsReturn {
    /// Kind of range that the model has.
    OfModel = 0,
    /// Range of the splat at which half of the beam is gone.
    Median = 1,
    /// Mean range by weight.
    Expected = 2,
    /// Range of the splat that takes most.
    Strongest = 3,
    /// Up to two: ranges of the strongest and of the last group of splats.
    Dual = 4,
}

/// A sweep that is asked for.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct DgsSweepOptions {
    /// sizeof(DgsSweepOptions).
    pub struct_bytes: u32,
    /// A DgsPointFrame.
    pub frame: u32,
    /// A DgsReturn.
    pub returns: u32,
    /// Share of a beam that splats have to take for a return, above 0 and at most 1; 0 stands for
    /// 0.5.
    pub opacity_min: f32,
    /// Seed of the noise of ranges, for models that have some.
    pub seed: u64,
    /// Pose of the sensor at the end of the sweep: world from sensor.
    pub world_from_lidar: DgsPose,
    /// Velocity of the sensor during the sweep, along the axes of the world, meters per second.
    pub velocity_mps: [f64; 3],
    /// Rotation vector of the sensor per second, in its own axes, radians per second.
    pub turn_rad_per_s: [f64; 3],
}

impl DgsSweepOptions {
    /// Bytes of the first version.
    const FIRST_BYTES: usize = size_of::<Self>();
}

/// The model called `sensor` that comes with the library, such as "pandar128", or that of a file
/// (.toml, or the parameters of NVIDIA NCore as .json).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_lidar_open(
    sensor: *const c_char,
    lidar: *mut *mut DgsLidar,
) -> DgsStatus {
    guarded(|_| {
        // SAFETY: as the header asks of all pointers.
        let (opened, sensor) = unsafe { (out_handle("lidar", lidar)?, text("sensor", sensor)?) };
        let model =
            read_lidar(Path::new(sensor)).map_err(decouplegs::session::SessionError::from)?;
        opened.write(LIDARS.add(Arc::new(model)));
        Ok(())
    })
}

/// Closes a LiDAR.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_lidar_close(lidar: *mut DgsLidar) -> DgsStatus {
    guarded(|_| LIDARS.close(lidar))
}

/// Number of LiDARs of a scene's rig: 0 for a file of splats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_lidar_count(
    scene: *const DgsScene,
    count: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let count = unsafe { out("count", count) }?;
        count.write(SCENES.find(call, scene)?.scene.rig().lidars().count());
        Ok(())
    })
}

/// LiDAR `index` of a scene's rig, from 0, to be closed, and its pose on the vehicle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_scene_lidar(
    scene: *const DgsScene,
    index: usize,
    lidar: *mut *mut DgsLidar,
    rig_from_lidar: *mut DgsPose,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let (opened, pose) = unsafe {
            (
                out_handle("lidar", lidar)?,
                out("rig_from_lidar", rig_from_lidar)?,
            )
        };
        let held = SCENES.find(call, scene)?;
        let mut lidars = held.scene.rig().lidars();
        let missing = || {
            Failure::not_found(format!(
                "the rig has no LiDAR {index}: it has {}, counted from 0",
                held.scene.rig().lidars().count()
            ))
        };
        let found = lidars.nth(index).ok_or_else(missing)?;
        pose.write(DgsPose::from_pose(&found.rig_from_lidar));
        opened.write(LIDARS.add(found.model.clone()));
        Ok(())
    })
}

/// Beams of a LiDAR's sweep: no sweep has more points.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_lidar_beam_count(
    lidar: *const DgsLidar,
    count: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let count = unsafe { out("count", count) }?;
        count.write(LIDARS.find(call, lidar)?.beams().len());
        Ok(())
    })
}

/// Duration of a LiDAR's sweep, seconds.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_lidar_sweep_s(lidar: *const DgsLidar, sweep_s: *mut f64) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let sweep_s = unsafe { out("sweep_s", sweep_s) }?;
        sweep_s.write(LIDARS.find(call, lidar)?.sweep_s);
        Ok(())
    })
}

/// Traces one sweep of a LiDAR through a world and waits for it. Agents are where the world has
/// them at the end of the sweep. Its points replace those of the sweep before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_sweep(
    renderer: *mut DgsBatchRenderer,
    world: *const DgsWorld,
    lidar: *const DgsLidar,
    options: *const DgsSweepOptions,
) -> DgsStatus {
    guarded(|call| {
        let held = BATCH_RENDERERS.find(call, renderer)?;
        let mut drawing = held.lock()?;
        drawing.points.clear();
        let model = Arc::clone(&*LIDARS.find(call, lidar)?);
        let zero = DgsSweepOptions {
            struct_bytes: 0,
            frame: 0,
            returns: 0,
            opacity_min: 0.0,
            seed: 0,
            world_from_lidar: DgsPose::default(),
            velocity_mps: [0.0; 3],
            turn_rad_per_s: [0.0; 3],
        };
        // SAFETY: as the header asks of all pointers; the options are of numbers.
        let asked = unsafe { growing("options", options, DgsSweepOptions::FIRST_BYTES, zero) }?;
        let frame = match asked.frame {
            frame if frame == DgsPointFrame::End as u32 => PointFrame::End,
            frame if frame == DgsPointFrame::Start as u32 => PointFrame::Start,
            frame if frame == DgsPointFrame::Raw as u32 => PointFrame::Raw,
            frame if frame == DgsPointFrame::World as u32 => PointFrame::World,
            frame => {
                let text = format!("frame is {frame}: expected a DgsPointFrame, 0 to 3");
                return Err(Failure::argument(text));
            }
        };
        let mode = match asked.returns {
            mode if mode == DgsReturn::OfModel as u32 => model.returns,
            mode if mode == DgsReturn::Median as u32 => ReturnMode::Median,
            mode if mode == DgsReturn::Expected as u32 => ReturnMode::Expected,
            mode if mode == DgsReturn::Strongest as u32 => ReturnMode::Strongest,
            mode if mode == DgsReturn::Dual as u32 => ReturnMode::Dual,
            mode => {
                let text = format!("returns is {mode}: expected a DgsReturn, 0 to 4");
                return Err(Failure::argument(text));
            }
        };
        let opacity_min = match asked.opacity_min {
            0.0 => 0.5,
            share if share > 0.0 && share <= 1.0 => share,
            share => {
                let text = format!("opacity_min is {share}: expected 0 to 1");
                return Err(Failure::argument(text));
            }
        };
        let motion = Motion {
            velocity_mps: DVec3::from_array(asked.velocity_mps),
            turn_rad_per_s: DVec3::from_array(asked.turn_rad_per_s),
        };
        motion
            .check()
            .map_err(|fault| Failure::argument(fault.to_string()))?;
        let sensor = RigLidar {
            name: model.name.clone(),
            model,
            rig_from_lidar: Pose::IDENTITY,
        };
        let pose = asked.world_from_lidar.to_pose("the LiDAR")?;
        let placed = sensor.sweep_until(&pose, &motion);
        let world = WORLDS.find(call, world)?;
        let world = world.read()?;
        let sweep_s = placed.model.sweep_s;
        let traced = drawing.renderer.trace(&world, &placed, sweep_s, mode)?;
        let sweep = traced.returns(&ReturnOptions {
            mode,
            opacity_min,
            seed: asked.seed,
        });
        let points = sweep.points(frame);
        drawing.points = points.iter().map(DgsLidarPoint::from_point).collect();
        Ok(())
    })
}

/// The points of the last sweep, in the order of firing. They stay until the batch renderer traces
/// another sweep or is closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_batch_renderer_points(
    renderer: *const DgsBatchRenderer,
    points: *mut *const DgsLidarPoint,
    count: *mut usize,
) -> DgsStatus {
    guarded(|call| {
        // SAFETY: as the header asks of all pointers.
        let (target, length) = unsafe { (out("points", points)?, out("count", count)?) };
        let held = BATCH_RENDERERS.find(call, renderer)?;
        let drawing = held.lock()?;
        target.write(drawing.points.as_ptr());
        length.write(drawing.points.len());
        Ok(())
    })
}
