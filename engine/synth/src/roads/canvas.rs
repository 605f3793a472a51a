//! Flat splats, collected in linear albedo and lit when all are there.

use decouplegs_scene::{SplatCloud, sh};
use glam::{Mat3, Quat, Vec3};

use super::illumination::Illumination;

/// A disc that covers a piece of a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Disc {
    /// Relative to the origin, meters.
    pub(super) middle: Vec3,
    /// Axis along the surface; its length is the standard deviation, meters.
    pub(super) along: Vec3,
    /// Axis along the surface at right angles to `along`; its length is the standard deviation,
    /// meters.
    pub(super) across: Vec3,
    /// Linear RGB.
    pub(super) albedo: Vec3,
    pub(super) look: Look,
}

/// Shading of a disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Look {
    /// Shaded by what falls on it; the strength of what it mirrors, 0 to 1, counts where it faces
    /// up.
    Lit { gloss: f32 },
    /// Shown as it is: `albedo` is display-referred.
    Shown,
}

/// Discs up to a limit; those beyond are counted, not kept.
pub(super) struct Canvas {
    discs: Vec<Disc>,
    discs_max: usize,
}

/// Opacity of every disc: what is below hardly shows, and edges stay soft.
const OPACITY: f32 = 0.97;

/// Thickness over the smaller of the two extents.
const FLATNESS: f32 = 0.08;

impl Canvas {
    pub(super) fn new(discs_max: usize) -> Self {
        Self {
            discs: Vec::new(),
            discs_max,
        }
    }

    /// Discs kept.
    pub(super) fn len(&self) -> usize {
        self.discs.len()
    }

    pub(super) fn is_full(&self) -> bool {
        self.discs.len() >= self.discs_max
    }

    /// Adds a disc while there is room.
    pub(super) fn push(&mut self, disc: Disc) {
        if !self.is_full() {
            self.discs.push(disc);
        }
    }

    /// Makes room for `more` discs beyond those it has.
    pub(super) fn grow(&mut self, more: usize) {
        self.discs_max = self.discs.len() + more;
    }

    #[cfg(test)]
    pub(super) fn discs(&self) -> &[Disc] {
        &self.discs
    }

    /// The splats of all discs in `light`.
    pub(super) fn into_cloud(self, sh_degree: u8, light: &Illumination) -> SplatCloud {
        let stride = sh::coefficient_count(sh_degree) - 1;
        let mut cloud = SplatCloud {
            sh_degree,
            ..SplatCloud::default()
        };
        for disc in &self.discs {
            let (along_m, across_m) = (
                disc.along.length().max(1e-3),
                disc.across.length().max(1e-3),
            );
            let normal = disc.along.cross(disc.across).normalize_or(Vec3::Z);
            let along = disc.along.normalize_or(Vec3::X);
            let axes = Mat3::from_cols(along, normal.cross(along), normal);
            let rotation = Quat::from_mat3(&axes).normalize();
            cloud.means.push(disc.middle.to_array());
            cloud.scales.push([
                along_m,
                across_m,
                (along_m.min(across_m) * FLATNESS).max(1e-3),
            ]);
            cloud
                .rotations
                .push([rotation.w, rotation.x, rotation.y, rotation.z]);
            cloud.opacities.push(OPACITY);
            let color = match disc.look {
                Look::Lit { .. } => light.shown(disc.albedo, normal),
                Look::Shown => disc.albedo,
            };
            cloud.sh_dc.push(((color - 0.5) / sh::Y0 as f32).to_array());
            let mirrors = match disc.look {
                Look::Lit { gloss } if normal.z > 0.9 => gloss,
                _ => 0.0,
            };
            cloud
                .sh_rest
                .extend((0..stride).map(|index| (mirrors * light.mirrored(index + 1)).to_array()));
        }
        cloud
    }
}
