//! Roads without the haze that hovers above them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use decouplegs::asset::{SceneFile, inria_ply, read_obstacles, read_placed_splats};
use decouplegs::drive::haze;
use decouplegs::footing::ground_of;
use decouplegs::scene::VehicleSize;

use super::replace_background;

/// Box of a vehicle of which the scene tells none.
const VEHICLE: VehicleSize = VehicleSize {
    length_m: 4.5,
    width_m: 1.8,
    height_m: 1.5,
};
/// Spreads of the road to which shadows reach.
const SLAB_SPREADS: f64 = 2.0;
/// Largest reach of shadows from the ground, meters: more would darken what stands on it.
const SLAB_M_MAX: f64 = 0.8;

/// Removes what hovers within `beside_m` of the recorded way of `scene`, whose paths are relative
/// to `folder`, where the new background is written. Lines that tell what was done.
pub fn remove(scene: &mut SceneFile, beside_m: f64, folder: &Path) -> Result<String> {
    let Some(ego) = scene.ego.clone().filter(|ego| ego.poses().len() > 1) else {
        bail!(
            "the scene file has no trajectory of the vehicle that recorded it, and only there the road is known to be free: add its poses as [[ego]], as `import` writes them"
        );
    };
    let path = folder.join(&scene.background);
    let ground = ground_of(scene, folder)?;
    let obstacles = match &scene.recording.obstacles {
        Some(file) => read_obstacles(&folder.join(file))?,
        None => Vec::new(),
    };
    let size = scene.recording.vehicle_size.unwrap_or(VEHICLE);
    let placed = read_placed_splats(&path)?;
    let cloud = &placed.cloud;
    let found = haze::find(
        (cloud, scene.origin + placed.origin),
        &ground,
        (ego.poses(), &size),
        beside_m,
        &obstacles,
    );
    let mut hovers = found.splats.iter().copied().peekable();
    let left: Vec<u32> = (0..cloud.len() as u32)
        .filter(|splat| hovers.next_if_eq(splat).is_none())
        .collect();
    ensure!(
        !left.is_empty(),
        "{} would have no splats left",
        path.display()
    );
    let background = PathBuf::from("background_clear.ply");
    let file = folder.join(&background);
    ensure!(
        file.symlink_metadata().is_err(),
        "{} exists, and nothing that exists is replaced: give --out another folder",
        file.display()
    );
    inria_ply::write(&file, &cloud.select(&left))
        .with_context(|| format!("{} cannot be written", file.display()))?;
    replace_background(scene, background, &placed, folder)?;
    let [before_m, after_m] = found.spreads_m;
    let mut report = format!(
        "haze: {} of {} splats hovered within {beside_m} m of the way and are gone; those of the road spread by {after_m:.2} m about the ground, {before_m:.2} before\n",
        found.splats.len(),
        cloud.len()
    );
    let shadows = scene
        .light
        .as_mut()
        .and_then(|light| light.shadows.as_mut());
    if let Some(shadows) = shadows {
        let slab_m = (SLAB_SPREADS * after_m).clamp(shadows.slab_m.min(SLAB_M_MAX), SLAB_M_MAX);
        if slab_m > shadows.slab_m {
            shadows.slab_m = slab_m;
            report.push_str(&format!(
                "shadows: slab_m is {slab_m:.2}, so that they fall on the road\n"
            ));
        }
    }
    Ok(report)
}
