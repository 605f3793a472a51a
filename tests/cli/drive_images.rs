//! Images of `decouplegs drive`: lamps of traffic lights, and road users of all kinds.

use super::*;

/// Runs scenarios of half a second on the street, each with its own tables; the first front image
/// of each.
fn front_images<const N: usize>(scenarios: [(&str, &str); N]) -> [Image; N] {
    let folder = tempfile::tempdir().unwrap();
    let paths = scenarios.map(|(name, tables)| {
        let text = format!(
            "version = 1\nname = \"{name}\"\nseed = 1\nduration_s = 0.5\n[place.street]\nweather = \"clear\"\nbackground = 20000\n\
             agent_splats = 400\nseed = 1\n[ego]\nroute = [\"main/forward/1/before\"]\nstart_m = 348.0\nend_m = 360.0\nspeed_mps = 8.0\n\
             cruise_mps = 8.0\n{tables}"
        );
        let path = folder.path().join(format!("{name}.toml"));
        fs::write(&path, text).unwrap();
        path
    });
    let out = folder.path().join("run");
    let mut words = vec!["drive", "--planner", "constant-velocity", "--all-cameras"];
    words.extend(["--size", "320x180", "--images", "all", "--out", text(&out)]);
    words.extend(paths.iter().map(|path| text(path)));
    succeed(&words);
    scenarios
        .map(|(name, _)| Image::read(&out.join(format!("images/{name}/front_0000.png"))).unwrap())
}

#[test]
fn every_road_user_is_in_the_image() {
    let vehicle = |kind: &str, size: &str, at_m: f64| {
        format!(
            "[[agent]]\nname = \"a\"\nkind = \"{kind}\"\nasset = 0\nsize_m = {size}\nlane = \"main/forward/1/before\"\nat_m = {at_m}\n\
             speed_mps = 6.0\n"
        )
    };
    let truck = vehicle("truck", "[7.8, 2.4, 3.3]", 362.0);
    let cyclist = vehicle("cyclist", "[1.8, 0.6, 1.75]", 357.0);
    // Ahead of the ego, which starts at x = 8 m, y = -4.95 m.
    let walker = "[[pedestrian]]\nname = \"p\"\nasset = 1\npath_m = [[15.0, -6.0], [15.0, 9.0]]\nat_time_s = 9.0\n";
    let sign = |kind: &str| {
        format!("[[sign]]\nkind = \"{kind}\"\nlane = \"main/forward/1/before\"\nat_m = 358.0\n")
    };
    let (stop, give_way) = (sign("stop"), sign("yield"));
    let images = front_images([
        ("nobody", ""),
        ("truck", &truck),
        ("cyclist", &cyclist),
        ("walker", walker),
        ("stop", &stop),
        ("yield", &give_way),
    ]);
    // Pixels that differ from the street without anybody, and the columns that they span.
    let changed = |image: &Image| {
        let pairs = images[0].rgb.iter().zip(&image.rgb).enumerate();
        let columns: Vec<usize> = pairs
            .filter(|(_, (a, b))| (0..3).any(|channel| (a[channel] - b[channel]).abs() > 0.1))
            .map(|(pixel, _)| pixel % 320)
            .collect();
        let (low, high) = (columns.iter().min(), columns.iter().max());
        (
            columns.len(),
            low.copied().unwrap_or(0),
            high.copied().unwrap_or(0),
        )
    };
    let [truck, cyclist, walker, stop, give_way] =
        [1, 2, 3, 4, 5].map(|index| changed(&images[index]));
    println!("{truck:?} {cyclist:?} {walker:?} {stop:?} {give_way:?}");
    assert!(
        truck.0 > 2 * cyclist.0 && cyclist.0 > 60,
        "{truck:?}, {cyclist:?}"
    );
    assert!(truck.2 - truck.1 > cyclist.2 - cyclist.1);
    // The pedestrian stands 1 m to the right of the ego's middle.
    assert!(walker.0 > 60 && walker.1 > 160, "{walker:?}");
    // Signs stand to the right of the lane, and do not look alike.
    assert!(stop.0 > 30 && stop.1 > 180, "{stop:?}");
    assert!(give_way.0 > 30 && give_way.1 > 180, "{give_way:?}");
    assert!(images[4].rgb != images[5].rgb);
}

#[test]
fn lamps_show_the_phase_of_their_light() {
    let light = |color: &str| {
        format!(
            "[[light]]\nname = \"main\"\nstop_lines = [[\"main/forward/1/before\", 365.2]]\nphases = [[\"{color}\", 9.0]]\n"
        )
    };
    let [red, green, none] = front_images([
        ("red", &light("red")),
        ("green", &light("green")),
        ("none", ""),
    ]);
    // Pixels of the first image that are redder than in the second, and greener.
    let changed = |a: &Image, b: &Image| {
        let redness = |rgb: &[f32; 3]| rgb[0] - rgb[1];
        let by: Vec<f32> = a
            .rgb
            .iter()
            .zip(&b.rgb)
            .map(|(a, b)| redness(a) - redness(b))
            .collect();
        let count = |is: &dyn Fn(f32) -> bool| by.iter().filter(|by| is(**by)).count();
        (count(&|by| by > 0.25), count(&|by| by < -0.25))
    };
    // The red lens lights up and the green one goes out.
    assert!(changed(&red, &green).0 > 10, "{:?}", changed(&red, &green));
    assert_eq!(changed(&red, &green).1, 0);
    // Without lights the lamps of the main street are painted green.
    assert!(changed(&red, &none).0 > 10 && changed(&green, &none).0 == 0);
    // The light of the other street is not in these scenarios: nothing else differs.
    let far = red
        .rgb
        .iter()
        .zip(&green.rgb)
        .filter(|(a, b)| a != b)
        .count();
    assert!(far < red.rgb.len() / 20, "{far} pixels differ");
}

#[test]
fn the_background_of_a_map_follows_the_area_of_its_lanes() {
    let Some(map) = data::file("a map of roads", "maps/esmini_soderleden.xodr") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let words = ["drive", "--level", "easy", "--episodes", "1", "--map"];
        let more = [
            &[
                text(&map),
                "--planner",
                "constant-velocity",
                "--out",
                text(&out),
            ],
            more,
        ];
        let said = succeed(&[&words[..], more[0], more[1]].concat());
        let scenario = fs::read_to_string(out.join("scenarios/easy_0000.toml")).unwrap();
        let line = scenario.lines().find(|line| line.starts_with("background"));
        (line.unwrap().to_owned(), said)
    };
    // 11 km of lanes.
    assert_eq!(run("auto", &["--render", "off"]).0, "background = 310000");
    let few = ["--background", "2000", "--render", "off"];
    assert_eq!(run("few", &few).0, "background = 2000");
}

/// Cameras with rolling shutters show the motion of the ego and of agents, and a log of them
/// replays bit by bit.
#[test]
fn rolling_shutters_are_driven_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let (scene, rolling) = (street.join("scene.toml"), street.join("rolling.toml"));
    let file = fs::read_to_string(&scene).unwrap();
    let shutter = "[[rig]]\nshutter = { direction = \"top_to_bottom\", readout_s = 0.1 }";
    fs::write(&rolling, file.replace("[[rig]]", shutter)).unwrap();
    let lanes = street.join("lanes.json");
    let run = |scene: &Path, name: &str| {
        let out = folder.path().join(name);
        let place = ["drive", "--scene", text(scene), "--map", text(&lanes)];
        let what = [
            "--level",
            "extreme",
            "--road-users",
            "mixed",
            "--episodes",
            "1",
        ];
        let how = [
            "--planner",
            "constant-velocity",
            "--all-cameras",
            "--size",
            "96x54",
        ];
        let out_of = ["--images", "all", "--render", "2", "--out", text(&out)];
        succeed(&[&place[..], &what, &how, &out_of].concat());
        out
    };
    let (still, rolled) = (run(&scene, "still"), run(&rolling, "rolled"));
    let name = "extreme_0000";
    let image = |out: &Path| Image::read(&out.join(format!("images/{name}/front_left_0002.png")));
    assert!(image(&still).unwrap() != image(&rolled).unwrap());
    let log = rolled.join(format!("logs/{name}.log"));
    assert!(succeed(&["replay", text(&log)]).contains("to the last bit"));
}
