//! The command that renders the image of a pane.

use decouplegs::scene::Camera;
use decouplegs_cli::arguments::quoted;
use decouplegs_cli::free_view::FreeView;
use serde_json::{Value, json};

use crate::protocol::{CameraRequest, Channel, Pane};
use crate::scene_course::SceneCourse;

/// Options of the viewer that `render` needs too, as they are typed.
#[derive(Clone, Default)]
pub struct RenderOptions {
    /// Storage, levels of detail and device.
    pub words: Vec<String>,
    /// Rules of the scene.
    pub rules: Vec<String>,
    /// File of cameras.
    pub cameras: Vec<String>,
}

/// The command that renders what `pane` shows of `course` by `camera` at `time_s`, and the name of
/// the image that it writes, as JSON.
///
/// # Errors
/// A sentence, where there is no such command.
pub fn render_command(
    course: &SceneCourse,
    pane: &Pane,
    camera: &Camera,
    time_s: f64,
    options: &RenderOptions,
) -> Result<Value, String> {
    if course.is_edited() {
        return Err(
            "the scene was edited: save it, open the new file, and copy the command there".into(),
        );
    }
    let input = &course.input;
    let is_elsewhen = time_s != input.loaded.ego.start_s();
    if !input.loaded.plain_agents.is_empty() && time_s != input.time_s {
        return Err("agents of plain splats stand still here, and 'render' puts them where they are at this time: go back to the first time".into());
    }
    let mut words = vec!["decouplegs".into(), "render".into(), course.typed_path()];
    let k = &camera.intrinsics;
    let size = format!("{}x{}", k.width_px, k.height_px);
    // What a scene file says of the camera besides its numbers.
    let own_size = match &pane.camera {
        CameraRequest::Named { name } => course.own_size_px(name),
        CameraRequest::Free(_) | CameraRequest::Attached { .. } => None,
    };
    let is_own_size = own_size == Some([k.width_px, k.height_px]);
    let view = match &pane.camera {
        CameraRequest::Free(free) => Some(free.view()),
        CameraRequest::Attached { pinhole, .. } => Some(FreeView {
            position_m: camera.world_from_camera.translation.to_array(),
            rotation: camera.world_from_camera.rotation.to_array(),
            lens: pinhole.view().lens,
        }),
        CameraRequest::Named { .. } if input.drives() => None,
        CameraRequest::Named { .. } => FreeView::from_camera(camera),
    };
    if let Some(view) = &view {
        words.extend(["--view".into(), view.to_string()]);
    } else if input.drives() {
        words.extend(["--cameras".into(), camera.name.clone()]);
    } else {
        words.extend(options.cameras.iter().cloned());
    }
    if view.is_some() || !is_own_size {
        words.extend(["--size".into(), size]);
    }
    if is_elsewhen {
        words.extend(["--time".into(), format!("{time_s:?}")]);
    }
    if !pane.agents {
        words.extend(["--layer".into(), "background".into()]);
    }
    let name = view.map_or_else(|| camera.name.clone(), |_| "view".into());
    let image = match plane_name(pane.channel)? {
        None => format!("{name}.png"),
        Some(plane) => {
            words.extend(["--planes".into(), plane.into(), "--plane-previews".into()]);
            format!("{name}.{plane}.png")
        }
    };
    words.extend(options.rules.iter().chain(&options.words).cloned());
    words.extend(["--out".into(), "image".into()]);
    let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    Ok(json!({"text": words.join(" "), "image": format!("image/{image}")}))
}

/// Plane of a channel that is not color, as `render --planes` calls it.
fn plane_name(channel: Channel) -> Result<Option<&'static str>, String> {
    match channel {
        Channel::Color => Ok(None),
        Channel::Depth => Ok(Some("depth")),
        Channel::Range => Ok(Some("range")),
        Channel::Instance => Ok(Some("instance")),
        Channel::Normal => Ok(Some("normal")),
        Channel::Flow => Ok(Some("flow_forward")),
        Channel::Alpha => Err(
            "'render' writes no image of the opacity alone: choose another kind of image".into(),
        ),
    }
}
