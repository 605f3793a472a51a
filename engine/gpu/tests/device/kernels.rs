//! Kernels: constants, buffers, kernels on trial, and what is refused.

use std::fs;

use decouplegs_gpu::{
    DeviceOptions, Gpu, GpuError, Kernel, KernelCache, KernelTrial, MemoryKind, QueueRole,
    Recorder, Shader,
};
use decouplegs_spirv::reflect;

use crate::interfaces::{arguments, scale, spin, table};
use crate::{Watched, constants, from_to, scaling, spirv};

#[test]
fn constants_are_members() {
    let gpu = Watched::open();
    let source: Vec<i32> = (0..1000).collect();
    let constants = scale::Constants {
        group_size: 32,
        factor: 3,
        negate: true,
        unused_scale: 1.0,
    };
    let kernel: Kernel<scale::Module> = gpu.kernel(&constants).unwrap();
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
    let bindings = from_to(&from, &to);
    recorder.dispatch(
        &kernel,
        bindings,
        scale::Push {
            count: 1000,
            add: 7,
        },
        [32, 1, 1],
    );
    gpu.submit(recorder, &[]).unwrap();
    let expected: Vec<i32> = source.iter().map(|value| -(value * 3 + 7)).collect();
    assert_eq!(gpu.read(&to).unwrap(), expected);
}

#[test]
fn indirect_dispatch_reads_its_arguments_behind_their_writer() {
    let gpu = Watched::open();
    let source: Vec<i32> = (0..1000).collect();
    let arguments: Kernel<arguments::Module> = gpu.kernel(&arguments::Constants {}).unwrap();
    let kernel = scaling(&gpu, 2);
    let from = gpu.upload("source", "test", &source).unwrap();
    let to = gpu
        .upload("target", "test", &vec![-1; source.len()])
        .unwrap();
    let words = gpu.upload("arguments", "test", &[0_u32; 8]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    let bindings = arguments::Bindings {
        arguments: words.bound(),
    };
    let push = arguments::Push {
        count: 700,
        group_size: 64,
        first_word: 4,
    };
    recorder.dispatch(&arguments, bindings, push, [1, 1, 1]);
    let bindings = from_to(&from, &to);
    recorder.dispatch_indirect(
        &kernel,
        bindings,
        scale::Push {
            count: 1000,
            add: 0,
        },
        &words,
        16,
    );
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
fn a_workgroup_that_is_too_large_is_refused() {
    let gpu = Watched::open();
    let max = gpu.limits().workgroup_threads_max;
    let built: Result<Kernel<scale::Module>, GpuError> = gpu.kernel(&scale::Constants {
        group_size: max + 1,
        ..constants(2)
    });
    let error = built.unwrap_err().to_string();
    assert!(error.contains(&format!("1 to {max}")), "{error}");
}

#[test]
fn interfaces_are_those_of_the_modules() {
    fn same<S: Shader>() {
        assert_eq!(reflect(S::spirv()).unwrap(), S::INTERFACE, "{}", S::NAME);
    }
    same::<scale::Module>();
    same::<spin::Module>();
    same::<table::Module>();
    same::<arguments::Module>();
}

/// A kernel on trial takes the place of the program's where it takes the same buffers, and is
/// refused where it does not.
#[test]
fn a_kernel_on_trial_takes_what_the_program_gives() {
    let folder = std::env::temp_dir().join(format!("decouplegs-trial-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let tried = |name: &str, words: &[u32], constants_text: &str| {
        fs::write(folder.join(name), bytemuck::cast_slice::<u32, u8>(words)).unwrap();
        fs::write(folder.join("constants.txt"), constants_text).unwrap();
        let options = DeviceOptions {
            trial: KernelTrial::from_folder(&folder).unwrap(),
            ..DeviceOptions::default()
        };
        let gpu = Gpu::open(&options).unwrap();
        let kernel: Kernel<scale::Module> = gpu.kernel(&constants(2))?;
        let values = gpu.upload("values", "test", &[1_i32; 64]).unwrap();
        let to = gpu.upload("target", "test", &[0_i32; 64]).unwrap();
        let mut recorder = gpu.record(QueueRole::Main);
        let push = scale::Push { count: 64, add: 5 };
        recorder.dispatch(&kernel, from_to(&values, &to), push, [1, 1, 1]);
        gpu.submit(recorder, &[]).unwrap();
        Ok::<i32, GpuError>(gpu.read(&to).unwrap()[63])
    };
    assert_eq!(tried("scale.spv", spirv("scale"), "").unwrap(), 7);
    assert_eq!(
        tried("scale.spv", spirv("scale"), "scale.FACTOR=4").unwrap(),
        9
    );
    let refused = |words: &[u32]| tried("scale.spv", words, "").unwrap_err().to_string();
    let error = refused(spirv("spin"));
    assert!(error.starts_with("scale.spv: expected buffers"), "{error}");
    assert!(error.contains("0 source_values: i32"), "{error}");
    assert!(error.contains("0 values: u32"), "{error}");
    let error = refused(&spirv("scale")[..20]);
    assert!(
        error.contains("scale.spv: the SPIR-V module is cut off"),
        "{error}"
    );
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn uniform_buffers_are_read_behind_their_writer() {
    let gpu = Watched::open();
    let kernel: Kernel<table::Module> = gpu.kernel(&table::Constants {}).unwrap();
    let table: Vec<i32> = (1..=20).collect();
    let table = gpu.upload("table", "test", &table).unwrap();
    let values = gpu.upload("values", "test", &[0_i32; 64]).unwrap();
    let bindings = || table::Bindings {
        table: table.bound(),
        values: values.bound(),
    };
    let fill_and_read = |mut recorder: Recorder| {
        recorder.fill(&table, 0, 4, 7);
        recorder.dispatch(&kernel, bindings(), table::Push {}, [1, 1, 1]);
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
    let kernel: Kernel<table::Module> = gpu.kernel(&table::Constants {}).unwrap();
    let table = gpu.upload("table", "test", &[1; 4]).unwrap();
    let values = gpu.upload("values", "test", &[0_i32; 64]).unwrap();
    let bindings = || table::Bindings {
        table: table.bound(),
        values: values.bound(),
    };
    gpu.record(QueueRole::Main)
        .dispatch(&kernel, bindings(), table::Push {}, [1, 1, 1]);
}

#[test]
#[should_panic(expected = "workgroups, the device runs at most")]
fn too_many_workgroups_assert() {
    let gpu = Watched::open();
    let values = gpu.upload("values", "test", &[1_i32; 64]).unwrap();
    let push = scale::Push { count: 64, add: 0 };
    let mut recorder = gpu.record(QueueRole::Main);
    let bindings = from_to(&values, &values);
    recorder.dispatch(&scaling(&gpu, 2), bindings, push, [1, u32::MAX, 1]);
}

#[test]
fn equal_kernels_are_built_once() {
    let gpu = Watched::open();
    let built = |factor| {
        scaling(&gpu, factor);
        gpu.kernel_counts().built
    };
    assert_eq!([2, 2, 3, 2].map(built), [1, 1, 2, 2]);
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
        let kernel = scaling(&gpu, 2);
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
