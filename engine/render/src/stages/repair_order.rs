//! Puts almost sorted lists right, proves it, and hands back those that it failed on.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{Arguments, Control, OrderPlan, SortScratch, kernel, push_constants};
use crate::capacity::groups_for;

/// Places that one workgroup repairs or checks.
const BLOCK: usize = 1024;
/// Entries that stand the wrong way round are found up to this many places apart.
pub const REPAIR_REACH_MAX: u32 = 256;

push_constants! {
    struct RepairPush {
        camera_count: u32,
        chunk_count: u32,
        records_max: u32,
        reach: u32,
    }
}

push_constants! {
    struct CheckPush {
        camera_count: u32,
        chunk_count: u32,
        records_max: u32,
    }
}

push_constants! {
    struct RestorePush {
        camera_count: u32,
    }
}

/// `repair_order.comp`, `check_order.comp` and `restore_order.comp`.
pub struct RepairOrder {
    repair: Kernel,
    check: Kernel,
    restore: Kernel,
}

/// The background's lists as the projection left them.
#[derive(Clone, Copy)]
pub struct StaticLists<'a> {
    /// How many cameras there are.
    pub camera_count: usize,
    /// Chunks of the background.
    pub chunk_count: usize,
    /// Records before each `[camera][chunk]`, and their total.
    pub firsts: &'a Buffer<u32>,
    /// Room for records.
    pub records_max: usize,
}

impl RepairOrder {
    /// The stages.
    ///
    /// # Errors
    /// When the driver refuses a kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            repair: kernel::<RepairPush>(gpu, &decouplegs_shaders::REPAIR_ORDER, &[])?,
            check: kernel::<CheckPush>(gpu, &decouplegs_shaders::CHECK_ORDER, &[])?,
            restore: kernel::<RestorePush>(gpu, &decouplegs_shaders::RESTORE_ORDER, &[])?,
        })
    }

    /// Finds the order of the lists in the first buffers of `sort` in which entries that stand the wrong way round are at most
    /// `reach` places apart; [`RepairOrder::record_check`] takes it over.
    ///
    /// # Panics
    /// When `reach` is more than [`REPAIR_REACH_MAX`] or no multiple of 8.
    pub fn record_repair(
        &self,
        recorder: &mut Recorder,
        lists: StaticLists<'_>,
        plan: &OrderPlan,
        sort: &SortScratch,
        reach: u32,
    ) {
        let whole = reach <= REPAIR_REACH_MAX && reach.is_multiple_of(8);
        assert!(whole, "a repair over {reach} places; multiples of 8 up to {REPAIR_REACH_MAX} can be looked at");
        let push = RepairPush {
            camera_count: lists.camera_count as u32,
            chunk_count: lists.chunk_count as u32,
            records_max: lists.records_max as u32,
            reach,
        };
        let buffers = [
            ("view_orders", plan.view_orders.binding()),
            ("firsts", lists.firsts.binding()),
            ("keys", sort.keys[0].binding()),
            ("values", sort.values[0].binding()),
            ("repaired", sort.values[1].binding()),
        ];
        // As many blocks as there can be: each list may end in one that is not full.
        let blocks = lists.records_max.div_ceil(BLOCK) + lists.camera_count;
        recorder.dispatch(&self.repair, &buffers, bytes_of(&push), groups_for(blocks));
    }

    /// Takes over what [`RepairOrder::record_repair`] found, and counts the inversions that are left.
    pub fn record_check(&self, recorder: &mut Recorder, lists: StaticLists<'_>, plan: &OrderPlan, sort: &SortScratch) {
        let push = CheckPush {
            camera_count: lists.camera_count as u32,
            chunk_count: lists.chunk_count as u32,
            records_max: lists.records_max as u32,
        };
        let buffers = [
            ("view_orders", plan.view_orders.binding()),
            ("firsts", lists.firsts.binding()),
            ("keys", sort.keys[0].binding()),
            ("values", sort.values[0].binding()),
            ("repaired", sort.values[1].binding()),
            ("unranked_keys", sort.keys[1].binding()),
            ("inversions", plan.inversions.binding()),
        ];
        recorder.dispatch(&self.check, &buffers, bytes_of(&push), groups_for(lists.records_max.div_ceil(BLOCK)));
    }

    /// Puts the lists that are still out of order back into the order of their splats.
    pub fn record_restore(
        &self,
        recorder: &mut Recorder,
        camera_count: usize,
        plan: &OrderPlan,
        sort: &SortScratch,
        control: &Control,
    ) {
        let buffers = [
            ("view_orders", plan.view_orders.binding()),
            ("inversions", plan.inversions.binding()),
            ("lists", plan.lists.binding()),
            ("unranked_keys", sort.keys[1].binding()),
            ("keys", sort.keys[0].binding()),
            ("values", sort.values[0].binding()),
        ];
        let offset = Arguments::Restore.byte_offset();
        let push = RestorePush { camera_count: camera_count as u32 };
        recorder.dispatch_indirect(&self.restore, &buffers, bytes_of(&push), control.arguments.binding(), offset);
    }
}
