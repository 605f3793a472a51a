//! `project.comp`: footprint, depth key and color of every visible splat.

pub mod rounding;

use decouplegs::render::stages::{
    CameraVariant, Project, ProjectInputs, ProjectVariant, Projected, Visible,
};
use decouplegs::render::twins::lens::lens_of;
use decouplegs::render::twins::projection::axes_of;
use decouplegs::render::twins::shadow::shadow_factor;
use decouplegs::render::{Planes, Storage, twins};
use decouplegs::scene::{Camera, DepthOrder, Fog, RayMap, Rules};
use glam::Vec3;

use super::scenes::{LABELED, Listed, NoKeys, ProjectedTwin, Scene, hard_world, lens_rig, rig};
use super::{ROUNDOFF, UNTOUCHED, open, run, upload};
use crate::device::Validated;
use rounding::{Projection, check_keys, check_record};

/// One run of the stage: what is drawn and how.
pub struct Case {
    pub scene: Scene,
    maps: Vec<RayMap>,
    listed: Listed,
    rules: Rules,
    variant: ProjectVariant,
    room: usize,
}

impl Case {
    pub fn new(gpu: &Validated, splats: usize, rules: Rules, variant: ProjectVariant) -> Self {
        Self::seen_by(gpu, splats, &rig(), rules, variant)
    }

    pub fn seen_by(
        gpu: &Validated,
        splats: usize,
        cameras: &[Camera],
        rules: Rules,
        variant: ProjectVariant,
    ) -> Self {
        let scene = Scene::stored(gpu, &hard_world(splats, 11), cameras, variant.storage);
        let maps = cameras
            .iter()
            .map(|camera| RayMap::new(&camera.intrinsics))
            .collect();
        let listed = scene.listed(&rules);
        let room = listed.records.len();
        Self {
            scene,
            maps,
            listed,
            rules,
            variant,
            room,
        }
    }

    /// Shift of means in the image of record `record`.
    pub fn mean_shift(&self, record: usize) -> u32 {
        self.scene.view.cameras[self.listed.records[record].0].mean_shift
    }

    pub fn twin(&self) -> ProjectedTwin {
        self.scene
            .projected(&self.listed, &self.rules, self.variant, self.room)
    }

    pub fn kernel(&self, gpu: &Validated) -> ProjectedTwin {
        let Self {
            scene,
            listed,
            rules,
            variant,
            room,
            ..
        } = self;
        let cameras = scene.view.cameras.len();
        let visible = Visible::new(gpu, cameras, scene.clusters.len()).unwrap();
        gpu.write(&visible.words, 0, &listed.words).unwrap();
        let projected = Projected::new(gpu, *room, 0, LABELED).unwrap();
        gpu.write(&projected.keys, 0, &vec![UNTOUCHED; *room])
            .unwrap();
        let (no_keys, shadows) = (NoKeys::new(gpu), scene.shadow_buffers(gpu));
        let offsets = upload(gpu, &listed.offsets);
        let project = Project::new(gpu, rules, *variant).unwrap();
        run(gpu, |r| {
            let inputs = ProjectInputs {
                visible: &visible,
                offsets: &offsets,
                kept: no_keys.kept(),
                shadows: &shadows,
                shadow_count: scene.shadows.len(),
                flow_interval_s: 0.0,
            };
            project.record(r, &scene.resident, scene.views(), inputs, &projected);
        });
        ProjectedTwin::read(gpu, &projected)
    }

    /// Projection of record `record`, with the bounds of [`rounding`].
    fn projection(&self, record: usize) -> Projection<'_> {
        let (camera, splat) = self.listed.records[record];
        let scene = &self.scene;
        let shape = scene.shapes[splat];
        Projection {
            camera: &scene.view.cameras[camera],
            lens: lens_of(&scene.view.lenses, camera).map(|lens| (self.maps[camera], lens)),
            mean_m: scene.means_m[splat],
            axes: axes_of(shape, scene.rotations[splat]).as_dmat3(),
            // Entries of the rotation are sums of products off by some roundings of 1.
            axes_share: 40.0 * ROUNDOFF,
            opacity: shape[3].into(),
            // A unit vector is off by some 12 roundings, and no basis function is steeper than 10.
            color: (200.0 * ROUNDOFF + self.shadow_share(splat))
                * (1.0 + self.coefficient_sum(splat)),
        }
    }

    pub fn check(&self, kernel: &ProjectedTwin, twin: &ProjectedTwin) -> Result<(), String> {
        let mut worst = [0.0f64; 2];
        for record in 0..self.room {
            let splat = self.listed.records[record].1;
            let what = format!("record {record} of splat {splat}, kind {}", splat % 16);
            let used = check_record(
                &what,
                record,
                kernel,
                twin,
                &self.projection(record).bounds(&self.rules),
            )?;
            worst = [worst[0].max(used[0]), worst[1].max(used[1])];
        }
        println!(
            "{} records: {:.3} of the bound of footprints, {:.3} of that of colors",
            self.room, worst[0], worst[1]
        );
        check_keys(&kernel.keys, &twin.keys)
    }

    /// Largest change by rounding of what shadows leave of the splat's light: at an edge of one,
    /// all of it.
    fn shadow_share(&self, splat: usize) -> f64 {
        let mean = self.scene.means_m[splat];
        let share = |shadow| {
            let far_m = mean.iter().fold(0.0f32, |sum, x| sum + x.abs()) + 40.0;
            let moved_m = (16.0 * ROUNDOFF) as f32 * far_m;
            let here = shadow_factor(shadow, mean);
            let change = |axis: usize, by_m: f32| {
                let mut moved = mean;
                moved[axis] += by_m;
                f64::from((shadow_factor(shadow, moved) - here).abs())
            };
            8.0 * ROUNDOFF
                + (0..3)
                    .map(|axis| change(axis, moved_m).max(change(axis, -moved_m)))
                    .sum::<f64>()
        };
        self.scene.shadows.iter().map(share).sum()
    }

    /// Sum of the largest SH coefficients, DC among them.
    fn coefficient_sum(&self, splat: usize) -> f64 {
        let stored = self.scene.sh();
        let rest = if self.variant.sh_degree > 0 {
            15.0 * 0.3
        } else {
            0.0
        };
        let dc = stored.dc(splat, self.scene.resident.splats);
        rest + f64::from(dc.abs().max_element())
    }
}

/// Colors of degree 0, labels and nothing else.
pub const PLAIN: ProjectVariant = ProjectVariant {
    sh_degree: 0,
    labels: true,
    instances: false,
    splat_ids: false,
    shadows: false,
    shadows_by_camera: false,
    cameras: CameraVariant {
        lenses: false,
        rolling: false,
    },
    planes: Planes::NONE,
    fog: false,
    storage: Storage::Exact,
};

#[test]
fn records_of_hard_splats() {
    let gpu = open();
    for (rules, variant) in [
        (
            Rules::DEFAULT,
            ProjectVariant {
                sh_degree: 3,
                instances: true,
                ..PLAIN
            },
        ),
        (
            Rules::DEFAULT,
            ProjectVariant {
                sh_degree: 1,
                ..PLAIN
            },
        ),
        (
            Rules {
                order: DepthOrder::Radial,
                ..Rules::DEFAULT
            },
            PLAIN,
        ),
        (
            Rules {
                antialias: true,
                ..Rules::INRIA
            },
            ProjectVariant {
                sh_degree: 2,
                instances: true,
                ..PLAIN
            },
        ),
        (
            Rules::DEFAULT,
            ProjectVariant {
                splat_ids: true,
                ..PLAIN
            },
        ),
        (
            Rules::DEFAULT,
            ProjectVariant {
                sh_degree: 3,
                storage: Storage::Compact,
                ..PLAIN
            },
        ),
    ] {
        let case = Case::new(&gpu, 3000, rules, variant);
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
    }
}

#[test]
fn records_in_fog() {
    let gpu = open();
    let variant = ProjectVariant {
        sh_degree: 1,
        fog: true,
        ..PLAIN
    };
    let mut case = Case::new(&gpu, 3000, Rules::DEFAULT, variant);
    case.scene.resident.fog = Some(Fog::new(0.05, [0.6, 0.7, 0.8]));
    let kernel = case.kernel(&gpu);
    case.check(&kernel, &case.twin()).unwrap();
    case.variant.fog = false;
    assert!(case.check(&kernel, &case.twin()).is_err());
}

#[test]
fn records_through_lenses() {
    let gpu = open();
    for (rules, variant) in [
        (
            Rules::DEFAULT,
            ProjectVariant {
                sh_degree: 1,
                cameras: CameraVariant {
                    lenses: true,
                    rolling: false,
                },
                ..PLAIN
            },
        ),
        (
            Rules {
                antialias: true,
                order: DepthOrder::Radial,
                ..Rules::INRIA
            },
            ProjectVariant {
                cameras: CameraVariant {
                    lenses: true,
                    rolling: false,
                },
                ..PLAIN
            },
        ),
    ] {
        let case = Case::seen_by(&gpu, 3000, &lens_rig(), rules, variant);
        let cameras: std::collections::BTreeSet<usize> =
            case.listed.records.iter().map(|record| record.0).collect();
        assert_eq!(cameras.len(), 4, "a lens shows nothing");
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
    }
}

#[test]
fn records_without_room_are_left_out() {
    let gpu = open();
    let mut case = Case::new(&gpu, 700, Rules::DEFAULT, PLAIN);
    for room in [1, 200, case.room - 1] {
        case.room = room;
        case.check(&case.kernel(&gpu), &case.twin()).unwrap();
    }
}

#[test]
fn keys_are_depths_in_order() {
    let gpu = open();
    let case = Case::new(&gpu, 2000, Rules::DEFAULT, PLAIN);
    let keys = case.kernel(&gpu).keys;
    // Between -1 and 1 over a world whose farthest splat is 10^7 m away: a step is 2^-42 of that,
    // or 2^-27 of the depth.
    let depth = |record: usize| {
        let (camera, splat) = case.listed.records[record];
        twins::depth_key::scaled_depth(
            case.scene.means_m[splat],
            &case.scene.view.cameras[camera],
            false,
        )
    };
    let mut order: Vec<usize> = (0..keys.len()).collect();
    order.sort_by_key(|&record| keys[record]);
    for pair in order.windows(2) {
        let step = (depth(pair[1]).abs() * 2f64.powi(-26)).max(2f64.powi(-41));
        assert!(
            depth(pair[0]) <= depth(pair[1]) + step,
            "records {pair:?} are in the wrong order"
        );
    }
}

#[test]
fn one_changed_value_is_seen() {
    let gpu = open();
    let case = Case::new(
        &gpu,
        500,
        Rules::DEFAULT,
        ProjectVariant {
            sh_degree: 3,
            instances: true,
            ..PLAIN
        },
    );
    let kernel = case.kernel(&gpu);
    let ordinary = case
        .listed
        .records
        .iter()
        .position(|&(_, splat)| splat % 16 > 9)
        .unwrap();
    let failure = |change: fn(&mut ProjectedTwin, usize)| {
        let mut twin = case.twin();
        case.check(&kernel, &twin).unwrap();
        change(&mut twin, ordinary);
        case.check(&kernel, &twin).unwrap_err()
    };
    assert!(failure(|twin, i| twin.footprints[2 * i][3] += 1000).contains("value 3"));
    assert!(failure(|twin, i| twin.change_color(i, Vec3::Y * 0.001)).contains("value 1"));
    assert!(failure(|twin, i| twin.labels[i][0] += 1000).contains("value 6"));
    assert!(failure(|twin, i| twin.labels[i][1] = 9).contains("instance"));
    assert!(failure(|twin, i| twin.keys[i] += 2).contains("keys"));
}
