//! The light of a scene, checked.

use std::ops::Range;

use decouplegs_scene::Invalid;
use decouplegs_scene::light::{
    AmbientOptions, CastingLights, Lamps, RelightOptions, ShadowOptions, Sun,
};
use glam::DVec3;
use toml::Spanned;

use super::SceneLight;
use super::check::field_of;
use super::form::{LampsForm, LightForm, ShadowForm, SunForm};
use crate::SceneError;
use crate::toml_text::Checker;

impl Checker<'_> {
    pub(super) fn light(&self, form: &Spanned<LightForm>) -> Result<SceneLight, SceneError> {
        let (span, form) = (form.span(), form.get_ref());
        let default = AmbientOptions::default();
        let ambient = AmbientOptions {
            sigma_m: form.sigma_m.unwrap_or(default.sigma_m),
            radius_m: form
                .radius_m
                .unwrap_or(3.0 * form.sigma_m.unwrap_or(default.sigma_m)),
            spacing_m: form.spacing_m.unwrap_or(default.spacing_m),
        };
        ambient.check().map_err(|reason| {
            self.error(&span, "light", field_of(reason.reason()), reason.reason())
        })?;
        let relighting = RelightOptions {
            full_effect: form.full_effect.unwrap_or(false),
            ground_albedo: form.ground_albedo,
            by_normals: form.by_normals.unwrap_or(false),
        };
        if relighting.by_normals && form.transfer.is_some() {
            let reason = "it replaces the transfer, which the table names too: remove one of them";
            return Err(self.error(&span, "light", "by_normals", reason));
        }
        relighting.check().map_err(|reason| {
            self.error(&span, "light", field_of(reason.reason()), reason.reason())
        })?;
        let shadows = form
            .shadows
            .as_ref()
            .map(|form| self.shadows(form))
            .transpose()?;
        let casting = self.casting(form)?;
        Ok(SceneLight {
            transfer: form.transfer.as_ref().map(Into::into),
            relighting,
            ambient,
            shadows,
            casting,
        })
    }

    fn casting(&self, form: &LightForm) -> Result<CastingLights, SceneError> {
        let check = |table: &str, span: &Range<usize>, checked: Result<(), Invalid>| {
            checked.map_err(|reason| {
                self.error(span, table, field_of(reason.reason()), reason.reason())
            })?;
            match form.shadows {
                Some(_) => Ok(()),
                None => {
                    let reason = "it casts shadows, which a scene has only with a [light.shadows] table: add one, or remove this table";
                    Err(self.error(span, "", table, reason))
                }
            }
        };
        let mut casting = CastingLights::default();
        if let Some(table) = &form.sun {
            let SunForm { towards, share } = *table.get_ref();
            let towards = DVec3::from_array(towards);
            let sun = Sun { towards, share };
            check("light.sun", &table.span(), sun.check())?;
            casting.sun = Some(sun);
        }
        if let Some(table) = &form.lamps {
            let LampsForm { places, range_m } = table.get_ref();
            let lamps = Lamps {
                positions: places.iter().copied().map(DVec3::from_array).collect(),
                range_m: range_m.unwrap_or(Lamps::default().range_m),
            };
            check("light.lamps", &table.span(), lamps.check())?;
            casting.lamps = lamps;
        }
        Ok(casting)
    }

    fn shadows(&self, form: &Spanned<ShadowForm>) -> Result<ShadowOptions, SceneError> {
        let (span, form, default) = (form.span(), form.get_ref(), ShadowOptions::default());
        let shadows = ShadowOptions {
            strength: form.strength.unwrap_or(default.strength),
            decay: form.decay.unwrap_or(default.decay),
            slab_m: form.slab_m.unwrap_or(default.slab_m),
            full_directionality: form
                .full_directionality
                .unwrap_or(default.full_directionality),
            floor: form.floor.unwrap_or(default.floor),
        };
        shadows.check().map_err(|reason| {
            self.error(
                &span,
                "light.shadows",
                field_of(reason.reason()),
                reason.reason(),
            )
        })?;
        Ok(shadows)
    }
}
