//! Catalogs, and the entries that references name.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::{self, Element};

use super::Skipped;
use super::parameters::{Node, Parameters};

/// Most bytes of catalogs that are parsed, counted for each reference: a short file may name a long
/// catalog often.
const PARSED_BYTES_MAX: u64 = 1 << 30;
/// Deepest chain of entries that refer to other entries.
const DEPTH_MAX: u32 = 4;

/// Catalogs that a scenario refers to.
pub(super) struct Catalogs<'r> {
    folders: Vec<PathBuf>,
    read_file: &'r dyn Fn(&Path) -> Option<Vec<u8>>,
    files: RefCell<HashMap<String, Option<Rc<[u8]>>>>,
    parsed_bytes: Cell<u64>,
    depth: Cell<u32>,
}

impl<'r> Catalogs<'r> {
    /// Catalogs in the folders that `root` lists, of whatever kind they are listed as.
    pub(super) fn new(
        root: Node,
        read_file: &'r dyn Fn(&Path) -> Option<Vec<u8>>,
    ) -> Result<Self, DecodeError> {
        let mut folders: Vec<PathBuf> = Vec::new();
        let listed = root.first("CatalogLocations");
        for directory in listed
            .iter()
            .flat_map(|list| list.elements())
            .filter_map(|kind| kind.first("Directory"))
        {
            let folder = directory
                .needed_attribute("path")?
                .replace('\\', "/")
                .into();
            if !folders.contains(&folder) && folders.len() < 64 {
                folders.push(folder);
            }
        }
        Ok(Self {
            folders,
            read_file,
            files: RefCell::default(),
            parsed_bytes: Cell::new(0),
            depth: Cell::new(0),
        })
    }

    /// Result of `read` for the entry that `reference` names, with the parameters that it assigns.
    /// `None` if there is no such catalog.
    ///
    /// # Errors
    /// An error if the catalog is no catalog or has no such entry, and those of `read`.
    pub(super) fn with_entry<T>(
        &self,
        reference: Node,
        skipped: &mut Skipped,
        read: impl FnOnce(Node, &mut Skipped) -> Result<T, DecodeError>,
    ) -> Result<Option<T>, DecodeError> {
        let catalog = reference.needed_attribute("catalogName")?;
        let entry = reference.needed_attribute("entryName")?;
        let Some(bytes) = self.file(&catalog) else {
            return Ok(None);
        };
        let file = xml::excerpt(&format!("{catalog}.xosc"));
        let within =
            |error: DecodeError| reference.fault(format!("in the catalog {file}: {error}"));
        let parsed_bytes = self.parsed_bytes.get() + bytes.len() as u64;
        self.parsed_bytes.set(parsed_bytes);
        if parsed_bytes > PARSED_BYTES_MAX || self.depth.get() == DEPTH_MAX {
            return Err(reference.fault(format!(
                "entries of catalogs are too large together or refer to each other; at most {PARSED_BYTES_MAX} bytes \
                 and {DEPTH_MAX} levels are read"
            )));
        }
        let document = xml::parse(&bytes).map_err(within)?;
        let root = Element::root(&document, "OpenSCENARIO").map_err(within)?;
        let listed = root.needed("Catalog").map_err(within)?;
        let found = listed
            .elements()
            .find(|element| element.attribute("name") == Some(&*entry))
            .ok_or_else(|| {
                reference.fault(format!(
                    "the catalog {file} has no entry {}",
                    xml::excerpt(&entry)
                ))
            })?;
        let parameters = Parameters::new(root, reference.assignments()?);
        self.depth.set(self.depth.get() + 1);
        let outside = skipped.within(Some(file.clone()));
        let read = read(Node::new(found, &parameters), skipped);
        skipped.within(outside);
        self.depth.set(self.depth.get() - 1);
        read.map(Some).map_err(within)
    }

    /// Bytes of the file of a catalog, which is in one of the folders.
    fn file(&self, catalog: &str) -> Option<Rc<[u8]>> {
        // A name, not a path: a reference does not lead out of the catalogs' folders.
        if catalog.contains(['/', '\\']) {
            return None;
        }
        let mut files = self.files.borrow_mut();
        if let Some(known) = files.get(catalog) {
            return known.clone();
        }
        let name = format!("{catalog}.xosc");
        let mut folders = self.folders.iter();
        let bytes = folders.find_map(|folder| (self.read_file)(&folder.join(&name)));
        let bytes = bytes.map(Rc::from);
        files.insert(catalog.to_owned(), bytes.clone());
        bytes
    }
}
