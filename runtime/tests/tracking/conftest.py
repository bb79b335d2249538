"""Robots with masses on every link, random states of one, and single bodies of the presets' size."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from legtool_runtime import Robot
from legtool_runtime.tracking.dynamics import FullState
from legtool_runtime.tracking.model import TrackedRobot

# Tests are imported by path, not as a package.
sys.path.insert(0, str(Path(__file__).parent))

from stones_and_bodies import BODIES


@pytest.fixture(scope="session")
def bodies():
    return BODIES


@pytest.fixture(scope="session")
def anymal():
    return BODIES["anymal_c"][0]


@pytest.fixture(scope="session")
def tracked(robot: Robot) -> TrackedRobot:
    rng = np.random.default_rng(0)

    def inertia(*lead: int) -> np.ndarray:
        half = rng.normal(size=(*lead, 3, 3))
        return np.einsum("...ij,...kj->...ik", half, half) + np.eye(3)

    return TrackedRobot(
        geometry=robot,
        trunk_mass=9.0,
        trunk_com=np.array([0.02, -0.005, 0.01]),
        trunk_inertia=0.05 * inertia(),
        link_mass=rng.uniform(0.4, 1.2, (4, 3)),
        link_com=rng.uniform(-0.05, 0.05, (4, 3, 3)),
        link_inertia=0.002 * inertia(4, 3),
        armature=np.full((4, 3), 0.01),
        joint_friction=np.full((4, 3), 0.2),
        joint_damping=np.full((4, 3), 0.1),
        torque_limit=np.full((4, 3), 40.0),
    )


@pytest.fixture(scope="session")
def random_state(robot: Robot) -> Callable[..., FullState]:
    rest, _ = robot.joints(robot.stance)

    def make(rng: np.random.Generator, speed: float = 1.0, bend: float = 0.4) -> FullState:
        orientation = rng.normal(size=4)
        return FullState(
            rng.normal(size=3),
            orientation / np.linalg.norm(orientation),
            rest + rng.uniform(-bend, bend, (4, 3)),
            speed * rng.normal(size=18),
        )

    return make
