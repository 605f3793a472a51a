//! Structures and constants that host and shaders both spell out: the same names at the same
//! positions, and the same numbers.

use std::fs;
use std::mem::{offset_of, size_of};
use std::path::Path;

use decouplegs::gpu::{DeviceOptions, Gpu};
use decouplegs::render::layout::{
    AgentRecord, BeamEchoes, BeamRecord, BeamState, BlendItem, Bucket, CameraRecord, ClusterRecord,
    Composite, EchoRecord, FiringRecord, LensRecord, MergePiece, NodeRecord, PartialTiles,
    RelightRecord, RequiredCounts, SectorRecord, ShadingRecord, ShadowRecord, ViewLists,
};
use decouplegs::render::post_processing::PhotometryRecord;
use decouplegs::scene::{lidar, light, rules};

/// A structure of the host.
struct Record {
    name: &'static str,
    members: Vec<(String, u32)>,
    bytes: u32,
}

macro_rules! record {
    ($type:ident { $($member:ident),* }) => {
        Record {
            name: stringify!($type),
            members: vec![$((stringify!($member).to_owned(), offset_of!($type, $member) as u32)),*],
            bytes: size_of::<$type>() as u32,
        }
    };
}

fn records() -> Vec<Record> {
    let mut records = records_of_frames();
    records.extend(records_of_light_and_lenses());
    records.extend(records_of_lidars());
    records.push(record!(PhotometryRecord {
        matrix,
        offset,
        gamma,
        vignetting,
        vignetting_center_px,
        vignetting_scale,
        gain,
        balance,
        response,
        has_gamma,
        has_balance,
        has_response
    }));
    records
}

fn records_of_frames() -> Vec<Record> {
    vec![
        record!(CameraRecord {
            row_x,
            row_y,
            row_z,
            row_z_low,
            center_high_m,
            center_low_m,
            row_x_coarse,
            row_y_coarse,
            row_z_coarse,
            row_x_fine,
            row_y_fine,
            row_z_fine,
            focal_px,
            principal_px,
            focal_coarse_px,
            focal_fine_px,
            principal_coarse_px,
            principal_fine_px,
            mean_shift,
            slope_min,
            slope_max,
            size_px,
            coarse_tiles,
            key_offset,
            key_scale,
            key_depth,
            first_bin,
            first_pixel,
            turn_rad_per_s,
            frame_turn_rad_per_s,
            frame_velocity_mps,
            shutter_first_s,
            shutter_s_per_px
        }),
        record!(NodeRecord {
            center_m,
            radius_m,
            error_m,
            parent
        }),
        record!(ClusterRecord {
            center_m,
            half_extent_m,
            splat_radius_m
        }),
        record!(RequiredCounts {
            records,
            pairs,
            pairs_low,
            pairs_high,
            large,
            buckets,
            long_slabs,
            pieces,
            planned,
            items,
            partials,
            composites,
            longest,
            tiles,
            next_tile,
            first_binned,
            merges
        }),
        record!(MergePiece { bin, piece }),
        record!(PartialTiles { first, tiles }),
        record!(ViewLists {
            first_static,
            first_moving
        }),
        record!(Bucket {
            first_pair,
            pairs,
            bin,
            part
        }),
        record!(AgentRecord {
            row_x,
            row_y,
            row_z,
            box_min_m,
            box_step_m,
            dc_residual_step,
            log2_size_min,
            log2_size_step,
            first_cluster,
            first_bounds,
            first_splat,
            splat_count,
            first_shape,
            first_color,
            cameras,
            instance,
            colors_in_world,
            colors_relit,
            shading,
            dc_residual_gain,
            velocity_mps,
            turn_rad_per_s
        }),
        record!(BlendItem {
            bin,
            first_pair,
            pairs,
            partial,
            segment
        }),
        record!(Composite {
            bin,
            first_partial,
            partials,
            part
        }),
    ]
}

fn records_of_lidars() -> Vec<Record> {
    vec![
        record!(SectorRecord {
            velocity_mps,
            half_time_s,
            residual_m,
            first_column,
            first_row
        }),
        record!(BeamRecord {
            direction,
            firing,
            index
        }),
        record!(FiringRecord { offset_m, time_s }),
        record!(BeamState {
            transmittance,
            range_sum_m,
            intensity_sum,
            median_m,
            strongest_weight,
            strongest_m,
            instances
        }),
        record!(EchoRecord {
            weight,
            range_sum_m,
            intensity_sum,
            instance
        }),
        record!(BeamEchoes {
            open,
            open_strongest,
            strongest,
            last
        }),
    ]
}

fn records_of_light_and_lenses() -> Vec<Record> {
    vec![
        record!(LensRecord {
            kind,
            tan_limit,
            chord_limit,
            slope_beyond,
            pixels_per_rad,
            chord_intervals,
            matrix,
            radial,
            tangential,
            thin_prism,
            table,
            bend_limit,
            bending
        }),
        record!(ShadingRecord {
            up,
            upright,
            upward,
            outward,
            towards,
            rgb,
            first_slope_per_m,
            first_middle
        }),
        record!(ShadowRecord {
            center_high_m,
            center_low_m,
            along,
            across,
            normal,
            strength,
            log2_decay,
            sharpness,
            cutoff,
            slab_m,
            cameras
        }),
        record!(RelightRecord {
            gain,
            summand,
            first_color,
            colors,
            first_relit,
            first_group
        }),
    ]
}

/// Difference of a kernel's structure from the host's, if any: none of the host's has its members
/// at its offsets and its size.
fn fault(members: &[(String, u32)], stride: Option<u32>, records: &[Record]) -> Option<String> {
    let names = |members: &[(String, u32)]| {
        members
            .iter()
            .map(|(name, _)| name.clone())
            .collect::<Vec<_>>()
    };
    let Some(record) = records
        .iter()
        .find(|record| names(&record.members) == names(members))
    else {
        return Some(format!(
            "no structure of the host has the members {:?}",
            names(members)
        ));
    };
    let fits = record.members == members && stride.is_none_or(|stride| stride == record.bytes);
    (!fits).then(|| {
        format!(
            "{} is {:?} of {} bytes, and {members:?} of {stride:?} there",
            record.name, record.members, record.bytes
        )
    })
}

#[test]
fn structures_are_the_same_on_host_and_device() {
    // Not validated: kernels are built for their layout alone, without the constants that fit their
    // shared memory to the device.
    let gpu = Gpu::open(&DeviceOptions {
        validation: false,
        ..DeviceOptions::default()
    })
    .unwrap();
    let records = records();
    let mut seen = 0;
    for kernel in decouplegs_shaders::ALL {
        let built = gpu.kernel(kernel.name, kernel.spirv, &[]).unwrap();
        for binding in built.bindings() {
            let members = built.member_offsets(&binding.name).unwrap();
            // Numbers and vectors have no members.
            if members.len() > 1 {
                seen += 1;
                let fault = fault(&members, built.element_stride(&binding.name), &records);
                assert_eq!(fault, None, "{}.comp, {}", kernel.name, binding.name);
            }
        }
    }
    println!(
        "{seen} bindings of structures in {} kernels",
        decouplegs_shaders::ALL.len()
    );
    assert!(seen >= 20, "{seen}");
    // And it can fail: a member that moved, one that is called otherwise, another size.
    let cluster = &records[2];
    let mut moved = cluster.members.clone();
    moved[1].1 += 4;
    assert!(
        fault(&moved, Some(cluster.bytes), &records)
            .unwrap()
            .contains("ClusterRecord")
    );
    moved[1].0 = "extent".into();
    assert!(
        fault(&moved, Some(cluster.bytes), &records)
            .unwrap()
            .contains("no structure")
    );
    assert!(fault(&cluster.members, Some(cluster.bytes + 4), &records).is_some());
}

/// The number that a shader's `const NAME = ...` stands for: a number, or a quotient of two.
fn constant(text: &str, name: &str) -> Option<f64> {
    let line = text
        .lines()
        .find(|line| line.starts_with("const ") && line.split_whitespace().nth(2) == Some(name))?;
    let value = line.split('=').nth(1)?.split(';').next()?.trim();
    let number = |text: &str| text.trim().trim_end_matches('u').parse::<f64>().ok();
    match value.split_once('/') {
        Some((above, below)) => Some(number(above)? / number(below)?),
        None => number(value),
    }
}

#[test]
fn constants_of_the_rules_are_the_same_on_host_and_device() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders");
    let paths = [folder.join("include"), folder]
        .into_iter()
        .flat_map(|folder| fs::read_dir(folder).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            let extension = path.extension().unwrap_or_default();
            extension == "glsl" || extension == "comp"
        });
    let texts: Vec<String> = paths
        .map(|path| fs::read_to_string(path).unwrap())
        .collect();
    let of = |name: &str| -> Vec<f64> {
        texts
            .iter()
            .filter_map(|text| constant(text, name))
            .collect()
    };
    for (name, expected) in [
        ("ALPHA_MIN", rules::ALPHA_MIN),
        ("TRANSMITTANCE_MIN", rules::TRANSMITTANCE_MIN),
        (
            "TRANSMITTANCE_MIN_INCLUSIVE",
            rules::TRANSMITTANCE_MIN_INCLUSIVE,
        ),
        ("DILATION_PX2", rules::DILATION_PX2),
        ("ECHO_SEPARATION_M", lidar::ECHO_SEPARATION_M),
        ("ECHO_WEIGHT_MIN", lidar::ECHO_WEIGHT_MIN),
        ("SHADING_LIGHT_MIN", light::LIGHT_MIN),
        ("SHADING_LIGHTS", light::SHADING_LIGHTS as f64),
    ] {
        assert_eq!(of(name), [expected], "{name}");
    }
    assert_eq!(constant("const float A = 1.0 / 4.0;", "A"), Some(0.25));
    assert_eq!(constant("const float A = 1.0 / 4.0;", "B"), None);
}
