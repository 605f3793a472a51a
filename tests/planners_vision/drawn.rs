//! Single images of a drawn road.

use super::drawn_road::{DrawnRoad, camera};
use super::glance;

#[test]
fn the_lane_is_found_where_it_was_drawn() {
    let camera = camera();
    for light in [1.0, 0.25] {
        for (offset_m, heading_rad, width_m) in [(0.0, 0.0, 3.3), (0.4, 0.02, 3.3), (-0.4, 0.03, 3.5), (0.25, -0.03, 3.0)] {
            let road = DrawnRoad { offset_m, heading_rad, width_m, dashes_m: 5.0, light, ..DrawnRoad::default() };
            let perception = glance(&camera, &road.image(&camera));
            let (off_m, off_rad) = (perception.lane_offset_m - offset_m, perception.lane_heading_rad - heading_rad);
            assert!(off_m.abs() < 0.12 && off_rad.abs() < 0.012, "{road:?} was seen as {perception:?}");
            assert_eq!((perception.unseen_m, perception.gap_m), (0.0, None), "{road:?}");
        }
    }
}

#[test]
fn the_car_ahead_is_found_by_its_foot() {
    let camera = camera();
    for light in [1.0, 0.3] {
        for gap_m in [4.0, 6.0, 9.0, 13.0, 18.0, 25.0] {
            let road = DrawnRoad { gap_m: Some(gap_m), light, ..DrawnRoad::default() };
            let seen_m = glance(&camera, &road.image(&camera)).gap_m.unwrap_or_else(|| panic!("{road:?}: no car was seen"));
            assert!((seen_m - gap_m).abs() < 0.1 * gap_m + 0.5, "{road:?}: seen at {seen_m} m");
        }
    }
}

#[test]
fn what_lies_flat_is_no_car() {
    let camera = camera();
    let flat = [
        DrawnRoad::default(),
        DrawnRoad { shade_m: Some([12.0, 24.0]), ..DrawnRoad::default() },
        DrawnRoad { shade_m: Some([0.0, 11.0]), ..DrawnRoad::default() },
        DrawnRoad { shade_m: Some([9.0, 1e9]), ..DrawnRoad::default() },
        DrawnRoad { bars_m: Some([9.0, 12.0]), ..DrawnRoad::default() },
        DrawnRoad { bars_m: Some([18.0, 21.0]), ..DrawnRoad::default() },
        DrawnRoad { light: 0.0, ..DrawnRoad::default() },
    ];
    for road in flat {
        assert_eq!(glance(&camera, &road.image(&camera)).gap_m, None, "{road:?}");
    }
}

#[test]
fn bars_of_a_crosswalk_are_no_lane() {
    let camera = camera();
    let road = DrawnRoad { offset_m: 0.3, bars_m: Some([8.0, 11.0]), ..DrawnRoad::default() };
    let perception = glance(&camera, &road.image(&camera));
    assert!((perception.lane_offset_m - 0.3).abs() < 0.12, "{perception:?}");
}
