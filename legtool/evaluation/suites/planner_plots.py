"""Drawings of closed-loop walks, as SVG text: the world from above with maps and plans, a filmstrip from the side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from legtool.datasets.logs.recording import Recording
from legtool.evaluation.report.drawing import GREY, RED, draw
from legtool.evaluation.suites.region_plots import paint_frame
from legtool.evaluation.suites.trial import Walked
from legtool.sim.robots.skeleton import leg_points
from legtool.sim.walks.pips import PlannedFrame
from legtool.sim.worlds.world import World
from legtool_runtime.robot import LEGS
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]

#: Left and right feet.
_SIDES = {"left": ("#1f5fa8", (0, 2)), "right": ("#c4511c", (1, 3))}
#: Maps with their plans that are drawn, and robots on a filmstrip.
_MAPS, _FRAMES = 3, 9
#: Costmap distances beyond this look alike [m].
_FAR_M = 0.15
#: What is drawn beyond start and goal, and beside the straight way between them, at least [m].
_BEYOND_M, _BESIDE_M = 0.6, 0.6
#: Side of the cells of a world seen from above [m].
_CELL_M = 0.02
_PIT = "#374151"


def world_view(walked: Walked) -> str:
    """From above: the world, the way of the CoM, where feet stood; below it some maps and the plans made on them."""
    world, recording, snapshots = walked.world, walked.recording, walked.history.snapshots
    chosen = snapshots[:: max(1, len(snapshots) // _MAPS)][:_MAPS]
    frames = _spread(walked.frames)
    low, high = _extent(world, recording)

    def paint(figure: Figure) -> None:
        axes = figure.subplots(1 + len(chosen) + len(frames), 1, squeeze=False)[:, 0]
        for ax, frame in zip(axes[1 + len(chosen) :], frames, strict=True):
            paint_frame(ax, frame)
            _frame(ax, low, high)
        _top_view(axes[0], walked, low, high)
        axes[-1].set_xlabel("x [m]")
        for ax, (plan, costmap, position) in zip(axes[1 : 1 + len(chosen)], chosen, strict=True):
            corner = costmap.lower_corner
            end = corner + costmap.resolution_m * np.array(costmap.distance.shape)
            shown = ax.imshow(
                np.minimum(costmap.distance, _FAR_M).T,
                origin="lower",
                extent=(corner[0], end[0], corner[1], end[1]),
                cmap="gray",
                vmin=0.0,
                vmax=_FAR_M,
                interpolation="nearest",
            )
            scale = figure.colorbar(shown, cax=ax.inset_axes((1.02, 0.0, 0.015, 1.0)), ticks=(0.0, 0.05, 0.1, _FAR_M))
            scale.set_label("to unsafe ground [m]", fontsize=7)
            ax.plot(position[0], position[1], marker="o", color="#2b7d4f")
            ax.plot(plan.position[:, 0], plan.position[:, 1], color="#2b7d4f", linewidth=1.2)
            for colour, legs in _SIDES.values():
                on_side = np.isin(plan.legs, legs)
                ax.plot(*plan.touchdowns[on_side][:, :2].T, ".", color=colour)
            command = ", ".join(f"{value:.1f}" for value in plan.commands[:, 0])
            ax.set_title(
                f"map at x = {position[0]:.2f} m; planned vx {command or 'none'} m/s ({plan.status})", loc="left"
            )
            _frame(ax, low, high)

    height = 8.5 * (high[1] - low[1]) / (high[0] - low[0]) + 0.3
    return draw(paint, 8.5, min(max(1.7, height), 5.0) * (1 + len(chosen) + len(frames)))


def _spread(frames: Sequence[PlannedFrame]) -> list[PlannedFrame]:
    """Some frames, at equal distances over the walk."""
    middles = [(2 * k + 1) * len(frames) // (2 * _MAPS) for k in range(_MAPS)]
    return [frames[k] for k in dict.fromkeys(middles)] if frames else []


def _extent(world: World, recording: Recording) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of what is drawn [m]."""
    places = np.concatenate([[world.start[:2], world.goal], recording.position_world[:, :2]])
    beside = np.array([_BEYOND_M, _BESIDE_M])
    return places.min(axis=0) - beside, places.max(axis=0) + beside


def _top_view(ax: Axes, walked: Walked, low: Array, high: Array) -> None:
    world, recording = walked.world, walked.recording
    x, y = (np.arange(low[k], high[k], _CELL_M) + 0.5 * _CELL_M for k in range(2))
    heights = world.height(x[:, None], y)
    points = np.stack(np.broadcast_arrays(x[:, None], y, heights), axis=-1).reshape(-1, 3)
    ground = world.on_ground(points).reshape(heights.shape)
    lowest = float(heights[ground].min()) if ground.any() else 0.0
    tallest = max(0.05, float(heights[ground].max()) - lowest) if ground.any() else 0.05
    shade = np.where(ground, 0.82 + 0.18 * (heights - lowest) / tallest, np.nan)
    ax.set_facecolor(_PIT)
    ax.imshow(
        shade.T, origin="lower", extent=(low[0], high[0], low[1], high[1]), cmap="gray", vmin=0.0, vmax=1.0,
        interpolation="nearest",
    )  # fmt: skip
    feet = feet_world(recording)
    ax.plot(recording.position_world[:, 0], recording.position_world[:, 1], color="#2b7d4f", linewidth=1.2, label="CoM")
    for name, (colour, legs) in _SIDES.items():
        stood = np.concatenate([_stands(recording, feet, leg) for leg in legs])
        ax.plot(stood[:, 0], stood[:, 1], ".", color=colour, markersize=5, label=f"{name} feet")
    if walked.missteps:
        where = np.array([(x, y) for _, x, y, _ in walked.missteps])
        ax.plot(where[:, 0], where[:, 1], "x", color=RED, markersize=8, label="missteps")
    ax.plot(*world.goal, marker="*", color="#2b7d4f", markersize=9, linestyle="none", label="goal")
    ax.set_title(f"{walked.outcome}: where feet stood", loc="left")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)
    _frame(ax, low, high)


def filmstrip(walked: Walked) -> str:
    """From the side: the robot at equal distances along its way, over the ground to its left and to its right."""
    world, recording, robot = walked.world, walked.recording, walked.robot.geometry
    way = world.goal - world.start[:2]
    length = float(np.hypot(*way))
    ahead = way / length if length > 0 else np.array([np.cos(world.start[2]), np.sin(world.start[2])])
    beside = np.array([-ahead[1], ahead[0]])
    along = (recording.position_world[:, :2] - world.start[:2]) @ ahead
    rows = [int(np.argmax(along >= stop - 1e-9)) for stop in np.linspace(along.min(), along.max(), _FRAMES)]

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        s = np.arange(min(-0.6, along.min() - 0.4), max(length, along.max()) + 0.5, 0.002)
        lowest = highest = float(world.height(*world.start[:2]))
        for y, (colour, _) in zip((0.2, -0.2), _SIDES.values(), strict=True):
            places = world.start[:2] + s[:, None] * ahead + y * beside
            heights = world.height(places[:, 0], places[:, 1])
            lowest, highest = min(lowest, float(heights.min())), max(highest, float(heights.max()))
            ax.plot(s, heights, color=colour, linewidth=0.8)
        for row in rows:
            _stick_figure(ax, walked, row, ahead)
        ax.set_aspect("equal")
        ax.grid(visible=False)
        ax.set_xlim(s[0], s[-1])
        ax.set_ylim(max(lowest, -0.6) - 0.02, highest + 1.9 * robot.standing_height)
        ax.set_xlabel("along the way [m]")
        ax.set_ylabel("z [m]")
        ax.set_title("from the right; left legs and ground blue, right legs and ground orange", loc="left")

    return draw(paint, 8.5, 2.4)


def _stick_figure(ax: Axes, walked: Walked, row: int, ahead: Array) -> None:
    recording, robot, start = walked.recording, walked.robot.geometry, walked.world.start[:2]

    def flat(points: Array) -> tuple[Array, Array]:
        return (points[:, :2] - start) @ ahead, points[:, 2]

    rotation = rotation_of(recording.orientation[row])
    at = recording.position_world[row]
    hips, knees, feet = leg_points(robot, walked.joint_positions[row])
    for colour, legs in _SIDES.values():
        for leg in legs:
            points = at + np.stack([hips[leg], knees[leg], feet[leg]]) @ rotation.T
            ax.plot(*flat(points), color=colour, linewidth=1.1, solid_capstyle="round")
    trunk = at + np.stack([robot.hips[[0, 1]].mean(axis=0), robot.hips[[2, 3]].mean(axis=0)]) @ rotation.T
    ax.plot(*flat(trunk), color=GREY, linewidth=3.0, solid_capstyle="round")


def feet_world(recording: Recording) -> Array:
    """(n, 4, 3) world frame [m]."""
    rotations = np.stack([rotation_of(quaternion) for quaternion in recording.orientation])
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


def _frame(ax: Axes, low: Array, high: Array) -> None:
    ax.set_aspect("equal")
    ax.grid(visible=False)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_ylabel("y [m]")
