"""Missteps are judged on the true state by the world's own judge of ground."""

import numpy as np
import pytest

from legtool.sim.walks.loop import run_trial
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.planners import BlindPlanner


class Still:
    """Holds the robot by nothing: the test places it."""

    def reset(self, state) -> None: ...

    def accepts_command(self) -> bool:
        return True

    def step(self, state, command):
        return np.zeros(12)


def test_a_blind_walk_into_a_gap_has_missteps_in_the_gap(make) -> None:
    environment = make(start=(0.2, 0.0, 0.0), timeout_s=12.0)
    missteps = Missteps(environment)
    run_trial(environment, BlindPlanner(0.5), [missteps])
    assert missteps.found
    time_s, x, y, leg = missteps.found[0]
    assert 1.1 < x < 1.4 and abs(y) < 0.4 and 1.0 < time_s < 12.0 and leg in range(4)


def test_standing_on_level_ground_is_no_misstep(make) -> None:
    environment = make(timeout_s=1.0)
    missteps = Missteps(environment)
    run_trial(environment, BlindPlanner(0.0), [missteps])
    assert not missteps.found


@pytest.mark.parametrize(("x", "near"), [(1.193, True), (1.205, False), (1.15, False)])
def test_a_foot_that_stands_within_a_centimetre_of_an_edge_is_noted_once(make, monkeypatch, x, near) -> None:
    """The gap begins at x = 1.2 m; a foot beyond it is a misstep, and near no edge of ground that it stands on."""
    environment = make(timeout_s=1.0)
    missteps = Missteps(environment)
    feet, forces = environment.feet()
    feet[1] = (x, 0.1, 0.0)
    forces = np.full(4, 0.25 * environment.simulation.robot.mass * 9.81)
    monkeypatch.setattr(environment, "feet", lambda: (feet, forces))
    for _ in range(200):
        missteps.tick(None, None)
        environment.simulation.tick += 1
    assert [(place[1], place[3]) for place in missteps.edges] == ([(x, 1)] if near else [])
    assert bool(missteps.found) == (x > 1.2)


def test_feet_are_where_the_simulator_has_them(make, robot) -> None:
    environment = make(Still(), start=(0.1, 0.05, 0.3))
    feet, forces = environment.feet()
    data = environment.simulation.data
    for leg, name in enumerate(("FL", "FR", "RL", "RR")):
        expected = data.geom(f"{name}_foot").xpos - [0, 0, robot.geometry.foot_radius]
        np.testing.assert_allclose(feet[leg], expected, atol=1e-9)
    assert forces.shape == (4,)
