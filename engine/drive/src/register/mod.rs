//! Registration: tracks brought onto the lanes of a map and onto the ground.
//!
//! A log is moved only where lanes show that it drifted: first all tracks together, then single
//! tracks, each by more than the habits of drivers explain. What is parked, or shows no drift,
//! stays where it was logged and is set on the ground.
//!
//! A track is smoothed ([`smooth`]), its lanes are chosen by the whole of it ([`route`]), its
//! points are matched to their line in order ([`dtw`]) except where it changes lanes
//! ([`lane_change`]), and one planar motion brings it there ([`procrustes`], then [`fit`]). Its
//! poses are then set on the ground at the four bottom corners of its box ([`grounding`]).
//!
//! Registration is for background traffic, never for the ego vehicle.

mod align;
mod drift;
pub mod dtw;
pub mod fit;
pub mod grounding;
pub mod lane_change;
mod prepared;
pub mod procrustes;
pub mod route;
pub mod smooth;

use decouplegs_scene::{Invalid, LaneMap, Pose, Track};
use rayon::prelude::*;

use crate::ground::Ground;
use crate::lane_index::LaneIndex;
use crate::polyline::Foot;
use align::Aligned;
use drift::KeptBecause;
use fit::{MotionPrior, PlanarFit};
use lane_change::LaneChange;
use prepared::Prepared;

/// Options of the registration of tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterOptions {
    /// Cost of a heading across the lane, meters; half of it counts against the lane (the paper's
    /// 2.5).
    pub heading_weight: f64,
    /// Half the width of the Sakoe-Chiba band, meters along the lane.
    pub band_m: f64,
    /// Lanes farther from a track are none of its, meters.
    pub radius_m: f64,
    /// Deviation of drivers' habits: how far they keep from the middle of their lane, meters. A
    /// track is moved by itself only where its lanes show more than that. 0: all tracks belong on
    /// the middles of their lanes.
    pub keeping_m: f64,
    /// Deviation of the tracks' noise along one axis, meters. None: told by each track itself.
    pub noise_m: Option<f64>,
    /// True: the one motion of the whole log is the only one.
    pub shared: bool,
    /// Prior of the drift of logs.
    pub prior: MotionPrior,
    /// Largest shift that is believed, meters.
    pub shift_max_m: f64,
    /// Largest turn that is believed, radians.
    pub yaw_max_rad: f64,
    /// A track that lies about its lane by more, as a deviation in meters, does not follow it.
    pub residual_max_m: f64,
    /// Tracks that travel less have no motion of their own, meters.
    pub travel_min_m: f64,
    /// A lane on another level is one whose height differs by more, meters.
    pub deck_m: f64,
    /// Length, width and height of tracks that tell none, meters.
    pub dims_m: [f64; 3],
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self {
            heading_weight: 2.5,
            band_m: 10.0,
            radius_m: 6.0,
            keeping_m: 0.3,
            noise_m: None,
            shared: false,
            prior: MotionPrior {
                shift_m: 1.0,
                yaw_rad: 2f64.to_radians(),
            },
            shift_max_m: 3.0,
            yaw_max_rad: 6f64.to_radians(),
            residual_max_m: 0.8,
            travel_min_m: 8.0,
            deck_m: 2.5,
            dims_m: [4.5, 1.9, 1.6],
        }
    }
}

/// Reason why nothing could be registered.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegisterError {
    /// The map has no lanes.
    #[error("the map has no lanes; tracks are registered to lanes")]
    NoLanes,
    /// The map cannot be used.
    #[error("the map cannot be used: {0}")]
    Map(Invalid),
    /// The log has no tracks.
    #[error("there are no tracks to register")]
    NoTracks,
    /// An option is not a positive number.
    #[error("option {name} is {value}; expected a number above zero")]
    Option {
        /// Field in [`RegisterOptions`].
        name: &'static str,
        /// Value of the field.
        value: f64,
    },
}

/// All tracks of a log.
#[derive(Clone, Debug)]
pub struct Registration {
    /// Tracks in the order of the log.
    pub tracks: Vec<RegisteredTrack>,
    /// The motion of all tracks together, where lanes show that the log drifted as a whole.
    pub shared: Option<PlanarFit>,
}

/// Result of the registration of a track.
#[derive(Clone, Debug)]
pub struct RegisteredTrack {
    /// Id as in the log.
    pub id: String,
    /// Class as in the log.
    pub class: String,
    /// Size as in the log, or [`RegisterOptions::dims_m`].
    pub dims_m: [f64; 3],
    /// Poses, or why there are none.
    pub outcome: Outcome,
}

/// Poses, or why there are none.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// The track is put on its lanes.
    Registered(Box<Registered>),
    /// The track fits no lanes, and is best left out.
    Refused {
        /// Reason, as a sentence without its end.
        reason: String,
    },
}

/// A track on its lanes.
#[derive(Clone, Debug)]
pub struct Registered {
    /// Registered from logged.
    pub fit: PlanarFit,
    /// Treatment of the track.
    pub treatment: Treatment,
    /// Positions in [`LaneMap::lanes`], in driving order.
    pub lanes: Vec<usize>,
    /// Lane changes.
    pub lane_changes: Vec<LaneChange>,
    /// One for each point of the track.
    pub poses: Vec<RegisteredPose>,
    /// Deviation of the log's noise, meters.
    pub noise_m: f64,
}

/// Treatment of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Treatment {
    /// Moved by a motion of its own, which its lanes show.
    Own,
    /// Moved with all others, as the log drifted as a whole.
    Log,
    /// Moved with all others; it travels too little to follow lanes.
    LogParked,
    /// Left where it was logged: lanes show no drift beyond the habits of drivers.
    Kept,
    /// Left where it was logged: it fits several lanes about as well.
    KeptLaneUnsure,
    /// Left where it was logged: it travels too little to follow lanes.
    KeptParked,
}

impl Treatment {
    /// True if the track travels too little to follow lanes.
    #[must_use]
    pub fn is_parked(self) -> bool {
        matches!(self, Self::LogParked | Self::KeptParked)
    }

    /// True if the track was left where it was logged.
    #[must_use]
    pub fn is_kept(self) -> bool {
        matches!(self, Self::Kept | Self::KeptLaneUnsure | Self::KeptParked)
    }

    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Own => "moved",
            Self::Log => "moved with the log",
            Self::LogParked => "parked, moved with the log",
            Self::Kept => "kept",
            Self::KeptLaneUnsure => "kept, lane unsure",
            Self::KeptParked => "parked, kept",
        }
    }
}

/// Pose of a road user at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisteredPose {
    /// The moment, seconds.
    pub time_s: f64,
    /// World from box, its origin in the middle of the box.
    pub pose: Pose,
    /// Nearest point on its lane; none if it follows none.
    pub lane: Option<Foot>,
    /// Properties of the pose.
    pub flags: PoseFlags,
}

/// Properties of a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PoseFlags {
    /// Fewer than three corners had ground below them: height and grade are those of the lane.
    pub no_support: bool,
    /// Neither ground nor lane nor log told a height.
    pub no_height: bool,
    /// The corners are no plane: a kerb, or something on the road.
    pub uneven: bool,
    /// The vehicle is between two lanes.
    pub lane_change: bool,
    /// The log has it far from its neighbors; it was put where they say.
    pub outlier: bool,
    /// Parked: the track travels too little to follow lanes.
    pub parked: bool,
    /// Lane unsure: the track fits several lanes about as well.
    pub lane_unsure: bool,
}

impl PoseFlags {
    /// The names of those that are set.
    #[must_use]
    pub fn names(self) -> Vec<&'static str> {
        let all = [
            (self.no_support, "no-support"),
            (self.no_height, "no-height"),
            (self.uneven, "uneven"),
            (self.lane_change, "lane-change"),
            (self.outlier, "outlier"),
            (self.parked, "parked"),
            (self.lane_unsure, "lane-unsure"),
        ];
        all.into_iter()
            .filter(|(set, _)| *set)
            .map(|(_, name)| name)
            .collect()
    }
}

/// Registers `tracks` to `map`, and sets them on `ground` where there is one; otherwise on the
/// lanes' own heights.
///
/// # Errors
/// [`RegisterError`], where map, tracks or options are none. A track that cannot be registered is
/// an [`Outcome`].
pub fn register(
    map: &LaneMap,
    tracks: &[Track],
    ground: Option<&Ground>,
    options: &RegisterOptions,
) -> Result<Registration, RegisterError> {
    check(map, tracks, options)?;
    let index = LaneIndex::new(map);
    let register = align::Register {
        map,
        index: &index,
        options,
    };
    let prepared: Vec<Result<Prepared, String>> =
        tracks.par_iter().map(Prepared::new(options)).collect();
    let long = |prepared: &&Prepared| prepared.traveled_m >= options.travel_min_m;
    let mut guides: Vec<&Prepared> = prepared.iter().flatten().filter(long).collect();
    // Sums do not depend on the order of the log.
    guides.sort_by(|a, b| a.track.id.cmp(&b.track.id));
    let trusts_lanes = options.keeping_m == 0.0;
    let needs_shared = options.shared
        || !trusts_lanes
        || prepared.iter().flatten().any(|prepared| !long(&prepared));
    // Fewer tracks can never show that the log drifted, and not each by itself.
    let can_share = trusts_lanes || options.shared || guides.len() >= drift::LOG_TRACKS_MIN;
    let shared = if needs_shared && can_share {
        register.shared(&guides)
    } else {
        None
    };
    let shared = shared.filter(|shared| trusts_lanes || register.is_log_drift(&guides, shared));
    let one = |prepared: &Result<Prepared, String>| -> Result<Box<Registered>, String> {
        let prepared = prepared.as_ref().map_err(Clone::clone)?;
        let base = shared.unwrap_or_else(|| drift::none_about(prepared.middle()));
        let with_log = |log: Treatment, kept: Treatment| if shared.is_some() { log } else { kept };
        let (aligned, treatment) = if !long(&prepared) {
            (
                Aligned::without_lanes(&base),
                with_log(Treatment::LogParked, Treatment::KeptParked),
            )
        } else if options.shared {
            (
                register.with_motion(prepared, &base)?,
                with_log(Treatment::Log, Treatment::Kept),
            )
        } else if trusts_lanes {
            (register.align(prepared)?, Treatment::Own)
        } else {
            // Who drives against lanes, or where none are, is refused.
            let stay = register.with_motion(prepared, &base)?;
            let kept = |kept: Treatment| {
                if shared.is_some() {
                    Treatment::Log
                } else {
                    kept
                }
            };
            match register.align(prepared) {
                Err(_) => (stay, kept(Treatment::Kept)),
                Ok(own) => match register.is_drift(prepared, &own, &stay) {
                    Ok(()) => (own, Treatment::Own),
                    Err(KeptBecause::NoEvidence) => (stay, kept(Treatment::Kept)),
                    Err(KeptBecause::LaneUnsure) => (stay, kept(Treatment::KeptLaneUnsure)),
                },
            }
        };
        Ok(Box::new(
            grounding::Grounding {
                register: &register,
                ground,
                options,
            }
            .place(prepared, aligned, treatment),
        ))
    };
    let registered = tracks
        .par_iter()
        .zip(&prepared)
        .map(|(track, prepared)| RegisteredTrack {
            id: track.id.clone(),
            class: track.class.clone(),
            dims_m: track.dims_m.unwrap_or(options.dims_m),
            outcome: one(prepared)
                .map_or_else(|reason| Outcome::Refused { reason }, Outcome::Registered),
        });
    Ok(Registration {
        tracks: registered.collect(),
        shared,
    })
}

fn check(map: &LaneMap, tracks: &[Track], options: &RegisterOptions) -> Result<(), RegisterError> {
    map.check().map_err(RegisterError::Map)?;
    if map.lanes.is_empty() {
        return Err(RegisterError::NoLanes);
    }
    if tracks.is_empty() {
        return Err(RegisterError::NoTracks);
    }
    let numbers = [
        ("heading_weight", options.heading_weight),
        ("band_m", options.band_m),
        ("radius_m", options.radius_m),
        ("keeping_m", options.keeping_m + 1e-9),
        (
            "noise_m",
            options.noise_m.map_or(1.0, |noise_m| noise_m + 1e-9),
        ),
        ("prior.shift_m", options.prior.shift_m),
        ("prior.yaw_rad", options.prior.yaw_rad),
        ("shift_max_m", options.shift_max_m),
        ("yaw_max_rad", options.yaw_max_rad),
        ("residual_max_m", options.residual_max_m),
        ("travel_min_m", options.travel_min_m),
        ("deck_m", options.deck_m),
        (
            "dims_m",
            options.dims_m.into_iter().fold(f64::INFINITY, f64::min),
        ),
    ];
    let wrong = numbers
        .into_iter()
        .find(|(_, value)| !(value.is_finite() && *value > 0.0));
    wrong.map_or(Ok(()), |(name, value)| {
        Err(RegisterError::Option { name, value })
    })
}
