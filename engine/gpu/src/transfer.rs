//! Data to the device and back, through staging buffers of limited size.

use bytemuck::Pod;

use crate::{Buffer, Gpu, GpuError, MemoryKind, QueueRole, Ticket, memory::BufferMemory};

/// Staging memory is pinned, so it is kept small; two pieces of this size already fill the bus.
pub(crate) const PIECE_BYTES: usize = 64 << 20;

const STAGING: &str = "staging";

/// Writes `data` from element `first` of `buffer` on. Two pieces alternate: while the device copies
/// one, the host fills the other.
pub(crate) fn write<T: Pod>(
    gpu: &Gpu,
    buffer: &Buffer<T>,
    first: usize,
    data: &[T],
    piece_bytes: usize,
) -> Result<(), GpuError> {
    let range = buffer.byte_range(first, data.len());
    let bytes: &[u8] = bytemuck::cast_slice(data);
    let mut pieces: [Option<(Buffer<u8>, Ticket)>; 2] = [None, None];
    for (i, piece) in bytes.chunks(piece_bytes).enumerate() {
        let staging = match pieces[i % 2].take() {
            Some((staging, ticket)) => {
                ticket.wait()?;
                staging
            }
            None => gpu.buffer(STAGING, STAGING, piece.len(), MemoryKind::Upload)?,
        };
        staging.write_host(0, piece);
        let mut recorder = gpu.record(QueueRole::Main).only_once();
        let to = (range.start + i * piece_bytes) as u64;
        recorder.copy_bytes(&staging.memory, 0, &buffer.memory, to, piece.len() as u64);
        pieces[i % 2] = Some((staging, gpu.submit(recorder, &[])?));
    }
    pieces
        .iter()
        .flatten()
        .try_for_each(|(_, ticket)| ticket.wait())
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

    #[test]
    fn pieces_of_any_size_carry_all_the_bytes() {
        let gpu = Gpu::open(&DeviceOptions {
            validation: true,
            ..DeviceOptions::default()
        })
        .unwrap();
        let words: Vec<u32> = (0..1000_u32)
            .map(|i| i.wrapping_mul(2_654_435_761))
            .collect();
        // One piece, an exact split, a short last piece, many pieces, pieces that split values.
        for piece_bytes in [4000, 2000, 1024, 64, 333] {
            let buffer: Buffer<u32> = gpu
                .buffer("words", "test", words.len() + 7, MemoryKind::Device)
                .unwrap();
            write(
                &gpu,
                &buffer,
                0,
                &vec![u32::MAX; words.len() + 7],
                PIECE_BYTES,
            )
            .unwrap();
            write(&gpu, &buffer, 5, &words, piece_bytes).unwrap();
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
}
