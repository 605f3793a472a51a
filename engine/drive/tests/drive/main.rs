//! Ground and registration against truths that are known.

mod ground;
mod grounding;
mod lanes;
mod properties;
mod register;
mod roads;
