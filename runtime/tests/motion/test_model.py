from __future__ import annotations

import numpy as np
import pytest

from legtool_runtime import BundleError, MotionModel, MotionState, StateError
from legtool_runtime.motion import kernels
from legtool_runtime.motion.features import FEATURES, REFERENCE, TARGETS
from legtool_runtime.motion.model import parameter_shapes
from legtool_runtime.robot import MIRROR, TROT_PAIRS

STATE = {
    "velocity": [0.3, 0.0, 0.1],
    "previous_velocity": [0.2, 0.0, 0.0],
    "previous_reference": [0.3, 0.0, 0.0],
    "feet_base": [[0.2, 0.1, -0.3], [0.2, -0.1, -0.3], [-0.2, 0.1, -0.3], [-0.2, -0.1, -0.3]],
    "swing_pair": 0,
}


@pytest.mark.parametrize(("degree", "states"), [(1, 3000), (2, 300)])
def test_mean_and_deviation_agree_with_the_formulas_in_plain_numpy(
    degree, states, model, parameters, random_state, reference
):
    rng = np.random.default_rng(0)
    for _ in range(states):
        state, commands = random_state(rng), rng.normal(size=(int(rng.integers(1, 12)), 3))
        got = model(degree).predict(state, commands)
        want = reference(parameters(degree), degree, state, commands)
        swing = want["swing"]
        stance = [leg for leg in range(4) if leg not in swing]
        m = len(commands)
        for name, mean, std in (
            ("fdm", got.foot_displacement[:, swing].reshape(m, 6), got.foot_displacement_std[:, swing].reshape(m, 6)),
            ("cdm", got.com_displacement, got.com_displacement_std),
            ("cvm", got.velocity, got.velocity_std),
        ):
            np.testing.assert_allclose(mean, want[name][0], rtol=1e-9, atol=1e-9)
            want_std = np.sqrt(np.diagonal(want[name][1], axis1=1, axis2=2))
            np.testing.assert_allclose(std, want_std, rtol=1e-9, atol=1e-9)
        assert not got.foot_displacement[:, stance].any()
        assert not got.foot_displacement_std[:, stance].any()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("swing_pair", [0, 1])
def test_covariance_agrees_with_the_formulas_and_with_the_deviations(
    degree, swing_pair, model, parameters, random_state, reference
):
    rng = np.random.default_rng(1)
    state = MotionState(*rng.normal(size=(3, 3)), rng.normal(size=(4, 3)), swing_pair)
    commands = rng.normal(size=(11, 3))
    got = model(degree).covariance(state, commands)
    want = reference(parameters(degree), degree, state, commands)
    for name, covariance in zip(TARGETS, got, strict=True):
        np.testing.assert_allclose(covariance, want[name][1], rtol=1e-9, atol=1e-9)
    std = model(degree).predict(state, commands).velocity_std
    np.testing.assert_allclose(std**2, np.diagonal(got.velocity, axis1=1, axis2=2), rtol=1e-9)


def test_a_mirrored_state_gives_the_mirrored_step(model):
    rng = np.random.default_rng(2)
    planar, point = np.array([1.0, -1.0, -1.0]), np.array([1.0, -1.0, 1.0])
    vectors, feet, commands = rng.normal(size=(3, 3)), rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    left = model(1).predict(MotionState(*vectors, feet, 0), commands)
    right = model(1).predict(MotionState(*(vectors * planar), feet[list(MIRROR)] * point, 1), commands * planar)
    np.testing.assert_allclose(right.foot_displacement[:, list(MIRROR)] * point, left.foot_displacement, atol=1e-12)
    np.testing.assert_allclose(right.com_displacement * [1, -1, 1, -1], left.com_displacement, atol=1e-12)
    np.testing.assert_allclose(right.velocity * planar, left.velocity, atol=1e-12)
    np.testing.assert_allclose(right.foot_displacement_std[:, list(MIRROR)], left.foot_displacement_std, atol=1e-12)


def test_a_coefficient_acts_on_the_input_and_output_that_its_place_names():
    parameters = {name: np.zeros(shape) for name, shape in parameter_shapes(1).items()}
    parameters["fdm.coefficients"][TARGETS["fdm"].index("hind_x"), FEATURES.index("foot_rr_z")] = 2.0
    parameters["cdm.coefficients"][TARGETS["cdm"].index("yaw"), FEATURES.index("previous_reference_y")] = 3.0
    parameters["cvm.coefficients"][TARGETS["cvm"].index("y"), FEATURES.index("reference_x")] = 5.0
    model = MotionModel(parameters, degree=1, instant="touchdown")
    feet = np.zeros((4, 3))
    feet[3, 2] = 7.0  # RR, z
    step = model.predict(MotionState(np.zeros(3), np.zeros(3), [0.0, 11.0, 0.0], feet, 0), [[13.0, 0.0, 0.0]])
    assert step.foot_displacement[0, 3].tolist() == [14.0, 0.0, 0.0]
    assert step.com_displacement[0].tolist() == [0.0, 0.0, 0.0, 33.0]
    assert step.velocity[0].tolist() == [0.0, 65.0, 0.0]


def test_the_second_degree_design_is_the_row_major_upper_triangle():
    x = np.arange(1.0, 25.0)[None]
    phi = kernels.design(x, 2)[0]
    expected = [1.0, *x[0], *(x[0, i] * x[0, j] for i in range(24) for j in range(i, 24))]
    assert phi.tolist() == expected
    assert sorted(kernels.design_order(2)) == list(range(325))


def test_kernels_can_be_called_from_compiled_code(model, random_state):
    from numba import njit

    @njit
    def best(weights, state, pair, commands):
        m = commands.shape[0]
        feet, com, velocity = np.empty((m, 4, 3)), np.empty((m, 4)), np.empty((m, 3))
        kernels.predict_mean(weights, state, pair, commands, feet, com, velocity)
        return np.argmax(com[:, 0])

    rng = np.random.default_rng(3)
    state, commands = random_state(rng), rng.normal(size=(20, 3))
    weights, _, _ = model(1).packed
    expected = model(1).predict(state, commands).com_displacement[:, 0].argmax()
    assert best(weights, state.features, state.swing_pair, commands) == expected


def test_a_prediction_leaves_its_inputs_alone_and_takes_any_layout_of_commands(model, random_state):
    rng = np.random.default_rng(4)
    state, commands = random_state(rng), rng.normal(size=(11, 3))
    before = state.features.copy(), commands.copy()
    expected = model(1).predict(state, commands)
    frozen = commands.copy()
    frozen.setflags(write=False)
    for layout in (np.asfortranarray(commands), commands.tolist(), frozen, np.repeat(commands, 2, axis=0)[::2]):
        np.testing.assert_array_equal(model(1).predict(state, layout).velocity, expected.velocity)
    assert (state.features == before[0]).all() and (commands == before[1]).all()
    assert len(model(1).predict(state, np.empty((0, 3))).velocity) == 0


def test_a_state_holds_copies_that_cannot_be_changed():
    feet = np.array(STATE["feet_base"])
    state = MotionState(**{**STATE, "feet_base": feet})
    feet[0, 0] = 99.0
    assert state.feet_base[0, 0] == 0.2
    with pytest.raises(ValueError, match="read-only"):
        state.velocity[0] = 1.0
    assert state.features[REFERENCE].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"velocity": [0.1, 0.2]}, r"state: velocity has shape \(2,\), expected \(3,\)"),
        ({"feet_base": np.zeros(12)}, r"state: feet_base has shape \(12,\), expected \(4, 3\)"),
        ({"previous_velocity": [0.0, np.nan, 0.0]}, "state: previous_velocity holds a value that is not finite"),
        ({"previous_reference": [0.0, np.inf, 0.0]}, "state: previous_reference holds a value that is not finite"),
        ({"previous_reference": ["a", "b", "c"]}, "previous_reference is not an array of numbers"),
        ({"swing_pair": 2}, r"swing_pair is 2, expected 0 \(FL\+RR\) or 1 \(FR\+RL\)"),
        ({"swing_pair": -1}, "swing_pair is -1"),
        ({"swing_pair": 0.5}, "swing_pair is 0.5"),
        ({"swing_pair": "FL+RR"}, "swing_pair is 'FL"),
    ],
)
def test_a_state_that_cannot_be_is_refused(change, message):
    with pytest.raises(StateError, match=message):
        MotionState(**{**STATE, **change})


@pytest.mark.parametrize(
    ("commands", "message"),
    [
        ([0.1, 0.0, 0.0], r"commands: shape \(3,\), expected \(m, 3\)"),
        (np.zeros((2, 4)), r"commands: shape \(2, 4\)"),
        ([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]], "commands: row 1 is"),
        ([["fast", "slow", "left"]], "commands is not an array of numbers"),
    ],
)
@pytest.mark.parametrize("call", ["predict", "covariance"])
def test_commands_that_cannot_be_are_refused(commands, message, call, model):
    with pytest.raises(StateError, match=message):
        getattr(model(1), call)(MotionState(**STATE), commands)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fdm.intercept": np.zeros(5)}, r"fdm.intercept has shape \(5,\), expected \(6,\)"),
        ({"cdm.coefficients": np.full((4, 24), np.nan)}, "cdm.coefficients holds a value that is not finite"),
        ({"cvm.noise_covariance": -np.eye(3)}, "cvm.noise_covariance has a negative eigenvalue"),
        ({"cvm.weights_covariance": np.triu(np.ones((25, 25)))}, "cvm.weights_covariance is not symmetric"),
        ({"xdm.intercept": np.zeros(3)}, "xdm.intercept is not one of its parameters"),
    ],
)
def test_parameters_that_cannot_be_are_refused(change, message, parameters):
    with pytest.raises(BundleError, match=message):
        MotionModel({**parameters(1), **change}, degree=1, instant="touchdown")


def test_an_unknown_instant_or_degree_is_refused(parameters):
    with pytest.raises(BundleError, match="instant is 'lift_off', expected touchdown or full_stance_end"):
        MotionModel(parameters(1), degree=1, instant="lift_off")
    with pytest.raises(BundleError, match="degree is 3, expected 1 or 2"):
        MotionModel(parameters(1), degree=3, instant="touchdown")


def test_a_missing_parameter_is_named(parameters):
    incomplete = parameters(1)
    del incomplete["cdm.intercept"]
    with pytest.raises(BundleError, match=r"cdm\.intercept is missing"):
        MotionModel(incomplete, degree=1, instant="touchdown")


def test_no_deviation_is_lost_to_rounding_where_the_weights_are_known_exactly(parameters):
    exact = parameters(1)
    for name in TARGETS:
        exact[f"{name}.weights_covariance"] = np.zeros((25, 25))
    state = MotionState(**STATE)
    step = MotionModel(exact, degree=1, instant="touchdown").predict(state, np.zeros((1, 3)))
    np.testing.assert_allclose(step.velocity_std[0], np.sqrt(np.diag(exact["cvm.noise_covariance"])), rtol=1e-12)
    assert (step.foot_displacement_std[0, list(TROT_PAIRS[0])] > 0).all()


#: Straight walks from 0 to 0.5 m/s: nothing sideways, no turns.
STRAIGHT = np.tile([-0.5, 0.5], (len(FEATURES), 1))
STRAIGHT[REFERENCE] = [[0.0, 0.5], [0.0, 0.0], [0.0, 0.0]]


def test_commands_outside_those_of_the_fit_are_told(parameters):
    model = MotionModel(parameters(1), degree=1, instant="touchdown", limits=STRAIGHT)
    commands = [[0, 0, 0], [0.5, 0, 0], [0.56, 0, 0], [0.6, 0, 0], [-0.1, 0, 0], [0.3, 0.5, 0], [0.3, 0, -0.3]]
    assert model.covers(commands).tolist() == [True, True, True, False, False, False, False]
    unknown = MotionModel(parameters(1), degree=1, instant="touchdown")
    assert unknown.covers(commands).all()
    with pytest.raises(StateError, match="finite"):
        model.covers([[np.nan, 0, 0]])


def test_what_was_commanded_to_one_side_alone_is_covered_for_one_pair_alone(parameters):
    limits = STRAIGHT.copy()
    limits[REFERENCE] = [[0.0, 0.5], [0.0, 0.3], [0.0, 0.0]]
    model = MotionModel(parameters(1), degree=1, instant="touchdown", limits=limits)
    assert not model.covers([[0.3, 0.2, 0.0]])[0]


@pytest.mark.parametrize("pair", [0, 1])
def test_the_inputs_of_a_state_outside_those_of_the_fit_are_named(parameters, pair):
    model = MotionModel(parameters(1), degree=1, instant="touchdown", limits=STRAIGHT)
    state = {**STATE, "swing_pair": pair}
    assert model.outside(MotionState(**state)) == ()
    fast = MotionState(**{**state, "velocity": [0.9, 0.0, 0.0], "previous_reference": [0.0, -0.9, 0.0]})
    named = model.outside(fast)
    assert named == (FEATURES[0], FEATURES[10])
    assert MotionModel(parameters(1), degree=1, instant="touchdown").outside(fast) == ()


def test_limits_of_another_shape_are_refused(parameters):
    with pytest.raises(BundleError, match="limits"):
        MotionModel(parameters(1), degree=1, instant="touchdown", limits=np.zeros((3, 2)))
