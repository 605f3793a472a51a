//! Checks of shutters and of objects.

use decouplegs::scene::Pose;
use glam::DVec3;

use super::check::{Judged, Stop, failed};
use super::rgb_image::RgbImage;
use super::target::{SIZE_PX, Target, pair, pinhole, spec_of};
use decouplegs_alpasim::wire::sensorsim::{CameraSpec, RgbRenderRequest, ShutterType};

/// Largest mean difference of a rolling shutter at rest from a global one, of 255.
const REST_DIFFERENCE_MAX: f64 = 0.05;
/// Turn of the camera during the readout, radians: about 14 pixels of the compared views.
const TURN_RAD: f64 = 0.04;
/// Rows at either edge that are compared, pixels.
const EDGE_PX: u32 = 20;
/// Distance of the object in front of the camera, meters.
const AHEAD_M: f64 = 12.0;
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

/// Share of pixels that differ by more than 8 of 255, and their mean column.
fn changed(a: &RgbImage, b: &RgbImage) -> (f64, f64) {
    let width = a.width_px as usize;
    let pixels = a.rgb.chunks_exact(3).zip(b.rgb.chunks_exact(3)).enumerate();
    let columns: Vec<usize> = pixels
        .filter(|(_, (a, b))| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 8))
        .map(|(at, _)| at % width)
        .collect();
    let sum: usize = columns.iter().sum();
    let count = columns.len().max(1) as f64;
    (
        columns.len() as f64 / (a.rgb.len() / 3).max(1) as f64,
        sum as f64 / count,
    )
}

/// Views without the object and with it at `right_m`.
async fn with_object(target: &mut Target, right_m: f64) -> Result<[RgbImage; 2], Stop> {
    let object = target.object(AHEAD_M, right_m)?;
    let request = target.request();
    let without = target.image(request.clone()).await?;
    let request = RgbRenderRequest {
        dynamic_objects: vec![object],
        ..request
    };
    Ok([without, target.image(request).await?])
}

pub(super) async fn object_shown(target: &mut Target) -> Judged {
    let [without, with] = with_object(target, 0.0).await?;
    let (share, _) = changed(&without, &with);
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
        let (share, column) = changed(&without, &with);
        if share < SHOWN_SHARE_MIN {
            return failed(format!(
                "{right_m} m to the right of the view it is not drawn"
            ));
        }
        columns.push(column);
    }
    // Four meters at the distance of the object, by the focal length; its own sides differ.
    let expected_px = 4.0 / AHEAD_M * super::target::FOCAL_PX;
    let found_px = columns[1] - columns[0];
    let figure = format!("4 m to the right are {found_px:.0} px; expected {expected_px:.0}");
    if (found_px - expected_px).abs() > 0.35 * expected_px {
        return failed(figure);
    }
    Ok(figure)
}

pub(super) async fn unlisted(target: &mut Target) -> Judged {
    let [before, with] = with_object(target, 0.0).await?;
    // The object was just drawn: the next request must forget it.
    let request = target.request();
    let after = target.image(request).await?;
    if changed(&before, &with).0 < SHOWN_SHARE_MIN {
        return Err(Stop::Skipped(
            "the object is not drawn where it is listed".into(),
        ));
    }
    let difference = before.difference(&after);
    if difference > 0.0 {
        return failed(format!(
            "after a request with the object, one without it differs by {difference:.2} of 255"
        ));
    }
    Ok("the same pixels".into())
}

pub(super) async fn unknown_object(target: &mut Target) -> Judged {
    let request = target.request();
    let without = target.image(request.clone()).await?;
    let sensor = target.sensor();
    let request = RgbRenderRequest {
        dynamic_objects: vec![decouplegs_alpasim::wire::sensorsim::DynamicObject {
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
