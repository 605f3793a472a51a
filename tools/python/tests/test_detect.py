"""`decouplegs.detect`: outputs of detectors in ONNX, layout by layout, and a model that is run."""

import json
import subprocess
import sys

import numpy as np
import pytest

from decouplegs import detect

SIZE = (64, 96)
# Corners, class and score of what every layout below holds.
BOXES = np.array([[8.0, 8.0, 40.0, 24.0], [50.0, 30.0, 90.0, 60.0]])
CLASSES, SCORES = np.array([2, 0]), np.array([0.9, 0.6])
COUNT = len(detect.cells(*SIZE, detect.STRIDES)[0])


def centers(boxes):
    return np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]], 1)


def rows(count, classes=3, objectness=True):
    """Rows of a YOLO head: the two boxes, a worse double of the first, and nothing."""
    table = np.zeros((count, 4 + objectness + classes))
    table[:, 2:4] = 1.0
    for at, box, kind, score in [(1, 0, 2, 0.9), (5, 1, 0, 0.6), (3, 0, 2, 0.5)]:
        table[at, :4] = centers(BOXES)[box] + (at == 3)
        table[at, 4 + objectness + kind] = score
        if objectness:
            table[at, 4] = 1.0
    return table


def plain_yolox():
    """The same as a head that is not decoded."""
    table = rows(COUNT)
    grid, stride = detect.cells(*SIZE, detect.STRIDES)
    table[:, :2] = table[:, :2] / stride[:, None] - grid
    empty = table[:, 4] == 0
    table[empty, :2] = 0.5
    table[:, 2:4] = np.log(table[:, 2:4] / stride[:, None])
    return table


def decoded_yolox():
    table = rows(COUNT)
    grid, stride = detect.cells(*SIZE, detect.STRIDES)
    empty = table[:, 4] == 0
    table[empty, :2] = ((grid + 0.5) * stride[:, None])[empty]
    return table


def detr(softmax):
    logits = np.full((1, 20, 4 if softmax else 3), -16.0)
    shares = np.full((1, 20, 4), 0.5)
    if softmax:
        logits[0, :, 3] = 8.0
    for at, box, kind, score in [(4, 0, 2, 0.9), (7, 1, 0, 0.6)]:
        shares[0, at] = centers(BOXES)[box] / [96, 64, 96, 64]
        logits[0, at, kind] = np.log(score / (1 - score))
        if softmax:
            logits[0, at, 3] = 0.0
    return [logits, shares]


def ended():
    found = np.zeros((1, 10, 6))
    found[0, :2] = np.concatenate([BOXES, SCORES[:, None], CLASSES[:, None]], 1)
    return [found]


LAYOUTS = {
    "YOLOv5": (["output"], [rows(3 * COUNT)[None]]),
    "YOLOX plain": (["output"], [plain_yolox()[None]]),
    "YOLOX decoded": (["output"], [decoded_yolox()[None]]),
    "YOLOv8": (["output0"], [rows(COUNT, objectness=False).T[None]]),
    "YOLOv10": (["output0"], ended()),
    "DETR softmax": (["logits", "pred_boxes"], detr(True)),
    "DETR sigmoid": (["pred_boxes", "logits"], detr(False)[::-1]),
    "SSD pixels": (["boxes", "labels", "scores"], [BOXES, CLASSES, SCORES]),
    "SSD shares": (
        ["num_detections", "detection_boxes:0", "detection_scores:0", "detection_classes:0"],
        [np.array([2.0]), (BOXES / [96, 64, 96, 64])[None][..., [1, 0, 3, 2]], SCORES[None], CLASSES[None].astype(float)],
    ),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_hold_the_same_boxes(name):
    names, outputs = LAYOUTS[name]
    outputs = [output.astype(np.float32) for output in outputs]
    layout = detect.layout_of(names, outputs, SIZE)
    assert layout == name.split()[0]
    boxes, scores, classes = detect.detections(layout, names, outputs, SIZE, 0.3)
    order = np.argsort(-scores)
    assert np.allclose(boxes[order], BOXES, atol=1e-3), boxes
    assert np.allclose(scores[order], SCORES, atol=1e-4)
    assert (classes[order] == CLASSES).all()


def test_other_outputs_are_refused_with_their_shapes():
    for outputs in ([np.zeros((1, 7, 8, 9))], [np.zeros((1, 1000))], [np.zeros((1, 5, 4)), np.zeros((1, 6, 3))]):
        with pytest.raises(detect.DetectorError, match=str(outputs[0].shape[-1])):
            detect.layout_of(["a", "b"], outputs, SIZE)


def test_images_keep_their_shape_and_mean():
    image = np.zeros((40, 120, 3), np.uint8)
    image[10:20, 30:60] = [200, 100, 0]
    canvas, place = detect.boxed(image, 64, 96, True)
    assert place.tolist() == [0.8, 0.8, 0.0, 16.0]
    assert (canvas[:16] == detect.GRAY).all() and (canvas[48:] == detect.GRAY).all()
    assert abs(canvas[16:48, :, 0].mean() - image[..., 0].mean()) < 0.5
    assert np.array_equal(detect.resized(image, 40, 120), image.astype(np.float32))


def test_a_model_finds_what_is_red(tmp_path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    model = tmp_path / "red.onnx"
    onnx.save(red_cells(onnx), model)
    image = np.zeros((64, 96, 3), np.uint8)
    image[16:32, 40:48] = [255, 0, 0]
    head = json.dumps({"width": 96, "height": 64}).encode()
    command = [sys.executable, detect.__file__, str(model), "0.5", "auto"]
    run = lambda sent: subprocess.run(command, input=sent, capture_output=True, check=False)
    ran = run(head + b"\n" + image.tobytes())
    inputs, found = map(json.loads, ran.stdout.splitlines())
    assert inputs["inputs"] == [["images", ["1", "3", "64", "96"]]]
    assert found["layout"] == "YOLOv8"
    assert sorted(one["bbox"] for one in found["detections"]) == [[40.0, 16.0, 8.0, 8.0], [40.0, 24.0, 8.0, 8.0]]
    cut = run(head + b"\n" + image.tobytes()[:100])
    assert cut.returncode == 1 and b"cut off" in cut.stdout
    command[2] = __file__
    assert b"no model that onnxruntime runs" in run(b"").stdout


def red_cells(onnx):
    """A detector of one class: cells of 8 pixels, by how red they are."""
    helper, numpy_helper = onnx.helper, onnx.numpy_helper
    weights = {"red": np.array([20, -20, -20], np.float32).reshape(1, 3, 1, 1), "bias": np.array([-10], np.float32)}
    grid = np.mgrid[:8, :12][::-1].reshape(2, -1) * 8.0 + 4.0
    weights["boxes"] = np.concatenate([grid, np.full((2, 96), 8.0)])[None].astype(np.float32)
    weights["shape"] = np.array([1, 1, 96])
    nodes = [
        helper.make_node("AveragePool", ["images"], ["cells"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("Conv", ["cells", "red", "bias"], ["redness"]),
        helper.make_node("Sigmoid", ["redness"], ["score"]),
        helper.make_node("Reshape", ["score", "shape"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores"], ["output0"], axis=1),
    ]
    value = lambda name, shape: helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
    parts = [numpy_helper.from_array(array, name) for name, array in weights.items()]
    graph = helper.make_graph(nodes, "red", [value("images", [1, 3, 64, 96])], [value("output0", [1, 5, 96])], parts)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
