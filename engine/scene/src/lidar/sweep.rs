//! Sweeps: returns of beams, and the points that they are in a frame of the caller's choice.

use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use super::{Beam, Lidar};
use crate::Pose;

/// Return of one beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarReturn {
    /// Place of the beam among [`super::LidarModel::beams`].
    pub beam: u32,
    /// Range along the beam, meters.
    pub range_m: f32,
    /// Intensity from 0 to 1. Luma (Rec. 709) of the splats' colors: no physical quantity.
    pub intensity: f32,
    /// Instance of the splat that gives the range; 0 for the background.
    pub instance: u16,
    /// Number among the returns of the beam, from 1: the strongest, then the last.
    pub number: u8,
    /// Returns of the beam.
    pub count: u8,
}

/// Returns of one sweep, in the order of beams.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarSweep {
    /// Sensor, and its poses during the sweep.
    pub lidar: Lidar,
    /// Beams of the sweep.
    pub beams: Arc<[Beam]>,
    /// Returns; at most one per beam, two by [`super::ReturnMode::Dual`].
    pub returns: Vec<LidarReturn>,
}

/// Frame in which points are given. Only the motion of the own vehicle is compensated: other agents
/// are where each beam met them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointFrame {
    /// Sensor frame at the time of firing: not compensated.
    Raw,
    /// Sensor frame at the start of the sweep.
    Start,
    /// Sensor frame at the end of the sweep.
    End,
    /// Vehicle frame at a time after the start of the sweep, seconds.
    EgoAt(f64),
    /// World coordinates.
    World,
}

impl PointFrame {
    /// Names that [`PointFrame::by_name`] accepts.
    pub const NAMES: [&'static str; 5] = ["raw", "start", "end", "ego", "world"];

    /// The frame called `name`; `ego` is the vehicle at the end of a sweep of `sweep_s`.
    #[must_use]
    pub fn by_name(name: &str, sweep_s: f64) -> Option<Self> {
        match name {
            "raw" => Some(Self::Raw),
            "start" => Some(Self::Start),
            "end" => Some(Self::End),
            "ego" => Some(Self::EgoAt(sweep_s)),
            "world" => Some(Self::World),
            _ => None,
        }
    }
}

/// Bytes of a return in [`LidarSweep::bytes`].
const RETURN_BYTES: usize = 16;
/// Fewest returns that a thread is given.
const RETURNS_AT_ONCE: usize = 4096;

/// Point of a sweep with all that is known of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarPoint {
    /// Position in the chosen frame, meters.
    pub position_m: DVec3,
    /// Beam of the return.
    pub beam: Beam,
    /// The return.
    pub measured: LidarReturn,
}

impl LidarSweep {
    /// The returns as bytes, little-endian: number of the beam (u32), range in meters and intensity
    /// (f32), instance (u16), number and count of returns of the beam (u8).
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        let mut all = vec![0; RETURN_BYTES * self.returns.len()];
        let records = all.par_chunks_exact_mut(RETURN_BYTES);
        let of_return = |(bytes, found): (&mut [u8], &LidarReturn)| {
            let LidarReturn {
                beam,
                range_m,
                intensity,
                instance,
                number,
                count,
            } = *found;
            bytes[..4].copy_from_slice(&beam.to_le_bytes());
            bytes[4..8].copy_from_slice(&range_m.to_le_bytes());
            bytes[8..12].copy_from_slice(&intensity.to_le_bytes());
            bytes[12..14].copy_from_slice(&instance.to_le_bytes());
            bytes[14..].copy_from_slice(&[number, count]);
        };
        let some = records.zip(&self.returns).with_min_len(RETURNS_AT_ONCE);
        some.for_each(of_return);
        all
    }

    /// Points of the returns in `frame`.
    #[must_use]
    pub fn points(&self, frame: PointFrame) -> Vec<LidarPoint> {
        let end_s = self.lidar.model.sweep_s;
        let frame_from_world = match frame {
            PointFrame::Raw | PointFrame::World => Pose::IDENTITY,
            PointFrame::Start => self.lidar.pose_at(0.0).inverse(),
            PointFrame::End => self.lidar.pose_at(end_s).inverse(),
            PointFrame::EgoAt(time_s) => self.lidar.rig_at(time_s).inverse(),
        };
        // Beams that fire together follow each other: one pose serves them all.
        let point = |fired: &mut Option<(f64, Pose)>, measured: &LidarReturn| {
            let beam = self.beams[measured.beam as usize];
            let frame_from_sensor = match *fired {
                Some((time_s, pose)) if time_s == beam.time_s => pose,
                _ => {
                    let pose = match frame {
                        PointFrame::Raw => Pose::IDENTITY,
                        _ => frame_from_world.then(&self.lidar.pose_at(beam.time_s)),
                    };
                    *fired = Some((beam.time_s, pose));
                    pose
                }
            };
            LidarPoint {
                position_m: frame_from_sensor
                    .transform(f64::from(measured.range_m) * beam.direction),
                beam,
                measured: *measured,
            }
        };
        self.returns.par_iter().map_init(|| None, point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Motion;
    use crate::lidar::{LidarModel, LidarPattern, ReturnMode};

    #[test]
    fn returns_become_bytes_in_their_order() {
        let returns: Vec<LidarReturn> = (0..9001)
            .map(|beam| LidarReturn {
                beam,
                range_m: 0.5 + beam as f32,
                intensity: 0.25,
                instance: (beam % 7) as u16,
                number: 1,
                count: 2,
            })
            .collect();
        let sweep = LidarSweep {
            lidar: Lidar {
                name: "top".into(),
                model: Arc::new(LidarModel {
                    name: "any".into(),
                    pattern: LidarPattern::Rays(Vec::new()),
                    sweep_s: 0.1,
                    range_m: [0.3, 1e5],
                    returns: ReturnMode::Dual,
                    range_noise_m: 0.0,
                }),
                world_from_rig: Pose::IDENTITY,
                rig_from_lidar: Pose::IDENTITY,
                motion: Motion::REST,
            },
            beams: Arc::new([]),
            returns,
        };
        let bytes = sweep.bytes();
        assert_eq!(bytes.len(), 16 * 9001);
        for (found, expected) in bytes.chunks_exact(16).zip(&sweep.returns) {
            let word = |at: usize| [found[at], found[at + 1], found[at + 2], found[at + 3]];
            assert_eq!(u32::from_le_bytes(word(0)), expected.beam);
            assert_eq!(f32::from_le_bytes(word(4)), expected.range_m);
            assert_eq!(f32::from_le_bytes(word(8)), expected.intensity);
            assert_eq!(
                u16::from_le_bytes([found[12], found[13]]),
                expected.instance
            );
            assert_eq!(found[14..], [1, 2]);
        }
    }
}
