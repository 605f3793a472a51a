"""Detections by a model in ONNX: ``decouplegs realism scene --detector MODEL.onnx`` runs this file in a process of its own.

Needs NumPy and onnxruntime (``pip install onnxruntime``). It stands alone: the program carries its text and needs no installed package.

Arguments: the model, the least score, and the kind of input (``auto`` or one of ``INPUTS``). Standard input is a sequence of images, each a line of
JSON with ``width`` and ``height``, then as many pixels of three bytes, RGB, row by row from the top. Standard output has a line of JSON with the ``inputs``
of the model, then one per image: its ``layout``, and ``detections`` of COCO's form, ``category_id``, ``bbox`` (left, top, width, height in pixels of the
image) and ``score``. A line with ``error`` is the last one.

Layouts, by the outputs of the model (N boxes, C classes):

- YOLOv5, also v3 and v7: [1, N, 5 + C]: center, size, objectness, classes;
- YOLOX: the same, and N is the cells of strides 8, 16 and 32, one box each; decoded or not, which the values show;
- YOLOv8, also v9 and v11: [1, 4 + C, N]: center, size, classes;
- YOLOv10, also others without suppression: [1, N, 6]: corners, score, class;
- DETR, also RT-DETR and RF-DETR: logits [1, N, C] and boxes [1, N, 4] as shares of the image; by softmax with a class for nothing, or by sigmoid;
- SSD, also others whose suppression is in the model: boxes [1, N, 4] or [N, 4], scores and labels of length N. Boxes by the names of TensorFlow
  (``detection_boxes``) are y, x, y, x; all others x, y, x, y.
"""

from __future__ import annotations

import json
import sys
from typing import Any, BinaryIO

try:
    import numpy as np
except ImportError:
    if __name__ != "__main__":
        raise
    print(json.dumps({"error": f"{sys.executable} has no NumPy: pip install onnxruntime numpy, or name a Python that has them in DECOUPLEGS_PYTHON"}))
    sys.exit(1)

INPUTS = ("rgb-1", "rgb-255", "bgr-1", "bgr-255", "rgb-imagenet")
# Boxes of one class that overlap by more are of one object.
SAME_IOU = 0.5
# Candidates of one image that are examined, at most: those with the highest scores.
CANDIDATES_MAX = 1000
# Side of images, at most: more is a damaged header.
SIDE_MAX = 1 << 14
GRAY = 114.0
STRIDES = (8, 16, 32)
# Side of the image that tells the layout of a model for images of any size.
PROBE = 320


class DetectorError(Exception):
    """A model or an input that cannot be used: a sentence."""


def weights(size: int, wanted: int) -> np.ndarray:
    """Weights [wanted, size] of linear interpolation, with a wider filter where the image becomes smaller."""
    scale = size / wanted
    support = max(scale, 1.0)
    centers = (np.arange(wanted) + 0.5) * scale
    distance = np.abs(np.arange(size)[None] + 0.5 - centers[:, None]) / support
    kernel = np.maximum(0.0, 1.0 - distance)
    return (kernel / kernel.sum(1, keepdims=True)).astype(np.float32)


def resized(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """``image`` [H, W, 3] at another size, float32 from 0 to 255."""
    rows, columns = weights(image.shape[0], height), weights(image.shape[1], width)
    return np.einsum("yh,hwc,xw->yxc", rows, image.astype(np.float32), columns, optimize=True)


def boxed(image: np.ndarray, height: int, width: int, centered: bool) -> tuple[np.ndarray, np.ndarray]:
    """``image`` inside [height, width] without a change of its shape, the rest gray; and what takes pixels there to the image: scale, left, top."""
    scale = min(height / image.shape[0], width / image.shape[1])
    rows, columns = (max(1, round(side * scale)) for side in image.shape[:2])
    top, left = ((height - rows) // 2, (width - columns) // 2) if centered else (0, 0)
    canvas = np.full((height, width, 3), GRAY, np.float32)
    canvas[top : top + rows, left : left + columns] = resized(image, rows, columns)
    return canvas, np.array([columns / image.shape[1], rows / image.shape[0], left, top])


def corners_of(centers: np.ndarray) -> np.ndarray:
    """Corners x, y, x, y of boxes given by center and size."""
    half = centers[:, 2:4] / 2
    return np.concatenate([centers[:, :2] - half, centers[:, :2] + half], 1)


def suppressed(boxes: np.ndarray, scores: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Indices of the boxes that no better one of their class overlaps."""
    order = np.argsort(-scores, kind="stable")
    kept = []
    while order.size:
        best, rest = order[0], order[1:]
        kept.append(best)
        low = np.maximum(boxes[best, :2], boxes[rest, :2])
        high = np.minimum(boxes[best, 2:], boxes[rest, 2:])
        both = np.prod(np.maximum(high - low, 0.0), 1)
        area = lambda of: np.prod(np.maximum(of[..., 2:] - of[..., :2], 0.0), -1)
        iou = both / np.maximum(area(boxes[best]) + area(boxes[rest]) - both, 1e-9)
        order = rest[(iou <= SAME_IOU) | (classes[rest] != classes[best])]
    return np.array(kept, int)


def cells(height: int, width: int, strides: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Column and row of each cell of a YOLO head [N, 2], and its stride [N]."""
    grids, sizes = [], []
    for stride in strides:
        rows, columns = np.mgrid[: height // stride, : width // stride]
        grids.append(np.stack([columns, rows], -1).reshape(-1, 2))
        sizes.append(np.full(len(grids[-1]), stride))
    return np.concatenate(grids).astype(float), np.concatenate(sizes).astype(float)


def layout_of(names: list[str], outputs: list[np.ndarray], size: tuple[int, int]) -> str:
    """Layout of a model's outputs for an input of ``size``, rows and columns."""
    shapes = [output.shape for output in outputs]
    if len(outputs) == 1 and len(shapes[0]) == 3 and shapes[0][0] == 1:
        _, first, second = shapes[0]
        if first > second > 6 and first in (len(cells(*size, strides)[0]) for strides in (STRIDES, STRIDES[1:])):
            return "YOLOX"
        if second == 6:
            return "YOLOv10"
        if first > second > 6:
            return "YOLOv5"
        if second > first > 4:
            return "YOLOv8"
    if len(outputs) == 2:
        boxes = [shape for shape in shapes if len(shape) == 3 and shape[2] == 4]
        if boxes and all(len(shape) == 3 and shape[:2] == boxes[0][:2] for shape in shapes):
            return "DETR"
    if len(outputs) >= 3 and parts_of(names, outputs) is not None:
        return "SSD"
    found = ", ".join(f"{name} {list(shape)}" for name, shape in zip(names, shapes))
    raise DetectorError(
        f"outputs {found} are of no known layout; expected one of [1, N, 5 + C] (YOLOv5, YOLOX), [1, 4 + C, N] (YOLOv8), [1, N, 6] (YOLOv10), "
        "logits [1, N, C] and boxes [1, N, 4] (DETR), or boxes, scores and labels (SSD)"
    )


def parts_of(names: list[str], outputs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Boxes [N, 4] as x, y, x, y, scores [N] and classes [N] of a model with suppression of its own; ``None`` where it has not these."""
    named = {}
    for name, output in zip(names, outputs):
        for key in ("box", "score", "label", "class"):
            if key in name.lower() and key not in named:
                named[key] = output
    labels = named.get("label", named.get("class"))
    boxes, scores = named.get("box"), named.get("score")
    if boxes is None or scores is None or labels is None or boxes.size % 4 or boxes.shape[-1] != 4:
        return None
    boxes = boxes.reshape(-1, 4)
    if scores.size != len(boxes) or labels.size != len(boxes):
        return None
    if any(name.lower().startswith("detection_boxes") for name in names):
        boxes = boxes[:, [1, 0, 3, 2]]
    return boxes, scores.reshape(-1), labels.reshape(-1)


def yolox(found: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Rows of YOLOX with centers and sizes in pixels: decoded here unless the model did so."""
    rows = found.copy()
    grid, stride = next(heads for heads in (cells(*size, STRIDES), cells(*size, STRIDES[1:])) if len(heads[0]) == len(rows))
    middles = (grid + 0.5) * stride[:, None]
    # A decoded center lies near its cell, a plain one near zero.
    if np.median(np.abs(rows[:, :2] - middles)) > np.median(np.abs(rows[:, :2])):
        rows[:, :2] = (rows[:, :2] + grid) * stride[:, None]
        rows[:, 2:4] = np.exp(np.clip(rows[:, 2:4], -20.0, 20.0)) * stride[:, None]
    return rows


def detections(layout: str, names: list[str], outputs: list[np.ndarray], size: tuple[int, int], least: float) -> tuple[np.ndarray, ...]:
    """Boxes [N, 4] as x, y, x, y in pixels of the input, scores [N] and classes [N] from ``least`` on."""
    rows, columns = size
    extent = np.array([columns, rows, columns, rows], float)
    if layout in ("YOLOv5", "YOLOX"):
        found = outputs[0][0].astype(float)
        found = yolox(found, size) if layout == "YOLOX" else found
        boxes, scores = corners_of(found), found[:, 4:5] * found[:, 5:]
    elif layout == "YOLOv8":
        found = outputs[0][0].astype(float).T
        boxes, scores = corners_of(found), found[:, 4:]
    elif layout == "DETR":
        # A model of four classes has two outputs of this shape.
        first = next((at for at, name in enumerate(names) if "box" in name.lower() and outputs[at].shape[2] == 4), None)
        first = next(at for at, output in enumerate(outputs) if output.shape[2] == 4) if first is None else first
        shares, logits = outputs[first], outputs[1 - first][0].astype(float)
        boxes, scores = corners_of(shares[0].astype(float)) * extent, probabilities(logits)
    else:
        if layout == "YOLOv10":
            found = outputs[0][0].astype(float)
            boxes, scores, classes = found[:, :4], found[:, 4], found[:, 5]
        else:
            boxes, scores, classes = (part.astype(float) for part in parts_of(names, outputs))
            # Shares of the image, not pixels.
            boxes = boxes * extent if boxes.size and np.abs(boxes).max() <= 2.0 else boxes
        kept = scores >= least
        return boxes[kept], scores[kept], classes[kept].astype(int)
    classes, scores = scores.argmax(1), scores.max(1)
    kept = np.flatnonzero(scores >= least)
    kept = kept[np.argsort(-scores[kept], kind="stable")][:CANDIDATES_MAX]
    boxes, scores, classes = boxes[kept], scores[kept], classes[kept]
    if layout != "DETR":
        kept = suppressed(boxes, scores, classes)
        boxes, scores, classes = boxes[kept], scores[kept], classes[kept]
    return boxes, scores, classes


def probabilities(logits: np.ndarray) -> np.ndarray:
    """Scores of classes: by softmax where the last class stands for nothing, as most of the queries find that, otherwise by sigmoid."""
    if (logits.argmax(1) == logits.shape[1] - 1).mean() > 0.5:
        powers = np.exp(logits - logits.max(1, keepdims=True))
        return (powers / powers.sum(1, keepdims=True))[:, :-1]
    return 1.0 / (1.0 + np.exp(-np.clip(logits, -50.0, 50.0)))


class Detector:
    """A model, and what it wants."""

    def __init__(self, path: str, least: float, kind: str) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise DetectorError(f"{sys.executable} has no onnxruntime: pip install onnxruntime, or name a Python that has it in DECOUPLEGS_PYTHON") from None
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        try:
            self.session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has a class of its own for each fault.
            raise DetectorError(f"no model that onnxruntime runs: {str(error).splitlines()[0]}") from None
        self.inputs = self.session.get_inputs()
        self.names = [output.name for output in self.session.get_outputs()]
        self.least, self.kind = least, kind
        image = self.inputs[0]
        if len(image.shape) != 4:
            raise DetectorError(f"input {image.name} is {image.shape}; expected an image, [1, 3, H, W] or [1, H, W, 3]")
        self.last = image.shape[3] == 3
        self.bytes = "uint8" in image.type
        sides = image.shape[1:3] if self.last else image.shape[2:4]
        self.sides = [side if isinstance(side, int) and side > 0 else None for side in sides]
        # What the outputs look like does not depend on the values of the input.
        gray = np.full((self.sides[0] or PROBE, self.sides[1] or PROBE, 3), GRAY, np.uint8)
        self.layout = layout_of(self.names, self.run(gray, "YOLOv5")[0], self.size_for(gray))

    def size_for(self, image: np.ndarray) -> tuple[int, int]:
        """Rows and columns of the input: those of the model, otherwise the image's, up to whole strides."""
        rows, columns = (side or -(-own // STRIDES[-1]) * STRIDES[-1] for side, own in zip(self.sides, image.shape[:2]))
        return rows, columns

    def tensor(self, canvas: np.ndarray, kind: str) -> np.ndarray:
        """``canvas`` [H, W, 3] as the model's input."""
        if kind.startswith("bgr"):
            canvas = canvas[..., ::-1]
        if kind == "rgb-imagenet":
            canvas = (canvas / 255.0 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
        elif kind.endswith("-1"):
            canvas = canvas / 255.0
        values = canvas if self.last else canvas.transpose(2, 0, 1)
        if self.bytes:
            return np.ascontiguousarray(np.clip(np.round(values), 0, 255)[None].astype(np.uint8))
        kind_of = np.float16 if "float16" in self.inputs[0].type else np.float32
        return np.ascontiguousarray(values[None].astype(kind_of))

    def run(self, image: np.ndarray, layout: str) -> tuple[list[np.ndarray], np.ndarray]:
        """Outputs for ``image``, prepared as models of ``layout`` want it; and what takes pixels of the input to the image: scales, left, top."""
        rows, columns = self.size_for(image)
        if layout in ("DETR", "SSD"):
            canvas, place = resized(image, rows, columns), np.array([columns / image.shape[1], rows / image.shape[0], 0, 0])
        else:
            canvas, place = boxed(image, rows, columns, layout != "YOLOX")
        usual = {"YOLOX": "bgr-255", "DETR": "rgb-imagenet"}.get(layout, "rgb-255" if self.bytes else "rgb-1")
        feed = {self.inputs[0].name: self.tensor(canvas, usual if self.kind == "auto" else self.kind)}
        for other in self.inputs[1:]:
            whole = all(side == 1 or not isinstance(side, int) for side in other.shape[:-1])
            if other.shape[-1:] != [2] or not whole or "int64" not in other.type:
                raise DetectorError(f"input {other.name} is {other.shape} of {other.type}; expected an image alone, or the size [1, 2] beside it")
            feed[other.name] = np.array([[rows, columns]], np.int64)
        try:
            return self.session.run(None, feed), place
        except Exception as error:
            raise DetectorError(f"the model failed: {str(error).splitlines()[0]}") from None

    def __call__(self, image: np.ndarray) -> list[dict[str, Any]]:
        """Detections in ``image``, uint8 [H, W, 3]."""
        size = self.size_for(image)
        outputs, place = self.run(image, self.layout)
        boxes, scores, classes = detections(self.layout, self.names, outputs, size, self.least)
        boxes = (boxes - place[[2, 3, 2, 3]]) / place[[0, 1, 0, 1]]
        limit = np.array([image.shape[1], image.shape[0]] * 2, float)
        boxes = np.clip(boxes, 0.0, limit)
        found = []
        for box, score, number in zip(boxes, scores, classes):
            sides = box[2:] - box[:2]
            if np.isfinite(box).all() and np.isfinite(score) and (sides > 0).all():
                bbox = [float(value) for value in (*box[:2], *sides)]
                found.append({"category_id": int(number), "bbox": bbox, "score": float(score)})
        return found


def images(stream: BinaryIO) -> Any:
    """The images of a stream, uint8 [H, W, 3]."""
    while line := stream.readline(1 << 12):
        head = json.loads(line)
        rows, columns = int(head["height"]), int(head["width"])
        if not (0 < rows <= SIDE_MAX and 0 < columns <= SIDE_MAX):
            raise DetectorError(f"an image of {columns} x {rows} pixels was sent; expected 1 to {SIDE_MAX}")
        pixels = stream.read(rows * columns * 3)
        if len(pixels) < rows * columns * 3:
            raise DetectorError("an image was cut off")
        yield np.frombuffer(pixels, np.uint8).reshape(rows, columns, 3)


def main(arguments: list[str]) -> int:
    """Detects until the stream ends; 1 after an error."""
    path, least, kind = arguments[0], float(arguments[1]), arguments[2]
    say = lambda value: print(json.dumps(value), flush=True)
    try:
        detector = Detector(path, least, kind)
        say({"inputs": [[one.name, [str(side) for side in one.shape]] for one in detector.inputs]})
        for image in images(sys.stdin.buffer):
            found = detector(image)
            say({"layout": detector.layout, "detections": found})
    except DetectorError as error:
        say({"error": str(error)})
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
