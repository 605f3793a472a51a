//! Agents of every kind that is hard for a stage, as the stages hold them.

use bytemuck::Zeroable;
use decouplegs::gpu::Buffer;
use decouplegs::render::layout::{
    AgentRecord, CLUSTER_SPLATS, CameraRecord, ClusterRecord, LensRecord, RelightRecord,
    ShadingRecord, View, fog_vector,
};
use decouplegs::render::stages::{AgentBuffers, AgentCounts, CameraVariant, RelitColors};
use decouplegs::render::twins::agent::{UnpackedSplat, axes_of, unpack_splat};
use decouplegs::render::twins::lens::lens_of;
use decouplegs::render::twins::projection::Variant;
use decouplegs::render::twins::shading::{inverse_power, shading_gain, shading_normal};
use decouplegs::render::{PoolBuffers, sh_codec, stored_shape, twins};
use decouplegs::scene::light::Shading;
use decouplegs::scene::shape::principal_axes;
use decouplegs::scene::{
    Bounds, Camera, CodedCloud, CodedSplat, ColorTransfer, Fog, Pose, RayMap, Rules, SplatCodes, sh,
};
use glam::{DMat3, DQuat, DVec3, Mat3, Vec3};

use super::super::scenes::{ProjectedTwin, settled_visibility};
use super::super::{ROUNDOFF, UNTOUCHED, upload};
use super::hard_clouds::hard_cloud;
use crate::device::Validated;

/// One agent: what it shows, where, to whom.
#[derive(Clone, Copy)]
pub struct AgentInstance {
    pub cloud: usize,
    pub level: usize,
    pub pose: Pose,
    pub cameras: u32,
    pub colors_in_world: bool,
}

impl AgentInstance {
    /// The finest level of a cloud, seen by all cameras.
    pub fn new(cloud: usize, pose: Pose) -> Self {
        Self {
            cloud,
            level: 0,
            pose,
            cameras: u32::MAX,
            colors_in_world: false,
        }
    }
}

/// Clouds in a pool and the agents of a frame, as the kernels read them.
#[derive(Default)]
pub struct AgentScene {
    pub agents: Vec<AgentRecord>,
    /// `[agent][camera]`.
    pub cameras: Vec<CameraRecord>,
    pub lenses: Vec<LensRecord>,
    pub maps: Vec<RayMap>,
    pub splats: Vec<[u32; 3]>,
    pub shapes: Vec<[f32; 6]>,
    pub dc: Vec<[f32; 3]>,
    pub bands: Vec<[u32; 24]>,
    pub clusters: Vec<ClusterRecord>,
    /// Colors of the agents that are relit.
    pub relit_dc: Vec<[f32; 3]>,
    /// Fog between the agents and the cameras.
    pub fog: Option<Fog>,
    pub relit_bands: Vec<[u32; 24]>,
    /// Light on the agents that are shaded by normals.
    pub shadings: Vec<ShadingRecord>,
    pub counts: AgentCounts,
}

/// The splats to be projected: a bit each, and where each list of them begins, with their total
/// behind.
pub struct ListedAgents {
    pub words: Vec<u32>,
    pub offsets: Vec<u32>,
    /// (camera, agent, splat of its level) of each record.
    pub records: Vec<(usize, usize, usize)>,
}

impl AgentScene {
    /// `placed` agents of `clouds`, seen by `cameras`.
    pub fn new(clouds: &[CodedCloud], placed: &[AgentInstance], cameras: &[Camera]) -> Self {
        let mut scene = Self::default();
        // An entry of another asset stands before each.
        let offsets: Vec<AgentRecord> = clouds.iter().map(|cloud| scene.add(cloud)).collect();
        let view = View::new(cameras, DVec3::ZERO, 1e4).unwrap();
        scene.counts.cameras = cameras.len();
        for (instance, placed) in (1..).zip(placed) {
            let (cloud, first) = (&clouds[placed.cloud], offsets[placed.cloud]);
            let before = &cloud.levels[..placed.level];
            let rows = DMat3::from_quat(placed.pose.rotation).transpose();
            scene.agents.push(AgentRecord {
                row_x: rows.x_axis.as_vec3().to_array(),
                row_y: rows.y_axis.as_vec3().to_array(),
                row_z: rows.z_axis.as_vec3().to_array(),
                first_cluster: scene.counts.clusters as u32,
                first_bounds: first.first_bounds
                    + before
                        .iter()
                        .map(|splats| splats.div_ceil(CLUSTER_SPLATS))
                        .sum::<usize>() as u32,
                first_splat: first.first_splat + before.iter().sum::<usize>() as u32,
                splat_count: cloud.levels[placed.level] as u32,
                cameras: placed.cameras,
                instance,
                colors_in_world: placed.colors_in_world.into(),
                ..first
            });
            scene.counts.clusters += cloud.levels[placed.level].div_ceil(CLUSTER_SPLATS);
            let moved = view.cameras.iter().zip(cameras);
            scene.cameras.extend(
                moved.map(|(record, camera)| record.moved_into(camera, DVec3::ZERO, &placed.pose)),
            );
        }
        scene.counts.agents = placed.len();
        scene.lenses = view.lenses;
        scene.maps = cameras
            .iter()
            .map(|camera| RayMap::new(&camera.intrinsics))
            .collect();
        scene
    }

    /// Adds an agent and three clusters that only fill up their number, as frames do.
    fn padded(mut self) -> Self {
        self.agents.push(AgentRecord {
            first_cluster: u32::MAX,
            ..AgentRecord::default()
        });
        self.cameras
            .extend(vec![CameraRecord::zeroed(); self.counts.cameras]);
        self.counts.agents += 1;
        self.counts.clusters += 3;
        self
    }

    /// Kind of the cameras.
    pub fn camera_variant(&self) -> CameraVariant {
        CameraVariant::for_cameras(&self.cameras, &self.lenses)
    }

    /// Puts a cloud into the pool; returns where its parts begin.
    fn add(&mut self, cloud: &CodedCloud) -> AgentRecord {
        cloud.check().unwrap();
        self.splats.push([u32::MAX; 3]);
        self.shapes.push([1e9; 6]);
        self.dc.push([1e9; 3]);
        self.bands.push([u32::MAX; 24]);
        self.clusters.push(ClusterRecord {
            center_m: [0.0; 3],
            half_extent_m: [0.0; 3],
            splat_radius_m: -1e30,
        });
        let record = AgentRecord {
            box_min_m: cloud.bounds.min,
            box_step_m: cloud.position_step_m(),
            dc_residual_step: cloud.dc_residual_step,
            log2_size_min: cloud.log2_size_min,
            log2_size_step: cloud.log2_size_step,
            first_bounds: self.clusters.len() as u32,
            first_splat: self.splats.len() as u32,
            first_shape: self.shapes.len() as u32,
            first_color: self.dc.len() as u32,
            dc_residual_gain: [1.0; 3],
            ..AgentRecord::default()
        };
        self.splats.extend(cloud.splats.iter().map(|splat| splat.0));
        self.shapes.extend(&cloud.shapes);
        for color in 0..cloud.color_count() {
            self.dc.push(cloud.color(color)[0]);
            self.bands.push(encoded_bands(cloud.color(color)));
        }
        for level in 0..cloud.levels.len() {
            self.clusters.extend(
                cloud
                    .level(level)
                    .chunks(CLUSTER_SPLATS)
                    .map(|splats| cluster_of(cloud, splats)),
            );
        }
        record
    }

    /// Puts `agent`, which shows a codebook of `colors`, in a light of its own.
    pub fn relight(&mut self, agent: usize, colors: usize, light: &ColorTransfer) {
        let (record, first) = (&mut self.agents[agent], self.relit_dc.len());
        let relight = RelightRecord {
            first_relit: first as u32,
            ..RelightRecord::new(light, 3, record.first_color as usize, colors)
        };
        self.relit_dc.resize(first + colors, [0.0; 3]);
        self.relit_bands.resize(first + colors, [0; 24]);
        twins::relight(
            &[relight],
            &self.dc,
            &self.bands,
            &mut self.relit_dc,
            &mut self.relit_bands,
            3,
        );
        record.first_color = first as u32;
        record.colors_relit = 1;
        record.dc_residual_gain = light.gain[0];
    }

    /// Shades `agent` by normals.
    pub fn shade(&mut self, agent: usize, shading: &Shading) {
        self.shadings.push(ShadingRecord::new(shading));
        self.agents[agent].shading = self.shadings.len() as u32;
        self.counts.shadings = self.shadings.len();
    }

    /// Bounds on the rounding errors of the factor by which the color of a splat of `agent` is
    /// shaded, relative, and the factor itself.
    pub fn shading_error(&self, agent: usize, mean_m: [f32; 3], axes: Mat3) -> (f64, f64) {
        let Some(place) = self.agents[agent].shading.checked_sub(1) else {
            return (0.0, 1.0);
        };
        let shading = &self.shadings[place as usize];
        let mean_m = Vec3::from_array(mean_m);
        let columns = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.as_dvec3());
        let unit = columns
            .iter()
            .map(|axis| axis.length())
            .fold(1e-30, f64::max);
        let [x, y, z] = columns.map(|axis| axis / unit);
        // Products of columns of length 1 at most are rounded, and the power is four times as far
        // off as they are, relative to its largest part.
        let largest = [y.cross(z), z.cross(x), x.cross(y)]
            .iter()
            .map(|product| product.length())
            .fold(0.0, f64::max);
        let power = inverse_power(axes, 2);
        let outward = (mean_m * Vec3::from_array(shading.outward)).normalize_or(Vec3::Z);
        let of_power = power.x_axis.x + power.y_axis.y + power.z_axis.z;
        let across = f64::from((power * outward).length() / of_power.max(1e-30));
        let normal = (64.0 * ROUNDOFF / (largest * across).max(1e-30)).min(2.0);
        let steepest = |rgb: [f32; 3]| f64::from(rgb.into_iter().fold(0.0, f32::max));
        let slope = steepest(shading.upward.map(f32::abs))
            + shading.rgb.into_iter().map(steepest).sum::<f64>();
        let gain = shading_gain(shading, shading_normal(shading, axes, mean_m), mean_m).as_dvec3();
        let darkest = gain.min_element().powf(2.2);
        // A power is three rounded functions.
        let relative = (normal * slope / darkest + 64.0 * ROUNDOFF) / 2.2 + 64.0 * ROUNDOFF;
        (relative, gain.max_element())
    }

    pub fn relit(&self, gpu: &Validated) -> RelitColors {
        let relit = RelitColors::new(gpu, self.relit_dc.len()).unwrap();
        gpu.write(&relit.dc, 0, &self.relit_dc).unwrap();
        gpu.write(&relit.bands, 0, &self.relit_bands).unwrap();
        relit
    }

    pub fn unpacked(&self, agent: usize, splat: usize) -> (UnpackedSplat, Mat3) {
        let agent = &self.agents[agent];
        let coded = unpack_splat(self.splats[agent.first_splat as usize + splat], agent);
        (coded, axes_of(agent, &coded, &self.shapes))
    }

    pub fn camera(&self, agent: usize, camera: usize) -> &CameraRecord {
        &self.cameras[agent * self.counts.cameras + camera]
    }

    /// Relative error bound of a splat's size: a power of two is accurate to 3 + 2 |x| units in the
    /// last place (Vulkan specification, Precision of SPIR-V Instructions), and its exponent is a
    /// rounded product and sum.
    pub fn size_share(&self, agent: usize, splat: usize) -> f64 {
        let record = &self.agents[agent];
        let log2_size = f64::from(self.unpacked(agent, splat).0.size).log2();
        let steps =
            f64::from((record.log2_size_min.abs() + 255.0 * record.log2_size_step).max(1.0));
        2.0 * ROUNDOFF * (3.0 + 2.0 * log2_size.abs())
            + std::f64::consts::LN_2 * 2.0 * ROUNDOFF * steps
    }

    /// Visibility of the splat if it is the same for every rounding of f32: else `None`.
    pub fn settled_visibility(
        &self,
        camera: usize,
        agent: usize,
        splat: usize,
        rules: &Rules,
    ) -> Option<bool> {
        if self.agents[agent].cameras >> camera & 1 == 0 {
            return Some(false);
        }
        let (coded, axes) = self.unpacked(agent, splat);
        let size_share = 16.0 * ROUNDOFF + self.size_share(agent, splat);
        settled_visibility(
            self.camera(agent, camera),
            lens_of(&self.lenses, camera),
            coded.mean_m,
            axes,
            size_share,
            coded.opacity,
            rules,
        )
    }

    /// Camera, agent and splat of a bit of the visibility words; the splat is `None` beyond the
    /// agent's last.
    pub fn splat_of_bit(&self, bit: usize) -> (usize, usize, Option<usize>) {
        let (camera, index) = (
            bit / (self.counts.clusters * CLUSTER_SPLATS),
            bit % (self.counts.clusters * CLUSTER_SPLATS),
        );
        let agent = twins::agent::agent_of_cluster((index / CLUSTER_SPLATS) as u32, &self.agents);
        let splat = index - self.agents[agent].first_cluster as usize * CLUSTER_SPLATS;
        (
            camera,
            agent,
            Some(splat).filter(|&splat| splat < self.agents[agent].splat_count as usize),
        )
    }

    fn inputs(&self) -> twins::AgentInputs<'_> {
        twins::AgentInputs {
            agents: &self.agents,
            agent_cameras: &self.cameras,
            lenses: &self.lenses,
            splats: &self.splats,
            shapes: &self.shapes,
            camera_count: self.counts.cameras,
            cluster_count: self.counts.clusters,
            fog: self.fog.as_ref().map(|fog| fog_vector(Some(fog))),
            shadings: &self.shadings,
        }
    }

    /// The twin's visible words and counts.
    pub fn culled(&self, rules: &Rules) -> (Vec<u32>, Vec<u32>) {
        let AgentCounts {
            cameras, clusters, ..
        } = self.counts;
        let (mut words, mut counts) = (
            vec![0; cameras * clusters * CLUSTER_SPLATS / 32],
            vec![0; cameras * clusters],
        );
        let mut visible = twins::VisibleBits {
            words: &mut words,
            counts: &mut counts,
        };
        twins::cull_agents(
            &self.inputs(),
            &self.clusters,
            &mut visible,
            Variant::for_rules(rules),
        );
        (words, counts)
    }

    /// The visible splats, without those whose visibility is a matter of rounding.
    pub fn listed(&self, rules: &Rules) -> ListedAgents {
        let (mut words, _) = self.culled(rules);
        let mut listed = ListedAgents {
            words: Vec::new(),
            offsets: Vec::new(),
            records: Vec::new(),
        };
        for bit in 0..words.len() * 32 {
            if bit % CLUSTER_SPLATS == 0 {
                listed.offsets.push(listed.records.len() as u32);
            }
            let (camera, agent, splat) = self.splat_of_bit(bit);
            match splat.filter(|_| words[bit / 32] >> (bit % 32) & 1 == 1) {
                Some(splat)
                    if self.settled_visibility(camera, agent, splat, rules) == Some(true) =>
                {
                    listed.records.push((camera, agent, splat));
                }
                _ => words[bit / 32] &= !(1 << (bit % 32)),
            }
        }
        listed.offsets.push(listed.records.len() as u32);
        listed.words = words;
        listed
    }

    /// The twin's records behind `static_offsets[static_lists]` of the background, where there is
    /// room for `room` in all.
    pub fn projected(
        &self,
        listed: &ListedAgents,
        static_offsets: &[u32],
        rules: &Rules,
        sh_degree: u8,
        room: usize,
    ) -> ProjectedTwin {
        let mut out = ProjectedTwin::empty(room);
        let codebooks = twins::ColorCodebooks {
            dc: &self.dc,
            bands: &self.bands,
            relit_dc: &self.relit_dc,
            relit_bands: &self.relit_bands,
        };
        let listed = twins::ListedSplats {
            visible_words: &listed.words,
            offsets: &listed.offsets,
            first_record: *static_offsets.last().expect("offsets end with a total"),
        };
        let degree = sh_degree.into();
        twins::project_agents(
            &self.inputs(),
            &codebooks,
            &listed,
            &mut out.records(),
            rules,
            degree,
        );
        out
    }

    pub fn pool(&self, gpu: &Validated) -> PoolBuffers {
        PoolBuffers {
            splats: upload(gpu, &self.splats),
            clusters: upload(gpu, &self.clusters),
            shapes: upload(
                gpu,
                &self.shapes.iter().map(stored_shape).collect::<Vec<_>>(),
            ),
            color_dc: upload(gpu, &self.dc),
            color_bands: upload(gpu, &self.bands),
        }
    }

    /// The agents on the device; what the kernels write holds [`UNTOUCHED`].
    pub fn buffers(&self, gpu: &Validated) -> AgentBuffers {
        let buffers = AgentBuffers::new(gpu, self.counts).unwrap();
        gpu.write(&buffers.shadings, 0, &self.shadings).unwrap();
        gpu.write(&buffers.agents, 0, &self.agents).unwrap();
        gpu.write(&buffers.cameras, 0, &self.cameras).unwrap();
        gpu.write(&buffers.lenses, 0, &self.lenses).unwrap();
        let fill = |buffer: &Buffer<u32>| {
            gpu.write(buffer, 0, &vec![UNTOUCHED; buffer.len()])
                .unwrap();
        };
        [
            &buffers.visible.words,
            &buffers.visible.counts,
            &buffers.offsets,
        ]
        .into_iter()
        .for_each(fill);
        buffers
    }
}

/// Bands 1 to 3 one behind the other.
fn encoded_bands(coefficients: &[[f32; 3]]) -> [u32; 24] {
    let mut words = Vec::new();
    for band in 1..=3u8 {
        let range = sh::coefficient_count(band - 1)..sh::coefficient_count(band);
        words.extend(
            &sh_codec::encode_band(&coefficients[range], sh_codec::EXACT_BITS)
                [..sh_codec::words_of(band.into())],
        );
    }
    words.try_into().unwrap()
}

/// A box that holds what is drawn of `splats`.
fn cluster_of(cloud: &CodedCloud, splats: &[CodedSplat]) -> ClusterRecord {
    let codes: Vec<SplatCodes> = splats
        .iter()
        .map(|&splat| splat.into())
        .filter(|codes: &SplatCodes| codes.opacity > 0)
        .collect();
    let means: Vec<[f32; 3]> = codes.iter().map(|codes| cloud.mean_m(codes)).collect();
    if means.is_empty() {
        return ClusterRecord {
            center_m: [0.0; 3],
            half_extent_m: [0.0; 3],
            splat_radius_m: -1e30,
        };
    }
    let bounds = Bounds::from_points(&means);
    let splat_radius_m = |codes: &SplatCodes| {
        let longest =
            principal_axes(&cloud.shapes[usize::from(codes.shape)]).scales[0] * cloud.size(codes);
        longest * (2.0 * f32::from(codes.opacity).ln()).sqrt().max(1.7321) * 1.001
    };
    ClusterRecord {
        center_m: bounds.center(),
        half_extent_m: bounds.half_extent().map(|half| half * 1.000_01),
        splat_radius_m: codes.iter().map(splat_radius_m).fold(0.0, f32::max),
    }
}

/// Agents in front of the rig, turned, around the near plane, behind, so far that they are a pixel,
/// and beside it; some for some cameras only, some of a coarser level, of a level of no splats or
/// with colors that are not turned.
pub fn hard_agents(cameras: &[Camera]) -> AgentScene {
    let clouds = [
        hard_cloud(vec![900, 256, 0, 1], 31),
        hard_cloud(vec![1100], 32),
    ];
    let turned =
        DQuat::from_rotation_z(2.1) * DQuat::from_rotation_x(0.4) * DQuat::from_rotation_y(-0.7);
    let at = |cloud: usize, x: f64, y: f64, z: f64, rotation: DQuat| {
        AgentInstance::new(cloud, Pose::new(rotation, DVec3::new(x, y, z)))
    };
    let placed = [
        at(0, 0.5, 0.2, 8.0, DQuat::IDENTITY),
        at(1, -1.0, 0.5, 5.0, turned),
        AgentInstance {
            level: 2,
            ..at(0, 0.0, 0.0, 6.0, turned)
        },
        at(1, 0.1, 0.0, 0.3, turned.inverse()),
        at(0, 0.0, 0.0, -30.0, turned),
        AgentInstance {
            level: 1,
            ..at(0, 20.0, -9.0, 3000.0, turned)
        },
        AgentInstance {
            colors_in_world: true,
            cameras: 0b0101,
            ..at(1, 1.0, -1.0, 12.0, turned)
        },
        AgentInstance {
            level: 3,
            colors_in_world: true,
            ..at(0, 0.2, 0.1, 4.0, turned.inverse())
        },
        AgentInstance {
            cameras: 0,
            ..at(0, 0.0, 0.0, 7.0, turned)
        },
        at(1, 40.0, 0.0, 6.0, turned * turned),
        AgentInstance {
            level: 2,
            ..at(0, 0.0, 0.0, 9.0, turned)
        },
    ];
    AgentScene::new(&clouds, &placed, cameras).padded()
}
