from __future__ import annotations

import pytest

from legtool.configs.robots import load_robot
from legtool.sim.robots.robot import SimRobot, build_robot


@pytest.fixture(scope="session", params=["aliengo", "go2", "hyq"])
def any_robot(request: pytest.FixtureRequest) -> SimRobot:
    return build_robot(load_robot(request.param))


@pytest.fixture(scope="session")
def aliengo() -> SimRobot:
    return build_robot(load_robot("aliengo"))
