//! `checkpoint.ckpt` of a NuRec package: the arrays of `volume.nurec` as PyTorch saves them. No
//! real one could be had: this one is written after its public readers, by `torch.save`'s layout.

use decouplegs_scene::Pose;

use crate::nurec::{Packed, State, package, read, rig, state, tracks, turned, zip};
use crate::sample::cloud;

/// A pickle of protocol 2, and the storages that it names.
#[derive(Default)]
struct Pickle {
    bytes: Vec<u8>,
    storages: Vec<Vec<u8>>,
}

impl Pickle {
    fn text(&mut self, text: &str) {
        self.bytes.push(b'X');
        self.bytes.extend((text.len() as u32).to_le_bytes());
        self.bytes.extend(text.bytes());
    }

    fn global(&mut self, module: &str, name: &str) {
        self.bytes.extend(format!("c{module}\n{name}\n").bytes());
    }

    fn integer(&mut self, value: usize) {
        self.bytes.push(b'J');
        self.bytes.extend((value as i32).to_le_bytes());
    }

    fn integers(&mut self, values: &[usize]) {
        self.bytes.push(b'(');
        values.iter().for_each(|value| self.integer(*value));
        self.bytes.push(b't');
    }

    /// A call of `torch._utils._rebuild_tensor_v2` with a persistent id for the storage.
    fn tensor(&mut self, name: &str, shape: &[usize], numbers: &[u8]) {
        let (storage, width) = if name.ends_with("_cuboid_ids") {
            ("IntStorage", 4)
        } else if name.ends_with("n_active_features") {
            ("LongStorage", 8)
        } else {
            ("HalfStorage", 2)
        };
        self.global("torch._utils", "_rebuild_tensor_v2");
        self.bytes.extend(b"((");
        self.text("storage");
        self.global("torch", storage);
        self.text(&self.storages.len().to_string());
        self.text("cuda:0");
        self.integer(numbers.len() / width);
        self.bytes.extend(b"tQ");
        self.storages.push(numbers.to_vec());
        self.integer(0);
        self.integers(shape);
        let strides = (0..shape.len()).map(|side| shape[side + 1..].iter().product());
        self.integers(&strides.collect::<Vec<_>>());
        self.bytes.push(0x89);
        self.global("collections", "OrderedDict");
        self.bytes.extend(b")RtR");
    }
}

/// The checkpoint of `state`, its names behind `start`, and the tracks `ids` of its agents.
fn checkpoint(state: &State, start: &str, ids: &[&str]) -> Vec<u8> {
    let mut pickle = Pickle::default();
    pickle.bytes.extend(b"\x80\x02}(");
    pickle.text("epoch");
    pickle.integer(7);
    pickle.text("state_dict");
    pickle.bytes.extend(b"}(");
    for (name, value) in state {
        let Packed::Bytes(numbers) = value else {
            continue;
        };
        let Some(Packed::Sizes(shape)) = state.get(&format!("{name}.shape")) else {
            panic!("{name} has no shape")
        };
        pickle.text(&format!("{start}{name}"));
        pickle.tensor(name, shape, numbers);
    }
    pickle.text(&format!("{start}._extra_state"));
    pickle.bytes.extend(b"}(");
    pickle.text("obj_track_ids");
    pickle.bytes.extend(b"}(");
    pickle.text("dynamic_rigids");
    pickle.bytes.extend(b"](");
    ids.iter().for_each(|id| pickle.text(id));
    // The list of ids, and the dictionaries about it from within.
    pickle.bytes.extend(b"euuuu.");
    let mut entries = vec![("archive/data.pkl".to_owned(), pickle.bytes)];
    let storages = pickle.storages.into_iter().enumerate();
    entries.extend(storages.map(|(key, numbers)| (format!("archive/data/{key}"), numbers)));
    entries.push(("archive/byteorder".into(), b"little".to_vec()));
    entries.push(("archive/version".into(), b"3\n".to_vec()));
    let entries: Vec<(&str, Vec<u8>)> = entries
        .iter()
        .map(|(name, content)| (name.as_str(), content.clone()))
        .collect();
    zip(&entries)
}

fn package_of(checkpoint: Vec<u8>, nre_from_world: &Pose) -> Vec<u8> {
    zip(&[
        ("checkpoint.ckpt", checkpoint),
        ("rig_trajectories.json", rig(nre_from_world)),
        ("sequence_tracks.json", tracks()),
        ("metadata.yaml", b"scene_id: drive-a\nuuid: x\n".to_vec()),
    ])
}

#[test]
fn a_checkpoint_has_the_scene_of_its_volume() {
    let nre_from_world = turned();
    let state = state(&cloud(40, 3), &cloud(30, 1), &nre_from_world);
    let expected = read(&package(&nre_from_world));
    for start in ["model", ""] {
        let checkpoint = checkpoint(&state, start, &["17", "absent/../x", "unknown"]);
        let found = read(&package_of(checkpoint, &nre_from_world));
        assert_eq!(found.background, expected.background);
        assert_eq!(found.sky, expected.sky);
        assert_eq!(found.rig, expected.rig);
        assert_eq!(found.ground, expected.ground);
        assert_eq!(found.notes, expected.notes);
        let names = |scene: &decouplegs_asset::scene_import::ImportedScene| -> Vec<String> {
            scene
                .actors
                .iter()
                .map(|actor| actor.name.clone())
                .collect()
        };
        assert_eq!(names(&found), names(&expected));
        for (found, expected) in found.actors.iter().zip(&expected.actors) {
            assert_eq!(found.splats, expected.splats);
        }
    }
}

#[test]
fn a_broken_checkpoint_gets_a_sentence() {
    let mut state = state(&cloud(40, 3), &cloud(30, 1), &Pose::IDENTITY);
    state.insert(
        ".gaussians_nodes.background.positions.shape".into(),
        Packed::Sizes(vec![1 << 30, 3]),
    );
    let bytes = package_of(checkpoint(&state, "model", &["17"]), &Pose::IDENTITY);
    let error = decouplegs_asset::scene_import::decode_nurec(&bytes).unwrap_err();
    assert!(error.to_string().contains("positions"), "{error}");
}
