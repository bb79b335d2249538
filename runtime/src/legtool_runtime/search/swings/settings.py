"""Settings of the swing optimisation; they are read without numba."""

from __future__ import annotations

import math
from dataclasses import dataclass

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import PlannerError


@dataclass(frozen=True)
class SwingSettings:
    """The optimal control problem (19), its solver, and what is asked of an answer.

    Weights are of squares, per 20 ms, in m, rad, s and shares of the robot's weight, for a robot of ANYmal's size.

    Attributes:
        knot_s: longest time between knots [s].
        window: transitions that are optimised at once.
        passes: most passes of the solver.
        converged: a pass that changes the cost by less than this share, with all equalities held, is the last.
        velocity, momentum, place, height, tilt, joint: weights of the centre of mass's velocity, of the angular
            momentum by the mass [m²/s], of the centre of mass across and up, of rotation, and of joints off the
            reference.
        final: factor of all of them at the last knot.
        capture: weight at the last knot of the velocity that the next swing asks for, place included.
        force, rate, foot: weights of forces, joint rates, and feet across, off the reference.
        friction: half the opening of the cones, tan; keep some below the ground's.
        inside: the solver's cones, torques and joint speeds are this share of those that are checked.
        least: smallest normal force of a standing foot, as a share of the weight.
        most: largest one.
        joint_speed: limit of the joints of a leg of ANYmal's length; shorter legs turn faster [rad/s].
        barrier, smooth: height of the logarithmic barriers, and from where on they are parabolas, as shares of what
            each bound is measured in.
        defect: largest difference from the integrated motion at a knot, in a state's own unit.
        slip: farthest of a standing foot from its place, from its touchdown on and also between knots [m].
        clearance: least height of a swinging foot over the ground, away from the ends of its way [m].
        off_tilt: largest rotation off the reference [rad].
    """

    knot_s: float = 0.02
    window: int = 1
    passes: int = 12
    converged: float = 1e-3
    velocity: float = 4.0
    momentum: float = 100.0
    place: float = 40.0
    height: float = 400.0
    tilt: float = 200.0
    joint: float = 0.5
    final: float = 3.0
    capture: float = 2000.0
    force: float = 0.2
    rate: float = 0.01
    foot: float = 400.0
    friction: float = 0.60
    inside: float = 0.92
    least: float = 0.02
    most: float = 2.0
    joint_speed: float = 7.5
    barrier: float = 2e-3
    smooth: float = 0.01
    defect: float = 1e-3
    slip: float = 2e-3
    clearance: float = 0.01
    off_tilt: float = 0.5

    def __post_init__(self) -> None:
        above = (
            "velocity", "capture", "momentum", "place", "height", "tilt", "joint", "force", "rate", "foot", "barrier",
            "smooth", "defect", "slip", "off_tilt", "converged", "joint_speed",
        )  # fmt: skip
        bounds = {name: Bounds(0.0, math.inf, above=True) for name in above}
        bounds |= {
            "knot_s": Bounds(0.005, 0.05, "s"), "window": Bounds(1, 3), "passes": Bounds(1, 100),
            "final": Bounds(1.0, 1000.0), "inside": Bounds(0.5, 1.0), "friction": Bounds(0.02, 2.0),
            "least": Bounds(0.0, 0.2), "most": Bounds(0.5, 10.0), "clearance": Bounds(0.0, 0.2, "m"),
        }  # fmt: skip
        within("swing optimisation", self, bounds, PlannerError)
