//! Plans of a planner that sees photographs, and the scene from the same poses.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::LoadedScene;
use decouplegs::drive::{Ego, EgoOptions};
use decouplegs::episode::chosen;
use decouplegs::planner::{
    EgoMotion, EpisodeInfo, Localization, LocatedEgo, Navigation, Observation, Planner,
    PlannerChoice, Reading, Timeouts, Turn,
};
use decouplegs::render::rendered_image::Image;
use decouplegs::scene::{Plan, Pose, RigCamera, Scenario, Trajectory, VehicleSize, VehicleState};
use glam::DVec3;
use serde_json::{Value, json};

use super::gap::{Gap, Statistic};
use super::report::Compared;

/// A view belongs to a camera of the rig where the vehicle would be this near its recorded way,
/// meters and radians.
const ON_WAY_M: f64 = 0.3;
const ALONG_WAY_RAD: f64 = 0.09;
/// Steps between two recorded poses at which the nearest time is searched.
const STEPS: u32 = 32;
/// Views whose vehicles are nearer than this are of one moment, meters.
const SAME_PLACE_M: f64 = 0.1;
/// Times at which plans are compared, seconds: those of a nuScenes planner.
const COMPARED_S: [f64; 6] = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0];
/// Least cruise speed that navigation tells, m/s.
const CRUISE_MPS_MIN: f64 = 1.0;
/// Time from which the rate of the speed is found, seconds.
const ACCELERATION_S: f64 = 0.2;

/// Distances of plans for one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanPair {
    /// Photograph of the first camera.
    pub name: String,
    /// Plan for the scene and plan for the photograph.
    pub rendered: Apart,
    /// Plan for the photograph at half the size, as a control, and plan for the photograph.
    pub half_size: Apart,
}

/// Distance of two plans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Apart {
    /// Mean over [`COMPARED_S`], meters.
    pub ade_m: f64,
    /// That of their last points, meters.
    pub fde_m: f64,
}

impl Apart {
    fn between(a: &Plan, b: &Plan) -> Self {
        let apart_m = COMPARED_S.map(|at| a.at(at).distance(b.at(at)));
        Self {
            ade_m: apart_m.iter().sum::<f64>() / apart_m.len() as f64,
            fde_m: apart_m[apart_m.len() - 1],
        }
    }

    fn to_json(self) -> Value {
        json!({ "ade_m": self.ade_m, "fde_m": self.fde_m })
    }
}

/// Plans from photographs and from rendered images.
pub struct ComparedPlans {
    pub planner: String,
    pub pairs: Vec<PlanPair>,
    /// Moments for which the planner had no answer to one of them.
    pub unanswered: usize,
}

impl ComparedPlans {
    pub fn gaps(&self) -> Vec<Gap> {
        let planner = &self.planner;
        let gap = |statistic, name: &str, value: fn(&PlanPair) -> f64| {
            let values: Vec<f64> = self.pairs.iter().map(value).collect();
            Gap::new(name, statistic, &values, 3).within(0.0, f64::INFINITY)
        };
        let named = |what: &str| format!("plans by {planner}, {what}, m");
        vec![
            gap(
                Statistic::Mean,
                &named("mean distance over 3 s (ADE)"),
                |pair| pair.rendered.ade_m,
            ),
            gap(
                Statistic::Median,
                &named("median of those distances"),
                |pair| pair.rendered.ade_m,
            ),
            gap(
                Statistic::Mean,
                &named("distance after 3 s (FDE)"),
                |pair| pair.rendered.fde_m,
            ),
            gap(
                Statistic::Mean,
                &named("ADE of half-size photographs"),
                |pair| pair.half_size.ade_m,
            ),
        ]
    }

    pub fn to_json(&self) -> Value {
        let pair = |pair: &PlanPair| {
            json!({
                "photograph": pair.name,
                "rendered": pair.rendered.to_json(),
                "half_size_photograph": pair.half_size.to_json(),
            })
        };
        json!({
            "planner": self.planner,
            "unanswered": self.unanswered,
            "compared_at_s": COMPARED_S,
            "pairs": self.pairs.iter().map(pair).collect::<Vec<_>>(),
        })
    }
}

/// A view of a camera of the rig, and when it was taken.
struct Placed<'a> {
    camera: usize,
    time_s: f64,
    world_from_rig: Pose,
    compared: &'a Compared,
}

/// Shows the planner `choice` each moment that all cameras it asks for have a photograph of: once
/// the photographs, once the images of the scene, each time as the first step of an episode.
///
/// # Errors
/// Returns an error if the planner cannot be opened or asks for more than images and a route, or
/// if the scene has no rig, no way, or no photograph of the cameras that it asks for.
pub fn compare(
    choice: &PlannerChoice,
    loaded: &LoadedScene,
    compared: &[Compared],
) -> Result<ComparedPlans> {
    let timeouts = Timeouts {
        answer: Duration::from_secs(60),
        ..Timeouts::default()
    };
    let mut planner = choice
        .open(timeouts)
        .with_context(|| format!("the planner {choice} cannot be opened"))?;
    let sees = planner.sees();
    ensure!(
        !sees.lidars && !sees.privileged,
        "{choice} asks for more than images: photographs tell neither sweeps nor the states of others"
    );
    let way = &loaded.ego;
    ensure!(
        way.poses().len() > 1,
        "the scene has no way that the photographs were taken on, so a planner cannot be told its speed: expected [[ego]] poses"
    );
    let rig = chosen(&loaded.rig, &sees.cameras, None)?;
    let cameras: Vec<RigCamera> = rig.cameras().cloned().collect();
    ensure!(
        !cameras.is_empty(),
        "{choice} asks for no image: its plans are the same for photographs and for the scene"
    );
    let all: Vec<RigCamera> = loaded.rig.cameras().cloned().collect();
    let placed: Vec<Placed> = compared
        .iter()
        .filter_map(|one| place(one, &all, way))
        .collect();
    let of = |name: &str| all.iter().position(|camera| camera.name == name);
    let numbers: Vec<usize> = cameras
        .iter()
        .filter_map(|camera| of(&camera.name))
        .collect();
    let moment = |first: &Placed| -> Option<Vec<usize>> {
        let same = |number: &usize| {
            placed.iter().position(|other| {
                let apart = other.world_from_rig.translation - first.world_from_rig.translation;
                other.camera == *number && apart.length() <= SAME_PLACE_M
            })
        };
        numbers.iter().map(same).collect()
    };
    let moments: Vec<Vec<usize>> = placed
        .iter()
        .filter(|one| one.camera == numbers[0])
        .filter_map(moment)
        .collect();
    ensure!(
        !moments.is_empty(),
        "no photograph is of {}, which {choice} asks for, within {ON_WAY_M} m of the recorded way: are rig and [[ego]] those of the views?",
        cameras
            .iter()
            .map(|camera| camera.name.as_str())
            .collect::<Vec<_>>()
            .join(" and ")
    );
    let size = loaded.recording.vehicle_size.unwrap_or(VehicleSize::CAR);
    let mut found = ComparedPlans {
        planner: choice.to_string(),
        pairs: Vec::new(),
        unanswered: 0,
    };
    for moment in moments {
        let views: Vec<&Placed> = moment.iter().map(|&index| &placed[index]).collect();
        let told = Told::at(way, &views[0].world_from_rig, views[0].time_s, size);
        let mut answer = |image: fn(&Compared) -> Image| {
            answer(planner.as_mut(), &cameras, &views, &told, image)
        };
        let plans = (
            answer(|one| one.photograph.image.clone()),
            answer(|one| one.rendered.clone()),
            answer(|one| one.photograph.half_size()),
        );
        match plans {
            (Some(real), Some(rendered), Some(half_size)) => found.pairs.push(PlanPair {
                name: views[0].compared.photograph.name.clone(),
                rendered: Apart::between(&rendered, &real),
                half_size: Apart::between(&half_size, &real),
            }),
            _ => found.unanswered += 1,
        }
    }
    Ok(found)
}

/// The camera of the rig that took a photograph, and the pose of the vehicle: the one that is
/// nearest to the recorded way.
fn place<'a>(one: &'a Compared, cameras: &[RigCamera], way: &Trajectory) -> Option<Placed<'a>> {
    let world_from_camera = one.photograph.camera.world_from_camera;
    let candidates = cameras.iter().enumerate().filter_map(|(camera, of_rig)| {
        let world_from_rig = world_from_camera.then(&of_rig.rig_from_camera.inverse());
        let time_s = nearest_s(way, world_from_rig.translation);
        let recorded = way.at(time_s);
        let apart_m = recorded.translation.distance(world_from_rig.translation);
        let turned_rad = recorded.rotation.angle_between(world_from_rig.rotation);
        (apart_m <= ON_WAY_M && turned_rad <= ALONG_WAY_RAD).then_some((
            apart_m,
            Placed {
                camera,
                time_s,
                world_from_rig,
                compared: one,
            },
        ))
    });
    let nearest = candidates.min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.map(|(_, placed)| placed)
}

/// Time at which `way` comes nearest to `at_m`.
pub fn nearest_s(way: &Trajectory, at_m: DVec3) -> f64 {
    let apart = |time_s: &f64| way.at(*time_s).translation.distance_squared(at_m);
    let nearest =
        |times: &mut dyn Iterator<Item = f64>| times.min_by(|a, b| apart(a).total_cmp(&apart(b)));
    let poses = way.poses();
    let apart_at = |index: usize| poses[index].pose.translation.distance_squared(at_m);
    let index = (0..poses.len()).min_by(|&a, &b| apart_at(a).total_cmp(&apart_at(b)));
    let index = index.unwrap_or(0);
    let ends = [index.saturating_sub(1), (index + 1).min(poses.len() - 1)];
    let [from_s, to_s] = ends.map(|index| poses[index].time_s);
    let mut times = (0..=2 * STEPS)
        .map(|step| from_s + (to_s - from_s) * f64::from(step) / f64::from(2 * STEPS));
    nearest(&mut times).unwrap_or(from_s)
}

/// Everything but images that a planner is told.
struct Told {
    info: EpisodeInfo,
    motion: EgoMotion,
    guidance: Navigation,
    localization: Localization,
}

impl Told {
    fn at(way: &Trajectory, world_from_rig: &Pose, time_s: f64, size: VehicleSize) -> Self {
        let speed_at = |time_s: f64| way.motion_at(time_s).velocity_mps.length();
        let (from_s, to_s) = (
            (time_s - ACCELERATION_S).max(way.start_s()),
            (time_s + ACCELERATION_S).min(way.end_s()),
        );
        let state = VehicleState {
            position_m: world_from_rig.translation.truncate(),
            yaw_rad: world_from_rig.heading_rad(),
            speed_mps: speed_at(time_s),
            acceleration_mps2: (speed_at(to_s) - speed_at(from_s)) / (to_s - from_s).max(1e-3),
        };
        let mut ego = Ego::new(state, size, EgoOptions::default());
        ego.move_to(state, way.motion_at(time_s).turn_rad_per_s.z);
        let motion = EgoMotion {
            speed_mps: state.speed_mps,
            acceleration_mps2: state.acceleration_mps2,
            steer_rad: ego.steer_rad(),
            yaw_rate_radps: ego.yaw_rate_radps(),
        };
        let speeds = way.poses().iter().map(|timed| speed_at(timed.time_s));
        let route_m = route(way, time_s);
        let length_m = route_m
            .windows(2)
            .map(|pair| pair[0].distance(pair[1]))
            .sum();
        let now = LocatedEgo {
            time_s: 0.0,
            pose: *world_from_rig,
            state,
            motion,
        };
        Self {
            info: EpisodeInfo {
                scenario: "recording".into(),
                seed: 0,
                step_s: Scenario::STEP_S,
                ego_size: size,
                rear_axle_to_middle_m: ego.rear_axle_to_middle_m(),
                sensors: Vec::new(),
            },
            motion,
            guidance: Navigation {
                turn: Turn::Straight,
                distance_m: length_m,
                angle_rad: 0.0,
                length_m,
                cruise_mps: speeds.fold(CRUISE_MPS_MIN, f64::max),
            },
            localization: Localization {
                path: vec![now],
                route_m,
            },
        }
    }
}

/// Points of the way from `time_s` on, as far apart as those of a route, and on beyond its end.
fn route(way: &Trajectory, time_s: f64) -> Vec<DVec3> {
    let mut at_m = way.at(time_s).translation;
    let mut ahead = way.at(time_s).rotation * DVec3::X;
    let mut points = vec![at_m];
    let later = way.poses().iter().filter(|timed| timed.time_s > time_s);
    let mut later = later.map(|timed| timed.pose.translation).peekable();
    while points.len() < Localization::WAYPOINTS {
        while later
            .next_if(|next| next.distance(at_m) < Localization::SPACING_M)
            .is_some()
        {}
        ahead = match later.peek() {
            Some(next) => (*next - at_m).normalize_or(ahead),
            None => ahead,
        };
        at_m += Localization::SPACING_M * ahead;
        points.push(at_m);
    }
    points
}

/// Plan for the images that `image` takes of `views`; `None` where the planner has none.
fn answer(
    planner: &mut dyn Planner,
    cameras: &[RigCamera],
    views: &[&Placed],
    told: &Told,
    image: fn(&Compared) -> Image,
) -> Option<Plan> {
    let images: Vec<Image> = views.iter().map(|view| image(view.compared)).collect();
    let sized = |((camera, view), image): ((&RigCamera, &&Placed), &Image)| RigCamera {
        intrinsics: (view.compared.photograph.camera.intrinsics).resized(image.width, image.height),
        ..camera.clone()
    };
    let cameras: Vec<RigCamera> = cameras.iter().zip(views).zip(&images).map(sized).collect();
    let info = EpisodeInfo {
        sensors: cameras
            .iter()
            .cloned()
            .map(decouplegs::scene::Sensor::Camera)
            .collect(),
        ..told.info.clone()
    };
    let images: Vec<Vec<u8>> = images.iter().map(bytes).collect();
    let readings: Vec<Reading> = cameras
        .iter()
        .zip(&images)
        .map(|(camera, rgba)| Reading::image(camera, rgba))
        .collect();
    planner.begin(&info).ok()?;
    let observation = Observation {
        step: 0,
        time_s: 0.0,
        readings: &readings,
        ego: told.motion,
        guidance: told.guidance,
        localization: planner.sees().localization.then_some(&told.localization),
        privileged: None,
    };
    // A plan before the planner has seen enough is not its own.
    let plan = planner.plan(&observation).ok()?;
    (!planner.is_warming_up()).then_some(plan)
}

/// Four bytes per pixel, opaque.
fn bytes(image: &Image) -> Vec<u8> {
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let pixel = |rgb: &[f32; 3]| [byte(rgb[0]), byte(rgb[1]), byte(rgb[2]), 255];
    image.rgb.iter().flat_map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::TimedPose;

    fn way() -> Trajectory {
        let pose = |step: u32| TimedPose {
            time_s: 0.1 * f64::from(step),
            pose: Pose::from_yaw(0.0, DVec3::new(f64::from(step), 2.0, 0.7)),
        };
        Trajectory::new((0..=20).map(pose).collect()).unwrap()
    }

    #[test]
    fn a_place_on_the_way_has_its_time_and_route() {
        let way = way();
        assert!((nearest_s(&way, DVec3::new(7.25, 2.4, 0.0)) - 0.725).abs() < 0.004);
        assert_eq!(nearest_s(&way, DVec3::new(-9.0, 2.0, 0.0)), 0.0);
        let points = route(&way, 0.5);
        assert_eq!(points.len(), Localization::WAYPOINTS);
        // The way ends at 20 m, and the route goes on.
        let apart = points.windows(2).map(|pair| pair[0].distance(pair[1]));
        assert!(apart.clone().all(|apart_m| (apart_m - 4.0).abs() < 1e-9));
        assert!((points[19].x - 81.0).abs() < 1e-9);
    }

    #[test]
    fn motion_is_that_of_the_way() {
        let way = way();
        let told = Told::at(&way, &way.at(1.0), 1.0, VehicleSize::CAR);
        assert!((told.motion.speed_mps - 10.0).abs() < 1e-6);
        assert!(told.motion.acceleration_mps2.abs() < 1e-6 && told.motion.steer_rad.abs() < 1e-9);
        assert!((told.guidance.cruise_mps - 10.0).abs() < 1e-6);
        assert_eq!(told.localization.now().pose, way.at(1.0));
    }
}
