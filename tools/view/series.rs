//! Quantities of an episode over time, for the plots of the page.

use decouplegs::drive::score::Quantity;
use serde_json::{Value, json};

/// Quantities that the page always plots.
const PLOTTED: [&str; 2] = ["speed_mps", "time_to_collision_s"];

/// All others of `quantities` as JSON: name, unit, and a value for each instant, null where there
/// is none. Speeds are in km/h, angles in degrees.
pub fn facts(quantities: &[Quantity]) -> Value {
    let others = quantities.iter();
    let others = others.filter(|quantity| !PLOTTED.contains(&quantity.key));
    others.map(fact).collect()
}

fn fact(quantity: &Quantity) -> Value {
    let (unit, factor) = match quantity.unit {
        "m/s" => ("km/h", 3.6),
        "rad" => ("°", 1f64.to_degrees()),
        "rad/s" => ("°/s", 1f64.to_degrees()),
        unit => (unit, 1.0),
    };
    let values = quantity.values.iter();
    let values: Vec<Option<f64>> = values
        .map(|value| value.map(|value| factor * value))
        .collect();
    json!({"name": quantity.name, "unit": unit, "values": values})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_in_km_per_hour_and_angles_in_degrees() {
        let quantity = |unit| Quantity {
            key: "key",
            name: "Name",
            unit,
            values: vec![Some(1.0), None],
        };
        let expected =
            |unit: &str, value: f64| json!({"name": "Name", "unit": unit, "values": [value, null]});
        assert_eq!(fact(&quantity("m/s")), expected("km/h", 3.6));
        assert_eq!(fact(&quantity("rad/s")), expected("°/s", 1f64.to_degrees()));
        assert_eq!(fact(&quantity("m")), expected("m", 1.0));
    }
}
