//! One small entry of an archive that is not read as a whole.

use std::io::{Read, Seek, SeekFrom};

use super::read::{bytes_before_content, directory_span, stored_in_directory};
use super::{END_BYTES, LOCAL_BYTES};

/// Bytes at the end of a file in which the end of its directory is looked for.
const TAIL_BYTES: u64 = 65_535 + END_BYTES as u64;
/// Largest directory that is read, bytes.
const DIRECTORY_BYTES_MAX: u64 = 16 << 20;

/// The content of the stored entry `name` of the archive in `file`, of at most `bytes_max`. `None`
/// where there is none, or the directory has the 64-bit extension. Its checksum is not examined.
pub(crate) fn stored_in(
    file: &mut (impl Read + Seek),
    name: &str,
    bytes_max: u64,
) -> Option<Vec<u8>> {
    let file_bytes = file.seek(SeekFrom::End(0)).ok()?;
    let tail_at = file_bytes.saturating_sub(TAIL_BYTES);
    let tail = read_at(file, tail_at, file_bytes - tail_at)?;
    let (directory_at, bytes) = directory_span(&tail, file_bytes)?;
    if bytes > DIRECTORY_BYTES_MAX {
        return None;
    }
    let directory = read_at(file, directory_at, bytes)?;
    let (header_at, bytes) = stored_in_directory(&directory, name)?;
    if bytes > bytes_max {
        return None;
    }
    let header = read_at(file, header_at, LOCAL_BYTES as u64)?;
    let before = bytes_before_content(header.as_slice().try_into().ok()?)?;
    read_at(file, header_at.checked_add(before)?, bytes)
}

/// `bytes` of `file` from the place `at` on, all of them.
fn read_at(file: &mut (impl Read + Seek), at: u64, bytes: u64) -> Option<Vec<u8>> {
    let mut content = Vec::new();
    file.seek(SeekFrom::Start(at)).ok()?;
    file.by_ref().take(bytes).read_to_end(&mut content).ok()?;
    (content.len() as u64 == bytes).then_some(content)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::zip::StoredZip;
    use std::io::Cursor;

    #[test]
    fn an_entry_behind_a_large_one_is_found() {
        let mut bytes = Vec::new();
        let mut zip = StoredZip::new(&mut bytes);
        zip.add("volume", &vec![7; 200_000]).unwrap();
        zip.add("metadata.yaml", b"scene_id: a").unwrap();
        zip.finish().unwrap();
        let found = |name: &str, most: u64| stored_in(&mut Cursor::new(&bytes), name, most);
        assert_eq!(
            found("metadata.yaml", 100).as_deref(),
            Some(&b"scene_id: a"[..])
        );
        assert_eq!(found("metadata.yaml", 10), None, "larger than allowed");
        assert_eq!(
            found("volume", 1 << 20).map(|content| content.len()),
            Some(200_000)
        );
        assert_eq!(found("other", 100), None);
        for end in [0, 10, bytes.len() / 2, bytes.len() - 1] {
            let mut cut = Cursor::new(&bytes[..end]);
            assert_eq!(stored_in(&mut cut, "metadata.yaml", 100), None, "{end}");
        }
    }
}
