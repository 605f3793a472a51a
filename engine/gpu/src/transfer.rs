//! Data to the device and back, through staging buffers of limited size.

use bytemuck::Pod;
use rayon::prelude::*;

use crate::{Buffer, Gpu, GpuError, MemoryKind, QueueRole, Ticket, memory::BufferMemory};

/// Staging memory is pinned, so it is kept small; two pieces of this size already fill the bus.
pub(crate) const PIECE_BYTES: usize = 64 << 20;

const STAGING: &str = "staging";

/// Bytes that one thread copies into a staging buffer at a time.
const COPIED_BYTES: usize = 1 << 20;

/// Data on its way to the device. Two staging buffers alternate, for all that is written through
/// one of these: while the device copies one, the host fills the other.
pub struct Uploads<'gpu> {
    gpu: &'gpu Gpu,
    piece_bytes: usize,
    /// Staging buffers, each with the copy that reads it. The next piece takes the first one.
    pieces: [Option<(Buffer<u8>, Ticket)>; 2],
}

impl<'gpu> Uploads<'gpu> {
    pub(crate) fn new(gpu: &'gpu Gpu, piece_bytes: usize) -> Self {
        Self {
            gpu,
            piece_bytes,
            pieces: [None, None],
        }
    }

    /// A buffer on the device that holds `data` once [`Uploads::finish`] returned.
    ///
    /// # Errors
    /// Returns the errors of [`Gpu::upload`].
    pub fn upload<T: Pod>(
        &mut self,
        name: &'static str,
        purpose: &'static str,
        data: &[T],
    ) -> Result<Buffer<T>, GpuError> {
        let buffer = self
            .gpu
            .buffer(name, purpose, data.len(), MemoryKind::Device)?;
        self.write(&buffer, 0, data)?;
        Ok(buffer)
    }

    /// Writes `data` from element `first` of `buffer` on.
    pub(crate) fn write<T: Pod>(
        &mut self,
        buffer: &Buffer<T>,
        first: usize,
        data: &[T],
    ) -> Result<(), GpuError> {
        let range = buffer.byte_range(first, data.len());
        let bytes: &[u8] = bytemuck::cast_slice(data);
        for (i, piece) in bytes.chunks(self.piece_bytes).enumerate() {
            let staging = self.staging(piece.len())?;
            staging
                .memory
                .write_host_bytes(|host| fill(&mut host[..piece.len()], piece));
            let mut recorder = self.gpu.record(QueueRole::Main).only_once();
            let to = (range.start + i * self.piece_bytes) as u64;
            recorder.copy_bytes(&staging.memory, 0, &buffer.memory, to, piece.len() as u64);
            let ticket = self.gpu.submit(recorder, &[])?;
            self.pieces.rotate_left(1);
            self.pieces[1] = Some((staging, ticket));
        }
        Ok(())
    }

    /// A staging buffer of at least `wanted_bytes` that no copy reads.
    fn staging(&mut self, wanted_bytes: usize) -> Result<Buffer<u8>, GpuError> {
        let mut bytes = wanted_bytes;
        if let Some((staging, ticket)) = self.pieces[0].take() {
            ticket.wait()?;
            if staging.len() >= wanted_bytes {
                return Ok(staging);
            }
            // The next data may be larger still: a buffer grows a few times only.
            bytes = wanted_bytes.next_power_of_two().min(self.piece_bytes);
        }
        self.gpu.buffer(STAGING, STAGING, bytes, MemoryKind::Upload)
    }

    /// Waits until the device holds everything.
    ///
    /// # Errors
    /// Returns an error if the device is lost.
    pub fn finish(self) -> Result<(), GpuError> {
        self.wait()
    }

    fn wait(&self) -> Result<(), GpuError> {
        let copies = self.pieces.iter().flatten();
        copies.map(|(_, ticket)| ticket).try_for_each(Ticket::wait)
    }
}

impl Drop for Uploads<'_> {
    /// Waits for what was begun: after an error, too, no memory is held by copies under way.
    fn drop(&mut self) {
        let _ = self.wait();
    }
}

/// Copies `from` to `to`, which are equally long: a long one on all threads.
fn fill(to: &mut [u8], from: &[u8]) {
    if from.len() <= COPIED_BYTES {
        to.copy_from_slice(from);
        return;
    }
    let parts = to.par_chunks_mut(COPIED_BYTES);
    parts
        .zip(from.par_chunks(COPIED_BYTES))
        .for_each(|(to, from)| to.copy_from_slice(from));
}

/// All values of `buffer`, after everything submitted to the main queue before.
pub(crate) fn read<T: Pod>(
    gpu: &Gpu,
    buffer: &Buffer<T>,
    piece_bytes: usize,
) -> Result<Vec<T>, GpuError> {
    let mut data = vec![T::zeroed(); buffer.len()];
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut data);
    if bytes.is_empty() {
        return Ok(data);
    }
    let staging: Buffer<u8> = gpu.buffer(
        STAGING,
        STAGING,
        piece_bytes.min(bytes.len()),
        MemoryKind::Readback,
    )?;
    for (i, piece) in bytes.chunks_mut(piece_bytes).enumerate() {
        read_piece(gpu, &buffer.memory, i * piece_bytes, &staging, piece)?;
    }
    Ok(data)
}

fn read_piece(
    gpu: &Gpu,
    memory: &std::sync::Arc<BufferMemory>,
    byte_offset: usize,
    staging: &Buffer<u8>,
    piece: &mut [u8],
) -> Result<(), GpuError> {
    let mut recorder = gpu.record(QueueRole::Main).only_once();
    recorder.copy_bytes(
        memory,
        byte_offset as u64,
        &staging.memory,
        0,
        piece.len() as u64,
    );
    gpu.submit(recorder, &[])?.wait()?;
    piece.copy_from_slice(staging.as_host(piece.len()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DeviceOptions;

    fn device() -> Gpu {
        Gpu::open(&DeviceOptions {
            validation: true,
            ..DeviceOptions::default()
        })
        .unwrap()
    }

    fn write<T: Pod>(gpu: &Gpu, buffer: &Buffer<T>, first: usize, data: &[T], piece_bytes: usize) {
        let mut uploads = Uploads::new(gpu, piece_bytes);
        uploads.write(buffer, first, data).unwrap();
        uploads.finish().unwrap();
    }

    #[test]
    fn pieces_of_any_size_carry_all_the_bytes() {
        let gpu = device();
        let words: Vec<u32> = (0..1000_u32)
            .map(|i| i.wrapping_mul(2_654_435_761))
            .collect();
        // One piece, an exact split, a short last piece, many pieces, pieces that split values.
        for piece_bytes in [4000, 2000, 1024, 64, 333] {
            let buffer: Buffer<u32> = gpu
                .buffer("words", "test", words.len() + 7, MemoryKind::Device)
                .unwrap();
            let ones = vec![u32::MAX; words.len() + 7];
            write(&gpu, &buffer, 0, &ones, PIECE_BYTES);
            write(&gpu, &buffer, 5, &words, piece_bytes);
            let read = read(&gpu, &buffer, piece_bytes).unwrap();
            assert_eq!(read[5..1005], words, "pieces of {piece_bytes} bytes");
            assert!(
                read[..5]
                    .iter()
                    .chain(&read[1005..])
                    .all(|&word| word == u32::MAX),
                "pieces of {piece_bytes} bytes"
            );
        }
        assert_eq!(gpu.memory().total_bytes, 0);
        assert_eq!(gpu.take_validation_messages(), [""; 0]);
    }

    #[test]
    fn buffers_of_any_size_share_two_staging_buffers() {
        let gpu = device();
        // Smaller, larger and much larger than what came before, and nothing; the last ones are
        // copied by several threads.
        let lens = [3, 1, 700, 0, 20, 1500, 90, 900_001, 600_000];
        let piece_bytes = 5 << 19;
        let words = |len: usize| -> Vec<u32> { (0..len as u32).map(|i| i ^ len as u32).collect() };
        let mut uploads = Uploads::new(&gpu, piece_bytes);
        let buffers: Vec<_> = lens
            .iter()
            .map(|&len| uploads.upload("words", "test", &words(len)).unwrap())
            .collect();
        let staged_bytes = gpu.memory().bytes_by_purpose[STAGING] as usize;
        assert!(
            (piece_bytes..=2 * piece_bytes).contains(&staged_bytes),
            "{staged_bytes} bytes"
        );
        uploads.finish().unwrap();
        for (buffer, len) in buffers.iter().zip(lens) {
            assert_eq!(gpu.read(buffer).unwrap(), words(len));
        }
        assert_eq!(gpu.take_validation_messages(), [""; 0]);
    }
}
