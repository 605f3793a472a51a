//! Files of one splat, whole, cut and of other trainers.

use super::*;

/// A file of one splat with the given properties, all float.
fn file(properties: &[(&str, f32)]) -> Vec<u8> {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n".to_vec();
    for (name, _) in properties {
        bytes.extend_from_slice(format!("property float {name}\n").as_bytes());
    }
    bytes.extend_from_slice(b"end_header\n");
    bytes.extend(properties.iter().flat_map(|(_, value)| value.to_le_bytes()));
    bytes
}

const ONE: [(&str, f32); 15] = [
    ("rot_3", 0.0),
    ("rot_0", 2.0),
    ("rot_2", 0.0),
    ("rot_1", 0.0),
    ("confidence", 9.0),
    ("scale_1", 0.0),
    ("scale_0", -1.0),
    ("scale_2", 1.0),
    ("opacity", f32::INFINITY),
    ("f_dc_2", 0.3),
    ("f_dc_0", 0.1),
    ("f_dc_1", 0.2),
    ("z", 3.0),
    ("x", 1.0),
    ("y", 2.0),
];

#[test]
fn properties_are_found_by_name_in_any_order() {
    let cloud = decode(&file(&ONE)).unwrap();
    assert_eq!(cloud.means, [[1.0, 2.0, 3.0]]);
    assert_eq!(cloud.rotations, [[1.0, 0.0, 0.0, 0.0]]);
    assert_eq!(
        cloud.scales,
        [[(-1.0f64).exp() as f32, 1.0, std::f32::consts::E]]
    );
    assert_eq!(
        (cloud.opacities[0], cloud.sh_dc[0], cloud.sh_degree),
        (1.0, [0.1, 0.2, 0.3], 0)
    );
    assert_eq!(cloud.defect_of(0), None);
}

#[test]
fn a_missing_property_is_named() {
    for (skipped, (name, _)) in ONE
        .iter()
        .enumerate()
        .filter(|(_, (name, _))| !["confidence", "scale_2"].contains(name))
    {
        let rest: Vec<_> = ONE
            .iter()
            .enumerate()
            .filter(|(i, _)| *i != skipped)
            .map(|(_, property)| *property)
            .collect();
        assert!(decode(&file(&rest)).unwrap_err().to_string().contains(name));
    }
}

#[test]
fn rest_coefficients_are_channel_major_and_counted() {
    for (count, degree) in [(9usize, 1u8), (24, 2), (45, 3), (72, 3)] {
        let names: Vec<String> = (0..count).map(|i| format!("f_rest_{i}")).collect();
        let mut properties = ONE.to_vec();
        properties.extend(
            names
                .iter()
                .enumerate()
                .map(|(i, name)| (name.as_str(), i as f32)),
        );
        let cloud = decode(&file(&properties)).unwrap();
        let stride = count / 3;
        assert_eq!(
            (cloud.sh_degree, cloud.sh_rest.len()),
            (degree, stride.min(15))
        );
        assert_eq!(
            cloud.rest_of(0)[1],
            [1.0, (stride + 1) as f32, (2 * stride + 1) as f32]
        );
        properties.pop();
        assert!(
            decode(&file(&properties))
                .unwrap_err()
                .to_string()
                .contains("f_rest")
        );
    }
}

#[test]
fn a_splat_that_cannot_be_drawn_does_not_fail_the_file() {
    use decouplegs_scene::SplatDefect;
    for (name, value, defect) in [
        ("x", f32::NAN, SplatDefect::Mean),
        ("scale_2", f32::INFINITY, SplatDefect::Scale),
        ("rot_0", 0.0, SplatDefect::Rotation),
        ("opacity", f32::NAN, SplatDefect::Opacity),
        ("f_dc_1", f32::NEG_INFINITY, SplatDefect::Color),
    ] {
        let changed = ONE.map(|property| {
            if property.0 == name {
                (name, value)
            } else {
                property
            }
        });
        assert_eq!(
            decode(&file(&changed)).unwrap().defect_of(0),
            Some(defect),
            "{name}"
        );
    }
}

#[test]
fn one_of_several_models_is_read_by_its_element() {
    let bytes = String::from_utf8(file(&[("x", 0.0)]))
        .unwrap()
        .replace("element vertex", "element vertex_obj_007");
    let error = decode(bytes.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("vertex_obj_007"), "{error}");
    assert!(
        decode_element(bytes.as_bytes(), "vertex_obj_007")
            .unwrap_err()
            .to_string()
            .contains("'y'")
    );
}

#[test]
fn an_empty_cloud_is_a_file() {
    let cloud = SplatCloud::with_degree(2);
    assert_eq!(decode(&encode(&cloud)).unwrap(), cloud);
}

/// [`ONE`] without the properties that `left_out` begins, and with `more`.
fn other(left_out: &[&str], more: &[(&'static str, f32)]) -> Vec<u8> {
    let kept = ONE
        .into_iter()
        .filter(|(name, _)| !left_out.iter().any(|start| name.starts_with(start)));
    file(&kept.chain(more.iter().copied()).collect::<Vec<_>>())
}

#[test]
fn files_of_other_trainers_are_read_as_they_mean() {
    let plain = decode(&file(&ONE)).unwrap();
    let flat = decode(&other(&["scale_2"], &[])).unwrap();
    assert!((flat.scales[0][2] - 1e-6).abs() < 1e-9);
    assert_eq!(flat.scales[0][..2], plain.scales[0][..2]);
    let round = decode(&other(&["scale_1", "scale_2"], &[])).unwrap();
    assert_eq!(round.scales[0], [plain.scales[0][0]; 3]);
    // Bytes of colors, whatever their order.
    let mut colored = other(&["f_dc_"], &[]);
    let end = colored
        .windows(11)
        .position(|part| part == b"end_header\n")
        .unwrap();
    let names = b"property uchar blue\nproperty uchar red\nproperty uchar green\n";
    colored.splice(end..end, names.iter().copied());
    colored.extend([0, 255, 51]);
    let dc = decode(&colored).unwrap().sh_dc[0];
    let expected = [1.0, 0.2, 0.0].map(|share: f32| (share - 0.5) / 0.282_094_79);
    assert!(
        dc.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5),
        "{dc:?}"
    );
    // A filter as wide as the smallest scale.
    let wide = decode(&other(&[], &[("filter_3D", (-1.0f32).exp())])).unwrap();
    let (before, after) = (plain.scales[0], wide.scales[0]);
    assert!((after[0] - before[0] * 2.0f32.sqrt()).abs() < 1e-6);
    let share: f32 = (0..3).map(|axis| before[axis] / after[axis]).product();
    assert!((wide.opacities[0] - plain.opacities[0] * share).abs() < 1e-6 && share < 0.7);
    for (left_out, more, part) in [
        (&["opacity"][..], &[][..], "of a trainer that leaves it out"),
        (
            &[],
            &[("trbf_center", 0.5)],
            "'trbf_center' tells of splats that appear",
        ),
        (
            &["opacity", "scale", "rot", "f_dc"],
            &[],
            "points or a mesh",
        ),
    ] {
        let message = decode(&other(left_out, more)).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn large_doubles_are_relative_to_an_origin() {
    let placed = |scalar: &str, at: [f64; 3]| {
        let rest = ONE
            .into_iter()
            .filter(|(name, _)| !["x", "y", "z"].contains(name));
        let rest: Vec<_> = rest.collect();
        let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 2\n".to_vec();
        for name in ["x", "y", "z"] {
            bytes.extend(format!("property {scalar} {name}\n").bytes());
        }
        for (name, _) in &rest {
            bytes.extend(format!("property float {name}\n").bytes());
        }
        bytes.extend(b"end_header\n");
        for step in [0.0, 0.125] {
            for value in at {
                match scalar {
                    "double" => bytes.extend((value + step).to_le_bytes()),
                    _ => bytes.extend(((value + step) as f32).to_le_bytes()),
                }
            }
            bytes.extend(rest.iter().flat_map(|(_, value)| value.to_le_bytes()));
        }
        let placed = decode_placed(&bytes).unwrap();
        (placed.cloud, placed.origin)
    };
    let (cloud, origin) = placed("double", [5e5, 5.4e6, 200.0]);
    assert_eq!(origin, DVec3::new(5e5, 5.4e6, 200.0));
    assert_eq!((cloud.means[0], cloud.means[1]), ([0.0; 3], [0.125; 3]));
    // Small ones, and floats, stay as they are.
    let (cloud, origin) = placed("double", [50.0, -1.0, 2.0]);
    assert_eq!((cloud.means[0], origin), ([50.0, -1.0, 2.0], DVec3::ZERO));
    let (cloud, origin) = placed("float", [5e5, 5.4e6, 200.0]);
    assert_eq!((cloud.means[0], origin), ([5e5, 5.4e6, 200.0], DVec3::ZERO));
}
