//! Images on the device in the hands of another API: imported once, handed out on streams, taken
//! back when the stream is done.
//!
//! A renderer draws into a few buffers in turn. [`Lender::lend`] takes the images of a frame as a
//! [`Loan`]; what is handed out of it ([`Loan::hand_out`]) makes the consumer's stream wait for the
//! frame, and when the consumer releases it an event is recorded on that stream. The images go
//! back to the renderer ([`Lender::collect`]) when all such events are done: nobody waits for the
//! device, and nothing is drawn over that is still read.
//!
//! What is needed of CUDA is the trait [`Interop`]. [`Cuda`] is the driver, found at run time;
//! tests have one of their own, so that the rules above are tested on machines without CUDA.
//!
//! `unsafe` is only in `driver` and `cuda`; each block is one operation and says why it is sound.

mod cuda;
mod driver;
mod interop;
mod lender;

pub use cuda::Cuda;
pub use interop::{Exported, Interop, InteropError, Stream};
pub use lender::{Handed, Lender, Loan, Shared};
