//! Loads a scene file: its world and its agents.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use decouplegs_scene::light::{
    AmbientField, AmbientOptions, CastingLights, GroundLight, Lighting, LitAgent, RelightOptions,
    ShadowOptions, bake_shadows,
};
use decouplegs_scene::{
    CodedCloud, GroundShadow, LightTransfer, Motion, Photometry, Pose, Presence, Rig, Sensor,
    ShFrame, SplatCloud, SplatScene, Trajectory,
};
use glam::DVec3;

use super::files::{Folder, SceneFiles};
use super::{LoadedRecording, SceneAgent, SceneFile, SceneSky, is_scene_file};
use crate::memory::{self, SPLATS_MAX, cloud_bytes};
use crate::packed_scene::{is_package, open_packed_scene};
use crate::sky_bundle;
use crate::{AssetError, SkyKind, coded_asset, light_transfer_file, read_placed_splats};

/// A scene, ready to be drawn: what stands still at one moment, and what is moved from frame to
/// frame.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedScene {
    /// Background, and the agents whose assets are plain splat files as they stand at the moment
    /// asked for. Each plain file's splats are in spatial order.
    pub splat_scene: SplatScene,
    /// Compressed assets (`.safetensors`), each file once.
    pub assets: Vec<CodedCloud>,
    /// The agents that show them, in the order of the scene file.
    pub agents: Vec<LoadedAgent>,
    /// The agents of plain splat files that are in [`LoadedScene::splat_scene`].
    pub plain_agents: Vec<PlainAgent>,
    /// The ego vehicle's sensors; none for a splat file.
    pub rig: Rig,
    /// Trajectory of the ego vehicle, world coordinates.
    pub ego: Trajectory,
    /// Height of the ego's poses above the road, meters, where it is known.
    pub ego_height_m: Option<f64>,
    /// Drive on which the scene was recorded.
    pub recording: LoadedRecording,
    /// Names and classes of all agents of both kinds; the instance id of agent `i` is `i + 1`.
    pub agent_labels: Vec<AgentLabel>,
    /// Light of the background on the moving agents.
    pub light: Option<LoadedLight>,
    /// Photometric calibrations that come with the sky, by the names of cameras.
    pub photometry_by_camera: Vec<(String, Photometry)>,
}

/// Name and class of an agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentLabel {
    /// Names the agent; unique in the scene.
    pub name: String,
    /// Class of what it shows; `None` if it is unknown.
    pub class: Option<String>,
}

impl AgentLabel {
    /// The label of `agent`.
    #[must_use]
    pub fn from_agent(agent: &SceneAgent) -> Self {
        Self {
            name: agent.name.clone(),
            class: agent.class.clone(),
        }
    }
}

/// The light of a loaded scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadedLight {
    /// Effect of light on colors.
    pub transfer: Option<LightTransfer>,
    /// Options of that effect.
    pub relighting: RelightOptions,
    /// Distance from which that light is gathered, and its grid.
    pub ambient: AmbientOptions,
    /// Contact shadows.
    pub shadows: Option<ShadowOptions>,
    /// Lights that cast shadows.
    pub casting: CastingLights,
}

/// Pose and box of an agent whose asset is a plain splat file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlainAgent {
    /// Instance id, from 1: its position among all agents of the scene file.
    pub instance: u16,
    /// Pose, world coordinates.
    pub pose: Pose,
    /// Motion at the same moment.
    pub motion: Motion,
    /// Length, width and height of the box around the means of its splats, meters.
    pub dims_m: [f32; 3],
}

/// An agent that shows a compressed asset.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedAgent {
    /// Names the agent; unique in the scene.
    pub name: String,
    /// Index of its asset in [`LoadedScene::assets`].
    pub asset: usize,
    /// Instance id, from 1: its position among all agents of the scene file.
    pub instance: u16,
    /// Frame of the asset's colors.
    pub sh_frame: ShFrame,
    /// Trajectory, world coordinates.
    pub trajectory: Trajectory,
    /// Times at which it is in the scene.
    pub present: Presence,
}

impl LoadedAgent {
    /// Pose at `time_s`, world coordinates; `None` where it is absent.
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Option<Pose> {
        let present = self.present.includes(time_s);
        present.then(|| self.trajectory.at(time_s))
    }
}

impl LoadedScene {
    /// A scene of background only, without cameras.
    #[must_use]
    pub fn of_world(splat_scene: SplatScene) -> Self {
        Self {
            splat_scene,
            assets: Vec::new(),
            agents: Vec::new(),
            plain_agents: Vec::new(),
            rig: Rig::default(),
            ego: Trajectory::standing(Pose::IDENTITY),
            ego_height_m: None,
            recording: LoadedRecording::default(),
            agent_labels: Vec::new(),
            light: None,
            photometry_by_camera: Vec::new(),
        }
    }

    /// The calibration that comes with the sky for the camera called `name`; the identity for
    /// others.
    #[must_use]
    pub fn photometry_of_camera(&self, name: &str) -> Photometry {
        photometry_of(&self.photometry_by_camera, name)
    }

    /// Checks that [`LoadedScene::baked`] is a world that the memory holds: thousands of agents may
    /// show one small asset.
    ///
    /// # Errors
    /// [`AssetError::Placement`] with the splats or bytes.
    pub fn check_baked(&self) -> Result<(), AssetError> {
        let finest = |agent: &LoadedAgent| {
            self.assets[agent.asset]
                .levels
                .first()
                .copied()
                .unwrap_or(0) as u64
        };
        let splats =
            self.splat_scene.splats.len() as u64 + self.agents.iter().map(finest).sum::<u64>();
        let sh_degree = self
            .assets
            .iter()
            .map(|asset| asset.sh_degree)
            .max()
            .unwrap_or(0)
            .max(self.splat_scene.splats.sh_degree);
        if splats > SPLATS_MAX {
            return Err(AssetError::Placement(format!(
                "with all agents decoded there are {splats} splats; at most {SPLATS_MAX} are read"
            )));
        }
        // Twice, as a list that grows is copied.
        memory::require(
            &format!("a scene of {splats} decoded splats"),
            2 * cloud_bytes(splats, sh_degree),
        )
        .map_err(|error| AssetError::Placement(error.into()))
    }

    /// The uncompressed twin: [`LoadedScene::splat_scene`] with the finest level of every agent
    /// added that is present at `time_s`, where it is then, in order, in the scene's light. What
    /// was in the scene already stays as it stands.
    #[must_use]
    pub fn baked(&self, time_s: f64) -> SplatScene {
        let mut splat_scene = self.splat_scene.clone();
        let lighting = self.lighting();
        let agents = self.agents.iter();
        let lit: Vec<(&LoadedAgent, Pose, Option<LitAgent>)> = agents
            .filter_map(|agent| {
                let (pose, dims_m) = (agent.pose_at(time_s)?, self.assets[agent.asset].dims_m);
                let lit = lighting
                    .as_ref()
                    .map(|lighting| lighting.of_agent(&pose, dims_m, agent.sh_frame));
                Some((agent, pose, lit))
            })
            .collect();
        // Before there are agents in it, which shadows do not lie on.
        let shadows: Vec<GroundShadow> = lit
            .iter()
            .filter_map(|(_, _, lit)| lit.as_ref())
            .flat_map(|lit| lit.shadows.iter().copied())
            .collect();
        bake_shadows(&mut splat_scene, &shadows);
        let decoded: Vec<SplatCloud> = self.assets.iter().map(|asset| asset.decoded(0)).collect();
        for (agent, pose, lit) in lit {
            let asset = &decoded[agent.asset];
            let relit = lit.and_then(|lit| lit.relit(asset));
            splat_scene.bake_instance(
                relit.as_ref().unwrap_or(asset),
                &pose,
                agent.sh_frame,
                agent.instance,
            );
        }
        splat_scene
    }

    /// The light of the background, its field baked where agents drive; `None` where the scene has
    /// none.
    #[must_use]
    pub fn lighting(&self) -> Option<Lighting> {
        let light = self.light.as_ref()?;
        let mut field = AmbientField::with_normals(
            (&self.splat_scene.splats, self.normals()),
            self.background_splats(),
            self.splat_scene.origin,
            &light.ambient,
        );
        field.bake(
            self.agents
                .iter()
                .flat_map(|agent| places_along(&agent.trajectory, light.ambient.spacing_m)),
        );
        let ways = self.agents.iter().map(|agent| &agent.trajectory);
        let places = ways
            .chain([&self.ego])
            .flat_map(|way| places_along(way, light.ambient.spacing_m));
        let ground_light = light.relighting.by_normals.then(|| {
            let patches = field.ground_along(places, GroundLight::LANE_M);
            GroundLight::from_patches(&patches, &light.casting)
        });
        Some(Lighting {
            ground_light: ground_light.flatten(),
            field,
            transfer: light.transfer.clone(),
            relighting: light.relighting,
            shadows: light.shadows,
            casting: light.casting.clone(),
        })
    }
}

/// The calibration of the camera called `name`, of pairs by name; the identity for others.
fn photometry_of(cameras: &[(String, Photometry)], name: &str) -> Photometry {
    let found = cameras.iter().find(|(camera, _)| camera == name);
    found.map_or(Photometry::IDENTITY, |(_, photometry)| *photometry)
}

/// Places along a trajectory, world coordinates, at most `step_m` apart: where its light is summed
/// up beforehand.
fn places_along(trajectory: &Trajectory, step_m: f64) -> impl Iterator<Item = DVec3> {
    let knots: Vec<DVec3> = trajectory
        .poses()
        .iter()
        .map(|timed| timed.pose.translation)
        .collect();
    let between = move |pair: &[DVec3]| {
        let (from, to) = (pair[0], pair[1]);
        // A teleport is no road.
        let steps = ((to - from).length() / step_m).ceil().clamp(1.0, 4096.0) as usize;
        (0..steps).map(move |step| from.lerp(to, step as f64 / steps as f64))
    };
    let along: Vec<DVec3> = knots.windows(2).flat_map(between).collect();
    along.into_iter().chain(knots.last().copied())
}

impl SceneFile {
    /// Loads background and agents, whose paths are relative to `directory`. Agents of plain splat
    /// files stand where they are at `time_s`; those that are absent then are left out.
    ///
    /// # Errors
    /// [`AssetError`] of the file at fault, or when there are more agents than ids.
    pub fn load(&self, directory: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
        self.load_from(&Folder(directory), time_s)
    }

    /// The ego vehicle's sensors, with the models of its LiDARs and the calibrations that come with
    /// its sky. Paths are relative to `directory`.
    ///
    /// # Errors
    /// [`AssetError`] of the file at fault.
    pub fn loaded_rig(&self, directory: &Path) -> Result<Rig, AssetError> {
        let files = Folder(directory);
        let sky = self.sky_map.as_ref().filter(|sky| sky.kind == SkyKind::Npz);
        let bundle = sky.map(|sky| files.sky(sky)).transpose()?;
        let cameras = bundle.map(|bundle| bundle.cameras).unwrap_or_default();
        self.rig_from(&files, &cameras)
    }

    fn rig_from(
        &self,
        files: &dyn SceneFiles,
        cameras: &[(String, Photometry)],
    ) -> Result<Rig, AssetError> {
        let mut rig = self.rig.clone();
        for camera in rig.cameras_mut() {
            let own = &mut camera.intrinsics.photometry;
            *own = own.or(photometry_of(cameras, &camera.name));
        }
        for lidar in &self.lidars {
            rig.sensors.push(Sensor::Lidar(lidar.load(files)?));
        }
        Ok(rig)
    }

    /// Loads like [`SceneFile::load`], from `files`.
    pub(crate) fn load_from(
        &self,
        files: &dyn SceneFiles,
        time_s: f64,
    ) -> Result<LoadedScene, AssetError> {
        let background = files.placed_splats(&self.background)?.in_spatial_order();
        let recording = self.recording.load(files, &background, self.origin)?;
        let sky = self.sky_map.as_ref().map(|sky| files.sky(sky));
        let (sky_map, cameras) = sky
            .transpose()?
            .map(|bundle| (Arc::new(bundle.sky), bundle.cameras))
            .unzip();
        let mut scene = LoadedScene::of_world(SplatScene {
            origin: self.origin + background.origin,
            sky: self.sky,
            sky_map,
            sky_splats: background.labels.sky,
            normals: background.labels.normals,
            photometry: self.photometry,
            fog: self.fog,
            rules: self.rules,
            ..SplatScene::from_splats(background.cloud)
        });
        scene.recording = recording;
        scene.photometry_by_camera = cameras.unwrap_or_default();
        let mut loader = AgentLoader {
            files,
            time_s,
            plain: HashMap::new(),
            coded: HashMap::new(),
            checked_splats: 0,
        };
        loader.read_assets(&mut scene, &self.agents)?;
        for (index, agent) in self.agents.iter().enumerate() {
            let instance = u16::try_from(index + 1).map_err(|_| {
                AssetError::Placement(format!(
                    "agent {}: more than {} agents in one world",
                    agent.name,
                    u16::MAX
                ))
            })?;
            loader.add(&mut scene, agent, instance);
        }
        scene.rig = self.rig_from(files, &scene.photometry_by_camera)?;
        let standing = || {
            Trajectory::standing(Pose {
                translation: self.origin,
                ..Pose::IDENTITY
            })
        };
        scene.ego = self.ego.clone().unwrap_or_else(standing);
        scene.ego_height_m = self.ego_height_m;
        if let Some(light) = &self.light {
            let read = |file: &PathBuf| {
                light_transfer_file::read_from(&files.bytes(file)?, &files.path(file))
            };
            let transfer = light
                .transfer
                .as_ref()
                .map(read)
                .transpose()?
                .map(|file| file.transfer);
            scene.light = Some(LoadedLight {
                transfer,
                relighting: light.relighting,
                ambient: light.ambient,
                shadows: light.shadows,
                casting: light.casting.clone(),
            });
        }
        scene.agent_labels = self.agents.iter().map(AgentLabel::from_agent).collect();
        Ok(scene)
    }
}

/// Adds agents to a scene. Many may show one asset: it is read once.
struct AgentLoader<'a> {
    files: &'a dyn SceneFiles,
    time_s: f64,
    plain: HashMap<PathBuf, SplatCloud>,
    /// Splats for which memory was found.
    checked_splats: u64,
    /// Places in [`LoadedScene::assets`].
    coded: HashMap<PathBuf, usize>,
}

impl AgentLoader<'_> {
    /// Checks that the memory holds `splats` splats and as many more, as a list that is full grows
    /// to twice its size: 500 agents may show one small file.
    fn check_size(&mut self, splats: u64, sh_degree: u8) -> Result<(), AssetError> {
        if splats > SPLATS_MAX {
            let message = format!(
                "background and agents have more than {SPLATS_MAX} splats, which is no scene: compress the agents"
            );
            return Err(AssetError::Placement(message));
        }
        if splats <= self.checked_splats {
            return Ok(());
        }
        self.checked_splats = 2 * splats;
        let what = format!("a scene of {splats} splats and more, with its agents,");
        memory::require(&what, cloud_bytes(self.checked_splats, sh_degree))
            .map_err(|error| AssetError::Placement(error.into()))
    }

    /// Reads the assets that agents show, each file once, and checks that the memory holds the
    /// background with all plain splats before the first are placed in it.
    fn read_assets(
        &mut self,
        scene: &mut LoadedScene,
        agents: &[SceneAgent],
    ) -> Result<(), AssetError> {
        let background = &scene.splat_scene.splats;
        let (mut splats, mut sh_degree) = (background.len() as u64, background.sh_degree);
        for agent in agents {
            let file = &agent.asset;
            if coded_asset::has_extension(file) {
                if !self.coded.contains_key(file) {
                    let (bytes, path) = (self.files.bytes(file)?, self.files.path(file));
                    self.coded.insert(file.clone(), scene.assets.len());
                    scene
                        .assets
                        .push(coded_asset::read_from(&bytes, &path)?.cloud);
                }
                continue;
            }
            if !self.plain.contains_key(file) {
                let cloud = self.files.splats(file)?.in_spatial_order();
                self.plain.insert(file.clone(), cloud);
            }
            let cloud = &self.plain[file];
            if agent.present.includes(self.time_s) {
                splats += cloud.len() as u64;
            }
            sh_degree = sh_degree.max(cloud.sh_degree);
            self.check_size(splats, sh_degree)?;
        }
        Ok(())
    }

    /// Adds an agent whose asset was read.
    fn add(&self, scene: &mut LoadedScene, agent: &SceneAgent, instance: u16) {
        let file = &agent.asset;
        if let Some(asset) = self.plain.get(file) {
            if agent.present.includes(self.time_s) {
                let pose = agent.trajectory.at(self.time_s);
                let sh_frame = agent.sh_frame.unwrap_or_default();
                scene
                    .splat_scene
                    .bake_instance(asset, &pose, sh_frame, instance);
                scene.plain_agents.push(PlainAgent {
                    instance,
                    pose,
                    motion: agent.trajectory.motion_at(self.time_s),
                    dims_m: asset.bounds().half_extent().map(|half_m| 2.0 * half_m),
                });
            }
            return;
        }
        let asset = self.coded[file];
        scene.agents.push(LoadedAgent {
            name: agent.name.clone(),
            asset,
            instance,
            sh_frame: agent.sh_frame.unwrap_or(scene.assets[asset].sh_frame),
            trajectory: agent.trajectory.clone(),
            present: agent.present.clone(),
        });
    }
}

/// Opens what a user calls a scene: a scene file (`.toml`) or a package of one (`.usdz`), loaded as
/// at `time_s`, or a splat file, which becomes a world of background only without cameras, its
/// origin at zero unless its coordinates are large doubles.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub fn open_scene(path: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
    if is_scene_file(path) {
        let directory = path.parent().unwrap_or(Path::new(""));
        return SceneFile::read(path)?.load(directory, time_s);
    }
    if is_package(path) {
        return open_packed_scene(path, time_s);
    }
    open_splats(path)
}

/// The scene of a splat file, with the sky of Instant NuRec where there is one beside it.
fn open_splats(path: &Path) -> Result<LoadedScene, AssetError> {
    let is_ply = path.extension().is_some_and(|found| found == "ply");
    let sky = path.with_extension(sky_bundle::EXTENSION);
    if is_ply && sky.is_file() {
        let name = |path: &Path| PathBuf::from(path.file_name().unwrap_or_default());
        let scene = SceneFile {
            sky_map: Some(SceneSky::new(name(&sky), SkyKind::Npz)),
            ..SceneFile::of_background(name(path))
        };
        return scene.load(path.parent().unwrap_or(Path::new("")), 0.0);
    }
    let splats = read_placed_splats(path)?.in_spatial_order();
    let road_m = splats.road_points_m().into_iter();
    let ground_m = road_m.map(|point| point + splats.origin).collect();
    Ok(LoadedScene {
        recording: LoadedRecording {
            ground_m,
            ..LoadedRecording::default()
        },
        ..LoadedScene::of_world(SplatScene {
            origin: splats.origin,
            sky_splats: splats.labels.sky,
            normals: splats.labels.normals,
            ..SplatScene::from_splats(splats.cloud)
        })
    })
}
