from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from legtool_runtime.tracking.dynamics import GRAVITY, FullState, Terms, dynamics_terms, make_terms
from legtool_runtime.tracking.model import TrackedRobot

UP = np.tile([0.0, 0.0, 1.0], (4, 1))
TILTED = UP + np.array([0.2, -0.1, 0.0])
TILTED /= np.linalg.norm(TILTED, axis=1)[:, None]


def terms_at(robot: TrackedRobot, state: FullState, normals: np.ndarray = UP) -> Terms:
    terms = make_terms()
    dynamics_terms(robot.model(), state, normals, terms)
    return terms


def moved(state: FullState, velocity: np.ndarray, dt: float) -> FullState:
    """The state after ``dt`` at a constant generalised velocity."""
    angle = velocity[3:6] * dt
    size = np.linalg.norm(angle)
    w, v = np.cos(size / 2), (np.sin(size / 2) / size * angle if size > 0 else angle)
    a, b = state.orientation[0], state.orientation[1:]
    orientation = np.concatenate([[a * w - b @ v], a * v + w * b + np.cross(b, v)])
    joints = state.joints + dt * velocity[6:].reshape(4, 3)
    return FullState(state.position + dt * velocity[:3], orientation, joints, state.velocity)


def energy(robot: TrackedRobot, state: FullState) -> float:
    terms = terms_at(robot, state)
    return float(0.5 * state.velocity @ terms.mass @ state.velocity + robot.mass * GRAVITY * terms.com[2])


@pytest.fixture
def states(random_state: Callable[..., FullState]) -> list[FullState]:
    rng = np.random.default_rng(1)
    return [random_state(rng) for _ in range(5)]


def test_mass_matrix_is_symmetric_and_positive(tracked: TrackedRobot, states: list[FullState]) -> None:
    for state in states:
        mass = terms_at(tracked, state).mass
        np.testing.assert_allclose(mass, mass.T, atol=1e-12)
        assert np.linalg.eigvalsh(mass).min() > 0
        np.testing.assert_allclose(mass[:3, :3], tracked.mass * np.eye(3), atol=1e-12)


def test_legs_do_not_couple_but_through_the_base(tracked: TrackedRobot, states: list[FullState]) -> None:
    mass = terms_at(tracked, states[0]).mass[6:, 6:].reshape(4, 3, 4, 3)
    for leg in range(4):
        for other in set(range(4)) - {leg}:
            assert not mass[leg, :, other].any()


def test_free_flight_keeps_energy_and_angular_momentum(tracked: TrackedRobot, states: list[FullState]) -> None:
    def rate(state: FullState) -> np.ndarray:
        terms = terms_at(tracked, state)
        return np.linalg.solve(terms.mass, -terms.bias)

    state = states[0]
    first, momentum = energy(tracked, state), terms_at(tracked, state).momentum.copy()
    dt = 1e-4
    for _ in range(300):  # the midpoint rule
        half = moved(state, state.velocity, dt / 2)._replace(velocity=state.velocity + dt / 2 * rate(state))
        velocity = state.velocity + dt * rate(half)
        state = moved(state, half.velocity, dt)._replace(velocity=velocity)
    assert abs(energy(tracked, state) - first) < 1e-5 * abs(first)
    np.testing.assert_allclose(terms_at(tracked, state).momentum, momentum, atol=1e-5)


def test_jacobians_and_drifts_are_derivatives_of_the_feet(tracked: TrackedRobot, states: list[FullState]) -> None:
    dt = 1e-6
    for state in states:
        now = terms_at(tracked, state, TILTED)
        before, after = (terms_at(tracked, moved(state, state.velocity, s * dt), TILTED) for s in (-1, 1))
        for position, velocity in (("feet", "feet_velocity"), ("com", "com_velocity")):
            slope = (getattr(after, position) - getattr(before, position)) / (2 * dt)
            np.testing.assert_allclose(getattr(now, velocity), slope, atol=1e-7)
        for name, jacobian, drift in (
            ("feet_velocity", "jacobian", "drift"),
            ("contact_velocity", "contact_jacobian", "contact_drift"),
        ):
            np.testing.assert_allclose(getattr(now, name), getattr(now, jacobian) @ state.velocity, atol=1e-12)
            # At constant generalised velocities the feet's accelerations are the drift.
            slope = (getattr(after, name) - getattr(before, name)) / (2 * dt)
            np.testing.assert_allclose(getattr(now, drift), slope, atol=1e-6)


def test_feet_are_where_the_kinematics_put_them(tracked: TrackedRobot, states: list[FullState]) -> None:
    for state in states:
        terms = terms_at(tracked, state)
        feet = tracked.geometry.feet(state.joints) @ terms.rotation.T + state.position
        np.testing.assert_allclose(terms.feet, feet, atol=1e-12)


def test_at_rest_the_bias_is_the_weight(tracked: TrackedRobot, states: list[FullState]) -> None:
    for state in states:
        terms = terms_at(tracked, state._replace(velocity=np.zeros(18)))
        np.testing.assert_allclose(terms.bias[:3], [0, 0, tracked.mass * GRAVITY], atol=1e-9)
        moment = np.cross(terms.com - state.position, terms.bias[:3])
        np.testing.assert_allclose(terms.rotation @ terms.bias[3:6], moment, atol=1e-9)


def test_length_of_the_quaternion_does_not_matter(tracked: TrackedRobot, states: list[FullState]) -> None:
    state = states[0]
    longer = terms_at(tracked, state._replace(orientation=1.001 * state.orientation))
    np.testing.assert_allclose(longer.mass, terms_at(tracked, state).mass, atol=1e-12)
