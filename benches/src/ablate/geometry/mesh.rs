//! A car of triangles from the test data: a glTF file with `EXT_meshopt_compression`.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use decouplegs::scene::light::to_linear;
use glam::{DVec2, DVec3};
use serde_json::Value;

use super::body::Body;
use super::rays::Triangle;

/// Radius that the car is scaled to, seen from above: that of a box of 4.5 m by 1.9 m. The file
/// has no unit.
const RADIUS_M: f64 = 2.44;

/// Reflectance is clamped to that of real paint: 0 and 1 are numbers of a renderer.
const ALBEDO: [f64; 2] = [0.02, 0.9];

/// Bytes and structure of a .glb file.
struct Glb {
    json: Value,
    bytes: Vec<u8>,
    /// Start of the binary chunk.
    start: usize,
}

/// An image whose colors multiply those of a material.
struct Texture {
    width: usize,
    rgb: Vec<[u8; 3]>,
}

fn number(value: &Value, key: &str) -> usize {
    value[key].as_u64().unwrap_or(0) as usize
}

impl Glb {
    fn read(path: &Path) -> Self {
        let bytes = fs::read(path).expect("the mesh can be read");
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json = serde_json::from_slice(&bytes[20..20 + length]).expect("JSON");
        Self {
            json,
            bytes,
            start: 20 + length + 8,
        }
    }

    fn slice(&self, view: &Value) -> &[u8] {
        let from = self.start + number(view, "byteOffset");
        &self.bytes[from..from + number(view, "byteLength")]
    }

    /// Values of accessor `index`, of which a view of compressed ones holds several after another.
    fn values<T: Clone + Copy + Default>(&self, index: &Value) -> Vec<T> {
        let accessor = &self.json["accessors"][index.as_u64().unwrap() as usize];
        let view = &self.json["bufferViews"][number(accessor, "bufferView")];
        let packed = &view["extensions"]["EXT_meshopt_compression"];
        let (data, count) = (self.slice(packed), number(packed, "count"));
        assert_eq!(number(packed, "byteStride"), size_of::<T>());
        let all: Vec<T> = if packed["mode"] == "TRIANGLES" {
            meshopt::decode_index_buffer(data, count).expect("indices")
        } else {
            meshopt::decode_vertex_buffer(data, count).expect("vertices")
        };
        let from = number(accessor, "byteOffset") / size_of::<T>();
        all[from..from + number(accessor, "count")].to_vec()
    }

    fn texture(&self, material: &Value) -> Option<Texture> {
        let texture = &material["pbrMetallicRoughness"]["baseColorTexture"]["index"];
        let texture = &self.json["textures"][texture.as_u64()? as usize];
        let image = &self.json["images"][number(texture, "source")];
        let data = self.slice(&self.json["bufferViews"][number(image, "bufferView")]);
        if image["mimeType"] == "image/png" {
            let image = image::load_from_memory(data).expect("a PNG").to_rgb8();
            let rgb = image.pixels().map(|pixel| pixel.0).collect();
            return Some(Texture {
                width: image.width() as usize,
                rgb,
            });
        }
        let mut decoder = jpeg_decoder::Decoder::new(Cursor::new(data));
        let bytes = decoder.decode().expect("a JPEG");
        let info = decoder.info().expect("a decoded JPEG has a size");
        assert_eq!(info.pixel_format, jpeg_decoder::PixelFormat::RGB24);
        Some(Texture {
            width: usize::from(info.width),
            rgb: bytes.as_chunks::<3>().0.to_vec(),
        })
    }
}

impl Texture {
    /// Linear color at `uv`, of the nearest pixel; the image repeats.
    fn at(&self, uv: DVec2) -> [f64; 3] {
        let height = self.rgb.len() / self.width;
        let position = |share: f64, count: usize| {
            ((share.rem_euclid(1.0) * count as f64) as usize).min(count - 1)
        };
        let pixel = self.rgb[position(uv.y, height) * self.width + position(uv.x, self.width)];
        pixel.map(|value| to_linear(f64::from(value) / 255.0))
    }
}

/// The car of file `path`, z up, standing on z = 0, its middle above the origin.
pub fn car(path: &Path) -> Body {
    let glb = Glb::read(path);
    let mut triangles = Vec::new();
    let mut albedos = Vec::new();
    for primitive in glb.json["meshes"][0]["primitives"].as_array().unwrap() {
        let attributes = &primitive["attributes"];
        let positions: Vec<[f32; 3]> = glb.values(&attributes["POSITION"]);
        let indices: Vec<u16> = glb.values(&primitive["indices"]);
        let material = &glb.json["materials"][number(primitive, "material")];
        let factor = &material["pbrMetallicRoughness"]["baseColorFactor"];
        let factor: [f64; 3] = std::array::from_fn(|i| factor[i].as_f64().unwrap_or(1.0));
        let texture = glb.texture(material);
        let uvs: Vec<[f32; 2]> = match &texture {
            Some(_) => glb.values(&attributes["TEXCOORD_0"]),
            None => Vec::new(),
        };
        for triangle in indices.as_chunks::<3>().0 {
            let triangle = triangle.map(usize::from);
            // glTF has y up.
            let corner = |index: usize| {
                let [x, y, z] = positions[index].map(f64::from);
                DVec3::new(x, -z, y)
            };
            let painted = texture.as_ref().map_or([1.0; 3], |texture| {
                let uv = triangle.map(|index| DVec2::from_array(uvs[index].map(f64::from)));
                texture.at((uv[0] + uv[1] + uv[2]) / 3.0)
            });
            triangles.push(triangle.map(corner));
            albedos.push(std::array::from_fn(|channel| {
                (factor[channel] * painted[channel]).clamp(ALBEDO[0], ALBEDO[1])
            }));
        }
    }
    let corners = || triangles.as_flattened().iter();
    let min = corners().copied().reduce(DVec3::min).unwrap();
    let max = corners().copied().reduce(DVec3::max).unwrap();
    let foot = (0.5 * (min + max)).with_z(min.z);
    let radius = corners()
        .map(|&corner| (corner - foot).truncate().length())
        .fold(0.0, f64::max);
    let scale = RADIUS_M / radius;
    let placed = triangles
        .iter()
        .map(|corners| Triangle::new(corners.map(|corner| scale * (corner - foot))))
        .collect();
    Body::of_triangles("mesh", placed, &albedos)
}
