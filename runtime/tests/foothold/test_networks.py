import numpy as np
import pytest
from onnx_writer import FLOAT, model, node

from legtool_runtime.errors import BundleError
from legtool_runtime.foothold import Criteria, Gait, Tuple
from legtool_runtime.foothold.features import COARSE_INPUT, FEATURES
from legtool_runtime.foothold.networks import CELLS, CountNetwork, FootholdNetwork
from legtool_runtime.foothold.pose import PosePlanner
from legtool_runtime.foothold.selection import FootholdSelector

TWIST = (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)
#: Functions of the heights h: the root of 0.25 - h, NaN above; and e to the power of 1000 h, which overflows there.
NAN = [node("Sub", ["limit", "flat"], "left"), node("Sqrt", ["left"], "x")]
INFINITE = [node("Mul", ["flat", "thousand"], "power"), node("Exp", ["power"], "x")]
FINITE = [node("Neg", ["flat"], "x")]


def network(task, values, *, dense=False):
    """A network whose outputs are ``values``, functions of each cell's height, as many as the task's networks give."""
    inputs = {"heights": ("n", 1, 33, 33), "vector": ("n", len(FEATURES))}
    if not dense:
        inputs[COARSE_INPUT] = ("n", 33, 33) if task == "vfa" else ("n", 2, 31)
    shape = {"vfa": (33, 33) if dense else (CELLS + 1,), "vpa": (31,) if dense else (30,)}[task]
    count = int(np.prod(shape))
    constants = {
        "cells": np.array([-1, CELLS], np.int64),
        "begin": np.array([0], np.int64),
        "one": np.array([1], np.int64),
        "end": np.array([min(count, CELLS)], np.int64),
        "axis": np.array([1], np.int64),
        "shape": np.array([-1, *shape], np.int64),
        "limit": np.array(0.25, np.float32),
        "thousand": np.array(1000, np.float32),
    }
    nodes = [
        node("Reshape", ["heights", "cells"], "flat"),
        *values,
        node("Slice", ["x", "begin", "end", "axis"], "some"),
    ]
    if count > CELLS:  # one more, for "no cell is safe": below all others
        nodes += [
            node("Slice", ["flat", "begin", "one", "axis"], "first"),
            node("Sub", ["first", "thousand"], "none"),
            node("Concat", ["some", "none"], "all", axis=1),
        ]
    nodes.append(node("Reshape", ["all" if count > CELLS else "some", "shape"], "out"))
    return model(nodes, inputs, {"out": (FLOAT, ("n", *shape))}, constants)


def around(heights):
    return Tuple(heights, leg=0, hip_height=0.56, base_twist=TWIST, gait=Gait(), nominal=(0.0, 0.0))


def with_block():
    """Level ground, and one block on which the models give what is not finite."""
    heights = np.zeros((33, 33), np.float32)
    heights[10:14, 14:18] = 0.4
    return heights


@pytest.mark.parametrize("values", [NAN, INFINITE])
@pytest.mark.parametrize("dense", [False, True])
def test_what_is_not_finite_is_never_taken_for_a_foothold(robots, values, dense):
    proposer = FootholdNetwork(robots[0], network("vfa", values, dense=dense), dense=dense)
    cell = proposer.propose(around(with_block()))
    if dense:
        assert cell is None or with_block()[cell] == 0
    else:
        assert cell is None
    selector = FootholdSelector(Criteria(robots[0]), method="cnn", network=proposer)
    assert selector.select(around(with_block())).cell == cell


@pytest.mark.parametrize("values", [NAN, INFINITE])
@pytest.mark.parametrize("dense", [False, True])
def test_what_is_not_finite_counts_no_footholds(robots, values, dense):
    counter = CountNetwork(robots[0], network("vpa", values, dense=dense), dense=dense)
    spoilt = np.zeros((33, 33), np.float32)
    spoilt[0, :] = 0.4
    maps = [Tuple(h, leg=leg, base_twist=TWIST, gait=Gait()) for leg, h in enumerate([np.zeros((33, 33)), spoilt])]
    level, counted = counter.counts(maps)
    assert (level > 0).any() and (counted == 0).all()
    weights = counter.weights([maps[1]] * 4)
    assert np.isfinite(weights).all()
    planner = PosePlanner(Criteria(robots[0]), network=counter)
    assert np.isfinite(planner.optimise(np.stack([weights, weights]), [0.0, 0.0]).objective)


@pytest.mark.parametrize("dense", [False, True])
def test_a_network_that_gives_nothing_finite_on_flat_ground_is_refused(robots, dense):
    below = [node("Sub", ["flat", "limit"], "less"), node("Sqrt", ["less"], "x")]
    by_zero = [node("Sub", ["flat", "flat"], "zero"), node("Div", ["limit", "zero"], "x")]
    for values in (below, by_zero):
        with pytest.raises(BundleError, match=r"for flat ground is not finite.*train it anew and export"):
            FootholdNetwork(robots[0], network("vfa", values, dense=dense), dense=dense)
        with pytest.raises(BundleError, match=r"for flat ground is not finite"):
            CountNetwork(robots[0], network("vpa", values, dense=dense), dense=dense)


def test_a_network_of_another_task_is_refused(robots):
    with pytest.raises(BundleError, match=r"takes .*; expected heights .*, glance \(n, 33, 33\)"):
        FootholdNetwork(robots[0], network("vpa", FINITE), dense=False)
    with pytest.raises(BundleError, match=r"gives \(1, 31\) for a sample, expected 1089 numbers"):
        FootholdNetwork(robots[0], network("vpa", FINITE, dense=True), dense=True)
    with pytest.raises(BundleError, match="foothold network: not an ONNX model"):
        FootholdNetwork(robots[0], b"no", dense=False)
