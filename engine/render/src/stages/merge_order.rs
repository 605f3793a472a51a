//! Joins each camera's sorted lists of background and agents.

use bytemuck::bytes_of;
use decouplegs_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder};

use super::{Arguments, Control, OrderPlan, kernel, push_constants};

push_constants! {
    struct Push {
        camera_count: u32,
    }
}

/// `merge_order.comp`.
pub struct MergeOrder {
    kernel: Kernel,
}

impl MergeOrder {
    /// The stage.
    ///
    /// # Errors
    /// When the driver refuses the kernel.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self { kernel: kernel::<Push>(gpu, &decouplegs_shaders::MERGE_ORDER, &[])? })
    }

    /// Writes to `order` the records `values` of the lists of `plan`, whose `keys` are sorted, by key and camera.
    #[expect(clippy::too_many_arguments, reason = "one argument a buffer that the stage reads or writes")]
    pub fn record(
        &self,
        recorder: &mut Recorder,
        camera_count: usize,
        plan: &OrderPlan,
        keys: &Buffer<u32>,
        values: &Buffer<u32>,
        order: &Buffer<u32>,
        control: &Control,
    ) {
        let buffers =
            [("lists", plan.lists.binding()), ("keys", keys.binding()), ("values", values.binding()), ("order", order.binding())];
        let push = Push { camera_count: camera_count as u32 };
        let offset = Arguments::Merge.byte_offset();
        recorder.dispatch_indirect(&self.kernel, &buffers, bytes_of(&push), control.arguments.binding(), offset);
    }
}
