//! Zips whose directories lie about places, sizes and methods, as packages of scenes, bundles and
//! checkpoints: an error or what they hold.
#![no_main]

mod choices;

use choices::Choices;
use decouplegs_asset::{SplatFormat, checkpoint, open_packed_scene, sog};
use libfuzzer_sys::fuzz_target;

const NAMES: [&str; 9] = [
    "decouplegs/scene.toml",
    "decouplegs/background.splat",
    "decouplegs/assets/0000_car.splat",
    "meta.json",
    "means_l.webp",
    "a/data.pkl",
    "a/data/0",
    "decouplegs/../up",
    "default.usda",
];
const SCENE: &[u8] = b"version = 1\nbackground = \"background.splat\"\n[[agent]]\nname = \"a\"\nasset = \"assets/0000_car.splat\"\nposition_m = [1.0, 2.0, 3.0]\n";
const META: &[u8] = br#"{"version":2,"count":4,"means":{"mins":[0,0,0],"maxs":[1,1,1],"files":["means_l.webp","means_u.webp"]},"scales":{"codebook":[0],"files":["scales.webp"]},"quats":{"files":["quats.webp"]},"sh0":{"codebook":[0],"files":["sh0.webp"]}}"#;

struct Entry {
    name: &'static str,
    at: u32,
    bytes: u32,
}

fn header(out: &mut Vec<u8>, method: u16, checksum: u32, packed: u32, size: u32, name: &str) {
    out.extend([20, 0, 0, 0]);
    out.extend(method.to_le_bytes());
    out.extend([0; 4]);
    for number in [checksum, packed, size] {
        out.extend(number.to_le_bytes());
    }
    out.extend((name.len() as u16).to_le_bytes());
    out.extend([0, 0]);
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

fuzz_target!(|bytes: &[u8]| {
    let mut choices = Choices(bytes);
    let mut file = Vec::new();
    let mut entries = Vec::new();
    let mut checksums = Vec::new();
    for _ in 0..=choices.one_of(8) {
        let name = NAMES[choices.one_of(NAMES.len())];
        let content: Vec<u8> = match name {
            "decouplegs/scene.toml" => SCENE.to_vec(),
            "meta.json" => META.to_vec(),
            _ => vec![0x3e; 32 * choices.one_of(64)],
        };
        entries.push(Entry {
            name,
            at: file.len() as u32,
            bytes: content.len() as u32,
        });
        checksums.push(checksum(&content));
        file.extend(b"PK\x03\x04");
        header(
            &mut file,
            0,
            checksum(&content),
            content.len() as u32,
            content.len() as u32,
            name,
        );
        file.extend(name.bytes());
        file.extend(content);
    }
    let start = file.len() as u32;
    for at in 0..entries.len() {
        // Several names may stand for the same bytes.
        let seen = if choices.rarely() {
            choices.one_of(entries.len())
        } else {
            at
        };
        let Entry {
            at: place, bytes, ..
        } = entries[seen];
        let lie = |choices: &mut Choices<'_>, truth: u32| {
            if choices.rarely() {
                choices.number() as u32
            } else {
                truth
            }
        };
        let (packed, size) = (lie(&mut choices, bytes), lie(&mut choices, bytes));
        let method = if choices.rarely() {
            [8, 9, 93][choices.one_of(3)]
        } else {
            0
        };
        file.extend(b"PK\x01\x02\x14\x00");
        header(
            &mut file,
            method,
            checksums[seen],
            packed,
            size,
            entries[at].name,
        );
        file.extend([0; 10]);
        file.extend([0; 4][..0].iter());
        let place = lie(&mut choices, place);
        file.extend(place.to_le_bytes());
        file.extend(entries[at].name.bytes());
    }
    let length = file.len() as u32 - start;
    let count = entries.len() as u16;
    file.extend(b"PK\x05\x06\0\0\0\0");
    file.extend(count.to_le_bytes());
    file.extend(count.to_le_bytes());
    file.extend(length.to_le_bytes());
    file.extend(start.to_le_bytes());
    file.extend([0, 0]);
    let _ = SplatFormat::detect(&file, "zip");
    let _ = sog::decode(&file);
    let _ = checkpoint::decode(&file);
    let path = std::env::temp_dir().join(format!("decouplegs-fuzz-{}.usdz", std::process::id()));
    if std::fs::write(&path, &file).is_ok() {
        let _ = open_packed_scene(&path, 0.0);
    }
});
