//! Status of a call, and its origin in the engine's errors.

use decouplegs::gpu::GpuError;
use decouplegs::render::RenderError;
use decouplegs::session::SessionError;

/// Status of a call. dgs_last_error() has the sentence.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DgsStatus {
    /// The call succeeded.
    Ok = 0,
    /// NULL, a misaligned pointer, text that is not UTF-8, a number out of range or not finite, a
    /// struct of an unknown size.
    InvalidArgument = 1,
    /// A handle that was closed, was never given out, is of another kind, or belongs to another
    /// session.
    InvalidHandle = 2,
    /// No device, agent, asset, camera or image of that name or number.
    NotFound = 3,
    /// The buffer is too short for the text: `length` says how long it must be, without the NUL.
    TooSmall = 4,
    /// A limit is reached: agents of a world, splats, or images that are held.
    Limit = 5,
    /// Another thread is using the batch renderer or changing the world.
    Busy = 6,
    /// A file is missing, cannot be read, or is not what its format promises.
    File = 7,
    /// No Vulkan loader, driver or device, or the driver refused.
    Device = 8,
    /// The device has not the memory.
    OutOfMemory = 9,
    /// The device stopped answering: close everything and open a session anew.
    DeviceLost = 10,
    /// This device, session or agent cannot do it.
    Unsupported = 11,
    /// A fault of the library, which stopped the call midway. Please report it.
    Panic = 12,
    /// The handle was in a call that ended with DGS_STATUS_PANIC: it can only be closed.
    Poisoned = 13,
}

impl DgsStatus {
    /// All of them, each at the index that is its number.
    pub(crate) const ALL: [Self; 14] = [
        Self::Ok,
        Self::InvalidArgument,
        Self::InvalidHandle,
        Self::NotFound,
        Self::TooSmall,
        Self::Limit,
        Self::Busy,
        Self::File,
        Self::Device,
        Self::OutOfMemory,
        Self::DeviceLost,
        Self::Unsupported,
        Self::Panic,
        Self::Poisoned,
    ];

    pub(crate) fn name(self) -> &'static std::ffi::CStr {
        match self {
            Self::Ok => c"ok",
            Self::InvalidArgument => c"invalid argument",
            Self::InvalidHandle => c"invalid handle",
            Self::NotFound => c"not found",
            Self::TooSmall => c"buffer too small",
            Self::Limit => c"limit reached",
            Self::Busy => c"busy",
            Self::File => c"file",
            Self::Device => c"device",
            Self::OutOfMemory => c"out of device memory",
            Self::DeviceLost => c"device lost",
            Self::Unsupported => c"unsupported",
            Self::Panic => c"panic",
            Self::Poisoned => c"poisoned",
        }
    }
}

/// Reason why a call fails.
#[derive(Debug)]
pub struct Failure {
    pub status: DgsStatus,
    pub message: String,
}

impl Failure {
    pub fn new(status: DgsStatus, message: impl Into<String>) -> Self {
        Self {
            status,
            message: message.into(),
        }
    }

    pub fn argument(message: impl Into<String>) -> Self {
        Self::new(DgsStatus::InvalidArgument, message)
    }

    /// Failure of this kind whose message begins with `whom`.
    pub fn with_subject(self, whom: &str) -> Self {
        Self {
            message: format!("{whom}: {}", self.message),
            ..self
        }
    }

    pub fn not_found(message: impl Into<String>) -> Self {
        Self::new(DgsStatus::NotFound, message)
    }
}

impl From<GpuError> for Failure {
    fn from(error: GpuError) -> Self {
        Self::new(of_gpu(&error), error.to_string())
    }
}

impl From<SessionError> for Failure {
    fn from(error: SessionError) -> Self {
        let status = match &error {
            SessionError::Gpu(error) => of_gpu(error),
            // Agents that their world cannot take, too: the scene file puts them there.
            SessionError::Asset(_) => DgsStatus::File,
            SessionError::Render(error) => of_render(error),
            SessionError::NoAgent { .. } | SessionError::NoAsset { .. } => DgsStatus::NotFound,
            SessionError::PlainSplats { .. } | SessionError::NotBytes => DgsStatus::Unsupported,
            SessionError::TooManyAgents { .. } => DgsStatus::Limit,
            SessionError::NoCameras
            | SessionError::NothingSubmitted
            | SessionError::Image(_)
            | SessionError::Unfinished { .. } => DgsStatus::InvalidArgument,
            SessionError::OtherSession { .. } => DgsStatus::InvalidHandle,
        };
        Self::new(status, error.to_string())
    }
}

fn of_gpu(error: &GpuError) -> DgsStatus {
    match error {
        GpuError::UnknownDevice { .. } => DgsStatus::NotFound,
        GpuError::MissingFeature { .. } => DgsStatus::Unsupported,
        GpuError::BufferTooLarge { .. } | GpuError::OutOfMemory { .. } => DgsStatus::OutOfMemory,
        GpuError::DeviceLost { .. } | GpuError::Hang { .. } => DgsStatus::DeviceLost,
        _ => DgsStatus::Device,
    }
}

fn of_render(error: &RenderError) -> DgsStatus {
    match error {
        RenderError::Gpu(error) => of_gpu(error),
        RenderError::View(_)
        | RenderError::Lidar { .. }
        | RenderError::AgentPose { .. }
        | RenderError::AgentMotion { .. } => DgsStatus::InvalidArgument,
        // What is drawn comes from files, and was checked when they were read.
        RenderError::Asset(_) | RenderError::AgentLight { .. } | RenderError::Shadow { .. } => {
            DgsStatus::File
        }
        RenderError::TooManyInFlight { .. }
        | RenderError::TooManyTaken { .. }
        | RenderError::TooManySplats { .. } => DgsStatus::Limit,
        RenderError::NoSuchAsset | RenderError::NothingInFlight => DgsStatus::NotFound,
        RenderError::Unsettled { .. } => DgsStatus::OutOfMemory,
    }
}
