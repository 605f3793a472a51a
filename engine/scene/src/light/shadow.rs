//! Shadows on the ground that an agent stands on: soft super-ellipses, about its footprint or where
//! its box keeps a light away.

use crate::{Invalid, Pose, SplatCloud, SplatScene, sh};
use glam::{DVec2, DVec3};

/// Exponent of the super-ellipse: a rounded rectangle.
pub const EXPONENT: i32 = 4;

/// Largest [`GroundShadow::sharpness`].
pub const SHARPNESS_MAX: u32 = 8;

/// The mask counts as zero below this: half of what an eight-bit image shows at full strength.
pub const MASK_MIN: f64 = 1.0 / 512.0;

/// A shadow of one agent: ground at u, in its plane, is darkened by `1 - strength M(u)`,
/// `M(u) = exp(-decay r^(2^sharpness))`, `r = (|u_x / (L / 2)|^4 + |u_y / (W / 2)|^4)^(1/4)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundShadow {
    /// The ground: origin in the middle of the shadow, x along it, z out of the ground. f64 world
    /// coordinates.
    pub world_from_ground: Pose,
    /// Half of its length and width, meters.
    pub half_size_m: [f64; 2],
    /// lambda I_dom: share of the light that is gone in the middle, 0 to 1.
    pub strength: f64,
    /// tau_decay: how fast it fades outward.
    pub decay: f64,
    /// Number of times that the radius is squared before it decays, at most 8: 0
    /// fades from the middle on, 3 is even within and has a soft edge.
    pub sharpness: u32,
    /// Splats whose mean is farther from the plane are not ground, meters.
    pub slab_m: f64,
}

impl GroundShadow {
    /// Checks the shadow and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let pose = &self.world_from_ground;
        if !(pose.translation.is_finite()
            && pose.rotation.is_finite()
            && pose.rotation.length_squared() > 1e-12)
        {
            return Err(Invalid::new(format!("its pose {pose:?} is not finite")));
        }
        let [length_m, width_m] = self.half_size_m;
        let positive = [
            ("half length", length_m),
            ("half width", width_m),
            ("decay", self.decay),
            ("slab", self.slab_m),
        ];
        match positive
            .iter()
            .find(|(_, value)| !(value.is_finite() && *value > 0.0))
        {
            Some((what, value)) => Err(Invalid::new(format!(
                "a {what} of {value}; expected a number above zero"
            ))),
            None if !(0.0..=1.0).contains(&self.strength) => Err(Invalid::new(format!(
                "a strength of {}; expected 0 to 1",
                self.strength
            ))),
            None if self.sharpness > SHARPNESS_MAX => Err(Invalid::new(format!(
                "a sharpness of {}; expected 0 to {SHARPNESS_MAX}",
                self.sharpness
            ))),
            None => Ok(()),
        }
    }

    /// Extent of the mask, in half sizes.
    #[must_use]
    pub fn cutoff(&self) -> f64 {
        (-MASK_MIN.ln() / self.decay).powf(0.5f64.powi(self.sharpness as i32))
    }

    /// M at `u`, meters along and across the agent.
    #[must_use]
    pub fn mask(&self, u: DVec2) -> f64 {
        let radius = (u / DVec2::from_array(self.half_size_m))
            .abs()
            .powf(f64::from(EXPONENT))
            .element_sum()
            .powf(1.0 / f64::from(EXPONENT));
        let radius = (0..self.sharpness).fold(radius, |radius, _| radius * radius);
        let mask = (-self.decay * radius).exp();
        if mask >= MASK_MIN { mask } else { 0.0 }
    }

    /// Factor on the color of a splat with its mean at `position`, world coordinates: 1 away from
    /// the shadow.
    #[must_use]
    pub fn factor(&self, position: DVec3) -> f64 {
        let local = self.world_from_ground.inverse().transform(position);
        if local.z.abs() > self.slab_m {
            return 1.0;
        }
        (1.0 - self.strength * self.mask(local.truncate())).clamp(0.0, 1.0)
    }
}

/// `splat_scene` as it looks under `shadows`, whose factors multiply: before agents are added to
/// it, which shadows do not lie on.
///
/// `max(0, 0.5 + SH) f = max(0, f (0.5 + SH))`, so a darkened splat is a splat again.
pub fn bake_shadows(splat_scene: &mut SplatScene, shadows: &[GroundShadow]) {
    if shadows.is_empty() {
        return;
    }
    let origin = splat_scene.origin;
    let SplatCloud {
        means,
        sh_degree,
        sh_dc,
        sh_rest,
        ..
    } = &mut splat_scene.splats;
    let stride = sh::coefficient_count(*sh_degree) - 1;
    let shift = sh::DC_SHIFT;
    for (splat, mean) in means.iter().enumerate() {
        let position = origin + DVec3::from_array(mean.map(f64::from));
        let factor: f64 = shadows
            .iter()
            .map(|shadow| shadow.factor(position))
            .product();
        if factor == 1.0 {
            continue;
        }
        sh_dc[splat] = sh_dc[splat].map(|dc| (factor * (f64::from(dc) + shift) - shift) as f32);
        for coefficient in &mut sh_rest[splat * stride..(splat + 1) * stride] {
            *coefficient = coefficient.map(|value| (factor * f64::from(value)) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shadow() -> GroundShadow {
        GroundShadow {
            world_from_ground: Pose::from_yaw(
                std::f64::consts::FRAC_PI_2,
                DVec3::new(4.5e6, 10.0, 0.0),
            ),
            half_size_m: [2.0, 1.0],
            strength: 0.8,
            decay: 2.0,
            sharpness: 0,
            slab_m: 0.1,
        }
    }

    #[test]
    fn it_is_darkest_in_the_middle_fades_outward_and_turns_with_the_agent() {
        let shadow = shadow();
        let at = |x: f64, y: f64, z: f64| shadow.factor(DVec3::new(4.5e6 + x, 10.0 + y, z));
        assert!((at(0.0, 0.0, 0.0) - 0.2).abs() < 1e-12);
        // The agent looks along y: its end is at y = 2, its side at x = 1, and both are as dark.
        assert!(
            (at(0.0, 2.0, 0.0) - at(1.0, 0.0, 0.0)).abs() < 1e-9
                && at(1.0, 0.0, 0.0) < at(2.0, 0.0, 0.0)
        );
        assert_eq!((at(0.0, 0.0, 0.11), at(40.0, 0.0, 0.0)), (1.0, 1.0));
    }

    #[test]
    fn a_sharp_shadow_is_even_within_and_ends_at_its_cutoff() {
        let sharp = GroundShadow {
            decay: 0.5,
            sharpness: 3,
            ..shadow()
        };
        // Along the agent, which looks along y; a half length is 2 m.
        let mask = |half_lengths: f64| sharp.mask(DVec2::new(2.0 * half_lengths, 0.0));
        assert!(
            mask(0.6) > 0.99 && (mask(1.0) - (-0.5f64).exp()).abs() < 1e-12 && mask(1.3) < 0.02
        );
        let cutoff = sharp.cutoff();
        assert!(mask(0.999 * cutoff) > 0.0 && mask(1.001 * cutoff) == 0.0 && cutoff < 1.5);
    }

    #[test]
    fn shadows_multiply() {
        let splat = SplatCloud {
            means: vec![[0.0, 10.0, 0.05], [30.0, 10.0, 0.05]],
            scales: vec![[0.1; 3]; 2],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            opacities: vec![1.0; 2],
            sh_degree: 1,
            sh_dc: vec![[0.3; 3]; 2],
            sh_rest: vec![[0.2; 3]; 6],
        };
        let mut splat_scene = SplatScene {
            origin: DVec3::new(4.5e6, 0.0, 0.0),
            ..SplatScene::from_splats(splat)
        };
        let before = splat_scene.clone();
        bake_shadows(&mut splat_scene, &[shadow(), shadow()]);
        let shown = |splat_scene: &SplatScene, splat: usize| {
            0.5 + sh::Y0 * f64::from(splat_scene.splats.sh_dc[splat][0])
        };
        assert!((shown(&splat_scene, 0) - 0.04 * shown(&before, 0)).abs() < 1e-6);
        assert!((splat_scene.splats.sh_rest[0][0] - 0.04 * 0.2).abs() < 1e-6);
        assert_eq!(splat_scene.splats.sh_dc[1], before.splats.sh_dc[1]);
    }

    #[test]
    fn what_is_no_shadow_is_named() {
        shadow().check().unwrap();
        let broken = |change: fn(&mut GroundShadow)| {
            let mut shadow = shadow();
            change(&mut shadow);
            shadow.check().unwrap_err()
        };
        assert!(
            broken(|s| s.half_size_m[1] = 0.0)
                .reason()
                .contains("half width")
        );
        assert!(broken(|s| s.strength = 1.5).reason().contains("1.5"));
        assert!(broken(|s| s.sharpness = 9).reason().contains("9"));
        assert!(broken(|s| s.decay = f64::NAN).reason().contains("decay"));
        assert!(
            broken(|s| s.world_from_ground.translation.x = f64::INFINITY)
                .reason()
                .contains("pose")
        );
    }
}
