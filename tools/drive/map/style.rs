//! Appearance of lanes and tracks: names of style classes, and the style sheet with their colors.

use decouplegs::scene::LaneKind;

/// The drawing's own style sheet: it needs nothing beside it, and follows the reader's choice of
/// light or dark.
pub const STYLE: &str = include_str!("style.css");

/// The style class of a lane.
pub fn lane_class(kind: LaneKind) -> &'static str {
    kind.name()
}

/// The style class of a track, and the name under which the legend has it.
pub fn track_class(class: &str) -> &'static str {
    match class {
        "car" | "van" | "taxi" | "vehicle" | "unknown" => "car",
        "truck" | "bus" | "trailer" | "tram" | "train" => "truck",
        "bicycle" | "cyclist" | "motorcycle" | "motorcyclist" | "rider" => "rider",
        "pedestrian" | "person" => "pedestrian",
        _ => "user",
    }
}

/// All of the above, in the order of the legend, with what they are.
pub const TRACK_CLASSES: [(&str, &str); 5] = [
    ("car", "cars"),
    ("truck", "trucks and buses"),
    ("rider", "riders"),
    ("pedestrian", "pedestrians"),
    ("user", "other road users"),
];
