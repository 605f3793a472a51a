"""Agents that drive as recorded drivers did: a small network that is trained on tracks in a minute or two. Needs NumPy.

It learns one number, the acceleration, from what it is told of a vehicle and its leader (behavior cloning, with a squared error);
steering is left to the program, which keeps the vehicle to its way. Four steps:

    decouplegs realism traffic --tracks A.xml --agents "exec:python3 learned_agents.py record a.samples" --show-recording
    python3 learned_agents.py train a.samples b.samples --out model.npz
    decouplegs realism traffic --tracks C.xml --agents "exec:python3 learned_agents.py drive model.npz" --out gap
    decouplegs drive --level hard --planner lane-follow --agents "exec:python3 learned_agents.py drive model.npz" --step 0.1 --out run

`train --onnx model.onnx` also writes an ONNX file, which `--agents onnx:model.onnx` runs. It needs the package onnx.

It is an example, not a good model of drivers: it knows one leader, changes no lanes, has no memory, and minds no lights and no
speed limits unless the tracks that it learned from told of them. Copies of drivers drift: nothing here teaches it to come back.
"""

import argparse
import math
import sys

import decouplegs_planner
import numpy

#: Numbers that the network is told of a vehicle; the order is that of --agents onnx:MODEL.
FEATURES = 13
#: Distance that stands for none, meters.
NONE_M = 100.0
#: Number of a row of samples: vehicle, step, and the features.
ROW = 2 + FEATURES
#: Time over which the recorded acceleration is a mean, seconds: that of moments is mostly noise.
MEAN_S = 1.0
#: Limits of the acceleration, m/s^2: those of recorded drivers, nearly all of the time.
ACCELERATION_MPS2 = (-6.0, 3.0)


def curvature(way_m, at):
    """Turn of a way from before to behind its point `at`, over the length of the two parts, 1/m."""
    if at + 1 >= len(way_m):
        return 0.0
    (ax, ay), (bx, by), (cx, cy) = way_m[at - 1 : at + 2]
    turn_rad = math.atan2(cy - by, cx - bx) - math.atan2(by - ay, bx - ax)
    turn_rad -= 2.0 * math.pi * round(turn_rad / (2.0 * math.pi))
    return 2.0 * turn_rad / max(math.dist((ax, ay), (bx, by)) + math.dist((bx, by), (cx, cy)), 1e-6)


def features(agent):
    """Numbers that the network gets of an agent, in the order of --agents onnx:MODEL."""
    leader = agent.leader
    return [
        agent.speed_mps,
        agent.acceleration_mps2,
        NONE_M if leader is None else min(leader.gap_m, NONE_M),
        0.0 if leader is None else leader.speed_mps - agent.speed_mps,
        0.0 if leader is None else 1.0,
        agent.offset_m,
        agent.turn_rad,
        curvature(agent.way_m, 1),
        curvature(agent.way_m, 3),
        curvature(agent.way_m, 6),
        agent.limit_mps or 0.0,
        NONE_M if agent.stop_m is None else min(agent.stop_m, NONE_M),
        agent.size_m[0],
    ]


class Recorder(decouplegs_planner.AgentDriver):
    """Writes what it is told of vehicles on their tracks, and drives nobody."""

    name = "recorder"

    def __init__(self, path):
        self.file = open(path, "wb")

    def drive(self, observation):
        rows = [[agent.agent, observation.step, *features(agent)] for agent in observation.agents if agent.driven_by == "track"]
        numpy.asarray(rows, numpy.float32).tofile(self.file)
        self.file.flush()
        return []


class Learned(decouplegs_planner.AgentDriver):
    """Drives all agents by a network."""

    def __init__(self, path):
        self.network = dict(numpy.load(path))
        self.name = "learned"

    def drive(self, observation):
        if not observation.agents:
            return []
        inputs = numpy.asarray([features(agent) for agent in observation.agents], numpy.float32)
        outputs = forward(self.network, inputs)[-1][:, 0]
        return [(agent.agent, float(output)) for agent, output in zip(observation.agents, outputs)]


def forward(network, inputs):
    """Activations of all layers; the last are the accelerations."""
    layers = [(inputs - network["mean"]) / network["scale"]]
    for number in (1, 2):
        layers.append(numpy.tanh(layers[-1] @ network[f"w{number}"] + network[f"b{number}"]))
    layers.append(layers[-1] @ network["w3"] + network["b3"])
    return layers


def samples(paths, step_s=0.1):
    """Features of recorded vehicles, the mean acceleration of each over the next time, and numbers of the vehicles."""
    ahead = round(MEAN_S / step_s)
    inputs, targets, vehicles = [], [], []
    for number, path in enumerate(paths):
        try:
            rows = numpy.fromfile(path, numpy.float32)
        except OSError as error:
            sys.exit(f"{path} cannot be read: {error.strerror}; expected a file that `record` wrote")
        if rows.size == 0 or rows.size % ROW:
            sys.exit(f"{path} has {rows.size} numbers; expected rows of {ROW}, as `record` writes them")
        rows = rows.reshape(-1, ROW)
        rows = rows[numpy.lexsort((rows[:, 1], rows[:, 0]))]
        same = (rows[ahead:, 0] == rows[:-ahead, 0]) & (rows[ahead:, 1] == rows[:-ahead, 1] + ahead)
        inputs.append(rows[:-ahead][same, 2:])
        targets.append((rows[ahead:][same, 2] - rows[:-ahead][same, 2]) / MEAN_S)
        vehicles.append(rows[:-ahead][same, 0].astype(int) + (number << 20))
    inputs, targets, vehicles = map(numpy.concatenate, (inputs, targets, vehicles))
    if len(targets) < 1000:
        sys.exit(f"{len(targets)} samples are too few; expected 1000 or more: record longer tracks, or more of them")
    return inputs, numpy.clip(targets, *ACCELERATION_MPS2), vehicles


def train(paths, epochs, seed, width=32):
    """A network that is trained on the samples of `paths`, and its root mean square errors, beside that of the mean."""
    inputs, targets, vehicles = samples(paths)
    generator = numpy.random.default_rng(seed)
    # Samples of one vehicle are much alike: whole vehicles are held out.
    is_held = numpy.isin(vehicles, generator.permutation(numpy.unique(vehicles))[::10])
    kept, held = numpy.flatnonzero(~is_held), numpy.flatnonzero(is_held)
    scale = inputs[kept].std(axis=0)
    network = {"mean": inputs[kept].mean(axis=0), "scale": numpy.where(scale > 1e-6, scale, 1.0)}
    sizes = [FEATURES, width, width, 1]
    for number, (rows, columns) in enumerate(zip(sizes, sizes[1:]), 1):
        network[f"w{number}"] = generator.normal(0.0, rows**-0.5, (rows, columns))
        network[f"b{number}"] = numpy.zeros(columns)
    learned = [name for name in network if name[0] in "wb"]
    # Adam (Kingma and Ba, 2015).
    first = {name: numpy.zeros_like(network[name]) for name in learned}
    second = {name: numpy.zeros_like(network[name]) for name in learned}
    batch, steps = 512, 0
    for epoch in range(epochs):
        rate = 2e-3 * 0.5 * (1.0 + math.cos(math.pi * epoch / epochs))
        kept = generator.permutation(kept)
        for begin in range(0, len(kept), batch):
            chosen = kept[begin : begin + batch]
            layers = forward(network, inputs[chosen])
            error = 2.0 * (layers[-1] - targets[chosen, None]) / len(chosen)
            slopes = {}
            for number in (3, 2, 1):
                slopes[f"w{number}"] = layers[number - 1].T @ error
                slopes[f"b{number}"] = error.sum(axis=0)
                error = (error @ network[f"w{number}"].T) * (1.0 - layers[number - 1] ** 2)
            steps += 1
            for name in learned:
                first[name] += 0.1 * (slopes[name] - first[name])
                second[name] += 0.001 * (slopes[name] ** 2 - second[name])
                unbiased = first[name] / (1.0 - 0.9**steps)
                network[name] -= rate * unbiased / (numpy.sqrt(second[name] / (1.0 - 0.999**steps)) + 1e-8)
    found = forward(network, inputs[held])[-1][:, 0]
    errors = [float(numpy.sqrt(numpy.mean((guess - targets[held]) ** 2))) for guess in (found, targets[kept].mean())]
    return {name: value.astype(numpy.float32) for name, value in network.items()}, len(targets), errors


def write_onnx(network, path):
    """Writes a network as ONNX: input `vehicles` [N, 13], output `accelerations` [N, 1]."""
    import onnx
    from onnx import helper, numpy_helper

    nodes = [helper.make_node("Sub", ["vehicles", "mean"], ["moved"]), helper.make_node("Div", ["moved", "scale"], ["h0"])]
    for number in (1, 2, 3):
        nodes.append(helper.make_node("Gemm", [f"h{number - 1}", f"w{number}", f"b{number}"], [f"z{number}"]))
        if number < 3:
            nodes.append(helper.make_node("Tanh", [f"z{number}"], [f"h{number}"]))
    nodes[-1].output[0] = "accelerations"
    told = helper.make_tensor_value_info("vehicles", onnx.TensorProto.FLOAT, ["N", FEATURES])
    answer = helper.make_tensor_value_info("accelerations", onnx.TensorProto.FLOAT, ["N", 1])
    weights = [numpy_helper.from_array(value, name) for name, value in network.items()]
    graph = helper.make_graph(nodes, "learned agents", [told], [answer], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def main():
    parser = argparse.ArgumentParser(description="Agents that drive as recorded drivers did.")
    words = parser.add_subparsers(dest="word", required=True)
    words.add_parser("record", help="a driver of agents that writes samples and drives nobody").add_argument("samples")
    words.add_parser("drive", help="a driver of agents by a network").add_argument("model")
    training = words.add_parser("train", help="train a network on samples")
    training.add_argument("samples", nargs="+")
    training.add_argument("--out", required=True, metavar="MODEL.npz")
    training.add_argument("--onnx", metavar="MODEL.onnx")
    training.add_argument("--epochs", type=int, default=30)
    training.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    if chosen.word == "train":
        network, count, (error, spread) = train(chosen.samples, chosen.epochs, chosen.seed)
        numpy.savez(chosen.out, **network)
        if chosen.onnx:
            write_onnx(network, chosen.onnx)
        print(f"{count} samples; error on a tenth of the vehicles, which was held out: {error:.3f} m/s^2; of their mean: {spread:.3f} m/s^2")
        return
    driver = Recorder(chosen.samples) if chosen.word == "record" else Learned(chosen.model)
    # The driver has its own arguments.
    sys.argv[1:] = []
    decouplegs_planner.run(lambda: driver)


if __name__ == "__main__":
    main()
