"""Writes the tiny networks of networks/, whose outputs are known: python make_networks.py (needs onnx and numpy).

blocks.onnx   finds, for every pixel, the displacement of at most 3 px whose 7 x 7 block differs least
matcher.onnx  gives the same displacements at a lattice of positions, as pairs; every second one is marked as not found
broken.onnx   gives NaN, half a size, and no batch
fixed.onnx    takes pictures of 32 x 24 only, and says that all moved by (2, 1)
"""

from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

HERE = Path(__file__).parent / "networks"
REACH = 3
BLOCK = 7
STEP = 8


def constant(name, values, kind):
    return numpy_helper.from_array(np.asarray(values, kind), name)


def picture(name, height="H", width="W"):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, height, width])


def output(name, shape, kind=TensorProto.FLOAT):
    return helper.make_tensor_value_info(name, kind, shape)


def write(name, nodes, inputs, outputs, constants):
    graph = helper.make_graph(nodes, name, inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    checker.check_model(model)
    HERE.mkdir(exist_ok=True)
    save(model, str(HERE / f"{name}.onnx"))


def block_matching():
    """Nodes and constants from `before` and `now` to `flow` (1, 2, H, W)."""
    displacements = [(u, v) for v in range(-REACH, REACH + 1) for u in range(-REACH, REACH + 1)]
    # Of equal blocks the first wins: the displacement of least length.
    displacements.sort(key=lambda d: (d[0] ** 2 + d[1] ** 2, d))
    end = np.iinfo(np.int64).max
    constants = [
        constant("pads", [0, 0, REACH, REACH, 0, 0, REACH, REACH], np.int64),
        constant("axes", [2, 3], np.int64),
        constant("displacements", displacements, np.float32),
    ]
    nodes = [helper.make_node("Pad", ["now", "pads"], ["wide"], mode="edge")]
    costs = []
    for i, (u, v) in enumerate(displacements):
        ends = [end if d == REACH else d - REACH for d in (v, u)]
        constants += [constant(f"from{i}", [REACH + v, REACH + u], np.int64), constant(f"to{i}", ends, np.int64)]
        nodes += [
            helper.make_node("Slice", ["wide", f"from{i}", f"to{i}", "axes"], [f"moved{i}"]),
            helper.make_node("Sub", ["before", f"moved{i}"], [f"difference{i}"]),
            helper.make_node("Abs", [f"difference{i}"], [f"absolute{i}"]),
            helper.make_node("ReduceMean", [f"absolute{i}"], [f"grey{i}"], axes=[1], keepdims=1),
            helper.make_node(
                "AveragePool", [f"grey{i}"], [f"cost{i}"], kernel_shape=[BLOCK, BLOCK], pads=[BLOCK // 2] * 4
            ),
        ]
        costs.append(f"cost{i}")
    nodes += [
        helper.make_node("Concat", costs, ["costs"], axis=1),
        helper.make_node("ArgMin", ["costs"], ["best"], axis=1, keepdims=0),
        helper.make_node("Gather", ["displacements", "best"], ["chosen"], axis=0),
        helper.make_node("Transpose", ["chosen"], ["flow"], perm=[0, 3, 1, 2]),
    ]
    return nodes, constants


def main():
    nodes, constants = block_matching()
    inputs = [picture("before"), picture("now")]
    write("blocks", nodes, inputs, [output("flow", [1, 2, "H", "W"])], constants)

    # Row, column.
    lattice = [(y, x) for y in range(STEP, 40, STEP) for x in range(STEP, 56, STEP)]
    rows = [(0, y, x) for y, x in lattice]
    found = [i if i % 2 == 0 else -1 for i in range(len(lattice))]
    constants = [
        *constants,
        constant("lattice", rows, np.int64),
        constant("positions", [(x, y) for y, x in lattice], np.float32),
        constant("found", found, np.int64),
    ]
    nodes = [
        *nodes[:-1],
        helper.make_node("GatherND", ["chosen", "lattice"], ["displacement"]),
        helper.make_node("Add", ["positions", "displacement"], ["second"]),
        helper.make_node("Identity", ["positions"], ["first"]),
        helper.make_node("Identity", ["found"], ["matches"]),
    ]
    outputs = [
        output("first", [len(lattice), 2]),
        output("second", [len(lattice), 2]),
        output("matches", [len(lattice)], TensorProto.INT64),
    ]
    write("matcher", nodes, inputs, outputs, constants)

    constants = [
        constant("zero", 0, np.float32),
        constant("axis", [0], np.int64),
        constant("two", [0, 1], np.int64),
    ]
    nodes = [
        helper.make_node("Concat", ["before", "now"], ["six"], axis=1),
        helper.make_node("Split", ["six"], ["nothing", "unused"], axis=1),
        helper.make_node("Mul", ["nothing", "zero"], ["none"]),
        helper.make_node("Gather", ["none", "two"], ["pair"], axis=1),
        helper.make_node("Div", ["pair", "zero"], ["nan"]),
        helper.make_node("AveragePool", ["none"], ["half"], kernel_shape=[2, 2], strides=[2, 2]),
        helper.make_node("Squeeze", ["none", "axis"], ["three"]),
    ]
    outputs = [
        output("nan", [1, 2, "H", "W"]),
        output("half", [1, 3, "h", "w"]),
        output("three", [3, "H", "W"]),
    ]
    write("broken", nodes, inputs, outputs, constants)

    motion = np.broadcast_to(np.array([2, 1], np.float32)[None, :, None, None], (1, 2, 24, 32))
    constants = [constant("zero", 0, np.float32), constant("motion", motion, np.float32)]
    nodes = [
        helper.make_node("ReduceMean", ["both"], ["mean"], axes=[1, 2, 3], keepdims=1),
        helper.make_node("Mul", ["mean", "zero"], ["none"]),
        helper.make_node("Add", ["motion", "none"], ["flow"]),
    ]
    both = helper.make_tensor_value_info("both", TensorProto.FLOAT, [1, 6, 24, 32])
    write("fixed", nodes, [both], [output("flow", [1, 2, 24, 32])], constants)


if __name__ == "__main__":
    main()
