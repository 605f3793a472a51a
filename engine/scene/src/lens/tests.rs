use glam::{DVec2, DVec3};

use super::{FTheta, FThetaReference, Fisheye, Lens, OpenCv, RayMap};
use crate::Intrinsics;

const SIZE: (u32, u32) = (960, 600);

fn with(lens: Lens, focal_px: f64) -> Intrinsics {
    let (width_px, height_px) = SIZE;
    Intrinsics {
        width_px,
        height_px,
        fx_px: focal_px,
        fy_px: 1.02 * focal_px,
        cx_px: 471.3,
        cy_px: 310.8,
        lens,
        photometry: crate::Photometry::IDENTITY,
        windshield: None,
        shutter: crate::Shutter::GLOBAL,
    }
}

/// Coefficients of the size that calibrations of cars' cameras have.
fn lenses() -> Vec<(&'static str, Intrinsics)> {
    let open_cv = OpenCv {
        radial: [-0.32, 0.11, -0.004, 0.02, -0.01, 0.003],
        tangential: [0.0011, -0.0007],
        thin_prism: [0.0004, -0.0002, -0.0003, 0.0001],
    };
    let rational = OpenCv {
        radial: [0.9, -0.3, 0.02, 1.2, -0.1, 0.05],
        ..OpenCv::default()
    };
    let fisheye = Fisheye {
        radial: [-0.021, 0.004, -0.002, 0.0003],
        max_angle_rad: 1.4,
    };
    let f_theta = |reference| FTheta {
        reference,
        pixel_distance_to_angle: [0.0, 0.0021, 1.4e-7, -8.0e-10, 2.4e-12, -1.8e-15],
        angle_to_pixel_distance: [0.0, 473.6, -9.6, 24.9, -42.3, 15.1],
        max_angle_rad: 1.25,
        linear_cde: [0.9998, 6.3e-4, -1.0e-3],
    };
    vec![
        ("pinhole", with(Lens::Pinhole, 700.0)),
        ("distorted", with(Lens::OpenCv(open_cv), 600.0)),
        ("rational", with(Lens::OpenCv(rational), 600.0)),
        ("fisheye", with(Lens::Fisheye(fisheye), 380.0)),
        (
            "equidistant",
            with(Lens::Fisheye(Fisheye::default()), 300.0),
        ),
        (
            "f-theta forward",
            with(
                Lens::FTheta(f_theta(FThetaReference::AngleToPixelDistance)),
                473.6,
            ),
        ),
        (
            "f-theta backward",
            with(
                Lens::FTheta(f_theta(FThetaReference::PixelDistanceToAngle)),
                476.0,
            ),
        ),
    ]
}

fn pixels(size: (u32, u32)) -> impl Iterator<Item = DVec2> {
    let (columns, rows) = (24, 15);
    (0..=rows).flat_map(move |row| {
        (0..=columns).map(move |column| {
            DVec2::new(
                f64::from(size.0) * f64::from(column) / f64::from(columns),
                f64::from(size.1) * f64::from(row) / f64::from(rows),
            )
        })
    })
}

#[test]
fn a_pixel_is_the_pixel_of_its_ray() {
    for (name, intrinsics) in lenses() {
        intrinsics
            .check()
            .unwrap_or_else(|fault| panic!("{name}: {fault}"));
        let map = RayMap::new(&intrinsics);
        let mut seen = 0;
        for pixel in pixels(SIZE) {
            let Some(ray) = map.unproject(pixel) else {
                continue;
            };
            seen += 1;
            assert!((ray.length() - 1.0).abs() < 1e-12);
            let back = map
                .project(ray * 3.7)
                .unwrap_or_else(|| panic!("{name}: {pixel} has a ray and no pixel"));
            assert!(
                (back - pixel).length() < 1e-9,
                "{name}: {pixel} comes back as {back}"
            );
            assert_eq!(
                intrinsics.unproject(pixel).is_some(),
                map.unproject(pixel).is_some()
            );
        }
        assert!(seen > 300, "{name}: only {seen} of 400 pixels have a ray");
    }
}

#[test]
fn a_ray_is_the_ray_of_its_pixel() {
    for (name, intrinsics) in lenses() {
        let map = RayMap::new(&intrinsics);
        for i in 0..400 {
            let (around, off_axis) = (f64::from(i) * 0.7, map.limit_rad() * f64::from(i) / 401.0);
            let ray = DVec3::new(
                off_axis.sin() * around.cos(),
                off_axis.sin() * around.sin(),
                off_axis.cos(),
            );
            let pixel = map.project(ray).unwrap();
            let back = map
                .unproject(pixel)
                .unwrap_or_else(|| panic!("{name}: {pixel} of {off_axis} rad has no ray"));
            assert!(
                (back - ray).length() < 1e-9,
                "{name}: {ray} comes back as {back}"
            );
        }
    }
}

#[test]
fn formulas_are_those_of_opencv_and_nvidia() {
    // Worked by hand from the definitions, at a ray of slope 0.3, -0.2.
    let ray = DVec3::new(0.6, -0.4, 2.0);
    let (x, y, r2) = (0.3f64, -0.2f64, 0.13f64);
    let of = |index: usize| lenses()[index].1;
    let factor = (1.0 - 0.32 * r2 + 0.11 * r2 * r2 - 0.004 * r2.powi(3))
        / (1.0 + 0.02 * r2 - 0.01 * r2 * r2 + 0.003 * r2.powi(3));
    let distorted = DVec2::new(
        x * factor + 2.0 * 0.0011 * x * y - 0.0007 * (r2 + 2.0 * x * x) + 0.0004 * r2
            - 0.0002 * r2 * r2,
        y * factor + 0.0011 * (r2 + 2.0 * y * y) - 2.0 * 0.0007 * x * y - 0.0003 * r2
            + 0.0001 * r2 * r2,
    );
    let expected = DVec2::new(600.0, 612.0) * distorted + DVec2::new(471.3, 310.8);
    assert!((of(1).project(ray).unwrap() - expected).length() < 1e-10);

    let a = r2.sqrt().atan();
    let direction = DVec2::new(x, y) / r2.sqrt();
    let radius = a - 0.021 * a.powi(3) + 0.004 * a.powi(5) - 0.002 * a.powi(7) + 0.0003 * a.powi(9);
    let expected = DVec2::new(380.0, 387.6) * direction * radius + DVec2::new(471.3, 310.8);
    assert!((of(3).project(ray).unwrap() - expected).length() < 1e-10);

    let radius =
        473.6 * a - 9.6 * a.powi(2) + 24.9 * a.powi(3) - 42.3 * a.powi(4) + 15.1 * a.powi(5);
    let v = direction * radius;
    let expected =
        DVec2::new(0.9998 * v.x + 6.3e-4 * v.y, -1.0e-3 * v.x + v.y) + DVec2::new(471.3, 310.8);
    assert!((of(5).project(ray).unwrap() - expected).length() < 1e-10);

    // The backward polynomial says which angle a pixel has.
    let pixel = DVec2::new(471.3 + 0.9998 * 200.0, 310.8 - 1.0e-3 * 200.0);
    let ray = of(6).unproject(pixel).unwrap();
    let angle = 0.0021 * 200.0 + 1.4e-7 * 4e4 - 8.0e-10 * 8e6 + 2.4e-12 * 1.6e9 - 1.8e-15 * 3.2e11;
    assert!((ray.x.atan2(ray.z) - angle).abs() < 1e-12 && ray.y.abs() < 1e-12);
}

#[test]
fn a_resized_or_cropped_camera_sees_the_same_rays() {
    for (name, full) in lenses() {
        let small = full.resized(SIZE.0 / 2, SIZE.1 / 4);
        let crop = full.cropped(100, 50, 300, 200);
        small
            .check()
            .unwrap_or_else(|fault| panic!("{name}: {fault}"));
        for pixel in pixels((300, 200)) {
            let here = full.unproject(pixel + DVec2::new(100.0, 50.0));
            let there = crop.unproject(pixel);
            assert!(
                here.unwrap_or(DVec3::Z).distance(there.unwrap_or(DVec3::Z)) < 1e-9,
                "{name}: crop, {pixel}"
            );
        }
        for pixel in pixels(SIZE) {
            if let Some(ray) = full.unproject(pixel) {
                let there = small.unproject(pixel * DVec2::new(0.5, 0.25));
                // Where a lens ends is found in steps.
                assert!(
                    there.is_none_or(|there| there.distance(ray) < 1e-9),
                    "{name}: {pixel} resized"
                );
                assert!(
                    there.is_some() || full.lens.is_pinhole() || ray.z < 0.8,
                    "{name}: {pixel} lost its ray"
                );
            }
        }
    }
}

#[test]
fn beyond_its_end_a_lens_goes_on_without_a_jump_and_never_back() {
    for (name, intrinsics) in lenses() {
        let map = RayMap::new(&intrinsics);
        let center = DVec2::new(intrinsics.cx_px, intrinsics.cy_px);
        for around in 0..12 {
            let (s, c) = (f64::from(around) * 0.55).sin_cos();
            let mut before = (0.0, center);
            for step in 1..=3000 {
                let angle = std::f64::consts::PI * f64::from(step) / 3000.0;
                let ray = DVec3::new(angle.sin() * c, angle.sin() * s, angle.cos());
                let pixel = map.project_extended(ray);
                let distance = (pixel - center).length();
                assert!(distance > before.0 - 1e-9, "{name}: comes back at {angle}");
                assert!(
                    pixel.distance(before.1) < 30.0,
                    "{name}: jumps by {} at {angle}",
                    pixel.distance(before.1)
                );
                before = (distance, pixel);
                let shown = map.project(ray);
                assert!(
                    (angle - map.limit_rad()).abs() < 1e-12
                        || shown.is_some() == (angle < map.limit_rad()),
                    "{name}: {angle}"
                );
                assert!(shown.is_none_or(|shown| shown.distance(pixel) < 1e-9));
            }
        }
    }
}

#[test]
fn lenses_that_make_no_image_are_refused_with_the_reason() {
    let refused = |lens: Lens, part: &str| {
        let fault = with(lens, 400.0).check().unwrap_err();
        assert!(
            fault.reason().contains(part),
            "'{fault}' does not say '{part}'"
        );
    };
    let open_cv = |radial: [f64; 6]| {
        Lens::OpenCv(OpenCv {
            radial,
            ..OpenCv::default()
        })
    };
    refused(open_cv([f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]), "NaN");
    refused(open_cv([-40.0, 0.0, 0.0, 0.0, 0.0, 0.0]), "folds");
    refused(open_cv([0.0, 0.0, 0.0, 30.0, 0.0, 0.0]), "folds");
    refused(open_cv([1e300, 1e300, 0.0, -1e300, 0.0, 0.0]), "folds");
    refused(
        Lens::OpenCv(OpenCv {
            thin_prism: [f64::INFINITY, 0.0, 0.0, 0.0],
            ..OpenCv::default()
        }),
        "inf",
    );
    refused(
        Lens::OpenCv(OpenCv {
            tangential: [5.0, 0.0],
            ..OpenCv::default()
        }),
        "folds",
    );
    let fisheye = |k1: f64, max_angle_rad: f64| {
        Lens::Fisheye(Fisheye {
            radial: [k1, 0.0, 0.0, 0.0],
            max_angle_rad,
        })
    };
    refused(fisheye(0.0, f64::NAN), "max angle NaN");
    refused(fisheye(0.0, -1.0), "max angle -1");
    refused(fisheye(0.0, 4.0), "max angle 4");
    refused(fisheye(f64::NAN, 1.0), "NaN");
    refused(fisheye(-0.5, 1.5), "turns over at 0.81");
    // Ended before that, it is a lens.
    assert_eq!(with(fisheye(-0.5, 0.8), 400.0).check(), Ok(()));
    let f_theta = |reference, polynomial: [f64; 6], cde: [f64; 3]| {
        Lens::FTheta(FTheta {
            reference,
            pixel_distance_to_angle: polynomial,
            angle_to_pixel_distance: polynomial,
            max_angle_rad: 1.2,
            linear_cde: cde,
        })
    };
    let (forward, backward) = (
        FThetaReference::AngleToPixelDistance,
        FThetaReference::PixelDistanceToAngle,
    );
    refused(f_theta(forward, [0.0; 6], [1.0, 0.0, 0.0]), "rising");
    refused(
        f_theta(forward, [5.0, 400.0, 0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        "begins 5",
    );
    refused(
        f_theta(
            forward,
            [0.0, 400.0, 0.0, -300.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
        ),
        "turns over at 0.66",
    );
    refused(
        f_theta(
            backward,
            [0.0, 0.002, 0.0, -1e-8, 0.0, 0.0],
            [1.0, 0.0, 0.0],
        ),
        "turns over",
    );
    refused(
        f_theta(
            backward,
            [0.0, 0.002, 0.0, 0.0, f64::NAN, 0.0],
            [1.0, 0.0, 0.0],
        ),
        "NaN",
    );
    refused(
        f_theta(forward, [0.0, 400.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 1.0]),
        "fold",
    );
    refused(
        f_theta(
            forward,
            [0.0, 400.0, 0.0, 0.0, 0.0, 0.0],
            [1.0, f64::NAN, 0.0],
        ),
        "NaN",
    );
}

#[test]
fn a_pinhole_in_other_words_is_the_pinhole() {
    let plain = with(Lens::Pinhole, 500.0);
    let zero = with(Lens::OpenCv(OpenCv::default()), 500.0);
    assert!(zero.lens.is_pinhole());
    let ray = DVec3::new(0.31, -0.17, 1.3);
    assert_eq!(plain.project(ray), zero.project(ray));
    assert!(
        (RayMap::new(&zero).project(ray).unwrap() - plain.project(ray).unwrap()).length() < 1e-11
    );
    for intrinsics in [plain, zero] {
        assert_eq!(intrinsics.project(DVec3::new(0.1, 0.1, -1.0)), None);
        assert!(
            intrinsics.project(DVec3::new(30.0, 0.0, 1.0)).is_some(),
            "far beside the image is a pixel, too"
        );
        assert!(
            (intrinsics.unproject(plain.project(ray).unwrap()).unwrap() - ray.normalize()).length()
                < 1e-12
        );
    }
}

#[test]
fn what_is_no_ray_has_no_pixel() {
    for (_, intrinsics) in lenses() {
        let map = RayMap::new(&intrinsics);
        for ray in [
            DVec3::ZERO,
            DVec3::NAN,
            DVec3::new(0.0, 0.0, -1.0),
            DVec3::new(1.0, 0.0, 0.0),
        ] {
            assert_eq!(map.project(ray), None, "{ray}");
        }
        assert_eq!(map.unproject(DVec2::NAN), None);
        assert_eq!(
            map.project(DVec3::Z),
            Some(DVec2::new(intrinsics.cx_px, intrinsics.cy_px))
        );
        assert!(map.project_extended(DVec3::NEG_Z).is_finite());
        assert!(
            map.project_extended(DVec3::new(1e-200, 0.0, -1.0))
                .is_finite()
        );
    }
}
