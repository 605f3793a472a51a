//! Frame times of a drive.

use anyhow::Result;
use decouplegs::gpu::Gpu;
use decouplegs::render::{ColorFormat, Outputs, RenderOptions, Renderer, ResidentSplats};
use decouplegs::scene::SplatScene;
use decouplegs::{Session, World, asset::LoadedScene};

use crate::stress::drive_schedule::DriveSchedule;
use crate::stress::figures::Measured;

/// Least number of frames before the timed ones.
const WARM_UP_FRAMES: u32 = 2;
/// Interval between frames, seconds.
const STEP_S: f64 = 0.1;

/// Scene of the drive that is timed.
pub struct Speed<'a> {
    pub gpu: &'a Gpu,
    pub scene: &'a LoadedScene,
    pub schedule: DriveSchedule,
}

impl<'a> Speed<'a> {
    /// `frames` timed frames from the middle moment on backwards and forwards: the middle of the
    /// drive is the middle of the frames.
    pub fn over(gpu: &'a Gpu, scene: &'a LoadedScene, frames: u32) -> Self {
        let cameras_used = scene.rig.cameras().count();
        let middle_s = 0.5 * (scene.ego.start_s() + scene.ego.end_s());
        let start_s = (middle_s - 0.5 * STEP_S * f64::from(frames)).max(scene.ego.start_s());
        let schedule = DriveSchedule {
            start_s,
            step_s: STEP_S,
            warm_up: WARM_UP_FRAMES,
            frames,
            samples: 0,
            cameras_used,
            standing: None,
        };
        Self {
            gpu,
            scene,
            schedule,
        }
    }

    /// Compressed agents that drive as `driven` says, two frames in flight.
    pub fn of_coded(&self, driven: &LoadedScene) -> Result<Measured> {
        let mut renderer = self.renderer(true, 2);
        let session = Session::on(self.gpu, &(*renderer.options()).into());
        let mut world = World::new(&session.add_scene(driven)?);
        self.drive(&mut renderer, |renderer, time_s| {
            world.set_time(time_s);
            let cameras = self.schedule.cameras(self.scene, time_s);
            Ok(world.lend(|splats| renderer.submit(splats, &cameras))?)
        })
    }

    /// Copies that stand, depth keys computed in every frame, two frames in flight: as `stress`
    /// measures vanilla.
    pub fn of_copies(&self, copies: SplatScene) -> Result<Measured> {
        let mut renderer = self.renderer(false, 2);
        let resident = renderer.upload(&SplatScene {
            instance_from_splat: Vec::new(),
            ..copies
        })?;
        self.drive(&mut renderer, |renderer, time_s| {
            Ok(renderer.submit(&resident, &self.schedule.cameras(self.scene, time_s))?)
        })
    }

    /// Copies that are made and uploaded anew in each frame, as they must be where agents drive or
    /// light changes.
    pub fn of_fresh_copies(&self, copies_at: impl Fn(f64) -> SplatScene) -> Result<Measured> {
        let mut renderer = self.renderer(false, 1);
        // Kept until the next frame: this one is drawn from it.
        let mut shown: Option<ResidentSplats> = None;
        self.drive(&mut renderer, |renderer, time_s| {
            let splat_scene = SplatScene {
                instance_from_splat: Vec::new(),
                ..copies_at(time_s)
            };
            let resident = shown.insert(renderer.upload(&splat_scene)?);
            Ok(renderer.submit(&*resident, &self.schedule.cameras(self.scene, time_s))?)
        })
    }

    fn renderer(&self, keep_keys: bool, frames_in_flight: usize) -> Renderer {
        let outputs = Outputs {
            color: ColorFormat::U8,
            ..Outputs::default()
        };
        Renderer::new(
            self.gpu,
            RenderOptions {
                outputs,
                keep_keys,
                frames_in_flight,
                ..RenderOptions::default()
            },
        )
    }

    fn drive(
        &self,
        renderer: &mut Renderer,
        submit: impl FnMut(&mut Renderer, f64) -> Result<()>,
    ) -> Result<Measured> {
        let driven = self.schedule.drive(renderer, submit)?;
        Ok(Measured::from_driven(&driven, self.gpu.memory()))
    }
}
