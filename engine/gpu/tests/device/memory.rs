//! Buffers: round trips, accounting, and what is said when there is no more memory.

use decouplegs_gpu::{Buffer, GpuError, MemoryKind, QueueRole};

use crate::interfaces::scale;
use crate::{Watched, from_to, scaling};

#[test]
fn what_is_uploaded_is_read_back() {
    let gpu = Watched::open();
    let words: Vec<u32> = (0..100_003_u32)
        .map(|i| i.wrapping_mul(2_654_435_761))
        .collect();
    let buffer = gpu.upload("words", "test", &words).unwrap();
    assert_eq!(gpu.read(&buffer).unwrap(), words);
    gpu.write(&buffer, 5, &[1, 2, 3]).unwrap();
    let read = gpu.read(&buffer).unwrap();
    assert_eq!(
        (&read[..8], &read[8..]),
        (
            &[words[0], words[1], words[2], words[3], words[4], 1, 2, 3][..],
            &words[8..]
        )
    );
    let odd: Vec<[u8; 3]> = vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]];
    assert_eq!(
        gpu.read(&gpu.upload("odd", "test", &odd).unwrap()).unwrap(),
        odd
    );
}

#[test]
fn a_buffer_of_nothing_can_be_bound_copied_and_read() {
    let gpu = Watched::open();
    let nothing: Buffer<i32> = gpu.upload("nothing", "test", &[]).unwrap();
    let target = gpu.upload("target", "test", &[5_i32; 4]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    let bindings = from_to(&nothing, &target);
    recorder.dispatch(
        &scaling(&gpu, 2),
        bindings,
        scale::Push { count: 0, add: 0 },
        [1, 1, 1],
    );
    recorder.copy(&nothing, 0, &target, 4, 0);
    recorder.fill(&nothing, 0, 0, 1);
    gpu.submit(recorder, &[]).unwrap();
    assert_eq!((nothing.len(), gpu.read(&nothing).unwrap()), (0, vec![]));
    assert_eq!(gpu.read(&target).unwrap(), [5; 4]);
}

#[test]
fn fill_and_copy_touch_their_ranges_only() {
    let gpu = Watched::open();
    let from = gpu
        .upload("from", "test", &(0..10_u32).collect::<Vec<_>>())
        .unwrap();
    let to = gpu.upload("to", "test", &[100_u32; 6]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    recorder.fill(&from, 8, 4, 77);
    recorder.copy(&from, 1, &to, 2, 3);
    recorder.copy(&to, 0, &to, 5, 1);
    gpu.submit(recorder, &[]).unwrap();
    assert_eq!(gpu.read(&to).unwrap(), [100, 100, 1, 77, 3, 100]);
}

#[test]
fn mapped_buffers_are_written_and_read_by_the_host() {
    let gpu = Watched::open();
    let upload = gpu
        .buffer::<i32>("upload", "test", 100, MemoryKind::Upload)
        .unwrap();
    let readback = gpu
        .buffer::<i32>("readback", "test", 100, MemoryKind::Readback)
        .unwrap();
    upload.write_host(0, &[3; 100]);
    upload.write_host(50, &[4; 50]);
    let mut recorder = gpu.record(QueueRole::Main);
    let bindings = from_to(&upload, &readback);
    recorder.dispatch(
        &scaling(&gpu, 10),
        bindings,
        scale::Push { count: 100, add: 1 },
        [2, 1, 1],
    );
    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
    let expected: Vec<i32> = (0..100).map(|i| if i < 50 { 31 } else { 41 }).collect();
    assert_eq!(readback.read_host(), expected);
}

#[test]
#[should_panic(expected = "buffer values: elements 3 + 2 wanted, it has 4")]
fn writing_past_the_end_asserts() {
    let gpu = Watched::open();
    let values = gpu.upload("values", "test", &[1_u32; 4]).unwrap();
    let _ = gpu.write(&values, 3, &[1, 2]);
}

#[test]
#[should_panic(expected = "buffer values: lives on the device")]
fn device_memory_is_out_of_the_hosts_reach() {
    let gpu = Watched::open();
    let _ = gpu
        .upload("values", "test", &[1_u32; 4])
        .unwrap()
        .read_host();
}

#[test]
fn memory_is_counted_by_purpose_until_the_last_use_is_over() {
    let gpu = Watched::open();
    assert_eq!(gpu.memory().total_bytes, 0);
    let splats = gpu.upload("means", "splats", &[0_i32; 1000]).unwrap();
    let image = gpu
        .buffer::<i32>("image", "images", 500, MemoryKind::Device)
        .unwrap();
    let report = gpu.memory();
    // Drivers round up to their alignment; nothing else may come on top, staging is gone.
    assert!(
        (4000..=4000 + 4096).contains(&report.bytes_by_purpose["splats"]),
        "{report:?}"
    );
    assert!(
        (2000..=2000 + 4096).contains(&report.bytes_by_purpose["images"]),
        "{report:?}"
    );
    assert_eq!(
        report.total_bytes,
        report.bytes_by_purpose.values().sum::<u64>()
    );
    assert_eq!(report.bytes_by_purpose.len(), 2, "{report:?}");

    let mut recorder = gpu.record(QueueRole::Main);
    let bindings = from_to(&splats, &image);
    recorder.dispatch(
        &scaling(&gpu, 2),
        bindings,
        scale::Push { count: 500, add: 0 },
        [8, 1, 1],
    );
    // The recorder alone holds buffers and kernel now.
    drop((splats, image));
    assert_eq!(gpu.memory().total_bytes, report.total_bytes);
    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
    assert_eq!(gpu.memory().total_bytes, 0);
}

#[test]
fn a_recorder_that_is_never_submitted_gives_back_what_it_held() {
    let gpu = Watched::open();
    let values = gpu.upload("values", "test", &[1_u32; 64]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    recorder.fill(&values, 0, 64, 1);
    drop((values, recorder));
    assert_eq!(gpu.memory().total_bytes, 0);
}

#[test]
fn a_buffer_that_no_kernel_could_see_whole_is_refused_with_both_numbers() {
    let gpu = Watched::open();
    let limit = gpu.limits().storage_buffer_bytes_max;
    let error = gpu
        .buffer::<u8>("everything", "test", limit as usize + 1, MemoryKind::Device)
        .unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains(&limit.to_string())
            && text.contains(&(limit + 1).to_string())
            && text.contains("everything"),
        "{text}"
    );
    // A length whose bytes do not fit 64 bits is as much too large.
    let error = gpu
        .buffer::<[u64; 4]>("absurd", "test", usize::MAX, MemoryKind::Device)
        .unwrap_err();
    assert!(matches!(error, GpuError::BufferTooLarge { .. }), "{error}");
}

#[test]
fn memory_that_the_heap_does_not_have_is_refused_with_the_bytes() {
    let gpu = Watched::open();
    let heap = gpu.limits().device_memory_bytes;
    let each = gpu.limits().storage_buffer_bytes_max.min(heap);
    let mut held = Vec::new();
    // Never touched: a driver that runs on the CPU does not really use these pages.
    let error = loop {
        assert!(
            held.len() as u64 <= heap / each,
            "{} buffers of {each} bytes in a heap of {heap}",
            held.len()
        );
        match gpu.buffer::<u8>("hoard", "greed", each as usize, MemoryKind::Device) {
            Ok(buffer) => held.push(buffer),
            Err(error) => break error,
        }
    };
    let GpuError::OutOfMemory {
        wanted_bytes,
        used_bytes,
        heap_bytes,
        ..
    } = error
    else {
        panic!("{error}")
    };
    assert!(
        wanted_bytes >= each && heap_bytes == heap && used_bytes >= held.len() as u64 * each,
        "{error}"
    );
    let text = error.to_string();
    assert!(
        text.contains("hoard (greed)")
            && text.contains(&heap.to_string())
            && text.contains(&used_bytes.to_string()),
        "{text}"
    );
    drop(held);
    assert_eq!(gpu.memory().total_bytes, 0);
}

#[test]
fn memory_for_others_is_a_buffer_like_any_or_is_refused_with_the_reason() {
    let gpu = Watched::open();
    if !gpu.can_export() {
        let refused = gpu
            .buffer::<u32>("images", "test", 4, MemoryKind::Exported)
            .map(|_| ())
            .unwrap_err()
            .to_string();
        assert!(refused.contains("VK_KHR_external_memory_fd"), "{refused}");
        assert!(gpu.export_timeline(QueueRole::Main).is_err());
        println!(
            "{} exports nothing: what it would give was not tested",
            gpu.info()
        );
        return;
    }
    let words: Vec<u32> = (0..70_001).collect();
    let before = gpu.memory().total_bytes;
    let buffer: Buffer<u32> = gpu
        .buffer("images", "test", words.len(), MemoryKind::Exported)
        .unwrap();
    gpu.write(&buffer, 0, &words).unwrap();
    let (first, second) = (buffer.export().unwrap(), buffer.export().unwrap());
    assert!(
        first.allocation_bytes >= buffer.byte_len()
            && second.allocation_bytes == first.allocation_bytes
    );
    assert_eq!(gpu.memory().total_bytes - before, first.allocation_bytes);
    assert_eq!(gpu.read(&buffer).unwrap(), words);
    gpu.export_timeline(QueueRole::Main).unwrap();
    let ticket = gpu.submit(gpu.record(QueueRole::Main), &[]).unwrap();
    assert!(ticket.value() > 0);
    drop(buffer);
    assert_eq!(gpu.memory().total_bytes, before);
}
