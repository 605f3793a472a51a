//! Places made ready: what an episode needs of where it takes place.

mod assets;
mod standing;
mod views;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use decouplegs_asset::memory::{self, cloud_bytes};
use decouplegs_asset::{
    AssetError, LoadedLight, LoadedScene, SceneFile, read_map, read_obstacles, read_probe,
};
use decouplegs_drive::generate::RoadUserAsset;
use decouplegs_drive::lights::{LaneStopLine, TrafficLights};
use decouplegs_drive::signs::TrafficSigns;
use decouplegs_drive::{
    Ground, GroundGuides, GroundOptions, Obstacles, RoadGraph, RoadParts, RoadSurface, Survey,
    ViewSupport, occupancy,
};
use decouplegs_scene::episode::StopLineRecord;
use decouplegs_scene::light::{AmbientOptions, CastingLights, RelightOptions, ShadowOptions};
use decouplegs_scene::scenario::Place;
use decouplegs_scene::{
    LaneMap, LightColor, LightTransfer, Obstacle, Pose, Rig, RoadUser, SignKind, SplatScene,
    Trajectory, VehicleSize, Weather,
};
use decouplegs_session::{Scene, Session, SessionError};
use decouplegs_synth::probes::probe_of;
use decouplegs_synth::roads::{self, RoadsOptions};
use decouplegs_synth::street::signals::{SignalHead, head_assets, post_assets, sign_assets};
use decouplegs_synth::street::{AssetLight, Capture, Street, StreetOptions};
use decouplegs_train::compress::CompressError;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

use self::assets::{
    ALL_CARS, Cars, ROAD_USER_SPLATS, cars, coded, road_users, road_users_coded, size_of,
    street_cars,
};
use self::views::support_of;

/// Reason why a site cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SiteError {
    /// A file of the site cannot be used.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// A generated asset.
    #[error("a car of the street cannot be coded")]
    Compress(#[from] CompressError),
    /// The lanes form no roads, or the scene has no splats.
    #[error("{0}")]
    Unfit(String),
}

/// Appearance options of a site.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Appearance {
    /// Effect of light on the colors of agents on a synthetic site; `None`: they keep their
    /// captured colors. Scene files have their own.
    pub transfer: Option<LightTransfer>,
    /// Leave out the assets of trucks, buses, cyclists and pedestrians, whose compression takes
    /// seconds: no scenario that has some can then be driven.
    pub only_cars: bool,
}

/// Place of episodes, loaded: splats, lanes, obstacles and ground.
pub struct Site {
    /// Splats to render; none if nothing is visible.
    pub loaded: LoadedScene,
    /// Lanes of the place.
    pub lanes: LaneMap,
    /// Lanes as a graph for traffic.
    pub graph: Arc<RoadGraph>,
    /// Road surface, for vehicles that may leave their lanes.
    pub surface: RoadSurface,
    /// Junctions, crossings and edges of lanes, for scores.
    pub parts: RoadParts,
    /// Static things that the ego can hit.
    pub obstacles: Arc<Obstacles>,
    /// Boxes of the assets that agents may show: the first ones of the scene.
    pub asset_sizes: Vec<VehicleSize>,
    /// Assets of trucks, buses, cyclists and pedestrians, the last ones of the scene.
    pub road_users: Vec<RoadUserAsset>,
    /// Assets that show the color of traffic lights, where the place has such.
    pub signals: Option<Signals>,
    /// The ground that was captured, where it was.
    ground: Option<Ground>,
    /// Places and headings that the place was seen from, where it was not from everywhere.
    view_support: Option<Arc<ViewSupport>>,
}

/// Assets of traffic lights and signs: green, yellow and red, stop and yield, after those of cars.
#[derive(Clone, Debug, PartialEq)]
pub struct Signals {
    /// Heads of the place, by light. None: a post stands beside each stop line.
    pub heads: Option<Vec<SignalHead>>,
}

/// Post of a traffic light: distance from the end of its stop line, meters.
const POST_M: f64 = 0.8;
/// Ends of stop lines nearer than this are those of lanes beside each other, meters.
const BESIDE_M: f64 = 0.5;

/// The ground is looked for within this of the lane's height, meters: less than there is between
/// two decks.
const GROUND_BAND_M: f64 = 1.0;

impl Site {
    /// Light is summed up along lanes in steps of this, meters: what its field is spaced by.
    pub const LIGHT_STEP_M: f64 = 1.0;

    /// `place` made ready, its files relative to `directory`. Without a `appearance` nothing is
    /// made that is only to be seen.
    ///
    /// # Errors
    /// Returns an error if a file is at fault, or lanes or assets are missing.
    pub fn open(
        place: &Place,
        directory: &Path,
        appearance: Option<&Appearance>,
    ) -> Result<Self, SiteError> {
        if let (
            Some(_),
            Place::Street {
                background,
                agent_splats,
                ..
            }
            | Place::Roads {
                background,
                agent_splats,
                ..
            },
        ) = (appearance, place)
        {
            let splats = (*background as u64)
                .saturating_add((*agent_splats as u64).saturating_mul(ALL_CARS as u64));
            let what = format!("a place of {background} splats with cars of {agent_splats}");
            // Twice, as lists are sorted into copies.
            memory::require(&what, cloud_bytes(splats, 0).saturating_mul(2))
                .map_err(|error| SiteError::Unfit(error.into()))?;
        }
        match place {
            Place::Street {
                weather,
                background,
                agent_splats,
                seed,
            } => Self::street(*weather, [*background, *agent_splats], *seed, appearance),
            Place::Roads {
                map,
                probe,
                exposure_ev,
                air,
                obstacles,
                background,
                agent_splats,
            } => {
                let objects = match obstacles {
                    Some(file) => read_obstacles(&directory.join(file))?,
                    None => Vec::new(),
                };
                let lanes = read_map(&directory.join(map))?;
                let cars = cars(
                    *agent_splats * usize::from(appearance.is_some()),
                    AssetLight::Neutral,
                );
                let Some(appearance) = appearance else {
                    let mut obstacles = roads::obstacles(&lanes, RoadsOptions::default().seed);
                    obstacles.extend(objects);
                    return Self::bare(lanes, obstacles, cars.sizes);
                };
                let read = |probe: &PathBuf| read_probe(&directory.join(probe));
                let probe = match (probe, air.weather) {
                    (Some(probe), _) => Some(read(probe)?),
                    (None, weather) => weather.map(probe_of),
                };
                let options = RoadsOptions {
                    objects,
                    ..RoadsOptions::new(*background, probe, *exposure_ev)
                };
                let drawn = roads::generate(&lanes, &options);
                let splat_scene = SplatScene {
                    origin: drawn.origin,
                    sky: drawn.sky,
                    fog: air.fog(drawn.sky),
                    ..SplatScene::from_splats(drawn.background)
                };
                let cars = Cars {
                    signals: post_assets().into_iter().chain(sign_assets()).collect(),
                    ..cars
                };
                let site =
                    Self::synthetic((lanes, drawn.obstacles), splat_scene, cars, appearance)?;
                Ok(Self {
                    signals: Some(Signals { heads: None }),
                    ..site
                })
            }
            Place::Scene {
                scene,
                map,
                obstacles,
            } => Self::captured(
                &directory.join(scene),
                read_map(&directory.join(map))?,
                obstacles.as_ref().map(|file| directory.join(file)),
                appearance,
            ),
        }
    }

    fn street(
        weather: Weather,
        [background, agent_splats]: [usize; 2],
        seed: u64,
        appearance: Option<&Appearance>,
    ) -> Result<Self, SiteError> {
        // Cars that no light is put on are shown in the sun of their capture.
        let asset_light = match appearance {
            Some(Appearance {
                transfer: Some(_), ..
            }) => AssetLight::Neutral,
            _ => AssetLight::Sun,
        };
        let cars = cars(
            agent_splats * usize::from(appearance.is_some()),
            asset_light,
        );
        let background = background * usize::from(appearance.is_some());
        let capture = Capture::Lanes;
        let options = StreetOptions {
            background,
            agents: 0,
            seed,
            weather,
            capture,
            ..StreetOptions::default()
        };
        let street = Street::generate(&options);
        let Some(appearance) = appearance else {
            return Self::bare(street.lanes, street.obstacles, cars.sizes);
        };
        let splat_scene = SplatScene {
            sky: street.sky,
            ..SplatScene::from_splats(street.background)
        };
        let cars = Cars {
            signals: head_assets().into_iter().chain(sign_assets()).collect(),
            ..cars
        };
        let site = Self::synthetic(
            (street.lanes, street.obstacles),
            splat_scene,
            cars,
            appearance,
        )?;
        Ok(Self {
            signals: Some(Signals {
                heads: Some(street.signal_heads),
            }),
            ..site
        })
    }

    /// Site without splats, for episodes that are not rendered.
    fn bare(
        lanes: LaneMap,
        obstacles: Vec<Obstacle>,
        asset_sizes: Vec<VehicleSize>,
    ) -> Result<Self, SiteError> {
        let loaded = LoadedScene::of_world(SplatScene::default());
        Self::new(loaded, (lanes, obstacles), asset_sizes, None)
    }

    fn synthetic(
        map: (LaneMap, Vec<Obstacle>),
        mut splat_scene: SplatScene,
        cars: Cars,
        appearance: &Appearance,
    ) -> Result<Self, SiteError> {
        splat_scene.splats = splat_scene.splats.in_spatial_order();
        let assets = cars
            .clouds
            .par_iter()
            .zip(&cars.sizes)
            .map(|(cloud, size)| coded(cloud, size));
        let mut assets = assets.collect::<Result<Vec<_>, _>>()?;
        for cloud in &cars.signals {
            let bounds = cloud.bounds();
            let dims_m = std::array::from_fn(|axis| bounds.max[axis] - bounds.min[axis]);
            assets.push(coded(cloud, &size_of(dims_m))?);
        }
        if !appearance.only_cars {
            assets.extend(road_users_coded(cars.splats, cars.light)?);
        }
        let light = LoadedLight {
            transfer: appearance.transfer.clone(),
            relighting: RelightOptions::default(),
            ambient: AmbientOptions::default(),
            shadows: Some(ShadowOptions::default()),
            casting: CastingLights::default(),
        };
        let loaded = LoadedScene {
            assets,
            rig: cars.rig,
            light: Some(light),
            ..LoadedScene::of_world(splat_scene)
        };
        Self::new(loaded, map, cars.sizes, None)
    }

    fn captured(
        scene: &Path,
        lanes: LaneMap,
        obstacles: Option<PathBuf>,
        appearance: Option<&Appearance>,
    ) -> Result<Self, SiteError> {
        let obstacles = obstacles.as_deref().map(read_obstacles).transpose()?;
        let (mut loaded, dims_m) = match appearance {
            Some(_) => {
                let loaded = decouplegs_session::open_movable_scene(scene)?.0;
                let dims_m = loaded.assets.iter().map(|asset| asset.dims_m).collect();
                (loaded, dims_m)
            }
            // Cars of plain splats take time to compress: only where they are seen.
            None => decouplegs_session::measure_movable_scene(scene)?,
        };
        // Traffic replaces the vehicles that drove when the scene was captured.
        loaded.agents.clear();
        loaded.agent_labels.clear();
        let mut sizes: Vec<VehicleSize> = dims_m.into_iter().map(size_of).collect();
        if sizes.is_empty() {
            // A scene without agents of its own is driven in among the cars of the street.
            (loaded.assets, sizes) = street_cars(appearance.is_some())?;
        }
        if appearance.is_some_and(|appearance| !appearance.only_cars) {
            let coded = road_users_coded(ROAD_USER_SPLATS, AssetLight::Neutral)?;
            loaded.assets.extend(coded);
        }
        let options = GroundOptions {
            band_m: GROUND_BAND_M,
            ..GroundOptions::default()
        };
        let survey = Survey::from_points(std::mem::take(&mut loaded.recording.ground_m));
        let guides = GroundGuides {
            survey: survey.as_ref(),
            map: Some(&lanes),
            ..GroundGuides::for_way(loaded.ego.poses(), loaded.ego_height_m)
        };
        let (splats, origin) = (&loaded.splat_scene.splats, loaded.splat_scene.origin);
        let ground = Ground::new(splats, origin, &options).guided(splats, guides);
        let solid = &loaded.splat_scene.without_sky_splats().splats;
        let obstacles = obstacles
            .or_else(|| loaded.recording.obstacles.clone())
            .unwrap_or_else(|| occupancy::obstacles(solid, origin, &lanes, &ground));
        let view_support = support_of(&loaded).map(Arc::new);
        let mut site = Self::new(loaded, (lanes, obstacles), sizes, Some(ground))?;
        site.view_support = view_support;
        Ok(site)
    }

    fn new(
        loaded: LoadedScene,
        (lanes, obstacles): (LaneMap, Vec<Obstacle>),
        asset_sizes: Vec<VehicleSize>,
        ground: Option<Ground>,
    ) -> Result<Self, SiteError> {
        let graph =
            Arc::new(RoadGraph::new(&lanes).map_err(|error| SiteError::Unfit(error.into()))?);
        let surface = RoadSurface::new(&lanes);
        let parts = RoadParts::new(&lanes, &graph);
        Ok(Self {
            loaded,
            parts,
            lanes,
            graph,
            surface,
            obstacles: Arc::new(Obstacles::new(obstacles)),
            asset_sizes,
            road_users: road_users(),
            signals: None,
            ground,
            view_support: None,
        })
    }

    /// Places and headings that the place was seen from: elsewhere its images are no good. `None`
    /// where it looks right from everywhere, or nobody knows.
    #[must_use]
    pub fn view_support(&self) -> Option<&Arc<ViewSupport>> {
        self.view_support.as_ref()
    }

    /// The way that the place was recorded on; `None` where there is none.
    #[must_use]
    pub fn recorded_way(&self) -> Option<&Trajectory> {
        Some(&self.loaded.ego).filter(|way| way.poses().len() > 1)
    }

    /// Index in the scene of the asset that an agent shows. Indices beyond the last of its kind
    /// start over.
    pub(super) fn asset_of(&self, kind: RoadUser, asset: usize) -> usize {
        let cars = self.asset_sizes.len();
        if kind == RoadUser::Car {
            return asset % cars.max(1);
        }
        let indices = 0..self.road_users.len();
        let mut same = indices.filter(|&index| self.road_users[index].kind == kind);
        let count = same.clone().count();
        let signals = match self.signals {
            Some(_) => LightColor::ALL.len() + SignKind::ALL.len(),
            None => 0,
        };
        cars + signals
            + same
                .nth(asset % count)
                .expect("the place has assets of every kind")
    }

    /// Index in the scene of the asset that shows a traffic light in a color.
    pub(super) fn signal_asset(&self, color: LightColor) -> usize {
        self.asset_sizes.len() + color as usize
    }

    /// Index in the scene of the asset of a sign.
    pub(super) fn sign_asset(&self, kind: SignKind) -> usize {
        self.asset_sizes.len() + LightColor::ALL.len() + kind as usize
    }

    /// Poses of the assets that show traffic lights, with the index of each one's light.
    pub(super) fn signal_poses(&self, lights: &TrafficLights) -> Vec<(usize, Pose)> {
        match &self.signals {
            None => Vec::new(),
            Some(Signals { heads: Some(heads) }) => heads
                .iter()
                .filter_map(|head| Some((lights.find(head.light)?, head.pose)))
                .collect(),
            Some(Signals { heads: None }) => self.posts(lights),
        }
    }

    /// Kinds and poses of the signs that the place shows: none where it was captured.
    pub(super) fn sign_poses(&self, signs: &TrafficSigns) -> Vec<(SignKind, Pose)> {
        if self.signals.is_none() {
            return Vec::new();
        }
        let lines = signs.lines().iter();
        let sign = |line: &LaneStopLine| {
            let kind = signs.kind(line.record.index);
            (kind, self.post(line.lane, &line.record))
        };
        lines.map(sign).collect()
    }

    /// A post to the right of each stop line that has none of the same light beside it.
    fn posts(&self, lights: &TrafficLights) -> Vec<(usize, Pose)> {
        let records = || lights.lines().iter().map(|line| (line.lane, line.record));
        let outer = records().filter(|(_, line)| {
            !records().any(|(_, other)| {
                other.index == line.index && other.ends_m[1].distance(line.ends_m[0]) < BESIDE_M
            })
        });
        outer
            .map(|(lane, line)| (line.index, self.post(lane, &line)))
            .collect()
    }

    /// Pose of a post to the right of a line on a lane.
    fn post(&self, lane: usize, line: &StopLineRecord) -> Pose {
        let ahead = line.ahead();
        let foot_m = line.ends_m[0] + ahead.rotate(DVec2::NEG_Y) * POST_M;
        let lane_z_m = self.lanes.lanes[lane].centerline[0].z;
        let z_m = self.surface.height_at(line.middle_m(), lane_z_m);
        let foot_m = foot_m.extend(z_m.unwrap_or(lane_z_m));
        Pose::from_yaw(ahead.to_angle(), foot_m)
    }

    /// Adds the site to `session`, with light baked along its lanes. A [`super::Rollout`] moves the
    /// agents of worlds over it.
    ///
    /// # Errors
    /// Returns the errors of [`Session::add_scene`].
    pub fn add_to(&self, session: &Session) -> Result<Arc<Scene>, SessionError> {
        let scene = session.add_scene(&self.loaded)?;
        scene.bake_light(self.positions(Self::LIGHT_STEP_M));
        Ok(scene)
    }

    /// Points along its lanes, `step_m` apart, at which light is baked.
    pub fn positions(&self, step_m: f64) -> impl Iterator<Item = DVec3> + '_ {
        self.lanes.lanes.iter().flat_map(move |lane| {
            lane.centerline.windows(2).flat_map(move |pair| {
                let steps = (pair[0].distance(pair[1]) / step_m)
                    .ceil()
                    .clamp(1.0, 4096.0) as u32;
                (0..steps)
                    .map(move |step| pair[0].lerp(pair[1], f64::from(step) / f64::from(steps)))
            })
        })
    }
}

/// The cameras of the ego in `place`, its files relative to `directory`.
///
/// # Errors
/// Returns an error if the scene file is at fault.
pub fn rig_of(place: &Place, directory: &Path) -> Result<Rig, SiteError> {
    match place {
        Place::Scene { scene, .. } => Ok(SceneFile::read(&directory.join(scene))?.rig),
        Place::Street { .. } | Place::Roads { .. } => Ok(cars(0, AssetLight::Neutral).rig),
    }
}
