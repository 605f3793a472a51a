//! Logs of ROS 2 messages in MCAP files, and the messages that an episode needs.
//!
//! Messages are in the Common Data Representation (CDR), little-endian. Each schema has the
//! definitions of the messages that it is made of, so readers need no ROS.

mod cdr;
mod messages;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::sync::Arc;

use decouplegs_asset::EncodeError;
use mcap::{Channel, Message, Schema, WriteOptions, Writer};

pub(crate) use cdr::Cdr;
pub use messages::{
    CAMERA_INFO, COMPRESSED_IMAGE, CameraModel, FLOAT64, LOG, MARKER_ARRAY, Marker, ODOMETRY, PATH,
    POINT_CLOUD2, TF_MESSAGE, Transform, camera_info, compressed_image, float64, marker_array,
    odometry, path, tf_message, warning,
};

/// Type of a message: its name and its definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageType {
    /// Name, such as `sensor_msgs/msg/Image`.
    pub name: &'static str,
    /// Definition with those of its parts, as `ros2 bag` stores them.
    pub definition: &'static str,
}

/// Log that is being written.
pub struct McapLog<W: Write + Seek> {
    writer: Writer<W>,
    channels: Vec<(Arc<Channel<'static>>, u32)>,
}

/// Topic of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topic(usize);

impl<W: Write + Seek> McapLog<W> {
    /// A log without messages.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn new(out: W) -> Result<Self, EncodeError> {
        let options = WriteOptions::new().compression(None).profile("ros2");
        Ok(Self {
            writer: options.create(out).map_err(fault)?,
            channels: Vec::new(),
        })
    }

    /// Adds the topic `name`. `latched`: subscribers that come later get its last message, as those
    /// of `/tf_static` must.
    pub fn topic(&mut self, name: &str, kind: MessageType, latched: bool) -> Topic {
        let number = self.channels.len() as u16 + 1;
        let schema = Schema {
            id: number,
            name: kind.name.to_owned(),
            encoding: "ros2msg".to_owned(),
            data: Cow::Borrowed(kind.definition.as_bytes()),
        };
        // Durability 1 is transient local; the other entries are the defaults of ROS 2.
        let quality = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1\n";
        let metadata = match latched {
            true => BTreeMap::from([("offered_qos_profiles".to_owned(), quality.to_owned())]),
            false => BTreeMap::new(),
        };
        let channel = Channel {
            id: number,
            topic: name.to_owned(),
            schema: Some(Arc::new(schema)),
            message_encoding: "cdr".to_owned(),
            metadata,
        };
        self.channels.push((Arc::new(channel), 0));
        Topic(self.channels.len() - 1)
    }

    /// Adds a message of `topic` at `time_ns`.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn add(&mut self, topic: Topic, time_ns: u64, data: &[u8]) -> Result<(), EncodeError> {
        let (channel, count) = &mut self.channels[topic.0];
        let message = Message {
            channel: Arc::clone(channel),
            sequence: *count,
            log_time: time_ns,
            publish_time: time_ns,
            data: Cow::Borrowed(data),
        };
        *count += 1;
        self.writer.write(&message).map_err(fault)
    }

    /// Writes the index, and returns what was written to.
    ///
    /// # Errors
    /// An [`EncodeError`] of the library.
    pub fn finish(mut self) -> Result<W, EncodeError> {
        self.writer.finish().map_err(fault)?;
        Ok(self.writer.into_inner())
    }
}

#[expect(clippy::needless_pass_by_value, reason = "the shape of map_err")]
fn fault(error: mcap::McapError) -> EncodeError {
    EncodeError(error.to_string())
}
