//! Archives whose entries are stored as they are, each aligned, as USDZ asks for.

use std::io::{self, Read, Write};

use flate2::Crc;

use super::{CENTRAL, CENTRAL_BYTES, END, LOCAL, LOCAL_BYTES, leads_astray};

/// Alignment of every entry's content, bytes.
pub const ALIGNMENT: usize = 64;
/// The extra field that fills up to the alignment: the one that USD's own writer uses.
const PADDING: u16 = 0x1986;
/// Written with every entry, so that the same content is the same bytes: 1 January 1980, midnight.
const DATE: [u8; 4] = [0, 0, 0x21, 0];
/// Zip without extensions counts in 32 bits, and USDZ allows no extensions.
const BYTES_MAX: u64 = u32::MAX as u64;

struct Written {
    name: String,
    checksum: u32,
    bytes: u32,
    header_at: u32,
}

/// Writes an archive of stored entries, one behind the other.
pub struct StoredZip<W: Write> {
    to: W,
    at: u64,
    written: Vec<Written>,
}

impl<W: Write> StoredZip<W> {
    /// An archive without entries.
    pub fn new(to: W) -> Self {
        Self {
            to,
            at: 0,
            written: Vec::new(),
        }
    }

    /// Adds an entry called `name`, parts joined by `/`.
    ///
    /// # Errors
    /// Returns an error if the name is taken or leads out of the archive, when the archive grows
    /// beyond 4 GiB, or when writing fails.
    pub fn add(&mut self, name: &str, content: &[u8]) -> io::Result<()> {
        let mut checksum = Crc::new();
        checksum.update(content);
        self.begin(name, checksum.sum(), content.len() as u64)?;
        self.put(content)
    }

    /// Adds what `open` reads as an entry called `name`. It is read twice, and kept nowhere.
    ///
    /// # Errors
    /// Returns the errors of [`StoredZip::add`], and an error if reading fails or if the second
    /// reading gives other bytes than the first.
    pub fn add_from<R: Read>(
        &mut self,
        name: &str,
        open: impl Fn() -> io::Result<R>,
    ) -> io::Result<()> {
        let mut block = vec![0; 1 << 16];
        let mut checksum = Crc::new();
        let mut first = open()?;
        let mut bytes = 0;
        loop {
            let read = first.read(&mut block)?;
            if read == 0 {
                break;
            }
            checksum.update(&block[..read]);
            bytes += read as u64;
        }
        self.begin(name, checksum.sum(), bytes)?;
        let (mut second, mut again) = (open()?.take(bytes), Crc::new());
        loop {
            let read = second.read(&mut block)?;
            if read == 0 {
                break;
            }
            again.update(&block[..read]);
            self.put(&block[..read])?;
        }
        if again.sum() != checksum.sum() {
            return Err(io::Error::other(format!(
                "the source of '{name}' changed while it was read"
            )));
        }
        Ok(())
    }

    /// Writes the directory and gives the writer back.
    ///
    /// # Errors
    /// Returns an error if the archive grows beyond 4 GiB or 65,535 entries, or when writing fails.
    pub fn finish(mut self) -> io::Result<W> {
        let start = self.at;
        let too_many = || {
            io::Error::other(format!(
                "{} entries; a zip has at most 65535",
                self.written.len()
            ))
        };
        let count = u16::try_from(self.written.len()).map_err(|_| too_many())?;
        for written in std::mem::take(&mut self.written) {
            let mut entry = Vec::with_capacity(CENTRAL_BYTES + written.name.len());
            entry.extend_from_slice(&CENTRAL);
            // Made by and needed: version 2.0. No flags, stored.
            entry.extend_from_slice(&[20, 0, 20, 0, 0, 0, 0, 0]);
            entry.extend_from_slice(&DATE);
            entry.extend(
                [written.checksum, written.bytes, written.bytes]
                    .into_iter()
                    .flat_map(u32::to_le_bytes),
            );
            entry.extend_from_slice(&(written.name.len() as u16).to_le_bytes());
            // No extra field, comment, disk or attributes.
            entry.extend_from_slice(&[0; 12]);
            entry.extend_from_slice(&written.header_at.to_le_bytes());
            entry.extend_from_slice(written.name.as_bytes());
            self.put(&entry)?;
        }
        let length = u32::try_from(self.at - start).map_err(|_| beyond_zip())?;
        let start = u32::try_from(start).map_err(|_| beyond_zip())?;
        let mut end = END.to_vec();
        end.extend_from_slice(&[0; 4]);
        end.extend([count, count].into_iter().flat_map(u16::to_le_bytes));
        end.extend([length, start].into_iter().flat_map(u32::to_le_bytes));
        end.extend_from_slice(&[0; 2]);
        self.put(&end)?;
        Ok(self.to)
    }

    /// Writes what stands before the content of an entry.
    fn begin(&mut self, name: &str, checksum: u32, bytes: u64) -> io::Result<()> {
        let refused = |why: &str| {
            Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("'{name}' {why}"),
            ))
        };
        if name.is_empty() || leads_astray(name) || name.len() > usize::from(u16::MAX) {
            return refused("is no name in a zip");
        }
        if self.written.iter().any(|written| written.name == name) {
            return refused("is in the zip already");
        }
        if self.at + bytes > BYTES_MAX - (1 << 20) {
            return Err(beyond_zip());
        }
        let before = self.at as usize + LOCAL_BYTES + name.len();
        // A field of padding needs four bytes for itself.
        let mut padding = before.next_multiple_of(ALIGNMENT) - before;
        if (1..4).contains(&padding) {
            padding += ALIGNMENT;
        }
        let mut header = LOCAL.to_vec();
        header.extend_from_slice(&[20, 0, 0, 0, 0, 0]);
        header.extend_from_slice(&DATE);
        header.extend(
            [checksum, bytes as u32, bytes as u32]
                .into_iter()
                .flat_map(u32::to_le_bytes),
        );
        header.extend(
            [name.len() as u16, padding as u16]
                .into_iter()
                .flat_map(u16::to_le_bytes),
        );
        header.extend_from_slice(name.as_bytes());
        if padding > 0 {
            header.extend(
                [PADDING, padding as u16 - 4]
                    .into_iter()
                    .flat_map(u16::to_le_bytes),
            );
            header.resize(header.len() + padding - 4, 0);
        }
        self.written.push(Written {
            name: name.to_owned(),
            checksum,
            bytes: bytes as u32,
            header_at: self.at as u32,
        });
        self.put(&header)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.to.write_all(bytes)?;
        self.at += bytes.len() as u64;
        Ok(())
    }
}

fn beyond_zip() -> io::Error {
    io::Error::other(
        "a zip without extensions, as USDZ asks for, holds at most 4 GiB; make the splats fewer",
    )
}
