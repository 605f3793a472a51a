//! Text form of a traffic sign, the same in scenario files and lane files.

use decouplegs_scene::{SignKind, StopLine, TrafficSign};
use serde::{Deserialize, Serialize};

use crate::traffic_light_form::{Fault, check_line};

/// Most signs of a file.
pub const SIGNS_MAX: usize = 10_000;

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SignForm {
    kind: String,
    lane: String,
    at_m: f64,
}

impl SignForm {
    pub fn from_sign(sign: &TrafficSign) -> Self {
        Self {
            kind: sign.kind.name().to_owned(),
            lane: sign.line.lane.clone(),
            at_m: sign.line.at_m,
        }
    }

    /// The sign. Its line is not checked.
    ///
    /// # Errors
    /// Returns an error if the kind is unknown.
    pub fn sign(&self) -> Result<TrafficSign, Fault> {
        let kind = SignKind::by_name(&self.kind).ok_or_else(|| Fault {
            field: "kind",
            reason: format!("'{}' is unknown; there are stop, yield", self.kind),
        })?;
        let line = StopLine {
            lane: self.lane.clone(),
            at_m: self.at_m,
            ..StopLine::default()
        };
        Ok(TrafficSign { kind, line })
    }
}

/// First fault of a sign, if any.
pub fn check(sign: &TrafficSign) -> Result<(), Fault> {
    check_line(&sign.line).map_err(|reason| Fault {
        field: "at_m",
        reason,
    })
}
