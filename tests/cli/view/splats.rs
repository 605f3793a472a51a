//! Splats that pages draw by themselves.

use std::collections::HashMap;

use decouplegs::asset::open_scene;
use decouplegs::scene::SplatCloud;
use decouplegs::scene::sh::Y0;

use super::*;

const CHUNK_HEADER_BYTES: usize = 48;
const SPLAT_BYTES: usize = 32;

/// A chunk: part, splats of the part and of the stream, origin, and its splats.
struct Chunk {
    part: u32,
    of: u32,
    all: u32,
    origin: [f64; 3],
    splats: Vec<[u8; SPLAT_BYTES]>,
}

impl Viewer {
    /// Chunks of the splats of the first source.
    fn splats(&self) -> Vec<Chunk> {
        let here = format!("Host: {}\r\n", self.host);
        let answer = self.get_bytes(&format!("/splats/0{}", self.query), &here);
        assert!(answer.starts_with(b"HTTP/1.1 200"));
        let mut blank = answer.windows(4);
        let head = blank.position(|four| four == b"\r\n\r\n").expect("a body");
        let mut body = &answer[head + 4..];
        let mut chunks = Vec::new();
        while !body.is_empty() {
            assert_eq!(&body[..4], b"DGPS");
            let word = |at: usize| u32::from_le_bytes(body[at..at + 4].try_into().unwrap());
            let axis = |at: usize| f64::from_le_bytes(body[at..at + 8].try_into().unwrap());
            let end = CHUNK_HEADER_BYTES + SPLAT_BYTES * word(8) as usize;
            chunks.push(Chunk {
                part: word(4),
                of: word(12),
                all: word(16),
                origin: [24, 32, 40].map(axis),
                splats: body[CHUNK_HEADER_BYTES..end].as_chunks().0.to_vec(),
            });
            body = &body[end..];
        }
        chunks
    }
}

/// True if `bytes` are a splat of `cloud` within what the codes hold.
fn is_splat(bytes: &[u8; SPLAT_BYTES], cloud: &SplatCloud, splat: usize) -> bool {
    let code = |at: usize| f32::from(i16::from_le_bytes([bytes[at], bytes[at + 1]])) / 32_767.0;
    let near = |a: f32, b: f32, tolerance: f32| (a - b).abs() <= tolerance;
    let [w, x, y, z] = cloud.rotations[splat];
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    let rotation = [x, y, z].map(|part| sign * part);
    let color = cloud.sh_dc[splat].map(|dc| (0.5 + Y0 as f32 * dc).clamp(0.0, 1.0));
    let [red, green, blue] = color;
    let shown = [red, green, blue, cloud.opacities[splat]];
    (0..3).all(|axis| {
        near(
            code(16 + 2 * axis),
            cloud.scales[splat][axis].ln() / 32.0,
            2e-5,
        ) && near(code(22 + 2 * axis), rotation[axis], 2e-5)
    }) && (0..4).all(|at| near(f32::from(bytes[12 + at]) / 255.0, shown[at], 0.002))
}

#[test]
fn a_page_is_sent_the_background_and_each_asset_once() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let viewer = Viewer::start(&[text(&scene)]);
    let chunks = viewer.splats();
    let loaded = open_scene(&scene, 0.0).unwrap();
    let background = &loaded.splat_scene.splats;
    let parts: Vec<u32> = chunks.iter().map(|chunk| chunk.part).collect();
    let expected: Vec<u32> = (0..=loaded.assets.len() as u32).collect();
    assert_eq!(parts, expected);
    assert_eq!(chunks[0].origin, loaded.splat_scene.origin.to_array());
    let sent: usize = chunks.iter().map(|chunk| chunk.splats.len()).sum();
    assert!(chunks.iter().all(|chunk| chunk.all as usize == sent));
    let clouds = loaded.assets.iter().map(|asset| asset.decoded(0));
    let clouds: Vec<SplatCloud> = [background.clone()].into_iter().chain(clouds).collect();
    for (chunk, cloud) in chunks.iter().zip(&clouds) {
        assert_eq!(
            (chunk.of as usize, chunk.splats.len()),
            (cloud.len(), cloud.len())
        );
        let places: HashMap<[u8; 12], usize> = (cloud.means.iter().enumerate())
            .map(|(splat, mean)| {
                let bytes = mean.map(f32::to_le_bytes);
                (bytes.as_flattened().try_into().unwrap(), splat)
            })
            .collect();
        // Means of compressed assets lie on a grid: a few may be the same.
        let mut others = 0;
        for bytes in &chunk.splats {
            let splat = places[&bytes[..12]];
            others += usize::from(!is_splat(bytes, cloud, splat));
        }
        assert!(others * 50 <= cloud.len(), "{others} of {}", cloud.len());
        // The comparison tells splats apart.
        let first = &chunk.splats[0];
        let same = (0..cloud.len()).filter(|&splat| is_splat(first, cloud, splat));
        assert!(same.count() * 10 < cloud.len());
    }
}

#[test]
fn a_page_is_sent_no_more_splats_than_it_may_have() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let viewer = Viewer::start(&[text(&scene), "--browser-splats", "1000"]);
    let chunks = viewer.splats();
    let sent: usize = chunks.iter().map(|chunk| chunk.splats.len()).sum();
    assert_eq!(sent, 1000);
    let assets: usize = chunks[1..].iter().map(|chunk| chunk.splats.len()).sum();
    assert!((1..=500).contains(&assets), "{assets}");
    let here = format!("Host: {}\r\n", viewer.host);
    for (path, status) in [
        ("/splats/0".to_owned(), 401),
        (format!("/splats/1{}", viewer.query), 404),
        (format!("/splats/x{}", viewer.query), 400),
    ] {
        let answer = viewer.get(&path, &here);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status}")),
            "{path}: {answer}"
        );
    }
    fail(2, &["view", text(&scene), "--browser-splats", "100000000"]);
}
