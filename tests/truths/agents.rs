//! An agent's splats are turned by moving the camera into its frame. Here covariances and colors
//! are turned themselves, in f64.

use std::f64::consts::LOG2_E;

use decouplegs::gpu::QueueRole;
use decouplegs::render::Planes;
use decouplegs::render::sh_codec::{self, EXACT_BITS};
use decouplegs::render::stages::{
    AgentVariant, CameraVariant, ProjectAgents, Projected, RecordContents, SeenAgents,
};
use decouplegs::render::twins::record::{load_color, load_footprint};
use decouplegs::scene::rules::DILATION_PX2;
use decouplegs::scene::sh::{ShRotation, basis};
use decouplegs::scene::{Bounds, Camera, CodedCloud, Pose, Rules, ShFrame, SplatCodes, sh};
use glam::{DMat2, DMat3, DQuat, DVec2, DVec3};

use super::square_camera;
use crate::device::Validated;
use crate::stages::Random;
use crate::stages::agents::hard_agents::{AgentInstance, AgentScene};

/// Tolerance of a rotation, relative to the covariance and to the color.
const RELATIVE: f64 = 1e-5;

/// A cloud of sixty-four shapes, of which the thinnest are 1 : 100, and as many colors that stay
/// above zero from all sides.
fn cloud(random: &mut Random) -> CodedCloud {
    let shape = |random: &mut Random| {
        let mut off = || random.between(-0.5, 0.5);
        let [yx, zx, zy] = [off(), off(), off()];
        [
            random.across_scales(0.01, 1.0),
            yx,
            random.across_scales(0.01, 1.0),
            zx,
            zy,
            random.across_scales(0.01, 1.0),
        ]
    };
    let splat = |i: u16, random: &mut Random| SplatCodes {
        position: std::array::from_fn(|_| random.below(65_536) as u16),
        opacity: 200,
        size: random.below(256) as u8,
        shape: i,
        color: i,
        dc_residual: [
            random.below(32) as i8 - 16,
            random.below(16) as i8 - 8,
            random.below(16) as i8 - 8,
        ],
    };
    CodedCloud {
        bounds: Bounds {
            min: [-2.2, -0.9, -0.75],
            max: [2.2, 0.9, 0.75],
        },
        log2_size_min: -6.0,
        log2_size_step: 5.0 / 255.0,
        dc_residual_step: [0.01; 3],
        splats: (0..64).map(|i| splat(i, random).into()).collect(),
        levels: vec![64],
        shapes: (0..64).map(|_| shape(random)).collect(),
        sh_degree: 3,
        colors: (0..64 * 16)
            .map(|i| {
                std::array::from_fn(|_| {
                    if i % 16 == 0 {
                        1.5
                    } else {
                        random.between(-0.1, 0.1)
                    }
                })
            })
            .collect(),
        sh_frame: ShFrame::Canonical,
        dims_m: [4.4, 1.8, 1.5],
    }
}

/// A covariance in pixels and a color.
struct Seen {
    covariance_px2: DMat2,
    rgb: DVec3,
}

/// The splat turned into the world and seen by `camera`, in f64. With `rotation` other than the
/// agent's it is turned wrongly.
fn turned(
    cloud: &CodedCloud,
    codes: &SplatCodes,
    pose: &Pose,
    rotation: DQuat,
    camera: &Camera,
    colors_turn: bool,
) -> Seen {
    let [xx, yx, yy, zx, zy, zz] = cloud.shapes[usize::from(codes.shape)].map(f64::from);
    let factor = DMat3::from_cols(
        DVec3::new(xx, yx, zx),
        DVec3::new(0.0, yy, zy),
        DVec3::new(0.0, 0.0, zz),
    );
    let size = (f64::from(cloud.log2_size_min)
        + f64::from(codes.size) * f64::from(cloud.log2_size_step))
    .exp2();
    let r = DMat3::from_quat(rotation);
    let covariance_m2 = r * (factor * factor.transpose()) * r.transpose() * (size * size);
    let mean_m = pose.transform(DVec3::from_array(cloud.mean_m(codes).map(f64::from)));
    let w = DMat3::from_quat(camera.world_from_camera.rotation).transpose();
    let t = w * (mean_m - camera.world_from_camera.translation);
    let (k, z) = (&camera.intrinsics, t.z);
    let rows = [
        DVec3::new(k.fx_px / z, 0.0, -k.fx_px * t.x / (z * z)),
        DVec3::new(0.0, k.fy_px / z, -k.fy_px * t.y / (z * z)),
    ];
    let in_camera = w * covariance_m2 * w.transpose();
    let entry = |i: usize, j: usize| rows[i].dot(in_camera * rows[j]);
    let covariance_px2 = DMat2::from_cols(
        DVec2::new(entry(0, 0) + DILATION_PX2, entry(0, 1)),
        DVec2::new(entry(1, 0), entry(1, 1) + DILATION_PX2),
    );

    let mut rest = stored_rest(cloud.color(codes.color.into()));
    if colors_turn {
        ShRotation::new(rotation).rotate(&mut rest);
    }
    let dc = DVec3::from_array(cloud.color(codes.color.into())[0].map(f64::from));
    let dc = dc + DVec3::from_array(cloud.dc_residual(codes).map(f64::from));
    let y = basis((mean_m - camera.world_from_camera.translation).normalize());
    let higher = rest
        .iter()
        .zip(&y[1..])
        .map(|(c, y)| DVec3::from_array(c.map(f64::from)) * *y)
        .sum::<DVec3>();
    Seen {
        covariance_px2,
        rgb: 0.5 + y[0] * dc + higher,
    }
}

/// Coefficients after DC as 16 bits hold them.
fn stored_rest(coefficients: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let band = |band: usize| {
        let range = sh::coefficient_count(band as u8 - 1)..sh::coefficient_count(band as u8);
        sh_codec::decode_band(
            &sh_codec::encode_band(&coefficients[range], EXACT_BITS),
            2 * band + 1,
            EXACT_BITS,
        )
    };
    (1..=3).flat_map(band).collect()
}

/// Result of the kernel for each splat of `listed`, from its factored form.
fn seen_by_kernel(
    gpu: &Validated,
    scene: &AgentScene,
    rules: &Rules,
) -> Vec<((usize, usize), Seen)> {
    let listed = scene.listed(rules);
    let room = listed.records.len();
    let (pool, buffers) = (scene.pool(gpu), scene.buffers(gpu));
    gpu.write(&buffers.visible.words, 0, &listed.words).unwrap();
    gpu.write(&buffers.offsets, 0, &listed.offsets).unwrap();
    let static_offsets = gpu.upload("no background", "test", &[0u32]).unwrap();
    let projected = Projected::new(gpu, room, 0, RecordContents::default()).unwrap();
    let project = ProjectAgents::new(
        gpu,
        rules,
        AgentVariant {
            sh_degree: 3,
            labels: false,
            relit: false,
            shaded: false,
            cameras: CameraVariant::default(),
            planes: Planes::NONE,
            fog: false,
        },
    )
    .unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    let seen = SeenAgents {
        pool: &pool,
        buffers: &buffers,
        relit: &scene.relit(gpu),
        counts: scene.counts,
        fog: None,
        flow_interval_s: 0.0,
    };
    project.record(&mut recorder, seen, &static_offsets, 0, &projected);
    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
    let footprints = gpu.read(&projected.footprints).unwrap();
    let seen = |record: usize| {
        let splat = load_footprint(&footprints, record, 0, [0; 2]);
        let [slope, rate_x, rate_y] = [splat.slope, splat.rate_x, splat.rate_y].map(f64::from);
        // In d.y the variance is half log2(e) over the squared rate; along x what slope explains
        // comes on top.
        let half = 0.5 * LOG2_E;
        let yy = half / (rate_y * rate_y);
        let xx = half / (rate_x * rate_x) + slope * slope * yy;
        Seen {
            covariance_px2: DMat2::from_cols(
                DVec2::new(xx, slope * yy),
                DVec2::new(slope * yy, yy),
            ),
            rgb: load_color(&footprints, record).as_dvec3(),
        }
    };
    listed
        .records
        .iter()
        .enumerate()
        .map(|(record, &(_, agent, splat))| ((agent, splat), seen(record)))
        .collect()
}

fn norm(m: DMat2) -> f64 {
    m.to_cols_array()
        .iter()
        .map(|entry| entry * entry)
        .sum::<f64>()
        .sqrt()
}

/// The largest relative differences of covariance and color.
fn worst(found: &[((usize, usize), Seen)], expected: impl Fn(usize, usize) -> Seen) -> [f64; 2] {
    found
        .iter()
        .fold([0.0; 2], |worst: [f64; 2], ((agent, splat), seen)| {
            let truth = expected(*agent, *splat);
            let covariance =
                norm(seen.covariance_px2 - truth.covariance_px2) / norm(truth.covariance_px2);
            [
                worst[0].max(covariance),
                worst[1].max((seen.rgb - truth.rgb).length() / truth.rgb.length()),
            ]
        })
}

#[test]
fn covariances_and_colors_turn_with_the_agent() {
    let gpu = Validated::open();
    let mut random = Random(51);
    let cloud = cloud(&mut random);
    let mut camera = square_camera(401);
    let quaternion = |random: &mut Random| {
        let [x, y, z, w] = std::array::from_fn(|_| f64::from(random.between(-1.0, 1.0)));
        DQuat::from_xyzw(x, y, z, w).normalize()
    };
    camera.world_from_camera = Pose::new(quaternion(&mut random), DVec3::new(3.0, -2.0, 1.0));
    let place = |agent: usize| {
        let rotation = quaternion(&mut Random(100 + agent as u64));
        let mut random = Random(1000 + agent as u64);
        let before = DVec3::new(
            random.between(-4.0, 4.0).into(),
            random.between(-4.0, 4.0).into(),
            random.between(5.0, 40.0).into(),
        );
        let pose = Pose::new(rotation, camera.world_from_camera.transform(before));
        AgentInstance {
            colors_in_world: agent % 4 == 3,
            ..AgentInstance::new(0, pose)
        }
    };
    let placed: Vec<AgentInstance> = (0..100).map(place).collect();
    let scene = AgentScene::new(
        std::slice::from_ref(&cloud),
        &placed,
        std::slice::from_ref(&camera),
    );
    let found = seen_by_kernel(&gpu, &scene, &Rules::DEFAULT);
    assert!(found.len() > 5000, "{} splats are seen", found.len());
    let truth = |agent: usize, splat: usize, rotation: DQuat| {
        let AgentInstance {
            pose,
            colors_in_world,
            ..
        } = &placed[agent];
        turned(
            &cloud,
            &cloud.splats[splat].into(),
            pose,
            rotation,
            &camera,
            !colors_in_world,
        )
    };
    let [covariance, color] = worst(&found, |agent, splat| {
        truth(agent, splat, placed[agent].pose.rotation)
    });
    println!(
        "{} splats: covariances within {covariance:.1e}, colors within {color:.1e}",
        found.len()
    );
    assert!(
        covariance < RELATIVE && color < RELATIVE,
        "{covariance:e}, {color:e}"
    );
    // The other way round, or by a ten-thousandth of a radian more, it is seen to be wrong.
    let wrong = worst(&found, |agent, splat| {
        truth(agent, splat, placed[agent].pose.rotation.inverse())
    });
    assert!(wrong[0] > 0.1 && wrong[1] > 0.01, "{wrong:?}");
    let more = DQuat::from_rotation_x(1e-4);
    let wrong = worst(&found, |agent, splat| {
        truth(agent, splat, placed[agent].pose.rotation * more)
    });
    assert!(
        wrong[0] > 2.0 * RELATIVE && wrong[1] > 2.0 * RELATIVE,
        "{wrong:?}"
    );
}
