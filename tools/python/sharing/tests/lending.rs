//! The rules of lending, on streams that are played.

use std::collections::HashMap;
use std::fs::File;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use decouplegs_sharing::{Exported, Interop, InteropError, Lender, Shared, Stream};

/// An API whose device does what it is told and when.
#[derive(Default)]
struct Played {
    imported: AtomicUsize,
    alive: Arc<AtomicUsize>,
    waits: Mutex<Vec<(u64, Stream)>>,
    /// Marks that were made and marks that the device has come to, by stream.
    streams: Mutex<HashMap<usize, (usize, usize)>>,
    /// Set to make marks fail.
    broken: AtomicUsize,
}

struct Mapping {
    alive: Arc<AtomicUsize>,
    holders: Arc<()>,
    address: u64,
}

impl Drop for Mapping {
    fn drop(&mut self) {
        self.alive.fetch_sub(1, Ordering::SeqCst);
        assert!(
            Arc::strong_count(&self.holders) > 1,
            "the mapping went after the buffer"
        );
    }
}

fn key(stream: Stream) -> usize {
    match stream {
        Stream::Own(address) => address,
        _ => 1,
    }
}

impl Played {
    /// The device comes to the end of a stream.
    fn finish_stream(&self, stream: Stream) {
        let mut streams = self.streams.lock().unwrap();
        let (made, done) = streams.entry(key(stream)).or_default();
        *done = *made;
    }
}

impl Interop for Played {
    type Memory = Mapping;
    type Timeline = ();
    type Event = (usize, usize);

    fn import_memory(&self, exported: Exported) -> Result<Mapping, InteropError> {
        self.alive.fetch_add(1, Ordering::SeqCst);
        let number = self.imported.fetch_add(1, Ordering::SeqCst) as u64;
        let holders =
            LAST_EXPORTED.with(|last| last.borrow().clone().expect("a buffer was exported"));
        Ok(Mapping {
            alive: self.alive.clone(),
            holders,
            address: 1000 * (number + 1) + exported.buffer_bytes,
        })
    }

    fn address(memory: &Mapping) -> u64 {
        memory.address
    }

    fn import_timeline(&self, _descriptor: OwnedFd) -> Result<(), InteropError> {
        Ok(())
    }

    fn wait(&self, (): &(), value: u64, stream: Stream) -> Result<(), InteropError> {
        self.waits.lock().unwrap().push((value, stream));
        Ok(())
    }

    fn record(&self, stream: Stream) -> Result<(usize, usize), InteropError> {
        if self.broken.load(Ordering::SeqCst) > 0 {
            return Err(InteropError::Call {
                call: "record",
                code: "the stream is gone".into(),
            });
        }
        let mut streams = self.streams.lock().unwrap();
        let (made, _) = streams.entry(key(stream)).or_default();
        *made += 1;
        Ok((key(stream), *made))
    }

    fn is_done(&self, (stream, mark): &(usize, usize)) -> Result<bool, InteropError> {
        Ok(self.streams.lock().unwrap()[stream].1 >= *mark)
    }

    fn finish(&self, (stream, _): &(usize, usize)) -> Result<(), InteropError> {
        self.finish_stream(Stream::Own(*stream));
        Ok(())
    }
}

thread_local! {
    static LAST_EXPORTED: std::cell::RefCell<Option<Arc<()>>> = const { std::cell::RefCell::new(None) };
}

/// A buffer of the renderer; clones share it.
#[derive(Clone, Default)]
struct Memory(Arc<()>);

impl Shared for Memory {
    fn id(&self) -> usize {
        Arc::as_ptr(&self.0).addr()
    }

    fn holders(&self) -> usize {
        // The mapping's own handle, which only checks the order of things, is not one that the
        // renderer knows of.
        Arc::strong_count(&self.0) - 1
    }

    fn export(&self) -> Result<Exported, InteropError> {
        LAST_EXPORTED.with(|last| *last.borrow_mut() = Some(self.0.clone()));
        Ok(Exported {
            descriptor: descriptor(),
            allocation_bytes: 64,
            buffer_bytes: 48,
        })
    }
}

fn descriptor() -> OwnedFd {
    File::open("/dev/null").unwrap().into()
}

/// Images that count how many of them are out.
struct Images {
    memory: Memory,
    out: Arc<AtomicUsize>,
}

impl Images {
    fn new(memory: &Memory, out: &Arc<AtomicUsize>) -> Self {
        out.fetch_add(1, Ordering::SeqCst);
        Self {
            memory: memory.clone(),
            out: out.clone(),
        }
    }
}

impl Drop for Images {
    fn drop(&mut self) {
        self.out.fetch_sub(1, Ordering::SeqCst);
    }
}

struct Case {
    played: Arc<Played>,
    lender: Arc<Lender<Played, Images>>,
    memory: Memory,
    out: Arc<AtomicUsize>,
}

impl Case {
    fn new() -> Self {
        let played = Arc::new(Played::default());
        let lender = Lender::new(played.clone(), descriptor()).unwrap();
        Self {
            played,
            lender,
            memory: Memory::default(),
            out: Arc::default(),
        }
    }

    fn images(&self) -> Images {
        Images::new(&self.memory, &self.out)
    }

    fn out(&self) -> usize {
        self.out.load(Ordering::SeqCst)
    }
}

#[test]
fn images_come_back_when_the_stream_is_done_and_not_before() {
    let case = Case::new();
    let stream = Stream::Own(77);
    let loan = case.lender.lend(case.images(), 5);
    let handed = loan.hand_out(stream).unwrap();
    assert_eq!(
        *case.played.waits.lock().unwrap(),
        [(5, stream)],
        "the stream waits for the frame"
    );
    drop(loan);
    assert_eq!(
        (case.lender.collect().unwrap(), case.out()),
        (0, 1),
        "they are still held"
    );
    drop(handed);
    assert_eq!(
        (case.lender.collect().unwrap(), case.out()),
        (1, 1),
        "the device still reads them"
    );
    case.played.finish_stream(Stream::Own(78));
    assert_eq!(
        (case.lender.collect().unwrap(), case.out()),
        (1, 1),
        "another stream says nothing"
    );
    case.played.finish_stream(stream);
    assert_eq!((case.lender.collect().unwrap(), case.out()), (0, 0));
}

#[test]
fn all_streams_that_read_have_to_be_done() {
    let case = Case::new();
    let loan = case.lender.lend(case.images(), 1);
    let streams = [Stream::Own(70), Stream::PerThread, Stream::Own(71)];
    let handed: Vec<_> = streams
        .iter()
        .map(|stream| loan.hand_out(*stream).unwrap())
        .collect();
    drop((loan, handed));
    case.played.finish_stream(Stream::Own(70));
    case.played.finish_stream(Stream::Own(71));
    assert_eq!((case.lender.collect().unwrap(), case.out()), (1, 1));
    // What the default stream of a thread reads ends on the stream behind all default streams.
    case.played.finish_stream(Stream::Legacy);
    assert_eq!((case.lender.collect().unwrap(), case.out()), (0, 0));
}

#[test]
fn without_order_nothing_waits_and_what_was_never_handed_out_is_free_at_once() {
    let case = Case::new();
    let loan = case.lender.lend(case.images(), 1);
    drop(loan.hand_out(Stream::Unordered).unwrap());
    assert!(case.played.waits.lock().unwrap().is_empty());
    case.played.finish_stream(Stream::Legacy);
    drop(loan);
    drop(case.lender.lend(case.images(), 2));
    assert_eq!((case.lender.collect().unwrap(), case.out()), (0, 0));
}

#[test]
fn a_buffer_is_imported_once_and_forgotten_when_the_renderer_lets_go_of_it() {
    let case = Case::new();
    let first = case.lender.memory(case.memory.clone()).unwrap();
    assert_eq!(Played::address(&first), 1048);
    drop(first);
    for frame in 0..100 {
        let loan = case.lender.lend(case.images(), frame);
        assert_eq!(
            Played::address(&case.lender.memory(loan.images().memory.clone()).unwrap()),
            1048
        );
        drop(loan);
        case.lender.collect().unwrap();
    }
    assert_eq!(
        (
            case.played.imported.load(Ordering::SeqCst),
            case.lender.imports()
        ),
        (1, 1)
    );
    let other = Memory::default();
    assert_eq!(
        Played::address(&case.lender.memory(other.clone()).unwrap()),
        2048
    );
    LAST_EXPORTED.with(|last| last.borrow_mut().take());
    drop(other);
    case.lender.collect().unwrap();
    assert_eq!(
        (
            case.lender.imports(),
            case.played.alive.load(Ordering::SeqCst)
        ),
        (1, 1)
    );
}

#[test]
fn images_of_which_nobody_knows_who_reads_them_are_never_given_back() {
    let case = Case::new();
    let loan = case.lender.lend(case.images(), 1);
    let handed = loan.hand_out(Stream::Own(70)).unwrap();
    case.played.broken.store(1, Ordering::SeqCst);
    drop((handed, loan));
    assert!(
        case.lender
            .collect()
            .unwrap_err()
            .to_string()
            .contains("the stream is gone")
    );
    assert_eq!(
        (case.lender.collect().unwrap(), case.out()),
        (0, 1),
        "said once, and kept for ever"
    );
}

#[test]
fn a_consumer_that_outlives_the_renderer_is_waited_for() {
    let case = Case::new();
    let loan = case.lender.lend(case.images(), 1);
    let handed = loan.hand_out(Stream::Own(70)).unwrap();
    drop((loan, case.lender));
    assert_eq!(case.out.load(Ordering::SeqCst), 1);
    drop(handed);
    assert_eq!(case.out.load(Ordering::SeqCst), 0);
    assert_eq!(
        case.played.streams.lock().unwrap()[&70],
        (1, 1),
        "its stream was waited for"
    );
}

#[test]
fn streams_are_those_of_the_array_standard() {
    assert_eq!(Stream::of_dlpack(None), Ok(Stream::Legacy));
    assert_eq!(Stream::of_dlpack(Some(1)), Ok(Stream::Legacy));
    assert_eq!(Stream::of_dlpack(Some(2)), Ok(Stream::PerThread));
    assert_eq!(Stream::of_dlpack(Some(-1)), Ok(Stream::Unordered));
    assert_eq!(
        Stream::of_dlpack(Some(0x55_0000)),
        Ok(Stream::Own(0x55_0000))
    );
    for refused in [0, -2, i64::MIN] {
        assert!(
            Stream::of_dlpack(Some(refused))
                .unwrap_err()
                .contains("names no CUDA stream")
        );
    }
}

#[test]
fn without_a_driver_there_is_a_reason() {
    // Where there is a driver, no device has this UUID.
    let refused = decouplegs_sharing::Cuda::open([0; 16]).err().unwrap();
    assert!(
        matches!(
            refused,
            InteropError::Missing(_) | InteropError::NoSuchDevice { .. }
        ),
        "{refused}"
    );
    assert!(refused.to_string().contains("CUDA"), "{refused}");
}
