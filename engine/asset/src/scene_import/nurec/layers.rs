//! Layers of a volume as clouds of splats.

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use super::state::{Array, LAYERS, State};
use crate::DecodeError;
use crate::activation::{normalized, scale_of_log, sigmoid};
use crate::memory::{self, cloud_bytes};

/// Coefficients above degree 0 of each splat.
const SPECULAR: usize = 15;

/// A layer, read.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub(super) name: String,
    /// Splats in the frame of the volume, or of their boxes.
    pub(super) cloud: SplatCloud,
    /// Index of the track of each splat; empty in a layer that stands still.
    pub(super) tracks: Vec<u32>,
    /// Coefficients of the color over time; 1 where it is constant.
    pub(super) color_times: usize,
}

/// Reads the layer called `name`.
///
/// # Errors
/// A sentence that names the array at fault, or a setting that is not drawn here.
pub(super) fn layer(state: &State<'_>, name: &str) -> Result<Layer, DecodeError> {
    check_settings(state, name)?;
    let means: Vec<[f32; 3]> = rows(state, name, "positions")?;
    let count = means.len();
    let same = |found: usize, array: &str| match found == count {
        true => Ok(()),
        false => Err(DecodeError::Malformed(format!(
            "'{LAYERS}{name}.{array}' has {found} rows for {count} positions"
        ))),
    };
    let sh_degree = degree(state, name, count)?;
    memory::require(
        &format!("layer {name} of {count} splats"),
        cloud_bytes(count as u64, sh_degree),
    )
    .map_err(|error| DecodeError::Malformed(error.into()))?;
    let log_scales: Vec<[f32; 3]> = rows(state, name, "scales")?;
    let rotations: Vec<[f32; 4]> = rows(state, name, "rotations")?;
    let logits: Vec<[f32; 1]> = rows(state, name, "densities")?;
    same(log_scales.len(), "scales")?;
    same(rotations.len(), "rotations")?;
    same(logits.len(), "densities")?;

    let albedo = state.of_layer(name, "features_albedo")?;
    let color_times = match *albedo.shape() {
        [_, 3] => 1,
        [_, times, 3] if times > 0 => times,
        _ => {
            return Err(shape_error(
                name,
                "features_albedo",
                albedo,
                "[N, 3] or [N, F, 3]",
            ));
        }
    };
    same(albedo.shape()[0], "features_albedo")?;
    let tracks = tracks(state, name)?;
    if !tracks.is_empty() {
        same(tracks.len(), "gaussian_cuboid_ids")?;
    }
    let specular = state.of_layer(name, "features_specular")?;
    let stride = sh::coefficient_count(sh_degree) - 1;
    let mut sh_rest = vec![[0.0; 3]; count * stride];
    let of_splats = sh_rest.par_chunks_mut(stride.max(1)).enumerate();
    of_splats.for_each(|(splat, coefficients)| {
        specular.copy_to(splat * 3 * SPECULAR, coefficients.as_flattened_mut());
    });
    Ok(Layer {
        name: name.to_owned(),
        cloud: SplatCloud {
            means,
            scales: log_scales
                .into_par_iter()
                .map(|logarithms| logarithms.map(scale_of_log))
                .collect(),
            rotations: rotations.into_par_iter().map(normalized).collect(),
            opacities: logits
                .into_par_iter()
                .map(|[logit]| sigmoid(logit))
                .collect(),
            sh_degree,
            sh_dc: albedo.columns(count, 3 * color_times, 0),
            sh_rest,
        },
        tracks,
        color_times,
    })
}

fn rows<const N: usize>(
    state: &State<'_>,
    layer: &str,
    array: &str,
) -> Result<Vec<[f32; N]>, DecodeError> {
    let name = format!("{LAYERS}{layer}.{array}");
    state.of_layer(layer, array)?.rows(&name)
}

fn shape_error(layer: &str, array: &str, found: &Array<'_>, expected: &str) -> DecodeError {
    DecodeError::Malformed(format!(
        "'{LAYERS}{layer}.{array}' has the shape {:?}, expected {expected}",
        found.shape()
    ))
}

/// Degree of the colors of a layer: as far as its coefficients are in use and not all zero.
fn degree(state: &State<'_>, name: &str, count: usize) -> Result<u8, DecodeError> {
    let specular = state.of_layer(name, "features_specular")?;
    let expected = "[N, 45]";
    let is_whole = specular.len() == count * 3 * SPECULAR;
    if !is_whole || specular.shape().first() != Some(&count) {
        return Err(shape_error(name, "features_specular", specular, expected));
    }
    let active = state.of_layer(name, "n_active_features").ok();
    let active = active.filter(|active| active.len() > 0);
    let active = active.map_or(sh::DEGREE_MAX, |active| {
        active.at(0).clamp(0.0, sh::DEGREE_MAX.into()) as u8
    });
    let is_used = |degree: &u8| {
        let first = 3 * (sh::coefficient_count(degree - 1) - 1);
        let end = 3 * (sh::coefficient_count(*degree) - 1);
        (0..count)
            .into_par_iter()
            .any(|splat| (first..end).any(|at| specular.at(splat * 3 * SPECULAR + at) != 0.0))
    };
    Ok((1..=active).rev().find(is_used).unwrap_or(0))
}

/// Index of the track of each splat of a layer; empty where it stands still.
fn tracks(state: &State<'_>, name: &str) -> Result<Vec<u32>, DecodeError> {
    let Ok(ids) = state.of_layer(name, "gaussian_cuboid_ids") else {
        return Ok(Vec::new());
    };
    let known = state.tracks_of(name).len();
    let track = |at: usize| {
        let id = ids.at(at);
        let is_known = id >= 0.0 && (id as usize) < known;
        is_known.then_some(id as u32).ok_or_else(|| {
            DecodeError::Malformed(format!(
                "splat {at} of layer {name} belongs to track {id}, and obj_track_ids names {known}"
            ))
        })
    };
    (0..ids.len()).map(track).collect()
}

/// Refuses layers whose numbers mean something else than they do here.
fn check_settings(state: &State<'_>, name: &str) -> Result<(), DecodeError> {
    let settings = state.settings_of(name);
    for (what, found, expected) in [
        (
            "density_activation",
            &settings.density_activation,
            "sigmoid",
        ),
        ("scale_activation", &settings.scale_activation, "exp"),
        (
            "rotation_activation",
            &settings.rotation_activation,
            "normalize",
        ),
    ] {
        if let Some(found) = found.as_ref().filter(|found| *found != expected) {
            return Err(DecodeError::Unsupported(format!(
                "layer {name} has {what} {found:?}; {expected:?} is read"
            )));
        }
    }
    match settings.kernel_degree {
        Some(degree) if degree != 2.0 => Err(DecodeError::Unsupported(format!(
            "layer {name} has kernels of degree {degree}; Gaussians, of degree 2, are drawn"
        ))),
        _ => Ok(()),
    }
}

impl Layer {
    /// The splats of each track, with the track's index; in the order of the tracks.
    pub(super) fn parts(&self) -> Vec<(usize, SplatCloud)> {
        let mut of_track: Vec<Vec<u32>> = Vec::new();
        for (splat, &track) in self.tracks.iter().enumerate() {
            let track = track as usize;
            if of_track.len() <= track {
                of_track.resize(track + 1, Vec::new());
            }
            of_track[track].push(splat as u32);
        }
        let parts = of_track.into_iter().enumerate();
        let parts = parts.filter(|(_, splats)| !splats.is_empty());
        parts
            .map(|(track, splats)| (track, self.cloud.select(&splats)))
            .collect()
    }
}
