from __future__ import annotations

import numpy as np

from legtool.sim.controllers.trot.forces import stance_forces

ARMS = np.array([[0.24, 0.13, -0.37], [0.24, -0.13, -0.37], [-0.24, 0.13, -0.37], [-0.24, -0.13, -0.37]])
WEIGHTS = np.array([1.0, 1.0, 2.0, 10.0, 10.0, 0.5])
LENGTH, FRICTION = 0.25, 0.6


def solve(wrench: list[float], limit: list[float]) -> np.ndarray:
    forces, dual = np.zeros((4, 3)), np.zeros((4, 3))
    for _ in range(5):  # warm-started, as from tick to tick
        stance_forces(ARMS, np.array(wrench), WEIGHTS, LENGTH, FRICTION, np.array(limit), forces, dual)
    return forces


def test_four_feet_share_the_weight() -> None:
    forces = solve([0, 0, 1, 0, 0, 0], [1.5] * 4)
    np.testing.assert_allclose(forces[:, 2], 0.25, atol=0.01)
    np.testing.assert_allclose(forces[:, :2], 0.0, atol=0.01)


def test_four_feet_give_the_wanted_force_and_moment() -> None:
    wanted = [0.15, -0.1, 1.1, 0.05, -0.08, 0.04]
    forces = solve(wanted, [1.5] * 4)
    moment = np.cross(ARMS, forces).sum(axis=0) / LENGTH
    np.testing.assert_allclose([*forces.sum(axis=0), *moment], wanted, atol=0.03)


def test_forces_stay_in_their_cones_whatever_is_asked() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        forces = solve(list(rng.uniform(-2, 2, 6)), [1.5, 0.0, 0.0, 1.5])
        assert (np.linalg.norm(forces[:, :2], axis=1) <= FRICTION * forces[:, 2] + 1e-9).all()
        assert (forces[:, 2] <= 1.5 + 1e-9).all()
        assert (forces[[1, 2]] == 0).all()


def test_a_diagonal_pair_does_not_trade_its_balance_for_acceleration() -> None:
    # Acceleration across the support line needs a moment about it that two feet cannot give.
    across = np.array([-0.13, 0.24]) / np.hypot(0.13, 0.24)
    forces = solve([*(0.4 * across), 1, 0, 0, 0], [1.5, 0.0, 0.0, 1.5])
    assert abs(forces.sum(axis=0)[:2] @ across) < 0.05
