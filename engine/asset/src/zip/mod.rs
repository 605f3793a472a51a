//! Zip archives: what SOG bundles, checkpoints of PyTorch and USDZ packages are inside.
//!
//! Read are archives of one file whose entries are stored or deflated, with the 64-bit extension.
//! Nothing is allocated by what a directory claims: a stored entry is a piece of the file, a
//! deflated one grows with what is really there and is given up at the size that the caller is
//! ready to hold. Names that lead out of a folder are refused.

mod read;
mod seek;
mod write;

pub(crate) use read::{Archive, first_stored};
pub(crate) use seek::stored_in;
pub use write::{ALIGNMENT, StoredZip};

/// Signature of local entries.
const LOCAL: [u8; 4] = *b"PK\x03\x04";
/// Signature of directory entries.
const CENTRAL: [u8; 4] = *b"PK\x01\x02";
/// Signature of the end of the directory.
const END: [u8; 4] = *b"PK\x05\x06";
/// Bytes of a local entry before its name.
const LOCAL_BYTES: usize = 30;
/// Bytes of a directory entry before its name.
const CENTRAL_BYTES: usize = 46;
/// Bytes of the end of the directory before its comment.
const END_BYTES: usize = 22;

/// Reason why `name` may not be in an archive that is unpacked into a folder, if any.
fn leads_astray(name: &str) -> bool {
    let is_absolute = name.starts_with('/') || name.contains(':');
    is_absolute
        || name.contains(['\\', '\0'])
        || name.split('/').any(|part| part == ".." || part == ".")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_lead_out_of_a_folder_are_told() {
        for good in ["a", "a/b.txt", "a/", "..a/b..", "a.b/c"] {
            assert!(!leads_astray(good), "{good}");
        }
        for bad in ["/a", "../a", "a/../b", "a/..", "C:/a", "a\\b", "./a", "a\0"] {
            assert!(leads_astray(bad), "{bad}");
        }
    }

    #[test]
    fn what_is_stored_is_read_again_and_lies_aligned() {
        let mut bytes = Vec::new();
        let mut zip = StoredZip::new(&mut bytes);
        zip.add("a.txt", b"first").unwrap();
        zip.add("folder/b.bin", &[7; 300]).unwrap();
        zip.add("empty", b"").unwrap();
        zip.finish().unwrap();
        let archive = Archive::parse(&bytes).unwrap();
        assert_eq!(
            archive.names().collect::<Vec<_>>(),
            ["a.txt", "folder/b.bin", "empty"]
        );
        for name in ["a.txt", "folder/b.bin", "empty"] {
            let content = archive.stored(name).unwrap();
            let at = content.as_ptr() as usize - bytes.as_ptr() as usize;
            assert_eq!(at % ALIGNMENT, 0, "{name}");
            assert_eq!(archive.checked(name, 300).unwrap(), content);
        }
        assert_eq!(archive.stored("a.txt").unwrap(), b"first");
        // Also where the end of the file, with the directory, is not there.
        assert_eq!(
            first_stored(&bytes[..430], "folder/b.bin"),
            Some(&[7; 300][..])
        );
        assert_eq!(
            first_stored(&bytes[..400], "folder/b.bin"),
            None,
            "cut short"
        );
        assert_eq!(first_stored(&bytes, "c"), None);
        assert!(
            archive
                .checked("folder/b.bin", 299)
                .unwrap_err()
                .to_string()
                .contains("300")
        );
        assert!(archive.stored("c").unwrap_err().to_string().contains("'c'"));
    }

    #[test]
    fn a_changed_byte_of_an_entry_is_noticed() {
        let mut bytes = Vec::new();
        let mut zip = StoredZip::new(&mut bytes);
        zip.add("a.txt", b"content").unwrap();
        zip.finish().unwrap();
        let at = bytes
            .windows(7)
            .position(|window| window == b"content")
            .unwrap();
        bytes[at] ^= 1;
        let archive = Archive::parse(&bytes).unwrap();
        assert!(
            archive
                .checked("a.txt", 100)
                .unwrap_err()
                .to_string()
                .contains("checksum")
        );
    }

    #[test]
    fn two_entries_of_one_name_are_not_written() {
        let mut zip = StoredZip::new(Vec::new());
        zip.add("a", b"").unwrap();
        assert!(zip.add("a", b"").is_err() && zip.add("../a", b"").is_err());
    }
}
