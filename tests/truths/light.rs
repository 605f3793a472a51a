//! Light of a synthetic street.

use decouplegs::scene::light::{
    AmbientField, AmbientOptions, ShadowOptions, ambient_by_definition,
};
use decouplegs::synth::street::{AssetLight, Street, StreetOptions, Weather};
use glam::DVec3;

fn street(weather: Weather) -> Street {
    let asset_light = AssetLight::Neutral;
    Street::generate(&StreetOptions {
        background: 150_000,
        agents: 3,
        agent_splats: 200,
        weather,
        asset_light,
        ..StreetOptions::default()
    })
}

/// Shadows of cars in their lanes, in the mean: (how stark, how bright the light).
fn shadows(weather: Weather) -> (f64, f64) {
    let street = street(weather);
    let field = AmbientField::new(
        &street.background,
        street.background.len(),
        DVec3::ZERO,
        &AmbientOptions::default(),
    );
    let options = ShadowOptions::default();
    let positions: Vec<DVec3> = (0..16)
        .map(|i| {
            DVec3::new(
                -75.0 + 6.0 * f64::from(i),
                if i % 2 == 0 { -1.65 } else { 4.95 },
                0.75,
            )
        })
        .collect();
    let lights: Vec<_> = positions
        .iter()
        .map(|&position| field.at(position).expect("a street stands about it"))
        .collect();
    let mean =
        |of: &dyn Fn(usize) -> f64| (0..lights.len()).map(of).sum::<f64>() / lights.len() as f64;
    (
        mean(&|i| options.starkness(&lights[i])),
        mean(&|i| f64::from(lights[i].mean()[1])),
    )
}

#[test]
fn overcast_streets_throw_fainter_shadows_than_sunny_ones() {
    let (sunny, overcast) = (shadows(Weather::Clear), shadows(Weather::Overcast));
    println!("starkness and brightness: sunny {sunny:?}, overcast {overcast:?}");
    assert!(
        sunny.0 > 1.1 * overcast.0 && overcast.0 > 0.8,
        "sunny {sunny:?}, overcast {overcast:?}"
    );
    assert!(
        overcast.1 > 0.5 * sunny.1,
        "not because it is dark: {} and {}",
        overcast.1,
        sunny.1
    );
}

#[test]
fn the_field_of_a_street_is_the_sum_over_its_splats() {
    let street = street(Weather::Dusk);
    let options = AmbientOptions::default();
    let mut field = AmbientField::new(
        &street.background,
        street.background.len(),
        DVec3::ZERO,
        &options,
    );
    let positions: Vec<DVec3> = (0..12)
        .map(|i| DVec3::new(-70.0 + 9.3 * f64::from(i), 1.65 * f64::from(i % 5 - 2), 0.8))
        .collect();
    // Of the mean light: the coefficient that is off most, and how much it matters for the side
    // that light comes from.
    let errors = |field: &AmbientField| {
        let of = |position: &DVec3| {
            let (found, truth) = (
                field.at(*position).unwrap(),
                ambient_by_definition(&street.background, &[], *position, &options).unwrap(),
            );
            let off = found
                .to_vector()
                .iter()
                .zip(truth.to_vector())
                .fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs()));
            let direct = f64::from(truth.coefficients[0][1]);
            (
                off / direct,
                (found.directionality() - truth.directionality()).abs(),
            )
        };
        positions
            .iter()
            .map(of)
            .fold((0.0f64, 0.0f64), |worst, (a, b)| {
                (worst.0.max(a), worst.1.max(b))
            })
    };
    let summed = errors(&field);
    field.bake(positions.iter().copied());
    let baked = errors(&field);
    println!(
        "of the mean light, and of directionality: {summed:?} from cubes, {baked:?} from probes"
    );
    // Under half a level of an eight-bit image in brightness, and a twentieth of what tells dusk
    // from an overcast sky.
    for (light, directionality) in [summed, baked] {
        assert!(
            light < 5e-3 && directionality < 5e-5,
            "{summed:?} {baked:?}"
        );
    }
    assert!(
        summed.0 > 0.0 && baked != summed,
        "three computations, not one"
    );
}
