from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from legtool_runtime.errors import RobotError
from legtool_runtime.tracking.assembly import Gains, References, orientation_error, scaled
from legtool_runtime.tracking.dynamics import GRAVITY, FullState
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.whole_body import NO_STANCE, REFUSED, SOLVED, WholeBody


@pytest.fixture
def standing(tracked: TrackedRobot) -> tuple[FullState, References]:
    """At rest on four feet, and the wish to stay so."""
    geometry = tracked.geometry
    angles, _ = geometry.joints(geometry.stance)
    position = np.array([0.0, 0.0, geometry.standing_height])
    state = FullState(position, np.array([1.0, 0.0, 0.0, 0.0]), angles, np.zeros(18))
    wanted = References(
        com=np.stack([position + tracked.com, np.zeros(3), np.zeros(3)]),
        orientation=np.array([1.0, 0.0, 0.0, 0.0]),
        turning=np.zeros((2, 3)),
        stance=np.ones(4, dtype=bool),
        swing=np.zeros((4, 3, 3)),
        forces=np.tile([0.0, 0.0, tracked.mass * GRAVITY / 4], (4, 1)),
        normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        friction=np.full(4, 0.6),
    )
    return state, wanted


def disturbed(rng: np.random.Generator, state: FullState, wanted: References) -> tuple[FullState, References]:
    """A robot on uneven ground that has been hit, some of its feet in the air."""
    stance = rng.random(4) < 0.6
    stance[rng.integers(4)] = True
    normals = np.array([0.0, 0.0, 1.0]) + rng.uniform(-0.3, 0.3, (4, 3))
    orientation = np.array([1.0, *rng.uniform(-0.2, 0.2, 3)])
    moving = FullState(
        state.position + rng.uniform(-0.05, 0.05, 3),
        orientation / np.linalg.norm(orientation),
        state.joints + rng.uniform(-0.5, 0.5, (4, 3)),
        rng.normal(size=18) * np.repeat([0.5, 1.0, 4.0], [3, 3, 12]),
    )
    swing = rng.uniform(-1, 1, (4, 3, 3)) * np.array([0.3, 1.0, 10.0])[:, None]
    return moving, wanted._replace(
        com=wanted.com + rng.uniform(-1, 1, (3, 3)) * np.array([0.1, 0.5, 3.0])[:, None],
        stance=stance,
        swing=swing,
        normals=normals / np.linalg.norm(normals, axis=1)[:, None],
        friction=rng.uniform(0.3, 1.0, 4),
    )


def test_standing_still_is_carried_by_the_feet(tracked: TrackedRobot, standing: tuple[FullState, References]) -> None:
    answer = WholeBody(tracked).control(*standing)
    assert answer.solved
    np.testing.assert_allclose(answer.acceleration, 0, atol=1e-2)
    np.testing.assert_allclose(answer.forces.sum(axis=0), [0, 0, tracked.mass * GRAVITY], rtol=1e-3, atol=0.1)
    assert (answer.friction_margin > 0.5).all()


def test_hard_bounds_hold_whatever_happens(tracked: TrackedRobot, standing: tuple[FullState, References]) -> None:
    rng, control = np.random.default_rng(3), WholeBody(tracked)
    least = control.gains.least_force * tracked.mass * GRAVITY
    saturated = 0
    for _ in range(1000):
        state, wanted = disturbed(rng, *standing)
        answer = control.control(state, wanted)
        assert answer.status == SOLVED
        assert (np.abs(answer.torques.reshape(4, 3)) <= tracked.torque_limit).all()
        saturated += answer.torque_share > 0.999
        normal = (answer.forces * wanted.normals).sum(axis=1)
        tangent = np.linalg.norm(answer.forces - normal[:, None] * wanted.normals, axis=1)
        stance = wanted.stance
        assert not answer.forces[~stance].any()
        assert (normal[stance] >= least - 1e-4).all()
        assert (tangent[stance] <= np.sqrt(2) * wanted.friction[stance] * normal[stance] + 1e-4).all()
        margin = 1 - tangent[stance] / (wanted.friction[stance] * normal[stance])
        np.testing.assert_allclose(answer.friction_margin[stance], margin, atol=1e-9)
        assert np.isnan(answer.friction_margin[~stance]).all()
    assert saturated > 50


def test_answer_obeys_the_equation_of_motion(tracked: TrackedRobot, standing: tuple[FullState, References]) -> None:
    rng, control = np.random.default_rng(4), WholeBody(tracked)
    for _ in range(50):
        state, wanted = disturbed(rng, *standing)
        answer, terms = control.control(state, wanted), control.terms
        drive = terms.mass @ answer.acceleration + terms.bias
        for leg in range(4):
            drive -= terms.contact_jacobian[leg].T @ answer.forces[leg]
        np.testing.assert_allclose(drive[:6], 0, atol=1e-6)
        drag = answer.torques - drive[6:] - 0.1 * state.velocity[6:]
        assert (np.abs(drag) <= 0.2 + 1e-6).all()  # no more than the dry friction


def test_joints_that_run_into_their_limits_are_braked(
    tracked: TrackedRobot, standing: tuple[FullState, References]
) -> None:
    state, wanted = standing
    low = tracked.geometry.joint_limits[0, 2, 0]
    state.joints[0, 2] = low + 0.02
    state.velocity[6 + 2] = -2.0
    wanted.stance[0] = False
    wanted.swing[0, 0] = [0.24, 0.13, 0.6]  # nearer to the hip than the knee can bend
    answer = WholeBody(tracked).control(state, wanted)
    assert answer.solved
    assert answer.acceleration[6 + 2] > 20.0


def test_a_swinging_leg_at_its_limit_does_not_throw_the_trunk(
    tracked: TrackedRobot, standing: tuple[FullState, References]
) -> None:
    state, wanted = standing
    state.joints[0, 2] = tracked.geometry.joint_limits[0, 2, 0] + 0.02
    control = WholeBody(tracked)
    control.control(state, wanted)
    wanted.stance[[0, 3]] = False
    wanted.swing[:, 0] = control.terms.feet
    calm = control.control(state, wanted).acceleration[:3].copy()
    wanted.swing[0, 0, 2] += 0.06  # the knee cannot bend as far
    np.testing.assert_allclose(control.control(state, wanted).acceleration[:3], calm, atol=2.5)


def test_a_standing_leg_that_runs_straight_lets_its_foot_go(
    tracked: TrackedRobot, standing: tuple[FullState, References]
) -> None:
    """Held to its foot it would be bent by the trunk's fall: the other feet would give up the weight they carry."""
    state, wanted = standing
    state.joints[2, 2] = tracked.geometry.joint_limits[2, 2, 1] - 0.1
    state.velocity[6 + 8] = 6.0
    answer = WholeBody(tracked).control(state, wanted)
    assert answer.solved
    assert answer.forces[:, 2].sum() > 0.9 * tracked.mass * GRAVITY
    assert answer.acceleration[6 + 8] < -200.0  # the knee is braked all the same


@pytest.mark.parametrize(
    "spoil",
    [
        lambda s, w: s.position.__setitem__(0, np.nan),
        lambda s, w: s.orientation.__setitem__(slice(None), 0.0),
        lambda s, w: s.joints.__setitem__((1, 1), np.inf),
        lambda s, w: s.velocity.__setitem__(7, np.nan),
        lambda s, w: w.com.__setitem__((2, 1), np.nan),
        lambda s, w: w.orientation.__setitem__(0, np.nan),
        lambda s, w: w.forces.__setitem__((0, 2), np.nan),
        lambda s, w: w.normals.__setitem__((0, 2), 2.0),
        lambda s, w: w.friction.__setitem__(0, 0.0),
    ],
)
def test_what_cannot_be_used_is_flagged_and_the_torques_stay(
    tracked: TrackedRobot, standing: tuple[FullState, References], spoil: Callable[[FullState, References], None]
) -> None:
    control = WholeBody(tracked)
    before = control.control(*standing).torques.copy()
    spoil(*standing)
    answer = control.control(*standing)
    assert answer.status == REFUSED and not answer.solved
    np.testing.assert_array_equal(answer.torques, before)


def test_reference_of_a_standing_foots_swing_is_not_read(
    tracked: TrackedRobot, standing: tuple[FullState, References]
) -> None:
    state, wanted = standing
    wanted.swing[:] = np.nan
    assert WholeBody(tracked).control(state, wanted).solved


def test_without_a_foot_on_the_ground_the_legs_still_swing(
    tracked: TrackedRobot, standing: tuple[FullState, References]
) -> None:
    state, wanted = standing
    wanted.stance[:] = False
    control = WholeBody(tracked)
    wanted.swing[:, 0] = tracked.geometry.stance + state.position
    wanted.swing[:, 2] = [1.0, 0.0, 2.0]
    answer = control.control(state, wanted)
    assert answer.status == NO_STANCE and not answer.solved
    assert not answer.forces.any()
    reached = control.terms.jacobian @ answer.acceleration + control.terms.drift
    np.testing.assert_allclose(reached, np.tile([1.0, 0.0, 2.0], (4, 1)), atol=0.1)


def test_program_without_a_solution_falls_back_to_carrying_the_weight(
    tracked: TrackedRobot, standing: tuple[FullState, References]
) -> None:
    state, wanted = standing
    control = WholeBody(tracked)
    held = control.control(state, wanted)
    torques = held.torques.copy()
    wanted.forces[0, 2] = 1e200  # squared, it is no longer finite
    answer = control.control(state, wanted)
    assert not answer.solved
    np.testing.assert_allclose(answer.forces.sum(axis=0)[2], tracked.mass * GRAVITY, rtol=1e-6)
    np.testing.assert_allclose(answer.torques, torques, atol=0.5)


@pytest.mark.parametrize(("name", "value"), [("swing_weight", -1.0), ("force_weight", 0.0), ("com_damping", np.nan)])
def test_impossible_gain_is_refused(tracked: TrackedRobot, name: str, value: float) -> None:
    with pytest.raises(RobotError, match=f"gain {name}"):
        WholeBody(tracked, Gains(**{name: value}))


def test_gains_scale_as_accelerations_stay() -> None:
    gains = scaled(Gains(), 4.0)
    assert gains.swing_stiffness == Gains().swing_stiffness / 4
    assert gains.swing_damping == Gains().swing_damping / 2
    assert gains.acceleration_limit == Gains().acceleration_limit
    assert gains.orientation_weight == Gains().orientation_weight * 16


def test_orientation_error_turns_the_measured_into_the_wanted() -> None:
    def about_z(angle: float) -> np.ndarray:
        return np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])

    error = np.zeros(3)
    orientation_error(about_z(0.3), -about_z(0.5), error)
    np.testing.assert_allclose(error, [0, 0, 0.2], atol=1e-12)
    orientation_error(about_z(0.3), about_z(0.3), error)
    np.testing.assert_allclose(error, 0, atol=1e-12)
    orientation_error(about_z(3.0), about_z(-3.0), error)
    np.testing.assert_allclose(error, [0, 0, 2 * np.pi - 6.0], atol=1e-12)
