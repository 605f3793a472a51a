//! Views that a place was seen from.

use decouplegs_asset::LoadedScene;
use decouplegs_drive::ViewSupport;
use decouplegs_scene::CapturedViews;

/// Support of the views that a scene file names, else of the way of its ego.
pub(super) fn support_of(loaded: &LoadedScene) -> Option<ViewSupport> {
    let of_way = || CapturedViews::from_way(&loaded.ego);
    match loaded.recording.views.clone().or_else(of_way)? {
        CapturedViews::Everywhere => None,
        CapturedViews::From(views) => ViewSupport::from_views(&views),
    }
}
