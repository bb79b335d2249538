"""Centroidal quantities and derivatives against plain NumPy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from plain_check import bodies, com_of, momentum_of, turned, vector_of

from legtool_runtime.search.swings.centroidal import fill_tree, make_tree, momentum_slope
from legtool_runtime.search.swings.motion import advance, feet_of, feet_slope, linearise, spin_of
from legtool_runtime.tracking.model import TrackedRobot

STEP = 1e-5


def draw(walker: TrackedRobot, seed: int):
    rng = np.random.default_rng(seed)
    rest, _ = walker.geometry.joints(walker.geometry.stance)
    x = 0.3 * rng.normal(size=24)
    x[9:12], x[12:] = 0.0, rest.ravel() + rng.uniform(-0.4, 0.4, 12)
    u = 0.3 * rng.normal(size=24)
    u[12:] *= 5.0
    return x, turned(rng.normal(size=3)), u, rng.normal(size=(4, 3))


@pytest.mark.parametrize("seed", range(3))
def test_centroidal_momentum_is_that_of_the_links(walker: TrackedRobot, seed: int) -> None:
    x, rotation, u, _ = draw(walker, seed)
    tree, spin = make_tree(), np.array([0.4, -0.7, 0.5])
    fill_tree(walker.model(), x[12:], tree)
    ours = rotation @ (tree.locked @ spin + tree.rate.T @ u[12:])

    def at(time: float):
        return np.zeros(3), rotation @ turned(time * spin), x[12:] + time * u[12:]

    np.testing.assert_allclose(momentum_of(walker, at(-1e-5), at(1e-5), 2e-5), ours, atol=1e-5)
    np.testing.assert_allclose(com_of(walker, np.zeros(3), np.eye(3), x[12:]), tree.com, atol=1e-12)
    np.testing.assert_allclose(tree.inverse @ tree.locked, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_slope_of_the_momentum_by_the_joints(walker: TrackedRobot, seed: int) -> None:
    x, _, u, _ = draw(walker, seed)
    model, spin, slope = walker.model(), np.array([0.4, -0.7, 0.5]), np.empty((12, 3))
    tree = make_tree()
    fill_tree(model, x[12:], tree)
    momentum_slope(model, tree, spin, u[12:], slope)

    def momentum(joints: np.ndarray) -> np.ndarray:
        other = make_tree()
        fill_tree(model, joints, other)
        return other.locked @ spin + other.rate.T @ u[12:]

    for j in range(12):
        step = STEP * np.eye(12)[j]
        differences = (momentum(x[12:] + step) - momentum(x[12:] - step)) / (2 * STEP)
        np.testing.assert_allclose(slope[j], differences, atol=1e-7)


@pytest.mark.parametrize("standing", [(True, False, False, True), (True, True, True, False), (True,) * 4])
def test_slopes_of_step_and_feet(walker: TrackedRobot, standing: tuple[bool, ...]) -> None:
    x, rotation, u, contact = draw(walker, 4)
    model, tree, stands = walker.model(), make_tree(), np.array(standing)
    slope_x, slope_u, slope_feet = np.zeros((24, 24)), np.zeros((24, 24)), np.zeros((12, 24))
    linearise(model, x, rotation, u, contact, stands, 0.02, tree, slope_x, slope_u)
    feet_of(model, x, rotation, tree, np.empty((4, 3)))
    feet_slope(rotation, tree, slope_feet)

    def moved(dx: np.ndarray, du: np.ndarray):
        state, turn = x + dx, rotation @ turned(dx[9:12])
        state[9:12] = 0.0
        after, rotated, feet = np.empty(24), np.empty((3, 3)), np.empty((4, 3))
        advance(model, state, turn, u + du, contact, stands, 0.02, make_tree(), after, rotated)
        feet_of(model, state, turn, make_tree(), feet)
        return after, rotated, feet.ravel()

    none = np.zeros(24)
    _, middle, _ = moved(none, none)

    def difference(ahead, back):
        out = (ahead[0] - back[0]) / (2 * STEP)
        out[9:12] = (vector_of(middle.T @ ahead[1]) - vector_of(middle.T @ back[1])) / (2 * STEP)
        return out, (ahead[2] - back[2]) / (2 * STEP)

    for i in range(24):
        step = STEP * np.eye(24)[i]
        by_state, by_feet = difference(moved(step, none), moved(-step, none))
        by_input, _ = difference(moved(none, step), moved(none, -step))
        np.testing.assert_allclose(slope_x[:, i], by_state, atol=1e-7)
        np.testing.assert_allclose(slope_feet[:, i], by_feet, atol=1e-7)
        lifted = i < 12 and not standing[i // 3]
        np.testing.assert_allclose(slope_u[:, i], none if lifted else by_input, atol=1e-7)


def test_a_body_in_the_air_keeps_its_momentum(walker: TrackedRobot) -> None:
    x, rotation, u, contact = draw(walker, 5)
    model, tree, after, turn = walker.model(), make_tree(), np.empty(24), np.empty((3, 3))
    fill_tree(model, x[12:], tree)
    spin = np.empty(3)
    spin_of(model, tree, rotation, x[3:6], u[12:], spin)
    np.testing.assert_allclose(tree.locked @ spin + tree.rate.T @ u[12:], walker.mass * rotation.T @ x[3:6], atol=1e-9)
    start = x.copy()
    for _ in range(20):
        advance(model, x, rotation, u, contact, np.zeros(4, bool), 0.01, tree, after, turn)
        x, rotation = after.copy(), turn.copy()
        x[12:] = start[12:] + 0.1 * np.sin(x[12:] - start[12:])
    np.testing.assert_allclose(x[3:6], start[3:6], atol=1e-12)
    np.testing.assert_allclose(x[:3], start[:3] + 0.2 * np.array([0.0, 0.0, -9.81]), atol=1e-9)
    np.testing.assert_allclose(x[6:9], start[6:9] + 0.2 * start[:3] + [0, 0, -0.5 * 9.81 * 0.04], atol=1e-9)


def test_feet_are_where_the_links_end(walker: TrackedRobot) -> None:
    x, rotation, _, _ = draw(walker, 6)
    feet, tree = np.empty((4, 3)), make_tree()
    feet_of(walker.model(), x, rotation, tree, feet)
    base = x[6:9] - rotation @ tree.com
    np.testing.assert_allclose(feet, bodies(walker, base, rotation, x[12:])[4], atol=1e-12)
