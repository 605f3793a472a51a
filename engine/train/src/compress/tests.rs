//! Compression as a whole.

use decouplegs_scene::{SplatCloud, sh};

use super::*;

/// `count` discs on a plane of 10 by 10 m, of different sizes, directions and smoothly varying
/// colors.
pub(super) fn plane(count: usize, sh_degree: u8) -> SplatCloud {
    let stride = sh::coefficient_count(sh_degree) - 1;
    let wave = |i: usize, k: f32| (i as f32 * k + 0.3).sin();
    let side = (count as f32).sqrt().ceil();
    SplatCloud {
        means: (0..count)
            .map(|i| {
                [
                    i as f32 % side * 10.0 / side,
                    (i as f32 / side).floor() * 10.0 / side,
                    0.05 * wave(i, 0.7),
                ]
            })
            .collect(),
        scales: (0..count)
            .map(|i| {
                [
                    0.1 + 0.05 * wave(i, 0.37),
                    0.06 + 0.03 * wave(i, 0.53),
                    0.002,
                ]
            })
            .collect(),
        rotations: (0..count)
            .map(|i| [1.0, 0.3 * wave(i, 0.11), 0.2 * wave(i, 0.23), wave(i, 0.31)])
            .collect(),
        opacities: (0..count).map(|i| 0.6 + 0.39 * wave(i, 0.91)).collect(),
        sh_degree,
        sh_dc: (0..count)
            .map(|i| [wave(i, 0.01), wave(i, 0.013), wave(i, 0.002)])
            .collect(),
        sh_rest: (0..count * stride)
            .map(|i| {
                [
                    0.1 * wave(i, 0.017),
                    0.1 * wave(i, 0.019),
                    0.05 * wave(i, 0.023),
                ]
            })
            .collect(),
    }
}

fn quick() -> CompressOptions {
    CompressOptions {
        colors: 64,
        shapes: 32,
        iterations_max: 50,
        ..CompressOptions::default()
    }
}

fn compressed(cloud: &SplatCloud, options: &CompressOptions) -> Compressed {
    compress(cloud, &vec![1.0; cloud.len()], options, &|_| ()).unwrap()
}

/// The largest axis of a splat of `cloud`, and the least.
fn extremes(cloud: &SplatCloud, splat: usize) -> (f32, f32) {
    let scales = cloud.scales[splat];
    (
        scales.into_iter().fold(0.0, f32::max),
        scales.into_iter().fold(f32::MAX, f32::min),
    )
}

#[test]
fn what_comes_out_is_near_what_went_in() {
    let cloud = plane(2000, 3);
    let Compressed {
        cloud: coded,
        report,
        ..
    } = compressed(
        &cloud,
        &CompressOptions {
            iterations_max: 100,
            ..Default::default()
        },
    );
    assert_eq!(
        (report.kept, coded.levels.as_slice()),
        (2000, [2000, 250].as_slice())
    );
    let decoded = coded.decoded(0);
    let sorted = cloud.in_spatial_order();
    for splat in 0..2000 {
        for axis in 0..3 {
            assert!((decoded.means[splat][axis] - sorted.means[splat][axis]).abs() < 1e-4);
            assert!((decoded.sh_dc[splat][axis] - sorted.sh_dc[splat][axis]).abs() < 0.1);
        }
        assert!((decoded.opacities[splat] - sorted.opacities[splat]).abs() < 0.002);
        let ((long, _), (long_before, _)) = (extremes(&decoded, splat), extremes(&sorted, splat));
        assert!(
            (long / long_before - 1.0).abs() < 0.1,
            "{:?} from {:?}",
            decoded.scales[splat],
            sorted.scales[splat]
        );
    }
    assert_eq!(
        coded.dims_m,
        std::array::from_fn(|axis| cloud.bounds().half_extent()[axis] * 2.0)
    );
}

#[test]
fn sizes_are_counted_as_they_are_stored() {
    let cloud = plane(2000, 3);
    let Compressed {
        cloud: coded,
        report,
        ..
    } = compressed(&cloud, &quick());
    assert_eq!(report.bytes.levels, [2000 * 12, 250 * 12]);
    assert_eq!(
        (report.bytes.shapes, report.bytes.colors),
        (coded.shapes.len() * 24, coded.color_count() * 96)
    );
    assert!((report.bytes_per_splat() - report.bytes.total() as f64 / 2000.0).abs() < 1e-12);
}

#[test]
fn the_seed_decides_and_the_threads_do_not() {
    let cloud = plane(1500, 1);
    let with_threads = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| compressed(&cloud, &CompressOptions { seed, ..quick() }))
    };
    assert_eq!(with_threads(1, 3), with_threads(2, 3));
    assert_ne!(
        with_threads(1, 3).cloud.colors,
        with_threads(1, 4).cloud.colors
    );
}

#[test]
fn needles_stay_needles() {
    let mut cloud = plane(300, 0);
    cloud.scales = (0..300)
        .map(|i| [1.0 + i as f32 * 0.01, 1e-5, 1e-5])
        .collect();
    cloud.rotations = vec![[0.5, 0.5, 0.5, -0.5]; 300];
    let decoded = compressed(&cloud, &quick()).cloud.decoded(0);
    for splat in 0..300 {
        let (long, short) = extremes(&decoded, splat);
        assert!(short < 3e-4 * long, "{:?}", decoded.scales[splat]);
    }
}

#[test]
fn flat_assets_and_splats_without_any_size_are_coded() {
    let mut cloud = plane(300, 1);
    cloud.means.iter_mut().for_each(|mean| mean[2] = 0.25);
    cloud.scales.iter_mut().for_each(|scales| scales[2] = 0.0);
    cloud.scales[5] = [0.0; 3];
    for shape_space in ShapeSpace::ALL {
        let coded = compressed(
            &cloud,
            &CompressOptions {
                shape_space,
                ..quick()
            },
        )
        .cloud;
        let decoded = coded.decoded(0);
        assert!(
            (0..300).all(|splat| decoded.defect_of(splat).is_none()),
            "{shape_space:?}"
        );
        assert!(decoded.means.iter().all(|mean| mean[2] == 0.25));
    }
}

#[test]
fn one_splat_and_equal_splats_come_back() {
    let one = plane(1, 3);
    let decoded = compressed(&one, &CompressOptions::default())
        .cloud
        .decoded(0);
    assert_eq!((decoded.len(), decoded.means[0]), (1, one.means[0]));
    assert!((decoded.sh_rest[4][0] - one.sh_rest[4][0]).abs() < 1e-3);
    let many = one.select(&[0; 500]);
    let Compressed {
        cloud: coded,
        report,
        ..
    } = compressed(&many, &CompressOptions::default());
    assert_eq!(
        (
            coded.levels.len(),
            coded.shapes.len(),
            coded.color_count(),
            report.kept
        ),
        (2, 1, 1, 500)
    );
    let decoded = coded.decoded(0);
    assert!(
        decoded
            .scales
            .iter()
            .all(|scales| *scales == decoded.scales[0])
    );
    let ((long, _), (long_before, _)) = (extremes(&decoded, 0), extremes(&one, 0));
    assert!((long / long_before - 1.0).abs() < 1e-3);
}

#[test]
fn fewer_splats_than_codes_lose_no_shape_and_no_color() {
    let cloud = plane(40, 1);
    let Compressed {
        cloud: coded,
        report,
        ..
    } = compressed(&cloud, &CompressOptions::default());
    assert_eq!((coded.shapes.len(), coded.color_count()), (40, 40));
    assert!(
        report.shapes.distortion.last().unwrap() < &1e-12
            && report.colors.distortion.last().unwrap() < &1e-12
    );
}

#[test]
fn what_leaves_nothing_is_refused_with_the_reason() {
    let mut cloud = plane(10, 0);
    cloud.opacities = vec![0.002; 10];
    let refuse = |cloud: &SplatCloud, visibility: &[f32], options: &CompressOptions| {
        compress(cloud, visibility, options, &|_| ())
            .unwrap_err()
            .to_string()
    };
    let all_transparent = refuse(&cloud, &[0.0; 10], &quick());
    assert!(
        all_transparent.contains("10 have an opacity below 1/255"),
        "{all_transparent}"
    );
    assert!(refuse(&plane(10, 0), &[0.0; 10], &quick()).contains("10 are seen in no view"));
    assert!(refuse(&SplatCloud::default(), &[], &quick()).contains("none of 0 splats"));
    assert!(
        refuse(&plane(3, 0), &[1.0; 2], &quick())
            .contains("2 visibilities were given for 3 splats")
    );
    assert!(refuse(&plane(2, 0), &[1.0, f32::NAN], &quick()).contains("splat 1 is NaN"));
    let with = |change: fn(&mut CompressOptions)| {
        let mut options = quick();
        change(&mut options);
        refuse(&plane(2, 0), &[1.0; 2], &options)
    };
    assert!(with(|options| options.colors = 1025).contains("1025; expected 1 to 1024"));
    assert!(with(|options| options.shapes = 0).contains("0; expected 1 to 512"));
    assert!(with(|options| options.prune = Prune::KeepRatio(f32::NAN)).contains("NaN"));
    assert!(with(|options| options.prune = Prune::Threshold(1.5)).contains("1.5"));
    assert!(with(|options| options.color_dc_weight = 0.0).contains("at least 0.001"));
}

#[test]
fn unseen_splats_go_by_threshold_and_stay_when_a_ratio_asks_for_them() {
    let cloud = plane(100, 0);
    let visibility: Vec<f32> = (0..100)
        .map(|i| if i < 30 { 0.0 } else { i as f32 })
        .collect();
    let kept = |prune| {
        compress(
            &cloud,
            &visibility,
            &CompressOptions { prune, ..quick() },
            &|_| (),
        )
        .unwrap()
        .report
        .kept
    };
    assert_eq!(kept(Prune::Threshold(THRESHOLD)), 70);
    assert_eq!(kept(Prune::KeepRatio(1.0)), 100);
    assert_eq!(kept(Prune::KeepRatio(0.25)), 25);
}

#[test]
fn an_extent_beyond_f32_is_an_error() {
    let mut cloud = plane(4, 0);
    cloud.means[0] = [-3e38; 3];
    cloud.means[3] = [3e38; 3];
    assert!(
        compress(&cloud, &[1.0; 4], &quick(), &|_| ())
            .unwrap_err()
            .to_string()
            .contains("cannot be coded")
    );
}

mod properties {
    use super::*;
    use proptest::prelude::*;

    fn number() -> impl Strategy<Value = f32> {
        prop_oneof![8 => -2.0f32..2.0, 1 => Just(0.0), 1 => any::<f32>()]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

        #[test]
        fn any_cloud_is_coded_soundly_or_refused(
            numbers in prop::collection::vec(number(), 17..400), ratio in 0.05f32..1.0, space in 0usize..4,
        ) {
            let mut cloud = SplatCloud::with_degree(0);
            for n in numbers.chunks_exact(17) {
                cloud.means.push([n[0], n[1], n[2]]);
                cloud.scales.push([n[3].abs(), n[4].abs(), n[5].abs()]);
                cloud.rotations.push([n[6], n[7], n[8], n[9]]);
                cloud.opacities.push(n[10].abs());
                cloud.sh_dc.push([n[11], n[12], n[13]]);
            }
            let options = CompressOptions {
                prune: Prune::KeepRatio(ratio), shape_space: ShapeSpace::ALL[space], shapes: 5, colors: 7, iterations_max: 30,
                ..Default::default()
            };
            if let Ok(Compressed { cloud: coded, report, .. }) = compress(&cloud, &vec![1.0; cloud.len()], &options, &|_| ()) {
                prop_assert_eq!(coded.check(), Ok(()));
                prop_assert!(report.shapes.distortion.iter().chain(&report.colors.distortion).all(|value| value.is_finite()));
                let decoded = coded.decoded(0);
                prop_assert_eq!(decoded.len(), report.kept);
                for splat in 0..decoded.len() {
                    prop_assert_eq!(decoded.defect_of(splat), None);
                }
            }
        }
    }
}
