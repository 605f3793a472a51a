//! A small convolutional network, computed in a fixed order of plain f32 operations: the same bits
//! on every machine, so that episodes are the same wherever they are driven.

use decouplegs_scene::Invalid;
use half::f16;
use safetensors::{Dtype, SafeTensors};

/// Side of the kernels of convolutions, and their stride, pixels.
const KERNEL: usize = 3;
const STRIDE: usize = 2;
/// Most numbers between two layers, and most layers of a kind: a file cannot ask for more.
const VALUES_MAX: usize = 1 << 20;
const LAYERS_MAX: usize = 16;

/// Image-like numbers: rows from the top, channels of a position side by side.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Map {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
    pub(super) values: Vec<f32>,
}

/// A layer whose outputs are sums of weighted inputs.
#[derive(Clone, Debug, PartialEq)]
struct Weights {
    inputs: usize,
    outputs: usize,
    /// Input by input, the weights of all outputs side by side.
    weights: Vec<f32>,
    biases: Vec<f32>,
}

/// Convolutions of 3x3 with a stride of 2 over an image; then dense layers over what they find and
/// over further numbers, which the second dense layer is given beside the outputs of the first.
/// ReLU follows each layer but the last.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Network {
    convolutions: Vec<Weights>,
    dense: Vec<Weights>,
}

/// Sizes that a network must have.
pub(super) struct Shape {
    /// Height, width and channels of its image.
    pub(super) image: [usize; 3],
    /// Further numbers.
    pub(super) numbers: usize,
    /// Number of its outputs.
    pub(super) outputs: usize,
}

impl Network {
    /// Network from the bytes of a safetensors file: tensors `conv1.weight` [outputs, inputs, 3, 3]
    /// and `conv1.bias`, `conv2.weight` and so on, then `dense1.weight` [outputs, inputs] and
    /// `dense1.bias` and so on, 16- or 32-bit floats. The first dense layer is given the channels
    /// of the last convolution, each row by row.
    ///
    /// # Errors
    /// A sentence on what is missing, or has another shape than `shape` asks for.
    pub(super) fn from_bytes(bytes: &[u8], shape: &Shape) -> Result<Self, Invalid> {
        let file = SafeTensors::deserialize(bytes)
            .map_err(|error| Invalid::new(format!("no safetensors file: {error}")))?;
        let [mut height, mut width, mut channels] = shape.image;
        let mut convolutions = Vec::new();
        while let Some(layer) = layer(&file, "conv", convolutions.len(), channels, KERNEL * KERNEL)?
        {
            (height, width) = (height.div_ceil(STRIDE), width.div_ceil(STRIDE));
            channels = layer.outputs;
            convolutions.push(layer);
        }
        let mut dense = Vec::new();
        let mut inputs = channels * height * width;
        while let Some(layer) = layer(&file, "dense", dense.len(), inputs, 1)? {
            inputs = layer.outputs + if dense.is_empty() { shape.numbers } else { 0 };
            dense.push(layer);
        }
        let outputs = dense.last().map_or(0, |last: &Weights| last.outputs);
        if dense.len() < 2 || outputs != shape.outputs {
            return Err(Invalid::new(format!(
                "{} dense layers, the last with {outputs} outputs; expected 2 or more, and {}",
                dense.len(),
                shape.outputs
            )));
        }
        let layers = convolutions.iter().chain(&dense);
        let tensors = layers.count() * 2;
        if file.len() != tensors {
            return Err(Invalid::new(format!(
                "{} tensors, {tensors} of which are layers that follow each other",
                file.len()
            )));
        }
        Ok(Self {
            convolutions,
            dense,
        })
    }

    /// Outputs for `image` and `numbers`, which must have the shape that the network was read for.
    pub(super) fn outputs(&self, image: Map, numbers: &[f32]) -> Vec<f32> {
        let seen = self
            .convolutions
            .iter()
            .fold(image, |map, layer| layer.convolved(&map));
        let mut values = by_channel(&seen);
        for (number, layer) in self.dense.iter().enumerate() {
            if number == 1 {
                values.extend_from_slice(numbers);
            }
            values = layer.weighted(values.iter().copied().enumerate());
            if number + 1 < self.dense.len() {
                rectify(&mut values);
            }
        }
        values
    }
}

impl Weights {
    /// The sum of biases and weighted `inputs`, each with its number.
    fn weighted(&self, inputs: impl Iterator<Item = (usize, f32)>) -> Vec<f32> {
        let mut sums = self.biases.clone();
        for (input, value) in inputs {
            // Most are zero after ReLU.
            if value != 0.0 {
                let weights = &self.weights[input * self.outputs..][..self.outputs];
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum += value * weight;
                }
            }
        }
        sums
    }

    /// The convolution of `map` and ReLU. Beyond its border all is zero.
    fn convolved(&self, map: &Map) -> Map {
        let (height, width) = (map.height.div_ceil(STRIDE), map.width.div_ceil(STRIDE));
        let mut values = Vec::with_capacity(height * width * self.outputs);
        for y in 0..height {
            for x in 0..width {
                let within = (0..KERNEL * KERNEL).filter_map(|at| {
                    // The kernel's middle is on the position.
                    let row = (y * STRIDE + at / KERNEL).checked_sub(1)?;
                    let column = (x * STRIDE + at % KERNEL).checked_sub(1)?;
                    let inside = row < map.height && column < map.width;
                    inside.then_some((at, (row * map.width + column) * map.channels))
                });
                let inputs = within.flat_map(|(at, first)| {
                    let channels = &map.values[first..first + map.channels];
                    let numbers = at * map.channels..;
                    numbers.zip(channels.iter().copied())
                });
                values.extend(self.weighted(inputs));
            }
        }
        rectify(&mut values);
        Map {
            height,
            width,
            channels: self.outputs,
            values,
        }
    }
}

fn rectify(values: &mut [f32]) {
    values.iter_mut().for_each(|value| *value = value.max(0.0));
}

/// The values of `map`, channel by channel.
fn by_channel(map: &Map) -> Vec<f32> {
    (0..map.channels)
        .flat_map(|channel| map.values[channel..].iter().copied().step_by(map.channels))
        .collect()
}

/// Layer `number` of the kind `kind`, from 0, with `area` weights for each input and output; `None`
/// if there is none.
fn layer(
    file: &SafeTensors,
    kind: &str,
    number: usize,
    inputs: usize,
    area: usize,
) -> Result<Option<Weights>, Invalid> {
    let name = format!("{kind}{}", number + 1);
    let Ok(weight) = file.tensor(&format!("{name}.weight")) else {
        return Ok(None);
    };
    let outputs = weight.shape().first().copied().unwrap_or(0);
    let expected: &[usize] = match area {
        1 => &[outputs, inputs],
        _ => &[outputs, inputs, KERNEL, KERNEL],
    };
    if weight.shape() != expected || outputs == 0 || number >= LAYERS_MAX || outputs > VALUES_MAX {
        return Err(Invalid::new(format!(
            "{name}.weight has the shape {:?}; expected {expected:?}, 1 to {VALUES_MAX} outputs and {LAYERS_MAX} layers at most",
            weight.shape()
        )));
    }
    let by_output = floats(file, &format!("{name}.weight"))?;
    let biases = floats(file, &format!("{name}.bias"))?;
    if biases.len() != outputs {
        return Err(Invalid::new(format!(
            "{name}.bias has {} numbers; expected {outputs}",
            biases.len()
        )));
    }
    // Inputs are met position by position of the kernel, channels side by side.
    let mut weights = Vec::with_capacity(by_output.len());
    for at in 0..area {
        for input in 0..inputs {
            weights.extend(
                (0..outputs).map(|output| by_output[(output * inputs + input) * area + at]),
            );
        }
    }
    Ok(Some(Weights {
        inputs: inputs * area,
        outputs,
        weights,
        biases,
    }))
}

/// The numbers of the tensor `name`.
fn floats(file: &SafeTensors, name: &str) -> Result<Vec<f32>, Invalid> {
    let tensor = file
        .tensor(name)
        .map_err(|_| Invalid::new(format!("no tensor {name}")))?;
    let numbers: Vec<f32> = match tensor.dtype() {
        Dtype::F16 => {
            let numbers = tensor.data().as_chunks().0.iter();
            numbers
                .map(|&bytes| f16::from_le_bytes(bytes).to_f32())
                .collect()
        }
        Dtype::F32 => {
            let numbers = tensor.data().as_chunks().0.iter();
            numbers.map(|&bytes| f32::from_le_bytes(bytes)).collect()
        }
        other => {
            return Err(Invalid::new(format!(
                "{name} has numbers of type {other:?}; expected F16 or F32"
            )));
        }
    };
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(numbers),
        false => Err(Invalid::new(format!(
            "{name} has a number that is not finite"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::random::Random;
    use proptest::prelude::*;
    use safetensors::serialize;
    use safetensors::tensor::TensorView;

    use super::*;

    const SHAPE: Shape = Shape {
        image: [5, 6, 2],
        numbers: 3,
        outputs: 4,
    };
    /// Tensors of a network of that shape: one convolution to 3 channels of 3x3, two dense layers.
    const TENSORS: [(&str, &[usize]); 6] = [
        ("conv1.weight", &[3, 2, 3, 3]),
        ("conv1.bias", &[3]),
        ("dense1.weight", &[5, 27]),
        ("dense1.bias", &[5]),
        ("dense2.weight", &[4, 8]),
        ("dense2.bias", &[4]),
    ];

    /// The tensors with these names and shapes, with numbers from -1 to 1.
    fn numbers_of(tensors: &[(&str, &[usize])]) -> Vec<Vec<f32>> {
        let mut random = Random::new(7);
        let of = |(_, shape): &(&str, &[usize])| {
            let count = shape.iter().product();
            (0..count)
                .map(|_| (2.0 * random.unit() - 1.0) as f32)
                .collect()
        };
        tensors.iter().map(of).collect()
    }

    fn file_of(tensors: &[(&str, &[usize])], numbers: &[Vec<f32>]) -> Vec<u8> {
        let bytes: Vec<Vec<u8>> = numbers
            .iter()
            .map(|numbers| {
                numbers
                    .iter()
                    .flat_map(|number| number.to_le_bytes())
                    .collect()
            })
            .collect();
        let views = tensors.iter().zip(&bytes).map(|((name, shape), bytes)| {
            (
                *name,
                TensorView::new(Dtype::F32, shape.to_vec(), bytes).unwrap(),
            )
        });
        serialize(views, None).unwrap()
    }

    /// The outputs by the definition of the layers, in f64.
    fn defined(numbers: &[Vec<f32>], image: &Map, told: &[f32]) -> Vec<f64> {
        let [conv, conv_bias, dense1, bias1, dense2, bias2] = numbers else {
            panic!("six tensors");
        };
        let mut seen = Vec::new();
        for output in 0..3 {
            for (y, x) in (0..3_usize).flat_map(|y| (0..3_usize).map(move |x| (y, x))) {
                let mut sum = f64::from(conv_bias[output]);
                for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column)))
                {
                    let (Some(v), Some(u)) = (
                        (2 * y + row).checked_sub(1),
                        (2 * x + column).checked_sub(1),
                    ) else {
                        continue;
                    };
                    if v < image.height && u < image.width {
                        for input in 0..2 {
                            let weight = conv[((output * 2 + input) * 3 + row) * 3 + column];
                            let value = image.values[(v * image.width + u) * 2 + input];
                            sum += f64::from(weight) * f64::from(value);
                        }
                    }
                }
                seen.push(sum.max(0.0));
            }
        }
        let dense = |weights: &[f32], biases: &[f32], inputs: &[f64]| -> Vec<f64> {
            let sum = |(row, bias): (&[f32], &f32)| {
                let products = row
                    .iter()
                    .zip(inputs)
                    .map(|(weight, input)| f64::from(*weight) * input);
                f64::from(*bias) + products.sum::<f64>()
            };
            weights.chunks(inputs.len()).zip(biases).map(sum).collect()
        };
        let mut hidden: Vec<f64> = dense(dense1, bias1, &seen)
            .iter()
            .map(|value| value.max(0.0))
            .collect();
        hidden.extend(told.iter().map(|value| f64::from(*value)));
        dense(dense2, bias2, &hidden)
    }

    #[test]
    fn outputs_are_those_of_the_layers_as_they_are_defined() {
        let numbers = numbers_of(&TENSORS);
        let network = Network::from_bytes(&file_of(&TENSORS, &numbers), &SHAPE).unwrap();
        let mut random = Random::new(3);
        let image = Map {
            height: 5,
            width: 6,
            channels: 2,
            values: (0..60)
                .map(|_| (4.0 * random.unit() - 2.0) as f32)
                .collect(),
        };
        let told = [0.3, -0.7, 1.1];
        let defined = defined(&numbers, &image, &told);
        let found = network.outputs(image, &told);
        assert_eq!(found.len(), 4);
        for (found, defined) in found.iter().zip(&defined) {
            assert!(
                (f64::from(*found) - defined).abs() < 1e-5,
                "{found} {defined}"
            );
        }
    }

    #[test]
    fn files_without_such_a_network_are_refused_with_what_is_wrong() {
        let numbers = numbers_of(&TENSORS);
        let refusal = |tensors: &[(&str, &[usize])], numbers: &[Vec<f32>]| {
            Network::from_bytes(&file_of(tensors, numbers), &SHAPE)
                .unwrap_err()
                .to_string()
        };
        let mut renamed = TENSORS;
        renamed[1].0 = "conv1.biases";
        assert!(refusal(&renamed, &numbers).contains("no tensor conv1.bias"));
        let mut other = TENSORS;
        other[2].1 = &[27, 5];
        assert!(
            refusal(&other, &numbers)
                .contains("dense1.weight has the shape [27, 5]; expected [27, 27]")
        );
        let mut infinite = numbers.clone();
        infinite[5][2] = f32::INFINITY;
        assert!(
            refusal(&TENSORS, &infinite).contains("dense2.bias has a number that is not finite")
        );
        assert!(refusal(&TENSORS[..4], &numbers).contains("1 dense layers"));
        let [more, spare] = ["dense4.bias", "mean"].map(|name| {
            let tensors = [&TENSORS[..], &[(name, &[1])]].concat();
            refusal(&tensors, &[&numbers[..], &[vec![0.0]]].concat())
        });
        assert!(
            more.contains("7 tensors, 6 of which") && spare.contains("7 tensors"),
            "{more} {spare}"
        );
        assert!(
            Network::from_bytes(b"{}", &SHAPE)
                .unwrap_err()
                .to_string()
                .contains("no safetensors file")
        );
    }

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_give_numbers(at in 0_usize..1_000, byte: u8, end in 0_usize..1_200) {
            let mut file = file_of(&TENSORS, &numbers_of(&TENSORS));
            let count = file.len();
            file[at % count] = byte;
            file.truncate(end.max(at + 1));
            if let Ok(network) = Network::from_bytes(&file, &SHAPE) {
                let image = Map { height: 5, width: 6, channels: 2, values: vec![0.5; 60] };
                prop_assert_eq!(network.outputs(image, &[0.0; 3]).len(), 4);
            }
        }
    }
}
