//! Where every camera's lists of records lie, and which of them the radix sort has to order.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Constant, Gpu, GpuError, Kernel, Recorder, Residence};

use super::{Control, PURPOSE, kernel, push_constants};
use crate::layout::{CAMERAS_MAX, SortSegment, ViewLists, ViewOrder};

/// The lists of a frame.
pub struct OrderPlan {
    /// How each camera's background comes into order, as the host decided.
    pub view_orders: Buffer<ViewOrder>,
    /// Neighbours that stood the wrong way round in each camera's background list; zero before the frame.
    pub inversions: Buffer<u32>,
    /// Where each camera's records lie.
    pub lists: Buffer<ViewLists>,
    /// What the radix sort orders: background and agents of each camera.
    pub segments: Buffer<SortSegment>,
}

impl OrderPlan {
    /// Buffers for as many cameras as a frame can have.
    ///
    /// # Errors
    /// When the device is out of memory.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            view_orders: gpu.buffer("view_orders", PURPOSE, CAMERAS_MAX, Residence::Device)?,
            inversions: gpu.buffer("inversions", PURPOSE, CAMERAS_MAX, Residence::Device)?,
            lists: gpu.buffer("view_lists", PURPOSE, CAMERAS_MAX, Residence::Device)?,
            segments: gpu.buffer("record_segments", PURPOSE, 2 * CAMERAS_MAX, Residence::Device)?,
        })
    }
}

push_constants! {
    struct Push {
        camera_count: u32,
        static_chunks: u32,
        moving_chunks: u32,
        records_max: u32,
    }
}

/// `plan_order.comp`.
pub struct PlanOrder {
    kernel: Kernel,
}

impl PlanOrder {
    /// The stage; `sort_block` is how many keys a workgroup of the sort takes.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu, sort_block: u32) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel::<Push>(gpu, &decouplegs_shaders::PLAN_ORDER, &[("SORT_BLOCK", Constant::U32(sort_block))])? })
    }

    /// Plans the lists that begin at `static_firsts` and `moving_firsts`, of so many chunks a camera, in room for
    /// `records_max` records.
    #[expect(clippy::too_many_arguments, reason = "one argument a buffer that the stage reads or writes")]
    pub fn record(
        &self,
        recorder: &mut Recorder,
        camera_count: usize,
        static_firsts: &Buffer<u32>,
        static_chunks: usize,
        moving_firsts: &Buffer<u32>,
        moving_chunks: usize,
        records_max: usize,
        plan: &OrderPlan,
        control: &Control,
    ) {
        let push = Push {
            camera_count: camera_count as u32,
            static_chunks: static_chunks as u32,
            moving_chunks: moving_chunks as u32,
            records_max: records_max as u32,
        };
        let buffers = [
            ("view_orders", plan.view_orders.binding()),
            ("static_firsts", static_firsts.binding()),
            ("moving_firsts", moving_firsts.binding()),
            ("inversions", plan.inversions.binding()),
            ("lists", plan.lists.binding()),
            ("segments", plan.segments.binding()),
            ("needs", control.needs.binding()),
            ("arguments", control.arguments.binding()),
        ];
        recorder.dispatch(&self.kernel, &buffers, bytes_of(&push), [1, 1, 1]);
    }
}
