//! Contents of a scene file: cameras, LiDARs, the ego vehicle's trajectory, agents.

use std::borrow::Cow;
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use decouplegs_asset::{LoadedAgent, LoadedScene, SceneFile};
use decouplegs_scene::light::{CastingLights, GroundLight, Sun, Trust, ambient_by_definition};
use decouplegs_scene::{Presence, RigCamera, RigLidar, ShFrame, SplatScene, Trajectory};
use glam::DVec3;
use serde_json::{Value, json};

use super::summary::Lines;

/// Cameras, LiDARs, ego and agents of a scene.
pub struct Listing {
    cameras: Vec<RigCamera>,
    lidars: Vec<RigLidar>,
    ego: Trajectory,
    agents: Vec<Agent>,
    light: Option<Light>,
}

/// The light of the scene, and how far its field is from what it stands for.
struct Light {
    transfer: Option<PathBuf>,
    /// Albedo that the ground is taken to have; `None` without a transfer.
    ground_albedo: Option<f64>,
    /// True: colors follow the normals of splats.
    by_normals: bool,
    /// Light that the ground tells of.
    told: Option<GroundLight>,
    shadows: bool,
    casting: CastingLights,
    probes: usize,
    /// Start of each lit agent.
    starts: Vec<Start>,
    /// Largest error of the mean light.
    error: f64,
}

/// The light where an agent starts.
struct Start {
    instance: u16,
    /// Mean color and directionality of the light; `None` if the background has none.
    light: Option<([f32; 3], f64)>,
    /// Trust in the effect of that light on colors; `None` if nothing is known of its
    /// errors.
    trust: Option<Trust>,
}

struct Agent {
    instance: usize,
    name: String,
    asset: PathBuf,
    /// Splats of the asset, or of its finest level.
    splats: usize,
    sh_frame: &'static str,
    trajectory: Trajectory,
    present: Presence,
}

impl Listing {
    /// Lists `scene`, of which `loaded` was read and `splat_scene` baked.
    pub fn new(scene: &SceneFile, loaded: &LoadedScene, splat_scene: &SplatScene) -> Self {
        let mut splats = vec![0; scene.agents.len() + 1];
        splat_scene
            .instance_from_splat
            .iter()
            .for_each(|&instance| splats[usize::from(instance)] += 1);
        let by_instance: HashMap<usize, &LoadedAgent> = loaded
            .agents
            .iter()
            .map(|coded| (usize::from(coded.instance), coded))
            .collect();
        let agent = |(index, agent): (usize, &decouplegs_asset::SceneAgent)| {
            let coded = by_instance.get(&(index + 1));
            let sh_frame = coded.map_or_else(
                || agent.sh_frame.unwrap_or_default(),
                |coded| coded.sh_frame,
            );
            Agent {
                instance: index + 1,
                name: agent.name.clone(),
                asset: agent.asset.clone(),
                splats: splats[index + 1],
                sh_frame: if sh_frame == ShFrame::World {
                    "world"
                } else {
                    "canonical"
                },
                trajectory: agent.trajectory.clone(),
                present: agent.present.clone(),
            }
        };
        Self {
            cameras: scene.rig.cameras().cloned().collect(),
            lidars: loaded.rig.lidars().cloned().collect(),
            ego: loaded.ego.clone(),
            agents: scene.agents.iter().enumerate().map(agent).collect(),
            light: Light::new(scene, loaded),
        }
    }

    pub fn to_text(&self) -> String {
        let mut lines = Lines::default();
        lines.line("cameras", &self.cameras.len().to_string());
        for RigCamera {
            name,
            intrinsics,
            rig_from_camera,
        } in &self.cameras
        {
            let forward = rig_from_camera.rotation * DVec3::Z;
            let yaw_deg = forward.y.atan2(forward.x).to_degrees();
            let fov_deg = intrinsics.horizontal_fov_rad().to_degrees();
            let at = meters(rig_from_camera.translation);
            let (width_px, height_px) = (intrinsics.width_px, intrinsics.height_px);
            lines.line(
                "",
                &format!("{name}: {width_px}x{height_px}, {fov_deg:.1} degrees wide, at {at}, turned {yaw_deg:.1} degrees"),
            );
        }
        if !self.lidars.is_empty() {
            lines.line("LiDARs", &self.lidars.len().to_string());
        }
        for RigLidar {
            name,
            model,
            rig_from_lidar,
        } in &self.lidars
        {
            let (rows, columns) = (model.rings(), model.columns());
            let (at, rate_hz) = (meters(rig_from_lidar.translation), 1.0 / model.sweep_s);
            lines.line(
                "",
                &format!(
                    "{name}: {}, {rows} rows, {columns} columns, {rate_hz:.1} Hz, at {at}",
                    model.name
                ),
            );
        }
        lines.line("ego", &way_to_text(&self.ego));
        lines.line("agents", &self.agents.len().to_string());
        for Agent {
            instance,
            name,
            asset,
            splats,
            sh_frame,
            trajectory,
            present,
        } in &self.agents
        {
            let (asset, way) = (asset.display(), way_to_text(trajectory));
            let times = times_to_text(present);
            lines.line(
                "",
                &format!(
                    "{instance} {name}: {asset}, {splats} splats, colors {sh_frame}, {way}{times}"
                ),
            );
        }
        if let Some(light) = &self.light {
            light.add_to(&mut lines);
        }
        lines.into_text()
    }

    pub fn to_json(&self) -> Value {
        let camera = |camera: &RigCamera| {
            json!({
                "name": camera.name,
                "width_px": camera.intrinsics.width_px,
                "height_px": camera.intrinsics.height_px,
                "position_m": camera.rig_from_camera.translation.to_array(),
            })
        };
        let agent = |agent: &Agent| {
            let mut listed = json!({
                "instance": agent.instance,
                "name": agent.name,
                "asset": agent.asset.to_string_lossy(),
                "splats": agent.splats,
                "sh_frame": agent.sh_frame,
                "trajectory": way_to_json(&agent.trajectory),
            });
            if agent.present != Presence::ALWAYS {
                listed["present_s"] = json!(agent.present.intervals_s());
            }
            listed
        };
        let lidar = |lidar: &RigLidar| {
            json!({
                "name": lidar.name,
                "sensor": lidar.model.name,
                "rings": lidar.model.rings(),
                "columns": lidar.model.columns(),
                "sweep_s": lidar.model.sweep_s,
                "position_m": lidar.rig_from_lidar.translation.to_array(),
            })
        };
        json!({
            "cameras": self.cameras.iter().map(camera).collect::<Vec<_>>(),
            "lidars": self.lidars.iter().map(lidar).collect::<Vec<_>>(),
            "ego": way_to_json(&self.ego),
            "agents": self.agents.iter().map(agent).collect::<Vec<_>>(),
            "light": self.light.as_ref().map(Light::to_json),
        })
    }
}

impl Light {
    fn new(scene: &SceneFile, loaded: &LoadedScene) -> Option<Self> {
        let (file, lighting) = (scene.light.as_ref()?, loaded.lighting()?);
        let shadows = lighting.shadows.unwrap_or_default();
        // Agents of plain files stand behind the background.
        let instances = &loaded.splat_scene.instance_from_splat;
        let background = match instances.iter().position(|&instance| instance != 0) {
            Some(end) => Cow::Owned(
                loaded
                    .splat_scene
                    .splats
                    .select(&(0..end as u32).collect::<Vec<_>>()),
            ),
            None => Cow::Borrowed(&loaded.splat_scene.splats),
        };
        let (mut starts, mut error) = (Vec::new(), 0.0f64);
        for agent in &loaded.agents {
            let pose = &agent.trajectory.poses()[0].pose;
            let place = pose.translation;
            let found = lighting.field.at(place);
            let light = found.map(|light| (light.mean(), shadows.starkness(&light)));
            let (calibrated, known) = lighting.at(place);
            starts.push(Start {
                instance: agent.instance,
                light,
                trust: known
                    .then(|| lighting.trust(&calibrated, pose, agent.sh_frame))
                    .flatten(),
            });
            let truth = ambient_by_definition(
                &background,
                loaded.normals(),
                place - loaded.splat_scene.origin,
                &file.ambient,
            );
            if let (Some(found), Some(truth)) = (found, truth) {
                let off = found
                    .to_vector()
                    .iter()
                    .zip(truth.to_vector())
                    .fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
                error = error.max(off / f64::from(truth.coefficients[0][1]).max(1e-9));
            }
        }
        let (probes, _) = lighting.field.size();
        Some(Self {
            transfer: file.transfer.clone(),
            ground_albedo: lighting.ground_albedo(),
            by_normals: lighting.relighting.by_normals,
            told: lighting.ground_light.clone(),
            shadows: file.shadows.is_some(),
            casting: lighting.casting.clone(),
            probes,
            starts,
            error,
        })
    }

    fn add_to(&self, lines: &mut Lines) {
        let albedo = self.ground_albedo.map_or(String::new(), |albedo| {
            format!(" over a ground of albedo {albedo:.3}")
        });
        let transfer = match &self.transfer {
            Some(path) => format!("relit by {}{albedo}", path.display()),
            None if self.by_normals => format!("lit by normals{albedo}"),
            None => "colors stay as captured".to_owned(),
        };
        let mut shadows = match self.shadows {
            true => "contact shadows",
            false => "no shadows",
        }
        .to_owned();
        if let Some(Sun { towards, share }) = self.casting.sun {
            let elevation_deg = towards.normalize().z.asin().to_degrees();
            let share = 100.0 * share;
            let _ = write!(
                shadows,
                ", shadows of a sun {elevation_deg:.0} degrees high that gives {share:.0} % of the light"
            );
        }
        if !self.casting.lamps.positions.is_empty() {
            let count = self.casting.lamps.positions.len();
            let _ = write!(shadows, ", shadows of {count} lamps");
        }
        let error = 100.0 * self.error;
        lines.line(
            "light",
            &format!(
                "{transfer}, {shadows}; {} probes, at most {error:.2} % of the mean light off",
                self.probes
            ),
        );
        if let (Some(told), Some(albedo)) = (&self.told, self.ground_albedo) {
            let [sky, direct] = [told.sky, told.direct].map(|color| {
                let [red, green, blue] = color.map(|value| value / albedo);
                format!("({red:.2}, {green:.2}, {blue:.2})")
            });
            let source = match self.casting.sun {
                Some(_) => "the sun",
                None => "a lamp above",
            };
            lines.line(
                "",
                &format!("the road shows linear light of the sky {sky}, and {direct} of {source}"),
            );
        }
        for Start {
            instance,
            light,
            trust,
        } in &self.starts
        {
            let message = light.map_or("no light is known where it starts".into(), |([red, green, blue], starkness)| {
                format!("starts in light of ({red:.2}, {green:.2}, {blue:.2}), shadows {starkness:.2} stark")
            });
            let trust = trust.map_or(String::new(), |trust| {
                let Trust {
                    kept,
                    effect,
                    error,
                    distance,
                } = trust;
                format!(
                    "; changes colors by {effect:.3}, error {error:.3} (predicted), {:.0} % of the change kept, distance {distance:.1} from calibrated lights",
                    100.0 * kept[0]
                )
            });
            lines.line("", &format!("{instance}: {message}{trust}"));
        }
    }

    fn to_json(&self) -> Value {
        let start = |start: &Start| {
            let Start {
                instance,
                light,
                trust,
            } = start;
            json!({
                "instance": instance,
                "mean_rgb": light.map(|(mean, _)| mean),
                "starkness": light.map(|(_, starkness)| starkness),
                "trust": trust.map(|trust| json!({
                    "kept": trust.kept[0],
                    "effect": trust.effect,
                    "error": trust.error,
                    "distance": trust.distance,
                })),
            })
        };
        json!({
            "transfer": self.transfer.as_ref().map(|path| path.to_string_lossy().into_owned()),
            "ground_albedo": self.ground_albedo,
            "by_normals": self.by_normals,
            "ground_light": self.told.as_ref().map(|told| json!({
                "sky": told.sky,
                "direct": told.direct,
            })),
            "shadows": self.shadows,
            "sun": self.casting.sun.map(|sun| json!({"towards": sun.towards.to_array(), "share": sun.share})),
            "lamps": self.casting.lamps.positions.len(),
            "probes": self.probes,
            "field_error_of_mean": self.error,
            "starts": self.starts.iter().map(start).collect::<Vec<_>>(),
        })
    }
}

fn way_to_text(way: &Trajectory) -> String {
    let poses = way.poses();
    match poses {
        [only] => format!("stands at {}", meters(only.pose.translation)),
        _ => format!(
            "{:.1} s to {:.1} s, {} poses, {:.1} m from {} to {}",
            way.start_s(),
            way.end_s(),
            poses.len(),
            length_m(way),
            meters(poses[0].pose.translation),
            meters(poses[poses.len() - 1].pose.translation)
        ),
    }
}

/// `, present 0.0 s to 4.5 s and 8.0 s to 12.0 s`; nothing for an agent that always is.
fn times_to_text(present: &Presence) -> String {
    let interval = |[from_s, to_s]: &[f64; 2]| format!("{from_s:.1} s to {to_s:.1} s");
    match present.intervals_s() {
        [] => String::new(),
        intervals_s => {
            let intervals: Vec<String> = intervals_s.iter().map(interval).collect();
            format!(", present {}", intervals.join(" and "))
        }
    }
}

fn way_to_json(way: &Trajectory) -> Value {
    json!({ "start_s": way.start_s(), "end_s": way.end_s(), "poses": way.poses().len(), "length_m": length_m(way) })
}

/// Length of the straight pieces between poses, meters.
fn length_m(way: &Trajectory) -> f64 {
    way.poses()
        .windows(2)
        .map(|pair| pair[0].pose.translation.distance(pair[1].pose.translation))
        .sum()
}

fn meters(position: DVec3) -> String {
    format!(
        "({:.2}, {:.2}, {:.2}) m",
        position.x, position.y, position.z
    )
}
