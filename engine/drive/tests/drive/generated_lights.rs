//! Traffic lights of generated scenarios.

use decouplegs_scene::{Level, LightColor, TrafficLight};

use crate::generate::{roads, street};

/// Lights whose ways cross each other, both green or yellow at some time of a scenario.
fn both_open(lights: &[TrafficLight]) -> bool {
    (0..400).any(|tick| {
        let open = |light: &&TrafficLight| light.color_at(0.1 * f64::from(tick)) != LightColor::Red;
        lights.iter().filter(open).count() > 1
    })
}

#[test]
fn scenarios_have_the_lights_of_the_map_with_phases() {
    let street = street();
    let scenario = |level| street.generator().scenario(level, 3, 0).unwrap();
    for level in Level::ALL {
        let lights = scenario(level).lights;
        let names: Vec<&str> = lights.iter().map(|light| light.name.as_str()).collect();
        assert_eq!(names, ["main", "cross"]);
        assert!(!both_open(&lights));
        // The time limit follows from the reference drive, which waits at red.
        assert!(scenario(level).duration_s > 20.0);
    }
    assert_ne!(
        scenario(Level::Easy).lights[0].offset_s,
        scenario(Level::Hard).lights[0].offset_s
    );
    let plain = street.generator().without_lights();
    assert!(plain.scenario(Level::Hard, 3, 0).unwrap().lights.is_empty());
    // The comparator sees lights that are open together.
    let mut together = scenario(Level::Easy).lights;
    together[1].offset_s = together[0].offset_s;
    assert!(both_open(&together));

    // A map that tells no phases: six lights of one crossing become two.
    let Some(grounds) = roads("lanelet2_mapping_example.osm") else {
        return;
    };
    let told = &grounds.map.lights;
    assert_eq!(told.len(), 6);
    assert!(told.iter().all(|light| light.phases.is_empty()));
    let lights = grounds
        .generator()
        .scenario(Level::Easy, 1, 0)
        .unwrap()
        .lights;
    assert!(lights.len() == 2 && !both_open(&lights));
    let lines = |lights: &[TrafficLight]| -> usize {
        lights.iter().map(|light| light.stop_lines.len()).sum()
    };
    assert_eq!((lines(&lights), lines(told)), (10, 10));
}
