//! Probes, irradiance and the truth, against what is known of them in closed form.

use std::f64::consts::PI;

use decouplegs_scene::light::{
    IrradianceMap, Surroundings, reflected_by_white, reflected_by_white_of_nine,
};
use glam::{DQuat, DVec3};

use super::super::*;
use super::{ball, sky};

fn directions() -> impl Iterator<Item = DVec3> {
    (0..60).map(|index| {
        let (azimuth, z) = (
            2.4 * f64::from(index),
            1.0 - (2.0 * f64::from(index) + 1.0) / 60.0,
        );
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z)
    })
}

#[test]
fn pixels_cover_the_sphere_once_and_lie_where_the_convention_says() {
    let probe = Probe::from_fn("axes", 64, |d| d.as_vec3().to_array());
    let total: f64 = (0..probe.pixels().len())
        .map(|pixel| probe.solid_angle(pixel))
        .sum();
    assert!((total - 4.0 * PI).abs() < 1e-12);
    // The top is up, the middle is ahead, left of it is left. Clamping made negative components 0.
    let (top, bottom) = (probe.pixels()[3], probe.pixels()[64 * 31 + 3]);
    assert!(top[2] > 0.99 && bottom[2] == 0.0, "{top:?} {bottom:?}");
    let row = 16 * 64;
    assert!(
        probe.pixels()[row + 32][0] > 0.99
            && probe.pixels()[row + 16][1] > 0.99
            && probe.pixels()[row + 48][1] == 0.0
    );
    for direction in directions().filter(|direction| direction.z.abs() < 0.95) {
        let found = probe.radiance(direction).map(f64::from);
        let expected = direction.max(DVec3::ZERO).to_array();
        // Half a pixel is 2.8 degrees.
        assert!(
            found
                .iter()
                .zip(expected)
                .all(|(a, b)| (a - b).abs() < 0.06),
            "{direction}: {found:?}"
        );
    }
}

#[test]
fn no_light_is_lost_when_a_probe_is_made_smaller() {
    let flux = |probe: &Probe| {
        probe
            .rays()
            .map(|(_, steradians, rgb)| steradians * rgb[0])
            .sum::<f64>()
    };
    // 100 columns in blocks of 7 do not come out even.
    for (width, to) in [(96, 12), (96, 48), (100, 15), (96, 96), (96, 500)] {
        let probe = sky(3, width);
        let small = probe.downsampled(to);
        assert!(
            (flux(&small) / flux(&probe) - 1.0).abs()
                < if width % to == 0 || to > width {
                    1e-6
                } else {
                    0.02
                },
            "{width} to {to}"
        );
        assert!(small.width() <= to.max(1) || to > width);
    }
}

#[test]
fn what_is_no_radiance_is_clamped_and_counted() {
    let mut pixels = vec![[1.0f32; 3]; 8];
    (pixels[0][1], pixels[3][0], pixels[5][2]) = (f32::NAN, f32::INFINITY, -0.5);
    let probe = Probe::new("broken", 4, 2, pixels);
    assert_eq!(probe.clamped, 3);
    assert!(
        probe
            .pixels()
            .as_flattened()
            .iter()
            .all(|value| value.is_finite() && *value >= 0.0)
    );
}

#[test]
fn an_even_light_falls_evenly_and_a_sun_by_the_cosine() {
    let even = Probe::from_fn("even", 128, |_| [0.5, 1.0, 2.0]);
    let map = IrradianceMap::new(&even);
    for normal in directions() {
        for reflected in [
            map.reflected_by_white(normal),
            reflected_by_white(&even, normal),
        ] {
            assert!(
                (reflected[0] - 0.5).abs() < 2e-3 && (reflected[2] - 2.0).abs() < 8e-3,
                "{normal}: {reflected:?}"
            );
        }
    }
    let mut pixels = vec![[0.0f32; 3]; 128 * 64];
    let pixel = 20 * 128 + 47;
    pixels[pixel] = [(PI / even.solid_angle(pixel)) as f32; 3];
    let sun = Probe::new("sun", 128, 64, pixels);
    let (map, towards) = (IrradianceMap::new(&sun), sun.direction(pixel));
    for normal in directions() {
        let expected = normal.dot(towards).max(0.0);
        assert!((reflected_by_white(&sun, normal)[1] - expected).abs() < 1e-6);
        // Where the sun sets, the map's straight lines cut a corner of 2.8 degrees.
        assert!(
            (map.reflected_by_white(normal)[1] - expected).abs() < 0.013,
            "{normal}"
        );
    }
}

#[test]
fn nine_coefficients_hold_the_irradiance_of_a_smooth_sky_to_a_few_percent() {
    let probe = sky(5, 96);
    let map = IrradianceMap::new(&probe);
    let (mut worst, mut scale) = (0.0f64, 0.0f64);
    for normal in directions() {
        let (exact, nine) = (
            map.reflected_by_white(normal),
            reflected_by_white_of_nine(&probe, normal),
        );
        let summed = reflected_by_white(&probe, normal);
        for channel in 0..3 {
            assert!(
                (exact[channel] / summed[channel] - 1.0).abs() < 2e-3,
                "{normal}: {exact:?} {summed:?}"
            );
            worst = worst.max((exact[channel] - nine[channel]).abs());
            scale = scale.max(exact[channel]);
        }
    }
    // Ramamoorthi and Hanrahan bound the error of any light at 9 % and find 3 % at most in theirs,
    // of the largest value.
    assert!(worst < 0.05 * scale, "{worst} of {scale}");
    // The two readings differ where the light does: a sky of one turn does not serve another.
    let turned = map.reflected_by_white(DQuat::from_rotation_z(2.0) * DVec3::X)[0];
    assert!((turned - map.reflected_by_white(DVec3::X)[0]).abs() > 0.02 * scale);
}

#[test]
fn turning_and_mirroring_a_light_is_turning_and_mirroring_its_probe() {
    let (probe, ground) = (sky(7, 96), Surroundings::default());
    let prepared = PreparedProbe::new(&probe, &ground);
    for (yaw_rad, mirrored) in [
        (0.0, false),
        (std::f64::consts::FRAC_PI_2, false),
        (-std::f64::consts::FRAC_PI_2, true),
    ] {
        let light = Lighting::of_probe((0, &prepared), &ground, yaw_rad, mirrored, 0.4).unwrap();
        // Quarter turns and mirror images map pixels to pixels, so this is the same light without
        // the code under test.
        let moved = Probe::from_fn("moved", 96, |direction| {
            let mut back = DQuat::from_rotation_z(-yaw_rad) * direction;
            if mirrored {
                back.y = -back.y;
            }
            probe.radiance(back)
        });
        let moved = PreparedProbe::new(&moved, &ground);
        let expected = Lighting::of_probe((0, &moved), &ground, 0.0, false, 0.4).unwrap();
        for (a, b) in light
            .descriptor
            .to_vector()
            .iter()
            .zip(expected.descriptor.to_vector())
        {
            assert!((a - b).abs() < 1e-5, "{yaw_rad} {mirrored}: {a} {b}");
        }
        for normal in directions() {
            let (a, b) = (
                light.reflected_by_white(normal)[0],
                expected.reflected_by_white(normal)[0],
            );
            assert!(
                (a / b - 1.0).abs() < 5e-3,
                "{yaw_rad} {mirrored} {normal}: {a} {b}"
            );
        }
    }
}

#[test]
fn white_light_shows_colors_as_they_are_and_the_sunny_side_is_brighter() {
    let cloud = ball(300, 2);
    let same = lit_cloud(&cloud, |_| [1.0; 3]);
    for (a, b) in cloud
        .sh_dc
        .iter()
        .chain(&cloud.sh_rest)
        .zip(same.sh_dc.iter().chain(&same.sh_rest))
    {
        assert!(
            (0..3).all(|channel| (a[channel] - b[channel]).abs() < 1e-5),
            "{a:?} {b:?}"
        );
    }
    let sunny = lit_cloud(&cloud, |normal| [2.0 * normal.z.max(0.0); 3]);
    for splat in 0..cloud.len() {
        let (before, after) = (cloud.sh_dc[splat][0], sunny.sh_dc[splat][0]);
        // Outward normals: what is above the middle faces up.
        match cloud.means[splat][2] {
            z if z < -0.05 => assert!(after < before, "the dark side of splat {splat}"),
            z if z > 0.6 => assert!(after > before, "the bright side of splat {splat}"),
            _ => {}
        }
    }
}
