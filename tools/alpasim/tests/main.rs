//! Drivers of AlpaSim's egodriver contract in the closed loop.

mod driving;
mod fake_driver;
