//! Roads drawn from synthetic lanes.

use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::{DVec3, Vec3};

use super::canvas::Disc;
use super::paint::{Line, line};
use super::*;

/// Far from zero, as maps in UTM are.
const CORNER: DVec3 = DVec3::new(458_000.0, 5_428_000.0, 112.0);

/// The middle of [`map`].
const MIDDLE: DVec3 = DVec3::new(458_100.0, 5_428_000.0, 112.0);

/// A lane of 3.5 m along `ahead` (x or y) whose middle passes `at`, meters from the corner.
fn lane(id: &str, at: DVec3, ahead: DVec3, length_m: f64) -> Lane {
    let left = DVec3::Z.cross(ahead) * 1.75;
    let line = |offset: DVec3| {
        vec![
            CORNER + at + offset,
            CORNER + at + offset + ahead * length_m,
        ]
    };
    Lane {
        id: id.into(),
        centerline: line(DVec3::ZERO),
        left: line(left),
        right: line(-left),
        has_height: true,
        ..Lane::default()
    }
}

/// Two lanes to +x, one to -x on their left, and a crossing street of one lane to +y over all of
/// them at x = 100 m.
fn map() -> LaneMap {
    let along = |id: &str, y: f64| lane(id, DVec3::new(0.0, y, 0.0), DVec3::X, 200.0);
    let back = lane("back", DVec3::new(200.0, 3.5, 0.0), DVec3::NEG_X, 200.0);
    let across = lane("across", DVec3::new(100.0, -60.0, 0.0), DVec3::Y, 120.0);
    let walk = Lane {
        kind: LaneKind::Walking,
        ..lane("walk", DVec3::new(0.0, -7.0, 0.0), DVec3::X, 90.0)
    };
    LaneMap {
        lanes: vec![along("right", -3.5), along("left", 0.0), back, across, walk],
        offset: DVec3::ZERO,
        lights: vec![],
        signs: vec![],
    }
}

fn drawn(options: &RoadsOptions) -> Drawn {
    Drawn::new(strips(&map()).0, glam::DVec3::ZERO, vec![], options)
}

#[test]
fn lines_are_dashed_between_lanes_of_one_direction_solid_at_edges_and_absent_on_the_crossing() {
    let (strips, origin) = strips(&map());
    let index = StripIndex::new(strips);
    assert_eq!(origin, MIDDLE);
    let at = |strip: usize, at_m: f32, on_left: bool| {
        let section = index.strips[strip].at(at_m);
        let ahead = (index.strips[strip].at(at_m + 0.5).middle() - section.middle())
            .truncate()
            .normalize();
        line(&index, strip, &section, ahead, on_left)
    };
    assert_eq!(
        (at(0, 40.0, false), at(0, 40.0, true)),
        (Line::Solid, Line::Dashed),
        "the edge, and between equals"
    );
    assert_eq!(
        (at(1, 40.0, false), at(1, 40.0, true)),
        (Line::OfNeighbor, Line::Solid),
        "painted once; against traffic"
    );
    assert_eq!(
        (at(2, 40.0, false), at(2, 40.0, true)),
        (Line::Solid, Line::OfNeighbor)
    );
    for (strip, middle_m) in [(0, 100.0), (1, 100.0), (2, 100.0), (3, 60.0)] {
        assert_eq!(
            [false, true].map(|on_left| at(strip, middle_m, on_left)),
            [Line::None; 2],
            "strip {strip} on the crossing"
        );
    }
    assert_eq!(
        (at(4, 40.0, false), at(4, 40.0, true)),
        (Line::None, Line::OfNeighbor),
        "a sidewalk has none, and covers none"
    );
}

/// Discs that show paint, by how bright they are.
fn is_paint(disc: &Disc) -> bool {
    disc.albedo.min_element() > 0.5 && disc.across.length() < 0.1
}

#[test]
fn dashes_are_three_metres_long_and_six_apart() {
    let place = drawn(&RoadsOptions::default());
    let mut canvas = Canvas::new(1_000_000);
    pavement::pavement(&mut canvas, &place, 0.3);
    // The border between the two lanes to +x, away from the crossing.
    let y = -1.75;
    let on_border =
        |disc: &&Disc| (disc.middle.y - y).abs() < 0.02 && disc.middle.x < -5.0 && is_paint(disc);
    let xs: Vec<f32> = canvas
        .discs()
        .iter()
        .filter(on_border)
        .map(|disc| disc.middle.x + 100.0)
        .collect();
    assert!(xs.len() > 30, "{}", xs.len());
    assert!(xs.iter().all(|x| x.rem_euclid(9.0) < 3.0), "{xs:?}");
    let painted_m: f32 = canvas
        .discs()
        .iter()
        .filter(on_border)
        .map(|disc| disc.along.length() / pavement::SCALE_OVER_ROW)
        .sum();
    assert!(
        (painted_m / 95.0 - 1.0 / 3.0).abs() < 0.04,
        "{painted_m} m of 95"
    );
}

#[test]
fn every_place_on_a_road_is_paved_once_and_paint_is_not_covered() {
    let place = drawn(&RoadsOptions::default());
    let mut canvas = Canvas::new(1_000_000);
    pavement::pavement(&mut canvas, &place, 0.3);
    let discs = canvas.discs();
    for (x, y) in [
        (-50.0, 2.0),
        (0.0, 2.0),
        (0.3, 5.1),
        (0.5, 30.0),
        (60.0, -1.0),
    ] {
        let opacity = |disc: &Disc| {
            let offset = Vec3::new(x, y, 0.0) - disc.middle;
            let (u, v) = (
                offset.dot(disc.along) / disc.along.length_squared(),
                offset.dot(disc.across) / disc.across.length_squared(),
            );
            0.97 * (-0.5 * (u * u + v * v)).exp()
        };
        let passing: f32 = discs.iter().map(|disc| 1.0 - opacity(disc)).product();
        let layers: f32 = discs.iter().map(opacity).sum();
        assert!(
            passing < 0.12,
            "{passing} of the light passes the road at {x}, {y}"
        );
        assert!(layers < 4.5, "{layers} layers at {x}, {y}");
    }
    // What lies over the middle of a solid line beside it.
    let paint = discs
        .iter()
        .find(|disc| is_paint(disc) && (disc.middle.x + 50.0).abs() < 2.0)
        .unwrap();
    let beside: f32 = discs
        .iter()
        .filter(|disc| !is_paint(disc))
        .map(|disc| {
            let offset = paint.middle - disc.middle;
            let (u, v) = (
                offset.dot(disc.along) / disc.along.length_squared(),
                offset.dot(disc.across) / disc.across.length_squared(),
            );
            0.97 * (-0.5 * (u * u + v * v)).exp()
        })
        .sum();
    assert!(beside < 0.5, "asphalt of weight {beside} over paint");
}

#[test]
fn counts_are_exact_bits_are_the_same_and_splats_are_whole() {
    for splats in [0, 1, 500, 5_000, 60_000] {
        let options = RoadsOptions {
            splats,
            ..RoadsOptions::default()
        };
        let scene = generate(&map(), &options);
        assert_eq!((scene.background.len(), scene.origin), (splats, MIDDLE));
        assert!(
            (0..splats).all(|splat| scene.background.defect_of(splat).is_none()),
            "{splats} splats"
        );
        assert_eq!(generate(&map(), &options).background, scene.background);
    }
    let other = generate(
        &map(),
        &RoadsOptions {
            splats: 5_000,
            seed: u64::MAX,
            ..RoadsOptions::default()
        },
    );
    assert_ne!(
        other.background,
        generate(
            &map(),
            &RoadsOptions {
                splats: 5_000,
                ..RoadsOptions::default()
            }
        )
        .background
    );
}

/// Mean display value of splats that lie on the road.
fn brightness_of_road(scene: &RoadsScene) -> f32 {
    let on_road =
        |mean: &[f32; 3]| mean[0].abs() < 90.0 && mean[1].abs() < 1.0 && mean[2].abs() < 0.3;
    let colors: Vec<f32> = (scene.background.means.iter().zip(&scene.background.sh_dc))
        .filter(|(mean, _)| on_road(mean))
        .map(|(_, dc)| 0.5 + sh::Y0 as f32 * dc[1])
        .collect();
    assert!(colors.len() > 40, "{}", colors.len());
    colors.iter().sum::<f32>() / colors.len() as f32
}

#[test]
fn roads_are_as_bright_as_their_probe_and_exposure() {
    let probes = crate::probes::procedural_probes();
    let under = |name: Option<&str>, exposure_ev: f64| {
        let probe = name.map(|name| {
            probes
                .iter()
                .find(|probe| probe.name == name)
                .unwrap()
                .clone()
        });
        generate(
            &map(),
            &RoadsOptions {
                splats: 20_000,
                probe,
                exposure_ev,
                ..RoadsOptions::default()
            },
        )
    };
    let road = |name: &str, exposure_ev: f64| brightness_of_road(&under(Some(name), exposure_ev));
    let (day, dusk, night) = (
        road("clear-55", 0.0),
        road("dusk", 0.0),
        road("night-lamps", 0.0),
    );
    assert!(
        day > 0.35 && dusk < 0.7 * day && night < 0.5 * dusk,
        "{day}, {dusk}, {night}"
    );
    // One stop is a factor of two in linear light.
    assert!((road("dusk", 1.0) / dusk - 2f32.powf(1.0 / 2.2)).abs() < 0.02);
    let overcast = under(None, 0.0);
    assert!(
        (0.3..0.6).contains(&brightness_of_road(&overcast))
            && overcast.sky.iter().all(|value| (0.4..1.0).contains(value))
    );
    assert!(
        under(Some("night-lamps"), 0.0)
            .sky
            .iter()
            .all(|value| *value < 0.3)
    );
}

#[test]
fn splats_are_finer_along_the_way_of_the_cameras() {
    let way_m = vec![CORNER, CORNER + DVec3::X * 60.0];
    let scene = generate(
        &map(),
        &RoadsOptions {
            splats: 20_000,
            way_m,
            ..RoadsOptions::default()
        },
    );
    let near = |x: std::ops::Range<f32>| {
        let on_road =
            |mean: &&[f32; 3]| x.contains(&mean[0]) && mean[1].abs() < 5.0 && mean[2].abs() < 0.3;
        scene.background.means.iter().filter(on_road).count()
    };
    assert!(
        near(-90.0..-50.0) > 4 * near(50.0..90.0),
        "{} and {}",
        near(-90.0..-50.0),
        near(50.0..90.0)
    );
}

#[test]
fn maps_that_are_no_maps_are_land_under_a_sky() {
    let options = RoadsOptions {
        splats: 3_000,
        ..RoadsOptions::default()
    };
    assert_eq!(
        generate(&LaneMap::default(), &options).background.len(),
        3_000
    );
    let point = Lane {
        centerline: vec![CORNER; 2],
        ..Lane::default()
    };
    let nowhere = Lane {
        centerline: vec![DVec3::NAN, CORNER],
        ..Lane::default()
    };
    let endless = Lane {
        centerline: vec![CORNER, DVec3::splat(1e300)],
        ..Lane::default()
    };
    let long = Lane {
        centerline: vec![CORNER, CORNER + DVec3::X * 40_000.0],
        ..Lane::default()
    };
    let wide = Lane {
        left: vec![CORNER, CORNER + DVec3::Y * 1e4],
        ..lane("wide", DVec3::ZERO, DVec3::X, 1e3)
    };
    let scene = generate(
        &LaneMap {
            lanes: vec![point, nowhere, endless, long, wide],
            offset: DVec3::ZERO,
            lights: vec![],
            signs: vec![],
        },
        &options,
    );
    assert_eq!(scene.background.len(), 3_000);
    assert!((0..3_000).all(|splat| scene.background.defect_of(splat).is_none()));
}
