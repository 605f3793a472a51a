//! Interfaces of the kernels in `tests/kernels`. A test compares them with the modules.

/// `target = source * FACTOR + add`.
pub mod scale {
    decouplegs_gpu::shader! {
        "scale", crate::spirv("scale");
        entry_point: "main";
        workgroup: [(1, Some(0)), (1, None), (1, None)];
        capabilities: [1];
        bindings {
            0 source_values: i32, Read, None;
            1 target_values: i32, Write, None;
        }
        push 8 {
            0 count: u32;
            4 add: i32;
        }
        constants {
            0 GROUP_SIZE group_size: u32;
            1 FACTOR factor: u32;
            2 NEGATE negate: bool;
            3 UNUSED_SCALE unused_scale: f32;
        }
    }
}

/// Work that takes a while.
pub mod spin {
    decouplegs_gpu::shader! {
        "spin", crate::spirv("spin");
        entry_point: "main";
        workgroup: [(64, None), (1, None), (1, None)];
        capabilities: [1];
        bindings {
            0 values: u32, ReadWrite, None;
        }
        push 8 {
            0 count: u32;
            4 rounds: u32;
        }
        constants {
        }
    }
}

/// A uniform buffer.
pub mod table {
    decouplegs_gpu::shader! {
        "table", crate::spirv("table");
        entry_point: "main";
        workgroup: [(64, None), (1, None), (1, None)];
        capabilities: [1];
        bindings {
            0 table: i32, Read, Some(64);
            1 values: i32, Write, None;
        }
        push 0 {
        }
        constants {
        }
    }
}

/// Arguments of an indirect dispatch.
pub mod arguments {
    decouplegs_gpu::shader! {
        "arguments", crate::spirv("arguments");
        entry_point: "main";
        workgroup: [(1, None), (1, None), (1, None)];
        capabilities: [1];
        bindings {
            0 arguments: u32, ReadWrite, None;
        }
        push 12 {
            0 count: u32;
            4 group_size: u32;
            8 first_word: u32;
        }
        constants {
        }
    }
}
