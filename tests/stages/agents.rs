//! `cull_agents.comp` and `project_agents.comp`: what is visible of agents, and their records
//! behind those of the background.

pub mod hard_agents;
mod hard_clouds;

use decouplegs::render::Planes;
use decouplegs::render::layout::{CLUSTER_SPLATS, near_m};
use decouplegs::render::stages::{
    AgentCounts, AgentVariant, CullAgents, ProjectAgents, Projected, SeenAgents,
};
use decouplegs::render::twins::{self, agent::UnpackedSplat, lens::lens_of};
use decouplegs::scene::light::{LightFrom, LitShare, Shading};
use decouplegs::scene::{Camera, ColorTransfer, DepthOrder, Fog, Pose, Rules};
use glam::{DQuat, DVec3, Vec3};

use super::project::rounding::{Projection, check_keys, check_record};
use super::scenes::{LABELED, ProjectedTwin, lens_rig, rig};
use super::{ROUNDOFF, UNTOUCHED, identical, open, run, untouched, upload};
use crate::device::Validated;
use hard_agents::{AgentInstance, AgentScene, ListedAgents, hard_agents};
use hard_clouds::hard_cloud;

/// Visibility bits and counts of the kernel.
fn visible(gpu: &Validated, scene: &AgentScene, rules: &Rules) -> (Vec<u32>, Vec<u32>) {
    let (pool, buffers) = (scene.pool(gpu), scene.buffers(gpu));
    let cull = CullAgents::new(gpu, rules, scene.camera_variant()).unwrap();
    run(gpu, |r| cull.record(r, &pool, &buffers, scene.counts));
    (
        gpu.read(&buffers.visible.words).unwrap(),
        gpu.read(&buffers.visible.counts).unwrap(),
    )
}

/// Holds the kernel's bits to the twin's wherever these survive rounding; returns how many do not.
fn check_bits(
    scene: &AgentScene,
    rules: &Rules,
    words: &[u32],
    twin_words: &[u32],
) -> Result<usize, String> {
    let mut unsettled = 0;
    for bit in 0..words.len() * 32 {
        let (camera, agent, splat) = scene.splat_of_bit(bit);
        let [kernel, twin] =
            [words, twin_words].map(|words| words[bit / 32] >> (bit % 32) & 1 == 1);
        let settled = splat.map_or(Some(false), |splat| {
            scene.settled_visibility(camera, agent, splat, rules)
        });
        unsettled += usize::from(settled.is_none());
        if kernel != twin && settled.is_some() {
            return Err(format!(
                "camera {camera}, agent {agent}, splat {splat:?}: the kernel says {kernel}, the twin {twin}"
            ));
        }
    }
    Ok(unsettled)
}

fn compare_bits(gpu: &Validated, scene: &AgentScene, rules: Rules) {
    let (words, counts) = visible(gpu, scene, &rules);
    let unsettled = check_bits(scene, &rules, &words, &scene.culled(&rules).0).unwrap();
    let (seen, decisions): (u32, usize) = (counts.iter().sum(), words.len() * 32);
    println!("{seen} of {decisions} are seen, {unsettled} only as f32 rounds");
    // One in thirty-two is made to be at the threshold of opacity.
    assert!(
        unsettled * 20 <= decisions,
        "{unsettled} of {decisions} decisions are left to rounding: the test proves too little"
    );
    let bits: Vec<u32> = words
        .chunks(CLUSTER_SPLATS / 32)
        .map(|cluster| cluster.iter().map(|word| word.count_ones()).sum())
        .collect();
    identical("counts", &counts, &bits).unwrap();
}

#[test]
fn hard_agents_are_seen_by_the_same_cameras() {
    let gpu = open();
    let scene = hard_agents(&rig());
    for rules in [
        Rules::DEFAULT,
        Rules::INRIA,
        Rules::NUREC,
        Rules {
            antialias: true,
            ..Rules::DEFAULT
        },
    ] {
        compare_bits(&gpu, &scene, rules);
        compare_bits(&gpu, &hard_agents(&lens_rig()), rules);
    }
}

#[test]
fn as_many_cameras_as_there_may_be() {
    let gpu = open();
    let cameras: Vec<Camera> = (0..32).map(|i| rig()[i % 4].clone()).collect();
    let placed = [0xffff_ffff, 0x8000_0001].map(|cameras| AgentInstance {
        cameras,
        ..AgentInstance::new(
            0,
            Pose::from_yaw(f64::from(cameras % 7), DVec3::new(0.0, 0.0, 7.0)),
        )
    });
    let scene = AgentScene::new(&[hard_cloud(vec![300], 33)], &placed, &cameras);
    compare_bits(&gpu, &scene, Rules::DEFAULT);
    let (_, counts) = visible(&gpu, &scene, &Rules::DEFAULT);
    let of_second = |camera: usize| counts[4 * camera + 2] + counts[4 * camera + 3];
    let seen_by: Vec<usize> = (0..32).filter(|&camera| of_second(camera) > 0).collect();
    assert_eq!(
        seen_by,
        [0, 31],
        "the first and the last camera, whose bits are set"
    );
    assert!(
        (0..32).step_by(4).all(|camera| counts[4 * camera] > 0),
        "the other is masked from none"
    );
}

#[test]
fn agents_behind_every_camera_are_dropped_by_their_boxes() {
    let cameras = rig();
    let near_m = near_m(&Rules::DEFAULT);
    let scene = hard_agents(&cameras);
    let reached = |agent: usize, camera: usize| {
        let first = scene.agents[agent].first_bounds as usize;
        let clusters = &scene.clusters
            [first..first + (scene.agents[agent].splat_count as usize).div_ceil(CLUSTER_SPLATS)];
        clusters
            .iter()
            .any(|cluster| twins::cluster_overlaps(cluster, scene.camera(agent, camera), near_m))
    };
    // Shapes of up to 16 m reach far, but not over 3 km.
    assert!(reached(0, 0) && reached(1, 1));
    let placed = AgentInstance::new(0, Pose::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, -3000.0)));
    let behind = AgentScene::new(&[hard_cloud(vec![900], 31)], &[placed], &cameras);
    assert!((0..4).all(|camera| {
        behind
            .clusters
            .iter()
            .all(|cluster| !twins::cluster_overlaps(cluster, behind.camera(0, camera), near_m))
    }));
    compare_bits(&open(), &behind, Rules::DEFAULT);
}

#[test]
fn one_bit_is_seen() {
    let gpu = open();
    let scene = hard_agents(&rig()[..2]);
    let (words, _) = visible(&gpu, &scene, &Rules::DEFAULT);
    let settled = (0..900)
        .find(|&splat| scene.settled_visibility(0, 0, splat, &Rules::DEFAULT) == Some(true))
        .unwrap();
    let mut twin = words.clone();
    check_bits(&scene, &Rules::DEFAULT, &words, &twin).unwrap();
    twin[settled / 32] ^= 1 << (settled % 32);
    let failure = check_bits(&scene, &Rules::DEFAULT, &words, &twin).unwrap_err();
    assert!(
        failure.contains(&format!("splat Some({settled}):")),
        "{failure}"
    );
}

/// Records of the background before those of the agents, by list, and their total behind.
const STATIC_FIRSTS: [u32; 4] = [0, 17, 17, 41];
const STATIC_RECORDS: usize = 41;

/// One run of the projection.
struct Case {
    scene: AgentScene,
    listed: ListedAgents,
    rules: Rules,
    sh_degree: u8,
    /// For records of background and agents.
    room: usize,
}

impl Case {
    fn new(scene: AgentScene, rules: Rules, sh_degree: u8) -> Self {
        let listed = scene.listed(&rules);
        let room = STATIC_RECORDS + listed.records.len();
        Self {
            scene,
            listed,
            rules,
            sh_degree,
            room,
        }
    }

    fn twin(&self) -> ProjectedTwin {
        self.scene.projected(
            &self.listed,
            &STATIC_FIRSTS,
            &self.rules,
            self.sh_degree,
            self.room,
        )
    }

    fn kernel(&self, gpu: &Validated) -> ProjectedTwin {
        let Self {
            scene,
            listed,
            rules,
            sh_degree,
            room,
        } = self;
        let (pool, buffers) = (scene.pool(gpu), scene.buffers(gpu));
        gpu.write(&buffers.visible.words, 0, &listed.words).unwrap();
        gpu.write(&buffers.offsets, 0, &listed.offsets).unwrap();
        let static_offsets = upload(gpu, &STATIC_FIRSTS);
        let projected = Projected::new(gpu, *room, 0, LABELED).unwrap();
        gpu.write(&projected.keys, 0, &vec![UNTOUCHED; *room])
            .unwrap();
        let (relit, is_relit) = (scene.relit(gpu), !scene.relit_dc.is_empty());
        let project = ProjectAgents::new(
            gpu,
            rules,
            AgentVariant {
                sh_degree: *sh_degree,
                labels: true,
                relit: is_relit,
                shaded: !scene.shadings.is_empty(),
                cameras: scene.camera_variant(),
                planes: Planes::NONE,
                fog: scene.fog.is_some(),
            },
        )
        .unwrap();
        let lists = STATIC_FIRSTS.len() - 1;
        run(gpu, |r| {
            let seen = SeenAgents {
                pool: &pool,
                buffers: &buffers,
                relit: &relit,
                counts: scene.counts,
                fog: scene.fog.as_ref(),
                flow_interval_s: 0.0,
            };
            project.record(r, seen, &static_offsets, lists, &projected);
        });
        ProjectedTwin::read(gpu, &projected)
    }

    /// Projection of record `record` of the agents.
    fn projection(&self, record: usize) -> Projection<'_> {
        let (camera, agent, splat) = self.listed.records[record];
        let (coded, axes) = self.scene.unpacked(agent, splat);
        let entry = (self.scene.agents[agent].first_color + coded.color) as usize;
        let dc_of = if self.scene.agents[agent].colors_relit != 0 {
            &self.scene.relit_dc
        } else {
            &self.scene.dc
        };
        let dc = dc_of[entry]
            .iter()
            .chain(coded.dc_residual.as_ref())
            .map(|value| f64::from(value.abs()))
            .sum::<f64>();
        let (shading, gain) = self.scene.shading_error(agent, coded.mean_m, axes);
        let color = 1.0 + dc + 15.0 * 0.3;
        Projection {
            camera: self.scene.camera(agent, camera),
            lens: lens_of(&self.scene.lenses, camera).map(|lens| (self.scene.maps[camera], lens)),
            mean_m: coded.mean_m,
            axes: axes.as_dmat3(),
            // Entries of a factor are stored; only their size and the dot products are rounded.
            axes_share: 8.0 * ROUNDOFF + self.scene.size_share(agent, splat),
            opacity: coded.opacity.into(),
            // A unit vector is off by some 12 roundings, turned by some 20, and no basis function
            // is steeper than 10.
            color: gain * color * (300.0 * ROUNDOFF + shading),
        }
    }

    fn check(&self, kernel: &ProjectedTwin, twin: &ProjectedTwin) -> Result<(), String> {
        let mut worst = [0.0f64; 2];
        let records = self.room - STATIC_RECORDS;
        for record in 0..records {
            let what = format!(
                "record {record} of (camera, agent, splat) {:?}",
                self.listed.records[record]
            );
            let used = check_record(
                &what,
                STATIC_RECORDS + record,
                kernel,
                twin,
                &self.projection(record).bounds(&self.rules),
            )?;
            worst = [worst[0].max(used[0]), worst[1].max(used[1])];
        }
        println!(
            "{records} records: {:.3} of the bound of footprints, {:.3} of that of colors",
            worst[0], worst[1]
        );
        identical(
            "of the background",
            &kernel.keys[..STATIC_RECORDS],
            &[UNTOUCHED; STATIC_RECORDS],
        )?;
        check_keys(&kernel.keys, &twin.keys)
    }
}

#[test]
fn records_of_hard_agents() {
    let gpu = open();
    for (rules, sh_degree) in [
        (Rules::DEFAULT, 3),
        (
            Rules {
                order: DepthOrder::Radial,
                ..Rules::DEFAULT
            },
            0,
        ),
        (
            Rules {
                antialias: true,
                ..Rules::INRIA
            },
            2,
        ),
    ] {
        let case = Case::new(hard_agents(&rig()), rules, sh_degree);
        let kinds = |of: fn(&(usize, usize, usize)) -> usize| {
            case.listed
                .records
                .iter()
                .map(of)
                .collect::<std::collections::BTreeSet<_>>()
                .len()
        };
        assert!(
            kinds(|record| record.0) == 4 && kinds(|record| record.1) >= 6,
            "cameras or agents without a record"
        );
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
        let through = Case::new(hard_agents(&lens_rig()), rules, sh_degree);
        through
            .check(&through.kernel(&gpu), &through.twin())
            .unwrap();
    }
}

#[test]
fn records_of_relit_agents() {
    let gpu = open();
    let plain = Case::new(hard_agents(&rig()), Rules::DEFAULT, 3);
    let mut scene = hard_agents(&rig());
    let mut light = ColorTransfer::IDENTITY;
    light.gain[0] = [0.5, 1.25, 0.75];
    light.offset[2] = [0.125, -0.25, 0.0];
    // Some are relit and some are not; the first and the sixth show the same asset in other lights.
    scene.relight(0, 1024, &light);
    light.gain[0] = [1.5; 3];
    scene.relight(5, 1024, &light);
    scene.relight(6, 1024, &light);
    let case = Case::new(scene, Rules::DEFAULT, 3);
    let kernel = case.kernel(&gpu);
    case.check(&kernel, &case.twin()).unwrap();
    let (changed, lit) = (
        case.check(&kernel, &plain.twin()).unwrap_err(),
        plain.kernel(&gpu),
    );
    assert!(changed.contains("value"), "other light is seen: {changed}");
    let of = |wanted: usize| {
        case.listed
            .records
            .iter()
            .position(|&(_, agent, _)| agent == wanted)
            .unwrap()
            + STATIC_RECORDS
    };
    assert!(
        kernel.color(of(1)) == lit.color(of(1)),
        "an agent that is not relit has the bits it has without light"
    );
    assert!(kernel.color(of(0)) != lit.color(of(0)));
}

/// The kernel shades as the twin does: sun and lamps on some agents, none on others.
#[test]
fn records_of_agents_shaded_by_normals() {
    let gpu = open();
    let plain = Case::new(hard_agents(&rig()), Rules::DEFAULT, 3);
    let mut scene = hard_agents(&rig());
    let mut light = some_shading(1.0);
    scene.shade(0, &light);
    let dusk = Case::new(scene, Rules::DEFAULT, 3);
    dusk.check(&dusk.kernel(&gpu), &dusk.twin()).unwrap();
    let mut scene = hard_agents(&rig());
    light.lights[0].towards = -light.lights[0].towards;
    scene.shade(5, &light);
    scene.shade(0, &some_shading(0.0));
    let case = Case::new(scene, Rules::DEFAULT, 3);
    let kernel = case.kernel(&gpu);
    case.check(&kernel, &case.twin()).unwrap();
    for (other, what) in [(&plain, "none"), (&dusk, "other lights")] {
        let changed = case.check(&kernel, &other.twin()).unwrap_err();
        assert!(changed.contains("value"), "{what}: {changed}");
    }
    let unshaded = plain.kernel(&gpu);
    for record in 0..case.room - STATIC_RECORDS {
        let (_, agent, _) = case.listed.records[record];
        let at = STATIC_RECORDS + record;
        assert!(
            [0, 5].contains(&agent) || kernel.color(at) == unshaded.color(at),
            "an agent that is not shaded has the bits it has without: record {record}"
        );
    }
}

/// A sky, a ground, `sun` times a sun and a lamp, on agents of unlike sides.
fn some_shading(sun: f64) -> Shading {
    let from = |towards: DVec3, rgb: [f64; 3]| LightFrom {
        towards: towards.normalize(),
        rgb,
    };
    let lights = [
        from(
            DVec3::new(0.9, -0.3, 0.3),
            [2.0, 1.1, 0.4].map(|rgb| sun * rgb),
        ),
        LightFrom::default(),
        from(DVec3::new(-0.2, 0.6, 0.7), [0.3, 0.2, 0.1]),
        LightFrom::default(),
    ];
    Shading {
        up: DVec3::new(0.1, -0.05, 0.99).normalize(),
        sky: [0.2, 0.25, 0.4],
        ground: [0.1, 0.08, 0.07],
        lights,
        first: LitShare {
            middle: 0.6,
            slope_per_m: DVec3::new(0.4, -0.2, 0.3),
        },
        half_size_m: [2.3, 0.9, 0.75],
    }
}

#[test]
fn records_of_agents_in_fog() {
    let gpu = open();
    let plain = Case::new(hard_agents(&rig()), Rules::DEFAULT, 2);
    let mut scene = hard_agents(&rig());
    scene.fog = Some(Fog::new(0.05, [0.6, 0.7, 0.8]));
    let case = Case::new(scene, Rules::DEFAULT, 2);
    let kernel = case.kernel(&gpu);
    case.check(&kernel, &case.twin()).unwrap();
    assert!(case.check(&kernel, &plain.twin()).is_err());
}

#[test]
fn every_shape_and_color_is_read() {
    let case = Case::new(hard_agents(&rig()), Rules::DEFAULT, 3);
    let read = |of: fn(&UnpackedSplat) -> u32| {
        let entries = case
            .listed
            .records
            .iter()
            .map(|&(_, agent, splat)| of(&case.scene.unpacked(agent, splat).0));
        entries.collect::<std::collections::BTreeSet<_>>().len()
    };
    // A thirty-second of the splats is never drawn, another one at the edge of it.
    assert!(read(|splat| splat.shape) >= 460 && read(|splat| splat.color) >= 900);
}

#[test]
fn records_without_room_are_left_out() {
    let gpu = open();
    let mut case = Case::new(hard_agents(&rig()[..2]), Rules::DEFAULT, 1);
    for room in [
        STATIC_RECORDS,
        STATIC_RECORDS + 1,
        STATIC_RECORDS + 300,
        case.room - 1,
    ] {
        case.room = room;
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
    }
}

#[test]
fn no_agents_are_nothing() {
    let gpu = open();
    let scene = hard_agents(&rig());
    let (pool, buffers) = (scene.pool(&gpu), scene.buffers(&gpu));
    let projected = Projected::new(&gpu, 8, 0, LABELED).unwrap();
    gpu.write(&projected.keys, 0, &[UNTOUCHED; 8]).unwrap();
    let (cull, project) = (
        CullAgents::new(&gpu, &Rules::DEFAULT, scene.camera_variant()).unwrap(),
        ProjectAgents::new(
            &gpu,
            &Rules::DEFAULT,
            AgentVariant {
                sh_degree: 3,
                labels: true,
                relit: false,
                shaded: false,
                cameras: scene.camera_variant(),
                planes: Planes::NONE,
                fog: scene.fog.is_some(),
            },
        )
        .unwrap(),
    );
    let (none, static_offsets) = (
        AgentCounts {
            cameras: 4,
            ..AgentCounts::default()
        },
        untouched(&gpu, 1),
    );
    run(&gpu, |r| {
        cull.record(r, &pool, &buffers, none);
        let seen = SeenAgents {
            pool: &pool,
            buffers: &buffers,
            relit: &scene.relit(&gpu),
            counts: none,
            fog: None,
            flow_interval_s: 0.0,
        };
        project.record(r, seen, &static_offsets, 0, &projected);
    });
    let left = [
        &buffers.visible.words,
        &buffers.visible.counts,
        &projected.keys,
    ]
    .map(|buffer| gpu.read(buffer).unwrap());
    assert!(left.iter().flatten().all(|&word| word == UNTOUCHED));
}

#[test]
fn one_changed_value_is_seen() {
    let gpu = open();
    let case = Case::new(hard_agents(&rig()[..2]), Rules::DEFAULT, 3);
    let kernel = case.kernel(&gpu);
    // An ordinary shape, seen from afar enough for its bounds to be small.
    let ordinary = |&(_, agent, splat): &(usize, usize, usize)| agent == 0 && splat % 8 == 4;
    let record = STATIC_RECORDS + case.listed.records.iter().position(ordinary).unwrap();
    let failure = |change: &dyn Fn(&mut ProjectedTwin)| {
        let mut twin = case.twin();
        case.check(&kernel, &twin).unwrap();
        change(&mut twin);
        case.check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(&|twin| twin.footprints[2 * record][3] += 2000).contains("value 3"));
    let greener = |twin: &mut ProjectedTwin| twin.change_color(record, Vec3::Y * 0.001);
    assert!(failure(&greener).contains("value 1"));
    assert!(failure(&|twin| twin.labels[record][1] = 99).contains("instance"));
    assert!(failure(&|twin| twin.keys[record] += 2).contains("keys"));
    let mut wrong = case.kernel(&gpu);
    wrong.keys[0] = 1;
    assert!(
        case.check(&wrong, &case.twin())
            .unwrap_err()
            .contains("of the background")
    );
}
