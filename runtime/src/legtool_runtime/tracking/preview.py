"""Preview: convex model-predictive control of the single rigid body over the stances of a contact plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import TrackingError
from legtool_runtime.tracking import riccati
from legtool_runtime.tracking.body_reference import BodyReference, spline_at, turning
from legtool_runtime.tracking.contact_plan import ContactPlan, PlanTable, stance_at
from legtool_runtime.tracking.settings import PreviewSettings

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

GRAVITY = 9.81
#: Gap of the first slacks and duals: from a guess of the same problem a moment ago, and from none.
_WARM, _COLD = 0.02, 0.1


class BodyState(NamedTuple):
    """Where the body is, world frame: ``position`` (3,) of the centre of mass [m], ``velocity`` (3,) [m/s],
    ``rotation`` (3, 3) body to world, ``angular_velocity`` (3,) [rad/s]."""

    position: Array
    velocity: Array
    rotation: Array
    angular_velocity: Array


@dataclass(frozen=True, eq=False)
class PreviewSolution:
    """Forces over the horizon, and the motion they make.

    Attributes:
        times_s: (n + 1,) borders of the nodes, the plan's clock.
        solved: whether it is of this moment; an unsolved problem keeps the last solution.
        iterations: of the interior point method.
        forces: (n, 4, 3) of each foot, constant over a node, world frame [N]; zero for a swinging foot.
        acceleration: (n, 3) of the centre of mass, world frame [m/s²].
        angular_acceleration: (n, 3) [rad/s²].
        position: (n + 1, 3) of the centre of mass at the nodes' borders, world frame [m].
        velocity: (n + 1, 3) [m/s].
        standing: (n, 4) which feet carry.
    """

    times_s: Array
    solved: bool
    iterations: int
    forces: Array
    acceleration: Array
    angular_acceleration: Array
    position: Array
    velocity: Array
    standing: Flags

    def node(self, time_s: float) -> int:
        """The node of a time; the first and last one hold before and after."""
        return min(max(int(np.searchsorted(self.times_s, time_s, side="right")) - 1, 0), len(self.forces) - 1)


class Preview:
    """Plans forces for one robot; keeps its last solution to start from."""

    def __init__(
        self, *, mass: float, inertia: ArrayLike, height: float, settings: PreviewSettings | None = None
    ) -> None:
        """Take the rigid body.

        Args:
            mass: of the whole robot [kg].
            inertia: (3, 3) of the robot as it stands, about its centre of mass, base frame [kg m²].
            height: of the centre of mass over the feet as it stands [m].
            settings: weights and margins.

        Raises:
            TrackingError: a mass, inertia or height of no body.
        """
        self.settings = PreviewSettings() if settings is None else settings
        self.mass, self.inertia = float(mass), np.array(inertia, dtype=np.float64)
        symmetric = self.inertia.shape == (3, 3) and np.allclose(self.inertia, self.inertia.T)
        if not (symmetric and np.isfinite(self.inertia).all() and (np.linalg.eigvalsh(self.inertia) > 0).all()):
            raise TrackingError(f"preview: inertia {self.inertia.tolist()}, expected (3, 3), symmetric and positive")
        if not (math.isfinite(mass) and mass > 0 and math.isfinite(height) and height > 0):
            raise TrackingError(f"preview: mass {mass} kg, height {height} m; expected positive numbers")
        n = self.settings.nodes
        self._weights = self.settings.weights(height)
        self._work = riccati.workspace(n)
        self._wrench, self._shift, self._drift = np.zeros((n, 6, 12)), np.zeros((n, 3, 3)), np.zeros((n, 12))
        self._nominal, self._least, self._legs = np.zeros((n, 12)), np.zeros(n), np.zeros(n, np.int64)
        self._axes, self._start, self._times = np.zeros((n, 4, 3, 3)), np.zeros(12), np.zeros(n + 1)
        self._standing, self._last = np.zeros((n, 4), np.bool_), None

    _last: PreviewSolution | None

    def problem(
        self,
        state: BodyState,
        reference: BodyReference,
        plan: ContactPlan,
        time_s: float,
        *,
        standing: ArrayLike | None = None,
        late: ArrayLike | None = None,
        places: ArrayLike | None = None,
    ) -> riccati.RiccatiProblem:
        """The problem at an instant, in memory that the next call overwrites; arguments as of :meth:`solve`."""
        now = plan.standing(time_s) if standing is None else np.array(standing, dtype=np.bool_)
        waits = np.zeros(4, np.bool_) if late is None else np.array(late, dtype=np.bool_)
        feet = np.full((4, 3), np.nan) if places is None else np.array(places, dtype=np.float64)
        _nodes(plan.table, time_s, self.settings.node_s, self._times)
        _contacts(plan.table, self._times, now, waits, self._standing)
        body = np.vstack([state.position, state.velocity, state.rotation, state.angular_velocity])
        node_s = np.diff(self._times)
        problem = riccati.RiccatiProblem(
            node_s, node_s / self.settings.node_s, self._start, self._legs, self._wrench, self._shift, self._drift,
            self._nominal, self._weights, 2.0 * self.settings.effort, self.settings.friction, self._least,
            self.settings.most,
        )  # fmt: skip
        timing = (reference.start_s, reference.step_s)
        rigid = (self.mass, self.inertia, self.settings.least)
        _assemble(
            problem, plan.table, reference.control, timing, self._times, body, feet, rigid, self._standing, self._axes
        )
        return problem

    def solve(
        self,
        state: BodyState,
        reference: BodyReference,
        plan: ContactPlan,
        time_s: float,
        *,
        standing: ArrayLike | None = None,
        late: ArrayLike | None = None,
        places: ArrayLike | None = None,
    ) -> PreviewSolution:
        """Plan forces from now on.

        Args:
            state: where the body is.
            reference: where it shall be, over the horizon.
            plan: which foot stands where and when; an early touchdown is told by :meth:`ContactPlan.touched_down`, a
                clock that waits by :meth:`ContactPlan.delayed`.
            time_s: now, the plan's clock.
            standing: (4,) whether each foot is on the ground; the first node uses no other. None: as planned.
            late: (4,) feet that should stand already and do not; the first two nodes go without them.
            places: (4, 3) contact points of the feet that stand, as measured, world frame [m]; NaN: as planned.

        Returns:
            the solution; with ``solved`` False the last one, which still holds by its own times (an upright stand on
            all feet where there is none). It never raises for what is measured.
        """
        values = np.concatenate([np.ravel(part) for part in state] + [np.array([time_s])])
        if not np.isfinite(values).all() or (standing is not None and np.shape(standing) != (4,)):
            return self._kept(0, time_s, state)
        problem = self.problem(state, reference, plan, time_s, standing=standing, late=late, places=places)
        known = self._last
        nodes = self.settings.nodes
        before, old = np.zeros((nodes, 4, 3)), np.full(nodes + 1, -np.inf)
        warm = known is not None and bool(known.times_s[0] <= time_s < known.times_s[-1])
        if known is not None and warm:
            before, old = known.forces, known.times_s
        _guess(problem, self._work, before, old, self._times, self._standing, self._axes, self.mass * GRAVITY)
        riccati.begin(problem, self._work, _WARM if warm else _COLD)
        iterations = riccati.solve(problem, self._work, riccati.TOLERANCE)
        if iterations < 0 and warm:  # a guess can be worse than none
            old = np.full(nodes + 1, -np.inf)
            _guess(problem, self._work, before, old, self._times, self._standing, self._axes, self.mass * GRAVITY)
            riccati.begin(problem, self._work, _COLD)
            iterations = riccati.solve(problem, self._work, riccati.TOLERANCE)
        if iterations < 0:
            return self._kept(-iterations, time_s, state)
        out = _Result(np.zeros((nodes, 4, 3)), np.zeros((nodes, 6)), np.zeros((nodes + 1, 9)))
        timing = (reference.start_s, reference.step_s)
        _read(
            problem,
            self._work,
            reference.control,
            timing,
            self._times,
            self._standing,
            self._axes,
            self.mass * GRAVITY,
            out,
        )
        self._last = PreviewSolution(
            self._times.copy(), True, iterations, out.forces, out.accelerations[:, :3],
            out.accelerations[:, 3:], out.states[:, :3], out.states[:, 3:6], self._standing.copy(),
        )  # fmt: skip
        return self._last

    def forget(self) -> None:
        """Drop the last solution, as before a new start."""
        self._last = None

    def _kept(self, iterations: int, time_s: float, state: BodyState) -> PreviewSolution:
        n = self.settings.nodes
        if self._last is not None:
            return replace(self._last, solved=False, iterations=iterations)
        forces = np.zeros((n, 4, 3))
        forces[:, :, 2] = 0.25 * self.mass * GRAVITY
        times = np.linspace(time_s, time_s + n * self.settings.node_s, n + 1)
        position = np.tile(np.nan_to_num(np.asarray(state.position, np.float64)), (n + 1, 1))
        rest, still = np.zeros((n, 3)), np.zeros((n + 1, 3))
        standing = np.ones((n, 4), np.bool_)
        return PreviewSolution(times, False, iterations, forces, rest, rest, position, still, standing)


class _Result(NamedTuple):
    forces: Array  # (n, 4, 3)
    accelerations: Array  # (n, 6)
    states: Array  # (n + 1, 9) centre of mass, its velocity, angular velocity


@kernel
def _nodes(table: PlanTable, now: float, node: float, times: Array) -> None:
    """Write the borders (n + 1,) of nodes that no touchdown or lift-off falls into, but for ones of a fifth of a node.

    With nodes of one length the same full stance is one node now and two a moment later, and the body drifts.
    """
    least = 0.2 * node
    times[0] = now
    k, last = 0, times.shape[0] - 1
    while k < last:
        event = np.inf
        for leg in range(4):
            for i in range(table.stances[leg]):
                for t in (table.begin[leg, i], table.end[leg, i]):
                    if t > times[k] + least and t < event:
                        event = t
        parts = last - k
        step = node
        if event < times[k] + (last - k + 1) * node:
            parts = min(max(int(np.ceil((event - times[k]) / node - 1e-6)), 1), last - k)
            step = (event - times[k]) / max(int(np.ceil((event - times[k]) / node - 1e-6)), 1)
        begin = times[k]
        for i in range(1, parts + 1):
            times[k + i] = begin + i * step
        k += parts


@kernel
def _contacts(table: PlanTable, times: Array, now: Flags, late: Flags, out: Flags) -> None:
    """Write which feet carry in each node (n, 4): those that stand at its middle, see :meth:`Preview.solve`."""
    for k in range(out.shape[0]):
        for leg in range(4):
            stands = stance_at(table, leg, 0.5 * (times[k] + times[k + 1])) >= 0
            out[k, leg] = stands and (k > 0 or now[leg]) and (k > 1 or not late[leg])


@kernel
def _contact_axes(normal: Array, out: Array) -> None:
    """Write two tangents and the normal as columns (3, 3); the first tangent lies in the world's x-z plane."""
    x, y, z = normal[0], normal[1], normal[2]
    length = np.sqrt(x * x + z * z)
    tx, tz = z / length, -x / length
    out[0, 0], out[1, 0], out[2, 0] = tx, 0.0, tz
    out[0, 1], out[1, 1], out[2, 1] = y * tz, z * tx - x * tz, -y * tx
    out[0, 2], out[1, 2], out[2, 2] = x, y, z


@kernel
def rotation_vector(turn: Array, out: Array) -> None:
    """Write the rotation vector (3,) of a rotation matrix."""
    cosine = min(max(0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0), -1.0), 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    factor = 0.5 if angle < 1e-6 else 0.5 * angle / max(sine, 1e-6)
    out[0] = factor * (turn[2, 1] - turn[1, 2])
    out[1] = factor * (turn[0, 2] - turn[2, 0])
    out[2] = factor * (turn[1, 0] - turn[0, 1])


@kernel
def _assemble(
    problem: riccati.RiccatiProblem,
    table: PlanTable,
    control: Array,
    timing: tuple[float, float],
    times: Array,
    body: Array,
    places: Array,
    rigid: tuple[float, Array, tuple[float, float]],
    standing: Flags,
    axes: Array,
) -> None:
    """Fill ``problem``: ``timing`` start and step of the reference; ``body`` (6, 3) the state's rows."""
    start, step = timing
    now = times[0]
    mass, inertia, least = rigid
    n = problem.legs.shape[0]
    spline, following, middle = np.empty((3, 6)), np.empty((3, 6)), np.empty((3, 6))
    turn, unused = np.empty((3, 3)), np.empty((3, 3))
    rates, next_rates, other_rates = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    arm, push = np.empty(3), np.empty(3)
    spline_at(start, step, control, now, spline)
    turning(spline, turn, rates)
    off = body[2:5] @ turn.T
    for i in range(3):
        problem.start[i] = body[0, i] - spline[0, i]
        problem.start[i + 3] = body[1, i] - spline[1, i]
        problem.start[i + 9] = body[5, i] - rates[0, i]
    rotation_vector(off, problem.start[6:9])
    for k in range(n):
        dt, centre = problem.node_s[k], 0.5 * (times[k] + times[k + 1])
        spline_at(start, step, control, times[k + 1], following)
        spline_at(start, step, control, centre, middle)
        turning(following, unused, next_rates)
        turning(middle, turn, other_rates)
        world = turn @ inertia @ turn.T
        inverse = np.linalg.inv(world)
        momentum = world @ rates[0]
        spin = inverse @ np.array(
            [
                rates[0, 1] * momentum[2] - rates[0, 2] * momentum[1],
                rates[0, 2] * momentum[0] - rates[0, 0] * momentum[2],
                rates[0, 0] * momentum[1] - rates[0, 1] * momentum[0],
            ]
        )
        for i in range(3):
            wanted = (following[1, i] - spline[1, i]) / dt
            gravity = GRAVITY if i == 2 else 0.0
            push[i] = wanted + gravity
            problem.drift[k, i] = spline[0, i] - following[0, i] + dt * spline[1, i] - 0.5 * dt * dt * gravity
            problem.drift[k, i + 3] = -dt * push[i]
            turned = (next_rates[0, i] - rates[0, i]) / dt + spin[i]
            problem.drift[k, i + 6], problem.drift[k, i + 9] = -0.5 * dt * dt * turned, -dt * turned
        # Shifted by d, forces that sum up to m · push turn the body by -d × m · push.
        skew = np.array([[0.0, -push[2], push[1]], [push[2], 0.0, -push[0]], [-push[1], push[0], 0.0]])
        problem.shift[k] = mass * (inverse @ skew)
        count = 0
        for leg in range(4):
            if standing[k, leg]:
                count += 1
        column = 0
        for leg in range(4):
            if not standing[k, leg]:
                continue
            stance = max(stance_at(table, leg, centre), 0)
            _contact_axes(table.normal[leg, stance], axes[k, leg])
            place = table.place[leg, stance]
            if np.isfinite(places[leg, 0]) and stance == stance_at(table, leg, now):
                place = places[leg]
            for i in range(3):
                arm[i] = place[i] - middle[0, i]
            for j in range(3):
                x, y, z = axes[k, leg, 0, j], axes[k, leg, 1, j], axes[k, leg, 2, j]
                mx, my, mz = arm[1] * z - arm[2] * y, arm[2] * x - arm[0] * z, arm[0] * y - arm[1] * x
                for i in range(3):
                    problem.wrench[k, i, column] = GRAVITY * axes[k, leg, i, j]
                    problem.wrench[k, i + 3, column] = (
                        mass * GRAVITY * (inverse[i, 0] * mx + inverse[i, 1] * my + inverse[i, 2] * mz)
                    )
                problem.nominal[k, column] = (x * push[0] + y * push[1] + z * push[2]) / (GRAVITY * count)
                column += 1
        problem.legs[k] = count
        problem.least[k] = least[0] if count >= 3 else least[1]
        spline[:], rates[0] = following, next_rates[0]


@kernel
def _guess(
    problem: riccati.RiccatiProblem,
    work: riccati.RiccatiWorkspace,
    before: Array,
    old: Array,
    times: Array,
    standing: Flags,
    axes: Array,
    weight: float,
) -> None:
    """Start from forces (n, 4, 3) of nodes with borders ``old`` where the same feet stand, else from nominal ones."""
    n = problem.legs.shape[0]
    node = 0
    work.states[0] = problem.start
    for k in range(n):
        centre = 0.5 * (times[k] + times[k + 1])
        while node < n - 1 and old[node + 1] <= centre:
            node += 1
        column, same = 0, centre < old[n]
        for leg in range(4):
            if standing[k, leg] != (before[node, leg, 2] != 0.0):
                same = False
        for leg in range(4):
            if not standing[k, leg]:
                continue
            for j in range(3):
                value = problem.nominal[k, column]
                if same:
                    value = 0.0
                    for i in range(3):
                        value += axes[k, leg, i, j] * before[node, leg, i] / weight
                work.forces[k, column] = value
                column += 1
        riccati.advance(problem, k, work.states[k], work.forces[k], work.states[k + 1])


@kernel
def _read(
    problem: riccati.RiccatiProblem,
    work: riccati.RiccatiWorkspace,
    control: Array,
    timing: tuple[float, float],
    times: Array,
    standing: Flags,
    axes: Array,
    weight: float,
    out: _Result,
) -> None:
    """Write the solution in the world's frame and units."""
    start, step = timing
    spline, turn, rates = np.empty((3, 6)), np.empty((3, 3)), np.empty((2, 3))
    n = problem.legs.shape[0]
    for k in range(n + 1):
        spline_at(start, step, control, times[k], spline)
        turning(spline, turn, rates)
        for i in range(3):
            out.states[k, i], out.states[k, i + 3] = (
                work.states[k, i] + spline[0, i],
                work.states[k, i + 3] + spline[1, i],
            )
            out.states[k, i + 6] = work.states[k, i + 9] + rates[0, i]
        if k == n:
            break
        column = 0
        for leg in range(4):
            if not standing[k, leg]:
                continue
            for i in range(3):
                for j in range(3):
                    out.forces[k, leg, i] += weight * axes[k, leg, i, j] * work.forces[k, column + j]
            column += 3
    for k in range(n):
        for i in range(6):
            out.accelerations[k, i] = (out.states[k + 1, i + 3] - out.states[k, i + 3]) / problem.node_s[k]
