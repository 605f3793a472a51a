//! The light of a scene, checked.

use decouplegs_scene::light::{
    AmbientOptions, CastingLights, Lamps, RelightOptions, ShadowOptions, Sun,
};
use toml::Spanned;

use super::SceneLight;
use super::check::field_of;
use super::form::{LightForm, ShadowForm};
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
        };
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
        let sun = form.sun.as_ref().map(|form| {
            let (towards, share) = (form.get_ref().towards.into(), form.get_ref().share);
            Sun { towards, share }
        });
        let lamps = form.lamps.as_ref().map(Spanned::get_ref).map(|form| Lamps {
            places: form.places.iter().copied().map(Into::into).collect(),
            range_m: form.range_m.unwrap_or(Lamps::default().range_m),
        });
        let tables = [
            ("light.sun", form.sun.as_ref().map(Spanned::span)),
            ("light.lamps", form.lamps.as_ref().map(Spanned::span)),
        ];
        let parts = [
            CastingLights {
                sun,
                ..CastingLights::default()
            },
            CastingLights {
                sun: None,
                lamps: lamps.unwrap_or_default(),
            },
        ];
        for ((table, span), part) in tables.into_iter().zip(&parts) {
            let Some(span) = span else { continue };
            part.check().map_err(|reason| {
                self.error(&span, table, field_of(reason.reason()), reason.reason())
            })?;
            if form.shadows.is_none() {
                let reason = "it casts shadows, which a scene has only with a [light.shadows] table: add one, or remove this table";
                return Err(self.error(&span, "", table, reason));
            }
        }
        let [_, CastingLights { lamps, .. }] = parts;
        Ok(CastingLights { sun, lamps })
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
