"""One strategy's walk over one of ViTAL's courses, and its file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.files import replacing
from legtool.sim.walks.kinematic import Posture, StepCount

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """A walk of n poses, and what MuJoCo saw on its steps.

    Attributes:
        x: (n,) of the trunk [m].
        pose: (n, 3) height in the world [m], roll, pitch [rad].
        safe: (n, 4) exact numbers of safe footholds.
        around: (n, 4, 2) the same with hips lower and higher by the margin.
        ground: (2, k) x and height of the course below the trunk's path [m].
        steps: of all legs; ``blind``, ``collided`` and ``violated`` of them, see :class:`StepCount`.
        blind: steps without a safe foothold.
        collided: steps with a collision.
        violated: steps beyond the workspace.
        excess: farthest that a joint was beyond its limits [rad].
        frames: the robot here and there.
    """

    x: Array
    pose: Array
    safe: NDArray[np.int64]
    around: NDArray[np.int64]
    ground: Array = field(default_factory=lambda: np.zeros((2, 0)))
    steps: int = 0
    blind: int = 0
    collided: int = 0
    violated: int = 0
    excess: float = 0.0
    frames: Sequence[Posture] = ()

    def with_steps(self, count: StepCount, ground: Array) -> Trace:
        """The trace with what its steps came to."""
        return replace(
            self, ground=ground, steps=count.steps, blind=count.blind, collided=count.collided,
            violated=count.violated, excess=count.excess, frames=tuple(count.frames),
        )  # fmt: skip

    def save(self, path: Path) -> None:
        """Write it, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        counts = np.array([self.steps, self.blind, self.collided, self.violated])
        legs = np.array([frame.legs for frame in self.frames]).reshape(-1, 4, 4, 3)
        trunks = np.array([frame.trunk for frame in self.frames]).reshape(-1, 2, 3)
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file, x=self.x, pose=self.pose, safe=self.safe, around=self.around, ground=self.ground,
                counts=counts, excess=self.excess, legs=legs, trunks=trunks,
            )  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> Trace:
        """Read what :meth:`save` wrote."""
        with np.load(path, allow_pickle=False) as held:
            frames = tuple(Posture(legs, trunk) for legs, trunk in zip(held["legs"], held["trunks"], strict=True))
            steps, blind, collided, violated = (int(value) for value in held["counts"])
            return cls(
                held["x"], held["pose"], held["safe"], held["around"], held["ground"],
                steps, blind, collided, violated, float(held["excess"]), frames,
            )  # fmt: skip
