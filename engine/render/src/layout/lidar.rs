//! Records of LiDARs.

use bytemuck::{Pod, Zeroable};
use decouplegs_scene::lidar::{ECHO_WEIGHT_MIN, Echo, ReturnMode};

/// `Sector` of `lidar.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SectorRecord {
    /// Mean velocity of the sensor, sector axes.
    pub velocity_mps: [f32; 3],
    /// Longest time between a firing and the middle of the sector.
    pub half_time_s: f32,
    /// Longest distance of the sensor from where its mean velocity has it.
    pub residual_m: f32,
    /// First of its columns among those of all sectors.
    pub first_column: u32,
    /// First of its rows.
    pub first_row: u32,
}

/// `LidarBeam` of `trace_lidar.comp`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct BeamRecord {
    /// Unit direction in sector axes; zero for a cell without a beam.
    pub direction: [f32; 3],
    /// Index of the time of firing.
    pub firing: u32,
    /// Index among the beams of the sensor.
    pub index: u32,
}

/// `Firing` of `trace_lidar.comp`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct FiringRecord {
    /// Position of the sensor relative to that in the middle of the sector, sector axes.
    pub offset_m: [f32; 3],
    /// Time relative to the middle of the sector.
    pub time_s: f32,
}

/// `BeamState` of `trace_lidar.comp`: what one beam found.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct BeamState {
    /// Share of the beam that no splat took.
    pub transmittance: f32,
    /// Sum of weight times range.
    pub range_sum_m: f32,
    /// Sum of weight times intensity.
    pub intensity_sum: f32,
    /// Range at which transmittance fell to 1/2 or below; 0 where it did not.
    pub median_m: f32,
    /// Largest weight of a splat.
    pub strongest_weight: f32,
    /// Range of that splat.
    pub strongest_m: f32,
    /// Instance of the median in the low half, of the strongest splat in the high half.
    pub instances: u32,
}

/// `Echo` of `trace_lidar.comp`: splats of a beam that follow one another.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct EchoRecord {
    /// Sum of weights; 0 for none.
    pub weight: f32,
    /// Sum of weight times range.
    pub range_sum_m: f32,
    /// Sum of weight times intensity.
    pub intensity_sum: f32,
    /// Instance of the splat with the largest weight.
    pub instance: u32,
}

impl EchoRecord {
    /// The echo; `None` where it does not count.
    fn echo(&self) -> Option<Echo> {
        (f64::from(self.weight) >= ECHO_WEIGHT_MIN).then(|| Echo {
            weight: self.weight,
            range_m: self.range_sum_m / self.weight,
            intensity: self.intensity_sum / self.weight,
            instance: self.instance as u16,
        })
    }
}

/// `BeamEchoes` of `trace_lidar.comp`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct BeamEchoes {
    /// The echo at the end of the walk.
    pub open: EchoRecord,
    /// Largest weight of a splat of it.
    pub open_strongest: f32,
    /// The strongest of the echoes before.
    pub strongest: EchoRecord,
    /// The last of the echoes before that counts.
    pub last: EchoRecord,
}

impl BeamEchoes {
    /// The strongest echo and the last, which is `None` if it is the same.
    #[must_use]
    pub fn found(&self) -> [Option<Echo>; 2] {
        match (self.open.echo(), self.strongest.echo(), self.last.echo()) {
            (None, None, _) => [None, None],
            (Some(open), None, _) => [Some(open), None],
            (None, Some(strongest), last) => {
                [Some(strongest), last.filter(|last| *last != strongest)]
            }
            (Some(open), Some(strongest), _) if open.weight > strongest.weight => {
                [Some(open), None]
            }
            (Some(open), Some(strongest), _) => [Some(strongest), Some(open)],
        }
    }
}

impl BeamState {
    /// Range by `mode` and the instance of the splat that gives it; for the mean range, of the
    /// splat with the largest weight. `None` where nothing was met, or no median; dual returns are
    /// in [`BeamEchoes`].
    #[must_use]
    pub fn range(&self, mode: ReturnMode) -> Option<(f32, u16)> {
        let strongest = (self.instances >> 16) as u16;
        let total = 1.0 - self.transmittance;
        match mode {
            ReturnMode::Median if self.median_m > 0.0 => {
                Some((self.median_m, self.instances as u16))
            }
            ReturnMode::Median | ReturnMode::Dual => None,
            _ if self.strongest_weight <= 0.0 => None,
            ReturnMode::Expected => Some((self.range_sum_m / total, strongest)),
            ReturnMode::Strongest => Some((self.strongest_m, strongest)),
        }
    }

    /// Mean intensity of the splats by weight; 0 where nothing was met.
    #[must_use]
    pub fn intensity(&self) -> f32 {
        match 1.0 - self.transmittance {
            total if total > 0.0 => self.intensity_sum / total,
            _ => 0.0,
        }
    }
}
