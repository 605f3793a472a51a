//! Generated scenarios, of which no number is rounder than it has to be.

use decouplegs_scene::scenario::{
    Behavior, DriverKind, Drivers, EgoTask, LaneSide, Maneuver, Measure, Measured, Party, Place,
    TrafficAgent, Trigger,
};
use decouplegs_scene::{
    Air, EgoIdentity, Egos, Level, LightColor, LightPhase, OtherEgo, Pedestrian, RoadUser,
    Scenario, SignKind, StopLine, TrafficLight, TrafficSign, VehicleSize, Weather,
};
use glam::DVec2;
use proptest::prelude::*;
use proptest::sample::select;

/// Paths and ids with everything in them that a text format could trip over.
const ODD_TEXT: &str = "[a-z\"'\\\\\u{e9}\u{1f697}#=\\[\\] \t\n]{1,12}";

fn sizes() -> impl Strategy<Value = VehicleSize> {
    prop::array::uniform3(0.1f64..=100.0).prop_map(VehicleSize::from_array)
}

fn places() -> impl Strategy<Value = Place> {
    let counts = (1usize..=200_000_000, 1usize..=10_000_000);
    let street = (select(Weather::ALL.to_vec()), counts.clone(), any::<u64>()).prop_map(
        |(weather, (background, agent_splats), seed)| Place::Street {
            weather,
            background,
            agent_splats,
            seed,
        },
    );
    let roads = (
        ODD_TEXT,
        prop::option::of(ODD_TEXT),
        -20.0f64..=20.0,
        prop::option::of(select(Weather::ALL.to_vec())),
        prop::option::of(1.0f64..=1e6),
        counts,
    )
        .prop_map(
            |(map, probe, exposure_ev, weather, visibility_m, (background, agent_splats))| {
                Place::Roads {
                    map: map.into(),
                    probe: probe.map(Into::into),
                    exposure_ev,
                    air: Air {
                        weather,
                        visibility_m,
                    },
                    obstacles: None,
                    background,
                    agent_splats,
                }
            },
        );
    let scene =
        (ODD_TEXT, ODD_TEXT, prop::option::of(ODD_TEXT)).prop_map(|(scene, map, obstacles)| {
            Place::Scene {
                scene: scene.into(),
                map: map.into(),
                obstacles: obstacles.map(Into::into),
            }
        });
    prop_oneof![street, roads, scene]
}

fn egos() -> impl Strategy<Value = EgoTask> {
    let speeds = (0.0f64..=100.0, 0.0f64..=100.0);
    (
        prop::collection::vec(ODD_TEXT, 1..5),
        0.0f64..1e3,
        1e3f64..=1e6,
        speeds,
        sizes(),
        any::<bool>(),
    )
        .prop_map(
            |(route, start_m, end_m, (speed_mps, cruise_mps), size, follows_recording)| EgoTask {
                route,
                start_m,
                end_m,
                speed_mps,
                cruise_mps,
                size,
                follows_recording,
                start_pose: (speed_mps > 50.0).then_some([start_m, -end_m, 0.1]),
            },
        )
}

fn measured() -> impl Strategy<Value = Trigger> {
    let point = (-1e7f64..=1e7, -1e7f64..=1e7);
    let point = point.prop_map(|(x, y)| Measure::DistanceTo {
        point_m: DVec2::new(x, y),
    });
    let named = (0..Measure::NAMED.len()).prop_map(|at| Measure::NAMED[at].1);
    (
        prop_oneof![point, named],
        (any::<bool>(), any::<bool>()),
        -1e6f64..=1e6,
        0.0f64..=1000.0,
        (0.0f64..=3600.0, 0.0f64..=3600.0),
    )
        .prop_map(|(measure, (is_ego, is_above), value, less_m, times_s)| {
            Trigger::Measured(Measured {
                of: if is_ego { Party::Ego } else { Party::Agent },
                measure,
                less_m,
                is_above,
                value,
                from_s: times_s.0,
                delay_s: times_s.1,
            })
        })
}

fn triggers() -> impl Strategy<Value = Trigger> {
    prop_oneof![
        (0.0f64..=3600.0).prop_map(|time_s| Trigger::Time { time_s }),
        (0.0f64..=10_000.0).prop_map(|distance_m| Trigger::NearEgo { distance_m }),
        measured(),
    ]
}

fn pedestrians() -> impl Strategy<Value = Vec<Pedestrian>> {
    let path = (-1e5f64..1e5, -1e5f64..1e5, 0.1f64..50.0, 2usize..5);
    let walker = (
        0usize..100,
        sizes(),
        path,
        0.1f64..=8.0,
        triggers(),
        any::<bool>(),
    );
    let walker = walker.prop_map(
        |(asset, size, (x, y, step_m, count), speed_mps, start, waits)| {
            let point = |at| DVec2::new(x + step_m * at as f64, y);
            Pedestrian {
                name: String::new(),
                asset,
                size,
                path_m: (0..count).map(point).collect(),
                speed_mps,
                start,
                waits_for_gap: waits,
            }
        },
    );
    prop::collection::vec(walker, 0..3).prop_map(|mut walkers| {
        for (index, walker) in walkers.iter_mut().enumerate() {
            walker.name = format!("walker-{index}");
        }
        walkers
    })
}

fn behaviors() -> impl Strategy<Value = Behavior> {
    let trigger = triggers();
    let duration_s = || 0.01f64..=3600.0;
    let maneuver = prop_oneof![
        (0.01f64..=20.0, duration_s()).prop_map(|(deceleration_mps2, duration_s)| {
            Maneuver::Brake {
                deceleration_mps2,
                duration_s,
            }
        }),
        Just(Maneuver::CutIn),
        (0.0f64..=100.0).prop_map(|speed_mps| Maneuver::Cruise { speed_mps }),
        select(vec![LaneSide::Left, LaneSide::Right])
            .prop_map(|side| Maneuver::ChangeLane { side }),
        (-1e5f64..=1e5, -1e5f64..=1e5).prop_map(|(x, y)| Maneuver::Teleport {
            point_m: DVec2::new(x, y),
        }),
        (-20.0f64..=20.0, duration_s()).prop_map(|(amplitude_m, duration_s)| Maneuver::Swerve {
            amplitude_m,
            duration_s
        }),
    ];
    (trigger, maneuver).prop_map(|(trigger, maneuver)| Behavior { trigger, maneuver })
}

fn agents() -> impl Strategy<Value = Vec<TrafficAgent>> {
    let agent = (
        (
            0usize..65_536,
            sizes(),
            ODD_TEXT,
            0.0f64..=1e6,
            0.0f64..=100.0,
        ),
        (
            select(RoadUser::ON_LANES.to_vec()),
            select(DriverKind::ALL.to_vec()),
            any::<bool>(),
            prop::collection::vec(behaviors(), 0..3),
            prop::option::of(0.0f64..=100.0),
        ),
    )
        .prop_map(
            |(
                (asset, size, lane, at_m, speed_mps),
                (kind, driver, changes_lanes, behaviors, cruise_mps),
            )| {
                TrafficAgent {
                    name: String::new(),
                    kind,
                    asset,
                    size,
                    lane,
                    at_m,
                    speed_mps,
                    cruise_mps,
                    driver,
                    changes_lanes,
                    behaviors,
                }
            },
        );
    prop::collection::vec(agent, 0..4).prop_map(|mut agents| {
        agents
            .iter_mut()
            .enumerate()
            .for_each(|(index, agent)| agent.name = format!("car-{index}"));
        agents
    })
}

pub fn scenarios() -> impl Strategy<Value = Scenario> {
    let times = (0.02f64..=3600.0, 0.02f64..=5.0);
    let head = (
        "[A-Za-z0-9_-]{1,100}",
        prop::option::of(select(Level::ALL.to_vec())),
        (any::<u64>(), select(Drivers::ALL.to_vec())),
        times,
    );
    (
        head,
        places(),
        egos(),
        agents(),
        lights(),
        pedestrians(),
        signs(),
    )
        .prop_map(
            |(
                (name, level, (seed, drivers), (duration_s, step_s)),
                place,
                ego,
                agents,
                lights,
                pedestrians,
                signs,
            )| {
                Scenario {
                    name,
                    level,
                    seed,
                    drivers,
                    duration_s,
                    step_s,
                    place,
                    ego,
                    egos: Egos::default(),
                    agents,
                    lights,
                    pedestrians,
                    signs,
                    story: Default::default(),
                }
            },
        )
}

/// Scenarios with up to eight egos.
pub fn scenarios_of_egos() -> impl Strategy<Value = Scenario> {
    let planner = prop::option::of(select(vec![
        "constant-velocity",
        "lane-follow",
        "vision",
        "learned",
    ]));
    let identity = (0usize..65_536, planner).prop_map(|(asset, planner)| EgoIdentity {
        asset,
        planner: planner.map(str::to_owned),
        ..EgoIdentity::default()
    });
    let other = (identity.clone(), egos()).prop_map(|(identity, task)| OtherEgo { identity, task });
    let others = prop::collection::vec(other, 0..Egos::MAX);
    (scenarios(), identity, others).prop_map(|(scenario, own, mut others)| {
        for (index, other) in others.iter_mut().enumerate() {
            other.identity.name = format!("ego-{index}");
        }
        let egos = Egos { own, others };
        Scenario { egos, ..scenario }
    })
}

fn signs() -> impl Strategy<Value = Vec<TrafficSign>> {
    let sign = (select(SignKind::ALL.to_vec()), "\\PC{1,9}", 0.0f64..=1e6);
    let sign = sign.prop_map(|(kind, lane, at_m)| TrafficSign {
        kind,
        line: StopLine {
            lane,
            at_m,
            ..StopLine::default()
        },
    });
    prop::collection::vec(sign, 0..3)
}

fn lights() -> impl Strategy<Value = Vec<TrafficLight>> {
    let towards = prop::collection::vec("\\PC{1,9}", 0..3);
    let line = ("\\PC{1,9}", 0.0f64..=1e6, towards);
    let line = line.prop_map(|(lane, at_m, towards)| StopLine {
        lane,
        at_m,
        towards,
    });
    let phase = (select(LightColor::ALL.to_vec()), 0.1f64..=3600.0)
        .prop_map(|(color, duration_s)| LightPhase { color, duration_s });
    let light = (
        prop::collection::vec(line, 1..4),
        prop::collection::vec(phase, 1..4),
        -1e6f64..=1e6,
    );
    prop::collection::vec(light, 0..3).prop_map(|lights| {
        let light = |(at, (stop_lines, phases, offset_s))| TrafficLight {
            name: format!("light {at}"),
            stop_lines,
            phases,
            offset_s,
            changes: vec![],
        };
        lights.into_iter().enumerate().map(light).collect()
    })
}
