//! The checks, by name, and what becomes of one.

use decouplegs_alpasim::wire::sensorsim::ftheta_camera_param::PolynomialType;
use tonic::{Code, Status};

use super::target::Target;
use super::{answers, images, motion, sweeps};

/// Result of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The server does as the contract says; with the figure that was seen.
    Passed(String),
    /// The server does otherwise: what was expected and what was found.
    Failed(String),
    /// Not judged, with the reason.
    Skipped(String),
}

impl Outcome {
    /// One word for tables.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Passed(_) => "passed",
            Self::Failed(_) => "FAILED",
            Self::Skipped(_) => "skipped",
        }
    }

    /// Figure, fault or reason.
    #[must_use]
    pub fn detail(&self) -> &str {
        match self {
            Self::Passed(text) | Self::Failed(text) | Self::Skipped(text) => text,
        }
    }
}

/// End of a check that did not pass. A status of gRPC becomes one by [`From`].
pub(super) enum Stop {
    Failed(String),
    Skipped(String),
    Refused(Status),
}

impl From<Status> for Stop {
    fn from(status: Status) -> Self {
        Self::Refused(status)
    }
}

/// Figure of a check that passed, or the reason why it did not.
pub(super) type Judged = Result<String, Stop>;

/// A failure with this text.
pub(super) fn failed<T>(text: impl Into<String>) -> Result<T, Stop> {
    Err(Stop::Failed(text.into()))
}

/// One property of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "each has its sentence in Check::asks")]
pub enum Check {
    Version,
    Scenes,
    Cameras,
    Package,
    Trajectories,
    EgoMasks,
    Png,
    Colors,
    Planar,
    Jpeg,
    LargeAnswer,
    Resized,
    Repeatable,
    Parallel,
    UnknownFields,
    Fisheye,
    FTheta,
    FThetaBackward,
    ShutterInstant,
    StaticRolling,
    RollingRows,
    RollingReversed,
    ObjectShown,
    ObjectMoves,
    ObjectCentered,
    ObjectTurns,
    ObjectForgotten,
    UnknownObject,
    Batch,
    BatchPerCameraObjects,
    UnknownScene,
    MissingCamera,
    UndefinedFormat,
    BackwardTime,
    Lidar,
    LidarPose,
    Aggregated,
}

impl Check {
    /// All checks, in the order in which they are run.
    pub const ALL: [Self; 37] = [
        Self::Version,
        Self::Scenes,
        Self::Cameras,
        Self::Package,
        Self::Trajectories,
        Self::EgoMasks,
        Self::Png,
        Self::Colors,
        Self::Planar,
        Self::Jpeg,
        Self::LargeAnswer,
        Self::Resized,
        Self::Repeatable,
        Self::Parallel,
        Self::UnknownFields,
        Self::Fisheye,
        Self::FTheta,
        Self::FThetaBackward,
        Self::ShutterInstant,
        Self::StaticRolling,
        Self::RollingRows,
        Self::RollingReversed,
        Self::ObjectShown,
        Self::ObjectMoves,
        Self::ObjectCentered,
        Self::ObjectTurns,
        Self::ObjectForgotten,
        Self::UnknownObject,
        Self::Batch,
        Self::BatchPerCameraObjects,
        Self::UnknownScene,
        Self::MissingCamera,
        Self::UndefinedFormat,
        Self::BackwardTime,
        Self::Lidar,
        Self::LidarPose,
        Self::Aggregated,
    ];

    /// Property that is asked for, one sentence.
    #[must_use]
    pub fn asks(self) -> &'static str {
        match self {
            Self::Version => "get_version names the server and the version of the contract",
            Self::Scenes => "get_available_scenes lists scenes, each once",
            Self::Cameras => "cameras have unique ids, a lens, a size and a unit quaternion",
            Self::Package => {
                "cameras have the poses and names, the trajectory the times of the package"
            }
            Self::Trajectories => "the recorded trajectory has rising times and unit quaternions",
            Self::EgoMasks => "get_available_ego_masks answers, also without masks",
            Self::Png => "a PNG has the size asked for",
            Self::Colors => "channels come as red, green, blue: a bright sky is not red",
            Self::Planar => "RGB_UINT8_PLANAR has three planes with the pixels of the PNG",
            Self::Jpeg => "a JPEG of quality 95 has the size asked for and shows the PNG",
            Self::LargeAnswer => "an image of 1920 x 1080 arrives, 6 MB as planes",
            Self::Resized => "another size shows the same view with other pixels",
            Self::Repeatable => "the same request gives the same pixels",
            Self::Parallel => "eight requests at once give the pixels of one alone",
            Self::UnknownFields => "fields that the server does not know change nothing",
            Self::Fisheye => "an OpenCV fisheye that is a pinhole in disguise shows its image",
            Self::FTheta => "an f-theta lens that is a pinhole in disguise shows its image",
            Self::FThetaBackward => {
                "so does one whose reference is the polynomial from pixels to angles"
            }
            Self::ShutterInstant => "frame_end_us may be frame_start_us",
            Self::StaticRolling => "a rolling shutter at rest shows the image of a global one",
            Self::RollingRows => {
                "top-to-bottom: upper rows are seen from the start pose, lower ones from the end pose"
            }
            Self::RollingReversed => "bottom-to-top: upper rows are seen from the end pose",
            Self::ObjectShown => "an object that is listed is drawn",
            Self::ObjectMoves => "an object is drawn where its pose says",
            Self::ObjectCentered => "the pose of an object is that of the middle of its box",
            Self::ObjectTurns => "an object turns with its pose",
            Self::ObjectForgotten => {
                "a request is drawn alike whatever objects the one before it listed"
            }
            Self::UnknownObject => "an unknown track id changes nothing, or is refused",
            Self::Batch => "a batch returns each camera once, with the pixels of render_rgb",
            Self::BatchPerCameraObjects => "items of a batch may list different objects",
            Self::UnknownScene => "an unknown scene is refused",
            Self::MissingCamera => "a request without a camera is refused",
            Self::UndefinedFormat => "the image format UNDEFINED is refused",
            Self::BackwardTime => "frame_end_us before frame_start_us is refused",
            Self::Lidar => "a sweep has as many points as it says, in fields and buffers alike",
            Self::LidarPose => "points are in the frame of the sensor: they turn with it",
            Self::Aggregated => "render_aggregated returns what render_rgb and render_lidar do",
        }
    }

    /// Clause of the contract that it rests on: message and field of AlpaSim's protos
    /// (`src/grpc/alpasim_grpc/v0` at 3032e0c, version 0.54.0), or where its runtime relies on it.
    #[must_use]
    pub fn rests_on(self) -> &'static str {
        match self {
            Self::Version => "common.proto VersionId",
            Self::Scenes => "common.proto AvailableScenesReturn.scene_ids",
            Self::Cameras => "sensorsim.proto AvailableCamerasReturn.AvailableCamera",
            Self::Package => {
                "runtime sensorsim_service.py:295: poses of the package and rig_to_camera"
            }
            Self::Trajectories => {
                "sensorsim.proto AvailableTrajectory; the runtime does not call it"
            }
            Self::EgoMasks => "sensorsim.proto AvailableEgoMasksReturn",
            Self::Png | Self::Jpeg | Self::Planar | Self::UndefinedFormat => {
                "sensorsim.proto ImageFormat"
            }
            Self::Colors => "sensorsim.proto RGBRenderReturn: RGB",
            Self::LargeAnswer | Self::Resized => {
                "sensorsim.proto RGBRenderRequest.resolution_h, resolution_w"
            }
            Self::Repeatable | Self::Parallel | Self::ObjectForgotten => {
                "sensorsim.proto SensorsimService: a request has all of its state"
            }
            Self::UnknownFields => "protobuf: unknown fields are kept or dropped",
            Self::Fisheye => "sensorsim.proto OpenCVFisheyeCameraParam",
            Self::FTheta | Self::FThetaBackward => {
                "sensorsim.proto FthetaCameraParam.reference_poly, principal_point"
            }
            Self::ShutterInstant | Self::BackwardTime => {
                "sensorsim.proto RGBRenderRequest.frame_start_us, frame_end_us"
            }
            Self::StaticRolling | Self::RollingRows | Self::RollingReversed => {
                "sensorsim.proto CameraSpec.shutter_type, PosePair"
            }
            Self::ObjectShown | Self::ObjectMoves | Self::ObjectCentered | Self::ObjectTurns => {
                "sensorsim.proto DynamicObject.pose_pair"
            }
            Self::UnknownObject => "sensorsim.proto DynamicObject.track_id",
            Self::Batch | Self::BatchPerCameraObjects => "sensorsim.proto BatchRGBRenderReturn",
            Self::UnknownScene => "sensorsim.proto RGBRenderRequest.scene_id",
            Self::MissingCamera => "sensorsim.proto RGBRenderRequest.camera_intrinsics",
            Self::Lidar | Self::LidarPose => "sensorsim.proto LidarRenderReturn",
            Self::Aggregated => "sensorsim.proto AggregatedRenderReturn",
        }
    }

    /// True for calls that every simulator needs: without them the check fails.
    #[must_use]
    pub fn is_required(self) -> bool {
        !matches!(
            self,
            Self::EgoMasks | Self::Trajectories | Self::Lidar | Self::LidarPose | Self::Aggregated
        )
    }

    /// Runs the check.
    pub(super) async fn judge(self, target: &mut Target) -> Outcome {
        let judged = match self {
            Self::Version => answers::version(target).await,
            Self::Scenes => answers::scenes(target).await,
            Self::Cameras => answers::cameras(target).await,
            Self::Package => answers::package(target).await,
            Self::Trajectories => answers::trajectories(target).await,
            Self::EgoMasks => answers::ego_masks(target).await,
            Self::Png => images::png(target).await,
            Self::Colors => images::colors(target).await,
            Self::Planar => images::planar(target).await,
            Self::Jpeg => images::jpeg(target).await,
            Self::LargeAnswer => images::large(target).await,
            Self::Resized => images::resized(target).await,
            Self::Repeatable => images::repeatable(target).await,
            Self::Parallel => images::parallel(target).await,
            Self::UnknownFields => images::unknown_fields(target).await,
            Self::Fisheye => images::lens(target, images::fisheye()).await,
            Self::FTheta => {
                let lens = images::ftheta(PolynomialType::AngleToPixeldist);
                images::lens(target, lens).await
            }
            Self::FThetaBackward => {
                let lens = images::ftheta(PolynomialType::PixeldistToAngle);
                images::lens(target, lens).await
            }
            Self::ShutterInstant => motion::instant(target).await,
            Self::StaticRolling => motion::at_rest(target).await,
            Self::RollingRows => motion::rows(target, false).await,
            Self::RollingReversed => motion::rows(target, true).await,
            Self::ObjectShown => motion::object_shown(target).await,
            Self::ObjectMoves => motion::object_moves(target).await,
            Self::ObjectCentered => motion::object_centered(target).await,
            Self::ObjectTurns => motion::object_turns(target).await,
            Self::ObjectForgotten => motion::forgotten(target).await,
            Self::UnknownObject => motion::unknown_object(target).await,
            Self::Batch => answers::batch(target).await,
            Self::BatchPerCameraObjects => answers::batch_of_objects(target).await,
            Self::UnknownScene => answers::unknown_scene(target).await,
            Self::MissingCamera => answers::missing_camera(target).await,
            Self::UndefinedFormat => answers::undefined_format(target).await,
            Self::BackwardTime => answers::backward_time(target).await,
            Self::Lidar => sweeps::counts(target).await,
            Self::LidarPose => sweeps::frame(target).await,
            Self::Aggregated => sweeps::aggregated(target).await,
        };
        match judged {
            Ok(figure) => Outcome::Passed(figure),
            Err(Stop::Failed(fault)) => Outcome::Failed(fault),
            Err(Stop::Skipped(reason)) => Outcome::Skipped(reason),
            Err(Stop::Refused(status)) => {
                let said = format!("{:?}: {}", status.code(), status.message());
                if status.code() == Code::Unimplemented && !self.is_required() {
                    Outcome::Skipped("the server does not have this call".into())
                } else {
                    Outcome::Failed(format!("the request was refused, {said}"))
                }
            }
        }
    }
}
