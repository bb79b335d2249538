"""The frozen motion models: displacement of the feet (FDM) and of the CoM (CDM), and the CoM's next velocity (CVM).

Each is a multivariate linear regression (motion paper, III-A) with a predictive covariance
``noise_covariance · (1 + [1, φ]ᵀ · weights_covariance · [1, φ])``, where φ is the paper's x_FDM (equation 2), or its
second-order polynomial. They are learned for the canonical swing pair FL+RR; steps of FR+RL are mirrored here.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.errors import BundleError, StateError, shown
from legtool_runtime.motion import kernels
from legtool_runtime.motion.features import (
    FEATURE_SIGN,
    FEATURES,
    REFERENCE,
    TARGET_SIGN,
    TARGETS,
    canonical_features,
)
from legtool_runtime.robot import TROT_PAIR_NAMES, TROT_PAIRS

Array = NDArray[np.float64]

#: Instants of a step at which a state can be taken; a model accepts only states taken at its own instant.
INSTANTS = ("touchdown", "full_stance_end")
DEGREES = (1, 2)
#: A value counts as covered this far outside the fitted range: as a share of its width, and besides [SI unit].
_WIDER, _BESIDE = 0.1, 0.02

_STATE_SHAPES = {
    "velocity": (3,),
    "previous_velocity": (3,),
    "previous_reference": (3,),
    "feet_base": (4, 3),
}


class MotionPrediction(NamedTuple):
    """Expected motion of the robot in its next step, for each of m commands.

    Attributes:
        foot_displacement: (m, 4, 3) equation 3, base frame at t [m]; zero for stance feet.
        com_displacement: (m, 4) x, y, z [m] (equation 4) and yaw [rad], base frame at t.
        velocity: (m, 3) CoM velocity after the step: vx, vy [m/s], yaw rate [rad/s], base frame at t+1.
        foot_displacement_std: (m, 4, 3) predictive standard deviation [m]; zero for stance feet.
        com_displacement_std: (m, 4) [m], [rad].
        velocity_std: (m, 3) [m/s], [rad/s].
    """

    foot_displacement: Array
    com_displacement: Array
    velocity: Array
    foot_displacement_std: Array
    com_displacement_std: Array
    velocity_std: Array


class MotionCovariance(NamedTuple):
    """Predictive covariances of a :class:`MotionPrediction`.

    Attributes:
        foot_displacement: (m, 6, 6) of the two swing feet, front x, y, z, hind x, y, z, base frame [m²].
        com_displacement: (m, 4, 4) of x, y, z, yaw.
        velocity: (m, 3, 3) of vx, vy, yaw rate.
    """

    foot_displacement: Array
    com_displacement: Array
    velocity: Array


@dataclass(frozen=True, eq=False)
class MotionState:
    """State of the robot before a step (equation 1), taken at the instant of the model.

    Attributes:
        velocity: (3,) CoM velocity now: vx, vy [m/s], yaw rate [rad/s], base frame.
        previous_velocity: (3,) CoM velocity one step ago, in the base frame of that moment.
        previous_reference: (3,) velocity command of the step that ends now.
        feet_base: (4, 3) foot positions relative to the CoM, base frame [m].
        swing_pair: index into TROT_PAIRS of the pair that swings next: 0 for FL+RR, 1 for FR+RL.

    Raises:
        StateError: a shape is wrong, a value is not finite, or the swing pair does not exist.
    """

    velocity: Array
    previous_velocity: Array
    previous_reference: Array
    feet_base: Array
    swing_pair: int
    #: (24,) in the order of FEATURES; the reference of the coming step is zero.
    features: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name, shape in _STATE_SHAPES.items():
            advice = "; check the state estimator"
            value = checks.finite(f"state: {name}", getattr(self, name), shape, StateError, advice=advice)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        try:
            pair = operator.index(self.swing_pair)
        except TypeError:
            pair = -1
        if pair not in range(len(TROT_PAIRS)):
            choices = " or ".join(f"{index} ({name})" for index, name in enumerate(TROT_PAIR_NAMES))
            raise StateError(f"state: swing_pair is {shown(self.swing_pair)}, expected {choices}")
        object.__setattr__(self, "swing_pair", pair)
        rest = (self.velocity, self.previous_velocity, np.zeros(3), self.previous_reference, self.feet_base.ravel())
        object.__setattr__(self, "features", np.concatenate(rest))


class MotionModel:
    """FDM, CDM and CVM of one robot, ready to predict.

    Attributes:
        degree: 1, or 2 for the second-order polynomial.
        instant: the instant at which states must be taken, one of INSTANTS.
        parameters: ``"fdm.coefficients"`` and so on, as in :func:`parameter_shapes`; read-only.
        limits: (24, 2) smallest and largest value of each of FEATURES in the steps that it was fitted to, canonical;
            None where that is not known.
    """

    def __init__(
        self, parameters: Mapping[str, ArrayLike], *, degree: int, instant: str, limits: ArrayLike | None = None
    ) -> None:
        """Check and pack the parameters.

        Args:
            parameters: exactly the names of :func:`parameter_shapes`.
            degree: degree of the polynomial, one of DEGREES.
            instant: one of INSTANTS.
            limits: (24, 2) as the attribute.

        Raises:
            BundleError: limits of another shape, or a parameter that is missing, unknown, of the wrong shape, not
                finite, or not a valid covariance.
        """
        if degree not in DEGREES or isinstance(degree, bool):
            raise BundleError(f"motion model: degree is {degree!r}, expected 1 or 2")
        if instant not in INSTANTS:
            raise BundleError(f"motion model: instant is {instant!r}, expected {' or '.join(INSTANTS)}")
        self.degree = degree
        self.instant = instant
        self.limits = None
        if limits is not None:
            self.limits = checks.finite("motion model: limits", limits, (len(FEATURES), 2), BundleError)
        self.parameters = _checked(parameters, parameter_shapes(degree))
        order = kernels.design_order(degree)
        weights = [
            np.concatenate([self.parameters[f"{m}.intercept"][:, None], self.parameters[f"{m}.coefficients"]], axis=1)
            for m in TARGETS
        ]
        self._weights = np.ascontiguousarray(np.concatenate(weights).T[order])
        self._covariance = np.stack([self.parameters[f"{m}.weights_covariance"][np.ix_(order, order)] for m in TARGETS])
        noise = [np.diagonal(self.parameters[f"{m}.noise_covariance"]) for m in TARGETS]
        self._noise_std = np.sqrt(np.maximum(np.concatenate(noise), 0.0))

    @property
    def packed(self) -> tuple[Array, Array, Array]:
        """``weights``, ``covariance`` and ``noise_std`` in the form that the functions of :mod:`.kernels` need."""
        return self._weights, self._covariance, self._noise_std

    def predict(self, state: MotionState, commands: ArrayLike) -> MotionPrediction:
        """Predict the next step for many commands.

        Args:
            state: state of the robot at the instant of this model.
            commands: (m, 3) vx, vy [m/s], yaw rate [rad/s].

        Raises:
            StateError: the commands have the wrong shape or are not finite.
        """
        checks.instance("state", state, MotionState, StateError)
        command = _commands(commands)
        m = len(command)
        feet, com, velocity = np.empty((2, m, 4, 3)), np.empty((2, m, 4)), np.empty((2, m, 3))
        if not kernels.predict(
            self._weights, self._covariance, self._noise_std, state.features, state.swing_pair, command,
            feet, com, velocity,
        ):  # fmt: skip
            raise _not_finite(command)
        return MotionPrediction(feet[0], com[0], velocity[0], feet[1], com[1], velocity[1])

    def covers(self, commands: ArrayLike) -> NDArray[np.bool_]:
        """Whether commands lie within the range of those that the models were fitted to.

        Beyond it a linear model goes on as if nothing changed: a model of straight walks answers a command sideways
        like none. The range is widened by a tenth of its width and by 0.02 m/s or rad/s. A command is to lie in
        it for both swing pairs: for one of them it is mirrored.

        Args:
            commands: (m, 3) vx, vy [m/s], yaw rate [rad/s].

        Returns:
            (m,) True everywhere where the range is not known.

        Raises:
            StateError: the commands have the wrong shape or are not finite.
        """
        command = _commands(commands)
        if not np.isfinite(command).all():
            raise _not_finite(command)
        mirrored = command * FEATURE_SIGN[REFERENCE]
        return self._inside(command, REFERENCE) & self._inside(mirrored, REFERENCE)

    def outside(self, state: MotionState) -> tuple[str, ...]:
        """The inputs of a state that lie outside the range of the steps that the models were fitted to.

        Args:
            state: of the robot, at the instant of this model.

        Returns:
            names out of FEATURES, of the canonical pair; none where the range is not known.
        """
        features = canonical_features(state.features[None], np.array([state.swing_pair], dtype=np.int8))[0]
        names = [(k, name) for k, name in enumerate(FEATURES) if not REFERENCE.start <= k < REFERENCE.stop]
        return tuple(name for k, name in names if not self._inside(features[None, k : k + 1], slice(k, k + 1))[0])

    def _inside(self, values: Array, columns: slice) -> NDArray[np.bool_]:
        if self.limits is None:
            return np.ones(len(values), dtype=np.bool_)
        low, high = self.limits[columns].T
        margin = _WIDER * (high - low) + _BESIDE
        inside: NDArray[np.bool_] = ((low - margin <= values) & (values <= high + margin)).all(axis=1)
        return inside

    def covariance(self, state: MotionState, commands: ArrayLike) -> MotionCovariance:
        """Return the full predictive covariances; arguments and errors are those of :meth:`predict`."""
        checks.instance("state", state, MotionState, StateError)
        command = _commands(commands)
        if not np.isfinite(command).all():
            raise _not_finite(command)
        scale = np.empty((len(command), 3))
        kernels.predict_scale(self._covariance, state.features, state.swing_pair, command, scale)
        out = []
        for index, name in enumerate(TARGETS):
            sign = TARGET_SIGN[name] if state.swing_pair == 1 else np.ones(len(TARGETS[name]))
            noise = self.parameters[f"{name}.noise_covariance"] * np.outer(sign, sign)
            out.append(scale[:, index, None, None] * noise)
        return MotionCovariance(*out)

    def __str__(self) -> str:
        return f"motion models of degree {self.degree}, states at {self.instant}"

    def warm_up(self) -> None:
        """Compile every kernel of this line or load it from the user's cache (see :mod:`legtool_runtime.cache`)."""
        commands = np.zeros((11, 3))
        for pair in range(len(TROT_PAIRS)):
            state = MotionState(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((4, 3)), pair)
            self.covariance(state, commands)
            for _ in range(_WARM_CALLS):
                self.predict(state, commands)


#: The interpreter and the caches of the processor also need some calls before times settle.
_WARM_CALLS = 100


def parameter_shapes(degree: int) -> dict[str, tuple[int, ...]]:
    """Return name and shape of each parameter of ``fdm``, ``cdm`` and ``cvm`` with k outputs and d inputs.

    ``coefficients`` (k, d), ``intercept`` (k,), ``noise_covariance`` (k, k), ``weights_covariance`` (d+1, d+1) over
    [1, φ] in the order of :func:`legtool_runtime.motion.kernels.design`.
    """
    size = kernels.design_size(degree)
    shapes: dict[str, tuple[int, ...]] = {}
    for model, targets in TARGETS.items():
        k = len(targets)
        shapes[f"{model}.coefficients"] = (k, size - 1)
        shapes[f"{model}.intercept"] = (k,)
        shapes[f"{model}.noise_covariance"] = (k, k)
        shapes[f"{model}.weights_covariance"] = (size, size)
    return shapes


def _checked(parameters: Mapping[str, ArrayLike], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    if parameters.keys() != shapes.keys():
        odd = sorted(parameters.keys() ^ shapes.keys())[0]
        what = "missing" if odd in shapes else "not one of its parameters"
        raise BundleError(f"motion model: {odd} is {what}; expected {', '.join(shapes)}")
    checked = {}
    for name, shape in shapes.items():
        value = checks.finite(f"motion model: {name}", parameters[name], shape, BundleError)
        if name.endswith("covariance"):
            _check_covariance(name, value)
        value.setflags(write=False)
        checked[name] = value
    return checked


def _check_covariance(name: str, value: Array) -> None:
    size = np.abs(value).max()
    if np.abs(value - value.T).max() > 1e-9 * size:
        raise BundleError(f"motion model: {name} is not symmetric, so it is not a covariance")
    if size > 0 and np.linalg.eigvalsh(value / size)[0] < -1e-9:
        raise BundleError(f"motion model: {name} has a negative eigenvalue, so it is not a covariance")


def _commands(commands: ArrayLike) -> Array:
    # Always a fresh array: one kind of memory (writable, aligned, contiguous), so one compiled kernel.
    command = checks.array("commands", commands, StateError)
    if command.ndim != 2 or command.shape[1] != 3:
        raise StateError(f"commands: shape {command.shape}, expected (m, 3): vx, vy [m/s], yaw rate [rad/s]")
    return command


def _not_finite(commands: Array) -> StateError:
    row = int(np.flatnonzero(~np.isfinite(commands).all(axis=1))[0])
    return StateError(f"commands: row {row} is {commands[row].tolist()}, expected finite numbers")
