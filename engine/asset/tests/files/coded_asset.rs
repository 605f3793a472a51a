//! Coded assets: what their files hold, and broken ones, each refused with a sentence that names
//! what is wrong.

use decouplegs_asset::{
    AssetError, CodedAsset, CodedSummary, Provenance, coded_asset, read_coded, write_coded,
};
use decouplegs_scene::{CodedSplat, ShFrame, SplatCloud};
use glam::{DMat3, DQuat, DVec3};
use safetensors::{Dtype, SafeTensors};
use serde_json::{Value, json};

use crate::sample::{self, coded_cone, cone};

/// A file taken apart: its header, and its tensors' bytes.
struct Parts {
    header: Value,
    data: Vec<u8>,
}

impl Parts {
    fn read(bytes: &[u8]) -> Self {
        let end = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        Self {
            header: serde_json::from_slice(&bytes[8..end]).unwrap(),
            data: bytes[end..].to_vec(),
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let header = self.header.to_string();
        [
            &(header.len() as u64).to_le_bytes(),
            header.as_bytes(),
            &self.data,
        ]
        .concat()
    }

    /// The bytes of one tensor.
    fn tensor(&mut self, name: &str) -> &mut [u8] {
        let offset = |i: usize| self.header[name]["data_offsets"][i].as_u64().unwrap() as usize;
        let (start, end) = (offset(0), offset(1));
        &mut self.data[start..end]
    }
}

/// Error message for the cone's file after `change`.
fn complaint(change: impl Fn(&mut Parts)) -> String {
    let mut parts = Parts::read(&coded_asset::encode(&coded_cone()).unwrap());
    change(&mut parts);
    coded_asset::decode(&parts.to_bytes())
        .expect_err("a broken file must be refused")
        .to_string()
}

#[test]
fn the_seed_is_the_cone_and_is_written_the_same_every_time() {
    let seed = std::fs::read(sample::seed("coded_asset/cone.safetensors")).unwrap();
    assert_eq!(coded_asset::decode(&seed).unwrap(), coded_cone());
    assert!(
        coded_asset::encode(&coded_cone()).unwrap() == seed,
        "the writer no longer writes version 1 as it did"
    );
}

/// The covariance of one splat, in f64.
fn covariance(cloud: &SplatCloud, splat: usize) -> DMat3 {
    let [w, x, y, z] = cloud.rotations[splat].map(f64::from);
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let scales = DVec3::from_array(cloud.scales[splat].map(f64::from));
    axes * DMat3::from_diagonal(scales * scales) * axes.transpose()
}

#[test]
fn the_cone_is_the_cone_but_for_places_and_opacities() {
    let (cone, decoded) = (cone(), coded_cone().cloud.decoded(0));
    assert_eq!(
        (&decoded.sh_dc, &decoded.sh_rest),
        (&cone.sh_dc, &cone.sh_rest),
        "its colors are half floats"
    );
    for splat in 0..cone.len() {
        let step = coded_cone().cloud.position_step_m();
        for (axis, step_m) in step.into_iter().enumerate() {
            // Half a step, and the roundings of two f32 sums near 2.5 m.
            let error_m = (decoded.means[splat][axis] - cone.means[splat][axis]).abs();
            assert!(error_m <= 0.5 * step_m + 5e-7, "{splat}: {error_m} m");
        }
        assert!((decoded.opacities[splat] - cone.opacities[splat]).abs() <= 0.5001 / 255.0);
        let (found, expected) = (covariance(&decoded, splat), covariance(&cone, splat));
        let error = (found - expected)
            .abs()
            .to_cols_array()
            .into_iter()
            .fold(0.0, f64::max);
        let largest = expected
            .abs()
            .to_cols_array()
            .into_iter()
            .fold(0.0, f64::max);
        assert!(error <= 1e-6 * largest, "{splat}: {error} of {largest}");
    }
    assert_eq!(
        coded_cone().cloud.decoded(1).means[1],
        decoded.means[3],
        "every third splat again"
    );
}

#[test]
fn the_public_reader_sees_twelve_bytes_a_splat_and_two_codebooks() {
    let bytes = coded_asset::encode(&coded_cone()).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let splats = 16;
    let mut splat_bytes = 0;
    for (name, dtype, shape) in [
        ("positions", Dtype::U16, vec![splats, 3]),
        ("opacities", Dtype::U8, vec![splats]),
        ("sizes", Dtype::U8, vec![splats]),
        ("codes", Dtype::U32, vec![splats]),
        ("shapes", Dtype::F32, vec![12, 6]),
        ("colours", Dtype::F16, vec![12, 16, 3]),
        ("levels", Dtype::U32, vec![2]),
    ] {
        let tensor = file.tensor(name).unwrap();
        assert_eq!(
            (tensor.dtype(), tensor.shape()),
            (dtype, shape.as_slice()),
            "{name}"
        );
        let offset = tensor.data().as_ptr() as usize - bytes.as_ptr() as usize;
        assert_eq!(
            offset % (dtype.bitsize() / 8),
            0,
            "{name} is aligned in the file"
        );
        splat_bytes += if shape[0] == splats {
            tensor.data().len()
        } else {
            0
        };
    }
    assert_eq!((file.len(), splat_bytes), (7, 12 * splats));
}

#[test]
fn a_file_is_written_and_read_with_its_provenance() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cone.safetensors");
    write_coded(&path, &coded_cone()).unwrap();
    assert_eq!(read_coded(&path).unwrap(), coded_cone());
    // sha256sum of the same bytes.
    let provenance = Provenance::of_source("abc.ply", b"abc");
    assert_eq!(
        provenance.source_sha256,
        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    );
    std::fs::write(&path, b"short").unwrap();
    let error = read_coded(&path).unwrap_err().to_string();
    assert!(
        error.contains("cone.safetensors")
            && error.contains("coded asset")
            && error.contains("needs 8 bytes"),
        "{error}"
    );
}

#[test]
fn a_summary_counts_levels_and_bytes() {
    let summary = CodedSummary::new(&coded_cone(), 1600);
    assert_eq!(
        (summary.levels.as_slice(), summary.shapes, summary.colors),
        ([12, 4].as_slice(), 12, 12)
    );
    assert_eq!(
        (
            summary.bytes_per_splat,
            summary.sh_frame,
            summary.finest.splats
        ),
        (Some(100.0), "world", 12)
    );
    let json = serde_json::to_value(&summary).unwrap();
    assert_eq!(
        (&json["splats"], &json["settings"]["keep_ratio"]),
        (&json!(12), &json!("1"))
    );
}

#[test]
fn what_a_file_cannot_hold_is_refused_before_it_is_written() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("broken.safetensors");
    let refused = |change: fn(&mut CodedAsset)| {
        let mut asset = coded_cone();
        change(&mut asset);
        let error = write_coded(&path, &asset).unwrap_err();
        assert!(matches!(error, AssetError::Encode { .. }) && !path.exists());
        error.to_string()
    };
    assert!(refused(|asset| asset.cloud.colors[5][1] = 65_520.0).contains("65520"));
    assert!(refused(|asset| asset.cloud.shapes[0][0] = f32::NAN).contains("NaN"));
    assert!(
        refused(|asset| asset.cloud.splats[0] = CodedSplat([0, 0, 0x1ff]))
            .contains("shape 511 of 12")
    );
    assert!(refused(|asset| asset.cloud.dims_m[0] = -1.0).contains("dims_m"));
    let settings = |asset: &mut CodedAsset| {
        asset
            .provenance
            .settings
            .insert("essay".into(), "x".repeat(1 << 20));
    };
    assert!(refused(settings).contains("at most 1048576"));
}

#[test]
fn broken_headers_are_explained() {
    let whole = coded_asset::encode(&coded_cone()).unwrap();
    let after = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = whole.clone();
        change(&mut bytes);
        coded_asset::decode(&bytes).unwrap_err().to_string()
    };
    for claimed in [1 << 20, whole.len() as u64 - 7] {
        assert!(
            after(&|bytes| bytes[..8].copy_from_slice(&claimed.to_le_bytes()))
                .contains("header needs"),
            "{claimed}"
        );
    }
    for claimed in [(1 << 20) + 1, u64::from(u32::MAX), u64::MAX] {
        assert!(
            after(&|bytes| bytes[..8].copy_from_slice(&claimed.to_le_bytes())).contains("at most"),
            "{claimed}"
        );
    }
    assert!(after(&|bytes| bytes.push(0)).contains("1 bytes follow the last tensor"));
    assert!(after(&|bytes| bytes.truncate(bytes.len() - 1)).contains("the tensors needs"));
    assert!(after(&|bytes| bytes[8] = b'[').contains("the header:"));
    assert!(after(&|bytes| bytes[20] = 0xff).contains("the header:"));
    // Eight sizes whose sum is seven short of what 64 bits hold: adding the header to it would
    // overflow.
    let most = u64::MAX / 8;
    let tensor = |i: u64| json!({ "dtype": "U8", "shape": [most], "data_offsets": [i * most, (i + 1) * most] });
    let header = Value::Object((0..8).map(|i| (i.to_string(), tensor(i))).collect());
    let said = coded_asset::decode(
        &Parts {
            header,
            data: Vec::new(),
        }
        .to_bytes(),
    )
    .unwrap_err()
    .to_string();
    assert!(
        said.contains(&format!("{} bytes, found 0", 8 * most)),
        "{said}"
    );
}

#[test]
fn tensors_that_are_not_as_they_should_be_are_named() {
    for name in [
        "shapes",
        "codes",
        "levels",
        "colours",
        "positions",
        "opacities",
        "sizes",
    ] {
        let said = complaint(|parts| {
            let object = parts.header.as_object_mut().unwrap();
            let tensor = object.remove(name).unwrap();
            object.insert("other".into(), tensor);
        });
        assert!(said.contains("no tensor 'other'"), "{said}");
        let dtype = if name == "opacities" || name == "sizes" {
            "I8"
        } else {
            "BF16"
        };
        let said = complaint(|parts| {
            // The same bytes as another type: the shape follows, or the file would not hold
            // together.
            let bytes = parts.tensor(name).len();
            parts.header[name]["dtype"] = dtype.into();
            parts.header[name]["shape"] = json!([if dtype == "I8" { bytes } else { bytes / 2 }]);
        });
        assert!(
            said.contains(&format!("tensor '{name}' is {dtype}")),
            "{said}"
        );
    }
    let said = complaint(|parts| parts.header["positions"]["shape"] = json!([3, 16]));
    assert!(
        said.contains("positions' is U16 [3, 16]; expected U16 [rows, 3]"),
        "{said}"
    );
    let said = complaint(|parts| parts.header["colours"]["shape"] = json!([48, 4, 3]));
    assert!(said.contains("expected F16 [rows, 16, 3]"), "{said}");
    let said = complaint(|parts| parts.header["opacities"]["shape"] = json!([]));
    assert!(said.contains("invalid shape"), "{said}");
    // One splat's opacity becomes a size: every tensor is whole, but their counts differ.
    let said = complaint(|parts| {
        let end = parts.header["opacities"]["data_offsets"][1]
            .as_u64()
            .unwrap()
            - 1;
        parts.header["opacities"] =
            json!({ "dtype": "U8", "shape": [15], "data_offsets": [end - 15, end] });
        parts.header["sizes"] =
            json!({ "dtype": "U8", "shape": [17], "data_offsets": [end, end + 17] });
    });
    assert!(
        said.contains("'opacities' has 15 rows and 'positions' 16"),
        "{said}"
    );
}

#[test]
fn a_missing_tensor_is_named() {
    // The last tensor can be left out together with its bytes.
    let said = complaint(|parts| {
        parts
            .data
            .truncate(parts.header["sizes"]["data_offsets"][0].as_u64().unwrap() as usize);
        parts.header.as_object_mut().unwrap().remove("sizes");
    });
    assert!(said.contains("the tensor 'sizes' is missing"), "{said}");
}

#[test]
fn numbers_that_cannot_be_drawn_are_refused() {
    let nan = f32::NAN.to_le_bytes();
    assert!(complaint(|parts| parts.tensor("shapes")[4..8].copy_from_slice(&nan)).contains("NaN"));
    assert!(
        complaint(|parts| parts.tensor("colours")[..2].copy_from_slice(&[0x00, 0x7e]))
            .contains("NaN")
    );
    assert!(
        complaint(|parts| parts.tensor("colours")[..2].copy_from_slice(&[0x00, 0xfc]))
            .contains("inf")
    );
    let huge = 3e38f32.to_le_bytes();
    assert!(complaint(|parts| parts.tensor("shapes")[..4].copy_from_slice(&huge)).contains("3e38"));
    assert!(
        complaint(|parts| parts.tensor("codes")[..4].copy_from_slice(&12u32.to_le_bytes()))
            .contains("shape 12 of 12")
    );
    let color = (12u32 << 9).to_le_bytes();
    assert!(
        complaint(|parts| parts.tensor("codes")[60..].copy_from_slice(&color))
            .contains("color 12 of 12")
    );
    assert!(complaint(|parts| parts.tensor("levels")[0] = 11).contains("add up to 16"));
    assert!(
        complaint(|parts| parts.tensor("levels").copy_from_slice(&[0xff; 8]))
            .contains("add up to 16")
    );
}

#[test]
fn metadata_that_are_not_as_they_should_be_are_named() {
    let set = |key: &str, value: &str| {
        complaint(|parts| parts.header["__metadata__"][key] = value.into())
    };
    let own = [
        "format",
        "version",
        "tool_version",
        "source",
        "source_sha256",
        "dims_m",
        "bounds_min_m",
        "bounds_max_m",
    ];
    let coding = [
        "log2_size_min",
        "log2_size_step",
        "dc_residual_step",
        "sh_degree",
        "sh_frame",
    ];
    for key in own.into_iter().chain(coding) {
        let said = complaint(|parts| {
            drop(
                parts.header["__metadata__"]
                    .as_object_mut()
                    .unwrap()
                    .remove(key),
            );
        });
        assert!(said.contains(&format!("'{key}'")), "{key}: {said}");
    }
    assert!(
        complaint(|parts| drop(parts.header.as_object_mut().unwrap().remove("__metadata__")))
            .contains("'format'")
    );
    for (key, value, part) in [
        ("format", "pt", "'pt'"),
        ("version", "2", "reads version 1"),
        ("sh_degree", "4", "0 to 3"),
        ("sh_degree", "-1", "0 to 3"),
        ("sh_degree", "2", "[rows, 9, 3]"),
        ("sh_frame", "body", "'canonical' or 'world'"),
        ("dims_m", "[1.0, 2.0]", "three numbers"),
        ("dims_m", "[1.0, 2.0, 3.0, 4.0]", "three numbers"),
        ("dims_m", "[1.0, 2.0, 3.0, x]", "three numbers"),
        ("dims_m", "1.0, 2.0, 3.0", "three numbers"),
        ("dims_m", "[1.0, NaN, 3.0]", "NaN"),
        ("dims_m", "[1.0, -2.0, 3.0]", "dims_m"),
        ("bounds_min_m", "[9.0, 0.0, 0.0]", "rising box"),
        ("bounds_max_m", "[9.0, 3e38, 9.0]", "rising box"),
        ("bounds_max_m", "[inf, 0.0, 9.0]", "inf"),
        ("log2_size_min", "", "a number"),
        ("log2_size_min", "-200.0", "-120"),
        ("log2_size_step", "-0.1", "rising exponents"),
        ("log2_size_step", "0.5", "splats end"),
        ("dc_residual_step", "[0.1, 1e30, 0.1]", "dc_residual_step"),
    ] {
        let said = set(key, value);
        assert!(said.contains(part), "{key} = {value}: {said}");
    }
}

#[test]
fn what_others_add_to_the_metadata_is_no_fault() {
    let mut parts = Parts::read(&coded_asset::encode(&coded_cone()).unwrap());
    parts.header["__metadata__"]["license"] = "CC0".into();
    parts.header["__metadata__"]["sh_frame"] = "canonical".into();
    let read = coded_asset::decode(&parts.to_bytes()).unwrap();
    assert_eq!(
        (read.cloud.sh_frame, read.provenance),
        (ShFrame::Canonical, coded_cone().provenance)
    );
}
