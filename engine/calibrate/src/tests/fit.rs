//! Fits: what was planted comes back, what is not determined is refused, and nothing depends on
//! threads.

use std::f64::consts::FRAC_PI_3;

use decouplegs_scene::light::{ALBEDO_SPREAD, Surroundings};
use decouplegs_scene::{AmbientDescriptor, ColorTransfer, LightTransfer, SplatCloud, sh};
use decouplegs_synth::probes::procedural_probes;
use glam::DQuat;

use super::super::held_out::{relit_color, shown};
use super::super::moments::Moments;
use super::super::ridge::{Ridge, zero};
use super::super::sample::{Sample, samples};
use super::super::*;
use super::{ball, skies};
use decouplegs_scene::random::Random;

fn options() -> CalibrateOptions {
    CalibrateOptions {
        samples: 300,
        rotations: 5,
        ..CalibrateOptions::default()
    }
}

fn calibrated(
    assets: &[(String, &SplatCloud)],
    probes: &[Probe],
    options: &CalibrateOptions,
) -> Calibration {
    calibrate(assets, probes, options, &|_| {}).expect("these lights determine a fit")
}

fn random_transfer(sh_degree: u8, seed: u64) -> LightTransfer {
    let mut random = Random::new(seed);
    let mut row = || (std::array::from_fn(|_| (random.unit() - 0.5) as f32), 0.7);
    let rows = 3 * sh::coefficient_count(sh_degree);
    LightTransfer {
        sh_degree,
        gain: (0..rows).map(|_| row()).collect(),
        offset: (0..rows).map(|_| row()).collect(),
        neutral: Surroundings::default().neutral(),
        confidence: None,
    }
}

/// Largest difference of T and b over some lights.
fn distance(a: &LightTransfer, b: &LightTransfer, lights: &[Lighting<'_>]) -> f32 {
    let of_light = |light: &Lighting<'_>| {
        let (a, b) = (a.at(&light.descriptor), b.at(&light.descriptor));
        let pairs = a
            .gain
            .iter()
            .chain(&a.offset)
            .zip(b.gain.iter().chain(&b.offset));
        pairs
            .flat_map(|(a, b)| (0..3).map(move |channel| (a[channel] - b[channel]).abs()))
            .fold(0.0, f32::max)
    };
    lights.iter().map(of_light).fold(0.0, f32::max)
}

#[test]
fn a_planted_transfer_is_found_and_a_broken_one_is_told_from_it() {
    let (ground, planted) = (Surroundings::default(), random_transfer(2, 4));
    let probes: Vec<PreparedProbe> = skies(8)
        .iter()
        .map(|probe| PreparedProbe::new(probe, &ground))
        .collect();
    let lights = lightings(&probes, &ground, 5);
    let samples = samples(&ball(900, 2), 400, 1);
    for objective in [Objective::Seen, Objective::Coefficients] {
        let relit = |sample: &Sample, light: &Lighting<'_>| {
            let transfer = planted.at(&light.descriptor);
            let mut color = sample.surface.color;
            for (k, coefficient) in color.iter_mut().enumerate() {
                for (channel, value) in coefficient.iter_mut().enumerate() {
                    *value = f64::from(transfer.gain[k][channel]) * *value
                        + f64::from(transfer.offset[k][channel]);
                }
            }
            color
        };
        let moments = Moments::from_samples(&samples, &lights, 9, objective, relit);
        let all: Vec<_> = moments.lights.iter().collect();
        let found = Ridge::new(&moments, &all)
            .solve(1e-13, &zero(9))
            .to_transfer(2, ground.neutral());
        let apart = distance(&planted, &found, &lights);
        // f32 transfers of the planted Theta are the truth here: their rounding is amplified by the
        // smallest singular values.
        assert!(apart < 2e-3, "{objective}: T and b are off by {apart}");
        let worst = planted
            .gain
            .iter()
            .zip(&found.gain)
            .map(|(a, b)| (a.1 - b.1).abs())
            .fold(0.0, f32::max);
        assert!(worst < 0.02, "{objective}: a constant is off by {worst}");
        let mut broken = found;
        broken.gain[4].0[7] += 0.5;
        assert!(
            distance(&planted, &broken, &lights) > 2e-3,
            "the comparison cannot fail"
        );
    }
}

#[test]
fn lights_that_determine_nothing_are_refused_with_what_to_do() {
    let cloud = ball(200, 1);
    let assets = [("ball".to_owned(), &cloud)];
    let refused = |probes: &[Probe], options: CalibrateOptions| {
        calibrate(&assets, probes, &options, &|_| {}).unwrap_err()
    };
    let one = refused(
        &skies(1),
        CalibrateOptions {
            rotations: 1,
            ..options()
        },
    );
    assert_eq!(
        one,
        CalibrateError::TooFewLights {
            found: 2 * GROUND_DISPLAY.len(),
            probes: 1
        }
    );
    assert!(one.to_string().contains("at least 28"), "{one}");
    // Turned, mirrored and exposed it makes 72 lights, but all of one hue and one height.
    let turned = refused(
        &skies(1),
        CalibrateOptions {
            rotations: 6,
            ..options()
        },
    );
    assert!(
        matches!(
            turned,
            CalibrateError::RankDeficient {
                lights: 73,
                probes: 1,
                rank: 1..28,
                ..
            }
        ),
        "{turned}"
    );
    // Eight probes, none of them turned or colored.
    let gray: Vec<Probe> = skies(8)
        .iter()
        .map(|sky| {
            Probe::new(
                "gray",
                sky.width(),
                sky.height(),
                sky.pixels().iter().map(|rgb| [rgb[0]; 3]).collect(),
            )
        })
        .collect();
    let gray = refused(&gray, options());
    assert!(
        matches!(gray, CalibrateError::RankDeficient { rank: ..=12, .. }),
        "{gray}"
    );
    let dark = refused(&[Probe::from_fn("night", 32, |_| [0.0; 3])], options());
    assert_eq!(
        dark,
        CalibrateError::TooFewLights {
            found: 0,
            probes: 1
        }
    );
}

#[test]
fn options_and_assets_that_make_no_sense_are_named() {
    let (cloud, probes) = (ball(50, 0), skies(8));
    let refused = |cloud: &SplatCloud, options| {
        calibrate(&[("ball".to_owned(), cloud)], &probes, &options, &|_| {})
            .unwrap_err()
            .to_string()
    };
    assert!(
        refused(
            &cloud,
            CalibrateOptions {
                ridge: Some(-1.0),
                ..options()
            }
        )
        .contains("-1")
    );
    assert!(
        refused(
            &cloud,
            CalibrateOptions {
                rotations: 65,
                ..options()
            }
        )
        .contains("65")
    );
    assert!(
        refused(
            &cloud,
            CalibrateOptions {
                sh_degree: Some(4),
                ..options()
            }
        )
        .contains('4')
    );
    assert!(
        refused(
            &cloud,
            CalibrateOptions {
                samples: 0,
                ..options()
            }
        )
        .contains("1, one an asset")
    );
    let dark = Surroundings {
        albedo: 0.0,
        ..Surroundings::default()
    };
    assert!(
        refused(
            &cloud,
            CalibrateOptions {
                ground: dark,
                ..options()
            }
        )
        .contains("albedo")
    );
    assert!(
        calibrate(&[], &probes, &options(), &|_| {})
            .unwrap_err()
            .to_string()
            .contains("no asset")
    );
    let clear = SplatCloud {
        opacities: vec![0.0; cloud.len()],
        ..cloud
    };
    assert!(refused(&clear, options()).contains("ball"));
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let cloud = ball(300, 1);
    let probes = skies(7);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads start");
        let calibration =
            pool.install(|| calibrated(&[("ball".to_owned(), &cloud)], &probes, &options()));
        (calibration.transfer.clone(), calibration.total())
    };
    let one = on(1);
    assert_eq!(one, on(3));
    let other = calibrated(
        &[("ball".to_owned(), &cloud)],
        &probes,
        &CalibrateOptions {
            seed: 2,
            ..options()
        },
    );
    assert_ne!(one.0, other.transfer, "another seed looks at other splats");
}

#[test]
fn relit_colors_are_nearer_to_the_truth_in_light_that_the_fit_was_not_shown() {
    let cloud = ball(600, 1);
    let calibration = calibrated(&[("ball".to_owned(), &cloud)], &skies(8), &options());
    assert_eq!(calibration.held_out.len(), 8);
    let Comparison {
        none,
        relit,
        affine,
    } = calibration.total();
    assert!(
        affine.rmse() <= relit.rmse() && relit.rmse() < 0.6 * none.rmse(),
        "{} {} {}",
        none.rmse(),
        relit.rmse(),
        affine.rmse()
    );
    let angles = [&none, &relit, &affine].map(ColorError::angle_mean_deg);
    assert!(
        angles[1] < angles[0] && relit.angle_p95_deg() >= relit.angle_mean_deg(),
        "{angles:?} {}",
        relit.angle_p95_deg()
    );
    assert!(calibration.held_out_assets.is_empty(), "one asset is all");
    // The neutral light is one of 401, so it is pinned, not met: nearer to right than other lights
    // are without relighting.
    let neutral = calibration.neutral.relit.rmse();
    assert!(
        neutral < 0.5 * none.rmse(),
        "neutral light changes colors by {neutral}, others by {}",
        none.rmse()
    );
    assert!(calibration.neutral.none.rmse() < 1e-6);
    assert!(
        calibration
            .tried
            .iter()
            .any(|(ridge, _)| *ridge == calibration.ridge)
    );
}

#[test]
fn procedural_environments_calibrate_as_probes_from_files_do() {
    let cloud = ball(600, 1);
    let procedural = procedural_probes();
    let calibration = calibrated(&[("ball".to_owned(), &cloud)], &procedural, &options());
    assert_eq!(
        (calibration.held_out.len(), procedural.len()),
        (12, 12),
        "each can be told from the others"
    );
    assert!(
        calibration.lights > 28 * 10 && calibration.smallest_over_largest > 1e-6,
        "{}",
        calibration.smallest_over_largest
    );
    // In their own light, and in light that is nothing like theirs.
    let Comparison { none, relit, .. } = calibration.total();
    assert!(
        relit.rmse() < 0.6 * none.rmse(),
        "{} {}",
        none.rmse(),
        relit.rmse()
    );
    let ground = Surroundings::default();
    for sky in skies(4) {
        let probe = PreparedProbe::new(&sky, &ground);
        let light = Lighting::of_probe((0, &probe), &ground, 0.7, false, 0.4).unwrap();
        let truth = lit_cloud(&cloud, |normal| light.reflected_by_white(normal));
        let relit = calibration.transfer.at(&light.descriptor).relit(&cloud);
        let error = |found: &SplatCloud| {
            let pairs = found
                .sh_dc
                .iter()
                .flatten()
                .zip(truth.sh_dc.iter().flatten());
            pairs
                .map(|(a, b)| f64::from(a - b).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        assert!(
            error(&relit) < 0.8 * error(&cloud),
            "{}: {} and {} as they are",
            sky.name,
            error(&relit),
            error(&cloud)
        );
    }
}

#[test]
fn turning_light_and_asset_together_turns_the_colors() {
    let cloud = ball(400, 2);
    let transfer = calibrated(&[("ball".to_owned(), &cloud)], &skies(8), &options()).transfer;
    let ground = Surroundings::default();
    let probe = PreparedProbe::new(&skies(9)[8], &ground);
    let [there, turned] = [0.0, FRAC_PI_3].map(|yaw| {
        Lighting::of_probe((0, &probe), &ground, yaw, false, 0.4)
            .unwrap()
            .descriptor
    });
    let turn = DQuat::from_rotation_z(FRAC_PI_3);
    // An agent that stands turned sees the turned light as the unturned one sees the other.
    let in_its_frame = turned.turned(turn.inverse());
    let relit = |light: &AmbientDescriptor| transfer.at(light).relit(&cloud);
    let pose = decouplegs_scene::Pose::new(turn, glam::DVec3::ZERO);
    let (a, b) = (
        relit(&there).placed(&pose, true),
        relit(&in_its_frame).placed(&pose, true),
    );
    let worst = |a: &SplatCloud, b: &SplatCloud| {
        let pairs = a
            .sh_dc
            .iter()
            .chain(&a.sh_rest)
            .zip(b.sh_dc.iter().chain(&b.sh_rest));
        pairs
            .flat_map(|(a, b)| (0..3).map(move |channel| (a[channel] - b[channel]).abs()))
            .fold(0.0, f32::max)
    };
    assert!(worst(&a, &b) < 1e-4, "{}", worst(&a, &b));
    // Light that is not turned into the agent's frame gives other colors.
    assert!(worst(&a, &relit(&turned).placed(&pose, true)) > 1e-2);
}

/// A ball of other colors left out in turn is nearer to the truth relit than not, and the moments
/// without it are those of the others alone.
#[test]
fn assets_that_the_fit_was_not_shown_are_relit_too() {
    let (one, mut other) = (ball(500, 1), ball(700, 1));
    for dc in &mut other.sh_dc {
        *dc = [0.5 * dc[0] - 0.4, dc[1], -dc[2]];
    }
    let names = ["one".to_owned(), "other".to_owned()];
    let assets = [(names[0].clone(), &one), (names[1].clone(), &other)];
    let calibration = calibrated(&assets, &skies(8), &options());
    assert_eq!(calibration.held_out_assets.len(), 2);
    for held_out in &calibration.held_out_assets {
        let Comparison {
            none,
            relit,
            affine,
        } = &held_out.comparison;
        assert!(
            relit.rmse() < 0.6 * none.rmse() && affine.rmse() < relit.rmse(),
            "asset {}: {} {} {}",
            held_out.asset,
            none.rmse(),
            relit.rmse(),
            affine.rmse()
        );
    }
    // With one of two assets left out, the fit is that to the other alone.
    let alone = CalibrateOptions {
        samples: 150,
        ridge: Some(calibration.ridge),
        ..options()
    };
    let alone = calibrated(&assets[..1], &skies(8), &alone);
    let (found, expected) = (
        calibration.held_out_assets[1].comparison.relit.rmse(),
        judged(&alone.transfer, &other),
    );
    assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
}

/// Root mean squared error of the colors of `cloud`, relit by `transfer`, over [`skies`].
fn judged(transfer: &LightTransfer, cloud: &SplatCloud) -> f64 {
    let ground = Surroundings::default();
    let probes: Vec<PreparedProbe> = skies(8)
        .iter()
        .map(|probe| PreparedProbe::new(probe, &ground))
        .collect();
    let lights = lightings(&probes, &ground, 5);
    let samples = samples(cloud, 150, options().seed + 1);
    let (_, moments) = moments_of(&samples, &lights, 1, Objective::Seen);
    let pairs: Vec<_> = lights.iter().zip(&moments.lights).collect();
    Comparison::for_transfer(transfer, &samples, &moments, &pairs)
        .relit
        .rmse()
}

/// The confidence of a fit: an effect that is far above its error is kept, light that makes no
/// difference leaves colors bit for bit, and light unlike any that was calibrated is distrusted.
/// The full effect of that light is the case that must fail.
#[test]
fn relighting_is_never_much_worse_than_none() {
    let cloud = ball(600, 1);
    let calibration = calibrated(&[("ball".to_owned(), &cloud)], &skies(8), &options());
    let transfer = &calibration.transfer;
    let ground = Surroundings::default();
    let (same, trust) = transfer.trusted_at(&ground.neutral(), ALBEDO_SPREAD);
    let trust = trust.expect("probes were left out, so errors are known");
    println!("neutral: {trust:?}");
    assert_eq!(trust.kept[0], 0.0);
    assert_eq!((same.gain[0], same.offset[0]), ([1.0; 3], [0.0; 3]));

    let probes: Vec<PreparedProbe> = skies(9)[8..]
        .iter()
        .map(|probe| PreparedProbe::new(probe, &ground))
        .collect();
    let samples = samples(&cloud, 300, 5);
    let mut kept = Vec::new();
    for light in &lightings(&probes, &ground, 5)[1..] {
        let trusted = transfer.trusted_at(&light.descriptor, ALBEDO_SPREAD);
        let errors = [
            error_of(&ColorTransfer::IDENTITY, &samples, light),
            error_of(&trusted.0, &samples, light),
        ];
        let db = 20.0 * (errors[0] / errors[1]).log10();
        assert!(db > -0.1, "{errors:?} kept {:?}", trusted.1);
        kept.push(trusted.1.unwrap().kept[0]);
    }
    assert!(
        kept.iter().any(|kept| *kept > 0.9) && kept.iter().any(|kept| *kept < 0.5),
        "dark light is followed, light near neutral is not: {kept:?}"
    );

    // Light from one side, in colors of no sky.
    let mut strange = ground.neutral();
    for (k, value) in [(3, [0.4, -0.3, 0.0]), (7, [-0.3, 0.0, 0.5])] {
        strange.coefficients[k] = value;
    }
    let (trusted, trust) = transfer.trusted_at(&strange, ALBEDO_SPREAD);
    let trust = trust.unwrap();
    assert!(trust.distance > 10.0 && trust.kept[0] == 0.0, "{trust:?}");
    let neutral = Lighting::neutral(&ground);
    let errors =
        [&trusted, &transfer.at(&strange)].map(|transfer| error_of(transfer, &samples, &neutral));
    assert!(errors[1] > 2.0 * errors[0] + 0.02, "{errors:?}");
}

/// Root mean squared error of seen colors in one light.
fn error_of(transfer: &ColorTransfer, samples: &[Sample], light: &Lighting<'_>) -> f64 {
    let mut sum = 0.0;
    for sample in samples {
        let color = &sample.surface.color;
        let truth = sample
            .surface
            .lit(light.reflected_by_white(sample.surface.normal));
        let relit = relit_color(transfer, color);
        for basis in &sample.views {
            let pairs = shown(&relit, basis).into_iter().zip(shown(&truth, basis));
            sum += pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / (9 * samples.len()) as f64;
        }
    }
    sum.sqrt()
}
