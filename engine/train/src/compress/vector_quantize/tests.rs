use proptest::prelude::*;

use super::*;

fn options(entries: usize) -> QuantizeOptions {
    QuantizeOptions {
        entries,
        iterations_max: 400,
        final_iterations_max: 4,
        seed: 11,
    }
}

fn quantize(values: &[f32], dimension: usize, options: &QuantizeOptions) -> Quantized {
    let vectors = Vectors { values, dimension };
    vector_quantize(vectors, &vec![1.0; vectors.len()], options, &|_| ())
}

/// `per_cluster` points close around each of `centers`.
fn around(centers: &[[f32; 3]], per_cluster: usize, spread: f32) -> Vec<f32> {
    let mut random = Random::new(5);
    let mut values = Vec::new();
    for _ in 0..per_cluster {
        for center in centers {
            values.extend(center.map(|x| x + spread * (random.unit() as f32 - 0.5)));
        }
    }
    values
}

#[test]
fn separate_clusters_are_found() {
    let centers: Vec<[f32; 3]> = (0..8u8)
        .map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|bit| 10.0 * f32::from(bit)))
        .collect();
    let values = around(&centers, 200, 1.0);
    let book = quantize(&values, 3, &options(8));
    for center in &centers {
        let square = |entry: &[f32]| {
            entry
                .iter()
                .zip(center)
                .map(|(a, b)| (a - b) * (a - b))
                .sum::<f32>()
        };
        assert!(
            book.entries.chunks(3).any(|entry| square(entry) < 0.05),
            "{center:?} in {:?}",
            book.entries
        );
    }
    // Uniform in a cube of side 1: 3 / 12.
    let last = *book.distortion.last().unwrap();
    assert!((last - 0.25).abs() < 0.02, "{last}");
    let clusters = book
        .assignment
        .chunks(8)
        .all(|cluster| cluster == &book.assignment[..8]);
    assert!(clusters, "points of a cluster share an entry");
}

#[test]
fn moving_averages_improve_on_where_entries_began() {
    let values: Vec<f32> = (0..6000)
        .map(|i| ((i * i) as f32 * 0.0137).sin() * (1.0 + (i % 7) as f32))
        .collect();
    let last = |iterations_max| {
        let options = QuantizeOptions {
            iterations_max,
            final_iterations_max: 0,
            ..options(64)
        };
        *quantize(&values, 3, &options).distortion.last().unwrap()
    };
    assert!(
        last(400) < 0.92 * last(0),
        "{} against {}",
        last(400),
        last(0)
    );
}

#[test]
fn final_iterations_never_make_it_worse() {
    let values = around(&[[0.0; 3], [1.0; 3], [2.0, 0.0, 1.0]], 500, 2.0);
    let book = quantize(
        &values,
        3,
        &QuantizeOptions {
            final_iterations_max: 12,
            ..options(20)
        },
    );
    let of_all = &book.distortion[book.batches..];
    assert!(
        of_all.len() > 3
            && of_all
                .windows(2)
                .all(|pair| pair[1] <= pair[0] * (1.0 + 1e-6)),
        "{of_all:?}"
    );
}

#[test]
fn dead_entries_begin_again_where_vectors_are() {
    let values = around(&[[0.0; 3], [50.0; 3]], 1000, 1.0);
    let vectors = Vectors {
        values: &values,
        dimension: 3,
    };
    let weights = vec![1.0; vectors.len()];
    // Two entries live, six stand where nothing is.
    let mut entries = vec![1e4f32; 24];
    entries[..6].copy_from_slice(&[0.0, 0.0, 0.0, 50.0, 50.0, 50.0]);
    let mut training = Training {
        vectors,
        weights: &weights,
        entries,
        distortion: vec![],
        reseeded: 0,
        random: Random::new(2),
    };
    training.follow_batches(600, &|_| ());
    training.finish(2, &|_| ());
    assert!(training.reseeded >= 6, "{}", training.reseeded);
    assert!(
        training.entries.iter().all(|value| value.abs() < 60.0),
        "{:?}",
        training.entries
    );
    assert!(*training.distortion.last().unwrap() < 0.2);
}

#[test]
fn fewer_different_vectors_than_entries_are_kept_as_they_are() {
    let values: Vec<f32> = (0..300).flat_map(|i| [(i % 5) as f32, 1.0, -2.0]).collect();
    let book = quantize(&values, 3, &options(64));
    assert_eq!(book.entries.len(), 5 * 3);
    assert_eq!(*book.distortion.last().unwrap(), 0.0);
    let same = quantize(&[0.25; 3 * 40], 3, &options(8));
    assert_eq!(
        (same.entries.as_slice(), same.assignment.as_slice()),
        ([0.25; 3].as_slice(), [0u16; 40].as_slice())
    );
}

#[test]
fn weights_draw_entries_to_what_matters() {
    let values = [0.0f32, 1.0, 10.0];
    let vectors = Vectors {
        values: &values,
        dimension: 1,
    };
    let book = vector_quantize(vectors, &[1.0, 3.0, 0.0], &options(1), &|_| ());
    assert!((book.entries[0] - 0.75).abs() < 1e-5, "{:?}", book.entries);
}

#[test]
fn the_seed_decides_and_the_threads_do_not() {
    let values: Vec<f32> = (0..9000)
        .map(|i| ((i * 37 % 1001) as f32 * 0.01).cos())
        .collect();
    let with_threads = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            quantize(
                &values,
                3,
                &QuantizeOptions {
                    seed,
                    ..options(40)
                },
            )
        })
    };
    assert_eq!(with_threads(1, 3), with_threads(2, 3));
    assert_ne!(with_threads(1, 3).entries, with_threads(1, 4).entries);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn distortion_is_a_number_and_every_vector_has_its_nearest_entry(
        values in prop::collection::vec(-100.0f32..100.0, 4..200), entries in 1usize..20, scale in -20i32..20, seed: u64,
    ) {
        let values: Vec<f32> = values[..values.len() / 4 * 4].iter().map(|value| value * (scale as f32).exp2()).collect();
        let book = quantize(&values, 4, &QuantizeOptions { iterations_max: 60, seed, ..options(entries) });
        prop_assert!(book.distortion.iter().all(|value| value.is_finite() && *value >= 0.0), "{:?}", book.distortion);
        prop_assert!(book.entries.len() <= entries * 4 && book.entries.iter().all(|value| value.is_finite()));
        let search = SearchBook::new(Vectors { values: &book.entries, dimension: 4 });
        for (vector, &entry) in values.chunks(4).zip(&book.assignment) {
            prop_assert_eq!(search.nearest(vector).entry, usize::from(entry));
        }
    }
}
