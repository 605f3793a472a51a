//! Splats of every kind that is hard for a stage, as the stages hold them.

use bytemuck::Zeroable;
use decouplegs::gpu::Buffer;
use decouplegs::render::layout::{
    CAMERAS_MAX, CLUSTER_SPLATS, CameraRecord, ClusterRecord, LensRecord, NO_KEY_SET, ShadowRecord,
    View, fog_vector, response_squares_max,
};
use decouplegs::render::stages::{
    KeptKeys, ProjectVariant, Projected, RecordContents, ShadowBuffers, Views, words_for,
};
use decouplegs::render::twins::color_code::pack_color;
use decouplegs::render::twins::footprint::{Footprint, reached_coarse_rows, reached_coarse_tiles};
use decouplegs::render::twins::lens::{lens_of, project_splat_seen};
use decouplegs::render::twins::projection::{Variant, axes_of, from_camera_m, to_camera_axes};
use decouplegs::render::twins::record::{load_color, load_footprint};
use decouplegs::render::twins::stored_splat::load_shape;
use decouplegs::render::twins::{self, sh::Stored};
use decouplegs::render::{ResidentSplats, Storage};
use decouplegs::scene::lens::{FTheta, FThetaReference, Fisheye, OpenCv};
use decouplegs::scene::{Camera, Intrinsics, Lens, Motion, Pose, Rules, SplatScene};
use glam::{DQuat, DVec3, Mat3, Vec3};

use super::{ROUNDOFF, Random, UNTOUCHED, upload};
use crate::device::Validated;
use crate::frames::{Splat, world_of};

/// Ordinary splats, needles, discs, ones that cover the image or no pixel center, far beside it, at
/// the near plane, behind it, too faint, and at the edge of too faint.
pub fn hard_splats(count: usize, seed: u64) -> Vec<Splat> {
    let mut random = Random(seed);
    (0..count)
        .map(|i| {
            let depth_m = random.across_scales(0.5, 60.0);
            let ordinary = Splat {
                mean_m: [
                    random.between(-1.0, 1.0) * depth_m,
                    random.between(-0.6, 0.6) * depth_m,
                    depth_m,
                ],
                scale_m: std::array::from_fn(|_| random.across_scales(0.005, 0.5)),
                rotation: std::array::from_fn(|_| random.between(-1.0, 1.0)),
                opacity: random.between(0.01, 1.0),
                rgb: std::array::from_fn(|_| random.between(0.0, 1.0)),
            };
            let [x, y, z] = ordinary.mean_m;
            match i % 16 {
                0 => Splat {
                    scale_m: [random.between(0.5, 2.0), 1e-5, 1e-5],
                    ..ordinary
                },
                1 => Splat {
                    scale_m: [random.between(0.1, 1.0), random.between(0.1, 1.0), 1e-6],
                    ..ordinary
                },
                2 => Splat {
                    scale_m: [random.across_scales(1.0, 1000.0); 3],
                    opacity: 0.1,
                    ..ordinary
                },
                3 => Splat {
                    scale_m: [1e-6; 3],
                    ..ordinary
                },
                4 => Splat {
                    mean_m: [x * 10.0, y * 10.0, z],
                    ..ordinary
                },
                // So far beside the axis that its pixel is none that an integer holds.
                5 => Splat {
                    mean_m: [x * 1e6, y, random.between(0.01, 0.02)],
                    scale_m: [0.1; 3],
                    ..ordinary
                },
                6 => Splat {
                    mean_m: [x * 0.01, y * 0.01, random.between(0.009, 0.011)],
                    scale_m: [0.002; 3],
                    ..ordinary
                },
                7 => Splat {
                    mean_m: [x, y, -z],
                    ..ordinary
                },
                8 => Splat {
                    opacity: random.between(0.003, 0.005),
                    ..ordinary
                },
                9 => Splat {
                    opacity: f32::from_bits((1.0f32 / 255.0).to_bits() - 2 + random.below(5)),
                    ..ordinary
                },
                _ => ordinary,
            }
        })
        .collect()
}

/// A world of hard splats of degree 3 in three instances.
pub fn hard_world(count: usize, seed: u64) -> SplatScene {
    let mut world = world_of(&hard_splats(count, seed));
    let mut random = Random(seed + 1);
    world.splats.sh_degree = 3;
    world.splats.sh_rest = (0..count * 15)
        .map(|_| std::array::from_fn(|_| random.between(-0.3, 0.3)))
        .collect();
    world.instance_from_splat = (0..count).map(|_| random.below(3) as u16).collect();
    world
}

/// Cameras that see the hard splats: straight on, turned with the principal point off center, wide,
/// and of one pixel.
pub fn rig() -> Vec<Camera> {
    let camera = |name: &str, size: (u32, u32), fov_deg: f64, pose: Pose| Camera {
        name: name.into(),
        intrinsics: Intrinsics::from_horizontal_fov(size.0, size.1, fov_deg.to_radians()),
        world_from_camera: pose,
        motion: Motion::REST,
    };
    let turned = Pose::new(
        DQuat::from_rotation_y(0.3) * DQuat::from_rotation_z(0.2),
        DVec3::new(0.4, -0.2, -1.0),
    );
    let mut shifted = camera("shifted", (333, 217), 50.0, turned);
    shifted.intrinsics.cx_px = 20.0;
    vec![
        camera("straight", (200, 120), 60.0, Pose::IDENTITY),
        shifted,
        camera(
            "wide",
            (1000, 700),
            130.0,
            Pose::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, -0.5)),
        ),
        camera("pixel", (1, 1), 60.0, Pose::IDENTITY),
    ]
}

/// A pinhole, distorted ones, and lenses by angle that end inside the image and beyond it.
pub fn lens_rig() -> Vec<Camera> {
    let lenses = [
        Lens::Pinhole,
        Lens::OpenCv(OpenCv {
            radial: [-0.3, 0.1, -0.004, 0.02, -0.01, 0.003],
            tangential: [0.002, -0.001],
            thin_prism: [0.001, -0.0005, -0.0007, 0.0002],
        }),
        Lens::Fisheye(Fisheye {
            radial: [-0.02, 0.004, -0.002, 0.0003],
            max_angle_rad: 1.3,
        }),
        Lens::FTheta(FTheta {
            reference: FThetaReference::PixelDistanceToAngle,
            pixel_distance_to_angle: [0.0, 0.0042, 5.6e-7, -6.4e-9, 3.8e-11, -5.8e-14],
            angle_to_pixel_distance: [0.0; 6],
            max_angle_rad: 1.2,
            linear_cde: [0.9998, 6.3e-4, -1.0e-3],
        }),
    ];
    let focal_px = [180.0, 150.0, 110.0, 238.0];
    let with = |(mut camera, (lens, focal_px)): (Camera, (Lens, f64))| {
        let size = (400, 260);
        camera.intrinsics = Intrinsics {
            lens,
            ..Intrinsics::from_horizontal_fov(size.0, size.1, 1.0)
        };
        (
            camera.intrinsics.fx_px,
            camera.intrinsics.fy_px,
            camera.intrinsics.cx_px,
        ) = (focal_px, 1.01 * focal_px, 207.5);
        camera
    };
    rig()
        .into_iter()
        .zip(lenses.into_iter().zip(focal_px))
        .map(with)
        .collect()
}

/// A world on the device, its bytes as the kernels read them, and the cameras.
pub struct Scene {
    pub resident: ResidentSplats,
    pub view: View,
    pub camera_buffer: Buffer<CameraRecord>,
    pub lens_buffer: Buffer<LensRecord>,
    pub clusters: Vec<ClusterRecord>,
    pub means_m: Vec<[f32; 3]>,
    pub shapes: Vec<[f32; 4]>,
    pub rotations: Vec<[f32; 4]>,
    pub instances: Vec<u32>,
    sh_dc: Vec<u32>,
    sh_bands: [Vec<u32>; 3],
    /// None, unless a test puts some there.
    pub shadows: Vec<ShadowRecord>,
}

impl Scene {
    pub fn new(gpu: &Validated, world: &SplatScene, cameras: &[Camera]) -> Self {
        Self::stored(gpu, world, cameras, Storage::Exact)
    }

    pub fn stored(
        gpu: &Validated,
        world: &SplatScene,
        cameras: &[Camera],
        storage: Storage,
    ) -> Self {
        let resident = ResidentSplats::upload(gpu, world, storage).unwrap();
        let shapes = gpu.read(&resident.shapes).unwrap();
        let rotations = gpu.read(&resident.rotations).unwrap();
        let (shapes, rotations) = (0..resident.splats)
            .map(|splat| load_shape(storage, &shapes, &rotations, splat))
            .unzip();
        let view = View::new(cameras, world.origin, resident.distance_max_m).unwrap();
        Self {
            camera_buffer: uniform_cameras(gpu, &view.cameras),
            lens_buffer: upload(gpu, &view.lenses),
            clusters: gpu.read(&resident.clusters).unwrap(),
            means_m: gpu.read(&resident.means).unwrap(),
            shapes,
            rotations,
            instances: gpu.read(&resident.instances).unwrap(),
            sh_dc: gpu.read(&resident.sh_dc).unwrap(),
            sh_bands: std::array::from_fn(|band| gpu.read(&resident.sh_bands[band]).unwrap()),
            resident,
            view,
            shadows: Vec::new(),
        }
    }

    pub fn sh(&self) -> Stored<'_> {
        Stored {
            storage: self.resident.storage,
            sh_dc: &self.sh_dc,
            sh_bands: std::array::from_fn(|band| self.sh_bands[band].as_slice()),
        }
    }

    /// The twin's bits of which shadow may lie on which cluster.
    pub fn shadow_words(&self) -> Vec<u32> {
        let mut words = vec![0; self.clusters.len() * words_for(self.shadows.len())];
        twins::cull_shadows(&self.clusters, &self.shadows, &mut words);
        words
    }

    /// Shadows on the device.
    pub fn shadow_buffers(&self, gpu: &Validated) -> ShadowBuffers {
        let buffers = ShadowBuffers::new(gpu, self.shadows.len(), self.clusters.len()).unwrap();
        gpu.write(&buffers.shadows, 0, &self.shadows).unwrap();
        gpu.write(&buffers.words, 0, &self.shadow_words()).unwrap();
        buffers
    }

    fn splats(&self) -> twins::SplatBuffers<'_> {
        twins::SplatBuffers {
            means_m: &self.means_m,
            shapes: &self.shapes,
            rotations: &self.rotations,
        }
    }

    /// The twin's visible words and counts.
    pub fn culled(&self, rules: &Rules) -> (Vec<u32>, Vec<u32>) {
        let lists = self.view.cameras.len() * self.clusters.len();
        let (mut words, mut counts) = (vec![0; lists * CLUSTER_SPLATS / 32], vec![0; lists]);
        let mut visible = twins::VisibleBits {
            words: &mut words,
            counts: &mut counts,
        };
        twins::cull(
            &self.view.cameras,
            &self.view.lenses,
            &self.clusters,
            self.splats(),
            &mut visible,
            Variant::for_rules(rules),
        );
        (words, counts)
    }

    /// Visibility of the splat if it is the same for every rounding of f32: else `None`.
    pub fn settled_visibility(&self, camera: usize, splat: usize, rules: &Rules) -> Option<bool> {
        let (shape, rotation) = (self.shapes[splat], self.rotations[splat]);
        let axes = axes_of(shape, rotation);
        let (camera, lens) = (
            &self.view.cameras[camera],
            lens_of(&self.view.lenses, camera),
        );
        settled_visibility(
            camera,
            lens,
            self.means_m[splat],
            axes,
            16.0 * ROUNDOFF,
            shape[3],
            rules,
        )
    }
}

/// Visibility of a splat if it is the same for every rounding of f32: else `None`.
///
/// Tried are the mean moved by the rounding of a camera transform along each axis, the size changed
/// by `size_share` and the opacity by some roundings of its own.
pub fn settled_visibility(
    camera: &CameraRecord,
    lens: Option<&LensRecord>,
    mean_m: [f32; 3],
    axes: Mat3,
    size_share: f64,
    opacity: f32,
    rules: &Rules,
) -> Option<bool> {
    let offset = from_camera_m(mean_m, camera);
    let t = to_camera_axes(camera, offset);
    let moved_m = (8.0 * ROUNDOFF) as f32 * offset.abs().element_sum();
    let visible = |t: Vec3, size: f32, opacity: f32| {
        let (footprint, drawn) = project_splat_seen(
            camera,
            lens,
            t,
            axes * size,
            opacity,
            Variant::for_rules(rules),
        );
        drawn && count_coarse_tiles(&footprint, camera, rules) > 0
    };
    let decision = visible(t, 1.0, opacity);
    let moves = [Vec3::X, Vec3::Y, Vec3::Z]
        .into_iter()
        .flat_map(|axis| [t + moved_m * axis, t - moved_m * axis]);
    let changes = |share: f64| [1.0 - share as f32, 1.0 + share as f32];
    let same = moves
        .into_iter()
        .all(|t| visible(t, 1.0, opacity) == decision)
        && changes(size_share)
            .iter()
            .all(|&change| visible(t, change, opacity) == decision)
        && changes(16.0 * ROUNDOFF)
            .iter()
            .all(|&change| visible(t, 1.0, opacity * change) == decision);
    same.then_some(decision)
}

/// Coarse tiles of `camera` that the splat can reach.
fn count_coarse_tiles(splat: &Footprint, camera: &CameraRecord, rules: &Rules) -> u32 {
    let most = response_squares_max(rules);
    let [first, last] = reached_coarse_rows(splat, most, camera.size_px[1]);
    let tiles =
        (first..=last).map(|row| reached_coarse_tiles(splat, most, row as u32, camera.size_px));
    tiles.map(|[left, right]| (right - left + 1) as u32).sum()
}

/// Number of coarse tiles that the splat overlaps if it is the same for every rounding of f32: else
/// `None`.
pub fn settled_tile_count(splat: &Footprint, camera: &CameraRecord, rules: &Rules) -> Option<u32> {
    let count = |dx: f32, dy: f32| {
        let mut moved = *splat;
        moved.mean_px.x += dx;
        moved.mean_px.y += dy;
        count_coarse_tiles(&moved, camera, rules)
    };
    let radius = (splat.log2_opacity + 8.01).max(0.0).sqrt();
    let half_height = radius / splat.rate_y;
    let half_width = (splat.slope.abs() * half_height) + radius / splat.rate_x;
    let roundings = (16.0 * ROUNDOFF) as f32;
    let dx = roundings * (splat.mean_px.x.abs() + half_width + camera.size_px[0] as f32);
    let dy = roundings * (splat.mean_px.y.abs() + half_height + camera.size_px[1] as f32);
    let here = count(0.0, 0.0);
    [(dx, 0.0), (-dx, 0.0), (0.0, dy), (0.0, -dy)]
        .iter()
        .all(|&(dx, dy)| count(dx, dy) == here)
        .then_some(here)
}

/// Output of the twin of project.
pub struct ProjectedTwin {
    pub footprints: Vec<[u32; 4]>,
    pub labels: Vec<[u32; 2]>,
    pub keys: Vec<u32>,
}

/// Records with depth and instance.
pub const LABELED: RecordContents = RecordContents {
    labels: true,
    attribute_vectors: 0,
    depths: false,
};

impl ProjectedTwin {
    /// Room for `room` records. What is not written is `UNTOUCHED`.
    pub fn empty(room: usize) -> Self {
        Self {
            footprints: vec![[0; 4]; 2 * room],
            labels: vec![[0; 2]; room],
            keys: vec![UNTOUCHED; room],
        }
    }

    /// The output of the kernel.
    pub fn read(gpu: &Validated, projected: &Projected) -> Self {
        Self {
            footprints: gpu.read(&projected.footprints).unwrap(),
            labels: gpu.read(&projected.labels).unwrap(),
            keys: gpu.read(&projected.keys).unwrap(),
        }
    }

    /// The buffers to write to.
    pub fn records(&mut self) -> twins::Records<'_> {
        twins::Records {
            footprints: &mut self.footprints,
            labels: &mut self.labels,
            keys: &mut self.keys,
        }
    }

    pub fn color(&self, record: usize) -> Vec3 {
        load_color(&self.footprints, record)
    }

    /// Adds `change` to a color.
    pub fn change_color(&mut self, record: usize, change: Vec3) {
        let code = pack_color(self.color(record) + change);
        self.footprints[2 * record + 1][2..].copy_from_slice(&code);
    }

    /// The pixel in which a record's mean lies, or that next to it, in an image of this
    /// `mean_shift`.
    pub fn pixel_of_mean(&self, record: usize, mean_shift: u32) -> [u32; 2] {
        let splat = load_footprint(&self.footprints, record, mean_shift, [0; 2]);
        let end = 1 << (31 - mean_shift);
        splat.mean_px.to_array().map(|px| (px as u32).min(end - 1))
    }

    /// Footprint, its mean relative to pixel `origin`, and depth of a record of an image of this
    /// `mean_shift`.
    pub fn values(&self, record: usize, mean_shift: u32, origin: [u32; 2]) -> [f32; 7] {
        let splat = load_footprint(&self.footprints, record, mean_shift, origin);
        [
            splat.mean_px.x,
            splat.mean_px.y,
            splat.slope,
            splat.rate_x,
            splat.rate_y,
            splat.log2_opacity,
            self.depth_m(record),
        ]
    }

    pub fn depth_m(&self, record: usize) -> f32 {
        f32::from_bits(self.labels[record][0])
    }
}

/// No depth keys are kept: buffers for stages that are given none.
pub struct NoKeys {
    sets: Buffer<u32>,
    keys: Buffer<u32>,
}

impl NoKeys {
    pub fn new(gpu: &Validated) -> Self {
        Self {
            sets: upload(gpu, &[NO_KEY_SET; 32]),
            keys: upload(gpu, &[]),
        }
    }

    pub fn kept(&self) -> KeptKeys<'_> {
        KeptKeys {
            sets: &self.sets,
            keys: &self.keys,
        }
    }
}

/// The splats to be projected: a bit each, and where each list of them begins.
pub struct Listed {
    pub words: Vec<u32>,
    pub offsets: Vec<u32>,
    /// (camera, splat) of each record.
    pub records: Vec<(usize, usize)>,
}

/// The cameras, in a buffer as long as kernels read it as a uniform buffer.
fn uniform_cameras(gpu: &Validated, cameras: &[CameraRecord]) -> Buffer<CameraRecord> {
    let mut cameras = cameras.to_vec();
    cameras.resize(CAMERAS_MAX, CameraRecord::zeroed());
    upload(gpu, &cameras)
}

impl Scene {
    pub fn views(&self) -> Views<'_> {
        Views {
            cameras: &self.camera_buffer,
            lenses: &self.lens_buffer,
            count: self.view.cameras.len(),
        }
    }

    /// The visible splats, without those whose visibility is a matter of rounding.
    pub fn listed(&self, rules: &Rules) -> Listed {
        let (mut words, _) = self.culled(rules);
        let mut listed = Listed {
            words: Vec::new(),
            offsets: Vec::new(),
            records: Vec::new(),
        };
        for camera in 0..self.view.cameras.len() {
            for cluster in 0..self.clusters.len() {
                listed.offsets.push(listed.records.len() as u32);
                for index in 0..CLUSTER_SPLATS {
                    let bit = (camera * self.clusters.len() + cluster) * CLUSTER_SPLATS + index;
                    if words[bit / 32] >> (bit % 32) & 1 == 0 {
                        continue;
                    }
                    let splat = cluster * CLUSTER_SPLATS + index;
                    if self.settled_visibility(camera, splat, rules) == Some(true) {
                        listed.records.push((camera, splat));
                    } else {
                        words[bit / 32] &= !(1 << (bit % 32));
                    }
                }
            }
        }
        listed.words = words;
        listed
    }

    /// The twin's records where there is room for `room` and no keys are kept. What is not written
    /// is `UNTOUCHED`.
    pub fn projected(
        &self,
        listed: &Listed,
        rules: &Rules,
        variant: ProjectVariant,
        room: usize,
    ) -> ProjectedTwin {
        let mut out = ProjectedTwin::empty(room);
        let input = twins::ProjectBuffers {
            cameras: &self.view.cameras,
            lenses: &self.view.lenses,
            splats: self.splats(),
            sh: self.sh(),
            instances: variant.instances.then_some(self.instances.as_slice()),
            visible_words: &listed.words,
            offsets: &listed.offsets,
            key_sets: &vec![NO_KEY_SET; self.view.cameras.len()],
            kept_keys: &[],
            shadows: &self.shadows,
            shadow_words: &self.shadow_words(),
            fog: fog_vector(self.resident.fog.as_ref()),
        };
        twins::project(&input, &mut out.records(), rules, &variant);
        out
    }
}
