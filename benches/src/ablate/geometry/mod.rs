//! Relighting against a truth that shares nothing with the fit: bodies of known shape, whose light
//! is integrated over the part of each environment that they leave open, in f64.
//!
//! A calibration takes a splat to face an open sphere of light. Here a surface sample is lit by the
//! part of the environment that its body does not hide and by the ground below, which its body
//! darkens. The asset is what white light from everywhere shows of the same body, its dark corners
//! included. The descriptor comes from splats of the ground around. Gloss is left out.

mod body;
mod experiment;
mod mesh;
mod rays;
mod skylight;
mod tests;
