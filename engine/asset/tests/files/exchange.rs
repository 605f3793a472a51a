//! SOG, binary glTF and checkpoints: what is written is read, what others wrote too.

use decouplegs_asset::zip::StoredZip;
use decouplegs_asset::{checkpoint, khr_glb, read_splats, sog};
use decouplegs_scene::SplatCloud;

use crate::data::data;
use crate::errors::Errors;
use crate::sample::{cloud, cone};

#[test]
fn a_sog_reads_back_within_its_quantization() {
    for degree in 0..=3 {
        let original = cloud(300, degree);
        let (bytes, order) = sog::encode(&original).unwrap();
        let errors = Errors::between(&original.select(&order), &sog::decode(&bytes).unwrap());
        println!("degree {degree}: {errors:?}");
        // 16 bits of ln(1 + 40 m), either sign, and its slope out there; half a step of sqrt(2)/255
        // in three components.
        assert!(
            errors.mean_m < 41.0 * 2.0 * 41f32.ln() / 65_535.0,
            "{errors:?}"
        );
        assert!(
            errors.angle_rad < 4.0 * 3f64.sqrt() * std::f64::consts::SQRT_2 / 510.0,
            "{errors:?}"
        );
        assert!(errors.opacity <= 0.501 / 255.0, "{errors:?}");
        // 256 numbers over a range of 6 (scales), 3 (DC) and 1.2.
        assert!(
            errors.scale_ln < 6.0 / 128.0 && errors.dc < 3.0 / 128.0 && errors.rest < 1.2 / 128.0,
            "{errors:?}"
        );
    }
}

#[test]
fn splats_of_a_sog_stand_in_the_order_that_is_told() {
    // More rows than a band has, and a last row that is not full.
    let original = cloud(9001, 1);
    let (bytes, order) = sog::encode(&original).unwrap();
    let mut splats = order.clone();
    splats.sort_unstable();
    assert!(splats.into_iter().eq(0..9001));
    let back = sog::decode(&bytes).unwrap();
    let ordered = Errors::between(&original.select(&order), &back);
    assert!(
        ordered.opacity <= 0.501 / 255.0 && ordered.rest < 1.2 / 128.0,
        "{ordered:?}"
    );
    let unordered = Errors::between(&original, &back);
    assert!(unordered.opacity > 0.1, "{unordered:?}");
}

#[test]
fn writing_a_sog_again_changes_nothing_more() {
    let once = sog::decode(&sog::encode(&cloud(100, 2)).unwrap().0).unwrap();
    let (bytes, order) = sog::encode(&once).unwrap();
    let (once, twice) = (once.select(&order), sog::decode(&bytes).unwrap());
    assert_eq!(
        (&once.sh_dc, &once.sh_rest, &once.opacities),
        (&twice.sh_dc, &twice.sh_rest, &twice.opacities)
    );
    let errors = Errors::between(&once, &twice);
    assert!(
        errors.mean_m < 1e-4 && errors.scale_ln < 1e-6 && errors.angle_rad < 0.02,
        "{errors:?}"
    );
}

#[test]
fn a_sog_is_read_from_its_folder_too() {
    let (zip, folder) = (
        crate::sample::seed("sog/cone.sog"),
        tempfile::tempdir().unwrap(),
    );
    let cloud = cone();
    let (bytes, _) = sog::encode(&cloud).unwrap();
    // Stored entries, one behind the other: names and sizes stand in their local headers.
    let mut at = 0;
    while bytes[at..].starts_with(b"PK\x03\x04") {
        let word = |from: usize| {
            u32::from_le_bytes(bytes[at + from..at + from + 4].try_into().unwrap()) as usize
        };
        let half = |from: usize| {
            u16::from_le_bytes(bytes[at + from..at + from + 2].try_into().unwrap()) as usize
        };
        let (size, name, extra) = (word(18), half(26), half(28));
        let name = std::str::from_utf8(&bytes[at + 30..at + 30 + name]).unwrap();
        let start = at + 30 + name.len() + extra;
        assert_eq!(start % 64, 0, "{name} is aligned");
        std::fs::write(folder.path().join(name), &bytes[start..start + size]).unwrap();
        at = start + size;
    }
    let unzipped = read_splats(folder.path()).unwrap();
    assert_eq!(
        unzipped,
        read_splats(&folder.path().join("meta.json")).unwrap()
    );
    assert_eq!(unzipped, sog::decode(&bytes).unwrap());
    assert_eq!(unzipped.len(), read_splats(&zip).unwrap().len());
    std::fs::remove_file(folder.path().join("quats.webp")).unwrap();
    assert!(
        read_splats(folder.path())
            .unwrap_err()
            .to_string()
            .contains("quats.webp")
    );
}

#[test]
fn other_zips_and_other_sogs_are_explained() {
    let zip = |name: &str, content: &str| {
        let mut zip = StoredZip::new(Vec::new());
        zip.add(name, content.as_bytes()).unwrap();
        zip.finish().unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes, part) in [
        ("a.zip", zip("readme", ""), "neither"),
        ("a.usdz", zip("default.usda", ""), "USDZ"),
        ("a.sog", zip("meta.json", "{\"means\":{}}"), "version 1"),
        ("b.sog", zip("meta.json", "{\"version\":3}"), "version 3"),
        ("c.sog", zip("meta.json", "{\"version\":2}"), "count"),
        ("d.sog", b"PK\x03\x04".to_vec(), "directory"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = read_splats(&path).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(part), "{error}");
    }
    let many = SplatCloud {
        sh_rest: vec![[0.0; 3]; 3 * 65_537],
        sh_degree: 1,
        ..cloud(65_537, 0)
    };
    // More than the palette has entries: coefficients that are alike share them.
    let read = sog::decode(&sog::encode(&many).unwrap().0).unwrap();
    assert!(
        read.sh_rest.len() == many.sh_rest.len()
            && read.sh_rest.iter().all(|rest| *rest == [0.0; 3])
    );
    assert!(
        sog::encode(&SplatCloud::default()).is_err()
            && khr_glb::encode(&SplatCloud::default()).is_err()
    );
}

#[test]
fn a_glb_reads_back_to_the_bit() {
    for degree in 0..=3 {
        let original = cloud(40, degree);
        let back = khr_glb::decode(&khr_glb::encode(&original).unwrap()).unwrap();
        let errors = Errors::between(&original, &back);
        assert_eq!(
            (&back.means, &back.scales, &back.opacities),
            (&original.means, &original.scales, &original.opacities)
        );
        assert_eq!(
            (&back.sh_dc, &back.sh_rest),
            (&original.sh_dc, &original.sh_rest)
        );
        assert!(errors.angle_rad < 1e-6, "{errors:?}");
    }
}

#[test]
fn a_glb_has_y_up() {
    let original = cloud(7, 3);
    let file = khr_glb::encode(&original).unwrap();
    let text = String::from_utf8_lossy(&file).into_owned();
    assert!(
        text.contains("\"nodes\":[{\"mesh\":0}]"),
        "no node turns it back"
    );
    // Positions are the first rows of the binary chunk, behind the text.
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let positions = &file[20 + length + 8..];
    for (splat, [x, y, z]) in original.means.iter().enumerate() {
        let stored = [0, 1, 2].map(|axis| {
            let at = 12 * splat + 4 * axis;
            f32::from_le_bytes(positions[at..at + 4].try_into().unwrap())
        });
        assert_eq!(stored, [-x, -y, *z], "y is down in a cloud");
    }
}

/// A file whose text says `to` where it said `from`, lengths to match.
fn glb_with(file: &[u8], from: &str, to: &str) -> Vec<u8> {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let mut text = std::str::from_utf8(&file[20..20 + length])
        .unwrap()
        .replace(from, to)
        .into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let rest = &file[20 + length..];
    let mut changed = file[..8].to_vec();
    changed.extend_from_slice(&((20 + text.len() + rest.len()) as u32).to_le_bytes());
    changed.extend_from_slice(&(text.len() as u32).to_le_bytes());
    changed.extend_from_slice(b"JSON");
    [changed, text, rest.to_vec()].concat()
}

#[test]
fn scales_below_zero_are_the_logarithms_of_the_drafts() {
    let mut original = cloud(40, 0);
    original
        .scales
        .iter_mut()
        .for_each(|scales| *scales = scales.map(|scale| scale.min(0.5)));
    let mut stored = original.clone();
    stored
        .scales
        .iter_mut()
        .for_each(|scales| *scales = scales.map(f32::ln));
    // Not through the writer, which refuses negative scales.
    let file = khr_glb::encode(&original).unwrap();
    let [from, to] = [&original, &stored].map(|cloud| {
        cloud
            .scales
            .as_flattened()
            .iter()
            .flat_map(|s| s.to_le_bytes())
            .collect::<Vec<u8>>()
    });
    let at = file
        .windows(from.len())
        .position(|window| window == from)
        .unwrap();
    let draft = [&file[..at], &to, &file[at + from.len()..]].concat();
    let errors = Errors::between(&original, &khr_glb::decode(&draft).unwrap());
    assert!(errors.scale_ln < 1e-6, "{errors:?}");
}

#[test]
fn nodes_place_what_they_show_as_often_as_they_show_it() {
    let file = khr_glb::encode(&cloud(5, 3)).unwrap();
    let twice = glb_with(
        &file,
        "\"nodes\":[{\"mesh\":0}]",
        "\"nodes\":[{\"children\":[1,2],\"translation\":[1,0,0]},{\"mesh\":0},{\"mesh\":0,\"rotation\":[0,0,0.70710678,0.70710678],\"scale\":[2,2,2]}]",
    );
    let placed = khr_glb::decode(&twice).unwrap();
    assert_eq!(placed.len(), 10);
    let original = cloud(5, 3);
    for splat in 0..5 {
        let [x, y, z] = original.means[splat];
        let [moved, turned] = [placed.means[splat], placed.means[splat + 5]];
        // One meter and half a turn of the file's axes are -1 m in those of the cloud.
        assert!((moved[0] - x + 1.0).abs() < 1e-5 && moved[1] == y && moved[2] == z);
        let expected = [-1.0 - 2.0 * y, 2.0 * x, 2.0 * z];
        assert!(
            (0..3).all(|axis| (turned[axis] - expected[axis]).abs() < 1e-4),
            "{turned:?} {expected:?}"
        );
        assert!((placed.scales[splat + 5][1] / original.scales[splat][1] - 2.0).abs() < 1e-5);
    }
    assert_ne!(placed.rest_of(0), placed.rest_of(5), "colors turn too");
    for (nodes, part) in [
        ("[{\"children\":[0]}]", "below itself"),
        ("[{\"children\":[1,1]},{\"mesh\":0}]", "below two"),
        ("[{\"mesh\":7}]", "no mesh 7"),
        ("[{\"children\":[9]}]", "no node 9"),
        ("[{\"mesh\":0,\"scale\":[0,1,1]}]", "flattens"),
        ("[{}]", "nothing"),
    ] {
        let error = khr_glb::decode(&glb_with(&file, "[{\"mesh\":0}]", nodes))
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{nodes}: {error}");
    }
}

#[test]
fn a_glb_that_claims_too_much_is_refused() {
    let file = khr_glb::encode(&cloud(5, 1)).unwrap();
    for (from, to) in [
        ("\"count\":5", "\"count\":4000000000"),
        ("\"count\":5", "\"count\":18446744073709551615"),
        ("\"byteOffset\":0", "\"byteOffset\":18446744073709551615"),
        ("\"VEC3\"", "\"MAT4\""),
        ("5126", "5125"),
        ("\"buffer\":0", "\"buffer\":1"),
        ("\"mode\":0", "\"mode\":[]]"),
    ] {
        assert!(
            khr_glb::decode(&glb_with(&file, from, to)).is_err(),
            "{from} -> {to}"
        );
    }
    // Many nodes that show the same splats.
    let nodes: Vec<String> = (0..9000).map(|_| "{\"mesh\":0}".to_owned()).collect();
    let roots: Vec<String> = (0..9000).map(|node| node.to_string()).collect();
    let many = glb_with(
        &khr_glb::encode(&cloud(500, 0)).unwrap(),
        "[{\"mesh\":0}]",
        &format!("[{}]", nodes.join(",")),
    );
    let many = glb_with(
        &many,
        "\"scenes\":[{\"nodes\":[0]}]",
        &format!("\"scenes\":[{{\"nodes\":[{}]}}]", roots.join(",")),
    );
    assert!(
        khr_glb::decode(&many)
            .unwrap_err()
            .to_string()
            .contains("believed")
    );
}

#[test]
fn real_files_of_others_are_read() {
    if let Some(path) = data("splats/statue_angel.sog") {
        let cloud = read_splats(&path).unwrap();
        let bounds = cloud.bounds();
        println!(
            "statue_angel.sog: {} splats within {:?} to {:?}",
            cloud.len(),
            bounds.min,
            bounds.max
        );
        assert_eq!((cloud.len(), cloud.sh_degree), (71_359, 0));
        assert!((0..cloud.len()).all(|splat| cloud.defect_of(splat).is_none()));
        // The extent of meta.json, unlogged: x from -0.5807 to 0.5913.
        assert!((f64::from(bounds.min[0]) + 0.580_741_9f64.exp_m1()).abs() < 1e-5);
        assert!((f64::from(bounds.max[0]) - 0.591_317_2f64.exp_m1()).abs() < 1e-5);
    }
    if let Some(path) = data("splats/khr_conformance_matrix.glb") {
        let bytes = std::fs::read(&path).unwrap();
        let cloud = khr_glb::decode(&bytes).unwrap();
        assert_eq!((cloud.len(), cloud.sh_degree), (15, 3));
        // Half a turn about z: y is up in the file, and down in a cloud.
        assert!(cloud.means.iter().all(|mean| *mean == [-1.0, -2.0, 3.0]));
        // A draft: scales are logarithms, whole or normalized integers.
        let scale = |splat: usize| cloud.scales[splat].map(|scale| f64::from(scale).ln());
        let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3);
        assert!(
            close(scale(4), [1.0, -2.0, 3.0]) && close(scale(5), [1.0, 0.0, -1.0]),
            "{:?}",
            scale(4)
        );
        assert!(
            (cloud.opacities[9] - 64.0 / 255.0).abs() < 1e-6
                && (cloud.opacities[8] - 0.75).abs() < 1e-6
        );
        // x first: half a turn about x.
        assert_eq!(cloud.rotations[0], [0.0, -1.0, 0.0, 0.0]);
        assert!(
            cloud.rest_of(14).iter().any(|c| *c != [0.0; 3])
                && cloud.rest_of(0).iter().all(|c| *c == [0.0; 3])
        );
        assert!(khr_glb::read_notes(&bytes).unwrap()[0].contains("lin_rec709_display"));
    }
}

#[test]
fn a_checkpoint_of_gsplat_is_its_cloud_and_one_that_runs_something_is_refused() {
    let bytes = std::fs::read(crate::sample::seed("checkpoint/cone.pt")).unwrap();
    let errors = Errors::between(&cone(), &checkpoint::decode(&bytes).unwrap());
    assert!(
        errors.mean_m == 0.0 && errors.rest == 0.0 && errors.dc == 0.0,
        "{errors:?}"
    );
    let pickled = |pickle: &[u8]| {
        let mut zip = StoredZip::new(Vec::new());
        zip.add("a/data.pkl", pickle).unwrap();
        zip.finish().unwrap()
    };
    for (pickle, part) in [
        (
            &b"\x80\x02cposix\nsystem\nX\x02\x00\x00\x00id\x85R."[..],
            "Nothing was run",
        ),
        (b"\x80\x02}.", "expected a checkpoint of gsplat"),
        (b"\x80\x02}X\x06\x00\x00\x00splats}s.", "no 'means'"),
        (b"\x80\x02", "the pickle"),
    ] {
        let error = checkpoint::decode(&pickled(pickle))
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{error}");
    }
    let old = checkpoint::decode(b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.")
        .unwrap_err()
        .to_string();
    assert!(old.contains("before 1.6"), "{old}");
}
