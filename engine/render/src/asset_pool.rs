//! Agents' assets on the device: all in one set of buffers, so that one dispatch draws agents of
//! any assets.

use std::sync::Arc;

use bytemuck::Zeroable;
use decouplegs_gpu::{Buffer, Gpu, MemoryKind, QueueRole, Ticket};
use decouplegs_scene::{Bounds, CodedCloud, ShFrame, SplatCodes, sh, shape};
use glam::DVec3;
use rayon::prelude::*;

use crate::layout::{AgentRecord, CLUSTER_SPLATS, ClusterRecord};
use crate::range_allocator::RangeAllocator;
use crate::resident_splats::{Extent, cluster_of};
use crate::{RenderError, sh_codec};

/// Purpose under which the memory of assets is counted.
pub const PURPOSE: &str = "assets";

/// Words that bands 1 to 3 of a color take.
pub const COLOR_WORDS: usize = 24;

/// Words that a shape takes: one sector, read as two vectors.
pub const SHAPE_WORDS: usize = 8;

/// Names an asset of a pool. Stale after the asset was removed, which is noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct AssetId {
    pub(crate) index: u32,
    pub(crate) generation: u32,
}

/// The pool's buffers as the kernels read them.
#[derive(Clone)]
pub struct PoolBuffers {
    /// Coded splats, three words each.
    pub splats: Buffer<[u32; 3]>,
    /// Boxes of clusters of 256 splats, each level of detail beginning one.
    pub clusters: Buffer<ClusterRecord>,
    /// Triangular factors, as [`stored_shape`] stores them.
    pub shapes: Buffer<[f32; SHAPE_WORDS]>,
    /// DC coefficients of colors.
    pub color_dc: Buffer<[f32; 3]>,
    /// Bands 1 to 3 of colors, 24 words each.
    pub color_bands: Buffer<[u32; COLOR_WORDS]>,
}

/// One level of detail in the pool.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    first_splat: usize,
    splats: usize,
    first_bounds: usize,
    /// Meters from a splat to the next, about.
    pub pitch_m: f64,
}

impl Level {
    pub fn cluster_count(&self) -> usize {
        self.splats.div_ceil(CLUSTER_SPLATS)
    }
}

/// An asset in the pool.
pub(crate) struct Asset {
    generation: u32,
    /// Box of the means of all it draws, in its own frame, and how far these reach out of it.
    pub whole: ClusterRecord,
    pub levels: Vec<Level>,
    pub sh_degree: u8,
    pub sh_frame: ShFrame,
    /// Asset fields for the kernels; the pose belongs to the agent.
    record: AgentRecord,
    ranges: Ranges,
}

impl Asset {
    /// The record of an agent that shows it at level of detail `level`, its splats' range and
    /// codebooks filled in.
    pub fn record(&self, level: usize) -> AgentRecord {
        let Level {
            first_splat,
            splats,
            first_bounds,
            ..
        } = self.levels[level];
        AgentRecord {
            first_splat: first_splat as u32,
            splat_count: splats as u32,
            first_bounds: first_bounds as u32,
            ..self.record
        }
    }

    /// First and number of its colors in the pool.
    pub fn colors(&self) -> (usize, usize) {
        self.ranges.colors
    }

    /// Largest distance of a drawn mean from its origin, meters.
    pub fn distance_max_m(&self) -> f64 {
        let farthest = |axis: usize| {
            f64::from(self.whole.center_m[axis].abs() + self.whole.half_extent_m[axis])
        };
        DVec3::new(farthest(0), farthest(1), farthest(2)).length()
    }
}

/// First and count in each of the pool's buffers.
#[derive(Clone, Copy)]
struct Ranges {
    splats: (usize, usize),
    clusters: (usize, usize),
    shapes: (usize, usize),
    colors: (usize, usize),
}

/// Assets on a device, shared by any number of agents. Adding one copies it behind the frames in
/// flight and waits for nothing.
pub struct AssetPool {
    gpu: Gpu,
    buffers: PoolBuffers,
    splats: RangeAllocator,
    clusters: RangeAllocator,
    shapes: RangeAllocator,
    colors: RangeAllocator,
    assets: Vec<Option<Asset>>,
    generation: u32,
    last_upload: Option<Ticket>,
}

impl AssetPool {
    /// A pool without assets.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let buffers = PoolBuffers {
            splats: gpu.buffer("coded_splats", PURPOSE, 0, MemoryKind::Device)?,
            clusters: gpu.buffer("asset_clusters", PURPOSE, 0, MemoryKind::Device)?,
            shapes: gpu.buffer("coded_shapes", PURPOSE, 0, MemoryKind::Device)?,
            color_dc: gpu.buffer("coded_dc", PURPOSE, 0, MemoryKind::Device)?,
            color_bands: gpu.buffer("coded_bands", PURPOSE, 0, MemoryKind::Device)?,
        };
        Ok(Self {
            gpu: gpu.clone(),
            buffers,
            splats: RangeAllocator::default(),
            clusters: RangeAllocator::default(),
            shapes: RangeAllocator::default(),
            colors: RangeAllocator::default(),
            assets: Vec::new(),
            generation: 0,
            last_upload: None,
        })
    }

    /// Assets that it holds.
    #[must_use]
    pub fn len(&self) -> usize {
        self.assets.iter().flatten().count()
    }

    /// True if it holds no assets.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Copies `cloud` to the device. All agents that show it share it.
    ///
    /// # Errors
    /// Returns an error if the cloud cannot be drawn ([`CodedCloud::check`]), or the device has not
    /// the memory.
    pub fn add(&mut self, cloud: &CodedCloud) -> Result<AssetId, RenderError> {
        cloud.check().map_err(RenderError::Asset)?;
        let encoded = Encoded::from_cloud(cloud);
        let ranges = self.allocate(&encoded)?;
        if let Err(error) = self.upload(&encoded, &ranges) {
            self.release(&ranges);
            return Err(error);
        }
        self.generation += 1;
        let asset = Asset {
            generation: self.generation,
            whole: encoded.whole,
            levels: levels_of(cloud, &ranges),
            sh_degree: cloud.sh_degree,
            sh_frame: cloud.sh_frame,
            record: AgentRecord {
                box_min_m: cloud.bounds.min,
                box_step_m: cloud.position_step_m(),
                dc_residual_step: cloud.dc_residual_step,
                log2_size_min: cloud.log2_size_min,
                log2_size_step: cloud.log2_size_step,
                first_shape: ranges.shapes.0 as u32,
                first_color: ranges.colors.0 as u32,
                dc_residual_gain: [1.0; 3],
                ..AgentRecord::default()
            },
            ranges,
        };
        let index = self
            .assets
            .iter()
            .position(Option::is_none)
            .unwrap_or(self.assets.len());
        if index == self.assets.len() {
            self.assets.push(None);
        }
        self.assets[index] = Some(asset);
        Ok(AssetId {
            index: index as u32,
            generation: self.generation,
        })
    }

    /// Gives the asset's memory back to the pool. Frames in flight still draw it.
    ///
    /// # Errors
    /// Returns an error if the pool does not hold it.
    pub fn remove(&mut self, id: AssetId) -> Result<(), RenderError> {
        let ranges = self.asset(id)?.ranges;
        self.assets[id.index as usize] = None;
        self.release(&ranges);
        Ok(())
    }

    pub(crate) fn asset(&self, id: AssetId) -> Result<&Asset, RenderError> {
        let asset = self.assets.get(id.index as usize).and_then(Option::as_ref);
        asset
            .filter(|asset| asset.generation == id.generation)
            .ok_or(RenderError::NoSuchAsset)
    }

    /// Highest degree of the colors of its assets; `None` when there are none.
    pub(crate) fn sh_degree(&self) -> Option<u8> {
        self.assets
            .iter()
            .flatten()
            .map(|asset| asset.sh_degree)
            .max()
    }

    pub(crate) fn buffers(&self) -> &PoolBuffers {
        &self.buffers
    }

    /// The copy of the asset that was added last.
    pub(crate) fn last_upload(&self) -> Option<&Ticket> {
        self.last_upload.as_ref()
    }

    fn allocate(&mut self, encoded: &Encoded) -> Result<Ranges, RenderError> {
        let [splats, clusters, shapes, colors] = [
            encoded.splats.len(),
            encoded.clusters.len(),
            encoded.shapes.len(),
            encoded.color_dc.len(),
        ];
        let ranges = Ranges {
            splats: (self.splats.take(splats), splats),
            clusters: (self.clusters.take(clusters), clusters),
            shapes: (self.shapes.take(shapes), shapes),
            colors: (self.colors.take(colors), colors),
        };
        if let Err(error) = self.fit_buffers() {
            self.release(&ranges);
            return Err(error);
        }
        Ok(ranges)
    }

    fn release(&mut self, ranges: &Ranges) {
        self.splats.give_back(ranges.splats.0, ranges.splats.1);
        self.clusters
            .give_back(ranges.clusters.0, ranges.clusters.1);
        self.shapes.give_back(ranges.shapes.0, ranges.shapes.1);
        self.colors.give_back(ranges.colors.0, ranges.colors.1);
    }

    /// Buffers as long as what was allocated, the assets in them copied over on the device.
    fn fit_buffers(&mut self) -> Result<(), RenderError> {
        let lengths = [
            self.splats.end(),
            self.clusters.end(),
            self.shapes.end(),
            self.colors.end(),
        ];
        let old = self.buffers.clone();
        if lengths[0] <= old.splats.len()
            && lengths[1] <= old.clusters.len()
            && lengths[2] <= old.shapes.len()
            && lengths[3] <= old.color_dc.len()
        {
            return Ok(());
        }
        let buffers = PoolBuffers {
            splats: grown(&self.gpu, "coded_splats", &old.splats, lengths[0])?,
            clusters: grown(&self.gpu, "asset_clusters", &old.clusters, lengths[1])?,
            shapes: grown(&self.gpu, "coded_shapes", &old.shapes, lengths[2])?,
            color_dc: grown(&self.gpu, "coded_dc", &old.color_dc, lengths[3])?,
            color_bands: grown(&self.gpu, "coded_bands", &old.color_bands, lengths[3])?,
        };
        let mut recorder = self.gpu.record(QueueRole::Main).only_once();
        recorder.stage("grow assets", |r| {
            r.copy(&old.splats, 0, &buffers.splats, 0, old.splats.len());
            r.copy(&old.clusters, 0, &buffers.clusters, 0, old.clusters.len());
            r.copy(&old.shapes, 0, &buffers.shapes, 0, old.shapes.len());
            r.copy(&old.color_dc, 0, &buffers.color_dc, 0, old.color_dc.len());
            r.copy(
                &old.color_bands,
                0,
                &buffers.color_bands,
                0,
                old.color_bands.len(),
            );
        });
        self.last_upload = Some(self.gpu.submit(recorder, &[])?);
        self.buffers = buffers;
        Ok(())
    }

    fn upload(&mut self, encoded: &Encoded, ranges: &Ranges) -> Result<(), RenderError> {
        let gpu = &self.gpu;
        let staged = PoolBuffers {
            splats: staged(gpu, &encoded.splats)?,
            clusters: staged(gpu, &encoded.clusters)?,
            shapes: staged(gpu, &encoded.shapes)?,
            color_dc: staged(gpu, &encoded.color_dc)?,
            color_bands: staged(gpu, &encoded.color_bands)?,
        };
        let to = &self.buffers;
        let mut recorder = gpu.record(QueueRole::Main).only_once();
        recorder.stage("add asset", |r| {
            r.copy(
                &staged.splats,
                0,
                &to.splats,
                ranges.splats.0,
                ranges.splats.1,
            );
            r.copy(
                &staged.clusters,
                0,
                &to.clusters,
                ranges.clusters.0,
                ranges.clusters.1,
            );
            r.copy(
                &staged.shapes,
                0,
                &to.shapes,
                ranges.shapes.0,
                ranges.shapes.1,
            );
            r.copy(
                &staged.color_dc,
                0,
                &to.color_dc,
                ranges.colors.0,
                ranges.colors.1,
            );
            r.copy(
                &staged.color_bands,
                0,
                &to.color_bands,
                ranges.colors.0,
                ranges.colors.1,
            );
        });
        self.last_upload = Some(gpu.submit(recorder, &[])?);
        Ok(())
    }
}

/// A buffer of at least `len`; `old` itself where that is long enough. The next asset shall not
/// make it grow again at once.
fn grown<T: bytemuck::Pod>(
    gpu: &Gpu,
    name: &'static str,
    old: &Buffer<T>,
    len: usize,
) -> Result<Buffer<T>, RenderError> {
    let room = if len <= old.len() {
        old.len()
    } else {
        len + len / 4
    };
    Ok(gpu.buffer(name, PURPOSE, room, MemoryKind::Device)?)
}

fn staged<T: bytemuck::Pod>(gpu: &Gpu, data: &[T]) -> Result<Buffer<T>, RenderError> {
    let buffer = gpu.buffer("staged asset", "staging", data.len(), MemoryKind::Upload)?;
    buffer.write_host(0, data);
    Ok(buffer)
}

fn levels_of(cloud: &CodedCloud, ranges: &Ranges) -> Vec<Level> {
    let size = DVec3::from_array(cloud.bounds.half_extent().map(f64::from)) * 2.0;
    // What it shows lies on surfaces: about those of its box.
    let area_m2 = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
    let (mut first_splat, mut first_bounds) = (ranges.splats.0, ranges.clusters.0);
    let levels = cloud.levels.iter().map(|&splats| {
        let level = Level {
            first_splat,
            splats,
            first_bounds,
            pitch_m: (area_m2 / splats.max(1) as f64).sqrt(),
        };
        first_splat += splats;
        first_bounds += level.cluster_count();
        level
    });
    levels.collect()
}

/// An asset as the device holds it.
struct Encoded {
    splats: Vec<[u32; 3]>,
    clusters: Vec<ClusterRecord>,
    shapes: Vec<[f32; SHAPE_WORDS]>,
    color_dc: Vec<[f32; 3]>,
    color_bands: Vec<[u32; COLOR_WORDS]>,
    whole: ClusterRecord,
}

impl Encoded {
    fn from_cloud(cloud: &CodedCloud) -> Self {
        let longest: Arc<[f32]> = cloud
            .shapes
            .iter()
            .map(|factor| shape::principal_axes(factor).scales[0])
            .collect();
        let extent = |codes: SplatCodes| Extent {
            mean_m: cloud.mean_m(&codes),
            longest_m: longest[usize::from(codes.shape)] * cloud.size(&codes),
            opacity: f32::from(codes.opacity) / 255.0,
        };
        let mut clusters = Vec::new();
        for level in 0..cloud.levels.len() {
            let of_level = cloud.level(level).par_chunks(CLUSTER_SPLATS);
            let boxes = of_level.map(|splats| {
                cluster_of(
                    &splats
                        .iter()
                        .map(|&splat| extent(splat.into()))
                        .collect::<Vec<_>>(),
                )
            });
            clusters.extend(boxes.collect::<Vec<_>>());
        }
        Self {
            splats: cloud.splats.iter().map(|splat| splat.0).collect(),
            shapes: cloud.shapes.iter().map(stored_shape).collect(),
            color_dc: (0..cloud.color_count())
                .map(|entry| cloud.color(entry)[0])
                .collect(),
            color_bands: (0..cloud.color_count())
                .map(|entry| encode_bands(cloud.color(entry), cloud.sh_degree))
                .collect(),
            whole: whole_of(&clusters),
            clusters,
        }
    }
}

/// A triangular factor and the padding that keeps it in one sector.
#[must_use]
pub fn stored_shape(&[xx, yx, yy, zx, zy, zz]: &[f32; 6]) -> [f32; SHAPE_WORDS] {
    [xx, yx, yy, zx, zy, zz, 0.0, 0.0]
}

/// Bands 1 to 3 one behind the other; those that the color has not are zero.
fn encode_bands(coefficients: &[[f32; 3]], sh_degree: u8) -> [u32; COLOR_WORDS] {
    let mut words = [0; COLOR_WORDS];
    let mut first_word = 0;
    for band in 1..=3usize {
        let count = sh_codec::words_of(band);
        if band <= usize::from(sh_degree) {
            let range = sh::coefficient_count(band as u8 - 1)..sh::coefficient_count(band as u8);
            words[first_word..first_word + count].copy_from_slice(
                &sh_codec::encode_band(&coefficients[range], sh_codec::EXACT_BITS)[..count],
            );
        }
        first_word += count;
    }
    words
}

/// The box around the clusters' boxes; one that no camera reaches when nothing is drawn.
fn whole_of(clusters: &[ClusterRecord]) -> ClusterRecord {
    let mut bounds = Bounds::EMPTY;
    let mut splat_radius_m = -1e30f32;
    for cluster in clusters
        .iter()
        .filter(|cluster| cluster.splat_radius_m >= 0.0)
    {
        for side in [-1.0f32, 1.0] {
            bounds.include(&std::array::from_fn(|axis| {
                cluster.center_m[axis] + side * cluster.half_extent_m[axis]
            }));
        }
        splat_radius_m = splat_radius_m.max(cluster.splat_radius_m);
    }
    if splat_radius_m < 0.0 {
        return ClusterRecord {
            splat_radius_m,
            ..ClusterRecord::zeroed()
        };
    }
    let half_extent_m = bounds.half_extent().map(|half| half * 1.000_01);
    ClusterRecord {
        center_m: bounds.center(),
        half_extent_m,
        splat_radius_m,
    }
}
