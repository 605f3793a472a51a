//! The renderer's images, as they are lent to CUDA.

use std::sync::Arc;

use decouplegs::gpu::{Buffer, QueueRole};
use decouplegs::render::{Plane, TakenImages};
use decouplegs::session::Session;
use decouplegs_sharing::{Cuda, Exported, Handed, Interop, InteropError, Lender, Loan, Shared};

pub type CudaLender = Lender<Cuda, TakenImages>;
pub type CudaLoan = Loan<Cuda, TakenImages>;
pub type CudaHanded = Handed<Cuda, TakenImages>;

/// A buffer of images.
struct ImageBuffer<T>(Buffer<T>);

impl<T> Shared for ImageBuffer<T> {
    fn id(&self) -> usize {
        self.0.id()
    }

    fn holders(&self) -> usize {
        self.0.holders()
    }

    fn export(&self) -> Result<Exported, InteropError> {
        let exported = self
            .0
            .export()
            .map_err(|error| InteropError::Export(error.to_string()))?;
        let buffer_bytes = self.0.byte_len();
        Ok(Exported {
            descriptor: exported.descriptor,
            allocation_bytes: exported.allocation_bytes,
            buffer_bytes,
        })
    }
}

/// A lender of the images that are drawn in `session`.
pub fn lender(session: &Session, cuda: &Arc<Cuda>) -> Result<Arc<CudaLender>, InteropError> {
    let timeline = session
        .gpu()
        .export_timeline(QueueRole::Main)
        .map_err(|error| InteropError::Export(error.to_string()))?;
    Lender::new(cuda.clone(), timeline)
}

/// CUDA addresses of a frame's images; 0 for those that were not requested.
#[derive(Clone, Copy, Default)]
pub struct Addresses {
    pub color: u64,
    /// Addresses by plane.
    pub planes: [u64; Plane::ALL.len()],
}

/// Imports what of `loan` was asked for.
pub fn addresses(lender: &CudaLender, loan: &CudaLoan) -> Result<Addresses, InteropError> {
    let buffers = loan.images().buffers();
    let color = if buffers.images_u8.is_empty() {
        address(lender, &buffers.images_f32)?
    } else {
        address(lender, &buffers.images_u8)?
    };
    let first = address(lender, &buffers.planes)?;
    let of_plane = |plane: Plane| {
        let words = buffers.plane_words(plane);
        words.map_or(0, |words| first + 4 * words.start as u64)
    };
    Ok(Addresses {
        color,
        planes: Plane::ALL.map(of_plane),
    })
}

/// The import stays as long as another than the lender holds the buffer, which the loan does.
fn address<T: 'static>(lender: &CudaLender, buffer: &Buffer<T>) -> Result<u64, InteropError> {
    if buffer.is_empty() {
        return Ok(0);
    }
    Ok(Cuda::address(&*lender.memory(ImageBuffer(buffer.clone()))?))
}
