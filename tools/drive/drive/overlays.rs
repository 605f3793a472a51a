//! Frames of videos with what the planner meant and what came of it: its plan on the road, boxes of
//! road users, and figures of the moment.

mod canvas;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use decouplegs::drive::score::{EpisodeScore, Quantity, quantities};
use decouplegs::episode::{Moment, Moments, Site, camera_named};
use decouplegs::scene::episode::Episode;
use decouplegs::scene::{Camera, Pose, RayMap, Rig, RoadUser};
use decouplegs::session::Scene;
use glam::{DVec2, DVec3};

use self::canvas::Canvas;

/// Time for which an infraction is shown, seconds.
const SHOWN_S: f64 = 2.0;
/// Distance from the camera to the farthest box that is drawn, meters.
const FAR_M: f64 = 100.0;
/// Pieces of a line: lenses bend it.
const PIECES: u32 = 8;
/// Distance in front of the camera from which on lines are drawn, meters.
const NEAR_M: f64 = 0.1;

const PLAN: [u8; 3] = [60, 220, 255];
const FAULT: [u8; 3] = [255, 110, 90];
const WORDS: [u8; 3] = [255, 255, 255];

/// Overlays of all moments of an episode.
pub struct Overlays<'a> {
    episode: &'a Episode,
    /// Cameras of the episode, with the size and lens of its images.
    rig: Rig,
    moments: Moments,
    quantities: Vec<Quantity>,
    /// Times and texts of infractions, seconds.
    infractions: Vec<(f64, String)>,
}

impl<'a> Overlays<'a> {
    /// Overlays of `episode` in `site`, whose copy on the device is `scene`.
    ///
    /// # Errors
    /// Returns an error if the episode has no images, or cannot be replayed in `site`.
    pub fn new(episode: &'a Episode, site: &Arc<Site>, scene: &Arc<Scene>) -> Result<Self> {
        let head = &episode.head;
        let drawn_by = head
            .drawn_by
            .as_ref()
            .context("the episode has no images")?;
        let mut cameras = Vec::new();
        for name in &head.planner.cameras {
            let mut camera = camera_named(&site.loaded.rig, name)?.clone();
            camera.intrinsics = drawn_by.intrinsics(&camera.intrinsics);
            cameras.push(camera);
        }
        let score = EpisodeScore::new(episode);
        Ok(Self {
            moments: Moments::from_episode(episode, site, scene)?,
            quantities: quantities(episode, &score),
            infractions: score.described(head),
            rig: Rig::from_iter(cameras),
            episode,
        })
    }

    /// Draws them onto the images `CAMERA_STEP.png` of `camera` in `folder`, and writes those to
    /// `to`.
    ///
    /// # Errors
    /// Returns an error if an image cannot be read or written.
    pub fn draw_all(&self, folder: &Path, camera: &str, to: &Path) -> Result<()> {
        for (index, moment) in self.moments.as_slice().iter().enumerate() {
            let Some(step) = moment.step else { continue };
            let name = PathBuf::from(format!("{camera}_{step:04}.png"));
            // Steps that were not drawn have none.
            if folder.join(&name).is_file() {
                let mut canvas = Canvas::open(&folder.join(&name))?;
                self.draw(&mut canvas, camera, (index, moment))?;
                canvas.save(&to.join(&name))?;
            }
        }
        Ok(())
    }

    fn draw(
        &self,
        canvas: &mut Canvas,
        camera: &str,
        (index, moment): (usize, &Moment),
    ) -> Result<()> {
        let cameras = self.rig.moving_at(&moment.ego, &moment.motion);
        let camera = cameras.iter().find(|one| one.name == camera);
        let seen = Seen::new(camera.context("the camera is not in the rig")?);
        self.draw_boxes(canvas, &seen, moment);
        if let Some(step) = moment
            .step
            .and_then(|step| self.episode.steps.get(step as usize))
        {
            let height_m = self.episode.head.scenario.ego.size.to_array()[2];
            let on_road = |at: DVec2| moment.ego.transform(at.extend(-0.5 * height_m));
            let points = step
                .plan
                .points()
                .iter()
                .map(|point| on_road(point.position_m));
            let way: Vec<DVec3> = std::iter::once(on_road(DVec2::ZERO))
                .chain(points)
                .collect();
            for pair in way.windows(2) {
                canvas.line(&seen.line([pair[0], pair[1]]), PLAN, 3.0);
            }
            for point in &way[1..] {
                canvas.dot(seen.pixel(*point), PLAN, 4.0);
            }
        }
        canvas.words(&self.words(index, moment.time_s));
        Ok(())
    }

    fn draw_boxes(&self, canvas: &mut Canvas, seen: &Seen, moment: &Moment) {
        let head = &self.episode.head;
        for agent in moment.world.agents().iter().filter(|agent| agent.present) {
            // Lamps and signs come after the road users.
            let Some(index) = usize::from(agent.placed.instance).checked_sub(1) else {
                continue;
            };
            let Some(size) = head.agent_sizes.get(index) else {
                continue;
            };
            let pose = &agent.placed.pose;
            if pose.translation.distance(seen.eye_m) > FAR_M {
                continue;
            }
            let color = color_of(head.scenario.agent(index).1);
            for edge in edges(pose, DVec3::from(size.to_array())) {
                canvas.line(&seen.line(edge), color, 1.5);
            }
        }
    }

    /// Lines of text, and their colors.
    fn words(&self, index: usize, time_s: f64) -> Vec<(String, [u8; 3])> {
        let at = |key: &str| {
            let found = self.quantities.iter().find(|quantity| quantity.key == key);
            found.and_then(|quantity| quantity.values[index])
        };
        let mut motion = format!("{:.0} km/h", 3.6 * at("speed_mps").unwrap_or(0.0));
        if let Some(limit_mps) = at("speed_limit_mps") {
            motion.push_str(&format!(" of {:.0}", 3.6 * limit_mps));
        }
        if let Some(ttc_s) = at("time_to_collision_s") {
            motion.push_str(&format!("  TTC {ttc_s:.1} s"));
        }
        let mut score = String::new();
        for (key, name) in [("route_completion", "RC"), ("driving_score", "DS")] {
            if let Some(value) = at(key) {
                score.push_str(&format!("{name} {value:.2}  "));
            }
        }
        let name = &self.episode.head.scenario.name;
        let mut words = vec![
            (format!("{name}  {time_s:.1} s"), WORDS),
            (motion, WORDS),
            (score.trim_end().to_owned(), WORDS),
        ];
        let shown = self.infractions.iter();
        let shown = shown.filter(|(begin_s, _)| (*begin_s..begin_s + SHOWN_S).contains(&time_s));
        words.extend(shown.map(|(_, text)| (text.clone(), FAULT)));
        words
    }
}

/// Color of the box of a road user, as in the viewer's maps: one per kind.
fn color_of(kind: RoadUser) -> [u8; 3] {
    match kind {
        RoadUser::Car => [90, 170, 255],
        RoadUser::Truck | RoadUser::Bus => [190, 130, 255],
        RoadUser::Cyclist => [90, 220, 130],
        RoadUser::Pedestrian => [255, 180, 60],
    }
}

/// The twelve edges of a box of `dims_m` (length, width, height) at `pose`, world coordinates.
fn edges(pose: &Pose, dims_m: DVec3) -> impl Iterator<Item = [DVec3; 2]> {
    let corner = move |bits: usize| {
        let sign = |axis: usize| if bits >> axis & 1 == 0 { -0.5 } else { 0.5 };
        pose.transform(DVec3::new(sign(0), sign(1), sign(2)) * dims_m)
    };
    let edges = (0..8usize).flat_map(|from| {
        let up = (0..3).filter(move |axis| from >> axis & 1 == 0);
        up.map(move |axis| (from, from | 1 << axis))
    });
    edges.map(move |(from, to)| [corner(from), corner(to)])
}

/// A camera that lines are seen by.
struct Seen<'a> {
    camera: &'a Camera,
    lens: Option<RayMap>,
    camera_from_world: Pose,
    eye_m: DVec3,
}

impl<'a> Seen<'a> {
    fn new(camera: &'a Camera) -> Self {
        let k = &camera.intrinsics;
        Self {
            lens: (!k.is_pinhole()).then(|| RayMap::new(k)),
            camera_from_world: camera.world_from_camera.inverse(),
            eye_m: camera.world_from_camera.translation,
            camera,
        }
    }

    /// Pixel of a point of the world; `None` behind the camera and outside of the lens's field.
    fn pixel(&self, point_m: DVec3) -> Option<DVec2> {
        let ray = self.camera_from_world.transform(point_m);
        match &self.lens {
            Some(lens) => lens.project(ray),
            None => (ray.z > NEAR_M).then(|| self.camera.intrinsics.project(ray))?,
        }
    }

    /// Pixels along a line of the world. A part of it that no lens shows is left out.
    fn line(&self, [from_m, to_m]: [DVec3; 2]) -> Vec<Option<DVec2>> {
        let at = |piece: u32| from_m.lerp(to_m, f64::from(piece) / f64::from(PIECES));
        (0..=PIECES).map(|piece| self.pixel(at(piece))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::Intrinsics;

    #[test]
    fn a_box_has_twelve_edges_along_its_axes() {
        let pose = Pose::from_yaw(0.3, DVec3::new(5.0, -2.0, 1.0));
        let dims_m = DVec3::new(4.0, 2.0, 1.5);
        let mut lengths: Vec<f64> = edges(&pose, dims_m).map(|[a, b]| a.distance(b)).collect();
        lengths.sort_by(f64::total_cmp);
        let expected = [[1.5; 4], [2.0; 4], [4.0; 4]].concat();
        assert_eq!(lengths.len(), 12);
        for (found, expected) in lengths.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-12, "{lengths:?}");
        }
    }

    #[test]
    fn lines_end_where_the_camera_does_not_see() {
        // It stands at x = 1 and looks along z.
        let at = Pose::new(glam::DQuat::IDENTITY, DVec3::X);
        let intrinsics = Intrinsics::pinhole([200, 100], [50.0, 50.0], [100.0, 50.0]);
        let camera = Camera::new("front", intrinsics, at);
        let seen = Seen::new(&camera);
        assert_eq!(
            seen.pixel(DVec3::new(2.0, 0.5, 2.0)),
            Some(DVec2::new(125.0, 62.5))
        );
        let line = seen.line([DVec3::new(1.0, 1.0, -4.0), DVec3::new(1.0, 1.0, 4.0)]);
        let shown: Vec<bool> = line.iter().map(Option::is_some).collect();
        let expected = [[false; 5].as_slice(), &[true; 4]].concat();
        assert_eq!(shown, expected);
        assert_eq!(line[8], Some(DVec2::new(100.0, 62.5)));
    }
}
