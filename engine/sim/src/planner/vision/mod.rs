//! A small driver that looks: it finds its lane's markings and the vehicle ahead in one front
//! image, and nothing else is told to it but what any vehicle knows of itself and what a navigation
//! system says.
//!
//! Each step goes the same way. The lane believed in (`lane`) is moved by the ego's own motion, and
//! continued ahead by the turn that navigation announces: that is the expected way (`way`). Along
//! it the image is unrolled (`road_view`), the lane's markings are voted for (`markings`), and the
//! belief is corrected. The way is searched for the foot of a vehicle (`obstacle`), which is
//! tracked (`lead`) and followed (`follow`) by the Intelligent Driver Model. Where no markings are
//! seen, at crossings or behind others, the belief is kept and carried on by the ego's motion
//! alone.

mod camera_image;
mod follow;
mod lane;
mod lead;
mod markings;
mod obstacle;
mod road_view;
mod way;
mod weights;

use decouplegs_scene::plan::Plan;
use decouplegs_scene::vehicle::VehicleSize;

use self::camera_image::Image;
use self::follow::Pace;
use self::lane::{LaneBelief, Step};
use self::lead::{Elapsed, Lead};
use self::way::{Arc, RoadPath};
use super::cadence::{SPACING_S, plan_through};
use super::{
    Cameras, EgoMotion, EpisodeInfo, Navigation, Observation, ObservationRequest, Planner,
    PlannerError, Turn,
};
use crate::planner::images;

/// Least length of the lane before a turn that is examined, meters.
const LANE_BEFORE_M: f64 = 10.0;
/// Distance to a turn from which the lane after it is looked for, meters.
const LANE_AFTER_M: f64 = 20.0;
/// Distance before the vehicle ahead up to which markings are looked for, meters.
const BEFORE_LEAD_M: f64 = 0.5;
/// Being off the lane's middle decays along this, or along what is driven in [`RETURN_S`] where
/// that is more, meters.
const RETURN_M: f64 = 6.0;
/// Time that takes the place of [`RETURN_M`] at higher speeds, seconds.
const RETURN_S: f64 = 0.9;
/// Distance without markings after which the ego drives slowly, meters.
const LOST_M: f64 = 60.0;
/// Speed while the lane is lost, m/s.
const LOST_MPS: f64 = 5.0;
/// Largest speed that is believed, meters per second.
const SPEED_MPS_MAX: f64 = 60.0;
/// Longest step that is believed, seconds.
const STEP_S_MAX: f64 = 5.0;
/// Progress that navigation tells is believed when it differs from what was driven by less than
/// this, meters.
const PROGRESS_SLACK_M: f64 = 3.0;

/// Perception of the last image by the planner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Perception {
    /// Middle of the ego's lane beside the ego, to the left where above zero, meters.
    pub lane_offset_m: f64,
    /// Heading of the lane in the ego's frame.
    pub lane_heading_rad: f64,
    /// Bend of the lane, to the left where above zero, 1/m.
    pub lane_curvature: f64,
    /// Width of the lane from border to border, meters.
    pub lane_width_m: f64,
    /// Driven since markings were last seen, meters.
    pub unseen_m: f64,
    /// Distance from the ego's front to the vehicle ahead, meters; `None` where none is seen.
    pub gap_m: Option<f64>,
}

/// Drives by the front image alone: by lane markings and the vehicle ahead, and what navigation
/// announces.
///
/// It sees no traffic lights, no signs and nobody who comes from the side; it changes no lanes and
/// knows no hills. It takes the ground for flat, and starts in the belief that it stands in a lane,
/// along it.
#[derive(Clone, Debug, Default)]
pub struct Vision {
    state: Option<State>,
}

/// State within an episode.
#[derive(Clone, Debug)]
struct State {
    ego_size: VehicleSize,
    step_s: f64,
    time_s: Option<f64>,
    motion: EgoMotion,
    guidance: Navigation,
    lane: LaneBelief,
    arc: Option<Arc>,
    lead: Option<Lead>,
}

impl Vision {
    /// Perception of the last image; `None` before an episode.
    #[must_use]
    pub fn perception(&self) -> Option<Perception> {
        let state = self.state.as_ref()?;
        Some(Perception {
            lane_offset_m: state.lane.offset_m,
            lane_heading_rad: state.lane.heading_rad,
            lane_curvature: state.lane.curvature,
            lane_width_m: state.lane.width_m,
            unseen_m: state.lane.unseen_m,
            gap_m: state
                .lead
                .map(|lead| lead.arc_m - 0.5 * state.ego_size.length_m),
        })
    }
}

impl Planner for Vision {
    fn name(&self) -> String {
        "vision".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            cameras: Cameras::Front,
            privileged: false,
            ..ObservationRequest::default()
        }
    }

    fn begin(&mut self, info: &EpisodeInfo) -> Result<(), PlannerError> {
        self.state = Some(State {
            ego_size: info.ego_size,
            step_s: if info.step_s.is_finite() {
                info.step_s.clamp(0.0, STEP_S_MAX)
            } else {
                0.0
            },
            time_s: None,
            motion: EgoMotion::default(),
            guidance: Navigation::default(),
            lane: LaneBelief::at_start(),
            arc: None,
            lead: None,
        });
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let state = self.state.as_mut().ok_or_else(|| {
            PlannerError("vision was asked for a plan before an episode began".into())
        })?;
        state.look(observation);
        state.drive(&observation.guidance)
    }
}

impl State {
    /// Brings lane and lead up to date with what is seen now.
    fn look(&mut self, observation: &Observation) {
        let elapsed = self.move_on(observation);
        self.turn_on(Arc::announced(&observation.guidance));
        let image = images(observation.readings)
            .next()
            .and_then(|frame| Image::from_frame(&frame, self.ego_size.height_m));
        let Some(image) = image else {
            self.lead = lead::track(self.lead, &elapsed, &[]);
            return;
        };
        let way = self.way();
        self.lead = lead::track(self.lead, &elapsed, &obstacle::scan(&image, &way));
        self.find_lane(&image, &way);
    }

    /// Moves what is believed by the ego's motion since the last step.
    fn move_on(&mut self, observation: &Observation) -> Elapsed {
        let motion = believable(&observation.ego);
        let dt_s = self
            .time_s
            .map_or(0.0, |before_s| observation.time_s - before_s);
        let dt_s = if dt_s.is_finite() {
            dt_s.clamp(0.0, STEP_S_MAX)
        } else {
            self.step_s
        };
        let driven_m = 0.5 * (self.motion.speed_mps + motion.speed_mps) * dt_s;
        let turned_rad = 0.5 * (self.motion.yaw_rate_radps + motion.yaw_rate_radps) * dt_s;
        if self.time_s.is_some() {
            let progress_m = progress_m(&self.guidance, &observation.guidance)
                .filter(|told_m| (told_m - driven_m).abs() < PROGRESS_SLACK_M);
            let step = Step {
                driven_m,
                turned_rad,
                progress_m,
            };
            self.lane = self.lane.moved(&self.way(), &step, self.ego_size.length_m);
        }
        (self.motion, self.time_s, self.guidance) =
            (motion, Some(observation.time_s), observation.guidance);
        Elapsed {
            driven_m,
            dt_s,
            speed_mps: motion.speed_mps,
        }
    }

    /// Takes note of the turn ahead. Behind a turn the road is taken for straight until its
    /// markings tell otherwise.
    fn turn_on(&mut self, arc: Option<Arc>) {
        let within = |arc: &Option<Arc>| arc.is_some_and(|arc| arc.begin_m <= 0.0);
        if within(&self.arc) && !within(&arc) {
            self.lane = LaneBelief {
                curvature: 0.0,
                ..self.lane
            };
        }
        self.arc = arc;
    }

    fn way(&self) -> RoadPath {
        RoadPath::expected(&self.lane, self.arc.as_ref())
    }

    /// Corrects the lane by its markings: those before a turn, or those after it once they are
    /// near.
    fn find_lane(&mut self, image: &Image, way: &RoadPath) {
        let lead_m = self
            .lead
            .map_or(f64::INFINITY, |lead| lead.arc_m - BEFORE_LEAD_M);
        let (from_m, to_m) = match self.arc {
            Some(arc) if arc.begin_m >= LANE_BEFORE_M => (0.0, arc.begin_m),
            Some(arc) if arc.end_m <= LANE_AFTER_M => (arc.end_m, f64::INFINITY),
            Some(_) => return,
            None => (0.0, f64::INFINITY),
        };
        let rows = road_view::rows(image, way, from_m, to_m.min(lead_m));
        if let Some(fix) = markings::find_lane(&rows, &self.lane, from_m) {
            self.lane = self.lane.corrected(&fix, way, from_m);
        }
    }

    /// The plan along the way, at the pace that lead and bends allow.
    fn drive(&self, guidance: &Navigation) -> Result<Plan, PlannerError> {
        let way = self.way();
        let cruise_mps = if guidance.cruise_mps.is_finite() {
            guidance.cruise_mps.clamp(0.1, SPEED_MPS_MAX)
        } else {
            LOST_MPS
        };
        let pace = Pace {
            way: &way,
            lead: self.lead,
            length_m: self.ego_size.length_m,
            speed_mps: self.motion.speed_mps,
            cruise_mps: if self.lane.unseen_m > LOST_M {
                cruise_mps.min(LOST_MPS)
            } else {
                cruise_mps
            },
        };
        let arcs_m = pace.arcs_m();
        let return_m = RETURN_M.max(RETURN_S * self.motion.speed_mps);
        plan_through(|time_s| {
            let arc_m = arcs_m[((time_s / SPACING_S).round() as usize).min(arcs_m.len() - 1)];
            way.at(arc_m)
                .beside(-self.lane.offset_m * (-arc_m / return_m).exp())
        })
    }
}

/// Progress along the way between two announcements of the same turn, meters.
fn progress_m(before: &Navigation, now: &Navigation) -> Option<f64> {
    let same = before.turn == now.turn
        && before.angle_rad == now.angle_rad
        && before.length_m == now.length_m;
    (same && now.turn != Turn::Straight).then_some(before.distance_m - now.distance_m)
}

/// Motion without numbers that no car has.
fn believable(motion: &EgoMotion) -> EgoMotion {
    let finite = |value: f64, limit: f64| {
        if value.is_finite() {
            value.clamp(-limit, limit)
        } else {
            0.0
        }
    };
    EgoMotion {
        speed_mps: finite(motion.speed_mps, SPEED_MPS_MAX).max(0.0),
        acceleration_mps2: finite(motion.acceleration_mps2, 20.0),
        steer_rad: finite(motion.steer_rad, 1.5),
        yaw_rate_radps: finite(motion.yaw_rate_radps, 3.0),
    }
}
