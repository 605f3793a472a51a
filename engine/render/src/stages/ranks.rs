//! Kept orders: the rank of every splat of the background along a direction, and the visible ones among them.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder, Residence};

use super::{PURPOSE, Scan, SortScratch, kernel, push_constants};
use crate::capacity::groups_for;
use crate::layout::{CHUNK_SPLATS, CameraRecord, ViewOrder};
use crate::resident::ResidentWorld;

/// What each camera sees, by rank. Of length 0 where no order is kept.
pub struct RankLists {
    /// One bit a rank, `[camera][chunk][8 words]`; zero before the frame.
    pub words: Buffer<u32>,
    counts: Buffer<u32>,
    /// Visible splats before each `[camera][chunk]` of ranks, and their total.
    pub firsts: Buffer<u32>,
}

impl RankLists {
    /// Buffers for a world of `chunks` seen by `cameras`.
    ///
    /// # Errors
    /// When the device is out of memory.
    pub fn new(gpu: &Gpu, cameras: usize, chunks: usize) -> Result<Self, GpuError> {
        let lists = cameras * chunks;
        let buffer = |name, len| gpu.buffer(name, PURPOSE, len, Residence::Device);
        Ok(Self {
            words: buffer("rank_words", lists * CHUNK_SPLATS / 32)?,
            counts: buffer("rank_counts", lists)?,
            firsts: buffer("rank_firsts", lists + 1)?,
        })
    }
}

/// What the stages need to know of kept orders.
#[derive(Clone, Copy)]
pub struct Ranked<'a> {
    /// How each camera's background comes into order.
    pub view_orders: &'a Buffer<ViewOrder>,
    /// Places in the order, `[rank set][splat]`.
    pub ranks: &'a Buffer<u32>,
    /// What is visible, by rank.
    pub lists: &'a RankLists,
}

push_constants! {
    struct KeyPush {
        splat_count: u32,
        camera: u32,
    }
}

push_constants! {
    struct RankPush {
        splat_count: u32,
        rank_set: u32,
    }
}

push_constants! {
    struct CountPush {
        count: u32,
    }
}

/// `key_splats.comp`, `rank_splats.comp` and `count_ranks.comp`.
pub struct Ranks {
    key: Kernel,
    rank: Kernel,
    count: Kernel,
}

impl Ranks {
    /// The stages.
    ///
    /// # Errors
    /// When the driver refuses a kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            key: kernel::<KeyPush>(gpu, &decouplegs_shaders::KEY_SPLATS, &[])?,
            rank: kernel::<RankPush>(gpu, &decouplegs_shaders::RANK_SPLATS, &[])?,
            count: kernel::<CountPush>(gpu, &decouplegs_shaders::COUNT_RANKS, &[])?,
        })
    }

    /// Writes the depth keys of all splats of `world` along the direction of camera `camera`, and their indices, to the first
    /// buffers of `sort`.
    pub fn record_keys(
        &self,
        recorder: &mut Recorder,
        world: &ResidentWorld,
        cameras: &Buffer<CameraRecord>,
        camera: usize,
        sort: &SortScratch,
    ) {
        let push = KeyPush { splat_count: world.splats as u32, camera: camera as u32 };
        let buffers = [
            ("cameras", cameras.binding()),
            ("means_m", world.means.binding()),
            ("keys", sort.keys[0].binding()),
            ("values", sort.values[0].binding()),
        ];
        recorder.dispatch(&self.key, &buffers, bytes_of(&push), groups_for(world.splats.div_ceil(256)));
    }

    /// Writes the ranks of `splats` splats, whose sorted indices are `order`, as set `rank_set` of `ranks`.
    pub fn record_ranks(
        &self,
        recorder: &mut Recorder,
        order: &Buffer<u32>,
        splats: usize,
        ranks: &Buffer<u32>,
        rank_set: usize,
    ) {
        let push = RankPush { splat_count: splats as u32, rank_set: rank_set as u32 };
        let buffers = [("values", order.binding()), ("ranks", ranks.binding())];
        recorder.dispatch(&self.rank, &buffers, bytes_of(&push), groups_for(splats.div_ceil(256)));
    }

    /// Counts the visible splats before each of `chunk_lists` stretches of 256 ranks.
    pub fn record_counts(&self, recorder: &mut Recorder, scan: &Scan, lists: &RankLists, chunk_lists: usize) {
        let buffers = [("rank_words", lists.words.binding()), ("rank_counts", lists.counts.binding())];
        let push = CountPush { count: chunk_lists as u32 };
        recorder.dispatch(&self.count, &buffers, bytes_of(&push), groups_for(chunk_lists.div_ceil(256)));
        scan.record(recorder, &lists.counts, &lists.firsts, chunk_lists);
    }
}
