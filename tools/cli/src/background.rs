//! Storage and levels of detail of the background on the command line.

use clap::ValueEnum;
use decouplegs_render::{RenderOptions, Storage};

use crate::arguments::pixels;

/// Arguments of every command that draws a background.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct BackgroundArguments {
    /// Storage of the background's splats on the device. Agents are stored as their codebooks
    #[arg(long, value_enum, default_value_t)]
    storage: StorageName,
    /// Render the background with fewer splats where they lie at most this many pixels apart. They
    /// are merged when the scene is opened (default: always the finest, which is exact)
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true, value_parser = pixels)]
    background_pitch: Option<f64>,
}

impl BackgroundArguments {
    /// The arguments as they are typed, those that are not the default.
    #[must_use]
    pub fn words(self) -> Vec<String> {
        let mut words = Vec::new();
        if self.storage == StorageName::Compact {
            words.extend(["--storage".into(), "compact".into()]);
        }
        if let Some(pitch_px) = self.background_pitch {
            words.extend(["--background-pitch".into(), format!("{pitch_px:?}")]);
        }
        words
    }

    /// Writes what was asked for into `options`.
    pub fn apply_to(self, options: &mut RenderOptions) {
        options.background_pitch_px = self.background_pitch;
        options.storage = match self.storage {
            StorageName::Exact => Storage::Exact,
            StorageName::Compact => Storage::Compact,
        };
    }
}

/// Storage by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum StorageName {
    /// 152 bytes per splat of degree 3
    #[default]
    Exact,
    /// 120 bytes per splat of degree 3: scales, rotations and colors are rounded, by less than one
    /// step of an 8-bit image. `bench` measures the error
    Compact,
}
