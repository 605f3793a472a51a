//! Instants as JSON: one form for each version of logs that tells more of them.

use decouplegs_scene::VehicleState;
use decouplegs_scene::episode::{EpisodeTick, LaneOffset, LaneRecord, ROAD_VERSION, RoadRecord};
use glam::DVec2;
use serde::{Deserialize, Serialize};

/// x, y, yaw, speed and acceleration.
type StateForm = [f64; 5];

/// Time, ego, its steering, whether it is on the road, agents; null for those off the map.
type InstantForm1 = (f64, StateForm, f64, bool, Vec<Option<StateForm>>);

/// Speed of the ego against the lanes below it, and their speed limit.
type LanesForm = Option<(f64, Option<f64>)>;

/// Instant with the lanes below the ego before the agents.
type InstantForm3 = (f64, StateForm, f64, bool, LanesForm, Vec<Option<StateForm>>);

/// Flags of a place in a junction, of one on a crossing and of a wrong turn; offset from the lane
/// and half the lane's width.
type RoadForm = (bool, bool, bool, Option<(f64, f64)>);

/// Instant with the position of the ego on the road before the agents.
type InstantForm4 = (
    f64,
    StateForm,
    f64,
    bool,
    LanesForm,
    RoadForm,
    Vec<Option<StateForm>>,
);

/// Instant of an ego beside the first, whose agents another line tells.
type OwnInstantForm = (f64, StateForm, f64, bool, LanesForm, RoadForm);

/// First version of logs with lanes.
pub(super) const LANES_VERSION: u32 = 3;

/// An instant of any version.
#[derive(Deserialize, Serialize)]
#[serde(untagged)]
pub(super) enum InstantForm {
    OnRoad(InstantForm4),
    WithLanes(InstantForm3),
    Bare(InstantForm1),
    Own(OwnInstantForm),
}

impl InstantForm {
    /// True if logs of `version` have instants of this form.
    pub(super) fn is_of(&self, version: u32) -> bool {
        match self {
            Self::OnRoad(_) | Self::Own(_) => version >= ROAD_VERSION,
            Self::WithLanes(_) => (LANES_VERSION..ROAD_VERSION).contains(&version),
            Self::Bare(_) => version < LANES_VERSION,
        }
    }

    /// The form without agents.
    pub(super) fn without_agents(self) -> Self {
        match self {
            Self::OnRoad((time_s, ego, steer_rad, on_road, lanes, road, _)) => {
                Self::Own((time_s, ego, steer_rad, on_road, lanes, road))
            }
            other => other,
        }
    }
}

fn state_form(state: &VehicleState) -> StateForm {
    let VehicleState {
        position_m,
        yaw_rad,
        speed_mps,
        acceleration_mps2,
    } = *state;
    [
        position_m.x,
        position_m.y,
        yaw_rad,
        speed_mps,
        acceleration_mps2,
    ]
}

fn state([x, y, yaw_rad, speed_mps, acceleration_mps2]: StateForm) -> VehicleState {
    VehicleState {
        position_m: DVec2::new(x, y),
        yaw_rad,
        speed_mps,
        acceleration_mps2,
    }
}

fn road_form(road: &RoadRecord) -> RoadForm {
    let RoadRecord {
        in_junction,
        on_crossing,
        wrong_turn,
        lane,
    } = *road;
    let lane = lane.map(|lane| (lane.lateral_m, lane.half_width_m));
    (in_junction, on_crossing, wrong_turn, lane)
}

fn road((in_junction, on_crossing, wrong_turn, lane): RoadForm) -> RoadRecord {
    RoadRecord {
        in_junction,
        on_crossing,
        wrong_turn,
        lane: lane.map(|(lateral_m, half_width_m)| LaneOffset {
            lateral_m,
            half_width_m,
        }),
    }
}

/// The form of `instant` in a log of `version`.
pub(super) fn instant_form(instant: &EpisodeTick, version: u32) -> InstantForm {
    let EpisodeTick {
        time_s,
        ego,
        steer_rad,
        on_road,
        lanes,
        road,
        agents,
    } = instant;
    let (ego, agents) = (state_form(ego), agents.iter());
    let agents = agents.map(|agent| agent.as_ref().map(state_form)).collect();
    if version < LANES_VERSION {
        return InstantForm::Bare((*time_s, ego, *steer_rad, *on_road, agents));
    }
    let lanes = lanes.map(|lanes| (lanes.against_mps, lanes.limit_mps));
    if version < ROAD_VERSION {
        return InstantForm::WithLanes((*time_s, ego, *steer_rad, *on_road, lanes, agents));
    }
    let road = road_form(&road.unwrap_or_default());
    InstantForm::OnRoad((*time_s, ego, *steer_rad, *on_road, lanes, road, agents))
}

/// The instant of a form.
pub(super) fn instant(form: InstantForm) -> EpisodeTick {
    let (time_s, ego, steer_rad, on_road, lanes, road_form, agents) = match form {
        InstantForm::OnRoad((time_s, ego, steer_rad, on_road, lanes, road, agents)) => {
            (time_s, ego, steer_rad, on_road, lanes, Some(road), agents)
        }
        InstantForm::Own((time_s, ego, steer_rad, on_road, lanes, road)) => (
            time_s,
            ego,
            steer_rad,
            on_road,
            lanes,
            Some(road),
            Vec::new(),
        ),
        InstantForm::WithLanes((time_s, ego, steer_rad, on_road, lanes, agents)) => {
            (time_s, ego, steer_rad, on_road, lanes, None, agents)
        }
        InstantForm::Bare((time_s, ego, steer_rad, on_road, agents)) => {
            (time_s, ego, steer_rad, on_road, None, None, agents)
        }
    };
    EpisodeTick {
        time_s,
        ego: state(ego),
        steer_rad,
        on_road,
        lanes: lanes.map(|(against_mps, limit_mps)| LaneRecord {
            against_mps,
            limit_mps,
        }),
        road: road_form.map(road),
        agents: agents.into_iter().map(|agent| agent.map(state)).collect(),
    }
}
