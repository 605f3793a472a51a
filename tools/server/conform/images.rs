//! Checks of image formats, sizes and lenses.

use bytes::{BufMut, Bytes, BytesMut};
use decouplegs::scene::Pose;
use glam::{DQuat, DVec3};
use http::uri::PathAndQuery;
use prost::Message;
use tonic::client::Grpc;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::{Code, Request, Status};

use super::MESSAGE_BYTES_MAX;
use super::check::{Judged, Stop, failed};
use super::rgb_image::RgbImage;
use super::target::{FOCAL_PX, SIZE_PX, Target, pinhole, spec_of};
use decouplegs_alpasim::wire::sensorsim::camera_spec::CameraParam;
use decouplegs_alpasim::wire::sensorsim::ftheta_camera_param::PolynomialType;
use decouplegs_alpasim::wire::sensorsim::{
    FthetaCameraParam, ImageFormat, LinearCde, OpenCvFisheyeCameraParam, RgbRenderRequest,
    RgbRenderReturn,
};

/// Largest mean difference of a JPEG of quality 95 and of a halved image, of 255.
const JPEG_DIFFERENCE_MAX: f64 = 6.0;
const HALVED_DIFFERENCE_MAX: f64 = 10.0;
/// Largest shift between images of one view, pixels, and largest mean difference, of 255.
const SHIFT_MAX_PX: f64 = 0.05;
const LENS_DIFFERENCE_MAX: f64 = 2.0;

/// A sky that is darker than this tells nothing by its color, of 255.
const BRIGHT_MIN: f64 = 90.0;
/// Greatest excess of red over blue of a bright sky overhead, of 255.
const REDDER_MAX: f64 = 20.0;

/// Number of a field that no version of the contract has.
const UNKNOWN_FIELD: u32 = 7_654;

fn has_size(image: &RgbImage, [width_px, height_px]: [u32; 2]) -> Result<(), Stop> {
    if image.size() == [width_px, height_px] {
        return Ok(());
    }
    let [found_w, found_h] = image.size();
    failed(format!(
        "{found_w} x {found_h} pixels; asked for {width_px} x {height_px}"
    ))
}

pub(super) async fn png(target: &mut Target) -> Judged {
    let request = target.request();
    let image = target.image(request).await?;
    has_size(&image, SIZE_PX)?;
    Ok(format!(
        "{} x {}, contrast {:.0} of 255",
        SIZE_PX[0],
        SIZE_PX[1],
        image.contrast()
    ))
}

pub(super) async fn planar(target: &mut Target) -> Judged {
    let request = target.request();
    let png = target.image(request.clone()).await?;
    let request = RgbRenderRequest {
        image_format: ImageFormat::RgbUint8Planar.into(),
        ..request
    };
    let Some(planes) = planes_of(target, request, SIZE_PX).await? else {
        return Err(Stop::Skipped(
            "the server has PNG and JPEG alone, which is all that AlpaSim asks for".into(),
        ));
    };
    let difference = planes.difference(&png);
    if difference > 0.0 {
        return failed(format!(
            "its pixels differ from the PNG by {difference:.2} of 255 on average"
        ));
    }
    Ok("the same pixels".into())
}

pub(super) async fn jpeg(target: &mut Target) -> Judged {
    let request = target.request();
    let png = target.image(request.clone()).await?;
    let request = RgbRenderRequest {
        image_format: ImageFormat::Jpeg.into(),
        ..request
    };
    let answer = target.client.render_rgb(request).await?.into_inner();
    let jpeg = RgbImage::of_jpeg(&answer.image_bytes)?;
    has_size(&jpeg, SIZE_PX)?;
    let difference = jpeg.difference(&png);
    if difference > JPEG_DIFFERENCE_MAX {
        return failed(format!(
            "it differs from the PNG by {difference:.1} of 255 on average; at most {JPEG_DIFFERENCE_MAX} is expected"
        ));
    }
    Ok(format!("{difference:.1} of 255 from the PNG"))
}

/// The planes of an image; `None` from a server that has no such format.
async fn planes_of(
    target: &mut Target,
    request: RgbRenderRequest,
    size: [u32; 2],
) -> Result<Option<RgbImage>, Stop> {
    match target.client.render_rgb(request).await {
        Ok(answer) => RgbImage::of_planes(&answer.into_inner().image_bytes, size).map(Some),
        Err(status) if matches!(status.code(), Code::Unimplemented | Code::InvalidArgument) => {
            Ok(None)
        }
        Err(status) => Err(status.into()),
    }
}

pub(super) async fn large(target: &mut Target) -> Judged {
    let size = [1920, 1080];
    let request = RgbRenderRequest {
        resolution_w: size[0],
        resolution_h: size[1],
        image_format: ImageFormat::RgbUint8Planar.into(),
        ..target.request()
    };
    if let Some(planes) = planes_of(target, request.clone(), size).await? {
        return Ok(format!("{} bytes", planes.rgb.len()));
    }
    let request = RgbRenderRequest {
        image_format: ImageFormat::Png.into(),
        ..request
    };
    let answer = target.client.render_rgb(request).await?.into_inner();
    has_size(&RgbImage::of_png(&answer.image_bytes)?, size)?;
    Ok(format!("a PNG of {} bytes", answer.image_bytes.len()))
}

/// Looks straight up: whatever the weather, a bright sky is no redder than it is blue.
pub(super) async fn colors(target: &mut Target) -> Judged {
    let sensor = target.sensor();
    let up = Pose {
        rotation: DQuat::from_rotation_arc(sensor.rotation * DVec3::Z, DVec3::Z) * sensor.rotation,
        ..sensor
    };
    let request = target.request_of(spec_of(pinhole()), &up, &up);
    let image = target.image(request).await?;
    let mut sums = [0.0; 3];
    for pixel in image.rgb.chunks_exact(3) {
        for (sum, value) in sums.iter_mut().zip(pixel) {
            *sum += f64::from(*value);
        }
    }
    let [red, green, blue] = sums.map(|sum| sum / (image.rgb.len() / 3).max(1) as f64);
    let figure =
        format!("the sky overhead has red {red:.0}, green {green:.0}, blue {blue:.0} of 255");
    if red.max(green).max(blue) < BRIGHT_MIN {
        return Err(Stop::Skipped(format!("{figure}: too dark to tell")));
    }
    if red - blue > REDDER_MAX {
        return failed(format!("{figure}: are the channels blue, green, red?"));
    }
    Ok(figure)
}

pub(super) async fn resized(target: &mut Target) -> Judged {
    let request = target.request();
    let whole = target.view(request.clone()).await?;
    let request = RgbRenderRequest {
        resolution_w: SIZE_PX[0] / 2,
        resolution_h: SIZE_PX[1] / 2,
        ..request
    };
    let half = target.image(request).await?;
    has_size(&half, [SIZE_PX[0] / 2, SIZE_PX[1] / 2])?;
    let difference = whole.halved().difference(&half);
    if difference > HALVED_DIFFERENCE_MAX {
        return failed(format!(
            "half the size differs from the halved image by {difference:.1} of 255; at most {HALVED_DIFFERENCE_MAX} is expected"
        ));
    }
    Ok(format!("{difference:.1} of 255 from the halved image"))
}

pub(super) async fn repeatable(target: &mut Target) -> Judged {
    let request = target.request();
    let first = target.image(request.clone()).await?;
    let second = target.image(request).await?;
    let difference = first.difference(&second);
    if difference > 0.0 {
        return failed(format!(
            "pixels differ by {difference:.3} of 255 on average"
        ));
    }
    Ok("the same pixels".into())
}

pub(super) async fn parallel(target: &mut Target) -> Judged {
    let request = target.request();
    let alone = target.image(request.clone()).await?;
    let mut clients = tokio::task::JoinSet::new();
    for _ in 0..8 {
        let (mut client, request) = (target.client.clone(), request.clone());
        clients.spawn(async move { client.render_rgb(request).await });
    }
    while let Some(answer) = clients.join_next().await {
        let Ok(answer) = answer else {
            return failed("a request was dropped");
        };
        let image = RgbImage::of_png(&answer?.into_inner().image_bytes)?;
        let difference = alone.difference(&image);
        if difference > 0.0 {
            return failed(format!(
                "pixels differ by {difference:.3} of 255 on average"
            ));
        }
    }
    Ok("8 images, the same pixels".into())
}

pub(super) async fn unknown_fields(target: &mut Target) -> Judged {
    let request = target.request();
    let plain = target.image(request.clone()).await?;
    let mut bytes = BytesMut::from(request.encode_to_vec().as_slice());
    // A varint and a text, as newer clients send them.
    bytes.put_slice(&key(UNKNOWN_FIELD, 0));
    bytes.put_u8(1);
    bytes.put_slice(&key(UNKNOWN_FIELD + 1, 2));
    bytes.put_slice(b"\x03new");
    let mut grpc = Grpc::new(target.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX);
    if grpc.ready().await.is_err() {
        return failed("the connection is lost");
    }
    let path = PathAndQuery::from_static("/nre.grpc.protos.sensorsim.SensorsimService/render_rgb");
    let answer = grpc.unary(Request::new(bytes.freeze()), path, Raw).await?;
    let answer = RgbRenderReturn::decode(answer.into_inner());
    let answer = answer.or_else(|error| failed(format!("the answer is no message: {error}")))?;
    let difference = RgbImage::of_png(&answer.image_bytes)?.difference(&plain);
    if difference > 0.0 {
        return failed(format!(
            "the image differs by {difference:.2} of 255 on average"
        ));
    }
    Ok("the same pixels".into())
}

/// Key of a field of the wire format, a varint.
fn key(field: u32, kind: u32) -> Vec<u8> {
    let mut value = field << 3 | kind;
    let mut bytes = Vec::new();
    while value > 0x7f {
        bytes.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

/// Sends and takes bytes as they are.
#[derive(Clone, Default)]
struct Raw;

impl Codec for Raw {
    type Encode = Bytes;
    type Decode = Bytes;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

impl Encoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn encode(&mut self, item: Bytes, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put(item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        use bytes::Buf;
        Ok(Some(buffer.copy_to_bytes(buffer.remaining())))
    }
}

/// Coefficients of the tangent's power series: theta, theta^3 and so on to theta^9.
const TANGENT: [f64; 5] = [1.0, 1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0];

/// Tangent and arc tangent as polynomials without a constant, within 2e-6 up to 0.52, fitted with
/// the largest error made smallest: f-theta lenses have six coefficients.
const TANGENT_FIT: [f64; 5] = [
    1.000_127_82,
    -0.003_210_727_03,
    0.358_930_399,
    -0.084_059_908,
    0.237_757_287,
];
const ARC_TANGENT_FIT: [f64; 5] = [
    0.999_834_265,
    0.004_191_689_09,
    -0.367_372_316,
    0.116_568_099,
    0.042_148_007_1,
];

/// The pinhole as OpenCV's fisheye: its polynomial is the tangent, to 0.001 pixels.
pub(super) fn fisheye() -> CameraParam {
    CameraParam::OpencvFisheyeParam(OpenCvFisheyeCameraParam {
        principal_point_x: f64::from(SIZE_PX[0]) / 2.0,
        principal_point_y: f64::from(SIZE_PX[1]) / 2.0,
        focal_length_x: FOCAL_PX,
        focal_length_y: FOCAL_PX,
        radial_coeffs: TANGENT[1..].to_vec(),
        max_angle: 0.7,
    })
}

/// The pinhole as an f-theta lens, whose principal point counts from the middle of the first pixel.
/// Only the polynomial of `reference` is that of the pinhole: the other is a first guess, 0.1 % off
/// at the middle and 8 % at the corners.
pub(super) fn ftheta(reference: PolynomialType) -> CameraParam {
    let powers = |fit: &[f64; 5], of: &dyn Fn(i32, f64) -> f64| -> Vec<f64> {
        let terms = (1..).zip(fit).map(|(power, c)| of(power, *c));
        std::iter::once(0.0).chain(terms).collect()
    };
    let mut forward = powers(&TANGENT_FIT, &|_, c| FOCAL_PX * c);
    let mut backward = powers(&ARC_TANGENT_FIT, &|power, c| c / FOCAL_PX.powi(power));
    match reference {
        PolynomialType::PixeldistToAngle => forward[2..].fill(0.0),
        _ => backward[2..].fill(0.0),
    }
    CameraParam::FthetaParam(FthetaCameraParam {
        principal_point_x: f64::from(SIZE_PX[0]) / 2.0 - 0.5,
        principal_point_y: f64::from(SIZE_PX[1]) / 2.0 - 0.5,
        reference_poly: reference.into(),
        pixeldist_to_angle_poly: backward,
        angle_to_pixeldist_poly: forward,
        max_angle: 0.7,
        linear_cde: Some(LinearCde {
            linear_c: 1.0,
            linear_d: 0.0,
            linear_e: 0.0,
        }),
    })
}

/// Compares the image of `lens` with that of the pinhole, which is the same view.
pub(super) async fn lens(target: &mut Target, lens: CameraParam) -> Judged {
    let request = target.request();
    let expected = target.view(request).await?;
    let sensor = target.sensor();
    let request = target.request_of(spec_of(lens), &sensor, &sensor);
    let found = target.image(request).await?;
    has_size(&found, SIZE_PX)?;
    let difference = expected.difference(&found);
    let Some([right_px, down_px]) = expected.shift_of(&found) else {
        return Err(Stop::Skipped(
            "the view has no edges in both directions".into(),
        ));
    };
    let figure = format!(
        "shifted by {right_px:.3} px to the right and {down_px:.3} px down; {difference:.2} of 255"
    );
    let shift_px = right_px.abs().max(down_px.abs());
    if shift_px > SHIFT_MAX_PX || difference > LENS_DIFFERENCE_MAX {
        // Splats right before a camera have other footprints behind another lens.
        if !target.has_trajectory {
            return Err(Stop::Skipped(format!(
                "{figure}: without a trajectory the view is from the origin, which may be too near to splats to tell"
            )));
        }
        return failed(format!(
            "{figure}; at most {SHIFT_MAX_PX} px and {LENS_DIFFERENCE_MAX} are expected"
        ));
    }
    Ok(figure)
}
