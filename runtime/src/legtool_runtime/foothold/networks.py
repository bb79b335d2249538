"""The foothold networks on the robot: ONNX models that propose footholds and predict safe-foothold functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import BundleError
from legtool_runtime.foothold.basis import RadialBasis
from legtool_runtime.foothold.criteria.criteria import Criteria
from legtool_runtime.foothold.criteria.rules import COARSE, COARSE_COUNTS, COARSE_TILTED
from legtool_runtime.foothold.features import FEATURES, HIPS, Inputs, Kind, encode
from legtool_runtime.foothold.gait import Gait, hip_velocity
from legtool_runtime.foothold.heightmap import nearest_safe
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, CriteriaSettings, hip_heights
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.onnx_session import OnnxSession
from legtool_runtime.robot import Robot

Array32 = NDArray[np.float32]
CELLS = SIZE * SIZE
#: A cell counts as safe for the dense network from this probability on: what lies between is left to caution.
SAFE_FROM = 0.8
#: Kinds of network: the paper's CNN of the task, and ours that predicts the safe map and serves both tasks.
KINDS = ("paper", "dense")


def foothold_interface() -> dict[str, Any]:
    """Names and units of the networks' inputs, and the instants that coarse checks look at.

    Part of the line's description, and to be the same.
    """
    return {
        "features": [name for name, _ in FEATURES],
        "glances": [list(instants) for instants in (COARSE, COARSE_TILTED, COARSE_COUNTS)],
        "size": SIZE,
        "resolution_m": RESOLUTION_M,
    }


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
        coarse: tuple[int, ...],
        criteria: CriteriaSettings | None,
        outputs: int,
        threads: int,
    ) -> None:
        self.robot, self.dense, self._kind = robot, kind == "dense", kind
        self.criteria = criteria or CriteriaSettings.for_robot(robot)
        self._exact = Criteria(robot, self.criteria)
        self._session = OnnxSession(onnx, what="foothold network", error=BundleError, threads=threads)
        self._check(_probe(None if self.dense else coarse), outputs)

    def __str__(self) -> str:
        return f"the {'dense' if self.dense else 'paper'} network"

    def _check(self, probe: dict[str, Array32], outputs: int) -> None:
        """Refuse a model that does not take such inputs, or give so many numbers for each sample, all finite."""
        inputs = {port.name: port for port in self._session.inputs}
        if inputs.keys() != probe.keys() or not all(inputs[name].fits(x.shape) for name, x in probe.items()):
            takes = "; ".join(str(port) for port in self._session.inputs)
            expected = ", ".join(f"{name} ({', '.join(['n', *map(str, x.shape[1:])])})" for name, x in probe.items())
            raise BundleError(f"foothold network: takes {takes}; expected {expected}")
        out = self._session.probe(probe)
        if len(out) != 1 or len(out[0]) != 1 or out[0].size != outputs:
            raise BundleError(
                f"foothold network: gives {' and '.join(str(x.shape) for x in out)} for a sample, expected {outputs} "
                "numbers; is it the network of another task?"
            )
        if not np.isfinite(out[0]).all():
            raise BundleError(
                "foothold network: what it gives for flat ground is not finite: its training diverged, or its file is "
                "damaged; train it anew and export that run"
            )

    def _run(self, tuples: Sequence[Tuple]) -> tuple[Inputs, Array32]:
        inputs = encode(self._exact, self._kind, tuples)
        (out,) = self._session.run(inputs.fed())
        return inputs, out


def _probe(coarse: tuple[int, ...] | None) -> dict[str, Array32]:
    """What is fed to see what a model gives: flat ground, a vector of usual sizes, and a coarse check of nothing."""
    vector = np.array([[size for _, size in FEATURES]], np.float32)
    checked = None if coarse is None else np.zeros((1, *coarse), np.float32)
    return Inputs(np.zeros((1, 1, SIZE, SIZE), np.float32), vector, checked, np.zeros(1, np.float32)).fed()


class FootholdNetwork(_Network):
    """Proposes footholds: the paper's CNN, or the dense one with the nearest of its safe cells."""

    def __init__(
        self, robot: Robot, onnx: bytes, *, dense: bool, criteria: CriteriaSettings | None = None, threads: int = 1
    ) -> None:
        """Take the model, and what it was trained for; ``criteria`` None: the robot's by default.

        Raises:
            BundleError: the model cannot be read, is of another task, or gives values that are not finite.
        """
        kind: Kind = "dense" if dense else "vfa"
        outputs, coarse = CELLS if dense else CELLS + 1, (SIZE, SIZE)
        super().__init__(robot, onnx, kind=kind, coarse=coarse, criteria=criteria, outputs=outputs, threads=threads)

    def __str__(self) -> str:
        return f"foothold selection by {super().__str__()}"

    def warm_up(self) -> None:
        """Compile what is compiled, or load it, and run the network once."""
        flat, twist = np.zeros((SIZE, SIZE), np.float32), (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.propose(Tuple(flat, leg=0, hip_height=0.5, base_twist=twist, gait=Gait(), nominal=(0.0, 0.0)))

    def propose(self, t: Tuple) -> tuple[int, int] | None:
        """The cell ix, iy to step on; None: the network sees no safe one. See :class:`.selection.Proposer`.

        Values that are not finite speak for no cell: a network that gives them sees none.
        """
        _, (out,) = self._run([t])
        right = t.leg % 2 == 1
        if not self.dense:
            best = int(out.argmax())
            ix, iy = divmod(best, SIZE)
            none = best == CELLS or not np.isfinite(out).all()
            return None if none else (ix, SIZE - 1 - iy if right else iy)
        safe = (out >= SAFE_FROM) & np.isfinite(out)
        safe = safe[:, ::-1] if right else safe
        direction = hip_velocity(self.robot, t.leg, t.base_twist, roll=t.roll, pitch=t.pitch)
        return nearest_safe(safe & ~np.isnan(t.heights), direction)


class CountNetwork(_Network):
    """Predicts the weights of safe-foothold functions: the paper's CNN, or the dense one's counts."""

    def __init__(
        self, robot: Robot, onnx: bytes, *, dense: bool, criteria: CriteriaSettings | None = None, threads: int = 1
    ) -> None:
        """Take the model, and what it was trained for; ``criteria`` None: the robot's by default.

        Raises:
            BundleError: the model cannot be read, is of another task, or gives values that are not finite.
        """
        self._hips = hip_heights(robot, HIPS)
        self._basis = RadialBasis(float(self._hips[0]), float(self._hips[-1]))
        self._functions = self._basis.functions(self._hips)
        kind: Kind = "dense" if dense else "vpa"
        outputs = HIPS if dense else self._basis.count
        super().__init__(robot, onnx, kind=kind, coarse=(2, HIPS), criteria=criteria, outputs=outputs, threads=threads)

    def __str__(self) -> str:
        return f"safe footholds over hip heights by {super().__str__()}"

    def warm_up(self) -> None:
        """Compile what is compiled, or load it, and run the network once."""
        flat, twist = np.zeros((SIZE, SIZE), np.float32), (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.weights([Tuple(flat, leg=leg, base_twist=twist, gait=Gait()) for leg in range(4)])

    def counts(self, tuples: Sequence[Tuple]) -> NDArray[np.float64]:
        """(n, 31) numbers of safe footholds over the set of hip heights, for maps below hips.

        Where the network gives a value that is not finite for a map, it has no safe footholds.
        """
        inputs, out = self._run(tuples)
        with np.errstate(invalid="ignore", over="ignore"):
            above = out if self.dense else out @ self._functions.T
        above = np.where(np.isfinite(above).all(axis=1, keepdims=True), above, 0.0)
        # Predicted above each map's median; asked for above the maps' common reference.
        shifted = [np.interp(self._hips - m, self._hips, c) for c, m in zip(above, inputs.median, strict=True)]
        return np.clip(np.array(shifted, dtype=np.float64), 0, CELLS)

    def weights(self, tuples: Sequence[Tuple]) -> NDArray[np.float64]:
        """(n, E) weights w of the safe-foothold functions. See :class:`.pose.Counter`."""
        return self._basis.fit(self._hips, self.counts(tuples))
