//! Training: [`compress`] turns splats into a compressed asset (vector quantization, levels of
//! detail), [`calibrate`] fits the effect of light on the colors of agents.
#![forbid(unsafe_code)]

pub mod calibrate;
pub mod compress;
