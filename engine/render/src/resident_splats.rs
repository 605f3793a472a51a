//! Splats on the device: attributes as the kernels read them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytemuck::Zeroable;
use decouplegs_gpu::{Buffer, Gpu, Uploads};
use decouplegs_scene::{
    Bounds, Camera, DetailLevels, Fog, Photometry, SplatCloud, SplatScene, release, rules, sh,
};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::layout::{CLUSTER_SPLATS, ClusterRecord, NodeRecord};
use crate::post_processing::SkyBuffers;
use crate::reference::unscented::SIGMA_SPREAD;
use crate::storage::{CompactShape, Storage, unit};
use crate::{RenderError, sh_codec};

/// Purpose under which the memory of these splats is counted.
pub const PURPOSE: &str = "scene";

/// Tells backgrounds apart whose depth keys are kept.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

/// The splats of a background in device memory. Drawn by any number of frames; clones share the
/// memory, and dropping the last frees it.
#[derive(Clone)]
pub struct ResidentSplats {
    pub(crate) id: u64,
    /// Splats of all levels of detail, defective ones included: these are never drawn, but keep
    /// their index.
    pub splats: usize,
    /// Splats that cannot be drawn.
    pub defects: usize,
    /// Degree of the colors stored.
    pub sh_degree: u8,
    /// True if splats belong to instances.
    pub has_instances: bool,
    /// No drawn mean is farther from the origin, meters.
    pub distance_max_m: f64,
    /// World coordinates of the point that means are relative to.
    pub origin: DVec3,
    /// Color where transmittance is left, behind fog; black where there is a sky map.
    pub sky: [f32; 3],
    /// Colors where transmittance is left, by direction.
    pub sky_map: Option<SkyBuffers>,
    /// Photometric calibration of cameras that have none of their own.
    pub photometry: Photometry,
    /// Fog between the cameras and everything else.
    pub fog: Option<Fog>,
    /// One a [`CLUSTER_SPLATS`] splats.
    pub clusters: Buffer<ClusterRecord>,
    /// Nodes of the levels of detail, one per cluster; of length 0 without levels.
    pub nodes: Buffer<NodeRecord>,
    /// Clusters of the finest level, which come first: all, without levels.
    pub finest_clusters: usize,
    /// Splats that LiDARs meet, where they are not all of them.
    lidar_splats: Option<Arc<ResidentSplats>>,
    /// Storage of the buffers below.
    pub storage: Storage,
    /// Relative to the origin, meters.
    pub means: Buffer<[f32; 3]>,
    /// Exact: scales (m) and opacity, f32. Compact: [`CompactShape`].
    pub shapes: Buffer<[u32; 4]>,
    /// Exact: unit quaternions w, x, y, z, f32. Compact: the opacity words of four splats.
    pub rotations: Buffer<[u32; 4]>,
    /// DC coefficients. Exact: f32, three a splat. Compact: by plane of words.
    pub sh_dc: Buffer<u32>,
    /// Bands 1, 2 and 3, by plane of words; of length 0 where the degree is lower.
    pub sh_bands: [Buffer<u32>; 3],
    /// Two 16-bit ids a word, the earlier one in the low half; of length 0 where splats belong to
    /// no instance.
    pub instances: Buffer<u32>,
}

impl ResidentSplats {
    /// True if images of `cameras` are post-processed: there is a sky map, or a calibration.
    #[must_use]
    pub fn is_post_processed<'a>(&self, cameras: impl IntoIterator<Item = &'a Camera>) -> bool {
        let calibrated = |camera: &Camera| !self.photometry_of(camera).is_identity();
        self.sky_map.is_some() || cameras.into_iter().any(calibrated)
    }

    /// Photometric calibration of the images of `camera`, as `SplatScene::photometry_of` gives it.
    #[must_use]
    pub fn photometry_of(&self, camera: &Camera) -> Photometry {
        camera.intrinsics.photometry.or(self.photometry)
    }

    /// Copies `splat_scene` to the device, its splats stored as `storage` says.
    ///
    /// Splats are drawn in the order given; culling is quickest when neighbors in it are neighbors
    /// in space ([`SplatCloud::spatial_order`]). Splats with a defect are kept as ones of opacity
    /// 0.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, with the bytes wanted.
    pub fn upload(
        gpu: &Gpu,
        splat_scene: &SplatScene,
        storage: Storage,
    ) -> Result<Self, RenderError> {
        let cloud = (
            &splat_scene.splats,
            splat_scene.instance_from_splat.as_slice(),
        );
        let mut scene = Self::with_splats(gpu, splat_scene, cloud, &[], storage)?;
        scene.add_lidar_splats(gpu, splat_scene)?;
        Ok(scene)
    }

    /// Uploads the splats that LiDARs meet, where they are not all of them.
    fn add_lidar_splats(&mut self, gpu: &Gpu, splat_scene: &SplatScene) -> Result<(), RenderError> {
        if !splat_scene.sky_splats.is_empty() {
            let met = splat_scene.without_sky_splats();
            self.lidar_splats = Some(Arc::new(Self::upload(gpu, &met, self.storage)?));
        }
        Ok(())
    }

    /// The splats that LiDARs meet.
    #[must_use]
    pub fn for_lidar(&self) -> &Self {
        self.lidar_splats.as_deref().unwrap_or(self)
    }

    /// [`ResidentSplats::upload`] with levels of detail, which take a third more memory.
    ///
    /// # Errors
    /// Returns an error if the device has not the memory, with the bytes wanted.
    pub fn upload_with_levels(
        gpu: &Gpu,
        splat_scene: &SplatScene,
        storage: Storage,
    ) -> Result<Self, RenderError> {
        let levels = DetailLevels::build(&splat_scene.splats, &splat_scene.instance_from_splat);
        let nodes: Vec<NodeRecord> = levels.nodes.iter().map(NodeRecord::from).collect();
        let cloud = (&levels.splats, levels.instance_from_splat.as_slice());
        let mut scene = Self::with_splats(gpu, splat_scene, cloud, &nodes, storage)?;
        scene.finest_clusters = levels.finest_nodes;
        scene.add_lidar_splats(gpu, splat_scene)?;
        Ok(scene)
    }

    /// `splat_scene` with other splats, and the instances that they belong to.
    fn with_splats(
        gpu: &Gpu,
        splat_scene: &SplatScene,
        (cloud, instance_from_splat): (&SplatCloud, &[u16]),
        nodes: &[NodeRecord],
        storage: Storage,
    ) -> Result<Self, RenderError> {
        let prepared: Vec<Prepared> = (0..cloud.len())
            .into_par_iter()
            .map(|splat| Prepared::new(cloud, splat, storage))
            .collect();
        let means: Vec<[f32; 3]> = prepared.par_iter().map(|splat| splat.mean_m).collect();
        let shapes: Vec<[u32; 4]> = prepared.par_iter().map(|splat| splat.shape_words).collect();
        let mut uploads = gpu.uploads();
        let band = |uploads: &mut Uploads, band| {
            uploads.upload(
                ["sh_dc", "sh_band1", "sh_band2", "sh_band3"][band],
                PURPOSE,
                &band_words(cloud, &prepared, storage, band),
            )
        };
        let clusters: Vec<ClusterRecord> = prepared
            .par_chunks(CLUSTER_SPLATS)
            .map(|splats| {
                cluster_of(
                    &splats
                        .iter()
                        .filter_map(Prepared::extent)
                        .collect::<Vec<_>>(),
                )
            })
            .collect();
        let distance_m = |splat: &Prepared| Vec3::from_array(splat.mean_m).as_dvec3().length();
        // Fog that dims nothing is none: kernels with fog may round otherwise.
        let fog = splat_scene.fog.filter(|fog| fog.extinction_per_m > 0.0);
        let scene = Self {
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            distance_max_m: prepared
                .par_iter()
                .filter(|splat| splat.drawn)
                .map(distance_m)
                .reduce(|| 0.0, f64::max),
            splats: cloud.len(),
            defects: prepared.iter().filter(|splat| !splat.drawn).count(),
            sh_degree: cloud.sh_degree,
            has_instances: !instance_from_splat.is_empty(),
            origin: splat_scene.origin,
            sky: match (&splat_scene.sky_map, &fog) {
                (Some(_), _) => [0.0; 3],
                (None, None) => splat_scene.sky,
                (None, Some(fog)) => {
                    let seen = fog.seen_sky(splat_scene.sky.map(f64::from));
                    seen.map(|value| value as f32)
                }
            },
            sky_map: splat_scene
                .sky_map
                .as_ref()
                .map(|sky| SkyBuffers::upload(gpu, sky))
                .transpose()?
                .map(|sky| match &fog {
                    Some(fog) => sky.behind(fog),
                    None => sky,
                }),
            fog,
            photometry: splat_scene.photometry,
            finest_clusters: clusters.len(),
            lidar_splats: None,
            nodes: uploads.upload("nodes", PURPOSE, nodes)?,
            clusters: uploads.upload("clusters", PURPOSE, &clusters)?,
            means: uploads.upload("means", PURPOSE, &means)?,
            storage,
            shapes: uploads.upload("shapes", PURPOSE, &shapes)?,
            rotations: uploads.upload("rotations", PURPOSE, &rotation_words(&prepared, storage))?,
            sh_dc: band(&mut uploads, 0)?,
            sh_bands: [
                band(&mut uploads, 1)?,
                band(&mut uploads, 2)?,
                band(&mut uploads, 3)?,
            ],
            instances: uploads.upload("instances", PURPOSE, &pack_pairs(instance_from_splat))?,
        };
        uploads.finish()?;
        release((prepared, means, shapes));
        Ok(scene)
    }

    /// Clusters of all levels of detail.
    #[must_use]
    pub fn cluster_count(&self) -> usize {
        self.splats.div_ceil(CLUSTER_SPLATS)
    }
}

/// One splat as it is stored.
struct Prepared {
    drawn: bool,
    mean_m: [f32; 3],
    /// Scales (m) and opacity, as they are read back.
    shape: [f32; 4],
    /// Words in [`ResidentSplats::shapes`].
    shape_words: [u32; 4],
    /// Word in [`ResidentSplats::rotations`] of compact storage.
    opacity_word: u32,
    rotation: [f32; 4],
}

impl Prepared {
    fn new(cloud: &SplatCloud, splat: usize, storage: Storage) -> Self {
        if cloud.defect_of(splat).is_some() {
            return Self {
                drawn: false,
                mean_m: [0.0; 3],
                shape: [0.0; 4],
                shape_words: [0; 4],
                opacity_word: 0,
                rotation: [1.0, 0.0, 0.0, 0.0],
            };
        }
        let (scales_m, opacity) = (cloud.scales[splat], cloud.opacities[splat]);
        let rotation = unit(cloud.rotations[splat]);
        // Boxes of clusters must hold what is drawn, so scales are those that are read back.
        let (shape, shape_words, opacity_word) = match storage {
            Storage::Exact => {
                let [x, y, z] = scales_m;
                let shape = [x, y, z, opacity];
                (shape, shape.map(f32::to_bits), 0)
            }
            Storage::Compact => {
                let code = CompactShape::new(scales_m, rotation, opacity);
                (code.unpack().0, code.shape, code.opacity)
            }
        };
        Self {
            drawn: true,
            mean_m: cloud.means[splat],
            shape,
            shape_words,
            opacity_word,
            rotation,
        }
    }

    fn extent(&self) -> Option<Extent> {
        let [x, y, z, opacity] = self.shape;
        self.drawn.then_some(Extent {
            mean_m: self.mean_m,
            longest_m: x.max(y).max(z),
            opacity,
        })
    }
}

/// Extent of a splat, for the bounding box of its cluster.
pub(crate) struct Extent {
    pub mean_m: [f32; 3],
    /// Longest standard deviation.
    pub longest_m: f32,
    pub opacity: f32,
}

impl Extent {
    /// Standard deviation times cut-off radius along the longest axis, meters, rounded up; no less
    /// than how far the points stand that the unscented transform takes.
    fn splat_radius_m(&self) -> f32 {
        let radius = (2.0 * (f64::from(self.opacity) / rules::ALPHA_MIN).ln().max(0.0))
            .sqrt()
            .max(SIGMA_SPREAD);
        (f64::from(self.longest_m) * radius * 1.001) as f32
    }
}

/// The box of a cluster's drawn splats; one that no camera reaches when it has none.
pub(crate) fn cluster_of(splats: &[Extent]) -> ClusterRecord {
    // An opacity below 1/255 is never seen, wherever it is.
    let drawn = || {
        splats
            .iter()
            .filter(|splat| f64::from(splat.opacity) >= rules::ALPHA_MIN * 0.999)
    };
    if drawn().next().is_none() {
        // Infinitely small at infinity would be NaN in the test; far behind nothing is simplest
        // said by a negative radius.
        return ClusterRecord {
            splat_radius_m: -1e30,
            ..ClusterRecord::zeroed()
        };
    }
    let bounds = Bounds::from_points(drawn().map(|splat| &splat.mean_m));
    ClusterRecord {
        center_m: bounds.center(),
        half_extent_m: bounds.half_extent().map(|half| half * 1.000_01),
        splat_radius_m: drawn().map(Extent::splat_radius_m).fold(0.0, f32::max),
    }
}

/// Words of [`ResidentSplats::rotations`].
fn rotation_words(prepared: &[Prepared], storage: Storage) -> Vec<[u32; 4]> {
    match storage {
        Storage::Exact => prepared
            .par_iter()
            .map(|splat| splat.rotation.map(f32::to_bits))
            .collect(),
        Storage::Compact => prepared
            .par_chunks(4)
            .map(|splats| {
                std::array::from_fn(|k| splats.get(k).map_or(0, |splat| splat.opacity_word))
            })
            .collect(),
    }
}

/// Splats whose coefficients one task encodes.
const PART_SPLATS: usize = 4096;

/// Words in which the device reads the coefficients of `band`; none above the degree of `cloud`.
fn band_words(
    cloud: &SplatCloud,
    prepared: &[Prepared],
    storage: Storage,
    band: usize,
) -> Vec<u32> {
    if usize::from(cloud.sh_degree) < band {
        return Vec::new();
    }
    let count = cloud.len();
    let Some(bits) = storage.sh_bits(band) else {
        let mut words = vec![0; 3 * count];
        let slots = words.par_chunks_exact_mut(3);
        slots
            .zip(prepared)
            .zip(&cloud.sh_dc)
            .filter(|((_, splat), _)| splat.drawn)
            .for_each(|((slot, _), dc)| slot.copy_from_slice(&dc.map(f32::to_bits)));
        return words;
    };
    let coefficients = |splat: usize| match band {
        0 => std::slice::from_ref(&cloud.sh_dc[splat]),
        _ => {
            let first = sh::coefficient_count(band as u8 - 1) - 1;
            &cloud.rest_of(splat)[first..sh::coefficient_count(band as u8) - 1]
        }
    };
    // One plane for each word of a splat, one task for the same splats of all planes.
    let mut words = vec![0; storage.sh_words(band) * count];
    let mut parts: Vec<Vec<&mut [u32]>> = Vec::new();
    parts.resize_with(count.div_ceil(PART_SPLATS), Vec::new);
    for plane in words.chunks_exact_mut(count.max(1)) {
        let slots = plane.chunks_mut(PART_SPLATS);
        parts
            .iter_mut()
            .zip(slots)
            .for_each(|(part, slots)| part.push(slots));
    }
    parts.par_iter_mut().enumerate().for_each(|(part, planes)| {
        let splats = part * PART_SPLATS..count.min((part + 1) * PART_SPLATS);
        for (slot, splat) in splats.enumerate().filter(|&(_, i)| prepared[i].drawn) {
            let encoded = sh_codec::encode_band(coefficients(splat), bits);
            for (plane, word) in planes.iter_mut().zip(encoded) {
                plane[slot] = word;
            }
        }
    });
    words
}

/// Two 16-bit ids a word, the earlier one in the low half.
fn pack_pairs(ids: &[u16]) -> Vec<u32> {
    ids.chunks(2)
        .map(|pair| u32::from(pair[0]) | u32::from(pair.get(1).copied().unwrap_or(0)) << 16)
        .collect()
}
