//! Decoder of messages. It counts entries first, because a message of 16 MB can declare eight
//! million objects, which take gigabytes as values.

use std::marker::PhantomData;

use prost::{Message, Name};
use tonic::Status;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder};
use tonic_prost::{ProstCodec, ProstEncoder};

/// Entries that all repeated fields of a message may have together: a batch of sixteen cameras that
/// each see 4,096 objects.
pub const ENTRIES_MAX: usize = 1 << 16;

/// Fields that hold many messages, each as the way there from the message whose name comes first.
const REPEATED: &[(&str, &[&[u32]])] = &[
    ("RGBRenderRequest", &[&[8]]),
    ("BatchRGBRenderRequest", &[&[1], &[1, 2, 8]]),
    ("AggregatedRenderRequest", &[&[1], &[1, 8], &[2], &[2, 6]]),
    ("LidarRenderRequest", &[&[6]]),
    ("SweepRequest", &[&[6]]),
    ("DriveResponse", &[&[2, 1], &[3, 2], &[3, 2, 1]]),
    ("PhysicsGroundIntersectionRequest", &[&[5], &[4, 3, 1]]),
];

/// [`ProstCodec`], for messages that may not be what they claim.
#[derive(Clone, Debug)]
pub struct BoundedCodec<T, U> {
    messages: PhantomData<(T, U)>,
}

impl<T, U> Default for BoundedCodec<T, U> {
    fn default() -> Self {
        Self {
            messages: PhantomData,
        }
    }
}

impl<T: Message + Send + 'static, U: Message + Name + Default + Send + 'static> Codec
    for BoundedCodec<T, U>
{
    type Encode = T;
    type Decode = U;
    type Encoder = ProstEncoder<T>;
    type Decoder = BoundedDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<T, U>::raw_encoder(BufferSettings::default())
    }

    fn decoder(&mut self) -> Self::Decoder {
        BoundedDecoder {
            message: PhantomData,
        }
    }
}

/// Reads messages whose entries were counted.
#[derive(Clone, Debug)]
pub struct BoundedDecoder<U> {
    message: PhantomData<U>,
}

impl<U: Message + Name + Default> Decoder for BoundedDecoder<U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        use bytes::Buf;
        let bytes = buffer.copy_to_bytes(buffer.remaining());
        let mut entries = 0;
        for way in REPEATED
            .iter()
            .filter(|(name, _)| *name == U::NAME)
            .flat_map(|(_, ways)| *ways)
        {
            count(&bytes, way, &mut entries);
        }
        if entries > ENTRIES_MAX {
            let reason = format!(
                "{} has more than {ENTRIES_MAX} entries in all: send fewer objects or cameras",
                U::NAME
            );
            return Err(Status::resource_exhausted(reason));
        }
        let malformed = |error| Status::invalid_argument(format!("not a {}: {error}", U::NAME));
        U::decode(bytes).map(Some).map_err(malformed)
    }
}

/// Adds the entries of the field at the end of `way` to `entries`, until there are too many. What
/// is malformed ends the count: it will not be decoded either.
fn count(message: &[u8], way: &[u32], entries: &mut usize) {
    let mut rest = message;
    while let Some((field, inner)) = next_field(&mut rest) {
        if *entries > ENTRIES_MAX {
            return;
        }
        match (way, inner) {
            ([last], Some(_)) if u64::from(*last) == field => *entries += 1,
            ([first, on @ ..], Some(inner)) if u64::from(*first) == field => {
                count(inner, on, entries);
            }
            _ => {}
        }
    }
}

/// Takes a field off the front: its number, and its bytes where it has a length.
fn next_field<'a>(rest: &mut &'a [u8]) -> Option<(u64, Option<&'a [u8]>)> {
    let key = varint(rest)?;
    let skipped = match key & 7 {
        0 => varint(rest).map(|_| None)?,
        1 => take(rest, 8).map(|_| None)?,
        2 => {
            let length = usize::try_from(varint(rest)?).ok()?;
            Some(take(rest, length)?)
        }
        5 => take(rest, 4).map(|_| None)?,
        _ => return None,
    };
    Some((key >> 3, skipped))
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(length)?;
    *rest = left;
    Some(taken)
}

fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for place in 0..10 {
        let (&byte, left) = rest.split_first()?;
        *rest = left;
        value |= u64::from(byte & 0x7f) << (7 * place);
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::common::{PoseAtTime, Trajectory};
    use crate::wire::egodriver::DriveResponse;
    use crate::wire::egodriver::drive_response::DebugInfo;
    use crate::wire::physics::PhysicsGroundIntersectionRequest;
    use crate::wire::sensorsim::{
        AggregatedRenderRequest, BatchRgbRenderRequest, BatchRgbRenderRequestItem, DynamicObject,
        LidarRenderRequest, RgbRenderRequest,
    };

    fn entries<M: Message + Name>(message: &M) -> usize {
        let ways = REPEATED
            .iter()
            .find(|(name, _)| *name == M::NAME)
            .expect("its repeated fields are listed")
            .1;
        let (bytes, mut entries) = (message.encode_to_vec(), 0);
        ways.iter().for_each(|way| count(&bytes, way, &mut entries));
        entries
    }

    fn request(objects: usize) -> RgbRenderRequest {
        let object = DynamicObject {
            track_id: "a car".into(),
            pose_pair: None,
        };
        RgbRenderRequest {
            scene_id: "street".into(),
            frame_end_us: 7,
            dynamic_objects: vec![object; objects],
            ..Default::default()
        }
    }

    #[test]
    fn entries_are_counted_wherever_they_are() {
        assert_eq!(entries(&request(3)), 3);
        let item = |objects| BatchRgbRenderRequestItem {
            camera_name: "front".into(),
            request: Some(request(objects)),
        };
        assert_eq!(
            entries(&BatchRgbRenderRequest {
                items: vec![item(3), item(4)]
            }),
            2 + 7
        );
        let lidar = LidarRenderRequest {
            dynamic_objects: request(5).dynamic_objects,
            ..Default::default()
        };
        let aggregated = AggregatedRenderRequest {
            rgb_requests: vec![request(2)],
            lidar_requests: vec![lidar.clone()],
        };
        assert_eq!((entries(&lidar), entries(&aggregated)), (5, 1 + 2 + 1 + 5));
        assert_eq!(
            entries(&PhysicsGroundIntersectionRequest {
                other_objects: vec![Default::default(); 6],
                ..Default::default()
            }),
            6
        );
        let trajectory = |poses: usize| Trajectory {
            poses: vec![PoseAtTime::default(); poses],
        };
        let answer = DriveResponse {
            trajectory: Some(trajectory(3)),
            debug_info: Some(DebugInfo {
                sampled_trajectories: vec![trajectory(4); 2],
                ..DebugInfo::default()
            }),
            ..DriveResponse::default()
        };
        assert_eq!(entries(&answer), 3 + 2 + 8);
    }

    #[test]
    fn no_bytes_hang_or_panic() {
        let bytes = BatchRgbRenderRequest {
            items: vec![BatchRgbRenderRequestItem {
                camera_name: "front".into(),
                request: Some(request(4)),
            }],
        }
        .encode_to_vec();
        for length in 0..bytes.len() {
            let mut cut = bytes[..length].to_vec();
            count(&cut, &[1, 2, 8], &mut 0);
            cut.push(0xff);
            count(&cut, &[1, 2, 8], &mut 0);
        }
        count(&[0xff; 32], &[1], &mut 0);
    }
}
