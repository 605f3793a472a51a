//! Files of the page that the program carries.

const JAVASCRIPT: &str = "text/javascript; charset=utf-8";
/// Files of the page: name, media type and text.
pub const PAGE: [(&str, &str, &str); 26] = [
    (
        "index.html",
        "text/html; charset=utf-8",
        include_str!("page/index.html"),
    ),
    (
        "style.css",
        "text/css; charset=utf-8",
        include_str!("page/style.css"),
    ),
    (
        "camera_panel.js",
        JAVASCRIPT,
        include_str!("page/camera_panel.js"),
    ),
    (
        "browser_drawing.js",
        JAVASCRIPT,
        include_str!("page/browser_drawing.js"),
    ),
    ("axes.js", JAVASCRIPT, include_str!("page/axes.js")),
    (
        "bookmarks.js",
        JAVASCRIPT,
        include_str!("page/bookmarks.js"),
    ),
    ("cameras.js", JAVASCRIPT, include_str!("page/cameras.js")),
    ("compare.js", JAVASCRIPT, include_str!("page/compare.js")),
    (
        "connection.js",
        JAVASCRIPT,
        include_str!("page/connection.js"),
    ),
    (
        "drawing_levels.js",
        JAVASCRIPT,
        include_str!("page/drawing_levels.js"),
    ),
    ("dropping.js", JAVASCRIPT, include_str!("page/dropping.js")),
    ("files.js", JAVASCRIPT, include_str!("page/files.js")),
    ("geometry.js", JAVASCRIPT, include_str!("page/geometry.js")),
    ("link.js", JAVASCRIPT, include_str!("page/link.js")),
    ("main.js", JAVASCRIPT, include_str!("page/main.js")),
    ("measure.js", JAVASCRIPT, include_str!("page/measure.js")),
    ("overlays.js", JAVASCRIPT, include_str!("page/overlays.js")),
    ("panels.js", JAVASCRIPT, include_str!("page/panels.js")),
    ("path.js", JAVASCRIPT, include_str!("page/path.js")),
    (
        "splat_canvas.js",
        JAVASCRIPT,
        include_str!("page/splat_canvas.js"),
    ),
    (
        "splat_cloud.js",
        JAVASCRIPT,
        include_str!("page/splat_cloud.js"),
    ),
    (
        "splat_sorter.js",
        JAVASCRIPT,
        include_str!("page/splat_sorter.js"),
    ),
    ("state.js", JAVASCRIPT, include_str!("page/state.js")),
    ("steering.js", JAVASCRIPT, include_str!("page/steering.js")),
    ("timeline.js", JAVASCRIPT, include_str!("page/timeline.js")),
    ("views.js", JAVASCRIPT, include_str!("page/views.js")),
];

/// Page of one file that shows a scene without a viewer, with marks for its contents.
pub const ONE_FILE: &str = include_str!("page/one_file.html");
/// Script of the worker that sorts splats.
pub const SORTER: &str = include_str!("page/splat_sorter.js");
/// Modules that a page of one file has beside some of [`PAGE`].
const OWN_MODULES: [(&str, &str); 2] = [
    ("one_file.js", include_str!("page/one_file.js")),
    ("tracks.js", include_str!("page/tracks.js")),
];
/// Modules of [`PAGE`] that a page of one file has too.
const SHARED_MODULES: [&str; 9] = [
    "axes.js",
    "cameras.js",
    "drawing_levels.js",
    "geometry.js",
    "overlays.js",
    "splat_canvas.js",
    "splat_cloud.js",
    "state.js",
    "steering.js",
];

/// Modules of a page of one file: name and text.
pub fn modules() -> impl Iterator<Item = (&'static str, &'static str)> {
    let shared = PAGE
        .iter()
        .filter(|(name, ..)| SHARED_MODULES.contains(name));
    let shared = shared.map(|&(name, _, text)| (name, text));
    shared.chain(OWN_MODULES)
}
