//! Faults on purpose: what fails, what goes on, and what is given back.

use decouplegs_gpu::{DeviceOptions, DeviceSet, Drill, Gpu, MemoryKind, QueueRole};

use super::{Watched, validation};

fn drilled(drill: &str) -> Watched {
    let drill: Drill = drill.parse().unwrap();
    let options = DeviceOptions {
        validation: validation(),
        drill: Some(drill),
        ..DeviceOptions::default()
    };
    Watched(Gpu::open(&options).unwrap())
}

#[test]
fn a_device_that_a_drill_loses_finishes_what_it_has_and_takes_nothing_more() {
    let gpu = drilled("lost:2");
    let first = gpu.upload("values", "test", &[1_u32, 2, 3]).unwrap();
    // The second submission.
    let ticket = gpu.submit(gpu.record(QueueRole::Main), &[]).unwrap();
    for _ in 0..3 {
        let error = gpu.submit(gpu.record(QueueRole::Main), &[]).unwrap_err();
        assert!(error.is_lost() && !error.is_full(), "{error}");
        assert!(gpu.read(&first).unwrap_err().is_lost());
    }
    ticket.wait().unwrap();
    drop((first, ticket));
    assert_eq!(gpu.memory().total_bytes, 0);
}

#[test]
fn a_device_that_a_drill_fills_has_no_memory_and_works_on() {
    let gpu = drilled("full:1");
    let held = gpu.upload("values", "test", &[1_u32, 2, 3]).unwrap();
    let buffer = gpu.buffer::<u32>("more", "test", 4, MemoryKind::Device);
    let error = buffer.unwrap_err();
    assert!(error.is_full() && !error.is_lost(), "{error}");
    assert_eq!(gpu.read(&held).unwrap(), [1, 2, 3]);
}

#[test]
fn a_device_that_is_named_twice_is_opened_twice() {
    let set: DeviceSet = "0,0".parse().unwrap();
    let options = |position| DeviceOptions {
        validation: validation(),
        drill: (position == 1).then(|| "lost:0".parse().unwrap()),
        ..DeviceOptions::default()
    };
    let gpus = Gpu::open_all(&set, options).unwrap();
    let [first, second] = gpus.as_slice() else {
        panic!("{gpus:?}")
    };
    assert!(!first.is(second) && first.info() == second.info());
    assert!(first.submit(first.record(QueueRole::Main), &[]).is_ok());
    assert!(second.submit(second.record(QueueRole::Main), &[]).is_err());
    let all = Gpu::open_all(&DeviceSet::All, |_| options(0)).unwrap();
    assert!(!all.is_empty() && all.len() <= Gpu::list().unwrap().len());
    for gpu in gpus.iter().chain(&all) {
        assert_eq!(gpu.take_validation_messages(), Vec::<String>::new());
    }
}
