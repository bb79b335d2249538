"""A robot of ANYmal C's size with masses on every link, and walks for it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

# Tests are imported by path, not as a package.
sys.path.insert(0, str(Path(__file__).parent))

from legtool_runtime import Robot
from legtool_runtime.search.swings.optimiser import SwingOptimiser
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot


def heavy(geometry: Robot) -> TrackedRobot:
    """A robot of 45 kg; nothing about it is symmetric but the masses of its legs."""
    links = np.zeros((4, 3, 3))
    for leg in range(4):
        side = 1.0 if leg in (0, 2) else -1.0
        links[leg] = [[0.01, 0.02 * side, 0.0], [0.01, -0.05 * side, -0.12], [0.03, 0.0, -0.10]]
    inertia = np.tile(np.diag([0.03, 0.03, 0.004]), (4, 3, 1, 1))
    inertia[:, :, 0, 1] = inertia[:, :, 1, 0] = 0.002
    return TrackedRobot(
        geometry=geometry,
        trunk_mass=19.2,
        trunk_com=np.array([0.01, -0.004, 0.05]),
        trunk_inertia=np.array([[0.22, 0.01, 0.0], [0.01, 0.64, -0.02], [0.0, -0.02, 0.62]]),
        link_mass=np.tile([2.8, 3.0, 0.6], (4, 1)),
        link_com=links,
        link_inertia=inertia,
        armature=np.full((4, 3), 0.02),
        joint_friction=np.full((4, 3), 0.1),
        joint_damping=np.full((4, 3), 1.0),
        torque_limit=np.full((4, 3), 80.0),
    )


@pytest.fixture(scope="session")
def walker(anymal: Robot) -> TrackedRobot:
    return heavy(anymal)


@pytest.fixture(scope="session")
def optimiser(walker: TrackedRobot) -> SwingOptimiser:
    return SwingOptimiser(walker)


@pytest.fixture(scope="session")
def trot(walker: TrackedRobot) -> Callable[..., ContactPlan]:
    """A trot over level ground from 0.3 s on; ``stride`` by leg, the ground's normal everywhere."""

    def make(steps: int = 3, stride: float = 0.12, normal: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> ContactPlan:
        feet = walker.geometry.stance * [1.0, 1.0, 0.0]
        rows = [np.stack([np.add(f, (stride * i, 0.0, 0.0)) for i in range(steps)]) for f in feet]
        return plan_from_gait(GaitTiming.trot(), rows, start_s=0.3, normals=[np.tile(normal, (steps, 1))] * 4)

    return make
