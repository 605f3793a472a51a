"""Write checkpoints with PyTorch, shaped as trainers shape them, and the same numbers as .npy files.

    python3 write_checkpoints.py FOLDER

The layouts are those of gsplat (`examples/simple_trainer.py`), nerfstudio's splatfacto, drivestudio (`models/trainers/base.py`),
Street Gaussians (`lib/models/street_gaussian_model.py`) and HUGSIM (`scene/gaussian_model.py`). It runs in any Python with torch.
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch
from torch.nn import Parameter

SPLATS = 200
GROUND = 60
ACTOR = 40


def splats(count, generator, *, ahead=True):
    """Random parameters of splats in front of a camera that looks along z, or around the origin."""

    def normal(*shape):
        return torch.randn(*shape, generator=generator)

    means = normal(count, 3)
    if ahead:
        depth = 4.0 + 10.0 * torch.rand(count, generator=generator)
        means = torch.stack([0.3 * depth * means[:, 0].clamp(-1, 1), 0.15 * depth * means[:, 1].clamp(-1, 1), depth], dim=1)
    return {
        "means": means,
        "scales": normal(count, 3) * 0.4 - 2.0,
        "quats": normal(count, 4),
        "opacities": normal(count) * 1.5,
        "sh0": normal(count, 1, 3),
        "shN": normal(count, 15, 3) * 0.15,
    }


def parameters(tensors):
    return {name: Parameter(tensor) for name, tensor in tensors.items()}


def gsplat(tensors):
    return {"step": 29999, "splats": torch.nn.ParameterDict(parameters(tensors)).state_dict()}


def splatfacto(tensors):
    names = {"sh0": "features_dc", "shN": "features_rest"}
    state = {f"_model.gauss_params.{names.get(name, name)}": tensor for name, tensor in tensors.items()}
    state["_model.gauss_params.features_dc"] = tensors["sh0"].squeeze(1)
    state["_model.gauss_params.opacities"] = tensors["opacities"].unsqueeze(1)
    return {"step": 29999, "pipeline": state, "optimizers": {}, "scalers": {}}


class Module(torch.nn.Module):
    """A module whose state has the given tensors."""

    def __init__(self, tensors):
        super().__init__()
        for name, tensor in tensors.items():
            if tensor.is_floating_point():
                self.register_parameter(name, Parameter(tensor))
            else:
                self.register_buffer(name, tensor)


def drivestudio(tensors, actor):
    def named(tensors):
        names = {"sh0": "_features_dc", "shN": "_features_rest"}
        renamed = {names.get(name, f"_{name}"): tensor for name, tensor in tensors.items()}
        return {**renamed, "_features_dc": tensors["sh0"].squeeze(1), "_opacities": tensors["opacities"].unsqueeze(1)}

    rigid = {
        **named(actor),
        "instances_quats": torch.tensor([[[1.0, 0.0, 0.0, 0.0]]] * 3),
        "instances_trans": torch.tensor([[[2.0 * frame, 0.5, 8.0]] for frame in range(3)]),
        "points_ids": torch.zeros(ACTOR, 1, dtype=torch.int64),
        "instances_size": torch.tensor([[4.5, 1.8, 1.5]]),
        "instances_fv": torch.ones(3, 1, dtype=torch.bool),
    }
    models = {"Background": Module(named(tensors)).state_dict(), "RigidNodes": Module(rigid).state_dict()}
    optimizer = torch.optim.Adam(parameters(tensors).values(), eps=1e-15)
    return {"models": models, "step": 30000, "optimizer": optimizer.state_dict()}


def street_gaussians(tensors, actor):
    def model(tensors):
        return {
            "xyz": Parameter(tensors["means"]),
            "feature_dc": Parameter(tensors["sh0"]),
            "feature_rest": Parameter(tensors["shN"]),
            "scaling": Parameter(tensors["scales"]),
            "rotation": Parameter(tensors["quats"]),
            "opacity": Parameter(tensors["opacities"].unsqueeze(1)),
            "semantic": Parameter(torch.zeros(len(tensors["means"]), 0)),
        }

    return {"background": model(tensors), "obj_003": model(actor), "actor_pose": {}, "iter": 30000}


def hugsim_tuple(tensors, *more):
    """The tuple of `GaussianModel.capture`."""
    return (
        3,
        Parameter(tensors["means"]),
        Parameter(tensors["sh0"]),
        Parameter(tensors["shN"]),
        Parameter(torch.zeros(len(tensors["means"]), 20)),
        Parameter(tensors["scales"]),
        Parameter(tensors["quats"]),
        Parameter(tensors["opacities"].unsqueeze(1)),
        *more,
    )


def hugsim(folder, tensors, ground, actor, network):
    folder.mkdir()
    scene = hugsim_tuple(tensors, 5.0, Module({"params": network}).state_dict(), hugsim_tuple(ground))
    torch.save((scene, 30000), folder / "scene.pth")
    torch.save((hugsim_tuple(actor), 30000), folder / "dynamic_7.pth")
    frames = []
    for step in range(2):
        turn = 0.1 * step
        camera = [[np.cos(turn), 0, np.sin(turn), 0.2], [0, 1, 0, 0.1], [-np.sin(turn), 0, np.cos(turn), 0.5 * step], [0, 0, 0, 1]]
        box = [[0, 1, 0, 1.0], [0, 0, 1, 0.4], [1, 0, 0, 7.0 + 2 * step], [0, 0, 0, 1]]
        frames.append(
            {
                "rgb_path": f"images/CAM_FRONT/{step:04}.jpg",
                "camtoworld": camera,
                "intrinsics": [[150, 0, 82], [0, 155, 57], [0, 0, 1]],
                "width": 160,
                "height": 120,
                "timestamp": 0.5 * step,
                "dynamics": {"7": box},
            }
        )
    (folder / "meta_data.json").write_text(json.dumps({"camera_model": "OPENCV", "frames": frames}))


def main():
    out = Path(sys.argv[1])
    generator = torch.Generator().manual_seed(7)
    tensors, actor = splats(SPLATS, generator), splats(ACTOR, generator, ahead=False)
    ground = splats(GROUND, generator)
    ground["means"][:, 1] = 1.5
    ground["scales"] = ground["scales"][:, :2]
    ground["quats"] = torch.tensor([1.0, 0.0, 0.0, 0.0]) + 0.05 * ground["quats"]
    network = 0.3 * torch.randn(32 * 48 + 32 * 32 + 16 * 32, generator=generator)
    for group, members in (("scene", tensors), ("actor", actor), ("ground", ground), ("network", {"params": network})):
        for name, tensor in members.items():
            np.save(out / f"{group}_{name}.npy", tensor.numpy())
    torch.save(gsplat(tensors), out / "gsplat.pt")
    torch.save(splatfacto(tensors), out / "splatfacto.ckpt")
    torch.save(drivestudio(tensors, actor), out / "drivestudio.pth")
    torch.save(street_gaussians(tensors, actor), out / "street_gaussians.pth")
    hugsim(out / "hugsim", tensors, ground, actor, network)


if __name__ == "__main__":
    main()
