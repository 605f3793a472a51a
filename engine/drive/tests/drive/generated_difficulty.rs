//! Density, surprise and time of generated scenarios, each from a level of its own.

use decouplegs_drive::generate::Difficulty;
use decouplegs_scene::Level;
use decouplegs_scene::scenario::DriverKind;

use crate::generate::street;

#[test]
fn each_part_of_the_difficulty_is_taken_from_its_level() {
    let street = street();
    let of = |difficulty: Difficulty, index: u32| {
        let generator = street.generator().with_difficulty(difficulty);
        generator.scenario(Level::Medium, 5, index).unwrap()
    };
    let part = |density, surprise, time| Difficulty {
        density,
        surprise,
        time,
    };
    for index in 0..10 {
        let plain = of(Difficulty::default(), index);
        let medium = Some(Level::Medium);
        assert_eq!(of(part(medium, medium, medium), index), plain);

        // Nothing but the time limit changes, and it falls from level to level.
        let limits = Level::ALL.map(|time| {
            let timed = of(part(None, None, Some(time)), index);
            let mut same = timed.clone();
            same.duration_s = plain.duration_s;
            assert_eq!(same, plain);
            timed.duration_s
        });
        assert!(limits.is_sorted_by(|a, b| a >= b), "{limits:?}");
        assert!(limits[0] > limits[3] + 10.0, "{limits:?}");

        let sparse = of(part(Some(Level::Easy), None, None), index);
        let dense = of(part(Some(Level::Extreme), None, None), index);
        let counts = [&sparse, &plain, &dense].map(|scenario| scenario.agents.len());
        assert!(
            counts[0] < counts[1] && counts[1] + 5 < counts[2],
            "{counts:?}"
        );
        let behaves = |scenario: &decouplegs_scene::Scenario| {
            scenario
                .agents
                .iter()
                .any(|agent| !agent.behaviors.is_empty())
        };
        assert!(!behaves(&sparse) && !behaves(&plain) && !behaves(&dense));

        let surprising = of(part(None, Some(Level::Extreme), None), index);
        assert!(behaves(&surprising));
        let calm =
            |agent: &decouplegs_scene::scenario::TrafficAgent| agent.driver == DriverKind::Calm;
        assert!(!surprising.agents.iter().any(calm));
        assert!(surprising.agents.len() < dense.agents.len());
    }
}
