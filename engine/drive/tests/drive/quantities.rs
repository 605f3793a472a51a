//! Quantities of episodes over time.

use decouplegs_drive::score::{EpisodeScore, Quantity, quantities};
use decouplegs_scene::EpisodeEnd;

use crate::episodes::{episode, straight};

fn named<'a>(all: &'a [Quantity], key: &str) -> &'a [Option<f64>] {
    let found = all.iter().find(|quantity| quantity.key == key);
    &found.unwrap_or_else(|| panic!("no {key}")).values
}

#[test]
fn scores_so_far_end_as_the_score_of_the_episode() {
    // It stands 60 m ahead, and the boxes touch after a good 5 s; the ego drives on through it.
    let standing = straight(60.0, 0.0, 0.0, 0.0);
    let ego = straight(0.0, 0.0, 0.0, 10.0);
    let driven = episode(14, &ego, &[standing], EpisodeEnd::Time);
    let score = EpisodeScore::new(&driven);
    let hit_s = score.infractions[0].time_s;
    let all = quantities(&driven, &score);
    assert!(all.iter().all(|one| one.values.len() == 14 * 5 + 1));
    let [completion, scores] = ["route_completion", "driving_score"].map(|key| named(&all, key));
    for (index, tick) in driven.instants().enumerate() {
        let (completion, so_far) = (completion[index].unwrap(), scores[index].unwrap());
        assert!((completion - 0.1 * tick.time_s).abs() < 1e-9, "{tick:?}");
        let factor = if tick.time_s < hit_s { 1.0 } else { 0.6 };
        assert!((so_far - factor * completion).abs() < 1e-9, "{tick:?}");
    }
    assert_eq!(completion.last(), Some(&Some(score.route_completion)));
    assert_eq!(scores.last(), Some(&Some(score.driving_score)));
    assert!(
        score.driving_score < score.route_completion,
        "the collision counts"
    );
    let ttc = named(&all, "time_to_collision_s");
    assert!(
        ttc[0].is_some_and(|ttc_s| (ttc_s - hit_s).abs() < 0.11),
        "{ttc:?}"
    );
    assert!(ttc.iter().flatten().any(|ttc_s| *ttc_s == 0.0), "{ttc:?}");
    assert!(
        named(&all, "speed_mps")
            .iter()
            .all(|one| *one == Some(10.0))
    );
}

#[test]
fn what_no_moment_tells_is_no_quantity() {
    let stood = straight(0.0, 0.0, 0.0, 0.0);
    let standing = episode(4, &stood, &[], EpisodeEnd::Time);
    let all = quantities(&standing, &EpisodeScore::new(&standing));
    let keys: Vec<&str> = all.iter().map(|quantity| quantity.key).collect();
    for absent in [
        "time_to_collision_s",
        "nearest_agent_m",
        "speed_limit_mps",
        "lane_offset_m",
    ] {
        assert!(!keys.contains(&absent), "{keys:?}");
    }
    assert!(
        keys.contains(&"speed_mps") && keys.contains(&"driving_score"),
        "{keys:?}"
    );
}
