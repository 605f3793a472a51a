//! Files as the field writes them: each is read with the right values, or refused with the reason.
//! They lie beside the public test files.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use decouplegs::scenario_import::import_open_scenario;
use decouplegs::scene::RoadUser;

use super::*;

/// A file of the field. `None`, with a word of it, where it is missing.
fn of_field(name: &str) -> Option<PathBuf> {
    data::file(
        &format!("the field's {name}"),
        &format!("../repro/field/{name}"),
    )
}

/// Everything that a run says; it must end with `code`.
fn said(code: i32, arguments: &[&str]) -> String {
    let output = decouplegs(arguments);
    let both = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&both).into_owned();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
    text
}

#[test]
fn maps_are_read_by_the_letter_of_their_formats() {
    let at = |mps: &str| format!("{mps} m/s");
    let same = |mps: &str| at(&format!("{mps} to {mps}"));
    let late = "begins after its road or section";
    let cases: Vec<(&str, i32, Vec<String>)> = vec![
        ("maps/bom.xodr", 0, vec![at("13.89 to 27.78")]),
        ("maps/nsprefix.xodr", 0, vec![at("13.89 to 27.78")]),
        (
            "maps/speed_types.xodr",
            0,
            vec!["driving          2".into(), at("13.89 to 27.78")],
        ),
        ("maps/speed_lane.xodr", 0, vec![at("8.33 to 13.90")]),
        (
            "maps/speed_lane_late.xodr",
            0,
            vec![format!("1 of 2 lanes, {}", same("8.33"))],
        ),
        ("maps/speed_kmh_txt.xodr", 0, vec![same("13.89")]),
        ("maps/speed_kph.xodr", 0, vec![same("13.89")]),
        (
            "maps/speed_nolimit.xodr",
            0,
            vec!["known to no lane".into()],
        ),
        ("maps/elev_late.xodr", 0, vec![late.into()]),
        ("maps/lo_late.xodr", 0, vec![late.into()]),
        ("maps/width_late.xodr", 0, vec![late.into()]),
        (
            "maps/gap.xodr",
            0,
            vec![
                "1 links of lanes are dropped".into(),
                "1/0/-1 to 2/0/-1".into(),
            ],
        ),
        (
            "maps/multi_pred.xodr",
            0,
            vec!["2 from lane to lane".into()],
        ),
        ("maps/nolink.xodr", 0, vec!["2 from lane to lane".into()]),
        ("maps/single.xodr", 0, vec!["driving          5".into()]),
        ("maps/bidir.xodr", 0, vec!["driving          1".into()]),
        ("maps/shared18.xodr", 0, vec!["other            1".into()]),
        ("maps/tram.xodr", 0, vec!["driving          1".into()]),
        ("maps/offset_hdr.xodr", 0, vec!["driving          1".into()]),
        ("maps/cr_b14.xml", 0, vec![same("13.90")]),
        ("maps/cr_kmh.xml", 0, vec![same("13.89")]),
        ("maps/cr_num.xml", 0, vec![same("13.90")]),
        ("maps/doctype.xodr", 1, vec!["XML with DTD".into()]),
        (
            "maps/latin1.xodr",
            1,
            vec!["expected XML in UTF-8".into(), "iconv".into()],
        ),
        ("maps/utf16.xodr", 1, vec!["a text in UTF-16".into()]),
        ("maps/plain.osm", 1, vec!["plain OpenStreetMap".into()]),
        ("lanelet2/bare.osm", 0, vec!["driving          1".into()]),
        ("lanelet2/road.osm", 0, vec!["driving          1".into()]),
        (
            "lanelet2/road_bike.osm",
            0,
            vec!["bicycle          1".into()],
        ),
        (
            "lanelet2/road_novehicle.osm",
            0,
            vec!["walking          1".into()],
        ),
        (
            "lanelet2/speed_empty.osm",
            0,
            vec!["known to no lane".into()],
        ),
        ("lanelet2/speed_inf.osm", 0, vec!["known to no lane".into()]),
        ("lanelet2/speed_kmph.osm", 0, vec![same("13.89")]),
        ("lanelet2/speed_sp.osm", 0, vec![same("13.89")]),
        ("lanelet2/speed_ms.osm", 0, vec![same("10.00")]),
        ("lanelet2/speed_nounit.osm", 0, vec![same("11.11")]),
    ];
    for (name, code, expected) in cases {
        let Some(path) = of_field(name) else {
            continue;
        };
        let found = said(code, &["map", text(&path)]);
        for expected in expected {
            assert!(
                found.contains(&expected),
                "{name}: no {expected:?} in {found}"
            );
        }
    }
}

#[test]
fn splats_of_other_trainers_are_read_or_named() {
    for (name, code, expected) in [
        ("ply/2dgs.ply", 0, "two scales a splat, as 2DGS writes them"),
        (
            "ply/rgb.ply",
            0,
            "colors are red, green and blue, as nerfstudio writes them",
        ),
        ("ply/ascii.ply", 0, "splats           300"),
        ("ply/big.ply", 1, "the body is binary_big_endian"),
        // Coordinates of a map, as doubles: an origin is taken off before they are rounded.
        ("geo/geo64.ply", 0, "bounds y         -0.996 to 0.989 m"),
        ("geo/loc.ply", 0, "bounds y         -0.996 to 0.989 m"),
    ] {
        if let Some(path) = of_field(name) {
            let found = said(code, &["inspect", text(&path)]);
            assert!(found.contains(expected), "{name}: {found}");
        }
    }
}

/// The cameras that `path` belongs to: a folder of COLMAP is named by one of its files.
fn cameras_in(path: &Path) -> &Path {
    match path.extension().and_then(OsStr::to_str) {
        Some("bin" | "txt") => path.parent().unwrap(),
        _ => path,
    }
}

/// Arguments that draw `splats` through `cameras` into the folder `out`.
fn draws<'a>(splats: &'a Path, cameras: &'a Path, out: &'a Path) -> [&'a str; 6] {
    let [splats, cameras, out] = [splats, cameras, out].map(text);
    ["render", splats, "--cameras", cameras, "--out", out]
}

#[test]
fn cameras_are_drawn_through_the_lens_that_they_name_or_not_at_all() {
    let Some(splats) = of_field("ply/rgb.ply") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let drawn = |name: &str| {
        let path = of_field(name)?;
        let out = folder.path().join(name.replace(['/', '.'], "_"));
        succeed(&draws(&splats, cameras_in(&path), &out));
        let image = fs::read_dir(&out).unwrap().next()?.unwrap().path();
        Some(fs::read(image).unwrap())
    };
    let of = |name: &str| drawn(&format!("cameras/{name}.json"));
    let middle = of("ok");
    // A principal point beside the middle, as four trainers write it: in pixels, and in shares that
    // are rounded to four digits.
    for (name, other) in [("cxcy", "K"), ("prcp", "pp_ndc")] {
        let aside = of(name);
        assert!(aside == of(other), "{name} and {other} are the same point");
        assert!(middle.is_none() || aside != middle, "{name} is dropped");
    }
    for name in ["floatw", "wrapped"] {
        assert!(of(name) == middle, "{name} is the same camera");
    }
    for name in [
        "cameras/num_name.json",
        "cameras/rot_round.json",
        "cameras/t_angy.json",
        "cameras/t_bom.json",
        "cameras/t_lower.json",
        "cameras/t_perframe.json",
        "cameras/t_xfov.json",
        "cameras/dbl/images.txt",
        "cameras/tabs/images.txt",
        "cameras/fish15/images.bin",
        "cameras/simplefish14/images.bin",
        "cameras/unused11/images.bin",
        "geo/bs.json",
        "geo/jpg.json",
        "geo/uni.json",
    ] {
        assert_eq!(drawn(name).is_some(), middle.is_some(), "{name}");
    }
    let scene = |name: &str| {
        let path = of_field(name)?;
        let out = folder.path().join(name.replace(['/', '.'], "_"));
        succeed(&["render", text(&path), "--out", text(&out)]);
        Some(fs::read(out.join("c.png")).unwrap())
    };
    assert!(
        scene("geo/geo64.toml") == scene("geo/loc.toml"),
        "a scene of a map's coordinates"
    );
    let refusals = [
        ("cameras/t_equi.json", "camera model EQUIRECTANGULAR"),
        ("cameras/t_latlong.json", "'is_latlong' is true"),
        ("cameras/t_ftheta.json", "'ftheta_p1' is 120"),
        ("cameras/t_rolling.json", "'rolling_shutter'"),
        (
            "cameras/t_intr.json",
            "keys of transforms.json that are not read: 'camera'",
        ),
        ("cameras/t_flat.json", "not a camera file"),
        ("cameras/t_nan.json", "not a camera file"),
        ("cameras/t_strnum.json", "not a camera file"),
        (
            "cameras/equirect17/images.bin",
            "camera model EQUIRECTANGULAR is not drawn",
        ),
        ("cameras/fov7/images.bin", "camera model FOV is not drawn"),
        ("geo/noext.json", "'w' is missing"),
    ];
    for (name, expected) in refusals {
        let Some(path) = of_field(name) else {
            continue;
        };
        let out = folder.path().join("refused");
        let found = said(1, &draws(&splats, cameras_in(&path), &out));
        assert!(found.contains(expected), "{name}: {found}");
        assert!(!out.exists(), "{name}: nothing is drawn");
    }
}

#[test]
fn sizes_angles_and_times_of_tracks_are_theirs_or_named() {
    let Some(map) = of_field("openscenario/m.xodr") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    for (name, code, expected) in [
        ("ok", 0, "1 of 1 tracks registered"),
        ("long", 0, "1 of 1 tracks registered"),
        ("deg", 1, "90 is more than two turns; expected radians"),
        ("us", 1, "more than a day; expected seconds"),
    ] {
        let Some(path) = of_field(&format!("tracks/{name}.csv")) else {
            continue;
        };
        let out = folder.path().join(format!("{name}.csv"));
        let out = text(&out);
        let found = said(
            code,
            &[
                "register",
                "--map",
                text(&map),
                "--tracks",
                text(&path),
                "--out",
                out,
            ],
        );
        assert!(found.contains(expected), "{name}: {found}");
        if code == 0 {
            let tracks = decouplegs::asset::read_tracks(Path::new(out)).unwrap();
            assert_eq!(tracks[0].dims_m.unwrap()[0], 8.0, "{name}");
        }
    }
}

/// Places of the ego's middle along its route, and of another's rear axle, meters.
struct Expected {
    start_m: f64,
    end_m: f64,
    other: Option<(&'static str, [f64; 2])>,
    /// Events of others, and those of them that are driven.
    events: [usize; 2],
}

#[test]
fn scenarios_have_the_places_sizes_and_events_of_their_files() {
    let alone = |start_m: f64, end_m: f64| Expected {
        start_m,
        end_m,
        other: None,
        events: [0, 0],
    };
    let beside = |name: &'static str, point_m: [f64; 2]| Expected {
        other: Some((name, point_m)),
        ..alone(51.4, 111.4)
    };
    let triggered = || Expected {
        events: [1, 1],
        ..beside("T", [100.0, -1.75])
    };
    let from_left = |start_m: f64, point_m: [f64; 2]| Expected {
        start_m,
        end_m: start_m + 60.0,
        ..beside("T", point_m)
    };
    let cases = [
        ("apos_comment", alone(51.4, 111.4)),
        ("bom", alone(51.4, 111.4)),
        ("cat_expr", alone(51.4, 111.4)),
        ("comment_dollar", alone(51.4, 111.4)),
        ("dollar_text", alone(51.4, 111.4)),
        ("expr", alone(51.4, 111.4)),
        ("expr_plain", alone(51.4, 111.4)),
        ("heading", alone(51.4, 111.4)),
        ("misc2", alone(51.4, 111.4)),
        ("misc_inline", alone(51.4, 111.4)),
        ("neg", alone(51.4, 111.4)),
        ("ns", alone(51.4, 111.4)),
        ("two_teleports", alone(51.4, 111.4)),
        ("route_ok", alone(51.4, 300.0)),
        ("route_pos", alone(51.4, 300.0)),
        ("route_start", alone(51.4, 300.0)),
        ("cat_assign", beside("T", [100.0, -1.75])),
        ("cat_assign_dollar", beside("T", [100.0, -1.75])),
        ("dlane_right", from_left(201.4, [240.0, -5.25])),
        ("ego_name", beside("Target", [100.0, -1.75])),
        ("misc", beside("Cone", [100.0, -1.75])),
        ("off_lane", beside("T", [100.0, -5.25])),
        ("ped_zero", beside("Walker", [120.0, -5.25])),
        ("rel_dslane_left", from_left(201.4, [160.0, 1.75])),
        ("rel_obj", beside("T", [100.0, -1.75])),
        ("rel_road", beside("T", [90.0, -5.25])),
        ("rel_world", beside("T", [100.0, -1.75])),
        ("road_pos", beside("T", [100.0, -5.25])),
        ("cond_reach", triggered()),
        ("cond_reldist_cart", triggered()),
        ("cond_reldist_eucl", triggered()),
        ("cond_reldist_long", triggered()),
        ("cond_thw", triggered()),
        ("cond_trav", triggered()),
        ("cond_ttc", triggered()),
        ("scope_inner_only", triggered()),
    ];
    for (name, expected) in cases {
        let Some(path) = of_field(&format!("openscenario/{name}.xosc")) else {
            continue;
        };
        let read =
            import_open_scenario(&path, None).unwrap_or_else(|error| panic!("{name}: {error}"));
        let ego = &read.scenario.ego;
        let ways_m = [ego.start_m - expected.start_m, ego.end_m - expected.end_m];
        assert!(
            ways_m.iter().all(|way_m| way_m.abs() < 1e-6),
            "{name}: {ego:?}"
        );
        assert_eq!(ego.speed_mps, 15.0, "{name}");
        let actors = &read.scenario.story.actors;
        assert_eq!(
            actors.len(),
            usize::from(expected.other.is_some()),
            "{name}"
        );
        for (actor, (other, point_m)) in actors.iter().zip(expected.other) {
            let apart_m = glam::DVec2::from(actor.point_m).distance(point_m.into());
            assert!(actor.name == other && apart_m < 1e-6, "{name}: {actor:?}");
        }
        assert_eq!([read.events, read.events_driven], expected.events, "{name}");
        match name {
            "cat_assign" | "cat_assign_dollar" => assert_eq!(actors[0].size_m[0], 9.0),
            "ped_zero" => assert_eq!(actors[0].kind, RoadUser::Pedestrian),
            "misc2" | "misc_inline" => assert_eq!(read.obstacles.len(), 1, "{name}"),
            "heading" => assert!(read.skipped[0].contains("against the direction of its lane")),
            "misc" => assert!(read.skipped[0].contains("the catalog Misc.xosc was not found")),
            _ => {}
        }
    }
    for (name, expected) in [
        (
            "no_logic",
            "it names no map (<LogicFile>); give one with --map",
        ),
        ("v09", "versions 1.0 to 1.3 are read"),
    ] {
        if let Some(path) = of_field(&format!("openscenario/{name}.xosc")) {
            let error = import_open_scenario(&path, None).unwrap_err();
            let found = decouplegs::explain::explain(&error);
            assert!(found.contains(expected), "{name}: {found}");
        }
    }
}
