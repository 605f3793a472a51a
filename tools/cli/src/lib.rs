//! Parts that the command line programs share. Not an interface for other programs: those use the
//! crate `decouplegs`.
//!
//! | module | content |
//! |---|---|
//! | `programs` | the programs, their subcommands and their exit codes |
//! | `command_line` | how command lines are read, and what mistakes in them are told |
//! | `arguments`, `device`, `scene_source`, `orbit`, `background` | arguments of several subcommands, and what they open |
//! | `free_view`, `camera_path` | a pinhole as numbers; its way through keyframes |
//! | `outputs` | files and folders that are written, checked before work begins |
//! | `progress` | progress lines and durations |
//! | `jpeg`, `png_bytes`, `video` | images as bytes of a file, and as a video |
//! | `page`, `plot`, `thumbnail` | pages of reports: their text, tables and images, and plots as SVG |
//! | `street_files` | a synthetic street as the files of a scene |
//! | `views`, `visibility`, `image_quality` | views around an asset, how much each splat shows in them, and differences between images |
#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod arguments;
#[doc(hidden)]
pub mod background;
#[doc(hidden)]
pub mod camera_path;
#[doc(hidden)]
pub mod command_line;
#[doc(hidden)]
pub mod device;
#[doc(hidden)]
pub mod free_view;
#[doc(hidden)]
pub mod image_quality;
#[doc(hidden)]
pub mod jpeg;
#[doc(hidden)]
pub mod orbit;
#[doc(hidden)]
pub mod outputs;
#[doc(hidden)]
pub mod page;
#[doc(hidden)]
pub mod plot;
#[doc(hidden)]
pub mod png_bytes;
#[doc(hidden)]
pub mod programs;
#[doc(hidden)]
pub mod progress;
#[doc(hidden)]
pub mod scene_source;
#[doc(hidden)]
pub mod street_files;
#[doc(hidden)]
pub mod thumbnail;
#[doc(hidden)]
pub mod video;
#[doc(hidden)]
pub mod views;
#[doc(hidden)]
pub mod visibility;
