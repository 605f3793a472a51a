//! Footprints through lenses against what each pixel's own ray sees of the Gaussian.

use decouplegs_scene::lens::{FTheta, FThetaReference, Fisheye, OpenCv};
use decouplegs_scene::{Camera, Intrinsics, Lens, Motion, Pose, RayMap, Rules};
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::super::project::Projected64;
use super::super::render;
use super::{Plain, WHITE, projected, world_of};

/// Lenses of cars: 1600 x 900, 120 degrees across by angle and 70 by distortion.
fn lenses() -> [(&'static str, Lens, f64); 3] {
    let open_cv = OpenCv {
        radial: [-0.31, 0.11, -0.01, 0.03, -0.01, 0.001],
        ..OpenCv::default()
    };
    let f_theta = FTheta {
        reference: FThetaReference::AngleToPixelDistance,
        pixel_distance_to_angle: [0.0; 6],
        angle_to_pixel_distance: [0.0, 790.0, -16.0, 41.6, -70.6, 25.2],
        max_angle_rad: 1.3,
        linear_cde: [1.0, 1e-4, -1e-4],
    };
    let fisheye = Fisheye {
        radial: [-0.02, 0.004, -0.002, 0.0003],
        max_angle_rad: 1.4,
    };
    [
        ("OpenCV", Lens::OpenCv(open_cv), 1100.0),
        ("fisheye", Lens::Fisheye(fisheye), 760.0),
        ("f-theta", Lens::FTheta(f_theta), 790.0),
    ]
}

fn camera(lens: Lens, focal_px: f64, size: (u32, u32)) -> Camera {
    let mut intrinsics = Intrinsics {
        lens,
        ..Intrinsics::from_horizontal_fov(size.0, size.1, 1.0)
    };
    (intrinsics.fx_px, intrinsics.fy_px) = (focal_px, focal_px);
    intrinsics.check().unwrap();
    Camera {
        name: "lens".into(),
        intrinsics,
        world_from_camera: Pose::IDENTITY,
        motion: Motion::REST,
    }
}

/// The exponent of a Gaussian's greatest value along a ray (Wu et al., 3DGUT, 2025, equation 11):
/// its share of the peak is `exp` of it.
fn along(ray: DVec3, mean: DVec3, inverse: &DMat3) -> f64 {
    let (a, b) = (*inverse * ray, *inverse * mean);
    let position = ray.dot(b);
    -0.5 * (mean.dot(b) - position * position / ray.dot(a))
}

/// The mean position of what the pixels' rays see of the Gaussian, and its standard deviation,
/// pixels: sampled on a grid about the footprint, six of its standard deviations each way.
fn seen(map: &RayMap, mean: DVec3, axes: &DMat3, footprint: &Projected64) -> Option<(DVec2, f64)> {
    let inverse = (*axes * axes.transpose()).inverse();
    let spread = DVec2::new(footprint.half_extent_px.x, footprint.half_extent_px.y);
    let (mut weight, mut first, mut second) = (0.0, DVec2::ZERO, 0.0);
    let steps = 48;
    for row in -steps..=steps {
        for column in -steps..=steps {
            let offset =
                2.0 * spread * DVec2::new(f64::from(column), f64::from(row)) / f64::from(steps);
            let Some(ray) = map.unproject(footprint.mean_px + offset) else {
                continue;
            };
            let here = along(ray, mean, &inverse).exp();
            weight += here;
            first += here * offset;
            second += here * offset.length_squared();
        }
    }
    let center = first / weight;
    (weight > 1e-3).then(|| {
        (
            footprint.mean_px + center,
            (0.5 * (second / weight - center.length_squared()))
                .max(0.0)
                .sqrt(),
        )
    })
}

/// Numbers from 0 to 1.
fn noise(index: u32, stream: u32) -> f64 {
    let x = index.wrapping_mul(2_654_435_761) ^ stream.wrapping_mul(0x9e37_79b9);
    let x = (x ^ x >> 15).wrapping_mul(0x2c1b_3c6d);
    f64::from((x ^ x >> 12).wrapping_mul(0x297a_2d39) >> 8) / f64::from(1 << 24)
}

/// A splat as streets have them: 1 to 30 cm, flat or long, 3 to 60 m away, somewhere in the image.
fn street_splat(index: u32, map: &RayMap, size: (u32, u32)) -> Option<(DVec3, DMat3)> {
    let pixel = DVec2::new(
        noise(index, 1) * f64::from(size.0),
        noise(index, 2) * f64::from(size.1),
    );
    let mean = map.unproject(pixel)? * 3.0 * 20f64.powf(noise(index, 3));
    let scale = |stream: u32| 0.01 * 30f64.powf(noise(index, stream));
    let turn = DQuat::from_xyzw(
        noise(index, 7) - 0.5,
        noise(index, 8) - 0.5,
        noise(index, 9) - 0.5,
        noise(index, 10) - 0.5,
    );
    Some((
        mean,
        DMat3::from_quat(turn.normalize())
            * DMat3::from_diagonal(DVec3::new(scale(4), scale(5), scale(6))),
    ))
}

/// The footprint that the definition gives a Gaussian whose axes are those of the splat.
fn footprint(camera: &Camera, mean: DVec3, axes: &DMat3) -> Option<(Projected64, DVec3, DMat3)> {
    let scales = [
        axes.x_axis.length(),
        axes.y_axis.length(),
        axes.z_axis.length(),
    ];
    let turn = DQuat::from_mat3(&DMat3::from_cols(
        axes.x_axis / scales[0],
        axes.y_axis / scales[1],
        axes.z_axis / scales[2],
    ));
    let scales = scales.map(|scale| scale as f32);
    let mut splat_scene = world_of(&[Plain {
        mean: mean.as_vec3().to_array(),
        scales,
        opacity: 0.9,
        rgb: WHITE,
    }]);
    splat_scene.splats.rotations[0] = [turn.w, turn.x, turn.y, turn.z].map(|value| value as f32);
    Some((
        projected(&splat_scene, camera, &Rules::DEFAULT)?,
        mean,
        *axes,
    ))
}

#[test]
fn footprints_of_small_splats_are_where_rays_see_them() {
    let size = (1600, 900);
    for (name, lens, focal_px) in lenses() {
        let camera = camera(lens, focal_px, size);
        let map = RayMap::new(&camera.intrinsics);
        let mut errors: Vec<(f64, f64, f64)> = Vec::new();
        for index in 0..500 {
            let Some((mean, axes)) = street_splat(index, &map, size) else {
                continue;
            };
            let Some((splat, mean, axes)) = footprint(&camera, mean, &axes) else {
                continue;
            };
            let Some((center, spread_px)) = seen(&map, mean, &axes, &splat) else {
                continue;
            };
            let off_axis = mean.truncate().length().atan2(mean.z);
            errors.push((spread_px, (center - splat.mean_px).length(), off_axis));
        }
        assert!(
            errors.len() > 350,
            "{name}: only {} splats were measured",
            errors.len()
        );
        for (low, high) in [
            (0.0, 1.0),
            (1.0, 3.0),
            (3.0, 10.0),
            (10.0, 30.0),
            (30.0, 1e9),
        ] {
            let mut here: Vec<_> = errors
                .iter()
                .filter(|(spread_px, ..)| (low..high).contains(spread_px))
                .collect();
            here.sort_by(|a, b| a.1.total_cmp(&b.1));
            let at = |share: f64| {
                here.get(((here.len() as f64 - 1.0) * share) as usize)
                    .map_or(0.0, |error| error.1)
            };
            let worst = here.last().map_or(0.0, |error| error.2.to_degrees());
            println!(
                "{name}, {low} to {high} px wide: {} splats, median {:.4} px, 99 % {:.4}, largest {:.4} ({worst:.0} degrees off axis)",
                here.len(),
                at(0.5),
                at(0.99),
                at(1.0)
            );
            // Small is what is at most three pixels wide; beyond, the footprint is an ellipse where
            // what rays see is none, most of all where a splat is deep against its distance.
            if high <= 3.0 {
                assert!(
                    at(1.0) <= 0.25,
                    "{name}: {} px where splats are {low} to {high} px wide",
                    at(1.0)
                );
            } else if high <= 10.0 {
                assert!(
                    at(0.5) <= 0.25,
                    "{name}: half of the splats {low} to {high} px wide are {} px off",
                    at(0.5)
                );
            }
        }
    }
}

#[test]
fn a_marker_is_drawn_where_its_ray_falls() {
    let size = (160, 90);
    for (name, lens, focal_px) in lenses() {
        // The same lens in an image of a tenth.
        let mut camera = camera(lens, focal_px, (1600, 900));
        camera.intrinsics = camera.intrinsics.resized(size.0, size.1);
        (camera.intrinsics.fx_px, camera.intrinsics.fy_px) = (focal_px / 10.0, focal_px / 10.0);
        for (column, row) in [
            (80.0, 45.0),
            (20.3, 12.7),
            (150.6, 80.2),
            (5.5, 45.5),
            (81.2, 84.0),
        ] {
            let pixel = DVec2::new(column, row);
            let ray = camera
                .intrinsics
                .unproject(pixel)
                .unwrap_or_else(|| panic!("{name}: {pixel} has no ray"));
            let marker = Plain::ball((ray * 12.0).as_vec3().to_array(), 0.01, 0.9, WHITE);
            let image = render(&world_of(&[marker]), &camera, &Rules::DEFAULT);
            let (mut weight, mut position) = (0.0, DVec2::ZERO);
            for (index, alpha) in image.alpha.iter().enumerate() {
                let at = DVec2::new(
                    f64::from(index as u32 % size.0) + 0.5,
                    f64::from(index as u32 / size.0) + 0.5,
                );
                weight += alpha;
                position += *alpha * at;
            }
            assert!(
                (position / weight - pixel).length() < 0.06,
                "{name}: drawn at {} instead of {pixel}",
                position / weight
            );
        }
    }
}

#[test]
fn a_splat_beyond_the_end_of_the_lens_is_not_drawn_and_one_at_it_is() {
    let lens = Lens::Fisheye(Fisheye {
        radial: [0.0; 4],
        max_angle_rad: 1.0,
    });
    let camera = camera(lens, 100.0, (400, 400));
    let at = |angle: f64, scale: f32| {
        let ball = Plain::ball(
            [
                (10.0 * angle.sin()) as f32,
                0.0,
                (10.0 * angle.cos()) as f32,
            ],
            scale,
            0.9,
            WHITE,
        );
        projected(&world_of(&[ball]), &camera, &Rules::DEFAULT)
    };
    assert!(at(0.99, 0.01).is_some());
    assert!(at(1.01, 0.01).is_none());
    // What reaches over the end is seen within it.
    let wide = at(1.05, 0.5).unwrap();
    assert!((wide.mean_px.x - 305.0).abs() < 2.0, "{}", wide.mean_px);
}
