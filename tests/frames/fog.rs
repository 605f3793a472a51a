//! Fog: images against the definition, in f64.

use std::sync::Arc;

use decouplegs::render::reference;
use decouplegs::scene::{Fog, Rules, SplatScene};
use glam::{DMat3, DVec3};

use super::hard_cases::crowd;
use super::sky::{noise, some_photometry};
use super::{Splat, assert_exact, camera_at, draw, world_of};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

const FOG: Fog = Fog {
    extinction_per_m: 0.08,
    color: [0.7, 0.72, 0.75],
    sky_range_m: 60.0,
};

fn crowded() -> SplatScene {
    SplatScene {
        sky: [0.3, 0.5, 0.9],
        ..world_of(&crowd(80))
    }
}

/// Even sky, sky map and calibrated cameras, through pinholes and lenses.
#[test]
fn images_in_fog_are_those_of_the_definition() {
    let plain = SplatScene {
        fog: Some(FOG),
        ..crowded()
    };
    assert_exact(&plain, &lens_rig(), Rules::DEFAULT);
    let mut sky = noise(8, DMat3::IDENTITY);
    (sky.clamps, sky.clamps_splats) = (true, true);
    let under = SplatScene {
        sky_map: Some(Arc::new(sky)),
        ..plain
    };
    let mut cameras = lens_rig();
    cameras[0].intrinsics.photometry = some_photometry(0.8);
    assert_exact(&under, &cameras, Rules::INRIA);
}

/// One opaque splat ahead: its color at its distance, and the sky beside it, by hand.
#[test]
fn a_splat_fades_by_its_distance() {
    let far_m = 20.0;
    let splat = Splat::at(0.0, 0.0, far_m as f32);
    let world = SplatScene {
        sky: [0.1, 0.2, 0.3],
        ..world_of(&[splat])
    };
    let camera = camera_at(DVec3::ZERO, 64, 48);
    let image = |fog: Option<Fog>| {
        reference::render(
            &SplatScene {
                fog,
                ..world.clone()
            },
            &camera,
            &Rules::DEFAULT,
        )
    };
    let (clear, foggy) = (image(None), image(Some(FOG)));
    let (left, sky_left) = (FOG.left(far_m), FOG.left(FOG.sky_range_m));
    for pixel in 0..clear.rgb.len() {
        let alpha = clear.alpha[pixel];
        for channel in 0..3 {
            let behind = (1.0 - alpha) * f64::from(world.sky[channel]);
            let own = clear.rgb[pixel][channel] - behind;
            let air = FOG.color[channel];
            let expected = left * own
                + alpha * (1.0 - left) * air
                + sky_left * behind
                + (1.0 - alpha) * (1.0 - sky_left) * air;
            assert!((foggy.rgb[pixel][channel] - expected).abs() < 1e-12);
        }
        assert_eq!(
            (alpha, clear.depth[pixel]),
            (foggy.alpha[pixel], foggy.depth[pixel])
        );
    }
}

/// Clear air changes no bit, and fog changes nothing but color.
#[test]
fn fog_without_extinction_changes_no_bit() {
    let gpu = Validated::open();
    let world = crowded();
    let of = |fog: Option<Fog>| {
        draw(
            &gpu,
            &SplatScene {
                fog,
                ..world.clone()
            },
            &lens_rig(),
            Rules::DEFAULT,
        )
    };
    let plain = of(None);
    assert!(
        plain
            == of(Some(Fog {
                extinction_per_m: 0.0,
                ..FOG
            }))
    );
    for (foggy, plain) in of(Some(FOG)).iter().zip(&plain) {
        assert!(foggy.alpha == plain.alpha && foggy.planes == plain.planes);
        assert!(foggy.rgb != plain.rgb);
    }
}
