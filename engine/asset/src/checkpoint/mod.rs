//! Checkpoints of PyTorch (`.pt`, `.pth`, `.ckpt`): what is read of them, and of which trainers.
//!
//! A checkpoint is a zip of a pickle, `data.pkl`, and of one stored entry for each tensor's
//! numbers. A pickle is a program for a stack machine that may call anything; here it calls
//! nothing. It builds dictionaries, lists, numbers, texts and tensors; names of classes are kept as
//! names, those that belong to no trainer's checkpoint are refused, and what others would have
//! built stays opaque. Tensors are pieces of the file until they are asked for.
//!
//! | trainer | what it is read as |
//! |---|---|
//! | gsplat (`simple_trainer.py`) | a cloud, by [`decode`] |
//! | drivestudio, OmniRe | background, rigid actors and their tracks, by [`crate::scene_import`] |
//! | Street Gaussians | background and actors, by [`crate::scene_import`] |
//! | HUGSIM | background, ground and actors of a folder, by [`crate::scene_import`] |

mod gaussians;
mod gsplat;
mod pickle;
mod stack;
mod tensor;
mod value;

use decouplegs_scene::SplatCloud;

use crate::DecodeError;
use crate::zip::Archive;
use pickle::Unpickler;

pub(crate) use gaussians::{ModelTensors, Names, cloud_of, plain_dc, rows};
pub(crate) use tensor::Tensor;
pub(crate) use value::{Node, Tree};

/// Name of the format for users.
pub(crate) const NAME: &str = "PyTorch checkpoint";
/// The entry that has everything but the tensors' numbers.
const PICKLE: &str = "data.pkl";
/// Most bytes of a pickle. Real ones name tensors and settings in some ten kilobytes, with an
/// optimizer's state in a megabyte. Each byte may build a node of [`value::Node`], 24 bytes, and a
/// index in the memo.
const PICKLE_BYTES_MAX: usize = 4 << 20;

/// Reads the splats of a checkpoint of gsplat.
///
/// # Errors
/// A [`DecodeError`] that names the tensor at fault, or says which other trainer's checkpoint this
/// is and how to read it.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    let checkpoint = Checkpoint::parse(bytes)?;
    gsplat::cloud(&checkpoint)
}

/// True if a zip is a checkpoint.
pub(crate) fn is_checkpoint(archive: &Archive<'_>) -> bool {
    root_of(archive).is_some()
}

/// The folder in a checkpoint that holds everything, with its slash.
fn root_of<'n>(archive: &'n Archive<'_>) -> Option<&'n str> {
    archive.names().find_map(|name| {
        name.strip_suffix(PICKLE)
            .filter(|root| root.is_empty() || root.ends_with('/'))
    })
}

/// A checkpoint, unpickled.
pub(crate) struct Checkpoint<'a> {
    archive: Archive<'a>,
    root: String,
    /// Size of the file, bytes.
    pub(crate) file_bytes: usize,
    /// Result of the pickle.
    pub(crate) tree: Tree,
}

impl<'a> Checkpoint<'a> {
    /// Reads the pickle of `bytes`.
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        if bytes.starts_with(b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.") {
            let message = "saved in the form of PyTorch before 1.6; load it with torch.load and save it again with torch.save";
            return Err(DecodeError::Unsupported(message.into()));
        }
        let archive = Archive::parse(bytes)?;
        let Some(root) = root_of(&archive).map(str::to_owned) else {
            return Err(DecodeError::Malformed(format!(
                "the zip has no '{PICKLE}'; a checkpoint of PyTorch has one"
            )));
        };
        let byte_order = format!("{root}byteorder");
        if archive.has(&byte_order) && archive.stored(&byte_order)? != b"little" {
            return Err(DecodeError::Unsupported(
                "its numbers are not little-endian; save it again on another machine".into(),
            ));
        }
        let pickle = archive.stored(&format!("{root}{PICKLE}"))?;
        if pickle.len() > PICKLE_BYTES_MAX {
            let message = format!(
                "its pickle has {} bytes; at most {PICKLE_BYTES_MAX} are read",
                pickle.len()
            );
            return Err(DecodeError::Unsupported(message));
        }
        let tree = Unpickler::new(pickle).run()?;
        Ok(Self {
            archive,
            root,
            file_bytes: bytes.len(),
            tree,
        })
    }

    /// The numbers of a tensor, called `what` in messages.
    pub(crate) fn tensor(&self, node: &Node, what: &str) -> Result<Tensor<'a>, DecodeError> {
        let Node::Tensor(form) = node else {
            return Err(DecodeError::Malformed(format!(
                "'{what}' is {}, expected a tensor",
                node.kind()
            )));
        };
        let Node::Storage(storage) = self.tree.node(form.storage) else {
            return Err(DecodeError::Malformed(format!(
                "tensor '{what}' has no storage"
            )));
        };
        let bytes = self
            .archive
            .stored(&format!("{}data/{}", self.root, storage.key))?;
        Tensor::new(form, storage.scalar, bytes, self.file_bytes, what)
    }
}
