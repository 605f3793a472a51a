//! A log that was written once must mean the same for ever. It seeds the fuzz target, too.

use std::path::Path;

use decouplegs_logs::read_episode_log;
use decouplegs_scene::{Episode, EpisodeEnd, VehicleSize};

/// Frozen: a reader that no longer understands it is broken, whatever is written today.
#[test]
fn an_episode_log_of_version_1_reads_as_it_was_written() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../asset/fuzz/seeds/episode_log/small.log");
    let Episode {
        head,
        start,
        steps,
        end,
        ..
    } = read_episode_log(&path).unwrap();
    assert_eq!(
        (head.scenario.seed, head.scenario.agents[0].behaviors.len()),
        (0xfedc_ba98_7654_3210, 1)
    );
    assert_eq!(
        (head.planner.name.as_str(), head.planner.privileged),
        ("lane-follow", true)
    );
    assert_eq!(
        (head.route_m[1].y, head.agent_sizes.as_slice()),
        (1.0 / 3.0, &[VehicleSize::CAR][..])
    );
    assert_eq!(
        (start.ego.speed_mps, steps.len(), end),
        (8.0, 3, EpisodeEnd::Collision { agent: 0 })
    );
    let last = &steps[2];
    assert_eq!(
        (last.step, last.readings[0].hash, last.instants.len()),
        (2, 7 << 100 | 2, 2)
    );
    assert!(
        last.plan.points()[0].position_m.y.is_sign_negative(),
        "minus zero has a sign"
    );
    assert_eq!(
        (
            last.instants[1].agents[0].unwrap().position_m.x,
            last.instants[1].on_road
        ),
        (20.0 + 1.5 / 3.0, false)
    );
}
