//! Rolling shutters in f64.

use std::borrow::Cow;

use decouplegs_scene::{Camera, Rules, SplatScene};
use rayon::prelude::*;

use super::{Image64, Window, render_window};

/// Renders each row, or column, of the image as that of a global-shutter image with all poses at
/// the time of its exposure: the definition of a rolling shutter. `world_at` gives the world at a
/// time in seconds after that of the camera's pose.
///
/// # Panics
/// Panics if the camera's intrinsics fail [`decouplegs_scene::Intrinsics::check`].
#[must_use]
pub fn render_moving<'a>(
    world_at: &(dyn Fn(f64) -> Cow<'a, SplatScene> + Sync),
    camera: &Camera,
    rules: &Rules,
) -> Image64 {
    render_moving_window(world_at, camera, rules, Window::whole(&camera.intrinsics))
}

/// The pixels of [`render_moving`] that lie in `window`, bit for bit.
///
/// # Panics
/// Panics if the camera's intrinsics fail [`decouplegs_scene::Intrinsics::check`] or the window
/// does not lie in its image.
#[must_use]
pub fn render_moving_window<'a>(
    world_at: &(dyn Fn(f64) -> Cow<'a, SplatScene> + Sync),
    camera: &Camera,
    rules: &Rules,
    window: Window,
) -> Image64 {
    let shutter = camera.intrinsics.shutter;
    let exposed = |window: Window| {
        let time_s = shutter.time_s(window.center_px(0).to_array());
        render_window(&world_at(time_s), &camera.at_rest(time_s), rules, window)
    };
    if shutter.is_global() {
        return exposed(window);
    }
    let by_column = shutter.s_per_px[0] != 0.0;
    let strip = |index: u32| match by_column {
        true => Window {
            left_px: window.left_px + index,
            width_px: 1,
            ..window
        },
        false => Window {
            top_px: window.top_px + index,
            height_px: 1,
            ..window
        },
    };
    let (width, height) = (window.width_px as usize, window.height_px as usize);
    let count = if by_column { width } else { height } as u32;
    let strips: Vec<Image64> = (0..count)
        .into_par_iter()
        .map(|index| exposed(strip(index)))
        .collect();
    // Strip of each pixel, and its index there.
    let positions = (0..width * height).map(|pixel| match by_column {
        true => (pixel % width, pixel / width),
        false => (pixel / width, pixel % width),
    });
    let positions: Vec<(usize, usize)> = positions.collect();
    Image64 {
        width: window.width_px,
        height: window.height_px,
        rgb: gathered(&positions, &strips, |strip| &strip.rgb),
        alpha: gathered(&positions, &strips, |strip| &strip.alpha),
        depth: gathered(&positions, &strips, |strip| &strip.depth),
        instance: gathered(&positions, &strips, |strip| &strip.instance),
    }
}

/// Values of a plane, each at a position of a strip.
fn gathered<T: Copy>(
    positions: &[(usize, usize)],
    strips: &[Image64],
    plane: impl Fn(&Image64) -> &[T],
) -> Vec<T> {
    let value = |&(strip, at): &(usize, usize)| plane(&strips[strip])[at];
    positions.iter().map(value).collect()
}
