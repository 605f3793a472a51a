//! Images: what a renderer writes, how it comes to the host, and files of it.

pub(crate) mod image_bytes;
pub mod image_hash;
pub mod post_processing;
pub(crate) mod read_back;
pub mod rendered_image;
pub(crate) mod taken;
