//! Episode logs: round trips, the file as it grows, and every way in which one can be broken.

mod writing;

use decouplegs_logs::episode_log::{VERSION, decode, encode};
use decouplegs_logs::{EpisodeLog, read_episode_log};
use decouplegs_scene::episode::{
    AgentCommand, CommandRecord, DrawnBy, EpisodeTick, HandoverRecord, LaneOffset, LaneRecord,
    LightChangeRecord, PlannerRecord, ReadingRecord, RoadRecord, StopLineRecord,
};
use decouplegs_scene::{
    Episode, EpisodeEnd, EpisodeHead, EpisodeStep, LightChange, LightColor, LightCourse, Obstacle,
    ObstacleKind, Plan, PlanPoint, Scenario, VehicleSize, VehicleState,
};
use glam::DVec2;
use proptest::prelude::*;

use crate::scenarios::scenarios;

/// Any finite number, the tiny, the huge and minus zero among them.
fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<u64>()
            .prop_map(f64::from_bits)
            .prop_filter("finite", |value| value.is_finite()),
        Just(-0.0),
        -1e7f64..1e7,
    ]
}

fn states() -> impl Strategy<Value = VehicleState> {
    prop::array::uniform5(numbers()).prop_map(|[x, y, yaw_rad, speed_mps, acceleration_mps2]| {
        VehicleState {
            position_m: DVec2::new(x, y),
            yaw_rad,
            speed_mps,
            acceleration_mps2,
        }
    })
}

fn roads() -> impl Strategy<Value = RoadRecord> {
    let flags = (any::<bool>(), any::<bool>(), any::<bool>());
    (flags, prop::option::of((numbers(), numbers()))).prop_map(|(flags, lane)| RoadRecord {
        in_junction: flags.0,
        on_crossing: flags.1,
        wrong_turn: flags.2,
        lane: lane.map(|(lateral_m, half_width_m)| LaneOffset {
            lateral_m,
            half_width_m,
        }),
    })
}

fn instants(agents: usize) -> impl Strategy<Value = EpisodeTick> {
    (
        states(),
        numbers(),
        any::<bool>(),
        prop::option::of((numbers(), prop::option::of(numbers()))),
        roads(),
        prop::collection::vec(prop::option::of(states()), agents),
    )
        .prop_map(
            |(ego, steer_rad, on_road, lanes, road, agents)| EpisodeTick {
                time_s: 0.0,
                ego,
                steer_rad,
                on_road,
                lanes: lanes.map(|(against_mps, limit_mps)| LaneRecord {
                    against_mps,
                    limit_mps,
                }),
                road: Some(road),
                agents,
            },
        )
}

fn plans() -> impl Strategy<Value = Plan> {
    prop::collection::vec((0.01f64..1.0, -1e3f64..1e3, -1e3f64..1e3), 1..7).prop_map(|steps| {
        let mut time_s = 0.0;
        let point = |(after_s, x, y)| {
            time_s += after_s;
            PlanPoint {
                time_s,
                position_m: DVec2::new(x, y),
            }
        };
        Plan::new(steps.into_iter().map(point).collect()).unwrap()
    })
}

fn heads() -> impl Strategy<Value = EpisodeHead> {
    let text = || "(?s).{0,8}";
    let names = || prop::collection::vec(text(), 0..3);
    let planner = (text(), names(), names(), any::<bool>()).prop_map(
        |(name, cameras, lidars, privileged)| PlannerRecord {
            name,
            localization: cameras.is_empty(),
            cameras,
            lidars,
            privileged,
        },
    );
    let drawn_by =
        (text(), any::<[u32; 3]>()).prop_map(|(device, [width_px, height_px, every])| DrawnBy {
            device,
            width_px,
            height_px,
            every,
            f_theta: every % 2 == 1,
        });
    let route = prop::collection::vec(
        (numbers(), numbers()).prop_map(|(x, y)| DVec2::new(x, y)),
        2..5,
    );
    (
        scenarios(),
        text(),
        planner,
        prop::option::of(drawn_by),
        route,
        any::<u8>(),
    )
        .prop_map(
            |(scenario, version, planner, drawn_by, route_m, agent_driver)| {
                let line = |index| StopLineRecord {
                    index,
                    ends_m: [DVec2::new(1.0 / 3.0, -4.0), DVec2::new(2.0, 1e-7)],
                };
                let stop_lines = (0..scenario.lights.len()).map(line).collect();
                let sign_lines = (0..scenario.signs.len()).map(line).collect();
                let agent_sizes = scenario.agent_sizes();
                EpisodeHead {
                    log_version: VERSION,
                    version,
                    scenario,
                    planner,
                    drawn_by,
                    route_m,
                    agent_sizes,
                    stop_lines,
                    sign_lines,
                    agent_driver: (agent_driver % 2 == 1).then(|| "learned".into()),
                }
            },
        )
}

fn ends() -> impl Strategy<Value = EpisodeEnd> {
    prop_oneof![
        Just(EpisodeEnd::RouteDone),
        Just(EpisodeEnd::Story),
        Just(EpisodeEnd::Time),
        any::<usize>().prop_map(|agent| EpisodeEnd::Collision { agent }),
        Just(EpisodeEnd::OffRoad),
        Just(EpisodeEnd::OffRoute),
        (0..5_usize, states(), 0.1f64..30.0).prop_map(|(kind, state, length_m)| {
            let obstacle = Obstacle {
                kind: ObstacleKind::ALL[kind],
                center_m: state.position_m,
                yaw_rad: state.yaw_rad,
                length_m,
                width_m: 0.5 * length_m,
            };
            EpisodeEnd::Obstacle { obstacle }
        }),
        "(?s).{0,40}".prop_map(|reason| EpisodeEnd::Planner { reason }),
    ]
}

fn episodes() -> impl Strategy<Value = Episode> {
    heads().prop_flat_map(|head| {
        let agents = head.agent_sizes.len();
        let reading =
            ("[a-z]{1,5}", any::<u128>()).prop_map(|(sensor, hash)| ReadingRecord { sensor, hash });
        let step = (
            prop::collection::vec(reading, 0..3),
            plans(),
            prop::collection::vec(instants(agents), 0..4),
        );
        let steps = prop::collection::vec(step, 0..4);
        (Just(head), instants(agents), steps, ends(), 0.001f64..0.3).prop_map(
            |(head, start, steps, end, substep_s)| {
                let end = match end {
                    EpisodeEnd::Collision { .. } if head.agent_sizes.is_empty() => EpisodeEnd::Time,
                    EpisodeEnd::Collision { agent } => EpisodeEnd::Collision {
                        agent: agent % head.agent_sizes.len(),
                    },
                    other => other,
                };
                let mut moment = 0;
                let (agents, lights) = (head.agent_sizes.len(), head.scenario.lights.len());
                let command = |agent: usize| CommandRecord {
                    command: AgentCommand {
                        agent,
                        acceleration_mps2: -substep_s,
                        curvature_per_m: agent.is_multiple_of(2).then_some(substep_s / 3.0),
                    },
                    is_limited: agent.is_multiple_of(3),
                };
                let number = |(step, (readings, plan, mut instants)): (
                    usize,
                    (Vec<ReadingRecord>, Plan, Vec<EpisodeTick>),
                )| {
                    for instant in &mut instants {
                        moment += 1;
                        instant.time_s = f64::from(moment) * substep_s;
                    }
                    let change = |light| LightChangeRecord {
                        light,
                        change: LightChange {
                            time_s: f64::from(moment) * substep_s,
                            course: match light {
                                0 => LightCourse::Held(LightColor::Yellow),
                                _ => LightCourse::Cycle { offset_s: -1.5 },
                            },
                        },
                    };
                    EpisodeStep {
                        step: step as u32,
                        readings,
                        plan,
                        warm_up: step % 2 == 1,
                        instants,
                        handovers: vec![],
                        commands: (0..agents).map(command).collect(),
                        lights: (0..lights).map(change).collect(),
                    }
                };
                let steps: Vec<EpisodeStep> = steps.into_iter().enumerate().map(number).collect();
                let mut episode = Episode {
                    head,
                    start,
                    steps: vec![],
                    end,
                    others: vec![],
                };
                steps.into_iter().for_each(|step| episode.push(step));
                episode
            },
        )
    })
}

/// An episode of three short steps with one agent.
pub fn small() -> Episode {
    let mut scenario: Scenario = decouplegs_logs::scenario_file::parse(
        &crate::scenario_files::example().replace("\"hard\"", "\"easy\""),
    )
    .unwrap();
    scenario.pedestrians.clear();
    let state = |x: f64| VehicleState {
        position_m: DVec2::new(x, 0.1),
        speed_mps: 8.0,
        ..VehicleState::default()
    };
    let instant = |time_s: f64| EpisodeTick {
        time_s,
        ego: state(8.0 * time_s),
        steer_rad: 0.01,
        on_road: true,
        lanes: None,
        road: Some(RoadRecord::default()),
        agents: vec![Some(state(20.0 + time_s))],
    };
    let step = |step: u32| EpisodeStep {
        step,
        readings: vec![ReadingRecord {
            sensor: "front".into(),
            hash: 7 << 100 | u128::from(step),
        }],
        plan: Plan::new(vec![PlanPoint {
            time_s: 0.5,
            position_m: DVec2::new(4.0, -0.0),
        }])
        .unwrap(),
        warm_up: false,
        instants: vec![
            instant(0.5 * f64::from(step) + 0.25),
            instant(0.5 * f64::from(step) + 0.5),
        ],
        // Logs without handovers do not tell of them.
        handovers: match step {
            1 => vec![HandoverRecord {
                agent: 0,
                time_s: 0.6,
            }],
            _ => vec![],
        },
        commands: vec![],
        lights: vec![],
    };
    let planner = PlannerRecord {
        name: "lane-follow".into(),
        cameras: vec!["front".into()],
        lidars: Vec::new(),
        localization: false,
        privileged: true,
    };
    let drawn_by = DrawnBy {
        device: "a device".into(),
        width_px: 64,
        height_px: 36,
        every: 1,
        f_theta: false,
    };
    Episode {
        head: EpisodeHead {
            log_version: VERSION,
            version: "0.1.0".into(),
            agent_sizes: vec![VehicleSize::CAR],
            stop_lines: vec![],
            sign_lines: vec![],
            agent_driver: None,
            scenario,
            planner,
            drawn_by: Some(drawn_by),
            route_m: vec![DVec2::ZERO, DVec2::new(100.0, 1.0 / 3.0)],
        },
        start: instant(0.0),
        steps: (0..3).map(step).collect(),
        end: EpisodeEnd::Collision { agent: 0 },
        others: vec![],
    }
}

fn lines_of(bytes: &[u8]) -> Vec<Vec<u8>> {
    bytes
        .split_inclusive(|&byte| byte == b'\n')
        .map(<[u8]>::to_vec)
        .collect()
}

fn complaint(bytes: &[u8]) -> String {
    decode(bytes).unwrap_err().to_string()
}

#[test]
fn every_flip_of_a_bit_is_found() {
    let bytes = encode(&small()).unwrap();
    assert_eq!(decode(&bytes).unwrap(), small());
    let lines = lines_of(&bytes);
    let mut line = 1;
    for at in 0..bytes.len() {
        let mut broken = bytes.clone();
        for flip in (0..8).map(|bit| 1u8 << bit).chain([0x20 ^ b'\n', 0xff]) {
            broken[at] = bytes[at] ^ flip;
            let complaint = complaint(&broken);
            assert!(
                complaint.contains(&format!("line {line}: ")),
                "byte {at} of line {line}, flip {flip:#04x}: {complaint}"
            );
        }
        line += usize::from(bytes[at] == b'\n');
    }
    assert_eq!(line, 1 + lines.len());
}

#[test]
fn every_truncation_is_found() {
    let bytes = encode(&small()).unwrap();
    for length in 0..bytes.len() {
        let (complaint, whole) = (
            complaint(&bytes[..length]),
            lines_of(&bytes[..length]).len(),
        );
        match length {
            0 => assert!(complaint.contains("is empty"), "{complaint}"),
            _ if bytes[length - 1] == b'\n' => {
                assert!(
                    complaint.starts_with(&format!("line {}: is missing", whole + 1)),
                    "{length}: {complaint}"
                );
            }
            _ => assert!(
                complaint.starts_with(&format!("line {whole}: has no end")),
                "{length}: {complaint}"
            ),
        }
    }
}

#[test]
fn lines_that_are_moved_left_out_repeated_or_of_another_log_are_found() {
    let bytes = encode(&small()).unwrap();
    let lines = lines_of(&bytes);
    let joined = |order: &[usize]| {
        order
            .iter()
            .flat_map(|&line| lines[line].clone())
            .collect::<Vec<u8>>()
    };
    assert_eq!(joined(&[0, 1, 2, 3, 4]), bytes);
    for (order, line) in [
        (&[0, 2, 1, 3, 4][..], 2),
        (&[0, 1, 3, 4], 3),
        (&[0, 1, 2, 4], 4),
        (&[0, 1, 1, 2, 3, 4], 3),
        (&[1, 2, 3, 4], 1),
        (&[4], 1),
    ] {
        let complaint = complaint(&joined(order));
        assert!(
            complaint.starts_with(&format!("line {line}: its checksum is")),
            "{order:?}: {complaint}"
        );
    }
    assert!(complaint(&joined(&[0, 1, 2, 3, 4, 4])).starts_with("line 6: follows the end"));

    let mut other = small();
    other.steps[0].instants[0].ego.speed_mps = 8.5;
    let others = lines_of(&encode(&other).unwrap());
    assert_eq!(
        (&others[0], others[1] == lines[1], others[2] == lines[2]),
        (&lines[0], false, false)
    );
    let spliced = [&lines[0], &others[1], &lines[2], &lines[3], &lines[4]]
        .map(|line| line.clone())
        .concat();
    assert!(
        complaint(&spliced).starts_with("line 3: its checksum is"),
        "{}",
        complaint(&spliced)
    );
}

/// The line of `payload` behind `before`, with a good checksum: what is wrong with it is its
/// content.
fn sealed(before: &[u8; 16], payload: &str) -> Vec<u8> {
    let checksum = xxhash_rust::xxh3::xxh3_64(&[before.as_slice(), payload.as_bytes()].concat());
    format!("{checksum:016x} {payload}\n").into_bytes()
}

/// `small` with one record changed, every checksum good.
fn resealed(line: usize, from: &str, to: &str) -> Vec<u8> {
    let mut before = *b"0000000000000000";
    let mut bytes = Vec::new();
    for (index, old) in lines_of(&encode(&small()).unwrap()).iter().enumerate() {
        let payload = std::str::from_utf8(&old[17..old.len() - 1]).unwrap();
        assert!(
            index != line || payload.contains(from),
            "{payload} has no {from}"
        );
        let payload = if index == line {
            payload.replacen(from, to, 1)
        } else {
            payload.to_owned()
        };
        let new = sealed(&before, &payload);
        before = new[..16].try_into().unwrap();
        bytes.extend(new);
    }
    bytes
}

#[test]
fn records_that_do_not_hold_together_are_refused_though_their_checksums_are_good() {
    assert_eq!(
        resealed(0, "a device", "a device"),
        encode(&small()).unwrap(),
        "the checksum is as documented"
    );
    for (line, from, to, expected) in [
        (
            0,
            "decouplegs-episode",
            "decouplegs",
            "line 1: is of format \"decouplegs\", version 4",
        ),
        (
            0,
            "\"version\":4",
            "\"version\":5,\"more\":0",
            "line 1: is of format \"decouplegs-episode\", version 5",
        ),
        (
            0,
            "\"program\"",
            "\"pogrom\"",
            "line 1: is no head of an episode log: unknown field",
        ),
        (
            0,
            "duration_s = 20.0",
            "duration_s = -1.0",
            "line 1: its scenario, line",
        ),
        (
            0,
            "\"route_m\":[[0.0,0.0],",
            "\"route_m\":[",
            "line 1: a route of 1 points",
        ),
        (
            0,
            "\"agent_sizes_m\":[[4.5,1.8,1.5]]",
            "\"agent_sizes_m\":[]",
            "line 1: 0 agents have a size",
        ),
        (
            0,
            "\"start\":[0.0",
            "\"start\":[1e999",
            "line 1: is no head",
        ),
        (
            1,
            "\"step\":0",
            "\"step\":1",
            "line 2: step 1; expected step 0",
        ),
        (
            1,
            "\"plan\":[[0.5",
            "\"plan\":[[0.0",
            "line 2: point 0 of the plan is at 0 s",
        ),
        (
            1,
            "\"instants\":[[0.25",
            "\"instants\":[[0.0",
            "line 2: instant 0 of step 0 is at 0 s, not after 0 s",
        ),
        (
            1,
            "[[20.25,0.1,0.0,8.0,0.0]]",
            "[]",
            "line 2: instant 0 of step 0 has 0 agents; expected 1",
        ),
        (1, "\"step\":0", "\"step\":00", "line 2: is no record"),
        (
            1,
            "\"step\":0",
            "\"step\": 0",
            "line 2: is not written as this program writes it, from byte 8",
        ),
        (
            1,
            "[[0.5,4.0",
            "[[0.50,4.0",
            "line 2: is not written as this program writes it",
        ),
        (
            1,
            "front\",\"0",
            "front\",\"+",
            "line 2: is not written as this program writes it",
        ),
        (
            1,
            "front\",\"0",
            "front\",\"x",
            "line 2: the reading of \"front\" has the hash",
        ),
        (
            4,
            "\"agent\":0",
            "\"agent\":1",
            "line 5: a collision with agent 1 of 1",
        ),
        (
            4,
            "\"collision\",\"agent\":0",
            "\"magic\"",
            "line 5: is no record of a step or an end",
        ),
    ] {
        let complaint = complaint(&resealed(line, from, to));
        assert!(
            complaint.starts_with(expected),
            "{from} -> {to}: {complaint}; expected {expected}"
        );
    }
}
