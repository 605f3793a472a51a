//! Readings and labels of one step of an episode.

use std::sync::Arc;

use anyhow::{Context, Result};
use decouplegs::asset::Layer;
use decouplegs::episode::{Moment, Site, reading_hash};
use decouplegs::gpu::Gpu;
use decouplegs::render::{ColorFormat, Image, Outputs, Plane};
use decouplegs::scene::bounding_box::{AgentBox, VisibleBox, agent_box, visible_boxes};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::lidar::ReturnOptions;
use decouplegs::scene::{Camera, LidarSweep, Motion, Pose, Rig, RoadUser};
use decouplegs::session::{
    AgentInstance, BatchRenderer, HostImages, Scene, Session, SessionOptions, World, WorldView,
};

/// Readings and labels of one step.
pub struct Sensed {
    /// Number of the step.
    pub step: u32,
    /// Time since the start of the episode, seconds.
    pub time_s: f64,
    /// Pose of the middle of the ego's box, world coordinates.
    pub ego: Pose,
    /// Road users on the map.
    pub agents: Vec<LabeledAgent>,
    /// One per camera of the rig.
    pub images: Vec<LabeledImage>,
    /// Sweep of the LiDAR that ends at the step, if there is one.
    pub sweep: Option<LidarSweep>,
}

/// Road user at a step.
pub struct LabeledAgent {
    /// Name; unique in the episode.
    pub name: String,
    /// Kind of road user.
    pub kind: RoadUser,
    /// Instance id in images and sweeps.
    pub instance: u16,
    /// Pose of the center of its box, world coordinates.
    pub pose: Pose,
    /// Length, width and height of its box, meters.
    pub dims_m: [f64; 3],
    /// Velocity and turn.
    pub motion: Motion,
}

/// Image with the boxes of the road users in it.
pub struct LabeledImage {
    /// Camera at the time of the step.
    pub camera: Camera,
    /// 8-bit RGBA, rows from the top.
    pub rgba: Vec<u8>,
    /// Instance id of each pixel; 0 for the background.
    pub instances: Vec<u16>,
    /// Boxes, in the order of [`Sensed::agents`]; `None` where an agent is not in the image.
    pub boxes: Vec<Option<Labeled>>,
}

/// One road user in one image.
#[derive(Clone, Copy)]
pub struct Labeled {
    /// 3D and amodal boxes.
    pub amodal: AgentBox,
    /// Box around the visible pixels, and their number; `None` where it is hidden.
    pub visible: Option<VisibleBox>,
    /// Pixels that it would have if nothing were before it.
    pub pixels_alone: u32,
}

impl Labeled {
    /// Share of its pixels in the image that are visible, from 0 to 1. A pixel belongs to the road
    /// user or surface with the largest weight.
    pub fn visible_fraction(&self) -> f64 {
        let visible = self.visible.map_or(0, |visible| visible.pixels);
        f64::from(visible.min(self.pixels_alone)) / f64::from(self.pixels_alone.max(1))
    }
}

impl Sensed {
    /// Cameras of which the log has an image of this size then, and whether it is this one.
    pub fn compared<'a>(
        &'a self,
        episode: &'a Episode,
    ) -> impl Iterator<Item = (&'a str, bool)> + 'a {
        let drawn_by = episode.head.drawn_by.as_ref();
        let size_px = drawn_by.map(|by| [by.width_px, by.height_px]);
        let readings = &episode.steps[self.step as usize].readings;
        self.images.iter().filter_map(move |image| {
            let k = &image.camera.intrinsics;
            let name = image.camera.name.as_str();
            let logged = readings.iter().find(|reading| reading.sensor == name)?;
            (size_px == Some([k.width_px, k.height_px]))
                .then(|| (name, reading_hash(&image.rgba) == logged.hash))
        })
    }

    /// Points of the sweep on an agent; 0 without a LiDAR.
    pub fn points_on(&self, agent: &LabeledAgent) -> usize {
        let returns = self.sweep.iter().flat_map(|sweep| &sweep.returns);
        returns
            .filter(|found| found.instance == agent.instance)
            .count()
    }
}

/// Renderers of images and labels, and the scenes that they draw.
pub struct Renderers {
    color: BatchRenderer,
    labels: BatchRenderer,
    images: HostImages,
    scene: Arc<Scene>,
    /// Agents of the scene over nothing.
    alone: Arc<Scene>,
}

impl Renderers {
    /// Copies the scene of `site` to the device.
    pub fn new(gpu: &Gpu, site: &Site) -> Result<Self> {
        // Light as `drive` renders it: no image depends on those before.
        let options = SessionOptions {
            bakes_light_on_demand: false,
            ..SessionOptions::default()
        };
        let session = Session::on(gpu, &options);
        let mut of_labels = options;
        of_labels.render.outputs = Outputs {
            color: ColorFormat::F32,
            planes: [Plane::Instance].into(),
            ..Outputs::default()
        };
        let labels = Session::on(gpu, &of_labels);
        Ok(Self {
            color: session.batch_renderer(),
            labels: labels.batch_renderer(),
            images: HostImages::default(),
            scene: site.add_to(&session)?,
            alone: session.add_layer(&site.loaded, Layer::Agents)?,
        })
    }

    /// Scene of the place.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Readings of `rig` at `moment`, at which a step begins, with their labels.
    pub fn sense(&mut self, episode: &Episode, rig: &Rig, moment: &Moment) -> Result<Sensed> {
        let step = moment.step.context("no step begins at this moment")?;
        let agents = labeled_agents(episode, &moment.world);
        let cameras = rig.moving_at(&moment.ego, &moment.motion);
        let mut images = Vec::with_capacity(cameras.len());
        if !cameras.is_empty() {
            let view = WorldView {
                world: &moment.world,
                cameras: &cameras,
            };
            self.color.draw(&[view], &mut self.images)?;
        }
        for (index, camera) in cameras.into_iter().enumerate() {
            let labels = self.labels(&moment.world, &camera)?;
            let instances = labels
                .instance()
                .context("the image has no instances")?
                .to_vec();
            let boxes = self.boxes(&moment.world, &agents, &camera, &instances)?;
            images.push(LabeledImage {
                rgba: self.images.rgba(0, index).to_vec(),
                camera,
                instances,
                boxes,
            });
        }
        let lidar = rig
            .sweeps_until(&moment.ego, &moment.motion)
            .into_iter()
            .next();
        let sweep = match &lidar {
            Some(lidar) => {
                let options = ReturnOptions::for_model(&lidar.model);
                let sweep_s = lidar.model.sweep_s;
                let traced = (self.color).trace(&moment.world, lidar, sweep_s, options.mode)?;
                Some(traced.returns(&options))
            }
            None => None,
        };
        Ok(Sensed {
            step,
            time_s: moment.time_s,
            ego: moment.ego,
            agents,
            images,
            sweep,
        })
    }

    /// Image with the plane of instances.
    fn labels(&mut self, world: &World, camera: &Camera) -> Result<Image> {
        let view = WorldView {
            world,
            cameras: std::slice::from_ref(camera),
        };
        let (mut images, _) = self.labels.draw_images(&[view])?;
        Ok(images.swap_remove(0).swap_remove(0))
    }

    fn boxes(
        &mut self,
        world: &World,
        agents: &[LabeledAgent],
        camera: &Camera,
        instances: &[u16],
    ) -> Result<Vec<Option<Labeled>>> {
        let ids = agents.iter().map(|agent| agent.instance);
        let highest = ids.chain(instances.iter().copied()).max().unwrap_or(0);
        let width_px = camera.intrinsics.width_px;
        let visible = visible_boxes(instances, width_px, usize::from(highest) + 1);
        let mut boxes = Vec::with_capacity(agents.len());
        for agent in agents {
            let Some(amodal) = agent_box(camera, &agent.pose, agent.dims_m) else {
                boxes.push(None);
                continue;
            };
            let mut alone = World::empty(&self.alone);
            let placed = world.agents().iter().find(|one| one.name == agent.name);
            let placed: Vec<(String, AgentInstance)> = placed
                .map(|one| (one.name.clone(), one.placed))
                .into_iter()
                .collect();
            alone.set_agents(placed)?;
            // As in an image with a background: a pixel is its own where it hides more than half.
            let image = self.labels(&alone, camera)?;
            let pixels_alone = image.alpha.iter().filter(|alpha| **alpha >= 0.5).count();
            boxes.push(Some(Labeled {
                amodal,
                visible: visible[usize::from(agent.instance)],
                pixels_alone: pixels_alone as u32,
            }));
        }
        Ok(boxes)
    }
}

fn labeled_agents(episode: &Episode, world: &World) -> Vec<LabeledAgent> {
    let head = &episode.head;
    let count = head.agent_sizes.len();
    let present = world.agents().iter().filter(|agent| agent.present);
    let labeled = present.filter_map(|agent| {
        // Lamps and signs come after the road users.
        let index = usize::from(agent.placed.instance).checked_sub(1)?;
        (index < count).then(|| LabeledAgent {
            name: agent.name.clone(),
            kind: head.scenario.agent(index).1,
            instance: agent.placed.instance,
            pose: agent.placed.pose,
            dims_m: head.agent_sizes[index].to_array(),
            motion: agent.placed.motion,
        })
    });
    labeled.collect()
}
