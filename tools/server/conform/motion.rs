//! Checks of shutters and of objects.

use decouplegs::scene::Pose;
use glam::DVec3;

use super::check::{Judged, Stop, failed};
use super::rgb_image::RgbImage;
use super::target::{FOCAL_PX, SIZE_PX, Target, pair, pinhole, spec_of};
use decouplegs_alpasim::wire::sensorsim::{
    CameraSpec, DynamicObject, RgbRenderRequest, ShutterType,
};

/// Largest mean difference of a rolling shutter at rest from a global one, of 255.
const REST_DIFFERENCE_MAX: f64 = 0.05;
/// Turn of the camera during the readout, radians: about 14 pixels of the compared views.
const TURN_RAD: f64 = 0.04;
/// Rows at either edge that are compared, pixels.
const EDGE_PX: u32 = 20;
/// Distance of the object in front of the camera, meters.
const AHEAD_M: f64 = 12.0;
/// Greatest height of the middle of what is drawn above the pose of an object, meters: half of a
/// car's height is 0.75.
const OFF_CENTER_MAX_M: f64 = 0.4;
/// Smallest share of pixels that change where an object appears.
const SHOWN_SHARE_MIN: f64 = 0.002;

pub(super) async fn instant(target: &mut Target) -> Judged {
    let request = target.request();
    let with_shutter = target.image(request.clone()).await?;
    let request = RgbRenderRequest {
        frame_end_us: request.frame_start_us,
        ..request
    };
    let instant = target.image(request).await?;
    let difference = with_shutter.difference(&instant);
    if difference > 0.0 {
        return failed(format!(
            "the view at rest differs by {difference:.3} of 255 from one with an open shutter"
        ));
    }
    Ok("the same pixels".into())
}

fn rolling(shutter: ShutterType) -> CameraSpec {
    CameraSpec {
        shutter_type: shutter.into(),
        ..spec_of(pinhole())
    }
}

pub(super) async fn at_rest(target: &mut Target) -> Judged {
    let request = target.request();
    let expected = target.view(request).await?;
    let sensor = target.sensor();
    let spec = rolling(ShutterType::RollingTopToBottom);
    let request = target.request_of(spec, &sensor, &sensor);
    let difference = expected.difference(&target.image(request).await?);
    if difference > REST_DIFFERENCE_MAX {
        return failed(format!(
            "{difference:.2} of 255 from the global shutter; at most {REST_DIFFERENCE_MAX} is expected"
        ));
    }
    Ok(format!("{difference:.3} of 255 from the global shutter"))
}

/// Compares the edges of an image of a turning camera with the views at rest of both ends.
pub(super) async fn rows(target: &mut Target, reversed: bool) -> Judged {
    let start = target.sensor();
    let turn = Pose::new(
        glam::DQuat::from_axis_angle(DVec3::Y, TURN_RAD),
        DVec3::ZERO,
    );
    let end = start.then(&turn);
    let mut views = Vec::new();
    for pose in [&start, &end] {
        let request = target.request_of(spec_of(pinhole()), pose, pose);
        views.push(target.view(request).await?);
    }
    let shutter = match reversed {
        true => ShutterType::RollingBottomToTop,
        false => ShutterType::RollingTopToBottom,
    };
    let request = target.request_of(rolling(shutter), &start, &end);
    let moving = target.image(request).await?;
    if moving.size() != SIZE_PX {
        return failed("the image has another size");
    }
    let (first, last) = match reversed {
        true => (&views[1], &views[0]),
        false => (&views[0], &views[1]),
    };
    let bottom = SIZE_PX[1] - EDGE_PX..SIZE_PX[1];
    let mut judged = 0;
    for (rows, near, far) in [(0..EDGE_PX, first, last), (bottom, last, first)] {
        let apart = near.difference_in(far, rows.clone());
        if apart < 1.0 {
            // Nothing to see there: the sky, a plain road.
            continue;
        }
        judged += 1;
        let (to_near, to_far) = (
            moving.difference_in(near, rows.clone()),
            moving.difference_in(far, rows.clone()),
        );
        if to_near >= 0.7 * to_far {
            return failed(format!(
                "rows {} to {} are {to_near:.1} of 255 from the view that they should show and {to_far:.1} from the other",
                rows.start, rows.end
            ));
        }
    }
    if judged == 0 {
        return Err(Stop::Skipped("the edges of the view show nothing".into()));
    }
    Ok(format!(
        "{judged} edges of the image seen at the right time"
    ))
}

/// Pixels that differ between two images.
struct Changed {
    /// Share of pixels that differ by more than 8 of 255.
    share: f64,
    /// Mean column and row of these, pixels.
    middle_px: [f64; 2],
}

fn changed(a: &RgbImage, b: &RgbImage) -> Changed {
    let width = a.width_px as usize;
    let pixels = a.rgb.chunks_exact(3).zip(b.rgb.chunks_exact(3)).enumerate();
    let places: Vec<[usize; 2]> = pixels
        .filter(|(_, (a, b))| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 8))
        .map(|(at, _)| [at % width, at / width])
        .collect();
    let count = places.len().max(1) as f64;
    let mean = |axis: usize| {
        let sum: usize = places.iter().map(|place| place[axis]).sum();
        0.5 + sum as f64 / count
    };
    Changed {
        share: places.len() as f64 / (a.rgb.len() / 3).max(1) as f64,
        middle_px: [mean(0), mean(1)],
    }
}

/// Image of the scene with `object` alone.
async fn with(target: &mut Target, object: DynamicObject) -> Result<RgbImage, Stop> {
    let request = RgbRenderRequest {
        dynamic_objects: vec![object],
        ..target.request()
    };
    target.image(request).await
}

/// Views without the object and with it at `right_m`. It is hidden as AlpaSim hides objects, far
/// below the ground: a renderer may draw those that a request does not list where they were
/// recorded, as NuRec does.
async fn with_object(target: &mut Target, right_m: f64) -> Result<[RgbImage; 2], Stop> {
    let object = target.object(AHEAD_M, right_m, 0.0)?;
    let hidden = target.hidden_object()?;
    Ok([with(target, hidden).await?, with(target, object).await?])
}

/// Views of [`with_object`]; skips the check where the object is not drawn at all.
async fn with_shown_object(target: &mut Target) -> Result<[RgbImage; 2], Stop> {
    let images = with_object(target, 0.0).await?;
    if changed(&images[0], &images[1]).share < SHOWN_SHARE_MIN {
        return Err(Stop::Skipped(
            "the object is not drawn where it is listed".into(),
        ));
    }
    Ok(images)
}

pub(super) async fn object_shown(target: &mut Target) -> Judged {
    let [without, with] = with_object(target, 0.0).await?;
    let share = changed(&without, &with).share;
    if share < SHOWN_SHARE_MIN {
        return failed(format!(
            "{AHEAD_M} m in front of the camera it changes {:.2} % of the pixels",
            100.0 * share
        ));
    }
    Ok(format!("{:.1} % of the pixels change", 100.0 * share))
}

pub(super) async fn object_moves(target: &mut Target) -> Judged {
    let mut columns = Vec::new();
    for right_m in [-2.0, 2.0] {
        let [without, with] = with_object(target, right_m).await?;
        let Changed { share, middle_px } = changed(&without, &with);
        if share < SHOWN_SHARE_MIN {
            return failed(format!(
                "{right_m} m to the right of the view it is not drawn"
            ));
        }
        columns.push(middle_px[0]);
    }
    // Four meters at the distance of the object, by the focal length; its own sides differ.
    let expected_px = 4.0 / AHEAD_M * FOCAL_PX;
    let found_px = columns[1] - columns[0];
    let figure = format!("4 m to the right are {found_px:.0} px; expected {expected_px:.0}");
    if (found_px - expected_px).abs() > 0.35 * expected_px {
        return failed(figure);
    }
    Ok(figure)
}

pub(super) async fn object_centered(target: &mut Target) -> Judged {
    let [without, with] = with_shown_object(target).await?;
    // Its center is level with the camera: on the horizon.
    let sensor = target.sensor();
    let toward = sensor.rotation.inverse() * target.object_direction();
    let expected_px = 0.5 * f64::from(SIZE_PX[1]) + FOCAL_PX * toward.y / toward.z;
    let found_px = changed(&without, &with).middle_px[1];
    let off_m = (expected_px - found_px) * AHEAD_M / FOCAL_PX;
    let figure = format!("its middle is drawn {off_m:.2} m above its pose");
    if off_m.abs() > OFF_CENTER_MAX_M {
        return failed(format!(
            "{figure}; at most {OFF_CENTER_MAX_M} m is expected"
        ));
    }
    Ok(figure)
}

pub(super) async fn object_turns(target: &mut Target) -> Judged {
    let [_, ahead] = with_shown_object(target).await?;
    let object = target.object(AHEAD_M, 0.0, std::f64::consts::FRAC_PI_2)?;
    let across = with(target, object).await?;
    let share = changed(&ahead, &across).share;
    if share < 0.5 * SHOWN_SHARE_MIN {
        return failed(format!(
            "turned by 90 degrees it changes {:.2} % of the pixels",
            100.0 * share
        ));
    }
    Ok(format!(
        "turned by 90 degrees it changes {:.1} % of the pixels",
        100.0 * share
    ))
}

pub(super) async fn forgotten(target: &mut Target) -> Judged {
    let request = target.request();
    let before = target.image(request.clone()).await?;
    let [hidden, _] = with_shown_object(target).await?;
    // The object was just drawn: the next request must forget it.
    let after = target.image(request).await?;
    let difference = before.difference(&after);
    if difference > 0.0 {
        return failed(format!(
            "after a request with the object, one without it differs by {difference:.2} of 255"
        ));
    }
    Ok(if hidden.difference(&after) > 0.0 {
        "the same pixels: it is drawn where it was recorded".into()
    } else {
        "the same pixels, without it".into()
    })
}

pub(super) async fn unknown_object(target: &mut Target) -> Judged {
    let request = target.request();
    let without = target.image(request.clone()).await?;
    let sensor = target.sensor();
    let request = RgbRenderRequest {
        dynamic_objects: vec![DynamicObject {
            track_id: "no-object-has-this-name".into(),
            pose_pair: Some(pair(&sensor, &sensor)),
        }],
        ..request
    };
    match target.image(request).await {
        Ok(image) if image.difference(&without) == 0.0 => Ok("ignored".into()),
        Ok(_) => failed("the image changes"),
        Err(Stop::Refused(status))
            if matches!(
                status.code(),
                tonic::Code::NotFound | tonic::Code::InvalidArgument
            ) =>
        {
            Ok(format!("refused with {:?}", status.code()))
        }
        Err(stop) => Err(stop),
    }
}
