"""What the swing optimisation begins with and holds to: the tracking controller's own reference, at the knots."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.robot import Robot, leg_inverse
from legtool_runtime.search.swings.centroidal import Tree, fill_tree
from legtool_runtime.search.swings.problem import STATES
from legtool_runtime.search.swings.recursion import solve_in_place
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.body_reference import BodyReference, spline_at, turning
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance
from legtool_runtime.tracking.dynamics import GRAVITY, Model
from legtool_runtime.tracking.settings import TrackerSettings
from legtool_runtime.tracking.swing import TimedSwing

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Length of the straight leg that lengths and joint speeds are written for [m].
LEG_M = 0.6125
#: Passes in which joints and the centre of mass in the base's frame are brought together.
_TOGETHER = 4
#: Knees are bent by so much at least to begin with [rad].
_BENT = 0.3
#: Of the least squares for forces: how little a wrench may be missed for it.
_SOFT = 1e-3


class Knots(NamedTuple):
    """Knots and contacts of a window.

    ``times`` (n + 1,) [s]; ``standing``, ``fixed`` (n, 4), ``contact`` (n, 4, 3), ``axes`` (n, 4, 3, 3), ``target``
    (n + 1, 4, 3) as in :class:`.SwingProblem`; ``phase`` (n + 1, 4) of the swing on whose way a foot is at a knot, NaN
    for one that stands before and after it; ``landings`` of the window: knot, leg and stance.
    """

    times: Array
    standing: Flags
    fixed: Flags
    contact: Array
    axes: Array
    target: Array
    phase: Array
    landings: tuple[tuple[int, int, Stance], ...]


def window_end(plan: ContactPlan, start_s: float, transitions: int, rest_s: float) -> float:
    """When so many transitions are over: at the lift-off after their last touchdown, or so long after it."""
    landings = sorted({round(s.begin_s, 6) for row in plan.stances for s in row if start_s < s.begin_s < math.inf})
    if not landings:
        return start_s + rest_s
    last = landings[min(transitions, len(landings)) - 1]
    lifts = [s.end_s for row in plan.stances for s in row if last < s.end_s < math.inf]
    return min([*lifts, last + rest_s])


def make_knots(
    plan: ContactPlan, robot: Robot, start_s: float, end_s: float, longest_s: float, elevation: HeightMap | None
) -> Knots:
    """Lay knots between events, and say where the feet are to be at them."""
    borders = [start_s, *(t for t in plan.events() if start_s + 1e-6 < t < end_s - 1e-6), end_s]
    times = [start_s]
    for a, b in itertools.pairwise(borders):
        pieces = max(math.ceil((b - a) / longest_s - 1e-6), 1)
        times += [a + (b - a) * i / pieces for i in range(1, pieces + 1)]
    n, at = len(times) - 1, np.array(times)
    middles = 0.5 * (at[1:] + at[:-1])
    standing, fixed = np.zeros((n, 4), np.bool_), np.zeros((n, 4), np.bool_)
    contact, axes = np.zeros((n, 4, 3)), np.tile(np.eye(3), (n, 4, 1, 1))
    target, phase = np.zeros((n + 1, 4, 3)), np.full((n + 1, 4), np.nan)
    landings: list[tuple[int, int, Stance]] = []
    for leg, row in enumerate(plan.stances):
        for k, stance in enumerate(row):
            inside = np.flatnonzero((stance.begin_s <= middles) & (middles < stance.end_s))
            if len(inside):
                standing[inside, leg] = fixed[inside, leg] = True
                contact[inside, leg], axes[inside, leg] = stance.place, _axes(stance.normal)
                target[inside, leg] = target[inside + 1, leg] = _centre(stance, robot)
            following = row[k + 1] if k + 1 < len(row) else None
            swing_s = np.inf if following is None else following.begin_s
            inside = np.flatnonzero((stance.end_s <= middles) & (middles < swing_s))
            if not len(inside):
                continue
            if following is None:  # never stands again: held where it is
                fixed[inside, leg] = True
                target[inside, leg] = target[inside + 1, leg] = _centre(stance, robot)
                continue
            on_way = np.append(inside, inside[-1] + 1)
            phases = np.clip((at[on_way] - stance.end_s) / (swing_s - stance.end_s), 0.0, 1.0)
            phase[on_way, leg] = phases
            target[on_way, leg] = planned_swing(robot, stance, following, elevation).along(phases)
            if phases[-1] > 1.0 - 1e-6:
                fixed[inside[-1], leg] = True
                target[on_way[-1], leg] = _centre(following, robot)
                landings.append((int(on_way[-1]), leg, following))
        before = row[0]
        early = np.flatnonzero(middles < before.begin_s)  # in the air before its first stance: held over it
        fixed[early, leg] = True
        target[early, leg] = _centre(before, robot)
    return Knots(at, standing, fixed, contact, axes, target, phase, tuple(landings))


def leg_length(robot: Robot) -> float:
    """Of a straight leg [m]."""
    return float((robot.thigh_length + robot.shank_length).max())


def planned_swing(robot: Robot, last: Stance, following: Stance, elevation: HeightMap | None) -> TimedSwing:
    """The swing that the tracking controller would make from one stance to another."""
    given, size = TrackerSettings(), leg_length(robot) / LEG_M
    swing = TimedSwing(
        _centre(last, robot), _centre(following, robot), given.swing_height_m * size,
        duration_s=min(max(following.begin_s - last.end_s, 0.05), 10.0), profile=given.swing_profile,
        search_speed=given.search_speed * math.sqrt(size), search_depth_m=given.search_depth_m * size,
    )  # fmt: skip
    return swing if elevation is None else swing.clear_of(elevation, radius=robot.foot_radius)[0]


def _centre(stance: Stance, robot: Robot) -> Array:
    centre: Array = stance.place + robot.foot_radius * stance.normal
    return centre


def _axes(normal: Array) -> Array:
    """(3, 3) two tangents and the normal, as rows."""
    first = np.array([normal[2], 0.0, -normal[0]])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])


def swing_demand(plan: ContactPlan, body: BodyReference, time_s: float) -> tuple[Array, Array]:
    """What a swing over two feet asks of the centre of mass where it begins; zeros elsewhere.

    Off the line through the two feet the centre of mass falls away from it, d̈ = ω² d, whatever the feet push. To be at
    the reference at the swing's end it has to begin with ḋ = ω (d₁ - d₀ cosh ωT) / sinh ωT.

    Returns:
        (3,) what the reference's velocity lacks [m/s]; (24,) the row by which the state's deviation is to be 0: the
        velocity across the line, and the place across it, which asks for ω coth ωT times as much velocity.
    """
    row = np.zeros(STATES)
    bearing = [stance for leg in range(4) if (stance := plan.current(leg, time_s + 1e-6)) is not None]
    land = min((plan.touchdown_s(leg, time_s + 1e-6) for leg in range(4)), default=math.inf)
    begins = any(abs(s.end_s - time_s) < 1e-6 for stances in plan.stances for s in stances)
    if not begins or len(bearing) != 2 or not math.isfinite(land):
        return np.zeros(3), row
    now, then = body.at(time_s), body.at(land)
    first, second = bearing[0].place, bearing[1].place
    across = np.array([first[1] - second[1], second[0] - first[0], 0.0])
    across /= np.linalg.norm(across)
    omega = math.sqrt(GRAVITY / max(now.position[2] - 0.5 * (first[2] + second[2]), 0.1))
    d0, d1 = across @ (now.position - first), across @ (then.position - first)
    wt = omega * (land - time_s)
    wanted = omega * (d1 - d0 * math.cosh(wt)) / math.sinh(wt)
    row[0:3], row[6:9] = across, omega / math.tanh(wt) * across
    return (wanted - across @ now.velocity) * across, row


class Course(NamedTuple):
    """The reference at knots: ``states`` (n + 1, 24), ``rotations`` (n + 1, 3, 3), ``inputs`` (n, 24), ``reached``
    (n + 1, 4) whether the legs get to their feet."""

    states: Array
    rotations: Array
    inputs: Array
    reached: Flags


def make_course(robot: Robot, model: Model, tree: Tree, body: BodyReference, knots: Knots, com: Array) -> Course:
    """The reference of body and feet as states and inputs.

    Args:
        robot: whose legs reach.
        model: with masses.
        tree: scratch.
        body: reference of the centre of mass across, and of the trunk's height for legs that all stand.
        knots: with the places of the feet.
        com: (3,) of the robot as it stands, base frame [m].
    """
    n = len(knots.times) - 1
    course = Course(np.zeros((n + 1, 24)), np.zeros((n + 1, 3, 3)), np.zeros((n, 24)), np.zeros((n + 1, 4), np.bool_))
    spins = np.empty((n + 1, 3))
    _bodies(body.control, np.array([body.start_s, body.step_s]), knots.times, course, spins)
    heights = course.states[:, 8] - course.rotations[:, 2] @ com
    _joints(model, _legs(robot), knots.target, com.copy(), heights, tree, course)
    _momenta(model, knots.times, spins, tree, course)
    _forces(knots.times, knots.standing, knots.contact, course)
    return course


def stand_first(robot: Robot, model: Model, tree: Tree, knots: Knots, course: Course, com: Array) -> None:
    """Write the joints of the first state, whose body has been put elsewhere, so that the feet are where they were."""
    first = Course(course.states[:1], course.rotations[:1], course.inputs[:1], course.reached[:1])
    _joints(model, _legs(robot), knots.target[:1], com.copy(), np.full(1, np.nan), tree, first)


def _legs(robot: Robot) -> Array:
    return np.stack([robot.abduction_offset, robot.thigh_length, robot.shank_length, robot.knee_sign], axis=1)


@kernel
def _bodies(control: Array, timing: Array, times: Array, course: Course, spins: Array) -> None:
    spline, rates = np.empty((3, 6)), np.empty((2, 3))
    for k in range(times.shape[0]):
        spline_at(timing[0], timing[1], control, times[k], spline)
        turning(spline, course.rotations[k], rates)
        course.states[k, 0:3], course.states[k, 6:9] = spline[1, 0:3], spline[0, 0:3]
        spins[k] = rates[0]


@kernel
def _joints(
    model: Model, legs: Array, feet: Array, com: Array, heights: Array, tree: Tree, course: Course
) -> None:  # fmt: skip
    """Write joints at all knots, by inverse kinematics from where the base is for a centre of mass.

    ``heights`` (n,) are the base's, which then decide the centre of mass's; NaN: its own stays [m].
    """
    foot = np.empty(3)
    for k in range(feet.shape[0]):
        x, rotation = course.states[k], course.rotations[k]
        for _ in range(_TOGETHER):
            for leg in range(4):
                for j in range(3):
                    foot[j] = com[j]
                    for i in range(3):
                        foot[j] += rotation[i, j] * (feet[k, leg, i] - x[6 + i])
                a = 12 + 3 * leg
                course.reached[k, leg] = leg_inverse(
                    model.hips[leg], legs[leg, 0], legs[leg, 1], legs[leg, 2], legs[leg, 3], foot, x[a : a + 3]
                )
                if abs(x[a + 2]) < _BENT:  # a straight leg has no inverse; the solver takes what it lacks from here
                    x[a + 1] += 0.5 * (x[a + 2] - legs[leg, 3] * _BENT)
                    x[a + 2] = legs[leg, 3] * _BENT
            fill_tree(model, x[12:24], tree)
            com[:] = tree.com
            if np.isfinite(heights[k]):
                x[8] = heights[k] + rotation[2, 0] * com[0] + rotation[2, 1] * com[1] + rotation[2, 2] * com[2]
    for k in range(1, feet.shape[0]):
        for j in range(12, 24):  # without jumps by whole turns
            turns = np.round((course.states[k, j] - course.states[k - 1, j]) / (2.0 * np.pi))
            course.states[k, j] -= 2.0 * np.pi * turns


@kernel
def _momenta(model: Model, times: Array, spins: Array, tree: Tree, course: Course) -> None:
    """Write joint rates, and the angular momentum that goes with them and the body's turning."""
    n = times.shape[0] - 1
    rates, turned, momentum = np.empty(12), np.empty(3), np.empty(3)
    for k in range(n):
        for j in range(12):
            course.inputs[k, 12 + j] = (course.states[k + 1, 12 + j] - course.states[k, 12 + j]) / (
                times[k + 1] - times[k]
            )
    for k in range(n + 1):
        x, rotation = course.states[k], course.rotations[k]
        first, second = max(k - 1, 0), min(k, n - 1)
        for j in range(12):
            rates[j] = 0.5 * (course.inputs[first, 12 + j] + course.inputs[second, 12 + j])
        fill_tree(model, x[12:24], tree)
        for i in range(3):
            turned[i] = rotation[0, i] * spins[k, 0] + rotation[1, i] * spins[k, 1] + rotation[2, i] * spins[k, 2]
        for i in range(3):
            momentum[i] = 0.0
            for j in range(3):
                momentum[i] += tree.locked[i, j] * turned[j]
            for j in range(12):
                momentum[i] += tree.rate[j, i] * rates[j]
        for i in range(3):
            x[3 + i] = 0.0
            for j in range(3):
                x[3 + i] += rotation[i, j] * momentum[j] / model.mass


@kernel
def _forces(times: Array, standing: Flags, contact: Array, course: Course) -> None:
    """Write the forces, nearest to even shares, that make the reference's motion as far as the contacts let them."""
    wrench, matrix, right = np.empty((6, 12)), np.empty((6, 6)), np.empty((6, 1))
    for k in range(standing.shape[0]):
        dt = times[k + 1] - times[k]
        x, after = course.states[k], course.states[k + 1]
        feet = 0
        for leg in range(4):
            feet += standing[k, leg]
        if feet == 0:
            continue
        for i in range(3):
            right[i, 0] = (after[i] - x[i]) / (dt * GRAVITY)
            right[3 + i, 0] = (after[3 + i] - x[3 + i]) / (dt * GRAVITY)
        wrench[:] = 0.0
        for leg in range(4):
            if not standing[k, leg]:
                continue
            a = 3 * leg
            course.inputs[k, a + 2] = 1.0 / feet
            for i in range(3):
                wrench[i, a + i] = 1.0
                after_i, before_i = (i + 1) % 3, (i + 2) % 3
                middle = 0.5 * (x[6 + before_i] + after[6 + before_i])
                wrench[3 + after_i, a + i] = contact[k, leg, before_i] - middle
                middle = 0.5 * (x[6 + after_i] + after[6 + after_i])
                wrench[3 + before_i, a + i] = -(contact[k, leg, after_i] - middle)
            for row in range(6):
                right[row, 0] -= wrench[row, a + 2] / feet
        right[2, 0] += 1.0
        for i in range(6):
            for j in range(6):
                matrix[i, j] = _SOFT if i == j else 0.0
                for l in range(12):
                    matrix[i, j] += wrench[i, l] * wrench[j, l]
        if solve_in_place(matrix, right, 1):
            for l in range(12):
                for row in range(6):
                    course.inputs[k, l] += wrench[row, l] * right[row, 0]
