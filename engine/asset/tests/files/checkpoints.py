#!/usr/bin/env python3
"""Writes the checkpoints in fuzz/seeds as torch.save lays them out, by Python's own pickle and without PyTorch.

    python3 tests/files/checkpoints.py fuzz/seeds

A tensor is pickled as torch does it: a call of torch._utils._rebuild_tensor_v2 with a persistent id for its storage, whose
numbers are an entry of the zip. The splats are those of `cone` in sample.rs.
"""

import collections
import io
import json
import math
import pathlib
import pickle
import struct
import sys
import types
import zipfile

torch = types.ModuleType("torch")
utils = types.ModuleType("torch._utils")
sys.modules["torch"], sys.modules["torch._utils"] = torch, utils


def named(module, name, thing):
    thing.__module__, thing.__qualname__, thing.__name__ = module.__name__, name, name
    setattr(module, name, thing)
    return thing


rebuild_tensor = named(utils, "_rebuild_tensor_v2", lambda *arguments: None)
rebuild_parameter = named(utils, "_rebuild_parameter", lambda *arguments: None)
STORAGES = {
    code: named(torch, name, type(name, (), {}))
    for code, name in (("f", "FloatStorage"), ("q", "LongStorage"), ("?", "BoolStorage"), ("e", "HalfStorage"))
}


class Storage:
    def __init__(self, code, numbers):
        self.code, self.numbers = code, numbers


class Tensor:
    """Numbers of the given shape, the last dimension the fastest; `of` another tensor to share its storage."""

    def __init__(self, code, shape, numbers, parameter=False, strides=None, offset=0):
        self.storage, self.shape, self.parameter, self.offset = Storage(code, list(numbers)), shape, parameter, offset
        packed = [math.prod(shape[i + 1 :]) for i in range(len(shape))]
        self.strides = tuple(strides or packed)

    def __reduce_ex__(self, protocol):
        if self.parameter:
            plain = Tensor.__new__(Tensor)
            plain.__dict__.update(self.__dict__, parameter=False)
            return rebuild_parameter, (plain, True, collections.OrderedDict())
        return rebuild_tensor, (self.storage, self.offset, self.shape, self.strides, False, collections.OrderedDict())


class Pickler(pickle.Pickler):
    def __init__(self, file):
        super().__init__(file, protocol=2)
        self.storages = []

    def persistent_id(self, thing):
        if not isinstance(thing, Storage):
            return None
        if thing not in self.storages:
            self.storages.append(thing)
        key = str(self.storages.index(thing))
        return "storage", STORAGES[thing.code], key, "cuda:0", len(thing.numbers)


def save(path, thing):
    text = io.BytesIO()
    pickler = Pickler(text)
    pickler.dump(thing)
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:

        def add(name, content):
            archive.writestr(zipfile.ZipInfo(f"{path.stem}/{name}", (1980, 1, 1, 0, 0, 0)), content)

        add("data.pkl", text.getvalue())
        add("byteorder", b"little")
        for key, storage in enumerate(pickler.storages):
            add(f"data/{key}", struct.pack(f"<{len(storage.numbers)}{storage.code}", *storage.numbers))
        add("version", b"3\n")


def cone():
    """The cone of sample.rs as trained parameters: rows of means, log-scales, quaternions, logits, DC and 15 coefficients."""
    corners = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    rows = []
    for i in range(12):
        ring, (x, y) = i // 4, corners[i % 4]
        opacity = (3 + i) / 16
        rest = [[((15 * i + k) * 7 + channel * 5) % 33 / 32 - 0.5 for channel in range(3)] for k in range(15)]
        rows.append(
            {
                "means": [2.5 + x * (3 - ring) / 16, y * (3 - ring) / 16 - 1.25, (5 * ring + 1) / 16],
                "scales": [math.log(s) for s in ((1 + ring) / 64, (4 - ring) / 32, (1 + i) / 512)],
                # Of any length: readers normalize.
                "quats": [3, 1 - i % 4, i // 4, 0.5 * i - 2],
                "opacities": [math.log(opacity / (1 - opacity))],
                "dc": [1.25, 1.25, 1.1875] if ring == 1 else [1.25, -0.25, -1.375],
                "rest": [channel for coefficient in rest for channel in coefficient],
            }
        )
    return rows


def column(rows, name):
    return [value for row in rows for value in row[name]]


def gsplat(rows):
    n = len(rows)
    splats = collections.OrderedDict(
        means=Tensor("f", (n, 3), column(rows, "means"), True),
        scales=Tensor("f", (n, 3), column(rows, "scales"), True),
        quats=Tensor("f", (n, 4), column(rows, "quats"), True),
        opacities=Tensor("f", (n,), column(rows, "opacities"), True),
        sh0=Tensor("f", (n, 1, 3), column(rows, "dc"), True),
        shN=Tensor("f", (n, 15, 3), column(rows, "rest"), True),
    )
    return {"step": 29999, "splats": splats}


def node(rows, **more):
    n = len(rows)
    # Means as a transposed view, which is legal: numbers of one axis lie together.
    means = [row["means"][axis] for axis in range(3) for row in rows]
    return collections.OrderedDict(
        _means=Tensor("f", (n, 3), means, True, strides=(1, n)),
        _scales=Tensor("f", (n, 3), column(rows, "scales"), True),
        _quats=Tensor("f", (n, 4), column(rows, "quats"), True),
        _features_dc=Tensor("f", (n, 3), column(rows, "dc"), True),
        _features_rest=Tensor("f", (n, 15, 3), column(rows, "rest"), True),
        _opacities=Tensor("f", (n, 1), column(rows, "opacities"), True),
        **more,
    )


# Six faces of 2 x 2 texels, a color for each face.
SKY = [value for face in range(6) for texel in range(4) for value in (0.1 * face, 1 - 0.1 * face, 1.5)]


def drivestudio(rows):
    # Splats take turns between two instances; the second is there from frame 1 on, a third never has splats.
    ids = [i % 2 for i in range(len(rows))]
    half = math.sqrt(0.5)
    quats = [[1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [2, 0, 0, 0], [half, 0, 0, half], [1, 0, 0, 0], [1, 0, 0, 0], [half, 0, 0, half], [1, 0, 0, 0]]
    trans = [[frame * 2 + 10 * instance, instance, 0.75] for frame in range(3) for instance in range(3)]
    rigid = node(
        rows,
        instances_quats=Tensor("f", (3, 3, 4), [x for q in quats for x in q], True),
        instances_trans=Tensor("f", (3, 3, 3), [x for t in trans for x in t], True),
        points_ids=Tensor("q", (len(rows), 1), ids),
        instances_size=Tensor("f", (3, 3), [4.5, 1.8, 1.5] * 3),
        instances_fv=Tensor("?", (3, 3), [True, False, False, True, True, False, True, True, False]),
    )
    sky = collections.OrderedDict(base=Tensor("f", (6, 2, 2, 3), SKY, True))
    # Two images, one hidden number of three: relu(1 - mean of the embedding) is added to the row of red.
    affine = collections.OrderedDict(
        [
            ("embedding.weight", Tensor("f", (2, 4), [0.25] * 4 + [0.75] * 4, True)),
            ("decoder.0.weight", Tensor("f", (3, 4), [-0.25] * 4 + [0] * 4 + [-1] * 4, True)),
            ("decoder.0.bias", Tensor("f", (3,), [1, 0.125, 0], True)),
            ("decoder.2.weight", Tensor("f", (12, 3), [1, 0, 0] * 4 + [0, 1, 5] * 8, True)),
            ("decoder.2.bias", Tensor("f", (12,), [0] * 11 + [0.5], True)),
        ]
    )
    models = {"Background": node(rows), "RigidNodes": rigid, "SMPLNodes": node(rows[:1]), "Sky": sky, "Affine": affine}
    return collections.OrderedDict(models=models, step=30000)


def street_gaussians(rows):
    def model(rows, terms):
        n = len(rows)
        # A Fourier series over time, whose terms after the constant one are zero on average.
        dc = [value for row in rows for term in range(terms) for value in (row["dc"] if term == 0 else [0.5, -0.5, 0.25])]
        return {
            "xyz": Tensor("f", (n, 3), column(rows, "means"), True),
            "feature_dc": Tensor("f", (n, terms, 3), dc, True),
            "feature_rest": Tensor("f", (n, 15, 3), column(rows, "rest"), True),
            "scaling": Tensor("f", (n, 3), column(rows, "scales"), True),
            "rotation": Tensor("f", (n, 4), column(rows, "quats"), True),
            "opacity": Tensor("f", (n, 1), column(rows, "opacities"), True),
            "semantic": Tensor("f", (n, 0), [], True),
        }

    # Two cameras: the identity, and twice the light with an offset.
    matrices = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 0.25, 0, 2, 0, 0.25, 0, 0, 2, 0.25]
    colors = {"params": collections.OrderedDict(affine_trans=Tensor("f", (2, 3, 4), matrices, True))}
    sky = {"params": {"sky_cube_map": Tensor("f", (6, 2, 2, 3), SKY, True)}}
    models = {"background": model(rows, 1), "obj_007": model(rows[:4], 5), "obj_012": model(rows[4:], 5)}
    return {**models, "actor_pose": {}, "color_correction": colors, "sky_cubemap": sky, "iter": 30000}


def hugsim_model(rows, *more, flat=False):
    """The tuple of HUGSIM's GaussianModel.capture; the ground's splats are flat."""
    n, sizes = len(rows), 2 if flat else 3
    return (
        3,
        Tensor("f", (n, 3), column(rows, "means"), True),
        Tensor("f", (n, 1, 3), column(rows, "dc"), True),
        Tensor("f", (n, 15, 3), column(rows, "rest"), True),
        Tensor("f", (n, 20), [float(i % 20 == 7) for i in range(20 * n)], True),
        Tensor("f", (n, sizes), [value for row in rows for value in row["scales"][:sizes]], True),
        Tensor("f", (n, 4), column(rows, "quats"), True),
        Tensor("f", (n, 1), column(rows, "opacities"), True),
        *more,
    )


def hugsim_network():
    """Weights of the color network: 48 inputs, two layers of 32, 16 outputs. Hidden number 0 is the constant input's."""
    first = [0.0] * (32 * 48)
    first[47] = 1.0  # row 0 takes the last input, a padding of 1
    first[48 + 1] = 1.0  # row 1 takes the cosine of x
    second = [0.0] * (32 * 32)
    second[0], second[32 + 1] = 1.0, 1.0
    last = [0.0] * (16 * 32)
    last[1 * 32] = 2.5  # W[0][1]: red gives 0.25 to green
    last[9 * 32 + 1] = 0.5  # the offset of red is 0.05 times the cosine
    return collections.OrderedDict(params=Tensor("f", (len(first + second + last),), first + second + last, True))


def hugsim_metadata():
    """Two cameras at 2 Hz, three moments: the ego drives 4 m ahead per step, 'dynamic_3' 2 m, in the frames but the first."""

    def matrix(x, y, z, turn=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
        return [[*turn[0], x], [*turn[1], y], [*turn[2], z], [0, 0, 0, 1]]

    frames = []
    for step in range(3):
        # The box's axes are x forward, y right and z down: forward is the world's z, down its y.
        box = matrix(3, 0.75, 10 + 2 * step, ((0, 1, 0), (0, 0, 1), (1, 0, 0)))
        for camera, turn in (("CAM_FRONT", ((1, 0, 0), (0, 1, 0), (0, 0, 1))), ("CAM_BACK", ((-1, 0, 0), (0, 1, 0), (0, 0, -1)))):
            z = 4 * step - (1 if camera == "CAM_BACK" else 0)
            frames.append(
                {
                    "rgb_path": f"./images/{camera}/{step:04}.jpg",
                    "camtoworld": matrix(0, 0, z, turn),
                    "intrinsics": [[400, 0, 401], [0, 410, 226], [0, 0, 1]],
                    "width": 800,
                    "height": 450,
                    "timestamp": 12.5 + 0.5 * step,
                    "dynamics": {"3": box} if step else {},
                }
            )
    return {"camera_model": "OPENCV", "frames": frames, "inv_pose": matrix(0, 0, 0), "verts": {}}


def hugsim(folder, rows):
    # The ground lies 1.5 m below the first camera, around it and ahead.
    flat = [{**row, "means": [row["means"][0] - 2.5, 1.5, 4 * (i % 3)], "quats": [2, 0, 0, 0]} for i, row in enumerate(rows)]
    ground = hugsim_model(flat, flat=True)
    save(folder / "scene.pth", (hugsim_model(rows, 5.0, hugsim_network(), ground), 30000))
    save(folder / "dynamic_3.pth", (hugsim_model(rows[:4], 5.0, None), 30000))
    (folder / "meta_data.json").write_text(json.dumps(hugsim_metadata()) + "\n")


def main():
    seeds, rows = pathlib.Path(sys.argv[1]), cone()
    save(seeds / "checkpoint/cone.pt", gsplat(rows))
    save(seeds / "scene_import/drivestudio.pth", drivestudio(rows))
    save(seeds / "scene_import/street_gaussians.pth", street_gaussians(rows))
    hugsim(seeds / "scene_import/hugsim", rows)


main()
