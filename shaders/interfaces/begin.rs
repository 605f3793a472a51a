// Written by `make shaders` from the SPIR-V. Changes here are lost.

decouplegs_gpu::shader! {
    "begin", decouplegs_shaders::BEGIN.spirv;
    entry_point: "main";
    workgroup: [(256, None), (1, None), (1, None)];
    capabilities: [1];
    bindings {
        0 staged_cameras: u32, Read, None;
        1 staged_lenses: u32, Read, None;
        2 staged_key_sets: u32, Read, None;
        3 cameras: u32, Write, None;
        4 lenses: u32, Write, None;
        5 key_sets: u32, Write, None;
        6 required: u32, Write, None;
        7 arguments: u32, Write, None;
        8 slab_counts: [u32; 4], Write, None;
        9 contributions: u32, Write, None;
        10 agent_offsets: u32, Write, None;
        11 transmittances: u32, Write, None;
        12 unfinished: u32, Write, None;
        13 medians_unfinished: u32, Write, None;
    }
    push 44 {
        0 camera_words: u32;
        4 lens_words: u32;
        8 key_set_words: u32;
        12 required_words: u32;
        16 argument_words: u32;
        20 slab_words: u32;
        24 contribution_words: u32;
        28 agent_offset_words: u32;
        32 transmittance_words: u32;
        36 unfinished_words: u32;
        40 medians_unfinished_words: u32;
    }
    constants {
    }
}
