//! Checkpoints built as trainers build them, with shapes, strides, offsets and storages that lie:
//! an error or a scene.
#![no_main]

mod choices;

use choices::Choices;
use decouplegs_asset::checkpoint;
use decouplegs_asset::scene_import::{ImportOptions, decode_checkpoint};
use decouplegs_asset::zip::StoredZip;
use libfuzzer_sys::fuzz_target;

/// Names of tensors of the three trainers.
const GSPLAT: [&str; 6] = ["means", "scales", "quats", "opacities", "sh0", "shN"];
const DRIVESTUDIO: [&str; 6] = [
    "_means",
    "_scales",
    "_quats",
    "_opacities",
    "_features_dc",
    "_features_rest",
];
const RIGID: [&str; 4] = [
    "points_ids",
    "instances_trans",
    "instances_quats",
    "instances_fv",
];
const STREET: [&str; 6] = [
    "xyz",
    "scaling",
    "rotation",
    "opacity",
    "feature_dc",
    "feature_rest",
];
/// Last dimensions as they should be.
const WIDTHS: [&[u64]; 6] = [&[3], &[3], &[4], &[1], &[1, 3], &[0, 3]];
const CLASSES: [&str; 5] = [
    "FloatStorage",
    "HalfStorage",
    "DoubleStorage",
    "LongStorage",
    "BoolStorage",
];

struct Pickle {
    bytes: Vec<u8>,
}

impl Pickle {
    fn text(&mut self, text: &str) {
        self.bytes.push(b'X');
        self.bytes.extend((text.len() as u32).to_le_bytes());
        self.bytes.extend(text.bytes());
    }

    fn number(&mut self, number: u64) {
        let bytes = number.to_le_bytes();
        // A byte more, so that large ones stay positive.
        self.bytes.extend([0x8a, 8]);
        self.bytes.extend(bytes);
    }

    fn numbers(&mut self, numbers: &[u64]) {
        self.bytes.push(b'(');
        numbers.iter().for_each(|&number| self.number(number));
        self.bytes.push(b't');
    }

    fn global(&mut self, module: &str, name: &str) {
        self.bytes.push(b'c');
        self.bytes.extend(format!("{module}\n{name}\n").bytes());
    }

    /// A tensor over storage `key`.
    fn tensor(&mut self, class: &str, key: &str, offset: u64, shape: &[u64], strides: &[u64]) {
        self.global("torch._utils", "_rebuild_tensor_v2");
        self.bytes.extend(b"((");
        self.text("storage");
        self.global("torch", class);
        self.text(key);
        self.text("cpu");
        self.number(64);
        self.bytes.extend(b"tQ");
        self.number(offset);
        self.numbers(shape);
        self.numbers(strides);
        self.bytes.extend(b"tR");
    }

    fn dictionary(&mut self, fill: impl FnOnce(&mut Self)) {
        self.bytes.extend(b"}(");
        fill(self);
        self.bytes.push(b'u');
    }
}

fn strides_of(shape: &[u64]) -> Vec<u64> {
    (0..shape.len())
        .map(|at| {
            shape[at + 1..]
                .iter()
                .fold(1u64, |product, &size| product.wrapping_mul(size.max(1)))
        })
        .collect()
}

fn tensors(pickle: &mut Pickle, choices: &mut Choices<'_>, names: &[&str], count: u64) {
    for (at, name) in names.iter().enumerate() {
        if choices.rarely() {
            continue;
        }
        let mut shape = vec![if choices.rarely() {
            choices.number()
        } else {
            count
        }];
        shape.extend(WIDTHS[at % WIDTHS.len()]);
        if choices.rarely() {
            let place = choices.one_of(shape.len());
            shape[place] = choices.number();
        }
        let mut strides = strides_of(&shape);
        if choices.rarely() {
            let place = choices.one_of(strides.len());
            strides[place] = choices.number();
        }
        let offset = if choices.rarely() {
            choices.number()
        } else {
            0
        };
        let class = CLASSES[if choices.rarely() {
            choices.one_of(CLASSES.len())
        } else {
            0
        }];
        let key = ["0", "1", "2"][choices.one_of(3)];
        pickle.text(name);
        pickle.tensor(class, key, offset, &shape, &strides);
    }
}

/// Poses of `frames` and `instances`.
fn rigid(pickle: &mut Pickle, choices: &mut Choices<'_>, count: u64) {
    let (frames, instances) = (choices.number(), choices.number());
    let shapes = [
        vec![count, 1],
        vec![frames, instances, 3],
        vec![frames, instances, 4],
        vec![frames, instances],
    ];
    for (name, shape) in RIGID.iter().zip(shapes) {
        let strides = strides_of(&shape);
        pickle.text(name);
        pickle.tensor(
            "FloatStorage",
            ["0", "2"][choices.one_of(2)],
            0,
            &shape,
            &strides,
        );
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut choices = Choices(bytes);
    let mut pickle = Pickle {
        bytes: vec![0x80, 2],
    };
    let count = choices.number().min(1 << 20);
    match choices.one_of(3) {
        0 => pickle.dictionary(|pickle| {
            pickle.text("splats");
            pickle.dictionary(|pickle| tensors(pickle, &mut choices, &GSPLAT, count));
        }),
        1 => pickle.dictionary(|pickle| {
            pickle.text("models");
            pickle.dictionary(|pickle| {
                for name in ["Background", "RigidNodes"] {
                    pickle.text(name);
                    pickle.dictionary(|pickle| {
                        tensors(pickle, &mut choices, &DRIVESTUDIO, count);
                        rigid(pickle, &mut choices, count);
                    });
                }
            });
        }),
        _ => pickle.dictionary(|pickle| {
            for at in 0..=choices.one_of(12) {
                pickle.text(&if at == 0 {
                    "background".to_owned()
                } else {
                    format!("obj_{at:03}")
                });
                pickle.dictionary(|pickle| tensors(pickle, &mut choices, &STREET, count));
            }
        }),
    }
    pickle.bytes.push(b'.');
    let mut zip = StoredZip::new(Vec::new());
    zip.add("a/data.pkl", &pickle.bytes)
        .expect("a name like any other");
    for (key, length) in [("0", 4096), ("1", 0), ("2", choices.one_of(256) * 64)] {
        zip.add(&format!("a/data/{key}"), &vec![0x3f; length])
            .expect("a name like any other");
    }
    let file = zip.finish().expect("a Vec takes every write");
    let _ = checkpoint::decode(&file);
    if let Ok(Some(scene)) = decode_checkpoint(&file, &ImportOptions::default()) {
        assert!(
            scene
                .actors
                .iter()
                .map(|actor| actor.splats.len())
                .sum::<usize>()
                < 1 << 24
        );
    }
});
