"""Drawings of closed-loop walks, as SVG text: the course from above with maps and plans, a filmstrip from the side."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from legtool.datasets.logs.recording import Recording
from legtool.evaluation.report.drawing import GREY, RED, draw
from legtool.sim.walks.walk import Walk
from legtool.sim.worlds.course import Course
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]

#: Left and right feet.
_SIDES = {"left": ("#1f5fa8", (0, 2)), "right": ("#c4511c", (1, 3))}
#: Maps with their plans that are drawn, and robots on a filmstrip.
_MAPS, _FRAMES = 3, 9
#: Costmap distances beyond this look alike [m].
_FAR_M = 0.15


def course_view(course: Course, walk: Walk, recording: Recording) -> str:
    """From above: the course, the way of the CoM, where feet stood; below it some maps and the plans made on them."""
    chosen = walk.snapshots[:: max(1, len(walk.snapshots) // _MAPS)][:_MAPS]

    def paint(figure: Figure) -> None:
        axes = figure.subplots(1 + len(chosen), 1, squeeze=False)[:, 0]
        _top_view(axes[0], course, walk, recording)
        for ax, (plan, costmap, position) in zip(axes[1:], chosen, strict=True):
            low = costmap.lower_corner
            high = low + costmap.resolution_m * np.array(costmap.distance.shape)
            ax.imshow(
                np.minimum(costmap.distance, _FAR_M).T,
                origin="lower",
                extent=(low[0], high[0], low[1], high[1]),
                cmap="gray",
                interpolation="nearest",
            )
            ax.plot(position[0], position[1], marker="o", color="#2b7d4f")
            ax.plot(plan.position[:, 0], plan.position[:, 1], color="#2b7d4f", linewidth=1.2)
            for colour, legs in _SIDES.values():
                on_side = np.isin(plan.legs, legs)
                ax.plot(*plan.touchdowns[on_side][:, :2].T, ".", color=colour)
            command = ", ".join(f"{value:.1f}" for value in plan.commands[:, 0])
            ax.set_title(
                f"map at x = {position[0]:.2f} m; planned vx {command or 'none'} m/s ({plan.status})", loc="left"
            )
            _frame(ax, course)

    return draw(paint, 8.5, 1.7 * (1 + len(chosen)))


def _top_view(ax: Axes, course: Course, walk: Walk, recording: Recording) -> None:
    ax.set_facecolor("#374151")
    tallest = max(0.05, float(course.upper[:, 2].max()))
    for low, high in zip(course.lower, course.upper, strict=True):
        shade = 0.82 + 0.18 * high[2] / tallest
        ax.add_patch(Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1], color=str(min(shade, 1.0))))
    feet = feet_world(recording)
    ax.plot(recording.position_world[:, 0], recording.position_world[:, 1], color="#2b7d4f", linewidth=1.2, label="CoM")
    for name, (colour, legs) in _SIDES.items():
        stood = np.concatenate([_stands(recording, feet, leg) for leg in legs])
        ax.plot(stood[:, 0], stood[:, 1], ".", color=colour, markersize=5, label=f"{name} feet")
    if walk.unclean:
        where = np.array(walk.unclean)[:, 1:]
        ax.plot(where[:, 0], where[:, 1], "x", color=RED, markersize=8, label="in a gap or on an edge")
    ax.set_title(f"{walk.outcome}: where feet stood", loc="left")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)
    _frame(ax, course)


def filmstrip(course: Course, robot: Robot, recording: Recording, joint_positions: Array) -> str:
    """From the side: the robot at equal distances along its way, over the floor's two halves."""
    x = recording.position_world[:, 0]
    stops = np.linspace(x.min(), x.max(), _FRAMES)
    rows = [int(np.argmax(x >= stop - 1e-9)) for stop in stops]

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        along = np.arange(-course.settings.run_in, course.settings.length + course.settings.run_in, 0.002)
        for y, (colour, _) in zip((0.2, -0.2), _SIDES.values(), strict=True):
            ax.plot(along, course.height(along, np.full(along.shape, y)), color=colour, linewidth=0.8)
        for row in rows:
            _stick_figure(ax, robot, recording, joint_positions, row)
        ax.set_aspect("equal")
        ax.grid(visible=False)
        ax.set_xlim(min(-0.6, x.min() - 0.4), course.settings.length + 0.5)
        ax.set_ylim(-course.settings.pit_depth - 0.02, 0.75)
        ax.set_xlabel("x [m]")
        ax.set_title("from the right; left legs and floor blue, right legs and floor orange", loc="left")

    return draw(paint, 8.5, 2.4)


def _stick_figure(ax: Axes, robot: Robot, recording: Recording, joint_positions: Array, row: int) -> None:
    rotation = rotation_of(recording.orientation[row])
    at = recording.position_world[row]
    hips, knees, feet = leg_points(robot, joint_positions[row])
    for colour, legs in _SIDES.values():
        for leg in legs:
            points = at + np.stack([hips[leg], knees[leg], feet[leg]]) @ rotation.T
            ax.plot(points[:, 0], points[:, 2], color=colour, linewidth=1.1, solid_capstyle="round")
    trunk = at + np.stack([robot.hips[[0, 1]].mean(axis=0), robot.hips[[2, 3]].mean(axis=0)]) @ rotation.T
    ax.plot(trunk[:, 0], trunk[:, 2], color=GREY, linewidth=3.0, solid_capstyle="round")


def leg_points(robot: Robot, joints: Array) -> tuple[Array, Array, Array]:
    """Thigh axes, knees and feet, each (4, 3) base frame [m], for joint angles (4, 3) [rad]."""
    c, s = np.cos(joints[:, 0]), np.sin(joints[:, 0])
    lateral = robot.abduction_offset
    hips = robot.hips + np.stack([np.zeros(4), c * lateral, s * lateral], axis=1)
    down = -robot.thigh_length * np.cos(joints[:, 1])
    knees = hips + np.stack([-robot.thigh_length * np.sin(joints[:, 1]), -s * down, c * down], axis=1)
    return hips, knees, robot.feet(joints)


def feet_world(recording: Recording) -> Array:
    """(n, 4, 3) world frame [m]."""
    rotations = rotation_of(recording.orientation)
    feet: Array = recording.position_world[:, None] + np.einsum("nij,nlj->nli", rotations, recording.feet_base)
    return feet


def _stands(recording: Recording, feet: Array, leg: int) -> Array:
    """(m, 3) where a leg stood: the middle of each contact."""
    assert recording.contact_force is not None
    force = recording.contact_force[:, leg]
    contact = force > 0.08 * recording.contact_force.sum(axis=1).max()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], contact, [False]]).astype(int)))
    middles = [(start + end) // 2 for start, end in zip(edges[::2], edges[1::2], strict=True) if end - start > 5]
    return feet[np.array(middles, dtype=int), leg] if middles else np.zeros((0, len(LEGS) - 1))


def _frame(ax: Axes, course: Course) -> None:
    ax.set_aspect("equal")
    ax.grid(visible=False)
    ax.set_xlim(-0.6, course.settings.length + 0.5)
    ax.set_ylim(-0.6, 0.6)
    ax.set_ylabel("y [m]")
