//! Kept lists: frames of standing cameras that keep what holds of the background give the same
//! bytes as frames that sort everything, and frames of moving cameras are what they were.

use std::sync::Arc;

use decouplegs::render::{
    Agent, AssetId, AssetPool, Capacity, ColorFormat, FrameAgents, FrameSplats, FrameStatistics,
    Image, ListSource, Outputs, Plane, Planes, RenderOptions, Renderer, ResidentSplats,
};
use decouplegs::scene::{
    Camera, DepthOrder, Fog, Pose, Rules, Shutter, ShutterDirection, SplatScene,
};
use glam::{DMat3, DVec3};

use super::agents::{background, camera_towards, coded_car};
use super::light::shadow;
use super::{all_outputs, sky};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

/// Two cameras at stop `stop` of a drive.
fn rig(stop: usize) -> Vec<Camera> {
    let eye = DVec3::new(0.2 * stop as f64, 0.0, 0.5);
    let ahead = eye + DVec3::new(1.0, 0.05 * stop as f64, 0.0);
    vec![
        camera_towards("front", eye, ahead, (320, 160)),
        camera_towards("side", eye, eye + DVec3::new(1.0, 0.8, 0.0), (150, 90)),
    ]
}

/// Cars of frame `frame`: one drives by, the second appears in frame 4 and leaves in frame 8, and
/// no camera sees one in frames 10 and 11.
fn cars(asset: AssetId, frame: usize) -> Vec<Agent> {
    let t = frame as f64;
    let car =
        |x: f64, y: f64, id| Agent::new(asset, Pose::from_yaw(0.1 * t, DVec3::new(x, y, 0.0)), id);
    let mut cars = Vec::new();
    if !(10..12).contains(&frame) {
        cars.push(car(9.0 + 0.3 * t, 0.5, 1));
    }
    if (4..8).contains(&frame) {
        cars.push(car(14.0, 6.0 - t, 2));
    }
    cars
}

/// A world, and a pool with a car.
struct Site {
    gpu: Validated,
    world: SplatScene,
    pool: AssetPool,
    car: AssetId,
    /// Cameras at a stop.
    rig: fn(usize) -> Vec<Camera>,
}

impl Site {
    fn new(world: SplatScene) -> Self {
        let gpu = Validated::open();
        let mut pool = AssetPool::new(&gpu).unwrap();
        let car = pool.add(&coded_car(500, 5)).unwrap();
        Self {
            gpu,
            world,
            pool,
            car,
            rig,
        }
    }

    fn renderer(&self, keep_lists: bool, options: RenderOptions) -> (Renderer, ResidentSplats) {
        let renderer = Renderer::new(
            &self.gpu,
            RenderOptions {
                keep_lists,
                ..options
            },
        )
        .with_capacity(ROOM);
        let resident = renderer.upload(&self.world).unwrap();
        (renderer, resident)
    }

    /// Frames with the cameras at `stops`, one stop per frame, drawn by `renderer`.
    fn drive(
        &self,
        renderer: &mut Renderer,
        world: &ResidentSplats,
        stops: &[usize],
    ) -> Vec<Shown> {
        let depth = renderer.options().frames_in_flight;
        let mut shown = Vec::new();
        for step in 0..stops.len() + depth - 1 {
            if let Some(&stop) = stops.get(step) {
                let cars = cars(self.car, step);
                let frame_agents = FrameAgents::new(&cars[..]);
                let scene = FrameSplats::with_agents(world, &self.pool, &frame_agents);
                renderer.submit(scene, &(self.rig)(stop)).unwrap();
            }
            if step + 1 >= depth {
                let statistics = renderer.finish().unwrap();
                shown.push((statistics, renderer.read_images().unwrap()));
            }
        }
        shown
    }

    /// Frames of the drive with and without kept lists, whose bytes are the same.
    fn compare(&self, options: RenderOptions, stops: &[usize]) -> [Vec<Shown>; 2] {
        let [kept, sorted] = [true, false].map(|keep_lists| {
            let (mut renderer, world) = self.renderer(keep_lists, options);
            self.drive(&mut renderer, &world, stops)
        });
        assert!(
            sorted
                .iter()
                .all(|(statistics, _)| statistics.lists == ListSource::Sorted)
        );
        check_images(&kept, &sorted).unwrap();
        [kept, sorted]
    }
}

/// Statistics and images of a frame.
type Shown = (FrameStatistics, Vec<Image>);

/// Says which frame differs first.
fn check_images(frames: &[Shown], others: &[Shown]) -> Result<(), String> {
    assert_eq!(frames.len(), others.len());
    let same = |(frame, other): (&Shown, &Shown)| frame.1 == other.1;
    match frames.iter().zip(others).map(same).position(|same| !same) {
        Some(frame) => Err(format!(
            "frame {frame} differs ({:?})",
            frames[frame].0.lists
        )),
        None => Ok(()),
    }
}

/// Sources of the lists of frames, a letter each.
fn sources(frames: &[Shown]) -> String {
    let letter = |(statistics, _): &Shown| match statistics.lists {
        ListSource::Sorted => 's',
        ListSource::Found => 'f',
        ListSource::Kept => 'k',
    };
    frames.iter().map(letter).collect()
}

const STANDING: [usize; 14] = [0; 14];

/// Coarse tiles of the two cameras.
const BINS: u32 = 5 * 5 + 3 * 3;

/// Room for all frames of this file.
const ROOM: Capacity = Capacity {
    records: 20_000,
    pairs: 60_000,
    partials: 2000,
    tiles: 20_000,
};

#[test]
fn standing_cameras_show_moving_agents_bit_by_bit() {
    let site = Site::new(background(6000, 4));
    for frames_in_flight in [1, 2, 3] {
        let options = RenderOptions {
            frames_in_flight,
            outputs: all_outputs(),
            ..RenderOptions::default()
        };
        let [frames, sorted] = site.compare(options, &STANDING);
        assert_eq!(
            sources(&frames),
            "sfkkkkkkkkkkkk",
            "{frames_in_flight} in flight"
        );
        let items = |frame: usize| frames[frame].0.required.items;
        assert!(
            (4..14).all(|frame| items(frame) < BINS),
            "coarse tiles that are in the image are blended again"
        );
        // Nothing of two frames without cars differs.
        assert_eq!(frames[10].1, frames[11].1);
        if frames_in_flight == 1 {
            assert_eq!(items(11), 0);
        }
        // Records and pairs are counted as if all of them were sorted.
        for (frame, sorted) in frames.iter().zip(&sorted) {
            let (found, expected) = (frame.0.required, sorted.0.required);
            assert_eq!(
                (found.records, found.pairs),
                (expected.records, expected.pairs)
            );
        }
        // The comparison sees a frame that shows another moment.
        let mut late = frames.clone();
        late[6].1 = frames[5].1.clone();
        assert_eq!(
            check_images(&late, &frames).unwrap_err(),
            "frame 6 differs (Kept)"
        );
    }
}

#[test]
fn cameras_that_go_stand_and_go_show_the_same_bytes() {
    let site = Site::new(background(4000, 14));
    let stops = [0, 1, 2, 3, 3, 3, 3, 3, 4, 5, 5, 6, 6, 6, 3, 3, 3];
    for frames_in_flight in [1, 2] {
        let options = RenderOptions {
            frames_in_flight,
            ..RenderOptions::default()
        };
        let [frames, _] = site.compare(options, &stops);
        assert_eq!(sources(&frames), "ssssfkkkssfsfksfk");
    }
}

#[test]
fn all_rules_and_outputs_are_the_same() {
    let site = Site::new(background(3000, 24));
    let radial = Rules {
        order: DepthOrder::Radial,
        ..Rules::DEFAULT
    };
    let bytes = Outputs {
        color: ColorFormat::U8,
        planes: Planes::BESIDE_COLOR,
        ..Outputs::default()
    };
    let geometry = Outputs {
        planes: [
            Plane::Depth,
            Plane::Normal,
            Plane::DepthMedian,
            Plane::SceneFlow,
        ]
        .into_iter()
        .collect(),
        ..Outputs::default()
    };
    let means = Outputs {
        planes: [Plane::Range, Plane::Normal, Plane::FlowForward].into(),
        ..Outputs::default()
    };
    let cases = [
        (Rules::GSPLAT15, all_outputs(), 64),
        (Rules::INRIA, bytes, 992),
        (Rules::NUREC, bytes, 64),
        (radial, bytes, 128),
        (Rules::DEFAULT, geometry, 128),
        (Rules::DEFAULT, means, 128),
    ];
    for (rules, outputs, segment_pairs) in cases {
        let options = RenderOptions {
            rules,
            outputs,
            segment_pairs,
            ..RenderOptions::default()
        };
        let [frames, sorted] = site.compare(options, &STANDING[..9]);
        assert_eq!(sources(&frames), "sfkkkkkkk", "{rules:?}, {outputs:?}");
        let items = |frames: &[Shown]| frames[8].0.required.items;
        assert!(items(&frames) < items(&sorted), "{rules:?}, {outputs:?}");
    }
}

#[test]
fn images_that_are_processed_are_blended_whole() {
    let site = Site::new(SplatScene {
        sky_map: Some(Arc::new(sky::noise(8, DMat3::IDENTITY))),
        ..background(2000, 34)
    });
    let [frames, sorted] = site.compare(RenderOptions::default(), &STANDING[..8]);
    assert_eq!(sources(&frames), "sfkkkkkk");
    assert_eq!(frames[7].0.required.items, sorted[7].0.required.items);
}

/// Lenses of all kinds that follow a turning vehicle, read out by rows, in fog: the same in every
/// frame, they stand.
#[test]
fn lenses_rolling_shutters_and_fog_are_the_same() {
    let mut site = Site::new(SplatScene {
        fog: Some(Fog::new(0.02, [0.5, 0.6, 0.7])),
        ..background(2000, 84)
    });
    site.rig = |stop| {
        let mut cameras = lens_rig();
        for camera in &mut cameras {
            camera.intrinsics = camera.intrinsics.resized(150, 100);
            camera.intrinsics.shutter =
                Shutter::new(ShutterDirection::TopToBottom, 0.03, [150, 100]);
            camera.world_from_camera = rig(0)[0].world_from_camera;
            camera.motion.velocity_mps = DVec3::new(3.0 + stop as f64, 0.5, 0.0);
            camera.motion.turn_rad_per_s = DVec3::new(0.0, 0.4, 0.0);
        }
        cameras
    };
    let [frames, _] = site.compare(RenderOptions::default(), &[0, 0, 0, 0, 0, 1, 1, 1]);
    assert_eq!(sources(&frames), "sfkkksfk");
}

#[test]
fn lists_that_outgrow_their_room_are_sorted_again() {
    let site = Site::new(background(3000, 44));
    // The second car needs more of one list than there is room for.
    let rooms = [
        Capacity {
            records: 4600,
            ..ROOM
        },
        Capacity {
            pairs: 6500,
            ..ROOM
        },
        Capacity {
            partials: 1,
            tiles: 1,
            ..ROOM
        },
    ];
    for (room, frames_in_flight) in rooms
        .into_iter()
        .flat_map(|room| [1, 2, 3].map(|f| (room, f)))
    {
        let options = RenderOptions {
            frames_in_flight,
            spare: 0.01,
            ..RenderOptions::default()
        };
        let [expected, frames] = [false, true].map(|keep_lists| {
            let (renderer, world) = site.renderer(keep_lists, options);
            site.drive(&mut renderer.with_capacity(room), &world, &STANDING)
        });
        check_images(&frames, &expected).unwrap();
        let redrawn = |(statistics, _): &Shown| statistics.redrawn > 0;
        let sources = sources(&frames);
        assert!(
            redrawn(&frames[4]) && sources.starts_with("sfkks") && sources.ends_with("kkk"),
            "{room:?}, {frames_in_flight} in flight: {sources}"
        );
    }
}

#[test]
fn another_background_and_taken_images_are_drawn_anew() {
    let site = Site::new(background(3000, 54));
    let edited = background(2500, 55);
    let [kept, sorted] = [true, false].map(|keep_lists| {
        let (mut renderer, world) = site.renderer(keep_lists, RenderOptions::default());
        let other = renderer.upload(&edited).unwrap();
        let mut red = other.clone();
        red.sky = [0.9, 0.1, 0.2];
        let worlds = [&world, &other, &red, &world];
        let mut frames = Vec::new();
        let mut taken = Vec::new();
        for step in 0..20 {
            let cars = cars(site.car, step % 5);
            let frame_agents = FrameAgents::new(&cars[..]);
            let scene = FrameSplats::with_agents(worlds[step / 5], &site.pool, &frame_agents);
            let statistics = renderer.render(scene, &rig(0)).unwrap();
            frames.push((statistics, renderer.read_images().unwrap()));
            // Others may write into images that they took, and give them back.
            if step % 3 == 2 {
                let images = renderer.take_images().unwrap().unwrap();
                let colors = &images.buffers().images_f32;
                let black = vec![[0.0; 4]; colors.len()];
                site.gpu.write(colors, 0, &black).unwrap();
                taken.push(images);
            }
            if step % 6 == 5 {
                taken.clear();
            }
        }
        frames
    });
    check_images(&kept, &sorted).unwrap();
    assert_eq!(sources(&kept), "sfkkk".repeat(4));
}

#[test]
fn shadows_and_contributions_rule_kept_lists_out() {
    let site = Site::new(background(1000, 64));
    let (mut renderer, world) = site.renderer(true, RenderOptions::default());
    let shadows = FrameAgents {
        shadows: vec![shadow(DVec3::new(8.0, 1.0, -0.6), 0.3, 0.9)],
        ..FrameAgents::default()
    };
    for _ in 0..4 {
        let scene = FrameSplats::with_agents(&world, &site.pool, &shadows);
        let statistics = renderer.render(scene, &rig(0)).unwrap();
        assert_eq!(statistics.lists, ListSource::Sorted);
    }
    let options = RenderOptions {
        outputs: Outputs {
            contributions: true,
            ..Outputs::default()
        },
        ..RenderOptions::default()
    };
    let (mut renderer, world) = site.renderer(true, options);
    for _ in 0..4 {
        let statistics = renderer.render(&world, &rig(0)).unwrap();
        assert_eq!(statistics.lists, ListSource::Sorted);
    }
}

#[test]
fn moving_cameras_pay_nothing_for_kept_lists() {
    let site = Site::new(background(3000, 74));
    let options = RenderOptions {
        stage_times: true,
        ..RenderOptions::default()
    };
    let stages = |(statistics, _): &Shown| -> Vec<&'static str> {
        let stages = statistics.queues.iter().flat_map(|queue| &queue.stages);
        stages.map(|stage| stage.name).collect()
    };
    let memory = || site.gpu.memory().bytes_by_purpose;
    let moving: Vec<usize> = (0..6).collect();
    let (mut renderer, world) = site.renderer(false, options);
    let expected = site.drive(&mut renderer, &world, &moving);
    let expected_memory = memory();
    drop((renderer, world));
    let (mut renderer, world) = site.renderer(true, options);
    let frames = site.drive(&mut renderer, &world, &moving);
    check_images(&frames, &expected).unwrap();
    for (frame, expected) in frames.iter().zip(&expected) {
        assert_eq!(stages(frame), stages(expected));
        assert_eq!(frame.0.required, expected.0.required);
    }
    assert_eq!(memory(), expected_memory);
    // Memory is taken when cameras stand, and given back when they move.
    let stood = site.drive(&mut renderer, &world, &[5, 5, 5]);
    assert_eq!(sources(&stood), "fkk");
    assert!(memory()["kept lists"] > 0);
    let kept = stages(&stood[2]);
    assert!(kept.contains(&"merge") && !kept.contains(&"cull") && !kept.contains(&"project"));
    let gone = site.drive(&mut renderer, &world, &[6, 7, 8]);
    assert_eq!(sources(&gone), "sss");
    assert_eq!(memory().get("kept lists"), None);
    assert_eq!(stages(&gone[2]), stages(&expected[5]));
}
