"""The foothold networks on the robot: ONNX models that propose footholds and predict safe-foothold functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import BundleError
from legtool_runtime.foothold.basis import RadialBasis
from legtool_runtime.foothold.criteria.criteria import GLANCE, GLANCE_COUNTS, Criteria
from legtool_runtime.foothold.features import FEATURES, HIPS, Inputs, Kind, encode
from legtool_runtime.foothold.gait import Gait, hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, CriteriaSettings, hip_heights
from legtool_runtime.robot import Robot

Array32 = NDArray[np.float32]
CELLS = SIZE * SIZE
#: A cell counts as safe for the dense network from this probability on: what lies between is left to caution.
SAFE_FROM = 0.8
#: Kinds of network: the paper's CNN of the task, and ours that predicts the safe map and serves both tasks.
KINDS = ("paper", "dense")


def foothold_interface() -> dict[str, Any]:
    """Names and units of the networks' inputs, and the instants that first guesses look at.

    Part of the line's description, and to be the same.
    """
    return {
        "features": [name for name, _ in FEATURES],
        "glances": [list(GLANCE), list(GLANCE_COUNTS)],
        "size": SIZE,
        "resolution_m": RESOLUTION_M,
    }


def _session(onnx: bytes, glance: tuple[int, ...] | None, outputs: int, threads: int) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(onnx, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise BundleError(f"foothold network: not an ONNX model ({' '.join(str(error).split())[:80]})") from error
    heights, vector = np.zeros((1, 1, SIZE, SIZE), np.float32), np.ones((1, len(FEATURES)), np.float32)
    guess = None if glance is None else np.zeros((1, *glance), np.float32)
    inputs = Inputs(heights, vector, guess, np.zeros(1, np.float32)).fed()
    try:
        (out,) = session.run(None, inputs)
    except Exception as error:
        expected = ", ".join(f"{name} ({', '.join(['n', *map(str, x.shape[1:])])})" for name, x in inputs.items())
        raise BundleError(
            f"foothold network: does not take {expected} ({' '.join(str(error).split())[:80]})"
        ) from error
    if out.size != outputs:
        raise BundleError(f"foothold network: gives {out.size} numbers a sample, expected {outputs}")
    return session


class _Network:
    """A model, for whom it was trained and on whose judgement.

    Attributes:
        robot: whose footholds it learned.
        criteria: the thresholds that its labels were judged by.
        dense: whether it is the dense network, not the paper's.
    """

    def __init__(
        self,
        robot: Robot,
        onnx: bytes,
        *,
        kind: Kind,
        glance: tuple[int, ...],
        criteria: CriteriaSettings | None,
        outputs: int,
        threads: int,
    ) -> None:
        self.robot, self.dense, self._kind = robot, kind == "dense", kind
        self.criteria = criteria or CriteriaSettings.for_robot(robot)
        self._judge = Criteria(robot, self.criteria)
        self._run = _session(onnx, None if self.dense else glance, outputs, threads).run

    def __str__(self) -> str:
        return f"the {'dense' if self.dense else 'paper'} network"


class FootholdNetwork(_Network):
    """Proposes footholds: the paper's CNN, or the dense one with the nearest of its safe cells."""

    def __init__(
        self, robot: Robot, onnx: bytes, *, dense: bool, criteria: CriteriaSettings | None = None, threads: int = 1
    ) -> None:
        """Take the model, and what it was trained for; ``criteria`` None: the robot's by default.

        Raises:
            BundleError: the model cannot be read, or is of another task.
        """
        kind: Kind = "dense" if dense else "vfa"
        outputs, glance = CELLS if dense else CELLS + 1, (SIZE, SIZE)
        super().__init__(robot, onnx, kind=kind, glance=glance, criteria=criteria, outputs=outputs, threads=threads)

    def __str__(self) -> str:
        return f"foothold selection by {super().__str__()}"

    def warm_up(self) -> None:
        """Compile what is compiled, or load it, and run the network once."""
        flat = np.zeros((SIZE, SIZE), np.float32)
        twist, nominal = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0)
        self.propose(flat, leg=0, hip_height=0.5, base_twist=twist, gait=Gait(), nominal=nominal)

    def propose(
        self,
        heights: Array32,
        *,
        leg: int,
        hip_height: float,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float],
    ) -> tuple[int, int] | None:
        """The cell ix, iy to step on; None: the network sees no safe one. See :class:`.selection.Proposer`."""
        inputs = encode(
            self._judge,
            self._kind,
            heights=np.asarray(heights)[None],
            leg=[leg],
            hip_height=[hip_height],
            base_twist=[base_twist],
            gait=[_alpha(gait)],
            nominal=[nominal],
            vpa=[0],
        )
        (out,) = self._run(None, inputs.fed())
        if not self.dense:
            best = int(out[0].argmax())
            ix, iy = divmod(best, SIZE)
            return None if best == CELLS else (ix, SIZE - 1 - iy if leg % 2 == 1 else iy)
        safe = out[0] >= SAFE_FROM
        if leg % 2 == 1:
            safe = safe[:, ::-1]
        return nearest_safe(safe & ~np.isnan(heights), hip_velocity(self.robot, leg, base_twist))


class CountNetwork(_Network):
    """Predicts the weights of safe-foothold functions: the paper's CNN, or the dense one's counts."""

    def __init__(
        self, robot: Robot, onnx: bytes, *, dense: bool, criteria: CriteriaSettings | None = None, threads: int = 1
    ) -> None:
        """Take the model, and what it was trained for; ``criteria`` None: the robot's by default.

        Raises:
            BundleError: the model cannot be read, or is of another task.
        """
        self._hips = hip_heights(robot, HIPS)
        self._basis = RadialBasis(float(self._hips[0]), float(self._hips[-1]))
        self._functions = self._basis.functions(self._hips)
        kind: Kind = "dense" if dense else "vpa"
        outputs = HIPS if dense else self._basis.count
        super().__init__(robot, onnx, kind=kind, glance=(2, HIPS), criteria=criteria, outputs=outputs, threads=threads)

    def __str__(self) -> str:
        return f"safe footholds over hip heights by {super().__str__()}"

    def warm_up(self) -> None:
        """Compile what is compiled, or load it, and run the network once."""
        flat = [np.zeros((SIZE, SIZE), np.float32)] * 4
        self.weights(flat, legs=[0, 1, 2, 3], base_twist=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0), gait=Gait())

    def counts(
        self, heights: Sequence[Array32], *, legs: Sequence[int], base_twist: Sequence[float], gait: Gait
    ) -> NDArray[np.float64]:
        """(n, 31) numbers of safe footholds over the set of hip heights, for maps below hips."""
        n = len(heights)
        inputs = encode(
            self._judge,
            self._kind,
            heights=np.stack(heights),
            leg=legs,
            hip_height=np.zeros(n),
            base_twist=np.tile(np.asarray(base_twist, dtype=np.float64), (n, 1)),
            gait=np.tile(_alpha(gait), (n, 1)),
            nominal=np.zeros((n, 2)),
            vpa=np.ones(n),
        )
        (out,) = self._run(None, inputs.fed())
        above = out if self.dense else out @ self._functions.T
        # Predicted above each map's median; asked for above the maps' common reference.
        shifted = [np.interp(self._hips - m, self._hips, c) for c, m in zip(above, inputs.median, strict=True)]
        return np.clip(np.array(shifted, dtype=np.float64), 0, CELLS)

    def weights(
        self, heights: Sequence[Array32], *, legs: Sequence[int], base_twist: Sequence[float], gait: Gait
    ) -> NDArray[np.float64]:
        """(n, E) weights w of the safe-foothold functions. See :class:`.pose.Counter`."""
        return self._basis.fit(self._hips, self.counts(heights, legs=legs, base_twist=base_twist, gait=gait))


def _alpha(gait: Gait) -> NDArray[np.float64]:
    return np.array([gait.step_length_m, gait.step_frequency_hz, gait.duty_factor, gait.time_to_touchdown_s])
