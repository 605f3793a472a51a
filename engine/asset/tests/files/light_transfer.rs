//! Light transfers and light probes as files: what they hold, and broken ones.

use decouplegs_asset::probe;
use decouplegs_asset::{
    LightTransferFile, light_transfer_file, read_light_transfer, write_light_transfer,
};
use decouplegs_scene::light::TransferConfidence;
use decouplegs_scene::{AmbientDescriptor, LightTransfer, sh};
use image::{DynamicImage, ImageFormat, Rgb32FImage};
use safetensors::SafeTensors;

fn transfer(sh_degree: u8) -> LightTransferFile {
    let wave = |index: usize| (index as f32 * 0.37).sin();
    let row = |row: usize, phase: usize| {
        (
            std::array::from_fn(|column| wave(row * 27 + column + phase)),
            wave(row + 2 * phase),
        )
    };
    let rows = 3 * sh::coefficient_count(sh_degree);
    let pair = |key: &str, value: &str| [(key.to_owned(), value.to_owned())].into();
    LightTransferFile {
        transfer: LightTransfer {
            sh_degree,
            gain: (0..rows).map(|index| row(index, 5)).collect(),
            offset: (0..rows).map(|index| row(index, 900)).collect(),
            neutral: AmbientDescriptor::uniform([0.4, 0.5, 0.6]),
            confidence: None,
        },
        tool_version: "0.1.0".into(),
        sources: pair("city.exr", &"a5".repeat(32)),
        settings: pair("ridge", "0.001"),
    }
}

fn with_confidence(sh_degree: u8) -> LightTransferFile {
    let count = sh::coefficient_count(sh_degree);
    let wave = |index: usize| (index as f32 * 0.61).cos();
    let mut file = transfer(sh_degree);
    file.transfer.confidence = Some(TransferConfidence {
        effect: (0..3 * count)
            .map(|row| [wave(row), wave(row + 40), 0.08])
            .collect(),
        residual: (0..count).map(|k| 0.01 * k as f32).collect(),
        light_mean: std::array::from_fn(wave),
        light_precision: (0..27)
            .map(|row| std::array::from_fn(|column| wave(27 * row + column)))
            .collect(),
    });
    file
}

#[test]
fn what_is_written_is_read_back_to_the_bit_and_by_others() {
    for sh_degree in 0..=3 {
        let file = transfer(sh_degree);
        let bytes = light_transfer_file::encode(&file).unwrap();
        assert_eq!(light_transfer_file::decode(&bytes).unwrap(), file);
        assert_eq!(bytes, light_transfer_file::encode(&file).unwrap());
        let tensors = SafeTensors::deserialize(&bytes).unwrap();
        let rows = 3 * sh::coefficient_count(sh_degree);
        assert_eq!(tensors.tensor("gain_weights").unwrap().shape(), [rows, 27]);
        assert_eq!(tensors.tensor("offset_constants").unwrap().shape(), [rows]);
        assert_eq!(tensors.tensor("neutral").unwrap().shape(), [9, 3]);
    }
    // Version 2 holds the errors of the calibration as well, and the first version none.
    let known = with_confidence(2);
    let bytes = light_transfer_file::encode(&known).unwrap();
    assert_eq!(light_transfer_file::decode(&bytes).unwrap(), known);
    let tensors = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(tensors.tensor("effect").unwrap().shape(), [27, 3]);
    assert_eq!(tensors.tensor("residual").unwrap().shape(), [9]);
    assert_eq!(tensors.tensor("light_precision").unwrap().shape(), [27, 27]);
    for broken in [f32::NAN, -1.0] {
        let mut file = with_confidence(2);
        file.transfer.confidence.as_mut().unwrap().residual[4] = broken;
        let refused = light_transfer_file::encode(&file).unwrap_err();
        assert!(refused.to_string().contains("residual"), "{refused}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("theta.safetensors");
    write_light_transfer(&path, &transfer(2)).unwrap();
    assert_eq!(read_light_transfer(&path).unwrap(), transfer(2));
}

#[test]
fn broken_transfers_are_refused_with_what_is_wrong() {
    let bytes = light_transfer_file::encode(&transfer(1)).unwrap();
    let replaced = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len(), "a header keeps its length");
        let at = bytes
            .windows(from.len())
            .position(|window| window == from.as_bytes())
            .expect("the header says so");
        let mut bytes = bytes.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        light_transfer_file::decode(&bytes)
            .expect_err("a broken file must be refused")
            .to_string()
    };
    assert!(
        replaced("decouplegs-light-transfer", "decouplegs-asset---------")
            .contains("no light transfer")
    );
    assert!(replaced("\"version\":\"1\"", "\"version\":\"3\"").contains("calibrate again"));
    assert!(replaced("\"sh_degree\":\"1\"", "\"sh_degree\":\"7\"").contains("sh_degree"));
    assert!(
        replaced("\"sh_degree\":\"1\"", "\"sh_degree\":\"2\"").contains("12 rows; expected 27")
    );
    assert!(replaced("\"neutral\"", "\"neutrax\"").contains("neutrax"));
    for value in [f32::NAN, f32::NEG_INFINITY, 1e9] {
        let mut bytes = bytes.clone();
        let end = bytes.len();
        bytes[end - 4..].copy_from_slice(&value.to_le_bytes());
        let said = light_transfer_file::decode(&bytes)
            .expect_err("a broken file must be refused")
            .to_string();
        assert!(
            said.contains(if value.is_finite() { "1e9" } else { "finite" }),
            "{said}"
        );
        let mut file = transfer(1);
        file.transfer.gain[3].0[2] = value;
        assert!(light_transfer_file::encode(&file).is_err());
    }
    let mut file = transfer(1);
    file.transfer.offset.pop();
    assert!(
        light_transfer_file::encode(&file)
            .unwrap_err()
            .to_string()
            .contains("11 of offset")
    );
}

#[test]
fn cut_and_flipped_transfers_never_panic() {
    let bytes = light_transfer_file::encode(&transfer(0)).unwrap();
    for length in 0..bytes.len() {
        assert!(
            light_transfer_file::decode(&bytes[..length]).is_err(),
            "cut at {length}"
        );
    }
    for at in 0..bytes.len() {
        for bit in 0..8 {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1 << bit;
            if let Ok(file) = light_transfer_file::decode(&flipped) {
                assert!(file.transfer.check().is_ok());
            }
        }
    }
}

/// An image of light in the bytes of a file.
fn image(format: ImageFormat) -> (Rgb32FImage, Vec<u8>) {
    let rgb = Rgb32FImage::from_fn(16, 8, |x, y| {
        image::Rgb([0.5 * x as f32, 4.0 * y as f32, 0.25])
    });
    let mut bytes = std::io::Cursor::new(Vec::new());
    DynamicImage::from(rgb.clone())
        .write_to(&mut bytes, format)
        .unwrap();
    (rgb, bytes.into_inner())
}

#[test]
fn probes_are_read_from_both_formats() {
    for format in [ImageFormat::OpenExr, ImageFormat::Hdr] {
        let (rgb, bytes) = image(format);
        let probe = probe::decode("sky", &bytes).unwrap();
        assert_eq!((probe.width(), probe.height(), probe.clamped), (16, 8, 0));
        for (found, pixel) in probe.pixels().iter().zip(rgb.pixels()) {
            // Radiance HDR shares an exponent: the largest channel has 8 bits, the others fewer.
            let tolerance = if format == ImageFormat::Hdr {
                pixel.0.iter().fold(0.0f32, |a, b| a.max(*b)) / 128.0
            } else {
                0.0
            };
            assert!(
                (0..3).all(|channel| (found[channel] - pixel.0[channel]).abs() <= tolerance),
                "{found:?} {pixel:?}"
            );
        }
    }
    assert!(
        probe::decode("sky", b"\x89PNG")
            .unwrap_err()
            .to_string()
            .contains(".exr or .hdr")
    );
    assert!(probe::decode("sky", &[]).is_err());
}

#[test]
fn probes_that_claim_too_much_are_refused() {
    let mut claim = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4000 +X 8000\n".to_vec();
    claim.extend([2, 2, 31, 64]);
    assert!(
        probe::decode("sky", &claim)
            .unwrap_err()
            .to_string()
            .contains("8000 x 4000")
    );
    let large = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 90000 +X 90000\n";
    assert!(
        probe::decode("sky", large)
            .unwrap_err()
            .to_string()
            .contains("8192 x 4096")
    );
}

#[test]
fn cut_and_flipped_probes_never_panic() {
    for format in [ImageFormat::OpenExr, ImageFormat::Hdr] {
        let (_, bytes) = image(format);
        for length in 0..bytes.len() {
            // An image may be whole before its file is.
            let _ = probe::decode("cut", &bytes[..length]);
        }
        for at in 0..bytes.len() {
            for bit in [0, 3, 7] {
                let mut flipped = bytes.clone();
                flipped[at] ^= 1 << bit;
                if let Ok(probe) = probe::decode("flipped", &flipped) {
                    assert!(
                        probe
                            .pixels()
                            .as_flattened()
                            .iter()
                            .all(|value| value.is_finite() && *value >= 0.0)
                    );
                }
            }
        }
    }
}
