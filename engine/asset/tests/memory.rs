//! Heap use of readers on damaged and lying files, measured.
//!
//! Counted is what Rust code asks for. Zstandard's own working memory comes from C and is not: a
//! stream is decoded in one piece into a buffer of ours, for which the library needs some hundred
//! kilobytes whatever the stream says.

use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use decouplegs_asset::zip::StoredZip;
use decouplegs_asset::{
    SceneFile, SplatFormat, cameras, checkpoint, coded_asset, compressed_ply, inria_ply, khr_glb,
    sog, splat, spz,
};
use peak_alloc::PeakAlloc;

#[global_allocator]
static HEAP: PeakAlloc = PeakAlloc;

/// The heap is measured for the whole process: one measurement at a time.
static MEASURING: Mutex<()> = Mutex::new(());

const MIB: usize = 1 << 20;

/// Heap use of any gzip decoder: its window of 32 KiB and tables.
const GZIP_HEAP: usize = 64 << 10;

/// Heap use of decoding a small file of a format, beside its splats.
fn heap_of(format: SplatFormat) -> usize {
    match format {
        // Images of as many pixels as are believed however small the file is, one and a half at a
        // time, and a palette.
        SplatFormat::Sog => 4 * MIB,
        // The nodes of a document and of a pickle take some ten times their text.
        SplatFormat::KhrGlb | SplatFormat::Checkpoint => 4 * GZIP_HEAP,
        _ => GZIP_HEAP,
    }
}

/// Runs `read` once to start the thread pool and once to measure: the most bytes that were in use
/// beyond those before.
fn peak_bytes<T>(read: impl Fn() -> T) -> usize {
    drop(read());
    HEAP.reset_peak_usage();
    let before = HEAP.current_usage();
    drop(read());
    HEAP.peak_usage() - before
}

/// Number of splats in a seed of the fuzz targets, read by its format's reader. Errors are a result
/// like any other here.
fn read(bytes: &[u8], format: SplatFormat) -> Option<usize> {
    let cloud = match format {
        SplatFormat::InriaPly => inria_ply::decode(bytes),
        SplatFormat::CompressedPly => compressed_ply::decode(bytes),
        SplatFormat::Splat => splat::decode(bytes),
        SplatFormat::Spz => spz::decode(bytes),
        SplatFormat::Sog => sog::decode(bytes),
        SplatFormat::KhrGlb => khr_glb::decode(bytes),
        SplatFormat::Checkpoint => checkpoint::decode(bytes),
        SplatFormat::CodedAsset => coded_asset::decode(bytes).map(|asset| asset.cloud.decoded(0)),
    };
    cloud.ok().map(|cloud| cloud.len())
}

fn seeds() -> Vec<(&'static str, SplatFormat, Vec<u8>)> {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    [
        ("inria_ply/cone.ply", SplatFormat::InriaPly),
        (
            "compressed_ply/cone.compressed.ply",
            SplatFormat::CompressedPly,
        ),
        ("splat/cone.splat", SplatFormat::Splat),
        ("coded_asset/cone.safetensors", SplatFormat::CodedAsset),
        ("sog/cone.sog", SplatFormat::Sog),
        ("khr_glb/cone.glb", SplatFormat::KhrGlb),
        ("checkpoint/cone.pt", SplatFormat::Checkpoint),
        ("spz/cone.v1.spz", SplatFormat::Spz),
        ("spz/cone.v2.spz", SplatFormat::Spz),
        ("spz/cone.v3.spz", SplatFormat::Spz),
        ("spz/cone.v4.spz", SplatFormat::Spz),
    ]
    .map(|(name, format)| (name, format, std::fs::read(seeds.join(name)).unwrap()))
    .to_vec()
}

/// A gzip SPZ of version 3 and degree 0 that claims `count` splats over a body of `zeros` bytes.
fn gzip_of_zeros(count: u32, zeros: usize) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(b"NGSP\x03\0\0\0").unwrap();
    encoder.write_all(&count.to_le_bytes()).unwrap();
    encoder.write_all(&[0, 12, 0, 0]).unwrap();
    let block = vec![0; MIB];
    for first in (0..zeros).step_by(MIB) {
        encoder.write_all(&block[..MIB.min(zeros - first)]).unwrap();
    }
    encoder.finish().unwrap()
}

#[test]
fn no_overwritten_byte_and_no_cut_makes_a_small_file_take_much() {
    let _alone = MEASURING.lock().unwrap_or_else(PoisonError::into_inner);
    for (name, format, whole) in seeds() {
        let mut most = 0;
        for at in 0..whole.len() {
            most = most.max(peak_bytes(|| read(&whole[..at], format)));
            for value in [0x00, 0x7f, 0xff, whole[at] ^ 1, whole[at] ^ 0x80] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                most = most.max(peak_bytes(|| read(&bytes, format)));
            }
        }
        println!(
            "{name}: {} bytes, at most {most} bytes of heap",
            whole.len()
        );
        assert!(
            most <= heap_of(format) + 4 * whole.len(),
            "{name}: {most} bytes"
        );
    }
}

#[test]
fn a_claim_takes_nothing_that_the_file_does_not_hold() {
    let _alone = MEASURING.lock().unwrap_or_else(PoisonError::into_inner);
    let check = |what: String, format: SplatFormat, bytes: &[u8]| {
        assert_eq!(read(bytes, format), None, "{what} must be refused");
        let peak = peak_bytes(|| read(bytes, format));
        println!("{what}: {} bytes, {peak} bytes of heap", bytes.len());
        assert!(
            peak <= heap_of(format) + 4 * bytes.len(),
            "{what}: {peak} bytes for a file of {}",
            bytes.len()
        );
    };
    for (name, format, bytes) in seeds() {
        for count in [1u64 << 20, u64::from(u32::MAX), 1 << 40, u64::MAX] {
            let what = format!("{name} that claims {count}");
            match (format, u32::try_from(count)) {
                (SplatFormat::InriaPly | SplatFormat::CompressedPly, _) => {
                    for element in ["chunk 1", "vertex 12", "sh 12"] {
                        let (from, kind) = (
                            format!("element {element}\n"),
                            element.split(' ').next().unwrap(),
                        );
                        let claimed = replaced(
                            &bytes,
                            from.as_bytes(),
                            format!("element {kind} {count}\n").as_bytes(),
                        );
                        claimed.into_iter().for_each(|claimed| {
                            check(format!("{what} of {kind}"), format, &claimed);
                        });
                    }
                }
                (SplatFormat::Spz, Ok(count)) if bytes.starts_with(b"NGSP") => {
                    let mut claimed = bytes.clone();
                    claimed[8..12].copy_from_slice(&count.to_le_bytes());
                    check(what, format, &claimed);
                }
                (SplatFormat::Spz, Ok(count)) => check(what, format, &gzip_of_zeros(count, 300)),
                (SplatFormat::CodedAsset, _) => {
                    let mut claimed = bytes.clone();
                    claimed[..8].copy_from_slice(&count.to_le_bytes());
                    check(format!("{what} bytes of header"), format, &claimed);
                    for (from, to) in [
                        ("\"shape\":[16]", format!("\"shape\":[{count}]")),
                        (
                            "\"shape\":[16,3],\"data_offsets\":[",
                            format!("\"shape\":[{count},3],\"data_offsets\":["),
                        ),
                        (
                            "\"data_offsets\":[0,",
                            format!("\"data_offsets\":[{count},"),
                        ),
                        (",288]", format!(",{count}]")),
                    ] {
                        check(
                            format!("{what} for {from}"),
                            format,
                            &with_header(&bytes, from, &to),
                        );
                    }
                }
                (SplatFormat::KhrGlb, _) => {
                    let claimed = replaced(
                        &bytes,
                        b"\"count\":12,",
                        format!("\"count\":{count},").as_bytes(),
                    )
                    .unwrap();
                    check(what, format, &claimed);
                }
                (SplatFormat::Sog, _) => {
                    let means =
                        "\"means\":{\"mins\":[0,0,0],\"maxs\":[1,1,1],\"files\":[\"a\",\"b\"]}";
                    let coded = "{\"codebook\":[0],\"files\":[\"a\"]}";
                    let rest = format!(
                        "\"scales\":{coded},\"sh0\":{coded},\"quats\":{{\"files\":[\"a\"]}}"
                    );
                    let mut zip = StoredZip::new(Vec::new());
                    zip.add(
                        "meta.json",
                        format!("{{\"version\":2,\"count\":{count},{means},{rest}}}").as_bytes(),
                    )
                    .unwrap();
                    check(what, format, &zip.finish().unwrap());
                }
                // The shape of a tensor, 12 rows: the last instruction that says so is that of
                // 'shN'.
                (SplatFormat::Checkpoint, Ok(count)) => {
                    let claimed = replaced(
                        &bytes,
                        b"K\x0cK\x03\x86",
                        &[b"J", &count.to_le_bytes()[..], b"K\x03\x86"].concat(),
                    )
                    .unwrap();
                    check(what, format, &claimed);
                }
                (SplatFormat::Checkpoint, Err(_)) => {}
                // A .splat has no count, and the count of an SPZ no more bits.
                (SplatFormat::Splat, _) | (SplatFormat::Spz, Err(_)) => {}
            }
        }
    }
    // As many as are believed of a file of this size, over nothing.
    check(
        "gzip SPZ over nothing".into(),
        SplatFormat::Spz,
        &gzip_of_zeros(16_384, 0),
    );
}

/// `bytes` with the one place that says `from` saying `to`.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Option<Vec<u8>> {
    let at = bytes
        .windows(from.len())
        .position(|window| window == from)?;
    Some([&bytes[..at], to, &bytes[at + from.len()..]].concat())
}

/// The coded asset `bytes` with the one place of its header that says `from` saying `to`, and the
/// header's length to match.
fn with_header(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let mut changed = replaced(bytes, from.as_bytes(), to.as_bytes()).expect("the header has it");
    let length =
        u64::from_le_bytes(bytes[..8].try_into().unwrap()) + to.len() as u64 - from.len() as u64;
    changed[..8].copy_from_slice(&length.to_le_bytes());
    changed
}

#[test]
fn a_bomb_takes_no_more_than_the_splats_that_are_believed() {
    let _alone = MEASURING.lock().unwrap_or_else(PoisonError::into_inner);
    let check = |what: &str, bytes: &[u8], bound: usize| {
        let peak = peak_bytes(|| spz::decode(bytes).is_ok());
        println!("{what}: {} bytes, {peak} bytes of heap", bytes.len());
        assert!(
            peak <= bound,
            "{what}: {peak} bytes of heap, at most {bound}"
        );
    };
    let zeros = 256 * MIB;
    // 64 KiB of what follows the streams are read, as extensions, into a buffer that doubles.
    check(
        "gzip bomb of few splats",
        &gzip_of_zeros(2, zeros),
        5 * GZIP_HEAP,
    );
    let length = gzip_of_zeros(2, zeros).len();
    // 20 bytes per splat in the file, 56 in memory, and a buffer that grows by doubling.
    let believed = 16_384 + length;
    check(
        "gzip bomb of as many splats as are believed",
        &gzip_of_zeros(believed as u32, zeros),
        160 * believed,
    );
    check(
        "gzip bomb of more",
        &gzip_of_zeros(u32::MAX, zeros),
        GZIP_HEAP,
    );
    // The positions of a version 4 file, whose table of contents tells the truth about twelve
    // splats.
    let (_, _, seed) = seeds().pop().unwrap();
    let bomb = zstd::bulk::compress(&vec![0; zeros], 3).unwrap();
    let first = u64::from_le_bytes(seed[32..40].try_into().unwrap()) as usize;
    let data_at = 32 + 6 * 16;
    let mut file = seed[..data_at].to_vec();
    file[32..40].copy_from_slice(&(bomb.len() as u64).to_le_bytes());
    file.extend_from_slice(&bomb);
    file.extend_from_slice(&seed[data_at + first..]);
    assert!(
        spz::decode(&file)
            .unwrap_err()
            .to_string()
            .contains("positions")
    );
    check("Zstandard bomb", &file, GZIP_HEAP);
}

#[test]
fn text_takes_a_small_multiple_of_its_length() {
    let _alone = MEASURING.lock().unwrap_or_else(PoisonError::into_inner);
    let of = |start: &str, middle: &str| format!("{start}{}", middle.repeat(MIB / middle.len()));
    for (start, middle) in [
        ("", "["),
        ("[", "{},"),
        ("{\"frames\":[", "[],"),
        ("{\"a\":[", "0,"),
        ("{\"frames\":[{\"transform_matrix\":[", "[0,0,0,0],"),
        ("{", "\"a\":0,"),
    ] {
        let text = of(start, middle);
        let peak = peak_bytes(|| cameras::decode(text.as_bytes(), None).is_ok());
        println!(
            "cameras {start}{middle}...: {} bytes of heap a byte",
            peak / text.len()
        );
        assert!(peak <= 32 * text.len(), "{start}{middle}: {peak} bytes");
    }
    let empty_tensor = "\"TENSOR\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0]},";
    for (start, middle) in [
        ("{", empty_tensor),
        ("{\"__metadata__\":{", "\"KEY\":\"\","),
        ("{\"a\":", "["),
        ("{\"a\":[", "[],"),
    ] {
        // Every tensor and every key has a name of its own, as far as there are names.
        let mut names = 0u32;
        let mut text = start.to_owned();
        while text.len() + middle.len() + 8 < MIB {
            names += 1;
            text.push_str(
                &middle
                    .replace("TENSOR", &format!("{names:x}"))
                    .replace("KEY", &format!("{names:x}")),
            );
        }
        // Once cut, once whole where it can be.
        for text in [
            text.clone(),
            format!("{}}}}}", text.trim_end_matches(',')),
            format!("{}}}", text.trim_end_matches(',')),
        ] {
            let file = [&(text.len() as u64).to_le_bytes(), text.as_bytes()].concat();
            let peak = peak_bytes(|| coded_asset::decode(&file).is_ok());
            println!(
                "coded asset {start}{middle}...: {} bytes of heap a byte",
                peak / file.len()
            );
            assert!(peak <= 32 * file.len(), "{start}{middle}: {peak} bytes");
        }
    }
    for (start, middle) in [
        ("a = [", "0,"),
        ("a = ", "["),
        ("", "[[rig]]\n"),
        ("", "[[a]]\n"),
        ("a = ", "{a="),
        ("a", ".a"),
    ] {
        let text = of(start, middle);
        let peak = peak_bytes(|| SceneFile::parse(&text).is_ok());
        println!(
            "scene {start}{middle}...: {} bytes of heap a byte",
            peak / text.len()
        );
        assert!(peak <= 128 * text.len(), "{start}{middle}: {peak} bytes");
    }
}

#[test]
fn agents_times_splats_are_counted_before_the_first_is_placed() {
    let _alone = MEASURING.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    // One black splat of 1 m after another: a .splat is 32 bytes each.
    let one: Vec<u8> = [[0.0_f32; 3], [1.0; 3]]
        .as_flattened()
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .chain([0, 0, 0, 255, 255, 128, 128, 128])
        .collect();
    std::fs::write(folder.path().join("ground.splat"), &one).unwrap();
    std::fs::write(folder.path().join("car.splat"), one.repeat(20_000)).unwrap();
    let agents = |count: usize| {
        let agent = |index: usize| {
            format!(
                "[[agent]]\nname = \"car {index}\"\nasset = \"car.splat\"\nposition_m = [0, 0, 0]\n"
            )
        };
        let agents: String = (0..count).map(agent).collect();
        let text = format!("version = 1\nbackground = \"ground.splat\"\n{agents}");
        SceneFile::parse(&text).unwrap()
    };
    assert!(agents(3).load(folder.path(), 0.0).is_ok());
    let many = agents(7000);
    let load = || many.load(folder.path(), 0.0).unwrap_err().to_string();
    let peak = peak_bytes(load);
    println!("7000 agents of 20000 splats: {peak} bytes of heap");
    assert!(load().contains("compress the agents"), "{}", load());
    assert!(peak < 64 * MIB, "{peak} bytes");
}
