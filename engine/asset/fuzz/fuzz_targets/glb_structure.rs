//! Binary glTF built from nodes, meshes and accessors that point anywhere: an error or a cloud that
//! the file accounts for.
#![no_main]

mod choices;

use choices::Choices;
use decouplegs_asset::khr_glb;
use libfuzzer_sys::fuzz_target;

const EXTENSION: &str = "KHR_gaussian_splatting";
const ATTRIBUTES: [(&str, &str); 5] = [
    ("POSITION", "VEC3"),
    ("ROTATION", "VEC4"),
    ("SCALE", "VEC3"),
    ("OPACITY", "SCALAR"),
    ("SH_DEGREE_0_COEF_0", "VEC3"),
];
const TYPES: [u64; 7] = [5126, 5120, 5121, 5122, 5123, 5125, 5127];

fuzz_target!(|bytes: &[u8]| {
    let mut choices = Choices(bytes);
    let binary = vec![0x3e; 64 * (1 + choices.one_of(64))];
    let count = choices.number();
    let (mut accessors, mut views, mut meshes, mut nodes) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for _ in 0..=choices.one_of(3) {
        let degree = choices.one_of(4);
        let rest = (1..=degree)
            .flat_map(|l| (0..2 * l + 1).map(move |n| format!("SH_DEGREE_{l}_COEF_{n}")));
        let named = ATTRIBUTES
            .iter()
            .map(|(name, kind)| ((*name).to_owned(), *kind))
            .chain(rest.map(|name| (name, "VEC3")));
        let mut attributes = Vec::new();
        for (name, kind) in named.collect::<Vec<_>>() {
            if choices.rarely() {
                continue;
            }
            let key = if name == "POSITION" {
                name
            } else {
                format!("{EXTENSION}:{name}")
            };
            attributes.push(format!("{key:?}:{}", accessors.len()));
            let kind = if choices.rarely() {
                ["SCALAR", "VEC4", "MAT4"][choices.one_of(3)]
            } else {
                kind
            };
            let component = if choices.rarely() {
                TYPES[choices.one_of(TYPES.len())]
            } else {
                TYPES[0]
            };
            let own = if choices.rarely() {
                choices.number()
            } else {
                count
            };
            let offset = if choices.rarely() {
                choices.number()
            } else {
                0
            };
            accessors.push(format!(
                "{{\"bufferView\":{},\"byteOffset\":{offset},\"componentType\":{component},\"count\":{own},\"type\":{kind:?},\"normalized\":{}}}",
                choices.one_of(4),
                choices.rarely()
            ));
        }
        meshes.push(format!(
            "{{\"primitives\":[{{\"attributes\":{{{}}},\"mode\":0,\"extensions\":{{\"{EXTENSION}\":{{}}}}}}]}}",
            attributes.join(",")
        ));
    }
    for _ in 0..4 {
        let (offset, length) = (
            if choices.rarely() {
                choices.number()
            } else {
                0
            },
            if choices.rarely() {
                choices.number()
            } else {
                binary.len() as u64
            },
        );
        let stride = if choices.rarely() {
            format!(",\"byteStride\":{}", choices.number())
        } else {
            String::new()
        };
        views.push(format!(
            "{{\"buffer\":0,\"byteOffset\":{offset},\"byteLength\":{length}{stride}}}"
        ));
    }
    for at in 0..=choices.one_of(40) {
        let child = if choices.rarely() {
            format!(",\"children\":[{}]", choices.number())
        } else {
            String::new()
        };
        let scale = if choices.rarely() {
            ",\"scale\":[0.0,-1e30,1e300]"
        } else {
            ""
        };
        nodes.push(format!(
            "{{\"mesh\":{}{child}{scale},\"translation\":[{at},0,0]}}",
            choices.one_of(meshes.len())
        ));
    }
    let scene: Vec<String> = (0..nodes.len()).map(|node| node.to_string()).collect();
    let mut text = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"scenes\":[{{\"nodes\":[{}]}}],\"nodes\":[{}],\"meshes\":[{}],\"accessors\":[{}],\"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{}}}]}}",
        scene.join(","),
        nodes.join(","),
        meshes.join(","),
        accessors.join(","),
        views.join(","),
        binary.len()
    )
    .into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut file = b"glTF".to_vec();
    let length = 12 + 8 + text.len() + 8 + binary.len();
    file.extend(
        [2, length as u32, text.len() as u32]
            .into_iter()
            .flat_map(u32::to_le_bytes),
    );
    file.extend(b"JSON");
    file.extend(text);
    file.extend((binary.len() as u32).to_le_bytes());
    file.extend(b"BIN\0");
    file.extend(binary);
    if let Ok(cloud) = khr_glb::decode(&file) {
        assert!(
            cloud.len() <= (64 << 20) / 56 + file.len(),
            "{} splats of {} bytes",
            cloud.len(),
            file.len()
        );
    }
});
