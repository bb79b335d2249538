"""The optimal control problem (19) over knots, for compiled code: what is given, and where its iterate is kept.

States (24,): velocity of the centre of mass [m/s]; angular momentum about it by the robot's mass [m²/s]; the centre of
mass [m], world frame; an entry for each axis of the base's rotation, 0 itself, by which the rotation beside it turns
about its own axes [rad]; joints [rad]. The centre of mass stands for the base's place, p = c - R c_b(q): so the linear
dynamics are linear. Inputs (24,): contact forces as shares of the weight, world frame; joint rates [rad/s]. Both are
constant between knots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.search.swings.centroidal import Tree, make_tree

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STATES = 24
#: Forces of standing feet and ways across of swinging ones: as many free inputs as a knot may have.
FREE = 12


class Limits(NamedTuple):
    """``friction`` of the cones; ``least``, ``most`` normal force as shares of the weight; ``low``, ``high`` (12,)
    joints [rad]; ``speed`` of joints [rad/s]; ``torque`` (12,) as shares of the weight times 1 m; ``barrier`` and
    ``smooth`` of the logarithmic barriers."""

    friction: float
    least: float
    most: float
    low: Array
    high: Array
    speed: float
    torque: Array
    barrier: float
    smooth: float


class SwingProblem(NamedTuple):
    """One problem over n knots and the end.

    ``step_s`` (n,) to the next knot [s]; ``standing`` (n, 4) feet that carry until then; ``fixed`` (n, 4) feet that are
    to be at their target then, others at its height only; ``target`` (n + 1, 4, 3) centres of the feet [m]; ``contact``
    (n, 4, 3) contact points of the standing ones; ``axes`` (n, 4, 3, 3) two tangents and the normal there, as rows;
    ``states`` (n + 1, 24), ``rotations`` (n + 1, 3, 3), ``inputs`` (n, 24) the reference, whose first state is where
    the robot is; ``weights`` (3, 24) of states on the way, at the end, and of inputs; ``steer`` (24,) a row whose
    product with the last state's deviation counts squared; ``foot`` weight of feet across.
    """

    step_s: Array
    standing: Flags
    fixed: Flags
    target: Array
    contact: Array
    axes: Array
    states: Array
    rotations: Array
    inputs: Array
    weights: Array
    steer: Array
    foot: float
    limits: Limits


class Workspace(NamedTuple):
    """Memory of the solver for n knots.

    ``states``, ``rotations``, ``inputs`` are the iterate, ``trial_…`` the next one; ``slope_x``, ``slope_u`` (n, 24,
    24) derivatives of a knot's dynamics; ``gap`` (n, 24) where they lead, off the next knot; ``feet``
    (n + 1, 4, 3) and ``feet_slope`` (n + 1, 12, 24) of the iterate; ``free`` (n,) inputs that the equalities leave;
    ``rate_x`` (n, 12, 24), ``rate_u`` (n, 12, 12), ``rate_0`` (n, 12): what joint rates change by with the state, the
    free inputs, and by themselves; ``next_x``, ``next_u`` (n, 24, 12), ``next_0`` (n, 24) the dynamics with that;
    ``gain`` (n, 12, 24), ``offset`` (n, 12) the answer of the recursion; ``move_x`` (n + 1, 24), ``move_u`` (n, 24) the
    full step; ``cost_x``, ``pull_x`` (n + 1, 24), ``cost_force`` (n, 4, 3, 3), ``cost_rate`` (n, 12) and ``pull_u``
    (n, 24) the cost's quadratic model; ``tree``, ``matrix`` (12, 12) and ``right`` (12, 40) are scratch.
    """

    states: Array
    rotations: Array
    inputs: Array
    trial_states: Array
    trial_rotations: Array
    trial_inputs: Array
    slope_x: Array
    slope_u: Array
    gap: Array
    feet: Array
    feet_slope: Array
    free: NDArray[np.int64]
    rate_x: Array
    rate_u: Array
    rate_0: Array
    next_x: Array
    next_u: Array
    next_0: Array
    gain: Array
    offset: Array
    move_x: Array
    move_u: Array
    cost_x: Array
    pull_x: Array
    cost_force: Array
    cost_rate: Array
    pull_u: Array
    tree: Tree
    matrix: Array
    right: Array


def make_workspace(knots: int) -> Workspace:
    """Memory for problems of up to so many knots; entries that no kernel writes are zero."""
    n, x = knots, STATES
    return Workspace(
        np.zeros((n + 1, x)), np.zeros((n + 1, 3, 3)), np.zeros((n, x)),
        np.zeros((n + 1, x)), np.zeros((n + 1, 3, 3)), np.zeros((n, x)),
        np.zeros((n, x, x)), np.zeros((n, x, x)), np.zeros((n, x)),
        np.zeros((n + 1, 4, 3)), np.zeros((n + 1, 12, x)), np.zeros(n, np.int64),
        np.zeros((n, 12, x)), np.zeros((n, 12, FREE)), np.zeros((n, 12)),
        np.zeros((n, x, x)), np.zeros((n, x, FREE)), np.zeros((n, x)),
        np.zeros((n, FREE, x)), np.zeros((n, FREE)), np.zeros((n + 1, x)), np.zeros((n, x)),
        np.zeros((n + 1, x)), np.zeros((n + 1, x)), np.zeros((n, 4, 3, 3)), np.zeros((n, 12)), np.zeros((n, x)),
        make_tree(), np.zeros((12, 12)), np.zeros((12, 40)),
    )  # fmt: skip
