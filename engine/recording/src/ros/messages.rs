//! Messages of an episode: transforms, images, calibrations, boxes.

use decouplegs_scene::{Motion, Pose};

use super::{Cdr, MessageType};

/// `sensor_msgs/PointCloud2`.
pub const POINT_CLOUD2: MessageType = MessageType {
    name: "sensor_msgs/msg/PointCloud2",
    definition: include_str!("definitions/PointCloud2.msg"),
};
/// `sensor_msgs/CompressedImage`.
pub const COMPRESSED_IMAGE: MessageType = MessageType {
    name: "sensor_msgs/msg/CompressedImage",
    definition: include_str!("definitions/CompressedImage.msg"),
};
/// `sensor_msgs/CameraInfo`.
pub const CAMERA_INFO: MessageType = MessageType {
    name: "sensor_msgs/msg/CameraInfo",
    definition: include_str!("definitions/CameraInfo.msg"),
};
/// `tf2_msgs/TFMessage`.
pub const TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs/msg/TFMessage",
    definition: include_str!("definitions/TFMessage.msg"),
};
/// `visualization_msgs/MarkerArray`, as of ROS 2 Humble.
pub const MARKER_ARRAY: MessageType = MessageType {
    name: "visualization_msgs/msg/MarkerArray",
    definition: include_str!("definitions/MarkerArray.msg"),
};

/// `nav_msgs/Odometry`.
pub const ODOMETRY: MessageType = MessageType {
    name: "nav_msgs/msg/Odometry",
    definition: include_str!("definitions/Odometry.msg"),
};
/// `nav_msgs/Path`.
pub const PATH: MessageType = MessageType {
    name: "nav_msgs/msg/Path",
    definition: include_str!("definitions/Path.msg"),
};
/// `std_msgs/Float64`.
pub const FLOAT64: MessageType = MessageType {
    name: "std_msgs/msg/Float64",
    definition: include_str!("definitions/Float64.msg"),
};
/// `rcl_interfaces/Log`.
pub const LOG: MessageType = MessageType {
    name: "rcl_interfaces/msg/Log",
    definition: include_str!("definitions/Log.msg"),
};

/// Pose of one frame in another.
#[derive(Clone, Debug, PartialEq)]
pub struct Transform {
    /// Frame in which the child stands.
    pub parent: String,
    /// Frame of the child.
    pub child: String,
    /// Parent from child.
    pub pose: Pose,
}

/// Message of transforms at `time_ns`.
#[must_use]
pub fn tf_message(time_ns: u64, transforms: &[Transform]) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.u32(transforms.len() as u32);
    for transform in transforms {
        cdr.header(time_ns, &transform.parent);
        cdr.string(&transform.child);
        pose(&mut cdr, &transform.pose);
    }
    cdr.finish()
}

/// Position, then x, y, z, w of the rotation.
fn pose(cdr: &mut Cdr, pose: &Pose) {
    cdr.f64s(&pose.translation.to_array());
    cdr.f64s(&pose.rotation.to_array());
}

/// Message of a pose with its motion, of unknown covariance. Velocities are in the axes of the
/// child, as ROS has them.
#[must_use]
pub fn odometry(time_ns: u64, transform: &Transform, motion: &Motion) -> Vec<u8> {
    const UNKNOWN: [f64; 36] = [0.0; 36];
    let velocity_mps = transform.pose.rotation.inverse() * motion.velocity_mps;
    let mut cdr = Cdr::with_header(time_ns, &transform.parent);
    cdr.string(&transform.child);
    pose(&mut cdr, &transform.pose);
    cdr.f64s(&UNKNOWN);
    cdr.f64s(&velocity_mps.to_array());
    cdr.f64s(&motion.turn_rad_per_s.to_array());
    cdr.f64s(&UNKNOWN);
    cdr.finish()
}

/// Message of a way through `frame`: poses with their times, nanoseconds.
#[must_use]
pub fn path(time_ns: u64, frame: &str, poses: &[(u64, Pose)]) -> Vec<u8> {
    let mut cdr = Cdr::with_header(time_ns, frame);
    cdr.u32(poses.len() as u32);
    for (time_ns, at) in poses {
        cdr.header(*time_ns, frame);
        pose(&mut cdr, at);
    }
    cdr.finish()
}

/// Message of a number.
#[must_use]
pub fn float64(value: f64) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.f64(value);
    cdr.finish()
}

/// Message of a warning that the program `name` gives at `time_ns`.
#[must_use]
pub fn warning(time_ns: u64, name: &str, text: &str) -> Vec<u8> {
    const WARN: u8 = 30;
    let mut cdr = Cdr::new();
    cdr.time(time_ns);
    cdr.u8(WARN);
    cdr.string(name);
    cdr.string(text);
    // No file, function and line.
    cdr.string("");
    cdr.string("");
    cdr.u32(0);
    cdr.finish()
}

/// Message of a PNG.
#[must_use]
pub fn compressed_image(time_ns: u64, frame: &str, png: &[u8]) -> Vec<u8> {
    let mut cdr = Cdr::with_header(time_ns, frame);
    cdr.string("png");
    cdr.bytes(png);
    cdr.finish()
}

/// Calibration of a camera, as ROS has it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraModel {
    /// Width and height of images, pixels.
    pub size_px: [u32; 2],
    /// `plumb_bob`, `rational_polynomial` or `equidistant`; empty where ROS has no model of the
    /// lens.
    pub distortion: &'static str,
    /// Coefficients of the distortion.
    pub coefficients: Vec<f64>,
    /// Focal lengths, then the principal point from the middle of the first pixel, pixels.
    pub focal_and_center_px: [f64; 4],
}

/// Message of a calibration.
#[must_use]
pub fn camera_info(time_ns: u64, frame: &str, model: &CameraModel) -> Vec<u8> {
    let [fx, fy, cx, cy] = model.focal_and_center_px;
    let [width_px, height_px] = model.size_px;
    let mut cdr = Cdr::with_header(time_ns, frame);
    cdr.u32(height_px);
    cdr.u32(width_px);
    cdr.string(model.distortion);
    cdr.u32(model.coefficients.len() as u32);
    cdr.f64s(&model.coefficients);
    cdr.f64s(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    cdr.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    cdr.f64s(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, the whole image.
    for _ in 0..6 {
        cdr.u32(0);
    }
    cdr.u8(0);
    cdr.finish()
}

/// Box of a road user.
#[derive(Clone, Debug, PartialEq)]
pub struct Marker {
    /// Kind of the road user; markers of one namespace have different ids.
    pub namespace: String,
    /// Number of the road user.
    pub id: u32,
    /// Pose of the middle of the box.
    pub pose: Pose,
    /// Length, width and height, meters.
    pub dims_m: [f64; 3],
    /// Red, green, blue and opacity, 0 to 1.
    pub rgba: [f32; 4],
    /// Name of the road user.
    pub text: String,
}

/// Message of boxes in `frame`, which replaces those before it.
#[must_use]
pub fn marker_array(time_ns: u64, frame: &str, markers: &[Marker]) -> Vec<u8> {
    const CUBE: u32 = 1;
    const ADD: u32 = 0;
    const DELETE_ALL: u32 = 3;
    let delete = Marker {
        namespace: String::new(),
        id: 0,
        pose: Pose::IDENTITY,
        dims_m: [1.0; 3],
        rgba: [0.0; 4],
        text: String::new(),
    };
    let mut cdr = Cdr::new();
    cdr.u32(markers.len() as u32 + 1);
    for (marker, action) in
        std::iter::once((&delete, DELETE_ALL)).chain(markers.iter().map(|marker| (marker, ADD)))
    {
        cdr.header(time_ns, frame);
        cdr.string(&marker.namespace);
        cdr.u32(marker.id);
        cdr.u32(CUBE);
        cdr.u32(action);
        pose(&mut cdr, &marker.pose);
        cdr.f64s(&marker.dims_m);
        for channel in marker.rgba {
            cdr.f32(channel);
        }
        // Lifetime: until it is replaced.
        cdr.u32(0);
        cdr.u32(0);
        cdr.u8(0);
        // No points, colors and texture.
        cdr.u32(0);
        cdr.u32(0);
        cdr.string("");
        cdr.header(0, "");
        cdr.string("");
        cdr.bytes(&[]);
        cdr.u32(0);
        cdr.string(&marker.text);
        // No mesh.
        cdr.string("");
        cdr.string("");
        cdr.bytes(&[]);
        cdr.u8(0);
    }
    cdr.finish()
}
