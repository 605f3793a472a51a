//! Storage of the background's splats on the command line.

use clap::ValueEnum;
use decouplegs::render::Storage;

/// The argument of every command that draws a background.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct StorageArguments {
    /// Storage of the background's splats on the device. Agents are stored as their codebooks
    #[arg(long, value_enum, default_value_t = StorageName::Exact)]
    storage: StorageName,
}

impl StorageArguments {
    /// The storage.
    pub fn storage(self) -> Storage {
        match self.storage {
            StorageName::Exact => Storage::Exact,
            StorageName::Compact => Storage::Compact,
        }
    }
}

/// Storage by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StorageName {
    /// 152 bytes per splat of degree 3
    Exact,
    /// 120 bytes per splat of degree 3: scales, rotations and colors are rounded, which no 8-bit
    /// image shows. `bench` measures the error
    Compact,
}
