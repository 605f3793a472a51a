"""A sequence as NVIDIA's package nvidia-ncore writes it: five seconds of a drive, two cameras, a LiDAR, a car.

    PYTHONPATH=FOLDER_OF_NCORE python3 ncore_sequence.py FOLDER itar|directory
"""

import io
import json
import sys
from pathlib import Path

import numpy as np
from ncore.data import (
    BBox3,
    BivariateWindshieldModelParameters,
    CuboidTrackObservation,
    FThetaCameraModelParameters,
    LabelSource,
    OpenCVPinholeCameraModelParameters,
    RowOffsetStructuredSpinningLidarModelParameters,
    ShutterType,
)
from ncore.data.v4 import (
    CameraSensorComponent,
    CuboidsComponent,
    IntrinsicsComponent,
    LidarSensorComponent,
    PosesComponent,
    SequenceComponentGroupsReader,
    SequenceComponentGroupsWriter,
)
from ncore.impl.common.transformations import HalfClosedInterval
from ncore.impl.data.types import ReferencePolynomial
from PIL import Image

START_US, STEP_US, POSES = 1_700_000_000_000_000, 100_000, 51
FORWARD = [0.0, 560.0, 4.0, -30.0, 6.0, 0.0]
BACKWARD = [0.0, 1 / 560.0, 0.0, 0.0, 0.0, 0.0]
WIDE, TELE, LIDAR = "camera_front_wide_120fov", "camera_front_tele_30fov", "lidar_top"


def floats(values):
    return np.array(values, np.float32)


def pose(x, y, z, rotation=np.eye(3)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, [x, y, z]
    return matrix


FRONT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # optical axes in those of the vehicle


def cameras():
    windshield = BivariateWindshieldModelParameters(
        reference_poly=ReferencePolynomial.FORWARD,
        horizontal_poly=floats([0.002, 1.003, 0.004]),
        vertical_poly=floats([-0.001, 0.002, 0.998]),
        horizontal_poly_inverse=floats([0.0, 1.0, 0.0]),
        vertical_poly_inverse=floats([0.0, 0.0, 1.0]),
    )
    kind = FThetaCameraModelParameters
    wide = kind(
        resolution=np.array([960, 600], np.uint64),
        shutter_type=ShutterType.ROLLING_TOP_TO_BOTTOM,
        external_distortion_parameters=windshield,
        principal_point=floats([470.25, 305.75]),
        reference_poly=kind.PolynomialType.ANGLE_TO_PIXELDIST,
        pixeldist_to_angle_poly=floats(BACKWARD),
        angle_to_pixeldist_poly=floats(FORWARD),
        max_angle=1.0,
        linear_cde=floats([1.0, 0.0, 0.0]),
    )
    tele = OpenCVPinholeCameraModelParameters(
        resolution=np.array([640, 400], np.uint64),
        shutter_type=ShutterType.GLOBAL,
        external_distortion_parameters=None,
        principal_point=floats([320.5, 200.5]),
        focal_length=floats([900.0, 905.0]),
        radial_coeffs=floats([0.1, -0.05, 0.0, 0.0, 0.0, 0.0]),
        tangential_coeffs=floats([0.001, -0.002]),
        thin_prism_coeffs=floats([0.0, 0.0, 0.0, 0.0]),
    )
    return {WIDE: wide, TELE: tele}


def main(folder, store):
    stop = START_US + STEP_US * (POSES - 1)
    writer = SequenceComponentGroupsWriter(
        output_dir_path=folder,
        store_base_name="drive",
        sequence_id="drive",
        sequence_timestamp_interval_us=HalfClosedInterval(START_US, stop + 1),
        generic_meta_data={},
        store_type=store,
    )
    times = np.arange(POSES, dtype=np.uint64) * STEP_US + np.uint64(START_US)
    way = np.stack([pose(0.8 * step, 0.01 * step * step, 0.5) for step in range(POSES)])
    (
        writer.register_component_writer(PosesComponent.Writer, "default", None, {})
        .store_dynamic_pose("rig", "world", way, times)
        .store_static_pose(WIDE, "rig", pose(1.7, 0.1, 1.4, FRONT))
        .store_static_pose(TELE, "rig", pose(1.7, -0.1, 1.4, FRONT))
        .store_static_pose("rig", LIDAR, np.linalg.inv(pose(1.1, 0.0, 1.9)))
    )
    intrinsics = writer.register_component_writer(IntrinsicsComponent.Writer, "default", None, {})
    rows, columns = 4, 90
    spinning = RowOffsetStructuredSpinningLidarModelParameters(
        spinning_frequency_hz=10.0,
        spinning_direction="cw",
        n_rows=rows,
        n_columns=columns,
        row_elevations_rad=floats(np.linspace(0.2, -0.3, rows)),
        column_azimuths_rad=floats(np.pi - 2 * np.pi * np.arange(columns) / columns),
        row_azimuth_offsets_rad=floats(np.zeros(rows)),
    )
    intrinsics.store_lidar_intrinsics(LIDAR, spinning)
    writer.register_component_writer(LidarSensorComponent.Writer, LIDAR, "lidars", {})
    for shade, (name, model) in enumerate(cameras().items()):
        intrinsics.store_camera_intrinsics(name, model)
        frames = writer.register_component_writer(CameraSensorComponent.Writer, name, "cameras", {})
        for start in (START_US + 1_000_000, START_US + 2_000_000):
            image = io.BytesIO()
            Image.new("RGB", (8, 6), (40 * shade, 90, 120)).save(image, "png")
            frames.store_frame(image.getvalue(), "png", np.array([start, start + 30_000], np.uint64), {}, {})
    boxes = [
        CuboidTrackObservation(
            track_id="7",
            class_id="automobile",
            timestamp_us=START_US + step * STEP_US,
            reference_frame_id=frame,
            reference_frame_timestamp_us=START_US + step * STEP_US,
            bbox3=BBox3(centroid=(20.0, 3.0, 0.25), dim=(4.5, 1.9, 1.5), rot=(0.0, 0.0, 0.5)),
            source=LabelSource.AUTOLABEL,
        )
        for step, frame in ((0, "rig"), (5, LIDAR))
    ]
    writer.register_component_writer(CuboidsComponent.Writer, "default", None, {}).store_observations(boxes)
    paths = writer.finalize()
    meta = SequenceComponentGroupsReader(paths).get_sequence_meta()
    (Path(folder) / "drive.json").write_text(json.dumps(meta.to_dict()))


if __name__ == "__main__":
    from upath import UPath

    main(UPath(sys.argv[1]), sys.argv[2])
