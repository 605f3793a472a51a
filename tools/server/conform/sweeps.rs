//! Checks of LiDAR sweeps.

use decouplegs::scene::Pose;
use glam::{DQuat, DVec3};

use super::check::{Judged, Stop, failed};
use super::rgb_image::RgbImage;
use super::target::{Target, pair};
use decouplegs_alpasim::wire::sensorsim::{
    AggregatedRenderRequest, LidarDeviceType, LidarRenderRequest, LidarRenderReturn, LidarSpec,
};

/// Height of the sensor above the rig, meters.
const ABOVE_M: f64 = 1.5;
/// Duration of a sweep, microseconds.
const SWEEP_US: u64 = 100_000;
/// Share of points that may appear or vanish when the sensor turns by a quarter: its beams meet
/// other splats.
const COUNT_CHANGE_MAX: f64 = 0.1;

fn request(target: &Target, turn_rad: f64) -> LidarRenderRequest {
    let mount = Pose::new(DQuat::from_rotation_z(turn_rad), DVec3::Z * ABOVE_M);
    let sensor = target.local_from_rig.then(&mount);
    LidarRenderRequest {
        scene_id: target.scene.clone(),
        lidar_config: Some(LidarSpec {
            lidar_type: LidarDeviceType::Pandar128.into(),
        }),
        frame_start_us: target.time_us,
        frame_end_us: target.time_us + SWEEP_US,
        sensor_pose: Some(pair(&sensor, &sensor)),
        dynamic_objects: Vec::new(),
    }
}

/// Points of a sweep, meters, after its counts are checked.
fn points(sweep: &LidarRenderReturn) -> Result<Vec<DVec3>, Stop> {
    let count = sweep.num_points as usize;
    let floats = |buffer: &[u8]| -> Vec<f32> {
        let (chunks, _) = buffer.as_chunks::<4>();
        chunks
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect()
    };
    let (fields, buffer) = (&sweep.point_xyzs, floats(&sweep.point_xyzs_buffer));
    if !fields.is_empty() && !buffer.is_empty() && *fields != buffer {
        return failed("point_xyzs and its buffer differ");
    }
    let xyzs = if fields.is_empty() { &buffer } else { fields };
    if xyzs.len() != 3 * count {
        return failed(format!(
            "num_points is {count}, and there are {} coordinates",
            xyzs.len()
        ));
    }
    let (fields, buffer) = (
        &sweep.point_intensities,
        floats(&sweep.point_intensities_buffer),
    );
    let intensities = fields.len().max(buffer.len());
    if intensities != 0 && intensities != count {
        return failed(format!("{intensities} intensities for {count} points"));
    }
    if !xyzs.iter().all(|value| value.is_finite()) {
        return failed("a coordinate is not finite");
    }
    let (triples, _) = xyzs.as_chunks::<3>();
    Ok(triples
        .iter()
        .map(|p| DVec3::from_array(p.map(f64::from)))
        .collect())
}

async fn sweep(target: &mut Target, turn_rad: f64) -> Result<Vec<DVec3>, Stop> {
    let request = request(target, turn_rad);
    points(&target.client.render_lidar(request).await?.into_inner())
}

pub(super) async fn counts(target: &mut Target) -> Judged {
    let points = sweep(target, 0.0).await?;
    if points.is_empty() {
        return Err(Stop::Skipped("the sweep has no points".into()));
    }
    let nearest = points
        .iter()
        .map(|p| p.length())
        .fold(f64::INFINITY, f64::min);
    Ok(format!(
        "{} points, the nearest at {nearest:.2} m",
        points.len()
    ))
}

/// Mean of points on the plane.
fn center(points: &[DVec3]) -> DVec3 {
    points.iter().copied().sum::<DVec3>() / points.len().max(1) as f64
}

pub(super) async fn frame(target: &mut Target) -> Judged {
    let level = sweep(target, 0.0).await?;
    let turned = sweep(target, std::f64::consts::FRAC_PI_2).await?;
    if level.is_empty() {
        return Err(Stop::Skipped("the sweep has no points".into()));
    }
    let change = (turned.len() as f64 - level.len() as f64).abs() / level.len() as f64;
    if change > COUNT_CHANGE_MAX {
        return failed(format!(
            "{} points, and {} after a quarter turn",
            level.len(),
            turned.len()
        ));
    }
    // The sensor turns to the left, so its points turn to the right.
    let back = DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2);
    let (expected, found) = (back * center(&level), center(&turned));
    let off = (expected - found).length();
    let range_m = level.iter().map(|p| p.length()).sum::<f64>() / level.len() as f64;
    let figure = format!("the center of the points is {off:.2} m off after a quarter turn");
    if off > 0.05 * range_m {
        return failed(format!(
            "{figure}; at most {:.2} m is expected",
            0.05 * range_m
        ));
    }
    Ok(figure)
}

pub(super) async fn aggregated(target: &mut Target) -> Judged {
    let (rgb, lidar) = (target.request(), request(target, 0.0));
    let (alone, points_alone) = (
        target.image(rgb.clone()).await?,
        points(
            &target
                .client
                .render_lidar(lidar.clone())
                .await?
                .into_inner(),
        )?,
    );
    let answer = target
        .client
        .render_aggregated(AggregatedRenderRequest {
            rgb_requests: vec![rgb],
            lidar_requests: vec![lidar],
        })
        .await?
        .into_inner();
    let ([image], [sweep]) = (&answer.rgb_returns[..], &answer.lidar_returns[..]) else {
        return failed(format!(
            "{} images and {} sweeps for one of each",
            answer.rgb_returns.len(),
            answer.lidar_returns.len()
        ));
    };
    let difference = RgbImage::of_png(&image.image_bytes)?.difference(&alone);
    if difference > 0.0 {
        return failed(format!(
            "the image differs from render_rgb by {difference:.2} of 255"
        ));
    }
    if points(sweep)? != points_alone {
        return failed("the points differ from render_lidar");
    }
    Ok(format!("the same pixels and {} points", points_alone.len()))
}
