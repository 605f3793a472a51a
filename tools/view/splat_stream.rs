//! Splats that the page draws by itself while a camera moves, as bytes.
//!
//! Chunks follow each other: those of the background, then those of each asset, of each the splats
//! that cover most first. A chunk is a header of 48 bytes and 32 bytes for each of its splats, all
//! fields little-endian.
//!
//! | byte of the header | content |
//! |---|---|
//! | 0 | "DGPS" |
//! | 4 | u32: part, 0 the background, `k` the asset `k - 1` of the scene |
//! | 8 | u32: splats of the chunk |
//! | 12 | u32: splats of the part in the whole stream |
//! | 16 | u32: splats of the whole stream |
//! | 20 | u32: 0 |
//! | 24 | 3 f64: place that means are relative to: in the world for the background, meters |
//!
//! | byte of a splat | content |
//! |---|---|
//! | 0 | 3 f32: mean, meters |
//! | 12 | 4 u8: red, green, blue and opacity, 255 for 1 |
//! | 16 | 3 i16: natural logarithms of the standard deviations in meters, 32767 for 32 |
//! | 22 | 3 i16: x, y and z of a rotation from the splat's axes, 32767 for 1; w is not below 0 |
//! | 28 | u32: 0 |

use std::cell::OnceCell;
use std::sync::Arc;

use decouplegs::asset::LoadedScene;
use decouplegs::scene::codebook::CodedCloud;
use decouplegs::scene::{SplatCloud, SplatScene, sh};
use glam::DVec3;
use serde_json::{Value, json};

/// First four bytes of each chunk.
const MAGIC: &[u8; 4] = b"DGPS";
/// Splats of a chunk: half a megabyte.
const CHUNK_SPLATS: usize = 16_384;
/// Bytes of a splat.
const SPLAT_BYTES: usize = 32;
/// Logarithm of a standard deviation that the largest code stands for.
const LOG_MAX: f32 = 32.0;
const CODE_MAX: f32 = 32_767.0;

/// Splats of `scene` and of `assets` for the page: at most `most`, of which assets take at most
/// half.
fn encode(scene: &SplatScene, assets: &[CodedCloud], most: usize) -> Vec<u8> {
    let share = most / 2 / assets.len().max(1);
    let shared = |asset: &CodedCloud| largest(&asset.decoded(0), share);
    let assets: Vec<SplatCloud> = assets.iter().map(shared).collect();
    let placed: usize = assets.iter().map(SplatCloud::len).sum();
    let background = largest(&scene.splats, most - placed);
    let all = placed + background.len();
    let mut bytes = Vec::with_capacity((SPLAT_BYTES + 1) * all + 4096);
    put_part(&mut bytes, 0, &background, scene.origin, all);
    for (part, asset) in (1..).zip(&assets) {
        put_part(&mut bytes, part, asset, DVec3::ZERO, all);
    }
    bytes
}

/// Encoded splats of a source, made when the first page asks for them.
#[derive(Default)]
pub struct KeptSplats {
    bytes: OnceCell<Arc<[u8]>>,
    version: u32,
}

impl KeptSplats {
    /// The splats of `scene`, at most `most`.
    pub fn bytes(&self, scene: &LoadedScene, most: usize) -> Arc<[u8]> {
        let encoded = || encode(&scene.splat_scene, &scene.assets, most).into();
        Arc::clone(self.bytes.get_or_init(encoded))
    }

    /// Number that is another one for each scene that the source had.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Forgets the splats: the scene is another one.
    pub fn forget(&mut self) {
        self.bytes = OnceCell::new();
        self.version += 1;
    }
}

/// Sky and rules by which the page draws a scene, as JSON. A sky that differs by
/// direction has its mean color.
pub fn rules_json(scene: &SplatScene) -> Value {
    let sky = match &scene.sky_map {
        Some(map) => {
            let texels = map.texels();
            let sum = texels.iter().fold([0.0; 3], |sum: [f64; 3], texel| {
                std::array::from_fn(|channel| sum[channel] + f64::from(texel[channel]))
            });
            sum.map(|channel| channel / texels.len().max(1) as f64)
        }
        None => scene.sky.map(f64::from),
    };
    json!({"sky": sky, "near_m": scene.rules.near_m, "antialias": scene.rules.antialias})
}

/// The splats of `cloud` that cover most, at most `most`, from the largest on.
fn largest(cloud: &SplatCloud, most: usize) -> SplatCloud {
    let weight = |splat: usize| {
        let mean = cloud.means[splat];
        let [_, middle, greatest] = cloud.sorted_scales_m(splat);
        let weight = f64::from(cloud.opacities[splat]) * middle * greatest;
        // None has the weight of infinity: it cannot be drawn.
        let is_drawn = mean.iter().all(|axis| axis.is_finite()) && weight.is_finite();
        if is_drawn { weight as f32 } else { -1.0 }
    };
    let weights: Vec<f32> = (0..cloud.len()).map(weight).collect();
    let drawn = (0..cloud.len() as u32).filter(|&splat| weights[splat as usize] >= 0.0);
    let mut order: Vec<u32> = drawn.collect();
    let heavier = |a: &u32, b: &u32| {
        let [a_weight, b_weight] = [a, b].map(|splat| weights[*splat as usize]);
        b_weight.total_cmp(&a_weight).then(a.cmp(b))
    };
    if order.len() > most {
        if most > 0 {
            order.select_nth_unstable_by(most - 1, heavier);
        }
        order.truncate(most);
    }
    order.sort_unstable_by(heavier);
    cloud.select(&order)
}

fn put_part(bytes: &mut Vec<u8>, part: u32, cloud: &SplatCloud, origin: DVec3, all: usize) {
    for first in (0..cloud.len()).step_by(CHUNK_SPLATS) {
        let end = (first + CHUNK_SPLATS).min(cloud.len());
        bytes.extend(MAGIC);
        for word in [
            part,
            (end - first) as u32,
            cloud.len() as u32,
            all as u32,
            0,
        ] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(origin.to_array().map(f64::to_le_bytes).as_flattened());
        (first..end).for_each(|splat| put_splat(bytes, cloud, splat));
    }
}

fn put_splat(bytes: &mut Vec<u8>, cloud: &SplatCloud, splat: usize) {
    let code = |share: f32| (CODE_MAX * share.clamp(-1.0, 1.0)).round() as i16;
    let byte = |share: f32| (255.0 * share.clamp(0.0, 1.0)).round() as u8;
    bytes.extend(cloud.means[splat].map(f32::to_le_bytes).as_flattened());
    let color = cloud.sh_dc[splat].map(|dc| byte(0.5 + sh::Y0 as f32 * dc));
    bytes.extend(color);
    bytes.push(byte(cloud.opacities[splat]));
    let logs = cloud.scales[splat].map(|scale| code(scale.ln() / LOG_MAX));
    let [w, x, y, z] = cloud.rotations[splat];
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    let rotation = [x, y, z].map(|part| code(sign * part));
    let codes = [logs, rotation];
    bytes.extend(
        codes
            .as_flattened()
            .iter()
            .flat_map(|code| code.to_le_bytes()),
    );
    bytes.extend([0; 4]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(opacities: &[f32]) -> SplatCloud {
        let count = opacities.len();
        SplatCloud {
            means: (0..count).map(|splat| [splat as f32, 0.0, 0.0]).collect(),
            scales: vec![[0.5, 1.0, 2.0]; count],
            rotations: vec![[-0.5, 0.5, 0.5, 0.5]; count],
            opacities: opacities.to_vec(),
            sh_degree: 0,
            sh_dc: vec![[0.0, 100.0, -100.0]; count],
            sh_rest: Vec::new(),
        }
    }

    fn encoded(background: SplatCloud, most: usize) -> Vec<u8> {
        encode(&SplatScene::from_splats(background), &[], most)
    }

    #[test]
    fn splats_that_cover_most_come_first_and_the_rest_is_left_out() {
        let bytes = encoded(cloud(&[0.1, 0.9, 0.5, f32::NAN]), 2);
        assert_eq!(bytes.len(), 48 + 2 * SPLAT_BYTES);
        assert_eq!(&bytes[..4], MAGIC);
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!([word(4), word(8), word(12), word(16)], [0, 2, 2, 2]);
        let first_x = |splat: usize| f32::from_bits(word(48 + SPLAT_BYTES * splat));
        assert_eq!([first_x(0), first_x(1)], [1.0, 2.0]);
        let splat = &bytes[48..48 + SPLAT_BYTES];
        assert_eq!(splat[12..16], [128, 255, 0, 230]);
        let code = |at: usize| i16::from_le_bytes([splat[at], splat[at + 1]]);
        assert_eq!([code(16), code(18), code(20)], [-710, 0, 710]);
        assert_eq!([code(22), code(24), code(26)], [-16_384; 3]);
    }

    #[test]
    fn nothing_is_sent_of_an_empty_scene() {
        assert!(encoded(cloud(&[]), 100).is_empty());
        assert!(encoded(cloud(&[0.5; 3]), 0).is_empty());
    }

    #[test]
    fn large_parts_come_in_chunks() {
        let count = CHUNK_SPLATS + 5;
        let bytes = encoded(cloud(&vec![0.5; count]), 1 << 20);
        let second = 48 + SPLAT_BYTES * CHUNK_SPLATS;
        assert_eq!(bytes.len(), second + 48 + 5 * SPLAT_BYTES);
        assert_eq!(&bytes[second..second + 12], b"DGPS\0\0\0\0\x05\0\0\0");
    }
}
