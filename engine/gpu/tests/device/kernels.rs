//! Kernels: constants and bindings by name, layouts, and what is refused.

use std::fs;

use decouplegs_gpu::{
    Constant, DeviceOptions, Gpu, GpuError, KernelCache, MemoryKind, QueueRole, Recorder,
};

use crate::{Watched, bytes, scale, scale_push, spirv};

#[test]
fn constants_are_given_by_name() {
    let gpu = Watched::open();
    let source: Vec<i32> = (0..1000).collect();
    let constants = [
        ("NEGATE", Constant::Bool(true)),
        ("GROUP_SIZE", Constant::U32(32)),
        ("FACTOR", Constant::U32(3)),
    ];
    let kernel = gpu.kernel("scale", &spirv("scale"), &constants).unwrap();
    assert_eq!(kernel.workgroup_size(), [32, 1, 1]);
    println!(
        "subgroups pinned to {}: {}",
        gpu.limits().subgroup_size,
        kernel.subgroups_pinned()
    );
    let from = gpu.upload("source", "test", &source).unwrap();
    let to = gpu
        .buffer::<i32>("target", "test", source.len(), MemoryKind::Device)
        .unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    let buffers = [
        ("target_values", to.binding()),
        ("source_values", from.binding()),
    ];
    recorder.dispatch(&kernel, &buffers, &scale_push(1000, 7), [32, 1, 1]);
    gpu.submit(recorder, &[]).unwrap();
    let expected: Vec<i32> = source.iter().map(|value| -(value * 3 + 7)).collect();
    assert_eq!(gpu.read(&to).unwrap(), expected);
}

#[test]
fn indirect_dispatch_reads_its_arguments_behind_their_writer() {
    let gpu = Watched::open();
    let source: Vec<i32> = (0..1000).collect();
    let arguments = gpu.kernel("arguments", &spirv("arguments"), &[]).unwrap();
    let kernel = scale(&gpu, 2);
    let from = gpu.upload("source", "test", &source).unwrap();
    let to = gpu
        .upload("target", "test", &vec![-1; source.len()])
        .unwrap();
    let words = gpu.upload("arguments", "test", &[0_u32; 8]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    recorder.dispatch(
        &arguments,
        &[("arguments", words.binding())],
        &bytes(&[700, 64, 4]),
        [1, 1, 1],
    );
    let buffers = [
        ("source_values", from.binding()),
        ("target_values", to.binding()),
    ];
    recorder.dispatch_indirect(&kernel, &buffers, &scale_push(1000, 0), words.binding(), 16);
    gpu.submit(recorder, &[]).unwrap();
    // 700 invocations in groups of 64 are 11 groups: 704 values.
    let expected: Vec<i32> = source
        .iter()
        .map(|&value| if value < 704 { value * 2 } else { -1 })
        .collect();
    assert_eq!(gpu.read(&to).unwrap(), expected);
    assert_eq!(gpu.read(&words).unwrap(), [0, 0, 0, 0, 11, 1, 1, 0]);
}

#[test]
fn what_is_no_storage_buffer_and_what_is_no_spirv_is_refused() {
    let gpu = Watched::open();
    let refusal = |words: &[u32]| match gpu.kernel("refused", words, &[]) {
        Err(error @ GpuError::Kernel { .. }) => error.to_string(),
        other => panic!("expected a refusal, got {other:?}"),
    };
    assert!(
        refusal(&spirv("texture")).contains("picture is neither a storage nor a uniform buffer")
    );
    assert!(refusal(&[1, 2, 3]).contains("not a SPIR-V module"));
    let large = Constant::U32(gpu.limits().workgroup_threads_max + 1);
    let error = gpu
        .kernel("scale", &spirv("scale"), &[("GROUP_SIZE", large)])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains(&format!("1 to {}", gpu.limits().workgroup_threads_max)),
        "{error}"
    );
}

#[test]
fn uniform_buffers_are_read_behind_their_writer() {
    let gpu = Watched::open();
    let kernel = gpu.kernel("table", &spirv("table"), &[]).unwrap();
    let table: Vec<i32> = (1..=20).collect();
    let table = gpu.upload("table", "test", &table).unwrap();
    let values = gpu.upload("values", "test", &[0_i32; 64]).unwrap();
    let bound = [("table", table.binding()), ("values", values.binding())];
    let fill_and_read = |mut recorder: Recorder| {
        recorder.fill(table.binding(), 0, 4, 7);
        recorder.dispatch(&kernel, &bound, &[], [1, 1, 1]);
        gpu.submit(recorder, &[]).unwrap().wait().unwrap();
        gpu.take_validation_messages()
    };
    assert_eq!(fill_and_read(gpu.record(QueueRole::Main)), [""; 0]);
    assert_eq!(gpu.read(&values).unwrap()[14..19], [30, 32, 14, 4, 6]);
    let missing = fill_and_read(gpu.record(QueueRole::Main).without_barriers());
    assert!(
        missing
            .iter()
            .any(|message| message.contains("SYNC-HAZARD-READ-AFTER-WRITE")),
        "{missing:#?}"
    );
}

#[test]
#[should_panic(expected = "buffer table of 16 bytes, the shader reads 64 of 'table'")]
fn a_uniform_buffer_that_is_too_short_asserts() {
    let gpu = Watched::open();
    let kernel = gpu.kernel("table", &spirv("table"), &[]).unwrap();
    let table = gpu.upload("table", "test", &[1; 4]).unwrap();
    let values = gpu.upload("values", "test", &[0_i32; 64]).unwrap();
    let bound = [("table", table.binding()), ("values", values.binding())];
    gpu.record(QueueRole::Main)
        .dispatch(&kernel, &bound, &[], [1, 1, 1]);
}

/// Dispatches `scale` with names and sizes that may be wrong.
fn dispatch(names: &[&str], push_bytes: usize, groups: [u32; 3]) {
    let gpu = Watched::open();
    let buffer = gpu.upload("values", "test", &[1_i32; 64]).unwrap();
    let buffers: Vec<_> = names.iter().map(|name| (*name, buffer.binding())).collect();
    gpu.record(QueueRole::Main)
        .dispatch(&scale(&gpu, 2), &buffers, &vec![0; push_bytes], groups);
}

#[test]
#[should_panic(
    expected = "no binding 'sauce_values', it has [\"source_values\", \"target_values\"]"
)]
fn a_wrong_binding_name_asserts() {
    dispatch(&["sauce_values", "target_values"], 8, [1, 1, 1]);
}

#[test]
#[should_panic(expected = "binding 'target_values' is not given exactly once")]
fn a_missing_binding_asserts() {
    dispatch(&["source_values"], 8, [1, 1, 1]);
}

#[test]
#[should_panic(expected = "binding 'source_values' is not given exactly once")]
fn a_binding_given_twice_asserts() {
    dispatch(
        &["source_values", "target_values", "source_values"],
        8,
        [1, 1, 1],
    );
}

#[test]
#[should_panic(expected = "12 bytes of push constants given, the shader declares 8")]
fn push_constants_of_another_size_assert() {
    dispatch(&["source_values", "target_values"], 12, [1, 1, 1]);
}

#[test]
#[should_panic(expected = "workgroups, the device runs at most")]
fn too_many_workgroups_assert() {
    dispatch(&["source_values", "target_values"], 8, [1, u32::MAX, 1]);
}

#[test]
#[should_panic(
    expected = "no specialization constant 'FAKTOR', it has [\"GROUP_SIZE\", \"FACTOR\""
)]
fn an_unknown_constant_asserts() {
    let gpu = Watched::open();
    let _ = gpu.kernel("scale", &spirv("scale"), &[("FAKTOR", Constant::U32(1))]);
}

#[test]
#[should_panic(
    expected = "specialization constant 'FACTOR' is U32 in the shader, given is F32(1.0)"
)]
fn a_constant_of_another_type_asserts() {
    let gpu = Watched::open();
    let of_factor = |factor| gpu.kernel("scale", &spirv("scale"), &[("FACTOR", factor)]);
    // A kernel whose constant has the same bits is not the one asked for.
    of_factor(Constant::U32(1.0_f32.to_bits())).unwrap();
    let _ = of_factor(Constant::F32(1.0));
}

#[test]
fn equal_kernels_are_built_once() {
    let gpu = Watched::open();
    let built = |factor| {
        scale(&gpu, factor);
        gpu.kernel_counts().built
    };
    assert_eq!([2, 2, 3, 2].map(built), [1, 1, 2, 2]);
    let layout = spirv("layout");
    gpu.kernel("layout", &layout, &[]).unwrap();
    gpu.kernel("layout of others", &layout, &[]).unwrap();
    assert_eq!(gpu.kernel_counts().built, 4, "errors tell kernels by name");
}

/// Kernels are kept in a file that the next start reads; a damaged one is ignored and replaced.
#[test]
fn a_second_start_finds_kernels_that_were_kept() {
    let folder = std::env::temp_dir().join(format!("decouplegs-kept-{}", std::process::id()));
    let start = || {
        let options = DeviceOptions {
            kernels: KernelCache::Folder(folder.clone()),
            ..DeviceOptions::default()
        };
        let gpu = Gpu::open(&options).unwrap();
        let kernel = scale(&gpu, 2);
        let counts = gpu.kernel_counts();
        drop(kernel);
        assert_eq!(gpu.take_validation_messages(), Vec::<String>::new());
        (gpu.has_kept_kernels(), counts)
    };
    let files = || {
        fs::read_dir(&folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect::<Vec<_>>()
    };
    let (read, counts) = start();
    assert!(!read && (counts.built, counts.found) == (1, 0));
    let [file] = &files()[..] else {
        panic!("one file, found {:?}", files())
    };
    let kept = fs::read(file).unwrap();
    let (read, counts) = start();
    assert!(read);
    println!("{counts:?}; drivers that keep nothing find nothing");
    for damaged in [
        &kept[..kept.len() - 1],
        b"",
        &[&kept[..30], &[!kept[30]], &kept[31..]].concat(),
    ] {
        fs::write(file, damaged).unwrap();
        assert!(!start().0, "what is damaged is ignored");
        assert!(start().0, "and written anew");
    }
    assert_eq!(files().len(), 1, "no temporary file is left");
    fs::remove_dir_all(&folder).unwrap();
}
