"""Preview: convex model-predictive control of the single rigid body over the stances of a contact plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import TrackingError
from legtool_runtime.tracking import riccati
from legtool_runtime.tracking.body_reference import BodyReference
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.dynamics import GRAVITY
from legtool_runtime.tracking.preview_problem import Result, assemble, guess, node_borders, node_contacts, read
from legtool_runtime.tracking.settings import PreviewSettings

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

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
        node_borders(plan.table, time_s, self.settings.node_s, self._times)
        node_contacts(plan.table, self._times, now, waits, self._standing)
        body = np.vstack([state.position, state.velocity, state.rotation, state.angular_velocity])
        node_s = np.diff(self._times)
        problem = riccati.RiccatiProblem(
            node_s, node_s / self.settings.node_s, self._start, self._legs, self._wrench, self._shift, self._drift,
            self._nominal, self._weights, 2.0 * self.settings.effort, self.settings.friction, self._least,
            self.settings.most,
        )  # fmt: skip
        timing = (reference.start_s, reference.step_s)
        rigid = (self.mass, self.inertia, self.settings.least)
        assemble(
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
        guess(problem, self._work, before, old, self._times, self._standing, self._axes, self.mass * GRAVITY)
        riccati.begin(problem, self._work, _WARM if warm else _COLD)
        iterations = riccati.solve(problem, self._work, riccati.TOLERANCE)
        if iterations < 0 and warm:  # a guess can be worse than none
            old = np.full(nodes + 1, -np.inf)
            guess(problem, self._work, before, old, self._times, self._standing, self._axes, self.mass * GRAVITY)
            riccati.begin(problem, self._work, _COLD)
            iterations = riccati.solve(problem, self._work, riccati.TOLERANCE)
        if iterations < 0:
            return self._kept(-iterations, time_s, state)
        out = Result(np.zeros((nodes, 4, 3)), np.zeros((nodes, 6)), np.zeros((nodes + 1, 9)))
        timing = (reference.start_s, reference.step_s)
        read(
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
