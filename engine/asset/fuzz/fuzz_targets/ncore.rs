//! Stores of NCore whose tar, or the attributes of one of whose groups, are any bytes: an error, or
//! a sequence whose times rise and whose boxes have sizes. The first byte says which.
#![no_main]

use decouplegs_asset::ncore::NcoreSequence;
use libfuzzer_sys::fuzz_target;

const GROUPS: [&str; 5] = [
    "poses/a/static_poses",
    "poses/a/dynamic_poses",
    "intrinsics/a/cameras/front",
    "cameras/front/frames",
    "cuboids/a/cuboids",
];
const POSE: &str = "[[1,0,0,1],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";

/// Adds a file to a tar.
fn add(tar: &mut Vec<u8>, name: &str, content: &[u8]) {
    let mut header = [0u8; 512];
    header[..name.len()].copy_from_slice(name.as_bytes());
    header[124..136].copy_from_slice(format!("{:011o}\0", content.len()).as_bytes());
    header[156] = b'0';
    header[148..156].fill(b' ');
    let sum: u64 = header.iter().map(|byte| u64::from(*byte)).sum();
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    tar.extend(header);
    tar.extend(content);
    tar.resize(tar.len().next_multiple_of(512), 0);
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, content)) = bytes.split_first() else {
        return;
    };
    let mut tar = Vec::new();
    let chosen = usize::from(*kind) % 6;
    for (index, group) in GROUPS.iter().enumerate() {
        let usual = match index {
            0 => format!("{{\"('front', 'rig')\": {{\"pose\": {POSE}}}}}"),
            1 => format!(
                "{{\"('rig', 'world')\": {{\"poses\": [{POSE}, {POSE}], \"timestamps_us\": [5, 105]}}}}"
            ),
            _ => "{}".to_owned(),
        };
        let own = match index == chosen {
            true => content,
            false => usual.as_bytes(),
        };
        add(&mut tar, &format!("{group}/.zattrs"), own);
    }
    tar.extend([0; 1024]);
    let folder = std::env::temp_dir().join(format!("ncore-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let meta = br#"{"version": "4.0", "component_stores": [{"path": "a.zarr.itar"}]}"#;
    std::fs::write(folder.join("a.json"), meta).unwrap();
    let tar = match chosen {
        5 => content,
        _ => tar.as_slice(),
    };
    std::fs::write(folder.join("a.zarr.itar"), tar).unwrap();
    if let Ok(sequence) = NcoreSequence::read(&folder.join("a.json")) {
        let poses = sequence.rig.poses();
        assert!(poses.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
        let mut dims = sequence.boxes.iter().filter_map(|row| row.dims_m);
        assert!(dims.all(|dims| dims.iter().all(|side_m| *side_m > 0.0)));
    }
});
