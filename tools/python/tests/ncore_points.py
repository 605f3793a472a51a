"""Image points of rays by NVIDIA NCore's own camera models (package nvidia-ncore, which needs torch): JSON in, JSON out.

    PYTHONPATH=FOLDER_OF_NCORE python3 ncore_points.py < cameras.json

Points count from the corner of the first pixel.
"""

import json
import sys

import numpy as np
import torch
from ncore.data import (
    BivariateWindshieldModelParameters,
    FThetaCameraModelParameters,
    OpenCVFisheyeCameraModelParameters,
    OpenCVPinholeCameraModelParameters,
    ShutterType,
)
from ncore.impl.data.types import ReferencePolynomial
from ncore.sensors import CameraModel


def floats(values):
    return np.array(values, np.float32)


def parameters(camera):
    windshield = camera.get("windshield")
    distortion = windshield and BivariateWindshieldModelParameters(
        reference_poly=ReferencePolynomial[windshield["reference"]],
        **{name: floats(windshield[name]) for name in ("horizontal_poly", "vertical_poly", "horizontal_poly_inverse", "vertical_poly_inverse")},
    )
    common = {
        "resolution": np.array(camera["size"], np.uint64),
        "shutter_type": ShutterType.GLOBAL,
        "external_distortion_parameters": distortion,
        "principal_point": floats(camera["center"]),
    }
    if camera["kind"] == "ftheta":
        kind = FThetaCameraModelParameters
        return kind(
            reference_poly=kind.PolynomialType[camera["reference"]],
            pixeldist_to_angle_poly=floats(camera["backward"]),
            angle_to_pixeldist_poly=floats(camera["forward"]),
            max_angle=camera["max_angle"],
            linear_cde=floats(camera["cde"]),
            **common,
        )
    common |= {"focal_length": floats(camera["focal"]), "radial_coeffs": floats(camera["radial"])}
    if camera["kind"] == "fisheye":
        return OpenCVFisheyeCameraModelParameters(max_angle=camera["max_angle"], **common)
    return OpenCVPinholeCameraModelParameters(
        tangential_coeffs=floats(camera["tangential"]), thin_prism_coeffs=floats(camera["thin_prism"]), **common
    )


def main():
    asked = json.load(sys.stdin)
    rays = torch.tensor(asked["rays"], dtype=torch.float64)
    found = {}
    for name, camera in asked["cameras"].items():
        model = CameraModel.from_parameters(parameters(camera), device="cpu", dtype=torch.float64)
        points = model.camera_rays_to_image_points(rays)
        found[name] = {"points": points.image_points.tolist(), "valid": points.valid_flag.tolist()}
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
