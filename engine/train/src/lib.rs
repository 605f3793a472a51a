//! Training: [`compress`] turns splats into a compressed asset (vector quantization, levels of
//! detail).
#![forbid(unsafe_code)]

pub mod compress;
