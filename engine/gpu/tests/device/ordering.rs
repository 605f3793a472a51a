//! Order: barriers inside a command buffer, tickets between queues, times.

use std::time::Instant;

use decouplegs_gpu::{
    Buffer, DeviceOptions, Gpu, Kernel, MemoryKind, QueueRole, QueueUse, Recorder, Ticket,
};

use crate::interfaces::{scale, spin};
use crate::{Watched, from_to, scaling};

const COUNT: u32 = 4096;

/// Copies from `a` to `b` and back again to `a`: read after write, write after read.
fn there_and_back(
    recorder: &mut Recorder,
    kernel: &Kernel<scale::Module>,
    a: &Buffer<i32>,
    b: &Buffer<i32>,
) {
    for (from, to) in [(a, b), (b, a)] {
        let bindings = from_to(from, to);
        recorder.dispatch(
            kernel,
            bindings,
            scale::Push {
                count: COUNT,
                add: 1,
            },
            [COUNT / 64, 1, 1],
        );
    }
}

fn two_buffers(gpu: &Gpu) -> (Buffer<i32>, Buffer<i32>) {
    let values: Vec<i32> = (0..COUNT as i32).collect();
    (
        gpu.upload("a", "test", &values).unwrap(),
        gpu.buffer("b", "test", values.len(), MemoryKind::Device)
            .unwrap(),
    )
}

#[test]
fn derived_barriers_leave_synchronization_validation_nothing_to_say() {
    let gpu = Watched::open();
    let (a, b) = two_buffers(&gpu);
    let kernel = scaling(&gpu, 2);
    let mut recorder = gpu.record(QueueRole::Main);
    for _ in 0..3 {
        there_and_back(&mut recorder, &kernel, &a, &b);
    }
    recorder.fill(&b, 0, 4, 9);
    recorder.copy(&b, 0, &a, 1, 1);
    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
    let mut expected: Vec<i32> = (0..COUNT as i32)
        .map(|value| (0..6).fold(value, |value, _| value * 2 + 1))
        .collect();
    expected[1] = 9;
    assert_eq!(gpu.read(&a).unwrap(), expected);
    assert_eq!(gpu.take_validation_messages(), [""; 0]);
}

#[test]
fn a_missing_barrier_is_seen_by_synchronization_validation() {
    let gpu = Watched::open();
    let (a, b) = two_buffers(&gpu);
    let mut recorder = gpu.record(QueueRole::Main).without_barriers();
    there_and_back(&mut recorder, &scaling(&gpu, 2), &a, &b);
    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
    let messages = gpu.take_validation_messages();
    assert!(
        messages
            .iter()
            .any(|message| message.contains("SYNC-HAZARD-READ-AFTER-WRITE")),
        "{messages:#?}"
    );
    assert!(
        messages
            .iter()
            .any(|message| message.contains("SYNC-HAZARD-WRITE-AFTER-READ")),
        "{messages:#?}"
    );
}

#[test]
fn tickets_order_the_queues() {
    for queues in [QueueUse::All, QueueUse::One] {
        let gpu = Watched::open_with(queues);
        println!("update queue of its own: {}", gpu.has_update_queue());
        let (a, b) = two_buffers(&gpu);
        let kernel = scaling(&gpu, 1);
        let mut last: Option<Ticket> = None;
        for i in 0..20 {
            let mut recorder = gpu.record(if i % 2 == 0 {
                QueueRole::Main
            } else {
                QueueRole::Update
            });
            there_and_back(&mut recorder, &kernel, &a, &b);
            let after: Vec<&Ticket> = last.iter().collect();
            last = Some(gpu.submit(recorder, &after).unwrap());
        }
        let last = last.unwrap();
        last.wait().unwrap();
        assert!(last.is_done().unwrap());
        let expected: Vec<i32> = (0..COUNT as i32).map(|value| value + 40).collect();
        assert_eq!(gpu.read(&a).unwrap(), expected);
    }
}

#[test]
fn submitted_work_keeps_what_it_uses() {
    let gpu = Watched::open();
    let spin: Kernel<spin::Module> = gpu.kernel(&spin::Constants {}).unwrap();
    let readback = gpu
        .buffer::<u32>("readback", "test", 64, MemoryKind::Readback)
        .unwrap();
    let values = gpu.upload("values", "test", &[1_u32; 64]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    recorder.dispatch(
        &spin,
        spin::Bindings {
            values: values.bound(),
        },
        spin::Push {
            count: 64,
            rounds: 60_000,
        },
        [1, 1, 1],
    );
    recorder.copy(&values, 0, &readback, 0, 64);
    let ticket = gpu.submit(recorder, &[]).unwrap();
    drop((values, spin));
    ticket.wait().unwrap();
    assert_eq!(readback.read_host(), [spun(60_000); 64]);
}

/// llvmpipe (Mesa 22.3) ends any loop after 65,535 rounds, without a word: a kernel that walks a
/// longer list needs two loops, one inside the other. When a newer driver does better, this test
/// says so.
#[test]
fn loops_run_to_their_end_but_on_llvmpipe() {
    let gpu = Watched::open();
    let rounds = 65_536 + 5;
    let run = if gpu.info().name.contains("llvmpipe") {
        65_535
    } else {
        rounds
    };
    let spin: Kernel<spin::Module> = gpu.kernel(&spin::Constants {}).unwrap();
    let values = gpu.upload("values", "test", &[1_u32; 64]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    recorder.dispatch(
        &spin,
        spin::Bindings {
            values: values.bound(),
        },
        spin::Push { count: 64, rounds },
        [1, 1, 1],
    );
    gpu.submit(recorder, &[]).unwrap();
    assert_eq!(gpu.read(&values).unwrap(), [spun(run); 64]);
}

/// Result of the spin kernel for 1.
fn spun(rounds: u32) -> u32 {
    (0..rounds).fold(1_u32, |value, _| {
        value.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)
    })
}

#[test]
fn stages_are_timed_in_order_and_do_not_overlap() {
    let gpu = Watched::open();
    let spin: Kernel<spin::Module> = gpu.kernel(&spin::Constants {}).unwrap();
    let values = gpu.upload("values", "test", &[1_u32; 1024]).unwrap();
    // The same slot serves all three, so stale times would show.
    for _ in 0..3 {
        let mut recorder = gpu.record(QueueRole::Main).time_stages();
        for (name, rounds) in [("short", 10), ("long", 50_000), ("last", 10)] {
            recorder.stage(name, |recorder| {
                recorder.dispatch(
                    &spin,
                    spin::Bindings {
                        values: values.bound(),
                    },
                    spin::Push {
                        count: 1024,
                        rounds,
                    },
                    [16, 1, 1],
                );
            });
        }
        let before = Instant::now();
        let ticket = gpu.submit(recorder, &[]).unwrap();
        let stages = ticket.stage_times().unwrap();
        let wall_ns = before.elapsed().as_nanos() as u64;
        println!(
            "{stages:?}, whole {} ns, wall {wall_ns} ns",
            ticket.gpu_time_ns().unwrap()
        );
        assert_eq!(
            stages.iter().map(|stage| stage.name).collect::<Vec<_>>(),
            ["short", "long", "last"]
        );
        for pair in stages.windows(2) {
            assert!(
                pair[0].start_ns + pair[0].duration_ns <= pair[1].start_ns,
                "{stages:?}"
            );
        }
        assert!(
            stages[1].duration_ns > stages[0].duration_ns
                && stages[1].duration_ns > stages[2].duration_ns,
            "{stages:?}"
        );
        let whole = ticket.gpu_time_ns().unwrap();
        assert!(
            whole >= stages[2].start_ns + stages[2].duration_ns && whole <= wall_ns,
            "{whole} of {wall_ns}: {stages:?}"
        );
    }
}

/// Submits what `body` records, waits for it, and tells whether it was recorded before.
fn repeats(gpu: &Gpu, body: impl FnOnce(&mut Recorder)) -> bool {
    let mut recorder = gpu.record(QueueRole::Main);
    body(&mut recorder);
    let ticket = gpu.submit(recorder, &[]).unwrap();
    ticket.wait().unwrap();
    ticket.is_repeated()
}

#[test]
fn equal_commands_are_recorded_once() {
    let gpu = Watched::open();
    let (a, b) = two_buffers(&gpu);
    let kernel = scaling(&gpu, 1);
    let twice = |r: &mut Recorder| r.stage("twice", |r| there_and_back(r, &kernel, &a, &b));
    assert!(!repeats(&gpu, twice));
    for _ in 0..3 {
        assert!(repeats(&gpu, twice));
    }
    let expected: Vec<i32> = (0..COUNT as i32).map(|value| value + 8).collect();
    assert_eq!(gpu.read(&a).unwrap(), expected);
    // Readings of the buffer above were submissions too: what is recorded outlives them.
    assert!(repeats(&gpu, twice));
    assert_eq!(gpu.take_validation_messages(), [""; 0]);
}

#[test]
fn a_command_buffer_serves_equal_commands_alone() {
    let gpu = Watched::open();
    let (a, b) = two_buffers(&gpu);
    let (kernel, other_kernel) = (scaling(&gpu, 1), scaling(&gpu, 2));
    let arguments = gpu.upload("arguments", "test", &[1_u32; 6]).unwrap();
    let run = |kernel: &Kernel<scale::Module>, bindings, add: i32, groups: u32| {
        let push = scale::Push { count: COUNT, add };
        repeats(&gpu, |r| {
            r.dispatch(kernel, bindings, push, [groups, 1, 1]);
        })
    };
    let indirect = |byte_offset: u64| {
        let push = scale::Push {
            count: COUNT,
            add: 1,
        };
        repeats(&gpu, |r| {
            r.dispatch_indirect(&kernel, from_to(&a, &b), push, &arguments, byte_offset);
        })
    };
    let copied =
        |from: usize, to: usize, count: usize| repeats(&gpu, |r| r.copy(&a, from, &b, to, count));
    let filled =
        |offset: u64, bytes: u64, value: u32| repeats(&gpu, |r| r.fill(&b, offset, bytes, value));
    let staged = |name: &'static str| repeats(&gpu, |r| r.stage(name, |r| r.copy(&a, 0, &b, 0, 1)));
    // Every one differs from those before it in one thing.
    let first = [
        run(&kernel, from_to(&a, &b), 1, 4),
        run(&other_kernel, from_to(&a, &b), 1, 4),
        run(&kernel, from_to(&b, &a), 1, 4),
        run(&kernel, from_to(&a, &b), 2, 4),
        run(&kernel, from_to(&a, &b), 1, 5),
        indirect(0),
        indirect(12),
        copied(0, 0, 4),
        copied(1, 0, 4),
        copied(0, 1, 4),
        copied(0, 0, 5),
        staged("one"),
        staged("two"),
    ];
    assert_eq!(first, [false; 13]);
    let fills = [
        filled(0, 8, 1),
        filled(4, 8, 1),
        filled(0, 4, 1),
        filled(0, 8, 2),
    ];
    assert_eq!(fills, [false; 4]);
    // Those are the last of sixteen that are kept.
    assert!(filled(0, 8, 2) && staged("two") && indirect(12));
    // A new buffer is another buffer, also where it has the handle of one that is gone.
    let of_new = || {
        let c = gpu.buffer("c", "test", 4, MemoryKind::Device).unwrap();
        repeats(&gpu, |r| r.copy(&a, 0, &c, 0, 4))
    };
    assert_eq!([of_new(), of_new(), of_new()], [false; 3]);
    assert_eq!(gpu.take_validation_messages(), [""; 0]);
}

#[test]
fn what_is_recorded_holds_no_memory() {
    let gpu = Watched::open();
    let (a, b) = two_buffers(&gpu);
    assert!(!repeats(&gpu, |r| r.copy(&a, 0, &b, 0, 4)));
    assert!(gpu.memory().total_bytes > 0);
    drop((a, b));
    assert_eq!(gpu.memory().total_bytes, 0);
    assert_eq!(gpu.take_validation_messages(), [""; 0]);
}

#[test]
fn stages_are_timed_only_where_that_is_asked_for() {
    let gpu = Watched::open();
    let (a, b) = two_buffers(&gpu);
    for asked in [false, true, false] {
        let mut recorder = gpu.record(QueueRole::Main);
        if asked {
            recorder = recorder.time_stages();
        }
        recorder.stage("copy", |r| r.copy(&a, 0, &b, 0, 4));
        let ticket = gpu.submit(recorder, &[]).unwrap();
        assert_eq!(ticket.stage_times().unwrap().len(), usize::from(asked));
        assert!(ticket.gpu_time_ns().unwrap() > 0);
    }
}

#[test]
fn threads_may_record_and_submit_at_the_same_time() {
    let gpu = Watched::open();
    let kernel = scaling(&gpu, 2);
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (gpu, kernel) = (&gpu, &kernel);
            scope.spawn(move || {
                let (a, b) = two_buffers(gpu);
                for _ in 0..8 {
                    let mut recorder = gpu.record(if thread % 2 == 0 {
                        QueueRole::Main
                    } else {
                        QueueRole::Update
                    });
                    there_and_back(&mut recorder, kernel, &a, &b);
                    gpu.submit(recorder, &[]).unwrap().wait().unwrap();
                }
                assert_eq!(
                    gpu.read(&a).unwrap()[1],
                    (0..16).fold(1, |value, _| value * 2 + 1)
                );
            });
        }
    });
}

#[test]
fn dropping_the_device_waits_for_its_work() {
    let gpu = Watched::open();
    let spin: Kernel<spin::Module> = gpu.kernel(&spin::Constants {}).unwrap();
    let values = gpu.upload("values", "test", &[1_u32; 4096]).unwrap();
    let mut recorder = gpu.record(QueueRole::Main);
    recorder.dispatch(
        &spin,
        spin::Bindings {
            values: values.bound(),
        },
        spin::Push {
            count: 4096,
            rounds: 60_000,
        },
        [64, 1, 1],
    );
    let ticket = gpu.submit(recorder, &[]).unwrap();
    drop(gpu);
    assert!(ticket.is_done().unwrap());
}

#[test]
#[should_panic(expected = "a ticket belongs to another device")]
fn tickets_of_another_device_assert() {
    let (one, other) = (Watched::open(), Watched::open());
    let ticket = other.submit(other.record(QueueRole::Main), &[]).unwrap();
    let _ = one.submit(one.record(QueueRole::Main), &[&ticket]);
}

#[test]
fn recording_a_frame_takes_little_of_the_host() {
    let gpu = Gpu::open(&DeviceOptions {
        validation: false,
        ..DeviceOptions::default()
    })
    .unwrap();
    let (a, b) = two_buffers(&gpu);
    let kernel = scaling(&gpu, 1);
    // With the same `value` the commands are those of the call before.
    let record = |value: i32| {
        let start = Instant::now();
        let mut recorder = gpu.record(QueueRole::Main);
        for _ in 0..20 {
            recorder.stage("there and back", |recorder| {
                there_and_back(recorder, &kernel, &a, &b);
            });
        }
        recorder.fill(&b, 0, 4, value as u32);
        let ticket = gpu.submit(recorder, &[]).unwrap();
        let took = start.elapsed();
        ticket.wait().unwrap();
        took
    };
    let best = (0..50).map(record).min().unwrap();
    let repeated = (0..50).map(|_| record(50)).min().unwrap();
    println!(
        "40 dispatches in 20 stages: recorded and submitted in {best:?}, again in {repeated:?}"
    );
    // A frame has about forty dispatches and a millisecond. Ten times what it takes on two slow
    // cores.
    assert!(best.as_micros() < 1000, "{best:?}");
}
